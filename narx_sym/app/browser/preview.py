"""The pictures that only the live page has: what was read, and what stays in sight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...data.record import Record
from ...diagnosis.refit import Fitted
from ...report.plots import BLACK, BLUE, GREEN, ORANGE, PINK, label, new_axes, plot_compensation, thin
from ...report.svg import svg
from ...report.words import number
from ...tasks.compensate import Tracked


def signals_svg(record: Record, units: Mapping[str, str]) -> str:
    """Return input and output over time as an `<svg>` element."""
    figure, axes = new_axes(2, figsize=(8.8, 3.4))
    for ax, name, values, colour in zip(axes, "uy", (record.u, record.y), (GREEN, BLUE), strict=True):
        keep = thin(values)
        ax.plot(record.t[keep], values[keep], color=colour, lw=0.9)
        ax.set_ylabel(label(name, units.get(name, "")))
        ax.margins(x=0)
    axes[1].set_xlabel("time [s]")
    alt = f"Input from {record.u.min():.4g} to {record.u.max():.4g} and output from {record.y.min():.4g} to "
    return svg(figure, "preview", f"{alt}{record.y.max():.4g} over {record.t[-1] - record.t[0]:.4g} s.")


def sight_svg(
    part: slice, before: Fitted | None, now: Fitted, candidates: Sequence[Fitted | None], units: Mapping[str, str]
) -> str:
    """Return a stretch of the longest segment over time and as a loop, as two `<svg>` elements.

    Parameters
    ----------
    part : slice of samples
    before, now : the model before the last step, where there is one, and the last
    candidates : what each candidate would make of it; the page shows one at a time (`candidate_<i>` in their ids)
    """
    i = int(np.argmax([len(r) for r in now.split.records]))
    record = now.split.records[i]
    t, u, y = record.t[part], record.u[part], record.y[part]
    runs = {"measured": y, "before": before and y - before.errors[i][part], "now": y - now.errors[i][part]}
    looks: dict[str, dict[str, Any]] = {
        "measured": {"color": BLACK, "lw": 2.2}, "before": {"color": ORANGE, "lw": 1.5, "ls": "--"},
        "now": {"color": BLUE, "lw": 1.6},
    }  # fmt: skip
    drawn = {name: run for name, run in runs.items() if run is not None}
    times = f"from {t[0]:.4g} to {t[-1]:.4g} s"
    rms = ", ".join(f"{name} {np.std(run - y):.2g}" for name, run in drawn.items() if name != "measured")
    found = []
    for where, x, width in (("time", t, 5.8), ("loop", u, 3.8)):
        figure, ax = new_axes(figsize=(width, 2.9))
        for name, run in drawn.items():
            ax.plot(x, run, label=name, **looks[name])
        ax.margins(x=0 if where == "time" else None)
        ax.set(xlim=ax.get_xlim(), ylim=ax.get_ylim())
        for k, fitted in enumerate(candidates):
            if fitted is not None:
                ax.plot(x, y - fitted.errors[i][part], color=PINK, lw=2.0, ls="-.", gid=f"candidate_{k}")
        ax.set_xlabel("time [s]" if where == "time" else label("u", units.get("u", "")))
        ax.set_ylabel(label("y", units.get("y", "")))
        if where == "time":
            ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=10, frameon=False, borderaxespad=0.2)
        told = f"error {rms}" if where == "time" else "output against input"
        found.append(svg(figure, f"sight_{where}", f"Measured and simulated output {times}: {told}."))
    return "".join(found)


@dataclass(frozen=True, eq=False)
class Ran:
    """A run of a law as the page shows it.

    Attributes
    ----------
    tracked : Tracked
    figure : its picture, an `<svg>` element
    sentence : its errors, and how long limits hold the input
    notes : what to know of it
    units : those of both
    """

    tracked: Tracked
    figure: str
    sentence: str
    notes: tuple[str, ...]
    units: Mapping[str, str]


def ran(tracked: Tracked, units: Mapping[str, str]) -> Ran:
    """Draw a run of a law, and say how near the model comes."""
    unit = f" {units['y']}" if units.get("y") else ""
    said = [
        f"{name} {number(rms)}{unit} rms, {number(most)}{unit} at most" if np.isfinite(rms) else f"{name} it runs away"
        for name, (rms, most) in tracked.errors.items()
    ]
    told = f"Error of the model's output against the reference: {'; '.join(said)}."
    holds = f"{tracked.holds[0].upper()}{tracked.holds[1:]}." if tracked.holds else "No limit holds the input."
    outputs = {"with the law": tracked.y, "without": tracked.bare}
    picture = plot_compensation(tracked.t, tracked.r, tracked.m, outputs, dict(units), tracked.limits)
    notes = [*tracked.notes]
    for name, known in units.items():
        notes = [text.replace(f"[unit of {name}]", known) for text in notes] if known else notes
    drawn = svg(picture, "law_run", f"Run of the law. {told}")
    return Ran(tracked, drawn, f"{told} {holds}", tuple(notes), units)
