"""Linear algebra of fits with the same bits on every BLAS.

A fit that meets kinks lets a last digit grow until it ends in another minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgeqrf

Array = np.ndarray


def single(x: Sequence[float] | Array) -> Array:
    """Return numbers in single precision, as floats: of what starts a fit the digits that BLAS leaves open go.

    What is too large for it stays as it is.
    """
    x = np.asarray(x, dtype=float)
    with np.errstate(over="ignore"):
        rough = x.astype(np.float32).astype(float)
    return np.where(np.isinf(rough), x, rough)


def add_grams(J: Array, blocks: Sequence[tuple[int, slice]], out: Array) -> None:
    """Add J'J of blocks of rows to an array.

    Parameters
    ----------
    J : (N, n) float array
    blocks : sequence of (number, rows)
        Slices with a start and a stop.
    out : (count, n, n) float array
        C order; J'J of a block is added to out[number].
    """
    from .machine import algebra  # LLVM takes long to load

    algebra.add_grams(J, blocks, out)


def step(H: Array, g: Array, damping: float = 0.0) -> Array | None:
    """Return w of (H + damping I) w = -g, (n,), or None where that matrix is not positive definite.

    Parameters
    ----------
    H : (n, n) array
        Symmetric: what is left of its diagonal is not read.
    g : (n,) array
    """
    from .machine import algebra

    return algebra.step(H, g, damping)


def triangle(*parts: Array) -> Array:
    """Return R of the columns of several matrices (rows, n) = Q R, upper triangular, (columns or fewer, columns)."""
    both = np.empty((len(parts[0]), sum(p.shape[1] for p in parts)), order="F")
    np.concatenate(parts, axis=1, out=both)
    return np.triu(dgeqrf(both, overwrite_a=True)[0][: both.shape[1]])


def gathered(J: Array, r: Array, blocks: Sequence[tuple[slice, slice]], shared: int) -> Array:
    """Return a square matrix that has the products of [J r], (n + 1, n + 1): all that least squares asks of them.

    Of the n columns of J the first `shared` act in all rows, the others in one block of rows each: `blocks` are its
    rows, which may be none, and its columns. Of many short segments each has a start: nearly all of J is zero.
    """
    if len(blocks) == 1:
        return triangle(J, r[:, None])
    n = J.shape[1]
    found, left = np.zeros((n + 1, n + 1)), []
    common = [*range(shared), n]
    for rows, own in blocks:
        if rows.stop == rows.start:
            continue
        size, begin = own.stop - own.start, own.start - shared
        R = triangle(J[rows, own], J[rows, :shared], r[rows, None])
        found[begin : begin + min(size, len(R)), own] = R[:size, :size]
        found[begin : begin + min(size, len(R))][:, common] = R[:size, size:]
        left.append(R[size:, size:])
    last = triangle(np.vstack(left))
    found[n - shared : n - shared + len(last)][:, common] = last
    return found


def banded(lags: Sequence[int], slopes: Sequence[Array], right: Array) -> Array:
    """Solve x[k] - sum_i c_i[k] x[k-i] = right[k] for all k, where everything before the first k is zero, (n, m).

    Parameters
    ----------
    lags : numbers i, at least one
    slopes : (n,) arrays c_i
    right : (n, m) array
        Several right-hand sides at once.
    """
    from .machine import algebra

    return algebra.banded(lags, slopes, right)


def filtered(A: Sequence[float] | Array, x: Any) -> Array:
    """Return y of A(q) y[k] = x[k], A = 1 + A_1 q^-1 + ..., at rest before the first sample: x is (n,) or (n, m)."""
    x, A = np.asarray(x, dtype=float), np.atleast_1d(A)
    lags = range(1, A.size)
    if not lags:
        return x.copy()
    slopes = [np.full(len(x), -c) for c in A[1:]]
    return np.asarray(banded(lags, slopes, x if x.ndim > 1 else x[:, None])).reshape(x.shape)


def smoothed(pole: float, x: Any) -> Array:
    """Return what one lag, y[k] = pole y[k-1] + (1 - pole) x[k], makes of signals that rest at their first sample."""
    return np.asarray(x[:1] + filtered([1.0, -pole], (1 - pole) * (x - x[:1])))


def smallest(columns: Array, target: Array, dependent: float) -> Array:
    """Return the smallest least-squares solution; each column counts in its own size, whatever its unit.

    NaN where a number is not finite. Singular values below `dependent` times the largest are none.
    """
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        return np.full(columns.shape[1], np.nan)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(columns / scale, target, rcond=dependent)[0] / scale)
