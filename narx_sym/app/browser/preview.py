"""The pictures that only the live page has: what was read, and what stays in sight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...data.record import Record
from ...data.units import headed
from ...diagnosis.refit import Fitted
from ...report.figures.describe import TIME, Line, span, traces
from ...report.figures.still import draw, new_axes
from ...report.plots import plot_compensation
from ...report.svg import svg
from ...report.words import number
from ...tasks.compensate import Tracked


def signals_svg(record: Record, units: Mapping[str, str]) -> str:
    """Return input and output over time as an `<svg>` element."""
    figure, ax = new_axes(figsize=(8.8, 3.4))
    signals = (("u", "input", record.u), ("y", "recorded", record.y))
    draw(ax, *(traces(TIME, record.t, headed(n, units.get(n)), {"": (role, x)}) for n, role, x in signals))
    alt = f"Input from {record.u.min():.4g} to {record.u.max():.4g} and output from {record.y.min():.4g} to "
    return svg(figure, "preview", f"{alt}{record.y.max():.4g} over {record.t[-1] - record.t[0]:.4g} s.")


def sight_svg(
    i: int,
    part: slice,
    before: Fitted | None,
    now: Fitted,
    candidates: Sequence[Fitted | None],
    units: Mapping[str, str],
) -> str:
    """Return a stretch of a segment over time and as a loop, as two `<svg>` elements.

    Parameters
    ----------
    i, part : which segment, and a slice of its samples
    before, now : the model before the last step, where there is one, and the last
    candidates : what each candidate would make of it; the page shows one at a time (`candidate_<i>` in their ids)
    """
    record = now.split.records[i]
    t, u, y = record.t[part], record.u[part], record.y[part]
    runs = {"measured": ("measured", y)}
    if before is not None:
        runs["before"] = ("before", y - before.errors[i][part])
    runs["now"] = ("after", y - now.errors[i][part])
    times = f"from {t[0]:.4g} to {t[-1]:.4g} s"
    rms = ", ".join(f"{name} {np.std(run - y):.2g}" for name, (_, run) in runs.items() if name != "measured")
    reach = span(*(run for _, run in runs.values()))
    found = []
    for name, x, axis, said, width in (
        ("time", t, TIME, f"error {rms}", 5.8), ("loop", u, headed("u", units.get("u")), "output against input", 3.8)
    ):  # fmt: skip
        more = [Line(x, y - c.errors[i][part], role="candidate", key=f"candidate_{k}")
                for k, c in enumerate(candidates) if c is not None]  # fmt: skip
        panel = traces(axis, x, headed("y", units.get("y")), runs, y_range=reach)
        _, ax = new_axes(figsize=(width, 2.9))
        drawn = draw(ax, replace(panel, marks=[*panel.marks, *more]))
        found.append(svg(drawn, f"sight_{name}", f"Measured and simulated output {times}: {said}."))
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
    outputs = {"with the law": tracked.y, "without": tracked.plain.y}
    picture = plot_compensation(tracked.t, tracked.r, tracked.m, outputs, dict(units), tracked.limits)
    notes = [*tracked.notes]
    for name, known in units.items():
        notes = [text.replace(f"[unit of {name}]", known) for text in notes] if known else notes
    drawn = svg(picture, "law_run", f"Run of the law. {told}")
    return Ran(tracked, drawn, f"{told} {holds}", tuple(notes), units)
