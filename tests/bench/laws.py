"""Tracking on the bench test with laws beyond Assumption A1, over many noise seeds.

    python tests/bench/laws.py [--seeds 20] [--jobs 2] [--out FILE.md]

The law of the physical Bouc-Wen model, by branches; then the same plant with a hidden effect of 5 % of the range, driven
by the law of the incomplete model and by that of the completed one. Excitations as in `paper_tables`: peaks spread over
70 ... 80 V, 50 000 samples. Nothing is tuned: fits run with their default settings, the physical model from two starts (from
b = c = 0 alone, where d does not matter, one seed of 20 stops elsewhere and says that it did not converge). About 8
minutes on two cores.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from common import asked, parallel, publish
from paper_tables import SINE, TS, N, direct, excitations, show
from scipy.optimize import brentq
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym import k, phi1, plants, u, y

NOISE = (0.0, 0.01)
TARGETS = {0.0: 0.02, 0.01: 0.03}
FALLS = 5.0
HALF, SHARE = 75.0, 0.05  # half of the input's range [V], and the share of the range that is hidden
TAU = 0.5  # of the fastest part of the creep [s]
Array = np.ndarray


def physical() -> ns.Model:
    """Return the physical Bouc-Wen model, before it is fitted."""
    a, b, c, d = sp.symbols("a b c d", real=True)
    memory = d * u[k - 1] - y[k - 1]
    F = y[k - 1] + a * phi1[k] + b * sp.Abs(phi1[k]) * memory + c * phi1[k] * sp.Abs(memory)
    return ns.Model(F, (a, b, c, d), [1, 0, 0, 2], Ts=TS)


def noisy(clean: Array, share: float, seed: int) -> Array:
    """Add white noise, in standard deviations of the output."""
    return clean + share * np.std(clean) * np.random.default_rng(1000 + seed).standard_normal(clean.size)


# -- the law of the physical model -----------------------------------------------------------------------------


def tracked(u_values: Array, y_values: Array, seed: int) -> list[tuple[float, float, bool]]:
    """Tracking MAPE, NSAVI and whether the check is good: free of noise, with noise, and from the paper's six terms."""
    found = []
    for share in NOISE:
        record = ns.Record.from_arrays(u_values, noisy(y_values, share, seed), TS)
        found.append(drive(physical().fit(record, method="free_run", starts=2)))
    record = ns.Record.from_arrays(u_values, y_values, TS)
    found.append(drive(direct().fit(record).add("hysteresis", "inside").fit(record)))
    return found


def drive(model: ns.Model) -> tuple[float, float, bool]:
    """Run the law on the plant."""
    law = model.compensator()
    volts = law.run(SINE, 0.0)
    return ns.mape(SINE, plants.bouc_wen(volts, TS)), ns.nsavi(volts, SINE), law.check().good


# -- hidden effects --------------------------------------------------------------------------------------------


def temperature(phase: float) -> Array:
    """A room over the 50 s of a record, from -1 to 1."""
    t = TS * np.arange(N)
    wave = np.sin(2 * np.pi * 0.07 * t + phase) + 0.3 * np.sin(2 * np.pi * 0.23 * t)
    return wave / 1.3


def relaxed(x: Array) -> Array:
    """The slow part of a creeping output: three filters (Kuhnen 2005)."""
    shares = np.exp(-TS / (TAU * 3.0 ** np.arange(3)))
    return np.mean([lfilter([1 - s], [1, -s], x) for s in shares], axis=0)


class Plant:
    """The bench test with one hidden effect of 5 % of the range."""

    def __init__(self, effect: str, u_values: Array, y_values: Array):
        self.effect = effect
        # The slack is 5 % of the input's range; a saturation takes that from it, half at each end.
        self.slack = SHARE * HALF
        self.knee = brentq(lambda s: s * np.tanh(HALF / s) - HALF * (1 - SHARE), 10, 1e4)
        spread = np.ptp(y_values)
        self.creep = SHARE * spread / np.ptp(relaxed(y_values))
        self.drift = SHARE * spread / 2

    def __call__(self, volts: Array, room: Array) -> Array:
        """Return the output."""
        if self.effect == "dead_zone":
            return plants.bouc_wen(volts - np.clip(volts, -self.slack, self.slack), TS)
        if self.effect == "saturation":
            return plants.bouc_wen(self.knee * np.tanh(volts / self.knee), TS)
        plain = plants.bouc_wen(volts, TS)
        if self.effect == "creep":
            return plain + self.creep * relaxed(plain)
        return plain + self.drift * room


HIDDEN = {
    "dead_zone": "dead zone", "saturation": "soft saturation", "creep": "creep", "channel:room": "temperature",
}  # fmt: skip


def completed(effect: str, u_values: Array, y_values: Array, share: float, seed: int) -> tuple[float, float, float]:
    """Tracking MAPE without a law, with the law of the incomplete model, and with that of the completed one."""
    plant = Plant(effect, u_values, y_values)
    known, coming = temperature(seed), temperature(seed + 2.0)
    record = ns.Record.from_arrays(
        u_values, noisy(plant(u_values, known), share, seed), TS, channels={"room": known} if "room" in effect else {}
    )
    incomplete = physical().fit(record, method="free_run", starts=2)
    found = [ns.mape(SINE, plant(SINE, coming))]
    for model in (incomplete, incomplete.add(effect).fit(record)):
        volts = model.compensator().run(SINE, 0.0, {"room": coming} if model.channels else {})
        found.append(ns.mape(SINE, plant(volts, coming)))
    return found[0], found[1], found[2]


# -- tables ----------------------------------------------------------------------------------------------------


def spread(values: Any) -> str:
    """Min / median / max as cells."""
    return " | ".join(show(float(f(values))) for f in (np.min, np.median, np.max))


def report(seeds: int, jobs: int) -> str:
    """Run everything and return the markdown."""
    inputs, outputs = excitations(np.linspace(70, 80, seeds))
    runs = np.array(
        parallel(tracked, [(inputs[:, i], outputs[:, i], i) for i in range(seeds)], jobs, "physical"), dtype=float
    )
    lines = [
        f"**The physical Bouc-Wen model, its law by branches: {seeds} seeds; the paper has 0.322 and 1.13**",
        "",
        "| identified from | tracking MAPE [%]: min | median | max | NSAVI: median | max | one solution everywhere | target |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for i, name in enumerate(("data without noise", "data with 1 % noise", "the six-term model, hysteresis added")):
        error, effort, good = runs[:, i].T
        most = TARGETS[NOISE[i] if i < 2 else 0.0]
        kept = "met" if np.median(error) <= most and np.median(effort) <= 1.15 else "missed"
        lines.append(
            f"| {name} | {spread(error)} | {np.median(effort):.4f} | {effort.max():.4f} | {int(good.sum())} of {seeds} "
            f"| <= {most:.2f}, 1.15: {kept} |"
        )
    lines += [
        "",
        f"**A hidden effect of 5 % of the range, {seeds} seeds: tracking MAPE [%] on the true plant**",
        "",
        "| hidden | noise | no law | law of the incomplete model: min | median | max | of the completed one: min | median "
        "| max | falls by (min) | (median) | target |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    calls = [
        (effect, inputs[:, i], outputs[:, i], share, i) for effect in HIDDEN for share in NOISE for i in range(seeds)
    ]
    found = np.array(parallel(completed, calls, jobs, "hidden effects")).reshape(len(HIDDEN), len(NOISE), seeds, 3)
    for row, name in zip(found, HIDDEN.values(), strict=True):
        for cells, share in zip(row, NOISE, strict=True):
            none, before, after = cells.T
            falls = before / after
            kept = "met" if falls.min() >= FALLS else "met by the median" if np.median(falls) >= FALLS else "missed"
            lines.append(
                f"| {name} | {share:.0%} | {np.median(none):.2f} | {spread(before)} | {spread(after)} | "
                f"{falls.min():.1f} | {np.median(falls):.1f} | >= {FALLS:.0f}: {kept} |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    options = asked(__doc__, seeds=20, jobs=2, out=Path)
    publish(report(options.seeds, options.jobs), options.out)
