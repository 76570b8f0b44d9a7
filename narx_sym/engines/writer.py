"""One walk from SymPy expressions to lines of text: the languages differ in their words only.

What a branch of a Piecewise needs is computed inside that branch: what is not chosen can neither stop a controller
nor raise an error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar

import sympy as sp

from ..errors import ModelError
from ..symbolic.functions import SQRT, Elementary, X, arguments_of, row_of
from .plan import Plan

SUM, PRODUCT, CALL, NAME = range(4)  # how tightly a text binds
MAX_PRODUCT = 16  # higher powers are left to the language's own function
LARGEST_SINGLE, SMALLEST_SINGLE = 3.4e38, 1.2e-38
RELATIONS = {
    sp.StrictLessThan: "<", sp.LessThan: "<=", sp.StrictGreaterThan: ">", sp.GreaterThan: ">=",
    sp.Equality: "==", sp.Unequality: "!=",
}  # fmt: skip


class Writer:
    """A recursive walk over expressions that writes the lines computing them.

    A subclass gives the words of a language. `names` maps symbols to texts, `waiting` holds shared parts that are
    written when they are first met.
    """

    language: ClassVar[str]
    words: ClassVar[str]  # the column of `narx_sym.symbolic.functions`
    relations: ClassVar[Mapping[Any, str]] = RELATIONS
    joints: ClassVar[tuple[str, str, str]]  # and, or, not
    truth: ClassVar[tuple[str, str]]  # false, true
    pow: ClassVar[str] = "pow"
    nan: ClassVar[str] = "nan"
    defining: ClassVar[str] = "{name} = {shown}"  # a part
    declaring: ClassVar[str] = ""  # a part that is assigned later, where a language wants that
    assigning: ClassVar[str] = "{name} = {shown};"
    choosing: ClassVar[tuple[str, ...]] = ("if ({condition}) {{", "} else {", "}")  # if, else, end

    def __init__(self, names: Mapping[Any, str], single: bool = False):
        self.names, self.single = dict(names), single
        self.waiting: dict[Any, Any] = {}
        self.lines: list[str] = []
        self.parts = 0

    # -- words that a language may give otherwise --------------------------------------------------------------

    def number(self, value: float) -> str:
        """Write a number that is not negative."""
        return repr(value)

    def call(self, name: str, *arguments: str) -> str:
        """Write the call of a mathematical function."""
        return f"{name}({', '.join(arguments)})"

    def power(self, base: str, exponent: str) -> str:
        """Write a power that is no product."""
        return self.call(self.pow, base, exponent)

    def undefined(self, expr: Any) -> str:
        """Write what a Piecewise without a valid case is."""
        return self.nan

    def define(self, name: str, shown: str, boolean: bool = False) -> list[str]:
        """Write the definition of a part."""
        return [self.defining.format(name=name, shown=shown)]

    def declare(self, name: str) -> list[str]:
        """Write the declaration of a part that the branches of a Piecewise assign."""
        return [self.declaring.format(name=name)] if self.declaring else []

    def assign(self, name: str, shown: str) -> str:
        """Write an assignment."""
        return self.assigning.format(name=name, shown=shown)

    def branches(self, condition: str, then: list[str], otherwise: list[str]) -> list[str]:
        """Write an if with both branches."""
        begin, between, *end = self.choosing
        return [begin.format(condition=condition), *then, between, *otherwise, *end]

    # -- the walk ----------------------------------------------------------------------------------------------

    def __call__(self, expr: Any, least: int = SUM) -> str:
        """Return the text of an expression, in brackets where it binds less tightly than `least`."""
        shown, binding = self.walk(expr)
        return shown if binding >= least else f"({shown})"

    def walk(self, e: Any) -> tuple[str, int]:
        """Return the text of one node, and how tightly it binds."""
        if e in self.waiting:
            inner = self.waiting.pop(e)
            self.names[e] = self.part(inner)
        if e in self.names:
            return self.names[e], NAME
        if e.is_Number or e.is_NumberSymbol:
            value = self.checked(float(e))
            return (f"-{self.number(-value)}", SUM) if value < 0 else (self.number(value), NAME)
        if e.is_Add:
            return self.sum(e.args), SUM
        if e.is_Mul:
            return self.product(e)
        if e.is_Pow:
            return self.raised(e.base, e.exp)
        if isinstance(e, sp.Piecewise):
            return self.piecewise(e), NAME
        row = row_of(e)
        if row is not None:
            return self.elementary(row, arguments_of(e)), CALL
        raise ModelError(f"{self.language} has no rule for {type(e).__name__} in {e}.")

    def elementary(self, row: Elementary, arguments: Sequence[Any]) -> str:
        """Write an elementary function; of several arguments two by two."""
        first, *others = (self.walk(a) for a in arguments)
        if not others:
            return self.applied(row, first)
        for other in others:
            first = self.applied(row, first, other), CALL
        return first[0]

    def applied(self, row: Elementary, *arguments: tuple[str, int]) -> str:
        """Write a function of texts; one that is needed twice gets a name."""
        pattern, given = getattr(row, self.words), {}
        if not pattern:
            return self.defined(row, *arguments[0])
        for letter, (shown, binding) in zip("xy", arguments, strict=False):
            twice = pattern.count(f"{{{letter}}}") > 1 and binding != NAME
            given[letter] = self.stored(shown) if twice else shown
        return pattern.format(**given)

    def defined(self, row: Elementary, shown: str, binding: int) -> str:
        """Write a function of a text that the language has no word for, by its definition."""
        argument = sp.Dummy(real=True)
        self.names[argument] = shown if binding == NAME else self.stored(shown)
        return self(row.definition.xreplace({X: argument}), CALL)

    def checked(self, value: float) -> float:
        """Refuse numbers that the language has no literal for."""
        if not math.isfinite(value):
            raise ModelError(f"{self.language} has no literal for {value}.")
        if self.single and value and not SMALLEST_SINGLE < abs(value) < LARGEST_SINGLE:
            raise ModelError(f"The number {value:g} does not fit into single precision; use double.")
        return value

    def sum(self, terms: Iterable[Any]) -> str:
        """Write a sum, each sign as an operation."""
        shown = ""
        for term in terms:
            negative = bool(term.as_coeff_Mul()[0].is_negative)
            joint = (" - " if negative else " + ") if shown else "-" * negative
            shown += joint + self(-term if negative else term, PRODUCT)
        return shown

    def product(self, e: Any) -> tuple[str, int]:
        """Write a product; negative powers are divided by."""
        if e.as_coeff_Mul()[0].is_negative:
            return f"-{self(-e, PRODUCT)}", SUM
        below = [a for a in e.args if a.is_Pow and a.exp.is_negative]
        above = [a for a in e.args if a not in below]
        shown = "*".join(self(a, PRODUCT) for a in above) or self.number(1.0)
        if below:
            bottom = [a.base ** (-a.exp) for a in below]
            shown += f"/{self(bottom[0], CALL)}" if len(below) == 1 else f"/({'*'.join(self(b, CALL) for b in bottom)})"
        return shown, PRODUCT

    def raised(self, base: Any, exponent: Any) -> tuple[str, int]:
        """Write a power: small whole ones as products, square roots as such."""
        if exponent.is_negative:
            return f"{self.number(1.0)}/{self(base ** (-exponent), CALL)}", PRODUCT
        if exponent.is_Integer and exponent <= MAX_PRODUCT:
            return "*".join([self.named(base)] * int(exponent)), PRODUCT
        if exponent == sp.Rational(1, 2):
            return self.elementary(SQRT, [base]), CALL
        return self.power(self(base), self(exponent)), CALL

    def named(self, expr: Any) -> str:
        """Return a name or a number for an expression that is needed more than once."""
        shown, binding = self.walk(expr)
        return shown if binding == NAME else self.part(expr, shown)

    def part(self, expr: Any, shown: str = "") -> str:
        """Write a part that gets its own name, and return that."""
        boolean = bool(expr.is_Relational or isinstance(expr, sp.logic.boolalg.BooleanFunction))
        return self.stored(shown or (self.condition(expr) if boolean else self(expr)), boolean)

    def stored(self, shown: str, boolean: bool = False) -> str:
        """Give a text its own name, and return that."""
        name = self.fresh()
        self.lines += self.define(name, shown, boolean)
        return name

    def fresh(self) -> str:
        """Return a new name."""
        self.parts += 1
        return f"part_{self.parts - 1}"

    def piecewise(self, e: Any) -> str:
        """Write the branches of a Piecewise, and return the name of its value."""
        name = self.fresh()
        self.lines += self.declare(name)
        self.cases(name, e, e.args)
        return name

    def cases(self, name: str, e: Any, cases: Sequence[Any]) -> None:
        """Write an if for the first of the cases; the others stand in its else."""
        if not cases:
            self.lines.append(self.assign(name, self.undefined(e)))
            return
        (value, condition), *others = cases
        if condition == sp.true:
            self.lines.append(self.assign(name, self(value)))
            return
        decided = self.condition(condition)
        then = self.block(lambda: self.lines.append(self.assign(name, self(value))))
        self.lines += self.branches(decided, then, self.block(lambda: self.cases(name, e, others)))

    def block(self, write: Callable[[], None]) -> list[str]:
        """Return the lines of a branch; what they compute is not known outside."""
        outside = self.lines, dict(self.names), dict(self.waiting)
        self.lines = []
        write()
        inside, (self.lines, self.names, self.waiting) = self.lines, outside
        return indented(inside)

    def condition(self, c: Any) -> str:
        """Write a relational or a Boolean combination."""
        if c in (sp.true, sp.false):
            return self.truth[c == sp.true]
        if isinstance(c, (sp.And, sp.Or)):
            joint = self.joints[isinstance(c, sp.Or)]
            return f" {joint} ".join(f"({self.condition(a)})" for a in c.args)
        if isinstance(c, sp.Not):
            return f"{self.joints[2]}({self.condition(c.args[0])})"
        if type(c) in self.relations:
            return f"{self(c.lhs)} {self.relations[type(c)]} {self(c.rhs)}"
        if c.is_Symbol:
            return self(c)
        raise ModelError(f"{self.language} has no rule for the condition {c}.")

    def updates(self, plan: Plan, done: Callable[[int, str], None]) -> None:
        """Write the equations of a plan in order; `done` is told each state and the text of its newest value.

        A shared part that has a name already is not written again.
        """
        common, rows = plan.shared
        self.waiting = {symbol: e for symbol, e in common if symbol not in self.names}
        for s, (*inner, outer) in enumerate(rows):
            shown, binding = self.walk(outer)
            for c in reversed(inner):
                factor = shown if binding >= PRODUCT else f"({shown})"
                last = self.names[plan.sample[s, 1]]
                shown, binding = last if factor == self.number(1.0) else f"{factor}*{last}", PRODUCT
                if c != 0:
                    shown, binding = f"{self(c)} + {shown}", SUM
            done(s, shown)


def indented(lines: Iterable[str]) -> list[str]:
    """Put lines one level further in."""
    return [f"    {line}" for line in lines]
