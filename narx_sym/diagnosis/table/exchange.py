"""What stands in place of an effect that was named: it may have imitated another one, or two."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..settings import ALIKE, LEFT, PER_EFFECT, RIVALS
from .hypotheses import Hypothesis
from .row import Row
from .verdict import alike, cheapest

if TYPE_CHECKING:
    from .rounds import Table


def instead(table: Table, best: Row | None, known: Row) -> tuple[Row, Row | None, list[str]]:
    """Return base and winner without an effect that was added before, or with another one for it, and what is gone.

    Where that costs less: what was named first may have imitated what is new now, or stood for two others.
    """
    if not known.ids or (best is not None and len(best.beyond(known)) > 1):
        return known, best, []
    base, made = known, best
    if best is not None:
        base, made = min([(known, best), *_beside_less(table, best, known)], key=lambda found: found[1].price)
    at, other = table.held(lambda: _others(table, made, known) or (known, None))
    base, made = (base, made) if other is None else (at, other)
    return base, made, [name for name in known.ids if name not in base.ids]


def _beside_less(table: Table, best: Row, known: Row) -> Iterator[tuple[Row, Row]]:
    """Give what is new beside rows that lack one effect of a base, or have another one for it."""
    new = best.beyond(known)
    without = [r for r in table.rows if new[0].id not in r.ids]
    listed = cheapest([r for r in without if r.hypothesis.core.given == best.hypothesis.core.given])
    for old in known.hypothesis.effects:
        rest = set(known.ids) - {old.id}
        fewer = [r for r in listed if set(r.ids) == rest]
        others = [r for r in listed if rest <= set(r.ids) and len(r.ids) == len(known.ids) and old.id not in r.ids]
        near = [r for r in others if r.price <= known.price + 2 * PER_EFFECT]
        for row in filter(table.holds, fewer + near[:RIVALS]):
            table.search.added(row, new[0], best)
            both = [r for r in table.rows if r.ids == (*row.ids, new[0].id)]  # one of a pair was fitted before
            yield from ((row, r) for r in cheapest(both)[:1] if np.isfinite(r.price) and table.holds(r))


def _others(table: Table, best: Row | None, known: Row) -> tuple[Row, Row] | None:
    """Return the cheapest row with one effect more than another, but not all of its effects, and what it stands on.

    None where it costs more than what is found, or where these data cannot tell it from the one with fewer.
    """
    rows = [r for r in table.rows if r.hypothesis.core.given == known.hypothesis.core.given and r.blocks.size]
    size, worth = len(known.ids) + 1, (known if best is None else best).price
    other = [r for r in rows if len(r.ids) == size and not set(known.ids) <= set(r.ids) and r.price < worth]
    for row in cheapest(other)[:1]:
        bases = cheapest([r for r in rows if r.ids == row.ids[:-1]])
        if bases and known not in alike([known, row], row):
            return bases[0], row
    return None


def exchanged(table: Table, known: Row) -> None:
    """Fit either half of the cheapest pair with other effects beside it: what was named may have stood for another.

    With every other one where the pair leaves something, else with those that cost no more than what they replace.
    """
    pairs = (r for r in cheapest(table.beside(known)) if len(r.beyond(known)) == 2)
    best = next(filter(table.holds, pairs), None)
    if best is None:
        return
    best_of: dict[Hypothesis, Row] = {}
    for row in sorted(table.beside(known), key=lambda r: r.before_judged):
        if len(row.beyond(known)) == 1 and row.before_judged < known.before_judged:
            best_of.setdefault(row.hypothesis, row)
    alone = list(best_of.values())
    if table.left(best, known) <= LEFT:
        worth = max((r.before_judged for r in cheapest(alone) if r.ids[-1] in best.ids), default=-np.inf)
        alone = [r for r in alone if r.before_judged <= worth + ALIKE]
    first, second = best.beyond(known)
    firsts = [r for r in alone if r.hypothesis.effects[-1] == first][:1]
    for row in (r for r in alone if r.ids[-1] not in best.ids):
        for half, variant, like in ((row, second, best), *((r, row.hypothesis.effects[-1], row) for r in firsts)):
            table.search.added(half, variant, like, best.price + PER_EFFECT)
