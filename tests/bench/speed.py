"""Speed, memory and accuracy beside C, BLAS and other toolkits, measured in one run.

    python tests/bench/speed.py [--quick] [--out FILE.md] [--only free-run,selection]

Each figure and its reference are measured in turn, several times; the ratio is the median over the rounds. Read the
ratios: the times belong to the machine. All tools get one BLAS thread.
"""

from __future__ import annotations

import ctypes
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import sympy as sp
from common import ROOT, asked, publish
from paper import BENCH
from paper_tables import TS, direct
from scipy.linalg.blas import dsyrk

from narx_sym import NARX, Model, Record, plants, pool
from narx_sym.engines.columns import Columns
from narx_sym.engines.compile import compile
from narx_sym.fit.bases.select import err_path, path_of
from narx_sym.fit.least_squares import factor
from narx_sym.symbolic.sensitivity import sensitivities
from narx_sym.symbolic.signals import k, u, y

os.environ["NARX_SYM_CACHE"] = "off"  # what is compiled is compiled anew, unless a row says otherwise
N = 50_000
THETA = np.array(BENCH.theta)
Array = np.ndarray

C_LOOP = """
static double sgn(double x) { return (x > 0) - (x < 0); }
void run(double *restrict y, const double *restrict u, const double *restrict t, long start, long stop)
{
    double last = y[start - 1];
    for (long k = start; k < stop; k++) {
        double d1 = u[k-1] - u[k-2], d2 = u[k-2] - u[k-3], s = sgn(d2);
        double c0 = t[1]*d1 + t[2]*d2*s*u[k-2] + t[4]*d2*u[k-2]*u[k-2];
        double c1 = t[0] + t[3]*d2*s + t[5]*d2*u[k-2];
        last = c0 + c1*last;
        y[k] = last;
    }
}
void decay(double *restrict y, const double *restrict u, const double *restrict t, long start, long stop)
{
    double last = y[start - 1];
    for (long k = start; k < stop; k++) { last = t[0]*last + t[1]*u[k-1]; y[k] = last; }
}
"""


# -- measuring and reporting -----------------------------------------------------------------------------------


def interleaved(rounds: int, **functions: Callable[[], Any]) -> dict[str, Array]:
    """Time functions in turn: the seconds of each, per round. One round before is not counted."""
    for f in functions.values():
        f()
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, f in functions.items():
            start = perf_counter()
            f()
            seconds[name].append(perf_counter() - start)
    return {name: np.array(s) for name, s in seconds.items()}


def shown(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if value < 1000 else f"{value:,.0f} {unit}".replace(",", " ")


@dataclass
class Report:
    """Rows of the table and the remarks below it."""

    rows: list[tuple[str, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(
        self, what: str, ours: str, reference: str = "", ratio: str = "", target: str = "", met: Any = None
    ) -> None:
        self.rows.append((what, ours, reference, ratio, target, "" if met is None else "yes" if met else "**no**"))

    def compare(
        self, what: str, ours: Array, other: Array, name: str, unit: str, scale: float = 1.0, scale_other: float = 0.0,
        most: float | None = None, faster: float | None = None,
    ) -> None:  # fmt: skip
        """One row from two interleaved series; `most` bounds ours/other, `faster` other/ours from below."""
        a, b = ours * scale, other * (scale_other or scale)
        ratio = float(np.median(b / a if faster else a / b))
        target, met = "", None
        if most is not None:
            target, met = f"<= {most:.3g}", ratio <= most
        elif faster is not None:
            target, met = f">= {faster:g} times faster", ratio >= faster
        said = f"{ratio:.3g}" if ratio < 1000 else f"{ratio:,.0f}".replace(",", " ")
        self.add(
            what,
            shown(np.median(a), unit),
            f"{name}: {shown(np.median(b), unit)}",
            f"{said} times faster" if faster else said,
            target,
            met,
        )

    def markdown(self) -> str:
        head = ("what", "ours", "reference", "median ratio", "target", "met?")
        lines = [head, ("---",) * len(head), *self.rows]
        return (
            "\n".join(["| " + " | ".join(line) + " |" for line in lines] + ["", *(f"- {n}" for n in self.notes)]) + "\n"
        )


# -- data and references ---------------------------------------------------------------------------------------


@cache
def excitation(n: int = N) -> Array:
    return plants.filtered_noise(n, TS)


@cache
def measured(n: int = N, noise: float = 0.01) -> Record:
    source = excitation(n)
    clean = plants.bouc_wen(source, TS)
    output = clean + noise * clean.std() * np.random.default_rng(1).standard_normal(n)
    return Record(source, output, TS * np.arange(n), TS)


@cache
def candidates(n: int) -> list[Any]:
    """The first n terms of a pool without rules."""
    big = n > 279
    return list(pool(n_y=3, n_u=3, degree=4 if big else 3))[:n]


@cache
def c_library() -> Any:
    """The loop in C, or None where there is no compiler."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    folder = tempfile.mkdtemp()
    source, library = Path(folder, "loop.c"), Path(folder, "loop.so")
    source.write_text(C_LOOP)
    subprocess.run([compiler, "-O3", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    loaded = ctypes.CDLL(str(library))
    shutil.rmtree(folder)
    return loaded


def c_run(source: Array, theta: Array = THETA, first: float = 0.0, name: str = "run") -> Any:
    """A function that runs the C loop over an input into the same array, or None."""
    library = c_library()
    if library is None:
        return None
    result, depth = np.full(source.size, first), 3
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (result, source, theta)]
    function = getattr(library, name)

    def run() -> Array:
        function(*pointers, ctypes.c_long(depth), ctypes.c_long(source.size))
        return result

    return run


# -- 1. free run -----------------------------------------------------------------------------------------------


def free_run(report: Report, quick: bool) -> None:
    recursion = direct().recursion
    native = compile(recursion)
    for n, rounds in ((N, 101), (1_000_000, 11 if quick else 31)):
        source, out = excitation(n), {"y": np.empty(n)}
        runs = {
            "call": lambda source=source: native({"u": source}, THETA, {"y": 0.0}),
            "reused": lambda source=source, out=out: native({"u": source}, THETA, {"y": 0.0}, out=out),
        }
        c = c_run(source)
        if c is None:
            report.notes.append("gcc is missing: no comparison with C.")
            found = interleaved(rounds, **runs)
            for name in runs:
                report.add(f"free run, N = {n:,}, {name}", shown(np.median(found[name]) / n * 1e9, "ns/step"))
            continue
        found = interleaved(rounds, **runs, c=c)
        for name, text in (("call", "native, as called"), ("reused", "native, `out=` reused")):
            report.compare(
                f"free run, {n:,} steps, {text}", found[name], found["c"], "gcc -O3", "ns/step", 1e9 / n, most=1.5
            )
        gap = np.max(np.abs(runs["call"]()["y"] - c())) / np.max(np.abs(c()))
        report.notes.append(f"Free run, {n:,} steps: largest difference to C {gap:.1e} of the largest output.")
    others = {
        engine: (lambda engine=engine: compile(recursion, engine)({"u": excitation()}, THETA, {"y": 0.0}))
        for engine in ("casadi", "python")
    }
    found = interleaved(3 if quick else 7, native=lambda: native({"u": excitation()}, THETA, {"y": 0.0}), **others)
    for engine in others:
        report.compare(
            f"free run, {N:,} steps, engine {engine}", found[engine], found["native"], "native", "ns/step", 1e9 / N
        )
    _compilers(report, native, quick)
    _toolkits(report, native, quick)


def _compilers(report: Report, native: Any, quick: bool) -> None:
    """Beside the loop that a user would write for each compiler: the free run, and its square with the gradient."""
    source, out = excitation(), {"y": np.empty(N)}
    truth = native({"u": source}, THETA, {"y": 0.0})["y"]
    gradient = valued(Record(source, truth + 0.01, TS * np.arange(N), TS))
    for name, make in (("numba", _numba), ("JAX scan", _jax), ("CasADi mapaccum", _mapaccum)):
        try:
            run, slopes = make(source, truth)
        except ImportError:
            report.notes.append(f"{name} is not installed: not compared.")
            continue
        found = interleaved(
            5 if quick else 15, ours=lambda: native({"u": source}, THETA, {"y": 0.0}, out=out), other=run, **(
                {"ours_slopes": gradient, "slopes": slopes} if slopes else {}
            ),
        )  # fmt: skip
        report.compare(f"free run, {N:,} steps, beside {name}", found["ours"], found["other"], name, "ns/step", 1e9 / N)
        gap = np.max(np.abs(np.asarray(run()).ravel() - truth)) / np.max(np.abs(truth))
        report.notes.append(f"{name}: largest difference to ours {gap:.1e} of the largest output.")
        if slopes:
            report.compare(
                f"squared error and its gradient by six parameters, beside {name}", found["ours_slopes"],
                found["slopes"], name, "ns/step", 1e9 / N,
            )  # fmt: skip


def _numba(source: Array, truth: Array) -> Any:
    from numba import njit

    @njit
    def run(y: Array, u: Array, t: Array) -> Array:
        last = y[2]
        for k_ in range(3, u.size):
            d1, d2 = u[k_ - 1] - u[k_ - 2], u[k_ - 2] - u[k_ - 3]
            s = np.sign(d2)
            last = (
                t[0] * last + t[1] * d1 + t[2] * d2 * s * u[k_ - 2] + t[3] * d2 * s * last + t[4] * d2 * u[k_ - 2] ** 2
                + t[5] * d2 * u[k_ - 2] * last
            )  # fmt: skip
            y[k_] = last
        return y

    y = np.zeros(source.size)
    return lambda: run(y, source, THETA), None


def _jax(source: Array, truth: Array) -> Any:
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp

    d2 = np.concatenate([np.zeros(3), source[1:-2] - source[:-3]])
    d1 = np.concatenate([np.zeros(3), source[2:-1] - source[1:-2]])
    older = np.concatenate([np.zeros(3), source[1:-2]])
    given = tuple(map(jnp.asarray, (d1, d2, jnp.sign(d2), older)))

    def run(t: Any) -> Any:
        def step(last: Any, x: Any) -> Any:
            e1, e2, s, w = x
            new = (
                t[0] * last
                + t[1] * e1
                + t[2] * e2 * s * w
                + t[3] * e2 * s * last
                + t[4] * e2 * w**2
                + t[5] * e2 * w * last
            )
            return new, new

        return jax.lax.scan(step, 0.0, given)[1]

    fast = jax.jit(run)
    slopes = jax.jit(jax.grad(lambda t: jnp.sum((run(t) - truth - 0.01) ** 2)))
    theta = jnp.asarray(THETA)
    return lambda: fast(theta).block_until_ready(), lambda: slopes(theta).block_until_ready()


def _mapaccum(source: Array, truth: Array) -> Any:
    import casadi as ca

    y, x, t = ca.SX.sym("y"), ca.SX.sym("x", 3), ca.SX.sym("t", 6)
    d1, d2, w = x[0] - x[1], x[1] - x[2], x[1]
    s = ca.sign(d2)
    new = t[0] * y + t[1] * d1 + t[2] * d2 * s * w + t[3] * d2 * s * y + t[4] * d2 * w**2 + t[5] * d2 * w * y
    run = ca.Function("step", [y, x, t], [new]).mapaccum(source.size - 3)
    given = ca.DM(np.vstack([source[2:-1], source[1:-2], source[:-3]]))
    theta = ca.repmat(ca.DM(THETA), 1, source.size - 3)
    return lambda: np.concatenate([np.zeros(3), np.asarray(run(0.0, given, theta)).ravel()]), None


def _toolkits(report: Report, native: Any, quick: bool) -> None:
    short = 5000
    source = excitation(short)
    difference = np.diff(source, prepend=source[:1])
    X = np.column_stack([source, difference, np.sign(difference)])
    truth = native({"u": source}, THETA, {"y": 0.0})["y"]
    ours = lambda: native({"u": excitation()}, THETA, {"y": 0.0})  # noqa: E731
    for name, make in (("SysIdentPy", _sysidentpy), ("fastcan", _fastcan)):
        try:
            simulate = make(X, truth)
        except ImportError:
            report.notes.append(f"{name} is not installed: not compared.")
            continue
        found = interleaved(3 if quick else 7, ours=ours, other=simulate)
        report.compare(
            f"free run, {N:,} steps, native, beside {name}", found["ours"], found["other"],
            f"{name}, {short:,} steps", "ns/step",
            1e9 / N, 1e9 / short, faster=1000,
        )  # fmt: skip
        gap = np.max(np.abs(simulate() - truth)) / np.max(np.abs(truth))
        report.notes.append(f"{name} gets u, phi1 and phi2 as inputs; largest difference to ours {gap:.1e}.")


def _sysidentpy(X: Array, truth: Array) -> Any:
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.simulation import SimulateNARMAX

    code = np.array([
        [1001, 0, 0], [3001, 0, 0], [4002, 3002, 2002], [4002, 3002, 1001], [3002, 2002, 2002], [3002, 2002, 1001]
    ])  # fmt: skip
    simulator = SimulateNARMAX(basis_function=Polynomial(degree=3), estimate_parameter=False)
    given = {"X_test": X, "y_test": truth[:, None], "model_code": code}
    simulator.simulate(**given, theta=THETA[:, None])
    listed = code.tolist()
    theta = THETA[[listed.index(list(row)) for row in simulator.final_model]][:, None]
    simulator.simulate(**given, theta=theta)
    return lambda: simulator.predict(X=X, y=truth[:, None])[:, 0]  # without the search for the terms


def _fastcan(X: Array, truth: Array) -> Any:
    from fastcan.narx import NARX as Narx

    model = Narx(
        feat_ids=[[-1, -1, 3], [-1, -1, 1], [0, 1, 2], [1, 2, 3], [0, 0, 1], [0, 1, 3]],
        delay_ids=[[-1, -1, 1], [-1, -1, 1], [2, 2, 2], [2, 2, 1], [2, 2, 2], [2, 2, 1]],
        fit_intercept=False,
    )
    model.fit(X, truth)
    model.coef_ = THETA.copy()
    return lambda: model.predict(X, y_init=truth[: model.max_delay_])


# -- 2. build --------------------------------------------------------------------------------------------------


def build(report: Report, quick: bool) -> None:
    random = np.random.default_rng(5)
    terms = candidates(220)
    times = {"narx": [], "general": []}
    for i in range(15):
        names = sp.symbols(f"fresh{i}_0:6", real=True)
        chosen = [terms[j] for j in random.choice(220, 6, replace=False)]
        total = sum(c * t for c, t in zip(names, chosen, strict=True))
        for kind, F in (("narx", total), ("general", total + sp.tanh(names[0] * y[k - 1]) * sp.Abs(u[k - 1]))):
            start = perf_counter()
            compile(Model(F, names).recursion)
            times[kind].append(perf_counter() - start)
    for kind, text in (("narx", "six random terms"), ("general", "the same and a tanh")):
        ms = 1e3 * float(np.median(times[kind]))
        report.add(f"build of a new model, {text}", shown(ms, "ms"), "", "", "<= 60 ms", ms <= 60)
    report.notes.append(f"Build: slowest of 30 {1e3 * max(map(max, times.values())):.0f} ms.")


# -- 3. gradient -----------------------------------------------------------------------------------------------


def valued(record: Record) -> Callable[[], tuple[float, Array]]:
    """Return what computes the squared error along a record, and its gradient by six parameters."""
    full = compile(sensitivities(direct().recursion)[0])
    names = [str(base.label) for base in full.recursion.states]
    buffer = np.empty((len(record), len(names)), order="F")
    out = {name: buffer[:, i] for i, name in enumerate(names)}
    initial = {**dict.fromkeys(names, 0.0), "y": record.y[:3]}
    residual = np.empty(len(record))

    def run() -> tuple[float, Array]:
        full({"u": record.u}, THETA, initial, out=out)
        np.subtract(buffer[:, 0], record.y, out=residual)
        return float(residual @ residual), 2 * (residual @ buffer[:, 1:])

    return run


def gradient(report: Report, quick: bool) -> None:
    bare = compile(direct().recursion)
    record, out = measured(), {"y": np.empty(N)}
    found = interleaved(
        31 if quick else 101,
        both=valued(record),
        bare=lambda: bare({"u": record.u}, THETA, {"y": record.y[:3]}, out=out),
    )
    report.compare(
        "six-parameter value and gradient",
        found["both"],
        found["bare"],
        "one bare simulation",
        "ns/step",
        1e9 / N,
        most=4,
    )
    short = measured(2000)
    value, slope = valued(short)()
    exact_value, exact = _long_double_gradient(short)
    error = float(np.max(np.abs((slope - exact) / exact)))
    report.add(
        "relative error of the gradient, 2 000 steps, worst of six", f"{error:.1e}", "long double", "", "<= 1e-10",
        error <= 1e-10,
    )  # fmt: skip
    report.notes.append(f"Value at 2 000 steps: relative error {abs(value / float(exact_value) - 1):.1e}.")


def _long_double_gradient(record: Record) -> tuple[Any, Array]:
    real = np.longdouble
    source, target, theta = (np.asarray(a).astype(real) for a in (record.u, record.y, THETA))
    last, S = target[2], np.zeros(6, real)
    value, slope = real(0), np.zeros(6, real)
    for i in range(3, source.size):
        d1, d2, u2 = source[i - 1] - source[i - 2], source[i - 2] - source[i - 3], source[i - 2]
        s = np.sign(d2)
        psi = np.array([last, d1, s * d2 * u2, s * d2 * last, d2 * u2 * u2, d2 * u2 * last], real)
        S = psi + (theta[0] + theta[3] * s * d2 + theta[5] * d2 * u2) * S
        last = theta @ psi
        gap = last - target[i]
        value, slope = value + gap * gap, slope + 2 * gap * S
    return value, slope.astype(float)


# -- 4. selection ----------------------------------------------------------------------------------------------


def selection_times(rounds: int) -> dict[str, Array]:
    """Time a selection from 220 candidates, and dsyrk of the same matrix."""
    frame, terms, record = NARX([y[k - 1]]), candidates(220), measured()
    matrix = Columns([*terms, y[k]])({"u": record.u, "y": record.y})
    return interleaved(
        rounds, whole=lambda: path_of(frame, terms, y[k], record, 15), dsyrk=lambda: dsyrk(1.0, matrix, trans=1)
    )


def selection(report: Report, quick: bool) -> None:
    found = selection_times(3 if quick else 9)
    size = "selection, 50 000 x 220, 15 terms"
    report.compare(size, found["whole"], found["dsyrk"], "dsyrk", "ms", 1e3, most=5)
    _selectors(report, selector_times(2 if quick else 5), size)
    _ill_conditioned(report)


def selector_times(rounds: int) -> dict[str, Any]:
    """Time our selection beside those of the toolkits that are installed; also the number of equal picks."""
    frame, terms, record = NARX([y[k - 1]]), candidates(220), measured()
    everything = Columns([*terms, y[k]])({"u": record.u, "y": record.y})
    matrix, target = np.ascontiguousarray(everything[:, :-1]), everything[:, -1].copy()
    order = path_of(frame, terms, y[k], record, 15).order
    results = {}
    for name, make in (("SysIdentPy ERR", _frols), ("fastcan", _cancorr), ("fastcan, eta=True", _cancorr_eta)):
        try:
            choose = make(matrix, target)
        except ImportError:
            continue
        found = interleaved(rounds, ours=lambda: path_of(frame, terms, y[k], record, 15), other=choose)
        picks = [int(i) for i in choose()]
        same = next((i for i, (a, b) in enumerate(zip(picks, order, strict=False)) if a != b), len(order))
        results[name] = {
            "ours": found["ours"].tolist(), "other": found["other"].tolist(), "first": same,
            "common": len(set(picks) & set(order)),
        }  # fmt: skip
    return results


def _selectors(report: Report, found: dict[str, Any], size: str) -> None:
    for name, one in found.items():
        report.compare(size, np.array(one["ours"]), np.array(one["other"]), name, "ms", 1e3, faster=8)
        report.notes.append(
            f"{name}: the first {one['first']} of 15 picks are ours, {one['common']} in common. It is given the matrix; "
            "ours evaluates it."
        )


def _frols(matrix: Array, target: Array) -> Any:
    from sysidentpy.model_structure_selection import FROLS

    chooser = FROLS(n_terms=15, order_selection=False)
    chooser.max_lag = 0
    return lambda: chooser.error_reduction_ratio(matrix, target[:, None], 15)[1]


def _cancorr(matrix: Array, target: Array, eta: bool = False) -> Any:
    from fastcan import FastCan

    return lambda: FastCan(15, eta=eta, verbose=0).fit(matrix, target).indices_


def _cancorr_eta(matrix: Array, target: Array) -> Any:
    return _cancorr(matrix, target, eta=True)


def _ill_conditioned(report: Report) -> None:
    """Noise-free data sampled at 1 ms: neighbouring samples are nearly equal."""
    n, lagged = 5000, list(pool(n_y=3, n_u=6, degree=2, phi=False))
    for text, terms, cutoff in (
        ("1 Hz, phi1 and phi2", candidates(220), 1.0), ("1 Hz, six input lags", lagged, 1.0),
        ("0.2 Hz, six input lags", lagged, 0.2),
    ):  # fmt: skip
        source = plants.filtered_noise(N, TS, cutoff=cutoff)[20_000 : 20_000 + n]
        data = {"u": source, "y": plants.bouc_wen(source, TS)}
        columns = Columns([*terms, y[k]])
        rows = columns(data)
        exact, gap, smallest = _long_double_picks(rows, 12)
        same, gram = (
            sum(a == b for a, b in zip(order, exact, strict=False))
            for order in (err_path(*factor(columns, [data]), 12).order, _gram_picks(rows, 12))
        )
        report.add(
            f"picks as in long double, {n:,} x {len(terms)}, {text}", f"{same} of 12", f"Gram matrix: {gram} of 12", "",
            "12 of 12", same == 12,
        )  # fmt: skip
        report.notes.append(
            f"Picks, {text}: of one pick only {smallest:.1e} is new; the closest decision is {gap:.1e} apart."
        )


def _long_double_picks(rows: Array, count: int) -> tuple[list[int], float, float]:
    """Select by classical Gram-Schmidt, twice, on all rows, with the same gate and tie rule as ours."""
    real = np.longdouble
    W, target = rows[:, :-1].astype(real), rows[:, -1].astype(real)
    W /= np.sqrt((W * W).sum(axis=0))
    original, basis = W.copy(), np.empty((len(rows), 0), real)
    order, gap, smallest = [], np.inf, np.inf
    for _ in range(count):
        W = original.copy()
        for _ in range(2):
            W -= basis @ (basis.T @ W)
        left = np.sqrt((W * W).sum(axis=0))
        alive = (left > 1e-10) & ~np.isin(np.arange(W.shape[1]), order)
        with np.errstate(all="ignore"):
            gain = np.where(alive, (target @ W) ** 2 / left**2, -1)
        tied = gain >= gain.max() * (1 - 1e-7)
        pick = int(np.flatnonzero(tied)[0])
        gap = min(gap, float(1 - gain[~tied].max() / gain.max()))
        smallest = min(smallest, float(left[pick]))
        basis = np.column_stack([basis, W[:, pick] / left[pick]])
        target = target - basis[:, -1] * (basis[:, -1] @ target)
        order.append(pick)
    return order, gap, smallest


def _gram_picks(rows: Array, count: int) -> list[int]:
    """Select on the Gram matrix in double precision, by elimination."""
    scaled = rows / np.linalg.norm(rows, axis=0)
    G, order = scaled.T @ scaled, []
    for _ in range(count):
        left = np.diag(G)[:-1].copy()
        alive = (left > 1e-20) & ~np.isin(np.arange(left.size), order)
        if not alive.any():
            break
        with np.errstate(all="ignore"):
            gain = np.where(alive, G[:-1, -1] ** 2 / left, -1.0)
        pick = int(np.flatnonzero(gain >= gain.max() * (1 - 1e-7))[0])
        order.append(pick)
        G = G - np.outer(G[:, pick], G[pick]) / G[pick, pick]
    return order


# -- 5. memory -------------------------------------------------------------------------------------------------


def peak() -> float:
    """The largest memory of this process so far [MB]."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux getrusage also counts what the parent process had used
        return next(int(line.split()[1]) for line in status.open() if line.startswith("VmHWM")) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0 if sys.platform != "darwin" else 1024.0**2)


def memory_of_selection() -> dict[str, float]:
    n = 10_000_000
    before = peak()
    source = excitation(n)
    output = compile(direct().recursion)({"u": source}, THETA, {"y": 0.0})["y"]
    output += 0.01 * output.std() * np.random.default_rng(1).standard_normal(n)
    record = Record(source, output, TS * np.arange(n), TS)
    data = peak()
    start = perf_counter()
    path_of(NARX([y[k - 1]]), candidates(35), y[k], record, 15)
    return {"imports": before, "data": data, "peak": peak(), "seconds": perf_counter() - start}


def memory_of_simulation() -> dict[str, float]:
    n = 10_000_000
    before = peak()
    source = np.sin(2 * np.pi * TS * np.arange(n))
    source *= 40
    data = peak()
    start = perf_counter()
    direct_model = direct()
    direct_model = direct_model.replace(theta=THETA)
    direct_model.simulate(source, y0=0.0)
    return {"imports": before, "data": data, "peak": peak(), "seconds": perf_counter() - start}


def memory(report: Report, quick: bool) -> None:
    if quick:
        return
    for what, name, most in (
        ("selection from 10 000 000 rows x 35 candidates", "memory_of_selection", 1000),
        ("simulation of 10 000 000 samples", "memory_of_simulation", None),
    ):
        found = child(name)
        report.add(
            f"peak memory, {what}", f"{found['peak']:.1f} MB",
            f"imports alone: {found['imports']:.0f} MB; before the call: {found['data']:.0f} MB", "",
            f"< {most} MB" if most else "", found["peak"] < most if most else None,
        )  # fmt: skip
        report.notes.append(f"{what[0].upper()}{what[1:]}: {found['seconds']:.2f} s.")


# -- 6. denormals ----------------------------------------------------------------------------------------------


def denormals(report: Report, quick: bool) -> None:
    n, rounds = 200_000, 9 if quick else 31
    zero, constant = np.zeros(n), np.ones(n)
    a, b, c = sp.symbols("slope gain second", real=True)
    first = Model(a * y[k - 1] + b * u[k - 1], (a, b))
    second = Model(a * y[k - 1] + c * y[k - 2] + b * u[k - 1], (a, b, c))
    curved = Model(a * y[k - 1] + b * u[k - 1] + c * y[k - 1] ** 3, (a, b, c))
    for text, model, theta in (
        ("y[k] = 0.9 y[k-1]", first, (0.9, 0.1)), ("AR(2), both poles 0.8", second, (1.6, 0.1, -0.64)),
        ("y[k] = 0.9 y[k-1] - 0.01 y[k-1]^3", curved, (0.9, 0.1, -0.01)),
        ("sensitivities of y[k] = 0.9 y[k-1]", sensitivities(first.recursion)[0], (0.9, 0.1)),
    ):  # fmt: skip
        run = compile(getattr(model, "recursion", model))
        initial = {str(base.label): 1.0 for base in run.recursion.states}
        found = interleaved(
            rounds,
            zero=lambda run=run, theta=theta, initial=initial: run({"u": zero}, theta, initial),
            constant=lambda run=run, theta=theta, initial=initial: run({"u": constant}, theta, initial),
        )
        report.compare(
            f"decay to zero, {text}", found["zero"], found["constant"], "constant input", "ns/step", 1e9 / n, most=1.5
        )
    theta = np.array([0.9, 0.1])
    runs = {name: c_run(s, theta, 1.0, "decay") for name, s in (("z", zero), ("c", constant))}
    if runs["z"]:
        found = interleaved(rounds, **runs)
        report.notes.append(
            f"The C loop of y[k] = 0.9 y[k-1] takes {np.median(found['z'] / found['c']):.2g} times as long on the "
            "decaying run."
        )


# -- 7. growth -------------------------------------------------------------------------------------------------


def slope(x: Sequence[float], t: Sequence[float]) -> float:
    return float(np.polyfit(np.log(x), np.log(t), 1)[0])


def growth(report: Report, quick: bool) -> None:
    native = compile(direct().recursion)
    lengths = [10**e for e in range(3, 7 if quick else 8)]
    sources = {n: excitation(n) for n in lengths}
    series = {"simulation, steps": (lengths, lambda n: native({"u": sources[n]}, THETA, {"y": 0.0}))}
    frame = NARX([y[k - 1]])
    rows = [10**e for e in range(3, 6 if quick else 7)]
    output = native({"u": sources[rows[-1]]}, THETA, {"y": 0.0})["y"]
    output = output + 0.01 * output.std() * np.random.default_rng(1).standard_normal(output.size)
    records = {n: Record(sources[rows[-1]][-n:], output[-n:], TS * np.arange(n), TS) for n in rows}
    series["selection from 35, rows"] = (rows, lambda n: path_of(frame, candidates(35), y[k], records[n], 15))
    widths = [35, 220] if quick else [35, 220, 900]
    for w in widths:
        candidates(w)
    series["selection, 50 000 rows, candidates"] = (
        widths,
        lambda w: path_of(frame, candidates(w), y[k], measured(), 15),
    )
    for name, (sizes, run) in series.items():
        found = interleaved(3 if quick else 5, **{str(n): (lambda n=n, run=run: run(n)) for n in sizes})
        times = [float(np.median(found[str(n)])) for n in sizes]
        listed = ", ".join(f"{n:,}: {shown(1e3 * t, 'ms')}" for n, t in zip(sizes, times, strict=True))
        last = slope(sizes[-2:], times[-2:])
        report.add(f"growth: {name}", f"slope {slope(sizes, times):.2f}, at the end {last:.2f}", listed)


# -- 8. start-up -----------------------------------------------------------------------------------------------


def start_up(report: Report, quick: bool) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def process(*arguments: str) -> Callable[[], Any]:
        command = [sys.executable, *arguments]
        return lambda: subprocess.run(
            command, check=True, capture_output=True, env=environment, cwd=tempfile.gettempdir()
        )

    found = interleaved(
        7,
        ours=process("-m", "narx_sym", "--help"),
        sympy=process("-c", "import sympy"),
        package=process("-c", "import narx_sym"),
    )
    ratio = float(np.median(found["ours"] / found["sympy"]))
    seconds = {name: f"{np.median(s):.2f} s" for name, s in found.items()}
    report.add(
        "start of `narx-sym --help`",
        seconds["ours"],
        f"import sympy: {seconds['sympy']}",
        f"{ratio:.2g}",
        "< 2",
        ratio < 2,
    )
    report.compare("start of `import narx_sym`", found["package"], found["sympy"], "import sympy", "s")


# -- command ---------------------------------------------------------------------------------------------------

PARTS: dict[str, Callable[..., None]] = {
    "free-run": free_run, "build": build, "gradient": gradient, "selection": selection,
    "memory": memory, "denormals": denormals, "growth": growth, "start-up": start_up,
}  # fmt: skip
CHILDREN: dict[str, Callable[[], Any]] = {
    "memory_of_selection": memory_of_selection,
    "memory_of_simulation": memory_of_simulation,
}


def child(name: str) -> dict[str, Any]:
    """Run a part in a process of its own."""
    command = [sys.executable, str(Path(__file__).resolve()), "--child", name]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    options = asked(__doc__, quick=False, out=Path, only="", child="")
    warnings.simplefilter("ignore")
    if options.child:
        print(json.dumps(CHILDREN[options.child]()))
        return
    report = Report()
    for name in options.only.split(",") if options.only else PARTS:
        print(f"{name} ...", file=sys.stderr)
        PARTS[name](report, options.quick)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    report.notes.append(
        f"{platform.machine()}, {cores} cores, Python {platform.python_version()}, NumPy {np.__version__}. "
        "Each ratio is a median over rounds in which both sides ran in turn, with one BLAS thread."
    )
    publish(report.markdown(), options.out)


if __name__ == "__main__":
    main()
