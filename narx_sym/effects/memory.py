"""Effects that remember: play and hysteresis."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ..recursion import State
from ..signals import k, signal
from ._effect import AMPLITUDE, CURVATURE, GAIN, Form, Scan, effect, step

PLAYS = 5


def play(x: Any, p: Any, r: Any) -> State:
    """The play operator: p follows x once the slack r is taken up (Brokate & Sprekels 1996)."""
    return State(p[k], sp.Max(x[k] - r, sp.Min(x[k] + r, p[k - 1])), x[k])


@effect(
    {"input": "u", "output": "y"}, scan={"r": AMPLITUDE}, sign=1, unit={"r": "unit of the driver"},
    source="Brokate & Sprekels 1996",
)  # fmt: skip
def backlash(x: Any, r: Any) -> Form:
    """Play of half-width r: after a reversal nothing moves until the slack is taken up."""
    p = signal("p")
    return Form((p[k] - x[k],), (play(x, p, r),))


@effect(
    {"output": ("u", "y"), "input": "u", "inside": "y"}, scan={"b": CURVATURE},
    unit={"b": "1 / unit of the driver"}, source="Bouc 1967, Wen 1976 (rate-independent form)", form="Bouc-Wen",
)  # fmt: skip
def hysteresis(x: Any, b: Any) -> Form:
    """Rate-independent memory: going up and coming down take different ways, whatever the speed."""
    h = signal("h")
    d = step(x)
    return Form((h[k],), (State(h[k], h[k - 1] + d - b * (sp.Abs(d) * h[k - 1] + d * sp.Abs(h[k - 1])) / 2, 0),))


@effect(
    {"output": "u", "input": "u"}, scan={"r": Scan("amplitude", (0.5, 1.0))}, unit={"r": "unit of the driver"},
    id="hysteresis", form="play superposition", source="Prandtl 1928, Ishlinskii 1944",
)  # fmt: skip
def play_superposition(x: Any, r: Any) -> Form:
    """Rate-independent memory: going up and coming down take different ways, whatever the speed."""
    ps = [signal(f"p{i}") for i in range(1, PLAYS + 1)]
    states = tuple(play(x, p, r * sp.Rational(i, PLAYS + 1)) for i, p in enumerate(ps, 1))
    return Form(tuple(p[k] - x[k] for p in ps), states)


@effect(
    {"inside": "uy"}, scan={"d": GAIN}, unit={"d": "unit of y / unit of u"}, id="hysteresis", form="Bouc-Wen actuator",
    source="Rakotondrabe 2011; Martins & Aguirre 2016, Eq. System",
)  # fmt: skip
def actuator_hysteresis(u: Any, y: Any, d: Any) -> list[Any]:
    """Rate-independent memory: going up and coming down take different ways, whatever the speed."""
    h = d * u[k - 1] - y[k - 1]
    phi1 = step(u)
    return [phi1, sp.Abs(phi1) * h, phi1 * sp.Abs(h)]
