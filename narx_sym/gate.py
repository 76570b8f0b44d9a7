"""Is anything missing at all? A test over every effect and every shape at once, after whitening.

The residual and the directions are filtered by an autoregressive model of the noise, estimated where everything that
the catalogue could explain is taken out. What a refit of the model could absorb is projected out of both. The largest
of all scores is compared with its own distribution under no effect (simulated from the correlations of the
directions), so neither the number of effects nor the number of shapes makes false alarms.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq, qr
from scipy.signal import lfilter
from scipy.stats import chi2

Array = np.ndarray
DRAWS, LEVEL = 999, 0.05
ORDER = 12
MOST, CLEAR = 12, 18.0  # columns that the noise is freed of at most, and the gain (in variances) of each at least
TINY = 1e-7  # share of a column's energy below which nothing but rounding is left


@dataclass(frozen=True)
class Scores:
    """What each group of columns explains of a residual.

    Attributes
    ----------
    share : (groups,) array
        Of the residual's energy, after what a refit absorbs is taken out (level space).
    gain : (groups,) array
        The same after whitening, as a likelihood ratio: energy over noise variance.
    log_p : (groups,) array
        Logarithm of the p-value of each group alone, with its own search.
    absorbed : (groups,) array
        Share of the direction's energy that a refit absorbs.
    p_value : float
        That the best of all is chance.
    critical : float
        The log p-value below which 5 % of the records without any effect fall.
    detectable : (groups,) array
        rms of the smallest contribution that would be seen [unit of y].
    """

    share: Array
    gain: Array
    log_p: Array
    absorbed: Array
    p_value: float
    critical: float
    detectable: Array

    def corrected(self, group: int) -> float:
        """Return the p-value of one group after correction for all of them."""
        if self.critical == 0:
            return 1.0
        tests = np.log(LEVEL) - self.critical  # log of the effective number of tests
        return float(np.exp(min(0.0, self.log_p[group] + tests)))


def orthonormal(columns: Array, energy: Array | None = None) -> Array:
    """Return an orthonormal basis of columns; what is below rounding of `energy` is left out."""
    if columns.shape[1] == 0:
        return columns
    size = np.linalg.norm(columns, axis=0) if energy is None else np.sqrt(energy)
    scaled = columns / np.where(size > 0, size, 1.0)
    if columns.shape[1] == 1:
        length = float(np.linalg.norm(scaled))
        return scaled / length if length**2 > TINY else scaled[:, :0]
    Q, R, _ = qr(scaled, mode="economic", pivoting=True)
    return np.asarray(Q[:, np.abs(np.diag(R)) ** 2 > TINY])


def explain(own: Array, directions: Array, residual: Array, variance: float | None = None) -> tuple[Array, Array]:
    """Return what remains of a residual after the few columns that clearly explain it, and which these are.

    Greedy, like forward selection: taking out all columns would take out the slow part of the noise too.
    """
    Q = orthonormal(own)
    e = residual - Q @ (Q.T @ residual)
    size = np.linalg.norm(directions, axis=0)
    D = directions / np.where(size > 0, size, 1.0)
    D = D - Q @ (Q.T @ D)
    picked: list[int] = []
    for _ in range(MOST):
        left = np.einsum("ij,ij->j", D, D)
        usable = left > 1e-6
        gain = np.where(usable, (D.T @ e) ** 2 / np.where(usable, left, 1.0), 0.0)
        best = int(np.argmax(gain))
        noise = float(e @ e - gain[best]) / max(1, e.size - Q.shape[1] - len(picked) - 1)
        if gain[best] < CLEAR * noise:
            break
        q = D[:, best] / np.sqrt(left[best])
        picked.append(best)
        e = e - q * (q @ e)
        D = D - np.outer(q, q @ D)
    return e, np.array(picked, dtype=int)


def autoregression(noise: Sequence[Array], order: int = ORDER) -> Array:
    """Return [1, a_1, ..., a_p] that whitens a noise, by least squares over all pieces."""
    order = min(order, max(1, min(n.size for n in noise) // 20))
    rows, targets = [], []
    for piece in noise:
        lagged = np.column_stack([piece[order - i : piece.size - i] for i in range(1, order + 1)])
        rows.append(lagged)
        targets.append(piece[order:])
    a = lstsq(np.concatenate(rows), np.concatenate(targets))[0]
    return np.concatenate([[1.0], -a])


def whiten(columns: Array, a: Array, edges: Array) -> Array:
    """Filter each segment by A(q); the first samples, which have no past, become zero."""
    out = np.empty_like(columns)
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        out[begin:end] = lfilter(a, [1.0], columns[begin:end], axis=0)
        out[begin : begin + a.size - 1] = 0.0
    return out


def score(
    residual: Array,
    own: Array,
    directions: Array,
    groups: Sequence[slice],
    searched: Sequence[float],
    edges: Array,
    rows: Array,
    seed: int = 0,
) -> Scores:
    """Score groups of directions against a residual.

    Parameters
    ----------
    residual : (N,) array, measured minus simulated [unit of y]
    own : (N, n) array
        The model's own directions: parameters and initial values.
    directions : (N, M) array
    groups : slices of its columns
    searched : how many alternatives each group was picked from by looking at the residual
    edges : where the segments begin and end
    rows : (N,) bool array
        Which samples count; the filter runs over all.
    """
    # What is missing is in here at first: it makes the noise look slower than it is, and is then taken out.
    noise = residual - own @ lstsq(own[rows], residual[rows])[0]
    for _ in range(3):  # the noise model and what it is estimated from improve each other
        a = autoregression(pieces(noise, edges, rows))
        white = whiten(np.column_stack([residual, own, directions]), a, edges)[rows]
        e, P, D = white[:, 0], white[:, 1 : own.shape[1] + 1], white[:, own.shape[1] + 1 :]
        remaining, picked = explain(P, D, e)
        chosen = np.column_stack([P, D[:, picked]])
        solution = lstsq(chosen, e)[0]
        noise = residual - np.column_stack([own, directions[:, picked]]) @ solution
    variance = float(remaining @ remaining) / max(1, e.size - chosen.shape[1])
    Q = orthonormal(P)
    e = e - Q @ (Q.T @ e)
    energy = np.einsum("ij,ij->j", D, D)
    D = D - Q @ (Q.T @ D)
    level_e, level_own, level_D = residual[rows], own[rows], directions[rows]
    Q0 = orthonormal(level_own)
    level_e = level_e - Q0 @ (Q0.T @ level_e)
    level_energy = np.einsum("ij,ij->j", level_D, level_D)
    level_D = level_D - Q0 @ (Q0.T @ level_D)

    count = len(groups)
    share, gain, log_p, absorbed, detectable = (np.zeros(count) for _ in range(5))
    bases, owners, freedoms = [], [], np.zeros(count, dtype=int)
    total = float(level_e @ level_e) or 1.0
    for i, columns in enumerate(groups):
        basis = orthonormal(D[:, columns], energy[columns])
        level = orthonormal(level_D[:, columns], level_energy[columns])
        share[i] = float(np.sum((level.T @ level_e) ** 2)) / total
        gain[i] = float(np.sum((basis.T @ e) ** 2)) / variance
        freedoms[i] = basis.shape[1]
        left_over = np.einsum("ij,ij->", level_D[:, columns], level_D[:, columns])
        absorbed[i] = 1 - left_over / (level_energy[columns].sum() or 1.0)
        log_p[i] = chi2.logsf(gain[i], basis.shape[1]) + np.log(searched[i]) if basis.shape[1] else 0.0
        bases.append(basis)
        owners.append(np.full(basis.shape[1], i))
    log_p = np.minimum(log_p, 0.0)
    lowest = _null(np.column_stack(bases), np.concatenate(owners), freedoms, searched, seed)
    best = float(log_p.min())
    p_value = (1 + int(np.sum(lowest <= best))) / (DRAWS + 1)
    critical = float(np.quantile(lowest, LEVEL))
    for i, columns in enumerate(groups):
        detectable[i] = _detectable(
            D[:, columns], level_D[:, columns], variance, critical - np.log(searched[i]), freedoms[i]
        )
    return Scores(share, gain, log_p, absorbed, p_value, critical, detectable)


def pieces(x: Array, edges: Array, rows: Array) -> list[Array]:
    """Return the contiguous stretches of the samples that count."""
    found = []
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        cuts = np.flatnonzero(np.diff(rows[begin:end].astype(int))) + 1 + begin
        bounds = [begin, *cuts, end]
        found += [x[i:j] for i, j in itertools.pairwise(bounds) if rows[i]]
    return found


def _null(basis: Array, owner: Array, freedoms: Array, searched: Sequence[float], seed: int) -> Array:
    """Return the smallest log p-value of each of many records without any effect, (DRAWS,)."""
    values, vectors = np.linalg.eigh(basis.T @ basis)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    drawn = rng.standard_normal((DRAWS, root.shape[1])) @ root.T
    energy = np.zeros((DRAWS, freedoms.size))
    np.add.at(energy.T, owner, (drawn**2).T)
    # Groups picked from the residual count as one more test: their p-values include the search.
    lowest = np.log(rng.uniform(size=DRAWS)) if max(searched) > 1 else np.zeros(DRAWS)
    for f in np.unique(freedoms[freedoms > 0]):
        of = np.flatnonzero((freedoms == f) & (np.asarray(searched) == 1.0))
        if of.size:
            lowest = np.minimum(lowest, chi2.logsf(energy[:, of].max(axis=1), f))
    return lowest


def _detectable(D: Array, level: Array, variance: float, log_p: float, freedom: int) -> float:
    """Return the rms contribution whose expected gain passes the critical value in 90 % of the cases."""
    if not freedom:
        return float("inf")
    white, seen = np.linalg.norm(D), np.linalg.norm(level)
    if white == 0:
        return float("inf")
    needed = (np.sqrt(chi2.isf(np.exp(max(log_p, -700.0)), freedom)) + 1.2816) * np.sqrt(variance)
    return float(needed * seen / white / np.sqrt(len(D)))
