"""Inversion in stages: from the output back to the input, each stage one equation in one unknown.

Every path from the input to the output passes some sequences: with effects at the output and at the input that is
y <- x <- v <- u. Each of them is solved for from the one before it; what lies beside the path, and what effects
remember, is computed forward.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import sympy as sp

from ..errors import NotInvertible
from ..models.model import Model
from ..symbolic.graph import Graph
from ..symbolic.identities import expanded
from ..symbolic.printing import text
from ..symbolic.recursion import Recursion
from ..symbolic.signals import INNER_INPUTS, INNER_OUTPUTS, held, k, lag, m, r, samples, shift, signal, swap, x, y
from .breakpoints import JUMPS
from .solution import Solution, resting, summed
from .solve import FAR, solve_for

Updates = tuple[tuple[Any, Any], ...]
WIDER = 3.0  # how many ranges beyond the identified ones a root finder looks


@dataclass(frozen=True)
class Staged:
    """A law in stages.

    Attributes
    ----------
    stages : tuple of Solution, from the output to the input
    updates : tuple of (left, right), in true time: `x[k+1] = ...` is computed together with m[k]
    delay : int
        The samples between the input and the output that it reaches first.
    own : mapping from each sequence of the model to its equation, the input called m
    leads : mapping from each sequence to the lead at which the law computes it
    note : text
        What makes the law delicate, if anything.
    """

    stages: tuple[Solution, ...]
    updates: Updates
    delay: int
    own: Mapping[Any, Any]
    leads: Mapping[Any, int]
    note: str = ""

    @cached_property
    def whole(self) -> Solution:
        """All stages as one equation in m[k], which is not solved."""
        expr = _inlined(self.own, _graph(self.own).delays(m), shift(self.own[y], self.delay), m[k])
        return Solution(m[k], r[k + self.delay], swap(expr, {y: r}), m[k - 1], "root finder", ())


def stages_of(model: Model) -> Staged:
    """Derive the stages of a model.

    Raises
    ------
    NotInvertible
        Where a stage has no solution.
    """
    own, values = _equations(model), model.values
    graph = _graph(own)
    delays: dict[Any, Any] = graph.delays(m)
    if delays[y] is None:
        raise NotInvertible("The model has no input term: there is nothing to solve for (Assumption A1).")
    chain = _chain(graph.fastest(m))
    together = {s.left.base: s.initial for s in model.states}
    turns = any(e.has(*JUMPS) for e in own.values())  # what asks for the sign of a step notices its last digit
    solved, updates = [], []
    above = gap = sp.S.Zero  # the size of what is added up in the stages above, and what the last of them adds up
    for upper, lower in pairwise(chain):
        delay, above = delays[upper], above + summed(gap)
        unknown = lower[k + (0 if lower == m else delays[lower])]
        expr = swap(_inlined(own, delays, shift(own[upper], delay), unknown), {y: r})
        target = r[k + delay] if upper == y else upper[k + delay]
        found = solve_for(
            expr, unknown, target, shift(unknown, -1), values, limits_of(model, lower), _rest(model), together, above,
        )  # fmt: skip
        if turns and upper != y and found.closed_form:
            found = replace(found, branches=(resting(unknown, target, expr, found.last, above), *found.branches))
        gap = expr - target
        solved.append(found)
        updates += [(signal(name)[unknown.indices[0]], e) for name, e in found.steps]
        updates.append((unknown, found.value))
    leads = _leads(updates, own, {b: d for b, d in delays.items() if b in chain[1:] and d is not None}, delays)
    plain = {b: e for b, e in own.items() if b != y}
    beside = [(b[k + leads[b]], swap(shift(e, leads[b]), {y: r})) for b, e in plain.items() if b in leads]
    taken = {left.base for left, _ in updates}
    every = {one[0].base: one for one in (*updates, *(o for o in beside if o[0].base not in taken))}
    everything = tuple(every[left.base] for left, _ in _in_turn(every.values()))
    early = delays[x] - delays[y] if delays.get(x) is not None else 0
    note = (
        f"the effect at the output reacts to the input {early} sample(s) before the linear part does: the law "
        "inverts this effect, and diverges unless the effect is larger than the linear part"
    )
    return Staged(tuple(solved), everything, delays[y], own, leads, note if early else "")


def _equations(model: Model) -> dict[Any, Any]:
    """Return the model's equations with the input called m; terms that their numbers switch off are gone."""
    found, off = {}, {s: sp.S.Zero for s, value in model.values.items() if not value}
    for left, right in model.recursion.updates:
        exact = set(samples(expanded(right.xreplace(model.values))))
        # Parameters that are zero switch most of them off: all others stay symbols, which do not round.
        forms = (right, expanded(right.xreplace(off)))
        same = (e for e in forms if not model.values or set(samples(e)) == exact)
        found[left.base] = swap(next(same, None) or expanded(right.xreplace(model.values)), {model.input: m})
    return found


def _graph(own: Mapping[Any, Any]) -> Graph:
    return Graph.of((base[k], right) for base, right in own.items())


def _chain(newest: Graph) -> list[Any]:
    """Return the sequences that every newest path from the output to the input passes, in order."""

    def distances(without: Any = None) -> dict[Any, int]:
        found, edge, steps = {y: 0}, {y}, 0
        while edge:
            steps += 1
            edge = {b for a in edge for b in newest.reads.get(a, ())} - found.keys() - {without}
            found |= dict.fromkeys(edge, steps)
        return found

    every = distances()
    passed = [b for b in every if b not in (y, m) and m not in distances(b)]
    return [y, *sorted(passed, key=lambda b: every[b]), m]


def _inlined(own: Mapping[Any, Any], delays: Mapping[Any, Any], expr: Any, unknown: Any) -> Any:
    """Write out what depends on the unknown beside it."""
    while True:
        beside = {
            s: shift(own[s.base], -lag(s))
            for s in samples(expr)
            if s != unknown and s.base in own and delays[s.base] is not None and -lag(s) == delays[s.base]
        }
        if not beside:
            return expr
        expr = expr.xreplace(beside)


def _leads(updates: Iterable[Any], own: Mapping[Any, Any], found: dict[Any, int], delays: Mapping[Any, Any]) -> Any:
    """Return the lead at which each sequence that is needed must be computed."""
    found = dict(found)
    reads = [s for _, right in updates for s in samples(right)]
    while True:
        more: dict[Any, int] = {}
        for s in [*reads, *(e for b, lead in found.items() for e in samples(shift(own[b], lead)))]:
            if s.base not in own or s.base == y:
                continue
            # What the newest input reaches is computed with it, all else when it is first needed.
            newest = delays[s.base]
            lead = newest if newest is not None and -lag(s) >= newest - 1 else -lag(s)
            if lead > found.get(s.base, -sp.oo):
                more[s.base] = max(lead, more.get(s.base, lead))
        if not more:
            return found
        found |= more


def in_order(updates: Sequence[tuple[Any, Any]], symbols: Sequence[Any]) -> Recursion:
    """Return updates in true time as a recursion."""
    return Recursion(tuple(_in_turn(updates)), tuple(symbols))


def _in_turn(updates: Iterable[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Return updates in true time with each sequence shifted to k, each after what it needs."""
    updates = list(updates)
    leads = {left.base: -lag(left) for left, _ in updates}
    moved = {left.base: swap(right, {}, {b: -i for b, i in leads.items()}) for left, right in updates}
    waiting, done = dict(moved), []
    while waiting:
        ready = next(
            (b for b, e in waiting.items() if not any(s.base in waiting and not lag(s) for s in samples(e))), None
        )
        if ready is None:  # cannot happen for a model that can be computed
            raise NotInvertible(f"{text(next(iter(waiting)))} and others depend on each other at the same sample.")
        done.append((ready[k], waiting.pop(ready)))
    return done


def wanted(base: Any) -> Any:
    """Return the sequence of what a stage asks for, beside what is then reached."""
    return signal(f"{base.name}_wanted")


def guarded(staged: Staged, clipped: Any) -> Updates:
    """Return the law with the model beside it: the model's own past stands where the law has the reference's.

    So the law goes on from where the machine is, when its input is limited or a reference cannot be reached.

    Parameters
    ----------
    clipped : function of the wanted m[k]
        What the actuator gives.
    """
    asked = {s.unknown: wanted(s.unknown.base)[s.unknown.indices[0]] for s in staged.stages}
    steps = {signal(name) for s in staged.stages for name, _ in s.steps}
    found = []
    for left, right in staged.updates:
        if left in asked or left.base in steps:
            past = {s: y[s.indices[0]] for s in samples(right, r) if -lag(s) < staged.delay}
            found.append((asked.get(left, left), right.xreplace({**past, **asked})))
    found.append((m[k], clipped(asked[m[k]])))
    roots = [*found, (y[k + staged.delay], shift(staged.own[y], staged.delay))]
    delays = _graph(staged.own).delays(m)
    leads = _leads(roots, staged.own, {b: i for b, i in staged.leads.items()}, delays) | {y: staged.delay}
    found += [(b[k + leads[b]], shift(e, leads[b])) for b, e in staged.own.items() if b in leads]
    return tuple(found)


def limits_of(model: Model, base: Any) -> tuple[float, float]:
    """Return where a root of a sequence is looked for."""
    outer = model.output if base in INNER_OUTPUTS else model.input
    ranges = model.info.ranges
    if outer.name not in ranges:
        return -FAR, FAR
    low, high = ranges[outer.name]
    wide, origin = WIDER * (high - low), 0.0 if base == m else float(model.operating_point.get(outer, 0.0))
    return low - wide - origin, high + wide - origin


def _rest(model: Model) -> Any:
    """Return a function that puts the middle of the identified ranges in the place of all samples."""
    middle = {}
    for base, outer, inners in ((model.input, m, INNER_INPUTS), (model.output, r, INNER_OUTPUTS)):
        low, high = model.info.ranges.get(base.name, (0.0, 0.0))
        origin = float(model.operating_point.get(base, 0.0))
        middle[outer] = (low + high) / 2 if high > low else origin
        middle |= dict.fromkeys(inners, middle[outer] - origin)
    return lambda expr: held(expr, lambda base: sp.Float(middle.get(base, 0.0)))
