"""The quasi-static sets ytilde(u, phi1) under loading and unloading, and where they attract (paper, section 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.signals import Name, differences, held, lags
from .doors import QuasiStaticDoors
from .model import Model
from .rest.equilibria import characteristic, constrained, jacobian, jury, solvable, without_integrator
from .rest_map import Play, closed, folded, plays, rest_of

ytilde = Name(r"\tilde{y}", real=True)
u_, phi1_ = Name("u", real=True), Name("phi_1", real=True)


@dataclass(frozen=True)
class QuasiStatic(QuasiStaticDoors, printing.InLatex):
    """The sets ytilde(u, phi1) under loading and unloading, and where they attract.

    Attributes
    ----------
    loading, unloading : expressions in u and phi_1, in the user's units
        Of several solutions a finite set, and where no formula of real numbers tells them the set of all real ones.
    jacobian : expression dF/dy[k-1], or a list of them for n_y > 1
    attracting : relational, or `And` of the Jury conditions for n_y > 1
    turns : mapping from symbols to (low, high), expressions in u
        Where the model has plays: the value of each at the last turn of the input, and between which it then was.

    What the constraints of the model say of its parameters is put in: of a Sigma_y = 1 model 1 - Sigma_y is gone.
    """

    model: Model
    loading: Any
    unloading: Any
    jacobian: Any
    attracting: Any
    turns: Mapping[Any, tuple[Any, Any]] = field(default_factory=dict)

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
        loading, unloading = (_shown(branch) for branch in (self.loading, self.unloading))
        sign = r"\in" if isinstance(self.loading, sp.Set) else "="
        cases = (
            loading
            if loading == unloading
            else rf"\begin{{cases}} {loading}, & \phi_{{2}} = 1 \\[6pt] {unloading}, & \phi_{{2}} = -1 \end{{cases}}"
        )
        cases = rf"\tilde{{{self.model.output.label}}} {sign} {cases}"
        return cases + r" \\ " + printing.latex(self.attracting)


def _shown(branch: Any) -> str:
    """Return LaTeX of a branch; of a set without formulas the equation that tells it."""
    if isinstance(branch, sp.ConditionSet):
        return rf"\left\{{{printing.latex(branch.sym)} \mid {printing.latex(branch.condition)}\right\}}"
    return printing.latex(branch)


def _static(expr: Any, model: Model, direction: int) -> Any:
    """Drop the time indices: y[k-i] is ytilde, u[k-j] is u, phi1[k-j] is phi_1, phi2[k-j] the direction."""
    first, second = differences(model.input)
    values = {model.output: ytilde, model.input: u_, first: phi1_, second: sp.Integer(direction)}
    for one in plays(model):  # since the input turned it has stayed, or it is taken along
        low, high = one.between(u_)
        values[one.base] = sp.Max(low, _turned(one)) if direction > 0 else sp.Min(high, _turned(one))
    return held(expr, lambda base: values.get(base, rest_of(base)))


def _turned(one: Play) -> Any:
    """Return the symbol of a play at the last turn of the input."""
    return Name(f"{one.base.label}_turn", real=True)


def quasi_static(model: Model) -> QuasiStatic:
    """Solve ytilde = F(ytilde, u, phi1, phi2) for phi2 = 1 (loading) and phi2 = -1 (unloading), Eq. (090919b).

    A play p[k] = Max(low(u), Min(high(u), p[k-1])) is, since the input turned, Max(low(u), p_turn) while the input
    rises, and Min(high(u), p_turn) while it falls: the branches of a model with plays depend on where they then were.

    Raises
    ------
    ModelError
        Where no closed form exists, and for a model that remembers more than its outputs, inputs and plays of them, or
        changes with time.
    """
    found = plays(model)
    turns = {_turned(one): one.between(u_) for one in found}
    closed(model, "The quasi-static solution is", but=found)
    F = model.in_user_units(folded(model))
    _no_lost_differences(model, F)
    offset = model.operating_point.get(model.output, 0)
    balances = [_static(F, model, direction) + offset - ytilde for direction in (1, -1)]
    known = constrained(model)
    if not all(sp.expand(e.xreplace(known)).has(ytilde) for e in balances):
        known = {}  # there is no such output: the general one says by which denominator
    branches = [_solved(e.xreplace(known), bool(turns)) for e in balances]
    slopes = [slope.xreplace(known) for slope in jacobian(model)]
    if not slopes:
        return QuasiStatic(model, branches[0], branches[1], sp.S.Zero, sp.true, turns)
    # The second lines of the paper's conditions divide by theta_4 phi_2 and hold only where that is positive: |.| < 1.
    conditions = jury(without_integrator(characteristic(slopes))[0])
    attracting = sp.And(*conditions, evaluate=False) if len(conditions) > 1 else conditions[0]
    only = slopes[0] if len(slopes) == 1 else slopes
    return QuasiStatic(model, branches[0], branches[1], only, attracting, turns)


def _solved(excess: Any, whole: bool) -> Any:
    """Solve for ytilde; a `whole` excess stays as it is: sums of plays in a curve, multiplied out, fill a page.

    Formulas for roots of higher degree hold complex numbers where the roots are real: these are told by the equation.
    """
    slope = sp.diff(excess, ytilde)
    if slope != 0 and not slope.has(ytilde):
        rest = excess.xreplace({ytilde: sp.S.Zero})
        return rest / -slope if whole else sp.factor_terms(sp.expand(rest)) / sp.factor_terms(sp.expand(-slope))
    if not solvable(excess, ytilde):
        raise ModelError("The quasi-static equation has no closed-form solution for this model.")
    if sp.degree(excess, ytilde) > 2:
        return sp.ConditionSet(ytilde, sp.Eq(excess, 0, evaluate=False), sp.S.Reals)
    solutions = sp.solve(excess, ytilde)
    return solutions[0] if len(solutions) == 1 else sp.FiniteSet(*solutions)


def _no_lost_differences(model: Model, F: Any) -> None:
    """Refuse differences that vanish when the time indices are dropped, other than phi1 and phi2."""
    for node in F.atoms(sp.Add):
        read = [lags(node, base) for base in (model.output, model.input)]
        if max(map(len, read)) > 1 and sp.expand(_static(node, model, 1)) == 0:
            raise ModelError(
                f"The quasi-static solution is not derived for this model: {printing.text(node)} is a time "
                "difference other than phi1."
            )
