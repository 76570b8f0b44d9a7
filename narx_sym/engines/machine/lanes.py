"""The derivatives of a free run beside the run itself: one vector per state, one lane per direction.

For x_i[k] = F_i(x_j[k-l]; theta) the tangents S_i[k] = sum dF_i/dx_j[k-l] S_j[k-l] + dF_i/dtheta share their factors
across all directions: the factors are derived and computed once per sample, the sum is a few vector instructions. A
state that only few directions reach, as a play of the input that its own start alone moves, has a number for each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from ...symbolic.recursion import Recursion
from ...symbolic.sensitivity import Tangent
from ...symbolic.signals import lag
from ..plan import Plan
from .emitter import DOUBLE, INT, multiply_add

WIDE = 4  # lanes come in such groups


@dataclass(frozen=True)
class Lanes:
    """What the tangents of a recursion are made from.

    Attributes
    ----------
    plan : Plan
        Its further expressions are the factors of the tangents.
    slopes : per state a tuple of (state, lag, expression number)
    forced : per state a tuple of (lane, expression number)
    keys : tuple of (state, lag)
        The tangents that are carried from sample to sample.
    few : mapping from a state to the lanes that reach it, where a number for each is less work than whole vectors
    width : int
        Lanes and one to spare, filled up to whole vectors.
    output : int
        The state whose tangents are kept.
    """

    plan: Plan
    slopes: tuple[tuple[tuple[int, int, int], ...], ...]
    forced: tuple[tuple[tuple[int, int], ...], ...]
    keys: tuple[tuple[int, int], ...]
    few: Mapping[int, tuple[int, ...]]
    width: int
    output: int

    @classmethod
    def of(cls, recursion: Recursion, tangent: Tangent, groups: Sequence[Sequence[Any]], output: int) -> Lanes:
        """Arrange the tangents of a recursion: lanes for the parameters of `tangent`, then for the groups of starts."""
        numbers: dict[Any, int] = {}
        at = {state: i for i, state in enumerate(recursion.states)}

        def number(expr: Any) -> int:
            return numbers.setdefault(expr, len(numbers))

        slopes = tuple(
            tuple((at[s.base], lag(s), number(e)) for s, e in sorted(row, key=lambda p: -lag(p[0])) if e != 0)
            for row in tangent.slopes
        )
        forced = tuple(tuple((p, number(e)) for p, e in enumerate(row) if e != 0) for row in tangent.forced)
        longest: dict[int, int] = {}
        for row in slopes:
            for state, back, _ in row:
                longest[state] = max(longest.get(state, 0), back)
        keys = tuple((state, back) for state in sorted(longest) for back in range(1, longest[state] + 1))
        own = len(tangent.forced[0])
        reached = {state: {lane for lane, _ in row} for state, row in enumerate(forced)}
        for lane, group in enumerate(groups, own):
            for state in group:
                reached[at[state]].add(lane)
        width = -(-(own + len(groups) + 1) // WIDE) * WIDE
        every = _reaching(reached, slopes)
        few = {state: tuple(sorted(by)) for state, by in every.items() if len(by) < width // WIDE}
        return cls(Plan.of(recursion, tuple(numbers)), slopes, forced, keys, few, width, output)

    @property
    def kind(self) -> ir.VectorType:
        """The type of one tangent."""
        return ir.VectorType(DOUBLE, self.width)

    def begin(self, b: ir.IRBuilder, given: Any) -> list[Any]:
        """Load the tangents before the first sample: in the order of `keys`, of some states a number for each lane."""
        found = []
        for i, (state, _) in enumerate(self.keys):
            row = ir.Constant(INT, i)
            if state in self.few:
                first = b.mul(row, ir.Constant(INT, self.width))
                found += [b.load(b.gep(given, [b.add(first, ir.Constant(INT, lane))])) for lane in self.few[state]]
            else:
                found.append(b.load(self._row(b, given, row)))
                found[-1].align = 8
        return found

    def step(
        self, b: ir.IRBuilder, compute: Callable[[Any], Any], carried: Sequence[Any], index: Any, kept: Any
    ) -> list[Any]:
        """Write one sample: the new tangents, those of the output into memory; return what is carried on."""
        values = iter(carried)
        old: dict[tuple[int, int], Any] = {
            (s, back): {lane: next(values) for lane in self.few[s]} if s in self.few else next(values)
            for s, back in self.keys
        }
        new: dict[int, Any] = {}
        expressions = self.plan.further
        for state, (slopes, forced) in enumerate(zip(self.slopes, self.forced, strict=True)):
            moved = [
                (compute(expressions[number]), new[other] if back == 0 else old[other, back])
                for other, back, number in slopes
            ]
            alone = {lane: compute(expressions[number]) for lane, number in forced}
            for factor, by in moved:
                for lane, x in by.items() if isinstance(by, dict) else ():
                    alone[lane] = multiply_add(b, factor, x, alone[lane]) if lane in alone else b.fmul(factor, x)
            if state in self.few:
                new[state] = {lane: alone.get(lane, ir.Constant(DOUBLE, 0.0)) for lane in self.few[state]}
                continue
            total = self._filled(b, alone)
            for factor, by in moved:
                if not isinstance(by, dict):
                    total = multiply_add(b, self._spread(b, factor), by, total)
            new[state] = total
        last = new[self.output]
        b.store(self._filled(b, last) if isinstance(last, dict) else last, self._row(b, kept, index)).align = 8
        onward = [new[s] if back == 1 else old[s, back - 1] for s, back in self.keys]
        return [x for each in onward for x in (each.values() if isinstance(each, dict) else (each,))]

    def _filled(self, b: ir.IRBuilder, numbers: Mapping[int, Any]) -> Any:
        """Return a tangent with some lanes, the others zero."""
        total = ir.Constant(self.kind, [0.0] * self.width)
        for lane, x in numbers.items():
            total = b.insert_element(total, x, ir.Constant(ir.IntType(32), lane))
        return total

    def _row(self, b: ir.IRBuilder, matrix: Any, i: Any) -> Any:
        """Return where row i of a matrix begins; counted in numbers, a whole vector may take more room."""
        first = b.gep(matrix, [b.mul(i, ir.Constant(INT, self.width))])
        return b.bitcast(first, self.kind.as_pointer())

    def _spread(self, b: ir.IRBuilder, x: Any) -> Any:
        """Put a number into every lane."""
        first = b.insert_element(ir.Constant(self.kind, ir.Undefined), x, ir.Constant(ir.IntType(32), 0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
        return b.shuffle_vector(first, ir.Constant(self.kind, ir.Undefined), mask)


def _reaching(reached: Mapping[int, set[int]], slopes: Sequence[Sequence[tuple[int, int, int]]]) -> dict[int, set[int]]:
    """Return the lanes that reach each state: its own, and those of the states that it reads."""
    found = {state: set(lanes) for state, lanes in reached.items()}
    grown = True
    while grown:
        more = {s: found[s].union(*(found[other] for other, _, _ in row)) for s, row in enumerate(slopes)}
        grown, found = more != found, more
    return found
