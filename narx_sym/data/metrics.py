"""Error measures of a simulation and of a compensation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import NarxError
from .arrays import Vector, vector


def mape(y: ArrayLike, y_hat: ArrayLike) -> float:
    """Return the mean absolute error in per cent of the range of `y` (the paper's MAPE).

    Parameters
    ----------
    y, y_hat : (N,) arrays, same unit
        Measured and modelled signal.

    Returns
    -------
    float
        100 sum|y - y_hat| / (N |max y - min y|), in per cent.

    Raises
    ------
    NarxError
        For arrays of different lengths, and a `y` that is constant.

    Examples
    --------
    >>> import narx_sym as ns
    >>> print(round(ns.mape([0.0, 1.0, 2.0], [0.1, 1.0, 1.9]), 3))
    3.333
    """
    a, b = _pair(y, y_hat, "mape", "y", "y_hat")
    _need_change(a, "mape", "y")
    return float(100.0 * np.mean(np.abs(a - b)) / np.ptp(a))


def nsavi(m: ArrayLike, r: ArrayLike) -> float:
    """Return how much the compensated input `m` moves, relative to the reference `r` (the paper's NSAVI).

    Parameters
    ----------
    m, r : (N,) arrays, N >= 2
        Input to the plant and reference.

    Returns
    -------
    float
        sum|diff m| / sum|diff r|, without unit when `m` and `r` share one.

    Raises
    ------
    NarxError
        For arrays of different lengths, and an `r` that is constant.

    Examples
    --------
    >>> import narx_sym as ns
    >>> print(ns.nsavi([0.0, 2.0, 1.0], [0.0, 1.0, 1.5]))
    2.0
    """
    a, b = _pair(m, r, "nsavi", "m", "r")
    _need_change(b, "nsavi", "r")
    # The paper prints a sum of ratios. Its tables come from the ratio of the sums, which also stays finite
    # where the reference rests.
    return float(np.sum(np.abs(np.diff(a))) / np.sum(np.abs(np.diff(b))))


def rms(x: ArrayLike) -> Vector:
    """Return the root of the mean square along the last axis; NaN where one is inside."""
    return np.asarray(np.sqrt(np.mean(np.square(x), axis=-1)))


def rmse(y: ArrayLike, y_hat: ArrayLike) -> float:
    """Root of the mean squared error of two (N,) arrays, in the unit of `y`."""
    a, b = _pair(y, y_hat, "rmse", "y", "y_hat")
    return float(np.sqrt(np.mean((a - b) ** 2)))


def nrmse(y: ArrayLike, y_hat: ArrayLike) -> float:
    """rms(y - y_hat) / std(y) of two (N,) arrays, without unit; 1 is the error of the mean value."""
    a, b = _pair(y, y_hat, "nrmse", "y", "y_hat")
    _need_change(a, "nrmse", "y")
    return rmse(a, b) / float(np.std(a))


def fit_percent(y: ArrayLike, y_hat: ArrayLike) -> float:
    """100 (1 - nrmse) of two (N,) arrays, in per cent; 100 is perfect, below 0 is worse than the mean."""
    return 100.0 * (1.0 - nrmse(y, y_hat))


def correlation_length(x: Vector) -> int:
    """Return the first lag at which the autocorrelation falls below 1/e [samples]."""
    x = x - x.mean()
    n = 1 << (2 * x.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(x, n)) ** 2
    rho = np.fft.irfft(spectrum, n)[: x.size]
    below = np.flatnonzero(rho < rho[0] / np.e)
    return int(below[0]) if below.size else x.size


def half_cycle(x: Vector) -> int:
    """Return how long a signal stays on one side of its median at a time taken at random: half a cycle [samples].

    So noise about the median, which crosses it often in a short time, counts for little.
    """
    n, level = x.size, x > np.median(x)
    turns = np.diff(np.flatnonzero(level[1:] != level[:-1]))
    return int(np.clip(np.median(np.repeat(turns, turns)) if turns.size else n, min(20, n), max(20, n // 3)))


def _pair(a: ArrayLike, b: ArrayLike, metric: str, name_a: str, name_b: str) -> tuple[Vector, Vector]:
    """Both signals as finite (N,) arrays of one length."""
    first, second = (
        vector(x, f"{metric}: {name}", NarxError, "did the simulation diverge?")
        for x, name in ((a, name_a), (b, name_b))
    )
    # Without this check (N,) and (N, 1) would broadcast to (N, N) and give a plausible wrong number.
    if np.shape(a) != np.shape(b):
        raise NarxError(
            f"{metric}: {name_a} has shape {np.shape(a)} but {name_b} has shape {np.shape(b)}; "
            "give arrays of the same shape"
        )
    if not first.size:
        raise NarxError(f"{metric}: {name_a} is empty")
    return first, second


def _need_change(x: Vector, metric: str, name: str) -> None:
    """Refuse a constant divisor."""
    if np.ptp(x) == 0.0:
        raise NarxError(f"{metric}: {name} is constant ({x[0]:.6g}), so the error has nothing to be compared with")
