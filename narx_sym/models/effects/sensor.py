"""What a sensor makes of the output: y[k] = g(sensed[k]) of what it sees."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.functions import within
from ...symbolic.signals import k
from ._effect import Scan, effect

# What is measured ends where the limit is: beyond the range there is nothing to be seen.
EDGE = Scan("amplitude", (0.3, 0.5, 0.7, 0.85, 1.0), beyond=1.2)
LIMIT = {"r": "unit of the driver"}


# A half of it shows one direction only, which is a limit at zero; less shows both, with different gains.
@effect({"sensor": "y"}, sign=1, full=True, least=0.75, centred=True, source="Ljung 1999")
def absolute_sensor(x: Any) -> Any:
    """The sensor loses the sign: it shows the size of what it measures."""
    return sp.Abs(x[k]) - x[k]


@effect(
    {"sensor": "y"},
    scan={"r": EDGE},
    sign=1,
    full=True,
    unit=LIMIT,
    form="upper",
    source="Tao & Kokotovic 1996",
    at_rest=True,
)
def output_limit(x: Any, r: Any) -> Any:
    """The sensor has a limit: what goes beyond it is shown as the limit."""
    return sp.Min(x[k], r) - x[k]


@effect(
    {"sensor": "y"},
    scan={"r": EDGE},
    sign=1,
    full=True,
    unit=LIMIT,
    id="output_limit",
    form="lower",
    source="Tao & Kokotovic 1996",
    at_rest=True,
)
def lower_limit(x: Any, r: Any) -> Any:
    """The sensor has a limit: what goes beyond it is shown as the limit."""
    return sp.Max(x[k], -r) - x[k]


@effect(
    {"sensor": "y"},
    scan={"r": EDGE, "e": EDGE},
    sign=1,
    full=True,
    unit=LIMIT | {"e": LIMIT["r"]},
    id="output_limit",
    form="both sides",
    source="Tao & Kokotovic 1996",
    at_rest=True,
)
def both_limits(x: Any, r: Any, e: Any) -> Any:
    """The sensor has a limit: what goes beyond it is shown as the limit."""
    return within(x[k], -e, r) - x[k]  # the middle of what a sensor shows is not where the machine works
