"""The pictures of a diagnosis, each alone on its axes: what the report and the live page show, with the numbers behind.

`PANELS` lists the parts of the story in their order; `pictures` returns what is drawn in each of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..diagnosis.bases import words
from ..diagnosis.misfit import Panel
from ..diagnosis.procedure import Diagnosis
from ..errors import NarxError
from ..files.atomic import csv_text
from ..models.model import Model
from ..symbolic.signals import differences, samples
from .comparison import POINTS, Array, Comparison, Units, draw_errors, draw_loop, draw_region, draw_time
from .plots import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PINK,
    RED,
    draw_panel,
    label,
    new_axes,
    plot_candidates,
    plot_ladder,
    plot_quasi_static,
    reach,
    thin,
)
from .svg import svg

# The story, in the order in which it is told: key and heading.
PANELS = (
    ("verdict", "What was found"),
    ("compare", "Measured and simulated"),
    ("ladder", "The error, step by step"),
    ("where", "Where the model fails"),
    ("candidates", "What may be missing"),
    ("model", "The model before and after"),
    ("derived", "What follows from the model"),
    ("experiment", "The next experiment"),
    ("provenance", "Where these figures come from"),
)
SHOWN, LEAST = 4, 0.02  # panels of where it fails, and the share that each must explain
NARROW, WIDE = (3.9, 2.9), (8.8, 2.6)  # [inch]


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture.

    Attributes
    ----------
    key : str
        Unique among the pictures of a diagnosis; letters, digits and "_".
    title, alt : str
        Heading, and what there is to see, in words and numbers.
    draw : function of matplotlib axes
    columns : mapping from a name to (N,) numbers or texts
        The numbers behind it, as drawn.
    size : (width, height) [inch]
    """

    key: str
    title: str
    alt: str
    draw: Callable[[Any], Any]
    columns: Mapping[str, Any]
    size: tuple[float, float] = NARROW

    def figure(self) -> Any:
        """Return a new matplotlib figure."""
        figure, ax = new_axes(figsize=self.size)
        self.draw(ax)
        return figure

    @cached_property
    def svg(self) -> str:
        """The picture as an `<svg>` element with a text alternative; its colours follow the page (`svg.stylesheet`)."""
        return svg(self.figure(), self.key, self.alt)

    @property
    def csv(self) -> str:
        """The numbers as CSV."""
        return csv_text(self.columns)


@dataclass(frozen=True, eq=False)
class Failure:
    """One panel of where the model fails: what it explains of the error and of the missing input, and its pictures."""

    name: str
    share: float
    share_missing: float
    worst: str
    pictures: list[Picture] = field(default_factory=list)


def pictures(diagnosis: Diagnosis, units: Units | None = None) -> dict[str, list[Picture]]:
    """Return the pictures of each part of the story, by the keys of `PANELS`; parts without a picture are empty."""
    units = units or {}
    found: dict[str, list[Picture]] = {key: [] for key, _ in PANELS}
    found["compare"] = comparison(diagnosis, units)
    found["ladder"] = [ladder(diagnosis, units)]
    found["where"] = [p for f in failures(diagnosis, units) for p in f.pictures]
    found["candidates"] = [candidates(diagnosis)] if diagnosis.candidates else []
    base = diagnosis.steps[0].base.model
    sets = quasi_static(diagnosis.model, units)
    if sets is None and any(samples(base.F, b) for b in differences(base.input)):
        sets = quasi_static(base, units, " of the base")
    found["derived"] = [] if sets is None else [sets]
    found["experiment"] = experiment(diagnosis, units)
    return found


# -- measured and simulated ------------------------------------------------------------------------------------


def comparison(diagnosis: Diagnosis, units: Units) -> list[Picture]:
    """Return time responses, errors and loops, before and after, on the same axes."""
    c, found = Comparison.of(diagnosis), []
    for i, run in enumerate(c.runs):
        when = ("before", "after")[i] if len(c.runs) > 1 else ""
        alt = f"Measured output and free run of {words(run)} over time, {c.t[-1] - c.t[0]:.3g} s. "
        alt += f"The free-run error is {c.nrmse[run]:.2g} of the output's standard deviation."
        found.append(
            Picture(f"time_{i}", f"Time response {when}".rstrip(), alt, _with(draw_time, c, run, units), c.drawn, WIDE)
        )
    sizes = ", ".join(f"{words(n)} {_rms(e):.2g}" for n, e in c.errors.items())
    alt = f"Free-run error over time; rms [{units.get('y') or 'unit of y'}]: {sizes}; noise floor {c.floor:.2g}."
    drawn = {"t": c.drawn["t"], **{f"error of {n}": e[c.keep] for n, e in c.errors.items()}}
    found.append(
        Picture(
            "errors",
            "Error before and after" if len(c.runs) > 1 else "Error",
            alt,
            _with(draw_errors, c, units),
            drawn,
            WIDE,
        )
    )
    for i, run in enumerate(c.runs):
        when = ("before", "after")[i] if len(c.runs) > 1 else ""
        alt = f"Loop of output against input, measured and free run of {words(run)}."
        found.append(Picture(f"loop_{i}", f"Loop {when}".rstrip(), alt, _with(draw_loop, c, run, units), c.drawn))
    return found


# -- ladder and candidates -------------------------------------------------------------------------------------


def ladder(diagnosis: Diagnosis, units: Units) -> Picture:
    """Return the error after each added effect, down to the floor."""
    rungs = diagnosis.ladder
    floor = diagnosis.floor / diagnosis.steps[0].base.problem.spread
    falls = ", then ".join(f"{r['validation']:.2g} {_after(n)}" for n, r in zip(diagnosis.rungs, rungs, strict=True))
    alt = f"Free-run error on samples never used for fitting, over the output's standard deviation: {falls}; "
    columns = {
        "model": [*diagnosis.rungs, "noise floor"],
        "training": [*(r["train"] for r in rungs), floor],
        "held out": [*(r["validation"] for r in rungs), floor],
    }

    def draw(ax: Any) -> None:
        plot_ladder(diagnosis, units=dict(units), ax=ax)

    alt += f"the noise floor is {floor:.2g}."
    return Picture("ladder", "Error ladder", alt, draw, columns, (max(4.0, 1.8 + 1.1 * len(rungs)), 3.5))


def candidates(diagnosis: Diagnosis) -> Picture:
    """Return the share of the removable error that each candidate removes."""
    rows = diagnosis.table()
    listed = "; ".join(
        f"{words(r['effect'])} {100 * r['share']:.0f} % ({100 * r['low']:.0f} to {100 * r['high']:.0f} %)" for r in rows
    )
    alt = f"Share of the removable error that each candidate removes, with 95 % intervals: {listed}."
    keys = ("effect", "where", "share", "low", "high", "nrmse", "in_confusion_set", "parameters")
    columns = {key: [r[key] for r in rows] for key in keys}
    size = (4.6, max(2.8, 1.7 + 0.42 * len(rows)))
    return Picture("candidates", "Candidates", alt, lambda ax: plot_candidates(diagnosis, ax=ax), columns, size)


# -- where it fails --------------------------------------------------------------------------------------------


def failures(diagnosis: Diagnosis, units: Units, most: int = SHOWN) -> list[Failure]:
    """Return the panels that explain most, each with the error, the missing input, and the worst region in time."""
    misfit, c = diagnosis.misfit, Comparison.of(diagnosis)
    errors, missing = ({p.name: p for p in ps} for ps in (misfit.panels, misfit.panels_missing))
    rows = [(max(r["share"], np.nan_to_num(r["share_missing"])), r) for r in misfit.table(units)]
    found = []
    ranked = sorted(rows, key=lambda p: -p[0])
    shown = [row for i, (share, row) in enumerate(ranked[:most]) if share > LEAST or i == 0]
    # Rounding is no forcing.
    missing = missing if misfit.missing is not None and np.abs(misfit.missing).max() > 1e-6 * c.floor else {}
    tops = [reach([p[r["panel"]] for r in shown if r["panel"] != "spectrum"]) for p in (errors, missing) if p]
    for i, row in enumerate(shown):
        name, made = row["panel"], []
        both = [("error", "Free-run error", errors[name])]
        both += [("missing", "Equivalent missing input", missing[name])] if name in missing else []
        for (word, title, panel), top in zip(both, tops, strict=False):
            title = f"{title}: {panel.label}"
            made.append(_panel(f"where_{i + 1}_{word}", title, panel, c.floor if word == "error" else None, top, units))
        # The residual that the panel explains better says where to look.
        of_missing = name in missing and (missing[name].share > errors[name].share or errors[name].worst is None)
        worst = missing[name].where(units).replace("error", "missing input") if of_missing else row["worst"]
        if name != "spectrum":
            region = misfit.region(name, of_missing)
            columns = {"t": c.t[c.keep], "error": c.errors["base"][c.keep], "in the worst region": region[c.keep]}
            alt = f"Error of the base over time; marked: {worst}."
            draw = _with(draw_region, c, region, units)
            made.append(Picture(f"where_{i + 1}_time", f"The worst region in time: {words(name)}", alt, draw, columns))
        found.append(Failure(name, row["share"], row["share_missing"], worst, made))
    return found


def _panel(key: str, title: str, panel: Panel, floor: float | None, top: float, units: Units) -> Picture:
    what = {"spectrum": "rms in a bin"}.get(panel.name, "mean")

    def draw(ax: Any) -> None:
        draw_panel(ax, panel, floor, dict(units))
        ax.set_title("", loc="left")
        ax.set_ylabel(label(f"{what} {'error' if 'error' in key else 'missing input'}", units.get("y", "")))
        ax.set_ylim(*((0, None) if panel.name == "spectrum" else (-top, top)))
        marks = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
        marks = {n: h for n, h in marks.items() if not n.endswith("\u2009")}
        if panel.low.ndim == 1:
            ax.legend(
                marks.values(), marks.keys(), loc="lower left", bbox_to_anchor=(-0.1, 1), ncols=2, fontsize=8,
                frameon=False, borderaxespad=0.2,
            )  # fmt: skip

    low, high = np.atleast_2d(panel.low.T), np.atleast_2d(panel.high.T)
    columns = {f"{side} {i + 1}" if len(low) > 1 else side: x for side, b in (("from", low), ("to", high))
               for i, x in enumerate(b)}  # fmt: skip
    columns |= {what: panel.mean, "standard error": panel.error, "samples": panel.count}
    alt = f"{title}. It explains {100 * panel.share:.0f} % of the variance; {panel.where(units)}."
    return Picture(key, title, alt, draw, columns)


# -- derived, and the experiment -------------------------------------------------------------------------------


def quasi_static(model: Model, units: Units, of: str = "") -> Picture | None:
    """Return the quasi-static sets, None where they are not derived or where the model does not stay finite."""

    def draw(ax: Any) -> None:
        plot_quasi_static(model, ax=ax, units=dict(units))

    try:
        draw(new_axes(figsize=(5.2, 5.0))[1])
    except NarxError:
        return None
    alt = "Quasi-static sets over the input: attracting and repelling parts, and the model's own loop."
    return Picture("quasi_static", f"Quasi-static sets{of}", alt, draw, {}, (5.2, 5.0))


def draw_input(ax: Any, t: Array, u: Array, units: Units) -> None:
    """Draw the input of an experiment."""
    keep = thin(u, POINTS)
    ax.plot(t[keep], u[keep], color=BLUE, lw=1.2)
    ax.set(xlabel="time [s]", ylabel=label("u", units.get("u", "")))
    ax.margins(x=0)


def draw_outputs(ax: Any, t: Array, outputs: Mapping[str, Array], units: Units) -> None:
    """Draw by how much the candidates' outputs differ from their mean."""
    mean = np.mean(list(outputs.values()), axis=0)
    looks = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (PINK, ":"), (BLACK, "-"), (RED, "--"))
    for (name, y), (colour, style) in zip(outputs.items(), looks, strict=False):
        keep = thin(y - mean, POINTS)
        ax.plot(t[keep], (y - mean)[keep], color=colour, ls=style, lw=1.0, label=words(name))
    ax.set(xlabel="time [s]", ylabel=label("y - mean of all", units.get("y", "")))
    ax.margins(x=0)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=9, frameon=False, borderaxespad=0.2)


def experiment(diagnosis: Diagnosis, units: Units) -> list[Picture]:
    """Return the input to run next, and what each candidate says will be measured."""
    e = diagnosis.experiment
    if e is None:
        return []
    alt = f"Input over {e.duration:.3g} s: {e.name}."
    first = Picture("next_input", "Input", alt, _with(draw_input, e.t, e.u, units), {"t": e.t, "u": e.u}, WIDE)
    alt = f"What the candidates say differs by {e.separation:.2g} {units.get('y', '')} rms or more after a refit."
    keep = np.unique(np.concatenate([thin(y, POINTS // 2) for y in e.outputs.values()]))
    columns = {"t": e.t[keep], **{n: y[keep] for n, y in e.outputs.items()}}
    draw = _with(draw_outputs, e.t, e.outputs, units)
    return [first, Picture("next_outputs", "What the candidates say", alt, draw, columns, WIDE)]


# -- small things ----------------------------------------------------------------------------------------------


def _with(draw: Callable[..., None], *more: Any) -> Callable[[Any], None]:
    return lambda ax: draw(ax, *more)


def _after(rung: str) -> str:
    return "for the base" if rung == "base" else f"with {words(rung)}"


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
