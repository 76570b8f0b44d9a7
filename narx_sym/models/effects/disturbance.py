"""What acts beside the input: offsets, drift, hum, other measured channels, ageing."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ...symbolic.signals import k
from ._effect import PEAKS, effect


@effect(("output", "inside"), driver="t", source="Ljung 1999")
def offset(t: Any) -> Any:
    """A constant that the model lacks."""
    return sp.S.One


@effect("output", driver="t", source="Ljung 1999")
def drift(t: Any) -> Any:
    """Drift: the output wanders off steadily with time."""
    return t[k]


@drift.another("bent", {"output": "t"}, source="Ljung 1999")
def bent_drift(t: Any) -> list[Any]:
    """Not in proportion to the time."""
    return [t[k], t[k] ** 2]


@effect("output", driver="t", scan={"f": PEAKS}, source="Hannan 1973")
def periodic_disturbance(t: Any, f: Any) -> list[Any]:
    """A periodic disturbance of one frequency, such as mains hum or an unbalance."""
    phase = 2 * sp.pi * f * t[k]
    return [sp.cos(phase), sp.sin(phase)]


@effect(("output", "inside"), driver="channel", source="Ljung 1999")
def channel(channel: Any) -> Any:
    """Another measured quantity acts on the output."""
    return channel[k]


@effect("input", driver="channel", centred=True, source="Billings 2013")
def channel_gain(channel: Any, x: Any) -> Any:
    """The gain depends on another measured quantity."""
    return channel[k] * x[k]


@effect("input", driver="t", centred=True, source="Ljung 1999")
def ageing(t: Any, x: Any) -> Any:
    """The gain changes steadily with time."""
    return t[k] * x[k]
