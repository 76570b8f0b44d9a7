"""What a record says before any model, against simulated plants: dead times, feedback, noise.

    python tests/bench/evidence.py dead_time [--seed 0] [--plants 25]

Plants of first and second order and resonant ones, with time constants of 1 to 30 samples; noise of 1 % on the output.
Nothing here comes from the package but what is asked.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import lfilter

from narx_sym.data.evidence.dead_time import dead_time
from narx_sym.data.record import Record

Array = np.ndarray
N, TS = 2000, 0.1
INPUTS = ("steps", "two levels", "noise", "multisine")


def driven(kind: str, rng: np.random.Generator, n: int = N) -> Array:
    """Return an input: random steps, two levels, coloured noise, or a multisine below a tenth of the sampling rate."""
    if kind == "noise":
        return lfilter([1], [1, -rng.uniform(0, 0.9)], rng.standard_normal(n))
    if kind == "multisine":
        lines = np.arange(1, int(rng.integers(n // 100, n // 10)))
        waves = np.sin(2 * np.pi * np.outer(np.arange(n), lines) / n + rng.uniform(0, 6.28, lines.size))
        return waves.sum(axis=1) / np.sqrt(lines.size)
    hold = int(rng.integers(3, 40))
    count = n // hold + 1
    levels = rng.choice([-1.0, 1.0], count) if kind == "two levels" else rng.uniform(-1, 1, count)
    return np.repeat(levels, hold)[:n]


def plant(rng: np.random.Generator) -> tuple[str, Array, Array]:
    """Return the name of a plant, its numerator and its denominator."""
    slow = [np.exp(-1 / tau) for tau in np.exp(rng.uniform(0, np.log(30), 2))]
    kind = ("first order", "second order", "resonant")[rng.integers(3)]
    if kind == "resonant":
        frequency, damping = rng.uniform(0.1, 0.8), rng.uniform(0.2, 0.8)
        pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * frequency)
        denominator = np.real(np.poly([pole, np.conj(pole)]))
        return kind, denominator.sum() * np.array([0.6, 0.4]), denominator
    denominator = np.real(np.poly(slow[: 1 + (kind == "second order")]))
    return kind, np.array([denominator.sum()]), denominator


def delayed(u: Array, d: int, rng: np.random.Generator, noise: float = 0.01) -> tuple[str, Record]:
    """Return a record of a random plant with a dead time of d samples."""
    kind, numerator, denominator = plant(rng)
    y = lfilter(numerator, denominator, np.concatenate([np.zeros(d), u[: u.size - d]]))
    return kind, Record.from_arrays(u, y + noise * np.std(y) * rng.standard_normal(u.size), Ts=TS)


def dead_times(seed: int, plants: int) -> None:
    """Count the dead times of 0 to 60 samples that are found exactly."""
    rng = np.random.default_rng(seed)
    right: Counter[str] = Counter()
    asked: Counter[str] = Counter()
    begin = time.process_time()
    for _ in range(plants):
        d = int(rng.integers(0, 61))
        for source in INPUTS:
            kind, record = delayed(driven(source, rng), d, rng)
            found = dead_time([record])
            for name in (source, kind, "all"):
                asked[name] += 1
                right[name] += found.samples == d
            if found.samples != d:
                print(f"{source}, {kind}: {d} samples, found {found.samples}, or {found.among}", flush=True)
    for name in asked:
        print(f"| {name} | {right[name]} of {asked[name]} |")
    print(f"{(time.process_time() - begin) / asked['all']:.2f} s each")


PARTS: dict[str, Callable[[int, int], Any]] = {"dead_time": dead_times}


def main() -> int:
    """Run one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=list(PARTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plants", type=int, default=25)
    options = parser.parse_args()
    PARTS[options.part](options.seed, options.plants)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
