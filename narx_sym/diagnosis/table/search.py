"""Every hypothesis is fitted in free run: orders, delay and effect are chosen together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...data.record import Record
from ...errors import FitError
from ...fit.bases.integrating import DRIVEN, at_one, lasting, slowest, slowest_seen
from ...fit.bases.judged import LITTLE
from ...fit.freerun import has_integrator
from ...fit.identify import FEWEST
from ...fit.simulate import parts
from ...models.extend import Variant, rubs
from ...models.model import Model
from ..settings import BLOCKS, BRIEF, CLOSER, FIRST, FORGOTTEN, FULL, GAIN, HIGHER, LOOK, LOOKS, NEAR, STEPS
from .frame import Frame
from .hypotheses import Core, Hypothesis, family_of, further, ladder, written
from .row import Row
from .starts.arx import arx_start
from .starts.restart import beginnings, whole
from .verdict import price

Array = np.ndarray


class Search:
    """The table of hypotheses over records at their working rate.

    Attributes
    ----------
    rows : list of Row
        The table; what cannot be worth its price is not judged.
    limits : of the shape parameters of each effect
    swings, leaks : bool
        Whether the input drives poles that hardly decay within the record: of a resonance, near 1.
    integrating : bool, whether the axis integrates: its free run is started again at block edges
    withheld : list of Row, starts of the cores that do not stand without an effect
    modes : int, poles of the cheapest core without an effect; infinite where none was looked for
    """

    def __init__(
        self, given: Model, records: Sequence[Record], sizes: Sequence[tuple[int, int]] | None = None, family: str = ""
    ):
        self.given, self.records, self.sizes = given, list(records), sizes
        self.family = family or family_of(given)
        self.limits: dict[Variant, Mapping[str, tuple[float, float]]] = {}
        self.frames: dict[Any, Frame] = {}
        self.rows: list[Row] = []
        self.higher: list[tuple[int, int]] = []
        self.idle: dict[Row, bool] = {}  # see `finer.idle`
        self.tried: set[str] = set()  # effects whose Taylor polynomials do not stand for them
        self.withheld: list[Row] = []
        self.integrating = self.family == "given" and has_integrator(given)
        self.swings = self.leaks = False
        self.modes: float = np.inf
        self.tunes = True  # whether delays are free
        self.further = further(given) if self.family != "given" else ()  # inputs, as late as they come
        self.slow = slowest_seen(self.records)

    # -- frames ----------------------------------------------------------------------------------------------------

    @property
    def pieces(self) -> int:
        """How often an integrating axis starts again: its free run cannot be held over a whole record.

        A piece brings its own start, so it has at least the samples that a structure is chosen from.
        """
        if not self.integrating:
            return 1
        return max(1, min(-(-BLOCKS // len(self.records)), min(map(len, self.records)) // FEWEST))

    @property
    def cut(self) -> list[Record]:
        """The records, in pieces where the axis integrates."""
        return [r[s] for r in self.records for s in parts(len(r), self.pieces)]

    def cores(self, delays: Sequence[int]) -> list[Core]:
        """Return the cores that are compared."""
        if self.sizes is not None:
            open_ones = [Core(a, b, d, self.integrating) for a, b in self.sizes for d in delays]
        else:
            open_ones = ladder(self.family, self.integrating, delays)
            open_ones += [Core(a, b, d, self.integrating) for a, b in self.higher for d in delays]
        return [c if c.given else replace(c, further=self.further) for c in open_ones]

    def delays(self, first: int) -> list[int]:
        """Return how late each input comes: the first one so many samples."""
        return [first, *(d for _, d in self.further)]

    @property
    def largest(self) -> Core | None:
        """The core that holds all open ones; None where there is none."""
        sizes = [c.at_once for c in self.cores([0]) if not c.given]
        most = {n: max(getattr(c, n) for c in sizes) for n in ("n_y", "n_u") if sizes}
        return replace(sizes[0], **most, integrating=False) if sizes else None

    def frame(self, effects: tuple[Variant, ...], given: bool) -> Frame:
        """Return the frame of a set of effects around the given model or around open cores, with their limits."""
        key = (effects, given, self.integrating)
        if key not in self.frames:
            made = Frame(self.given, None if given else self.largest, effects, self.records, self.pieces)
            made.limit([self.limits[v] for v in effects], FULL)
            self.frames[key] = made
        return self.frames[key]

    def forget(self, hypothesis: Hypothesis) -> None:
        """Let go of a frame: its derivatives along all records take memory."""
        self.frames.pop((hypothesis.effects, hypothesis.core.given, self.integrating), None)

    def rest(self) -> None:
        """Give the memory of all runs back: of a long record each frame needs much."""
        for frame in self.frames.values():
            frame.problem.rest()

    # -- without a further effect -----------------------------------------------------------------------------------

    def bases(self, delays: Sequence[int]) -> list[Row]:
        """Fit every core without an effect, with its best delay, and judge it; where the axis integrates, in pieces.

        Raises
        ------
        FitError
            Where no core follows the data.
        """
        every = [r.judged() for r in self.cored(self.cores(delays), any_pole=True)]
        away = [r for r in every if self.runs_away(r)]
        self.swings = any(slowest(r.a) < 1 and not at_one(r.a, self.slow) and self._driven(r, r.held) for r in away)
        found = self._staying(every)
        least = min((r.held for r in found), default=np.inf)
        near = sorted((r for r in away if at_one(r.a, self.slow)), key=lambda r: r.held)
        if near and least > DRIVEN * near[0].held and any(self._driven(r, r.held) for r in near):
            found = self._integrated(near[0], least, delays) or self._staying(every)
        if not found:
            raise FitError("The base model cannot follow these data in free run: choose another base.")
        found = self._climbed(found, delays)
        self.rows += found
        self.withheld = self._withheld(found, delays)
        self.modes = self._poles(min(found, key=lambda r: r.price).hypothesis.core)
        return found

    def _withheld(self, found: Sequence[Row], delays: Sequence[int]) -> list[Row]:
        """Return where the fits of those cores start that do not stand by themselves: beside an effect they may."""
        starts, stand = dict[Core, Row](), {r.size for r in found}
        for core in self.cores(delays):
            if core.given or core.at_once in stand:
                continue
            frame = self.frame((), core.given)
            x = self._start(core, frame)
            row = Row(Hypothesis(core), frame, x, frame.error(x, core), frame.parameters(core))
            if row.size not in starts or row.fitted < starts[row.size].fitted:
                starts[row.size] = row
        return list(starts.values())

    def _staying(self, rows: Sequence[Row]) -> list[Row]:
        return [r for r in rows if not self.runs_away(r)]

    def _integrated(self, near: Row, whole: float, delays: Sequence[int]) -> list[Row]:
        """Fit every core with a pole at 1, in pieces; return none where the axis does not integrate after all.

        It leaks where the pole that only is near 1 does better. And the pole at 1 stands for a drift where other cores
        leave little of the `whole` record, and pieces, each with a level of its own, are followed nearly as well
        without an input to that pole.
        """
        self.integrating = True
        found = [r.judged() for r in self.cored(self.cores(delays))]
        best = min(found, key=lambda r: r.held, default=None)
        if slowest(near.a) < 1 and (best is None or near.held <= best.held):
            self.leaks, self.swings = True, self.swings or lasting(near.a, self.slow)[1]
        elif best is not None and (whole >= LITTLE**2 or self._driven(best, best.held)):
            return found
        self.integrating = False
        return []

    def _climbed(self, found: list[Row], delays: Sequence[int]) -> list[Row]:
        """Fit larger cores too, while each is the cheapest or begins cheaper: a structure may have several resonances.

        Where no part of them does for the whole, only the start of a core of enough of them says so. A further
        resonance is priced as an effect: a free one also imitates a disturbance.
        """
        climbs, worth, frames = True, min(r.price for r in found), self.frames
        sizes: list[tuple[int, int]] = []
        for n in HIGHER if self.family == "linear" and self.sizes is None and not self.integrating else ():
            if not climbs and self._begins(Core(n, n, min(delays))) >= worth:
                continue
            self._grow([(n, n)])
            least = min((r.judged().price for r in self.cored([Core(n, n, d) for d in delays])), default=np.inf)
            climbs = least < worth
            if climbs:
                worth, sizes = least, [*sizes, (n, n)]
        self._grow(sizes)
        if not sizes:
            self.frames = frames
            return found
        return [r.judged() for r in self.cored(self.cores(delays))]

    def _begins(self, core: Core) -> float:
        """Return the price of a core where its fit begins."""
        frame = Frame(self.given, core, (), self.records)
        hypothesis = Hypothesis(core)
        return price(frame.error(self._start(core, frame), core), frame.parameters(core), self._more(hypothesis))

    def _grow(self, higher: list[tuple[int, int]]) -> None:
        """Let larger cores stand among the others: all frames hold the largest."""
        self.higher, self.frames = higher, {}

    def cored(self, cores: Sequence[Core], any_pole: bool = False) -> list[Row]:
        """Fit cores, each size with its best delay; not judged yet."""
        best: dict[Core, Row] = {}
        for core in cores:
            frame = self.frame((), core.given)
            row = self.fitted(Hypothesis(core), frame.near(self._start(core, frame), core), FIRST, any_pole)
            if row is not None and (row.size not in best or row.fitted < 0.999 * best[row.size].fitted):
                best[row.size] = row
        found = [self.fitted(r.hypothesis, r.values, STEPS, any_pole) or r for r in best.values()]
        return [self.tuned(r) for r in found] if self.further else found

    def _start(self, core: Core, frame: Frame) -> Array:
        """Return the point from which a core is fitted, (unknowns,)."""
        if core.given:
            return frame.placed(core, np.asarray(self.given.theta))
        guess = arx_start(frame.pieced, core)
        x = frame.placed(core, guess)
        return min((frame.beside(core, guess[: core.n_y]), x), key=lambda z: frame.error(z, core))

    def fitted(
        self, hypothesis: Hypothesis, x: Array, steps: int, any_pole: bool = False, gain: float = GAIN
    ) -> Row | None:
        """Fit one hypothesis from one start; None where it diverges, or integrates where the axis does not."""
        core = hypothesis.core
        frame = self.frame(hypothesis.effects, core.given)
        x, cost = frame.fit(x, core, steps, gain=gain)
        if not np.isfinite(cost):
            return None
        row = Row(hypothesis, frame, x, cost, frame.parameters(core), more=self._more(hypothesis))
        return row if any_pole or self._keeps(row) else None

    def _more(self, hypothesis: Hypothesis) -> int:
        """Return how much else a hypothesis has that is priced as an effect: see `Row.more`."""
        core, lags = hypothesis.core, sum(v.effect.lagged for v in hypothesis.effects)
        remembers = self.family == "static" and core.remembers
        resonances = max(0, (core.n_y - HIGHER[0]) // 2 + 1)
        return int(remembers + resonances + min(lags, max(0, self._poles(core) + lags - self.modes)))

    def _poles(self, core: Core) -> int:
        return self.given.n_y if core.given else core.n_y

    def runs_away(self, row: Row, a: Array | None = None) -> bool:
        """Whether a pole has moved to the unit circle, as far as the record tells: it imitates a drift, or a line.

        `a`, (n_y,), are the coefficients of older outputs; by default those of the core.
        """
        core, a = row.hypothesis.core, row.a if a is None else a
        if core.given or core.integrating or slowest(a) <= self.slow:
            return False
        near, swinging = lasting(a, self.slow)
        most = 1 / self.slow if self.leaks else 1.0  # where it leaks so slowly that it may as well grow
        return slowest(a) >= most or (near and not self.leaks) or (swinging and not self.swings)

    def grows(self, row: Row) -> bool:
        """Whether a pole beside that at 1 grows by more than the slowest one decays, and no effect holds it."""
        return row.hypothesis.core.integrating and not row.hypothesis.effects and slowest(row.a) > 1 / self.slow

    def _keeps(self, row: Row) -> bool:
        """Whether no pole has moved to the unit circle, or the effects hold what the input drives through it.

        What acts on the motion holds it; beside a core that forgets from sample to sample it is a play. What ends a way
        is met at rest: a force that ends where the input moves is a friction.
        """
        (core, effects), away = (row.hypothesis.core, row.hypothesis.effects), self.runs_away(row)
        motion = any(v.where == "motion" for v in effects)
        if row.expands & self.tried or not row.met_at_rest:
            return False
        if not away or not effects:
            return not (away or (motion and not core.given and slowest(row.a) < FORGOTTEN))
        ended = effects[-1].effect.at_rest and slowest(row.a) > 1 / self.slow  # between its ends it runs away
        held = (motion and not ended) or not self.runs_away(row, row.linearised)
        return held and self._driven(row, row.fitted)

    def _driven(self, row: Row, error: float) -> bool:
        """Whether the input drives the poles of a core that hardly decay; `error` is what is left with them."""
        return row.driven(self.cut, self.slow, error)

    # -- with one more effect -----------------------------------------------------------------------------------------

    def look(
        self, bases: Sequence[Row], variant: Variant, shapes: Sequence[Sequence[float]], best: Row | None = None
    ) -> list[Row]:
        """Fit an effect briefly: the first shape beside the smallest, the best or a middle, and the richest base.

        Others, spread over the list, beside that of the three where the first one was cheapest.
        """
        if not shapes:
            return []
        listed = sorted(bases, key=lambda r: r.parameters)
        few = {id(r): r for r in (listed[0], best or listed[len(listed) // 2], listed[-1])}
        looks = [(self._beside(base, variant, shapes[0], LOOK, brief=True), base) for base in few.values()]
        found = [(row, base) for row, base in looks if row is not None]
        at = min(found, key=lambda one: one[0].before_judged)[1] if found else listed[-1]
        spread = {round(i * (len(shapes) - 1) / (LOOKS - 1)) for i in range(1, LOOKS)} - {0}
        more = [self._beside(at, variant, shapes[i], LOOK, brief=True) for i in sorted(spread)]
        return self._cheapest([*(row for row, _ in found), *(row for row in more if row is not None)])

    def one_more(self, bases: Sequence[Row], looks: Sequence[Row]) -> list[Row]:
        """Fit an effect closer from the best shapes of `look`, where it looked and beside the cores next to the best.

        On to those next to a new best one, while that is cheaper.

        Returns
        -------
        list of Row
            The best of each core, cheapest first.
        """
        variant = looks[0].hypothesis.effects[-1]
        shapes = list(dict.fromkeys(r.shape for r in looks))[:2]
        by_core: dict[Core, Row] = {}
        for row in looks:
            by_core.setdefault(row.size, row)
        sizes, tried = {b.size for b in bases}, set[Core]()
        at, asked = looks[0].size, {r.size for r in looks}
        while True:
            asked |= {at, *(s for s in sizes if at.next_to(s, sizes))}
            near = [b for b in bases if b.size in asked - tried]
            if not near:
                break
            tried |= asked
            found = [self._beside(base, variant, shape, CLOSER) for base in near for shape in shapes]
            for row in self._cheapest([*(r for r in found if r is not None), *by_core.values()]):
                if row.size not in by_core or row.before_judged < by_core[row.size].before_judged:
                    by_core[row.size] = row
            best = self._cheapest(by_core.values())[0].size
            if best == at:
                break
            at = best
        return self._cheapest(by_core.values())

    def _cheapest(self, rows: Iterable[Row]) -> list[Row]:
        return sorted(rows, key=lambda r: r.before_judged)

    def _beside(
        self, base: Row, variant: Variant, shape: Sequence[float], steps: int, brief: bool = False
    ) -> Row | None:
        """Fit an effect beside what a row has, from one shape; None also where it would be another one there.

        A `brief` fit begins where it begins best, another one also where the base stands.
        """
        core = base.hypothesis.core
        if not core.given and not variant.beside(core.n_y):
            return None
        if variant.where == "friction" and not rubs(written(base.hypothesis, self.given)):
            return None
        hypothesis = replace(base.hypothesis, effects=(*base.hypothesis.effects, variant))
        frame = self.frame(hypothesis.effects, core.given)
        starts = beginnings(frame, base, shape)[-1 if brief else 0 :]
        found = [self.fitted(hypothesis, start, steps, gain=BRIEF) for start in starts]
        row = min((r for r in found if r is not None), key=lambda r: r.fitted, default=None)
        if row is not None:
            row.shape = tuple(shape)
        return row

    def added(self, row: Row, variant: Variant, like: Row, worth: float = np.inf) -> Row | None:
        """Fit an effect beside what a row has, from the shape that it has last in another row, to the end."""
        made = self._beside(row, variant, like.values[like.frame.added[-1][1]].tolist(), NEAR)
        return made and self.finish(made, worth=worth)

    def tuned(self, row: Row, steps: int = STEPS) -> Row:
        """Move the delay of a row while that helps."""
        while self.tunes and not row.hypothesis.core.given:
            core, before = row.hypothesis.core, row
            for delays in _near(core):
                other = replace(row.hypothesis, core=core.after(delays))
                made = self.fitted(other, row.values, NEAR)
                if made is not None and made.falls(row, 0.98):
                    row = self.fitted(other, made.values, steps) or made
                    break
            if row is before:
                break
        return row

    def finish(self, row: Row, steps: int = STEPS, worth: float = np.inf) -> Row:
        """Fit a row to the end, with its delay tuned, and put it into the table.

        It is judged where it may cost less than `worth`: at its minimum no error on held-out blocks is below that where
        it was fitted.
        """
        free = self.tuned(self.fitted(row.hypothesis, row.values, steps) or row, steps)
        best = whole(free, self._keeps, worth)
        self.rows.append(best.judged() if best.before_judged < worth else best)
        self.rows += [free] if best is not free else []  # beside another effect it need not be whole
        return best


def _near(core: Core) -> list[list[int]]:
    """Return the delays of a core with one of them, or all, changed by a sample."""
    delays = np.array([d for _, d in core.inputs])
    changed = [*np.eye(delays.size, dtype=int), *([np.ones_like(delays)] if core.further else [])]
    moved = [delays + step * one for one in changed for step in (-1, 1)]
    return [each.tolist() for each in moved if each.min() >= 0]
