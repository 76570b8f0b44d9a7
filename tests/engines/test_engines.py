"""Four ways to run a recursion give the same numbers and the same complaints."""

import numpy as np
import pytest
import sympy as sp
from drawn import STATES, A, B, V, X, assert_agree, inputs_of, recursions, runs
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from paper import BENCH

from narx_sym.engines.columns import Columns
from narx_sym.engines.compile import ENGINES, compile
from narx_sym.engines.plan import Plan
from narx_sym.errors import Diverged, ModelError
from narx_sym.models.model import NARX
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, phi1, phi2, signal, u, y

# ---------------------------------------------------------------- agreement on random recursions


@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
@given(recursions())
def test_engines_agree_on_random_recursions(made):
    recursion, n, seed = made
    assume(recursion.inputs)
    inputs = inputs_of(n, seed)
    initial = dict.fromkeys(recursion.states, 0.3)
    results = runs(recursion, inputs, (0.05, -0.07), initial)
    ties = [x[recursion.depth :] for name, x in results["python"].items() if name.startswith("tie")]
    assume(all(np.abs(x).min() > 1e-9 for x in ties))
    main = results["python"]["p"]
    assert np.all(np.isfinite(main)) and np.abs(main).max() <= 1
    assert_agree(results)


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_not_chosen_cannot_fail(engine):
    inverse = 1 / u[k]
    guarded = Recursion(((y[k], sp.Piecewise((inverse + inverse**2, u[k] > 0), (sp.log(1 - u[k]), True))),))
    given = {"u": np.array([0.0, 1.0, 2.0, 0.0, -1.0])}
    found = compile(guarded, engine)(given)["y"]
    np.testing.assert_allclose(found, [0.0, 2.0, 0.75, 0.0, np.log(2)], rtol=0, atol=1e-15)
    with pytest.raises(Diverged):  # no case holds
        compile(Recursion(((y[k], sp.Piecewise((u[k], u[k] > 0))),)), engine)(given)


@pytest.mark.parametrize("banded", (True, False))
def test_a_run_longer_than_one_chunk_agrees_with_the_loop(banded):
    past = y[k - 1] if banded else sp.sin(y[k - 1])
    recursion = Recursion(((y[k], 0.9 * past * phi2[k - 1] + 0.05 * y[k - 3] * u[k] + phi1[k - 2]),))
    n = 20_000 if banded else 9_000
    inputs, initial = inputs_of(n), np.array([0.1, 0.2, 0.3])
    expected = np.empty(n)
    expected[:3] = initial
    x = inputs["u"]
    for i in range(3, n):
        last = expected[i - 1] if banded else np.sin(expected[i - 1])
        step = np.sign(x[i - 1] - x[i - 2])
        expected[i] = 0.9 * last * step + 0.05 * expected[i - 3] * x[i] + x[i - 2] - x[i - 3]
    for engine, found in runs(recursion, inputs, (), {"y": initial}).items():
        np.testing.assert_allclose(found["y"], expected, rtol=0, atol=1e-12, err_msg=engine)


@pytest.mark.parametrize("n", (4, 5, 258, 259, 260, 261, 515, 516, 1_030))
@pytest.mark.parametrize("start", (3, 4))
def test_every_length_around_the_blocks_of_the_native_engine(n, start):
    p, q, s = STATES
    chain = Recursion(
        (
            (p[k], 0.9 * p[k - 1] * sp.sign(u[k - 1]) + u[k] * u[k - 3]),
            (q[k], 0.5 * q[k - 1] * sp.tanh(p[k]) + p[k - 2] ** 2 + k / 100),
            (s[k], A * s[k - 1] + p[k] * q[k - 1] - q[k]),
        ),
        (A,),
    )
    inputs, initial = inputs_of(n), {"p": 0.3, "q_1": np.linspace(0, 1, 4), "x": -1.0}
    assert_agree(runs(chain, inputs, (0.7,), initial, start=start))


@pytest.mark.parametrize("at", (3, 257, 258, 259, 514, 515, 999))
def test_divergence_in_and_between_blocks(at):
    p, q, _ = STATES
    growing = Recursion(((p[k], 0.5 * p[k - 1] + u[k]), (q[k], 0.5 * q[k - 1] + 1 / (u[k - 2] - 7) + p[k])))
    for bad_state in ("p", "q_1"):
        source = np.linspace(-1, 1, 1_000)
        if bad_state == "p":
            source[at] = np.inf
        elif at - 2 >= 0:
            source[at - 2] = 7
        found = {first_bad(growing, {"u": source}, {"p": 1.0, "q_1": 2.0}, e) for e in ENGINES}
        assert found == {at}


def test_a_decaying_run_ends_in_zeros_or_in_what_is_as_good():
    recursion = Recursion(((y[k], A * y[k - 1] + u[k] * y[k - 3]), (X[k], X[k - 1] * A)), (A,))
    for found in runs(recursion, {"u": np.zeros(3_000)}, (0.5,), {"y": 1.0, "x": 1.0}).values():
        for values in found.values():
            np.testing.assert_allclose(values[2:900], 0.5 ** np.arange(898.0), rtol=1e-12)
            assert np.abs(values[1_300:]).max() < 1e-280


def test_sensitivities_run_the_same_in_all_engines():
    from narx_sym.symbolic.sensitivity import sensitivities

    model = BENCH.model()
    extended, directions = sensitivities(model.recursion, initial=True)
    start = dict.fromkeys(extended.states, 0.0) | {y: 0.2, directions[-1][y]: 1.0}
    results = runs(extended, inputs_of(300), (0.9, 0.5, 0.1, -0.2, 0.02, -0.03), start)
    assert_agree(results, 1e-11)
    assert len(results["native"]) == 8


@pytest.mark.parametrize("order", (9, 30, 100))
def test_long_lags(order):
    recursion = Recursion(((y[k], 0.5 * y[k - order] + 0.2 * y[k - 1] + u[k - order]),))
    n = 4 * order
    inputs, initial = inputs_of(n), np.arange(order) / order
    expected = np.concatenate([initial, np.zeros(n - order)])
    for i in range(order, n):
        expected[i] = 0.5 * expected[i - order] + 0.2 * expected[i - 1] + inputs["u"][i - order]
    for engine, found in runs(recursion, inputs, (), {"y": initial}).items():
        np.testing.assert_allclose(found["y"], expected, rtol=0, atol=1e-13, err_msg=engine)


def test_the_time_index_may_stand_in_an_equation():
    recursion = Recursion(((y[k], y[k - 1] / 2 + k + sp.sin(k * u[k])),))
    results = runs(recursion, {"u": np.ones(50)}, (), {"y": 3.0})
    expected = [3.0]
    for i in range(1, 50):
        expected.append(expected[-1] / 2 + i + np.sin(i))
    np.testing.assert_allclose(results["native"]["y"], expected, rtol=1e-13)
    assert_agree(results)


def test_no_input_no_parameter_no_memory():
    alone = Recursion(((y[k], y[k - 1] / 2),))
    assert_agree(runs(alone, {}, (), {"y": 1.0}, length=6))
    assert compile(alone)({"u": np.ones(6)}, (), {"y": 1.0})["y"].tolist() == [1, 0.5, 0.25, 0.125, 0.0625, 0.03125]
    with pytest.raises(ModelError, match="length of the run"):
        compile(alone)({}, (), {"y": 1.0})
    memoryless = runs(Recursion(((y[k], u[k] ** 2 + k),)), {"u": [1.0, 2, 3]})
    assert_agree(memoryless)
    assert memoryless["native"]["y"].tolist() == [1, 5, 11]


def test_a_lead_sees_the_future_and_holds_the_last_value():
    recursion = Recursion(((y[k], u[k + 2] - u[k]),))
    for found in runs(recursion, {"u": [1.0, 2, 4, 8]}).values():
        assert found["y"].tolist() == [3, 6, 4, 0]


@pytest.mark.parametrize(
    "names", ("x0_1 x1_1", "time_index k_", "shared_0 shared_1", "parameter_1 parameter_0", "a0 stop", "sin sign")
)
def test_no_name_of_a_parameter_collides_with_a_name_of_the_engines(names):
    for real in (True, None):
        a, b = (sp.Symbol(n, real=real) for n in names.split())
        right = a * y[k - 1] + b * (u[k - 1] + a) ** 2 + sp.sin(b * (u[k - 1] + a)) * sp.sign(u[k - 1]) + k / 100
        plain = Recursion(((y[k], right.xreplace({a: A, b: B})),), (A, B))
        expected = compile(plain, "python")(inputs_of(20), (0.3, 0.7), {"y": 0.1})["y"]
        for engine, found in runs(Recursion(((y[k], right),), (a, b)), inputs_of(20), (0.3, 0.7), {"y": 0.1}).items():
            np.testing.assert_allclose(found["y"], expected, rtol=1e-12, err_msg=engine)


def test_a_condition_may_be_shared_by_several_branches():
    up = sp.And(u[k] > 0, sp.Or(y[k - 1] < u[k], sp.Not(sp.Ne(V[k], 0.5))))
    right = sp.Piecewise((y[k - 1] / 2, up), (u[k], u[k] > -0.5), (V[k], True)) + sp.Piecewise(
        (V[k] / 3, up), (y[k - 1] / 4, True)
    )
    inputs = inputs_of(60)
    inputs["v"][::3] = 0.5
    results = runs(Recursion(((y[k], right), (X[k], sp.Piecewise((1, up), (0, True))))), inputs, (), {"y": 0.3})
    assert_agree(results)
    taken = [
        x > 0 and (past < x or v == 0.5)
        for x, v, past in zip(inputs["u"][1:], inputs["v"][1:], results["python"]["y"], strict=False)
    ]
    assert results["python"]["x"][1:].tolist() == taken and 0 < sum(taken) < 59


def test_the_inputs_arrays_stay_untouched():
    given_u = np.linspace(-1, 1, 30)
    kept, start = given_u.copy(), np.full(3, 0.5)
    runs(Recursion(((y[k], 0.5 * y[k - 1] * u[k + 1]),)), {"u": given_u}, (), {"y": start}, start=3)
    assert np.array_equal(given_u, kept) and np.array_equal(start, np.full(3, 0.5))


# ---------------------------------------------------------------- complaints


def first_bad(recursion, inputs, initial, engine):
    found = compile(recursion, engine)(
        inputs, (), initial, length=len(inputs.get("u", range(1200))), on_divergence="nan"
    )
    values = np.array(list(found.values()))
    bad = ~np.isfinite(values).all(axis=0)
    at = int(np.argmax(bad))
    assert bad[at:].all() and np.isnan(values[:, at:]).all()
    with pytest.raises(Diverged, match=rf"sample {at} is not finite"):
        compile(recursion, engine)(inputs, (), initial, length=len(inputs.get("u", range(1200))))
    return at


@pytest.mark.parametrize(
    "right, at",
    (
        (y[k - 1] * 2.0, 1024),
        (y[k - 1] ** 2 + 2, None),
        (0.5 * y[k - 1] + sp.exp(u[k]), 711),
        (0.5 * y[k - 1] + sp.log(500 - u[k]), 500),
        (0.5 * y[k - 1] + sp.sqrt(499.5 - u[k]), 500),
        (0.5 * y[k - 1] + 1 / (u[k] - 77), 77),
        (0.5 * sp.Max(y[k - 1], sp.log(499.5 - u[k])), 500),
        (0.5 * sp.Max(sp.log(499.5 - u[k]), y[k - 1], u[k - 1]), 500),
        (0.5 * sp.Min(sp.log(499.5 - u[k]), u[k] + y[k - 1]), 500),
    ),
)
def test_divergence_is_found_at_the_same_sample(right, at):
    inputs = {"u": np.arange(1200.0)}
    found = {e: first_bad(Recursion(((y[k], right),)), inputs, {"y": 1.0}, e) for e in ENGINES}
    assert len(set(found.values())) == 1, found
    if at is not None:
        # 710.5 > log(largest float): exp overflows from 710 on, when 0.5 y adds to it
        assert abs(found["native"] - at) <= 1


@pytest.mark.parametrize("engine", ENGINES)
def test_bad_arguments(engine):
    run = compile(Recursion(((y[k], A * y[k - 1] + u[k - 2] + V[k]),), (A,)), engine)
    ones = np.ones(10)
    for inputs, theta, initial, words in (
        ({"u": ones}, (1,), {"y": 0}, "v is missing"),
        ({"u": ones, "v": np.ones(9)}, (1,), {"y": 0}, "different lengths"),
        ({"u": ones, "v": ones}, (1,), {}, "2 initial samples of y"),
        ({"u": ones, "v": ones}, (1,), None, "2 initial samples of y"),
        ({"u": ones, "v": ones}, (), {"y": 0}, "1 parameter value"),
        ({"u": ones, "v": ones}, (1, 2), {"y": 0}, "1 parameter value"),
        ({"u": ones, "v": np.ones((5, 2))}, (1,), {"y": 0}, "v"),
    ):
        with pytest.raises(ModelError, match=words):
            run(inputs, theta, initial)
    three = compile(Recursion(((y[k], y[k - 3]),)), engine)
    with pytest.raises(ModelError, match="needs 3 initial samples, 2 were given"):
        three({}, (), {"y": [1.0, 2]}, length=9)
    with pytest.raises(ModelError, match="needs 3 initial samples, 0 were given"):
        three({}, (), {"y": []}, length=9)
    assert three({}, (), {"y": [1.0, 2, 3, 4]}, length=5)["y"].tolist() == [1, 2, 3, 1, 2]
    assert three({}, (), {"y": [1.0, 2, 3]}, length=2)["y"].tolist() == [1, 2]
    empty = compile(Recursion(((y[k], u[k + 1]),)), engine)
    assert empty({"u": [1.0]})["y"].tolist() == [1]
    assert empty({"u": []})["y"].size == 0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_node_without_a_rule_is_refused_by_its_name(engine):
    unknown = sp.Function("mystery")
    with pytest.raises(ModelError, match="mystery"):
        compile(Recursion(((y[k], unknown(u[k])),)), engine)({"u": [1.0, 2]})
    with pytest.raises(ModelError, match="native, casadi, python"):
        compile(Recursion(((y[k], u[k]),)), "fortran")


# ---------------------------------------------------------------- one object per recursion, fallback


def test_the_same_recursion_is_compiled_once():
    first = compile(Recursion(((y[k], 0.25 * y[k - 1] + u[k]),)))
    assert compile(Recursion(((y[k], 0.25 * y[k - 1] + u[k]),))) is first
    assert compile(Recursion(((y[k], 0.26 * y[k - 1] + u[k]),))) is not first
    assert compile(first.recursion, "python") is not first
    # phi1 is written out before the comparison
    assert compile(Recursion(((y[k], phi1[k - 1]),))) is compile(Recursion(((y[k], u[k - 1] - u[k - 2]),)))


# ---------------------------------------------------------------- the plan


@pytest.mark.parametrize("right, order", ((y[k - 1] ** 3 + u[k], 3), ((y[k - 1] + u[k]) ** 4, 4), ((y[k - 1] + u[k]) ** 5, 0),
                                          (sp.sin(y[k - 1]), 0), (1 / y[k - 1], 0), (u[k], 0), (sp.Max(y[k - 1], u[k]), 0)))  # fmt: skip
def test_polynomials_up_to_the_fourth_power_are_collected(right, order):
    plan = Plan.of(Recursion(((y[k], right),)))
    (row,) = plan.collected
    assert len(row) == order + 1
    x = plan.sample.get((0, 1), sp.Dummy())
    assert sp.expand(sum(c * x**i for i, c in enumerate(row)) - plan.updates[0]) == 0


# ---------------------------------------------------------------- CasADi and columns


def test_the_casadi_step_is_one_update_and_differentiable():
    import casadi as ca

    model = NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi1[k-1]*y[k-1]"], [0.9, 0.5, 0.1])
    step = model.lambdify("casadi", parameters=True)
    inputs, past, theta = ca.SX.sym("v", 2), ca.SX.sym("x", 1), ca.SX.sym("t", 3)
    newest = step(*ca.vertsplit(inputs), past, *ca.vertsplit(theta))
    gradient = ca.Function("g", [past, inputs, theta], [ca.jacobian(newest, theta)])
    row = np.asarray(gradient(2.0, [3.0, 1.0], [0.9, 0.5, 0.1])).ravel()
    assert row.tolist() == [2.0, 2.0, 4.0]  # phi1[k-1] = u[k-1] - u[k-2] = 3 - 1
    assert float(step(3.0, 1.0, 2.0, 0.9, 0.5, 0.1)) == pytest.approx(3.2, rel=1e-15)


@example(powers=[0, 0, 0, 0])
@settings(max_examples=25, deadline=None)
@given(powers=st.lists(st.integers(0, 4), min_size=4, max_size=4))
def test_columns_equal_the_products_written_by_hand(powers):
    p, q, s, t = powers
    data = inputs_of(30) | {"y": np.random.default_rng(4).standard_normal(30)}
    term = u[k - 1] ** p * phi2[k - 2] ** q * y[k - 1] ** s * phi1[k - 1] ** t
    columns = Columns([term, y[k], term * sp.sin(u[k - 3]), sp.S.One])
    found = columns(data)
    i = np.arange(columns.depth, 30)
    x, out = data["u"], data["y"]
    expected = x[i - 1] ** p * np.sign(x[i - 2] - x[i - 3]) ** q * out[i - 1] ** s * (x[i - 1] - x[i - 2]) ** t
    assert found.shape == (30 - columns.depth, 4)
    for column, values in enumerate((expected, out[i], expected * np.sin(x[i - 3]), np.ones(i.size))):
        np.testing.assert_allclose(found[:, column], values, rtol=1e-13, atol=1e-300)
    blocks = [columns.block(data, a, min(a + 7, 30)) for a in range(columns.depth, 30, 7)]
    assert np.array_equal(np.vstack(blocks), found)


@pytest.mark.parametrize("length", (3, 14))
def test_branches_that_read_branches_are_not_multiplied_out(length):
    """Each of a chain of states has cases of the one before it: written into each other they are 3**length cases."""
    states, updates = [signal(f"s{i}") for i in range(length)], []
    before = u[k] + y[k - 1] / 4
    for s in states:
        case = sp.Piecewise(
            (before - 1, before > s[k - 1] + 1), (s[k - 1], sp.And(before > 0, u[k] > 0)), (before / 2, True)
        )
        updates.append((s[k], case))
        before = s[k]
    recursion = Recursion((*updates, (y[k], sp.Max(before, -1) / 2 + u[k])), ())
    assert_agree(runs(recursion, {"u": inputs_of(200)["u"]}, (), dict.fromkeys(map(str, recursion.states), 0.1)))
