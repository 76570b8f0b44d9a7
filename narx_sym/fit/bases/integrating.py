"""Whether an axis integrates, as far as a record tells: a pole of A y = B u at 1 that the input drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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
