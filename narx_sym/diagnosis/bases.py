"""Step 1: the base model, refitted in free run; what it absorbs is not missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy as sp

from ..errors import FitError
from ..models.info import Info
from ..models.model import NARX, Model
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import k, lags, samples, u, y
from .refit import Fitted, Split, settle

Array = np.ndarray
BASE = "base"  # in a confusion set: the base's own terms
SLOW = 0.25  # of the record: a linear base with a longer time constant integrates
STUCK = 0.98  # a base whose error falls below this share of what it was had not been fitted
CYCLES = 3  # of a periodic input at least
ALIKE, RESTING = 1.6, 0.1  # ratio of the quartiles of one speed; share of the top speed below which nothing moves
NARROW, SHORT = 0.9, 100  # share of the energy in one spectral line; samples of a segment that do not count


def words(name: str) -> str:
    """Return the name of an effect, a run or a panel as words."""
    return "the base" if name == BASE else name.replace("_", " ")


def fit_base(model: Model, split: Split) -> Fitted:
    """Step 1: the given model, refitted in free run on the training samples; a linear base gets room."""
    models = [*(roomy(model, more) for more in (1, 0) if is_linear(model)), model]
    reason = ""
    fits = []
    for one in models:
        try:
            made = settle(one.fit(list(split.records)) if one.theta is None else one, split)
        except FitError as error:
            reason = str(error)
            continue
        # A pole that moved to 1 imitates a drift by integrating a constant.
        if not integrates(made, model):
            return made
        fits.append(made)
    if fits:
        return fits[-1]
    raise FitError(f"The base model cannot follow these data in free run: {reason} Choose another base.")


def settled_again(base: Fitted, extended: Sequence[Fitted]) -> Fitted | None:
    """Fit the base again from where the best extended model has its parameters; None where that is no better.

    What only helped the fit out of a local minimum is not missing.
    """
    best = min(extended, key=lambda f: f.mean_square(base.split.train))
    values = dict(zip(best.model.symbols, best.model.theta, strict=True))
    start = np.array([values.get(s, t) for s, t in zip(base.model.symbols, base.model.theta, strict=True)])
    try:
        again = settle(base.model, base.split, start, base.limits)
    except FitError:
        return None
    if integrates(again, base.model):
        return None
    return again if again.mean_square(base.split.train) < STUCK * base.mean_square(base.split.train) else None


def is_linear(model: Model) -> bool:
    """Whether a model is a base of linear terms whose orders were identified."""
    return isinstance(model, NARX) and model.info.selection.base == "linear"


def roomy(model: Any, more: int) -> Model:
    """Return a linear base with one lag more on the input's sides, and `more` lags of the output.

    Its orders were chosen while something was missing, and may be too small once it is there; what is superfluous is
    deleted after each addition.
    """
    a = model.n_y and min(model.n_y + more, 3)
    first, last = max(0, model.delay - 1), model.n_u + 1
    terms = [
        *(y[k - i] for i in range(1, a + 1)),
        *(u[k - j] for j in range(first, last + 1)),
        *_beside(model),
        sp.S.One,
    ]
    known = dict(zip(model.terms, model.theta, strict=True))
    return NARX(
        terms, [known.get(t, 0.0) for t in terms], operating_point=model.operating_point, Ts=model.Ts, info=model.info
    )


def _beside(model: NARX) -> list[Any]:
    """Return the terms of further measured signals."""
    own = {model.input, model.output}
    return [term for term in model.terms if any(s.base not in own for s in samples(term))]


def slowest(model: Model) -> float:
    """Return the largest pole of the linear part of a model's core."""
    values = dict(zip(model.symbols, map(float, model.theta), strict=True))
    slopes = []
    for i in range(1, model.n_y + 1):
        slope = derivative(model.core, model.inner[k - i])
        constant = [p for p in sp.Add.make_args(slope) if not p.has(sp.Indexed)]
        slopes.append(float(sum(p.xreplace(values) for p in constant)))
    return float(np.abs(np.roots([1.0, *(-s for s in slopes)])).max()) if slopes else 0.0


def integrates(made: Fitted, base: Model) -> bool:
    """Whether a pole of a linear base has moved to 1, as far as the records tell."""
    longest = max(len(r) for r in made.split.records)
    return is_linear(base) and slowest(made.model) > max(float(np.exp(-1 / (SLOW * longest))), slowest(base))


def simpler(base: Fitted) -> list[Fitted]:
    """Return bases without the dynamics of a linear base that may only imitate what is missing.

    On one sine a lag looks like hysteresis; at one speed drag looks like friction.
    """
    model = base.model
    if not isinstance(model, NARX) or not is_linear(model):
        return []
    if not all(narrow(r) for r in base.split.records if len(r) > SHORT):
        return []
    now = min((i for i in lags(model.core, u)), default=0)
    found = []
    for orders in sorted({model.n_y, 0}):
        terms = [*(y[k - i] for i in range(1, orders + 1)), u[k - max(now, model.delay)], *_beside(model), sp.S.One]
        if len(terms) >= len(model.symbols):
            continue
        kept = Info(selection=model.info.selection)
        made = NARX(terms, operating_point=model.operating_point, Ts=model.Ts, info=kept)
        try:
            found.append(settle(made.fit(list(base.split.records)), base.split))
        except FitError:
            continue
    return found


def narrow(record: Any) -> bool:
    """Whether nearly all of an input's energy is at one frequency, as in a sine or a triangle."""
    power = np.abs(np.fft.rfft((record.u - record.u.mean()) * np.hanning(len(record)))) ** 2
    peak = int(np.argmax(power))
    return bool(peak >= CYCLES and power[max(0, peak - 3) : peak + 4].sum() > NARROW * power.sum())


def one_speed(base: Fitted, driver: str) -> bool:
    """Whether a linear base has a velocity term of u or y, and the records show one speed.

    Then the velocity and its sign are one signal: any friction law is a multiple of any other.
    """
    moving = base.model.input if driver == "u" else base.model.inner
    if not is_linear(base.model) or len(lags(base.model.core, moving)) < 2:
        return False
    speed = np.concatenate([np.abs(np.diff(r.u if driver == "u" else r.y)) for r in base.split.records])
    speed = speed[speed > RESTING * np.quantile(speed, 0.99)]
    slow, fast = np.quantile(speed, [0.25, 0.75]) if speed.size else (0.0, 1.0)
    return bool(fast < ALIKE * slow)
