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
from scipy.signal import oaconvolve
from scipy.stats import chi2

Array = np.ndarray
DRAWS, LEVEL, POWER = 999, 0.05, 0.8416  # the last: standard normal quantile of 80 %
LONGEST = 120  # lags of the noise model at most
TRIALS = 6
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
    passes : (groups, groups) array
        By how much the energy of a group's columns (row) is to grow until a group (column) passes in 80 % of records.
    """

    share: Array
    gain: Array
    log_p: Array
    absorbed: Array
    p_value: float
    critical: float
    passes: Array

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


def reduced(own: Array, residual: Array, directions: Array) -> tuple[Array, Array, int]:
    """Return a residual and directions without what a refit of the model absorbs, and how many columns do that."""
    Q = orthonormal(own)
    return residual - Q @ (Q.T @ residual), directions - Q @ (Q.T @ directions), Q.shape[1]


def explain(own: Array, directions: Array, residual: Array) -> Array:
    """Return which few columns clearly explain a residual.

    Greedy, like forward selection: taking out all columns would take out the slow part of the noise too.
    """
    size = np.linalg.norm(directions, axis=0)
    e, D, rank = reduced(own, residual, directions / np.where(size > 0, size, 1.0))
    picked: list[int] = []
    for _ in range(MOST):
        left = np.einsum("ij,ij->j", D, D)
        usable = left > 1e-6
        gain = np.where(usable, (D.T @ e) ** 2 / np.where(usable, left, 1.0), 0.0)
        best = int(np.argmax(gain))
        noise = float(e @ e - gain[best]) / max(1, e.size - rank - len(picked) - 1)
        if gain[best] < CLEAR * noise:
            break
        q = D[:, best] / np.sqrt(left[best])
        picked.append(best)
        e = e - q * (q @ e)
        D = D - np.outer(q, q @ D)
    return np.array(picked, dtype=int)


def autoregression(noise: Sequence[Array]) -> tuple[Array, float]:
    """Return [1, a_1, ..., a_p] that whitens a noise, and its AIC: Burg's method over all pieces.

    A slow wander under white noise needs many lags; white noise takes none.
    """
    count = sum(n.size for n in noise)
    longest = max(1, min(LONGEST, count // 20, min(n.size for n in noise) // 3))
    forward = [np.asarray(n, dtype=float)[1:] for n in noise]
    backward = [np.asarray(n, dtype=float)[:-1] for n in noise]
    power = sum(float(n @ n) for n in noise) / count
    a = np.ones(1)
    best, chosen = np.log(power) if power > 0 else -np.inf, a
    for order in range(1, longest + 1):
        above = sum(float(f @ b) for f, b in zip(forward, backward, strict=True))
        below = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        if below <= 0:
            break
        reflection = -2 * above / below
        a = np.append(a, 0.0) + reflection * np.append(a, 0.0)[::-1]
        power *= 1 - reflection**2
        pairs = [(f + reflection * b, b + reflection * f) for f, b in zip(forward, backward, strict=True)]
        forward, backward = [f[1:] for f, _ in pairs], [b[:-1] for _, b in pairs]
        criterion = np.log(max(power, 1e-300)) + 2 * order / count
        if criterion < best:
            best, chosen = criterion, a
    return np.asarray(chosen), float(best * count)


def whiten(columns: Array, a: Array, edges: Array) -> Array:
    """Filter each segment by A(q); the first samples, which have no past, become zero."""
    out = np.empty_like(columns)
    for begin, end in itertools.pairwise(edges):
        out[begin:end] = oaconvolve(columns[begin:end], a[:, None], axes=0)[: end - begin]
        out[begin : begin + a.size - 1] = 0.0
    return out


def whitened(
    residual: Array,
    own: Array,
    directions: Array,
    edges: Array,
    rows: Array,
    lines: Sequence[slice] = (),
    measured: Sequence[Array] = (),
) -> tuple[Array, Array, Array, Array, float]:
    """Estimate the noise and filter by it, in turns: the filter, whitened e, own and directions, and e's variance."""
    always = [np.arange(s.start, s.stop) for s in lines]
    first = np.unique(np.concatenate(always)).astype(int) if always else np.zeros(0, dtype=int)
    if measured:
        a = autoregression(measured)[0]
    else:
        first, a = _dominant(residual, own, directions, edges, rows, first)
    for left in (0,) if measured else (2, 1, 0):  # the noise model and what it is estimated from improve each other
        white = whiten(np.column_stack([residual, own, directions]), a, edges)[rows]
        e, P, D = white[:, 0], white[:, 1 : own.shape[1] + 1], white[:, own.shape[1] + 1 :]
        more = explain(np.column_stack([P, D[:, first]]), D, e)
        picked = np.unique(np.concatenate([first, more]))
        chosen = np.column_stack([P, D[:, picked]])
        solution = lstsq(chosen, e)[0]
        remaining = e - chosen @ solution
        if left:
            a = autoregression(_pieces(residual - np.column_stack([own, directions[:, picked]]) @ solution, edges))[0]
    return a, e, P, D, float(remaining @ remaining) / max(1, e.size - P.shape[1] - picked.size)


def _pieces(noise: Array, edges: Array) -> list[Array]:
    return [noise[b:e] for b, e in itertools.pairwise(edges)]


def _dominant(
    residual: Array, own: Array, directions: Array, edges: Array, rows: Array, first: Array
) -> tuple[Array, Array]:
    """Take out the one column without which the noise looks much slower than it is (AIC), if there is one.

    An autoregressive model takes a strong drift for noise, and then nothing is left to be seen.
    """
    e, D, _ = reduced(own[rows], residual[rows], directions[rows])
    size = np.einsum("ij,ij->j", D, D)
    usable = size > 1e-6 * np.einsum("ij,ij->j", directions[rows], directions[rows])
    share = np.where(usable, (D.T @ e) ** 2 / np.where(usable, size, 1.0), 0.0)
    trials = [first, *(np.append(first, j) for j in np.argsort(-share, kind="stable")[:TRIALS] if j not in first)]
    found = []
    for trial in trials:
        used = np.column_stack([own, directions[:, trial]])
        noise = residual - used @ lstsq(used[rows], residual[rows])[0]
        a, criterion = autoregression(_pieces(noise, edges))
        found.append((criterion, trial.astype(int), a))
    best = min(found, key=lambda f: f[0])
    return (best if best[0] < found[0][0] - CLEAR else found[0])[1:]


def shares(residual: Array, own: Array, directions: Array, groups: Sequence[slice]) -> tuple[Array, Array]:
    """Return what each group of directions explains of a residual's energy, and what a refit absorbs of the group's."""
    energy = np.einsum("ij,ij->j", directions, directions)
    e, D, _ = reduced(own, residual, directions)
    share, absorbed = np.zeros(len(groups)), np.zeros(len(groups))
    total = float(e @ e) or 1.0
    for i, columns in enumerate(groups):
        basis = orthonormal(D[:, columns], energy[columns])
        share[i] = float(np.sum((basis.T @ e) ** 2)) / total
        left = np.einsum("ij,ij->", D[:, columns], D[:, columns])
        absorbed[i] = 1 - left / (energy[columns].sum() or 1.0)
    return share, absorbed


def score(
    residual: Array,
    own: Array,
    directions: Array,
    groups: Sequence[slice],
    searched: Sequence[float],
    edges: Array,
    rows: Array,
    seed: int = 0,
    lines: Sequence[slice] = (),
    measured: Sequence[Array] = (),
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
    lines : slices of the columns that are sharp spectral lines
        An autoregressive model would take them for noise.
    measured : pieces of the noise itself, from repeated periods, where there are any
    """
    a, e, P, D, variance = whitened(residual, own, directions, edges, rows, lines, measured)
    if measured:
        pieces = np.concatenate([oaconvolve(m, a, mode="valid") for m in measured])
        variance = float(np.mean(pieces**2))
    variance = variance or float(np.finfo(float).tiny)  # a base that follows the data exactly leaves nothing to explain
    energy = np.einsum("ij,ij->j", D, D)
    e, D, _ = reduced(P, e, D)
    share, absorbed = shares(residual[rows], own[rows], directions[rows], groups)
    count = len(groups)
    gain, log_p = np.zeros(count), np.zeros(count)
    bases, owners, freedoms = [], [], np.zeros(count, dtype=int)
    for i, columns in enumerate(groups):
        group = orthonormal(D[:, columns], energy[columns])
        gain[i] = float(np.sum((group.T @ e) ** 2)) / variance
        freedoms[i] = group.shape[1]
        log_p[i] = chi2.logsf(gain[i], freedoms[i]) + np.log(searched[i]) if freedoms[i] else 0.0
        bases.append(group)
        owners.append(np.full(freedoms[i], i))
    log_p = np.minimum(log_p, 0.0)
    basis, owner = np.column_stack(bases), np.concatenate(owners)
    lowest = _null(basis, owner, freedoms, searched, seed)
    best = float(log_p.min())
    p_value = (1 + int(np.sum(lowest <= best))) / (DRAWS + 1)
    critical = float(np.quantile(lowest, LEVEL))
    needed = [_needed(variance, critical - np.log(n), int(f)) for n, f in zip(searched, freedoms, strict=True)]
    known = told(groups, D, basis, owner) * (freedoms > 0)[:, None]  # what a refit absorbs is never seen
    passes = np.divide(np.square(needed), known, out=np.full_like(known, np.inf), where=known > 0)
    return Scores(share, gain, log_p, absorbed, p_value, critical, passes)


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


def told(groups: Sequence[slice], D: Array, basis: Array, owner: Array) -> Array:
    """Return how much energy of each group's columns (row) each group's basis has (column), (groups, groups)."""
    energy = np.zeros((len(groups), D.shape[1]))
    np.add.at(energy, owner, (basis.T @ D) ** 2)
    return np.array([energy[:, columns].sum(axis=1) for columns in groups])


def _needed(variance: float, log_p: float, freedom: int) -> float:
    """Return the whitened size of a contribution whose gain passes the critical value in 80 % of the cases."""
    return float((np.sqrt(chi2.isf(np.exp(max(log_p, -700.0)), freedom)) + POWER) * np.sqrt(variance))
