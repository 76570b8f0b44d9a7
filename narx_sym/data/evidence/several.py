"""Several records together: what is said of them, once each, and which of them move."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..record import Record


def told_once(records: Sequence[Record], said: Callable[[Record], Iterable[str]]) -> dict[str, list[str]]:
    """Return what is said of records, each text with the names of the records that it is said of."""
    names: dict[str, list[str]] = {}
    for record in records:
        for text in said(record):
            names.setdefault(text, []).append(record.name)
    return names


def moving(records: Sequence[Record], signal: str = "y") -> list[Record]:
    """Return the records in which a signal moves: an error at rest has nothing to be compared with. All, if none."""
    return [r for r in records if np.ptp(r.signals[signal]) > 0] or list(records)


def rests(records: Iterable[Record]) -> bool:
    """Whether the input moves in none of some records: each is the answer to a step at its beginning."""
    return all(np.ptp(r.u) == 0 for r in records)
