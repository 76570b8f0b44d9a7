"""Where a model rests and whether it stays there: equilibria, continuum, eigenvalues (section 3 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.identities import vanishes
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import k
from .model import Model
from .rest_map import at_rest, closed, folded, rest_map, ubar, ybar

z = sp.Symbol("z")


@dataclass(frozen=True)
class SteadyState:
    """The rest map and what follows from it.

    Attributes
    ----------
    equation : Eq(ybar, G(ybar, ubar))
    conditions : list of Eq
        Necessary and sufficient for a continuum: every ybar is an equilibrium for every constant input (Lemma 1; the
        paper asks for Sigma_y = 1, which is enough only where no input or constant term remains at rest).
    equilibria : "continuum" or list of expressions in ubar
    """

    equation: sp.Eq
    conditions: list[Any]
    equilibria: Any

    def latex(self) -> str:
        """LaTeX of the equation and the continuum conditions."""
        return printing.latex([self.equation, *self.conditions])


def continuum_conditions(model: Model) -> list[Any]:
    """Return the equations in theta under which ybar = G(ybar, ubar) holds identically."""
    excess = sp.expand(rest_map(model) - ybar)
    groups: dict[Any, Any] = {}
    for part in sp.Add.make_args(excess):
        held = {s for s in part.free_symbols if s not in model.symbols}
        coefficient, function = part.as_independent(*held, as_Add=False) if held else (part, sp.S.One)
        groups[function] = groups.get(function, sp.S.Zero) + coefficient
    conditions = []
    for function in sorted(groups, key=sp.default_sort_key):
        balance = sp.factor_terms(sp.expand(groups[function]))
        if function == ybar:
            conditions.append(sp.Eq(sp.expand(groups[function]) + 1, 1, evaluate=False))
        elif balance != 0:
            conditions.append(sp.Eq(balance, 0, evaluate=False))
    return conditions


def continuum(model: Model, tolerance: float = 1e-9) -> bool:
    """Return whether the fitted model has a continuum of equilibrium points (Definition 1, Lemma 1).

    The whole rest map is tested: an input or constant term that survives at rest makes the output drift.
    """
    known = model.values
    gaps = [(c.lhs - c.rhs).xreplace(known) if isinstance(c, sp.Eq) else c for c in continuum_conditions(model)]
    return all(g.is_number and abs(float(g)) <= tolerance for g in map(sp.sympify, gaps))


def steady_state(model: Model) -> SteadyState:
    """Solve ybar = G(ybar, ubar)."""
    right = rest_map(model)
    equation = sp.Eq(ybar, right, evaluate=False)
    if continuum(model):
        return SteadyState(equation, continuum_conditions(model), "continuum")
    excess = sp.expand((right - ybar).xreplace(model.values))
    if excess == 0:
        return SteadyState(equation, continuum_conditions(model), "continuum")
    solutions = sp.solve(excess, ybar) if solvable(excess, ybar) else []
    return SteadyState(equation, continuum_conditions(model), solutions)


def solvable(expr: Any, unknown: Any) -> bool:
    """Whether a closed form is worth looking for: polynomials of low degree. Others could take for ever."""
    return bool(expr.has(unknown) and expr.is_polynomial(unknown) and sp.degree(expr, unknown) <= 4)


def jacobian(model: Model) -> list[Any]:
    """Return [dF/dy[k-1], ..., dF/dy[k-n_y]]: phi1, phi2 and time indices kept, in the user's units.

    Raises
    ------
    ModelError
        For a model that remembers more than its outputs and inputs.
    """
    closed(model, "The slope is", timeless=False)
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


@dataclass(frozen=True)
class Verdict:
    """Property 1: under a constant input a model of hysteresis has two or more real non-diverging equilibria."""

    equilibria: Any
    diverging: bool | None
    holds: bool
    reason: str


def property_1(model: Model) -> Verdict:
    """Count the equilibria of a fitted model under a constant input and say whether they diverge.

    At a continuum the eigenvalue that is exactly 1 is taken out before the others are judged.
    """
    if not model.values:
        raise ModelError("Property 1 is a verdict on numbers: fit the model or give theta first.")
    state = steady_state(model)
    slopes = [at_rest(derivative(model.right, model.output[k - i]), model) for i in range(1, model.n_y + 1)]
    polynomial = characteristic([s.xreplace(model.values) for s in slopes])
    if state.equilibria == "continuum":
        reduced, _ = sp.div(sp.Poly(polynomial, z), sp.Poly(z - 1, z))
        roots = [abs(complex(r)) for r in reduced.nroots()] if reduced.degree() > 0 else []
        diverging = any(r >= 1 for r in roots)
        return Verdict("continuum", diverging, not diverging, "every output is an equilibrium at rest (Lemma 1)")
    points = [p for p in state.equilibria if p.xreplace({ubar: sp.S.Zero}).is_real is not False]
    if not points:
        return Verdict([], None, False, "no equilibrium: the output drifts under a constant input")
    flags = []
    for point in points:
        at = polynomial.xreplace({ybar: point, ubar: sp.S.Zero})
        at = at.subs(ubar, 0)
        flags.append(any(abs(complex(root)) >= 1 for root in sp.Poly(at, z).nroots()))
    steady = [p for p, bad in zip(points, flags, strict=True) if not bad]
    count = "one equilibrium" if len(points) == 1 else f"{len(points)} equilibria"
    reason = f"{count} for a constant input, {len(steady)} non-diverging; two are needed"
    return Verdict(points, all(flags), len(steady) >= 2, reason)
