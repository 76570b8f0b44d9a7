"""Does the fit after `add` end in the best minimum? Random bases, effects and places against many random starts.

    python tests/bench/add_starts.py [--count 100] [--first 0]

Each case: a random base with a random effect of the catalogue in a random place makes a record with 0.4 % noise; the base
is fitted without the effect, the effect is added and fitted; beside it the best of 20 fits from random starts about the
truth. Printed: the share of cases that end more than 5 % above the best start, and each of them.
"""

import time
import warnings

import numpy as np
from common import asked

import narx_sym as ns
from narx_sym.diagnosis.add import Addition
from narx_sym.diagnosis.refit import Split, Trial, settle
from narx_sym.diagnosis.screening.scored import linearised
from narx_sym.errors import NarxError
from narx_sym.models.extend import extend, variants

N, TS, NOISE, STARTS, ABOVE = 1200, 0.01, 0.004, 20, 1.05
BASES = (
    (["y[k-1]", "u[k-1]", "1"], lambda g: [g.uniform(0.6, 0.95), g.uniform(0.1, 0.5), g.uniform(-0.1, 0.1)]),
    (["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], lambda g: [1.5, -g.uniform(0.55, 0.7), 0.1, g.uniform(-0.05, 0.1)]),
    (["u[k]", "1"], lambda g: [g.uniform(0.5, 2), g.uniform(-1, 1)]),
    (["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"],
     lambda g: [1.0, g.uniform(0.5, 1), g.uniform(0.05, 0.2), -g.uniform(0.1, 0.3)]),
)  # fmt: skip


def truth(rng):
    """A model with an effect, its parameters, and a record of it; None where the effect is not seen."""
    terms, draw = BASES[rng.integers(len(BASES))]
    base = ns.NARX.from_terms(terms, draw(rng), Ts=TS)
    t = np.arange(N) * TS
    u = 2 * np.sin(2 * np.pi * 0.5 * t) + np.sin(2 * np.pi * rng.uniform(0.1, 2) * t + 1)
    u += np.convolve(rng.standard_normal(N), np.ones(20) / 20, "same")
    temp = 3 + np.sin(2 * np.pi * 0.03 * t) + 0.3 * np.convolve(rng.standard_normal(N), np.ones(50) / 50, "same")
    plain = base.simulate(u, np.zeros(max(1, base.recursion.depth)), warn=False)
    record = ns.Record.from_arrays(
        u, plain + NOISE * np.std(plain) * rng.standard_normal(N), TS, channels={"temp": temp}
    )
    listed = list(variants(base, ["temp"]))
    variant = listed[rng.integers(len(listed))]
    ranges = linearised(settle(base, Split.whole([record]))).ranges(variant)
    made = extend(base, variant)
    shape = [low + (high - low) * rng.uniform(0.2, 0.6) for low, high in (ranges[p] for p in variant.shape)]
    sign = variant.effect.sign or rng.choice([-1, 1])
    for size in np.geomspace(1.0, 1e-3, 12) if not variant.effect.full else [0.95]:
        coefficients = [sign * size * rng.uniform(0.8, 1.0) for _ in made.coefficients]
        model = made.model.replace(theta=[*base.theta, *coefficients, *shape])
        y = model.simulate(u, np.full(max(1, model.recursion.depth), plain[0]), {"temp": temp, "t": t}, warn=False)
        moved = np.std(y - plain) / np.std(plain)
        if np.isfinite(moved) and moved < 0.5:
            break
    if not 0.02 < moved < 0.5:
        return None
    y = y + NOISE * np.std(y) * rng.standard_normal(N)
    return base, variant, model, ns.Record.from_arrays(u, y, TS, channels={"temp": temp})


def best_start(model, record, rng):
    """The least free-run NRMSE of fits from random starts about the true parameters."""
    trial, errors = Trial.of([record], [record]), []
    for i in range(STARTS):
        theta = np.array(model.theta) * (1 + (0.0 if i == 0 else 0.3) * rng.standard_normal(len(model.theta)))
        try:
            made = trial.final(settle(model, Split.whole([record]), theta))
        except NarxError:
            continue
        errors.append(trial.errors(made)["train"].free_run_nrmse)
    return min(errors, default=np.inf)


def case(seed):
    """Return what happened in one case: the effect, its place, and both errors; None where there is nothing to see."""
    rng = np.random.default_rng(seed)
    try:
        made = truth(rng)
    except NarxError:
        return None
    if made is None:
        return None
    base, variant, model, record = made
    try:
        fitted = ns.NARX(base.terms, Ts=TS).fit(record, method="auto")
        added = Addition(fitted, variant.id, variant.where).fit(record)
        error = ns.evaluate(added, record).free_run_nrmse
    except NarxError as problem:
        if "absorbs" in str(problem):
            return None
        error = np.inf
    return str(variant), error, best_start(model, record, rng)


def main():
    options = asked(__doc__, count=100, first=0)
    warnings.simplefilter("ignore")
    done, above, begin = 0, [], time.perf_counter()
    for seed in range(options.first, options.first + options.count):
        found = case(seed)
        if found is None:
            continue
        done += 1
        name, error, best = found
        if error > ABOVE * best:
            above.append(found)
            print(f"{seed}: {name}: {error:.4g}, best of {STARTS} starts {best:.4g}", flush=True)
    seconds = time.perf_counter() - begin
    print(
        f"{len(above)} of {done} end more than 5 % above the best of {STARTS} starts; {seconds / max(1, done):.1f} s each"
    )


if __name__ == "__main__":
    main()
