"""The residual against one variable, and where in it the model fails most, in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...symbolic.numbers import few, sized

Array = np.ndarray
DIRECTIONS = ("falling", "resting", "rising")
SINCE = ("distance_since_reversal", "time_since_reversal")  # negative while falling: their effects change sign


@dataclass(frozen=True, eq=False)
class Panel:
    """The residual against one variable.

    Attributes
    ----------
    name : str
        "u", "y", "direction", "rate", "amplitude_frequency", "distance_since_reversal", "time_since_reversal",
        "time", "spectrum" or "channel:<name>"; "y" is the simulated output, free of the noise in the error.
    label, unit_of : str
        Name of the axis, and which unit it has: "u", "u/s", "y", "s", "Hz", "" or a channel; "u, Hz" for two axes.
    low, high : (cells,) arrays, or (cells, 2) for "amplitude_frequency" [unit of the variable]
        Bounds of the cells. Distance and time since a reversal are negative while u falls.
    mean, error : (cells,) arrays [unit of y]
        Mean residual and its standard error, which holds for coloured residuals too; NaN where too few samples.
        For "spectrum": rms of a frequency bin, in what the other panels leave.
    count : (cells,) array of int
    share : float
        Share of the residual's variance that the cell means explain, without what chance explains; 0 to 1.
        For "spectrum": share of the strongest line, in what the other panels leave.
    cell : (N,) array of int
        Cell of each sample, -1 where there is none; empty for "spectrum".
    line : int or None
        Cell of the strongest line, for "spectrum".
    """

    name: str
    label: str
    unit_of: str
    low: Array
    high: Array
    mean: Array
    error: Array
    count: Array
    share: float
    cell: Array
    line: int | None = None

    @property
    def centres(self) -> Array:
        """Middles of the cells, in the shape of `low`."""
        return (self.low + self.high) / 2

    @property
    def worst(self) -> int | None:
        """The line, or the cell with the largest mean residual less its standard error; None where all are grey."""
        if self.line is not None:
            return self.line
        sure = np.abs(self.mean) - self.error
        return int(np.nanargmax(sure)) if np.isfinite(sure).any() else None

    def where(self, units: Mapping[str, str] | None = None) -> str:
        """Say in words where the worst cell is."""
        if self.worst is None:
            return "too few samples"
        units = units or {}
        low, high = np.atleast_1d(self.low[self.worst]), np.atleast_1d(self.high[self.worst])
        if self.name == "direction":
            place = DIRECTIONS[int(low[0] + 1.5)]
        elif self.name == "spectrum":
            place = f"around {low.mean() / 2 + high.mean() / 2:.3g} Hz"
        elif self.name in SINCE:
            near, far = sorted(np.abs([low[0], high[0]]))
            word = "rising" if high[0] > 0 else "falling"
            place = f"{_span(near, far, self.unit(units), '{} to {}')} after a reversal, {word}"
        elif self.low.ndim == 2:
            names, kinds = self.label.split(", "), self.unit_of.split(", ")
            axes = zip(names, low, high, kinds, strict=True)
            place = " and ".join(f"{n} in {_span(a, b, _unit(k, units))}" for n, a, b, k in axes)
        else:
            place = f"{self.name.removeprefix('channel:')} in {_span(low[0], high[0], self.unit(units))}"
        what = (
            "rms error " if self.name == "spectrum" else "mean error +" if self.mean[self.worst] > 0 else "mean error -"
        )
        return f"{place}: {what}{sized(abs(self.mean[self.worst]), units.get('y', ''), 2)}"

    def unit(self, units: Mapping[str, str]) -> str:
        """Return the unit of the axis, where it is known."""
        return _unit(self.unit_of, units)


def _span(low: float, high: float, unit: str, form: str = "[{}, {}]") -> str:
    """Two bounds with just the digits that tell them apart."""
    size = max(abs(low), abs(high), 1e-300)
    digits = int(np.clip(np.ceil(np.log10(size / max(high - low, 1e-12 * size))) + 2, 2, 12))
    values = [0.0 if abs(x) < 1e-3 * (high - low) else x for x in (low, high)]
    return f"{form.format(*(few(x, digits) for x in values))} {unit}".rstrip()


def _unit(kind: str, units: Mapping[str, str]) -> str:
    if kind in ("u/s", "y/s"):
        return f"{units[kind[0]]}/s" if units.get(kind[0]) else ""
    return kind if kind in ("s", "Hz") else units.get(kind, "")
