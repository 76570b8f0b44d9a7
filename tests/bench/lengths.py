"""Does more data tell more? Five machines with one hidden effect, of 200 to 200 000 samples: the name, and its interval.

    python tests/bench/lengths.py [--lengths 1000,5000] [--machines slack,limit]

Each machine is written here in NumPy and SciPy alone. *Width*: of the 95 % interval of the effect's shape parameter, as a
share of its true value, from the standard errors of the final fit.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from truths import play

import narx_sym as ns

Array = np.ndarray
LENGTHS = (200, 1000, 5000, 20_000, 50_000, 100_000, 200_000)


def wander(rng: np.random.Generator, n: int) -> Array:
    """Return a random walk without its slow part, of standard deviation 1."""
    made = sosfilt(butter(2, 0.002, "highpass", output="sos"), np.cumsum(rng.standard_normal(n + 1000)))[1000:]
    return np.asarray(made / made.std())


def smooth(rng: np.random.Generator, n: int) -> Array:
    """Return noise below a fiftieth of the sampling rate, of standard deviation 1."""
    made = sosfilt(butter(2, 0.04, output="sos"), rng.standard_normal(n + 1000))[1000:]
    return np.asarray(made / made.std())


def lag(x: Array, pole: float) -> Array:
    return np.asarray(lfilter([0.0, 1 - pole], [1.0, -pole], x))


MACHINES: dict[str, tuple[Callable[[np.random.Generator, int], Array], Callable[[Array], Array], set[str], float]] = {
    "slack": (wander, lambda u: lag(play(u, 0.3), 0.9), {"backlash"}, 0.3),
    "dead zone": (smooth, lambda u: lag(u - np.clip(u, -0.5, 0.5), 0.9), {"dead_zone"}, 0.5),
    "limit": (smooth, lambda u: lag(np.clip(u, -1.2, 1.2), 0.95), {"saturation"}, 1.2),
    "end stop": (smooth, lambda u: np.clip(lag(u, 0.9), -1.0, 1.0), {"output_limit"}, 1.0),
    "bend": (smooth, lambda u: lag(u + 0.15 * u**3, 0.9), {"cubic_gain"}, 0.15),
}


def main() -> None:
    """Print one line per machine and length."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lengths", default=",".join(map(str, LENGTHS)))
    parser.add_argument("--machines", default=",".join(MACHINES))
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| machine | samples | named | right | parameters | width | CPU s |\n|---|---|---|---|---|---|---|")
    for name in given.machines.split(","):
        drive, machine, right, true = MACHINES[name]
        for n in map(int, given.lengths.split(",")):
            rng = np.random.default_rng(5)
            u = drive(rng, n)
            y = machine(u)
            record = ns.Record.from_arrays(u, y + 0.01 * y.std() * rng.standard_normal(n), Ts=0.01)
            begin = time.process_time()
            found = ns.diagnose(ns.identify(record, base="linear"), record)
            took = time.process_time() - begin
            named = found.best.effect if found.candidates else found.verdict
            model, width = found.model, "-"
            if model.effects and model.standard_errors is not None:
                errors = dict(zip(model.symbols, model.standard_errors, strict=True))
                own = model.effects[-1].symbols
                at = own.get("r", own.get("s", own.get("c")))
                width = f"{2 * 1.96 * errors[at] / true:.2g}"
            sizes = (
                ", ".join(f"{p} {v:.4g}" for p, v in found.candidates[0].parameters.items()) if found.candidates else ""
            )
            ok = "yes" if named in right and found.verdict == "named" else found.verdict
            print(f"| {name} | {n} | {named} | {ok} | {sizes} | {width} | {took:.1f} |", flush=True)


if __name__ == "__main__":
    main()
