"""The elementary functions: one row each, with everything that the rooms above need to know about it.

A further function is a further row: the grammar reads it, every engine computes it, C99 and Structured Text are written
with it, and laws are derived through it. Its derivative is SymPy's own, and consists of functions that stand here too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import sympy as sp

X, Y = (sp.Dummy(name, real=True) for name in "xy")  # the arguments in the expressions below


@dataclass(frozen=True, kw_only=True)
class Elementary:
    """One elementary function.

    The texts of a language hold `{x}` for the argument; of a function of several arguments they join two of them, `{x}`
    and `{y}`. An empty text means that the engine takes `definition` instead.

    Attributes
    ----------
    name : str
        In the grammar, and in texts.
    cls : class of its nodes in SymPy, or what makes them where they are powers
    native : str
        For machine code: a function of the C library, an LLVM intrinsic ("llvm.fabs"), or "select >", the argument that
        is larger than the others ("select <": smaller), where a NaN is kept.
    numpy, python : str
        With the names of NumPy and of `math`.
    c : str
        C99; `{f}` ends the name of a function of the library (f for single precision), `{zero}` and `{one}` are
        numbers.
    st : str
        Structured Text of IEC 61131-3.
    casadi : str
        The name of a function of CasADi.
    javascript : str
        ECMAScript 2015.
    dimension : "kept", "none", "sign" or "root"
        What it makes of a unit: the same one; it takes pure numbers and gives one; it takes any unit and gives a pure
        number; it halves the power.
    sides : (below, above), expressions in X, or None
        What a function with a kink, or a jump, at 0 is on either side of it. None where it is smooth.
    extreme : ">", "<" or ""
        Of several arguments the one that compares so with the others; it has kinks where two are equal.
    inverse : expression in X, or None
        Of an increasing function, where X is in the open interval `values`.
    values : (lowest, highest)
        What the function reaches; with `inverse`.
    everywhere : bool
        Whether it has a value for every real number: only such functions stand in a pool of terms.
    constant : bool
        Whether the grammar takes it of a number: others can leave the range of numbers.
    also : texts
        Further names that the grammar reads.
    definition : expression in X (and Y), or None
        The same value by other nodes.
    """

    name: str
    cls: Any
    native: str
    numpy: str
    python: str
    c: str
    st: str
    casadi: str
    javascript: str
    dimension: str
    sides: tuple[Any, Any] | None
    extreme: str = ""
    inverse: Any
    values: tuple[Any, Any] = (-sp.oo, sp.oo)
    everywhere: bool
    constant: bool = True
    also: tuple[str, ...] = ()
    definition: Any = None


def _library(name: str, **other: Any) -> Elementary:
    """Return a smooth function of a pure number that has the same name in every language; `other` says what differs."""
    usual: dict[str, Any] = {
        "name": name, "cls": getattr(sp, name), "native": name, "numpy": f"{name}({{x}})", "python": f"{name}({{x}})",
        "c": f"{name}{{f}}({{x}})", "st": f"{name.upper()}({{x}})", "casadi": name, "javascript": f"Math.{name}({{x}})",
        "dimension": "none", "sides": None, "inverse": None, "everywhere": True,
    }  # fmt: skip
    return Elementary(**(usual | other))


def _extreme(name: str, cls: Any, compares: str, definition: Any) -> Elementary:
    """Return Max or Min. Unlike fmax and fmin, and like all others here, they keep a NaN."""
    word = name.lower()
    return Elementary(
        name=name, cls=cls, native=f"select {compares}", numpy=f"{word}imum({{x}}, {{y}})", casadi="",
        python=f"({{x}} if {{x}} {compares} {{y}} or {{x}} != {{x}} else {{y}})",
        c=f"{{x}} {compares} {{y}} || {{x}} != {{x}} ? {{x}} : {{y}}", st=f"{name.upper()}({{x}}, {{y}})",
        javascript=f"Math.{word}({{x}}, {{y}})", dimension="kept", sides=None, extreme=compares, inverse=None,
        everywhere=True, definition=definition,
    )  # fmt: skip


@lru_cache(maxsize=1024)
def within(x: Any, low: Any, high: Any) -> Any:
    """Return x held between two limits; of what is no number SymPy need not ask which of them is the larger."""
    undecided = bool(sp.sympify(x).free_symbols)
    return sp.Max(low, sp.Min(high, x, evaluate=not undecided), evaluate=not undecided)


def _continued(last: int) -> Any:
    """Return Lambert's continued fraction of tanh, from X^2/(2 n + 1) on."""
    found = sp.Integer(last)
    for odd in range(last - 2, 0, -2):
        found = odd + X**2 / found
    return X / found


def _series(last: int) -> Any:
    """Return the series of sinh up to X^last, as nested products."""
    found = sp.S.One
    for odd in range(last, 1, -2):
        found = 1 + X**2 / (odd * (odd - 1)) * found
    return X * found


# Structured Text has neither; EXP by itself loses the digits of what is small. Beyond 20 tanh is 1 to the last digit.
SMALL = sp.Rational(1, 2)
TANH = sp.Piecewise(
    (_continued(13), sp.And(-SMALL < X, X < SMALL)), (1 - 2 / (sp.exp(2 * within(X, -20, 20)) + 1), True)
)
SINH = sp.Piecewise((_series(13), sp.And(-SMALL < X, X < SMALL)), ((sp.exp(X) - sp.exp(-X)) / 2, True))
SQRT = _library("sqrt", native="llvm.sqrt", dimension="root", everywhere=False)
TABLE: tuple[Elementary, ...] = (
    Elementary(
        name="abs", also=("Abs",), cls=sp.Abs, native="llvm.fabs", numpy="absolute({x})", python="abs({x})",
        c="fabs{f}({x})", st="ABS({x})", casadi="fabs", javascript="Math.abs({x})", dimension="kept",
        sides=(-X, X), inverse=None, everywhere=True,
    ),
    _library("sin"),
    _library("cos"),
    _library("tan", constant=False),
    _library("tanh", st="", definition=TANH, inverse=sp.log((1 + X) / (1 - X)) / 2, values=(-1, 1)),
    _library("sinh", st="", definition=SINH, constant=False),
    _library("cosh", st="((EXP({x}) + EXP(-{x}))/2.0)", constant=False),
    _library("asin", numpy="arcsin({x})", everywhere=False),
    _library("acos", numpy="arccos({x})", everywhere=False),
    _library("atan", numpy="arctan({x})", inverse=sp.tan(X), values=(-sp.pi / 2, sp.pi / 2)),
    _library("exp", inverse=sp.log(X), values=(0, sp.oo), constant=False),
    _library("log", st="LN({x})", inverse=sp.exp(X), everywhere=False, constant=False),
    Elementary(
        name="sign", cls=sp.sign, native="", numpy="sign({x})", casadi="sign", javascript="Math.sign({x})",
        python="({x} if {x} != {x} else ({x} > 0.0) - ({x} < 0.0))",
        c="{x} > {zero} ? {one} : ({x} < {zero} ? -{one} : {x})",
        st="SEL({x} > 0.0, SEL({x} < 0.0, 0.0, -1.0), 1.0)",
        dimension="sign", sides=(sp.S.NegativeOne, sp.S.One), inverse=None, everywhere=True,
        definition=sp.Piecewise((1, X > 0), (-1, X < 0), (X, True)),
    ),
    SQRT,
    _extreme("Max", sp.Max, ">", sp.Piecewise((Y, X <= Y), (X, X > Y), (X + Y, True), evaluate=False)),
    _extreme("Min", sp.Min, "<", sp.Piecewise((Y, X >= Y), (X, X < Y), (X + Y, True), evaluate=False)),
    Elementary(  # 0 at 0, unlike SymPy's own value
        name="Heaviside", cls=sp.Heaviside, native="", numpy="where({x} > 0.0, 1.0, 0.0)", casadi="",
        python="(1.0 if {x} > 0.0 else 0.0)", javascript="({x} > 0.0 ? 1.0 : 0.0)",
        c="({x} > {zero} ? {one} : {zero})", st="SEL({x} > 0.0, 0.0, 1.0)",
        dimension="sign", sides=(sp.S.Zero, sp.S.One), inverse=None, everywhere=True, constant=False,
        definition=sp.Piecewise((1, X > 0), (0, True)),
    ),
)  # fmt: skip
NAMES: dict[str, Elementary] = {name: row for row in TABLE for name in (row.name, *row.also)}
CLASSES: dict[Any, Elementary] = {row.cls: row for row in TABLE}
KINKED: tuple[Any, ...] = tuple(row.cls for row in TABLE if row.sides or row.extreme)


def follows(asked: Any, last: Any, rate: Any) -> Any:
    """Return what is asked for, no further than `rate` from the last value: a limit of the rate."""
    return within(asked, last - rate, last + rate)


def row_of(node: Any) -> Elementary | None:
    """Return the row of a node; None for anything that is no elementary function."""
    return SQRT if node.is_Pow and node.exp == sp.S.Half else CLASSES.get(type(node))


def arguments_of(node: Any) -> tuple[Any, ...]:
    """Return what the function of a node is taken of: a power has its exponent beside it, a step its value at 0."""
    return node.args if CLASSES.get(type(node), SQRT).extreme else node.args[:1]
