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

MOVING = {"inside": "y", "output": "u"}
DRIVEN = {"inside": "y", "force": "y", "output": "u"}  # also at the mass that is driven, behind whose force are zeros
LEVEL = Scan("speed", (0.2, 0.6, 1.5))
SLOW = Scan("amplitude", (0.01, 0.03, 0.1), beyond=1.0)  # well below the speed: tanh reaches its plateau
NOTHING_RUBS = "thermal tank circuit battery process"


@effect(
    MOVING,
    source="Coulomb 1785",
    never=NOTHING_RUBS,
    means={
        "drive": "friction", "motion-force": "friction", "pendulum": "friction", "valve": "stiction",
        "propeller": "a threshold", "smart-material": "hysteresis", "soft": "hysteresis", "structure": "hysteresis",
    },
)  # fmt: skip
def coulomb_friction(x: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.sign(step(x))


@effect(
    DRIVEN,
    scan={"s": SLOW_SPEED},
    id="coulomb_friction",
    form="smooth",
    source="Coulomb 1785, smoothed by tanh",
)
def smooth_coulomb_friction(x: Any, s: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.tanh(step(x) / s)


@effect(DRIVEN, id="coulomb_friction", form=OF_A_SPEED, source="Coulomb 1785")
def coulomb_friction_of_speed(x: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.sign(x[k])


@effect(
    {"force": "y", "output": "u"},
    scan={"s": SLOW},
    id="coulomb_friction",
    form=f"smooth, {OF_A_SPEED}",
    source="Coulomb 1785, smoothed by tanh",
)
def smooth_coulomb_friction_of_speed(x: Any, s: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.tanh(x[k] / s)


@effect(
    {"output": "u"},
    scan={
        "n": Scan("steps", (4, 10), unit="samples"),
        "s": Scan("speed", (0.5, 2.0), beyond=1.0, unit="unit of the driver"),
    },
    id="coulomb_friction",
    form="averaged velocity",
    source="Coulomb 1785, velocity over n samples",
)
def averaged_coulomb_friction(x: Any, n: Any, s: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.tanh((x[k] - x[k - n]) / s)


@effect(
    {"output": "u"},
    scan={"r": LEVEL, "e": LEVEL, "tau": Scan("time", (0.0, 0.15), beyond=1.0)},
    id="coulomb_friction",
    form="viscoelastic",
    source="Jenkins 1962, the spring as Maxwell's 1867; two levels, as in bump and rebound (Dixon 2007)",
)
def viscoelastic_friction(x: Any, r: Any, e: Any, tau: Any, Ts: Any) -> Form:
    """Dry friction: a constant force against the motion, whatever the speed."""
    w, a = signal("w"), sp.exp(-Ts / tau)  # as elastic friction, but oil or rubber lets the spring relax
    return Form((w[k],), (State(w[k], within(a * w[k - 1] + (1 - a) * step(x), -e, r), 0),))


def dahl(d: Any, r: Any, before: Any = 0) -> Form:
    """Return the share p of the force that dry friction has reached, from `before`: it turns round over the way r."""
    p, side = signal("p"), sp.sign(d)
    return Form((p[k],), (State(p[k], side + (p[k - 1] - side) * sp.exp(-sp.Abs(d) / r), before),))


@effect(
    MOVING,
    scan={"r": Scan("amplitude", (0.01, 0.03, 0.1), beyond=1.0)},
    id="coulomb_friction",
    form="Dahl",
    source="Dahl 1968 (presliding), exact for a path that is straight between samples",
)
def dahl_friction(x: Any, r: Any) -> Form:
    """Dry friction: a constant force against the motion, whatever the speed."""
    # Over a long way r this is Bouc-Wen hysteresis: the grid ends where friction is no longer the word for it.
    return dahl(step(x), r)


@effect(
    {"output": "u"},
    scan={"r": Scan("amplitude", (0.03, 0.1), beyond=2.0)},
    id="coulomb_friction",
    form="elastic",
    source="Jenkins 1962; Iwan 1966 (a spring in series with a part that slips)",
)
def elastic_friction(x: Any, r: Any) -> Form:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return Form((rub[k],), (State(rub[k], clip(rub[k - 1] + step(x) / r, 1)),))


@effect(
    {"friction": "friction"},
    scan={"w": Scan("ratio", (0.2, 0.5, 0.8))},
    share=WHOLE,
    id="backlash",
    form="of what rubs",
    source="Coble et al. 2024 (a band that is slack after each reversal)",
)
def slack_of_friction(x: Any, w: Any) -> Any:
    """Play of half-width r: after a reversal nothing moves until the slack is taken up."""
    return -clip(x[k], w)  # x is the share of the friction that is reached: near none of it nothing is passed on


@effect(
    MOVING,
    scan={"r": Scan("stroke", (0.01, 0.03, 0.1), beyond=1.0)},
    id="coulomb_friction",
    form=f"Dahl, {OF_A_SPEED}",
    source="Dahl 1968 (presliding), exact for a path that is straight between samples",
)
def dahl_friction_of_speed(x: Any, r: Any, Ts: Any) -> Form:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return dahl(x[k] * Ts, r, sp.sign(x[k]))  # it has been moving


@effect(
    {"motion": "y"},
    scan={"r": Scan("speed", (0.1, 0.3, 1.0, 3.0), beyond=5.0)},
    share=WHOLE,
    id="coulomb_friction",
    form="holding",
    source="Coulomb 1785; implicit Euler step (Moreau 1988), soft(d, r) = d - clip(d, r)",
)
def holding_friction(x: Any, r: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    # y[k] = y[k-1] + soft(d, r) of the step d that the core would make: it rests until more than r pushes.
    return -clip(x[k], r)


@effect(
    {"motion": "y"},
    scan={"r": Scan("amplitude", (0.03, 0.1, 0.3), beyond=2.0)},
    share=WHOLE,
    id="coulomb_friction",
    form=f"holding, {OF_A_SPEED}",
    source="Coulomb 1785; implicit Euler step (Moreau 1988), soft(w, r) = w - clip(w, r)",
)
def holding_friction_of_speed(x: Any, y: Any, r: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    # y[k] = soft(w, r) of the speed w that the core would reach: it stands until more than r pushes.
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
    {"motion": "y"},
    scan={"r": Scan("speed", (0.1, 0.3, 1.0, 3.0), beyond=5.0), "e": Scan("speed", (0.1, 0.4), beyond=2.0)},
    share=WHOLE,
    source="Stribeck 1902; implicit Euler step (Moreau 1988)",
    never="thermal smart-material circuit battery process",
    means={"drive": "friction", "pendulum": "friction", "valve": "stiction", "soft": "hysteresis"},
)
def stiction(x: Any, y: Any, r: Any, e: Any) -> Form:
    """Stick-slip friction: the force to start moving is larger than the force to keep moving."""
    left, holds = held(x[k], y[k - 1] - y[k - 2], r, e)
    return Form((left - x[k],), (holds,))


@effect(
    {"motion": "y"},
    scan={"r": Scan("amplitude", (0.01, 0.03, 0.1), beyond=2.0), "e": Scan("amplitude", (0.03, 0.1), beyond=3.0)},
    share=WHOLE,
    id="stiction",
    form=OF_A_SPEED,
    source="Stribeck 1902; implicit Euler step (Moreau 1988)",
)
def stiction_of_speed(x: Any, y: Any, r: Any, e: Any) -> Form:
    """Stick-slip friction: the force to start moving is larger than the force to keep moving."""
    reached = y[k - 1] + x[k]  # by the core, if nothing held it
    left, holds = held(reached, y[k - 1], r, e)
    return Form((left - reached,), (holds,))


@effect(
    {"input": "u", "output": "y"},
    scan={"r": Scan("amplitude", (0.05, 0.2, 0.4), beyond=2.0), "e": Scan("amplitude", (0.05, 0.2), beyond=2.0)},
    share=WHOLE,
    id="stiction",
    form="of a valve",
    source="Choudhury, Thornhill & Shah 2005; He et al. 2007",
    never="thermal smart-material circuit battery",  # of a flow process the valve may stick
)
def valve_stiction(x: Any, r: Any, e: Any) -> Form:
    """Stick-slip friction: the force to start moving is larger than the force to keep moving."""
    p = signal("p")  # a play whose slack is wider while it rests
    left, holds = held(x[k] - p[k - 1], p[k - 1] - p[k - 2], r, e)
    return Form((p[k] - x[k],), (holds, State(p[k], p[k - 1] + left, x[k])))


@effect(
    {"inside": "y"},
    source="Coulomb 1785: friction is proportional to the load",
    never=NOTHING_RUBS,
    means={"drive": "friction"},
)
def channel_friction(channel: Any, x: Any) -> list[Any]:
    """Dry friction that grows with another measured quantity, such as a load, a current or a position."""
    return _loaded(channel, sp.sign(step(x)))


@effect(
    {"force": "y", "output": "u"},
    scan={"s": SLOW_SPEED},
    id="channel_friction",
    form="smooth",
    source="Coulomb 1785, smoothed by tanh",
)
def smooth_channel_friction(channel: Any, x: Any, s: Any) -> list[Any]:
    """Dry friction that grows with another measured quantity, such as a load, a current or a position."""
    return _loaded(channel, sp.tanh(step(x) / s))


@effect(DRIVEN, id="channel_friction", form=OF_A_SPEED, source="Coulomb 1785")
def channel_friction_of_speed(channel: Any, x: Any) -> list[Any]:
    """Dry friction that grows with another measured quantity, such as a load, a current or a position."""
    return _loaded(channel, sp.sign(x[k]))


@effect(
    {"force": "y", "output": "u"},
    scan={"s": SLOW},
    id="channel_friction",
    form=f"smooth, {OF_A_SPEED}",
    source="Coulomb 1785, smoothed by tanh",
)
def smooth_channel_friction_of_speed(channel: Any, x: Any, s: Any) -> list[Any]:
    """Dry friction that grows with another measured quantity, such as a load, a current or a position."""
    return _loaded(channel, sp.tanh(x[k] / s))


def _loaded(channel: Any, side: Any) -> list[Any]:
    """Return a friction on one side, c1 + c2 channel."""
    return [side, channel[k] * side]


@effect(
    {"motion": "y"},
    scan={
        "r": Scan("speed", (0.1, 0.5, 2.0), beyond=5.0, signed=True),
        "q": Scan("speed", (-0.3, 0.3, 2.0), beyond=5.0, signed=True, per_channel=True),
    },
    share=WHOLE,
    id="channel_friction",
    form="holding",
    source="Coulomb 1785; implicit Euler step (Moreau 1988)",
)
def holding_channel_friction(channel: Any, x: Any, r: Any, q: Any) -> Form:
    """Dry friction that grows with another measured quantity, such as a load, a current or a position."""
    return _held_by(channel, x[k], r, q)


@effect(
    {"motion": "y"},
    scan={
        "r": Scan("amplitude", (0.01, 0.1, 0.3), beyond=2.0, signed=True),
        "q": Scan("amplitude", (-0.1, 0.1, 0.3), beyond=2.0, signed=True, per_channel=True),
    },
    share=WHOLE,
    id="channel_friction",
    form=f"holding, {OF_A_SPEED}",
    source="Coulomb 1785; implicit Euler step (Moreau 1988)",
)
def holding_channel_friction_of_speed(channel: Any, x: Any, y: Any, r: Any, q: Any) -> Form:
    """Dry friction that grows with another measured quantity, such as a load, a current or a position."""
    return _held_by(channel, y[k - 1] + x[k], r, q)


def _held_by(channel: Any, d: Any, r: Any, q: Any) -> Form:
    """Return what a friction f, as large as a channel lets it be, takes from a push."""
    f = signal("f")
    return Form((soft(d, f[k]) - d,), (State(f[k], sp.Max(0, r + q * channel[k])),))


@effect(
    DRIVEN,
    scan={"s": SPEED},
    source="Stribeck 1902, Tustin 1947",
    never=f"{NOTHING_RUBS} smart-material",
    means={"drive": "friction", "pendulum": "friction"},
)
def stribeck_friction(x: Any, s: Any) -> Any:
    """Stiction: friction that is largest at rest and falls as the motion gets faster."""
    return sp.exp(-((step(x) / s) ** 2)) * sp.sign(step(x))


@effect(
    DRIVEN,
    source="Rayleigh 1876",
    never=f"{NOTHING_RUBS} smart-material soft",
    means={"propeller": "drag"},
)
def quadratic_drag(x: Any) -> Any:
    """Drag that grows with the square of the speed, as in a fluid."""
    return step(x) * sp.Abs(step(x))


@effect(("inside", "force"), driver="y", id="quadratic_drag", form=OF_A_SPEED, source="Rayleigh 1876")
def quadratic_drag_of_speed(x: Any) -> Any:
    """Drag that grows with the square of the speed, as in a fluid."""
    return x[k] * sp.Abs(x[k])
