"""The equivalent missing input: the smallest forcing that makes the model follow the measurement (Hooker 2009)."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solveh_banded
from scipy.optimize import brentq, minimize_scalar

from ...errors import DataError
from ...fit.simulate import vector

Array = np.ndarray


class Forcing:
    """The forcing along a free run, smoothed as much as `log_lam` says.

    The free-run error obeys e[k] = sum_i a_i[k] e[k-i] + w[k]. Its noise-free part x minimises
    |e - x|^2 + lam |L x|^2, where L x is the forcing w (Tikhonov). The first n_y rows of L are those of the identity,
    or nothing where the start states were estimated: then a start is no forcing.

    Parameters
    ----------
    e : (N,) array [unit of y]
    a : (N, n_y) array
        a_i[k] = dF/dy[k-i].
    started : bool
        Whether the start states were estimated.
    """

    ENDS = (-4.0, 10.0)  # of log10(lam)

    def __init__(self, e: Array, a: Array, started: bool = False):
        self.e, self.bare = e, a.shape[1] == 0
        # Row i: what w[k] takes from x[k-i].
        self.rows = np.vstack([np.ones(e.size), -a.T])
        self.rows[1 - started :, : a.shape[1]] = 0
        self.gram = _gram(self.rows)
        self.signs = np.random.default_rng(0).choice([-1.0, 1.0], e.size)
        self.log_lam = self.ENDS[0]

    def smooth(self, e: Array, log_lam: float | None = None) -> Array:
        """Return the noise-free part of an error, in the shape of `e`."""
        if self.bare:
            return e
        band = 10 ** (self.log_lam if log_lam is None else log_lam) * self.gram
        band[0] += 1
        return np.asarray(solveh_banded(band, e, lower=True, check_finite=False))

    def of(self, e: Array) -> Array:
        """Return the forcing that makes up an error, (N,)."""
        x = self.smooth(e)
        return np.asarray(sum(_late(row, x, i) for i, row in enumerate(self.rows)))

    def choose(self, floor: float | None = None) -> None:
        """Choose how much is smoothed; see `missing_input`."""
        ends = self.ENDS
        if self.bare or not self.e.any():
            return
        if floor is None:
            found = minimize_scalar(self._validation, bounds=ends, method="bounded", options={"xatol": 0.1}).x
        elif self._excess(ends[0], floor) >= 0:
            found = ends[0]
        elif self._excess(ends[1], floor) <= 0:
            found = ends[1]
        else:
            found = brentq(self._excess, *ends, args=(floor,), xtol=0.01)
        self.log_lam = float(found)

    def _excess(self, log_lam: float, floor: float) -> float:
        size = np.sqrt(np.mean(self.e**2))
        left = np.sqrt(np.mean((self.e - self.smooth(self.e, log_lam)) ** 2))
        return float(np.log(left / max(floor, 1e-12 * size)))

    def _validation(self, log_lam: float) -> float:
        x = self.smooth(np.column_stack([self.e, self.signs]), log_lam)
        # Hutchinson 1990: the trace of the smoother, from one random vector of signs.
        free = 1 - float(self.signs @ x[:, 1]) / self.e.size
        return float(np.log(np.mean((self.e - x[:, 0]) ** 2)) - 2 * np.log(free))

    def reaching(self, frequency: float) -> float:
        """Return log10(lam) at which half of an error of a frequency [cycles per sample] passes.

        The slopes are those of the last sample.
        """
        turns = np.exp(-2j * np.pi * frequency * np.arange(len(self.rows)))
        return float(-2 * np.log10(np.abs(turns @ self.rows[:, -1])))


def missing_input(residual: Any, slopes: Any, floor: float | None = None) -> Array:
    """Find the smallest forcing that makes the model follow the measurement; see `Forcing`.

    Parameters
    ----------
    residual : (N,) array [unit of y]
        Free-run error e.
    slopes : (N, n_y) array
        a_i[k] = dF/dy[k-i] along the run. Without memory (n_y = 0) the forcing is the error itself.
    floor : float, optional [unit of y]
        Standard deviation of the noise: lam makes rms(e - x) as large (Morozov's discrepancy principle). Without it,
        lam minimises the generalised cross validation (Golub, Heath and Wahba 1979), for white noise.

    Returns
    -------
    w : (N,) array [unit of y]
    """
    e = vector(residual, "free-run error")
    a = np.asarray(slopes, dtype=float)
    if a.ndim != 2 or a.shape[0] != e.size or not np.all(np.isfinite(a)):
        raise DataError(f"The slopes must be finite, of the shape ({e.size}, n_y), not {a.shape}.")
    if a.shape[1] == 0 or not e.any() or e.size <= a.shape[1]:
        return np.array(e)
    forcing = Forcing(e, a)
    forcing.choose(floor)
    return forcing.of(e)


def _late(row: Array, x: Array, lag: int) -> Array:
    """Return row[k] x[k - lag], 0 before the start."""
    return np.concatenate([np.zeros(lag), row[lag:] * x[: x.size - lag]])


def _gram(rows: Array) -> Array:
    """Lower bands of L'L, (n_y + 1, N): entry [d, j] is (L'L)[j + d, j]."""
    depth, n = rows.shape[0] - 1, rows.shape[1]
    out = np.zeros_like(rows)
    for d in range(depth + 1):
        for i in range(d, depth + 1):  # row k = j + i of L holds both columns j and j + d
            out[d, : n - i] += rows[i, i:] * rows[i - d, i:]
    return out
