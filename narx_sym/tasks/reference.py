"""References for a law to follow: a piece of a measurement, a sine, a column of a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..data.metrics import half_cycle
from ..data.record import Record, read_signal
from ..errors import DataError

Array = np.ndarray
MOST = 200_000  # samples of a reference
PERIODS = 4  # of the usual sine


@dataclass(frozen=True, eq=False)
class Reference:
    """What the output should do.

    Attributes
    ----------
    t, r : (N,) arrays [s, unit of the output]
    Ts : float or None
        [s]; None where it is not known, and `t` counts samples.
    """

    t: Array
    r: Array
    Ts: float | None


@dataclass(frozen=True)
class Usual:
    """A sine within the outputs of a record, about as fast as these.

    Attributes
    ----------
    offset, amplitude : [unit of the output]
    frequency : [Hz]
    """

    offset: float
    amplitude: float
    frequency: float


def usual(record: Record) -> Usual:
    """Return the usual sine for a record: half its range around its mean."""
    frequency = 0.5 / (half_cycle(record.y) * record.Ts)
    return Usual(float(np.mean(record.y)), float(np.ptp(record.y)) / 4, frequency)


def measured(record: Record, seconds: float | None = None) -> Reference:
    """Return the output of the longest segment of a record, or its first seconds."""
    part = max(record.segments(), key=len)
    n = len(part) if seconds is None else _count(seconds, record.Ts, "The time")
    return Reference(part.t[:n] - part.t[0], part.y[:n], record.Ts)


def sine(Ts: float, offset: float, amplitude: float, frequency: float, seconds: float) -> Reference:
    """Return a sine that begins at rest, at its lowest point.

    Parameters
    ----------
    Ts, seconds : sampling time and duration [s]
    offset, amplitude : [unit of the output]
    frequency : [Hz]

    Raises
    ------
    DataError
        For what is not positive, too fast for the sampling time, or too long.
    """
    _positive(frequency, "The frequency")
    if frequency * Ts > 0.5:
        raise DataError(f"A frequency of {frequency:g} Hz is too fast for Ts = {Ts:g} s: at most {0.5 / Ts:.4g} Hz.")
    t = np.arange(lasting(seconds, Ts)) * Ts
    return Reference(t, offset - amplitude * np.cos(2 * np.pi * frequency * t), Ts)


def lasting(seconds: float, Ts: float) -> int:
    """Return how many samples a duration has [s]; one that is too short or too long is refused."""
    return _count(seconds, Ts, "The duration")


def from_file(path: Path, shown: str, column: str | None = None, unit: str = "") -> Reference:
    """Return a column of a file: the one that is named, "r", or the only one beside the time "t".

    Parameters
    ----------
    shown : str
        What the file is called in errors.
    unit : str
        That of the output; a column that says another one is converted.
    """
    try:
        r, Ts, stamps = read_signal(path, column, option="--column", prefer="r", unit=unit, offers=())
    except DataError as error:
        raise DataError(str(error).replace(str(path), shown)) from None
    _count(r.size * (Ts or 1.0), Ts or 1.0, shown)
    return Reference(stamps - stamps[0], r, Ts)


def _positive(value: float, what: str) -> None:
    if not value > 0:
        raise DataError(f"{what} must be positive, not {value:g}.")


def _count(seconds: float, Ts: float, what: str, least: int = 2) -> int:
    """Return how many samples a time has."""
    _positive(seconds, what)
    n = seconds / Ts
    if not least <= round(n) <= MOST:
        raise DataError(f"{what} would have {n:.4g} samples: between {least} and {MOST} are taken.")
    return round(n)
