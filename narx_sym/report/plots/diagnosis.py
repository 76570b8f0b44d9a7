"""What a diagnosis found: the candidates, and the error step by step."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from ...data.units import said_first
from ...errors import NarxError
from ...files.atomic import write_figure
from ..figures.still import BLACK, BLUE, ORANGE, SKY, label, new_axes
from ..words import has_floor
from .valve import plot_valve


def plot_diagnosis(diagnosis: Any, path: str | Path | None = None, units: dict[str, str] | None = None) -> Any:
    """Draw the candidates and the error ladder of a diagnosis side by side."""
    if diagnosis.steps[0].valves:
        return plot_valve(diagnosis.steps[0].valves[0], path, units)
    if not diagnosis.candidates:
        return plot_ladder(diagnosis, path, units)
    figure, axes = new_axes(1, 2, figsize=(12.5, _height(diagnosis)), width_ratios=(3, 2))
    plot_candidates(diagnosis, ax=axes[0])
    plot_ladder(diagnosis, units=units, ax=axes[1])
    if path is not None:
        write_figure(figure, path)
    return figure


def _height(diagnosis: Any) -> float:
    return max(4.2, 1.8 + 0.55 * len(diagnosis.candidates))


def plot_ladder(
    diagnosis: Any, path: str | Path | None = None, units: dict[str, str] | None = None, ax: Any = None
) -> Any:
    """Draw the free-run error after each added effect, down to the noise floor.

    Parameters
    ----------
    diagnosis : Diagnosis
    path : str or Path, optional
        Where the picture is saved; its ending chooses the format.
    units : mapping with the unit of "y", for a second axis in that unit
    """
    units = said_first(diagnosis.units, units)
    rungs = diagnosis.ladder
    step = diagnosis.steps[0]
    spread = step.base.problem.spread
    floor = diagnosis.floor / spread
    if ax is None:
        _, ax = new_axes(figsize=(max(5.0, 2.6 + 1.3 * len(rungs)), 4.2))
    for key, colour, marker, style, word in (
        ("train", SKY, "o", "--", "whole record"), ("validation", BLUE, "s", "-", "validation data"),
    ):  # fmt: skip
        values = np.array([r[key] for r in rungs])
        ax.hlines(values, np.arange(len(rungs)) - 0.32, np.arange(len(rungs)) + 0.32, color=colour, lw=3, ls=style)
        joined = ":" if key == "validation" else "none"
        ax.plot(values, color=colour, ls=joined, lw=1.0, marker=marker, ms=6, label=word)
    for i, rung in enumerate(rungs):
        shift = (9, 6) if rung["validation"] >= rung["train"] else (9, -14)  # away from the other marker
        said = f"{rung['validation']:.2g}"
        ax.annotate(said, (i, rung["validation"]), shift, textcoords="offset points", fontsize=9)
    kind = {"estimate": "estimated"}.get(step.floor_kind, f"from {step.floor_kind}")
    known = [floor] if has_floor(diagnosis) else []
    for height in known:
        ax.axhline(height, color=BLACK, lw=1.2, ls="-.", label=f"noise floor, {kind}")
    every = [*known, *(r[key] for r in rungs for key in ("train", "validation"))]
    ax.set_yscale("log")
    room = max(1.6, np.sqrt(10 / max(max(every) / max(min(every), 1e-300), 1e-300)))  # at least a decade is shown
    ax.set_ylim(min(every) / room, max(every) * room)
    _plain_numbers(ax.yaxis)
    ax.set_xlim(-0.6, len(rungs) - 0.4)
    names = [textwrap.fill(name.replace("_", " "), 18).replace("$", r"\$") for name in diagnosis.rungs]
    ax.set_xticks(range(len(rungs)), names)
    ax.set_ylabel("free-run error / std of the output")
    if units.get("y"):
        other = ax.secondary_yaxis("right", functions=(lambda x: x * spread, lambda x: x / spread))
        other.set_ylabel(label("rms error", units["y"]))
        _plain_numbers(other.yaxis)
    ax.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(-0.1, 1))
    if path is not None:
        write_figure(ax.figure, path)
    return ax.figure


def _plain_numbers(axis: Any) -> None:
    """Write 0.02 instead of 2 x 10^-2 along a logarithmic axis, at 1, 2 and 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:.3g}"))


def plot_candidates(
    diagnosis: Any, path: str | Path | None = None, units: dict[str, str] | None = None, ax: Any = None
) -> Any:
    """Draw the fraction of the removable error that each candidate removes, with its 95 % interval.

    Parameters
    ----------
    diagnosis : Diagnosis
    path : str or Path, optional
        Where the picture is saved; its ending chooses the format.
    units : not used; as in the other pictures
    """
    rows = diagnosis.table()
    if not rows:
        raise NarxError(f"There is no candidate to draw: the verdict is {diagnosis.verdict}.")
    if ax is None:
        _, ax = new_axes(figsize=(8, _height(diagnosis)))
    low = max(-0.5, min(0.0, 1.1 * min(r["low"] for r in rows)))
    high = max(1.0, min(1.2, max(r["high"] for r in rows)))
    best = "these data cannot distinguish them" if len(diagnosis.confusion_set) > 1 else "the best"
    best = "one of the two effects together" if diagnosis.steps[0].pair else best
    for inside, colour, hatch, word in (
        (True, ORANGE, "", best),
        (False, SKY, "//", "others: less improvement, or more parameters"),
    ):  # fmt: skip
        chosen = [i for i, r in enumerate(rows) if r["in_confusion_set"] == inside]
        if chosen:
            shares = np.clip([rows[i]["share"] for i in chosen], low, high)
            ax.barh(chosen, shares, 0.6, color=colour, hatch=hatch, edgecolor="white", lw=0, label=word)
    for i, row in enumerate(rows):
        a, b = np.clip([row["low"], row["high"]], low, high)
        first = "95 % interval" if i == 0 else None
        ax.plot([a, b], [i, i], color=BLACK, lw=1.3, marker="|", ms=9, solid_capstyle="butt", label=first)
        ax.annotate(
            f"NRMSE {row['nrmse']:.2g}", (1.01, i), xycoords=("axes fraction", "data"), va="center", fontsize=9,
            annotation_clip=False,
        )  # fmt: skip
    ax.axvline(0, color=BLACK, lw=0.6)
    ax.set_xlim(low, high + 0.03)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_yticks(
        range(len(rows)),
        [
            textwrap.fill(
                f"{'* ' if r['in_confusion_set'] else ''}{r['effect'].replace('_', ' ')}, {r['where']}", 26
            ).replace("$", r"\$")
            for r in rows
        ],
    )
    ax.set_xlabel("fraction of the removable error, cross-validated")
    place = {"loc": "lower left", "bbox_to_anchor": (-0.3, 1)}
    ax.legend(fontsize=8, frameon=False, **place)
    if path is not None:
        write_figure(ax.figure, path)
    return ax.figure
