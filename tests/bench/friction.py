"""How strong may a friction be that is found? Parts that rub, from hardly to nearly stuck.

    python tests/bench/friction.py [--seed 1] [--jobs 2] [--noise 0.005]
    python tests/bench/friction.py --sensors [--seed 1]

Five machines (a motor recorded as a speed and as a position, a position loop, a part on a spring, and one that is
overdamped), five inputs, and friction of nothing, 5, 15, 35 and 60 % of the largest force: 125 records of 3 000 samples
with 0.5 % noise, all defaults. "right": a friction is told first, or nothing where there is none; "kin": what such a part
is at low speed, or what a bent speed looks like, is told first (a slack or a loop beside a spring or in a loop, a dead
zone of a speed); "in the set": a friction is among those told.

With --sensors: how often is a part that rubs said to have a sensor that is cut off, or froze? Its positions have no noise,
or the steps of an encoder, where a part that is held stays at exactly one value. And how often are sensors that do it seen?
"""

from __future__ import annotations

import warnings
from collections import Counter
from typing import Any

import numpy as np
import truths
from common import asked, diagnosed
from joblib import Parallel, delayed
from scipy import signal

import narx_sym as ns
from narx_sym.data.sensor import sensor_faults

N, TS = 3000, 0.01
FRICTION = {"coulomb_friction", "stiction", "stribeck_friction"}
SPRING = {"backlash", "hysteresis"}
MACHINES: dict[str, tuple[dict[str, float], int, set[str]]] = {
    "speed": ({"m": 0.1, "b": 1.0, "k": 0.0}, 1, {"dead_zone"}),
    "position": ({"m": 0.1, "b": 1.0, "k": 0.0}, 0, set()),
    "loop": ({"m": 0.02, "b": 0.1, "k": 0.0, "kp": 4.0, "kd": 0.5}, 0, SPRING),
    "spring": ({"m": 0.02, "b": 0.3, "k": 1.5}, 0, SPRING),
    "overdamped": ({"m": 0.002, "b": 0.3, "k": 1.0}, 0, SPRING),
}
INPUTS = ("smooth", "levels", "triangle", "sines", "chirp")
SIZES = (0.0, 0.05, 0.15, 0.35, 0.6)


def driven(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Return an input within one, (N,)."""
    t = np.arange(N) * TS
    if kind == "smooth":
        x = signal.lfilter(*signal.butter(3, 0.04), rng.standard_normal(N + 500))[500:]
        return x / np.abs(x).max()
    if kind == "levels":
        return np.repeat(rng.uniform(-1, 1, N // 75), 75)
    if kind == "triangle":
        return signal.sawtooth(0.4 * np.pi * t + np.pi / 2, 0.5) * (0.4 + 0.6 * t / t[-1])
    if kind == "sines":
        return 0.6 * np.sin(0.5 * np.pi * t) + 0.4 * np.sin(1.66 * np.pi * t + 1)
    return signal.chirp(t, 0.1, t[-1], 4)


def judged(machine: str, kind: str, F: float, seed: int, noise: float) -> dict[str, Any]:
    """Diagnose one machine and judge what is told."""
    warnings.simplefilter("ignore")
    values, column, kin = MACHINES[machine]
    rng = np.random.default_rng(seed)
    u = driven(kind, rng)
    y = truths.rubbing(u, TS, F=F, **values)[:, column]
    y = y + noise * y.std() * rng.standard_normal(N)
    found = diagnosed(ns.Record.from_arrays(u, y, TS))
    told = found.confusion_set
    first = set(told[:1])
    if F:
        says = (
            "right" if first & FRICTION else "kin" if first & kin else "in the set" if FRICTION & set(told) else "not"
        )
        says = says if told else "nothing named"
    else:
        says = "false" if told else "right"
    errors = [step["validation"] for step in found.ladder]
    return {
        "machine": machine,
        "input": kind,
        "F": F,
        "says": says,
        "verdict": found.verdict,
        "told": told,
        "errors": errors,
    }


def sensors(seed: int) -> None:
    """Count false words about the sensor of parts that rub, and what is seen of sensors that are cut off, or froze."""
    counts: Counter[tuple[str, str]] = Counter()
    records: Counter[tuple[str, str]] = Counter()

    def asked(of: str, word: str, u: np.ndarray, y: np.ndarray) -> None:
        records[of, word] += 1
        counts[of, word] += word in {f.effect for f in sensor_faults([ns.Record.from_arrays(u, y, TS)], 0.0)}

    for machine, kind, F in ((m, i, F) for m in MACHINES for i in INPUTS for F in SIZES if m != "speed"):
        rng = np.random.default_rng(seed)
        u = driven(kind, rng)
        y = truths.rubbing(u, TS, F=F, **MACHINES[machine][0])[:, 0]
        for step in (y.std() * s for s in (0.0, 0.002, 0.02, 0.1)):
            seen = step * np.round(y / step) if step else y
            for word in ("sensor_saturation", "frozen_sensor") if F else ():
                asked("parts that rub", word, u, seen)
            if kind != "levels" and not F:
                asked("cut off", "sensor_saturation", u, np.minimum(seen, 0.8 * y.max()))
            frozen = seen.copy()
            frozen[N // 3 : N // 2] = frozen[N // 3]
            asked("frozen, no friction" if not F else "frozen, friction", "frozen_sensor", u, frozen)
    for (of, word), n in sorted(counts.items()):
        print(f"{of}: {word} {n} of {records[of, word]}")


def main() -> None:
    """Run all machines and print what was told, and counts."""
    given = asked(__doc__, seed=1, jobs=2, noise=0.005, sensors=False)
    if given.sensors:
        return sensors(given.seed)
    cases = [(m, i, F) for m in MACHINES for i in INPUTS for F in SIZES]
    run = (delayed(judged)(*case, given.seed, given.noise) for case in cases)
    counts: Counter[tuple[float, str]] = Counter()
    for r in Parallel(given.jobs, return_as="generator")(run):
        counts[r["F"], r["says"]] += 1
        errors = " -> ".join(f"{e:.2g}" for e in r["errors"])
        print(
            f"{r['says']:14}{r['machine']:12}{r['input']:10}{r['F']:<6g}{r['verdict']:22}{', '.join(r['told'])}  {errors}",
            flush=True,
        )
    for F in SIZES:
        print(f"F = {F:g}: " + ", ".join(f"{n} {says}" for (size, says), n in sorted(counts.items()) if size == F))


if __name__ == "__main__":
    main()
