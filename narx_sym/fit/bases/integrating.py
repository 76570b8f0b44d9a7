"""Whether an axis integrates, as far as a record tells: a pole of A y = B u at 1 that the input drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from ...data.record import Record

Array = np.ndarray
DRIVEN = 0.5  # of the output's spread that passes through that pole: less, and it is that of a drift, not of an axis


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


def at_one(a: Array, slow: float) -> bool:
    """Whether a pole is at 1: as slow as `slow` (`slowest_seen`), and it does not swing within the record.

    A pair that swings without damping imitates a line of the output's spectrum, such as the third harmonic of a bent
    response to a sine; no axis integrates there.
    """
    near = [p for p in poles(a) if abs(np.angle(p)) <= 1 - slow]
    return max(map(abs, near), default=0.0) > slow


def undriven(a: Array, n_u: int, delay: int, records: Sequence[Record], slow: float) -> float:
    """Return the mean square that A y = B u leaves where the input does not drive the poles that hardly decay.

    They keep their free response, and the input the other poles: least squares in each segment [unit of y squared].
    A line of the spectrum, which no input makes, is described as well without a drive; a resonance is not.

    Parameters
    ----------
    a : (n,) array, the coefficients of older outputs
    n_u, delay : int, of the inputs
    slow : float, the pole from which on one hardly decays
    """
    found = poles(a)
    lasting = np.abs(found) > slow
    left = []
    for s in (s for r in records for s in r.segments()):
        k = np.arange(len(s))
        u = lfilter([1.0], np.poly(found[~lasting]).real, s.u - s.u.mean())
        columns = [np.where(k < delay + i, 0.0, np.roll(u, delay + i)) for i in range(n_u + 2)]
        columns += [part(p**k) for p in found for part in (np.real, np.imag)]
        matrix = np.column_stack([*columns, np.ones(len(s))])
        left.append(s.y - matrix @ np.linalg.lstsq(matrix, s.y, rcond=None)[0])
    return float(np.mean(np.concatenate(left) ** 2))


def driven(a: Array, b: Array, records: Sequence[Record]) -> float:
    """Return how far the input moves the output through the pole at 1: a standard deviation [unit of the output].

    Parameters
    ----------
    a, b : (n,) and (m,) arrays, the coefficients of older outputs and of inputs
    """
    found = poles(a)
    others = np.delete(found, np.argmin(np.abs(found - 1)))
    gain = np.sum(b) / np.prod(1 - others).real
    return float(max(np.std(gain * np.cumsum(s.u - s.u.mean())) for r in records for s in r.segments()))
