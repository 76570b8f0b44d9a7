"""One step as a plain function: it gives what a run gives, whichever engine computes it."""

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from sampling import some

import narx_sym as ns
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, lag, signal, u, y

BASE = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "phi1[k-2]*phi2[k-2]*u[k-2]"], [0.6, 0.5, 0.05], Ts=0.01,
                          operating_point={"u": 0.3, "y": -1.0})  # fmt: skip
ENGINES = ("numpy", "native", "python", "casadi")


def valued(variant):
    model = extend(BASE, variant).model
    return model.replace(theta=[*BASE.numbers, *(0.07 * (i + 1) for i in range(len(model.symbols) - 3))])


def sampled(texts, runs, depth):
    """The columns of what a function asks for, from the runs of each sequence."""
    found = []
    for one in texts:
        s = parse(one, signals=runs)
        i, run = lag(s), runs[s.base.name]
        found.append(run[depth - i : len(run) - i - depth])
    return found


def agrees(thing, runs, engine):
    function = thing.lambdify(engine)
    depth = thing.recursion.depth + thing.recursion.lead
    given = sampled(function.arguments, runs, depth)
    if engine == "casadi":
        columns = [function(*row) for row in zip(*given, strict=True)]
        found = np.array([[float(v) for v in (row if isinstance(row, tuple) else (row,))] for row in columns]).T
    else:
        found = np.atleast_2d(function(*given))
    for name, values in zip(function.returns, found, strict=True):
        expected = runs[name.partition("[")[0]]
        assert np.allclose(
            values, expected[depth : len(expected) - depth], rtol=0, atol=1e-12 * (1 + np.abs(expected).max())
        )


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("variant", some([None, *(v for v in variants(BASE) if v.driver != "t")], 24), ids=str)
def test_a_step_is_what_a_run_does(variant, engine):
    model = BASE if variant is None else valued(variant)
    n = np.arange(60)
    given = {"u": 0.3 + np.sin(0.37 * n) + 0.1 * np.sin(1.9 * n), "t": n * 0.01}
    start = dict.fromkeys(map(str, model.recursion.states), 0.2)
    runs = {
        **given,
        **model.recursion.compile()({b.name: given[b.name] for b in model.recursion.inputs}, model.theta, start),
    }
    agrees(model, runs, engine)


@pytest.mark.parametrize("engine", some(ENGINES))
def test_a_step_of_a_law_is_what_the_law_does(engine):
    terms = ["y[k-1]", "u[k-1]", "u[k-3]", "u[k-1]**2", "u[k-1]**3"]
    models = [BASE, ns.NARX.from_terms(terms[:4], [0.6, 0.5, 0.1, 0.3])]
    # Many cases in each of many states: written into each other they took NumPy longer than a minute.
    if engine == "numpy":
        models += [valued(next(v for v in variants(BASE) if str(v).startswith("stiction (on the motion")))]
    if engine != "casadi":  # which has no root finder
        models.append(ns.NARX.from_terms([*terms[:3], terms[4]], [0.6, 0.5, 0.1, 0.3]))
    for law in (m.compensator() for m in models):
        recursion, n = law.recursion, np.arange(60)
        start = dict.fromkeys(map(str, recursion.states), 0.2)
        runs = {"r": np.sin(0.2 * n) * 0.1 + 1.0}  # away from the fold of the quadratic law
        agrees(law, {**runs, **recursion.compile()(runs, law.theta, start)}, engine)


@pytest.mark.parametrize("engine", ENGINES)
def test_parameters_and_the_time_index_may_be_arguments(engine):
    a, hidden = sp.Symbol("u", real=True), signal("w")
    step = Recursion(((hidden[k], a * u[k] + k), (y[k], hidden[k] ** 2 + y[k - 1])), (a,)).lambdify(engine)
    assert step.arguments == ("u[k]", "y[k-1]", "k", "u") and step.returns == ("w[k]", "y[k]")
    assert tuple(map(float, step(2.0, 1.0, 3.0, 0.5))) == (4.0, 17.0)
    with pytest.raises(ns.ModelError, match="4 arguments"):
        step(1.0)
    free = ns.NARX(BASE.terms).lambdify(engine)
    assert (
        free.arguments[-3:]
        == BASE.lambdify(engine, parameters=True).arguments[-3:]
        == ("theta_1", "theta_2", "theta_3")
    )


@pytest.mark.parametrize("engine", ENGINES[:3])
def test_a_value_that_is_not_finite_ends_nothing(engine):
    step = ns.Model(1 / u[k - 1], ()).lambdify(engine)
    assert np.array_equal(np.isfinite(step([1.0, 0.0, 2.0, 0.0])), [True, False, True, False])
    assert step(np.full((2, 3), 4.0)).shape == (2, 3) and step(4.0) == 0.25


def test_casadi_takes_its_own_symbols():
    step, at = BASE.lambdify("casadi"), ca.SX.sym("u", 4)
    made = step(*(at[i] for i in range(4)))
    slope = ca.Function("slope", [at], [ca.jacobian(made, at)])(np.array([1.0, 0.4, 0.2, -1.0]))
    assert float(slope[BASE.lambdify().arguments.index("y[k-1]")]) == pytest.approx(0.6)
