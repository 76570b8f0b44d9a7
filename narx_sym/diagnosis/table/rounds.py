"""The one table of hypotheses: filled by rounds of screening and fitting, read by the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice, product
from typing import Any

import numpy as np

from ...data.evidence.rate import MOST, means, working
from ...data.record import Record
from ...errors import FitError
from ...fit.identify import OPEN
from ...models.effects import Catalogue
from ...models.extend import Variant, variants
from ...models.model import Model
from ..directions import Linearised
from ..progress import ALONE, BASE, PAIRS, Course
from ..refit import Fitted, Split, settle
from .arx import resampled, zeroed
from .hypotheses import Core, Hypothesis, family_of, linear_in_signals, written
from .screening import Scored, linearised, screen, shortlist
from .search import Row, Search
from .verdict import ALIKE, PER_EFFECT, ROUNDING, cheapest, distinct, price

Array = np.ndarray
SMALLER = 1  # further cores of the best form of an effect that are fitted to the end
HALVES = 8  # effects of which it is asked what their directions promise beside them
PARTNERS, TOGETHER = 2, 5  # of these, how many may be half of a pair, and effects that are tried with each


class Table:
    """The hypotheses about records, at their working rate; models of them at the records' own rate.

    Attributes
    ----------
    search : Search
    factor : int
        Samples of the record that are one at the working rate.
    rounding : float
        Mean square, over the variance of y, of what arithmetic and the steps of a converter make: less says nothing.
        (These steps are the parameter `quantum` [unit of y].)
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
        self.given, self.records = given, list(records)
        self.channels, self.catalogue, self.seed, self.course = tuple(channels), catalogue, seed, course
        work, self.factor = working(self.records) if family_of(given) in OPEN else (self.records, 1)
        self.search = Search(given if self.factor == 1 else given.replace(Ts=work[0].Ts), work)
        self._screened: dict[Row, Scored] = {}
        self._cores: dict[tuple[tuple[Variant, ...], bool], list[Row]] = {}  # fitted beside every core
        self._tried: dict[tuple[Variant, ...], set[Core]] = {}  # cores that were fitted with these effects alone
        self._fitted: dict[Row, Fitted] = {}
        self._own: dict[Row, Fitted] = {}
        steps = quantum**2 / 12 / (float(np.var(np.concatenate([r.y for r in self.records]))) or 1.0)
        self.rounding = max(ROUNDING**2, steps * float(np.exp(ALIKE)))
        self.delay = delay
        if delay is None:
            begin = int(getattr(given, "delay", 0) or 0)
            near = {max(0, begin - 1), begin, begin + 1} if self.factor == 1 else {begin // self.factor}
            tried = {0, 1, 2, 3, *near}
        else:
            tried = {delay // self.factor, -(-delay // self.factor)}
            self.search.tunes = False
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

    def judge_alone(self, known: Row, effect: str) -> None:
        """Judge an effect of a pair by itself, which need not be worth its price."""
        for row in self.beside(known):
            if [v.id for v in row.beyond(known)] == [effect]:
                row.judged()

    def fitted(self, row: Row) -> Fitted:
        """Return a row as a fitted model at the working rate.

        Raises
        ------
        FitError
            Where its free run cannot be held on the training samples alone.
        """
        if row not in self._fitted:
            self._fitted[row] = _settled(row, self.search)
        return self._fitted[row]

    def screened(self, row: Row) -> Scored:
        """Return what the directions say at a row."""
        if row not in self._screened:
            self._screened[row] = screen(self.fitted(row), self.channels, self.catalogue, self.seed)
        return self._screened[row]

    def checked(self, row: Row) -> Scored:
        """Return what the directions say at a row at the records' own rate, where these are short enough.

        A mean over several samples follows no recursion of the same order: what that leaves is no effect.
        """
        if self.factor == 1 or sum(map(len, self.records)) > MOST:
            return self.screened(row)
        return screen(self.own(row), self.channels, self.catalogue, self.seed)

    # -- rounds ----------------------------------------------------------------------------------------------------

    def singles(self, base: Row) -> None:
        """Fit every effect beside the effects of a row, with every core; the best to the end."""
        self.course.reach(ALONE)
        kinds = [g for g in (True, False) if any(r.ids == base.ids and r.hypothesis.core.given == g for r in self.rows)]
        for turn, given in enumerate(kinds):
            bases = [r for r in self.rows if r.ids == base.ids and r.hypothesis.core.given == given]
            at = base if base in bases else next(filter(self.settles, sorted(bases, key=lambda r: r.price)), None)
            if at is None:
                continue
            line = linearised(self.fitted(at))
            taken = {(v.id, v.where) for v in base.hypothesis.effects}  # elsewhere the same effect may act again
            tried = [v for v in self._ways(line.model, given) if (v.id, v.where) not in taken]
            tell = partial(self._tell, base, ", with other orders" if turn else "", turn, len(kinds))
            self._fit(self._every_core(bases), {v: line.grid(v) for v in tried}, line, tell, base.price)

    def pairs(self, base: Row) -> None:
        """Fit pairs: the best effects, and what the directions show beside each of them."""
        self.course.reach(PAIRS)
        # What is half of a pair bends to what the other half does, in each fold otherwise: where it was fitted counts.
        alone = [r for r in self.rows if len(r.beyond(base)) == 1 and (np.isfinite(r.held) or not r.blocks.size)]
        listed = islice(filter(self.settles, distinct(cheapest(alone, by=lambda r: r.before_judged))), HALVES)
        for turn, first in enumerate(sorted(listed, key=self._promised)[:PARTNERS]):
            scored = self.screened(first)
            kind = "given" if first.hypothesis.core.given else self.search.family
            others = {v: s for v, s in shortlist(scored, kind).items() if v.id not in first.ids}
            tell = partial(self._tell, base, f", one of them {first.ids[-1]}", turn, PARTNERS)
            worth = cheapest(self.rows)[0].price + PER_EFFECT  # dearer ones neither win nor are taken for the winner
            self._fit(self._every_core([first]), others, scored.line, tell, worth, first)

    def _every_core(self, rows: list[Row]) -> list[Row]:
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

    def _ways(self, model: Model, given: bool) -> list[Variant]:
        """Return every way in which the catalogue's effects may act; what an open core has itself is none."""
        listed = list(variants(model, self.channels, self.catalogue))
        if given:
            return listed
        open_ones = dict.fromkeys(replace(v, lag=0) for v in listed)
        return [v for v in open_ones if not linear_in_signals(model, v)]

    def _fit(
        self, bases: Sequence[Row], shapes: Mapping[Variant, Any], line: Linearised, tell: Callable[[int, int], None],
        worth: float, first: Row | None = None,
    ) -> None:  # fmt: skip
        """Look at effects beside rows; fit each form in its best place with every core, the best core to the end.

        All effects, but beside the `first` one of a pair only a few; judged is what may cost less than `worth`. `tell`
        hears how many fits of how many are done.
        """
        search, looks, most = self.search, [], TOGETHER if first is not None else None
        count = len(shapes) + min(len({v.id for v in shapes}), most or len(shapes))

        def best(rows: Sequence[Row]) -> float:
            return rows[0].before_judged

        for done, (variant, points) in enumerate(shapes.items()):
            tell(done, count)
            search.limits[variant] = line.ranges(variant)
            looks.append(search.look(bases, variant, points, first))
            search.rest()
        places: dict[str, dict[str, list[Row]]] = {}
        for rows in sorted(filter(None, looks), key=best):
            added = rows[0].hypothesis.effects[-1]
            places.setdefault(added.id, {}).setdefault(added.effect.form, rows)
        chosen = [list(forms.values()) for forms in places.values()][:most]
        kept = [rows for forms in chosen for rows in forms]
        for rows in looks:
            if rows and rows not in kept:
                search.forget(rows[0].hypothesis)
        for done, forms in enumerate(chosen, count - len(chosen)):
            tell(done, count)
            closer = sorted((search.one_more(bases, rows) for rows in forms), key=best)
            for rows in closer:
                self._cores[rows[0].hypothesis.effects, rows[0].hypothesis.core.given] = rows
                search.finish(rows[0], worth=worth)
            for row in closer[0][1 : 1 + SMALLER]:
                search.finish(row, 15, worth)
            search.rest()
        tell(count, count)

    def _tell(self, base: Row, more: str, turn: int, turns: int, done: int, of: int) -> None:
        """Tell how far a round is, and what the best row so far does to the error of the base."""
        rows = [r for r in self.beside(base) if r.beyond(base) and r.held < base.held]
        if rows:
            best = min(rows, key=lambda r: r.price)
            names = " and ".join(v.id for v in best.beyond(base))
            verb = "remove" if len(best.beyond(base)) > 1 else "removes"
            self.course.found = f"{names} {verb} {100 * (1 - best.held / base.held):.0f} % of the squared error"
        self.course.say(more, done, of, turn, turns)

    # -- at the record's own rate ------------------------------------------------------------------------------------

    def own(self, row: Row) -> Fitted:
        """Return a row as a model fitted at the record's own rate, on the training samples.

        Raises
        ------
        FitError
            Where it cannot be held there.
        """
        if row not in self._own:
            self._own[row] = self.fitted(row) if self.factor == 1 and self._whole else self._refined(row)
        return self._own[row]

    def held(self, choose: Callable[[], tuple[Row, Row | None]]) -> tuple[Row, Row | None]:
        """Return the first base and winner that can both be held at both rates; others leave the table.

        So does a winner that is not worth its price at the records' own rate, or where fewer effects clearly cost
        less there. The core of what is cheaper than the base, with its delay, stands in the table without the
        effects too: what a delay explains they do not.
        """
        while True:
            base, best = choose()
            if best is not None and self._bare(base):
                continue
            lost = [r for r in (base, best) if r is not None and not self.holds(r)]
            if not lost and best is not None and not (self.worth(best, base) and self._needed(best, base)):
                lost = [best]
            if not lost:
                return base, best
            self.rows.remove(lost[0])

    def _needed(self, best: Row, base: Row) -> bool:
        """Whether no fewer effects, the cheapest of them, clearly cost less at the records' own rate."""
        rows = (r for r in cheapest(self.beside(base)) if 0 < len(r.beyond(base)) < len(best.beyond(base)))
        fewer = next(filter(self.holds, rows), None)
        return fewer is None or not self.worth(fewer, best, ALIKE)

    def _bare(self, base: Row) -> bool:
        """Put the cores of what is cheaper than a base, with their delays, into the table with its effects alone.

        False where all of them stand there.
        """
        effects = base.hypothesis.effects
        alone = [r for r in self.rows if r.hypothesis.effects == effects and not r.hypothesis.core.given]
        cheaper = {r.hypothesis.core: r for r in self.beside(base) if r.price < base.price}
        tried = {r.hypothesis.core for r in alone} | self._tried.setdefault(effects, set())
        found = []
        for core, row in cheaper.items():
            if alone and not core.given and core not in tried:
                self._tried[effects].add(core)
                x, n = alone[0].values.copy(), alone[0].frame.n_core
                x[:n] = row.values[:n]
                found.append(self.search.fitted(replace(alone[0].hypothesis, core=core), x, 40))
        self.rows.extend(r.judged() for r in found if r is not None)
        return any(r is not None for r in found)

    def worth(self, row: Row, base: Row, by: float = 0.0) -> bool:
        """Whether a row costs less than another, `by` so much, at the records' own rate, on all but sealed samples."""

        def paid(r: Row) -> float:
            return price(self._averaged(self.own(r)), r.parameters, r.count)

        return paid(row) + by < paid(base)

    def holds(self, row: Row) -> bool:
        """Whether the free run of a row can be held at the working rate and at the records' own."""
        return self.settles(row) and _settles(self.own, row)

    def settles(self, row: Row) -> bool:
        """Whether the free run of a row can be held on the training samples alone, at the working rate."""
        return _settles(self.fitted, row)

    @property
    def _whole(self) -> bool:
        return sum(map(len, self.search.records)) == sum(map(len, self.records))

    def _refined(self, row: Row) -> Fitted:
        """Fit a hypothesis again on every sample: the core from the data, effects from their shapes in the table."""
        core, D = row.hypothesis.core, self.factor
        segments = [s for r in self.records for s in r.segments()]
        fine = Search(self.given, segments, [(core.n_y, core.n_u)])
        fine.integrating, fine.swings, fine.leaks = core.integrating, self.search.swings, self.search.leaks
        fine.tunes = self.search.tunes
        for variant in row.hypothesis.effects:
            fine.limits[variant] = {p: (low / at, high / at) for (p, (low, high)), at in self._scaled(variant)}
        first = core.delay * D - D // 2
        delays: Sequence[int] = range(max(0, first), first + 2 * D, max(1, D // 3)) if D > 1 else [core.delay]
        if self.delay is not None and not core.given:
            delays = [self.delay]
        # From where it stands in the table; from the data too, where that leaves more than the table says.
        fits: list[Fitted] = []
        for fit in (self._rebuilt,) if core.given else (self._carried, self._rebuilt):
            found = [made for delay in delays if (made := fit(fine, row, delay)) is not None]
            if found:
                with suppress(FitError):
                    fits.append(_settled(fine.tuned(min(found, key=lambda r: r.fitted)), fine))
            if fits and min(map(self._averaged, fits)) < row.held * np.exp(ALIKE):
                break
        if not fits:
            raise FitError(f"{row.hypothesis} has no stable fit at the record's own rate.")
        return min(fits, key=self._averaged)

    def _averaged(self, made: Fitted) -> float:
        """Return the mean squared error over the variance of y, averaged as the records of the table are.

        What lies past the samples of a fit is left out: there a model may only go on as it did.
        """
        errors = [means(e[~m], self.factor) for e, m in zip(made.errors, made.split.test, strict=True)]
        return float(np.mean(np.concatenate(errors) ** 2)) / made.problem.spread**2

    def _scaled(self, variant: Variant) -> list[tuple[tuple[str, tuple[float, float]], int]]:
        """Return the limits of each shape parameter, and by what it shrinks at the own rate: a step per sample does."""
        speed = {p: variant.effect.scan[p].of == "speed" for p in variant.shape}
        return [((p, self.search.limits[variant][p]), self.factor if speed[p] else 1) for p in variant.shape]

    def _carried(self, fine: Search, row: Row, delay: int) -> Row | None:
        """Fit a hypothesis from its poles and effects in the table, at this rate."""
        core, effects = replace(row.hypothesis.core, delay=delay), row.hypothesis.effects
        frame, a = fine.frame(effects, False), resampled(row.a, self.factor)
        # What a sample adds to y is less at a higher rate; what follows the steps of a signal is not.
        with np.errstate(all="ignore"):  # without a decay there is no such step, and no fit from it
            step = 1 / self.factor if core.integrating else (1 - a.sum()) / (1 - row.a.sum())
        b = row.values[row.frame.used(row.hypothesis.core)][core.n_y :][: core.n_u + 1]
        begins = frame.beside(core, a), frame.placed(core, np.concatenate([a, step * zeroed(b, self.factor)]))
        starts = []
        for begin, inside in product(begins, (step, 1.0)):
            x = begin.copy()
            for variant, new, old in zip(effects, frame.added, row.frame.added, strict=True):
                x[new[0]] = row.values[old[0]] * (inside if variant.where in ("inside", "motion") else 1.0)
                x[new[1]] = self._shape(row, variant, old[1])
            starts.append(x)
        return fine.fitted(Hypothesis(core, effects), min(starts, key=lambda z: frame.error(z, core)), 40)

    def _rebuilt(self, fine: Search, row: Row, delay: int) -> Row | None:
        """Fit the core from the data, then one effect after the other from its shape in the table."""
        made = min(fine.cored([delay]), key=lambda r: r.fitted, default=None)
        for variant, (_, where) in zip(row.hypothesis.effects, row.frame.added, strict=True):
            if made is None:
                return None
            looks = fine.look([made], variant, [self._shape(row, variant, where)])
            made = fine.one_more([made], looks)[0] if looks else None
        return made

    def _shape(self, row: Row, variant: Variant, where: Sequence[int]) -> tuple[float, ...]:
        """Return the shape of an effect of a row at the records' own rate."""
        return tuple(float(row.values[i]) / at for i, (_, at) in zip(where, self._scaled(variant), strict=True))


def _settled(row: Row, search: Search) -> Fitted:
    """Fit a row of a search again, as a model and on its training samples, from where its free run begins."""
    core, frame = row.hypothesis.core, row.frame
    made, theta = written(row.hypothesis, search.given), np.array(frame.theta(row.values, core))
    return settle(made, Split.of(search.cut), theta, frame.limits(made), errors=frame.errors(row.values, core))


def _settles(fit: Callable[[Row], Fitted], row: Row) -> bool:
    try:
        fit(row)
    except FitError:
        return False
    return True
