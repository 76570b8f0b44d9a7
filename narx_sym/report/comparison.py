"""Measured and simulated output over time and as a loop, before and after something was added, on the same axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..data.metrics import half_cycle
from ..data.units import headed, said_first
from ..diagnosis.bases import words
from ..diagnosis.misfit import Misfit
from ..diagnosis.procedure import Diagnosis
from ..diagnosis.refit import Fitted
from ..errors import NarxError
from .figures.describe import TIME, Area, Line, Panel, span, thin, traces
from .figures.still import draw, new_axes
from .picture import POINTS
from .plots import where_it_fails
from .words import has_floor

Array = np.ndarray
Units = Mapping[str, str]
FINE = 1000  # samples of a loop, evenly spaced: extremes alone would leave corners


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measured and simulated output along the segment with the largest error, before and after what was added.

    Attributes
    ----------
    t, u, y : (N,) arrays [s, unit of u, unit of y]
    runs : mapping from "base" or the names of the rungs to the (N,) free runs [unit of y]
        The base first; the last model second, where something was added.
    nrmse : mapping from the same names to the free-run error on validation data
    floor : float
        rms of the noise [unit of y]; NaN where it is not known.
    name : str
    misfit : Misfit
        Where the base fails along the whole segment.
    aside : stretches of time that are not fitted
    """

    t: Array
    u: Array
    y: Array
    runs: dict[str, Array]
    nrmse: dict[str, float]
    floor: float
    name: str
    misfit: Misfit
    aside: tuple[Area, ...] = ()

    @classmethod
    def of(cls, diagnosis: Diagnosis) -> Comparison:
        """Take it from a diagnosis."""
        base = diagnosis.steps[0].base
        last = diagnosis.last
        i = base.worst
        record = base.split.records[i]
        runs, nrmse = {"base": record.y - base.errors[i]}, {"base": diagnosis.ladder[0]["validation"]}
        if last is not None:
            name = " ".join(diagnosis.rungs)
            runs[name], nrmse[name] = record.y - last.errors[i], diagnosis.ladder[-1]["validation"]
        found = kept_back(base, i)
        return cls(
            record.t, record.u, record.y, runs, nrmse, diagnosis.floor if has_floor(diagnosis) else float("nan"),
            record.name, diagnosis.misfit, found,
        )  # fmt: skip

    @cached_property
    def errors(self) -> dict[str, Array]:
        """Measured minus simulated, (N,) arrays [unit of y]."""
        return {name: self.y - run for name, run in self.runs.items()}

    @property
    def band(self) -> tuple[Area, ...]:
        """The noise floor, where it is known."""
        return (Area(-self.floor, self.floor, "noise floor (± rms)"),) if np.isfinite(self.floor) else ()

    def role(self, run: str) -> str:
        """Return the role of a run in pictures."""
        return "before" if run == next(iter(self.runs)) else "after"

    def at(self, samples: Array | slice) -> Comparison:
        """Return it at some samples."""
        t, runs = self.t[samples], {name: run[samples] for name, run in self.runs.items()}
        inside = (replace(a, low=max(a.low, t[0]), high=min(a.high, t[-1])) for a in self.aside)
        aside = tuple(a for a in inside if a.low < a.high)
        return replace(self, t=t, u=self.u[samples], y=self.y[samples], runs=runs, aside=aside)

    @property
    def whole(self) -> tuple[Area, ...]:
        """The stretch that is not fitted, where all that is shown lies in it."""
        return tuple(a for a in self.aside if a.low <= self.t[0] and a.high >= self.t[-1])

    @cached_property
    def keep(self) -> Array:
        """Indices of the samples that a page lists: the extremes of all signals are among them."""
        signals = [self.y, self.u, *self.errors.values()]
        return np.unique(np.concatenate([thin(x, POINTS // len(signals)) for x in signals]))

    @cached_property
    def columns(self) -> dict[str, Array]:
        """Those samples by name: t, u, measured, and each run."""
        listed = {"t": self.t, "u": self.u, "measured": self.y, **self.runs}
        return {name: x[self.keep] for name, x in listed.items()}

    @cached_property
    def worst(self) -> slice:
        """Half a cycle of the output to either side of where the error of the base is largest."""
        n, half = self.y.size, half_cycle(self.y)
        power = np.convolve(self.errors["base"] ** 2, np.ones(half), mode="same")
        centre = int(np.clip(np.argmax(power), half, max(half, n - half)))
        return slice(max(0, centre - half), min(n, centre + half))

    @cached_property
    def periods(self) -> slice:
        """Two and a half periods of the output about the worst one."""
        half = (self.worst.stop - self.worst.start) // 2
        first = max(0, min(self.worst.start - 3 * half // 2, self.y.size - 5 * half))
        return slice(first, first + 5 * half)

    @cached_property
    def span(self) -> tuple[float, float]:
        """The range of all outputs, so that before and after have the same axes [unit of y]."""
        return span(self.y, *self.runs.values())


def kept_back(fitted: Fitted, i: int) -> tuple[Area, ...]:
    """Return what of segment i is validation data: no model is fitted to it."""
    split, t = fitted.split, fitted.split.records[i].t
    found = spans(split.test[i] & ~split.train[i])
    return tuple(Area(t[a], t[b - 1], "validation", "held-out", True) for a, b in found)


def response(c: Comparison, units: Units, *runs: str) -> Panel:
    """Describe measured and simulated output over time."""
    return traces(TIME, c.t, _said("y", units), _told(c, runs), *c.aside, y_range=c.span)


def loop(c: Comparison, units: Units, *runs: str) -> Panel:
    """Describe measured and simulated output against the input."""
    return traces(_said("u", units), c.u, _said("y", units), _told(c, runs), y_range=c.span, height=1.15)


def errors(c: Comparison, units: Units) -> Panel:
    """Describe the free-run errors over time, before and after, with the noise floor."""
    told = {words(name): (c.role(name), e) for name, e in c.errors.items()}
    y = headed("measured - simulated", units.get("y"))
    return traces(TIME, c.t, y, told, *c.aside, *c.band, height=0.8)


def stretch(c: Comparison, units: Units, width: int) -> Panel:
    """Describe some periods where the error is largest, measured, before and after, as a loop of output over input.

    With a `width`, that of `rate`, it is input over the rate of the output: the force over the velocity of an axis.
    """
    some = slice(c.periods.start, c.periods.stop, -(-(c.periods.stop - c.periods.start) // FINE))
    part, Ts = c.at(some), float(np.median(np.diff(c.t)))
    said = {n: "simulated" if len(c.runs) == 1 else "before" if n == "base" else "after" for n in c.runs}
    runs = {"measured": ("measured", c.y)} | {said[n]: (c.role(n), x) for n, x in c.runs.items()}
    if not width:
        shown = {n: (role, x[some]) for n, (role, x) in runs.items()}
        return traces(_said("u", units), part.u, _said("y", units), shown)
    lines = [Line(rate(x, width, Ts)[some], part.u, n, role) for n, (role, x) in runs.items()]
    return Panel(headed("rate of the output", units.get("y") and f"{units['y']}/s"), _said("u", units), lines)


def rate(values: Array, width: int, Ts: float) -> Array:
    """Return the rate of a signal, (N,): its change from `width` samples before to `width` after [per s]."""
    k = np.arange(values.size)
    low, high = np.maximum(k - width, 0), np.minimum(k + width, values.size - 1)
    return np.asarray((values[high] - values[low]) / ((high - low) * Ts))


def region(c: Comparison, inside: Array, units: Units) -> Panel:
    """Describe the error of the base over time, with the samples of a region, (N,) bool, marked."""
    error = c.errors["base"]
    told = {"the base": ("recorded", error), "worst region": ("region", np.where(inside, error, np.nan))}
    return traces(TIME, c.t, headed("error", units.get("y")), told, *c.band)


def _told(c: Comparison, runs: Sequence[str]) -> dict[str, tuple[str, Array]]:
    return {"measured": ("measured", c.y)} | {words(n): (c.role(n), c.runs[n]) for n in runs}


def _said(name: str, units: Units) -> str:
    return headed(name, units.get(name))


def plot_before_after(diagnosis: Diagnosis, axes: Any = None, units: Units | None = None) -> Any:
    """Draw time response and loop before and after, on the same axes, and the errors with the noise floor.

    Parameters
    ----------
    axes : three or five matplotlib axes, optional
        Time and loop of the base, then of the last model where something was added, then the errors.
    units : mapping such as {"u": "V", "y": "um"}
    """
    c, units = Comparison.of(diagnosis), said_first(diagnosis.units, units)
    if axes is None:
        figure, whole = new_axes(figsize=(12, 2.9 * len(c.runs) + 2.2))
        whole.remove()
        grid = figure.add_gridspec(len(c.runs) + 1, 2, width_ratios=(3, 2))
        axes = [figure.add_subplot(grid[i, j]) for i in range(len(c.runs)) for j in (0, 1)]
        axes.append(figure.add_subplot(grid[-1, :]))
    if len(axes) != 2 * len(c.runs) + 1:
        raise NarxError(f"Give {2 * len(c.runs) + 1} axes, not {len(axes)}.")
    pictures = [panel for run in c.runs for panel in (response(c, units, run), loop(c, units, run))]
    for ax, panel in zip(axes, [*pictures, errors(c, units)], strict=True):
        draw(ax, panel)
    return axes[-1].figure


def plot_where_it_fails(diagnosis: Diagnosis, units: Units | None = None) -> Any:
    """Draw where the model fails, in the panels that explain most; see `narx_sym.report.plots.where_it_fails`."""
    return where_it_fails(diagnosis.misfit, units=said_first(diagnosis.units, units))


def spans(mask: Array) -> list[list[int]]:
    """Return the stretches of a mask as [first, behind the last]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return edges.reshape(-1, 2).tolist()
