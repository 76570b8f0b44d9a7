"""A(q) y[k] = B(q) u[k] + f(...): the paper's grouping, and what stands in the way of Assumption A1."""

from __future__ import annotations

from typing import Any

import sympy as sp

from ..models.model import Model
from ..models.rest_map import effects_of, newest_input, remembered
from ..symbolic import printing
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import Name, expand_phi, k, lag, samples

q = Name("q")


def _addends(model: Model) -> list[tuple[Any, Any]]:
    """Return what the output adds up: each term, and the same with its coefficient in the user's units."""
    if model.states:
        return [(part, part) for part in sp.Add.make_args(sp.expand(model.right))]
    return [(term, c * expand_phi(model.in_user_units(term))) for c, term in model.parts()]


def offending(model: Model) -> list[tuple[Any, Any]]:
    """Return the terms that violate Assumption A1(i), each also with its coefficient in the user's units.

    They contain u[k - tau_d] other than linearly with a constant coefficient.
    """
    latest = model.input[k - newest_input(model)]
    return [
        (term, written)
        for term, written in _addends(model)
        if (written.has(latest) and samples(derivative(written, latest))) or _hidden(written, latest)
    ]


def _hidden(expr: Any, sample: Any) -> bool:
    return any(f.has(sample) for f in expr.atoms(sp.Function, sp.Piecewise))


def polynomials(model: Model) -> tuple[Any, Any, Any]:
    """Group a model as A(q) y[k] = B(q) u[k] + f: the linear regressors, and all the rest in f."""
    offset = sp.S.Zero if model.states else model.operating_point.get(model.output, sp.S.Zero)
    A, B, f = sp.S.One, sp.S.Zero, offset
    for _, written in _addends(model):
        pieces = sp.Add.make_args(sp.expand(written))
        if all(len(_samples_with_powers(p)) <= 1 for p in pieces):
            for piece in pieces:
                found = _samples_with_powers(piece)
                if not found or found[0].base not in (model.input, model.output):
                    f += piece
                elif found[0].base == model.output:
                    A -= piece / found[0] * q ** (-lag(found[0]))
                else:
                    B += piece / found[0] * q ** (-lag(found[0]))
        else:
            f += written
    return A, B, f


def _samples_with_powers(piece: Any) -> list[Any]:
    """Return the samples of a product with repetition; a sample inside a function counts twice."""
    found: list[Any] = []
    for factor in sp.Mul.make_args(piece):
        base, exponent = factor.as_base_exp()
        if isinstance(base, sp.Indexed) and exponent == 1:
            found.append(base)
        else:
            found += samples(factor) * 2
    return found


def why_not(model: Model, reason: str) -> str:
    """Say which terms or effects keep the newest input from being isolated."""
    arriving = model.recursion.graph.delays(model.input)[model.output] or 0
    latest = printing.text(model.input[k - (arriving if model.hidden else newest_input(model))])
    found = [] if model.hidden else offending(model)
    added = {c for e in model.effects for c in e.coefficients.values()}
    own = [one for one in found if added & one[1].free_symbols]
    if own:
        names = effects_of(model, sp.Add(*(written for _, written in own)))
        said = f"{names} uses it other than linearly, as in {printing.text(own[0][0])} (Assumption A1(i))"
    elif found:
        named = ", ".join(printing.text(t) for t, _ in found)
        said = (
            f"{named} {'violates' if len(found) == 1 else 'violate'} Assumption A1(i) (the only regressor involving "
            "u[k-tau_d] must be linear; --for-compensation keeps such terms out of the pool)"
        )
    elif holding := _holding(model):
        shown = ", ".join(printing.text(s.left) for s in holding)
        said = f"{effects_of(model, states=holding)} remembers it ({shown})"
    else:
        return f"{why}: {reason}" if (why := remembered(model)) else reason
    return f"{latest} cannot be isolated: {said}. {reason}"


def _holding(model: Model) -> list[Any]:
    """Return the states that remember and that the newest input passes."""
    passed = model.recursion.graph.fastest(model.input).reached(model.output)
    return [s for s in model.recurrent if s.left.base in passed]
