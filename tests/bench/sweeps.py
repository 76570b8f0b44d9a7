"""The sweeps of the paper over many noise seeds: sampling time (P10), loop shapes (P11), the valve (V2).

    python tests/bench/sweeps.py [--seeds 10] [--jobs 2] [--out FILE.md] [--only time shapes valve]

Constrained least squares on the paper's structures, as in the derivations P10, P11 and V2, which show one or two seeds.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from common import asked, publish
from paper import VALVE, VALVE_INVERSE
from paper_tables import TS, N, direct, inverse

from narx_sym import NARX, Record, evaluate, mape, nsavi, plants, pool, select
from narx_sym.errors import Diverged
from narx_sym.files.parallel import sweep
from narx_sym.models.assumptions import COMPENSATION, CONTINUUM

STEPS = (1, 2, 5, 10, 15, 20, 25, 30, 40, 50)  # [ms]
BETA = np.linspace(0.004, 0.1, 49)
LEADS = (0.5, 1.0, 2.0, 4.0, 8.0)  # values of the valve model's theta_3
PAPER_VALVE = {"model": (3.926, 2.374), "tracking": (5.514, 2.939), "NSAVI": (1.81, 1.61), "none": 18.602}
Array = np.ndarray


def run(model: NARX, reference: Array, m0: float) -> tuple[Array | None, Any]:
    """Run a model's law in silence: its input and excursion, or None where it runs away."""
    law = model.compensator()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            m = law.run(reference, m0=m0)
        except Diverged:
            return None, None
    return m, law.internal.along(m, reference, m0=m0)


# -- P10 -------------------------------------------------------------------------------------------------------


def at_sampling_time(seed: int, step: int) -> list[float]:
    """Model and tracking MAPE of both strategies, and the uncompensated MAPE; infinite where a run diverges."""
    volts = plants.filtered_noise(N, TS, peak=75.0, seed=seed)
    Ts = TS * step
    record = Record.from_arrays(volts[::step], plants.bouc_wen(volts, TS)[::step], Ts)
    r = 40 * np.sin(2 * np.pi * Ts * np.arange(N // step))
    plain = plants.bouc_wen(r, Ts, substeps=step)
    found = []
    for model in (direct().fit(record), inverse().fit(record)):
        m, _ = run(model, r, 0.0)
        tracked = np.inf if m is None else mape(r, plants.bouc_wen(m, Ts, substeps=step))
        found += [evaluate(model, Record.from_arrays(r, plain, Ts)).free_run_mape, tracked]
    return [*found, mape(r, plain)]


def time_table(seeds: int, jobs: int) -> list[str]:
    """P10: medians over the seeds."""
    calls = [(seed, step) for step in STEPS for seed in range(seeds)]
    errors = np.array(sweep(at_sampling_time, calls, "sampling times", jobs)).reshape(len(STEPS), seeds, 5)
    lines = [
        f"**P10: MAPE [%] against the sampling time, median of {seeds} seeds**",
        "",
        "| T_s [ms] | model M | tracking 1 | inverse | tracking 2 | uncompensated | runs away, law 1 / 2 |",
        "|---|---|---|---|---|---|---|",
    ]
    for step, values in zip(STEPS, errors, strict=True):
        shown = " | ".join(f"{x:.2f}" if np.isfinite(x) else "diverged" for x in np.median(values, axis=0))
        lost = np.sum(~np.isfinite(values), axis=0)
        lines.append(f"| {step} | {shown} | {lost[1]} / {lost[3]} of {seeds} |")
    return [*lines, ""]


# -- P11 -------------------------------------------------------------------------------------------------------


def one_shape(volts: Array, microns: Array, answer: Array, reference: Array) -> list[Any]:
    """(model MAPE, law's input, share repelling) of both strategies, and whether ERR picks the paper's regressors."""
    record, validation = Record.from_arrays(volts, microns, TS), Record.from_arrays(reference, answer, TS)
    found: list[Any] = []
    for model in (direct().fit(record), inverse().fit(record)):
        m, visit = run(model, reference, 0.0)
        found.append((evaluate(model, validation).free_run_mape, m, visit.share if visit else np.nan))
    candidates = pool(n_y=1, n_u=2, degree=3, delay=1, rules=(*CONTINUUM, *COMPENSATION))
    picks = select(candidates, record, n_terms=5).picks[:5]
    return [*found, set(picks) == set(direct().terms[1:])]


def shape_table(seeds: int, jobs: int) -> list[str]:
    """P11: 49 loops for each seed."""
    reference = 40 * np.sin(2 * np.pi * TS * np.arange(10_000))
    every = np.repeat(reference[:, None], BETA.size, axis=1)
    plain = plants.bouc_wen(every, TS, beta=BETA)
    none = np.array([mape(reference, x) for x in plain.T])
    errors, picked, shares = [], [], []
    for seed in range(seeds):
        volts = plants.filtered_noise(N, TS, peak=75.0, seed=seed)
        recorded = plants.bouc_wen(np.repeat(volts[:, None], BETA.size, axis=1), TS, beta=BETA)
        calls = [(volts, y, x, reference) for y, x in zip(recorded.T, plain.T, strict=True)]
        found = sweep(one_shape, calls, f"loop shapes, seed {seed}", jobs)
        rows = []
        for i in (0, 1):
            lost = [one[i][1] is None for one in found]
            inputs = np.column_stack([reference if one[i][1] is None else one[i][1] for one in found])
            outputs = plants.bouc_wen(inputs, TS, beta=BETA)
            rows.append([np.inf if gone else mape(reference, x) for gone, x in zip(lost, outputs.T, strict=True)])
        errors.append(rows)
        picked.append([one[2] for one in found])
        shares.append([one[0][2] for one in found])
    tracking = np.array(errors)  # (seeds, 2, 49)
    lines = [
        f"**P11: tracking MAPE [%] for beta = 0.004 ... 0.1, median and max of {seeds} seeds**",
        "",
        "| beta | uncompensated | strategy 1 | strategy 2 | law 1 repels (share of the run) | ERR picks M |",
        "|---|---|---|---|---|---|",
    ]
    for j in range(BETA.size):
        middle, worst = np.median(tracking[:, :, j], axis=0), tracking[:, :, j].max(axis=0)
        cells = " | ".join(f"{a:.3f} ({b:.3f})" for a, b in zip(middle, worst, strict=True))
        share = np.median([s[j] for s in shares])
        lines.append(
            f"| {BETA[j]:.3f} | {none[j]:.3f} | {cells} | {100 * share:.0f} % | "
            f"{sum(p[j] for p in picked)} of {seeds} |"
        )
    below = np.sum(tracking < none, axis=2)
    said = ", ".join(f"strategy {i + 1}: {below[:, i].min()} of 49 in the worst seed" for i in (0, 1))
    return [*lines, "", f"Compensated below uncompensated: {said}.", ""]


# -- V2 --------------------------------------------------------------------------------------------------------


def valve_seed(seed: int) -> list[float]:
    """Model, tracking, NSAVI of both strategies, mean eigenvalues of the laws of the best and of the chosen fit."""
    t = 0.01 * np.arange(20_000)
    reference = 0.56 * np.sin(0.2 * np.pi * t) + 3
    rng = np.random.default_rng(seed)

    def measured(volts: Array) -> Record:
        return Record.from_arrays(volts, plants.valve(volts) + 0.003 * rng.standard_normal(t.size), 0.01)

    record = measured(3 + plants.filtered_noise(t.size, 0.01, cutoff=0.1, peak=1.0, seed=seed))
    validation = measured(reference)
    found = {}
    for value in (None, *LEADS):
        model = VALVE.model()
        extra = [] if value is None else [sp.Eq(model.symbols[2], value)]
        model = model.fit(record, [sp.Eq(model.symbols[0], 1), *extra], method="free_run")
        found[value] = (model.compensator().internal.along(record.u, record.y).rate, model)
    rate, chosen = min((found[value] for value in LEADS), key=lambda pair: pair[0])
    c = float(chosen.theta[3])
    second = VALVE_INVERSE.model([1, 1, 0, 0, c, -c])
    second = second.fit(record.smoothed(1.0), ["continuum"], method="free_run")
    row = []
    for model, held in ((chosen, validation), (second, validation.smoothed(1.0))):
        m, _ = run(model, reference, 3.0)
        row.append(evaluate(model, held).free_run_mape)
        row += [np.inf, np.inf] if m is None else [mape(reference, plants.valve(m)), nsavi(m, reference)]
    return [*row, found[None][0], rate, mape(reference, plants.valve(reference))]


def valve_table(seeds: int, jobs: int) -> list[str]:
    """V2: Tables 4 and 5 as behaviour."""
    found = np.array(sweep(valve_seed, [(seed,) for seed in range(seeds)], "valve", jobs))
    lines = [
        f"**V2: a physical valve, {seeds} noise seeds, beside Tables 4 and 5**",
        "",
        "| | min | median | max | paper |",
        "|---|---|---|---|---|",
    ]
    names = [
        (f"{what}, strategy {i}", PAPER_VALVE[what][i - 1]) for i in (1, 2) for what in ("model", "tracking", "NSAVI")
    ]
    names += [("mean eigenvalue, law of the best fit", ""), ("mean eigenvalue, law chosen", "")]
    names.append(("uncompensated", PAPER_VALVE["none"]))
    for (name, paper), values in zip(names, found.T, strict=True):
        lines.append(f"| {name} | {values.min():.2f} | {np.median(values):.2f} | {values.max():.2f} | {paper} |")
    return [*lines, ""]


TABLES = {"time": time_table, "shapes": shape_table, "valve": valve_table}


def main() -> None:
    """Read the options and print the tables."""
    options = asked(__doc__, seeds=10, jobs=2, only=list(TABLES), out=Path)
    lines = [line for name in options.only for line in TABLES[name](options.seeds, options.jobs)]
    publish("\n".join(lines), options.out)


if __name__ == "__main__":
    main()
