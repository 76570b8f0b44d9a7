"""Property 1: what a fitted model does under a constant input (section 3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy as sp

from ...errors import ModelError
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import k, samples
from ..model import Model
from ..rest_map import plays, ubar, ybar
from .equilibria import characteristic, resting, z
from .roots import resting_points


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
BESIDE = 1e-9  # of the output's range: to either side of a kink
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
    excess = resting(model)
    excess = sp.expand(excess.xreplace({s: sp.S.Zero for s in excess.free_symbols - {ybar, ubar}}))
    if excess == 0:
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
