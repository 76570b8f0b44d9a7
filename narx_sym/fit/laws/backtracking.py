"""Of several inputs that are right for a sample a law takes one; where that leaves none later, it goes back.

The run returns to where another input gave the same output, the latest first, takes that one, and runs on from there
(backtracking; of the runs at hand the one that came furthest is changed next). A machine cannot do so: what it meets is
not known to it beforehand.

On a flat piece at an end of the map there are such inputs without number: those that leave nothing missed are computed
as sets; see `narx_sym.fit.laws.flat_ends`.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from ...inversion.compensator import Compensator
from ...inversion.solution import Solution
from ...inversion.stages import limits_of
from ...symbolic.signals import m, samples
from .crossings import OUTSIDE, around, beyond, bisected, crossings, gap_along
from .driven import FREE
from .flat_ends import FlatEnds
from .trial import Trial, alone, growth

Array = np.ndarray
TRIES, BACK = 200, 100  # runs; how far back of a miss an input is changed
AHEAD = 32  # samples beyond a miss until which inputs on flat ends are chosen
LONGER = 4  # the next stretch of a run is so many times as long
WIDER = 1.0  # of what the input has been: solutions further beyond are looked for in steps that grow
INEXACT, OTHER = 1e-9, 1e-7  # of the largest reference: what is missed; of the largest input: what is another one


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


def corrected(
    law: Compensator, target: Array, start: float, channels: Mapping[str, Any], values: dict[str, Array] | None
) -> tuple[dict[str, Array] | None, int, float]:
    """Return a run that misses nothing, if a law has one, and how many other inputs were tried.

    Where none was found, also by how much a disturbance of the input grows along the run that came furthest.

    Parameters
    ----------
    values : what the law's own run computed; None where it diverged
    """
    if not open_stages(law):
        return values, 0, 0.0
    runs = Backtracking(law, target, start, channels)
    if values is not None:
        values = runs.own(values)
        if runs.missed(values["y"]) is None:
            return values, 0, 0.0
        if (found := runs.moved()) is not None and runs.missed(runs.own(found)["y"]) is None:
            return found, runs.tried, 0.0
    found = runs.best()
    return (values, runs.tried, runs.grown()) if found is None else (found, runs.tried, 0.0)


@dataclass
class _Path:
    """A run with some given inputs, right up to a sample, and the other inputs on its way."""

    values: dict[str, Array]
    taken: Array
    begin: int  # the first sample that may still be changed
    missed: int | None
    tried: int = 0
    ways: Iterator[tuple[int, float]] | None = None


class Backtracking:
    """The runs of a law over one reference, some of whose inputs are given.

    Attributes
    ----------
    tried : int
        How many other inputs were tried.
    """

    def __init__(self, law: Compensator, target: Array, start: float, channels: Mapping[str, Any]):
        self.law, self.target, self.start, self.channels = law, target, start, channels
        assert law.staged is not None
        self.level = all(s.flat and s.alone for s in open_stages(law))  # all that is open is the place on a flat piece
        self.delay, self.tried = law.staged.delay, 0
        self.n = target.size - self.delay
        self.size = INEXACT * float(np.abs(target).max())
        self.prepared = Trial(law, target, start, channels).prepared
        self.depth = self.prepared.depth
        self.known: list[_Path] = []  # the runs so far that came to states of their own

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
        made = alone(self.law.model, command, first, self.start, self.channels)
        rests = np.all(np.abs(made[: self.delay] - first) <= self.size)
        return values | {"y": np.concatenate([made[self.delay :], values["y"][self.n :]])} if rests else values

    def _run(self, taken: Array, values: Mapping[str, Array], begin: int, end: int) -> dict[str, Array]:
        """Run on with some inputs from one sample until another; FREE where the law's own is taken."""
        return self.prepared.run({"m_taken": (taken, FREE)}, values, begin, end + self.delay)

    def _shown(self, values: Mapping[str, Array]) -> dict[str, Array]:
        return self.prepared.shown({**values, "m_wanted": values["m"]})

    def moved(self) -> dict[str, Array] | None:
        """Return a run whose inputs on flat ends before a miss are others; None where that does not do."""
        ends = FlatEnds(self.law, open_stages(self.law), self.prepared)
        taken, before, tried = np.full(self.target.size, FREE), -1, 0
        values = self._run(taken, {}, 0, self.n)
        while (missed := self.missed(values["y"][self.depth :])) is not None:
            begin, end = max(0, missed - BACK), min(self.n, missed + AHEAD)
            inputs = ends.inputs(values, begin, end)
            if inputs is None or missed <= before:
                return None
            taken[begin : begin + inputs.size], before, tried = inputs, missed, tried + 1
            values = self._run(taken, values, begin, self.n)
        self.tried = tried
        return self._shown(values)

    # -- one other input at a time -----------------------------------------------------------------------------

    def best(self) -> dict[str, Array] | None:
        """Return every sequence of a run that misses nothing; None where none was found."""
        order, self.tried = count(), 0
        first = self._path({}, np.full(self.target.size, FREE), 0, self.n)
        self.known = [first]
        waiting = [(0, next(order), first)]
        while waiting and self.tried < TRIES:
            path = heapq.heappop(waiting)[2]
            if path.missed is None:
                return self._shown(path.values)
            path.ways = path.ways or self._ways(path)
            way = next(path.ways, None)
            if way is None:
                continue
            at, value = way
            taken = path.taken.copy()
            taken[at] = value
            other = self._path(path.values, taken, at)
            new = not any(self._alike(one, other) for one in self.known)
            self.tried += new
            path.tried += new
            self.known += [other] * new
            for one in (path, other) if new else (path,):
                came = self.n if one.missed is None else one.missed
                heapq.heappush(waiting, (one.tried - came, next(order), one))
        return None

    def grown(self) -> float:
        """Return by how much a disturbance of the input grows along the run that came furthest, where one was tried."""
        if not self.tried:
            return 0.0
        path = max(self.known, key=lambda one: one.missed or 0)
        return growth(self.law, self.target, self.start, self.channels, path.missed or 0, taken=path.taken)

    def _path(self, values: Mapping[str, Array], taken: Array, begin: int, stretch: int = 1) -> _Path:
        """Run on from a sample of a run, in stretches that grow, until it misses."""
        changed, now, missed = begin + bool(values), dict(values), None
        while begin < self.n and missed is None:
            end = min(self.n, begin + stretch)
            now = self._run(taken, now, begin, end)
            missed, begin, stretch = self.missed(now["y"][self.depth : self.depth + end]), end, LONGER * stretch
        if missed is None:
            missed = self.missed(self.own(self._shown(now))["y"])
        return _Path(now, taken, changed, missed)

    def _alike(self, path: _Path, other: _Path) -> bool:
        """Whether two runs come to the same miss from the same state: what was changed before it is forgotten."""
        if path.missed != other.missed or path.missed is None:
            return False
        layout = self.prepared.compiled.layout
        for name in (layout.states[i] for i in layout.remembered):
            one, two = (p.values[name][path.missed : path.missed + self.depth] for p in (path, other))
            size = np.nanmax(np.abs(path.values[name]), initial=1e-300)
            if not (np.abs(one - two) <= INEXACT * size).all():
                return False
        return True

    def _ways(self, path: _Path) -> Iterator[tuple[int, float]]:
        """Return other inputs on the way to a miss, the latest first: the sample, and the input."""
        assert path.missed is not None
        at = np.arange(max(path.begin, path.missed - BACK), path.missed + 1)
        others = self._others(path, at) if at.size and not self.level else {}
        for place in map(int, at[::-1]):
            yield from ((place, x) for _, x in sorted(others.get(place, ())))

    def _others(self, path: _Path, at: Array) -> dict[int, list[tuple[float, float]]]:
        """Return further inputs that give the wanted output, by sample: how far they are, and where."""
        depth, law = self.depth, self.law
        assert law.staged is not None
        columns = {n: c[: depth + at[-1] + 1] for n, c in path.values.items()} | dict(self.prepared.given)  # read ahead
        inputs = columns["m"][depth - 1 :]  # from the value before the first one on
        last, taken, near = inputs[at], inputs[at + 1], around(inputs[:-1] if inputs.size > 1 else inputs, WIDER)
        low, high = limits_of(law.model, m)
        grid = np.clip(beyond(near), min(low, near[0]), max(high, near[-1]))
        # The last value is where a step turns, so often where the gap has a kink: between a pair of roots.
        points = np.sort(np.column_stack([np.broadcast_to(grid, (at.size, grid.size)), last]), axis=1)
        gap = gap_along(law, law.staged.whole, columns, self.target, at, depth)(points)
        small = INEXACT * np.abs(gap[:, OUTSIDE:-OUTSIDE]).max(axis=1, keepdims=True)
        rests = np.abs(gap) <= small
        # Along a flat piece rounding has signs of its own.
        rows, cells = np.nonzero(crossings(gap) & ~(rests[:, 1:] & rests[:, :-1]))
        of_rows = gap_along(law, law.staged.whole, columns, self.target, at[rows], depth)
        places = bisected(of_rows, points[rows, cells], points[rows, cells + 1])
        still = np.flatnonzero((rests & (points == last[:, None])).any(axis=1))
        rows, places = np.concatenate([rows, still]), np.concatenate([places, last[still]])
        away = np.abs(places - taken[rows])
        other = (away > OTHER * np.abs(inputs).max()) | (at[rows] == path.missed)
        found: dict[int, list[tuple[float, float]]] = {}
        for row, far, place in zip(rows[other], away[other], places[other], strict=True):
            found.setdefault(int(at[row]), []).append((float(far), float(place)))
        return found
