"""From SymPy expressions to LLVM values, loops around them, and the machine code of both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import contextmanager
from functools import cache as once
from functools import reduce
from itertools import count
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import sympy as sp
from llvmlite import ir

from ...errors import ModelError
from ...files import cache
from ...symbolic.functions import Elementary, X, arguments_of, row_of
from ..writer import RELATIONS

DOUBLE, INT, BOOL = ir.DoubleType(), ir.IntType(64), ir.IntType(1)


class Emitter:
    """A recursive walk from a SymPy expression to LLVM values; `known` maps symbols to values."""

    def __init__(self, builder: ir.IRBuilder, known: dict[Any, Any]):
        self.b, self.known = builder, known

    def __call__(self, expr: Any) -> Any:
        """Return the value of an expression, computed once."""
        if expr in self.known:
            return self.known[expr]
        value = self.known[expr] = self.walk(expr)
        return value

    def walk(self, e: Any) -> Any:
        """Emit one node."""
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
        row = row_of(e)
        if row is not None:
            return self.elementary(row, arguments_of(e))
        if e.is_Pow:
            return self.power(*e.args)
        if isinstance(e, sp.Piecewise):
            return self.piecewise(e.args)
        if e.is_Boolean or e.is_Relational:  # a condition that several branches share
            return self.condition(e)
        raise ModelError(f"The native engine has no rule for {type(e).__name__} in {e}.")

    def elementary(self, row: Elementary, arguments: Any) -> Any:
        """Emit an elementary function."""
        if row.native.startswith("select"):
            return self.extreme(row.extreme, arguments)
        if row.native.startswith("llvm."):
            return self.intrinsic(row.native, *arguments)
        if row.native:
            return self.call(row.native, arguments)
        return Emitter(self.b, {X: self(arguments[0])})(row.definition)

    def fold(self, operation: Callable[..., Any], arguments: Any) -> Any:
        """Chain a binary operation."""
        return reduce(operation, [self(a) for a in arguments])

    def power(self, base: Any, exponent: Any) -> Any:
        """Emit a power; whole ones as products."""
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
        """Emit Max or Min; a NaN is kept."""
        best, *others = (self(a) for a in arguments)
        for value in others:
            better = self.b.fcmp_unordered(comparison, value, best)  # unordered: a NaN is kept, not hidden
            take = self.b.and_(better, self.b.fcmp_ordered("ord", best, best))
            best = self.b.select(take, value, best)
        return best

    def piecewise(self, cases: Any) -> Any:
        """Emit nested selects, the last case first."""
        result = ir.Constant(DOUBLE, float("nan"))
        for value, condition in reversed(cases):
            result = self.b.select(self.condition(condition), self(value), result)
        return result

    def condition(self, c: Any) -> Any:
        """Emit a relational or a Boolean combination."""
        if c in self.known:
            return self.known[c]
        if c in (sp.true, sp.false):
            return ir.Constant(BOOL, int(c == sp.true))
        if isinstance(c, (sp.And, sp.Or)):
            operation = self.b.and_ if isinstance(c, sp.And) else self.b.or_
            return reduce(operation, [self.condition(a) for a in c.args])
        if isinstance(c, sp.Not):
            return self.b.not_(self.condition(c.args[0]))
        if type(c) in RELATIONS:
            return self.b.fcmp_ordered(RELATIONS[type(c)], self(c.lhs), self(c.rhs))
        raise ModelError(f"The native engine has no rule for the condition {c}.")

    def intrinsic(self, name: str, argument: Any) -> Any:
        """Emit an LLVM intrinsic of one argument."""
        return self.b.call(self.b.module.declare_intrinsic(name, [DOUBLE]), [self(argument)])

    def call(self, name: str, arguments: Any) -> Any:
        """Emit a call of the C library."""
        module = self.b.module
        function = module.globals.get(name)
        if function is None:
            function = ir.Function(module, ir.FunctionType(DOUBLE, [DOUBLE] * len(arguments)), name)
        return self.b.call(function, [self(a) for a in arguments])


def multiply_add(b: ir.IRBuilder, slope: Any, x: Any, constant: Any) -> Any:
    """Emit slope*x + constant; one fused step where the processor has it: half the latency of the loop."""
    if isinstance(x.type, ir.VectorType):  # of these LLVM fuses itself what it may
        return b.fadd(constant, b.fmul(slope, x, flags=("contract",)), flags=("contract",))
    return b.fma(slope, x, constant) if fused() else b.fadd(constant, b.fmul(slope, x))


@contextmanager
def loop(b: ir.IRBuilder, first: Any, last: Any, carried: Sequence[Any] = ()) -> Any:
    """Write for (i = first; i < last; i++); yields (i, carried values, a list to put their successors in)."""
    before = b.block
    body, after = (b.function.append_basic_block(n) for n in ("body", "after"))
    b.cbranch(b.icmp_signed("<", first, last), body, after)
    b.position_at_end(body)
    index = b.phi(INT)
    phis = [b.phi(x.type) for x in carried]
    successors: list[Any] = []
    yield index, phis, successors
    following = b.add(index, ir.Constant(INT, 1))
    b.cbranch(b.icmp_signed("<", following, last), body, after)
    end = b.block
    index.add_incoming(first, before)
    index.add_incoming(following, end)
    b.position_at_end(after)
    for i, (phi, initial) in enumerate(zip(phis, carried, strict=True)):
        result = b.phi(phi.type)
        for x in (phi, result):
            x.add_incoming(initial, before)
            x.add_incoming(successors[i], end)
        successors[i] = result  # what the loop leaves behind


@once
def fused() -> bool:
    """Whether this processor multiplies and adds in one step; elsewhere llvm.fma would be a slow call."""
    return bool(llvm.get_host_cpu_features().get("fma", False)) or llvm.get_process_triple().startswith(
        ("aarch64", "arm64")
    )


@once
def _target() -> Any:
    """Return a description of this processor."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    host = llvm.Target.from_default_triple()
    return host.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3, reloc="pic"
    )


@once
def processor() -> str:
    """Return what machine code depends on beside what it is made from, as text."""
    llvm.initialize_native_target()
    made_by = (llvmlite.__version__, *map(str, llvm.llvm_version_info), llvm.get_process_triple())
    return "\n".join((*made_by, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()))


def machine_code(module: ir.Module, straight: bool = False) -> bytes:
    """Return the machine code of a module.

    Code that is `straight` already, with its common parts taken out and nothing left to do for several samples at once,
    is not optimised once more: that took half of the time to make it or more, and what came out ran as fast (2 % of a
    run, over all effects).
    """
    parsed = llvm.parse_assembly(str(module))
    parsed.verify()
    if not straight:
        options = llvm.create_pipeline_tuning_options(speed_level=3)
        passes = llvm.create_pass_builder(_target(), options)
        passes.getModulePassManager().run(parsed, passes)
    return bytes(_target().emit_object(parsed))


def kept_machine_code(module: ir.Module, *names: str) -> Any:
    """Return the functions of a module by name, of code that is kept between processes under the module's text."""
    return loaded(cache.made(f"{processor()}\n{module}", lambda: machine_code(module)), *names)


_numbered = count()


@once
def _loader() -> Any:
    _target()  # initialises what a loader needs
    return llvm.create_lljit_compiler()


def loaded(code: bytes, *names: str) -> Any:
    """Load machine code; return the addresses of functions by name, to be kept alive while they are used."""
    library = llvm.JITLibraryBuilder().add_object_img(code).add_current_process()
    for name in names:
        library.export_symbol(name)
    return library.link(_loader(), f"code {next(_numbered)}")
