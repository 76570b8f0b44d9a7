"""The working rate: the records at which hypotheses are compared, as short as what moves in them allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from ...errors import DataError
from ..record import Record
from ..timegrid import same_pace, stepped

Array = np.ndarray
POWER, PER_CYCLE, LEAST, MOST, SHORT = 0.999, 10, 1200, 6000, 40  # of the working rate [samples]
STRETCHES = 3  # of a record that is still too long; of several, each has its share of them
MANY = 24  # pieces without a gap, twice the blocks that are judged: each brings unknown starts of its own


def working(records: Sequence[Record]) -> tuple[list[Record], int]:
    """Return records at their working rate, and how many samples became one.

    About ten samples per cycle of the frequency below which 99.9 % of the output's power lies, and no fewer than
    `LEAST` samples; of what is still longer than `MOST` the beginning, the middle and the end: what shows in large
    swings only, or late, is there. Of a record with many gaps the longest pieces.
    """
    factors = [min(_ratio(r.y) / PER_CYCLE, sum(map(len, records)) / LEAST) for r in records]
    factor = max(1, int(min(factors)))
    most = _pieces(len(records))
    found = [_averaged(part, factor) for r in records for part in _longest(r.segments(), most)]
    room, left = MOST, MOST
    for i, length in enumerate(sorted(map(len, found))):  # what short ones leave is there for long ones
        room = left // (len(found) - i)
        left -= min(length, room)
    room, stretches = max(LEAST, room), -(-STRETCHES // len(found))
    return [part for r in found if len(r) > SHORT for part in _spread(r, room, stretches)] or found, factor


def left_out(record: Record, of: int) -> list[str]:
    """Say where only the longest pieces of a record, one of so many, are at the working rate; of 0, all of it is."""
    if not of or len(record.segments()) <= _pieces(of):
        return []
    return [f"the candidate effects were compared on its {_pieces(of)} longest pieces without a gap"]


def _pieces(records: int) -> int:
    """Return how many pieces of each of so many records are compared."""
    return max(1, MANY // records)


def _longest(pieces: Sequence[Record], most: int) -> list[Record]:
    """Return so many of the longest pieces, in their order."""
    kept = sorted(sorted(range(len(pieces)), key=lambda i: -len(pieces[i]))[:most])
    return [pieces[i] for i in kept]


def _spread(record: Record, room: int, stretches: int) -> list[Record]:
    """Return a record that is no longer than `room`, or as many samples of it in stretches from its beginning on."""
    if len(record) <= room:
        return [record]
    part = room // stretches
    return [record[i : i + part] for i in np.linspace(0, len(record) - part, stretches).astype(int)]


def _ratio(y: Array) -> float:
    """Return samples per cycle of the frequency below which nearly all of the power lies."""
    level = y - np.linspace(y[0], y[-1], len(y))
    power = np.abs(np.fft.rfft(level - level.mean())) ** 2
    top = int(np.searchsorted(np.cumsum(power), POWER * power.sum()))
    return len(y) / max(1, top)


def _averaged(record: Record, factor: int) -> Record:
    if factor == 1:
        return record
    mean = partial(means, factor=factor)
    channels = {name: mean(c) for name, c in record.channels.items()}
    return Record(
        mean(record.u), mean(record.y), mean(record.t), record.Ts * factor, channels, record.name, units=record.units
    )


def at_one_step(records: Sequence[Record]) -> list[Record]:
    """Return records of nearly one sampling time at that of the most samples, with a note in each that is resampled.

    Those of one logger differ by what its clock does; of two steps with as many samples the longer is taken. DataError
    where one is twice another or more: samples would be skipped.
    """
    steps = [r.Ts for r in records]
    Ts = max(steps, key=lambda step: (sum(len(r) for r in records if same_pace(r.Ts, step)), step))
    if max(steps) >= 2 * min(steps):
        shown = ", ".join(f"{r.name}: {r.Ts:.6g} s" for r in records)
        raise DataError(f"The records have different sampling times ({shown}); a model has one: resample them.")
    return [r if same_pace(r.Ts, Ts) else _resampled(r, Ts) for r in records]


def _resampled(record: Record, Ts: float) -> Record:
    """Return a record with another sampling time [s], segment by segment."""
    pieces = [slice(a, b) for a, b in pairwise((0, *record.breaks, len(record)))]
    places = [np.arange(float(p.stop - p.start)) * (record.Ts / Ts) for p in pieces]
    note = f"resampled from Ts = {record.Ts:.6g} s to {Ts:.6g} s, the sampling time of most samples"
    grid = stepped(record.t, Ts, pieces, places, [*record.notes, note], True)
    return replace(
        record, u=grid.apply(record.u), y=grid.apply(record.y), t=grid.t, Ts=Ts, notes=grid.notes, breaks=grid.breaks,
        channels={name: grid.apply(c) for name, c in record.channels.items()},
    )  # fmt: skip


def means(x: Array, factor: int) -> Array:
    """Return the means of so many samples each, (N // factor,)."""
    n = x.size // factor
    return np.asarray(x[: n * factor].reshape(n, factor).mean(axis=1))
