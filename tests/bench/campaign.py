"""Does the proposed experiment decide? Machines whose first record cannot tell effects apart, measured again as proposed.

    python tests/bench/campaign.py [--cases 40] [--seed 0] [--jobs 2] [--experiments 2] [--reach 1]

A machine of `truths` with one hidden effect is driven by a slow sine of one size. Where the verdict is `confused`, the
proposed input is run on the same machine, and both records are diagnosed together; so up to `--experiments` times.
`--reach 2` is a user whose actuator may go twice as far as in the first record. Right
is a case that ends `named` with what is hidden (or another id that `truths` accepts for it). What the first record
decides by itself is counted beside. Nothing is tuned.
"""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
import truths
from common import asked
from joblib import Parallel, delayed

import narx_sym as ns

Array = np.ndarray
KINDS = (
    "backlash", "dead_zone", "saturation", "cubic_gain", "asymmetric_gain", "hysteresis", "coulomb_friction",
    "hardening_spring", "quadratic_drag", "creep", "elastic_backlash", "maxwell_slip", "tanh_friction", "atan_saturation",
)  # fmt: skip
N, TS, NOISE, SIZE = 1500, 0.01, 0.01, (0.05, 0.2)
LEAD = 300  # samples in which the machine comes from rest to where an input begins


@dataclass
class Machine:
    """One machine with one hidden effect, at rest at zero before every record."""

    kind: str
    seed: int

    def __post_init__(self) -> None:
        label = f"campaign/{self.kind}"
        self.rng = truths._rng(self.seed, label, "noise")
        self.draw = truths._plant(truths._rng(self.seed, label, "plant"), (self.kind,), None, TS) | {"offset": 0.0}
        rng = truths._rng(self.seed, label, "input")
        self.amplitude = float(rng.uniform(1.0, 5.0))
        slow = rng.uniform(0.05, 0.3) / (2 * np.pi * self.draw["tau"])
        self.first = self.amplitude * np.sin(2 * np.pi * slow * np.arange(N) * TS)
        plant = self.driven(self.first)
        bare = plant.linear(plant.K * plant.fine)
        self.Y, self.V = float(np.std(bare)), float(np.std(np.diff(bare))) / plant.h
        target = float(np.exp(rng.uniform(*np.log(SIZE))))
        self.unit = self.effect(plant).unit
        alone = self.simulated(self.first, None)
        self.strength = truths._calibrate(
            lambda s: float(np.std(self.simulated(self.first, s) - alone) / np.std(alone)),
            target,
            self.effect(plant).start,
        )
        self.scale = float(np.std(self.simulated(self.first, self.strength)))

    def driven(self, u: Array) -> truths.Plant:
        """Return the plant under a held input."""
        fine = np.repeat(u, truths.FINER)[: (len(u) - 1) * truths.FINER + 1]
        plant = truths.Plant(**self.draw, h=TS / truths.FINER, held=True, u=u, fine=fine, channels={}, A=self.amplitude)
        plant.Y, plant.V, plant.S = (
            getattr(self, n, default) for n, default in (("Y", 1.0), ("V", 1.0), ("unit", 0.0))
        )
        return plant

    def effect(self, plant: truths.Plant) -> truths.Effect:
        """Return the hidden effect on a plant: the same for every input."""
        return truths._EFFECTS[self.kind](truths._rng(self.seed, f"campaign/{self.kind}", "effect"), plant)

    def simulated(self, u: Array, strength: float | None) -> Array:
        """Return the output without noise, from rest at zero to where the input begins and along it."""
        lead = u[0] * np.minimum(np.arange(LEAD) / (LEAD // 2), 1.0)
        plant = self.driven(np.concatenate([lead, u]))
        return truths._simulate(plant, [(self.effect(plant), strength)])[:: truths.FINER][LEAD:]

    def measured(self, u: Array, name: str) -> ns.Record:
        """Run an input and measure with noise."""
        y = self.simulated(u, self.strength)
        return ns.Record.from_arrays(u, y + NOISE * self.scale * self.rng.standard_normal(y.size), TS, name=name)


def told(kind: str, seed: int, experiments: int, reach: float) -> dict[str, Any] | None:
    """Run the campaign of one machine: the verdicts, and whether it ends right; None where its effect has no such size."""
    warnings.simplefilter("ignore")
    try:
        machine = Machine(kind, seed)
    except RuntimeError:  # no strength of the effect has the wanted size
        return None
    records = [machine.measured(machine.first, "first")]
    limits = (-reach * machine.amplitude, reach * machine.amplitude) if reach > 1 else None
    found = ns.diagnose(ns.identify(records[0], base="linear"), records, limits=limits)
    first, sets, accept = found.verdict, [list(found.confusion_set)], truths._ACCEPT[kind]
    for i in range(experiments):
        if found.verdict != "confused" or found.experiment is None:
            break
        records.append(machine.measured(np.asarray(found.experiment.u), f"experiment {i + 1}"))
        found = ns.diagnose(ns.identify(records, base="linear"), records, limits=limits)
        sets.append(list(found.confusion_set))
    names = set(found.confusion_set)
    if found.verdict == "named":
        end = "named, right" if names <= accept else "named, wrong"
    else:
        end = f"{found.verdict}, {'with' if names & accept else 'without'} the truth"
    held = "with" if set(sets[0]) & accept else "without"
    return {"kind": kind, "seed": seed, "sets": sets, "end": end, "first": first, "held": held}


def main() -> int:
    """Print each confused case as it ends, then how many end which way."""
    options = asked(__doc__, cases=40, seed=0, jobs=2, experiments=2, reach=1.0)
    ends, others = Counter[str](), Counter[str]()
    tried, confused = 0, 0
    drawn = ((kind, seed) for seed in count(options.seed) for kind in KINDS)
    run = Parallel(n_jobs=options.jobs, return_as="generator_unordered", pre_dispatch=options.jobs)
    for row in run(delayed(told)(kind, seed, options.experiments, options.reach) for kind, seed in drawn):
        tried += 1
        if row is None:
            continue
        if row["first"] != "confused":
            others[row["end"]] += 1
            continue
        confused += 1
        ends[row["end"]] += 1
        sets = " -> ".join(", ".join(names) or "-" for names in row["sets"])
        print(f"{row['kind']} {row['seed']} (truth {row['held']} at first): {sets}: {row['end']}", flush=True)
        if confused == options.cases:
            break
    print(f"\n{confused} of {tried} first records are confused. They end:")
    for end, n in ends.most_common():
        print(f"- {end}: {n}")
    print("The other ones, at once:", ", ".join(f"{end} {n}" for end, n in others.most_common()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
