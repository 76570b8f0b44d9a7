"""Of several inputs that are right for a sample a law takes one; where that leaves none later, it goes back.

The run returns to where a stage had a further solution, the latest first, takes that one, and runs on from there
(backtracking; of the runs at hand the one that came furthest is changed next). Where it comes to a state in which an
earlier run was at that sample, it goes on as that one did, and what lies beyond is not tried again. A machine cannot do
so: what it meets is not known to it beforehand.

On a flat piece there are solutions without number. Those are tried at which the run that follows changes: to one side
it misses at another sample than to the other, or there from above instead of from below. A later sample lies on an edge
then, where a flat piece begins, and leaves a choice of its own: so friction goes on slipping.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import count, pairwise
from typing import Any

import numpy as np
import sympy as sp

from ...engines.compile import compile
from ...errors import Diverged
from ...inversion.branches import searched
from ...inversion.compensator import Compensator
from ...inversion.solution import Solution
from ...inversion.stages import guarded, in_order, limits_of, stages_of
from ...symbolic.recursion import Recursion
from ...symbolic.signals import k, m, samples, signal
from ..simulate import simulate
from .crossings import OUTSIDE, around, beyond, crossings, gaps
from .damping import growth
from .driven import FREE, Prepared
from .later import Later

Array = np.ndarray
TRIES, BACK, ON = 200, 100, 200  # runs; how far back of a miss a choice is changed; how far the first run goes on
AHEAD, MOVES = 32, np.geomspace(1e-5, 30.0, 28)  # beyond a miss a try is followed; of what a sequence has been: tries
LONGER = 4  # the next stretch of a run is so many times as long
WIDER = 1.0  # of what a sequence has been: solutions further beyond are looked for in steps that grow
INEXACT = 1e-9  # of the largest reference: what is further off is missed
Hints = Mapping[str, Mapping[int, float]]


def open_stages(law: Compensator) -> list[Solution]:
    """Return the stages that may leave a choice on which later samples depend."""
    return [s for s in (law.staged.stages if law.staged else ()) if (s.needs or not s.proved) and _lasts(law, s)]


def _lasts(law: Compensator, stage: Solution) -> bool:
    """Whether more of the model than the samples that stages solve for is made from what a stage takes, or leads to."""
    assert law.staged is not None
    later = law.staged.stages[law.staged.stages.index(stage) :]
    own = {law.model.input if one.unknown.base == m else one.unknown.base for one in later}
    made = {(left, s) for left, right in law.model.recursion.updates for s in samples(right) if s.base in own}
    return len(made) > len(own)


def steered(law: Compensator, clipped: Callable[[Any], Any] = lambda asked: asked) -> Recursion:
    """Return a law with the model beside it whose open stages take the solution nearest to a hint, where it is given.

    The hint of a sequence s is the channel s_hint. A root is looked for no further out than that, or than where the law
    itself looks for one.
    """
    staged = law.staged
    assert staged is not None
    swapped, near = {}, {s.unknown: s for s in stages_of(law.model, lambda unknown: _hint(unknown)[k]).stages}
    for stage in open_stages(law):
        hint = _hint(stage.unknown)[k]
        if _level(stage):
            swapped[stage.unknown] = sp.Piecewise((near[stage.unknown].value, hint < FREE))
            continue
        low, high = limits_of(law.model, stage.unknown.base)
        root = searched(replace(stage, last=hint), law.model.values, (sp.Min(low, hint), sp.Max(high, hint)))
        swapped[stage.unknown] = sp.Piecewise((root, hint < FREE))
    updates = tuple(
        (left, sp.Piecewise(*swapped[left].args, (right, True)) if left in swapped else right)
        for left, right in staged.updates
    )
    return in_order(guarded(replace(staged, updates=updates), clipped), law.symbols)


def right(
    law: Compensator, target: Array, start: float, channels: Mapping[str, Any], values: dict[str, Array] | None
) -> tuple[dict[str, Array] | None, int, float]:
    """Return a run that misses nothing, if a law has one, and how many further solutions were tried.

    Where none was found, also by how much a disturbance of the input grows along the run that came furthest.

    Parameters
    ----------
    values : what the law's own run computed; None where it diverged
    """
    if not open_stages(law):
        return values, 0, 0.0
    runs, missed = Lookback(law, target, start, channels), None
    if values is not None:
        values = runs.own(values)
        missed = runs.missed(values["y"])
        if missed is None:
            return values, 0, 0.0
        if any(stage.flat for stage in runs.open):
            moved = Later(law, target, start, channels, runs.missed, runs.size)
            if (found := moved.reached()) is not None and runs.missed(runs.own(found)["y"]) is None:
                return found, moved.stretches, 0.0
    found = runs.best(missed)
    if found is not None:
        return found, runs.tried, 0.0
    return values, runs.tried, runs.grown() if runs.tried else 0.0


def _hint(unknown: Any) -> Any:
    return signal(f"{unknown.base.name}_hint")


def _level(stage: Solution) -> bool:
    """Whether all that a stage leaves open is the place on a flat piece."""
    return bool(stage.flat) and stage.alone


@dataclass
class _Path:
    """A run with some hints, right up to a sample, and the further solutions on its way."""

    values: dict[str, Array]
    missed: int | None
    begin: int = 0  # the first sample that may still be changed
    hints: Hints = field(default_factory=dict)
    end: int | None = None  # from there on it is as an earlier run was
    tried: int = 0
    ways: Iterator[tuple[str, int, float]] | None = None


class Lookback:
    """The runs of a law over one reference.

    Attributes
    ----------
    tried : int
        How many further solutions were tried.
    """

    def __init__(self, law: Compensator, target: Array, start: float, channels: Mapping[str, Any]):
        self.law, self.target, self.start, self.channels = law, target, start, channels
        self.open = open_stages(law)
        assert law.staged is not None
        self.delay, self.tried = law.staged.delay, 0
        self.n = target.size - self.delay
        self.size = INEXACT * float(np.abs(target).max())
        self.known: list[tuple[Array, _Path]] = []  # the runs so far, and what each remembers, sample by sample

    def missed(self, reached: Array) -> int | None:
        """Return the first input whose output is not the reference."""
        n = min(reached.size, self.n)
        wrong = np.flatnonzero(~(np.abs(reached[:n] - self.target[self.delay :][:n]) <= self.size))
        return int(wrong[0]) if wrong.size else None

    def own(self, values: dict[str, Array]) -> dict[str, Array]:
        """Put what the model makes of the input by itself in the place of what it makes beside the law.

        The last digits are others, and a sign of a step may turn with them. Where the model does not rest until the
        first input arrives, nothing is changed.
        """
        command = values["m"][: self.target.size]
        if not np.isfinite(command).all():
            return values
        first = float(self.target[0])
        try:
            made = simulate(self.law.model, command, first, self.channels, u0=self.start, warn=False)
        except Diverged as error:
            depth = max(1, self.law.model.recursion.depth)
            made = np.concatenate([np.asarray(error.trajectory)[depth : error.at], np.full(command.size, np.nan)])
            made = made[: command.size]
        rests = np.all(np.abs(made[: self.delay] - first) <= self.size)
        return values | {"y": np.concatenate([made[self.delay :], values["y"][self.n :]])} if rests else values

    def best(self, missed: int | None = None) -> dict[str, Array] | None:
        """Return every sequence of a run that misses nothing; None where none was found.

        `missed` is the first input after which the law's own run misses, where that is known.
        """
        self.prepared = Prepared.of(self.law, compile(steered(self.law)), self.target, self.start, self.channels)
        order, self.known = count(), []
        waiting = [(0, next(order), self._run(_Path({}, missed), {}, 0))]
        while waiting and self.tried < TRIES:
            path = heapq.heappop(waiting)[2]
            if path.missed is None:
                return self.prepared.shown(path.values)
            path.ways = path.ways or self._ways(path)
            way = next(path.ways, None)
            if way is None:
                continue
            name, at, hint = way
            hints = {n: dict(held) for n, held in path.hints.items()}
            hints.setdefault(name, {})[at] = hint
            other = self._run(path, hints, at)
            new = other.end is None or other.end > other.begin
            self.tried += new
            path.tried += new
            for one in (path, other) if new else (path,):
                came = self.n if one.missed is None else one.missed
                heapq.heappush(waiting, (one.tried - came, next(order), one))
        return None

    def grown(self) -> float:
        """Return by how much a disturbance of the input grows along the run that came furthest."""
        path = max((p for _, p in self.known), key=lambda p: -1 if p.missed is None else p.missed)
        held = {name: column for name, (column, _) in self._more(path.hints).items()}
        at, more = path.missed or 0, {**self.channels, **held}
        return growth(self.law, self.target, self.start, more, at, lambda clipped: steered(self.law, clipped))

    def _run(self, before: _Path, hints: Hints, at: int) -> _Path:
        """Run on from a sample of a run, in stretches that grow, until it misses or is as an earlier run was."""
        values, begin, changed = before.values, at, at + 1 if hints else 0
        more = self._more(hints)
        met: tuple[int, int] | None = None
        stretch = 1 if hints else self.n if before.missed is None else before.missed + ON
        while begin < self.n:
            end = min(self.n, begin + stretch)
            values, stretch = self.prepared.run(more, values, begin, end + self.delay), LONGER * stretch
            seen = self.prepared.depth + end  # beyond, the reference was not read
            own, missed = self._remembered(values)[:, :seen], self.missed(values["y"][self.prepared.depth : seen])
            met = self._met(own, changed)
            if missed is not None or met:
                break
            begin = end
        else:
            missed = self.missed(self.own(self.prepared.shown(values))["y"])
        if met and (missed is None or met[0] <= max(missed, changed)):
            return _Path(values, met[1], changed, hints, met[0])
        path = _Path(values, missed, changed, hints)
        # What follows a miss is off the reference.
        until = own.shape[1] if missed is None else self.prepared.depth + missed + 1
        self.known.append((own[:, :until], path))
        return path

    def _remembered(self, values: Mapping[str, Array]) -> Array:
        """Return what later samples read, sequence by sequence, (remembered, n)."""
        layout = self.prepared.compiled.layout
        found = [values[layout.states[i]] for i in layout.remembered]
        return np.array(found) if found else np.empty((0, values["y"].size))

    def _met(self, own: Array, begin: int) -> tuple[int, int] | None:
        """Return the first sample from `begin` on at which an earlier run was in the same state, and what that misses.

        None where there is no such sample, and where nothing is remembered: there each sample stands alone.
        """
        if not own.size:
            return None
        depth, found = self.prepared.depth, []
        size = INEXACT * np.nanmax(np.abs(own), axis=1, initial=1e-300)[:, None]
        for other, path in self.known:
            n = min(own.shape[1], other.shape[1])
            same = (np.abs(own[:, :n] - other[:, :n]) <= size).all(axis=0)
            run = np.convolve(same, np.ones(depth, dtype=int))[:n] == depth  # all that is remembered
            found += [(begin + int(i), path.missed or 0) for i in np.flatnonzero(run[depth + begin - 1 :])[:1]]
        return min(found, default=None)

    def _more(self, hints: Hints) -> dict[str, tuple[Array, float]]:
        """Return the hints as further inputs of a run."""
        return {n: (self._column(hints.get(n, {})), FREE) for n in (_hint(s.unknown).name for s in self.open)}

    def _column(self, hints: Mapping[int, float]) -> Array:
        column = np.full(self.target.size, FREE)
        column[list(hints)] = list(hints.values())
        return column

    def _grid(self, stage: Solution, reached: Array) -> Array:
        """Return where further solutions are looked for: around what was reached, and where the law itself looks."""
        near = around(reached, WIDER)
        low, high = limits_of(self.law.model, stage.unknown.base)
        return np.clip(beyond(near), min(low, near[0]), max(high, near[-1]))

    def _ways(self, path: _Path) -> Iterator[tuple[str, int, float]]:
        """Return the further solutions on the way to a miss, the latest first: sequence, sample, and where."""
        assert path.missed is not None
        stop = path.missed + 1 if path.end is None else min(path.missed + 1, path.end)
        at = np.arange(max(path.begin, path.missed - BACK), stop)
        if not at.size:
            return
        others = self._crossed(path, at, stop)
        for place in at[::-1]:
            yield from ((name, int(place), where) for _, name, where in sorted(others.get(place, ())))
            for stage in self.open:
                if _level(stage):
                    yield from self._turned(path, stage, int(place))

    def _crossed(self, path: _Path, at: Array, stop: int) -> dict[int, list[tuple[float, str, float]]]:
        """Return the further solutions of samples by sample: how far they are, the hint, and where."""
        depth = self.prepared.depth
        columns = {n: c[: depth + stop] for n, c in {**path.values, **self.prepared.given}.items()}
        found: dict[int, list[tuple[float, str, float]]] = {}
        for stage in (s for s in self.open if not _level(s)):
            name, hint = stage.unknown.base.name, _hint(stage.unknown).name
            before = columns[name][max(depth - 1, 0) :][:1]
            column = np.concatenate([before, columns[name][depth:]])  # from the value before the first one on
            grid, last = self._grid(stage, column[:stop]), column[at]
            taken = columns[f"{name}_wanted"][depth + at]
            # The last value is where a step turns, so often where the gap has a kink: between a pair of roots.
            points = np.sort(np.column_stack([np.broadcast_to(grid, (at.size, grid.size)), last]), axis=1)
            gap = gaps(self.law, stage, columns, self.target, at, points, depth)
            rests = np.abs(gap) <= INEXACT * np.abs(gap[:, OUTSIDE:-OUTSIDE]).max(axis=1, keepdims=True)
            more = [(row, last[row], 0.0) for row in np.flatnonzero((rests & (points == last[:, None])).any(axis=1))]
            # Along a flat piece rounding has signs of its own.
            for row, cell in np.argwhere(crossings(gap) & ~(rests[:, 1:] & rests[:, :-1])):
                low, high = points[row, cell : cell + 2]
                more.append((row, (low + high) / 2, high - low))
            for row, place, width in more:
                away = abs(place - taken[row])
                if away > max(width, INEXACT * abs(place)) or at[row] == path.missed:
                    found.setdefault(int(at[row]), []).append((float(away), hint, float(place)))
        return found

    def _turned(self, path: _Path, stage: Solution, at: int) -> Iterator[tuple[str, int, float]]:
        """Return the values on a flat piece at which what follows changes: a later sample comes onto an edge there.

        Beside them the run misses at another sample, or to the other side. What comes furthest is first.
        """
        assert path.missed is not None
        name, depth, end = _hint(stage.unknown).name, self.prepared.depth, min(self.n, path.missed + AHEAD)
        column = path.values[stage.unknown.base.name][: depth + path.missed + 1]
        here, size = float(column[depth + at]), float(np.ptp(column)) or abs(float(column[-1])) or 1.0

        def came(where: float) -> tuple[int, bool]:
            hints = {**path.hints, name: {**path.hints.get(name, {}), at: where}}
            y = self.prepared.run(self._more(hints), path.values, at, end + self.delay)["y"][depth : depth + end]
            missed = self.missed(y)
            return (end, False) if missed is None else (missed, bool(y[missed] > self.target[self.delay + missed]))

        ends = [(x, came(x)) for x in here + size * np.concatenate([-MOVES[::-1], [0.0], MOVES])]
        found = [turn for one, other in pairwise(ends) for turn in _between(came, one, other)]
        yield from ((name, at, x) for _, _, x in sorted((-n, abs(x - here), x) for n, x in found))


def _between(came: Callable[[float], tuple[int, bool]], one: Any, other: Any) -> Iterator[tuple[int, float]]:
    """Return where a run comes to another sample between two values: how far at most, and the value."""
    if one[1] == other[1]:
        return
    middle = (one[0] + other[0]) / 2
    if one[0] < middle < other[0]:
        half = middle, came(middle)
        yield from _between(came, one, half)
        yield from _between(came, half, other)
    elif one[1][0] != other[1][0]:
        x, (n, _) = max(one, other, key=lambda end: end[1][0])
        yield n, float(x)
