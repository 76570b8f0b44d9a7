"""The verdict: a pure function of the table of hypotheses, the gate, and what the best of them leaves.

Errors are mean squares; a price is their logarithm plus what a hypothesis costs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

import numpy as np

from ..settings import ALIKE, ENOUGH, HELPS, LEFT, PER_EFFECT, PER_PARAMETER, ROUNDING, SAME, TEMPERATURE

VERDICTS = ("nothing_detectable", "named", "confused", "helps_but_incomplete", "outside_library", "closed_loop")


class Entry(Protocol):
    """What the verdict reads of a row of the table."""

    blocks: Any
    parameters: int

    @property
    def held(self) -> float:
        """Mean squared held-out error."""

    @property
    def before_judged(self) -> float:
        """The price of the error where it was fitted."""

    @property
    def count(self) -> int:
        """How many effects."""

    @property
    def charged(self) -> float:
        """How many effects it pays for."""

    @property
    def becomes(self) -> frozenset[str]:
        """Effects that one of its own is at a limit of its shape."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Which effects."""

    @property
    def price(self) -> float:
        """The one price."""


E = TypeVar("E", bound=Entry)


def price(error: float, parameters: float, effects: float) -> float:
    """Return the one price: ln(held-out mean square over the variance of y) and what parameters and effects cost."""
    return float(_log(error) + PER_PARAMETER * parameters + PER_EFFECT * effects)


def _log(error: Any) -> Any:
    """Return the logarithm of mean squares over the variance of y; what is below rounding is all the same."""
    return np.log(np.maximum(error, ROUNDING**2))


def cheapest(rows: Sequence[E], by: Callable[[E], Any] = lambda r: (r.price, r.parameters)) -> list[E]:
    """Return the cheapest row of each set of effects, cheapest first."""
    best: dict[tuple[str, ...], E] = {}
    for row in sorted(rows, key=by):
        best.setdefault(tuple(sorted(row.ids)), row)
    return list(best.values())


def distinct(rows: Sequence[E]) -> Iterator[E]:
    """Give rows, but none whose free run is that of one before: one effect may have two names along a record."""
    seen: list[E] = []
    for row in rows:
        if all(row.parameters != r.parameters or abs(row.before_judged - r.before_judged) > SAME for r in seen):
            seen.append(row)
            yield row


def winner(rows: Sequence[E], base: E) -> E | None:
    """Return the best hypothesis with a further effect, None where none is worth its price.

    Fewer effects that pay for fewer win where they remove most of what the best removes, and need fewer parameters.
    """
    listed = [r for r in cheapest(rows) if r.count > base.count and r.price < base.price]
    if not listed:
        return None
    rms = {id(r): float(np.sqrt(r.held)) for r in (base, *listed)}
    most = rms[id(base)] - rms[id(listed[0])]
    room = listed[0].parameters if len(listed[0].ids) > len(base.ids) else np.inf
    for count in sorted({r.count for r in listed if r.count < listed[0].count}):
        fewer = next((r for r in listed if r.count == count and r.charged < listed[0].charged), None)
        if fewer is not None and fewer.parameters < room and rms[id(base)] - rms[id(fewer)] >= ENOUGH * most:
            return fewer
    return listed[0]


def rivals(rows: Sequence[E], best: E, dearer: float = PER_EFFECT) -> Iterator[E]:
    """Give what may be taken for the best: of as many effects or none more, and no dearer than by so much.

    What becomes the best at a limit, and needs more parameters, is none: no data could ever speak against it.
    """
    for row in cheapest(rows):
        wider = row.parameters > best.parameters and set(best.ids) <= {*row.ids, *row.becomes}
        other = set(row.ids) != set(best.ids) and not wider
        if other and row.count <= best.count and row.price - best.price <= dearer:
            yield row


def alike(rows: Sequence[E], best: E, coarse: float = ALIKE) -> list[E]:
    """Return the hypotheses that these data cannot tell from the best, the best first.

    Of the rivals what is no worse than by the scatter of the blocks, or by `ALIKE`: in their errors, whatever it costs,
    or in its price, whatever its error. Where the best leaves less than that of its error, `coarse`, a smaller
    difference says something: from twice its standard error on.
    """
    found = [best]
    for row in rivals(rows, best):
        gap = _log(row.blocks) - _log(best.blocks)
        gap = gap[np.isfinite(gap)]
        if gap.size:
            scatter = gap.std() / np.sqrt(gap.size)
            none = max(scatter, min(ALIKE, max(coarse, 2 * scatter)))
            found += [row] if min(gap.mean(), row.price - best.price) <= none else []
    return found


def probabilities(rows: Sequence[E], base: E, more: int = 1) -> dict[tuple[str, ...], float]:
    """Return how probable each set of effects is, of the base and of those with up to so many `more`, base included.

    A price is a log loss per block: ln P(h | data) = -(blocks / 2) price(h) / TEMPERATURE + constant, with one
    temperature for all (Guo et al. 2017). What is at its limit another hypothesis adds nothing to that.
    """
    listed = [r for r in cheapest(rows) if r.count <= base.count + more and np.isfinite(r.price)]
    found = weighed([r.price for r in listed], [len(r.blocks) for r in listed])
    return {tuple(sorted(r.ids)): float(p) for r, p in zip(listed, found, strict=True)}


def weighed(prices: Sequence[float], blocks: Sequence[int], temperature: float = TEMPERATURE) -> Any:
    """Return the probabilities of hypotheses with some prices, each judged on so many blocks: an array."""
    depth = -np.array(blocks) / 2 * np.array(prices) / temperature
    weights = np.exp(depth - depth.max(initial=-np.inf))
    return weights / weights.sum()


def explained(removed: Any, base: E, lowest: float) -> Any:
    """Return which share of the removable error of a base is `removed`; no hypothesis goes below `lowest`."""
    return removed / max(base.held - lowest, 1e-300)


def removes(row: E, base: E, left: float) -> float:
    """Return the share of the removable error of a base that a row removes, of whose own error a share is left."""
    return float(explained(base.held - row.held, base, row.held * (1 - left)))


def nothing_named(structure: float, removed: float) -> str:
    """Return the verdict where no effect is worth its price.

    Parameters
    ----------
    structure : share of the base's error that follows from the signals
    removed : share of it that the best effect removes all the same: what is in the catalogue is not outside it
    """
    return "outside_library" if structure - removed > HELPS else "nothing_detectable"


def verdict(share: float, left: float, names: int) -> str:
    """Return the verdict where an effect is worth its price.

    Parameters
    ----------
    share : of the removable error, that the winner removes
    left : share of the winner's error that still follows from the signals
    names : how many hypotheses cannot be told apart
    """
    if share < HELPS:
        return "outside_library"
    if left > LEFT and share < 1 - LEFT**2:  # shares are of mean squares: a tenth of the rms that was removable
        return "helps_but_incomplete"
    return "confused" if names > 1 else "named"
