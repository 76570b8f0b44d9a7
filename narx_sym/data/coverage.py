"""What an identification has seen of a signal (range, rate, frequency), and by how much another run goes beyond it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..models.info import Info

Array = np.ndarray
POWER, PIECE = 0.99, 2**17  # share of the power that counts; samples of one periodogram
ROUNDING = 1e-12  # of a signal: changes up to here are those of arithmetic
RESOLUTION = 3.0  # periods per length of a record, within which its window cannot tell frequencies
PURE = 0.99  # of a signal's power at one frequency; measured sines have 0.998 and more, triangles 0.986
LEAKS = 2  # lines beside it that a Hann window fills
STEADY = 1.25  # largest ratio between its sizes in the quarters of a record: with more, amplitudes differ
SLIGHT = {"range": 0.01, "rate": 0.1, "frequency": 0.1}  # shares by which a run may go beyond without a word
WORDS = {"u": "inputs", "y": "outputs"}


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


def excess(x: Array, low: float, high: float) -> float:
    """Return by how many ranges a signal leaves [low, high]."""
    return max(low - float(x.min()), float(x.max()) - high) / max(high - low, 1e-300)


def beyond(info: Info, name: str, what: str, parts: Sequence[Array], Ts: float | None) -> list[str]:
    """Say in which quantities a signal goes beyond what was seen in identification, and by how much.

    Parameters
    ----------
    info : of a model; what it does not know is not judged
    name : "u" or "y", the signal of the identification that it is compared with
    what : its name in the sentences, such as "input"
    parts : (N,) arrays, contiguous each [unit of the signal]
    Ts : float [s], or None where rates and frequencies are not known
    """
    found = [outside] if (outside := leaves(info, name, what, parts)) else []
    if not Ts:
        return found
    most = info.rates.get(name)
    if most is not None and (now := rate(parts, Ts)) > (1 + SLIGHT["rate"]) * most:
        found.append(
            f"the {what} changes by up to {now:.4g} {_unit(info, name)}/s, in identification by up to "
            f"{most:.4g}{_so(now, most)}"
        )
    most = info.frequencies.get(name)
    if most is not None:
        longest = max(x.size for x in parts)
        now = frequency(parts, Ts)
        if now - RESOLUTION / (longest * Ts) > (1 + SLIGHT["frequency"]) * most:
            found.append(
                f"the {what} is faster: 99 % of its power lies below {now:.4g} Hz, in identification below "
                f"{most:.4g} Hz{_so(now, most)}"
            )
    return found


def leaves(info: Info, name: str, what: str, parts: Sequence[Array]) -> str:
    """Say by how much a signal leaves the identified range, or nothing."""
    if name not in info.ranges:
        return ""
    low, high = info.ranges[name]
    most = max(excess(x, low, high) for x in parts)
    if most <= SLIGHT["range"]:
        return ""
    return (
        f"the {what} leaves the identified {WORDS[name]} [{low:.4g}, {high:.4g}] by {most * (high - low):.3g} "
        f"{_unit(info, name)}, {100 * most:.3g} % of their range"
    )


def _unit(info: Info, name: str) -> str:
    return info.units.get(name) or f"[unit of {name}]"


def _so(now: float, most: float) -> str:
    return f" ({now / most:.3g} times)" if most > 0 else ""
