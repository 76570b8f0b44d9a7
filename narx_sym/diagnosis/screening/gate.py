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
from scipy.linalg import lstsq
from scipy.special import chdtrc, chdtri

from ...symbolic.identities import added
from ..settings import CLEAR, COLUMNS, DRAWS, LEVEL, LONGEST, OFFERED, POWER, TINY
from .products import Left, told, whitened

Array = np.ndarray


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


def explain(left: Left, first: Sequence[int]) -> list[int]:
    """Return which few columns clearly explain a residual, beside the first ones.

    Greedy, like forward selection: taking out all columns would take out the slow part of the noise too.
    """
    for column in first:
        if left.columns[column, column] > TINY * left.energy[column]:
            left = left.without(column)
    picked: list[int] = []
    for _ in range(COLUMNS):
        gain = left.gains
        best = int(np.argmax(gain))
        noise = (left.power - gain[best]) / max(1, left.count - left.rank - 1)
        if gain[best] <= 0 or gain[best] < CLEAR * noise:
            break
        picked.append(best)
        left = left.without(best)
    return picked


def autoregression(noise: Sequence[Array]) -> tuple[Array, float]:
    """Return [1, a_1, ..., a_p] that whitens a noise, and its AIC: Burg's method over all pieces.

    A slow wander under white noise needs many lags; white noise takes none.
    """
    count = sum(n.size for n in noise)
    longest = max(1, min(LONGEST, count // 20, min(n.size for n in noise) // 3))
    forward = [np.asarray(n, dtype=float)[1:] for n in noise]
    backward = [np.asarray(n, dtype=float)[:-1] for n in noise]
    power = added(float(n @ n) for n in noise) / count
    a = np.ones(1)
    best, chosen = np.log(power) if power > 0 else -np.inf, a
    for order in range(1, longest + 1):
        above = added(float(f @ b) for f, b in zip(forward, backward, strict=True))
        below = added(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
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


def noise_model(
    plain: Left,
    residual: Array,
    own: Array,
    directions: Array,
    edges: Array,
    rows: Array,
    lines: Sequence[slice] = (),
    measured: Sequence[Array] = (),
) -> tuple[Array, Left, float]:
    """Estimate the noise and filter by it, in turns: the filter, what is left after it, and the variance of the noise.

    For the arguments see `score`.
    """
    first = [j for s in lines for j in range(s.start, s.stop)]
    if measured:
        a = autoregression(measured)[0]
    else:
        first, a = _dominant(plain, residual, own, directions, edges, rows, first)
    for turns in (0,) if measured else (2, 1, 0):  # the noise model and what it is estimated from improve each other
        left = Left.of(own, residual, directions, edges, rows, a)
        picked = directions[:, sorted({*first, *explain(left, first)})]
        columns = np.column_stack([residual, own, picked])
        white = np.concatenate(list(whitened(columns, a, edges, rows)))
        solution = lstsq(white[:, 1:], white[:, 0])[0]
        remaining = white[:, 0] - white[:, 1:] @ solution
        if turns:
            a = autoregression(_pieces(residual - columns[:, 1:] @ solution, edges))[0]
    return a, left, float(remaining @ remaining) / max(1, left.count - columns.shape[1] + 1)


def _pieces(noise: Array, edges: Array) -> list[Array]:
    return [noise[b:e] for b, e in itertools.pairwise(edges)]


def _dominant(
    plain: Left, residual: Array, own: Array, directions: Array, edges: Array, rows: Array, first: list[int]
) -> tuple[list[int], Array]:
    """Take out the one column without which the noise looks much slower than it is (AIC), if there is one.

    An autoregressive model takes a strong drift for noise, and then nothing is left to be seen.
    """
    order = np.argsort(-plain.gains, kind="stable")[:OFFERED]
    trials = [first, *([*first, int(j)] for j in order if j not in first)]
    found = []
    for trial in trials:
        used = np.column_stack([own, directions[:, trial]])
        noise = residual - used @ lstsq(used[rows], residual[rows])[0]
        a, criterion = autoregression(_pieces(noise, edges))
        found.append((criterion, trial, a))
    best = min(found, key=lambda f: f[0])
    return (best if best[0] < found[0][0] - CLEAR else found[0])[1:]


def score(
    plain: Left,
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
    plain : what a refit leaves of them without a filter
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
    a, left, variance = noise_model(plain, residual, own, directions, edges, rows, lines, measured)
    if measured:
        pieces = np.concatenate([np.convolve(m, a, mode="valid") for m in measured])
        variance = float(np.mean(pieces**2))
    variance = variance or float(np.finfo(float).tiny)  # a base that follows the data exactly leaves nothing to explain
    share, absorbed = plain.shares(groups)
    basis, owner = left.basis(groups)
    freedoms = np.bincount(owner, minlength=len(groups))
    gain = np.bincount(owner, (basis.T @ left.residual) ** 2, len(groups)) / variance
    log_p = np.where(freedoms > 0, log_chance(freedoms, gain) + np.log(searched), 0.0)
    log_p = np.minimum(log_p, 0.0)
    lowest = _null(basis.T @ left.columns @ basis, owner, freedoms, searched, seed)
    best = float(log_p.min())
    p_value = (1 + int(np.sum(lowest <= best))) / (DRAWS + 1)
    critical = float(np.quantile(lowest, LEVEL))
    needed = [_needed(variance, critical - np.log(n), int(f)) for n, f in zip(searched, freedoms, strict=True)]
    known = told(groups, left.columns, basis, owner) * (freedoms > 0)[:, None]  # what a refit absorbs is never seen
    passes = np.divide(np.square(needed), known, out=np.full_like(known, np.inf), where=known > 0)
    return Scores(share, gain, log_p, absorbed, p_value, critical, passes)


def log_chance(freedom: Array | int, gain: Array) -> Array:
    """Return the logarithm of the chance that noise gains as much: of a chi-square with so many degrees of freedom."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(chdtrc(freedom, gain)))


def _null(products: Array, owner: Array, freedoms: Array, searched: Sequence[float], seed: int) -> Array:
    """Return the smallest log p-value of each of many records without any effect, (DRAWS,)."""
    values, vectors = np.linalg.eigh(products)
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
            lowest = np.minimum(lowest, log_chance(f, energy[:, of].max(axis=1)))
    return lowest


def _needed(variance: float, log_p: float, freedom: int) -> float:
    """Return the whitened size of a contribution whose gain passes the critical value in 80 % of the cases."""
    return float((np.sqrt(chdtri(freedom, np.exp(max(log_p, -700.0)))) + POWER) * np.sqrt(variance))
