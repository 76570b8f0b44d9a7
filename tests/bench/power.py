"""Whether an effect is seen at the size that the diagnosis promises: of 100 records with it, about 80 should show it.

    python tests/bench/power.py [--records 20] [--seed 400] [--samples 1500] [--times 1.0] [--effects backlash ...]

Each machine of `truths` is diagnosed with next to nothing hidden; what it prints as the smallest size that would be seen is then
hidden in the same machine, with other noise, and diagnosed again. Seen is what is not called "nothing_detectable". Nothing is tuned.
"""

from __future__ import annotations

import warnings
from statistics import median

import numpy as np
import truths
from common import asked, diagnosed

import narx_sym as ns

EFFECTS = (
    "backlash", "coulomb_friction", "dead_zone", "saturation", "hysteresis", "hardening_spring", "quadratic_gain", "drift",
)  # fmt: skip
NOTHING, LEVEL = 1e-4, 0.01  # of the output's standard deviation: what is hidden at first, and the noise


def machine(kind: str, seed: int, size: float, samples: int, other: int) -> ns.Record:
    """Return the record of a machine with a hidden effect of a size (of the linear output); `other` draws its noise."""
    kept, truths.SIZE = truths.SIZE, (size, size)
    try:
        made = truths.case("in", kind, seed, level=1e-9, N=samples)
    finally:
        truths.SIZE = kept
    noise = LEVEL * float(np.std(made.y)) * np.random.default_rng([seed, other]).standard_normal(samples)
    return ns.Record.from_arrays(made.u, made.y + noise, made.Ts)


def seen(kind: str, seed: int, samples: int, times: float) -> tuple[float, str, bool] | None:
    """Return the promised size (of the output's standard deviation), the verdict at `times` of it, whether it is in the set.

    None where nothing is promised, or the machine without the effect is not "nothing_detectable".
    """
    empty = machine(kind, seed, NOTHING, samples, 0)
    first = diagnosed(empty, channels=[]).steps[0]
    promised = first.smallest_detectable.get(kind)
    if promised is None or kind in first.absorbed or first.verdict != "nothing_detectable":
        return None
    size = promised / float(np.std(empty.y))
    try:
        found = diagnosed(machine(kind, seed, times * size, samples, 1), channels=[])
    except RuntimeError:  # no strength of the effect moves the output so much
        return None
    return size, found.verdict, kind in found.confusion_set


def main() -> int:
    """Print, per effect, the promised size and the share of records that show it."""
    options = asked(__doc__, records=20, seed=400, samples=1500, times=1.0, effects=EFFECTS)
    warnings.simplefilter("ignore")
    every: list[bool] = []
    print("| effect | records | promised, median | seen | in the set |\n|---|---|---|---|---|")
    for kind in options.effects:
        tried = [seen(kind, options.seed + i, options.samples, options.times) for i in range(options.records)]
        told = [t for t in tried if t is not None]
        shown = [verdict != "nothing_detectable" for _, verdict, _ in told]
        every += shown
        if told:
            size = f"{100 * median(s for s, _, _ in told):.2g} %"
            print(f"| {kind} | {len(told)} | {size} | {sum(shown)} | {sum(s for _, _, s in told)} |", flush=True)
    print(
        f"\nSeen: {sum(every)} of {len(every)} ({100 * np.mean(every):.0f} %) at {options.times:g} times the promised size."
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
