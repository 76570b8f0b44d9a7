"""Measured and simulated output over time and as a loop, before and after something was added, on the same axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..data.metrics import half_cycle
from ..data.units import said_first
from ..diagnosis.bases import words
from ..diagnosis.misfit import Misfit
from ..diagnosis.procedure import Diagnosis
from ..errors import NarxError
from .plots import BLACK, BLUE, ORANGE, RED, SKY, YELLOW, label, new_axes, thin, where_it_fails

Array = np.ndarray
Units = Mapping[str, str]
POINTS = 2000  # of all lines of a still picture together; extremes are kept
EVERY = 60_000  # samples: up to here a picture that can be zoomed has all of them, five of four bytes each


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measured and simulated output along the longest segment, before and after what was added.

    Attributes
    ----------
    t, u, y : (N,) arrays [s, unit of u, unit of y]
    runs : mapping from "base" or the names of the rungs to the (N,) free runs [unit of y]
        The base first; the last model second, where something was added.
    nrmse : mapping from the same names to the free-run error on held-out samples
    floor : float
        rms of the noise [unit of y].
    name : str
    misfit : Misfit
        Where the base fails along the same samples.
    """

    t: Array
    u: Array
    y: Array
    runs: dict[str, Array]
    nrmse: dict[str, float]
    floor: float
    name: str
    misfit: Misfit

    @classmethod
    def of(cls, diagnosis: Diagnosis) -> Comparison:
        """Take it from a diagnosis."""
        base = diagnosis.steps[0].base
        last = diagnosis.last
        i = int(np.argmax([len(r) for r in base.split.records]))
        record = base.split.records[i]
        runs, nrmse = {"base": record.y - base.errors[i]}, {"base": diagnosis.ladder[0]["validation"]}
        if last is not None:
            name = " ".join(diagnosis.rungs)
            runs[name], nrmse[name] = record.y - last.errors[i], diagnosis.ladder[-1]["validation"]
        return cls(record.t, record.u, record.y, runs, nrmse, diagnosis.floor, record.name, diagnosis.misfit)

    @property
    def errors(self) -> dict[str, Array]:
        """Measured minus simulated, (N,) arrays [unit of y]."""
        return {name: self.y - run for name, run in self.runs.items()}

    @cached_property
    def keep(self) -> Array:
        """Indices of the samples of still pictures: the extremes of all signals are among them."""
        return self._extremes(POINTS)

    @cached_property
    def zoomed(self) -> Array:
        """Indices of the samples of pictures that can be zoomed: all of them, unless the record is very long."""
        return np.arange(self.y.size) if self.y.size <= EVERY else self._extremes(EVERY)

    def _extremes(self, points: int) -> Array:
        signals = [self.y, self.u, *self.errors.values()]
        return np.unique(np.concatenate([thin(x, points // len(signals)) for x in signals]))

    @cached_property
    def drawn(self) -> dict[str, Array]:
        """The drawn samples by name: t, u, measured, and each run."""
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
    def span(self) -> tuple[float, float]:
        """The range of all outputs, so that before and after have the same axes [unit of y]."""
        every = [self.y, *self.runs.values()]
        low, high = min(float(x.min()) for x in every), max(float(x.max()) for x in every)
        room = 0.05 * (high - low) or 1.0
        return low - room, high + room


def draw_time(ax: Any, c: Comparison, run: str, units: Units) -> None:
    """Draw measured and simulated output over time."""
    ax.plot(c.drawn["t"], c.drawn["measured"], color=BLACK, lw=1.5, label="measured")
    ax.plot(c.drawn["t"], c.drawn[run], color=_colour(c, run), lw=1.1, ls="--", label=f"free run of {words(run)}")
    ax.set(xlabel="time [s]", ylabel=label("y", units.get("y", "")), ylim=c.span)
    ax.margins(x=0)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, fontsize=9, frameon=False, borderaxespad=0.2)


def draw_worst(ax: Any, c: Comparison, units: Units) -> None:
    """Draw where the error is largest: measured and simulated, before and after; below what is left of each."""
    part, unit = c.worst, units.get("y", "")
    t, single = c.t[part], len(c.runs) == 1
    grid = ax.get_subplotspec().subgridspec(2, 1, height_ratios=(3, 2), hspace=0.05)
    ax.set_subplotspec(grid[0])
    below = ax.figure.add_subplot(grid[1], sharex=ax)
    ax.plot(t, c.y[part], color=BLACK, lw=2.2, label="measured")
    below.axhspan(-c.floor, c.floor, color=YELLOW, alpha=0.45, lw=0, label="noise floor (± rms)")
    for (name, run), style in zip(c.runs.items(), ("--", "-"), strict=False):
        said = "simulated" if single else "before" if name == "base" else "after"
        ax.plot(t, run[part], color=_colour(c, name), lw=1.6, ls=style, label=said)
        below.plot(t, c.errors[name][part], color=_colour(c, name), lw=1.4, ls=style)
    ax.set(ylabel=label("y", unit))
    ax.tick_params(labelbottom=False)
    below.set(xlabel="time [s]", ylabel=label("error", unit))
    ax.margins(x=0)
    for one, columns in ((ax, 3), (below, 1)):
        one.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=columns, fontsize=9, frameon=False, borderaxespad=0.2)


def draw_loop(ax: Any, c: Comparison, run: str, units: Units) -> None:
    """Draw measured and simulated output against the input."""
    ax.plot(c.drawn["u"], c.drawn["measured"], color=BLACK, lw=1.2, label="measured")
    ax.plot(c.drawn["u"], c.drawn[run], color=_colour(c, run), lw=1.0, ls="--", label=f"free run of {words(run)}")
    ax.set(xlabel=label("u", units.get("u", "")), ylabel=label("y", units.get("y", "")), ylim=c.span)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=1, fontsize=9, frameon=False, borderaxespad=0.2)


def draw_errors(ax: Any, c: Comparison, units: Units) -> None:
    """Draw the free-run errors over time, before and after, with the noise floor."""
    ax.axhspan(-c.floor, c.floor, color=YELLOW, alpha=0.45, lw=0, label="noise floor (± rms)")
    for name, error in c.errors.items():
        ax.plot(c.drawn["t"], error[c.keep], color=_colour(c, name), lw=0.8, label=f"error of {words(name)}")
    ax.set(xlabel="time [s]", ylabel=label("measured - simulated", units.get("y", "")))
    ax.margins(x=0)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=9, frameon=False, borderaxespad=0.2)


def draw_region(ax: Any, c: Comparison, region: Array, units: Units) -> None:
    """Draw the error of the base over time, with the samples of a region marked."""
    error = c.errors["base"]
    ax.axhspan(-c.floor, c.floor, color=YELLOW, alpha=0.45, lw=0, label="noise floor (± rms)")
    ax.plot(c.t[c.keep], error[c.keep], color=SKY, lw=0.8, label="error of the base")
    inside = c.keep[region[c.keep]]
    ax.plot(c.t[inside], error[inside], color=RED, ls="none", marker=".", ms=3.0, label="in the worst region")
    ax.set(xlabel="time [s]", ylabel=label("error", units.get("y", "")))
    ax.margins(x=0)
    ax.legend(
        loc="lower left", bbox_to_anchor=(-0.1, 1), ncols=2, fontsize=8, frameon=False, borderaxespad=0.2, markerscale=3
    )


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
        figure, _ = new_axes(figsize=(12, 2.9 * len(c.runs) + 2.2))
        figure.clear()
        grid = figure.add_gridspec(len(c.runs) + 1, 2, width_ratios=(3, 2))
        axes = [figure.add_subplot(grid[i, j]) for i in range(len(c.runs)) for j in (0, 1)]
        axes.append(figure.add_subplot(grid[-1, :]))
    if len(axes) != 2 * len(c.runs) + 1:
        raise NarxError(f"Give {2 * len(c.runs) + 1} axes, not {len(axes)}.")
    for i, run in enumerate(c.runs):
        draw_time(axes[2 * i], c, run, units)
        draw_loop(axes[2 * i + 1], c, run, units)
    draw_errors(axes[-1], c, units)
    return axes[-1].figure


def _colour(c: Comparison, run: str) -> str:
    return ORANGE if run == next(iter(c.runs)) else BLUE


def plot_where_it_fails(diagnosis: Diagnosis, units: Units | None = None) -> Any:
    """Draw the error in the panels that tell most; see `narx_sym.report.plots.where_it_fails`."""
    return where_it_fails(diagnosis.misfit, units=said_first(diagnosis.units, units))


def spans(mask: Array) -> list[list[int]]:
    """Return the stretches of a mask as [first, behind the last]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return edges.reshape(-1, 2).tolist()
