"""By how much a run goes beyond what an identification has seen of a signal: its range, rate and frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..data.coverage import frequency, rate
from ..models.info import Info

Array = np.ndarray
RESOLUTION = 3.0  # periods per length of a record, within which its window cannot tell frequencies
SLIGHT = {"range": 0.01, "rate": 0.1, "frequency": 0.1}  # shares by which a run may go beyond without a word
WORDS = {"u": "inputs", "y": "outputs"}


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
