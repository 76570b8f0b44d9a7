"""Models that remember, on the measured piezo stage and on a simulated one: `python tests/bench/memory.py [--parts piezo stage speed]`.

piezo: fitted on one full-range sine, judged on varying amplitudes with the offset of the other record estimated on its
first second; every linear model up to orders 3 and delays 3 in the same table. stage: ten plays, creep and a resonance
by SciPy's ODE solver, tracked with the law of the play base and with the linear inverse. speed: a free run of ten plays
against C by hand.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
import warnings
from itertools import product
from pathlib import Path

import numpy as np
from common import asked
from places import SHARED
from scipy.integrate import solve_ivp

import narx_sym as ns
from narx_sym.errors import FitError
from narx_sym.fit.bases.play import Shape
from narx_sym.fit.identify import operating_point
from narx_sym.symbolic.signals import k, u, y

ROWS = "| {:<38} | {:>6} | {:>8} | {:>8} | {:>8} |"


def piezo() -> None:
    """Print the table of the book: fitted on one record, judged on the other, all models alike."""
    folder = SHARED / "piezo_dbo"
    train = ns.read(folder / "train_1Hz_full_range.csv", rows=slice(20, None))
    test = ns.read(folder / "test_varying_amplitude.csv", rows=slice(20, 5000))
    print(ROWS.format("model", "values", "fit", "test", "aligned"))

    def shown(name: str, model: ns.Model) -> float:
        found = [ns.evaluate(model, *given).free_run_nrmse for given in ((train,), (test,), (test, True))]
        print(ROWS.format(name, len(model.symbols), *(f"{e:.4f}" for e in found)), flush=True)
        return found[-1]

    shown("narx --for-compensation", ns.identify(train, base="narx", for_compensation=True))
    shown("play with creep", ns.identify(train, base="play", creep=True))
    for base in ("play", "bouc-wen", "static", "linear"):
        shown(base, ns.identify(train, base=base))
    best, origin = (np.inf, ""), operating_point([train])
    for a, b, d in product(range(4), range(1, 4), range(4)):
        terms = [*(y[k - i] for i in range(1, a + 1)), *(u[k - d - j] for j in range(b)), 1]
        try:
            model = ns.NARX(terms, operating_point=origin).fit(train, method="auto")
        except FitError:
            continue
        best = min(best, (shown(f"linear, orders {a} and {b}, delay {d}", model), f"{a}, {b}, delay {d}"))
    print(f"The best of all linear models: {best[0]:.4f} ({best[1]})")


RADII = np.linspace(0.2, 2.0, 10)
WEIGHTS = np.array([0.30, 0.25, 0.2, 0.18, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05])
CREEP, SLOW, OMEGA, DAMPING, TS = 0.04, 2.0, 2 * np.pi * 60.0, 0.3, 0.005


def stage(volts: np.ndarray) -> np.ndarray:
    """A stage: plays by hand, creep 1/SLOW, a resonance at 60 Hz by an ODE solver; volts held over each sample [V]."""
    held, slow, state, out = np.full(RADII.size, volts[0]), 0.0, np.zeros(2), np.empty(volts.size)
    slow = state[0] = volts[0] * (1 + WEIGHTS.sum())
    state[0] *= 1 + CREEP
    for i, x in enumerate(volts):
        out[i] = state[0]
        held = np.maximum(x - RADII, np.minimum(x + RADII, held))
        force = x + WEIGHTS @ held

        def motion(_: float, s: np.ndarray, force: float = force) -> list[float]:
            drive = force + CREEP * s[2]
            acceleration = OMEGA**2 * (drive - s[0]) - 2 * DAMPING * OMEGA * s[1]
            return [s[1], acceleration, (force - s[2]) / SLOW]

        end = solve_ivp(motion, (0, TS), [*state, slow], rtol=1e-8, atol=1e-10).y[:, -1]
        state, slow = end[:2], end[2]
    return out


def turns(n: int, size: float, seed: int) -> np.ndarray:
    """Random turns every 0.3 s, smooth between them."""
    rng = np.random.default_rng(seed)
    raw = np.interp(
        np.arange(n), np.arange(0, n + 60, 60), rng.uniform(-size, size, n // 60 + 2)[: n // 60 + 1 + (n % 60 > 0)]
    )
    return np.convolve(np.concatenate([np.full(15, raw[0]), raw, np.full(15, raw[-1])]), np.hanning(31) / 15, "valid")


def tracked(name: str, model: ns.Model, reference: np.ndarray) -> None:
    """Print the tracking error of a law on the stage, and that without one."""
    law = model.compensator()
    gain = model.info.line[1] if model.info.line else 1.0
    m = law.run(reference, reference[0] / gain, clip=True)
    error = [np.sqrt(np.mean((stage(x) - reference)[400:] ** 2)) for x in (m, reference / gain)]
    print(
        f"{name:<28} rms error {error[0]:.4f}, without {error[1]:.4f}: {error[1] / error[0]:.1f} times better",
        flush=True,
    )


def simulated() -> None:
    """Print how the laws of the play base and of the linear base track on the simulated stage."""
    volts = turns(6000, 2.4, 1)
    record = ns.Record.from_arrays(volts, stage(volts), Ts=TS)
    size = 0.8 * np.abs(record.y).max()
    t = np.arange(2400) * TS
    wave = size * np.sin(2 * np.pi * 0.5 * t) * np.linspace(1, 0.2, t.size)
    for base in ("play", "linear"):
        model = ns.identify(record, base=base)
        print(base, model.info.nrmse)
        tracked(f"{base}, decaying sine", model, wave)
        fade = np.clip(np.minimum(np.arange(2000), np.arange(2000)[::-1]) / 150, 0, 1)  # from rest at zero and back
        history = np.concatenate([turns(2000, 0.6 * size, 5) * fade, wave[:1200]])
        tracked(f"{base}, after random turns", model, history)


def speed() -> None:
    """Print the time of a free run of ten plays over that of C by hand, in one process."""
    radii, weights = 0.09 * np.arange(1, 11), np.linspace(1, 0.1, 11)
    model = Shape(tuple(radii), (), 0).model({}, [0.7, *weights, 0.0])
    source = """#include <math.h>
void run(const double *u, double *y, const double *p, const double *r, double a, long n) {
  double z[10]; for (int j = 0; j < 10; j++) z[j] = u[0];
  y[0] = 0;
  for (long i = 1; i < n; i++) { double v = p[0] * u[i];
    for (int j = 0; j < 10; j++) { z[j] = fmax(u[i] - r[j], fmin(u[i] + r[j], z[j])); v += p[j + 1] * z[j]; }
    y[i] = a * y[i - 1] + (1 - a) * v; } }"""
    volts = np.ascontiguousarray(np.sin(np.arange(400_000) / 50) * np.cos(np.arange(400_000) / 777))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plays.c"
        file.write_text(source)
        command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", str(file), "-o", f"{folder}/plays.so", "-lm"]
        subprocess.run(command, check=True)
        by_hand = ctypes.CDLL(f"{folder}/plays.so").run
        out = np.empty(volts.size)
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (volts, out, weights, radii)]
        times: dict[str, list[float]] = {"package": [], "C": []}
        for _ in range(15):
            begin = time.perf_counter()
            run = model.simulate(volts, 0.0, warn=False)
            times["package"].append(time.perf_counter() - begin)
            begin = time.perf_counter()
            by_hand(*pointers, ctypes.c_double(0.7), ctypes.c_long(volts.size))
            times["C"].append(time.perf_counter() - begin)
    assert np.abs(run - out).max() < 1e-10
    best = {name: min(listed) for name, listed in times.items()}
    print(
        f"package {1e3 * best['package']:.2f} ms, C {1e3 * best['C']:.2f} ms: ratio {best['package'] / best['C']:.2f}"
    )


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    what = {"piezo": piezo, "stage": simulated, "speed": speed}
    for name in asked(__doc__, parts=list(what)).parts:
        what[name]()
