"""Where a model rests and whether it stays there: equilibria, continuum, eigenvalues (section 3 of the paper)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.identities import vanishes
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import k, samples
from .model import Model
from .rest_map import closed, folded, plays, rest_map, ubar, ybar

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
    equilibria : "continuum", or a list of expressions in ubar; None where there is no closed form
    held : list of (low, symbol, high)
        Where the model has plays: from where to where each of them may rest. They make a continuum by themselves.
    """

    equation: sp.Eq
    conditions: list[Any]
    equilibria: Any
    held: Sequence[tuple[Any, Any, Any]] = ()

    def latex(self) -> str:
        """LaTeX of the equation, the continuum conditions, and where plays may rest."""
        return r" \\ ".join([printing.latex([self.equation, *self.conditions]), *self.ranges(printing.latex, r"\leq")])

    def ranges(self, shown: Callable[[Any], str] = str, below: str = "<=") -> list[str]:
        """Return where plays may rest, as texts."""
        return [f" {below} ".join(map(shown, chain)) for chain in self.held]


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
    found = plays(model)
    if found:
        bounds = [(p, *p.between(ubar)) for p in found]
        return SteadyState(equation, [], "continuum", [(low, p.rest, high) for p, low, high in bounds])
    if continuum(model):
        return SteadyState(equation, continuum_conditions(model), "continuum")
    excess = sp.expand((right - ybar).xreplace(model.values))
    if excess == 0:
        return SteadyState(equation, continuum_conditions(model), "continuum")
    solutions = sp.solve(excess, ybar) if solvable(excess, ybar) else None
    if not excess.has(ybar):
        solutions = []  # a constant that never vanishes
    return SteadyState(equation, continuum_conditions(model), solutions)


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


@dataclass(frozen=True)
class Verdict:
    """Property 1: under a constant input a model of hysteresis has two or more real non-diverging equilibria.

    Attributes
    ----------
    equilibria : "continuum", or a list of numbers at the input `at`; None where it is not known whether there is one
    diverging : bool or None
        Whether all of them repel.
    holds : bool
    reason : text
    at : number
        The constant input that decides: one at which there are two, where there is such a one [unit of the input].
    """

    equilibria: Any
    diverging: bool | None
    holds: bool
    reason: str
    at: float = 0.0


INPUTS = 9  # constant inputs over the identified range, and outputs of a continuum
STAYS = 1.0 - 1e-6  # an eigenvalue beyond it does not attract: a double root has one at 1, which rounding puts aside


def constant_inputs(model: Model) -> list[float]:
    """Return where a model is judged at rest: at its operating point, then over the identified range of the input."""
    low, high = model.info.ranges.get(model.input.name, (0.0, 0.0))
    centre = model.operating_point.get(model.input, 0.0 if low <= 0 <= high or low == high else (low + high) / 2)
    return [centre, *((low + (high - low) * i / (INPUTS - 1)) for i in range(INPUTS) if high > low)]


def property_1(model: Model) -> Verdict:
    """Count the equilibria of a fitted model under constant inputs and say whether they diverge.

    At a continuum the eigenvalue that is exactly 1 is taken out before the others are judged, over the identified
    outputs and inputs. Further channels are held at zero.
    """
    if model.symbols and not model.values:
        raise ModelError("Property 1 is a verdict on numbers: fit the model or give theta first.")
    held = {model.output: ybar, model.input: ubar}
    slopes = [
        derivative(model.right, model.output[k - i]).xreplace(
            {s: held.get(s.base, sp.S.Zero) for s in samples(model.right)}
        )
        for i in range(1, model.n_y + 1)
    ]
    polynomial = characteristic([s.xreplace(model.values) for s in slopes])
    if plays(model):
        roots = [abs(complex(root)) for root in sp.Poly(polynomial, z).nroots()] if model.n_y else []
        diverging = any(root >= STAYS for root in roots)
        return Verdict("continuum", diverging, not diverging, "a play rests wherever the input has left it")
    excess = sp.expand((rest_map(model) - ybar).xreplace(model.values))
    excess = excess.xreplace({s: sp.S.Zero for s in excess.free_symbols - {ybar, ubar}})
    if continuum(model) or excess == 0:
        return _along(model, polynomial)
    low, high = model.info.ranges.get(model.output.name, (-1.0, 1.0))
    verdicts = [_at_rest(excess, polynomial, at, max(abs(low), abs(high))) for at in constant_inputs(model)]
    if not excess.has(ubar):
        return verdicts[0]
    best = next((v for v in verdicts if v.holds), verdicts[0])
    where = f" (at {model.input.label} = {best.at:.4g})" if best.at or len(verdicts) > 1 else ""
    return Verdict(best.equilibria, best.diverging, best.holds, best.reason + where, best.at)


def _along(model: Model, polynomial: Any) -> Verdict:
    """Judge a continuum where the model was identified: at many outputs and inputs, for its other eigenvalues move."""
    reduced = sp.div(sp.Poly(polynomial, z), sp.Poly(z - 1, z))[0].as_expr()
    low, high = model.info.ranges.get(model.output.name, (-1.0, 1.0))
    outputs = [low + (high - low) * i / (INPUTS - 1) for i in range(INPUTS)] if reduced.has(ybar) else [0.0]
    inputs = constant_inputs(model) if reduced.has(ubar) else [0.0]
    every = "every output is an equilibrium at rest (Lemma 1)"
    shares: list[tuple[float, int, float]] = []
    for at in inputs:
        rests = [not _repels(reduced.xreplace({ybar: sp.Float(one), ubar: sp.Float(at)})) for one in outputs]
        shares.append((sum(rests) / len(rests), -len(shares), at))
    share, _, at = max(shares)
    if share == 1:
        return Verdict("continuum", False, True, every, at)
    where = f", non-diverging at {share:.0%} of the outputs" if share else ""
    return Verdict("continuum", not share, share > 0, every + where, at)  # beside one there are others


def _repels(polynomial: Any) -> bool:
    """Whether an eigenvalue does not lie inside the unit circle."""
    return polynomial.has(z) and any(abs(complex(root)) >= STAYS for root in sp.Poly(polynomial, z).nroots())


def _at_rest(excess: Any, polynomial: Any, at: float, scale: float) -> Verdict:
    """Judge the equilibria under one constant input."""
    given = {ubar: sp.Float(at)}
    if sp.expand(excess.xreplace(given)) == 0:
        return Verdict("continuum", None, False, "every output is an equilibrium at this input", at)
    found = resting_points(excess.xreplace(given), ybar, scale)
    if not found.points:
        drifts = ": the output drifts under a constant input" if found.complete else ": unknown"
        return Verdict([] if found.complete else None, None, False, f"{found}{drifts}", at)
    flags, kinked = [], bool(polynomial.atoms(sp.sign, sp.Heaviside, sp.Piecewise))
    for point in found.points:
        aside = BESIDE * (scale + abs(point))  # at a kink the slopes of both sides count
        sides = [point - aside, point, point + aside] if kinked else [point]
        numbers = [polynomial.xreplace({ybar: sp.Float(x), **given}).doit() for x in sides]
        flags.append(any(map(_repels, numbers)))
    steady = len(flags) - sum(flags)
    reason = f"{found} for a constant input, {steady} non-diverging; two are needed"
    return Verdict(list(found.points), all(flags), steady >= 2, reason, at)


WIDTH = sp.Rational(1, 10**15)  # of the interval that isolates a root
TOUCH = 1e-11  # relative to the largest term: a minimum as low as that touches zero
BESIDE = 1e-9  # of the output's range: to either side of a kink
SAME = 1e-6  # relative: roots nearer to each other are one that rounding has split
GRID, RANGES = 2001, 1e6  # where a bracket is looked for, and how many ranges away


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

    Polynomials by Sturm's theorem over the rationals that the decimals stand for, so that none is missed and none is
    invented; all else by changes of sign, from within a small part of `scale` to a million times it.

    Raises
    ------
    ModelError
        Where the expression contains more than the unknown.
    """
    if foreign := excess.free_symbols - {unknown}:
        raise ModelError(f"The equilibria depend on further signals ({', '.join(map(str, foreign))}).")
    exact = sp.expand(excess)
    if exact.is_polynomial(unknown):
        return Equilibria(_isolated(sp.Poly(sp.nsimplify(exact, rational=True), unknown, domain="QQ")), True)
    return Equilibria(_bracketed(sp.lambdify([unknown], excess, modules="math"), scale), False)


def _isolated(polynomial: Any) -> tuple[float, ...]:
    if polynomial.degree() < 1:
        return ()
    found = [float((a + b) / 2) for (a, b), _ in polynomial.intervals(eps=WIDTH)]
    # A double root that rounding has lifted from the axis is a turning point at it.
    for turning in polynomial.diff().sqf_part().intervals(eps=WIDTH) if polynomial.degree() > 1 else ():
        at = float(sum(turning[0] if isinstance(turning[0], tuple) else turning) / 2)
        terms = [float(c) * at**n for (n,), c in polynomial.terms()]
        if abs(sum(terms)) <= TOUCH * max(map(abs, terms), default=0.0):
            found.append(at)
    kept: list[float] = []
    for x in sorted(found):
        if not kept or x - kept[-1] > SAME * (1e-3 + abs(x)):
            kept.append(x)
    return tuple(kept)


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
