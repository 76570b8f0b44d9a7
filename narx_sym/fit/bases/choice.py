"""Which base: each is fitted on some blocks and judged in free run on others, at one price per parameter."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from ...data.record import Record
from ...errors import NarxError
from ...models.model import Model
from ..alignment import aligned

BASES = ("static", "linear", "narx", "play", "bouc-wen")
BLOCKS, HELD = 6, (1, 4)  # of one record, and which of them are held out
START = 0.1  # of each block that is held out: there the start of the run is estimated
PRICE = 0.1  # of a parameter, in ln(mean square): it must buy 5 % of the rms error


@dataclass(frozen=True)
class Judged:
    """A base and what it is worth: its free-run NRMSE on held-out samples, and the price of its parameters."""

    base: str
    error: float
    parameters: int

    @property
    def score(self) -> float:
        """ln(mean square) + 0.1 per parameter: the smallest is taken."""
        return 2 * math.log(max(self.error, 1e-12)) + PRICE * self.parameters

    def __str__(self) -> str:
        return f"{self.base} {self.error:.3g} with {self.parameters}"


def choose_base(records: Sequence[Record], identified: Callable[[str, list[Record]], Model]) -> Model:
    """Identify every base, and return the best one, identified on all samples; `info.selection.reason` says why.

    Parameters
    ----------
    identified : function of the name of a base and the records

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
        for base in BASES:
            try:
                model = identified(base, train)
                first = START * min(len(s) * s.Ts for r in held for s in r.segments())
                error = aligned(model, held, first).started
            except NarxError as problem:
                last = problem
                continue
            if math.isfinite(error):
                found.append(Judged(base, error, len(model.symbols)))
    if not found:
        raise last or NarxError("No base follows these data in free run.")
    best, *others = sorted(found, key=lambda one: one.score)
    model = identified(best.base, list(records))
    why = f"{best} parameters has the best free run of {len(found)} bases on held-out samples, at a price of {PRICE}"
    why += " in ln(mean square) for each parameter"
    why += f", beside {', '.join(map(str, others))}" if others else ""
    reason = f"{why}; {model.info.selection.reason}"
    return model.replace(
        info=replace(model.info, selection=replace(model.info.selection, base=best.base, reason=reason))
    )


def _split(records: list[Record]) -> tuple[list[Record], list[Record]]:
    """Hold out the last record, or some blocks of the only one: what drifts slowly is then in both parts."""
    if len(records) > 1:
        return records[:-1], records[-1:]
    n = len(records[0])
    edges = [n * i // BLOCKS for i in range(BLOCKS + 1)]
    parts: tuple[list[Record], list[Record]] = ([], [])
    for held, group in groupby(range(BLOCKS), key=HELD.__contains__):
        blocks = list(group)
        parts[held].append(records[0][edges[blocks[0]] : edges[blocks[-1] + 1]])
    return parts
