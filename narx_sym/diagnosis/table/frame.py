"""One compiled recursion for all cores: the largest one with a set of effects, of which smaller cores are points.

The derivatives of the free run are derived and compiled once per set of effects. A core of lower order leaves
coefficients at zero, an integrating core keeps their sum at one, a delay shifts the input.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import sympy as sp

from ...data.record import Record
from ...engines.algebra import add_grams, step
from ...fit.constraints import constraint_equations
from ...fit.freerun import FreeRun, determined
from ...fit.simulate import parts, segments
from ...models.effects import Form
from ...models.extend import Variant, equations
from ...models.model import Model
from ...symbolic.signals import INNER_OUTPUTS
from ..screening.contribution import contribution
from ..settings import BLOCKS, DEPENDENT, FOLDS, GAIN, RIDGE, SLACK, TRIALS, UNSEEN
from .hypotheses import Core, around, extended, linear
from .span import Span
from .starts.arx import later, start_beside

Array = np.ndarray


class Frame:
    """The free run of every core with one set of effects, and fits of it.

    The unknowns are those of the largest core, the effects' coefficients and shape parameters, and the start states of
    every segment.

    Parameters
    ----------
    given : Model
        The user's base; `largest` is None for it, else the orders of the largest linear core.
    pieces : int
        In how many the free run of each record starts again.
    """

    def __init__(
        self,
        given: Model,
        largest: Core | None,
        effects: Sequence[Variant],
        records: Sequence[Record],
        pieces: int = 1,
    ):
        self.given, self.largest, self.effects = given, largest, tuple(effects)
        self._form: Form | None = None
        self.pinned: tuple[int, ...] = ()  # coefficients that are 1
        self._whole: dict[tuple[int, ...], Frame] = {}  # shared by all that pin some
        self.begins: dict[Any, list[Array]] = {}  # where fits beside a row begin
        self._measured: dict[tuple[int, ...], list[Record]] = {}
        seen, records = self._beside_inputs(records)
        if largest is not None and not any(v.raw for v in effects):
            # Measured from the operating point, all records have the same recursion: it is derived once.
            model, self.added = around(largest, seen, given.Ts)
            records = [_shifted(r, given) for r in records]
        else:
            model, self.added = extended(given if largest is None else linear(largest, given), seen)
        self.records, self.pieces = list(records), pieces
        pieced = [(s.start == 0, r[s]) for r in self.records for s in parts(len(r), pieces)]
        self.pieced = [part for _, part in pieced]
        self._begins = [first or i > 0 for first, part in pieced for i in range(len(part.segments()))]
        self.segments = segments(self.pieced)
        self.problem = FreeRun(model, self.segments, [])
        self.size = self.problem.free + self.problem.shifts
        self.equations = constraint_equations(model, None) if largest is None else []
        self._delays = (0, *(0 for _ in largest.further)) if largest is not None else (0,)
        self._data = {self._delays: self.problem.data}
        self._free: dict[Any, Span] = {}
        self._cuts = {0: self._judged(0)}
        self.cuts, self.counts = self._cuts[0]
        # Where the columns of each segment stand: the parameters, its own starts, and last the error.
        own = [np.arange(self.size)[self.problem.own(i)] for i in range(len(self.problem.data))]
        each = [np.concatenate([np.arange(self.problem.free), at, [self.size]]) for at in own]
        self._at: list[Any] = [np.ix_(at, at) if len(each) > 1 else ... for at in each]
        self.low, self.high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        self._near()

    def _beside_inputs(self, records: Sequence[Record]) -> tuple[tuple[Variant, ...], list[Record]]:
        """Return the effects and records where an input that another is multiplied with comes as late as that one."""
        names = {n for n, _ in self.largest.further} if self.largest is not None else set()
        self._with: dict[str, tuple[str, str]] = {}  # its own name, and that of the input it comes with
        effects = []
        for variant in self.effects:
            if variant.channel in names:
                pair = variant.channel, variant.at or "u"
                variant = replace(variant, channel="_with_".join(pair))
                self._with[str(variant.channel)] = pair
            effects.append(variant)
        if not self._with:  # a copy would be checked anew
            return tuple(effects), list(records)
        more = [{new: r.signals[name] for new, (name, _) in self._with.items()} for r in records]
        return tuple(effects), [replace(r, channels=r.channels | m) for r, m in zip(records, more, strict=True)]

    def _judged(self, delay: int) -> tuple[dict[int, list[list[tuple[int, slice]]]], Array]:
        """Return the samples that count, per number of blocks, and how many there are in each of `BLOCKS`."""
        cuts, counts = {count: self._cut(count, delay) for count in (1, BLOCKS)}, np.zeros(BLOCKS)
        for b, rows in itertools.chain(*cuts[BLOCKS]):
            counts[b] += rows.stop - rows.start
        return cuts, counts

    def _cut(self, blocks: int, delay: int) -> list[list[tuple[int, slice]]]:
        """Return, per segment, which of its samples are in which of so many blocks of all.

        Until the first input of a record arrives, or that after a gap, nobody knows what drives the output.
        """
        lengths = [len(d[self.problem.name]) for d in self.problem.data]
        edges = [-(-b * sum(lengths) // blocks) for b in range(blocks + 1)]
        found, begin = [], 0
        for n, begins in zip(lengths, self._begins, strict=True):
            first = min(self.problem.depth + delay * begins, n - 1)
            cut = [int(np.clip(e - begin, first, n)) for e in edges]
            found.append([(b, slice(*pair)) for b, pair in enumerate(itertools.pairwise(cut)) if pair[0] < pair[1]])
            begin += n
        return found

    def _near(self) -> None:
        """Bound the starts of outputs: the true one is no farther from the measured one than the output ever goes.

        Where its own block is held out a start may run away to where a limit hides it, and no step leads back.
        """
        for i, data in enumerate(self.problem.data):
            own, far = self.problem.own(i), float(np.ptp(data[self.problem.name]))
            for at, start in enumerate(self.problem.starts, own.start):
                if far and start.back is not None:
                    self.low[at], self.high[at] = -far, far

    def _remember(self, x: Array) -> None:
        """Bound the starts of memories that begin at a number: no farther from it than they go from there."""
        at = np.flatnonzero([bool(names) for names in self.problem.blank])
        for i in range(len(self.problem.data) if at.size else 0):
            far = self.problem.reach(x, i)[at]
            far[~(far > 0)] = np.inf  # where it diverges, or never moves, nothing is known
            starts = self.problem.own(i).start + at
            self.low[starts], self.high[starts] = -far, far

    def limit(self, ranges: Sequence[Mapping[str, tuple[float, float]]], most: float) -> None:
        """Bound shapes and the coefficients whose sign means the effect."""
        for variant, (cs, shapes), allowed in zip(self.effects, self.added, ranges, strict=True):
            for i, name in zip(shapes, variant.shape, strict=True):
                self.low[i], self.high[i] = allowed[name]
            if variant.effect.sign and len(cs) == 1:
                sizes = max(variant.effect.share[0], 0.0), most if variant.effect.full else np.inf
                self.low[cs[0]], self.high[cs[0]] = sizes if variant.effect.sign > 0 else (-sizes[1], -sizes[0])
            if variant.effect.weights and variant.where == "input":  # none is larger than the whole
                self.low[cs], self.high[cs] = -most, most

    def limits(self, model: Model) -> dict[Any, tuple[float, float]]:
        """Return the bounds of a model's own symbols."""
        names, found = {str(s): s for s in model.symbols}, {}
        for i in (i for pair in self.added for part in pair for i in part):
            symbol = names.get(str(self.problem.model.symbols[i]))
            if symbol is not None and np.isfinite([self.low[i], self.high[i]]).any():
                found[symbol] = (float(self.low[i]), float(self.high[i]))
        return found

    def late(self, core: Core) -> None:
        """Let each input come as late as it does with a core."""
        delays = tuple(d for _, d in core.inputs)
        if delays not in self._data:
            own = next(iter(self._data.values()))
            self._data[delays] = [dict(d) for d in own]
            together = ((new, dict(core.inputs)[other]) for new, (_, other) in self._with.items())
            for name, delay in (*core.inputs, *together):
                moved = (later(r.signals[name], delay) for r in self.records)
                shown = [x[s] for x in moved for s in parts(len(x), self.pieces)]
                for d, x in zip(self._data[delays], shown, strict=True):
                    d[name] = x
        self.problem.data, self._delays = self._data[delays], delays  # of a problem that other frames move too
        self.judge_from(core.dead)

    def judge_from(self, delay: int) -> None:
        """Let those samples count that come no earlier than some."""
        if delay not in self._cuts:
            self._cuts[delay] = self._judged(delay)
        self.cuts, self.counts = self._cuts[delay]

    def whole(self, coefficient: int) -> Frame:
        """Return the same where a coefficient is 1."""
        pinned = (*self.pinned, coefficient)
        if pinned not in self._whole:
            made = copy(self)
            made._free, made.pinned = {}, pinned
            self._whole[pinned] = made
        return self._whole[pinned]

    def free(self, core: Core) -> Span:
        """Return the points that a core leaves free."""
        key = (core.n_y, core.n_u, core.integrating, core.given)
        if key not in self._free:
            self._free[key] = self._spanned(core).where_one(self.pinned)
        return self._free[key]

    def _spanned(self, core: Core) -> Span:
        if self.largest is None:
            return Span.of(self.equations, self.problem.model.symbols, self.size)
        t0, T = np.zeros(self.size), np.eye(self.size)[:, self.used(core)]
        if core.integrating:
            t0[0] = 1.0
            T[0, 1 : core.n_y] = -1.0
            T = T[:, 1:]
        return Span(t0, T)

    def used(self, core: Core) -> list[int]:
        """Return which unknowns a core has: of older outputs, of inputs, the constant, and all behind it."""
        if self.largest is None:
            return list(range(self.size))
        A, B = self.largest.n_y, self.largest.n_u
        b = (A + i * B + j for i in range(len(core.inputs)) for j in range(core.n_u))
        return [*range(core.n_y), *b, *range(A + self.largest.b, self.size)]

    def parameters(self, core: Core) -> int:
        """Return how many parameters a core with the effects has; start states do not count."""
        return self.free(core).size - self.problem.shifts

    def theta(self, x: Array, core: Core) -> list[float]:
        """Return the parameters of the model that `hypotheses.written` makes."""
        return [float(x[i]) for i in self.used(core) if i < self.problem.free]

    def shifts(self, other: Frame, x: Array) -> Array:
        """Return start shifts from those of a frame with fewer effects; new memories start where they would."""
        old, new = other.problem, self.problem
        s, t = len(old.starts), len(new.starts)
        made = np.zeros(new.shifts)
        for i in range(len(new.data)):
            made[i * t : i * t + s] = x[old.free + i * s : old.free + (i + 1) * s]
        return made

    def errors(self, x: Array, core: Core) -> list[Array]:
        """Return simulated minus measured outputs at a point, one (N,) array per segment."""
        self.late(core)
        problem, theta = self.problem, self.problem.theta(x)
        return [problem.compared(i, theta, x[problem.own(i)])[:, -1].copy() for i in range(len(problem.data))]

    def placed(self, core: Core, linear: Array) -> Array:
        """Return the point at which a core has given a, b and constant, and effects are absent, (unknowns,)."""
        return self.put(np.zeros(self.size), core, linear)

    def put(self, x: Array, core: Core, linear: Array) -> Array:
        """Return a point with given a, b and constant of a core."""
        x = x.copy()
        x[self.used(core)[: linear.size]] = linear
        return x

    def beside(self, core: Core, a: Array) -> Array:
        """Return the point with given coefficients a of older outputs, the rest of the core beside them."""
        linear, errors = start_beside(self.pieced, core, a)
        return self.problem.begun(self.placed(core, linear), errors)

    def measured(self) -> list[Record]:
        """Return every segment measured from the operating point, with each input as late as it comes."""
        if self._delays not in self._measured:
            model, data = self.problem.model, zip(self.segments, self._data[self._delays], strict=True)
            self._measured[self._delays] = []
            for r, d in data:
                channels = {n: d.get(n, c) for n, c in r.channels.items()}
                late = replace(r, u=d[model.input.name], y=d[model.output.name], channels=channels)
                self._measured[self._delays].append(_shifted(late, model))
        return list(self._measured[self._delays])

    def contributions(self, records: Sequence[Record], shape: Array, seen: Sequence[Array] = ()) -> list[Array]:
        """Return what the last effect adds along measured outputs, or `seen` ones: (N, coefficients) per segment."""
        if self._form is None:
            bare = self.given if self.largest is None else linear(self.largest, self.given)
            model, _ = extended(bare, self.effects[:-1])
            self._form = equations(model, self.effects[-1])
        names = [sp.Symbol(p, real=True) for p in self.effects[-1].shape]
        values = dict(zip(names, map(float, shape), strict=True))
        moved = (
            {f"{b}{n and '_'}{n}": x for n, x in {**r.channels, "": r.u}.items() for b in ("v", "passed")}
            | {**r.channels, "t": r.t, "u": r.u}
            for r in records
        )
        outputs = (dict.fromkeys(("y", *(b.name for b in INNER_OUTPUTS)), y) for y in seen or [r.y for r in records])
        return [contribution(self._form, values, {**a, **b}) for a, b in zip(moved, outputs, strict=True)]

    def near(self, x: Array, core: Core) -> Array:
        """Return x in single precision, where its free run is as good: no fit starts from what BLAS leaves open."""
        rough = self.free(core).rounded(x)
        return rough if self.error(rough, core) < SLACK * self.error(x, core) + DEPENDENT else x

    def error(self, x: Array, core: Core) -> float:
        """Return the mean square of the free run's errors, infinite where it diverges."""
        self.late(core)
        with np.errstate(all="ignore"):
            found = self._squares(x, None)[0]
        return found if np.isfinite(found) else np.inf

    def fit(
        self, x: Array, core: Core, steps: int, use: Array | None = None, only_starts: bool = False, gain: float = GAIN
    ) -> tuple[Array, float]:
        """Minimise the mean squared free-run error from x (Levenberg 1944, Marquardt 1963); return x and that error.

        `use`, (BLOCKS,) bool, says which blocks count.
        """
        self.late(core)
        span = self.free(core)
        if only_starts:
            span = span.last(self.problem.shifts)
            if not span.size:
                return x, np.nan
        with np.errstate(all="ignore"):
            self._remember(x)
            x = np.clip(x, self.low, self.high)
            cost, gradient, G, every = self._squares(x, use)
            damping = 1e-3
            if not (np.isfinite(cost) and determined(x, np.sqrt(G.diagonal()))):
                return x, np.inf
            for _ in range(steps):
                H, g = span.squared(G), span.across(gradient)
                size = np.sqrt(H.diagonal())
                # What these blocks do not determine, the start of a block that is held out, stays as it is.
                seen = size if every is G else np.sqrt(span.squared(every).diagonal())
                size = np.where(size <= UNSEEN * seen, np.inf, size)
                H, g = H / np.outer(size, size), g / size
                for c in self._stopped(x, span.T, g):
                    H[c], H[:, c], g[c] = 0.0, 0.0, 0.0
                for _ in range(TRIALS):
                    added = damping + RIDGE
                    w = step(H, g, added)
                    if w is None:
                        damping *= 8
                        continue
                    if np.sum((added * w - g) * w) < gain * cost:  # not so much of one sample's, as it is linear
                        return x, cost
                    new = np.clip(x + span.along(w / size), self.low, self.high)
                    now, gradient, G, every = self._squares(new, use)
                    if now < cost and determined(new, np.sqrt(G.diagonal())):
                        break
                    damping *= 8
                else:
                    break
                x, gained, cost, damping = new, cost - now, now, damping / 6
                if gained < gain * cost:
                    break
        return x, cost

    def _squares(self, x: Array, use: Array | None) -> tuple[float, Array, Array, Array]:
        """Return the mean square of the errors, J'r and J'J on the blocks that count, and J'J on all."""
        if use is None:
            r, g, G = self.sums(x, 1)
            all_of = G[0]
            return float(r[0] / self.counts.sum()), g[0], all_of, all_of
        r, g, G = self.sums(x, BLOCKS)
        return float(r[use].sum() / self.counts[use].sum()), g[use].sum(axis=0), G[use].sum(axis=0), G.sum(axis=0)

    def sums(self, x: Array, count: int) -> tuple[Array, Array, Array]:
        """Return r'r (count,), J'r (count, unknowns) and J'J (count, unknowns, unknowns) of the free run's errors.

        Errors are in standard deviations of y, `count` is 1 for all samples or BLOCKS. Nothing as long as the records
        is kept; NaN where the run diverges.
        """
        problem, n, theta = self.problem, self.size, self.problem.theta(x)
        sums = np.zeros((count, n + 1, n + 1))  # of the slopes and, last, the error
        for i, (blocks, at) in enumerate(zip(self.cuts[count], self._at, strict=True)):
            columns = problem.compared(i, theta, x[problem.own(i)])
            if at is ...:
                add_grams(columns, blocks, sums)
                continue
            own = np.zeros((count, columns.shape[1], columns.shape[1]))
            add_grams(columns, blocks, own)
            for b, _ in blocks:
                sums[b][at] += own[b]
        sums /= problem.spread**2
        return sums[:, n, n], sums[:, :n, n], sums[:, :n, :n]

    def _stopped(self, x: Array, T: Array, g: Array) -> list[int]:
        """Return the directions in which the error falls, but a bound is in the way."""
        found = []
        for i in np.flatnonzero((x <= self.low) | (x >= self.high)):
            for c in np.flatnonzero(T[i]):
                if (g[c] * T[i, c] > 0) == (x[i] <= self.low[i]):
                    found.append(int(c))
        return found

    def held_out(self, x: Array, core: Core, steps: int) -> Array:
        """Return the mean squared error of each block where the other folds fitted the parameters, (BLOCKS,).

        Infinite where its free run diverges, or nothing of the block is judged.
        """
        losses = np.full(BLOCKS, np.inf)
        for fold in range(FOLDS):
            held = (np.arange(BLOCKS) % FOLDS == fold) & (self.counts > 0)
            found, cost = self.fit(x, core, steps, ~held)
            found, _ = self.fit(found, core, 3, only_starts=True)
            if np.isfinite(cost):
                with np.errstate(all="ignore"):
                    losses[held] = self.sums(found, BLOCKS)[0][held] / self.counts[held]
        return np.where(np.isfinite(losses), losses, np.inf)


def _shifted(record: Record, given: Model) -> Record:
    """Return a record measured from the operating point of a model."""
    u0, y0 = (float(given.operating_point.get(b, 0.0)) for b in (given.input, given.output))
    return replace(record, u=record.u - u0, y=record.y - y0)
