"""How an input moves: where it turns back, which way it goes and how fast, without the noise on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..settings import ROUNDING

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Motion:
    """The swings of an input, from one reversal to the next.

    Attributes
    ----------
    smooth, slope : (N,) arrays [unit of u, and per sample]
        The input without noise, and its slope.
    still : (N,) array of bool
        Where it rests.
    turns : (reversals,) array of int
        Where it turns back.
    after : (N,) array of int
        The last reversal before each sample, -1 before the first.
    swing : (N,) array of int
        The swing of each sample; `length` [samples] and `height` [unit of u] are those of the swings.
    """

    smooth: Array
    slope: Array
    still: Array
    turns: Array
    after: Array
    swing: Array
    length: Array
    height: Array

    @classmethod
    def of(cls, u: Array) -> Motion:
        """Find it in an input, (N,) array that varies."""
        noise, spread, m = _noise(u), float(np.ptp(u)), 0
        smooth = u
        for _ in range(2):  # the second time without noise
            level = noise * 1.5 / np.sqrt(2 * m + 1)
            turns = reversals(smooth, float(np.clip(6 * level, 0.01 * spread, 0.04 * spread)))
            ends = np.unique([0, *turns, u.size - 1])
            swing = np.clip(np.searchsorted(ends, np.arange(u.size), side="right") - 1, 0, ends.size - 2)
            length, height = np.diff(ends), np.diff(smooth[ends])
            pace = np.abs(height / length)[swing]  # mean speed of the own swing, per sample
            if m == 0:
                # The slope of a line through 2 m + 1 samples: its noise is a twentieth of the usual pace at most.
                wanted = np.cbrt(1.5 * (noise / max(0.05 * float(np.median(pace)), 1e-300)) ** 2)
                longest = max(1, min(500, int(np.median(length[swing])) // 4, (u.size - 1) // 2))
                m = int(np.clip(np.ceil(wanted), 1, longest))
                smooth = _parabola(u, m, 0)
        slope = _parabola(u, m, 1)
        slope = np.where(np.abs(slope) > ROUNDING * np.abs(u).max(), slope, 0.0)  # while the input is held
        least = np.maximum(0.05 * pace, 2 * noise * np.sqrt(3 / (m * (m + 1) * (2 * m + 1))))
        still = _resting(slope, least, 2 * m + 1)
        after = np.searchsorted(turns, np.arange(u.size), side="right") - 1
        return cls(smooth, slope, still, turns, after, swing, length, height)

    @property
    def last(self) -> Array:
        """Where the last reversal was, (N,) array of int; 0 before the first."""
        none = np.zeros(self.after.size, dtype=int)
        return self.turns[np.maximum(self.after, 0)] if self.turns.size else none

    @property
    def sign(self) -> Array:
        """Which way the swing of each sample goes, (N,) array of -1, 0 or 1."""
        return np.asarray(np.sign(self.height)[self.swing])

    @property
    def whole(self) -> Array:
        """Whether the swing of a sample has both its ends in the record, (N,) array of bool."""
        return np.asarray((self.after >= 0) & (self.after < self.turns.size - 1))


def reversals(u: Array, threshold: float) -> Array:
    """Return the indices where u turns back by more than a threshold: local extremes, noise left out."""
    steps = np.flatnonzero(np.diff(u))
    turns = np.flatnonzero(np.diff(np.sign(np.diff(u)[steps]))) + 1
    found: list[int] = []
    low = high = 0
    way = 0
    for at in [*steps[turns].tolist(), u.size - 1]:
        low, high = (at if u[at] < u[low] else low), (at if u[at] > u[high] else high)
        if way >= 0 and u[at] < u[high] - threshold:
            found += [high] if way else []
            way, low = -1, at
        elif way <= 0 and u[at] > u[low] + threshold:
            found += [low] if way else []
            way, high = 1, at
    return np.array(found, dtype=int)


def _noise(u: Array) -> float:
    """Guess the noise on the input, (N,) array: from third differences and from the steps of a converter."""
    spread = float(np.ptp(u))
    step = spread / max(1, np.unique(u).size - 1)
    third = np.median(np.abs(np.diff(u, 3))) / 0.6745 / np.sqrt(20) if u.size > 3 else 0.0
    # Above this it is excitation, not noise.
    return min(float(max(third, step / np.sqrt(12) if step <= 0.01 * spread else 0.0)), 0.005 * spread)


def _resting(slope: Array, least: Array, window: int) -> Array:
    """Find where u rests, (N,) array of bool. Where it only turns, the slope passes evenly through zero."""
    near = np.abs(slope) <= 4 * least
    marks = np.diff(np.concatenate([[0], near.astype(int), [0]]))
    first, last = np.flatnonzero(marks > 0), np.flatnonzero(marks < 0)
    inner = np.concatenate([[0], np.cumsum(np.abs(slope) <= least)])
    out = np.zeros(slope.size, dtype=bool)
    for a, b in zip(first, last, strict=True):
        out[a:b] = b - a > window and inner[b] - inner[a] >= 0.5 * (b - a)
    return out


def _parabola(u: Array, m: int, derivative: int) -> Array:
    """Return value or slope of parabolas through 2 m + 1 samples each (Savitzky, Golay 1964), (N,).

    Less than `m` samples from an end those of the last parabola; through two samples there is a line.
    """
    if u.size < 2 * m + 1:
        return u if derivative == 0 else np.full(u.size, u[-1] - u[0])
    at = np.arange(-m, m + 1.0)
    weights = np.linalg.pinv(np.vander(at, 3, increasing=True))
    inner = np.convolve(u, weights[derivative][::-1], "valid")
    ends = []
    for part, own in ((u[: 2 * m + 1], at[:m]), (u[-2 * m - 1 :], at[m + 1 :])):
        a, b, c = weights @ part
        ends.append(a + b * own + c * own**2 if derivative == 0 else b + 2 * c * own)
    return np.concatenate([ends[0], inner, ends[1]])
