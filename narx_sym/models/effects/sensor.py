"""What a sensor makes of the output: y[k] = g(sensed[k]) of what it sees."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.functions import within
from ...symbolic.signals import k
from ._effect import WHOLE, Scan, effect

# What is measured ends where the limit is: beyond the range there is nothing to be seen.
EDGE = Scan("amplitude", (0.3, 0.5, 0.7, 0.85, 1.0), beyond=1.2)
LIMIT = "Tao & Kokotovic 1996"


# A half of it shows one direction only, which is a limit at zero; less shows both, with different gains.
@effect(
    {"sensor": "y"}, share=(0.75, 1.0), centred=True, source="Ljung 1999",
    never="thermal tank motion-force soft valve structure process",
)  # fmt: skip
def absolute_sensor(x: Any) -> Any:
    """The sensor loses the sign: it shows the size of what it measures."""
    return sp.Abs(x[k]) - x[k]


@effect({"sensor": "y"}, scan={"r": EDGE}, share=WHOLE, form="upper", source=LIMIT, means={"circuit": "clipping"})
def output_limit(x: Any, r: Any) -> Any:
    """The measured output ends at a limit: that of the sensor, or where a contact is lost."""
    return sp.Min(x[k], r) - x[k]


@output_limit.another("lower", {"sensor": "y"}, scan={"r": EDGE}, source=LIMIT)
def lower_limit(x: Any, r: Any) -> Any:
    """y[k] = Max(sensed[k], -r)."""
    return sp.Max(x[k], -r) - x[k]


@output_limit.another("both sides", {"sensor": "y"}, scan={"r": EDGE, "e": EDGE}, source=LIMIT)
def both_limits(x: Any, r: Any, e: Any) -> Any:
    """y[k] = sensed[k] between -e and r."""
    return within(x[k], -e, r) - x[k]  # the middle of what a sensor shows is not where the machine works
