"""The solution of one equation in one unknown: its branches, what they need, what they reach, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from ..symbolic.identities import added, expanded, vanishes
from ..symbolic.printing import InLatex, latex_sum, text
from ..symbolic.sensitivity import derivative

STILL = sp.Float(1e-13)  # of what is added up: a gap below it is one of rounding
ROUNDED, POINTS = 1e-13, 16  # of what is added up: rounding; where it is looked for
UNIQUE = ("linear", "branches", "nodes", "inverse function")  # ways that leave no choice, unless their notes say so


class Root(sp.Function):
    """The w nearest to `last` with `gap` = 0, between two limits: Root(gap, w, last, low, high).

    Where there may be several roots, the size of what is added up in the gap follows, and where the gap has kinks.
    A node for the equations that have no closed form; only the Python engine computes it.
    """

    @property
    def free_symbols(self) -> set[Any]:
        """All but the unknown, which is bound."""
        return set().union(*(a.free_symbols for a in self.args)) - {self.args[1]}

    def _eval_is_extended_real(self) -> bool:
        return True

    def _eval_derivative(self, s: Any) -> Any:
        gap, w, *_ = self.args
        return (-derivative(gap, s) / derivative(gap, w)).xreplace({w: self})  # the implicit function theorem


@dataclass(frozen=True)
class FlatEnd:
    """A flat piece at an end of a map: from `at` on, downwards (side -1) or upwards (1), all gives the target `level`.

    No target with a negative `room` is reached; `width` is that of the piece, None where it has no end.
    """

    side: int
    at: Any
    level: Any
    room: Any
    width: Any = None


@dataclass(frozen=True)
class Branch:
    """One case of a solution: where `condition` holds, and no earlier one does, the unknown is `solution`.

    `form` is the smooth expression in the unknown that equals the target there; None where a limit or a jump holds it.
    `flat` is the flat end of which it is the nearest value.
    """

    condition: Any
    solution: Any
    form: Any = None
    flat: FlatEnd | None = None


@dataclass(frozen=True)
class Polynomial(InLatex):
    """0 = c_n w^n + ... + c_1 w + c_0 with n of at least 2: its real roots are the w that reach the target.

    So a NARX model that is a polynomial in its newest input gives its compensation inputs as roots, among which one has
    to be chosen (arXiv 2011.12246, Nonlinear Dynamics 2021; read in its abstract, which does not say how it is chosen).
    Here the root nearest to the value before is taken: the input moves as little as it can, and stays on its side of a
    fold. The roots of a quadratic equation lie even to both sides of its vertex, so that the nearest one is the one on
    the same side. Where no root is real, w goes where the polynomial is nearest to zero: to the vertex of a quadratic,
    from which it leaves to the side where the polynomial rises: both are as near.

    Attributes
    ----------
    unknown, last : expressions
        w, and its value before.
    coefficients : tuple of expressions, from c_n to c_0
    """

    unknown: Any
    last: Any
    coefficients: tuple[Any, ...]

    @classmethod
    def of(cls, gap: Any, unknown: Any, last: Any) -> Polynomial | None:
        """Return the polynomial that an expression is in an unknown; None where it is none, or of the first degree."""
        w = sp.Dummy("w", real=True)
        left = gap.xreplace({unknown: w})
        if not left.is_polynomial(w):
            return None
        left = expanded(left)
        found: list[Any] = []
        while left != 0:  # Taylor's, at zero
            found.append(expanded(left.xreplace({w: sp.S.Zero}) / sp.factorial(len(found))))
            left = expanded(derivative(left, w))
        return cls(unknown, last, tuple(reversed(found))) if len(found) > 2 else None

    @property
    def degree(self) -> int:
        """The highest power of the unknown."""
        return len(self.coefficients) - 1

    @property
    def terms(self) -> list[tuple[Any, Any]]:
        """(coefficient, power of the unknown) pairs, the highest power first, without those that are not there."""
        powers = range(self.degree, -1, -1)
        return [(c, self.unknown**n) for c, n in zip(self.coefficients, powers, strict=True) if c != 0]

    def held(self, values: Mapping[Any, Any]) -> Polynomial:
        """Return the polynomial with numbers in the place of parameters."""
        return replace(self, coefficients=tuple(c.xreplace(dict(values)) for c in self.coefficients))

    @property
    def choice(self) -> str:
        """Say which root is taken, in words."""
        said = f"of its {self.degree} roots the real one nearest to {text(self.last)}"
        if self.degree % 2:
            return said
        least = (
            "the vertex, and from there the one where it rises" if self.degree == 2 else "where it is nearest to zero"
        )
        return f"{said}; where none is real, {least}"

    @property
    def sentence(self) -> str:
        """Say which equation the unknown solves, and which of its roots it is."""
        return f"{text(self.unknown)} is a root of {self}: {self.choice}"

    def __str__(self) -> str:
        shown = [(f"({text(c)})" if c.is_Add else text(c), "" if t == 1 else f"*{text(t)}") for c, t in self.terms]
        return " + ".join(f"{c}{t}" for c, t in shown).replace("+ -", "- ") + " = 0"

    def latex(self) -> str:
        """LaTeX of the equation: the coefficients, then the powers of the unknown."""
        return latex_sum(sp.S.Zero, self.terms)


@dataclass(frozen=True)
class Solution:
    """The value of an unknown that makes an expression equal a target.

    Attributes
    ----------
    unknown, target, expr, last : expressions
        `expr` is what must equal `target`; it contains the unknown, whose value before is `last`.
    how : "linear", "branches", "plays", "nodes", "quadratic", "inverse function" or "root finder"
    branches : tuple of Branch, in order
    steps : pairs (name of a further sequence, expression), needed before the branches
    needs : relationals under which there is exactly one solution; those that numbers alone decide are not in it
    reach : (lowest, highest) target that is reached, -oo and oo where there is no limit
    notes : texts
        What is chosen where there is a choice.
    flat : texts
        Which targets every value on a flat piece gives: the one nearest to `last` is taken.
    steep : float, optional
        The slope of `expr` is proved to be at least that, or at most minus that, for every value of the unknown.
    """

    unknown: Any
    target: Any
    expr: Any
    last: Any
    how: str
    branches: tuple[Branch, ...]
    steps: tuple[tuple[str, Any], ...] = ()
    needs: tuple[Any, ...] = ()
    reach: tuple[Any, Any] = (-sp.oo, sp.oo)
    notes: tuple[str, ...] = ()
    flat: tuple[str, ...] = ()
    steep: float | None = None

    @property
    def value(self) -> Any:
        """The solution as one expression."""
        if len(self.branches) == 1:
            return self.branches[0].solution
        return sp.Piecewise(*((b.solution, b.condition) for b in self.branches))

    def residual(self) -> Any:
        """Put each branch back where it is meant and subtract the target: 0 where the algebra is exact."""
        for branch in self.branches:
            turned = branch.solution.atoms(sp.sign) - (branch.form or branch.solution).atoms(sp.sign)
            for side in (1, -1) if turned else (1,):  # a slope that samples turn
                solution = branch.solution.xreplace(dict.fromkeys(turned, sp.Integer(side)))
                if branch.form is not None and (gap := self._left(branch.form, solution)) != 0:
                    return gap
        return sp.S.Zero

    def _left(self, form: Any, solution: Any) -> Any:
        gap = form.xreplace({self.unknown: solution}) - self.target
        while limits := [f for f in gap.atoms(sp.Max, sp.Min) if f.has(self.target)]:
            reached = {f: next(e for e in f.args if e.has(self.target)) for f in limits}
            gap = gap.xreplace(reached)  # the discriminant where there is a solution
        return sp.S.Zero if _rounded(gap) or vanishes(gap) else gap  # algebra may take minutes

    @property
    def polynomial(self) -> Polynomial | None:
        """The polynomial whose root the unknown is; None where it is not of degree 2 or more."""
        return Polynomial.of(self.expr - self.target, self.unknown, self.last)

    @property
    def closed_form(self) -> bool:
        """Whether no root finder is needed."""
        return self.how != "root finder"

    @property
    def proved(self) -> bool:
        """Whether there is exactly one solution for every target that `reach` and `needs` allow: by algebra."""
        return self.alone and not self.flat

    @property
    def alone(self) -> bool:
        """Whether there is exactly one solution for each of those targets that no flat piece gives."""
        return self.steep is not None or (self.how in UNIQUE and not self.notes)

    @property
    def proof(self) -> str:
        """Say, in words, why there is one solution, what it takes, or that it is not known."""
        x, of = text(self.unknown), text(self.target)
        if self.steep is not None and self.closed_form:
            said = f"exactly one {x} for every {of} (proved: the slope is at least {self.steep:.3g} everywhere)"
        elif self.steep is not None:
            why = f"proved: the slope is at least {self.steep:.3g} everywhere, up or down"
            said = f"{x} has no closed form: exactly one for every {of} ({why}), found by bracketing"
        elif not self.closed_form:
            said = f"{x} has no closed form: the root nearest to its last value is taken; not proved that there is one"
        elif self.how == "quadratic":
            sure = self.reach != (-sp.oo, sp.oo)
            said = f"two {x} for every {of}" if sure else f"none, one or two {x} for {of}, as its coefficients are then"
        elif self.alone:
            where = f" where {' and '.join(map(text, self.needs))}" if self.needs else ""
            said = f"exactly one {x} for every {of}{where} (proved)"
        else:
            said = f"one {x} for every {of} is taken (not proved that it is the only one)"
        low, high = map(text, self.reach)
        many = f", but {' and '.join(self.flat)}: the {x} nearest to {text(self.last)} is taken" if self.flat else ""
        if self.reach != (-sp.oo, sp.oo):
            ends = f"above {low}" if self.reach[1] == sp.oo else f"below {high}"
            only = "nothing else is reached" if self.alone or self.how == "quadratic" else "by the pieces that are used"
            said += f" {ends if sp.oo in map(abs, self.reach) else f'from {low} to {high}'}{many}; {only}"
            many = ""
        return "; ".join([f"{said}{many}", *self.notes])


def resting(unknown: Any, target: Any, expr: Any, last: Any, beside: Any = sp.S.Zero) -> Branch:
    """Return the branch of what rests: a value that already gives the target stays, whatever rounding says.

    Else the way there and back moves it by its last digit, which a sign of its step or a flat piece makes a jump of.
    Where the target was solved for, `beside` is the size of what was added up there: its last digit is the target's.
    """
    gap = expr.xreplace({unknown: last}) - target
    return Branch(sp.Abs(gap) <= STILL * (summed(gap) + beside), last)


def summed(gap: Any) -> Any:
    """Return the size of what is added up in an expression, which decides how large its rounding is."""
    return sp.Add(*map(sp.Abs, sp.Add.make_args(expanded(gap))))


def rounding(gap: Any, beside: Any) -> Any:
    """Return by how much a gap may differ from zero that is zero but for rounding: n 2^-52 times the size of its parts.

    Each of its n operations rounds by at most 2^-53 of that size; so did each of those that made the target, beside
    the size of what was added up where it was solved for.
    """
    return sp.Float(2.0**-52) * sp.count_ops(expanded(gap)) * (summed(gap) + beside)


def _rounded(expr: Any) -> bool:
    """Whether nothing but rounding is left: numbers that stand in the place of symbols have been divided.

    At points on all sides of its kinks the sum is nothing against what is added up in it.
    """
    symbols, parts, tried = sorted(expr.free_symbols, key=str), sp.Add.make_args(expr), 0
    for i in range(POINTS):
        at = {s: sp.Float(3 * ((0.618034 * (i * len(symbols) + j + 1)) % 1) - 1.5) for j, s in enumerate(symbols)}
        values = [part.xreplace(at) for part in parts]
        if all(v.is_number and v.is_extended_real and v.is_finite for v in values):
            tried += 1
            if abs(sum(values)) > ROUNDED * sum(map(abs, values)):
                return False
    return tried > POINTS // 4


def tidy(expr: Any) -> Any:
    """Return an expression expanded; over a common denominator where sums stand below."""
    expr = expanded(expr)
    below = (p for p in expr.atoms(sp.Pow) if p.base.is_Add and p.exp.is_negative)
    return sp.cancel(expr) if any(below) else expr


def number(expr: Any, values: Mapping[Any, Any]) -> float | None:
    """Return the value of an expression in which all samples cancel, or None."""
    held = sp.sympify(expr).xreplace(dict(values))
    if held.free_symbols:
        held = expanded(held)
    if held.free_symbols and (short := tidy(expr)) != expr:  # rounding must not keep samples that cancel
        held = expanded(short.xreplace(dict(values)))
    return float(held) if held.is_number and held.is_extended_real else None


def size_of(expr: Any, values: Mapping[Any, Any]) -> float:
    """Return the size of the numbers that are added up in an expression; 0 where all of it depends on samples."""
    parts = (number(p, values) for p in sp.Add.make_args(expanded(expr)))
    return added(abs(p) for p in parts if p is not None)


def apart(one: Any, other: Any, values: Mapping[Any, Any]) -> float | None:
    """Return how far one expression lies above another: 0 where only rounding does it, None where samples do."""
    found = 0.0 if tidy(one - other) == 0 else number(one - other, values)
    rounding = ROUNDED * (size_of(one, values) + size_of(other, values)) if found else 0.0
    return found if found is None or abs(found) > rounding else 0.0
