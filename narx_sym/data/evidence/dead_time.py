"""The dead time of a record: how many samples pass before the input acts.

For each candidate d a small linear model is fitted to the output error (Steiglitz & McBride 1965: a least-squares fit
whose signals are filtered by the last denominator), and BIC compares lags and orders at once. The candidates come from
the cross-correlation of signals prewhitened by an autoregressive model of the input (Box & Jenkins 1976), so that a
slow input does not smear the peak. A lag of the output and a delay of the input are told apart by the fit, not by the
peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz

from ...engines.algebra import filtered
from ..record import Record

Array = np.ndarray
SHARE = 0.1  # of the longest segment: no dead time beyond it is looked for
Pairs = Sequence[tuple[Array, Array]]
ROUGH = ((1, 1), (2, 2))  # lags of the output, of the input, of the first look at every candidate
ORDERS = ((0, 1), (1, 1), (1, 2), (2, 1), (2, 2))  # and of the last look at the best ones
TURNS, POLISHED = 4, 8  # of the iteration on the denominator; then of Gauss and Newton, at the last look
SETTLED = 1e-6  # relative gain below which a fit is done
RIDGE = 1e-12  # of columns of length 1: what data do not determine stays small
LAST = 6  # candidates that get the last look
WHITENING, EARLIEST = 20, 12  # lags of the input's model; candidates before the first clear peak
LATE, FEW = 8, 6  # candidates after it; peaks that are looked at
CLEAR = 4.0  # a peak of the cross-correlation in standard deviations
LONG, TIMES = 4000, 4  # samples of a segment that are fitted, or so many times the longest candidate
PLAIN = 4  # dead times below it are among those that every search tries
WHITE = 0.3  # correlation of neighbouring errors below which they are noise
ALIKE = 6.0  # difference of BIC within which two dead times explain the data alike
DOUBTFUL, NEEDED = 0.9, 0.25  # shares of the squared error that a longer dead time must come below, first and last look


class Look(NamedTuple):
    """The best free run at one dead time: BIC, mean squared error, and the correlation of neighbouring errors."""

    bic: float
    error: float
    slow: float


@dataclass(frozen=True)
class DeadTime:
    """How many samples pass before the input acts.

    Attributes
    ----------
    samples : int
        The lag of the newest input sample that acts: 0 acts at once, 1 is a sampled system without dead time.
    among : tuple of int
        All that these data cannot tell from it.
    long : bool
        Whether it is one that a search over the shortest lags would miss. It is believed where it leaves only noise, or
        where every model with a shorter one leaves four times the squared error: hysteresis looks like a delay too.
    """

    samples: int
    among: tuple[int, ...]
    long: bool

    def sentence(self, Ts: float) -> str:
        """Say it in words; `Ts` in s."""
        shown = f"dead time {self.samples} samples ({self.samples * Ts:.4g} s)"
        others = [d for d in self.among if d != self.samples]
        return f"{shown}; {min(others)} to {max(others)} fit equally well" if others else shown


def dead_time(records: Sequence[Record]) -> DeadTime:
    """Estimate the dead time of some records, each segment on its own start."""
    parts = [s for r in records for s in r.segments() if len(s) >= 2 * EARLIEST]
    if not parts:
        return DeadTime(0, (0,), False)
    most = max(PLAIN - 1, int(SHARE * max(map(len, parts))))
    most = min(most, min(map(len, parts)) // 2)
    pairs = [(p.u - p.u.mean(), p.y - p.y.mean()) for p in parts]
    candidates = _candidates(pairs, most)
    most = max(candidates)
    pairs = [_busiest(u, y, max(LONG, TIMES * most)) for u, y in pairs]
    rough = {d: min(output_error(pairs, o, d, most) for o in ROUGH) for d in candidates}
    order = sorted(rough, key=lambda d: (rough[d], d))
    # Far from being needed at the first look: then only the short ones are looked at again.
    far = min(one.error for one in rough.values()) > DOUBTFUL * min(rough[d].error for d in rough if d < PLAIN)
    seen = {d for d in order if d < PLAIN} | (set() if far else set(order[:LAST]))
    scored: dict[int, Look] = {}
    while seen - set(scored):
        for d in seen - set(scored):
            scored[d] = min(output_error(pairs, o, d, most, POLISHED) for o in ORDERS)
        best = min(scored, key=lambda d: (scored[d].bic, d))
        seen |= set() if far else {d for d in range(best - 2, best + 3) if 0 <= d <= most}
    plain = [d for d in scored if d < PLAIN]
    # Where only noise is left, the criterion is to be believed; else a model error may look like a delay.
    least, shorter = scored[best], min(scored[d].error for d in plain)
    clear = least.error < (1.0 if abs(least.slow) < WHITE else NEEDED) * shorter
    if best >= PLAIN and not clear:
        best = min(plain, key=lambda d: (scored[d].bic, d))
    among = tuple(sorted(d for d in scored if scored[d].bic < scored[best].bic + ALIKE and (clear or d < PLAIN)))
    return DeadTime(best, among, best >= PLAIN)


def _candidates(pairs: Pairs, most: int) -> list[int]:
    """Return the dead times that are worth a fit: short ones, and those around the peaks of the correlation."""
    rho, count = np.zeros(most + 1), 0
    for u, y in pairs:
        v, w = _prewhitened(u, y)
        size = float(np.linalg.norm(v) * np.linalg.norm(w)) or 1.0
        rho += _correlated(w, v, most) / size * v.size
        count += v.size
    strength = np.abs(rho) / np.sqrt(count)
    clear = np.flatnonzero(strength > max(CLEAR, 0.2 * strength.max()))
    found = set(range(PLAIN))
    first = int(clear[0]) if clear.size else 0
    for middle in {first, *map(int, np.argsort(-strength)[:FEW])}:
        found |= set(range(middle - 2, middle + 3))
    found |= set(range(first - EARLIEST, first + LATE + 1))
    return sorted(d for d in found if 0 <= d <= most)


def _busiest(u: Array, y: Array, length: int) -> tuple[Array, Array]:
    """Return the stretch of a segment along which the input moves most."""
    if u.size <= length:
        return u, y
    moved = np.concatenate([[0.0], np.cumsum(np.diff(u, prepend=u[0]) ** 2)])
    first = int(np.argmax(moved[length:] - moved[:-length]))
    return u[first : first + length], y[first : first + length]


def _prewhitened(u: Array, y: Array) -> tuple[Array, Array]:
    """Filter both signals by an autoregressive model of the input."""
    lags = min(WHITENING, u.size // 10)
    r = _correlated(u, u, lags)
    r[0] *= 1 + 1e-4
    a = np.concatenate([[1.0], -solve_toeplitz(r[:lags], r[1:])]) if r[0] > 0 else np.ones(1)
    return np.convolve(a, u)[lags : u.size], np.convolve(a, y)[lags : y.size]


def _correlated(y: Array, u: Array, most: int) -> Array:
    """Return sum_k y[k + d] u[k] for d = 0 ... most."""
    n = 2 * u.size
    return np.fft.irfft(np.fft.rfft(y, n) * np.fft.rfft(u, n).conj(), n)[: most + 1]


def output_error(pairs: Pairs, order: tuple[int, int], d: int, most: int, polished: int = 0) -> Look:
    """Return the free run of the best model found with these orders."""
    (a, b), denominator, count = order, np.array([1.0]), sum(u.size - most for u, _ in pairs)
    for _ in range(TURNS if a else 1):
        blocks, targets = [], []
        for u, y in pairs:
            v, w = filtered(denominator, u), filtered(denominator, y)
            rows = slice(most + b, u.size)
            columns = [-_late(w, i)[rows] for i in range(1, a + 1)] + [_late(v, d + j)[rows] for j in range(b)]
            blocks.append(np.column_stack([*columns, np.ones(u.size - most - b)]))
            targets.append(w[rows])
        theta = _solved(np.vstack(blocks), np.concatenate(targets))
        denominator = _stable(np.concatenate([[1.0], theta[:a]]))
    lowest, slow, step = _free_run(pairs, denominator, b, d, most)
    for _ in range(polished if a else 0):
        for part in (1.0, 0.3, 0.1):
            tried = _stable(denominator + np.concatenate([[0.0], part * step]))
            error, rho, further = _free_run(pairs, tried, b, d, most)
            if error < lowest:
                break
        else:
            break
        gained, denominator, lowest, slow, step = 1 - error / lowest, tried, error, rho, further
        if gained < SETTLED:
            break
    return Look(float(count * np.log(max(lowest, 1e-300)) + (a + b) * np.log(count)), lowest, slow)


def _free_run(pairs: Pairs, denominator: Array, b: int, d: int, most: int) -> tuple[float, float, Array]:
    """Return mean square and neighbours' correlation of the errors for a denominator, and a step of Gauss and Newton.

    Numerator, offset and the start of each segment are fitted.
    """
    parts, own = [], denominator.size
    for u, y in pairs:
        v, pulse = filtered(denominator, u), np.zeros(u.size)
        pulse[0] = 1.0
        free = filtered(denominator, pulse)
        X = np.column_stack([_late(v, d + j) for j in range(b)])
        parts.append((X, np.column_stack([np.ones(u.size), *(_late(free, j) for j in range(own - 1))]), y))
    theta, starts = _beside([(X[most:], S[most:], y[most:]) for X, S, y in parts])
    turned, errors = [], []
    for (X, S, y), start in zip(parts, starts, strict=True):
        run = X @ theta + S @ start
        slope = filtered(denominator, run)
        errors.append((y - run)[most:])
        moved = np.column_stack([X, *(-_late(slope, j) for j in range(1, own))])
        turned.append((moved[most:], S[most:], errors[-1]))
    step, e = _beside(turned)[0][b:] if own > 1 else np.zeros(0), np.concatenate(errors)
    square = float(e @ e)
    return square / e.size, float(e[1:] @ e[:-1]) / (square or 1.0), step


def _late(x: Array, lag: int) -> Array:
    return np.concatenate([np.zeros(lag), x[: x.size - lag]]) if lag else x


def _solved(X: Array, target: Array) -> Array:
    """Least squares by normal equations of scaled columns: many small problems, whose noise is far above rounding."""
    return _beside([(X, np.zeros((len(X), 0)), target)])[0]


def _beside(parts: Sequence[tuple[Array, Array, Array]]) -> tuple[Array, list[Array]]:
    """Solve least squares of parts (X, S, target): what multiplies all X, and what multiplies each S, its own.

    Its own are eliminated part by part: of many short segments nearly all else would be zeros.
    """
    size = np.sqrt(sum(np.einsum("ij,ij->j", X, X) for X, _, _ in parts))
    size[size == 0] = 1.0
    gram, right, own = RIDGE * np.eye(size.size), np.zeros(size.size), []
    for X, S, target in parts:
        scaled, width = X / size, np.sqrt(np.einsum("ij,ij->j", S, S))
        width[width == 0] = 1.0
        S = S / width
        both = np.column_stack([S.T @ scaled, S.T @ target])
        taken = np.linalg.solve(S.T @ S + RIDGE * np.eye(width.size), both)
        gram += scaled.T @ scaled - both[:, :-1].T @ taken[:, :-1]
        right += scaled.T @ target - both[:, :-1].T @ taken[:, -1]
        own.append((taken, width))
    theta = np.linalg.solve(gram, right)
    return theta / size, [(taken[:, -1] - taken[:, :-1] @ theta) / width for taken, width in own]


def _stable(denominator: Array) -> Array:
    """Reflect poles outside the unit circle; one at the circle stays."""
    roots = np.roots(denominator)
    outside = np.abs(roots) > 1
    if not outside.any():
        return denominator
    roots[outside] = 1 / np.conj(roots[outside])
    return np.real(np.poly(roots))
