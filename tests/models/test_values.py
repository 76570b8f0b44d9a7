"""Models by value: equality, hash, texts, what is assumed of parameters, and lags through states."""

import copy
import json

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from sampling import some

import narx_sym as ns
from narx_sym.errors import ModelError
from narx_sym.inversion.analyses import Subject
from narx_sym.models.analysis import steady_state
from narx_sym.models.info import Info
from narx_sym.models.rewrite import without
from narx_sym.symbolic.recursion import State
from narx_sym.symbolic.signals import signal

k, y, u = ns.k, ns.y, ns.u
ASSUMED = ({"real": True}, {"positive": True}, {}, {"nonnegative": True}, {"negative": True}, {"integer": True},
           {"nonzero": True, "real": True}, {"rational": True})  # fmt: skip


def made(**changes):
    a, b = sp.symbols("a b", real=True)
    given = {"theta": [0.5, 2e-3], "Ts": 0.01, "operating_point": {"u": 1.0}, "constraints": [sp.Eq(a + 2 * b, 0.504)],
             "standard_errors": [0.1, float("nan")], "info": Info(ranges={"u": (0.0, 1.0)})}  # fmt: skip
    return ns.Model(a * y[k - 1] + b * u[k - 1] ** 2, (a, b), **given | changes)


def test_equal_models_are_equal_and_hash_alike(tmp_path):
    ns.save(made(), tmp_path / "m.json")
    for other in (made(), ns.load(tmp_path / "m.json"), made().replace(), copy.deepcopy(made())):
        assert other == made() and hash(other) == hash(made()) and len({other, made()}) == 1
    changed = (
        {"theta": [0.5, 2e-3 + 1e-18]}, {"Ts": 0.02}, {"operating_point": {}}, {"standard_errors": None},
        {"info": Info()}, {"constraints": []}, {"states": [State(signal("w")[k], u[k])]},
    )  # fmt: skip
    assert made() != "a model" and not any(made(**one) == made() for one in changed)
    linear = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.2])
    assert linear != ns.Model(linear.F, linear.symbols, linear.theta)  # another kind of model
    assert ns.NARX.from_terms(["u[k-1]", "y[k-1]"], [0.5, 0.2]) != linear


@pytest.mark.parametrize("assumed", ASSUMED, ids=str)
def test_what_is_assumed_of_a_parameter_is_kept(assumed, tmp_path):
    c = sp.Symbol("c", **assumed)
    value = -1.0 if "negative" in assumed else 1.0
    model = ns.Model(c * y[k - 1] + u[k - 1] * sp.sqrt(c**2 + 1), (c,), [value], constraints=[sp.Eq(c, int(value))])
    ns.save(model, tmp_path / "m.json")
    loaded = ns.load(tmp_path / "m.json")
    assert loaded == model and loaded.F == model.F and sp.diff(loaded.F, c) == sp.diff(model.F, c) != 0


@pytest.mark.parametrize("assumed", ([], {"d": {}}, {"c": {"real": 1}}, {"c": {"tall": True}}, {"c": 3},
                                     {"c": {"positive": True, "negative": True}}))  # fmt: skip
def test_assumptions_that_mean_nothing_are_refused(assumed, tmp_path):
    c = sp.Symbol("c", positive=True)
    ns.save(ns.Model(c * y[k - 1] + u[k - 1], (c,), [0.5]), tmp_path / "m.json")
    path = tmp_path / "m.json"
    before = '"assumptions": {\n  "c": {\n   "positive": true\n  }\n }'
    assert before in path.read_text()
    path.write_text(path.read_text().replace(before, f'"assumptions": {json.dumps(assumed)}'))
    with pytest.raises(ModelError, match="assumptions"):
        ns.load(path)


def test_a_text_has_six_digits_and_the_operating_point():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [1 / 3, 2e-7 / 3], operating_point={"u": 1 / 3, "y": -96.0})
    assert repr(model) == "NARX(y[k] = 6.66667e-08*u[k-1] + 0.333333*y[k-1]; around u = 0.333333, y = -96.0)"
    assert "96.0" in repr(model.recursion) and "theta_1" in repr(ns.NARX.from_terms(["y[k-1]"]))


def test_a_notebook_shows_everything_that_holds_equations():
    model = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"], [1.0, 0.7, 0.01])
    squared = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2"], [0.5, 0.7, 0.1]).compensator()
    listed = (
        model, model.compensator(), squared, *squared.polynomials, model.recursion, model.quasi_static(),
        steady_state(model), ns.pool(), model.compensator().internal, State(u[k], y[k - 1]), Subject(model).law,
    )  # fmt: skip
    for thing in listed:
        shown = thing._repr_latex_()
        assert shown.startswith("$\\displaystyle ") and shown.endswith("$") and ns.latex(thing) in shown


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, 3), min_size=1, max_size=4), st.booleans())
def test_the_delay_and_the_order_count_lags_through_states(steps, own):
    """A chain of models: the pure delay is the sum of theirs."""
    names = [signal(f"w{i}") for i in range(len(steps))]
    before, states = u, []
    for w, steps_in in zip(names, steps, strict=True):
        states.append(State(w[k], w[k - 1] / 2 * int(own) + before[k - steps_in] + before[k - steps_in - 1]))
        before = w
    model = ns.Model(y[k - 1] / 2 + before[k - 1], (), states=states)
    impulse = np.r_[np.zeros(30), 1.0, np.zeros(40)]
    answer = model.simulate(impulse, 0.0)[30:]
    assert model.delay == np.flatnonzero(answer)[0] == sum(steps) + 1
    assert model.n_u == sum(steps) + len(steps) + 1


@pytest.mark.parametrize("seed", some(range(40), 4))
def test_a_parameter_that_is_zero_leaves_no_residual(seed):
    rng = np.random.default_rng(seed)
    terms = ["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]", "u[k-2]**2", "u[k-1]*u[k-2]", "u[k-1]**2", "u[k-3]"]
    chosen = [str(t) for t in rng.choice(terms, 4, replace=False)]
    theta = rng.uniform(-1, 1, 4)
    theta[rng.integers(4)] = 0.0
    model = ns.NARX.from_terms(chosen, theta)
    try:
        law = model.compensator()
    except ns.NotInvertible:
        assert not any(t.startswith("u") and v for t, v in zip(chosen, theta, strict=True))
        return
    assert law.residual() == 0
    zero = [s for s, v in zip(model.symbols, theta, strict=True) if not v]
    assert without(model, zero).compensator().residual() == 0
