"""What the sensor itself does to a record: values that are cut off, that freeze, that stand alone, and values in steps.

All are seen in the record alone, before any model: clipped extremes, one rest too long, samples far from both
neighbours, and the levels that occur.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from .record import Record

Array = np.ndarray
CLIPPED, RUN = 0.005, 4  # share of the samples at an extreme, and how many stay there in a row on average
PILES = 4.0  # times the next level of a coarse converter: what is cut off piles up; rounding alone seldom does
FAR = 3  # samples before a rest at least: within one or two it depends on where between samples it begins
MOVES = 0.02  # of the range of the input, while the output stays
LEVELS = 0.25  # distinct values per sample below which steps are looked for
WHOLE = 1e-3  # of a step: differences between levels are whole multiples of it
CROSSES = 0.5  # of the range of the input, while the output stays at one value: friction holds over a part of it
CHANCE = 1e-3  # that the longest rest is one of the many rests of this signal
ALONE, FARTHER = 0.02, 3.0  # share of the samples that stand alone at most, and how much farther than all others
AROUND = 5  # samples of a median that two bad ones in a row do not bend
LISTED = 30  # rows at most
LATE = 3  # samples in which an output follows a peak of its input
FELT = 0.25  # share of the noise power that steps, or what stands alone, must make up to be worth saying


@dataclass(frozen=True)
class Fault:
    """Something that the sensor does.

    Attributes
    ----------
    effect : "sensor_saturation", "frozen_sensor", "spikes" or "quantisation"
    size : float
        Where the values are cut off or stay, how far most of those that stand alone do, or the step [unit of y].
    share : float
        Of the samples that are cut off, stay or stand alone, or of the noise power that the steps make up.
    rows : pair of int
        The first row that stays, and the first that does not, counted from 0.
    record : str
        The name of the record that these are rows of.
    at : tuple of int
        The rows that stand alone.
    """

    effect: str
    size: float
    share: float
    rows: tuple[int, int] = (0, 0)
    record: str = ""
    at: tuple[int, ...] = ()

    @property
    def sentence(self) -> str:
        """What was seen, in plain words."""
        if self.effect == "sensor_saturation":
            return (
                f"The measured output seems to be cut off at {self.size:.6g} in {100 * self.share:.2g} % of the "
                "samples (sensor_saturation). If this is the limit of the sensor, leave these rows out, or measure "
                "with a wider range. A machine that stops there looks the same."
            )
        if self.effect == "frozen_sensor":
            first, last = self.rows
            return (
                f"The measured output stays at exactly {self.size:.6g} in the rows {first}:{last} of '{self.record}', "
                "while the input goes through half of its range (frozen_sensor). The sensor was frozen, values were "
                "filled in, or the machine was blocked."
            )
        if self.effect == "spikes":
            shown = ", ".join(map(str, self.at[:LISTED])) + (" ..." if len(self.at) > LISTED else "")
            many = (
                f"{len(self.at)} samples of '{self.record}' are"
                if len(self.at) > 1
                else f"A sample of '{self.record}' is"
            )
            return (
                f"{many} far from those around (spikes), by {self.size:.4g}: row{'s' * (len(self.at) > 1)} {shown}. "
                "Dropouts of the sensor and placeholders for missing values are treated as noise here."
            )
        return (
            f"The measured output comes in steps of {self.size:.4g} (quantisation), which make up "
            f"{100 * self.share:.0f} % of the noise power: a finer converter or a smaller range would lower the "
            "noise floor."
        )


def sensor_faults(records: Sequence[Record], floor: float, step: float | None = None) -> list[Fault]:
    """Look for clipped extremes and for steps in the measured outputs.

    Parameters
    ----------
    floor : float
        rms of the noise [unit of y].
    step : float, optional
        Of the converter, where it is known; read from the records by default [unit of y].
    """
    parts = [record.y for record in records]
    values, u = np.concatenate(parts), np.concatenate([record.u for record in records])
    found = []
    levels, step = np.unique(values), quantum(values) if step is None else step
    extremes = ((levels[-1], levels[-2]), (levels[0], levels[1])) if levels.size > 2 else ()  # two levels are switched
    moves = MOVES * np.ptp(u)
    for extreme, inner in extremes:
        share, length = _held(parts, float(extreme))
        inputs, beside = u[values == extreme], _held(parts, float(inner))[0] if step else 0.0
        piles = share >= max(CLIPPED, PILES * beside) and length >= RUN and np.ptp(inputs) > moves
        if piles and not _sticks(records, float(extreme), levels[[0, -1]], length / 2, moves):
            found.append(Fault("sensor_saturation", float(extreme), share))
    frozen = max((_frozen(r) for r in records), key=lambda one: one.share if one else 0.0, default=None)
    alone = max((_spikes(r, floor) for r in records), key=lambda one: len(one.at) if one else 0, default=None)
    found += [one for one in (frozen, alone) if one]
    part = step**2 / 12 / floor**2 if floor > 0 else 0.0
    return [*found, *([Fault("quantisation", step, min(1.0, part))] if part >= FELT else [])]


def _held(parts: Sequence[Array], value: float) -> tuple[float, float]:
    """Return which share of the samples has a value, and how long it stays there on average."""
    count = sum(int(np.sum(x == value)) for x in parts)
    visits = sum(int(np.sum(x[_ends(x)[:-1]] == value)) for x in parts)
    return count / sum(x.size for x in parts), count / max(visits, 1)


def _sticks(records: Sequence[Record], value: float, extremes: Array, long: float, moves: float) -> bool:
    """Return whether a machine rests at a value by itself: what is cut off is come to at speed, and only there.

    Rests are so `long`, while the input `moves`. How far the output is from the value some samples before it, and twice
    as many: at a steady speed the second is twice the first, of what comes to rest four times. Where it rests as often
    between the `extremes`, it comes to rest as it does there.
    """
    back = [n for n in (int(long) >> i for i in range(1, 16)) if n >= FAR] or [FAR]
    rows = -np.array([[2 * n for n in back], back])
    begins = [(r.y, first) for r in records for first, _ in _rests(r, long, moves)]
    at = np.array([y[first] for y, first in begins])
    far = np.array([np.abs(y[np.maximum(first + rows, 0)] - y[first]) for y, first in begins]).reshape(-1, *rows.shape)
    here, between = at == value, ~np.isin(at, extremes)  # what is cut off on one side may be so on the other

    def pace(which: Array) -> float:
        with np.errstate(all="ignore"):  # of what rests from the beginning nothing is known
            return float(np.nanmax(np.divide(*far[which].sum(axis=0)), initial=0.0))

    come, rest = pace(here), 4.0 if between.sum() < here.sum() else pace(between)
    return come == 0 or bool(come >= np.sqrt(2 * rest))


def _rests(record: Record, long: float, moves: float) -> list[tuple[int, int]]:
    """Return the rows of rests so `long` at one value, while the input `moves`: each its first, and the next after."""
    ends = _ends(record.y)
    rests = ((int(ends[i]), int(ends[i + 1])) for i in np.flatnonzero(np.diff(ends) >= long))
    return [(a, b) for a, b in rests if np.ptp(record.u[a:b]) > moves]


def _ends(y: Array) -> Array:
    """Return where each value begins, and the end."""
    return np.flatnonzero(np.diff(y, prepend=np.nan, append=np.nan) != 0)


def _frozen(record: Record) -> Fault | None:
    """Return the longest rest of the output at one value, where chance makes none as long and the input moves."""
    y, n = record.y, len(record)
    ends = _ends(y)
    lengths = np.diff(ends)
    i = int(np.argmax(lengths))
    length, rows = int(lengths[i]), slice(int(ends[i]), int(ends[i + 1]))
    rests = n - lengths.size - (length - 1)  # the other samples that repeat the one before
    usual = max(rests, 1) / max(n - length, 1)
    if length < max(CLIPPED * n, RUN) or n * usual ** (length - 1) > CHANCE or y[rows.start] in (y.min(), y.max()):
        return None
    moves = np.ptp(record.u)
    if np.ptp(record.u[rows]) <= CROSSES * moves:
        return None
    others = [b - a for a, b in _rests(record, RUN, MOVES * moves) if b - a < length / 2]  # of a part that sticks
    if others and len(others) * np.exp(-length / np.mean(others)) > CHANCE:
        return None
    return Fault("frozen_sensor", float(y[rows.start]), length / n, (rows.start, rows.stop), record.name)


def _spikes(record: Record, floor: float) -> Fault | None:
    """Return the samples of the output that stand alone, where the input has none just before: much of the noise."""
    peaks, heights = _alone(record.y)
    driven = _alone(record.u)[0]
    own = [not np.any((driven <= k) & (driven >= k - LATE)) for k in peaks]
    peaks, heights = peaks[own], heights[own]
    if not peaks.size or np.sum(heights**2) < FELT * floor**2 * len(record):
        return None
    share, rows = peaks.size / len(record), tuple(peaks.tolist())
    return Fault("spikes", float(np.median(heights)), share, record=record.name, at=rows)


def _alone(x: Array) -> tuple[Array, Array]:
    """Return the few samples that are much farther than all others from the median around them, and how far, (n,).

    And farther than the signal usually moves between two samples, when it does.
    """
    heights, moves = np.abs(x - median_filter(x, AROUND, mode="nearest")), np.abs(np.diff(x))
    step = np.median(moves[moves > 0]) if moves.any() else 0.0
    order = np.argsort(-heights, kind="stable")[: max(2, int(ALONE * x.size))]
    falls = np.flatnonzero(heights[order[:-1]] > FARTHER * np.maximum(heights[order[1:]], step))
    peaks = np.sort(order[: falls[-1] + 1]) if falls.size else order[:0]
    return peaks, heights[peaks]


def quantum(values: Array) -> float:
    """Return the step between the levels of a signal, or 0 where it has none."""
    levels = np.unique(values)
    if not 3 <= levels.size <= LEVELS * values.size:
        return 0.0
    gaps = np.diff(levels)
    step = float(np.median(gaps[gaps <= 1.5 * gaps.min()])) if gaps.min() > 1e-12 * np.abs(levels).max() else 0.0
    if not step:
        return 0.0
    multiples = gaps / step
    return step if np.all(np.abs(multiples - np.round(multiples)) <= WHOLE * np.maximum(1.0, multiples)) else 0.0
