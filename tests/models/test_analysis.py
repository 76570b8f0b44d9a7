"""Steady state, Sigma_y, the continuum, Property 1, Jury's conditions, quasi-static sets."""

import itertools

import numpy as np
import pytest
import sympy as sp
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from paper import BENCH
from sampling import some

from narx_sym.engines.columns import evaluate_quasi_static
from narx_sym.errors import ModelError
from narx_sym.fit.bases.play import Shape
from narx_sym.models.added import AddedEffect
from narx_sym.models.analysis import (
    characteristic,
    check,
    constraint_matrix,
    continuum,
    continuum_conditions,
    folded,
    jacobian,
    jury,
    phi1_,
    property_1,
    quasi_static,
    remembered,
    rest_map,
    sigma_y,
    steady_state,
    u_,
    ubar,
    ybar,
    ytilde,
    z,
)
from narx_sym.models.effects import EFFECTS
from narx_sym.models.extend import extend, variants
from narx_sym.models.info import Info
from narx_sym.models.model import NARX, Model
from narx_sym.models.rest.equilibria import constrained
from narx_sym.models.rest_map import plays, rest_of
from narx_sym.symbolic.identities import added
from narx_sym.symbolic.recursion import State
from narx_sym.symbolic.signals import Name, k, phi1, phi2, signal, t, u, y

TABLE_1 = tuple(BENCH.theta)


def zero(expression):
    return sp.simplify(expression) == 0


# ---------------------------------------------------------------- steady state and Sigma_y


def test_the_rest_map_holds_every_signal_constant():
    model = NARX.from_terms([*BENCH.terms, "u[k-1]", "y[k-2]*u[k-3]", "phi2[k-1]", "p[k-1]"], channels=["p"])
    t = model.symbols
    pbar = rest_of(signal("p"))
    assert zero(rest_map(model) - (t[0] * ybar + t[6] * ubar + t[7] * ybar * ubar + t[9] * pbar))


@pytest.mark.parametrize(
    "terms, theta, expected",
    (
        (BENCH.terms, TABLE_1, True),
        (BENCH.terms, (0.999, *TABLE_1[1:]), False),
        (["y[k-1]", "u[k-1]"], (1, 0.1), False),  # Assumption 1 and Sigma_y = 1 hold, and it drifts
        (["y[k-1]", "u[k-1]", "u[k-2]"], (1, 0.1, -0.1), True),
        (["y[k-1]", "1"], (1, 0.1), False),
        (["y[k-1]", "1"], (1, 0), True),
        (["y[k-1]", "y[k-1]*u[k-1]"], (1, 0.1), False),
        (["y[k-1]", "y[k-2]*u[k-1]", "y[k-1]*u[k-2]"], (1, 0.1, -0.1), True),
        (["y[k-1]", "y[k-2]", "y[k-3]", "phi1[k-1]"], (0.5, 0.2, 0.3, 1), True),
        (["y[k-1]", "y[k-1]**2"], (1, 0.1), False),
        (["y[k-1]", "phi2[k-1]**2"], (1, 3), True),
    ),
)
def test_a_continuum_needs_the_whole_rest_map(terms, theta, expected):
    model = NARX.from_terms(terms, theta)
    assert continuum(model) is expected
    conditions = [(c.lhs - c.rhs).xreplace(model.values) for c in continuum_conditions(model)]
    assert all(abs(float(c)) < 1e-12 for c in conditions) is expected
    # What it means: from anywhere, a constant input keeps the output where it is.
    depth = model.recursion.depth
    moved = [
        model.simulate(np.full(10, v), np.full(depth, start)) - start for v in (-1.5, 0, 2) for start in (-2, 0, 3)
    ]
    assert bool(np.abs(moved).max() < 1e-9) is expected
    assert (steady_state(model).equilibria == "continuum") is expected


def test_continuum_conditions_are_equations_in_the_parameters():
    model = NARX.from_terms(["y[k-1]", "u[k-1]", "1", "y[k-2]", "u[k-2]", "u[k-1]*y[k-1]", "sin(u[k-2])"])
    t = model.symbols
    found = {sp.expand(c.lhs - c.rhs) for c in continuum_conditions(model)}
    assert found == {t[0] + t[3] - 1, t[1] + t[4], t[2], t[5], t[6]}
    assert sp.Eq(t[0] + t[3], 1, evaluate=False) in continuum_conditions(model)
    S, c = constraint_matrix([sp.Eq(BENCH.model().sigma_y, 1)], BENCH.model().symbols)
    assert S == sp.Matrix([[1, 0, 0, 0, 0, 0]]) and c == sp.Matrix([1])


# ---------------------------------------------------------------- Property 1


@pytest.mark.parametrize(
    "terms, theta, count, diverging, holds",
    (
        (BENCH.terms, TABLE_1, "continuum", False, True),
        (["y[k-1]", "u[k-1]"], (0.9, 1), 1, False, False),
        (["y[k-1]", "u[k-1]"], (1.1, 1), 1, True, False),
        (["y[k-1]", "u[k-1]"], (1, 0.1), "continuum", None, False),  # without input it stays anywhere, else it drifts
        (["y[k-1]", "u[k-1]*y[k-1]"], (1, 0.48), "continuum", None, False),
        (["y[k-1]", "abs(y[k-1])", "u[k-1]"], (0.5, -0.84, 0.1), 1, True, False),  # repels on one side of its kink
        (["y[k-1]", "1"], (1, 0.1), 0, None, False),
        (["y[k-1]", "y[k-2]", "phi1[k-1]"], (1.5, -0.5, 1), "continuum", False, True),  # the other root is 0.5
        (["y[k-1]", "y[k-2]", "phi1[k-1]"], (-0.5, 1.5, 1), "continuum", True, False),  # ... and -1.5
        (["y[k-1]", "y[k-2]", "phi1[k-1]"], (2, -1, 1), "continuum", None, None),  # a double root at 1
        (["y[k-1]", "y[k-1]**3"], (1.5, -0.5), 3, False, True),  # -1, 0, 1: both ends attract
        (["y[k-1]", "y[k-1]**2"], (0.5, 0.5), 2, False, False),  # 0 attracts, 1 repels
        (["y[k-1]**2", "1"], (1, 1), 0, None, False),  # complex only
        (
            ["1", "y[k-1]", "y[k-1]**3"],
            (0.05, 1.5, -0.5),
            3,
            False,
            True,
        ),  # bistable, without a closed form in radicals
        (["tanh(y[k-1])"], (1.5,), 3, False, True),
        (["y[k-1]", "abs(y[k-1] - 1)", "1"], (1.2, -0.4, 0.1), 2, False, False),
        (["y[k-1]", "y[k-1]**3", "y[k-1]**5"], (1.9, -1.2, 0.2), 5, False, True),
        (["y[k-1]", "y[k-1]**4", "1"], (1.0, 0.1, 0.2), 0, None, False),  # a quartic without a real root
        (["y[k-1]", "y[k-1]**2", "1"], (-1.0, 1.0, 1.0), 1, None, False),  # (y - 1)^2 = 0: once
        (["y[k-1]", "y[k-1]**2", "1"], (0.4, 0.1, 0.9), 1, None, False),  # the same in decimals
    ),
)
def test_property_1(terms, theta, count, diverging, holds):
    verdict = property_1(NARX.from_terms(terms, theta))
    assert verdict.holds is holds and verdict.diverging is diverging
    assert (verdict.equilibria if count == "continuum" else len(verdict.equilibria)) == count
    assert verdict.reason


# ---------------------------------------------------------------- Jury


def holds(conditions):
    return all(bool(c.doit() if hasattr(c, "doit") else c) for c in conditions)


@example([0.5], True)
@example([2.0, 0.5], False)
@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1.6, 1.6), min_size=1, max_size=5), st.booleans())
def test_jury_agrees_with_the_roots(numbers, as_roots):
    """Polynomials by their coefficients, or by real roots and conjugate pairs."""
    if as_roots:
        roots = np.array(numbers, dtype=complex)
        if len(numbers) >= 2:
            roots[:2] = complex(numbers[0], numbers[1]), complex(numbers[0], -numbers[1])
        coefficients = np.poly(roots).real
    else:
        coefficients = np.array([1.0, *numbers])
    largest = np.abs(np.roots(coefficients)).max(initial=0)
    assume(abs(largest - 1) > 1e-3)
    exact = [sp.Rational(float(c)) for c in coefficients]
    polynomial = sum(c * z ** (len(exact) - 1 - i) for i, c in enumerate(exact))
    table = jury(polynomial)
    # A zero in the first column is the singular case of the table: on the border of what it can decide.
    assume(all((c.lhs - c.rhs) != 0 for c in table))
    assert holds(table) == (largest < 1)
    assert holds(jury(-3 * polynomial)) == (largest < 1)


def test_jury_of_low_orders_in_symbols():
    a, b = sp.symbols("a b", real=True)
    assert jury(z - a) == [sp.Lt(sp.Abs(a), 1, evaluate=False)]
    assert jury(sp.Integer(3)) == []
    triangle = jury(z**2 - a * z - b)
    assert {sp.expand(c.lhs - c.rhs) for c in triangle[:2]} == {1 - a - b, 1 + a - b}
    assert triangle[2].lhs.subs(b, sp.Rational(1, 3)) == sp.Rational(1, 3) and triangle[2].rhs == 1
    assert characteristic([a, b]) == z**2 - a * z - b


# ---------------------------------------------------------------- quasi-static sets


def direct(model, theta, value, step):
    """(fixed point, largest eigenvalue) with u and phi1 held, by iterating and differencing the equation itself."""
    s = np.sign(step)

    def F(*past):
        names = {y[k - i - 1]: v for i, v in enumerate(past)}
        names |= (
            {phi1[k - i]: step for i in range(4)}
            | {phi2[k - i]: s for i in range(4)}
            | {u[k - i]: value for i in range(4)}
        )
        names |= dict(zip(model.symbols, theta, strict=True))
        return float(model.F.xreplace({a: sp.Float(b, 30) for a, b in names.items()}))

    n = model.n_y
    intercept = F(*[0.0] * n)
    slopes = [F(*(float(i == j) for j in range(n))) - intercept for i in range(n)]
    companion = np.vstack([slopes, np.eye(n)[:-1]]) if n else np.zeros((1, 1))
    return intercept / (1 - sum(slopes)), np.abs(np.linalg.eigvals(companion)).max()


@pytest.mark.parametrize(
    "terms, theta",
    (
        (BENCH.terms, TABLE_1),
        (["y[k-1]", "y[k-2]", "phi1[k-1]", "phi1[k-1]*y[k-2]", "phi2[k-1]*u[k-2]"], (1.2, -0.3, 0.5, 0.2, 0.3)),
        (["u[k-1]", "phi2[k-1]*phi1[k-1]"], (2.0, 0.5)),
    ),
)
def test_evaluated_sets_equal_the_equation_itself(terms, theta):
    model = NARX.from_terms(terms, theta)
    source = 4 * np.sin(np.arange(60) * 0.37)
    source[20:25] = source[20]
    found = model.quasi_static().evaluate(source)
    steps = np.diff(source, prepend=source[:1])
    assert np.array_equal(found.phi1, steps) and np.array_equal(found.loading, steps > 0)
    resting = steps == 0
    assert resting.sum() == 5 and np.array_equal(np.isnan(found.ytilde), resting)
    assert not found.attracting[resting].any() and not found.repelling[resting].any()
    assert np.array_equal(found.repelling[~resting], ~found.attracting[~resting])
    for i in np.flatnonzero(~resting):
        point, radius = direct(model, theta, source[i], steps[i])
        assert found.ytilde[i] == pytest.approx(point, rel=1e-9, abs=1e-9)
        assert found.spectral_radius[i] == pytest.approx(radius, rel=1e-9, abs=1e-9)
        assert abs(radius - 1) < 1e-9 or found.attracting[i] == (radius < 1)


def test_both_regions_occur_and_the_conditions_agree_with_the_masks():
    model = BENCH.published()
    sets = model.quasi_static()
    source = 40 * np.sin(np.arange(400) * 0.05)
    found = sets.evaluate(source)
    assert sets.repelling == sp.Not(sets.attracting)
    assert found.attracting.sum() > 20 and found.repelling.sum() > 20
    for i in range(5, 400, 23):
        condition = sets.conditions(bool(found.loading[i])).xreplace(model.values)
        assert (
            bool(condition.xreplace({u_: sp.Float(source[i]), phi1_: sp.Float(found.phi1[i])})) == found.attracting[i]
        )


def test_sets_without_closed_form_or_with_several_solutions():
    a = sp.Symbol("a", real=True)
    with pytest.raises(ModelError, match="no closed-form"):
        Model(y[k - 1] + a * phi1[k - 1], [a]).quasi_static()
    squared = NARX.from_terms(["y[k-1]**2", "u[k-1]"], (0.2, 1)).quasi_static()
    assert isinstance(squared.loading, sp.FiniteSet)
    assert all(zero((squared.model.F - y[k - 1]).xreplace({y[k - 1]: s, u[k - 1]: u_})) for s in squared.loading)


@pytest.mark.parametrize(
    "theta", some([(0.0, 0.2, 0.0), (1.5, 0.0, -0.5), (0.5, 0.0, -0.5), (0.7, 0.5, -0.2), (0.3, 0, 0, 0.2)], 2)
)
def test_several_sets_are_the_real_ones(theta):
    """Also where formulas of real roots need complex numbers: they solve the equation, and none is lost."""
    terms = [f"y[k-1]**{i}" for i, c in enumerate(theta, 1) if c]
    model = NARX.from_terms([*terms, "u[k-1]"], [*(c for c in theta if c), 0.3])
    sets, source = model.quasi_static(), 8 * np.sin(np.arange(1, 60) * 0.37)
    assert not sets.loading.has(sp.I) and "cases" not in sets.latex()  # both branches are one
    found, seen = sets.evaluate(source), set()
    assert found.ytilde.shape == found.attracting.shape == (59, len(theta) if any(theta[2:]) else 2)
    for i in range(1, 59):
        exact = [sp.Rational(str(c)) for c in (*reversed(theta), 0.0)]
        polynomial = sp.Poly(exact, ytilde) + sp.Rational("0.3") * sp.Rational(float(source[i])) - ytilde
        expected = [float(x) for x in sp.Poly(polynomial, ytilde).real_roots()]
        points = found.ytilde[i][np.isfinite(found.ytilde[i])]
        np.testing.assert_allclose(points, expected, rtol=1e-7)
        slopes = sum(n * c * points ** (n - 1) for n, c in enumerate(theta, 1))
        np.testing.assert_array_equal(found.attracting[i, : points.size], np.abs(slopes) < 1)
        seen.add(points.size)
    assert len(seen) > 1 or theta == (
        0.5,
        0.0,
        -0.5,
    )  # as the input moves, some come and go; not of one that only falls


def test_what_constraints_say_is_put_in():
    """1 - Sigma_y is gone from the sets of a Sigma_y = 1 model, and with it the speed of the input; numbers stay."""
    for terms, constraint in (
        (BENCH.terms, "continuum"),
        (["y[k-1]", "y[k-2]", "phi1[k-1]", "phi1[k-1]*y[k-1]"], "continuum"),
        (["y[k-1]", "y[k-2]", "phi1[k-1]", "phi1[k-1]*y[k-1]"], sp.Eq(sp.Symbol("theta_1", real=True), 1)),
    ):
        free = NARX.from_terms(terms)
        model = free.replace(constraints=(constraint,))
        sets, plain = model.quasi_static(), free.quasi_static()
        fixed = constrained(model)
        assert fixed and not (sets.loading.free_symbols | sets.attracting.free_symbols) & fixed.keys()
        for one, other in ((sets.loading, plain.loading), (sets.unloading, plain.unloading)):
            assert zero(one - other.xreplace(fixed))
    assert not NARX.from_terms(BENCH.terms).replace(constraints=("continuum",)).quasi_static().loading.has(phi1_)
    drifting = NARX.from_terms(["y[k-1]", "phi1[k-1]"]).replace(constraints=("continuum",))
    assert drifting.quasi_static().loading.has(drifting.symbols[0])  # with it there is none: the general one stays


@pytest.mark.parametrize("terms", (BENCH.terms, ["y[k-1]", "y[k-2]", "u[k-1]", "phi1[k-2]*u[k-1]", "y[k-1]*phi1[k-1]"]))
def test_around_an_operating_point_the_sets_are_those_of_the_shifted_problem(terms):
    y0, u0 = -96.0, 1.5
    plain, moved = NARX.from_terms(terms), NARX.from_terms(terms, operating_point={y: y0, u: u0})
    a, b = quasi_static(plain), quasi_static(moved)
    for first, second in ((a.loading, b.loading), (a.unloading, b.unloading)):
        assert zero(sp.nsimplify(first.subs(u_, u_ - u0) + y0 - second, rational=True))
    inside = {y[k - i]: y[k - i] - y0 for i in range(1, 3)} | {u[k - i]: u[k - i] - u0 for i in range(1, 4)}
    assert [s.xreplace(inside) for s in jacobian(plain)] == jacobian(moved)
    theta = np.linspace(0.2, 0.6, len(terms))
    plain, moved = plain.replace(theta=theta), moved.replace(theta=theta)
    source = np.sin(np.arange(30.0))
    x, w = plain.quasi_static().evaluate(source), moved.quasi_static().evaluate(source + u0)
    np.testing.assert_allclose(w.ytilde[1:], x.ytilde[1:] + y0, rtol=1e-9)
    np.testing.assert_allclose(w.spectral_radius, x.spectral_radius, rtol=1e-9)
    assert ytilde not in b.loading.free_symbols


# ---------------------------------------------------------------- what is not one equation in y and u


def remembering(right=0):
    """A model with a state that remembers."""
    h, (a_, b_) = signal("h"), sp.symbols("a_0 b_1", real=True)
    return Model(
        a_ * y[k - 1] + h[k] + right, (a_, b_), (0.5, 0.2), states=(State(h[k], b_ * h[k - 1] + u[k - 1], group="1"),)
    )


def test_what_remembers_is_named():
    with pytest.raises(ModelError, match=r"slope .* it has further memory in the state h\[k\]"):
        jacobian(remembering())
    a_, b_ = remembering().symbols
    assert zero(rest_map(remembering()) - (a_ * ybar + ubar / (1 - b_)))  # what settles is where it settles
    named = remembering()
    effects = AddedEffect("offset", group="2"), AddedEffect("creep", group="1", coefficients={"b": named.symbols[1]})
    named = named.replace(effects=effects)
    with pytest.raises(ModelError, match=r"further memory in the effect creep \(h\[k\]\)"):
        quasi_static(named)
    with pytest.raises(ModelError, match="changes with time"):
        rest_map(remembering(t[k]))
    assert remembered(NARX.from_terms(["y[k-1]", "u[k-1]"])) == ""


def test_what_changes_with_time_is_named():
    a_, b_ = sp.symbols("a_1 b_1", real=True)
    drifting = Model(a_ * y[k - 1] + b_ * t[k] + u[k], (a_, b_), (0.5, 0.1))
    with pytest.raises(ModelError, match="the equation changes with time, so there is no steady state"):
        rest_map(drifting)
    drifting = drifting.replace(
        effects=[AddedEffect("offset", coefficients={"c": a_}), AddedEffect("drift", coefficients={"c": b_})]
    )
    with pytest.raises(ModelError, match="the effect drift changes with time"):
        rest_map(drifting)
    assert jacobian(drifting) == [a_]  # a slope does not ask for rest


def test_only_differences_of_neighbours_are_phi1():
    late = u[k - 2]
    parts = [u[k - 1] - late, late - u[k - 1], u[k - 1] + late, u[k - 1] - u[k - 3], 2 * u[k - 1] - late]
    expected = [phi1[k - 1], -phi1[k - 1], *parts[2:]]
    for part, wanted in zip(parts, expected, strict=True):
        assert folded(Model(y[k - 1] / 2 + sp.exp(part), ())) == y[k - 1] / 2 + sp.exp(wanted)


def test_a_set_that_is_the_only_root():
    sets = quasi_static(NARX.from_terms(["y[k-1]", "y[k-1]**2", "y[k-1]*u[k-1]", "u[k-1]**2"], (1, 1, -2, 1)))
    for branch in (sets.loading, sets.unloading):
        known = branch.xreplace(dict(zip(sets.model.symbols, map(sp.Integer, (1, 1, -2, 1)), strict=True)))
        roots = known if isinstance(known, sp.FiniteSet) else [known]
        assert {sp.simplify(root) for root in roots} == {u_}  # (ytilde - u)^2 = 0
    pinned = quasi_static(Model(y[k - 1] + (y[k - 1] - u[k - 1]) ** 2, ()))
    assert pinned.loading == pinned.unloading == u_


def test_without_a_term_in_the_output_the_continuum_has_no_sets():
    """1 - Sigma_y is a rounding error there: the quotient is no number, not 1e16."""
    theta = [0.7, 0.2, 0.1, 0.8]
    model = NARX.from_terms(["y[k-1]", "y[k-2]", "y[k-3]", "phi1[k-1]"], theta)
    assert 0 < abs(added(theta[:3]) - 1) < 1e-15
    found = model.quasi_static().evaluate(np.sin(np.arange(20) / 3))
    assert np.isnan(found.ytilde).all()
    kept = NARX.from_terms(["y[k-1]", "y[k-2]", "phi1[k-1]"], [0.7, 0.2, 0.8]).quasi_static().evaluate([1.0, 2.0])
    assert np.isfinite(kept.ytilde[1])


# ---------------------------------------------------------------- equilibria


def test_what_is_not_solved_is_not_none():
    """Without a change of sign nothing is known about a function; a polynomial is decided."""
    verdict = property_1(NARX.from_terms(["y[k-1]", "exp(y[k-1])"], (1.0, 0.1)))
    assert verdict.equilibria is None and not verdict.holds and "not known" in verdict.reason
    assert steady_state(NARX.from_terms(["tanh(y[k-1])", "u[k-1]"], (1.5, 0.1))).equilibria is None


def test_two_equilibria_at_the_operating_point():
    """Bistable where it is used, at u = 5, and not at u = 0; also found within the identified range."""
    bistable = Model(y[k - 1] - (y[k - 1] ** 3 - y[k - 1]) / 4 - (u[k - 1] - 5) / 2, ())
    assert not property_1(bistable).holds
    bistable = bistable.replace(info=Info(ranges={"u": (3.0, 7.0), "y": (-2.0, 2.0)}))
    verdict = property_1(bistable)
    assert verdict.holds and verdict.at == 5.0 and "at u = 5" in verdict.reason
    moved = Model(y[k - 1] - (y[k - 1] ** 3 - y[k - 1]) / 4 - u[k - 1] / 2, (), operating_point={u: 5.0})
    assert property_1(moved).holds


def test_sigma_y_of_every_way_to_write_it():
    model = NARX.from_terms(["y[k-1]", "phi1[k-1]", "y[k-3]", "y[k-1]*phi1[k-1]", "y[k-2]**2", "u[k-1]"])
    assert sigma_y(model) == model.sigma_y == model.symbols[0] + model.symbols[2]
    a, b = sp.symbols("a b", real=True)
    for core in (a * (y[k - 1] + y[k - 2]), (y[k - 1] + y[k - 2]) * a + b * u[k - 1] * y[k - 1], a * y[k - 1] * 2):
        assert zero(sigma_y(Model(core + b * u[k - 1], (a, b))) - 2 * a)
    assert zero(sigma_y(Model(2 * y[k - 1] - y[k - 2] + b * u[k - 1], (b,))) - 1)


# ---------------------------------------------------------------- plays


@pytest.mark.parametrize("seed", range(5))
def test_branches_of_plays_are_where_a_slow_run_goes(seed):
    rng = np.random.default_rng(seed)
    radii, weights = np.sort(rng.uniform(0.2, 2.0, 3)), rng.uniform(0.1, 1.0, 4)
    centre = float(rng.uniform(-2, 2))
    model = Shape(tuple(radii), (0.4,), 1).model({u: centre}, [0.6, *weights, 0.3, -0.2])
    sets = model.quasi_static()
    turns = rng.uniform(-4, 4, 6)
    history = np.concatenate([np.linspace(a, b, 400) for a, b in itertools.pairwise(turns)])
    z = {one.base: float(v) for one, v in zip(plays(model), _plays_after(model, history), strict=True)}
    for end in (turns[-1] + 1.3, turns[-1] - 1.3):
        slow = np.concatenate([history, np.linspace(turns[-1], end, 400), np.full(60, end)])
        known = {Name(f"{b.label}_turn", real=True): v for b, v in z.items()} | {u_: end}
        branch = sets.loading if end > turns[-1] else sets.unloading
        expected = float(branch.xreplace(model.values).xreplace(known))
        assert model.simulate(slow, 0.0, warn=False)[-1] == pytest.approx(expected, abs=1e-10)


def _plays_after(model, u_values):
    """The plays after a history, by hand; they start where the first input is."""
    found = []
    for one in plays(model):
        low, high = (sp.lambdify(u_, bound) for bound in one.between(u_))
        at = (low(u_values[0]) + high(u_values[0])) / 2
        for value in u_values:
            at = max(low(value), min(high(value), at))
        found.append(at)
    return found


def of_plays():
    return Shape((0.3, 0.9, 5.0), (0.4,), 0).model({}, [0.5, 1.0, 0.6, 0.4, 0.3, 0.1, -0.2])


def with_backlash():
    base = NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])
    variant = next(v for v in variants(base, (), EFFECTS) if v.id == "backlash" and v.where == "input")
    model = extend(base, variant).model
    return model.replace(theta=[0.5, 1.0, *([0.7] * (len(model.symbols) - 2))])


@pytest.mark.parametrize("make", (of_plays, with_backlash))
def test_sets_of_plays_are_the_loop_of_a_slow_cycle(make):
    model = make()
    cycle = 2 * np.sin(2 * np.pi * np.arange(20_000) / 20_000)
    sets = evaluate_quasi_static(model.quasi_static(), cycle, cycle - np.roll(cycle, 1))
    loop = model.simulate(np.tile(cycle, 3), 0.0, warn=False)[-cycle.size :]
    assert np.nanmax(np.abs(sets.ytilde - loop)) < 1e-3 * np.ptp(loop) and np.ptp(loop) > 2
    assert sets.attracting[sets.phi1 != 0].all()


def test_plays_rest_where_the_input_has_left_them():
    model = Shape((0.5,), (), 0).model({u: 0.3}, [0.5, 1.0, 0.6, 0.0])
    state = steady_state(model)
    assert state.equilibria == "continuum" and state.conditions == []
    (chain,) = state.held
    assert [float(e.xreplace({chain[1]: 0, ubar: 2.0})) for e in chain] == pytest.approx([1.2, 0.0, 2.2])
    verdict = property_1(model)
    assert verdict.holds and verdict.equilibria == "continuum"
    assert not property_1(model.replace(theta=[1.2, *model.theta[1:]])).holds
    with pytest.raises(ModelError, match=r"assumptions .* memory in the state z1\[k\]"):
        check(model)


def test_an_eigenvalue_of_one_says_nothing():
    """Of y - y**3/10 the origin attracts, though slowly; of y - (y**3 - y)**3/10 both ends do."""
    slow = property_1(NARX.from_terms(["y[k-1]", "y[k-1]**3"], [1.0, -0.1]))
    assert slow.equilibria == [0.0] and slow.diverging is None and slow.holds is False
    flat = NARX.from_terms(["y[k-1]", "(y[k-1]**3 - y[k-1])**3"], [1.0, -0.1])
    assert property_1(flat).equilibria == [-1.0, 0.0, 1.0] and property_1(flat).holds is None
    for first in (0.5, 1.2):
        ends = flat.simulate(np.zeros(4000), first)
        assert abs(ends[-1] - 1) < abs(ends[0] - 1) / 10


@pytest.mark.parametrize("terms, theta", ((["y[k-1]", "tanh(y[k-1])*((y[k-1]-0.5)**2-1e-6)"], [1, -0.5]),
                                          (["y[k-1]", "Max(0,y[k-1])", "abs(y[k-1])", "phi1[k-1]"], [0.5, 1, -0.5, 0.4])))  # fmt: skip
def test_property_1_does_not_fail_where_equilibria_may_be_missed(terms, theta):
    """The first has another one near 0.5, where a search sees no change of sign; of the second every output is one."""
    assert property_1(NARX.from_terms(terms, theta)).holds is None


def test_a_continuum_is_judged_along_it():
    """Its other eigenvalue is g (c - ybar**2): beyond 1 near the origin, or everywhere from -1 to 1."""
    g, c, b = sp.symbols("g c b", real=True)
    F = y[k - 1] + g * (y[k - 1] - y[k - 2]) * (c - y[k - 1] ** 2) + b * phi1[k - 1]
    for theta, steady, said in (([0.9, 1.0, 0.3], True, "non-diverging at all of the outputs"),
                                ([1.5, 1.0, 0.3], True, "non-diverging at 42% of the outputs"),
                                ([1e3, 2.0, 0.3], False, ", diverging at all of the outputs")):  # fmt: skip
        verdict = property_1(Model(F, (g, c, b), theta))
        assert verdict.equilibria == "continuum" and said in verdict.reason
        assert verdict.holds == steady and verdict.diverging != steady
