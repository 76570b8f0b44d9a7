"""Section 3 of the paper, part by part: at rest, equilibria, quasi-static sets; assumptions; constraints as matrices.

Everything here is algebra on the model's equation; numbers enter only where a model has been fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp
from sympy.solvers.solveset import NonlinearError

from ..errors import FitError
from ..symbolic.signals import pairs
from . import assumptions
from .model import Model
from .quasi_static import QuasiStatic, phi1_, quasi_static, u_, ytilde
from .rest.equilibria import (
    SteadyState,
    characteristic,
    continuum,
    continuum_conditions,
    jacobian,
    jury,
    steady_state,
    without_integrator,
    z,
)
from .rest.property_1 import Verdict, property_1
from .rest_map import closed, effects_of, folded, newest_input, remembered, rest_map, sigma_y, ubar, ybar

__all__ = [
    "QuasiStatic", "SteadyState", "Verdict", "characteristic", "check", "constraint_matrix", "continuum",
    "continuum_conditions", "effects_of", "folded", "jacobian", "jury", "newest_input", "phi1_", "property_1",
    "quasi_static", "remembered", "rest_map", "sigma_y", "steady_state", "u_", "ubar", "without_integrator", "ybar",
    "ytilde", "z",
]  # fmt: skip


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
    closed(model, "What the assumptions say is", timeless=False)
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
