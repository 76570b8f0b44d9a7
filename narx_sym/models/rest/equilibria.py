"""Where a model rests and whether it stays there: equilibria, continuum, eigenvalues (section 3 of the paper)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Any

import sympy as sp
from sympy.solvers.solveset import NonlinearError

from ...errors import ModelError
from ...symbolic import printing
from ...symbolic.identities import added, vanishes
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import Name, k
from ..model import Model
from ..rest_map import at_rest, closed, folded, plays, rest_map, resting_states, settled, ubar, ybar
from .pieces import pieces

z = Name("z")
WIDTH = sp.Rational(1, 10**15)  # of the interval that isolates a root
TOUCH = 1e-11  # relative to the largest term: a minimum as low as that touches zero
SAME = 1e-6  # relative: roots nearer to each other are one that rounding has split
JUMPS = sp.sign, sp.Heaviside, sp.Piecewise, sp.core.relational.Relational
GRID, RANGES = 2001, 1e6  # where a bracket is looked for, and how many ranges away


@dataclass(frozen=True)
class SteadyState(printing.InLatex):
    """The rest map and what follows from it.

    Attributes
    ----------
    equation : Eq(ybar, G(ybar, ubar))
    conditions : list of Eq
        Sufficient for a continuum: every ybar is an equilibrium for every constant input (Lemma 1; the paper asks for
        Sigma_y = 1, which is enough only where no input or constant term remains at rest). Necessary too where the
        functions of what is held are independent, as products of powers are; Max(0, y) and |y| are not.
    equilibria : "continuum", a list of expressions in ubar, or the set of all real solutions of an equation
        Numbers where they do not depend on ubar. An expression is an equilibrium at those inputs where it is real. Of a
        cubic or a quartic in ybar the set; `at` gives its members. None where there is no closed form.
    held : list of (low, symbol, high)
        Where the model has plays: from where to where each of them may rest. They make a continuum by themselves.
    """

    equation: sp.Eq
    conditions: list[Any]
    equilibria: Any
    held: Sequence[tuple[Any, Any, Any]] = ()
    excess: Any = sp.S.Zero  # G(ybar, ubar) - ybar with values

    def at(self, value: float) -> tuple[float, ...]:
        """Return the equilibria under one constant input, rising.

        Parameters
        ----------
        value : of the input, in the model's own units, as ubar in `equation`

        Raises
        ------
        ModelError
            For a continuum, and for a model without values.
        """
        if self.equilibria == "continuum":
            raise ModelError("Every output is an equilibrium, or any in a range: there is a continuum.")
        return resting_points(self.excess.xreplace({ubar: sp.Float(value)}), ybar).points

    def latex(self) -> str:
        """LaTeX of the equation, the continuum conditions, and where plays may rest."""
        return r" \\ ".join([printing.latex([self.equation, *self.conditions]), *self.ranges(printing.latex, r"\leq")])

    def ranges(self, shown: Callable[[Any], str] = str, below: str = "<=") -> list[str]:
        """Return where plays may rest, as texts."""
        return [f" {below} ".join(map(shown, chain)) for chain in self.held]


def balances(model: Model) -> dict[Any, list[Any]]:
    """Return what G(ybar, ubar) - ybar is made of: per function of what is held, the coefficients that add up.

    Raises
    ------
    ModelError
        For a model that remembers more than its outputs, inputs and plays of them, or changes with time.
    """
    closed(model, "The steady state is", but=[*plays(model), *resting_states(model)])
    known = settled(model)
    groups: dict[Any, list[Any]] = {ybar: [sp.S.NegativeOne]}
    for term in sp.Add.make_args(model.right):
        for part in sp.Add.make_args(sp.expand(at_rest(term, model).xreplace(known))):
            held = {s for s in part.free_symbols if s not in model.symbols}
            coefficient, function = part.as_independent(*held, as_Add=False) if held else (part, sp.S.One)
            groups.setdefault(function, []).append(coefficient)
    return groups


def continuum_conditions(model: Model) -> list[Any]:
    """Return the equations in theta under which ybar = G(ybar, ubar) holds identically."""
    groups, conditions = balances(model), dict[Any, None]()
    for function in sorted(groups, key=sp.default_sort_key):
        balance = sp.expand(sp.Add(*groups[function]))
        if function == ybar and balance != 0:
            conditions[sp.Eq(balance + 1, 1, evaluate=False)] = None
        elif balance != 0:
            left = sp.factor_terms(-balance if balance.could_extract_minus_sign() else balance)
            conditions[sp.Eq(left, 0, evaluate=False)] = None
    return list(conditions)


def constrained(model: Model) -> dict[Any, Any]:
    """Return parameters that the constraints of a model fix, as expressions in the others.

    Empty where the constraints contradict each other, or are not linear.
    """
    listed: list[Any] = []
    for one in model.constraints:
        listed += continuum_conditions(model) if isinstance(one, str) else [sp.sympify(one)]
    try:
        found = sp.linsolve([e for e in listed if e != sp.true], *model.symbols) if listed else sp.S.EmptySet
    except (NonlinearError, ValueError):
        return {}
    solutions = next(iter(found), ())
    return {s: e for s, e in zip(model.symbols, solutions, strict=False) if s != e}


ROUNDING = 1e-9  # relative to what is added up: a sum as small as that is zero


def unbalanced(model: Model, tolerance: float = ROUNDING) -> dict[Any, Any]:
    """Return the sums of `balances` with values, without those that vanish but for rounding, whatever the units."""
    found = {}
    for function, listed in balances(model).items():
        parts = [sp.sympify(c).xreplace(model.values) for c in listed]
        total = sp.Add(*parts)
        numbers = all(part.is_number for part in parts)
        if not (numbers and abs(float(total)) <= tolerance * added(abs(float(part)) for part in parts)):
            found[function] = total
    return found


def continuum(model: Model, tolerance: float = ROUNDING) -> bool:
    """Return whether the fitted model has a continuum of equilibrium points (Definition 1, Lemma 1).

    The whole rest map is tested: an input or constant term that survives at rest makes the output drift. The tolerance
    is relative to the coefficients that cancel each other.
    """
    return not unbalanced(model, tolerance)


def resting(model: Model) -> Any:
    """Return G(ybar, ubar) - ybar with values: zero at an equilibrium."""
    listed = unbalanced(model).items()
    return sp.expand(sp.Add(*(total * sp.sympify(function).xreplace(model.values) for function, total in listed)))


def steady_state(model: Model) -> SteadyState:
    """Solve ybar = G(ybar, ubar)."""
    equation = sp.Eq(ybar, rest_map(model), evaluate=False)
    found = plays(model)
    if found:
        bounds = [(p, *p.between(ubar)) for p in found]
        return SteadyState(equation, [], "continuum", [(low, p.rest, high) for p, low, high in bounds])
    excess = resting(model)
    equilibria = "continuum" if excess == 0 else _equilibria(excess)
    return SteadyState(equation, continuum_conditions(model), equilibria, excess=excess)


def _equilibria(excess: Any) -> Any:
    """Solve for ybar: by numbers where there is nothing else, by a formula, as a set, or not at all (None)."""
    if not excess.has(ybar):
        return []  # it never vanishes, or at some inputs only
    if excess.free_symbols == {ybar}:
        found = resting_points(excess, ybar)
        return [sp.Float(x) for x in found.points] if found.complete else None
    if not solvable(excess, ybar):
        return None
    if sp.degree(excess, ybar) > 2:  # formulas for real roots would hold complex numbers
        return sp.ConditionSet(ybar, sp.Eq(excess, 0, evaluate=False), sp.S.Reals)
    # Not as a real unknown: SymPy would leave out real roots that it writes with complex numbers.
    unknown = sp.Dummy()
    return [root for root in sp.solve(excess.xreplace({ybar: unknown}), unknown) if root.is_real is not False]


def solvable(expr: Any, unknown: Any) -> bool:
    """Whether a closed form is worth looking for: polynomials of low degree. Others could take for ever."""
    return bool(expr.has(unknown) and expr.is_polynomial(unknown) and sp.degree(expr, unknown) <= 4)


def jacobian(model: Model) -> list[Any]:
    """Return [dF/dy[k-1], ..., dF/dy[k-n_y]]: phi1, phi2 and time indices kept, in the user's units.

    Raises
    ------
    ModelError
        For a model that remembers more than its outputs, inputs and plays of them.
    """
    closed(model, "The slope is", timeless=False, but=plays(model))
    F = model.in_user_units(folded(model))
    return [derivative(F, model.output[k - i]) for i in range(1, model.n_y + 1)]


def characteristic(slopes: Sequence[Any]) -> Any:
    """Return z^n - F_1 z^(n-1) - ... - F_n, whose roots are the eigenvalues of the companion matrix."""
    n = len(slopes)
    return z**n - sum(slope * z ** (n - 1 - i) for i, slope in enumerate(slopes))


def jury(polynomial: Any) -> list[Any]:
    """Return the conditions under which all roots of a polynomial in z lie inside the unit circle (Jury 1964).

    For z - a it is |a| < 1. The conditions are relationals in the coefficients; p(1) > 0 comes first.
    """
    row = sp.Poly(polynomial, z).all_coeffs()
    lead = row[0]
    row = [sp.together(c / lead) for c in row]
    n = len(row) - 1
    if n == 0:
        return []
    if n == 1:
        return [sp.Lt(sp.Abs(-row[1]), 1, evaluate=False)]
    conditions = [sp.Gt(sum(row), 0, evaluate=False)]
    conditions.append(sp.Gt((-1) ** n * sum(c * (-1) ** (n - i) for i, c in enumerate(row)), 0, evaluate=False))
    while len(row) > 2:
        conditions.append(sp.Lt(sp.Abs(row[-1]), sp.Abs(row[0]), evaluate=False))
        if len(row) == 3:
            break
        row = [sp.expand(row[0] * a - row[-1] * b) for a, b in zip(row[:-1], row[:0:-1], strict=True)]
    return conditions


@lru_cache(maxsize=1024)
def without_integrator(polynomial: Any) -> tuple[Any, bool]:
    """Divide out the root z = 1 where it is exact: a Sigma_y = 1 model and its law integrate by construction."""
    if vanishes(polynomial.subs(z, 1)):
        return sp.cancel(sp.quo(sp.Poly(polynomial, z), sp.Poly(z - 1, z)).as_expr()), True
    return polynomial, False


# -- real roots of an expression in one unknown -----------------------------------------------------------------


@dataclass(frozen=True)
class Equilibria:
    """The outputs that stay where they are under one constant input.

    Attributes
    ----------
    points : tuple of numbers, rising
    complete : bool
        Whether these are all: isolated by algebra. Else there may be more, and none found means not known.
    """

    points: tuple[float, ...]
    complete: bool

    def __str__(self) -> str:
        n = len(self.points)
        if not self.complete:
            return f"at least {counted(n)}" if n else "whether there is an equilibrium is not known"
        return counted(n) if n else "no equilibrium"


def counted(n: int) -> str:
    """Return "one equilibrium", "2 equilibria"."""
    return "one equilibrium" if n == 1 else f"{n} equilibria"


def resting_points(excess: Any, unknown: Any, scale: float = 1.0) -> Equilibria:
    """Find the real roots of an expression in one unknown with numbers.

    Polynomials, and those that meet at kinks, by Sturm's theorem over the rationals that the decimals stand for, so
    that none is missed and none is invented; all else by changes of sign, from within a small part of `scale` to a
    million times it.

    Raises
    ------
    ModelError
        Where the expression contains more than the unknown.
    """
    if foreign := excess.free_symbols - {unknown}:
        raise ModelError(f"The equilibria depend on further signals ({', '.join(map(str, foreign))}).")
    exact = sp.expand(excess)
    if exact.is_polynomial(unknown):
        return Equilibria(_isolated(_polynomial(exact, unknown)), True)
    if (found := _between_kinks(exact, unknown, scale)) is not None:
        return Equilibria(found, True)
    return Equilibria(_bracketed(sp.lambdify([unknown], excess, modules="math"), scale), False)


def _polynomial(expr: Any, unknown: Any) -> Any:
    return sp.Poly(sp.nsimplify(expr, rational=True), unknown, domain="QQ")


def _between_kinks(expr: Any, unknown: Any, scale: float) -> tuple[float, ...] | None:
    """Return the roots of polynomials that meet at kinks; None for all else, as where one of them is zero all along."""
    parts = None if expr.has(*JUMPS) else pieces(expr, lambda argument: True)
    found: list[float] = []
    for part in parts or ():
        if not all(sp.expand(e).is_polynomial(unknown) for e in (part.right, *(at for at, _ in part.sides))):
            return None
        right, sides = _polynomial(part.right, unknown), [(_polynomial(at, unknown), sign) for at, sign in part.sides]
        if right.is_zero:
            return None
        found += [x for x in _isolated(right) if all(sign * p(x) >= 0 or _touches(p, x) for p, sign in sides)]
    return None if parts is None else _apart(sorted(found), scale)


def _isolated(polynomial: Any) -> tuple[float, ...]:
    """Isolate the real roots, each once: a double root that rounding has split, or lifted from the axis, is one."""
    turning = [(x, _touches(polynomial, x)) for x in _real_roots(polynomial.diff())]
    marks = sorted([(x, 0) for x in _real_roots(polynomial)] + [(x, 1 if touches else 2) for x, touches in turning])
    found: list[float] = []
    # Between two turning points the polynomial is monotone: from one that touches zero to a root beside it, all is.
    for apart, near in groupby(marks, lambda mark: mark[1] == 2):
        at = [] if apart else list(near)
        found += [x for x, touches in at if touches][:1] or [x for x, _ in at]
    return tuple(found)


def _touches(polynomial: Any, x: float) -> bool:
    """Whether it is zero there but for rounding of its terms."""
    terms = [float(c) * x**n for (n,), c in polynomial.terms()]
    return abs(added(terms)) <= TOUCH * max(map(abs, terms))


def _real_roots(polynomial: Any) -> list[float]:
    """Return the real roots by Sturm's theorem, to 15 digits of the smallest that is not zero."""
    if polynomial.degree() < 1:
        return []
    part = polynomial.sqf_part()
    sizes = [(n, math.log2(abs(c.p)) - math.log2(c.q)) for (n,), c in part.terms()]
    least, size = min(sizes)
    lowest = -max((other - size) / (n - least) for n, other in sizes if n > least) if len(sizes) > 1 else 0.0
    width = WIDTH * sp.Integer(2) ** (math.floor(lowest) - 1)  # Fujiwara's bound, of the reversed polynomial
    return [float((a + b) / 2) for a, b in part.intervals(eps=width, sqf=True)]


def _bracketed(gap: Any, scale: float) -> tuple[float, ...]:
    def value(x: float) -> float:
        try:
            return float(gap(x))
        except (OverflowError, ValueError, ZeroDivisionError, TypeError):
            return math.nan

    top = math.asinh(RANGES)
    grid = [scale * math.sinh(top * (2 * i / (GRID - 1) - 1)) for i in range(GRID)]
    points = [(x, value(x)) for x in grid]
    found: list[float] = []
    for (_, far), before, here in zip([(0.0, 0.0), *points], points, points[1:], strict=False):
        if before[1] == 0 and far * here[1] != 0:  # a zero alone; many in a row are a function that fades away
            found.append(before[0])
        elif before[1] * here[1] < 0 and (root := _bisected(value, before, here)) is not None:
            found.append(root)
    return _apart(found, scale)


def _apart(found: list[float], scale: float) -> tuple[float, ...]:
    """Return roots, each once."""
    return tuple(x for i, x in enumerate(found) if not i or x - found[i - 1] > SAME * (1e-3 * scale + abs(x)))


def _bisected(value: Any, low: tuple[float, float], high: tuple[float, float]) -> float | None:
    """Return the root between two points of different sign; None where it is a jump."""
    edges = abs(low[1]) + abs(high[1])
    for _ in range(200):
        middle = (low[0] + high[0]) / 2
        if middle in (low[0], high[0]):
            break
        here = (middle, value(middle))
        if here[1] == 0:
            return middle
        low, high = (here, high) if (here[1] > 0) == (low[1] > 0) else (low, here)
    return low[0] if abs(low[1]) + abs(high[1]) < 1e-6 * edges else None
