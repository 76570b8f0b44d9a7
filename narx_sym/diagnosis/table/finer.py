"""Hypotheses of the table at the records' own rate, on every sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ...data.evidence.rate import means
from ...data.record import Record
from ...errors import FitError
from ...models.extend import Variant
from ...models.model import Model
from ..refit import Fitted, Split, settle
from ..settings import ALIKE, CLOSER, STEPS
from .hypotheses import Hypothesis, written
from .row import Row
from .search import Search
from .starts.arx import resampled, zeroed


@dataclass(frozen=True)
class Finer:
    """What carries rows of a table to the records' own rate.

    Attributes
    ----------
    given, records : the user's model, and all samples
    search : of the table, at its working rate
    factor : int
        Samples of the records that are one in the table.
    delay : int or None
        Where the user gave it [samples of the records].
    """

    given: Model
    records: Sequence[Record]
    search: Search
    factor: int
    delay: int | None

    def fitted(self, row: Row) -> Fitted:
        """Fit a hypothesis again on every sample: from where it stands in the table, or the core from the data.

        Raises
        ------
        FitError
            Where it has no stable fit there.
        """
        core, D = row.hypothesis.core, self.factor
        segments = [s for r in self.records for s in r.segments()]
        fine = Search(self.given, segments, [(core.n_y, core.n_u)])
        fine.further = tuple((n, d * D) for n, d in core.further)
        fine.integrating, fine.swings, fine.leaks = core.integrating, self.search.swings, self.search.leaks
        fine.tunes = self.search.tunes
        for variant in row.hypothesis.effects:
            limits = {p: (low / at, high / at) for (p, (low, high)), at in self._scaled(variant)}
            fine.limits[variant.finer(D)] = limits
        first = core.delay * D - D // 2
        delays: Sequence[int] = range(max(0, first), first + 2 * D, max(1, D // 3)) if D > 1 else [core.delay]
        if self.delay is not None:
            delays = [self.delay]
        # From where it stands in the table; from the data too, where that leaves more than the table says.
        fits: list[Fitted] = []
        for fit in (self._carried, self._rebuilt):
            found = [made for delay in delays if (made := fit(fine, row, delay)) is not None]
            if found:
                with suppress(FitError):
                    fits.append(settled(fine.tuned(min(found, key=lambda r: r.fitted)), fine))
            if fits and min(map(self.averaged, fits)) < row.held * np.exp(ALIKE):
                break
        if not fits:
            raise FitError(f"{row.hypothesis} has no stable fit at the sampling rate of the record.")
        return min(fits, key=self.averaged)

    def averaged(self, made: Fitted) -> float:
        """Return the mean squared error over the variance of y, averaged as the records of the table are.

        What lies past the samples of a fit is left out: there a model may only go on as it did.
        """
        errors = [means(e[~m], self.factor) for e, m in zip(made.errors, made.split.test, strict=True)]
        return float(np.mean(np.concatenate(errors) ** 2)) / made.problem.spread**2

    def _scaled(self, variant: Variant) -> list[tuple[tuple[str, tuple[float, float]], int]]:
        """Return the limits of each shape parameter, and by what it shrinks at the own rate.

        A step per sample does, but no step over a time.
        """
        speed = {p: variant.effect.scan[p].of == "speed" and not variant.counted for p in variant.shape}
        return [((p, self.search.limits[variant][p]), self.factor if speed[p] else 1) for p in variant.shape]

    def _carried(self, fine: Search, row: Row, delay: int) -> Row | None:
        """Fit a hypothesis from its poles and effects in the table, at this rate."""
        core = row.hypothesis.core.after(fine.delays(delay))
        effects = row.hypothesis.effects
        finer = tuple(v.finer(self.factor) for v in effects)
        frame, a = fine.frame(finer, False), resampled(row.a, self.factor)
        # What a sample adds to y is less at a higher rate; what follows the steps of a signal is not.
        with np.errstate(all="ignore"):  # without a decay there is no such step, and no fit from it
            step = 1 / self.factor if core.integrating else (1 - a.sum()) / (1 - row.a.sum())
        b, constant = np.split(row.values[row.frame.used(row.hypothesis.core)][core.n_y :][: core.b + 1], [core.b])
        b = np.concatenate([zeroed(each, self.factor) for each in b.reshape(-1, core.n_u)])
        begins = frame.beside(core, a), frame.placed(core, np.concatenate([a, step * b, step * constant]))
        starts = []
        for begin, inside in product(begins, (step, 1.0)):
            x = begin.copy()
            for variant, new, old in zip(effects, frame.added, row.frame.added, strict=True):
                x[new[0]] = row.values[old[0]] * (inside if variant.where in ("inside", "motion") else 1.0)
                x[new[1]] = self._shape(row, variant, old[1])
            starts.append(x)
        return fine.fitted(Hypothesis(core, finer), min(starts, key=lambda z: frame.error(z, core)), STEPS)

    def _rebuilt(self, fine: Search, row: Row, delay: int) -> Row | None:
        """Fit the core from the data, then one effect after the other from its shape in the table."""
        made = min(fine.cored(fine.cores([delay])), key=lambda r: r.fitted, default=None)
        for variant, (_, where) in zip(row.hypothesis.effects, row.frame.added, strict=True):
            if made is None:
                return None
            looks = fine.look([made], variant.finer(self.factor), [self._shape(row, variant, where)])
            made = fine.one_more([made], looks)[0] if looks else None
        return made

    def _shape(self, row: Row, variant: Variant, where: Sequence[int]) -> tuple[float, ...]:
        """Return the shape of an effect of a row at the records' own rate."""
        return tuple(float(row.values[i]) / at for i, (_, at) in zip(where, self._scaled(variant), strict=True))


def settled(row: Row, search: Search) -> Fitted:
    """Fit a row of a search again, as a model and on its training samples, from where its free run begins."""
    core, frame = row.hypothesis.core, row.frame
    made, theta = written(row.hypothesis, search.given), np.array(frame.theta(row.values, core))
    return settle(made, Split.of(search.cut), theta, frame.limits(made), errors=frame.errors(row.values, core))


def idle(row: Row, search: Search) -> bool:
    """Whether the core of a row does as well without its last effect, though its poles may not do so by themselves.

    Poles on the unit circle imitate a drift or a hum, and an effect that hardly acts is no excuse for them.
    """
    effects = row.hypothesis.effects
    if not effects or not search.runs_away(row):
        return False
    if row not in search.idle:
        bare = replace(row.hypothesis, effects=effects[:-1])
        problem = search.frame(bare.effects, False).problem
        x = np.pad(row.values[: problem.free], (0, problem.shifts))
        alone = search.fitted(bare, x, CLOSER, any_pole=True)
        search.idle[row] = alone is not None and alone.fitted <= np.exp(ALIKE) * row.fitted
    return search.idle[row]


def settles(fit: Callable[[Row], Fitted], row: Row) -> bool:
    """Whether a row has a stable fit, by a function that raises FitError where it has none."""
    try:
        fit(row)
    except FitError:
        return False
    return True
