"""Where a model rests and whether it stays there: equilibria, continuum, eigenvalues (section 3 of the paper)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
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
from .roots import resting_points

z = Name("z")


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
