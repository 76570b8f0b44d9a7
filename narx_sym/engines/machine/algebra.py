"""Linear algebra of fits as machine code: J'J of some rows, the step that follows from it, banded recursions.

Every entry is one chain of products and sums in a fixed order, so the width of vectors and the processor's BLAS change
no bit of it. No product is fused with a sum.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache as once
from typing import Any

import numpy as np
from llvmlite import ir

from .emitter import DOUBLE, INT, kept_machine_code, loop
from .native import LARGEST

HIGH, WIDE = 4, 8  # of a tile: its sums and what is read for them fit into the vector registers
CHUNK = 128  # rows at once: they stay in the nearest cache, and sums of sums lose fewer digits
VECTOR = ir.VectorType(DOUBLE, HIGH)
Array = np.ndarray


def number(i: int) -> ir.Constant:
    """Return a whole number."""
    return ir.Constant(INT, i)


def at(b: ir.IRBuilder, array: Any, row: Any, width: Any, column: Any) -> Any:
    """Return where an entry of an array stands."""
    return b.gep(array, [b.add(b.mul(row, width), column)])


def _function(module: ir.Module, name: str, pointers: int, numbers: Sequence[Any], result: Any) -> ir.Function:
    kind = ir.FunctionType(result, [*[DOUBLE.as_pointer()] * pointers, *numbers])
    function = ir.Function(module, kind, name)
    for argument in function.args[:pointers]:
        argument.add_attribute("noalias")
    return function


def emit() -> ir.Module:
    """Write `gram`, `solve` and `banded`."""
    module = ir.Module("algebra")
    _emit_gram(module)
    _emit_solve(module)
    _emit_banded(module)
    return module


def _emit_gram(module: ir.Module) -> None:
    """Write `gram(J, sums, out, rows, stride, columns, width)`.

    `width` are the columns filled up to whole vectors, which can be read of each row; `sums` is (width, width). Tiles
    begin on the diagonal: what is right of it is summed, and written to both sides.
    """
    function = _function(module, "gram", 3, [INT] * 4, ir.VoidType())
    J, sums, out, rows, stride, columns, width = function.args
    b = ir.IRBuilder(function.append_basic_block("entry"))
    with loop(b, number(0), b.mul(width, width)) as (i, _, _):
        b.store(ir.Constant(DOUBLE, 0.0), b.gep(sums, [i]))
    with loop(b, number(0), _parts(b, rows, CHUNK)) as (part, _, _):
        first = b.mul(part, number(CHUNK))
        last = b.add(first, number(CHUNK))
        last = b.select(b.icmp_signed("<", last, rows), last, rows)
        with loop(b, number(0), _parts(b, columns, HIGH)) as (p, _, _):
            row = b.mul(p, number(HIGH))
            left = b.sub(width, row)
            pairs = b.sdiv(left, number(WIDE))
            with loop(b, number(0), pairs) as (q, _, _):
                _tile(b, J, sums, (first, last), stride, width, (row, b.add(row, b.mul(q, number(WIDE)))), WIDE)
            column = b.add(row, b.mul(pairs, number(WIDE)))
            with b.if_then(b.icmp_signed("<", column, width)):
                _tile(b, J, sums, (first, last), stride, width, (row, column), HIGH)
    with loop(b, number(0), columns) as (i, _, _), loop(b, i, columns) as (j, _, _):
        total = b.fadd(b.load(at(b, out, i, columns, j)), b.load(at(b, sums, i, width, j)))
        b.store(total, at(b, out, i, columns, j))
        b.store(total, at(b, out, j, columns, i))
    b.ret_void()


def _parts(b: ir.IRBuilder, length: Any, size: int) -> Any:
    return b.sdiv(b.add(length, number(size - 1)), number(size))


def _tile(
    b: ir.IRBuilder, J: Any, sums: Any, rows: tuple[Any, Any], stride: Any, width: Any, corner: tuple[Any, Any],
    wide: int,
) -> None:  # fmt: skip
    """Add the products of some rows to a tile of the sums, HIGH rows of `wide` numbers."""
    spread = ir.Constant(ir.VectorType(ir.IntType(32), HIGH), [0] * HIGH)
    undefined = ir.Constant(VECTOR, ir.Undefined)
    places = [(i, j) for i in range(HIGH) for j in range(0, wide, HIGH)]

    def vector(place: Any) -> Any:
        return b.bitcast(place, VECTOR.as_pointer())

    def loaded(place: Any) -> Any:
        found = b.load(vector(place))
        found.align = 8
        return found

    with loop(b, *rows, [ir.Constant(VECTOR, [0.0] * HIGH)] * len(places)) as (k, now, then):
        right = [loaded(at(b, J, k, stride, b.add(corner[1], number(j)))) for j in range(0, wide, HIGH)]
        for i in range(HIGH):
            x = b.load(at(b, J, k, stride, b.add(corner[0], number(i))))
            x = b.shuffle_vector(b.insert_element(undefined, x, ir.Constant(ir.IntType(32), 0)), undefined, spread)
            for y in right:
                then.append(b.fadd(now[len(then)], b.fmul(x, y)))
    for (i, j), total in zip(places, then, strict=True):
        place = at(b, sums, b.add(corner[0], number(i)), width, b.add(corner[1], number(j)))
        b.store(b.fadd(loaded(place), total), vector(place)).align = 8


def _emit_solve(module: ir.Module) -> None:
    """Write `solve(H, g, work, w, n, damping)`: w of (H + damping) w = -g by L D L'.

    It returns 0, and 1 where a pivot is not a positive number.
    """
    function = _function(module, "solve", 4, [INT, DOUBLE], INT)
    H, g, work, w, n, damping = function.args
    b = ir.IRBuilder(function.append_basic_block("entry"))
    zero, one = number(0), number(1)
    with loop(b, zero, n) as (i, _, _):
        with loop(b, i, n) as (j, _, _):
            b.store(b.load(at(b, H, i, n, j)), at(b, work, i, n, j))
        diagonal = at(b, work, i, n, i)
        b.store(b.fadd(b.load(diagonal), damping), diagonal)
        b.store(b.fneg(b.load(b.gep(g, [i]))), b.gep(w, [i]))
    with loop(b, zero, n) as (k, _, _):
        pivot = b.load(at(b, work, k, n, k))
        good = b.and_(
            b.fcmp_ordered(">", pivot, ir.Constant(DOUBLE, 0.0)),
            b.fcmp_ordered("<=", pivot, ir.Constant(DOUBLE, LARGEST)),
        )
        with b.if_then(b.not_(good), likely=False):
            b.ret(one)
        top = b.load(b.gep(w, [k]))
        with loop(b, b.add(k, one), n) as (i, _, _):
            factor = b.fdiv(b.load(at(b, work, k, n, i)), pivot)
            with loop(b, i, n) as (j, _, _):
                place = at(b, work, i, n, j)
                b.store(b.fsub(b.load(place), b.fmul(factor, b.load(at(b, work, k, n, j)))), place)
            place = b.gep(w, [i])
            b.store(b.fsub(b.load(place), b.fmul(factor, top)), place)
    with loop(b, zero, n) as (back, _, _):
        k = b.sub(b.sub(n, one), back)
        place = b.gep(w, [k])
        with loop(b, b.add(k, one), n, [b.load(place)]) as (j, now, then):
            then.append(b.fsub(now[0], b.fmul(b.load(at(b, work, k, n, j)), b.load(b.gep(w, [j])))))
        b.store(b.fdiv(then[0], b.load(at(b, work, k, n, k))), place)
    b.ret(zero)


def _emit_banded(module: ir.Module) -> None:
    """Write `banded(c, x, n, lags, width)`: x[k] += sum over i of c[k, i - 1] x[k - i], row by row of x, (n, width)."""
    function = _function(module, "banded", 2, [INT] * 3, ir.VoidType())
    c, x, n, lags, width = function.args
    b = ir.IRBuilder(function.append_basic_block("entry"))
    with loop(b, number(0), n) as (k, _, _):
        last = b.select(b.icmp_signed("<", k, lags), k, lags)
        with loop(b, number(0), last) as (i, _, _):
            slope = b.load(at(b, c, k, lags, i))
            before = b.sub(b.sub(k, number(1)), i)
            with loop(b, number(0), width) as (j, _, _):
                place = at(b, x, k, width, j)
                b.store(b.fadd(b.load(place), b.fmul(slope, b.load(at(b, x, before, width, j)))), place)
    b.ret_void()


@once
def _loaded() -> tuple[Any, Any, Any, Any]:
    """Return the machine code, to be kept alive, and its functions."""
    code = kept_machine_code(emit(), "gram", "solve", "banded")
    pointer, whole = ctypes.c_void_p, ctypes.c_int64
    gram = ctypes.CFUNCTYPE(None, *[pointer] * 3, *[whole] * 4)(code["gram"])
    solve = ctypes.CFUNCTYPE(whole, *[pointer] * 4, whole, ctypes.c_double)(code["solve"])
    banded = ctypes.CFUNCTYPE(None, *[pointer] * 2, *[whole] * 3)(code["banded"])
    return code, gram, solve, banded


def add_grams(J: Array, blocks: Sequence[tuple[int, slice]], out: Array) -> None:
    """Add J'J of each block of rows to out[block]."""
    _, gram, _, _ = _loaded()
    n = J.shape[1]
    width = -(-n // HIGH) * HIGH
    J = _filled_up(J, width)
    sums = np.empty((width, width))
    begin, to, between, stride = J.ctypes.data, out.ctypes.data, sums.ctypes.data, J.strides[0]
    for block, rows in blocks:
        there = to + block * out.strides[0]
        gram(begin + rows.start * stride, between, there, rows.stop - rows.start, stride // 8, n, width)


def _filled_up(J: Array, width: int) -> Array:
    """Return an array of which so many numbers can be read of each row: itself, where it is part of a wider one."""
    whole = J if J.base is None else J.base
    if isinstance(whole, np.ndarray) and whole.ndim == 2 and whole.dtype == float and whole.flags.c_contiguous:
        same = whole.shape[0] == J.shape[0] and whole.strides == J.strides
        if same and whole.shape[1] >= width and whole.ctypes.data == J.ctypes.data:
            return J
    wide = np.zeros((len(J), width))
    wide[:, : J.shape[1]] = J
    return wide


def step(H: Array, g: Array, damping: float) -> Array | None:
    """Return w of (H + damping) w = -g, or None where that is not positive definite."""
    _, _, solve, _ = _loaded()
    n = g.size
    H, g = np.ascontiguousarray(H, dtype=float), np.ascontiguousarray(g, dtype=float)
    work, w = np.empty((n, n)), np.empty(n)
    failed = solve(H.ctypes.data, g.ctypes.data, work.ctypes.data, w.ctypes.data, n, damping)
    return None if failed else w


def banded(lags: Sequence[int], slopes: Sequence[Array], right: Array) -> Array:
    """Return x of x[k] - sum_i c_i[k] x[k-i] = right[k], as part of an array with whole vectors in each row."""
    _, _, _, run = _loaded()
    (n, m), deepest = right.shape, max(lags)
    c, x = np.zeros((n, deepest)), np.zeros((n, -(-m // HIGH) * HIGH))
    for i, slope in zip(lags, slopes, strict=True):
        c[:, i - 1] = slope
    x[:, :m] = right
    run(c.ctypes.data, x.ctypes.data, n, deepest, x.shape[1])
    return x[:, :m]
