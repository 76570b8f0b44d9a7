"""The equivalent missing input: the smallest forcing that makes the model follow the measurement (Hooker 2009)."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solveh_banded
from scipy.optimize import brentq, minimize_scalar

from ...errors import DataError
from ...fit.simulate import vector

Array = np.ndarray


def missing_input(residual: Any, slopes: Any, floor: float | None = None) -> Array:
    """Find the smallest forcing that makes the model follow the measurement.

    The free-run error obeys e[k] = sum_i a_i[k] e[k-i] + w[k]. Its noise-free part x minimises
    |e - x|^2 + lam |L x|^2, where L x is the forcing w (Tikhonov); the first n_y rows of L are those of the identity.

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
    depth = a.shape[1]
    size = float(np.sqrt(np.mean(e**2)))
    if depth == 0 or size == 0 or e.size <= depth:
        return np.array(e)
    # Row i: what w[k] takes from x[k-i].
    rows = np.vstack([np.ones(e.size), -a.T])
    rows[1:, :depth] = 0
    gram = _gram(rows)
    trials = {False: e[:, None], True: np.column_stack([e, np.random.default_rng(0).choice([-1.0, 1.0], e.size)])}

    def smooth(log_lam: float, probe: bool = False) -> Array:
        band = 10**log_lam * gram
        band[0] += 1
        return np.asarray(solveh_banded(band, trials[probe], lower=True, check_finite=False))

    def excess(log_lam: float) -> float:
        return float(np.log(np.sqrt(np.mean((e - smooth(log_lam)[:, 0]) ** 2)) / max(floor or 0.0, 1e-12 * size)))

    def validation(log_lam: float) -> float:
        x = smooth(log_lam, probe=True)
        # Hutchinson 1990: the trace of the smoother, from one random vector of signs.
        free = 1 - float(trials[True][:, 1] @ x[:, 1]) / e.size
        return float(np.log(np.mean((e - x[:, 0]) ** 2)) - 2 * np.log(free))

    ends = (-4.0, 10.0)
    if floor is None:
        best = float(minimize_scalar(validation, bounds=ends, method="bounded", options={"xatol": 0.1}).x)
    elif excess(ends[0]) >= 0:
        best = ends[0]
    elif excess(ends[1]) <= 0:
        best = ends[1]
    else:
        best = float(brentq(excess, *ends, xtol=0.01))
    x = smooth(best)[:, 0]
    return np.asarray(sum(_late(row, x, i) for i, row in enumerate(rows)))


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
