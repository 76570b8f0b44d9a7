"""Friction and drag: forces that depend on the velocity of the moving part."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.signals import k
from ._effect import SLOW_SPEED, SPEED, Scan, clip, effect, step

MOVING = {"inside": "y", "output": "u"}


@effect(MOVING, source="Coulomb 1785")
def coulomb_friction(x: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.sign(step(x))


@effect(
    MOVING,
    scan={"s": SLOW_SPEED},
    unit={"s": "unit of the driver per sample"},
    id="coulomb_friction",
    form="smooth",
    source="Coulomb 1785, smoothed by tanh",
)
def smooth_coulomb_friction(x: Any, s: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.tanh(step(x) / s)


@effect(
    {"output": "u"},
    scan={"n": Scan("steps", (4, 10)), "s": Scan("speed", (0.5, 2.0), beyond=1.0)},
    id="coulomb_friction",
    form="averaged velocity",
    unit={"s": "unit of the driver"},
    source="Coulomb 1785, velocity over n samples",
)
def averaged_coulomb_friction(x: Any, n: Any, s: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    return sp.tanh((x[k] - x[k - n]) / s)


@effect(
    {"motion": "y"},
    scan={"r": Scan("speed", (0.1, 0.3, 0.6, 1.0), beyond=2.0)},
    sign=1,
    full=True,
    unit={"r": "unit of the driver per sample"},
    id="coulomb_friction",
    form="holding",
    source="Coulomb 1785; implicit Euler step (Moreau 1988), soft(d, r) = d - clip(d, r)",
)
def holding_friction(x: Any, r: Any) -> Any:
    """Dry friction: a constant force against the motion, whatever the speed."""
    # y[k] = y[k-1] + soft(d, r) of the step d that the core would make: it rests until more than r pushes.
    return -clip(x[k], r)


@effect(MOVING, scan={"s": SPEED}, unit={"s": "unit of the driver per sample"}, source="Stribeck 1902, Tustin 1947")
def stribeck_friction(x: Any, s: Any) -> Any:
    """Stiction: friction that is largest at rest and falls as the motion gets faster."""
    return sp.exp(-((step(x) / s) ** 2)) * sp.sign(step(x))


@effect(MOVING, source="Rayleigh 1876")
def quadratic_drag(x: Any) -> Any:
    """Drag that grows with the square of the speed, as in a fluid."""
    return step(x) * sp.Abs(step(x))
