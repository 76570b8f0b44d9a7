"""Which base: each is fitted on some blocks and judged in free run on others, at one price per parameter.

A constant offset of the sensor is estimated for every base. A model with Sigma_y = 1 keeps what it starts from and
takes an offset along for nothing, while one that forgets its start would pay for it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from ...data.metrics import nrmse
from ...data.record import Record
from ...errors import NarxError
from ...models.model import Model
from ..evaluate import free_run

BASES = ("static", "linear", "narx", "play", "bouc-wen")
# Each is judged by itself: of a base with few parameters and one with many, the one that pays.
SIZES: dict[str, list[dict[str, Any]]] = {"play": [{"plays": n, "knots": m} for n in (2, 4, 10) for m in (1, 2, 4)]}
BLOCKS, HELD = 6, (1, 4)  # of one record, and which of them are held out
SHORT = 0.1  # of the longest part that is held out: a shorter one does not count
PRICE = 0.1  # of a parameter, in ln(mean square): it must buy 5 % of the rms error


@dataclass(frozen=True)
class Judged:
    """A base of some size: its free-run NRMSE on held-out samples, an offset aside, and the price of its parameters."""

    base: str
    error: float
    parameters: int
    size: Mapping[str, Any]

    @property
    def score(self) -> float:
        """ln(mean square) + 0.1 per parameter: the smallest is taken."""
        return 2 * math.log(max(self.error, 1e-12)) + PRICE * self.parameters

    def __str__(self) -> str:
        return f"{self.base} {self.error:.3g} with {self.parameters}"


def choose_base(
    records: Sequence[Record], identified: Callable[[str, list[Record], Mapping[str, Any]], Model]
) -> Model:
    """Identify every base, and return the best one, identified on all samples; `info.selection.reason` says why.

    Parameters
    ----------
    identified : function of the name of a base, the records and the size

    Raises
    ------
    NarxError
        What stopped the last base, where none follows the data.
    """
    train, held = _split(list(records))
    found: list[Judged] = []
    last: NarxError | None = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of bases that are not taken
        for base, size in ((name, size) for name in BASES for size in SIZES.get(name, [{}])):
            try:
                model = identified(base, train, size)
                error = _error(model, held)
            except NarxError as problem:
                last = problem
                continue
            if math.isfinite(error):
                found.append(Judged(base, error, len(model.symbols), size))
    if not found:
        raise last or NarxError("No base follows these data in free run.")
    ordered = {one.base: one for one in sorted(found, key=lambda one: -one.score)}  # the best size of each
    best, *others = sorted(ordered.values(), key=lambda one: one.score)
    model = identified(best.base, list(records), best.size)
    why = (
        f"{best} parameters has the best free run of {len(ordered)} base models in cross-validation, with a "
        f"penalty of {PRICE}"
    )
    why += " in ln(mean square) for each parameter"
    why += f", compared with {', '.join(map(str, others))}" if others else ""
    reason = f"{why}; {model.info.selection.reason}"
    return model.replace(
        info=replace(model.info, selection=replace(model.info.selection, base=best.base, reason=reason))
    )


def _error(model: Model, held: Sequence[tuple[Record, int]]) -> float:
    """Return the free-run NRMSE on what is held out: of each record the samples from a first one on."""
    runs = [free_run(model, record, align=True)[first:] for record, first in held]
    return nrmse(np.concatenate([r.y[first:] for r, first in held]), np.concatenate(runs))


def _split(records: list[Record]) -> tuple[list[Record], list[tuple[Record, int]]]:
    """Hold out the last record, or some blocks of the only one: what drifts slowly is then in both parts.

    No base is identified from a block in which nothing moves. Each block that is held out stands behind what was
    measured before it: where the input turned earlier is known, and a base that remembers it need not guess.

    Returns
    -------
    train : list of Record
    held : list of (Record, first sample that is judged)
    """
    if len(records) > 1:
        return records[:-1], _long([(s, 0) for s in records[-1].segments()])
    (record,), n = records, len(records[0])
    edges = [n * i // BLOCKS for i in range(BLOCKS + 1)]
    train, held = [], []
    for out, group in groupby(range(BLOCKS), key=HELD.__contains__):
        blocks = list(group)
        a, b = edges[blocks[0]], edges[blocks[-1] + 1]
        if out:
            held += _with_history(record, a, b)
        elif min(np.ptp(record.u[a:b]), np.ptp(record.y[a:b])) > 0:
            train.append(record[a:b])
    return train or records, _long(held)


def _with_history(record: Record, a: int, b: int) -> list[tuple[Record, int]]:
    """Return the contiguous pieces from row a to b, each behind as many rows before it, where they are contiguous."""
    breaks = (0, *record.breaks)
    inside = [a, *(i for i in breaks if a < i < b), b]
    pieces = [(p, q, max(p - (q - p), *(i for i in breaks if i <= p))) for p, q in pairwise(inside) if q - p >= 2]
    return [(record[begin:q], p - begin) for p, q, begin in pieces]


def _long(pieces: list[tuple[Record, int]]) -> list[tuple[Record, int]]:
    """Return the pieces that are long enough to be judged, beside the longest."""
    return [(s, first) for s, first in pieces if len(s) >= SHORT * max(len(r) for r, _ in pieces)]
