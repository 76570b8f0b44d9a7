"""The play base: y = lag(curve(sum of p_i play(u; r_i))), a Prandtl-Ishlinskii model as a recursion of Max and Min.

The radii are spread over the input's range, the weights are not negative, the curve is a broken line (Kuhnen 2003), and
where the plays start is unknown. A play remembers where the input turned; a NARX model knows only where it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sp
from scipy.optimize import nnls

from ...data.record import Record
from ...engines.algebra import smoothed
from ...engines.compile import compile
from ...errors import FitError, ModelError
from ...models.effects.memory import play
from ...models.info import Selection
from ...models.model import Model
from ...models.rest_map import plays, remembered, rest_map, ubar, ybar
from ...models.rewrite import without
from ...symbolic.identities import added
from ...symbolic.recursion import Recursion, State
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import k, signal, u, v, y
from ..freerun import FreeRun
from ..least_squares import describe
from ..simulate import segments

Array = np.ndarray
PLAYS: int = 10
KNOTS: int = 4
LAGS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
SAME = 1.02  # a delay explains as much as another one
LEAST, SLOWEST = 0.01, 0.999  # poles
EVEN = 0.03  # the ridge that keeps the first weights even, of the input's own column
NOTHING = 1e-4  # of all weights: a play below it is left out
STEPS = 60
SHARE, CREEPS, SLOW = 0.02, 10, 0.9  # creep at the start of the fit: its share, lags in a record; least pole
SETTLES = 1e-9  # of the slope of the output over its own past from one


@dataclass(frozen=True)
class Shape:
    """What is chosen before the fit: radii [unit of u], knots of the curve [unit of y], and the delay."""

    radii: tuple[float, ...]
    knots: tuple[float, ...]
    delay: int
    creep: bool = False

    def model(self, origin: Mapping[Any, float], theta: Sequence[float] | None = None) -> Model:
        """Return the model; its parameters are a, p_0 ... p_n, c_0 ... c_m, and g and b of the creep."""
        a = sp.Symbol("a", real=True)
        p = sp.symbols(f"p_0:{len(self.radii) + 1}", real=True)
        c = sp.symbols(f"c_0:{len(self.knots) + 1}", real=True)
        states = plays_of(self.radii)
        total = sp.Add(p[0] * u[k], *(w * s.left for w, s in zip(p[1:], states, strict=True)))
        g, b, slow = sp.Symbol("g", real=True), sp.Symbol("b", real=True), signal("slow")
        followed = [State(v[k], total, u[k])]
        now = v[k - self.delay]
        if self.creep:  # the share g of what drives the stage comes late, by a slow lag with the pole b
            followed.append(State(slow[k], b * slow[k - 1] + (1 - b) * v[k], y[k], "slow"))
            inner = signal("w")
            followed.append(State(inner[k], v[k] + g * slow[k], y[k]))
            now = inner[k - self.delay]
        curve = sp.Add(
            now, c[0], *(w * sp.Max(now - b, 0) for w, b in zip(c[1:], map(number, self.knots), strict=True))
        )
        F = a * y[k - 1] + (1 - a) * curve
        late = (g, b) if self.creep else ()
        return Model(F, (a, *p, *c, *late), theta, states=[*states, *followed], operating_point=origin)


def number(value: float) -> Any:
    """Return a number that reads well and is kept exactly in a file."""
    return sp.Float(f"{value:.6g}")


def plays_of(radii: Sequence[float]) -> list[State]:
    """Return the play operators of the input; each starts by itself."""
    made = []
    for i, r in enumerate(map(number, radii), 1):
        state = play(u, signal(f"z{i}"), r)
        made.append(State(state.left, state.right, state.initial, f"z{i}"))
    return made


def identify_play(
    records: Sequence[Record], origin: Mapping[Any, float], delays: Sequence[int] = range(4), plays: int = PLAYS,
    creep: bool = False, knots: int = KNOTS,
) -> Model:  # fmt: skip
    """Identify a play model in free run.

    Parameters
    ----------
    origin : the operating point
    delays : which are tried [samples]
    plays : int
        How many radii are spread over half the input's range; those without weight are left out.
    creep : bool
        Whether a share of what the plays give comes late, by a slow lag.
    knots : int
        Where the curve may bend.

    Raises
    ------
    ModelError
        For fewer than one play, or a number of knots below zero.
    FitError
        Where the output falls with the input.
    """
    if int(plays) != plays or not 1 <= plays <= 50:
        raise ModelError(f"The play base has from 1 to 50 plays, not {plays}.")
    if int(knots) != knots or not 0 <= knots <= 50:
        raise ModelError(f"The curve of the play base bends at 0 to 50 places, not {knots}.")
    parts = segments(records)
    half = float(np.ptp(np.concatenate([p.u for p in parts]))) / 2
    radii = [float(f"{half * i / (plays + 1):.6g}") for i in range(1, plays + 1)]
    along = _plays_along(parts, origin, radii)
    guesses = [_guess(parts, origin, along, radii, a, d, knots) for d in delays for a in LAGS]
    close = [g for g in guesses if g.error <= SAME * min(g.error for g in guesses)]
    guess = min(close, key=lambda g: (g.shape.delay, g.error))
    if creep:
        slow = 1 - CREEPS / max(len(p) for p in parts)
        guess = replace(guess, shape=replace(guess.shape, creep=True), theta=(*guess.theta, SHARE, slow))
    model = _fitted(guess, parts, origin)
    own = {s.left.base for s in plays_of(radii)}
    weighty = sum(s.left.base in own for s in model.memory)  # creep remembers too
    reason = (
        f"{weighty} of {plays} plays have a nonzero weight; the delay is the smallest within 2 % of the best of "
        f"{len(delays)}"
    )
    chosen = Selection("play", len(delays) * len(LAGS), len(model.symbols), reason)
    return model.replace(info=replace(model.info, selection=chosen))


@dataclass(frozen=True)
class Guess:
    """Where a fit starts: a shape, the values of its parameters, and the rms error of y without a fit."""

    shape: Shape
    theta: tuple[float, ...]
    error: float


def _guess(
    parts: Sequence[Record], origin: Mapping[Any, float], along: Sequence[Array], radii: Sequence[float], a: float,
    delay: int, knots: int,
) -> Guess:  # fmt: skip
    """Guess the weights for a given lag and a straight curve, by non-negative least squares.

    One loop does not tell neighbouring radii apart: of all weights that explain it the even ones are taken (a ridge).
    """
    known = [_known_from(p.u) for p in parts]
    columns = np.vstack([_lagged(P, a, delay)[i:] for P, i in zip(along, known, strict=True)])
    target = np.concatenate([p.y[i:] for p, i in zip(parts, known, strict=True)]) - origin.get(y, 0.0)
    one, n = np.ones((target.size, 1)), columns.shape[1]
    ridge = EVEN * np.linalg.norm(columns[:, 0]) * np.eye(n, n + 2)[1:]
    found = nnls(np.vstack([np.hstack([columns, one, -one]), ridge]), np.concatenate([target, np.zeros(n - 1)]))[0]
    weights, constant = found[:n], float(found[n] - found[n + 1])
    if weights.sum() <= 0:
        raise FitError(
            "The output falls when the input rises, but a play model can only rise. Change the sign of the input."
        )
    low, high = float(target.min()) - constant, float(target.max()) - constant
    bends = tuple(float(f"{low + (high - low) * i / (knots + 1):.4g}") for i in range(1, knots + 1))
    weights = np.maximum(weights, NOTHING * weights.sum())
    error = float(np.sqrt(np.mean((columns @ weights + constant - target) ** 2)))
    theta = (max(a, LEAST), *map(float, weights), constant, *[0.0] * knots)
    return Guess(Shape(tuple(radii), bends, delay), theta, error)


def _known_from(source: Array) -> int:
    """Return from where on the plays are known: both ends of the input were visited, or a fifth of it is over."""
    ends = np.sort([int(np.argmin(source)), int(np.argmax(source))])
    return int(min(ends[1], source.size // 5))


def _plays_along(parts: Sequence[Record], origin: Mapping[Any, float], radii: Sequence[float]) -> list[Array]:
    """Return the input and its plays along each segment, (N, 1 + plays) arrays [unit of u]."""
    recursion = Recursion(tuple((s.left, s.right) for s in plays_of(radii)))
    run, listed = compile(recursion), []
    for part in parts:
        driver = part.u - origin.get(u, 0.0)
        memory = run({"u": driver}, [], {b.name: driver[0] for b in recursion.states}, start=1)
        listed.append(np.column_stack([driver, *memory.values()]))
    return listed


def _lagged(P: Array, a: float, delay: int) -> Array:
    """Return the columns delayed behind a lag, from rest."""
    late = np.vstack([np.repeat(P[:1], delay, axis=0), P[: len(P) - delay]])
    return smoothed(a, late)


def _fitted(guess: Guess, parts: Sequence[Record], origin: Mapping[Any, float]) -> Model:
    """Fit all parameters and the unknown starts of output and plays together, in free run."""
    model = guess.shape.model(origin, guess.theta)
    problem = FreeRun(model, list(parts), ())
    n, knots = len(guess.shape.radii) + 1, len(guess.shape.knots)
    a, *rest = model.symbols
    weights, bends, late = rest[:n], rest[n + 1 : n + 1 + knots], rest[n + 1 + knots :]
    limits = {a: (0.0, SLOWEST), **dict.fromkeys(weights, (0.0, np.inf))}
    limits |= {weights[0]: (NOTHING * added(guess.theta[1 : n + 1]), np.inf)}  # the law divides by it
    limits |= dict(zip(late, ((0.0, 1.0), (SLOW, 1 - 1e-6)), strict=False))
    limits |= dict.fromkeys(bends, (-1 / (knots + 1), np.inf))  # so the curve rises everywhere
    found = problem.minimise(problem.start(np.array(guess.theta)), STEPS, 1e-7, limits)
    theta, errors = problem.theta(found.x), dict(zip(model.symbols, problem.errors(found), strict=True))
    least = NOTHING * added(theta[1 : n + 1])
    gone = [s for s, value in zip(weights[1:], theta[2 : n + 1], strict=True) if value < least]
    made = model.replace(theta=theta.tolist())
    made = without(made, gone) if len(gone) < n - 1 else made
    made = made.replace(standard_errors=[errors[s] for s in made.symbols])
    return describe(made, list(parts), "free_run", bool(found.status > 0))


def branch_after(model: Model, history: Any) -> Any:
    """Return the quasi-static output after a history, an expression in u[k] and numbers, in the user's units.

    A play that u moves one way from a turn, however far, ends where one step takes it: Max(u - r, Min(u + r, z)) with z
    as it was at the turn. So one expression is the branch to either side, until the input turns again.

    Parameters
    ----------
    history : (N,) array [unit of u]
        The input until the turn; the plays rest at its first sample before.

    Raises
    ------
    ModelError
        For a model that remembers otherwise than by plays of its input, or whose output does not settle.
    """
    found = plays(model)
    if not found or remembered(model, found):
        raise ModelError("Branches after a history are derived for models whose only memory is plays of the input.")
    source, own = np.asarray(history, dtype=float), dict(model.recursion.updates)
    moved = Recursion(tuple((one.base[k], own[one.base[k]]) for one in found))
    first = {one.base: float(model.starts[one.base].xreplace({u[k]: sp.Float(source[0])})) for one in found}
    run = compile(moved)({"u": source}, [], first, start=1)
    rest = rest_map(model).xreplace(model.values)
    for one in found:
        low, high = one.between(u[k])
        rest = rest.xreplace({one.rest: sp.Max(low, sp.Min(high, sp.Float(run[one.base.name][-1])))})
    rest = rest.xreplace({ubar: u[k]})
    slope = derivative(rest, ybar)
    if slope.has(ybar) or abs(float(slope) - 1) < SETTLES:
        raise ModelError("The output of this model does not settle on a curve over its input.")
    return rest.xreplace({ybar: sp.S.Zero}) / (1 - slope)
