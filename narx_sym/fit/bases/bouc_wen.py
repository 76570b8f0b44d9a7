"""The Bouc-Wen base: the catalogue's actuator (Rakotondrabe 2011), which the paper simulates, behind a lag or bare.

w[k] = w[k-1] + c1 du + c2 |du| h + c3 du |h|,   du = u[k] - u[k-1],   h = d u[k-1] - w[k-1] - h0
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from ...data.record import Record
from ...errors import FitError
from ...models.effects.memory import actuator_hysteresis
from ...models.info import Selection
from ...models.model import Model
from ...symbolic.recursion import State
from ...symbolic.signals import k, samples, signal, y
from ..freerun import FreeRun
from ..least_squares import describe
from ..simulate import segments

Array = np.ndarray
GAINS = ((0.6, 1.3), (0.3, 2.0))  # slopes after a turn, and far from it, over that of the line through the data
TURNS = (0.5, 3.0)  # how fast the slope changes, over half the range of the input
LAG, SLOWEST = 0.7, 0.999  # poles
STEPS, REFINED = 12, 60
WORTH = 0.95  # a lag must bring 5 %: without one the law is that of the paper


def actuator(origin: Mapping[Any, float], lagged: bool, delay: int, theta: Sequence[float] | None = None) -> Model:
    """Return the model; its parameters are c1, c2, c3, d, h0, and a where a lag follows."""
    symbols = sp.symbols("c1 c2 c3 d h0", real=True)
    *c, d, h0 = symbols
    form = actuator_hysteresis.equations(d=d)
    w = signal("w") if lagged or delay else y
    # h0 is where the loop has its centre, an offset of what the force is measured from.
    seen = {y[k - 1]: w[k - 1] + h0}
    right = w[k - 1] + sp.Add(*(a * z.xreplace(seen) for a, z in zip(c, form.z, strict=True)))
    if w == y:
        return Model(right, symbols, theta, operating_point=origin)
    a = sp.Symbol("a", real=True) if lagged else sp.S.Zero
    state = State(w[k], right, y[k], "w")
    F = a * y[k - 1] + (1 - a) * w[k - delay]
    return Model(F, (*symbols, a) if lagged else symbols, theta, states=[state], operating_point=origin)


def identify_bouc_wen(records: Sequence[Record], origin: Mapping[Any, float], delays: Sequence[int]) -> Model:
    """Identify the Bouc-Wen base in free run: bare or behind a lag, the smallest delay that explains as much.

    Raises
    ------
    FitError
        Where every run diverges.
    """
    parts = segments(records)
    found: list[tuple[float, int, Model]] = []
    for lagged, delay in ((False, 0), *((True, d) for d in delays)):
        for theta in _starts(parts, lagged):
            model, cost, _ = _refined(actuator(origin, lagged, delay, theta), parts, STEPS) or (None, 0.0, False)
            if model is not None:
                found.append((cost * (WORTH**2 if not lagged else 1.0), delay, model))
    if not found:
        raise FitError("No Bouc-Wen model follows these data in free run.")
    least = min(cost for cost, _, _ in found)
    _, _, chosen = min((f for f in found if f[0] <= 1.02 * least), key=lambda f: (f[1], f[0]))
    done = _refined(chosen, parts, REFINED)
    model, _, converged = done if done else (chosen, 0.0, False)
    model = describe(model, list(parts), "free_run", converged)
    what = "with a lag" if len(model.symbols) > 5 else "bare"
    reason = f"the Bouc-Wen actuator {what}, delay {model.delay}: the best of {len(found)} starts in free run"
    return model.replace(info=replace(model.info, selection=Selection("bouc-wen", len(found), 0, reason)))


def _starts(parts: Sequence[Record], lagged: bool) -> Iterator[list[float]]:
    """Yield values that the fit starts from."""
    source, output = (np.concatenate([getattr(p, n) for p in parts]) for n in "uy")
    slope, half = float(np.polyfit(source, output, 1)[0]), float(np.ptp(source)) / 2
    for (first, far), turn, shape in product(GAINS, TURNS, (1.0, -1.0)):
        begin = [first * slope, turn / half, shape * turn / half, far * slope, 0.0]
        yield [*begin, LAG] if lagged else begin


def _refined(model: Model, parts: Sequence[Record], steps: int) -> tuple[Model, float, bool] | None:
    """Fit in free run; None where it diverges."""
    try:
        problem = FreeRun(model, list(parts), ())
        limits = {s: (0.0, SLOWEST) for s in model.symbols if str(s) == "a"}
        found = problem.minimise(problem.start(np.array(model.theta)), steps, 1e-9, limits)
    except FitError:
        return None
    made = model.replace(theta=problem.theta(found.x).tolist(), standard_errors=problem.errors(found))
    return (made, float(found.cost), bool(found.status > 0)) if samples(made.F) else None
