"""The noise of the sensor, from the record alone: what changes from sample to sample without a reason.

Three estimates, each too large where its assumption fails, so that the smallest counts:

- differences of high order over their norm: what is left of a smooth signal is the noise (von Neumann et al. 1941);
- second differences between periods of an input that repeats: what drifts slowly from period to period goes out;
- the residual of a long linear prediction from past outputs, and inputs up to now.

Noise that is slow, such as a load or a temperature, is not the sensor's.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

from ..record import Record

Array = np.ndarray
ORDERS = range(2, 9)  # of the differences
USUAL = 1.4826  # median of the absolute value to standard deviation, of a normal distribution
LAGS = (10, 30)  # of output and input in the prediction
PERIODS = 3  # at least
LONG = 20_000  # samples that are looked at
CLEARLY = 1.5  # above the sensor's noise: not it alone


def sensor_noise(records: Sequence[Record], period: int = 0) -> float:
    """Return the standard deviation of the sensor's noise [unit of y].

    Parameters
    ----------
    period : int
        Of an input that repeats exactly [samples]; 0 where it does not.
    """
    parts = [part for record in records for part in record.segments() if len(part) > 2 * sum(LAGS)]
    if not parts:
        return 0.0
    part = max(parts, key=len)[:LONG]
    found = [_differences(part.y), _prediction(part.u, part.y)]
    if period and len(part) >= PERIODS * period:
        y = part.y
        found.append(usual_size(y[2 * period :] - 2 * y[period:-period] + y[: -2 * period]) / np.sqrt(6))
    steps = np.abs(np.diff(part.y))
    grid = float(steps[steps > 0].min()) if np.any(steps > 0) else 0.0
    quantised = grid / np.sqrt(12) if np.mean(steps == 0) > 0.2 else 0.0
    return float(max(min(found), quantised))


def usual_size(x: Array) -> float:
    """Return the standard deviation of a signal whose rare large values do not count."""
    return float(USUAL * np.median(np.abs(x - np.median(x))))


def _differences(y: Array) -> float:
    """Return the smallest of the scaled differences; of white noise they are all alike."""
    return min(usual_size(np.diff(y, n)) / np.sqrt(comb(2 * n, n)) for n in ORDERS)


def _prediction(u: Array, y: Array) -> float:
    """Return the residual of y[k] from past outputs and from inputs up to now, with the degrees of freedom counted."""
    p, q = LAGS
    rows = np.arange(max(p, q), y.size)
    y, u = y - y.mean(), u - u.mean()
    X = np.column_stack([*(y[rows - i] for i in range(1, p + 1)), *(u[rows - j] for j in range(q)), np.ones(rows.size)])
    scale = np.linalg.norm(X, axis=0)
    X = X / np.where(scale > 0, scale, 1.0)
    gram = X.T @ X + 1e-12 * np.eye(X.shape[1])
    e = y[rows] - X @ np.linalg.solve(gram, X.T @ y[rows])
    return usual_size(e) * float(np.sqrt(rows.size / (rows.size - X.shape[1])))


def unexplained(error: Array, sensor: float, Ts: float) -> str:
    """Say how large an error is that the sensor cannot make, and how fast; an empty text where it can.

    Parameters
    ----------
    error : (N,) array [unit of y]
    sensor : float
        Standard deviation of the sensor's noise.
    Ts : float in s
    """
    size = float(np.sqrt(np.mean(error**2)))
    if sensor == 0 or size <= CLEARLY * sensor:
        return ""
    power = np.cumsum(np.abs(np.fft.rfft(error - error.mean())) ** 2)
    half = int(np.searchsorted(power, power[-1] / 2)) / (error.size * Ts)
    return f"unexplained: {np.sqrt(size**2 - sensor**2):.3g} rms, half of its power below {half:.3g} Hz"


def repeated(record: Record) -> int:
    """Return the period of an input that repeats exactly at least twice [samples], or 0."""
    u, n = record.u - record.u.mean(), len(record)
    spectrum = np.abs(np.fft.rfft(u, 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[: n // 2 + 1] / np.arange(n, n - n // 2 - 1, -1)
    tolerance = 1e-6 * np.ptp(record.u)
    peaks = np.flatnonzero((rho[1:-1] >= rho[:-2]) & (rho[1:-1] > rho[2:]) & (rho[1:-1] > 0.999 * rho[0])) + 1
    for period in [*peaks[:20], n // 2]:
        if period > 8 and np.abs(record.u[period:] - record.u[:-period]).max() <= tolerance:
            return int(period)
    return 0


def period_noise(records: Sequence[Record]) -> list[Array]:
    """Return what differs between periods, over sqrt(2): pieces of the noise itself [unit of y].

    The first period is left out: it may hold a transient (Pintelon & Schoukens 2012).
    """
    found = []
    for record in records:
        period = repeated(record)
        if period and len(record) >= 3 * period:
            y = record.y[period:]
            found.append((y[period:] - y[:-period]) / np.sqrt(2))
    return found
