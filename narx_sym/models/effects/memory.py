"""Effects that remember: play and hysteresis."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import sympy as sp

from ...symbolic.functions import within
from ...symbolic.recursion import State
from ...symbolic.signals import k, signal
from ._effect import AMPLITUDE, CURVATURE, GAIN, POSITIVE, RATIO, WHOLE, Form, Scan, clip, effect, step

# Up to a ratio of 1 the loop is passive, above it still saturates; below -1 a force grows faster than its way.
WIDE = {"b": CURVATURE, "g": Scan("ratio", (1.0, -1.0, 4.0))}
STIFFENING = {"b": CURVATURE, "g": Scan("ratio", (1.0, -1.0, -2.0))}  # -1.375 in the benchmark
ANYWHERE = {"output": ("u", "y"), "input": "u", "inside": "y"}
SOURCE, BOUNDED = "Bouc 1967, Wen 1976 (rate-independent form", "Ikhouane & Rodellar 2005"
PLAYS = 5


def play(x: Any, p: Any, r: Any) -> State:
    """The play operator: p follows x once the slack r is taken up (Brokate & Sprekels 1996)."""
    return State(p[k], within(p[k - 1], x[k] - r, x[k] + r), x[k])


@effect(
    {"input": "u", "output": "y"}, scan={"r": AMPLITUDE}, share=WHOLE, source="Brokate & Sprekels 1996",
    never="thermal propeller battery",
    means={"drive": "gear play", "valve": "play", "smart-material": "hysteresis", "soft": "hysteresis"},
)  # fmt: skip
def backlash(x: Any, r: Any) -> Form:
    """Play of half-width r: after a reversal nothing moves until the slack is taken up."""
    p = signal("p")
    return Form((p[k] - x[k],), (play(x, p, r),))


@backlash.another(
    "elastic", {"inside": "uy"}, share=POSITIVE, source="Nordin & Gutman 2002 (dead zone of an elastic shaft)",
    scan={"r": Scan("amplitude", (0.02, 0.06, 0.15, 0.4)), "d": Scan("gain", (0.8, 1.0, 1.25))},
)  # fmt: skip
def elastic_backlash(u: Any, y: Any, r: Any, d: Any) -> Any:
    """Within the gap the shaft between u and y gives no force."""
    return -clip(d * u[k - 1] - y[k - 1], d * r)


def bouc_wen(x: Any, b: Any, g: Any, n: int) -> Form:
    """Return the hysteresis of Bouc and Wen with exponent n; g is gamma over beta."""
    h = signal("h")
    d, before = step(x), h[k - 1]
    bent = sp.Abs(d) * before * sp.Abs(before) ** (n - 1) + g * d * sp.Abs(before) ** n
    return Form((h[k],), (State(h[k], before + d - b**n * bent, 0),))


@effect(
    ANYWHERE, scan={"b": CURVATURE, "g": RATIO}, form="Bouc-Wen", source=f"{SOURCE})", never="propeller",
    means={
        "motion-force": "friction", "valve": "play", "smart-material": "hysteresis",
        "soft": "hysteresis", "structure": "hysteresis",
    },
)  # fmt: skip
def hysteresis(x: Any, b: Any, g: Any) -> Form:
    """Rate-independent hysteresis: the rising and the falling branch differ at any speed."""
    return bouc_wen(x, b, g, 1)


@hysteresis.another("Bouc-Wen, wide", ANYWHERE, scan=WIDE, closer=True, source=f"{BOUNDED} (bounded, not passive)")
def wide_hysteresis(x: Any, b: Any, g: Any) -> Form:
    """With a larger gamma."""
    return bouc_wen(x, b, g, 1)


@hysteresis.another(
    "Bouc-Wen, sharp", ANYWHERE, scan=WIDE, closer=True, source=f"{SOURCE}, exponent 2); {BOUNDED} (bounded loops)"
)
def sharp_hysteresis(x: Any, b: Any, g: Any) -> Form:
    """With exponent 2."""
    return bouc_wen(x, b, g, 2)


def quarter_steps(x: Any) -> list[Any]:
    """Return the four quarters of the last step of a sequence along the cubic through its last four samples."""
    times = [sp.Rational(i, 4) - 1 for i in range(5)]

    def weight(i: int, t: Any) -> Any:
        return sp.prod([(t + j) / sp.Integer(j - i) for j in range(4) if j != i])

    return [
        sp.Add(*((weight(i, after) - weight(i, before)) * x[k - i] for i in range(4)))
        for before, after in pairwise(times)
    ]


@hysteresis.another(
    "Bouc-Wen force", {"inside": "y"}, scan=STIFFENING,
    source="Noel & Schoukens 2016 (benchmark); midpoint rule in four sub-steps",
)  # fmt: skip
def hysteretic_force(x: Any, b: Any, g: Any) -> Form:
    """A force acts like the input: over two samples, as the present one and the change."""
    h = signal("h")
    qs = [signal(f"q{i}") for i in (1, 2, 3)] + [h]
    ds = [signal(f"d{i}") for i in (1, 2, 3, 4)]
    steps = [State(d[k], s, 0) for d, s in zip(ds, quarter_steps(x), strict=True)]
    states = []
    before = h[k - 1]
    for q, d in zip(qs, ds, strict=True):
        step_ = d[k]
        half = before + (step_ - b * (sp.Abs(step_) * before + g * step_ * sp.Abs(before))) / 2
        states.append(State(q[k], before + step_ - b * (sp.Abs(step_) * half + g * step_ * sp.Abs(half)), 0))
        before = q[k]
    return Form((h[k], h[k] - h[k - 1]), (*steps, *states))


@hysteresis.another(
    "play superposition", {"output": "u", "input": "u"}, scan={"r": Scan("amplitude", (0.5, 1.0), beyond=1.0)},
    source="Prandtl 1928, Ishlinskii 1944",
)  # fmt: skip
def play_superposition(x: Any, r: Any) -> Form:
    """Plays with equal distances between their slacks."""
    ps = [signal(f"p{i}") for i in range(1, PLAYS + 1)]
    states = tuple(play(x, p, r * sp.Rational(i, PLAYS + 1)) for i, p in enumerate(ps, 1))
    return Form(tuple(p[k] - x[k] for p in ps), states)


@hysteresis.another(
    "Bouc-Wen actuator", {"inside": "uy"}, scan={"d": GAIN},
    source="Rakotondrabe 2011; Martins & Aguirre 2016, Eq. System",
)  # fmt: skip
def actuator_hysteresis(u: Any, y: Any, d: Any) -> list[Any]:
    """The hysteresis is what the output lacks of d u."""
    h = d * u[k - 1] - y[k - 1]
    phi1 = step(u)
    return [phi1, sp.Abs(phi1) * h, phi1 * sp.Abs(h)]
