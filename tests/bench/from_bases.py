"""The bench test from any base: identify, diagnose, add what is named, and track with the law of what was made.

    python tests/bench/from_bases.py [--seeds 20] [--first 100] [--bases narx,linear,auto] [--samples 50000]

Each record is noise of the paper's kind, scaled to a peak of 75 V, on an actuator with Bouc-Wen hysteresis: half of the
records as they are drawn, half of those whose other peak is below 50 V. The law then drives the actuator along the
paper's sine of 40 V. Nothing is tuned.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import common
import numpy as np

import narx_sym as ns
from narx_sym import plants
from narx_sym.errors import NarxError

TS, TARGET, LOPSIDED = 1e-3, 0.025, 50.0  # [s], MAPE [%], smaller peak of an asymmetric record [V]
Array = np.ndarray


def excitation(seed: int, samples: int) -> Array:
    """Return noise of the paper's kind; of an odd seed with one peak below 50 V."""
    for i in range(1000):
        drawn = plants.filtered_noise(N=samples, Ts=TS, seed=1000 * seed + i)
        if seed % 2 == 0 or min(drawn.max(), -drawn.min()) < LOPSIDED:
            break
    return drawn


def tracked(seed: int, base: str, samples: int) -> tuple[int, str, str, float, str, int, float, float]:
    """Return what was named, and the tracking MAPE of the law."""
    begin = time.perf_counter()
    volts = excitation(seed, samples)
    record = ns.Record.from_arrays(volts, plants.bouc_wen(volts, TS), Ts=TS)
    sine = 40 * np.sin(2 * np.pi * TS * np.arange(10_000))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = ns.diagnose(ns.identify(record, base=base), record)
        model, error, said = found.model, float("nan"), ""
        try:
            law = model.compensator()
            error = ns.mape(sine, plants.bouc_wen(law.run(sine, 0.0), TS))
        except NarxError as problem:
            said = str(problem).split(".")[0]
    shown = found.verdict + " " + "+".join(found.steps[0].added)
    left = ns.evaluate(model, record).free_run_nrmse
    return seed, base, shown, error, f"{said} | {model!r}", len(model.symbols), left, time.perf_counter() - begin


def main() -> int:
    """Run, and print a line each."""
    asked = common.asked(__doc__, seeds=20, first=100, bases="narx,linear,auto", samples=50_000)
    calls: list[Any] = [
        (seed, base, asked.samples)
        for base in asked.bases.split(",")
        for seed in range(asked.first, asked.first + asked.seeds)
    ]
    reached: dict[str, list[float]] = {}
    for call in calls:
        seed, base, shown, error, model, size, left, seconds = tracked(*call)
        reached.setdefault(base, []).append(error)
        print(f"{base:7} {seed} {shown:40} {error:8.4f} {size:3} {left:.2e} {seconds:5.0f} s  {model}", flush=True)
    for base, errors in reached.items():
        kept = sum(e <= TARGET for e in errors)
        print(f"{base}: {kept} of {len(errors)}, median {np.nanmedian(errors):.4f}, largest {np.nanmax(errors):.4f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
