"""The one table of hypotheses: filled by rounds of screening and fitting, read by the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from ...data.evidence.levels import one_step, turning
from ...data.evidence.rate import MOST, working
from ...data.record import Record
from ...errors import FitError
from ...fit.identify import OPEN
from ...models.effects import Catalogue
from ...models.extend import Variant
from ...models.model import Model
from ..progress import ALONE, BASE, PAIRS, Course
from ..refit import Fitted
from ..screening.directions import Linearised
from ..screening.scored import Scored, screen, shortlist
from ..settings import ALIKE, FIRST, LEFT, PARTNERS, PER_EFFECT, ROUNDING, STEPS, TOGETHER, TRIED
from .finer import Finer, idle, settled, settles
from .hypotheses import Core, family_of, ways, written
from .row import Row, leading, so_far
from .search import Search
from .verdict import cheapest, distinct, price, removes, rivals, verdict


class Table:
    """The hypotheses about records, at their working rate; models of them at the records' own rate.

    Attributes
    ----------
    search : Search
    factor : int
        Samples of the record that are one at the working rate.
    rounding : float
        Mean square, over the variance of y, of what arithmetic and a converter's steps (`quantum` [unit of y]) make.
    """

    def __init__(
        self,
        given: Model,
        records: Sequence[Record],
        channels: Sequence[str],
        catalogue: Catalogue,
        seed: int,
        course: Course,
        delay: int | None = None,
        quantum: float = 0.0,
    ):
        self.records = list(records)
        self.channels, self.catalogue, self.seed, self.course = tuple(channels), catalogue, seed, course
        work, self.factor = working(self.records) if family_of(given) in OPEN else (self.records, 1)
        self.search = Search(given if self.factor == 1 else given.replace(Ts=work[0].Ts), work)
        self.search.tried = set(catalogue)
        self.chosen = given.info.selection.base in OPEN  # a core that is given with chosen lags
        self._screened: dict[Fitted, Scored] = {}
        self._cores: dict[tuple[tuple[Variant, ...], bool], list[Row]] = {}  # fitted beside every core
        self._lost: set[tuple[tuple[Variant, ...], Core]] = set()  # cores of effects that left the table
        self._fitted: dict[Row, Fitted] = {}
        self._own: dict[Row, Fitted] = {}
        steps = quantum**2 / 12 / (float(np.var(np.concatenate([r.y for r in self.records]))) or 1.0)
        self.rounding = max(ROUNDING**2, steps * float(np.exp(ALIKE)))
        self.turning, self.one_step = turning(self.records), one_step(self.records)
        if delay is None:
            near = range(max(0, given.delay - 1), given.delay + 2) if self.factor == 1 else [given.delay // self.factor]
            tried = {0, 1, 2, 3, *near}
        else:
            tried = {delay // self.factor, -(-delay // self.factor)}
            self.search.tunes = False
        self.finer = Finer(given, self.records, self.search, self.factor, delay)
        course.reach(BASE)
        rows = self.search.bases(sorted(tried))
        ordered = sorted(rows, key=lambda r: (not r.hypothesis.core.given, r.more, r.price))
        held = next(filter(self.holds, ordered), None)
        if held is None:
            raise FitError("The base model cannot follow these data in free run: choose another base.")
        self.base = held

    @property
    def rows(self) -> list[Row]:
        """All hypotheses that were fitted to the end."""
        return self.search.rows

    def beside(self, known: Row) -> list[Row]:
        """Return the rows that have all effects of another."""
        return [r for r in self.rows if set(known.ids) <= set(r.ids)]

    def nearest(self, known: Row, count: int, most: int) -> list[Row]:
        """Return those of the cheapest hypotheses with so many effects more that lessen the error."""
        near = cheapest(self.beside(known), by=lambda r: r.before_judged)
        near = [r for r in near if len(r.beyond(known)) == count]
        return [r for r in near[:most] if r.judged().held < known.held]

    def fitted(self, row: Row) -> Fitted:
        """Return a row as a fitted model at the working rate.

        Raises
        ------
        FitError
            Where its free run cannot be held on the training samples alone.
        """
        if row not in self._fitted:
            self._fitted[row] = settled(row, self.search)
        return self._fitted[row]

    def screened(self, row: Row) -> Scored:
        """Return what the directions say at a row."""
        return self._scored(self.fitted(row))

    def _scored(self, fitted: Fitted) -> Scored:
        if fitted not in self._screened:
            self._screened[fitted] = screen(fitted, self.channels, self.catalogue, self.seed)
        return self._screened[fitted]

    def checked(self, row: Row) -> Scored:
        """Return what the directions say at a row at the records' own rate, where these are short enough.

        A mean over several samples follows no recursion of the same order: what that leaves is no effect.
        """
        if self.factor == 1 or sum(map(len, self.records)) > MOST:
            return self.screened(row)
        return self._scored(self.own(row))

    def left(self, row: Row, base: Row) -> float:
        """Return the share of a row's error that follows from the signals.

        Where that says that more is missing than a row adds to a base, the records' own rate must say so too: what only
        a mean over several samples leaves is not missing.
        """
        left = self.screened(row).missing
        if verdict(removes(row, base, left), left, 1) == "helps_but_incomplete":
            checked = self.checked(row).missing
            left = checked if checked <= LEFT else left
        return left

    # -- rounds ----------------------------------------------------------------------------------------------------

    def singles(self, base: Row) -> None:
        """Fit every effect beside the effects of a row, with every core; the best to the end."""
        self.course.reach(ALONE)
        kinds = [given for given in (True, False) if self.bases(base, given)]
        for turn, given in enumerate(kinds):
            bases = self.bases(base, given)
            at = base if base in bases else next(filter(self.settles, sorted(bases, key=lambda r: r.price)), None)
            if at is None:
                continue
            scored = self.screened(at)
            taken = {(v.id, v.where, v.at) for v in base.hypothesis.effects}  # elsewhere the same effect may act again
            largest = max((r.hypothesis for r in bases), key=lambda h: (h.core.n_y, h.core.n_u))
            listed = ways(written(largest, self.search.given), given, self.channels, self.catalogue, lags=self.chosen)
            worth = shortlist(scored, "given" if given else self.search.family)
            # Where they act, and in which form, a direction does not tell; nor of what has none at this core.
            ids = dict.fromkeys(v.id for v in worth)
            seen = {d.variant.id for d in scored.directions}
            ids |= dict.fromkeys(v.id for v in listed if v.id not in seen)
            new = [v for v in listed if v.id in ids and (v.id, v.where, v.at) not in taken and self._may_show(v)]
            first = {name: i for i, name in enumerate(ids)}  # what explains most
            tried = {v: worth.get(v) or scored.line.grid(v) for v in sorted(new, key=lambda v: first[v.id])}
            tell = partial(self._tell, base, ", with other orders" if turn else "", turn, len(kinds))
            starts = self.every_core(bases) + ([] if given or base.ids else self.search.withheld)
            self._fit(starts, tried, scored.line, tell, base.price)

    def asked(
        self, few: Catalogue, bases: list[Row], best: Row, said: str, worth: float, base: Row, first: Row | None = None
    ) -> bool:
        """Fit a few effects beside rows with every core; return whether there are any."""
        if self.course.enough:
            return False
        given = best.hypothesis.core.given
        bare = written(replace(best.hypothesis, effects=bases[0].hypothesis.effects), self.search.given)
        line, tell = self.screened(best).line, partial(self._tell, base, said, 0, 1)
        listed = ways(bare, given, self.channels, few, any(e.closer for e in few.all()), self.chosen)
        shapes = {v: line.grid(v) for v in listed if self._may_show(v)}
        self._fit(self.every_core(bases), shapes, line, tell, worth, first)
        return bool(shapes)

    def complete(self, best: Row, base: Row) -> Row:
        """Return the effects of a winner in their cheapest forms that leave nothing: what is left costs one more."""
        forms: dict[tuple[Variant, ...], Row] = {}
        for row in sorted((r for r in self.rows if r.ids == best.ids), key=lambda r: r.price):
            forms.setdefault(row.hypothesis.effects, row)
        near = (r for r in forms.values() if r.price <= best.price + PER_EFFECT and self.holds(r))
        return next((r for r in near if self.left(r, base) <= LEFT and self._shows(r, base)), best)

    def pairs(self, base: Row) -> None:
        """Fit pairs: the best effects, and what the directions show beside each of them."""
        self.course.reach(PAIRS)
        if self.course.enough:
            return
        # What is half of a pair bends to what the other half does, in each fold otherwise: where it was fitted counts.
        # A share that is whole alone need not be so beside another effect.
        alone = [r for r in self.rows if len(r.beyond(base)) == 1 and not r.frame.pinned]
        alone = [r for r in alone if np.isfinite(r.held) or not r.blocks.size]
        listed = islice(filter(self.settles, distinct(cheapest(alone, by=lambda r: r.before_judged))), TRIED)
        for turn, first in enumerate(sorted(listed, key=self._promised)[:PARTNERS]):
            scored = self.screened(first)
            kind = "given" if first.hypothesis.core.given else self.search.family
            others = {v: s for v, s in shortlist(scored, kind).items() if v.id not in first.ids and self._may_show(v)}
            tell = partial(self._tell, base, f", one of them {first.ids[-1]}", turn, PARTNERS)
            worth = cheapest(self.rows)[0].price + PER_EFFECT  # dearer ones neither win nor are taken for the winner
            self._fit(self.every_core([first]), others, scored.line, tell, worth, first)

    def bases(self, base: Row, given: bool) -> list[Row]:
        """Return the rows with the effects of another around the given model, or around open cores."""
        return [r for r in self.rows if r.ids == base.ids and r.hypothesis.core.given == given]

    def every_core(self, rows: list[Row]) -> list[Row]:
        """Return rows, and behind them their effects as they were fitted with the other cores."""
        had = {(r.hypothesis.effects, r.size) for r in rows}
        sets = dict.fromkeys((r.hypothesis.effects, r.hypothesis.core.given) for r in rows)
        more = [r for key in sets for r in self._cores.get(key, [])]
        return rows + [r for r in more if (r.hypothesis.effects, r.size) not in had]

    def _promised(self, first: Row) -> float:
        """Return the price of a row where a further effect removes what its direction promises."""
        scored = self.screened(first)
        promised = zip(scored.directions, scored.shares, strict=True)
        best = max((float(share) for d, share in promised if d.variant.id not in first.ids), default=0.0)
        return first.before_judged + float(np.log(max(1.0 - best, ROUNDING)))

    def _may_show(self, variant: Variant) -> bool:
        """Whether these data can show an effect: what remembers where its driver turned needs a turn."""
        driver = {variant.at} if variant.at else variant.driver
        return not variant.effect.turning or not self.turning.isdisjoint(driver)

    def _fit(
        self, bases: Sequence[Row], shapes: Mapping[Variant, Any], line: Linearised, tell: Callable[[int, int], None],
        worth: float, first: Row | None = None,
    ) -> None:  # fmt: skip
        """Look at effects beside rows, closer at the best few: each form in its best place, its best core to the end.

        Judged is what may cost less than `worth`; `first` is the effect that stands, of a pair.
        """
        search, looks = self.search, []
        count = len(shapes) + TOGETHER
        for done, (variant, points) in enumerate(shapes.items()):
            tell(done, count)
            if self.course.enough:
                break
            search.limits[variant] = line.ranges(variant)
            looks.append(search.look(bases, variant, points, first))
            search.rest()
        places: dict[str, dict[str, list[list[Row]]]] = {}
        for rows in sorted(filter(None, looks), key=leading):
            added = rows[0].hypothesis.effects[-1]
            places.setdefault(added.id, {}).setdefault(added.effect.form, []).append(rows)
        # A brief look may have been too brief for what the directions promise most of.
        promised = [name for name in dict.fromkeys(v.id for v in shapes) if name in places][: TOGETHER // 2]
        chosen = [list(places[name].values()) for name in dict.fromkeys([*list(places)[:TOGETHER], *promised])]
        kept = [rows for forms in chosen for form in forms for rows in form]
        for rows in looks:
            if rows and rows not in kept:
                search.forget(rows[0].hypothesis)
        for done, forms in enumerate(chosen, len(shapes)):
            tell(min(done, count), count)
            if self.course.enough:
                break
            closer = sorted((self._placed(bases, form) for form in forms), key=leading)
            for rows in closer:
                self._cores[rows[0].hypothesis.effects, rows[0].hypothesis.core.given] = rows
                search.finish(rows[0], worth=worth)
            for row in closer[0][1:2]:
                search.finish(row, FIRST, worth)
            search.rest()
        tell(count, count)

    def _placed(self, bases: Sequence[Row], places: Sequence[Sequence[Row]]) -> list[Row]:
        """Return a form of an effect in its best place, with every core: a brief look does not tell which that is."""
        closer = [self.search.one_more(bases, looks) for looks in places]
        if len(closer) > 1:
            for rows in closer:
                rows[0] = self.search.fitted(rows[0].hypothesis, rows[0].values, STEPS) or rows[0]
            closer.sort(key=leading)
        for rows in closer[1:]:
            self.search.forget(rows[0].hypothesis)
        return closer[0]

    def _tell(self, base: Row, more: str, turn: int, turns: int, done: int, of: int) -> None:
        """Tell how far a round is, and what the best row so far does to the error of the base."""
        self.course.say(more, done, of, turn, turns, lambda: so_far(self.beside(base), base))

    # -- at the record's own rate ------------------------------------------------------------------------------------

    @property
    def same_rate(self) -> bool:
        """Whether the table is of every sample of the records."""
        return self.factor == 1 and sum(map(len, self.search.records)) == sum(map(len, self.records))

    def own(self, row: Row) -> Fitted:
        """Return a row as a model fitted at the record's own rate, on the training samples.

        Raises
        ------
        FitError
            Where it cannot be held there.
        """
        if row not in self._own:
            self._own[row] = self.fitted(row) if self.same_rate else self.finer.fitted(row)
        return self._own[row]

    def held(self, choose: Callable[[], tuple[Row, Row | None]]) -> tuple[Row, Row | None]:
        """Return the first base and winner that can both be held at both rates; others leave the table.

        So does a winner that is not worth its price at the records' own rate, that raises the error on samples that
        were held out there, or where fewer effects clearly cost less.
        """
        while True:
            base, best = choose()
            lost = [r for r in (base, best) if r is not None and not self.holds(r)]
            if not lost and best is not None and not self._shows(best, base):
                lost = [best]
            if not lost:
                return base, best
            self.rows[:] = [r for r in self.rows if r.hypothesis != lost[0].hypothesis]
            self._instead(lost[0])

    def _instead(self, lost: Row) -> None:
        """Fit the effects of a row that could not be held with their next core, where no other row has them."""
        effects, given = lost.hypothesis.effects, lost.hypothesis.core.given
        self._lost.add((effects, lost.size))
        if not self.holds(lost) and all(r.ids != lost.ids for r in self.rows):
            for row in [r for r in self._cores.get((effects, given), []) if (effects, r.size) not in self._lost][:1]:
                self.search.finish(row)

    def _shows(self, best: Row, base: Row) -> bool:
        """Whether a winner is one at the records' own rate too, and the error that is shown does not rise."""
        before, after = (f.mean_square(f.split.held) for f in (self.own(base), self.own(best)))
        return after <= before and self.worth(best, base) and self._needed(best, base)

    def _needed(self, best: Row, base: Row) -> bool:
        """Whether no other effects clearly cost less at the records' own rate: the cheapest of fewer or as many."""
        size = len(best.beyond(base))
        others = [r for r in cheapest(self.beside(base)) if r.beyond(base) and set(r.ids) != set(best.ids)]
        fewer = filter(self.holds, (r for r in others if len(r.beyond(base)) < size))
        same = filter(self.holds, (r for r in others if len(r.beyond(base)) == size))
        asked = ((next(fewer, None), ALIKE), (next(same, None), PER_EFFECT))
        return not any(row is not None and self.worth(row, best, by) for row, by in asked)

    def unsure(self, found: list[Row], rows: Sequence[Row]) -> list[Row]:
        """Return what cannot be told from the best, the first one found, with what costs less at the records' own rate.

        A fit at the working rate may have missed a minimum. It is asked where nothing else is a rival.
        """
        best = found[0]
        missed = (r for r in rivals(rows, best, 2 * PER_EFFECT) if self.holds(r) and self.worth(r, best))
        return found if len(found) > 1 else [best, *missed]

    def worth(self, row: Row, base: Row, by: float = 0.0) -> bool:
        """Whether a row costs less than another, `by` so much, at the records' own rate, on all but sealed samples."""

        def paid(r: Row) -> float:
            return price(self.finer.averaged(self.own(r)), r.paid, r.charged)

        return paid(row) + by < paid(base)

    def exact(self, row: Row) -> bool:
        """Whether a row leaves no more than arithmetic and a converter do: a mean over samples leaves some itself."""
        own = self.own(row)
        return min(row.held, own.relative(own.split.held)) <= self.rounding

    def holds(self, row: Row) -> bool:
        """Whether the free run of a row can be held at the working rate and at the records' own, however long it is."""
        turns = not any(v.effect.turning for v in row.hypothesis.effects[-1:]) or row.goes_back
        stays = not (self.search.grows(row) or idle(row, self.search))
        return stays and turns and self.settles(row) and settles(self.own, row)

    def settles(self, row: Row) -> bool:
        """Whether the free run of a row can be held on the training samples alone, at the working rate."""
        return settles(self.fitted, row)
