"""Property 1: what a fitted model does under a constant input (section 3 of the paper)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp

from ...errors import ModelError
from ...symbolic.identities import added
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import k, samples
from ..model import Model
from ..rest_map import plays, ubar, ybar
from .equilibria import Equilibria, resting, resting_points
from .pieces import Linear, Piece, pieces, settles


@dataclass(frozen=True)
class Verdict:
    """Property 1: under a constant input a model of hysteresis has two or more real non-diverging equilibria.

    Attributes
    ----------
    equilibria : "continuum", or a list of numbers at the input `at`; None where it is not known whether there is one
    diverging : bool or None
        Whether all of them repel; None where that is not known.
    holds : bool or None
        None where it depends on equilibria that the linearisation does not decide: at kinks and jumps.
    reason : text
    at : number
        The constant input that decides: one at which there are two, where there is such a one [unit of the input].
    """

    equilibria: Any
    diverging: bool | None
    holds: bool | None
    reason: str
    at: float = 0.0


INPUTS = 9  # constant inputs over the identified range
OUTPUTS = 255  # of a continuum, at no equal distances
NEAR = 1e-9  # of the size of its terms: an expression as small as that is zero


def constant_inputs(model: Model) -> list[float]:
    """Return where a model is judged at rest: at its operating point, then over the identified range of the input."""
    low, high = model.info.ranges.get(model.input.name, (0.0, 0.0))
    centre = model.operating_point.get(model.input, 0.0 if low <= 0 <= high or low == high else (low + high) / 2)
    return [centre, *((low + (high - low) * i / (INPUTS - 1)) for i in range(INPUTS) if high > low)]


def property_1(model: Model) -> Verdict:
    """Count the equilibria of a fitted model under constant inputs and say whether they diverge.

    At a continuum the eigenvalue that is exactly 1 is taken out before the others are judged, at many of the identified
    outputs and inputs. At a kink all sides count. Further channels are held at zero.
    """
    if model.symbols and not model.values:
        raise ModelError("Property 1 can only be checked with numbers: fit the model or give theta first.")
    local = Local(model)
    if plays(model):
        return _along(local, "a play stays where the input has left it", lambda piece: piece)
    excess = resting(model)
    excess = sp.expand(excess.xreplace({s: sp.S.Zero for s in excess.free_symbols - {ybar, ubar}}))
    if excess == 0:
        return _along(local, "every output is an equilibrium at rest (Lemma 1)", lambda piece: piece.differences)
    low, high = model.info.ranges.get(model.output.name, (-1.0, 1.0))
    inputs = constant_inputs(model) if excess.has(ubar) else constant_inputs(model)[:1]
    verdicts = [_at_rest(local, excess.xreplace({ubar: sp.Float(at)}), at, max(abs(low), abs(high))) for at in inputs]
    ranked = sorted(verdicts, key=lambda v: {True: 0, None: 1, False: 2}[v.holds])
    best = ranked[0]
    where = f" (at {model.input.label} = {best.at:.4g})" if excess.has(ubar) and (best.at or len(inputs) > 1) else ""
    return Verdict(best.equilibria, best.diverging, best.holds, best.reason + where, best.at)


@dataclass(frozen=True)
class Local:
    """A fitted model around its equilibria, under constant inputs."""

    model: Model

    @cached_property
    def right(self) -> Any:
        """The equation in samples of the output and ubar, with values."""
        output, held = self.model.output, {self.model.input: ubar}
        others = {s: held.get(s.base, sp.S.Zero) for s in samples(self.model.right) if s.base != output}
        return self.model.right.xreplace({**others, **self.model.values})

    @cached_property
    def past(self) -> list[Any]:
        """y[k-1], y[k-2], ..."""
        return [self.model.output[k - i] for i in range(1, self.model.n_y + 1)]

    def still(self, expr: Any) -> Any:
        """Hold the output."""
        return expr.xreplace(dict.fromkeys(self.past, ybar))

    def everywhere(self, argument: Any) -> bool:
        """Whether an argument is zero wherever the output rests."""
        return bool(samples(argument)) and sp.expand(self.still(argument)) == 0

    def at(self, point: float, reach: float) -> Callable[[Any], bool]:
        """Return whether an argument is zero at a point, compared with its terms at `reach`."""

        def zero(argument: Any) -> bool:
            return bool(samples(argument)) and _vanishes(self.still(argument), point, reach)

        return zero

    def linear(self, listed: list[Piece] | None) -> Callable[[float, float], list[Linear] | None]:
        """Return the pieces around an output and an input; None where they do not meet there or have no slope."""
        parts = [
            (
                _function(self.still(p.right)),
                [_function(self.still(derivative(p.right, s))) for s in self.past],
                [([_function(self.still(derivative(a, s))) for s in self.past], sign) for a, sign in p.sides],
            )
            for p in listed or []
        ]

        def around(output: float, at: float) -> list[Linear] | None:
            found = []
            for value, slopes, sides in parts:
                if len(parts) > 1 and abs(value(output, at) - output) > 1e-6 * (abs(output) + self.step):
                    return None
                gradients = tuple((tuple(g(output, at) for g in gradient), sign) for gradient, sign in sides)
                found.append(Linear(tuple(f(output, at) for f in slopes), gradients))
            return found or None

        return around

    @cached_property
    def step(self) -> float:
        """A size of the output: jumps that are small beside it are none."""
        low, high = self.model.info.ranges.get(self.model.output.name, (0.0, 0.0))
        return max(abs(low), abs(high)) * 1e-3


def _function(expr: Any) -> Callable[[float, float], float]:
    made = sp.lambdify([ybar, ubar], expr, modules=[{"Heaviside": lambda x, *_: float(x > 0)}, "math"])

    def value(output: float, at: float) -> float:
        try:
            return float(made(output, at))
        except (ArithmeticError, ValueError, TypeError):
            return math.nan

    return value


def _vanishes(expr: Any, point: float, reach: float) -> bool:
    terms = [_function(term) for term in sp.Add.make_args(sp.expand(expr))]
    size = added(abs(term(reach, 0.0)) for term in terms)
    return abs(added(term(point, 0.0) for term in terms)) <= NEAR * size


def _along(local: Local, every: str, of: Callable[[Linear], Linear | None]) -> Verdict:
    """Judge a continuum where the model was identified: at many outputs and inputs, for its eigenvalues move."""
    listed = pieces(local.right, local.everywhere)
    around = local.linear(listed)
    moving = [local.still(derivative(p.right, s)) for p in listed or [] for s in local.past]
    low, high = local.model.info.ranges.get(local.model.output.name, (-1.0, 1.0))
    turns = [(i * (math.sqrt(5) - 1) / 2) % 1 for i in range(1, OUTPUTS + 1)]
    outputs = [low + (high - low) * turn for turn in turns] if any(e.has(ybar) for e in moving) else [0.0]
    inputs = constant_inputs(local.model) if any(e.has(ubar) for e in moving) else [0.0]
    found = []
    for at in inputs:
        judged = [_settles(around(output, at), of) for output in outputs]
        found.append((judged.count(True), judged.count(None), at))
    best = max(range(len(found)), key=lambda i: (found[i][0], found[i][1], -i))
    steady, unknown, at = found[best]
    n = len(outputs)
    kinds = (
        (steady, "non-diverging"),
        (unknown, "not decided by the linearisation"),
        (n - steady - unknown, "diverging"),
    )
    told = ", ".join(
        what if n == 1 else f"{what} at {_share(count, n)} of the outputs" for count, what in kinds if count
    )
    diverging = None if unknown and not steady else not steady
    holds = True if steady else None if unknown else False  # beside one there are others
    return Verdict("continuum", diverging, holds, f"{every}, {told}{f' ({n} looked at)' if n > 1 else ''}", at)


def _share(count: int, n: int) -> str:
    return "all" if count == n else f"{max(1, round(100 * count / n))}%"


def _settles(found: list[Linear] | None, of: Callable[[Linear], Linear | None]) -> bool | None:
    changed = [] if found is None else [of(piece) for piece in found]
    kept = [piece for piece in changed if piece is not None]
    return settles(kept) if kept and len(kept) == len(changed) else None


def _at_rest(local: Local, excess: Any, at: float, scale: float) -> Verdict:
    """Judge the equilibria under one constant input."""
    if sp.expand(excess) == 0:
        return Verdict("continuum", None, False, "every output is an equilibrium at this input", at)
    found = resting_points(excess, ybar, scale)
    if not found.points:
        drifts = ": the output drifts under a constant input" if found.complete else ": unknown"
        return Verdict([] if found.complete else None, None, False if found.complete else None, f"{found}{drifts}", at)
    judged = [_judged(local, point, at, found) for point in found.points]
    steady, unknown = judged.count(True), judged.count(None)
    open_ = f", {unknown} not decided by the linearisation" if unknown else ""
    reason = f"{found} for a constant input, {steady} non-diverging{open_}; two are needed"
    diverging = False if steady else None if unknown or not found.complete else True
    holds = True if steady >= 2 else None if steady + unknown >= 2 or not found.complete else False
    return Verdict(list(found.points), diverging, holds, reason, at)


def _judged(local: Local, point: float, at: float, found: Equilibria) -> bool | None:
    """Return whether an equilibrium attracts; None where its linearisation does not say."""
    fixed = Local(local.model)
    vars(fixed)["right"] = local.right.xreplace({ubar: sp.Float(at)})
    reach = max(fixed.step, *map(abs, found.points))
    around = fixed.linear(pieces(fixed.right, fixed.at(point, reach)))
    return _settles(around(point, at), lambda piece: piece)
