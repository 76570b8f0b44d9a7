"""How a signal moves: its range, its rate, its frequencies, and whether it is one sine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Array = np.ndarray
POWER, PIECE = 0.99, 2**17  # share of the power that counts; samples of one periodogram
ROUNDING = 1e-12  # of a signal: changes up to here are those of arithmetic
PURE = 0.99  # of a signal's power at one frequency; measured sines have 0.998 and more, triangles 0.986
LEAKS = 2  # lines beside it that a Hann window fills
STEADY = 1.25  # largest ratio between its sizes in the quarters of a record: with more, amplitudes differ


def rate(parts: Sequence[Array], Ts: float) -> float:
    """Return the largest change of a signal [unit/s].

    Parameters
    ----------
    parts : (N,) arrays, contiguous each
    Ts : float [s]
    """
    return max((float(np.abs(np.diff(x)).max()) for x in parts if x.size > 1), default=0.0) / Ts


def frequency(parts: Sequence[Array], Ts: float) -> float:
    """Return the frequency below which 99 % of a signal's power lies [Hz]: of its Hann periodograms, without means.

    A signal that is constant but for rounding has none.

    Parameters
    ----------
    parts : (N,) arrays, contiguous each
    Ts : float [s]
    """
    if all(np.ptp(x) <= ROUNDING * np.abs(x).max() for x in parts):
        return 0.0
    pieces = [x[i : i + PIECE] for x in parts for i in range(0, x.size, PIECE)]
    n = max(x.size for x in pieces)
    power = np.zeros(n // 2 + 1)
    for x in pieces:
        power += np.abs(np.fft.rfft((x - x.mean()) * np.hanning(x.size), n)) ** 2
    below = np.cumsum(power)
    return float(np.searchsorted(below, POWER * below[-1]) / (n * Ts)) if below[-1] > 0 else 0.0


def one_sine(x: Array, Ts: float) -> float:
    """Return the frequency [Hz] of a signal that is a single sine of steady size over two cycles or more, else 0."""
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)))) ** 2
    top = int(power.argmax())
    line = power[max(0, top - LEAKS) : top + LEAKS + 1].sum()
    if top < 2 or line < PURE * power.sum():
        return 0.0
    sizes = [part.std() for part in np.array_split(x, min(4, top // 2))]
    return top / (Ts * len(x)) if max(sizes) <= STEADY * min(sizes) else 0.0


def seen(signals: Mapping[str, Sequence[Array]], Ts: float) -> dict[str, Any]:
    """Return what a model keeps of its signals in `info`: ranges [unit], rates [unit/s] and frequencies [Hz] by name.

    Parameters
    ----------
    signals : mapping of names to lists of (N,) arrays, contiguous each
    Ts : float [s]
    """
    return {
        "ranges": {n: (float(min(map(np.min, p))), float(max(map(np.max, p)))) for n, p in signals.items()},
        "rates": {n: rate(parts, Ts) for n, parts in signals.items()},
        "frequencies": {n: frequency(parts, Ts) for n, parts in signals.items()},
    }
