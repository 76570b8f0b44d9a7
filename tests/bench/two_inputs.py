"""Machines with two inputs: is nothing named where nothing is hidden, and what is hidden named first?

    nice python tests/bench/two_inputs.py [--seed 100] [--cases 40] [--groups linear,hidden] [--kinds a,b] [--jobs 2]

Each machine is simulated by NumPy alone (N = 1500) and goes the way of a user: `identify(record, base="linear")`, then
`diagnose`, all defaults. Each input has its own excitation, unit, gain, time constant and dead time (1 to 24 samples); half of
the machines have a lag in common too. Noise is 0.5 to 2 % of the output. What is hidden adds 6 to 25 % to the output (a
tank's inflow goes down by 60 to 95 %). *Visible*: the base leaves at least half the noise power beside the noise, as in
`battery.py`; shares of hidden effects are of visible ones. Beside, where it is installed, stands SysIdentPy: forward regression
with BIC among three older outputs and the lags 1 ... 30 of both inputs, free run.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import warnings
from collections import Counter
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from scipy.signal import butter, lfilter

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parent)]

import common  # noqa: E402
import truths  # noqa: E402

import narx_sym as ns  # noqa: E402

N, TS, FINER = 1500, 0.01, 20
Array = np.ndarray
AT_INPUT = ("backlash", "dead_zone", "saturation", "quadratic_gain", "asymmetric_gain")
INNER = ("coulomb_friction", "sqrt_outflow", "end_stop", "quadratic_drag", "creep")


def lag(x: Array, pole: float) -> Array:
    """Return a signal behind a lag of gain 1, held between the samples: y[k] has x[k-1]."""
    return lfilter([0.0, 1 - pole], [1.0, -pole], x)


def late(x: Array, samples: int) -> Array:
    """Return a signal so many samples later; before it is what it begins with."""
    return np.concatenate([np.full(samples, x[0]), x])[: x.size]


def driven(rng: np.random.Generator) -> Array:
    """Return an input within one: levels that are held, or smooth noise, each at its own pace."""
    if rng.random() < 0.5:
        x = np.repeat(rng.uniform(-1, 1, N), rng.integers(8, 50))[:N]
    else:
        x = lfilter(*butter(3, rng.uniform(0.01, 0.06)), rng.standard_normal(N + 1000))[1000:]
    return x / np.abs(x).max()


def play(x: Array, r: float) -> Array:
    """Return what a slack of half width r lets through."""
    out, w = np.empty(x.size), 0.0
    for i, value in enumerate(x.tolist()):
        w = min(max(w, value - r), value + r)
        out[i] = w
    return out


def bent(kind: str, x: Array, size: float) -> Array:
    """Return what an effect of some size makes of an input within one."""
    if kind == "backlash":
        return play(x, size)
    if kind == "dead_zone":
        return np.sign(x) * np.maximum(np.abs(x) - size, 0.0)
    if kind == "saturation":
        return np.clip(x, size - 1, 1 - size)
    return x + size * (x**2 if kind == "quadratic_gain" else np.abs(x))


def inner(kind: str, force: Array, size: float, draw: Array) -> Array:
    """Return the output of a machine whose effect is inside or at the output, driven by a force."""
    if kind in ("coulomb_friction", "quadratic_drag"):
        k, b = 1.0, 0.15 + 0.2 * draw[0]
        m = b**2 * (0.1 + 0.5 * draw[1])
        if kind == "coulomb_friction":
            return truths.rubbing(force, TS, m=m, b=b, k=k, F=size)[:, 0]
        return _stepped(force, lambda x, v, f: (v, (f - k * x - b * v - 3 * size * b * abs(v) * v) / m))
    if kind == "sqrt_outflow":  # a tank, whose inflow is never empty
        rate, inflow = 0.1 + 0.2 * draw[0], 1 + (0.6 + 0.35 * draw[1]) * force / np.abs(force).max()
        return _stepped(inflow, lambda h, _, f: (0.5 / rate * (f - max(h, 0.0) ** 0.5), 0.0), 1.0)
    if kind == "end_stop":
        tau = 0.05 + 0.15 * draw[0]
        free = lag(force, np.exp(-TS / tau))
        most = np.quantile(free, 1 - 0.6 * size)
        return _stepped(force, lambda x, _, f: ((f - x) / tau, 0.0), most=most)
    y = lag(force, 0.6 + 0.3 * draw[0])
    return y + size * sum(lag(y, np.exp(-TS / tau)) for tau in (1.0, 3.0, 9.0))  # creep


def _stepped(force: Array, slope: Any, first: float = 0.0, most: float = np.inf) -> Array:
    """Return x of x' and v', `FINER` steps per sample, the force held; x goes no farther than `most`."""
    x, v, out = first, 0.0, []
    for f in force.tolist():
        out.append(x)
        for _ in range(FINER):
            dx, dv = slope(x, v, f)
            v += TS / FINER * dv
            x = min(x + TS / FINER * (v if dv else dx), most)
    return np.array(out)


def machine(kind: str, at: int, seed: int) -> dict[str, Any]:
    """Return the inputs, the output and the noise of a machine."""
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    inputs = [driven(rng) for _ in range(2)]
    units, gains = 10 ** rng.uniform(-1, 1, 2), rng.uniform(0.5, 1.5, 2) * rng.choice([-1, 1], 2)
    poles, dead, common = rng.uniform(0.7, 0.96, 2), rng.integers(1, 25, 2), rng.choice([0.0, rng.uniform(0.6, 0.9)])
    draw, wanted, noise = rng.random(2), np.exp(rng.uniform(*np.log([0.06, 0.25]))), rng.uniform(0.005, 0.02)

    def output(size: float) -> Array:
        seen = [bent(kind, x, size) if kind in AT_INPUT and i == at else x for i, x in enumerate(inputs)]
        parts = [g * late(x, d - 1) for g, x, d in zip(gains, seen, dead, strict=True)]
        if kind in INNER:  # one machine that both inputs act on
            return inner(kind, parts[0] + parts[1], size, draw)
        return lag(sum(lag(x, p) for x, p in zip(parts, poles, strict=True)), common)

    low, high, plain = 1e-3, 0.9, output(1e-9)
    size = low
    for _ in range(0 if kind in ("linear", "sqrt_outflow") else 12):  # what an effect adds grows with its size
        size = (low * high) ** 0.5
        added = np.std(output(size) - plain) / np.std(plain)
        low, high = (size, high) if added < wanted else (low, size)
    clean = plain if kind == "linear" else output(size)
    scale = 10 ** rng.uniform(-1, 1)
    y = scale * (clean + noise * clean.std() * rng.standard_normal(N))
    return {"u": units[0] * inputs[0], "u2": units[1] * inputs[1], "y": y, "noise": noise}


def beside(made: dict[str, Any]) -> float:
    """Return the free-run NRMSE of SysIdentPy's linear model, as it is meant to be used; NaN where it is not installed."""
    try:
        from sysidentpy.basis_function import Polynomial
        from sysidentpy.model_structure_selection import FROLS
        from sysidentpy.parameter_estimation import LeastSquares
    except ImportError:
        return np.nan
    X, y, lags = np.column_stack([made["u"], made["u2"]]), made["y"][:, None], [*range(1, 31)]
    chooser = FROLS(
        order_selection=True, n_info_values=20, ylag=3, xlag=[lags, lags], info_criteria="bic",
        estimator=LeastSquares(), basis_function=Polynomial(degree=1),
    )  # fmt: skip
    left = (chooser.fit(X=X, y=y).predict(X=X, y=y) - y)[max(lags) :]
    return float(np.sqrt(np.mean(left**2)) / np.std(y))


def judged(kind: str, at: int, seed: int) -> dict[str, Any]:
    """Identify and diagnose one machine."""
    warnings.simplefilter("ignore")
    made, begin = machine(kind, at, seed), perf_counter()
    record = ns.Record.from_arrays(made["u"], made["y"], TS, channels={"u2": made["u2"]}, roles={"u2": "input"})
    row = {"kind": kind, "at": at, "seed": seed, "noise": made["noise"], "beside": beside(made)}
    try:
        base = ns.identify(record, base="linear")
        error = ns.evaluate(base, record).free_run_nrmse
        found = ns.diagnose(base, record)
    except Exception as failed:
        return row | {"failed": f"{type(failed).__name__}: {failed}", "first": "", "error": np.nan, "told": []}
    first = found.steps[0].candidates[:1] if found.confusion_set else []
    return row | {
        "error": error, "told": found.confusion_set, "first": first[0].effect if first else "",
        "place": str(first[0].variant) if first else "", "after": found.ladder[-1]["train"], "verdict": found.verdict,
        "seconds": perf_counter() - begin,
    }  # fmt: skip


def main() -> None:
    """Run all machines; print each, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--cases", type=int, default=40, help="of each group")
    parser.add_argument("--groups", default="linear,hidden")
    parser.add_argument("--kinds", default="", help="only these of the hidden effects")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    kinds = [n for pair in zip(AT_INPUT, INNER, strict=True) for n in pair]
    cases = [("linear", 0, given.seed + i) for i in range(given.cases)] if "linear" in given.groups else []
    if "hidden" in given.groups:
        cases += [(kinds[i % 10], i // 10 % 2, given.seed + i // 10) for i in range(given.cases)]
    cases = [c for c in cases if not given.kinds or c[0] in given.kinds.split(",")]
    counts: Counter[tuple[str, str]] = Counter()
    for r in Parallel(given.jobs, return_as="generator_unordered")(delayed(judged)(*case) for case in cases):
        group = "linear" if r["kind"] == "linear" else "hidden"
        place = int("u2" in r.get("place", ""))
        counts[group, "visible"] += (visible := group == "linear" or not r["error"] ** 2 < 1.5 * r["noise"] ** 2)
        right = r["first"] == ("" if group == "linear" else r["kind"]) and "failed" not in r
        counts[group, "cases"] += 1
        counts[group, "right, of the visible"] += right and visible
        counts[group, "and at the right input"] += right and visible and (r["kind"] in INNER or place == r["at"])
        counts[group, "within 1.1 of the noise"] += bool(r["error"] < 1.1 * r["noise"])
        counts[group, "SysIdentPy within 1.1 of the noise"] += bool(r["beside"] < 1.1 * r["noise"])
        print(
            f"{common.mark(right, visible):6}{r['kind']:17}{'u u2'.split()[r['at']]:3} {r['seed']:<5}noise {r['noise']:.4f} "
            f"(SysIdentPy {r['beside']:.4f}) base {r['error']:.4f} -> {r.get('after', np.nan):.4f} {r.get('verdict', r.get('failed'))}: "
            f"{', '.join(r['told'])} | {r.get('place', '')} {r.get('seconds', 0):.0f} s",
            flush=True,
        )
    common.print_counts(counts)


if __name__ == "__main__":
    main()
