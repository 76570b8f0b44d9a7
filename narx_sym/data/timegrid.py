"""Regular time from time stamps: rounding is snapped, jitter resampled, gaps split, disorder refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..errors import DataError
from .arrays import Vector

MOST_NOTES = 10
CLOCK = 1e-3  # by which sampling times may differ: two clocks, or times of few digits; no time constant is so sure
NEXT = 1e-6  # of a step: so near before a sample it is that one
FEWEST_BURSTS = 4  # of rows, for a line through them to have an error
GAP, SHORTEST = 10.0, 10  # a gap is longer than 10 median steps; shorter pieces than 10 samples are useless


def check_step(Ts: float | None) -> float:
    """`Ts` as a positive, finite float in s."""
    try:
        value = float(Ts)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        value = np.nan
    if not (np.isfinite(value) and value > 0):
        raise DataError(f"the sampling time must be a positive number of seconds, not {Ts!r}; check --ts")
    return value


def same_pace(a: float, b: float) -> bool:
    """Whether two sampling times [s] are one, as far as clocks tell."""
    return abs(a - b) <= CLOCK * max(a, b)


@dataclass(frozen=True)
class Grid:
    """Regular time `t` (N,) and `Ts` in s, and the way any signal is brought onto it with `apply`."""

    t: Vector
    Ts: float
    breaks: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    resampled: bool = False
    # Per piece: which samples, their positions in steps of Ts, and the wanted positions.
    pieces: tuple[tuple[slice, Vector, Vector], ...] = ()

    def apply(self, x: Vector) -> Vector:
        """(M,) samples at the stamps -> (N,) samples on the grid."""
        if not self.resampled:
            return np.concatenate([x[rows] for rows, _, _ in self.pieces])
        return np.concatenate([between(new, old, x[rows]) for rows, old, new in self.pieces])


def between(at: Vector, known: Vector, x: Vector) -> Vector:
    """Return a signal (N,) between the samples where it is known, at (M,) places.

    On the straight line; what rests at most of its samples, as a command of levels does, was there what it is before.
    """
    if 2 * np.count_nonzero(np.diff(x)) >= x.size:
        return np.asarray(np.interp(at, known, x))
    return np.asarray(x[np.maximum(np.searchsorted(known, at + NEXT, side="right") - 1, 0)])


def uniform_time(n: int, Ts: float, start: int = 0) -> Grid:
    """Grid of `n` samples with the known `Ts` in s, the first at start * Ts."""
    k = np.arange(n, dtype=np.float64)
    return Grid((start + k) * Ts, Ts, pieces=((slice(0, n), k, k),))


def regular_time(t: Vector, where: Callable[[int], str] = lambda i: f"sample {i}", source: str = "") -> Grid:
    """Find the regular grid behind the time stamps.

    Parameters
    ----------
    t : (N,) array
        Time stamps in s.
    where : function
        Words for the place of sample i, used in messages and notes.
    source : str
        File and column, put before each message.

    Returns
    -------
    Grid
        Snapped where the stamps round to a grid, else resampled; split at gaps.
    """
    dt = np.diff(t)
    back = np.flatnonzero(dt <= 0)
    if back.size:
        i = int(back[0]) + 1
        verb = "repeats" if t[i] == t[i - 1] else "decreases"
        each = float(f"{(t[-1] - t[0]) / (t.size - 1):.3g}")
        even = f" (--ts {each:g}, where the rows are evenly spaced)" if np.all(dt >= 0) and each else ""
        raise DataError(
            f"{source}{where(i)}: time {verb} ({t[i - 1]:.10g} s, then {t[i]:.10g} s); sort the rows, "
            f"split the file there (--rows), or give --ts to ignore the time column{even}"
        )
    median = float(np.median(dt))
    bursts = _bursts(t, dt, median)
    if bursts is not None:
        return bursts
    pieces, notes = _split_at_gaps(t, dt, median, where, source)
    index = np.concatenate(([0.0], np.cumsum(np.maximum(1.0, np.rint(dt / median)))))
    lost = int(sum(index[p][-1] - index[p][0] + 1 - index[p].size for p in pieces))
    # Coarse stamps with few holes could be either; a handful of holes means lost samples, many mean rounding.
    counts = [np.arange(t.size, dtype=np.float64), index]
    for k in counts[::-1] if lost <= 0.01 * t.size else counts:
        Ts = _common_step(t, k, pieces)
        if Ts is not None:
            old = [k[p] - k[p][0] for p in pieces]
            notes += _snap_notes(
                max(np.max(np.abs(t[p] - t[p][0] - Ts * o)) for p, o in zip(pieces, old, strict=True)), Ts
            )
            lost = lost if k is index else 0
            if lost:
                how = "filled by linear interpolation; constant signals stay constant"
                notes.append(f"{lost} sample(s) are missing in the time stamps; {how}")
            return stepped(t, Ts, pieces, old, notes, lost > 0)
    Ts = float(f"{median:.9g}")
    inside = np.concatenate([np.diff(t[p]) for p in pieces])
    jitter = np.sqrt(np.mean((inside - Ts) ** 2))
    notes.append(
        f"time stamps are irregular (steps {inside.min():.4g} to {inside.max():.4g} s, rms jitter "
        f"{jitter:.2g} s); resampled by linear interpolation at Ts = {Ts:.10g} s; constant signals stay constant"
    )
    return stepped(t, Ts, pieces, [(t[p] - t[p][0]) / Ts for p in pieces], notes, True)


def _bursts(t: Vector, dt: Vector, median: float) -> Grid | None:
    """Return the even grid of rows that were stamped when they were read, many at once, or None.

    Such bursts are shorter than the pauses between them, their stamps follow no clock, and rows and time keep pace: no
    burst is further from an even spacing than the longest pause.
    """
    last = np.append(np.flatnonzero(dt > GAP * median), t.size - 1)  # row of each burst
    first = np.append(0, last[:-1] + 1)
    pauses = dt[last[:-1]]
    if last.size < FEWEST_BURSTS or np.max(t[last] - t[first]) >= pauses.min():
        return None
    k = np.arange(t.size, dtype=np.float64)
    rows = [slice(a, b + 1) for a, b in zip(first, last, strict=True) if b > a]
    if not rows or _common_step(t, k, rows) is not None:
        return None
    (Ts, start), spread = np.polyfit(last, t[last] - t[0], 1, cov=True)
    late = t[last] - t[0] - start - Ts * last
    if np.ptp(late) > pauses.max():
        return None
    doubt = 2 * float(np.sqrt(spread[0, 0]))
    trials = (float(f"{Ts:.{d}g}") for d in range(1, 10))
    Ts = next((step for step in trials if abs(step - Ts) <= doubt), float(Ts))
    note = (
        f"the rows come in {last.size} bursts, about {t.size / last.size:.3g} at once every {np.median(pauses):.3g} s, "
        f"so the time stamps are those of reading: the rows are treated as evenly spaced at Ts = {Ts:.10g} s; if "
        "this is wrong, give --ts"
    )
    return stepped(t, Ts, [slice(0, t.size)], [k], [note], False)


def _snap_notes(deviation: float, Ts: float) -> list[str]:
    """Say that stamps were moved by `deviation` (s)."""
    if deviation <= 1e-6 * Ts:
        return []
    doubt = "; the rounding is coarse, check Ts or give --ts" if deviation > 0.2 * Ts else ""
    return [
        f"time stamps snapped to the grid of Ts = {Ts:.10g} s (they were rounded, by at most "
        f"{deviation:.2g} s); the samples are unchanged{doubt}"
    ]


def _split_at_gaps(
    t: Vector, dt: Vector, median: float, where: Callable[[int], str], source: str
) -> tuple[list[slice], list[str]]:
    """Pieces between the gaps, too short ones left out, and the notes about it."""
    cuts = (np.flatnonzero(dt > GAP * median) + 1).tolist()
    edges, keep, notes = [0, *cuts, t.size], [], []
    for a, b in pairwise(edges):
        if a:
            gap = t[a] - t[a - 1]
            notes.append(f"{where(a)}: gap of {gap:.4g} s before t = {t[a]:.10g} s; the record is split there")
        if cuts and b - a < SHORTEST:
            notes.append(f"{where(a)}: a piece of only {b - a} sample(s) next to a gap is dropped")
        else:
            keep.append(slice(a, b))
    if len(notes) > MOST_NOTES:
        rest = len(cuts) - sum(": gap of" in n for n in notes[:MOST_NOTES])
        notes[MOST_NOTES:] = [
            f"{rest} further gap(s) split the record; pieces with fewer than {SHORTEST} samples are dropped"
        ]
    if not keep:
        raise DataError(
            f"{source}the time stamps have gaps everywhere, no part has {SHORTEST} samples; "
            "give --ts to ignore the time column"
        )
    return keep, notes


def stepped(t: Vector, Ts: float, pieces: list[slice], old: list[Vector], notes: list[str], resampled: bool) -> Grid:
    """Return the grid with one run of whole steps per piece; `old` are the positions of the samples in steps."""
    new = [np.arange(np.floor(k[-1] + NEXT) + 1) for k in old]
    time = np.concatenate([t[p][0] + Ts * k for p, k in zip(pieces, new, strict=True)])
    breaks = tuple(np.cumsum([k.size for k in new])[:-1].tolist())
    return Grid(time, Ts, breaks, tuple(notes), resampled, tuple(zip(pieces, old, new, strict=True)))


def _common_step(t: Vector, k: Vector, pieces: list[slice]) -> float | None:
    """Step in s for which all stamps round to t0 + Ts k in each piece, None where there is none."""
    last = _last_digit(t)
    num = den = 0.0
    for p in pieces:
        kc = k[p] - np.mean(k[p])
        num += float(np.sum(kc * (t[p] - t[p][0])))
        den += float(np.sum(kc**2))
    Ts = num / den

    def fits(step: float, slack: Vector) -> bool:
        """Whether one offset per piece brings every stamp within its slack."""
        rests = [(t[p] - t[p][0] - step * (k[p] - k[p][0]), slack[p]) for p in pieces]
        return all(np.max(r - s) <= np.min(r + s) for r, s in rests)

    generous = 0.6 * last + 1e-3 * Ts
    if not fits(Ts, 3 * generous):
        return None  # far from any grid
    exact = np.full(t.size, 1e-9 * Ts + 4 * np.spacing(np.abs(t).max()))
    # 0.005 s or 1/750 s rather than a number with noise in its last digits.
    short = [float(f"{Ts:.{d}g}") for d in range(1, 10)], [1 / float(f"{1 / Ts:.{d}g}") for d in range(1, 10)]
    nice = [step for pair in zip(*short, strict=True) for step in pair]
    trials = [(step, slack) for slack in (exact, 0.5 * last + exact) for step in nice]
    # Truncated stamps can tilt the fit, then a nice step may still hold where the fitted one does not.
    trials += [(step, generous) for step in (Ts, *nice)]
    return next((step for step, slack in trials if fits(step, slack)), None)


def _last_digit(t: Vector) -> Vector:
    """Find the unit of the last printed digit of each stamp in s, 0 where all digits are used.

    It is no larger than a step: stamps that follow one another differ in it.
    """
    size = np.where(t == 0, 1.0, np.abs(t))
    exponent, step = np.floor(np.log10(size)), float(np.max(np.diff(t)))

    def whole(x: Vector) -> bool:
        return bool(np.all(np.abs(x - np.rint(x)) <= 1e-6 + 4 * np.spacing(np.abs(x))))

    fixed = next((10.0**-d for d in range(13) if 10.0**-d <= step and whole(t * 10.0**d)), 0.0)
    fine = [d for d in range(1, 13) if 10.0 ** (exponent.max() - d + 1) <= step]
    digits = next((d for d in fine if whole(t * 10.0 ** (d - 1 - exponent))), None)
    floating = 0.0 if digits is None else 10.0 ** (exponent - digits + 1)
    return np.where(t == 0, fixed, np.maximum(fixed, floating))
