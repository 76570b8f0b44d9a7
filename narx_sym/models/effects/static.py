"""Static curves: of the input, and of the restoring force inside."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.functions import within
from ...symbolic.signals import k
from ._effect import AMPLITUDE, POSITIVE, WHOLE, Scan, clip, effect

LOSSES = {  # what a force or a flow that is bent over the output is, where the output is no deflection
    "thermal": "a loss that grows faster than linearly", "tank": "an outflow that is not in proportion to the level",
    "propeller": "drag", "process": "a rate that is not in proportion to the state",
}  # fmt: skip
INPUT, STOP = "Tao & Kokotovic 1996", "Shaw & Holmes 1983"
CURVED_POWER = "heating that is not in proportion to the input"
ENDS = Scan("amplitude", (0.15, 0.3, 0.5, 0.7, 0.9))
REACHED = Scan("amplitude", (0.15, 0.3, 0.5, 0.7, 0.9), beyond=1.1)  # a stop beyond what was reached is not seen


@effect(
    "input", scan={"r": AMPLITUDE}, share=WHOLE, source=INPUT, centred=True,
    means={"tank": "a pump threshold", "propeller": "a threshold"},
)  # fmt: skip
def dead_zone(x: Any, r: Any) -> Any:
    """Dead zone: small inputs have no effect."""
    return -clip(x[k], r)


@dead_zone.another(
    "two slopes", "input", source=INPUT, centred=True,
    scan={"r": Scan("amplitude", (0.08, 0.2, 0.45, 0.7)), "g": Scan("amplitude", (0.5, 2.0), power=0, beyond=2.0)},
)  # fmt: skip
def two_slopes(x: Any, r: Any, g: Any) -> Any:
    """The gain is 1 beyond r and g below -r; between them 1 - c."""
    return sp.Max(x[k] - r, 0) + g * sp.Min(x[k] + r, 0) - x[k]


@effect(
    "input", scan={"r": Scan("amplitude", (0.3, 0.6, 1.0, 1.5))}, share=WHOLE, source=INPUT, form="soft", centred=True,
    means={"smart-material": "saturation", "circuit": "clipping", "valve": "an end of the stroke"},
)  # fmt: skip
def saturation(x: Any, r: Any) -> Any:
    """Saturation: the effect of large inputs grows less and less."""
    return r * sp.tanh(x[k] / r) - x[k]


@saturation.another("hard", "input", scan={"r": AMPLITUDE}, source=INPUT, centred=True)
def hard_saturation(x: Any, r: Any) -> Any:
    """The input, limited to r."""
    return clip(x[k], r) - x[k]


@saturation.another("hard, two limits", "input", scan={"r": ENDS, "e": ENDS}, source=INPUT, centred=True)
def unequal_saturation(x: Any, r: Any, e: Any) -> Any:
    """The input between -e and r."""
    return within(x[k], -e, r) - x[k]


@effect("input", source="Billings 2013", centred=True)
def asymmetric_gain(x: Any) -> Any:
    """Two gains: one above a level of the input (zero or the operating point), another below it."""
    return sp.Abs(x[k])


@effect("input", source="Billings 2013", means={"thermal": CURVED_POWER})
def quadratic_gain(x: Any) -> Any:
    """A gain that grows or falls with the input: the static curve is bent to one side."""
    return x[k] ** 2


@effect(
    "input", source="Billings 2013", centred=True,
    means={"thermal": CURVED_POWER, "smart-material": "saturation", "circuit": "clipping"},
)  # fmt: skip
def cubic_gain(x: Any) -> Any:
    """A gain that depends on the size of the input, in the same way in both directions."""
    return x[k] ** 3


@effect(("inside", "force"), driver="y", source="Duffing 1918", means=LOSSES | {"pendulum": "gravity"})
def hardening_spring(x: Any) -> Any:
    """A spring that stiffens (or softens) with the deflection, in the same way in both directions."""
    return x[k] ** 3


@effect("inside", driver="y", source="Nayfeh & Mook 1979", means=LOSSES)
def quadratic_spring(x: Any) -> Any:
    """A spring that is stiffer in one direction than in the other."""
    return x[k] ** 2


@effect(
    {"inside": "y"}, scan={"r": REACHED}, share=POSITIVE, form="upper", source=STOP,
    never="smart-material propeller battery", means={"tank": "overflow", "valve": "an end of the stroke"},
)  # fmt: skip
def end_stop(x: Any, r: Any) -> Any:
    """An end stop, or a spring on one side: beyond a position a force pushes back (in a tank: the overflow)."""
    return -sp.Max(x[k] - r, 0)


@end_stop.another("lower", {"inside": "y"}, scan={"r": REACHED}, source=STOP)
def lower_stop(x: Any, r: Any) -> Any:
    """A force c Max(-r - y[k-1], 0) pushes back."""
    return sp.Max(-x[k] - r, 0)


@end_stop.another("both sides", {"inside": "y"}, scan={"r": REACHED}, source=STOP)
def both_stops(x: Any, r: Any) -> Any:
    """A gap of half-width r between two springs."""
    return clip(x[k], r) - x[k]


@end_stop.another("rigid upper", {"motion": "y"}, scan={"r": REACHED}, share=WHOLE, source=STOP)
def rigid_upper_stop(x: Any, y: Any, r: Any) -> Any:
    """y[k] = Min(free[k], r): x is the step from y[k-1] to free[k]."""
    return -sp.Max(y[k - 1] + x[k] - r, 0)


@end_stop.another("rigid lower", {"motion": "y"}, scan={"r": REACHED}, share=WHOLE, source=STOP)
def rigid_lower_stop(x: Any, y: Any, r: Any) -> Any:
    """y[k] = Max(free[k], -r)."""
    return sp.Max(-r - y[k - 1] - x[k], 0)


@end_stop.another("rigid both sides", {"motion": "y"}, scan={"r": REACHED, "e": REACHED}, share=WHOLE, source=STOP)
def rigid_stops(x: Any, y: Any, r: Any, e: Any) -> Any:
    """y[k] = free[k] between -e and r."""
    free = y[k - 1] + x[k]
    return within(free, -e, r) - free


@effect(
    {"inside": "y"}, scan={"a": Scan("depth", (1.05, 1.4, 2.2, 4.0), beyond=1.5)}, share=POSITIVE, means=LOSSES,
    source="Torricelli 1643; laminar below a hundredth of a",
    never="thermal drive motion-force smart-material soft propeller structure circuit battery pendulum",
)  # fmt: skip
def sqrt_outflow(x: Any, a: Any) -> Any:
    """An outflow proportional to the square root of the level, as from a tank: a low level falls more slowly."""
    level = sp.Max(x[k] + a, 0)  # above the outlet, which lies a below the operating point: there it is balanced
    return sp.sqrt(a / sp.Float(1.01)) - level / sp.sqrt(level + a / 100)


@effect({"inside": "uy"}, source="Mohler 1973")
def bilinear_gain(u: Any, y: Any) -> Any:
    """A gain that depends on the present output."""
    return u[k] * y[k - 1]


@effect("inside", driver="y", source="Huygens 1673 (the angle in rad)", centred=True, only="pendulum")
def gravity(x: Any) -> Any:
    """Gravity of a pendulum: the torque is proportional to the sine of the angle."""
    return sp.sin(x[k])


@gravity.another(
    "in degrees", {"inside": "y"}, source="Huygens 1673 (the angle in degrees)", centred=True, only="pendulum"
)
def gravity_in_degrees(x: Any) -> Any:
    """Of an angle in degrees."""
    return sp.sin(sp.pi / 180 * x[k])


@effect(
    {"inside": "uy"}, scan={"r": Scan("amplitude", (0.02, 0.1, 0.4))}, only="tank valve process",
    source="Torricelli 1643; laminar below r (Ellman & Piche 1999)",
)  # fmt: skip
def orifice(u: Any, y: Any, r: Any) -> Any:
    """A flow proportional to the square root of the pressure difference between input and output, as in an orifice."""
    p = u[k] - y[k - 1]
    return p / sp.sqrt(sp.Abs(p) + r)
