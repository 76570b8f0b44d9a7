"""The next experiment: the input on which models that the present data cannot tell apart differ most.

A discriminating design (Hunter & Reiner 1965), judged by the two models that come closest to each other (Buzzi-Ferraris
& Forzatti 1984). What a refit of one model could absorb does not count as a difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, permutations
from typing import Any

import numpy as np
from scipy.linalg import qr
from scipy.signal import butter, sosfilt

from ..data.record import Record
from ..errors import ModelError, NarxError
from ..files.atomic import PathLike, write_csv
from ..files.parallel import one_blas_thread
from ..fit.constraints import constraint_equations
from ..fit.freerun import FreeRun
from ..fit.simulate import Records, fitted, free_run, segments, simulate
from ..models.model import Model
from ..symbolic.signals import u as input_sequence
from .bases import words

Array = np.ndarray
FILE = "next.csv"
CLEARLY = 1.2  # a separation below this many times the present one is no clear gain
VISIBLE = 3.0  # standard errors of the noise, over all samples of the signal
SHORTEST = 12  # samples per period
SMALLEST = 0.1  # share of half the range; a signal that the rate limit makes smaller is left out
SETTLE = 500  # samples of rest before a proposed signal starts
ROUNDING = 1e-6  # a slope that differs from the others by a smaller share is one of them
TOGETHER = 4  # signals per free run: equations are derived once for all of them, but slopes take memory
FAR = 1.0  # a simulated output this many ranges outside the measured one is not believed


@dataclass(frozen=True, eq=False)
class Experiment:
    """An input to run next.

    Attributes
    ----------
    separates : list of str
        Ids of the candidates.
    name : str
        The signal in words.
    t, u : (N,) arrays
        Time [s] and input [its unit], within the range and the rate of the present records.
    separation : float
        Smallest pairwise rms distance between the candidates' outputs, after a refit [unit of y].
    present : float
        The same on the present records; NaN where a candidate cannot be run from their first samples.
    floor : float
        rms of the noise [unit of y].
    outputs : dict of (N,) arrays
        What each candidate says will be measured [unit of y].
    file : str
        Where the input is written, if it is.
    units : mapping of "u" and "y" to texts
    together : list of pairs of ids
        No signal of the family separates these; where other pairs can be separated, the distances are of those.
    """

    separates: list[str]
    name: str
    t: Array
    u: Array
    separation: float
    present: float
    floor: float
    outputs: dict[str, Array]
    file: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    together: list[tuple[str, str]] = field(default_factory=list)

    @property
    def ratio(self) -> float:
        """The separation in multiples of the noise; infinite without noise."""
        return self.separation / self.floor if self.floor > 0 else float("inf")

    @property
    def visible(self) -> bool:
        """Whether the difference can be seen at all: all samples together stand out of the noise and of rounding."""
        return self.separation > _threshold(self.floor, self.outputs.values())

    @property
    def clear(self) -> bool:
        """Whether it separates the candidates visibly, and clearly better than the present records do."""
        return self.visible and not self.separation < CLEARLY * self.present

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def sentence(self) -> str:
        """What to run, and what it will show, in plain words."""
        *most, last = map(words, self.separates)
        between = f"{', '.join(most)} and {last}"
        which = "their outputs" if len(most) == 1 else "any two of their outputs"
        least = "" if len(most) == 1 else "at least "
        which += " that can be told apart" if self.together else ""
        where = f" ({self.file})" if self.file else ""
        noise = f", {self.ratio:.2g} times the noise" if np.isfinite(self.ratio) else ""
        if not self.visible:
            return (
                f"No input within the present range and rate tells {between} apart: after a refit they say the same "
                f"even on the best one found ({self.name})."
            )
        said = (
            f"To decide between {between}: run this {self.duration:.3g} s input{where}: {self.name}. "
            f"Even after a refit {which} then differ by {least}{self._y(self.separation)} rms{noise}."
        )
        if not self.clear:
            said += (
                f" This is hardly better than the present record ({self._y(self.present)}): deciding needs a wider "
                "range or faster moves than that record has."
            )
        elif self.ratio < 1:
            said += " Repeat it and average: one sample's noise is larger than the difference."
        for a, b in self.together:
            said += f" No input of this kind tells {words(a)} and {words(b)} apart."
        return said

    def save(self, path: PathLike = FILE) -> None:
        """Write the columns t [s] and u [its unit] as CSV."""
        write_csv(path, {"t": self.t, "u": self.u})

    def _y(self, value: float) -> str:
        return _with_unit(value, self.units.get("y", ""), 2)


@dataclass(frozen=True)
class Limits:
    """What the present records show the input may do.

    Attributes
    ----------
    low, high : float
        [unit of u]
    rate : float
        Largest step per sample [unit of u].
    """

    low: float
    high: float
    rate: float

    @classmethod
    def of(cls, parts: Sequence[Record]) -> Limits:
        """Read the limits; the rate is the 99.9 % quantile of the steps, the largest step where the input jumps."""
        values = np.concatenate([p.u for p in parts])
        steps = np.abs(np.concatenate([np.diff(p.u) for p in parts]))
        low, high, largest = float(values.min()), float(values.max()), float(steps.max())
        # Rests with jumps between them: the quantile would see the rests only.
        jumps = np.count_nonzero(steps > largest / 2) >= 3 and np.median(steps) < 0.01 * largest
        rate = largest if jumps and largest > 0.05 * (high - low) else float(np.quantile(steps, 0.999))
        return cls(low, high, rate or largest)

    @property
    def centre(self) -> float:
        """The middle of the range [unit of u]."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> float:
        """Half the range [unit of u]."""
        return (self.high - self.low) / 2

    def confine(self, x: Array) -> Array:
        """Turn x, (N,) in halves of the range, into an input within the limits that starts and ends at the centre."""
        rate = self.rate / self.half
        last, limited = 0.0, []
        for value in np.clip(x, -1.0, 1.0).tolist():
            last = min(max(value, last - rate), last + rate)
            limited.append(last)
        index = np.arange(x.size)
        cone = rate * np.minimum(index, index[::-1])
        return np.clip(self.centre + self.half * np.clip(limited, -cone, cone), self.low, self.high)


def family(limits: Limits, n: int, Ts: float, seed: int = 0, unit: str = "") -> Iterator[tuple[str, Array]]:
    """Yield input signals with a name in words, simple ones first.

    Parameters
    ----------
    n : int
        Samples of each.
    Ts : float [s]
    unit : str
        Of u, for the names.

    Yields
    ------
    name, u : str and (n,) array [unit of u]
    """
    for name, size, x in _shapes(limits, n, Ts, seed, unit):
        if size is None:
            yield name, limits.confine(x)
        elif size >= SMALLEST:
            reach = "full range" if size > 0.995 else f"amplitude {_with_unit(size * limits.half, unit)}"
            yield f"{name}, {reach}", limits.confine(size * x)


def _shapes(limits: Limits, n: int, Ts: float, seed: int, unit: str) -> Iterator[tuple[str, float | None, Array]]:
    """Yield name, the amplitude that the rate allows (None where there is no choice), and shapes in [-1, 1], (n,)."""
    rate, length = limits.rate / limits.half, (n - 1) * Ts
    speed = f"at {_with_unit(limits.rate / Ts, unit)}{'/s' if unit else ' per s'}"

    def moves(step: float) -> str:
        return "" if step <= rate else f", moving {speed}"

    index = np.arange(n)
    early, late = index / (n - 1) * 2, index / (n - 1) * 2 - 1  # run from 0 to 1 over the first and the second half

    def hertz(cycles: float, share: float = 1.0) -> str:
        return f"{cycles / (share * length):.3g} Hz"

    def possible(cycles: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        return sorted({(a, b) for a, b in cycles if 0 < a < b and b * SHORTEST <= n / 2})

    def first_then(wave: Any, a: int, b: int) -> Array:
        return np.where(early < 1, wave(a * early), wave(b * late))

    def triangle(phase: Array) -> Array:
        return 1 - np.abs((4 * phase + 1) % 4 - 2)

    def sine(phase: Array) -> Array:
        return np.sin(2 * np.pi * phase)

    yield f"slow ramp up, down and back over {length:.3g} s", min(1.0, rate * (n - 1) / 4), triangle(early / 2)

    pairs = [(1, 3), (1, 10), (3, 10), (3, 30), (10, 30), (10, 100)]
    fastest = int(rate * (n - 1) / 8)  # periods of full range in half the time
    for a, b in possible([*pairs, (max(1, fastest // 3), fastest), (max(1, fastest // 10), fastest)]):
        name = f"triangle, {hertz(a, 0.5)} then {hertz(b, 0.5)}"
        yield name, min(1.0, rate * (n - 1) / 8 / b), first_then(triangle, a, b)

    for levels, passes in ((4, 1), (8, 1), (4, 3)):
        up = np.arange(1, levels + 1)
        one = np.concatenate([up, up[-2::-1], [0], -up, -up[-2::-1], [0]]) / levels
        held = n // (passes * one.size)
        if held * min(1.0, rate * levels) >= 2:
            step = f"steps of {_with_unit(limits.half / levels, unit)} every {held * Ts:.3g} s{moves(1 / levels)}"
            yield f"staircase up and down, {step}", None, _held(np.tile(one, passes), n)

    for cycles in (5, 15, 50):
        if cycles * SHORTEST <= n:
            size = min(1.0, rate * (n - 1) / (2 * np.pi * cycles))
            yield f"sine of {hertz(cycles)} with growing amplitude", size, index / n * sine(early / 2 * cycles)

    for cycles in (3, 10, 30):
        for small in (0.1, 0.3):
            if cycles * SHORTEST <= n / 2:
                size = min(1.0, rate * (n - 1) / (4 * np.pi * cycles))
                x = np.where(early < 1, small * sine(cycles * early), sine(cycles * late))
                yield f"sine of {hertz(cycles, 0.5)}, {100 * small:.0f} % of the amplitude and then all of it", size, x

    for a, b in possible([(2, 8), (2, 20), (5, 50)]):
        name = f"sine of {hertz(a, 0.5)}, then sine of {hertz(b, 0.5)}"
        yield name, min(1.0, rate * (n - 1) / (4 * np.pi * b)), first_then(sine, a, b)

    for rests in (2, 5):
        ends = np.append((-1.0) ** np.arange(rests), 0.0)
        name = f"fast moves from end to end of the range, one every {length / ends.size:.3g} s with rest after it"
        if 4 * ends.size <= rate * n:  # at least as much rest as motion
            yield f"{name}{moves(2.0)}", None, _held(ends, n)

    rng = np.random.default_rng(seed)
    for count in (20, 60, 200):
        drawn = rng.uniform(-1, 1, count)
        if count * SHORTEST <= n and rate * n / count >= SMALLEST:
            yield f"random levels, a new one every {length / count:.3g} s{moves(2.0)}", None, _held(drawn, n)

    for cycles in (5, 20, 80):
        white = rng.standard_normal(2 * n)
        if cycles * SHORTEST <= n:
            # The first half forgets how the filter started.
            x = sosfilt(butter(5, 2 * cycles / n, output="sos"), white)[n:]
            x = x / np.abs(x).max()
            yield f"filtered noise up to {hertz(cycles)}", min(1.0, rate / float(np.abs(np.diff(x)).max())), x

    yield f"rest at {_with_unit(limits.centre, unit)} for {length:.3g} s", None, np.zeros(n)


def _held(levels: Array, n: int) -> Array:
    """Return levels, each held equally long, (n,)."""
    return np.asarray(levels[np.arange(n) * levels.size // n])


def _threshold(floor: float, outputs: Iterable[Array]) -> float:
    """Return the rms distance between outputs, (N,) arrays, that N samples of noise, or rounding, could make."""
    listed = list(outputs)
    return max(VISIBLE * floor / np.sqrt(listed[0].size), 1e-9 * max(float(np.abs(y).max()) for y in listed))


def _with_unit(value: float, unit: str, digits: int = 3) -> str:
    return f"{value:.{digits}g} {unit}".rstrip()


def propose(
    models: Mapping[str, Model],
    records: Records,
    floor: float,
    seed: int = 0,
    longest: int = 8000,
    units: Mapping[str, str] | None = None,
) -> Experiment | None:
    """Choose the input that separates fitted models best.

    Parameters
    ----------
    models : mapping from an effect id to a fitted Model
        They explain the records equally well. Further channels are held at their means.
    records : Record or list of Record
        They set range, rate, sampling time and length.
    floor : float
        rms of the noise [unit of y].
    seed : int
        Of the random signals.
    longest : int
        Most samples.
    units : mapping of "u" and "y" to texts, optional

    Returns
    -------
    Experiment, or None where there is nothing to decide or no signal that all models survive

    Raises
    ------
    ModelError
        For a model that was not fitted, or an inverse one.
    """
    if len(models) < 2:
        return None
    if any(m.input != input_sequence for m in models.values()):
        raise ModelError("An experiment needs models from u to y; in an inverse model nobody can command the input.")
    for model in models.values():
        fitted(model)
    parts = segments(records)
    bench = _Bench.of(parts)
    limits = Limits.of(parts)
    n = min(longest, sum(len(p) for p in parts))
    if limits.half <= 0 or limits.rate <= 0 or n < 2 * SHORTEST:
        return None
    given = units or {}
    tried = [
        (name, u, outputs)
        for name, u in family(limits, n, parts[0].Ts, seed, given.get("u", ""))
        if (outputs := bench.simulated(models, u)) is not None
    ]
    if not tried:
        return None
    runs = {name: [bench.record(u, outputs[name]) for _, u, outputs in tried] for name in models}
    now = {name: _as_measured(model, parts) for name, model in models.items()}
    pairs = list(combinations(models, 2))
    apart, present = _distances(models, runs, now)
    usable = np.flatnonzero(np.isfinite(apart).all(axis=0))
    if not usable.size:
        return None
    lowest = [_threshold(floor, outputs.values()) for _, _, outputs in tried]
    possible: Array = np.any((apart > lowest)[:, usable], axis=1)
    chosen = possible if possible.any() else ~possible
    worst = apart[chosen].min(axis=0)
    best = int(usable[np.argmax(worst[usable])])
    name, u, outputs = tried[best]
    return Experiment(
        list(models), name, parts[0].Ts * np.arange(n), u, float(worst[best]), float(present[chosen].min()),
        float(floor), outputs, units=dict(given),
        together=[p for p, c in zip(pairs, possible, strict=True) if not c],
    )  # fmt: skip


@dataclass(frozen=True)
class _Bench:
    """How a proposed input is simulated: from rest, at the records' operating conditions.

    Attributes
    ----------
    Ts, start : float
        Sampling time and the time of the first sample [s].
    line : (slope, offset)
        Of the measured output over the input.
    outputs : (low, high)
        Which outputs are believed [unit of y].
    channels : means of the further channels
    """

    Ts: float
    start: float
    line: tuple[float, float]
    outputs: tuple[float, float]
    channels: dict[str, float]

    @classmethod
    def of(cls, parts: Sequence[Record]) -> _Bench:
        u, y = (np.concatenate([getattr(p, name) for p in parts]) for name in "uy")
        about = u - u.mean()
        slope = float(about @ y / max(about @ about, 1e-300))
        means = {
            name: float(np.mean(np.concatenate([p.channels[name] for p in parts])))
            for name in parts[0].channels
            if all(name in p.channels for p in parts)
        }
        room = FAR * float(np.ptp(y))
        return cls(
            parts[0].Ts, float(parts[0].t[0]), (slope, float(y.mean() - slope * u.mean())),
            (float(y.min()) - room, float(y.max()) + room), means,
        )  # fmt: skip

    def simulated(self, models: Mapping[str, Model], u: Array) -> dict[str, Array] | None:
        """Return each model's output, (N,) arrays [unit of y]; None where one diverges or goes far outside."""
        settle = min(u.size // 4, SETTLE)
        padded = np.concatenate([np.full(settle, u[0]), u])
        given: dict[str, Array] = {name: np.full(padded.size, value) for name, value in self.channels.items()}
        given["t"] = self.start + self.Ts * (np.arange(padded.size) - settle)
        found = {}
        for name, model in models.items():
            try:
                run = simulate(model, padded, self.line[1] + self.line[0] * u[0], given, warn=False)[settle:]
            except NarxError:
                return None
            if not (np.isfinite(run).all() and self.outputs[0] <= run.min() and run.max() <= self.outputs[1]):
                return None
            found[name] = run
        return found

    def record(self, u: Array, y: Array) -> Record:
        """Return a record as the experiment would give it."""
        channels = {name: np.full(u.size, value) for name, value in self.channels.items()}
        t: Array = self.start + self.Ts * np.arange(u.size)
        return Record(u, y, t, self.Ts, channels)


def _as_measured(model: Model, parts: Sequence[Record]) -> list[Record]:
    """Return the present records with a model's output in the place of the measured one; none where it diverges."""
    found = []
    for part in parts:
        try:
            run = free_run(model, part)
        except NarxError:
            return []
        if not np.isfinite(run).all():
            return []
        found.append(Record(part.u, run, part.t, part.Ts, part.channels))
    return found


def _distances(
    models: Mapping[str, Model], runs: Mapping[str, list[Record]], now: Mapping[str, list[Record]]
) -> tuple[Array, Array]:
    """Return the rms distance of each pair on each proposed signal, and on the present records [unit of y].

    One model plays the truth, the other is refitted to it: to first order what its slopes explain is absorbed.

    Returns
    -------
    (pairs, signals) and (pairs,) arrays, pairs as `itertools.combinations` orders them; NaN where a run diverges
    """
    count = len(next(iter(runs.values())))
    apart: dict[tuple[str, str], list[float]] = {}
    present: dict[tuple[str, str], float] = {}
    with np.errstate(all="ignore"), one_blas_thread():
        for one, truth in permutations(models, 2):
            blocks = [runs[truth][i : i + TOGETHER] for i in range(0, count, TOGETHER)]
            problems = (_run(models[one], block) for block in blocks)  # one at a time: their slopes are large
            apart[one, truth] = [_left(p, i, i + 1) for p in problems for i in range(len(p.data))]
            present[one, truth] = float("nan")
            if now[truth]:
                problem = _run(models[one], now[truth])
                present[one, truth] = _left(problem, 0, len(problem.data))
    pairs = list(combinations(models, 2))
    each = np.array([np.minimum(apart[a, b], apart[b, a]) for a, b in pairs])
    return each, np.array([np.minimum(present[a, b], present[b, a]) for a, b in pairs])


def _run(model: Model, records: list[Record]) -> FreeRun:
    """Return the free run of a model along records, with its slopes."""
    problem = FreeRun(model, records, constraint_equations(model, None))
    problem.run(problem.start(model.theta))
    return problem


def _left(problem: FreeRun, first: int, last: int) -> float:
    """Return the rms that a refit on some segments leaves [unit of y]; NaN where the run diverges."""
    rows, shifts = slice(problem.edges[first], problem.edges[last]), len(problem.starts)
    own = np.r_[: problem.free, problem.free + first * shifts : problem.free + last * shifts]
    residual, slopes = problem.residuals[rows], problem.slopes[rows][:, own]
    if not (np.isfinite(residual).all() and np.isfinite(slopes).all()):
        return float("nan")
    size = np.linalg.norm(slopes, axis=0)
    Q, R, _ = qr(slopes[:, size > 0] / size[size > 0], mode="economic", pivoting=True)
    Q = Q[:, np.abs(np.diag(R)) > ROUNDING]
    left = residual - Q @ (Q.T @ residual)
    left = left - Q @ (Q.T @ left)  # what rounding left of the first projection
    return float(np.sqrt(np.mean(left**2)) * problem.spread)
