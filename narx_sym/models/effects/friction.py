"""Friction and drag: forces that depend on the velocity of the moving part.

Of a signal that is a position the velocity is its step; the forms "of a speed" are for a signal that is one.
"""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.functions import within
from ...symbolic.recursion import State
from ...symbolic.signals import k, rub, signal
from ._effect import OF_A_SPEED, SLOW_SPEED, SPEED, WHOLE, Form, Scan, clip, effect, step
from .memory import backlash

MOVING = {"inside": "y", "output": "u"}
DRIVEN = {"inside": "y", "force": "y", "output": "u"}  # also at the mass that is driven, behind whose force are zeros
PRESLIDING = (0.01, 0.03, 0.1)  # over a long way it is Bouc-Wen hysteresis: the grid ends where it is a friction
BEHIND = {"force": "y", "output": "u"}
LEVEL = Scan("speed", (0.2, 0.6, 1.5))
HOLDING = Scan("speed", (0.1, 0.3, 1.0, 3.0), beyond=5.0)
AVERAGED = Scan("speed", (0.5, 2.0), beyond=1.0, unit="unit of the driver")
SLOW = Scan("amplitude", (0.01, 0.03, 0.1), beyond=1.0)  # well below the speed: tanh reaches its plateau
NOTHING_RUBS = "thermal tank circuit battery process"
SMOOTHED = "Coulomb 1785, smoothed by tanh"
DAHL = "Dahl 1968 (presliding), exact for a path that is straight between samples"
HELD = "Coulomb 1785; implicit Euler step (Moreau 1988)"
STICKS = "Stribeck 1902; implicit Euler step (Moreau 1988)"


@effect(
    MOVING, source="Coulomb 1785", never=NOTHING_RUBS,
    means={
        "drive": "friction", "motion-force": "friction", "pendulum": "friction", "valve": "stiction",
        "propeller": "a threshold", "smart-material": "hysteresis", "soft": "hysteresis", "structure": "hysteresis",
    },
)  # fmt: skip
def coulomb_friction(x: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.sign(step(x))


@coulomb_friction.another("smooth", DRIVEN, scan={"s": SLOW_SPEED}, source=SMOOTHED)
def smooth_coulomb_friction(x: Any, s: Any) -> Any:
    """It is reached at steps well above s."""
    return sp.tanh(step(x) / s)


@coulomb_friction.another(OF_A_SPEED, DRIVEN, source="Coulomb 1785")
def coulomb_friction_of_speed(x: Any) -> Any:
    """The side on which the speed is."""
    return sp.sign(x[k])


@coulomb_friction.another(f"smooth, {OF_A_SPEED}", BEHIND, scan={"s": SLOW}, source=SMOOTHED)
def smooth_coulomb_friction_of_speed(x: Any, s: Any) -> Any:
    """It is reached at speeds well above s."""
    return sp.tanh(x[k] / s)


@coulomb_friction.another(
    "averaged velocity", {"output": "u"}, scan={"n": Scan("steps", (4, 10), unit="samples"), "s": AVERAGED},
    source="Coulomb 1785, velocity over n samples",
)  # fmt: skip
def averaged_coulomb_friction(x: Any, n: Any, s: Any) -> Any:
    """The velocity is that over n samples."""
    return sp.tanh((x[k] - x[k - n]) / s)


@coulomb_friction.another(
    "viscoelastic", {"output": "u"}, scan={"r": LEVEL, "e": LEVEL, "tau": Scan("time", (0.0, 0.15), beyond=1.0)},
    source="Jenkins 1962, the spring as Maxwell's 1867; two levels, as in bump and rebound (Dixon 2007)",
)  # fmt: skip
def viscoelastic_friction(x: Any, r: Any, e: Any, tau: Any, Ts: Any) -> Form:
    """As elastic friction, but oil or rubber lets the spring relax."""
    w, a = signal("w"), sp.exp(-Ts / tau)
    return Form((w[k],), (State(w[k], within(a * w[k - 1] + (1 - a) * step(x), -e, r), 0),))


def dahl(d: Any, r: Any, before: Any = 0) -> Form:
    """Return the share p of the force that dry friction has reached, from `before`: it turns round over the way r."""
    p, side = signal("p"), sp.sign(d)
    return Form((p[k],), (State(p[k], side + (p[k - 1] - side) * sp.exp(-sp.Abs(d) / r), before),))


@coulomb_friction.another("Dahl", MOVING, scan={"r": Scan("amplitude", PRESLIDING, beyond=1.0)}, source=DAHL)
def dahl_friction(x: Any, r: Any) -> Form:
    """It turns round over a way r."""
    return dahl(step(x), r)


@coulomb_friction.another(
    "elastic", {"output": "u"}, scan={"r": Scan("amplitude", (0.03, 0.1), beyond=2.0)},
    source="Jenkins 1962; Iwan 1966 (a spring in series with a part that slips)",
)  # fmt: skip
def elastic_friction(x: Any, r: Any) -> Form:
    """A way of r takes it from none of its force to all."""
    return Form((rub[k],), (State(rub[k], clip(rub[k - 1] + step(x) / r, 1)),))


@backlash.another(
    "of what rubs", {"friction": "friction"}, scan={"w": Scan("ratio", (0.2, 0.5, 0.8))},
    source="Coble et al. 2024 (a band that is slack after each reversal)",
)  # fmt: skip
def slack_of_friction(x: Any, w: Any) -> Any:
    """Near none of the share x of the friction that is reached, nothing is passed on."""
    return -clip(x[k], w)


@coulomb_friction.another(
    f"Dahl, {OF_A_SPEED}", MOVING, scan={"r": Scan("stroke", PRESLIDING, beyond=1.0)}, source=DAHL
)
def dahl_friction_of_speed(x: Any, r: Any, Ts: Any) -> Form:
    """It turns round over a way r; before the start it has been moving."""
    return dahl(x[k] * Ts, r, sp.sign(x[k]))


@coulomb_friction.another(
    "holding", {"motion": "y"}, scan={"r": HOLDING}, share=WHOLE, source=f"{HELD}, soft(d, r) = d - clip(d, r)"
)
def holding_friction(x: Any, r: Any) -> Any:
    """y[k] = y[k-1] + soft(d, r) of the step d that the core would make: it rests until more than r pushes."""
    return -clip(x[k], r)


@coulomb_friction.another(
    f"holding, {OF_A_SPEED}", {"motion": "y"}, scan={"r": Scan("amplitude", (0.03, 0.1, 0.3), beyond=2.0)},
    share=WHOLE, source=f"{HELD}, soft(w, r) = w - clip(w, r)",
)  # fmt: skip
def holding_friction_of_speed(x: Any, y: Any, r: Any) -> Any:
    """y[k] = soft(w, r) of the speed w that the core would reach: it stands until more than r pushes."""
    return -clip(y[k - 1] + x[k], r)


def soft(d: Any, f: Any) -> Any:
    """Return what is left of a push d that a friction f >= 0 holds."""
    return sp.Max(d - f, 0) + sp.Min(d + f, 0)


def held(d: Any, before: Any, r: Any, e: Any) -> tuple[Any, State]:
    """Return what is left of a push d, and the state f that holds it.

    On the move f is r, at rest r + e; the last step tells which. It falls over e / 2, so that the part breaks loose by
    a jump: faster than what pushes it.
    """
    f = signal("f")
    holds = State(f[k], r + e * sp.exp(-((2 * before / e) ** 2)))
    return soft(d, f[k]), holds


@effect(
    {"motion": "y"}, scan={"r": HOLDING, "e": Scan("speed", (0.1, 0.4), beyond=2.0)}, share=WHOLE, source=STICKS,
    never="thermal smart-material circuit battery process",
    means={"drive": "friction", "pendulum": "friction", "valve": "stiction", "soft": "hysteresis"},
)  # fmt: skip
def stiction(x: Any, y: Any, r: Any, e: Any) -> Form:
    """Stick-slip friction: the force to start moving is larger than the force to keep moving."""
    left, holds = held(x[k], y[k - 1] - y[k - 2], r, e)
    return Form((left - x[k],), (holds,))


@stiction.another(
    OF_A_SPEED, {"motion": "y"}, source=STICKS,
    scan={"r": Scan("amplitude", (0.01, 0.03, 0.1), beyond=2.0), "e": Scan("amplitude", (0.03, 0.1), beyond=3.0)},
)  # fmt: skip
def stiction_of_speed(x: Any, y: Any, r: Any, e: Any) -> Form:
    """What is held is the speed that the core would reach."""
    reached = y[k - 1] + x[k]
    left, holds = held(reached, y[k - 1], r, e)
    return Form((left - reached,), (holds,))


@stiction.another(
    "of a valve", {"input": "u", "output": "y"}, source="Choudhury, Thornhill & Shah 2005; He et al. 2007",
    scan={"r": Scan("amplitude", (0.05, 0.2, 0.4), beyond=2.0), "e": Scan("amplitude", (0.05, 0.2), beyond=2.0)},
    never="thermal smart-material circuit battery",  # of a flow process the valve may stick
)  # fmt: skip
def valve_stiction(x: Any, r: Any, e: Any) -> Form:
    """A play whose slack is wider while it rests."""
    p = signal("p")
    left, holds = held(x[k] - p[k - 1], p[k - 1] - p[k - 2], r, e)
    return Form((p[k] - x[k],), (holds, State(p[k], p[k - 1] + left, x[k])))


def _loaded(channel: Any, side: Any) -> list[Any]:
    """Return a friction on one side, c1 + c2 channel."""
    return [side, channel[k] * side]


@effect(
    {"inside": "y"}, source="Coulomb 1785: friction is proportional to the load", never=NOTHING_RUBS,
    means={"drive": "friction"},
)  # fmt: skip
def channel_friction(channel: Any, x: Any) -> list[Any]:
    """Dry friction that grows with another measured quantity, such as a load, a current or a position."""
    return _loaded(channel, sp.sign(step(x)))


@channel_friction.another("smooth", BEHIND, scan={"s": SLOW_SPEED}, source=SMOOTHED)
def smooth_channel_friction(channel: Any, x: Any, s: Any) -> list[Any]:
    """It is reached at steps well above s."""
    return _loaded(channel, sp.tanh(step(x) / s))


@channel_friction.another(OF_A_SPEED, DRIVEN, source="Coulomb 1785")
def channel_friction_of_speed(channel: Any, x: Any) -> list[Any]:
    """The side on which the speed is."""
    return _loaded(channel, sp.sign(x[k]))


@channel_friction.another(f"smooth, {OF_A_SPEED}", BEHIND, scan={"s": SLOW}, source=SMOOTHED)
def smooth_channel_friction_of_speed(channel: Any, x: Any, s: Any) -> list[Any]:
    """It is reached at speeds well above s."""
    return _loaded(channel, sp.tanh(x[k] / s))


def holding_load(form: str, of: str, r: tuple[float, ...], q: tuple[float, ...], beyond: float) -> Any:
    """Declare a friction that holds, r + q channel, with its start values."""
    scan = {n: Scan(of, v, beyond=beyond, signed=True, per_channel=n == "q") for n, v in {"r": r, "q": q}.items()}
    return channel_friction.another(form, {"motion": "y"}, scan=scan, share=WHOLE, source=HELD)


@holding_load("holding", "speed", (0.1, 0.5, 2.0), (-0.3, 0.3, 2.0), beyond=5.0)
def holding_channel_friction(channel: Any, x: Any, r: Any, q: Any) -> Form:
    """It holds the step that the core would make."""
    return _held_by(channel, x[k], r, q)


@holding_load(f"holding, {OF_A_SPEED}", "amplitude", (0.01, 0.1, 0.3), (-0.1, 0.1, 0.3), beyond=2.0)
def holding_channel_friction_of_speed(channel: Any, x: Any, y: Any, r: Any, q: Any) -> Form:
    """It holds the speed that the core would reach."""
    return _held_by(channel, y[k - 1] + x[k], r, q)


def _held_by(channel: Any, d: Any, r: Any, q: Any) -> Form:
    """Return what a friction f, as large as a channel lets it be, takes from a push."""
    f = signal("f")
    return Form((soft(d, f[k]) - d,), (State(f[k], sp.Max(0, r + q * channel[k])),))


@effect(
    DRIVEN, scan={"s": SPEED}, source="Stribeck 1902, Tustin 1947", never=f"{NOTHING_RUBS} smart-material",
    means={"drive": "friction", "pendulum": "friction"},
)  # fmt: skip
def stribeck_friction(x: Any, s: Any) -> Any:
    """Stiction: friction that is largest at rest and falls as the motion gets faster."""
    return sp.exp(-((step(x) / s) ** 2)) * sp.sign(step(x))


@effect(DRIVEN, source="Rayleigh 1876", never=f"{NOTHING_RUBS} smart-material soft", means={"propeller": "drag"})
def quadratic_drag(x: Any) -> Any:
    """Drag that grows with the square of the speed, as in a fluid."""
    return step(x) * sp.Abs(step(x))


@quadratic_drag.another(OF_A_SPEED, {"inside": "y", "force": "y"}, source="Rayleigh 1876")
def quadratic_drag_of_speed(x: Any) -> Any:
    """Of the speed itself."""
    return x[k] * sp.Abs(x[k])
