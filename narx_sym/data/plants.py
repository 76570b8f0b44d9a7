"""Simulated truths by ordinary differential equations, independent of the model code."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter

from ..errors import DataError

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
    substeps: int = 1,
) -> Array:
    """Piezoelectric actuator with Bouc-Wen hysteresis (Rakotondrabe 2011; the paper's Eq. System).

    h' = A u' - beta |u'| h - gamma u' |h|,  y = d_p u - h.

    Parameters
    ----------
    u : (N,) or (N, batch) array [V]
    Ts : float [s]
        Also the integration step, as in the paper, unless `substeps` divide it.
    A [um/V], beta [1/V], gamma [1/V], d_p [um/V] : float or (batch,)
    h0 : float [um]
    substeps : int
        Integration steps per sample.

    Returns
    -------
    y : array like u [um]
    """
    u = np.ma.asarray(u, dtype=float).filled(np.nan)  # what is masked is missing
    if u.ndim not in (1, 2) or u.shape[0] < 2 or not np.all(np.isfinite(u)):
        raise DataError("The plant needs an input of at least two finite samples, (N,) or (N, batch).")

    def f(h: Any, _: Any, du: Any) -> Any:
        return A * du - beta * abs(du) * h - gamma * du * abs(h)

    start = h0 if u.ndim == 1 else np.full(u.shape[1], h0)
    return d_p * u - rk4(f, start, u, Ts, substeps)


def valve(
    u: Any,
    Ts: float = 0.01,
    tau: float = 0.2,
    Fc: float = 280.2,
    Fs: float = 336.3,
    Fv: float = 612.9,
    vs: float = 2.54e-4,
    M: float = 1.361,
    k: float = 52_538.0,
    S: float = 0.064516,
    stroke: float = 0.1016,
    substeps: int = 10,
) -> Array:
    """Pneumatic control valve: I/P converter, diaphragm, spring, stem with stiction (Kayihan & Doyle 2000).

    tau p' = p_u - p,  M x'' = S p - k x - f,  with p_u = 0 ... 12 psi and x = 0 ... stroke for u, y = 1 ... 5 V.
    Friction (Armstrong-Helouvry, Dupont & Canudas de Wit 1994): while it slides f = F sign(x') + Fv x' with
    F = Fc + (Fs - Fc) exp(-(x'/vs)^2); while it sticks f balances the rest, up to Fs.

    Each step is implicit in x' (Moreau 1988): sticking is a solution of the step, not a switch.

    Parameters
    ----------
    u : (N,) array [V]
        Linear between its samples; the valve starts at rest, pulled by no friction.
    Ts : float [s]
    tau : float [s]
        Of converter and diaphragm chamber.
    Fc, Fs : float [N]
        Coulomb friction and breakaway force. By default 63 lbf, PTFE packing on a 5/8 in stem (Fisher Control Valve
        Handbook, typical packing friction), and 1.2 times that, the ratio of Kayihan & Doyle, whose own valve (320 lbf)
        hardly moves on the paper's 0.56 V.
    Fv [N s/m], vs [m/s], M [kg], k [N/m], S [m^2], stroke [m] : float
        3.5 lbf s/in, 0.01 in/s, 3 lb, 300 lbf/in, 100 in^2, 4 in (Kayihan & Doyle 2000; Choudhury, Thornhill & Shah
        2005, Table 1).
    substeps : int
        Steps per sample.

    Returns
    -------
    y : (N,) array [V]
        Stem position.
    """
    u = np.ma.asarray(u, dtype=float).filled(np.nan)  # what is masked is missing
    if u.ndim != 1 or u.size < 2 or not np.all(np.isfinite(u)):
        raise DataError("The valve needs an input (N,) of at least two finite samples.")
    h, full = Ts / substeps, k * stroke / S  # [Pa]: 12 psi moves the spring through its stroke
    lag, inertia = -math.expm1(-h / tau), M + h * Fv + h * h * k
    p = full * (float(u[0]) - 1) / 4
    x, v = min(max(S * p / k, 0.0), stroke), 0.0
    path = [x]
    for now, following in itertools.pairwise(u.tolist()):
        for i in range(1, substeps + 1):
            p += lag * (full * (now + (following - now) * i / substeps - 1) / 4 - p)
            push, friction = M * v + h * (S * p - k * x), h * (Fc + (Fs - Fc) * math.exp(-((v / vs) ** 2)))
            v = (push - math.copysign(friction, push)) / inertia if abs(push) > friction else 0.0
            x += h * v
            if not 0.0 <= x <= stroke:
                x, v = min(max(x, 0.0), stroke), 0.0  # the stops
        path.append(x)
    return 1 + 4 * np.array(path) / stroke


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
