"""What some inputs hide: of two levels, whose noise bends the curve as a saturation does; of one way; of one speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..record import Record
from .rate import working

Array = np.ndarray
# Of the range of a signal: what it goes back by less is held for noise, and closes no loop. The inputs of 60 measured
# records go back by nothing or by more than 0.14.
TURN = 0.05
ONE_SPEED = 0.9  # of the mean squared step, what its mean size makes up: of a sine 0.81, of a triangle all of it
ROUNDING = 1e-9  # of the way between the levels: less than that is no noise
NEAR = 0.1  # of the way between the levels: a wider spread about them is excitation


def two_levels(u: Array) -> Array | None:
    """Return an input of two levels without its noise, (N,); None where it is none, or has no noise.

    Noise is near its level, and new at each sample: a brief pulse, and what swings about a level, is excitation.
    """
    high = u > (u.max() + u.min()) / 2
    if high.all() or not high.any():
        return None
    levels = np.where(high, u[high].mean(), u[~high].mean())
    beside, way = u - levels, float(np.ptp(levels))
    noise, new = float(np.std(beside)), float(np.sqrt(np.mean(np.diff(beside) ** 2)))
    near = ROUNDING * way < noise <= NEAR * way and float(np.max(np.abs(beside))) <= way / 2
    return levels if near and new > noise else None  # white noise has sqrt(2) of it as its step


def turns(x: Array) -> bool:
    """Whether a signal goes back on its way: up and down, by more than a part of its range."""
    back = min(np.max(np.maximum.accumulate(x) - x), np.max(x - np.minimum.accumulate(x)))
    return bool(back > TURN * np.ptp(x))


def turning(records: Sequence[Record]) -> set[str]:
    """Return which of u, y and the channels turn back within a segment."""
    parts = [part.signals for r in records for part in r.segments()]
    return {name for part in parts for name, x in part.items() if turns(x)}


def one_way(record: Record) -> list[str]:
    """Say where the input of a record never turns back, and whether it only moves at one speed."""
    if np.ptp(record.u) == 0 or "u" in turning([record]):
        return []
    said = "the input never reverses: hysteresis and slack cannot be distinguished from a static curve"
    moves = [steps for part in record.segments() if (steps := np.trim_zeros(np.diff(part.u))).size]
    ramps = moves and all(steps.size > 2 and _one_size(steps) for steps in moves)  # one or two steps are no ramp
    return [f"{said}, and at one speed a static curve, a lag and a drift cannot be distinguished" if ramps else said]


def one_step(records: Sequence[Record]) -> bool:
    """Whether all that the input ever does is one step: every output is what some linear machine answers to it."""
    parts = [part.u for r in records for part in r.segments()]
    moved = [np.flatnonzero(np.diff(u[:-1])) for u in parts]  # what the last one does has no answer
    sizes = {(float(u[at[0]]), float(u[at[0] + 1])) for u, at in zip(parts, moved, strict=True) if at.size}
    return len(sizes) == 1 and all(at.size <= 1 for at in moved)


def one_speed(records: Sequence[Record]) -> bool:
    """Whether the input goes there and back at one speed, at the working rate of the records."""
    if "u" not in turning(records):
        return False
    return _one_size(np.concatenate([np.diff(part.u) for part in working(records)[0]]))


def _one_size(steps: Array) -> bool:
    return bool(np.mean(np.abs(steps)) ** 2 > ONE_SPEED * np.mean(steps**2))


def at_levels(records: Sequence[Record], error: Callable[[Sequence[Record]], float]) -> tuple[list[Record], list[str]]:
    """Take noisy inputs at their two levels, where the output follows these better; return also what is to be said.

    Parameters
    ----------
    error : of a model along records: where the noise moves the output too, it is smaller with it
    """
    known = list(records)
    quiet = [r if (levels := two_levels(r.u)) is None else replace(r, u=levels) for r in known]
    moved = [(r, q) for r, q in zip(known, quiet, strict=True) if q is not r]
    if not moved or not error(quiet) < error(known):
        return known, []
    return quiet, [
        f"{r.name}: the input moves by {np.std(r.u - q.u):.2g} rms around two levels, but the output does not follow "
        "it (noise on the input, or a saturation there): the two levels are used as the input"
        for r, q in moved
    ]
