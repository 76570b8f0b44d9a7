"""Inputs to choose from: ramps, triangles, stairs, sines, fast moves, noise and rest, within limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from ...data.record import Record
from ...engines.compile import compile
from ...symbolic.functions import follows
from ...symbolic.numbers import with_unit
from ...symbolic.recursion import Recursion
from ...symbolic.signals import k, m, r
from ..settings import SHORTEST, SMALLEST

Array = np.ndarray
RATE = sp.Symbol("rate", positive=True)
LIMITER = Recursion(((m[k], follows(r[k], m[k - 1], RATE)),), (RATE,))


@dataclass(frozen=True)
class Limits:
    """What the input may do: what the present records show, or a range that is given.

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
    def of(cls, parts: Sequence[Record], given: tuple[float, float] | None = None) -> Limits:
        """Read the limits; the rate is the 99.9 % quantile of the steps, the largest step where the input jumps.

        Parameters
        ----------
        given : (low, high), optional
            The range instead of the records' [unit of u].
        """
        values = np.concatenate([p.u for p in parts])
        steps = np.abs(np.concatenate([np.diff(p.u) for p in parts]))
        low, high, largest = float(values.min()), float(values.max()), float(steps.max())
        # Rests with jumps between them: the quantile would see the rests only.
        jumps = np.count_nonzero(steps > largest / 2) >= 3 and np.median(steps) < 0.01 * largest
        rate = largest if jumps and largest > 0.05 * (high - low) else float(np.quantile(steps, 0.999))
        return cls(*(given or (low, high)), rate or largest)

    def times(self, share: float) -> tuple[float, float]:
        """Return so many times the range about its centre (low, high) [unit of u]."""
        return self.centre - share * self.half, self.centre + share * self.half

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
        asked = np.concatenate([[0.0], np.clip(x, -1.0, 1.0)])  # it starts from rest at the centre
        limited = compile(LIMITER)({r: asked}, [rate], {m: 0.0})["m"][1:]
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
    frame = _Frame(limits, n, Ts, seed, unit)
    for name, size, x in (shape for shapes in SHAPES for shape in shapes(frame)):
        if size is None:
            yield name, limits.confine(x)
        elif size >= SMALLEST:
            reach = "full range" if size > 0.995 else f"amplitude {with_unit(size * limits.half, unit)}"
            yield f"{name}, {reach}", limits.confine(size * x)


# Name, the amplitude that the rate allows (None where there is no choice), and a shape in [-1, 1], (n,).
Shape = tuple[str, float | None, Array]


@dataclass(frozen=True, eq=False)
class _Frame:
    """What all shapes are drawn in: n samples, Ts [s] apart, within the limits."""

    limits: Limits
    n: int
    Ts: float
    seed: int
    unit: str

    @property
    def rate(self) -> float:
        """The largest step per sample, in halves of the range."""
        return self.limits.rate / self.limits.half

    @property
    def length(self) -> float:
        """From the first to the last sample [s]."""
        return (self.n - 1) * self.Ts

    @cached_property
    def index(self) -> Array:
        return np.arange(self.n)

    @cached_property
    def early(self) -> Array:
        """Runs from 0 to 1 over the first half."""
        return self.index / (self.n - 1) * 2

    @cached_property
    def late(self) -> Array:
        """Runs from 0 to 1 over the second half."""
        return self.early - 1

    def moves(self, step: float) -> str:
        """Say how fast a step is taken, where the rate does not allow it at once."""
        speed = f"at {with_unit(self.limits.rate / self.Ts, self.unit)}{'/s' if self.unit else ' per s'}"
        return "" if step <= self.rate else f", moving {speed}"

    def hertz(self, cycles: float, share: float = 1.0) -> str:
        """Return the frequency of that many cycles in a share of the time."""
        return f"{cycles / (share * self.length):.3g} Hz"

    def possible(self, cycles: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """Return the pairs of cycles in one half each that the sampling time can show."""
        return sorted({(a, b) for a, b in cycles if 0 < a < b and b * SHORTEST <= self.n / 2})

    def first_then(self, wave: Any, a: int, b: int) -> Array:
        """Return a wave with a cycles in the first half and b in the second, (n,)."""
        return np.where(self.early < 1, wave(a * self.early), wave(b * self.late))

    def held(self, levels: Array) -> Array:
        """Return levels, each held equally long, (n,)."""
        return np.asarray(levels[self.index * levels.size // self.n])


def _triangle(phase: Array) -> Array:
    return 1 - np.abs((4 * phase + 1) % 4 - 2)


def _sine(phase: Array) -> Array:
    return np.sin(2 * np.pi * phase)


def _triangles(f: _Frame) -> Iterator[Shape]:
    """Yield a slow ramp, and triangles of two frequencies."""
    yield f"slow ramp up, down and back over {f.length:.3g} s", min(1.0, f.rate * (f.n - 1) / 4), _triangle(f.early / 2)
    pairs = [(1, 3), (1, 10), (3, 10), (3, 30), (10, 30), (10, 100)]
    fastest = int(f.rate * (f.n - 1) / 8)  # periods of full range in half the time
    for a, b in f.possible([*pairs, (max(1, fastest // 3), fastest), (max(1, fastest // 10), fastest)]):
        name = f"triangle, {f.hertz(a, 0.5)} then {f.hertz(b, 0.5)}"
        yield name, min(1.0, f.rate * (f.n - 1) / 8 / b), f.first_then(_triangle, a, b)


def _stairs(f: _Frame) -> Iterator[Shape]:
    """Yield staircases up and down."""
    for levels, passes in ((4, 1), (8, 1), (4, 3)):
        up = np.arange(1, levels + 1)
        one = np.concatenate([up, up[-2::-1], [0], -up, -up[-2::-1], [0]]) / levels
        held = f.n // (passes * one.size)
        if held * min(1.0, f.rate * levels) >= 2:
            height = with_unit(f.limits.half / levels, f.unit)
            step = f"steps of {height} every {held * f.Ts:.3g} s{f.moves(1 / levels)}"
            yield f"staircase up and down, {step}", None, f.held(np.tile(one, passes))


def _sines(f: _Frame) -> Iterator[Shape]:
    """Yield sines of growing amplitude, of two amplitudes, and of two frequencies."""
    for cycles in (5, 15, 50):
        if cycles * SHORTEST <= f.n:
            size = min(1.0, f.rate * (f.n - 1) / (2 * np.pi * cycles))
            name = f"sine of {f.hertz(cycles)} with growing amplitude"
            yield name, size, f.index / f.n * _sine(f.early / 2 * cycles)

    for cycles in (3, 10, 30):
        for small in (0.1, 0.3):
            if cycles * SHORTEST <= f.n / 2:
                size = min(1.0, f.rate * (f.n - 1) / (4 * np.pi * cycles))
                x = np.where(f.early < 1, small * _sine(cycles * f.early), _sine(cycles * f.late))
                name = f"sine of {f.hertz(cycles, 0.5)}, {100 * small:.0f} % of the amplitude and then all of it"
                yield name, size, x

    for a, b in f.possible([(2, 8), (2, 20), (5, 50)]):
        name = f"sine of {f.hertz(a, 0.5)}, then sine of {f.hertz(b, 0.5)}"
        yield name, min(1.0, f.rate * (f.n - 1) / (4 * np.pi * b)), f.first_then(_sine, a, b)


def _fast_moves(f: _Frame) -> Iterator[Shape]:
    """Yield moves from end to end with rest after each."""
    for rests in (2, 5):
        ends = np.append((-1.0) ** np.arange(rests), 0.0)
        every = f.length / ends.size
        name = f"fast moves from end to end of the range, one every {every:.3g} s with rest after it"
        if 4 * ends.size <= f.rate * f.n:  # at least as much rest as motion
            yield f"{name}{f.moves(2.0)}", None, f.held(ends)


def _random(f: _Frame) -> Iterator[Shape]:
    """Yield random levels and filtered noise."""
    rng = np.random.default_rng(f.seed)
    for count in (20, 60, 200):
        drawn = rng.uniform(-1, 1, count)
        if count * SHORTEST <= f.n and f.rate * f.n / count >= SMALLEST:
            name = f"random levels, a new one every {f.length / count:.3g} s{f.moves(2.0)}"
            yield name, None, f.held(drawn)

    for cycles in (5, 20, 80):
        white = rng.standard_normal(2 * f.n)
        if cycles * SHORTEST <= f.n:
            kept = 1 / np.sqrt(1 + (np.fft.rfftfreq(2 * f.n) * f.n / cycles) ** 10)  # of Butterworth, order 5
            x = np.fft.irfft(np.fft.rfft(white) * kept)[f.n :]
            x = x / np.abs(x).max()
            yield f"filtered noise up to {f.hertz(cycles)}", min(1.0, f.rate / float(np.abs(np.diff(x)).max())), x


def _rest(f: _Frame) -> Iterator[Shape]:
    """Yield no motion at all."""
    yield f"rest at {with_unit(f.limits.centre, f.unit)} for {f.length:.3g} s", None, np.zeros(f.n)


SHAPES: tuple[Callable[[_Frame], Iterator[Shape]], ...] = (_triangles, _stairs, _sines, _fast_moves, _random, _rest)
