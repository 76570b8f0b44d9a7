"""The pictures that only the live page has: what was read, and a run of a law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...data.record import Record
from ...data.units import headed
from ...report.figures.describe import TIME, traces
from ...report.figures.still import draw, new_axes
from ...report.plots import plot_compensation
from ...report.svg import svg
from ...symbolic.numbers import sized
from ...tasks.compensate import Tracked


def signals_svg(record: Record, units: Mapping[str, str]) -> str:
    """Return input and output over time as an `<svg>` element."""
    figure, ax = new_axes(figsize=(8.8, 3.4))
    signals = (("u", "input", record.u), ("y", "recorded", record.y))
    draw(ax, *(traces(TIME, record.t, headed(n, units.get(n)), {"": (role, x)}) for n, role, x in signals))
    alt = f"Input from {record.u.min():.4g} to {record.u.max():.4g} and output from {record.y.min():.4g} to "
    return svg(figure, "preview", f"{alt}{record.y.max():.4g} over {record.t[-1] - record.t[0]:.4g} s.")


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
    unit = units.get("y", "")
    said = [
        f"{name} {sized(rms, unit)} rms, {sized(most, unit)} at most"
        if np.isfinite(rms)
        else f"{name} the model diverges"
        for name, (rms, most) in tracked.errors.items()
    ]
    (own, _), (plain, _) = tracked.errors.values()
    told = "" if own <= plain else "Do not use this law here: it follows the reference worse than a constant gain. "
    told += f"Error of the model's output against the reference: {'; '.join(said)}."
    holds = f"{tracked.holds[0].upper()}{tracked.holds[1:]}." if tracked.holds else "The input stays within its limits."
    outputs = {"with the law": tracked.y, "without": tracked.plain.y}
    picture = plot_compensation(tracked.t, tracked.r, tracked.m, outputs, dict(units), tracked.limits)
    notes = [*tracked.notes]
    for name, known in units.items():
        notes = [text.replace(f"[unit of {name}]", known) for text in notes] if known else notes
    drawn = svg(picture, "law_run", f"Run of the law. {told}")
    return Ran(tracked, drawn, f"{told} {holds}", tuple(notes), units)
