"""The figures of numerical truth: digits on the NIST sets, constraints, derivatives, engines, standard errors.

    python tests/bench/truth.py [--engines 3000] [--models 1000] [--draws 2000]

Prints the table of the README; each part can be left out with a count of 0. Seeds are fixed.
"""

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import common
import numpy as np
from drawn import inputs_of, recursions, runs
from hypothesis import HealthCheck, Phase, assume, given, settings
from truth import (
    NAMES,
    classical,
    complex_step,
    digits,
    exact_constrained,
    exact_least_squares,
    random_problem,
    smooth_models,
    strd,
    triangle,
)

from narx_sym.data.metrics import nrmse
from narx_sym.data.record import Record
from narx_sym.engines.columns import Columns
from narx_sym.engines.compile import compile
from narx_sym.fit.bases.select import err_path
from narx_sym.fit.least_squares import one_step
from narx_sym.models.model import NARX
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.sensitivity import sensitivities
from narx_sym.symbolic.signals import expand_phi, k, y


def runner(count: int) -> Any:
    """Hypothesis as a generator of cases: always the same ones, nothing stored, nothing shrunk."""
    return settings(
        max_examples=count, deadline=None, database=None, derandomize=True, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip


def nist() -> Iterator[str]:
    yield "| set | level | estimates | standard errors | numpy lstsq | exact solution of the rounded regressors |"
    yield "|---|---|---|---|---|---|"
    for name in NAMES:
        data = strd(name)
        model, record = data.fit_problem
        theta, std = one_step(model, record, [])
        design = Columns(model.terms)({"u": record.u, **record.channels})
        lstsq = np.linalg.lstsq(design, record.y, rcond=None)[0]
        fractions = [[Fraction(v) for v in column] for column in design.T.tolist()]
        attainable, _ = exact_least_squares(fractions, [Fraction(v) for v in record.y.tolist()])
        shown = [
            digits(theta, data.theta),
            digits(std, data.std),
            *(digits(t, data.theta) for t in (lstsq, attainable)),
        ]
        yield f"| {name} | {data.level} | {' | '.join(f'{max(0.0, d):.1f}' for d in shown)} |"


def constrained(count: int) -> float:
    """The largest error against the null-space solution in rationals, relative to the largest estimate."""
    worst, random = 0.0, np.random.default_rng(3)
    model = NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]", "phi1[k-1]*y[k-1]"])
    for _ in range(count):
        record = Record.from_arrays(random.standard_normal(30), random.standard_normal(30), Ts=1.0)
        S = random.integers(-3, 4, (int(random.integers(1, 4)), 4)).tolist()
        inside = random.integers(-3, 4, 4).tolist()
        c = [sum(s * v for s, v in zip(row, inside, strict=True)) for row in S]
        equations = [
            sum(s * t for s, t in zip(row, model.symbols, strict=True)) - v for row, v in zip(S, c, strict=True)
        ]
        theta, _ = one_step(model, record, equations)
        rows = Columns([*model.terms, y[k]])({"u": record.u, "y": record.y})
        expected = exact_constrained(rows[:, :-1], rows[:, -1], S, c)
        worst = max(worst, float(np.abs(theta - expected).max() / np.abs(expected).max()))
    return worst


def err_shares(count: int) -> tuple[float, int]:
    """The largest error of an error reduction ratio against long double on all rows, and how many paths differ."""
    worst, other = 0.0, 0
    for seed in range(count):
        Psi, target = random_problem(seed)
        order, shares, gap = classical(Psi, target, 8)
        path = err_path(triangle(Psi, target), len(target), 8)
        if gap > 1e-6:
            other += path.order != order
        if path.order == order:
            worst = max(worst, float(np.abs(path.err - shares).max() / shares.max()))
    return worst, other


def derivatives(count: int) -> tuple[float, int]:
    """The largest error of a derivative along a run against a complex step, relative to its largest value."""
    worst, cases = [0.0], [0]

    @runner(count)
    @given(smooth_models())
    def each(made: Any) -> None:
        right, parameters, theta, seed = made
        recursion = Recursion(((y[k], right),), parameters)
        assume(recursion.inputs)
        inputs, start = {"u": np.random.default_rng(seed).uniform(-1, 1, 60)}, np.full(recursion.depth, 0.25)
        extended, directions = sensitivities(recursion)
        moved = [d.get(y) for d in directions]
        found = compile(extended)(inputs, theta, {y: start, **{m: 0.0 for m in moved if m is not None}})
        _, slopes = complex_step(expand_phi(right), parameters, inputs, theta, start)
        for name, expected in zip(moved, slopes, strict=False):
            size = np.abs(expected).max()
            if name is not None and size > 1e-3:
                worst[0] = max(worst[0], float(np.abs(found[str(name.label)] - expected).max() / size))
        cases[0] += 1

    each()
    return worst[0], cases[0]


def engines(count: int, small: bool) -> tuple[float, int]:
    """The largest difference between any two engines, relative to the largest value of the sequence."""
    worst, cases = [0.0], [0]

    @runner(count)
    @given(recursions(small=small))
    def each(made: Any) -> None:
        recursion, _, seed = made
        assume(recursion.inputs)
        results = runs(recursion, inputs_of(40, seed), (0.05, -0.07), dict.fromkeys(recursion.states, 0.3))
        ties = [x[recursion.depth :] for name, x in results["python"].items() if name.startswith("tie")]
        assume(all(np.abs(x).min() > 1e-9 for x in ties))
        for found in results.values():
            for name, expected in results["python"].items():
                size = np.abs(expected).max() or 1.0
                gap = float(np.abs(found[name] - expected).max() / size)
                worst[0] = max(worst[0], gap if np.isfinite(gap) else np.inf)
        cases[0] += 1

    each()
    return worst[0], cases[0]


TERMS = {
    "moving average": (["u[k-1]", "u[k-2]", "phi2[k-1]"], [0.7, 0.3, -0.5]),
    "linear, first order": (["y[k-1]", "u[k-1]"], [0.8, 0.5]),
    "hysteresis, Sigma_y = 1": (["y[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]"], [1.0, 0.8, -0.2]),
}
STUDENT = 1.9720  # 95 %, 197 degrees of freedom (1.9719 ... 1.9723 for 196 ... 199)


def coverage(method: str, name: str, draws: int, n: int = 200) -> tuple[list[float], float]:
    """Shares of 95 % intervals that hold the truth, and the size of the noise in deviations of the output.

    One step ahead white noise enters the equation (of a model without past outputs: adds to the output); in free run it
    adds to the output.
    """
    terms, truth = TERMS[name]
    integrates = truth[0] == 1.0
    random, inside, sizes = np.random.default_rng(17), [], []
    inner = method == "one_step" and any("y[" in t for t in terms)
    maker = NARX.from_terms([*terms, *(["e[k]"] if inner else [])], [*truth, *([1.0] if inner else [])], channels=["e"])
    for _ in range(draws):
        source = np.cumsum(random.standard_normal(n)) / 4 if integrates else random.standard_normal(n)
        e = (0.02 if inner and integrates else 0.2) * random.standard_normal(n)
        clean = NARX.from_terms(terms, truth).simulate(source, 0.0)
        out = maker.simulate(source, 0.0, {"e": e}) if inner else clean + e
        sizes.append(nrmse(out, clean))
        model = NARX.from_terms(terms, truth)
        constraints = ["continuum"] if integrates else []
        model = model.fit(Record.from_arrays(source, out, Ts=1.0), constraints, method=method)
        free = np.array(model.standard_errors) > 1e-9
        inside.append(np.abs(np.array(model.theta) - truth)[free] < STUDENT * np.array(model.standard_errors)[free])
    return [float(c) for c in np.mean(inside, axis=0)], float(np.median(sizes))


def main() -> None:
    asked = common.asked(__doc__, engines=3000, models=1000, draws=2000)
    for line in nist():
        print(line, flush=True)
    if asked.models:
        count = asked.models
        print(f"constrained LS against rationals, {count} problems: {constrained(count):.1e}", flush=True)
        worst, other = err_shares(count)
        print(f"ERR against long double, {count} problems: {worst:.1e}; other paths: {other}", flush=True)
        worst, cases = derivatives(count)
        print(f"sensitivities against complex steps, {cases} models: {worst:.1e}", flush=True)
    for small, count in ((True, asked.engines * 3 // 4), (False, asked.engines // 4)):
        if count:
            worst, cases = engines(count, small)
            print(f"engines, {cases} {'small' if small else 'larger'} recursions: {worst:.1e}", flush=True)
    for method in ("one_step", "free_run"):
        for name in TERMS if asked.draws else ():
            shares, noise = coverage(method, name, asked.draws)
            shown = " / ".join(f"{100 * s:.1f}" for s in shares)
            print(f"coverage, {method}, {name}, noise {noise:.2f}: {shown} %", flush=True)


if __name__ == "__main__":
    main()
