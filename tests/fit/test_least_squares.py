"""Least squares with and without constraints, free-run fits, sensitivities, simulation and prediction."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import sympy as sp
from paper import BENCH
from truth import exact_constrained

from narx_sym.data.record import Record
from narx_sym.engines.columns import Columns
from narx_sym.errors import DataError, Diverged, FitError, ModelError
from narx_sym.fit import freerun
from narx_sym.fit.evaluate import evaluate, free_run
from narx_sym.fit.least_squares import factor, fit
from narx_sym.fit.simulate import predict, simulate
from narx_sym.models.analysis import continuum
from narx_sym.models.extend import extend, variants
from narx_sym.models.info import Info
from narx_sym.models.model import NARX, Model
from narx_sym.symbolic.signals import k, u, y

MIXED = ("y[k-1]", "y[k-2]", "u[k-1]", "phi1[k-1]", "phi2[k-1]*u[k-2]")


def noise_record(n=300, seed=0, **more):
    random = np.random.default_rng(seed)
    return Record.from_arrays(random.standard_normal(n), random.standard_normal(n), Ts=0.1, **more)


def slow(n, seed=0, peak=40.0):
    """A slow input: a sum of sines from rest."""
    i, random = np.arange(n), np.random.default_rng(seed)
    x = sum(np.sin(w * i + p) for w, p in zip(random.uniform(0.01, 0.08, 5), random.uniform(0, 6, 5), strict=True))
    x *= np.minimum(1, i / 50)
    return x * peak / np.abs(x).max()


def made(terms, theta, source, noise=0.0, seed=0):
    """A record that the model itself made, with output noise."""
    out = NARX.from_terms(terms, theta).simulate(source, 0.0)
    return Record.from_arrays(source, out + noise * np.random.default_rng(seed).standard_normal(out.size), Ts=0.01)


def regression(model, *records):
    """[Psi, y] stacked, from the definition."""
    parts = [Columns([*model.terms, y[k]])({"u": r.u, "y": r.y}) for r in records]
    stacked = np.vstack(parts)
    return stacked[:, :-1], stacked[:, -1]


# ---------------------------------------------------------------- least squares


@pytest.mark.parametrize("n", (50, 5_000))
def test_least_squares_equals_lstsq(n):
    model, record = NARX.from_terms(MIXED), noise_record(n)
    Psi, target = regression(model, record)
    expected, (rss,), *_ = np.linalg.lstsq(Psi, target)
    given, model = model, model.fit(record)
    assert given.theta is None and given.info == Info()  # a fit returns another model
    np.testing.assert_allclose(model.theta, expected, rtol=1e-11)
    variance = rss / (len(target) - 5) * np.linalg.inv(Psi.T @ Psi)
    np.testing.assert_allclose(model.standard_errors, np.sqrt(np.diag(variance)), rtol=1e-9)
    assert model.info.samples == n and model.Ts == 0.1


def test_several_records_are_one_stacked_regression():
    records = [noise_record(n, seed=n) for n in (40, 2_500, 300)]
    model = NARX.from_terms(MIXED).fit(records)
    Psi, target = regression(model, *records)
    np.testing.assert_allclose(model.theta, np.linalg.lstsq(Psi, target)[0], rtol=1e-11)
    # A gap separates like two records.
    u_, y_ = (np.concatenate([getattr(r, name) for r in records]) for name in "uy")
    gap = Record(u_, y_, np.arange(u_.size) * 0.1, 0.1, breaks=(40, 2_540))
    np.testing.assert_allclose(NARX.from_terms(MIXED).fit(gap).theta, model.theta, rtol=1e-12)


def test_the_factor_is_that_of_all_rows_with_lags_and_previews():
    record = noise_record(5_000)
    columns = Columns([u[k + 2], y[k - 3] * u[k], y[k]])
    R, rows = factor(columns, [{"u": record.u, "y": record.y}])
    i = np.arange(3, 4_998)
    stacked = np.column_stack([record.u[i + 2], record.y[i - 3] * record.u[i], record.y[i]])
    assert rows == len(i) and np.array_equal(R, np.triu(R))
    np.testing.assert_allclose(R.T @ R, stacked.T @ stacked, rtol=1e-11, atol=1e-9)


def test_an_operating_point_fits_the_shifted_data():
    record = noise_record(200)
    moved = Record.from_arrays(record.u + 1.8, record.y - 96, Ts=0.1)
    plain = NARX.from_terms(MIXED).fit(record)
    around = NARX.from_terms(MIXED, operating_point={u: 1.8, y: -96}).fit(moved)
    np.testing.assert_allclose(around.theta, plain.theta, rtol=1e-9)
    np.testing.assert_allclose(around.predict(moved), plain.predict(record) - 96, atol=1e-10)


# ---------------------------------------------------------------- constraints


CONSTRAINTS = {
    "one": ([[1, 1, 0, 0, 0]], [1]),
    "fixed": ([[0, 0, 1, 0, 0]], [2]),
    "two fixed": ([[1, 0, 0, 0, 0], [0, 0, 0, 0, 3]], [1, 1]),
    "two": ([[1, 1, 0, 0, 0], [0, 2, -1, 0, 0]], [1, 0]),
    "three": ([[1, 1, 0, 0, 0], [0, 2, -1, 0, 1], [0, 0, 0, 1, -4]], [1, 3, 5]),
    "repeated": ([[1, 1, 0, 0, 0], [2, 2, 0, 0, 0], [0, 0, 0, 1, 0]], [1, 2, 1]),
    "dependent": ([[1, 1, 0, 0, 0], [0, 0, 1, 1, 0], [1, 1, 1, 1, 0]], [1, 2, 3]),
    "all": (np.eye(5, dtype=int).tolist(), [1, 2, 3, 4, 5]),
}


@pytest.mark.parametrize("name", CONSTRAINTS)
def test_constrained_least_squares_equals_exact_arithmetic(name):
    S, c = CONSTRAINTS[name]
    model, record = NARX.from_terms(MIXED), noise_record(24)
    equations = [
        sum(s * t for s, t in zip(row, model.symbols, strict=True)) - value for row, value in zip(S, c, strict=True)
    ]
    model = model.fit(record, equations)
    expected = exact_constrained(*regression(model, record), S, c)
    np.testing.assert_allclose(model.theta, expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(np.array(S) @ model.theta, c, atol=1e-13)
    fixed = [i for i in range(5) if any(np.count_nonzero(row) == 1 and row[i] for row in S)]
    assert all((model.standard_errors[i] < 1e-12) == (i in fixed) for i in range(5))
    # The constraints stay with the model: fitted again without naming them, nothing changes.
    again = model.theta
    np.testing.assert_allclose(model.fit(record).theta, again, rtol=1e-12)


def test_sigma_y_is_exactly_one():
    record = made(BENCH.terms, BENCH.theta, slow(3_000), noise=0.05)
    model = BENCH.model().fit(record, ["continuum"])
    assert model.theta[0] == 1.0 and continuum(model, 0)
    rest = model.simulate(np.full(100, 7.0), 12.5)
    assert np.array_equal(rest, np.full(100, 12.5))
    two = NARX.from_terms(["y[k-1]", "y[k-2]", "phi1[k-1]"])
    two = two.fit(record, [sp.Eq(two.sigma_y, 1)])
    assert abs(two.theta[0] + two.theta[1] - 1) <= 4.5e-16 and continuum(two)
    whole = NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]", "1"]).fit(record, ["continuum"])
    np.testing.assert_allclose(whole.theta, [1, whole.theta[1], -whole.theta[1], 0], rtol=0, atol=1e-14)


A, B = sp.symbols("theta_1 theta_2", real=True)


@pytest.mark.parametrize(
    "equations, words",
    (
        ([A - 1, A - 2], "contradict"),
        ([A + B - 1, 2 * A + 2 * B - 3], "contradict"),
        ([sp.Eq(A, 1), sp.false], "can never hold"),
        ([A * B - 1], "not linear"),
        ([A**2 - 1], "not linear"),
        ([sp.Symbol("alpha") - 1], "alpha"),
        ([sp.Symbol("theta_1") - 1], "theta_1"),  # not the model's symbol, which is real
        (["sigma"], "Unknown constraint 'sigma'"),
    ),
)
def test_impossible_constraints(equations, words):
    for method in ("one_step", "free_run"):
        with pytest.raises(FitError, match=words):
            NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(noise_record(), equations, method=method)


@pytest.mark.parametrize("nothing", (sp.true, sp.S.Zero, sp.Eq(A - A, 0, evaluate=False)))
def test_a_constraint_that_says_nothing_changes_nothing(nothing):
    record = noise_record()
    model = NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"])
    one = model.symbols[1] + model.symbols[2] - 1
    alone = np.array(model.fit(record, [one]).theta)
    np.testing.assert_allclose(model.fit(record, [one, nothing]).theta, alone, rtol=1e-12)


# ---------------------------------------------------------------- what cannot be fitted


def test_data_that_do_not_determine_the_model():
    record = noise_record(100)
    for terms in (["phi1[k-1]", "u[k-1]", "u[k-2]"], ["phi1[k-1]", "phi2[k-1]**2*phi1[k-1]"]):
        with pytest.raises(FitError, match="linearly dependent"):
            NARX.from_terms(terms).fit(record)
    ramp = Record.from_arrays(np.arange(50.0), np.arange(50.0) ** 2, Ts=1)
    with pytest.raises(FitError, match="linearly dependent"):
        NARX.from_terms(["phi2[k-1]", "phi1[k-1]"]).fit(ramp)
    half = Record.from_arrays(np.abs(record.u), record.y, Ts=1)
    with pytest.raises(FitError, match="zero on all"):
        NARX.from_terms(["y[k-1]", "Min(u[k-1], 0)"]).fit(half)
    with pytest.raises(FitError, match="5 parameters cannot be estimated from 4 equations"):
        NARX.from_terms(MIXED).fit(noise_record(6))
    with pytest.raises(FitError, match="5 parameters cannot be estimated from 5 equations"):
        NARX.from_terms(MIXED).fit(noise_record(7))
    with pytest.raises(FitError, match="shorter than the largest lag"):
        NARX.from_terms(["y[k-30]"]).fit(noise_record(20))
    with pytest.raises(FitError, match="not finite"):
        NARX.from_terms(["y[k-1]", "log(u[k-1])"]).fit(record)
    with pytest.raises(DataError, match="constant"):
        NARX.from_terms(["y[k-1]"]).fit(Record.from_arrays(np.ones(50), record.y[:50], Ts=1))
    # A machine that rests in one segment tells something in the others.
    still = replace(record, u=np.where(np.arange(len(record)) < 60, record.u[60], record.u), breaks=(60,))
    assert NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(still).theta is not None
    with pytest.raises(FitError, match="Unknown method"):
        NARX.from_terms(["y[k-1]"]).fit(record, method="magic")
    with pytest.raises(FitError, match="not linear in its parameters"):
        Model(y[k - 1] * A + u[k], [A]).fit(record)
    with pytest.raises(ModelError, match="'temperature'"):
        NARX.from_terms(["y[k-1]", "temperature[k]"], channels=["temperature"]).fit(record)


# ---------------------------------------------------------------- free-run fit


def test_a_free_run_fit_recovers_the_exact_parameters():
    record = made(BENCH.terms, BENCH.theta, slow(1_500))
    model = BENCH.model(np.array(BENCH.theta) * (1, 1.1, 0.8, 0.9, 1.2, 1.1))
    model = model.fit(record, ["continuum"], method="free_run")
    np.testing.assert_allclose(model.theta, BENCH.theta, rtol=1e-7)
    assert model.theta[0] == 1 and model.info.converged and model.info.nrmse.free_run < 1e-8


def test_a_free_run_fit_of_a_model_that_is_not_linear_in_its_parameters():
    a, d = sp.symbols("a d", real=True)
    make = lambda theta: Model(0.9 * y[k - 1] + a * sp.tanh(d * u[k - 1]), [a, d], theta)  # noqa: E731
    source = slow(500, peak=3.0)
    record = Record.from_arrays(source, make([0.7, 1.6]).simulate(source, 0.0), Ts=1)
    np.testing.assert_allclose(make([1.0, 1.0]).fit(record, method="free_run").theta, [0.7, 1.6], rtol=1e-7)
    tied = make([1.0, 1.0])
    tied = tied.fit(record, [sp.Eq(a, sp.Rational(7, 10))], method="free_run")
    assert tied.theta[0] == 0.7 and tied.theta[1] == pytest.approx(1.6, rel=1e-7)


def test_under_output_noise_the_free_run_fit_beats_one_step():
    source, fresh = slow(3_000), slow(1_000, seed=9)
    truth = made(BENCH.terms, BENCH.theta, fresh)
    for seed in range(2):
        record = made(BENCH.terms, BENCH.theta, source, noise=0.3, seed=seed)
        one = BENCH.model().fit(record, ["continuum"])
        free = BENCH.model().fit(record, ["continuum"], method="free_run")
        assert free.theta[0] == 1.0
        assert evaluate(free, truth).free_run_nrmse < 0.5 * evaluate(one, truth).free_run_nrmse
        assert evaluate(free, record).free_run_nrmse <= evaluate(one, record).free_run_nrmse
        off = np.abs(free.theta - BENCH.theta) / np.maximum(free.standard_errors, 1e-300)
        assert np.all(off[1:] < 5)  # white noise: the standard errors hold


def test_free_run_fits_merge_records_and_estimate_each_start():
    records = [made(BENCH.terms, BENCH.theta, slow(700, seed=s)) for s in (1, 2)]
    lifted = Record.from_arrays(records[1].u, records[1].y, Ts=0.01)
    model = BENCH.model(np.array(BENCH.theta) * 1.05)
    model = model.fit([records[0], lifted], [sp.Eq(model.sigma_y, 1)], method="free_run")
    np.testing.assert_allclose(model.theta, BENCH.theta, rtol=1e-6)


def test_a_diverging_start_is_said():
    record = made(BENCH.terms, BENCH.theta, slow(600))
    with pytest.raises(FitError, match="diverges"):
        NARX.from_terms(["y[k-1]", "u[k-1]"], [4.0, 1.0]).fit(record, method="free_run")


def test_auto_keeps_the_better_free_run():
    noisy = made(BENCH.terms, BENCH.theta, slow(1_500), noise=0.3)
    one, auto = BENCH.model().fit(noisy, ["continuum"]), BENCH.model()
    auto = auto.fit(noisy, ["continuum"], method="auto")
    assert auto.info.method == "free_run" and one.info.method == "one_step"
    assert auto.info.nrmse.free_run < one.info.nrmse.free_run
    assert auto.constraints == one.constraints and auto.theta[0] == 1


def test_auto_keeps_one_step_where_the_free_run_diverges():
    random = np.random.default_rng(0)
    # An unstable plant, measured under feedback: its free run diverges.
    source, out = np.zeros(3_000), np.zeros(3_000)
    for i in range(1, 3_000):
        source[i - 1] = -1.5 * out[i - 1] + random.standard_normal()
        out[i] = 2 * out[i - 1] + source[i - 1]
    record = Record.from_arrays(source, out, Ts=1)
    model = NARX.from_terms(["y[k-1]", "u[k-1]"])
    model = model.fit(record, method="auto")
    np.testing.assert_allclose(model.theta, (2, 1), rtol=1e-9)
    assert model.info.method == "one_step" and model.info.nrmse.free_run == np.inf
    # A model that is not linear in its parameters has no other fit.
    stuck = Model(A * y[k - 1] + B * u[k - 1], [A, B], [3.0, 1.0])
    with pytest.raises(FitError, match="diverge"):
        stuck = stuck.fit(record, method="auto")
    assert stuck.theta.tolist() == [3, 1]


# ---------------------------------------------------------------- sensitivities


C, D = sp.symbols("c d", real=True)


# ---------------------------------------------------------------- simulate and predict


def test_simulate_takes_any_kind_of_one_signal():
    model = BENCH.published()
    source = slow(300)
    expected = model.simulate(source, 0.5)
    assert expected.shape == (300,) and expected.dtype == float and expected[:3].tolist() == [0.5] * 3
    for given_u in (
        source[:, None],
        source[None, :],
        source.tolist(),
        pd.Series(source, index=range(5, 305)),
        source[::1],
    ):
        assert np.array_equal(model.simulate(given_u, 0.5), expected)
    for engine in ("casadi", "python"):
        np.testing.assert_allclose(simulate(model, source, 0.5, engine=engine), expected, atol=1e-10)
    hand = expected.copy()
    x, t = source, BENCH.theta
    for i in range(3, 300):
        d1, d2 = x[i - 1] - x[i - 2], x[i - 2] - x[i - 3]
        hand[i] = (
            t[0] * hand[i - 1] + t[1] * d1 + t[2] * abs(d2) * x[i - 2] + t[3] * abs(d2) * hand[i - 1]
            + t[4] * d2 * x[i - 2] ** 2 + t[5] * d2 * x[i - 2] * hand[i - 1]
        )  # fmt: skip
    np.testing.assert_allclose(expected, hand, atol=1e-11)


def test_the_start_of_a_simulation():
    model = NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], (0.5, 0.2, 1.0))
    assert model.simulate([0.0, 0, 0], [1.0, 2.0]).tolist() == [1, 2, 1.2]
    assert model.simulate([0.0], 3.0).tolist() == [3] and model.simulate([0.0, 0], [3.0, 4]).tolist() == [3, 4]
    with pytest.warns(UserWarning, match="starts from 0"):
        assert model.simulate([1.0, 1, 1])[0] == 0
    model = model.replace(info=Info(line=(10.0, 2.0)))
    assert model.simulate([1.0, 1, 1])[:2].tolist() == [12, 12]
    assert NARX.from_terms(["1", "u[k-1]"], (2, 1)).simulate([1.0, 2], 0.0).tolist() == [0, 3]
    for bad in ([], [1.0, np.nan], [np.inf, 1]):
        with pytest.raises(ModelError, match="finite numbers"):
            model.simulate(bad)
    with pytest.raises(ModelError, match="at least one sample"):
        model.simulate([1.0, 1, 1], [])
    with pytest.raises(ModelError, match="no parameter values"):
        BENCH.model().simulate([1.0, 2])


def test_a_diverging_simulation_says_where_and_why():
    model = NARX.from_terms(["y[k-1]", "u[k-1]"], (3.0, 1.0))
    with pytest.raises(Diverged, match=r"sample \d+ is not finite.*unstable model"):
        model.simulate(np.ones(2_000), 0.0)
    assert evaluate(model, noise_record(2_000)).free_run_nrmse == np.inf


def test_predict_uses_measured_outputs():
    record = noise_record(50, channels={"p": np.arange(50.0)})
    model = NARX.from_terms([*MIXED, "p[k-3]"], (0.5, -0.2, 1.0, 0.3, 0.1, 0.01), channels=["p"])
    found = predict(model, record)
    assert found.shape == (50,) and np.array_equal(found[:3], record.y[:3])
    i = np.arange(3, 50)
    x, out = record.u, record.y
    expected = 0.5 * out[i - 1] - 0.2 * out[i - 2] + x[i - 1] + 0.3 * (x[i - 1] - x[i - 2]) + 0.01 * (i - 3.0)
    np.testing.assert_allclose(found[3:], expected + 0.1 * np.sign(x[i - 1] - x[i - 2]) * x[i - 2], atol=1e-13)
    assert free_run(model, record).shape == (50,)


def test_an_inverse_model_predicts_the_input_from_the_output_ahead():
    record = noise_record(40)
    model = NARX.from_terms(["u[k-1]", "breve_phi1[k-1]"], (0.5, 2.0), input="y", output="u", lead=2)
    found = predict(model, record)
    i = np.arange(2, 38)
    assert found.shape == (38,)
    np.testing.assert_allclose(found[2:], 0.5 * record.u[i - 1] + 2 * (record.y[i + 1] - record.y[i]), atol=1e-13)
    made_up = Record.from_arrays(found, record.y[:38], Ts=1)
    assert len(made_up) == 38


def test_extended_least_squares_removes_the_bias_of_noise_at_the_output():
    """Noise after a lag is a moving average in its equation: y[k] - 0.8 y[k-1] holds e[k] - 0.8 e[k-1]."""
    rng = np.random.default_rng(12)
    source = rng.standard_normal(6000)
    clean = np.zeros(6000)
    for i in range(1, 6000):
        clean[i] = 0.8 * clean[i - 1] + 0.3 * source[i - 1]
    record = Record.from_arrays(source, clean + 0.3 * rng.standard_normal(6000), Ts=1.0)
    model = NARX.from_terms(["y[k-1]", "u[k-1]"])
    plain, better = (model.fit(record, method=method) for method in ("one_step", "els"))
    assert abs(plain.theta[0] - 0.8) > 0.1 and better.theta == pytest.approx([0.8, 0.3], abs=0.02)
    assert better.info.method == "els" and better.info.converged and better.terms == model.terms
    held = model.fit(record, [sp.Eq(model.symbols[1], 0.3)], method="els")
    assert held.theta[1] == 0.3 and held.theta[0] == pytest.approx(0.8, abs=0.02)


def test_derivatives_that_cannot_be_decomposed_are_no_fit(monkeypatch):
    """LAPACK gives up on some: that start counts for nothing, the one-step fit is kept."""

    def fails(*args, **kwargs):
        raise np.linalg.LinAlgError("SVD did not converge")

    rng = np.random.default_rng(0)
    u = rng.normal(size=200)
    y = np.zeros(200)
    for i in range(1, 200):
        y[i] = 0.8 * y[i - 1] + 0.2 * u[i - 1]
    record = Record.from_arrays(u, y, 0.01)
    model = NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.5])
    monkeypatch.setattr(freerun, "least_squares", fails)
    with pytest.raises(FitError, match="decomposed"):
        fit(model, record, method="free_run")
    assert fit(model, record).theta == pytest.approx([0.8, 0.2])


def test_a_friction_that_reverses_is_fitted_beyond_its_derivatives():
    """When a sign turns moves with the parameters, which no derivative tells: secants of the free run do."""
    ends = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        t = np.arange(1000) * 0.01
        u = 2 * np.sin(np.pi * t) + np.sin(2 * np.pi * rng.uniform(0.1, 2) * t) + 0.3 * rng.standard_normal(t.size)
        base = NARX.from_terms(["y[k-1]", "u[k-1]"], [0.9, 0.1], Ts=0.01)
        variant = next(v for v in variants(base, []) if v.id == "coulomb_friction" and v.where == "inside")
        truth = extend(base, variant).model.replace(theta=[0.9, 0.1, -0.03])
        clean = truth.simulate(u, np.zeros(2), warn=False)
        noise = 0.01 * clean.std()
        record = Record.from_arrays(u, clean + noise * rng.standard_normal(t.size), 0.01)
        start = truth.replace(theta=[0.9, 0.105, -0.018])
        for jumps in (False, True):
            problem = freerun.FreeRun(start, record, [])
            assert problem.jumps
            problem.jumps = jumps
            found = problem.minimise(problem.start(np.array(start.theta)), 60, 1e-7)
            ends.append(np.sqrt(2 * found.cost / t.size) * problem.spread / noise)
    by_derivatives, by_secants = np.array(ends).reshape(-1, 2).T
    assert np.all(by_secants < 1.05 * np.maximum(1.0, by_derivatives))
    assert np.mean(by_secants > 1.05) <= np.mean(by_derivatives > 1.05) / 2
    assert np.mean(by_derivatives > 1.05) >= 0.25  # else this test says nothing
