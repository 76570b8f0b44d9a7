"""SymPy to LLVM: the update loop as machine code, without a C compiler on the user's machine."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir

from ..plan import Plan
from .emitter import BOOL, DOUBLE, INT, Emitter, loop, machine_code, multiply_add
from .lanes import Lanes

MAX_CARRIED = 8  # older samples of a state are read from memory
BLOCK = 256  # steps whose coefficients are computed at once
LARGEST, TINY = 1.7976931348623157e308, 1e-290


class _Function:
    """The function `run(arrays..., theta, start, stop) -> first bad index or stop` while it is being written.

    With `beside`, two arrays stand before theta: where tangents go, and those before the first sample.
    """

    def __init__(self, plan: Plan, beside: int = 0):
        self.plan, self.states = plan, range(len(plan.updates))
        self.module = ir.Module("narx")
        pointer, count = DOUBLE.as_pointer(), len(plan.signals) + beside
        kind = ir.FunctionType(INT, [pointer] * (count + 1) + [INT, INT])
        self.function = ir.Function(self.module, kind, "run")
        for argument in self.function.args[: count + 1]:
            argument.add_attribute("noalias")
        *self.arrays, self.theta, self.start, self.stop = self.function.args
        self.b = ir.IRBuilder(self.function.append_basic_block("entry"))
        self.parameters = {
            symbol: self.b.load(self.b.gep(self.theta, [ir.Constant(INT, i)]))
            for i, symbol in enumerate(plan.parameters)
        }

    def load(self, signal: int, index: Any, lag: int) -> Any:
        return self.b.load(self.b.gep(self.arrays[signal], [self.b.sub(index, ir.Constant(INT, lag))]))

    def size(self, x: Any) -> Any:
        name = "llvm.fabs.f64" if x.type == DOUBLE else f"llvm.fabs.v{x.type.count}f64"
        return self.b.call(self.module.declare_intrinsic(name, (), ir.FunctionType(x.type, [x.type])), [x])

    def finite(self, x: Any) -> Any:
        return self.b.fcmp_ordered("<=", self.size(x), ir.Constant(DOUBLE, LARGEST))

    def flushed(self, x: Any) -> Any:
        """Put zero for a value about to become denormal: denormal arithmetic is 15 times slower."""
        tiny, zero = (ir.Constant(x.type, [v] * x.type.count if x.type != DOUBLE else v) for v in (TINY, 0.0))
        return self.b.select(self.b.fcmp_ordered("<", self.size(x), tiny), zero, x)

    def coefficients(self, index: Any, known: dict[Any, Any]) -> Callable[[Any], Any]:
        """Return a function that computes expressions at one index; shared parts when they are first needed."""
        known |= self.parameters
        known[self.plan.time] = self.b.sitofp(index, DOUBLE)
        value_of = Emitter(self.b, known)
        waiting = dict(self.plan.shared[0])

        def compute(expr: Any) -> Any:
            for symbol, inner in self.plan.needed(expr, waiting):
                known[symbol] = value_of(inner)
            return value_of(expr)

        return compute

    def checked(self, first: Any, last: Any) -> None:
        """Return from `run` at the first index in first ... last - 1 where a state is not finite."""
        b = self.b
        with loop(self.b, first, last) as (index, _, _):
            good = b.and_(ir.Constant(BOOL, 1), ir.Constant(BOOL, 1))
            for s in self.states:
                good = b.and_(good, self.finite(self.load(s, index, 0)))
            with b.if_then(b.not_(good), likely=False):
                b.ret(index)


def scan_levels(plan: Plan) -> list[list[int]] | None:
    """Group the states so that each is affine in its own last value with coefficients known from earlier groups.

    Such coefficients are computed for a whole block at once; what is left of the recursion is x = c0 + c1*x. The
    sensitivities of a model form one group behind the model. None where a state does not fit.
    """
    rows = plan.collected
    level: dict[int, int] = {}
    owner = {symbol: s for (s, _), symbol in plan.sample.items() if s < len(plan.updates)}
    for s, row in enumerate(rows):
        used = {owner[symbol] for c in row for symbol in c.free_symbols if symbol in owner}
        if len(row) > 2 or any(u >= s for u in used):
            return None
        level[s] = 1 + max((level[u] for u in used), default=-1)
    return [[s for s in level if level[s] == n] for n in range(max(level.values()) + 1)]


def _emit_blocks(plan: Plan, levels: list[list[int]]) -> ir.Module:
    f = _Function(plan)
    b, rows = f.b, plan.shared[1]
    # Equal coefficients share a buffer: all sensitivities of a model have the same slope dF/dy.
    buffers = {c: b.alloca(DOUBLE, ir.Constant(INT, BLOCK)) for row in rows for c in row}
    computed: set[Any] = set()
    begin = [f.load(s, f.start, 1) if (s, 1) in plan.sample else ir.Constant(DOUBLE, 0.0) for s in f.states]
    outer = b.add(
        b.sdiv(b.sub(b.sub(f.stop, f.start), ir.Constant(INT, 1)), ir.Constant(INT, BLOCK)), ir.Constant(INT, 1)
    )
    outer = b.select(b.icmp_signed("<", f.start, f.stop), outer, ir.Constant(INT, 0))
    with loop(b, ir.Constant(INT, 0), outer, begin) as (block, carried, successors):
        first = b.add(f.start, b.mul(block, ir.Constant(INT, BLOCK)))
        length = b.sub(f.stop, first)
        length = b.select(b.icmp_signed("<", length, ir.Constant(INT, BLOCK)), length, ir.Constant(INT, BLOCK))
        last = dict(enumerate(carried))
        good = ir.Constant(BOOL, 1)
        for group in levels:
            with loop(b, ir.Constant(INT, 0), length) as (j, _, _):
                index = b.add(first, j)
                earlier = {s for level in levels[: levels.index(group)] for s in level}
                known = {
                    symbol: f.load(s, index, i)
                    for (s, i), symbol in plan.sample.items()
                    if s in earlier or s not in f.states
                }
                compute = f.coefficients(index, known)
                for c in dict.fromkeys(c for s in group for c in rows[s] if c not in computed):
                    b.store(compute(c), b.gep(buffers[c], [j]))
                    computed.add(c)
            with loop(b, ir.Constant(INT, 0), length, [good, *(last[s] for s in group)]) as (j, now, then):
                sound, *values = now
                following = []
                for s, x in zip(group, values, strict=True):
                    constant, *slope = (b.load(b.gep(buffers[c], [j])) for c in rows[s])
                    x = multiply_add(b, slope[0], x, constant) if slope else constant
                    b.store(x, b.gep(f.arrays[s], [b.add(first, j)]))
                    sound = b.and_(sound, f.finite(x))
                    following.append(x)
                then += [sound, *following]
            good = then[0]
            last |= dict(zip(group, then[1:], strict=True))
        with b.if_then(b.not_(good), likely=False):
            f.checked(first, b.add(first, length))
        successors += [f.flushed(last[s]) for s in f.states]
    b.ret(f.stop)
    return f.module


def _emit_steps(plan: Plan, lanes: Lanes | None = None) -> ir.Module:
    f = _Function(plan, beside=0 if lanes is None else 2)
    b, rows = f.b, plan.shared[1]
    depth = {s: max([0, *(i for j, i in plan.sample if j == s and i <= MAX_CARRIED)]) for s in f.states}
    keys = [(s, i) for s in f.states for i in range(1, depth[s] + 1)]
    inner = ir.Constant(INT, BLOCK)
    before = [f.load(s, f.start, i) for s, i in keys]
    before += lanes.begin(b, f.arrays[-1]) if lanes else []
    with loop(b, f.start, f.stop, before) as (index, now, then):
        carried = dict(zip(keys, now, strict=False))
        known = {}
        for key, symbol in plan.sample.items():
            if key in carried:
                known[symbol] = carried[key]
            elif key[0] not in f.states or key[1] > MAX_CARRIED:
                known[symbol] = f.load(key[0], index, key[1])
        compute = f.coefficients(index, known)
        newest, good = {}, ir.Constant(BOOL, 1)
        for s in f.states:
            coefficients = [compute(c) for c in rows[s]]
            x = coefficients[-1]
            for c in reversed(coefficients[:-1]):
                x = multiply_add(b, x, carried[s, 1], c)
            b.store(x, b.gep(f.arrays[s], [index]))
            good = b.and_(good, f.finite(x))
            newest[s] = x
            if (s, 0) in plan.sample:
                known[plan.sample[s, 0]] = x
        with b.if_then(b.not_(good), likely=False):
            b.ret(index)
        edge = b.icmp_signed("==", b.srem(index, inner), ir.Constant(INT, 0))
        for s, i in keys:
            x = newest[s] if i == 1 else carried[s, i - 1]
            then.append(b.select(edge, f.flushed(x), x))
        for moved in lanes.step(b, compute, now[len(keys) :], index, f.arrays[-2]) if lanes else []:
            then.append(b.select(edge, f.flushed(moved), moved))
    b.ret(f.stop)
    return f.module


def coded(plan: Plan, lanes: Lanes | None = None) -> bytes:
    """Return the machine code of a plan, of its tangents too where they are given.

    The loop over k is written in blocks where the algebra allows it, else step by step: that code is straight.
    """
    levels = scan_levels(plan) if lanes is None else None
    return machine_code(_emit_steps(plan, lanes) if levels is None else _emit_blocks(plan, levels), levels is None)


def bound(code: Any, count: int, numbers: np.ndarray) -> Callable[..., int]:
    """Return run(arrays, theta, start, stop) of loaded machine code over so many arrays; `numbers` follow theta."""
    signature = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_void_p] * (count + 1), ctypes.c_int64, ctypes.c_int64)
    function = signature(code["run"])

    def given(theta: np.ndarray) -> np.ndarray:
        return np.concatenate([theta, numbers]) if numbers.size else theta

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        values = given(theta)
        return int(function(*[a.ctypes.data for a in arrays], values.ctypes.data, start, stop))

    def over(arrays: list[np.ndarray], start: int, stop: int) -> Callable[[np.ndarray], int]:
        """Return run(theta) over arrays that stay where they are."""
        addresses = [a.ctypes.data for a in arrays]

        def move(theta: np.ndarray, _kept: Any = arrays) -> int:  # their memory, as long as this is called
            values = given(theta)
            return int(function(*addresses, values.ctypes.data, start, stop))

        return move

    run.code, run.over = code, over  # type: ignore[attr-defined]  # keeps the machine code alive
    return run
