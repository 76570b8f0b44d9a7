"""Where a law starts: the input before the first sample, at rest; and where limits of the input let the model rest."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sp
from scipy.optimize import brentq

from ...errors import NarxError
from ...inversion.compensator import Compensator
from ...models.model import Model
from ...symbolic.functions import within
from ...symbolic.signals import k, r, y
from ..simulate import rest_output, rest_states, simulate

HELD, STAYS = 50, 1e-9  # samples over which an input is held; of the outputs' range: what moves less rests
RESTS = 1e-3  # of the outputs' range: a start that moves no further is called at rest
FINEST = 32  # lines that the rest map is made of, at most
LONGEST = 100_000  # samples in which a model comes to rest, or does not


def law_start(law: Compensator, output: float, m0: float | None = None) -> dict[str, float]:
    """Return the start values of the recursion and the C source by name (a steady state)."""
    begin = rest_input(law, float(output)) if m0 is None else float(m0)
    rest = rest_states(law.model, begin, float(output))
    return {"m": begin, "r": float(output), law.model.output.name: float(output)} | rest


def rest_input(law: Compensator, output: float, limits: Sequence[float] | None = None) -> float:
    """Return the input for which an output is a steady state of the model, within the limits.

    Where it rests with every input (a continuum of equilibria), or with none, it is the recorded start, moved along the
    line through the data; inside the recorded inputs.

    Parameters
    ----------
    output : number [unit of y]
    limits : (lowest, highest) input, optional [unit of u]
    """
    model = law.model
    line = model.info.line
    if line is None:
        if output != 0:
            warnings.warn("No initial input m0 was given: the law starts from 0.", stacklevel=3)
        return _inside(0.0, limits)
    offset, slope = line
    inverse = model.input == y
    if model.info.start is not None:  # the line through it: with memory, the other one need not pass where it began
        offset = model.info.start[1] - slope * model.info.start[0]
    if inverse:
        return _inside(float(offset + slope * output), limits)
    seen = model.info.ranges.get(model.input.name)
    near = _inside(_inside(float((output - offset) / slope) if slope else 0.0, seen), limits)
    return near if seen is None or model.channels else _resting(model, output, near, _both(seen, limits))


def rest_expression(law: Compensator, limits: Sequence[float] | None = None) -> Any:
    """Return `rest_input` as an expression in r[k]: straight lines between outputs; None for a model without records.

    The outputs lie in the known range, so close that the middle of two is met to a thousandth of the input's range.
    """
    seen = law.model.info.ranges
    driven, output = ("u", "y") if law.model.input == y else (law.model.input.name, law.model.output.name)
    if law.model.info.line is None or not {driven, output} <= seen.keys():
        return None
    near = RESTS * (seen[driven][1] - seen[driven][0])

    def between(low: tuple[float, float], high: tuple[float, float], parts: int) -> list[tuple[float, float]]:
        at = (low[0] + high[0]) / 2
        middle = (at, rest_input(law, at, limits))
        if parts < 2 or (parts < FINEST and abs(middle[1] - (low[1] + high[1]) / 2) <= near):
            return [low]
        return [*between(low, middle, parts // 2), *between(middle, high, parts // 2)]

    first, last = ((at, rest_input(law, at, limits)) for at in seen[output])
    every = [*between(first, last, FINEST), last]
    points = [first]
    for (at, here), (b, end) in pairwise(every[1:]):  # what lies on a line is no kink
        a, begun = points[-1]
        if abs(begun + (end - begun) * (at - a) / (b - a) - here) > near / FINEST:
            points.append((at, here))
    points.append(last)
    lines = (
        (end - start) / (b - a) * (within(r[k], sp.Float(a), sp.Float(b)) - sp.Float(a))
        for (a, start), (b, end) in pairwise(points)
        if b > a and abs(end - start) > 0
    )
    return sp.Add(sp.Float(first[1]), *lines)


def rests_with(model: Model, held: float, output: float, beside: Mapping[str, float] | None = None) -> bool:
    """Whether a model stays at an output while its input, and the channels `beside` it, are held."""
    low, high = model.info.ranges.get(model.output.name, (output, output))
    return bool(np.abs(_moved(model, held, output, beside)).max() <= RESTS * max(high - low, abs(output), 1e-300))


def _moved(model: Model, held: float, output: float, beside: Mapping[str, float] | None = None) -> np.ndarray:
    """Return how far a model moves from an output while its input is held, (HELD,); NaN where it runs away."""
    channels = {name: np.full(HELD, value) for name, value in (beside or {}).items()}
    try:
        return simulate(model, np.full(HELD, held), output, channels, u0=held, warn=False) - output
    except NarxError:
        return np.full(HELD, np.nan)


def _resting(model: Model, output: float, near: float, ends: tuple[float, float]) -> float:
    """Return the input between two ends at which a model rests, on the side of `near` where it is."""
    low, high = model.info.ranges.get(model.output.name, (output, output))
    size = STAYS * max(high - low, abs(output), 1e-300)

    def drift(held: float) -> float:
        return float(_moved(model, held, output)[-1])

    here = drift(near)
    if not abs(here) > size:
        return near
    for end in sorted(ends, key=lambda e: abs(e - near)):
        if here * drift(end) < 0:
            return float(brentq(drift, *sorted((near, end)), xtol=1e-12, disp=False))
    return near


def _inside(value: float, limits: Sequence[float] | None) -> float:
    return value if limits is None else min(max(value, float(limits[0])), float(limits[1]))


def _both(seen: Sequence[float], limits: Sequence[float] | None) -> tuple[float, float]:
    """Return what two ranges have in common; the nearer limit where that is nothing."""
    return _inside(seen[0], limits), _inside(seen[1], limits)


def rests_at(model: Model, limits: Sequence[float]) -> tuple[float, float] | None:
    """Return the outputs at which a model rests when its input goes from the middle to either limit and stays there.

    Parameters
    ----------
    limits : (lowest, highest) input [unit of u]

    Returns
    -------
    (output at the lowest, output at the highest input) [unit of y]; None where it does not come to rest, and for a
    model that was not fitted to records, or needs a channel.
    """
    seen = model.info.ranges.get(model.output.name)
    if seen is None or model.channels:
        return None
    middle, size = float(np.mean(limits)), STAYS * (seen[1] - seen[0])
    found: list[float] = []
    n = HELD
    while len(found) < 2 and n <= LONGEST:
        try:
            run = simulate(model, np.full(n, limits[len(found)]), rest_output(model, middle), u0=middle, warn=False)
        except NarxError:
            return None
        if np.ptp(run[n // 2 :]) <= size:
            found.append(float(run[-1]))
        else:
            n *= 2
    return (found[0], found[1]) if len(found) == 2 else None
