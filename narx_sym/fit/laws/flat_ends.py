"""Of all the inputs on flat pieces those with which a law misses nothing: sets of them, sample by sample.

At each sample a law either takes its one input, while the target stays within the flat ends of the map, or the target
is exactly that of a flat end and any input beyond it will do: a number of zero or more that is free. Along such a run
everything is affine in the free numbers, and what must hold is linear in them:

    room[k] >= 0 where the law has one input;   room[k] = 0, free[k] >= 0 on a flat end.

An equation takes one free number away, so that few are free at a time: as many as samples pass until an input is seen,
since the outputs that follow decide on them. What is left is a polytope; where it is empty, an earlier sample was on
another piece, and the search goes back to the latest one (depth first). The point of a polytope that is nearest to the
one before solves a least distance problem (Lawson & Hanson 1974, chapter 23). Where the pieces of the model are not
affine, tangents stand for them.
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
    """A run until a sample, all of it affine: coefficients of the free numbers, then what is left without them."""

    at: int
    past: Array  # (sequences, samples before, free numbers + 1)
    inputs: Array  # (samples so far, free numbers + 1)
    holds: Array  # (conditions, free numbers + 1): not negative
    piece: int = 0

    def in_other(self, change: Array) -> _Node:
        """Return the node in other free numbers; (free numbers + 1, others + 1) matrix."""
        return replace(self, past=self.past @ change, inputs=self.inputs @ change, holds=self.holds @ change)


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
        self.steps = [_step(one, law.model.values) for one in recursions]
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
        best = self._first(values, begin)
        waiting, nodes = [best], 0
        while waiting and best.at < end and nodes < NODES:
            node, nodes = waiting.pop(), nodes + 1
            best = node if node.at > best.at else best
            waiting += [new for new in self._next(node, end)][::-1]
        return None if best.at == begin else best.inputs[:, -1]

    def _first(self, values: Mapping[str, Array], begin: int) -> _Node:
        past, now = np.zeros((len(self.rows), self.depth, 1)), self.prepared.depth + begin
        for name, row in self.rows.items():
            column, first = values[name], now + self.leads[name] - self.beside[name]
            past[row, :, 0] = column[np.clip(np.arange(first - self.depth, first), 0, column.size - 1)]
        return _Node(begin, past, np.zeros((0, 1)), np.zeros((0, 1)))

    def _next(self, node: _Node, end: int) -> Iterator[_Node]:
        """Return what may come after a node: the flat end that it is on, one input, other flat ends."""
        for piece in sorted(range(len(self.steps)), key=lambda one: (one != node.piece or not one, one)):
            new = self._moved(node, piece, end)
            free = None if new is None else nearest(new.holds)
            if new is not None and free is not None:
                yield new.in_other(np.column_stack([np.eye(free.size + 1, free.size), np.append(free, 1.0)]))

    def _moved(self, node: _Node, piece: int, end: int) -> _Node | None:
        """Return a node one sample later on a piece; None where that leaves nothing."""
        n = node.past.shape[2]
        if piece:  # one number more is free
            node, n = node.in_other(np.insert(np.eye(n), n - 1, 0.0, axis=1)), n + 1
        points = np.eye(n) * TANGENT
        points[-1] = 1.0
        new = self._stepped(node, piece, points)
        if new is None:
            return None
        rooms = [new[f"{ROOM}{i}"] for i in range(self.ends) if node.at + self.leads[f"{ROOM}{i}"] < end]
        equation = new[f"{NOW}{piece - 1}"] if piece else None
        first = [new[f"{NOW}{i}"] for i in range(self.ends)]
        if any(one[-1] < -EXACT and np.abs(one[:-1]).max(initial=0.0) < NOTHING for one in first):
            return None
        if piece:
            rooms.append(np.eye(n)[-2])
            rooms += [new[WIDE] - np.eye(n)[-2]] if WIDE in new else []
        past = np.concatenate([node.past[:, 1:], np.array([[new[name]] for name in self.rows])], axis=1)
        inputs, holds = np.vstack([node.inputs, new["m"]]), np.vstack([node.holds, *rooms])
        found = _Node(node.at + 1, past, inputs, holds, piece)
        if equation is not None:
            change = _solved(equation)
            if change is None:
                return None
            found = found.in_other(change)
        constant = np.abs(found.holds[:, :-1]).max(axis=1, initial=0.0) < NOTHING
        if (found.holds[constant, -1] < -EXACT).any():
            return None
        return replace(found, holds=found.holds[~constant])

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


def nearest(holds: Array) -> Array | None:
    """Return the smallest numbers for which nothing is negative: coefficients, then constants; None where none are."""
    slopes, rest = holds[:, :-1], holds[:, -1]
    found = np.zeros(slopes.shape[1])
    for _ in range(REFINED if found.size else 0):
        if (rest >= -EXACT).all():
            return found
        dual = np.vstack([slopes.T, -rest - EXACT / 2])
        dual /= np.linalg.norm(slopes, axis=1)
        try:
            left = dual @ nnls(dual, np.append(np.zeros(found.size), 1.0))[0]
        except RuntimeError:  # it did not come to an end
            return None
        if left[-1] == 1.0:
            return None
        found = found + left[:-1] / (1.0 - left[-1])
        rest = slopes @ found + holds[:, -1]
    return found if (rest >= -EXACT).all() else None


def _solved(equation: Array) -> Array | None:
    """Return free numbers as others that solve an equation, one fewer; None where nothing solves it."""
    slope, rest = equation[:-1], equation[-1]
    n = slope.size
    if np.abs(slope).max(initial=0.0) < NOTHING:
        return np.eye(n + 1) if abs(rest) <= EXACT else None
    change = np.zeros((n + 1, n))
    change[:-1, :-1], change[:-1, -1], change[-1, -1] = null_space(slope[None]), -slope * rest / (slope @ slope), 1.0
    return change


def _step(
    updates: Sequence[tuple[Any, Any]], values: Mapping[Any, Any]
) -> tuple[list[str], list[tuple[str, int]], Callable[..., Any]]:
    """Return the names of all sequences, which samples before they are made of, and their function."""
    made: dict[Any, Any] = {}
    for left, right in updates:
        made[left] = right.xreplace(made).xreplace(dict(values))
    read = sorted({s for e in made.values() for s in samples(e)}, key=str)
    plain = [sp.Symbol(f"s{i}", real=True) for i in range(len(read))]
    function = lambdify([e.xreplace(dict(zip(read, plain, strict=True))) for e in made.values()], plain)
    return [left.base.name for left in made], [(s.base.name, lag(s)) for s in read], function


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
    later = [(leads.get(left.base, -lag(left)) + lag(left), left, right) for left, right in updates]
    found = [(shift(left, n), shift(right, n)) for n, left, right in later]
    found += [(signal(f"{NOW}{i}")[k], e) for i, e in enumerate(rooms)]
    return [*found, (signal(WIDE)[k], sp.sympify(end[1].width))] if end and end[1].width is not None else found
