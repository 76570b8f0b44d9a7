"""The derivatives of a free run beside the run itself: one vector per state, one lane per direction.

For x_i[k] = F_i(x_j[k-l]; theta) the tangents S_i[k] = sum dF_i/dx_j[k-l] S_j[k-l] + dF_i/dtheta share their factors
across all directions: the factors are derived and computed once per sample, the sum is a few vector instructions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    width : int
        Lanes and one to spare, filled up to whole vectors.
    output : int
        The state whose tangents are kept.
    """

    plan: Plan
    slopes: tuple[tuple[tuple[int, int, int], ...], ...]
    forced: tuple[tuple[tuple[int, int], ...], ...]
    keys: tuple[tuple[int, int], ...]
    width: int
    output: int

    @classmethod
    def of(cls, recursion: Recursion, tangent: Tangent, lanes: int, output: int) -> Lanes:
        """Arrange the tangents of a recursion."""
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
        return cls(Plan.of(recursion, tuple(numbers)), slopes, forced, keys, -(-(lanes + 1) // WIDE) * WIDE, output)

    @property
    def kind(self) -> ir.VectorType:
        """The type of one tangent."""
        return ir.VectorType(DOUBLE, self.width)

    def begin(self, b: ir.IRBuilder, given: Any) -> list[Any]:
        """Load the tangents before the first sample, in the order of `keys`."""
        found = [b.load(self._row(b, given, ir.Constant(INT, i))) for i in range(len(self.keys))]
        for loaded in found:
            loaded.align = 8
        return found

    def step(
        self, b: ir.IRBuilder, compute: Callable[[Any], Any], carried: Sequence[Any], index: Any, kept: Any
    ) -> list[Any]:
        """Write one sample: the new tangents, those of the output into memory; return what is carried on."""
        old = dict(zip(self.keys, carried, strict=True))
        new: dict[int, Any] = {}
        zero = ir.Constant(self.kind, [0.0] * self.width)
        expressions = self.plan.further
        for state, (slopes, forced) in enumerate(zip(self.slopes, self.forced, strict=True)):
            total = zero
            for lane, number in forced:
                total = b.insert_element(total, compute(expressions[number]), ir.Constant(ir.IntType(32), lane))
            for other, back, number in slopes:
                moved = new[other] if back == 0 else old[other, back]
                total = multiply_add(b, self._spread(b, compute(expressions[number])), moved, total)
            new[state] = total
        b.store(new[self.output], self._row(b, kept, index)).align = 8
        return [new[s] if back == 1 else old[s, back - 1] for s, back in self.keys]

    def _row(self, b: ir.IRBuilder, matrix: Any, i: Any) -> Any:
        """Return where row i of a matrix begins; counted in numbers, a whole vector may take more room."""
        first = b.gep(matrix, [b.mul(i, ir.Constant(INT, self.width))])
        return b.bitcast(first, self.kind.as_pointer())

    def _spread(self, b: ir.IRBuilder, x: Any) -> Any:
        """Put a number into every lane."""
        first = b.insert_element(ir.Constant(self.kind, ir.Undefined), x, ir.Constant(ir.IntType(32), 0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
        return b.shuffle_vector(first, ir.Constant(self.kind, ir.Undefined), mask)
