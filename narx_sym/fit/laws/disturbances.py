"""What becomes of a disturbance along a run: the product of the Jacobians, not of their eigenvalues."""

from __future__ import annotations

import math

import numpy as np

from ...symbolic.identities import added

Array = np.ndarray
SMALLEST, FAR = 1e-12, 1e100  # of a factor, so that its logarithm is finite; beyond which nothing is followed
FORGOTTEN, LOOKED = 1e-2, 5_000_000  # of a disturbance; how many products at most


def disturbed(slopes: Array) -> tuple[float, float]:
    """Follow disturbances through d[k] = slopes[0, k] d[k-1] + slopes[1, k] d[k-2] + ...

    Parameters
    ----------
    slopes : (n, N) array

    Returns
    -------
    growth : float
        The largest factor by which one grows that begins at any sample, before it has shrunk to a hundredth.
    rate : float
        The factor per sample by which the whole product grows; NaN without samples.
    """
    n, N = slopes.shape
    slopes = np.nan_to_num(slopes, nan=0.0, posinf=FAR, neginf=-FAR)
    if not N:
        return 1.0, math.nan
    if not n:
        return 1.0, 0.0
    if n == 1:
        logs = np.log(np.maximum(np.abs(slopes[0]), SMALLEST))
    else:
        logs = _tangent(slopes)
    heights = np.concatenate([[0.0], np.cumsum(logs)])
    grown = float(np.max(heights - np.minimum.accumulate(heights)))
    if n > 1:
        # A tangent turns with the run at its start; what is compared is its own size, wherever that begins.
        grown = max(_impulses(slopes), grown if heights[-1] > 0 else 0.0)
    return float(np.exp(min(grown, 700.0))), float(np.exp(np.mean(logs)))


def _tangent(slopes: Array) -> Array:
    """Return the logarithm of the growth of one tangent vector in each sample."""
    d, logs = [1.0] + [0.0] * (len(slopes) - 1), []
    for row in slopes.T.tolist():
        new = added(a * x for a, x in zip(row, d, strict=True))
        d = [new, *d[:-1]]
        size = max(max(map(abs, d)), SMALLEST**20)
        logs.append(math.log(size))
        d = [x / size for x in d]
    return np.array(logs)


def _impulses(slopes: Array) -> float:
    """Return the logarithm of the largest response to a unit error of m at any sample, while it has not died out."""
    n, N = slopes.shape
    d = np.zeros((n, N))
    d[0] = 1.0  # column s: the error at sample s, then what has become of it
    starts, largest = np.arange(N), 1.0
    for step in range(1, min(N, max(LOOKED // N, 100))):
        inside = starts + step < N
        d, starts = d[:, inside], starts[inside]
        new = np.einsum("ij,ij->j", slopes[:, starts + step], d)
        d = np.vstack([new, d[:-1]])
        size = np.abs(d).max(axis=0)
        largest = max(largest, float(np.abs(new).max(initial=0.0)))
        living = (size > FORGOTTEN) & (size < FAR)
        d, starts = d[:, living], starts[living]
        if not starts.size:
            break
    return math.log(largest)


def kept(slopes: Array) -> float:
    """Return what a lasting error of 1 in m has become at the end."""
    d = [1.0] * len(slopes)
    for row in slopes.T.tolist():
        d = [added(a * x for a, x in zip(row, d, strict=True)), *d[:-1]]
        if not abs(d[0]) < FAR:
            break
    return abs(d[0])
