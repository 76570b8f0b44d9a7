"""Data at rest in the one-step fit: their rows, their weight, and what is refused."""

import warnings

import numpy as np
import pytest
import sympy as sp

import narx_sym as ns
from narx_sym.engines.columns import Columns
from narx_sym.symbolic.signals import k, signal, t, u, y

N, TERMS = 400, ("y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]**2", "phi1[k-1]*y[k-1]", "phi2[k-1]*u[k-2]", "1")
POINTS = np.array([[0.5, 0.3], [-1.0, 0.2], [2.0, 1.7]])


def record(seed=0, at=(0.0, 0.0)):
    source, output = np.random.default_rng(seed).standard_normal((2, N))
    return ns.Record.from_arrays(at[0] + source, at[1] + output, Ts=0.1)


def at_rest(points):
    """The rows of TERMS and of the output, written by hand: phi1 = phi2 = 0."""
    source, output = points.T
    zero = np.zeros_like(source)
    return np.column_stack([output, output, source, source**2, zero, zero, zero + 1]), output


def stacked(measured, points, weight, at=(0.0, 0.0)):
    rows = Columns([*ns.NARX.from_terms(TERMS).terms, y[k]])({"u": measured.u - at[0], "y": measured.y - at[1]})
    Psi, target = at_rest(points - at)
    share = np.sqrt(weight * len(rows) / len(points))
    return np.vstack([rows[:, :-1], share * Psi]), np.concatenate([rows[:, -1], share * target])


@pytest.mark.parametrize("weight", (0.1, 1.0, 1e4))
def test_each_point_is_one_row(weight):
    fitted = ns.NARX.from_terms(TERMS).fit(record(), steady_state=POINTS.tolist(), weight=weight)
    Psi, target = stacked(record(), POINTS, weight)
    np.testing.assert_allclose(fitted.theta, np.linalg.lstsq(Psi, target)[0], rtol=1e-9)
    rss = np.sum((target - Psi @ fitted.theta) ** 2)
    spread = np.sqrt(np.diag(np.linalg.inv(Psi.T @ Psi)) * rss / (len(target) - len(TERMS)))
    np.testing.assert_allclose(fitted.standard_errors, spread, rtol=1e-9)


def test_one_point_and_several_records():
    records = [record(seed) for seed in range(2)]
    fitted = ns.NARX.from_terms(TERMS).fit(records, steady_state=POINTS[:1])
    parts = [stacked(r, POINTS[:1], 0.0) for r in records]
    Psi, target = at_rest(POINTS[:1])
    share = np.sqrt(2 * (N - 2))
    Psi = np.vstack([*(p[0][:-1] for p in parts), share * Psi])
    target = np.concatenate([*(p[1][:-1] for p in parts), share * target])
    np.testing.assert_allclose(fitted.theta, np.linalg.lstsq(Psi, target)[0], rtol=1e-9)


def test_without_weight_they_are_no_data():
    model = ns.NARX.from_terms(TERMS)
    plain, none = model.fit(record()), model.fit(record(), steady_state=POINTS, weight=0)
    assert none.theta.tolist() == plain.theta.tolist() and none.standard_errors == plain.standard_errors


def test_they_are_measured_from_the_operating_point():
    at = (3.0, -2.0)
    model = ns.NARX.from_terms(TERMS, operating_point={ns.u: at[0], ns.y: at[1]})
    fitted = model.fit(record(at=at), steady_state=POINTS + at, weight=2.0)
    Psi, target = stacked(record(at=at), POINTS + at, 2.0, at)
    np.testing.assert_allclose(fitted.theta, np.linalg.lstsq(Psi, target)[0], rtol=1e-9)


def test_constraints_hold_beside_them():
    model = ns.NARX.from_terms(TERMS)
    fitted = model.fit(record(), [sp.Eq(model.sigma_y, 1)], steady_state=POINTS, weight=5.0)
    assert float(model.sigma_y.xreplace(fitted.values)) == pytest.approx(1, abs=1e-12)
    Psi, target = stacked(record(), POINTS, 5.0)
    reduced = np.column_stack([Psi[:, 0] - Psi[:, 1], Psi[:, 2:]])  # theta_2 = 1 - theta_1
    found = np.linalg.lstsq(reduced, target - Psi[:, 1])[0]
    np.testing.assert_allclose(fitted.theta, [found[0], 1 - found[0], *found[1:]], rtol=1e-9)


def test_an_inverse_model_rests_where_the_machine_does():
    model = ns.NARX.from_terms(("u[k-1]", "y[k-1]", "1"), output="u", input="y", lead=2)
    fitted = model.fit(record(), steady_state=POINTS, weight=1e12)
    slope, gain, offset = fitted.theta
    line = np.linalg.lstsq(np.column_stack([POINTS[:, 1], np.ones(3)]), POINTS[:, 0] * (1 - slope))[0]
    np.testing.assert_allclose([gain, offset], line, atol=1e-4)


def test_the_input_may_be_another_channel():
    one = record()
    other = ns.Record.from_arrays(one.u[::-1].copy(), one.y, Ts=0.1, channels={"force": one.u})
    fitted = ns.NARX.from_terms(("y[k-1]", "force[k-1]"), input="force").fit(other, steady_state=POINTS)
    same = ns.NARX.from_terms(("y[k-1]", "u[k-1]")).fit(one, steady_state=POINTS)
    np.testing.assert_allclose(fitted.theta, same.theta, rtol=1e-12)


def test_a_continuum_learns_nothing_from_them():
    model = ns.NARX.from_terms(("y[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]"))
    with pytest.warns(UserWarning, match="steady-state data change nothing"):
        fitted = model.fit(record(), "continuum", steady_state=POINTS)
    np.testing.assert_allclose(fitted.theta, model.fit(record(), "continuum").theta, rtol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.fit(record(), steady_state=POINTS)


BAD = {
    "shape": ([1.0, 2.0], "shape"),
    "columns": (np.ones((4, 3)), "shape"),
    "none": (np.zeros((0, 2)), "n > 0"),
    "empty": ([], "n > 0"),
    "ragged": ([[1.0, 2.0], [3.0]], "pairs of numbers"),
    "text": ([["a", "b"]], "pairs of numbers"),
    "missing": ([[1.0, 2.0], [3.0, np.nan]], "in row 1"),
    "masked": (np.ma.masked_greater(POINTS, 1.9), "in row 2"),
    "infinite": ([[np.inf, 2.0]], "in row 0"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_point_is_refused(name):
    points, said = BAD[name]
    with pytest.raises(ns.FitError, match=said):
        ns.NARX.from_terms(TERMS).fit(record(), steady_state=points)


@pytest.mark.parametrize("weight", (-1.0, np.nan, np.inf, "much"))
def test_what_is_no_weight_is_refused(weight):
    with pytest.raises(ns.FitError, match="weight"):
        ns.NARX.from_terms(TERMS).fit(record(), steady_state=POINTS, weight=weight)


@pytest.mark.parametrize("method", ("auto", "free_run", "els"))
def test_other_methods_take_no_points(method):
    with pytest.raises(ns.FitError, match="one-step fit: use method='one_step'"):
        ns.NARX.from_terms(TERMS).fit(record(), method=method, steady_state=POINTS)


def test_a_model_that_is_not_linear_in_its_parameters_takes_none():
    a = sp.Symbol("a")
    with pytest.raises(ns.FitError, match="linear in their parameters"):
        ns.Model(a**2 * y[k - 1] + u[k - 1], [a], [0.5]).fit(record(), steady_state=POINTS)


def test_a_channel_or_a_clock_is_not_at_rest():
    for other in (signal("temp")[k - 1], t[k]):
        with pytest.raises(ns.FitError, match="hold input and output alone"):
            ns.NARX([y[k - 1], u[k - 1], other]).fit(record(), steady_state=POINTS)


def test_a_term_that_has_no_value_at_rest_is_named():
    measured = record(at=(10.0, 0.0))
    with pytest.raises(ns.FitError, match=r"not finite at rest at u = 0, y = 1"):
        ns.NARX.from_terms(["y[k-1]", "1/u[k-1]"]).fit(measured, steady_state=[[1.0, 1.0], [0.0, 1.0]])
