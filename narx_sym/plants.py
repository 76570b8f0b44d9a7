"""Simulated truths by ordinary differential equations, independent of the model code."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter

from .errors import DataError

Array = np.ndarray


def rk4(f: Callable[[Any, Any, Any], Any], x0: Any, u: Array, Ts: float, substeps: int = 1) -> Array:
    """Integrate x' = f(x, u, u') by the classical Runge-Kutta method, u linear between its samples.

    Parameters
    ----------
    f : function of (x, u, du/dt)
    x0 : number or (batch,) array
    u : (N,) or (N, batch) array
    Ts : float
        Sampling time [s].
    substeps : int
        Integration steps per sample.

    Returns
    -------
    (N,) or (N, batch) array
    """
    series = u.tolist() if u.ndim == 1 else u  # Python floats are faster than NumPy scalars
    x, path, h = x0, [x0], Ts / substeps
    for now, following in itertools.pairwise(series):
        rate = (following - now) / Ts
        for i in range(substeps):
            a = now + rate * h * i
            b, c = a + rate * h / 2, a + rate * h
            k1 = f(x, a, rate)
            k2 = f(x + h / 2 * k1, b, rate)
            k3 = f(x + h / 2 * k2, b, rate)
            k4 = f(x + h * k3, c, rate)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        path.append(x)
    return np.array(path)


def bouc_wen(
    u: Any,
    Ts: float = 1e-3,
    A: Any = 0.9,
    beta: Any = 0.008,
    gamma: Any = 0.008,
    d_p: Any = 1.6,
    h0: float = 0.0,
) -> Array:
    """Piezoelectric actuator with Bouc-Wen hysteresis (Rakotondrabe 2011; the paper's Eq. System).

    h' = A u' - beta |u'| h - gamma u' |h|,  y = d_p u - h.

    Parameters
    ----------
    u : (N,) or (N, batch) array [V]
    Ts : float [s]
        Also the integration step, as in the paper.
    A [um/V], beta [1/V], gamma [1/V], d_p [um/V] : float or (batch,)
    h0 : float [um]

    Returns
    -------
    y : array like u [um]
    """
    u = np.asarray(u, dtype=float)
    if u.ndim not in (1, 2) or u.shape[0] < 2 or not np.all(np.isfinite(u)):
        raise DataError("The plant needs an input of at least two finite samples, (N,) or (N, batch).")

    def f(h: Any, _: Any, du: Any) -> Any:
        return A * du - beta * abs(du) * h - gamma * du * abs(h)

    start = h0 if u.ndim == 1 else np.full(u.shape[1], h0)
    return d_p * u - rk4(f, start, u, Ts)


def filtered_noise(
    N: int = 50_000, Ts: float = 1e-3, cutoff: float = 1.0, peak: float = 75.0, seed: int = 0, order: int = 5
) -> Array:
    """White Gaussian noise through a Butterworth low-pass filter, scaled to a peak (Martins & Aguirre 2016).

    Parameters
    ----------
    N, Ts [s], cutoff [Hz], order : as in the paper (50 000, 1 ms, 1 Hz, 5)
    peak : float
        Largest absolute value. [unit of u]

    Returns
    -------
    (N,) array
    """
    b, a = butter(order, 2 * cutoff * Ts)
    u = lfilter(b, a, np.random.default_rng(seed).standard_normal(N))
    return u * (peak / np.abs(u).max())
