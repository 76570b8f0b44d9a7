"""Many parameter sets at once, multi-start, bootstrap, the banded Jacobian, and sweeps on a cluster."""

import subprocess
import sys

import numpy as np
import pytest
from paper import BENCH

import narx_sym as ns
from narx_sym.errors import ModelError
from narx_sym.fit import ensemble, freerun
from narx_sym.fit.bootstrap import block_bootstrap, correlation_length
from narx_sym.fit.freerun import FreeRun
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.signals import u, y

TABLE_1 = np.array(BENCH.theta)
OTHERS = {
    "paper": (BENCH.terms, TABLE_1),
    "two lags": (["y[k-1]", "y[k-2]", "u[k-1]", "abs(u[k-2])"], np.array([1.2, -0.4, 0.3, 0.1])),
    "nonlinear": (["y[k-1]", "tanh(y[k-1])", "Max(u[k-1], y[k-2])"], np.array([0.3, 0.2, 0.4])),
}


@pytest.fixture(scope="module")
def record():
    u = ns.plants.filtered_noise(N=3000, Ts=0.01, cutoff=0.5, peak=60.0, seed=1)
    return ns.Record.from_arrays(u, ns.plants.bouc_wen(u, Ts=0.01), Ts=0.01)


def cloud(theta, sets, seed=0):
    return theta * (1 + 0.01 * np.random.default_rng(seed).standard_normal((sets, theta.size)))


@pytest.mark.parametrize("name", OTHERS)
def test_sets_agree_with_single_runs(record, name):
    terms, theta = OTHERS[name]
    model = ns.NARX.from_terms(terms)
    sets = 9
    thetas = cloud(theta, sets)
    runs = ensemble.trajectories(model, thetas, record)
    costs = ensemble.costs(model, thetas, record)
    bands = ensemble.bands(model, thetas, record)
    depth = model.recursion.depth
    for i in range(0, sets, 4):
        model = model.replace(theta=thetas[i])
        single = model.simulate(record.u, record.y[:depth], warn=False)
        assert np.allclose(runs[i], single, rtol=1e-9, atol=1e-9 * np.abs(single).max())
        assert costs[i] == pytest.approx(np.mean((single - record.y)[depth:] ** 2), rel=1e-9)
    assert np.allclose(bands.low, runs.min(axis=0)) and np.allclose(bands.high, runs.max(axis=0))
    assert np.allclose(bands.mean, runs.mean(axis=0))


@pytest.mark.parametrize(
    "wanted, where, values",
    (
        ("backlash", "input", (0.6, 8.0)), ("backlash", "output", (0.6, 8.0)), ("drift", "output", (0.5,)),
        ("hysteresis", "output", (0.4, 0.05, 0.0)), ("rate_dependence", "input", (0.5, 0.3)),
    ),
)  # fmt: skip
@pytest.mark.parametrize("point", ({}, {u: 3.0, y: -2.0}))
def test_sets_of_a_model_with_states_agree_with_single_runs(record, wanted, where, values, point):
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], Ts=0.01, operating_point=point)
    found = (v for v in variants(base) if v.id == wanted and v.where == where and v.effect.form in ("", "Bouc-Wen"))
    model = extend(base, next(found)).model
    values = np.array([1.2, -0.4, 0.2, *values][: len(model.symbols)])
    thetas = cloud(values, 5)
    late = record[200:]  # far from zero at the start
    runs, costs = ensemble.trajectories(model, thetas, late), ensemble.costs(model, thetas, late)
    depth = max(1, model.recursion.depth)
    for i in range(0, 5, 2):
        model = model.replace(theta=thetas[i])
        single = model.simulate(late.u, late.y[:depth], {"t": late.t}, warn=False)
        assert np.allclose(runs[i], single, rtol=1e-9, atol=1e-9 * np.abs(single).max())
        assert costs[i] == pytest.approx(np.mean((single - late.y)[depth:] ** 2), rel=1e-9)


def test_several_starts_fit_a_model_with_states():
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.7, 0.5], Ts=0.01)
    model = extend(base, next(v for v in variants(base) if v.id == "backlash" and v.where == "input")).model
    true = [0.7, 0.5, 0.8, 0.3]
    model = model.replace(theta=true)
    source = np.sin(np.arange(600) / 21) + np.sin(np.arange(600) / 7.3)
    own = ns.Record.from_arrays(source, model.simulate(source, 0.0), Ts=0.01)
    assert np.argmin(ensemble.costs(model, [[0.6, 0.6, 0.6, 0.2], true, [0.7, 0.5, 0.1, 0.6]], own)) == 1
    model = model.replace(theta=[0.6, 0.6, 0.6, 0.2])
    model = model.fit(own, method="free_run", starts=3, seed=0)
    assert model.theta == pytest.approx(true, rel=1e-4)


def test_a_diverging_set_has_infinite_cost_and_spoils_no_other(record):
    model = BENCH.model()
    thetas = cloud(TABLE_1, 5)
    good = ensemble.costs(model, thetas, record)
    thetas[2, 0] = 3.0
    found = ensemble.costs(model, thetas, record)
    assert np.isinf(found[2]) and np.array_equal(np.delete(found, 2), np.delete(good, 2))


def test_costs_add_records_up(record):
    model = BENCH.model()
    first, second = record[:1200], record[1200:]
    thetas = cloud(TABLE_1, 4)
    depth = model.recursion.depth
    weights = np.array([len(first) - depth, len(second) - depth])
    parts = np.array([ensemble.costs(model, thetas, r) for r in (first, second)])
    assert np.allclose(ensemble.costs(model, thetas, [first, second]), weights @ parts / weights.sum())


def test_wrong_shapes_are_refused(record):
    with pytest.raises(ModelError, match="shape"):
        ensemble.costs(BENCH.model(), np.ones((3, 5)), record)
    with pytest.raises(ModelError, match="shorter"):
        ensemble.costs(BENCH.model(), TABLE_1, record[:3])


@pytest.mark.parametrize("name", OTHERS)
def test_banded_jacobian_equals_forward_sensitivities(record, name, monkeypatch):
    terms, theta = OTHERS[name]
    model = ns.NARX.from_terms(terms)
    forward = FreeRun(model, record, [])
    monkeypatch.setattr(freerun, "MANY", 0)
    banded = FreeRun(model, record, [])
    z = forward.start(theta)
    z[-1] = 0.1
    for a, b in zip(forward.run(z), banded.run(z), strict=True):
        assert np.allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(a).max())


def test_multi_start_leaves_a_bad_start(record):
    """A start at which the only slope is wrong by far ends in a worse minimum or fails; the cloud does not."""
    import sympy as sp

    from narx_sym.symbolic.signals import k, phi1, u, y

    a, b, c, d = names = sp.symbols("a b c d", real=True)
    h = d * u[k - 1] - y[k - 1]
    F = y[k - 1] + a * phi1[k] + b * sp.Abs(phi1[k]) * h + c * phi1[k] * sp.Abs(h)
    start = (0.5, 0.02, -0.02, 2.5)
    single = ns.Model(F, names, start).fit(record, method="free_run", max_steps=40)
    several = ns.Model(F, names, start).fit(record, method="free_run", max_steps=40, starts=4, seed=1)
    assert several.info.nrmse.free_run <= single.info.nrmse.free_run * (1 + 1e-6)
    assert np.allclose(several.theta, [0.7, 0.008, 0.008, 1.6], rtol=0.02)
    again = ns.Model(F, names, start).fit(record, method="free_run", max_steps=40, starts=4, seed=1)
    assert np.array_equal(several.theta, again.theta)


def test_bootstrap_agrees_with_theory_under_white_noise():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(2000)
    truth = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.5])
    y = truth.simulate(u, 0.0) + 0.1 * rng.standard_normal(u.size)
    record = ns.Record.from_arrays(u, y, Ts=1.0)
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(record, method="free_run")
    found = block_bootstrap(model, record, draws=150, seed=3)
    assert np.allclose(found.std, model.standard_errors, rtol=0.3)
    low, high = found.interval()
    assert np.all(low < truth.theta) and np.all(truth.theta < high)
    bands = found.bands(record)
    assert np.all(bands.low <= bands.mean) and np.all(bands.mean <= bands.high)
    assert np.array_equal(found.thetas, block_bootstrap(model, record, draws=150, seed=3).thetas)


def test_correlation_length():
    rng = np.random.default_rng(0)
    x = rng.standard_normal(20_000)
    y = np.zeros_like(x)
    for i in range(1, x.size):
        y[i] = 0.9 * y[i - 1] + x[i]
    assert correlation_length(x) == 1
    assert correlation_length(y) == pytest.approx(1 / -np.log(0.9), abs=2)


def test_start_up_loads_little():
    code = (
        "import sys, narx_sym; narx_sym.NARX; "
        "print([m for m in ('casadi', 'matplotlib', 'pandas', 'llvmlite') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
