"""Offsets between records, or across a gap: what a sensor that was moved does, and a play that never moves imitates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ...data.evidence.several import rests
from ...data.record import Record
from ...errors import FitError
from ..refit import Fitted, Split, settle
from ..settings import TURNS
from .verdict import price

Array = np.ndarray


def offsets_of(base: Fitted) -> tuple[Array, Fitted] | None:
    """Return the offset of each segment against the first [unit of y], and the base fitted without them.

    None where the base has no stable fit then.
    """
    parts = list(base.split.records)
    offsets, made = np.zeros(len(parts)), base
    for _ in range(TURNS):
        means = np.array([e[made.problem.depth :].mean() for e in made.errors])
        offsets = offsets + means - means[0]
        moved = [replace(r, y=r.y - d) for r, d in zip(parts, offsets, strict=True)]
        try:
            made = settle(made.model, Split.of(moved), made.model.theta, made.limits)
        except FitError:
            return None
    return offsets, made


def without_offsets(
    records: Sequence[Record], base: Fitted, best: Fitted, effects: int
) -> tuple[list[Record], list[str]] | None:
    """Return records without offsets between their segments, where these explain more than effects do, and what to say.

    Each offset costs what a parameter does, an effect what it costs in the table.

    Parameters
    ----------
    best : with the effects that would be named, of which there are so many
    """
    segments = [s for record in records for s in record.segments()]
    # An axis that integrates is cut further, and starts again at each cut: an offset is nothing of its own there. Where
    # the input only differs between segments it is a curve of the input.
    same = [len(s) for s in segments] == [len(s) for s in base.split.records] and not rests(segments)
    found = offsets_of(base) if same and len(segments) > 1 else None
    if found is None:
        return None
    offsets, level = found

    def paid(made: Fitted, parameters: int, count: int) -> float:
        return price(made.relative([~sealed for sealed in made.split.test]), parameters, count)

    size = len(level.model.symbols)
    if paid(level, size + offsets.size - 1, 0) >= paid(best, len(best.model.symbols), effects):
        return None
    moved, left = [], iter(offsets)
    for record in records:
        y = record.y.copy()
        for a, b in pairwise((0, *record.breaks, len(record))):
            y[a:b] -= next(left) if b - a > 1 else 0.0  # a single sample is no segment
        moved.append(replace(record, y=y))
    most = float(np.abs(offsets).max())
    where = "between the records" if len(records) > 1 else "across the gaps"
    return moved, [f"Offsets {where}, of up to {most:.3g}, explain more than an effect would: they are removed."]
