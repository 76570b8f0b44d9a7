"""Names of one kind are no names of another: what a channel, a parameter or a state is called changes nothing."""

import numpy as np
import pytest
import sympy as sp
from drawn import assert_agree
from sampling import more, some

import narx_sym as ns
from narx_sym.models.analysis import check, jacobian, property_1, steady_state
from narx_sym.symbolic.recursion import State
from narx_sym.symbolic.sensitivity import sensitivities
from narx_sym.symbolic.signals import signal

k, y, u = ns.k, ns.y, ns.u
# What the package itself calls something: signals of laws and effects, parameters, derivatives, symbols of results.
NAMES = (
    "r", "m", "x", "v", "free", "acting", "theta_1", "theta_3", "dy_0", "m_wanted", "v_hint", "channel_r", "z", "q",
    "ybar", "phi_1", "c", "time_index", "shared_0", "int", "end",
)  # fmt: skip
N = np.arange(80)
INPUT, BESIDE = np.sin(0.1 * N), 1 + np.cos(0.23 * N)


def saved_and_loaded(model, folder):
    ns.save(model, folder / "m.json")
    return ns.load(folder / "m.json")


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("bent", [False, pytest.param(True, marks=more)])
@pytest.mark.parametrize("name", some(NAMES, 4))
def test_a_channel_may_have_any_name(name, bent, tmp_path):
    terms = ["y[k-1]", "u[k-1]", "{}[k-1]", *(["u[k-1]**2"] if bent else [])]
    theta = [0.6, 0.5, 0.8, 0.05][: len(terms)]
    runs = []
    for called in ("plain", name):
        model = ns.NARX.from_terms([t.format(called) for t in terms], theta, channels=[called])
        wave = model.simulate(INPUT, 0.0, {called: BESIDE})
        law = model.compensator()
        assert law.residual() == 0
        assert saved_and_loaded(model, tmp_path) == model
        if called != "plain":
            assert all(one.export(to) for one in (model, law) for to in ("c", "st", "js"))
        extended, directions = sensitivities(model.recursion, initial=True)
        given = {"u": INPUT, called: BESIDE}
        found = extended.compile()(given, theta, dict.fromkeys(map(str, extended.states), 0.5))
        moved = [found[d[y].name] for d in directions]
        runs.append({"y": wave, "m": law.run(wave, 0.0, {called: BESIDE}), **dict(enumerate(moved))})
    assert np.abs(runs[1]["m"] - INPUT)[1:-1].max() < 1e-12
    plain, other = ({str(n): values for n, values in run.items()} for run in runs)
    assert_agree({"python": plain, "named": other})


@pytest.mark.parametrize("name", some(["y", "u", "k", "phi1", "t", *NAMES], 5))
def test_a_parameter_may_have_any_name(name, tmp_path):
    values = []
    for called in ("plain", name):
        p = sp.Symbol(called, real=True)
        a, b = sp.symbols("one two", real=True)
        own = p * y[k - 1] + a * u[k - 1] + b * ns.phi1[k - 2] * ns.phi2[k - 2] * u[k - 2]
        model = ns.Model(own, (p, a, b), [0.5, 0.8, 0.1])
        law, wave = model.compensator(), model.simulate(INPUT, 0.0)
        loaded = saved_and_loaded(model, tmp_path)
        assert law.residual() == 0 and loaded == model and hash(loaded) == hash(model)
        assert sp.diff(model.F, p) == sp.diff(loaded.F, p) == y[k - 1]
        if called != "plain":
            assert all(model.export(to) for to in ("c", "st", "js", "casadi")) and law.export("c")
        sets, plain = model.quasi_static(), {p: sp.Symbol("plain", real=True)}
        symbolic = (
            sets.loading, sets.unloading, model.sigma_y, steady_state(model).equation, *jacobian(model), law.law,
            *(v.reason for v in check(model)), property_1(model).reason,
        )  # fmt: skip
        assert repr(model) == repr(model.replace(theta=list(model.theta)))
        found = sets.evaluate(INPUT)
        values.append(
            ([e.xreplace(plain) if isinstance(e, sp.Basic) else e for e in symbolic], wave, law.run(wave, 0.0),
             found.ytilde, model.expand(True))
        )  # fmt: skip
    assert values[0][0] == values[1][0] and values[0][4] == values[1][4]
    for one, other in zip(values[0][1:4], values[1][1:4], strict=True):
        assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("name", some(["r", "m", "w", "theta_1", "z", "q", "c", "m_wanted", "dy_0", "int"]))
def test_a_state_may_have_any_name(name):
    runs = []
    for called in ("plain", name):
        w, (a, b) = signal(called), sp.symbols("theta_1 theta_2", real=True)
        model = ns.Model(
            a * y[k - 1] + b * u[k - 1] + w[k], (a, b), [0.5, 0.8], states=[State(w[k], u[k - 1] ** 2 / 9)]
        )
        wave = model.simulate(INPUT, 0.0)
        law = model.compensator()
        assert law.residual() == 0
        runs.append([wave, law.run(wave, 0.0, clip=True)])
    assert all(np.array_equal(one, other) for one, other in zip(*runs, strict=True))


@pytest.mark.parametrize("bent", (False, pytest.param(True, marks=more)))
def test_what_is_said_of_a_fitted_law_names_no_other_signal(bent):
    """Whether it is stable and where it is known depend on no name; sources speak of a name of the channel's own."""
    terms = ["y[k-1]", "u[k-1]", "{}[k-1]", *(["u[k-1]**2"] if bent else [])]
    said = []
    for name in ("plain", "r", "m", "theta_1", "m_share", "m_kick"):
        model = ns.NARX.from_terms(
            [t.format(name) for t in terms], [0.6, 0.5, 0.3, 0.05][: len(terms)], channels=[name]
        )
        wave = model.simulate(INPUT, 0.0, {name: BESIDE})
        fitted = model.fit(ns.Record.from_arrays(INPUT, wave, 0.01, channels={name: BESIDE}))
        law = fitted.replace(theta=model.theta).compensator()
        said.append(str(law.stability()))
        assert "u from -" in said[-1] and law.stability().stable is True
        (own,) = law.named({name: BESIDE})
        assert own not in ("r", "m", "m_share", "m_kick") and own in law.export("c") and own in law.export("st")
    assert len(set(said)) == 1
