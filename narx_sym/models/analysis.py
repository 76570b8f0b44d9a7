"""Section 3 of the paper: steady state, Sigma_y, the continuum of equilibria, quasi-static sets, attracting regions.

Everything here is algebra on the model's equation; numbers enter only where a model has been fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import sympy as sp
from sympy.solvers.solveset import NonlinearError

from ..errors import FitError, ModelError
from ..symbolic import printing
from ..symbolic.identities import vanishes
from ..symbolic.recursion import State
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import differences, k, lag, lags, samples, t, x
from . import assumptions
from .doors import QuasiStaticDoors
from .model import Model, pairs

ybar, ubar, ytilde = (sp.Symbol(n, real=True) for n in (r"\bar{y}", r"\bar{u}", r"\tilde{y}"))
u_, phi1_ = sp.Symbol("u", real=True), sp.Symbol("phi_1", real=True)
z = sp.Symbol("z")


def _rest(base: Any) -> Any:
    return sp.Symbol(rf"\bar{{{base.label}}}", real=True)


def effects_of(model: Model, expr: Any = None, states: Sequence[State] = ()) -> str:
    """Name the effects whose coefficients an expression contains or that brought some states, or the states."""
    symbols = {str(s) for s in sp.sympify(expr or 0).free_symbols}
    groups = {s.group for s in states if s.group}
    named = [
        one["effect"]
        for one in model.info.get("effects", [])
        if any(c in symbols or c.partition("_")[2] in groups for c in one["coefficients"])
    ]
    if named:
        return f"the {'effect' if len(named) == 1 else 'effects'} {' and '.join(dict.fromkeys(named))}"
    return f"the {'state' if len(states) == 1 else 'states'} {', '.join(printing.text(s.left) for s in states)}"


def remembered(model: Model) -> str:
    """Say what keeps a model from being one equation in y and u; an empty text where it is one."""
    if not model.hidden:
        return ""
    read = {base for state in model.hidden for base in {state.left.base} | _reads(model, state.right)}
    held = [s for s in model.recurrent if s.left.base in read]
    if held:
        shown = ", ".join(printing.text(s.left) for s in held)
        return f"{effects_of(model, states=held)} remembers more than outputs and inputs ({shown})"
    return f"{effects_of(model, model.beside, model.hidden)} acts on the inner output x[k], which is not measured"


def _closed(model: Model, what: str, timeless: bool = True) -> None:
    """Refuse what is not derived for models that remember, or that change with time.

    Raises
    ------
    ModelError
    """
    why = remembered(model)
    if not why and timeless and samples(model.right, t):
        why = f"{_moving(model)} changes with time, so that nothing is at rest"
    if why:
        raise ModelError(f"{what} not derived for this model: {why}.")


def _moving(model: Model) -> str:
    """Name the effects that depend on time."""
    symbols = {str(s): s for s in model.symbols}
    for one in model.info.get("effects", []):
        if any(c in symbols and samples(sp.diff(model.right, symbols[c]), t) for c in one["coefficients"]):
            return f"the effect {one['effect']}"
    return "the equation"


def newest_input(model: Model) -> int:
    """Return the smallest lag of the input: that of the core, or of an effect that acts faster."""
    return min(lags(model.right, model.input), default=model.delay)


def folded(model: Model) -> Any:
    """Return the model's flat equation with differences of consecutive inputs written as phi1, their signs as phi2."""
    first, second = differences(model.input)
    expr = model.flat
    found: dict[Any, Any] = {}
    for node in expr.atoms(sp.Add):
        read = samples(node, model.input)
        if len(node.args) == len(read) == 2 and lag(read[1]) - lag(read[0]) == 1:
            for sign in (1, -1):
                if node == sign * (read[0] - read[1]):
                    found[node] = sign * first[read[0].indices[0]]
    expr = expr.xreplace(found)
    return expr.xreplace({sp.sign(s): second[s.indices[0]] for s in samples(expr, first)})


def rest_map(model: Model) -> Any:
    """Return G with ybar = G(ybar, ubar): all signals held constant, in the user's units.

    phi1 and phi2 vanish because u[k] - u[k-1] does; they are not declared.

    Raises
    ------
    ModelError
        For a model that remembers more than its outputs and inputs, or changes with time.
    """
    _closed(model, "The steady state is")
    right = model.right
    held = {model.output: ybar, model.input: ubar}
    return right.xreplace({s: held.get(s.base, _rest(s.base)) for s in samples(right)})


def sigma_y(model: Model) -> Any:
    """Return the sum of the parameters of the linear output regressors.

    Where effects act on the output it is that of the inner output `x`.

    Raises
    ------
    ModelError
        Where the output also returns through what an effect remembers.
    """
    returning = any(_reads(model, s.right) & {x, model.output} for s in model.states if s.left.base != x)
    if model.hidden and (returning or (model.inner == x and samples(model.beside, x))):
        _closed(model, "Sigma_y is", timeless=False)
    terms = model.parts() if model.core == model.F else pairs(model.core)
    return sp.Add(*(c for c, term in terms if isinstance(term, sp.Indexed) and term.base == model.inner))


def _reads(model: Model, expr: Any) -> set[Any]:
    """Return the sequences that an expression reads, itself or through other states."""
    states = {s.left.base: s.right for s in model.states}
    read: set[Any] = set()
    more = {s.base for s in samples(expr)}
    while more:
        read |= more
        more = {s.base for b in more if b in states for s in samples(states[b])} - read
    return read


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
    solutions = sp.solve(excess, ybar) if _solvable(excess, ybar) else []
    return SteadyState(equation, continuum_conditions(model), solutions)


def _solvable(expr: Any, unknown: Any) -> bool:
    """Whether a closed form is worth looking for: polynomials of low degree. Others could take for ever."""
    return bool(expr.has(unknown) and expr.is_polynomial(unknown) and sp.degree(expr, unknown) <= 4)


def jacobian(model: Model) -> list[Any]:
    """Return [dF/dy[k-1], ..., dF/dy[k-n_y]]: phi1, phi2 and time indices kept, in the user's units.

    Raises
    ------
    ModelError
        For a model that remembers more than its outputs and inputs.
    """
    _closed(model, "The slope is", timeless=False)
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
    held = {model.output: ybar, model.input: ubar}
    slopes = [
        derivative(model.right, model.output[k - i]).xreplace(
            {s: held.get(s.base, _rest(s.base)) for s in samples(model.right)}
        )
        for i in range(1, model.n_y + 1)
    ]
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


@dataclass(frozen=True)
class QuasiStatic(QuasiStaticDoors):
    """The sets ytilde(u, phi1) under loading and unloading, and where they attract.

    Attributes
    ----------
    loading, unloading : expressions in u and phi_1, in the user's units
    jacobian : expression dF/dy[k-1], or a list of them for n_y > 1
    attracting : relational, or `And` of the Jury conditions for n_y > 1
    """

    model: Model
    loading: Any
    unloading: Any
    jacobian: Any
    attracting: Any

    @property
    def repelling(self) -> Any:
        """Where the sets do not attract."""
        return sp.Not(self.attracting)

    def conditions(self, loading: bool) -> Any:
        """Return the attracting condition of one branch in u and phi_1."""
        return _static(self.attracting, self.model, 1 if loading else -1)

    @property
    def branches(self) -> tuple[Any, Any]:
        """(dF/dy under loading, under unloading) in u, phi_1 and ytilde; lists for n_y > 1."""
        slopes = self.jacobian if isinstance(self.jacobian, list) else [self.jacobian]
        loading, unloading = ([_static(s, self.model, d) for s in slopes] for d in (1, -1))
        return loading, unloading

    def latex(self) -> str:
        """LaTeX of the two cases and of the attracting condition."""
        cases = (
            rf"\tilde{{{self.model.output.label}}} = \begin{{cases}} "
            rf"{printing.latex(self.loading)}, & \phi_{{2}} = 1 \\[6pt] "
            rf"{printing.latex(self.unloading)}, & \phi_{{2}} = -1 \end{{cases}}"
        )
        return cases + r" \\ " + printing.latex(self.attracting)


def _static(expr: Any, model: Model, direction: int) -> Any:
    """Drop the time indices: y[k-i] is ytilde, u[k-j] is u, phi1[k-j] is phi_1, phi2[k-j] the direction."""
    first, second = differences(model.input)
    values = {
        model.output: ytilde,
        model.input: u_,
        first: phi1_,
        second: sp.Integer(direction),
    }
    return expr.xreplace({s: values.get(s.base, _rest(s.base)) for s in samples(expr)})


def quasi_static(model: Model) -> QuasiStatic:
    """Solve ytilde = F(ytilde, u, phi1, phi2) for phi2 = 1 (loading) and phi2 = -1 (unloading), Eq. (090919b).

    Raises
    ------
    ModelError
        Where no closed form exists, and for a model that remembers more than its outputs and inputs or changes with
        time.
    """
    _closed(model, "The quasi-static solution is")
    F = model.in_user_units(folded(model))
    _no_lost_differences(model, F)
    branches = []
    offset = model.operating_point.get(model.output, 0)
    for direction in (1, -1):
        excess = _static(F, model, direction) + offset - ytilde
        slope = sp.diff(excess, ytilde)
        if slope != 0 and not slope.has(ytilde):
            branches.append(sp.expand(excess.xreplace({ytilde: sp.S.Zero})) / sp.expand(-slope))
            continue
        solutions = sp.solve(excess, ytilde) if _solvable(excess, ytilde) else []
        if not solutions:
            raise ModelError("The quasi-static equation has no closed-form solution for this model.")
        branches.append(solutions[0] if len(solutions) == 1 else sp.FiniteSet(*solutions))
    slopes = jacobian(model)
    if not slopes:
        return QuasiStatic(model, branches[0], branches[1], sp.S.Zero, sp.true)
    # The second lines of the paper's conditions divide by theta_4 phi_2 and hold only where that is positive: |.| < 1.
    conditions = jury(without_integrator(characteristic(slopes))[0])
    attracting = sp.And(*conditions, evaluate=False) if len(conditions) > 1 else conditions[0]
    return QuasiStatic(model, branches[0], branches[1], slopes[0] if len(slopes) == 1 else slopes, attracting)


def _no_lost_differences(model: Model, F: Any) -> None:
    """Refuse differences that vanish when the time indices are dropped, other than phi1 and phi2."""
    for node in F.atoms(sp.Add):
        read = [lags(node, base) for base in (model.output, model.input)]
        if max(map(len, read)) > 1 and sp.expand(_static(node, model, 1)) == 0:
            raise ModelError(
                f"The quasi-static solution is not derived for this model: {printing.text(node)} is a difference in "
                "time other than phi1."
            )


def check(model: Model, rules: Sequence[str] | None = None) -> list[assumptions.Violation]:
    """Return every assumption that a model violates, term by term, with the reason.

    Parameters
    ----------
    rules : names of `assumptions.RULES`
        All of the paper's by default.

    Raises
    ------
    ModelError
        For a model that remembers more than its outputs and inputs: the assumptions speak of regressors in these.
    """
    _closed(model, "What the assumptions say is", timeless=False)
    total = sp.sympify(sigma_y(model)).xreplace(model.values)
    # The rule about rest values belongs to Sigma_y = 1; a model with another known sum has one equilibrium anyway.
    integrates = model.constraints or not total.is_number or abs(float(total) - 1) < 1e-9
    first = assumptions.CONTINUUM if integrates else assumptions.ASSUMPTION_1
    names = list(rules) if rules is not None else [*first, *(("A1(i)",) if not model.lead else ())]
    listed = pairs(sp.expand(folded(model))) if model.states else model.parts()
    terms = list(dict.fromkeys(term for _, term in listed))
    structure = assumptions.Structure(model.output, model.input, newest_input(model))
    found = assumptions.violations(terms, names, structure)
    return found + (assumptions.structural(terms, structure) if rules is None else [])


def constraint_matrix(equations: Sequence[Any], symbols: Sequence[Any]) -> tuple[sp.Matrix, sp.Matrix]:
    """Derive S and c with S theta = c from equations in the symbols.

    Raises
    ------
    FitError
        Where an equation is not linear in the parameters.
    """
    try:
        S, c = sp.linear_eq_to_matrix([sp.sympify(e) for e in equations], list(symbols))
    except NonlinearError as error:
        raise FitError(f"A constraint is not linear in the parameters: {error}") from None
    if S.free_symbols | c.free_symbols:
        unknown = ", ".join(map(str, S.free_symbols | c.free_symbols))
        raise FitError(f"The constraints contain {unknown}, which are not parameters of this model.")
    return S, c
