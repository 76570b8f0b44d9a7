"""Least squares, constraints, derivatives and standard errors against references that share no code with them."""

from fractions import Fraction

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from truth import NAMES, complex_step, digits, exact_constrained, exact_least_squares, smooth_models, strd

from narx_sym.data.record import Record
from narx_sym.engines.columns import Columns
from narx_sym.engines.compile import compile
from narx_sym.errors import FitError
from narx_sym.fit.constraints import Elimination
from narx_sym.fit.least_squares import CORRECTED, factor, one_step, refined, solve_factor
from narx_sym.models.model import NARX
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.sensitivity import sensitivities
from narx_sym.symbolic.signals import expand_phi, k, y

# ---------------------------------------------------------------- NIST StRD

LEAST = {"lower": 12.0, "average": 14.0, "higher": 9.0}  # correct digits


def test_all_sets_are_there():
    assert len(NAMES) == 11 and {strd(n).level for n in NAMES} == set(LEAST)


@pytest.mark.parametrize("name", NAMES)
def test_the_data_are_transcribed_rightly(name):
    data = strd(name)
    theta, squares = exact_least_squares(*data.design(Fraction))
    assert digits(theta, data.theta) > 14.2 and digits([float(s) ** 0.5 for s in squares], data.std) > 14.2


@pytest.mark.parametrize("name", NAMES)
def test_certified_values(name):
    data = strd(name)
    theta, std = one_step(*data.fit_problem, [])
    if name != "Filip":
        assert digits(theta, data.theta) >= LEAST[data.level]
        assert digits(std, data.std) >= 9
        return
    # Its powers of x, rounded to doubles, are another problem: that one's solution is what can be attained.
    model, record = data.fit_problem
    rounded = Columns(model.terms)({"u": record.u})
    theta_rounded, _ = exact_least_squares(
        [[Fraction(v) for v in column] for column in rounded.T.tolist()], [Fraction(v) for v in record.y.tolist()]
    )
    attainable = digits(theta_rounded, data.theta)
    assert 7 < attainable < 9
    assert digits(theta, data.theta) >= attainable - 0.5
    assert digits(std, data.std) > 7


@pytest.mark.parametrize("name", ("Wampler3", "Wampler4", "Wampler5"))
def test_a_correction_gains_digits_and_leaves_easy_problems_alone(name):
    data = strd(name)
    model, record = data.fit_problem
    columns, sequences = Columns([*model.terms, y[k]]), {"u": record.u, "y": record.y}
    R, rows = factor(columns, [sequences])
    z, _ = solve_factor(R, rows, data.terms)
    block = columns(sequences)
    corrected = refined(z, R, [block])
    assert digits(corrected, data.theta) > digits(z, data.theta) + 2
    by_rows = refined(z, R, [block[i : i + 1] for i in range(len(block))])
    assert digits(by_rows, data.theta) > digits(corrected, data.theta) - 1
    # Units do not decide whether it is taken.
    units = 10.0 ** np.array([9, 0, -9, 12, 0, 3, 0])
    assert not np.array_equal(refined(z / units[:6], R * units, [block * units]), z / units[:6])
    easy = np.triu(np.random.default_rng(0).standard_normal((4, 4))) + 4 * np.eye(4)
    assert np.abs(np.diag(easy)[:3] / np.linalg.norm(easy[:3, :3], axis=0)).min() > CORRECTED[1]
    assert np.array_equal(refined(z[:3], easy, [np.full((2, 4), np.nan)]), z[:3])


def test_records_in_any_unit_and_in_several_pieces():
    data = strd("Longley")
    model, record = data.fit_problem
    theta, std = one_step(model, record, [])
    big = Record.from_arrays(record.u * 1e9, record.y * 1e-9, Ts=1.0, channels=record.channels)
    scaled, spread = one_step(model, big, [])
    units = np.where(np.arange(7) == 1, 1e-18, 1e-9)
    assert digits(scaled / units, theta) > 9 and digits(spread / units, std) > 9
    pieces = [record[:5], record[5:9], record[9:]]
    assert digits(one_step(model, pieces, [])[0], data.theta) > 9


def test_columns_that_are_dependent_to_the_last_digit_are_refused():
    source = np.random.default_rng(0).standard_normal(50)
    record = Record.from_arrays(source, source, Ts=1.0, channels={"p": source * (1 + 1e-15)})
    with pytest.raises(FitError, match="linearly dependent"):
        one_step(NARX.from_terms(["u[k]", "p[k]"], channels=["p"]), record, [])


# ---------------------------------------------------------------- constraints


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.lists(st.integers(-3, 3), min_size=4, max_size=4).filter(any), min_size=1, max_size=3),
    st.lists(st.integers(-3, 3), min_size=4, max_size=4),
    st.integers(0, 999),
)
def test_constrained_least_squares_equals_rationals(S, inside, seed):
    random = np.random.default_rng(seed)
    record = Record.from_arrays(random.standard_normal(20), random.standard_normal(20), Ts=1.0)
    model = NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]", "phi1[k-1]*y[k-1]"])
    c = [sum(s * v for s, v in zip(row, inside, strict=True)) for row in S]
    equations = [sum(s * t for s, t in zip(row, model.symbols, strict=True)) - v for row, v in zip(S, c, strict=True)]
    theta, _ = one_step(model, record, equations)
    rows = Columns([*model.terms, y[k]])({"u": record.u, "y": record.y})
    expected = exact_constrained(rows[:, :-1], rows[:, -1], S, c)
    np.testing.assert_allclose(theta, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


# ---------------------------------------------------------------- derivatives


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(smooth_models())
def test_sensitivities_equal_complex_steps_for_random_models(made):
    right, parameters, theta, seed = made
    recursion = Recursion(((y[k], right),), parameters)
    assume(recursion.inputs)
    inputs, start = {"u": np.random.default_rng(seed).uniform(-1, 1, 40)}, np.full(recursion.depth, 0.25)
    extended, directions = sensitivities(recursion, initial=True)
    moved = [d.get(y) for d in directions]
    initial = {y: start, **{m: 0.0 for m in moved if m is not None}}
    if moved[-1] is not None:
        initial[moved[-1]] = 1.0
    found = compile(extended, "python")(inputs, theta, initial)
    run, slopes = complex_step(expand_phi(right), parameters, inputs, theta, start)
    np.testing.assert_allclose(found["y"], run, rtol=1e-12, atol=1e-13)
    for name, expected in zip(moved, slopes, strict=True):
        if name is None:
            assert not np.any(expected[recursion.depth :])
            continue
        gap = np.abs(found[str(name.label)] - expected).max()
        assert gap <= 1e-12 * max(1e-3, np.abs(expected).max())


def test_the_unit_of_a_constraint_does_not_matter():
    """An equation with coefficients of 1e-13 is the same equation."""
    a, b, c = sp.symbols("a b c", real=True)
    for size in (1.0, 1e-14, 1e12):
        tiny = sp.Eq(sp.Float(size) * (a + 2 * b), sp.Float(size) * 3, evaluate=False)
        both = Elimination.of([tiny, sp.Eq(b + c, 1, evaluate=False)], [a, b, c])
        assert both.Z.shape == (3, 1)
        theta = both.t0 + both.Z @ [0.7]
        assert theta[0] + 2 * theta[1] == pytest.approx(3) and theta[1] + theta[2] == pytest.approx(1)
