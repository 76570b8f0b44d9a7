"""A run over time and as a loop: a model beside a measurement, and a plant under a compensation law."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...data.metrics import rmse
from ...data.record import Record
from ...data.units import in_units, said_first
from ...fit.simulate import arrays, free_run, simulate
from ...models.model import Model
from ...tasks.commission import Commissioning
from .style import BLACK, BLUE, GREEN, ORANGE, RED, SKY, label, new_axes, thin


def plot_comparison(model: Model, record: Record, axes: Any = None, units: dict[str, str] | None = None) -> Any:
    """Draw measured and simulated output over time, the error, and both loops.

    Parameters
    ----------
    axes : three matplotlib axes (time, error, loop), optional
    units : mapping such as {"u": "V", "y": "um"}
    """
    (record,) = in_units([record], model.info.units)
    units = said_first(record.units, units)
    if axes is None:
        figure, _ = new_axes(figsize=(11, 5))
        figure.clear()
        grid = figure.add_gridspec(2, 2, width_ratios=(3, 2), height_ratios=(3, 1))
        top = figure.add_subplot(grid[0, 0])
        axes = [top, figure.add_subplot(grid[1, 0], sharex=top), figure.add_subplot(grid[:, 1])]
    parts = record.segments()
    listed = [arrays(model, part) for part in parts]
    source, output = str(model.input.label), str(model.output.label)
    simulated = np.concatenate([free_run(model, part) for part in parts])
    measured, driver = (np.concatenate([d[name] for d in listed]) for name in (output, source))
    time = np.concatenate([part.t[: d[output].size] for part, d in zip(parts, listed, strict=True)])
    keep = np.union1d(thin(measured), thin(measured - simulated))
    name = label(output, units.get(output, ""))
    axes[0].plot(time[keep], measured[keep], color=BLACK, lw=1.6, label="measured")
    axes[0].plot(time[keep], simulated[keep], color=ORANGE, lw=1.2, ls="--", label="free run")
    axes[0].set_ylabel(name)
    share = rmse(measured, simulated) / float(np.std(measured) or 1.0)
    axes[0].set_title(f"{record.name}: free-run NRMSE {share:.3g}", loc="left", fontsize=10)
    axes[1].plot(time[keep], (measured - simulated)[keep], color=BLUE, lw=0.8)
    axes[1].axhline(0, color=BLACK, lw=0.5)
    axes[1].set(xlabel="time [s]", ylabel=f"error of {name}")
    axes[2].plot(driver[keep], measured[keep], color=BLACK, lw=1.2, label="measured")
    axes[2].plot(driver[keep], simulated[keep], color=ORANGE, lw=1.0, ls="--", label="free run")
    axes[2].set(xlabel=label(source, units.get(source, "")), ylabel=name)
    axes[2].legend(loc="upper left")
    return axes[0].figure


def reversal_curves(model: Model, count: int = 8, leg: int = 400) -> list[tuple[Any, Any]]:
    """Return first-order reversal curves of a model over the input's range it was fitted on, slowly swept.

    From the top the input falls to each of `count` levels and rises again: each curve is that rise.

    Returns
    -------
    list of (u, y), (leg,) arrays [units of u and y], from the highest level to the lowest
    """
    low, high = model.info.ranges.get(str(model.input.label), (-1.0, 1.0))
    levels = [high - (high - low) * i / count for i in range(1, count + 1)]
    path = [np.linspace(low, high, leg)]
    for level in levels:
        path += [np.linspace(high, level, leg), np.linspace(level, high, leg)]
    source = np.concatenate(path)
    run = simulate(model, source, warn=False)
    edges = [(2 + 2 * i) * leg for i in range(count)]
    return [(source[a : a + leg], run[a : a + leg]) for a in edges]


def plot_reversal_curves(
    model: Model, record: Record | None = None, ax: Any = None, count: int = 8, units: dict[str, str] | None = None
) -> Any:
    """Draw first-order reversal curves of a model: how it goes on after each turn; over the loops of a record.

    Parameters
    ----------
    record : Record, optional
        Its rising branches are drawn behind the curves.
    units : mapping such as {"u": "V", "y": "um"}
    """
    units = said_first(model.info.units, units)
    if ax is None:
        _, ax = new_axes(figsize=(6.5, 5.0))
    if record is not None:
        rising = np.diff(record.u, prepend=record.u[0]) >= 0
        ax.plot(record.u, np.where(rising, record.y, np.nan), color=SKY, lw=0.6, label="measured, rising")
    for i, (source, run) in enumerate(reversal_curves(model, count)):
        ax.plot(source, run, color=ORANGE, lw=1.2, label="model, after each turn" if i == 0 else None)
        ax.plot(source[:1], run[:1], color=BLACK, marker=".", ms=4, ls="none")
    ax.set(xlabel=label("u", units.get("u", "")), ylabel=label("y", units.get("y", "")))
    ax.legend(loc="upper left", fontsize=9, frameon=False)
    return ax.figure


def plot_compensation(
    t: Any,
    r: Any,
    m: Any,
    outputs: dict[str, Any],
    units: dict[str, str] | None = None,
    limits: tuple[float, float] | None = None,
) -> Any:
    """Draw responses and compensated input over time, the tracking errors, and the loops r against y.

    Parameters
    ----------
    outputs : mapping from a name ("compensated", "without") to the (N,) plant output
    limits : (lowest, highest) input, optional
        They are marked.
    """
    units = units or {}
    figure, axes = new_axes(2, 2, figsize=(11, 7))
    colours = (ORANGE, SKY, GREEN)
    t, r, m = (np.asarray(x, dtype=float) for x in (t, r, m))
    told = [r, m, *(r - y for y in outputs.values())]
    keep = np.unique(np.concatenate([thin(x, 4000 // len(told)) for x in told]))
    axes[0, 0].plot(t[keep], r[keep], color=BLACK, lw=1.6, label="reference r")
    axes[1, 0].plot(t[keep], m[keep], color=BLUE, lw=1.2, label="compensated input m")
    for limit in limits or ():
        axes[1, 0].axhline(limit, color=RED, lw=1.0, ls=":", label="limits" if limit == max(limits or ()) else None)
    for (name, values), colour in reversed(list(zip(outputs.items(), colours, strict=False))):
        axes[0, 0].plot(t[keep], values[keep], color=colour, lw=1.1, ls="--", label=name)
        axes[0, 1].plot(t[keep], (r - values)[keep], color=colour, lw=1.0, label=name)
        axes[1, 1].plot(r[keep], values[keep], color=colour, lw=1.1, label=name)
    axes[0, 0].set(xlabel="time [s]", ylabel=label("y", units.get("y", "")))
    axes[0, 1].set(xlabel="time [s]", ylabel=label("r - y", units.get("y", "")))
    axes[1, 0].set(xlabel="time [s]", ylabel=label("m", units.get("u", "")))
    axes[1, 1].set(xlabel=label("r", units.get("y", "")), ylabel=label("y", units.get("y", "")))
    for ax in axes.flat:
        if ax is not axes[1, 1]:
            ax.margins(x=0)
        columns = len(outputs) + 1
        ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=columns, fontsize=9, frameon=False, borderaxespad=0.2)
    return figure


def plot_commissioning(found: Commissioning, units: dict[str, str] | None = None) -> Any:
    """Draw the input of a law, the reference, and the band of the tracking error.

    Parameters
    ----------
    units : mapping such as {"u": "V", "y": "um"}
    """
    units = said_first(found.law.model.info.units, units)
    time = np.arange(found.r.size) * (found.law.model.Ts or 1.0)
    unit = "s" if found.law.model.Ts else "samples"
    figure, axes = new_axes(3, 1, figsize=(10, 7.5))
    axes[0].plot(*_thinned(time, found.r), color=BLACK, lw=1.4)
    axes[0].set_ylabel(label("reference", units.get("y", "")))
    verdict = "Go" if found.go else "No go"
    unit_y = f" {units['y']}" if units.get("y") else ""
    axes[0].set_title(
        f"{verdict}: error {found.expected:.3g}{unit_y} rms, without the law {found.without:.3g}{unit_y}", loc="left"
    )
    axes[1].plot(*_thinned(time, found.run.m), color=BLUE, lw=1.1)
    axes[1].set_ylabel(label("input of the law", units.get("u", "")))
    keep = np.union1d(thin(found.low), thin(found.high))
    axes[2].fill_between(
        time[keep], found.low[keep], found.high[keep], color=SKY, lw=0, label="95 % of what the records allow"
    )
    axes[2].axhline(0, color=BLACK, lw=0.7)
    axes[2].set(xlabel=f"time [{unit}]", ylabel=label("y - r", units.get("y", "")))
    figure.legend(loc="outside lower right", fontsize=9, frameon=False)
    return figure


def _thinned(time: Any, x: Any) -> tuple[Any, Any]:
    keep = thin(x)
    return time[keep], x[keep]
