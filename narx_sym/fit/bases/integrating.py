"""Whether an axis integrates, as far as a record tells: a pole of A y = B u at 1 that the input drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...data.evidence.several import rests
from ...data.record import Record
from ...engines.algebra import filtered
from ...models.model import NARX, Model
from ...symbolic.signals import lag, signal, u, y
from ..evaluate import free_run_nrmse
from ..freerun import has_integrator

Array = np.ndarray
ROUNDED = 1e-6  # of a pole: less is rounding
DRIVEN = 2.0  # times the mean square, where nothing drives a pole that hardly decays: less, and it imitates a drift


def slowest_seen(records: Sequence[Record]) -> float:
    """Return the pole [per sample] whose time constant is a quarter of the longest segment.

    A slower one cannot be told from an integrator.
    """
    return float(np.exp(-4 / max(len(s) for r in records for s in r.segments())))


def poles(a: Array) -> Array:
    """Return the poles of y[k] = a[0] y[k-1] + a[1] y[k-2] + ..., (n,)."""
    return np.asarray(np.roots(np.concatenate([[1.0], -np.asarray(a)])))


def slowest(a: Array) -> float:
    """Return the size of the largest pole; 0 where the output has no memory."""
    return float(np.abs(poles(a)).max(initial=0.0))


def lasting(a: Array, slow: float) -> tuple[bool, bool]:
    """Whether there are poles that hardly decay, near 1 and elsewhere: as slow as `slow` (`slowest_seen`).

    A pair elsewhere swings within the record, once at least; undamped it imitates a line of the output's spectrum, such
    as the third harmonic of a bent response to a sine; no axis integrates there.
    """
    once = -np.log(slow) * np.pi / 2  # `slow` decays four times in the longest segment, this turns once in it
    near = [abs(np.angle(p)) <= once for p in poles(a) if abs(p) > slow]
    return any(near), not all(near)


def at_one(a: Array, slow: float) -> bool:
    """Whether a pole cannot be told from 1."""
    return lasting(a, slow)[0]


def drives(
    a: Array, n_u: int, inputs: Sequence[tuple[str, int]], records: Sequence[Record], slow: float, error: float
) -> bool:
    """Whether inputs drive the poles of A y = B u that hardly decay: without them much more would be left.

    Undriven these poles keep their free response in each segment, and the inputs the other poles: least squares. A
    drift, or a line of the spectrum, which no input makes, is described as well without a drive; an axis or a
    resonance is not. Of records that each answer a step at its beginning it cannot tell: their free response is that
    answer.

    Parameters
    ----------
    a : (n,) array, the coefficients of older outputs
    n_u : int, of each input
    inputs : names, each with its delay [samples]
    slow : float, the pole from which on one hardly decays
    error : float, the mean square that A y = B u leaves [unit of y squared]
    """
    found = poles(a)
    stay = np.abs(found) > slow
    regressors, outputs = [], []
    for s in (s for r in records for s in r.segments()):
        k = np.arange(len(s))
        first = max(found.size, *(d + n_u + 1 for _, d in inputs))  # a free run starts from the samples before
        still = np.poly(found[~stay]).real
        shown = [(filtered(still, s.signals[n] - s.signals[n].mean()), d) for n, d in inputs]
        driven = np.column_stack([np.roll(x, d + i) for x, d in shown for i in range(n_u + 2)])[first:]
        since = [k - k[-1] if abs(p) > 1 else k for p in found]  # of what grows, backwards: it stays finite
        free = [part(p**i) for p, i in zip(found, since, strict=True) for part in (np.real, np.imag)]
        own = np.column_stack([*free, np.ones(len(s))])[first:]
        both = np.column_stack([driven, s.y[first:]])
        both -= own @ np.linalg.lstsq(own, both, rcond=None)[0]  # each segment has its own free response
        regressors.append(both[:, :-1])
        outputs.append(both[:, -1])
    matrix, measured = np.vstack(regressors), np.concatenate(outputs)
    left = measured - matrix @ np.linalg.lstsq(matrix, measured, rcond=None)[0]
    return bool(np.mean(left**2) > DRIVEN * error)


def integrates(model: Model, records: Sequence[Record]) -> bool:
    """Whether the input drives a linear model through a pole that the records cannot tell from 1.

    A model of other equations integrates where these say so.
    """
    if not isinstance(model, NARX):
        return has_integrator(model)
    a, slow = _coefficients(model, y), slowest_seen(records)
    if not at_one(a, slow):
        return False
    if rests(records):  # nothing else makes what they do
        return True
    error = free_run_nrmse(model, records) * np.std(np.concatenate([r.y for r in records]))
    signals = [u, *(signal(n) for n in model.channels)]
    shown = {base.name: np.flatnonzero(_coefficients(model, base)) for base in signals}
    inputs = [(name, int(at[0])) for name, at in shown.items() if at.size]
    n_u = max((int(np.ptp(at)) + 1 for at in shown.values() if at.size), default=1)
    return drives(a, n_u, inputs or [(u.name, 0)], records, slow, error**2)


def hardly_decays(model: Model, records: Sequence[Record]) -> bool:
    """Whether a linear model has a pole that the records cannot tell from 1."""
    return at_one(_coefficients(model, y), slowest_seen(records))


def grows(model: Model) -> bool:
    """Whether a linear model has a pole beyond 1, by more than rounding."""
    return slowest(_coefficients(model, y)) > 1 + ROUNDED


def _coefficients(model: Model, base: Any) -> Array:
    """Return the coefficients of the samples of a signal in a linear model, by lag."""
    found = {lag(x): c for c, (_, x) in zip(model.theta, model.parts(), strict=True) if x.has(base)}
    return np.array([found.get(i, 0.0) for i in range(int(base == y), max(found, default=0) + 1)])
