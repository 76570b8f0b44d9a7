"""Friction and drag: forces that depend on the velocity of the moving part."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.signals import k
from ._effect import SLOW_SPEED, SPEED, Scan, effect, step

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


@effect(MOVING, scan={"s": SPEED}, unit={"s": "unit of the driver per sample"}, source="Stribeck 1902, Tustin 1947")
def stribeck_friction(x: Any, s: Any) -> Any:
    """Stiction: friction that is largest at rest and falls as the motion gets faster."""
    return sp.exp(-((step(x) / s) ** 2)) * sp.sign(step(x))


@effect(MOVING, source="Rayleigh 1876")
def quadratic_drag(x: Any) -> Any:
    """Drag that grows with the square of the speed, as in a fluid."""
    return step(x) * sp.Abs(step(x))
