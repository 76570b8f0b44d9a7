"""SymPy to LLVM: the update loop as machine code, without a C compiler on the user's machine."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import sympy as sp
from llvmlite import ir

from ..errors import ModelError
from .plan import Plan

DOUBLE, INT, BOOL = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
MAX_CARRIED = 8  # older samples of a state are read from memory
LARGEST, TINY = 1.7976931348623157e308, 1e-290
LIBM = {
    sp.sin: "sin", sp.cos: "cos", sp.tan: "tan", sp.tanh: "tanh", sp.exp: "exp", sp.log: "log", sp.atan: "atan",
    sp.sinh: "sinh", sp.cosh: "cosh", sp.asin: "asin", sp.acos: "acos",
}  # fmt: skip
COMPARISONS = {
    sp.StrictLessThan: "<", sp.LessThan: "<=", sp.StrictGreaterThan: ">", sp.GreaterThan: ">=",
    sp.Equality: "==", sp.Unequality: "!=",
}  # fmt: skip


class _Emitter:
    """A recursive walk from a SymPy expression to LLVM values; `known` maps symbols to values."""

    def __init__(self, builder: ir.IRBuilder, known: dict[Any, Any]):
        self.b, self.known = builder, known

    def __call__(self, expr: Any) -> Any:
        if expr in self.known:
            return self.known[expr]
        value = self.known[expr] = self.walk(expr)
        return value

    def walk(self, e: Any) -> Any:
        b = self.b
        if e.is_Number or e.is_NumberSymbol:
            return ir.Constant(DOUBLE, float(e))
        if e.is_Add:
            return self.fold(b.fadd, e.args)
        if e.is_Mul:
            numerator = [a for a in e.args if not (a.is_Pow and a.exp.is_negative)]
            below = [a.base ** (-a.exp) for a in e.args if a.is_Pow and a.exp.is_negative]
            top = self.fold(b.fmul, numerator) if numerator else ir.Constant(DOUBLE, 1.0)
            return b.fdiv(top, self.fold(b.fmul, below)) if below else top
        if e.is_Pow:
            return self.power(*e.args)
        if isinstance(e, sp.Abs):
            return self.intrinsic("llvm.fabs", e.args[0])
        if isinstance(e, sp.sign):
            x, zero = self(e.args[0]), ir.Constant(DOUBLE, 0.0)
            down = b.select(b.fcmp_ordered("<", x, zero), ir.Constant(DOUBLE, -1.0), x)  # keeps 0 and NaN
            return b.select(b.fcmp_ordered(">", x, zero), ir.Constant(DOUBLE, 1.0), down)
        if isinstance(e, (sp.Max, sp.Min)):
            return self.extreme(">" if isinstance(e, sp.Max) else "<", e.args)
        if isinstance(e, sp.Piecewise):
            return self.piecewise(e.args)
        if isinstance(e, sp.Heaviside):
            return b.uitofp(b.fcmp_ordered(">", self(e.args[0]), ir.Constant(DOUBLE, 0.0)), DOUBLE)
        if type(e) in LIBM:
            return self.call(LIBM[type(e)], e.args)
        raise ModelError(f"The native engine has no rule for {type(e).__name__} in {e}.")

    def fold(self, operation: Callable[..., Any], arguments: Any) -> Any:
        values = [self(a) for a in arguments]
        total = values[0]
        for value in values[1:]:
            total = operation(total, value)
        return total

    def power(self, base: Any, exponent: Any) -> Any:
        if exponent == sp.Rational(1, 2):
            return self.intrinsic("llvm.sqrt", base)
        if not exponent.is_Integer:
            return self.call("pow", (base, exponent))
        n, square, total = abs(int(exponent)), self(base), None
        while n:  # products, never pow()
            if n & 1:
                total = square if total is None else self.b.fmul(total, square)
            n >>= 1
            square = self.b.fmul(square, square) if n else square
        return total if exponent > 0 else self.b.fdiv(ir.Constant(DOUBLE, 1.0), total)

    def extreme(self, comparison: str, arguments: Any) -> Any:
        values = [self(a) for a in arguments]
        best = values[0]
        for value in values[1:]:
            better = self.b.fcmp_unordered(comparison, value, best)  # unordered: a NaN is kept, not hidden
            take = self.b.and_(better, self.b.fcmp_ordered("ord", best, best))
            best = self.b.select(take, value, best)
        return best

    def piecewise(self, cases: Any) -> Any:
        result = ir.Constant(DOUBLE, float("nan"))
        for value, condition in reversed(cases):
            result = self.b.select(self.condition(condition), self(value), result)
        return result

    def condition(self, c: Any) -> Any:
        if c in (sp.true, sp.false):
            return ir.Constant(BOOL, int(c == sp.true))
        if isinstance(c, (sp.And, sp.Or)):
            operation = self.b.and_ if isinstance(c, sp.And) else self.b.or_
            parts = [self.condition(a) for a in c.args]
            total = parts[0]
            for part in parts[1:]:
                total = operation(total, part)
            return total
        if isinstance(c, sp.Not):
            return self.b.not_(self.condition(c.args[0]))
        if type(c) in COMPARISONS:
            return self.b.fcmp_ordered(COMPARISONS[type(c)], self(c.lhs), self(c.rhs))
        raise ModelError(f"The native engine has no rule for the condition {c}.")

    def intrinsic(self, name: str, argument: Any) -> Any:
        return self.b.call(self.b.module.declare_intrinsic(name, [DOUBLE]), [self(argument)])

    def call(self, name: str, arguments: Any) -> Any:
        module = self.b.module
        function = module.globals.get(name)
        if function is None:
            function = ir.Function(module, ir.FunctionType(DOUBLE, [DOUBLE] * len(arguments)), name)
        return self.b.call(function, [self(a) for a in arguments])


def emit(plan: Plan) -> ir.Module:
    """Write the loop: for (i = start; i < stop; i++) { update the states; leave at the first bad value }."""
    module = ir.Module("narx")
    pointer = DOUBLE.as_pointer()
    count = len(plan.signals)
    function = ir.Function(module, ir.FunctionType(INT, [pointer] * (count + 1) + [INT, INT]), "run")
    for argument in function.args[: count + 1]:
        argument.add_attribute("noalias")
    *arrays, theta, start, stop = function.args
    entry, loop, good, done = (function.append_basic_block(n) for n in ("entry", "loop", "good", "done"))

    b = ir.IRBuilder(entry)
    states = range(len(plan.updates))
    depth = {s: max([0, *(i for j, i in plan.sample if j == s and i <= MAX_CARRIED)]) for s in states}
    known: dict[Any, Any] = {}
    for position, symbol in enumerate(plan.parameters):
        known[symbol] = b.load(b.gep(theta, [ir.Constant(INT, position)]))
    first = {
        (s, i): b.load(b.gep(arrays[s], [b.sub(start, ir.Constant(INT, i))]))
        for s in states
        for i in range(1, depth[s] + 1)
    }
    b.cbranch(b.icmp_signed("<", start, stop), loop, done)

    b.position_at_end(loop)
    index = b.phi(INT, "i")
    carried = {key: b.phi(DOUBLE, f"x{key[0]}_{key[1]}") for key in first}
    for key, symbol in plan.sample.items():
        if key in carried:
            known[symbol] = carried[key]
        elif key[0] not in states or key[1] > MAX_CARRIED:
            known[symbol] = b.load(b.gep(arrays[key[0]], [b.sub(index, ir.Constant(INT, key[1]))]))
    known[plan.time] = b.sitofp(index, DOUBLE)
    value_of = _Emitter(b, known)
    common, rows = plan.shared
    waiting = dict(common)

    def compute(expr: Any) -> Any:
        """Shared parts are computed when first needed: a later state may use an earlier one at lag 0."""
        for symbol in sorted(expr.free_symbols & waiting.keys(), key=str):
            if symbol in waiting:  # an inner part may have needed it already
                known[symbol] = compute(waiting.pop(symbol))
        return value_of(expr)

    newest = {}
    all_good = ir.Constant(BOOL, 1)
    for s in states:
        coefficients = [compute(c) for c in rows[s]]
        x = coefficients[-1]
        for c in reversed(coefficients[:-1]):
            x = b.fadd(c, b.fmul(x, carried[s, 1]))
        b.store(x, b.gep(arrays[s], [index]))
        size = b.call(module.declare_intrinsic("llvm.fabs", [DOUBLE]), [x])
        all_good = b.and_(all_good, b.fcmp_ordered("<=", size, ir.Constant(DOUBLE, LARGEST)))
        newest[s] = x
        if (s, 0) in plan.sample:
            known[plan.sample[s, 0]] = x
    b.cbranch(all_good, good, done)

    b.position_at_end(good)
    following = b.add(index, ir.Constant(INT, 1))
    more = b.icmp_signed("<", following, stop)
    b.cbranch(more, loop, done)

    index.add_incoming(start, entry)
    index.add_incoming(following, good)
    for (s, i), phi in carried.items():
        phi.add_incoming(first[s, i], entry)
        phi.add_incoming(newest[s] if i == 1 else carried[s, i - 1], good)
    b.position_at_end(done)
    result = b.phi(INT)
    result.add_incoming(start, entry)
    result.add_incoming(index, loop)
    result.add_incoming(following, good)
    b.ret(result)
    return module


@cache
def _target() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    host = llvm.Target.from_default_triple()
    return host.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3
    )


def machine_code(module: ir.Module) -> Any:
    """Optimise and load a module; the returned engine must be kept alive while its functions are used."""
    machine = _target()
    parsed = llvm.parse_assembly(str(module))
    parsed.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(parsed, passes)
    engine = llvm.create_mcjit_compiler(parsed, _target.__wrapped__())
    engine.finalize_object()
    return engine


def build(plan: Plan) -> Callable[..., int]:
    """Return run(arrays, theta, start, stop) for a plan."""
    engine = machine_code(emit(plan))
    count = len(plan.signals)
    signature = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_void_p] * (count + 1), ctypes.c_int64, ctypes.c_int64)
    function = signature(engine.get_function_address("run"))

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        return int(function(*[a.ctypes.data for a in arrays], theta.ctypes.data, start, stop))

    run.engine = engine  # type: ignore[attr-defined]  # keeps the machine code alive
    return run
