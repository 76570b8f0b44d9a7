"""One recursion, many parameter sets: the step over all sets at once, so that the processor runs them side by side.

The loop over the sets is the inner one. What does not depend on the parameters is computed once per step; the rest is
vectorised by LLVM over the sets.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir

from ..plan import Plan
from .emitter import DOUBLE, INT, Emitter, kept_machine_code, loop, multiply_add

SETS = 32  # side by side: a constant, so that LLVM knows that the rows do not overlap


def past(plan: Plan) -> list[tuple[int, int]]:
    """Return the (state, lag) pairs that are kept from step to step."""
    deepest = {s: max([1, *(i for j, i in plan.sample if j == s)]) for s in range(len(plan.updates))}
    return [(s, i) for s, n in deepest.items() for i in range(1, n + 1)]


class _Grouped(Emitter):
    """Multiplies and adds what all sets share first: it is then computed once per step. Fuses sums of products."""

    def __init__(self, builder: ir.IRBuilder, known: dict[Any, Any], varying: set[Any]):
        super().__init__(builder, known)
        self.varying = varying

    def order(self, arguments: Any) -> list[Any]:
        return sorted(arguments, key=lambda a: bool(a.free_symbols & self.varying))

    def fold(self, operation: Callable[..., Any], arguments: Any) -> Any:
        return super().fold(operation, self.order(arguments))

    def walk(self, e: Any) -> Any:
        if not e.is_Add:
            return super().walk(e)
        first, *others = self.order(e.args)
        total = self(first)
        for part in others:
            if part.is_Mul and not any(f.is_Pow and f.exp.is_negative for f in part.args):
                *shared, last = self.order(part.args)
                total = multiply_add(self.b, self.fold(self.b.fmul, shared), self(last), total)
            else:
                total = self.b.fadd(total, self(part))
        return total


def emit(plan: Plan, keep: bool, output: int) -> ir.Module:
    """Write `run(inputs..., target, past, theta, cost, kept, start, stop)`.

    `past` is (n_past, SETS), `theta` (n_parameters, SETS), `cost` (SETS,): the squared error of the state number
    `output` against the target. With `keep` that state is written to `kept`, (stop, SETS).
    """
    module, pointer = ir.Module("ensemble"), DOUBLE.as_pointer()
    states = range(len(plan.updates))
    count = len(plan.signals) - len(states)
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), [pointer] * (count + 5) + [INT] * 2), "run")
    for argument in function.args[: count + 5]:
        argument.add_attribute("noalias")
    inputs = function.args[:count]
    target, memory, theta, cost, kept, start, stop = function.args[count:]
    b = ir.IRBuilder(function.append_basic_block("entry"))
    keys = past(plan)

    def at(array: Any, row: int, column: Any) -> Any:
        return b.gep(array, [b.add(ir.Constant(INT, row * SETS), column)])

    with loop(b, start, stop) as (k, _, _):
        shared = {
            symbol: b.load(b.gep(inputs[s - len(states)], [b.sub(k, ir.Constant(INT, i))]))
            for (s, i), symbol in plan.sample.items()
            if s not in states
        }
        shared[plan.time] = b.sitofp(k, DOUBLE)
        wanted = b.load(b.gep(target, [k]))
        with loop(b, ir.Constant(INT, 0), ir.Constant(INT, SETS)) as (j, _, _):
            known = dict(shared)
            held = {key: b.load(at(memory, row, j)) for row, key in enumerate(keys)}
            known |= {plan.sample[key]: x for key, x in held.items() if key in plan.sample}
            known |= {symbol: b.load(at(theta, row, j)) for row, symbol in enumerate(plan.parameters)}
            value_of, newest = _Grouped(b, known, set(known) - set(shared)), []
            for s, coefficients in enumerate(plan.collected):
                *lower, x = (value_of(c) for c in coefficients)
                for c in reversed(lower):
                    x = multiply_add(b, x, held[s, 1], c)
                newest.append(x)
                known[plan.sample[s, 0]] = x
                value_of.varying.add(plan.sample[s, 0])
            for row, (s, i) in enumerate(keys):
                b.store(newest[s] if i == 1 else held[s, i - 1], at(memory, row, j))
            gap = b.fsub(newest[output], wanted)
            b.store(b.fadd(b.load(b.gep(cost, [j])), b.fmul(gap, gap)), b.gep(cost, [j]))
            if keep:
                b.store(newest[output], b.gep(kept, [b.add(b.mul(k, ir.Constant(INT, SETS)), j)]))
    b.ret_void()
    return module


def build(plan: Plan, keep: bool, output: int) -> Callable[..., None]:
    """Return run(inputs, target, past, theta, cost, kept, start, stop)."""
    engine = kept_machine_code(emit(plan, keep, output))
    pointers = len(plan.signals) - len(plan.updates) + 5
    signature = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * pointers, *[ctypes.c_int64] * 2)
    function = signature(engine.get_function_address("run"))

    def run(
        inputs: list[np.ndarray], target: np.ndarray, past: np.ndarray, theta: np.ndarray, cost: np.ndarray,
        kept: np.ndarray, start: int, stop: int,
    ) -> None:  # fmt: skip
        arrays = [*inputs, target, past, theta, cost, kept]
        function(*[a.ctypes.data for a in arrays], start, stop)

    run.engine = engine  # type: ignore[attr-defined]  # keeps the machine code alive
    return run
