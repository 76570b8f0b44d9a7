"""Dynamics that a base may lack: lags, delays, creep, limits of speed."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.functions import within
from ...symbolic.recursion import State
from ...symbolic.signals import k, signal
from ._effect import STEPS, TIME, WHOLE, Form, Scan, effect

REACHED = Scan("speed", (0.05, 0.2, 0.5, 1.0))  # one that is never reached is not seen; jumps are much faster
SERVO = "Gelb & Vander Velde 1968 (velocity-limited servo)"


def lag_of(x: Any, w: Any, tau: Any, Ts: Any) -> State:
    """A first-order lag of a sequence with time constant tau [s], exact for an input held between samples."""
    a = sp.exp(-Ts / tau)
    return State(w[k], a * w[k - 1] + (1 - a) * x[k], x[k])


@effect(
    {"inside": "y"}, scan={"n": Scan("steps", (0, 1, 2))}, source="Ljung 1999",
    means={"thermal": "one more thermal mass"},
)  # fmt: skip
def inertia(x: Any, n: Any) -> Any:
    """A mass or a further time constant: the output overshoots or lags more than the model."""
    return x[k - n]


@effect("input", scan={"d": STEPS}, share=WHOLE, source="Ljung 1999")
def input_delay(x: Any, d: Any) -> Any:
    """A dead time: the input acts later than in the model."""
    return x[k - d] - x[k]


@effect(
    "input", scan={"tau": TIME}, share=WHOLE, source="Ljung 1999",
    means={"thermal": "one more thermal mass", "battery": "an RC pair"},
)  # fmt: skip
def rate_dependence(x: Any, tau: Any, Ts: Any) -> Form:
    """A lag before the actuator (amplifier, eddy currents): fast inputs arrive late and small."""
    w = signal("w")
    return Form((w[k] - x[k],), (lag_of(x, w, tau, Ts),))


def no_faster(x: Any, down: Any, up: Any) -> Form:
    """Follow a sequence, no faster: the twin of the play, which follows it no nearer."""
    w = signal("w")
    return Form((w[k] - x[k],), (State(w[k], within(x[k], w[k - 1] - down, w[k - 1] + up), x[k]),))


@effect("input", scan={"r": REACHED}, share=WHOLE, source=SERVO, never="motion-force structure")
def rate_limit(x: Any, r: Any) -> Form:
    """A speed limit: the actuator cannot follow fast inputs, like a motor at full speed."""
    return no_faster(x, r, r)


@rate_limit.another("two speeds", "input", scan={"r": REACHED, "e": REACHED}, source=SERVO)
def two_rate_limits(x: Any, r: Any, e: Any) -> Form:
    """It rises by r a sample at most, and falls by e."""
    return no_faster(x, e, r)


@effect(
    {"motion": "y"}, source="Beater 2007 (a pneumatic drive fills and empties at different speeds)", never="structure",
    means={"thermal": "a difference in speed between heating and cooling"},
)  # fmt: skip
def uneven_speed(x: Any) -> Any:
    """Different speeds in the two directions: it opens faster than it closes, or the other way round."""
    return sp.Min(x[k], 0)


@effect(
    {"output": "y"}, scan={"tau": Scan("time", (0.35, 0.5, 0.65, 0.8), beyond=1.0)}, share=WHOLE,
    source="Kuhnen 2005 (creep operators)", means={"battery": "an RC pair"},
)  # fmt: skip
def creep(x: Any, tau: Any, Ts: Any) -> Form:
    """Creep: after a step the output goes on moving slowly."""
    ws = [signal(f"w{i}") for i in (1, 2, 3)]
    states = tuple(lag_of(x, w, tau * 3**i, Ts) for i, w in enumerate(ws))
    return Form((sum(w[k] for w in ws) / 3,), states)


@effect(
    {"output": "u"}, source="Plett 2004 (open-circuit voltage over the charge)", only="battery",
    means={"battery": "a nonlinear open-circuit voltage"},
)  # fmt: skip
def charge_curve(x: Any, Ts: Any) -> Form:
    """A nonlinear charge curve: the open-circuit voltage depends nonlinearly on the integral of the current."""
    q = signal("q")
    return Form((q[k], q[k] ** 2, q[k] ** 3), (State(q[k], q[k - 1] + Ts * x[k], 0),))
