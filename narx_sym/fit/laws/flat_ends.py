"""Of all the inputs on flat pieces those with which a law misses nothing: sets of them, sample by sample.

At each sample a law either takes its one input, while the target stays within the flat ends of the map, or the target
is exactly that of a flat end and any input beyond it will do: a number of zero or more that is free. Along such a run
everything is affine in the free numbers, and what must hold is linear in them:

    room[k] >= 0 where the law has one input;   room[k] = 0, free[k] >= 0 on a flat end.

An equation takes one free number away, so that few are free at a time: as many as samples pass until an input is seen,
since the outputs that follow decide on them. What is left is a polytope; where it is empty, an earlier sample was on
another piece, and the search goes back to the latest one that matters: each number and each condition knows the samples
whose pieces it was made by, and a choice that no condition in the conflict was made by changes nothing
(conflict-directed backjumping, Prosser 1993). What fails whatever stood before is not tried again. The point of a
polytope that is nearest to the one before solves a least distance problem (Lawson & Hanson 1974, chapter 23), and where
there is none, its multipliers name the conditions in the conflict. Where the pieces of the model are not affine,
tangents stand for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sp
from scipy.linalg import null_space
from scipy.optimize import nnls

from ...engines.numpy import lambdify
from ...inversion.compensator import Compensator
from ...inversion.solution import FlatEnd, Solution
from ...inversion.stages import in_order, wanted
from ...symbolic.graph import Graph
from ...symbolic.signals import k, lag, r, samples, shift, signal
from .driven import Prepared

Array = np.ndarray
NODES = 10_000  # samples that a search computes
EXACT, NOTHING = 1e-10, 1e-11  # of the largest target: no room; what a free number that hardly matters changes
TANGENT, REFINED = 1.0, 3  # of a free number: less leaves more rounding; times that a point is corrected for it
FREE, ROOM, NOW, WIDE = signal("m_free"), "m_room", "m_room_now", "m_wide"


@dataclass(frozen=True)
class _Node:
    """A run until a sample, all of it affine: coefficients of the free numbers, then what is left without them.

    `past_by` and `holds_by` say by the pieces of which samples it was made, (..., samples) bool.
    """

    at: int
    past: Array  # (sequences, samples before, free numbers + 1)
    inputs: Array  # (samples so far, free numbers + 1)
    holds: Array  # (conditions, free numbers + 1): not negative
    past_by: Array
    holds_by: Array
    piece: int = 0

    def in_other(self, change: Array) -> _Node:
        """Return the node in other free numbers; (free numbers + 1, others + 1) matrix."""
        return replace(self, past=self.past @ change, inputs=self.inputs @ change, holds=self.holds @ change)

    def solved(self, equation: Array, by: Array) -> _Node | None:
        """Return the node in free numbers that solve an equation, one fewer; None where nothing solves it."""
        slope, rest = equation[:-1], equation[-1]
        n, read = slope.size, slope != 0
        if np.abs(slope).max(initial=0.0) < NOTHING:
            return self if abs(rest) <= EXACT else None
        change = np.zeros((n + 1, n))
        change[:-1, :-1] = np.column_stack([np.eye(n)[:, ~read], np.eye(n)[:, read] @ null_space(slope[read][None])])
        change[:-1, -1], change[-1, -1] = -slope * rest / (slope @ slope), 1.0
        past_by, holds_by = (
            np.where((a[..., :-1] * slope != 0).any(axis=-1)[..., None], b | by, b)
            for a, b in ((self.past, self.past_by), (self.holds, self.holds_by))
        )
        return replace(self.in_other(change), past_by=past_by, holds_by=holds_by)


class FlatEnds:
    """The runs of a law over one reference, with the inputs on its flat ends free."""

    def __init__(self, law: Compensator, stages: Sequence[Solution], prepared: Prepared):
        ends = [(s, b.flat) for s in stages for b in s.branches if b.flat]
        self.prepared, self.ends, self.last = prepared, len(ends), prepared.given["r"].size - 1
        pieces = [_updates(law, stages, end) for end in [None, *ends]] if ends else []
        leads = {left.base: -lag(left) for piece in pieces for left, _ in piece}
        self.leads = {base.name: lead for base, lead in leads.items()}
        self.beside = {left.base.name: -lag(left) for left, _ in law.beside()}
        recursions = [in_order(piece, law.symbols).updates for piece in pieces]
        read = sorted({s.base.name for one in recursions for _, e in one for s in samples(e) if s.base in leads})
        self.rows = {name: i for i, name in enumerate(read)}
        self.depth = max((lag(s) for one in recursions for _, e in one for s in samples(e)), default=0)
        steps = [_step(one, law.model.values) for one in recursions]
        self.steps, self.reads = [one for one, _ in steps], [reads for _, reads in steps]
        self.targets = [s.target.base.name for s, _ in ends]
        self.sizes: dict[str, float] = {}

    def inputs(self, values: Mapping[str, Array], begin: int, end: int) -> Array | None:
        """Return inputs from one sample of a run until another that miss nothing, (end - begin,); None where none do.

        Where the search ends before, those of the run that came furthest, (fewer,).
        """
        if not self.ends:
            return None
        self.sizes = {name: _size(values["m"], np.median) for name in (FREE.name, WIDE)}
        for i, name in enumerate(self.targets):
            size = _size({**values, **self.prepared.given}[name], np.max)
            self.sizes |= {f"{ROOM}{i}": size, f"{NOW}{i}": size}
        best, nodes = self._first(values, begin, end - begin), 0
        path = [(best, self._next(best, end), np.zeros(end - begin, dtype=bool))]
        self.failed: set[tuple[int, int]] = set()  # samples and pieces, whatever stands before
        while best.at < end and nodes < NODES:
            node, others, conflict = path[-1]
            new = next(others, None)
            if isinstance(new, _Node):
                path, nodes = [*path, (new, self._next(new, end), np.zeros_like(conflict))], nodes + 1
                best = new if new.at > best.at else best
            elif new is not None:
                conflict |= new
            else:
                conflict[node.at - begin :] = False
                if not conflict.any():
                    break
                latest = begin + int(np.flatnonzero(conflict)[-1])
                if conflict.sum() == 1:
                    self.failed.add((latest, path[latest - begin + 1][0].piece))
                path = path[: latest - begin + 1]
                path[-1][2][:] |= conflict
        return None if best.at == begin else best.inputs[:, -1]

    def _first(self, values: Mapping[str, Array], begin: int, n: int) -> _Node:
        past, now = np.zeros((len(self.rows), self.depth, 1)), self.prepared.depth + begin
        for name, row in self.rows.items():
            column, first = values[name], now + self.leads[name] - self.beside[name]
            past[row, :, 0] = column[np.clip(np.arange(first - self.depth, first), 0, column.size - 1)]
        by = np.zeros((*past.shape[:2], n), dtype=bool)
        return _Node(begin, past, np.zeros((0, 1)), np.zeros((0, 1)), by, np.zeros((0, n), dtype=bool))

    def _next(self, node: _Node, end: int) -> Iterator[_Node | Array]:
        """Return what may come after a node: the flat end that it is on, one input, other flat ends.

        Where that leaves nothing, the samples whose pieces are the reason, (samples,) bool.
        """
        for piece in sorted(range(len(self.steps)), key=lambda one: (one != node.piece or not one, one)):
            if (node.at, piece) in self.failed:
                continue
            new = self._moved(node, piece, end)
            if isinstance(new, _Node):
                free, against = nearest(new.holds)
                if against.any():
                    new = new.holds_by[against].any(axis=0)
                else:
                    new = new.in_other(np.column_stack([np.eye(free.size + 1, free.size), np.append(free, 1.0)]))
            yield new

    def _moved(self, node: _Node, piece: int, end: int) -> _Node | Array:
        """Return a node one sample later on a piece; where that leaves nothing, by the pieces of which samples."""
        n, now = node.past.shape[2], node.at - (end - node.past_by.shape[2])
        if piece:  # one number more is free
            node, n = node.in_other(np.insert(np.eye(n), n - 1, 0.0, axis=1)), n + 1
        points = np.eye(n) * TANGENT
        points[-1] = 1.0
        new = self._stepped(node, piece, points)
        here = np.arange(node.past_by.shape[2]) == now
        if new is None:
            return ~here
        by = {name: self._by(node, reads) for name, reads in self.reads[piece].items()}
        for i in range(self.ends):
            first = new[f"{NOW}{i}"]
            if first[-1] < -EXACT and np.abs(first[:-1]).max(initial=0.0) < NOTHING:
                return by[f"{NOW}{i}"]
        early = [f"{ROOM}{i}" for i in range(self.ends) if node.at + self.leads[f"{ROOM}{i}"] < end]
        rooms, rooms_by = [new[name] for name in early], [by[name] | here for name in early]
        if piece:
            rooms += [np.eye(n)[-2], *([new[WIDE] - np.eye(n)[-2]] if WIDE in new else [])]
            rooms_by += [here, *([by[WIDE] | here] if WIDE in new else [])]
        past, past_by = (
            np.concatenate([before[:, 1:], np.array([[one[name]] for name in self.rows])], axis=1)
            for before, one in ((node.past, new), (node.past_by, {name: each | here for name, each in by.items()}))
        )
        inputs, holds = np.vstack([node.inputs, new["m"]]), np.vstack([node.holds, *rooms])
        moved = _Node(node.at + 1, past, inputs, holds, past_by, np.vstack([node.holds_by, *rooms_by]), piece)
        if piece:
            reason = by[f"{NOW}{piece - 1}"]
            solved = moved.solved(new[f"{NOW}{piece - 1}"], reason | here)
            if solved is None:
                return reason
            moved = solved
        constant = np.abs(moved.holds[:, :-1]).max(axis=1, initial=0.0) < NOTHING
        against = constant & (moved.holds[:, -1] < -EXACT)
        if against.any():
            return np.asarray(moved.holds_by[against].any(axis=0))
        return replace(moved, holds=moved.holds[~constant], holds_by=moved.holds_by[~constant])

    def _by(self, node: _Node, reads: Sequence[tuple[str, int]]) -> Array:
        """Return by the pieces of which samples a sequence is made."""
        made = [node.past_by[self.rows[name], self.depth - i] for name, i in reads if name in self.rows]
        return np.any([np.zeros(node.past_by.shape[2], dtype=bool), *made], axis=0)

    def _stepped(self, node: _Node, piece: int, points: Array) -> dict[str, Array] | None:
        """Return every sequence at a sample as coefficients and a constant; None where one is not finite."""
        names, read, function = self.steps[piece]
        past, given = node.past @ points, self.prepared.given
        at = self.prepared.depth + node.at

        def value(name: str, i: int) -> Array | float:
            if name == FREE.name:
                return points[-2] * self.sizes[name]
            row = self.rows.get(name)
            return given[name][min(at - i, self.last)] if row is None else past[row, self.depth - i]

        found = np.array([np.broadcast_to(x, points.shape[1]) for x in function(*(value(*one) for one in read))])
        if not np.isfinite(found).all():
            return None
        found[:, :-1] = (found[:, :-1] - found[:, -1:]) / TANGENT
        return {name: row / self.sizes.get(name, 1.0) for name, row in zip(names, found, strict=True)}


def _size(column: Array, most: Callable[[Array], Any]) -> float:
    return float(most(np.abs(column[np.isfinite(column)]))) or 1.0


def nearest(holds: Array) -> tuple[Array, Array]:
    """Return the smallest numbers for which nothing is negative, and which of the conditions exclude each other.

    Parameters
    ----------
    holds : (conditions, numbers + 1) array, coefficients, then constants
    """
    joined, rows = holds[:, :-1] != 0, holds[:, -1] < -EXACT
    found, against, size = np.zeros(joined.shape[1]), np.zeros(rows.size, dtype=bool), 0
    while rows.sum() > size:  # what has a number in common with what is violated
        size, own = rows.sum(), joined[rows].any(axis=0)
        rows = rows | joined[:, own].any(axis=1)
    if not size:
        return found, against
    slopes = holds[np.ix_(rows, own)]
    for _ in range(REFINED):
        rest = slopes @ found[own] + holds[rows, -1]
        if (rest >= -EXACT).all():
            return found, against
        dual = np.vstack([slopes.T, -rest - EXACT / 2])
        dual /= np.linalg.norm(slopes, axis=1)
        try:
            multipliers = nnls(dual, np.append(np.zeros(slopes.shape[1]), 1.0))[0]
        except RuntimeError:  # it did not come to an end
            break
        left = dual @ multipliers
        if left[-1] == 1.0:
            against[rows] = multipliers > 0
            return found, against
        found[own] += left[:-1] / (1.0 - left[-1])
    if not (slopes @ found[own] + holds[rows, -1] >= -EXACT).all():
        against[rows] = True
    return found, against


def _step(
    updates: Sequence[tuple[Any, Any]], values: Mapping[Any, Any]
) -> tuple[tuple[list[str], list[tuple[str, int]], Callable[..., Any]], dict[str, list[tuple[str, int]]]]:
    """Return the names of all sequences, which samples before they are made of, and their function; then each one's."""
    symbols = {left: sp.Symbol(f"x{i}", real=True) for i, (left, _) in enumerate(updates)}
    reads: dict[Any, set[Any]] = {}
    for left, right in updates:
        now = set(samples(right))
        reads[left] = (now - reads.keys()).union(*(reads[s] for s in now & reads.keys()))
    read = sorted(set().union(*reads.values()), key=str)
    plain = {s: sp.Symbol(f"s{i}", real=True) for i, s in enumerate(read)}
    steps = [(symbols[left], right.xreplace({**dict(values), **symbols, **plain})) for left, right in updates]
    function = lambdify(list(symbols.values()), list(plain.values()), steps)
    made = {left.base.name: [(s.base.name, lag(s)) for s in some] for left, some in reads.items()}
    return (list(made), [(s.base.name, lag(s)) for s in read], function), made


def _updates(law: Compensator, stages: Sequence[Solution], end: tuple[Solution, FlatEnd] | None) -> list[Any]:
    """Return the updates of a law whose stages take one input, or of which one is on a flat end; and their rooms.

    What the inputs before decide is computed as early as it is known: a search sees at once where it leads to nothing.
    """
    assert law.staged is not None
    asked = {s.target: wanted(s.target.base)[s.target.indices[0]] for s in stages if s.target.base != r}
    free = {s.unknown: sp.Piecewise(*((b.solution, b.condition) for b in s.branches if not b.flat)) for s in stages}
    flat = {end[0].unknown: end[1].at + end[1].side * FREE[k], end[0].target: end[1].level} if end else {}
    taken = {**free, **flat}
    updates = [(left, taken.get(left, right)) for left, right in law.staged.updates if left not in asked]
    updates += [(asked[left], right) for left, right in law.staged.updates if left in asked]
    updates += [(left, flat.get(left, one)) for left, one in asked.items()]
    rooms = [b.flat.room.xreplace(asked) for s in stages for b in s.branches if b.flat]
    updates += [(signal(f"{ROOM}{i}")[k], e) for i, e in enumerate(rooms)]
    solved = {e for s in law.staged.stages for e in (s.unknown, s.target) if e.base != r}
    beside = [(left, right) for left, right in updates if left not in solved]
    graph = Graph.of((left.base[k], shift(right, lag(left))) for left, right in beside)
    leads: dict[Any, int] = {}
    for one in solved:  # how soon each of them reaches what lies beside
        for base, delay in graph.delays(one.base).items():
            if delay is not None:
                leads[base] = min(delay - lag(one), leads.get(base, delay - lag(one)))
    earlier = {left.base: leads.get(left.base, -lag(left)) + lag(left) for left, _ in updates}
    own, settled = {left.base: -lag(left) for left, _ in updates}, False
    while not settled:  # none before what it reads
        settled = True
        for left, right in updates:
            known = (own[s.base] + earlier[s.base] + lag(s) for s in samples(right) if s.base in own)
            first = min(known, default=earlier[left.base])
            if first < earlier[left.base]:
                earlier[left.base], settled = first, False
    found = [(shift(left, earlier[left.base]), shift(right, earlier[left.base])) for left, right in updates]
    found += [(signal(f"{NOW}{i}")[k], e) for i, e in enumerate(rooms)]
    return [*found, (signal(WIDE)[k], sp.sympify(end[1].width))] if end and end[1].width is not None else found
