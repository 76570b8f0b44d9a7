"""Static curves: of the input, and of the restoring force inside."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.signals import k
from ._effect import AMPLITUDE, Scan, clip, effect

LIMIT = {"r": "unit of the driver"}


@effect("input", scan={"r": AMPLITUDE}, sign=1, full=True, unit=LIMIT, source="Tao & Kokotovic 1996", centred=True)
def dead_zone(x: Any, r: Any) -> Any:
    """Dead zone: small inputs do nothing."""
    return -clip(x[k], r)


@effect(
    "input",
    scan={"r": Scan("amplitude", (0.3, 0.6, 1.0, 1.5))},
    sign=1,
    full=True,
    unit=LIMIT,
    source="Tao & Kokotovic 1996",
    form="soft",
    centred=True,
)
def saturation(x: Any, r: Any) -> Any:
    """Saturation: large inputs do less and less."""
    return r * sp.tanh(x[k] / r) - x[k]


@effect(
    "input",
    scan={"r": AMPLITUDE},
    sign=1,
    full=True,
    unit=LIMIT,
    id="saturation",
    source="Tao & Kokotovic 1996",
    form="hard",
    centred=True,
)
def hard_saturation(x: Any, r: Any) -> Any:
    """Saturation: large inputs do less and less."""
    return clip(x[k], r) - x[k]


@effect("input", source="Billings 2013", centred=True)
def asymmetric_gain(x: Any) -> Any:
    """Another gain for positive inputs than for negative ones."""
    return sp.Abs(x[k])


@effect("input", source="Billings 2013")
def quadratic_gain(x: Any) -> Any:
    """A gain that grows with the input: the static curve is bent to one side."""
    return x[k] ** 2


@effect("input", source="Billings 2013", centred=True)
def cubic_gain(x: Any) -> Any:
    """A gain that depends on the size of the input, alike in both directions."""
    return x[k] ** 3


@effect("inside", driver="y", source="Duffing 1918")
def hardening_spring(x: Any) -> Any:
    """A spring that stiffens (or softens) with the deflection, alike in both directions."""
    return x[k] ** 3


@effect("inside", driver="y", source="Nayfeh & Mook 1979")
def quadratic_spring(x: Any) -> Any:
    """A spring that is stiffer in one direction than in the other."""
    return x[k] ** 2


@effect({"inside": "uy"}, source="Mohler 1973")
def bilinear_gain(u: Any, y: Any) -> Any:
    """A gain that depends on the present output."""
    return u[k] * y[k - 1]
