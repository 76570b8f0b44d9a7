"""Models taken elsewhere: CasADi, python-control, and models that come from SysIdentPy."""

import importlib.util
import sys

import numpy as np
import pytest
import sympy as sp
from exported import SUBJECTS, valued

import narx_sym as ns
from narx_sym.errors import ModelError
from narx_sym.fit.interop import from_sysidentpy
from narx_sym.symbolic.printing import text
from narx_sym.symbolic.signals import k, signal, u, y

needs_control = pytest.mark.skipif(
    importlib.util.find_spec("control") is None, reason="python-control is not installed here"
)
needs_sysidentpy = pytest.mark.skipif(
    importlib.util.find_spec("sysidentpy") is None, reason="SysIdentPy is not installed here (the bench extra)"
)
N = 300
MODELS = [name for name, subject in SUBJECTS.items() if isinstance(subject.thing, ns.Model)]
LAWS = [name for name, subject in SUBJECTS.items() if isinstance(subject.thing, ns.Compensator)]


def at_rest(subject):
    """The state at rest; of a law also, whatever its preview has in sight, and the output of the model beside it."""
    own = {str(subject.output.label), *(str(s.base.label) for s in subject.recursion.given)}
    own |= {str(s.base.label) for s in subject.recursion.past} & {"y", *(subject.rest or ())}
    return subject.thing.rest_state(**{name: subject.at_rest(name) for name in own if name != "t"})


# ---------------------------------------------------------------- CasADi


@pytest.mark.parametrize("name", MODELS + LAWS)
def test_casadi_steps_like_the_free_run(name):
    subject = SUBJECTS[name]
    function = subject.thing.export("casadi", "one")
    assert (function.name_in(), function.name_out()) == (["state", "inputs"], ["next", "output"])
    state, given, waves = at_rest(subject), subject.recursion.given, subject.waves(N)
    found = []
    for i in range(N - 10):
        now = [waves[str(s.base.label)][i - int(k - s.indices[0])] for s in given]
        state, output = function(state, now)
        found.append(float(output))
    expected = subject.expected(N)
    assert np.abs(np.array(found) - expected[: N - 10]).max() <= 1e-12 * np.abs(expected).max()


def test_the_order_of_the_state():
    model = ns.NARX.from_terms(["y[k-1]", "y[k-3]", "u[k-2]"], [0.5, 0.1, 2.0])
    recursion = model.recursion
    assert [text(s) for s in recursion.past] == ["y[k-1]", "y[k-2]", "y[k-3]", "u[k-1]", "u[k-2]"]
    assert [text(s) for s in recursion.given] == ["u[k]"]
    following, output = model.export("casadi")([1.0, 2.0, 3.0, 4.0, 5.0], [6.0])
    assert float(output) == 0.5 * 1 + 0.1 * 3 + 2 * 5
    assert np.array(following).ravel().tolist() == [float(output), 1, 2, 6, 4]
    law = model.compensator()
    assert [text(s) for s in law.recursion.given] == ["r[k+2]"]
    assert [text(s) for s in law.recursion.past] == ["r[k+1]", "r[k]", "r[k-1]"]
    assert model.rest_state(u=7.0, y=9.0).tolist() == [9, 9, 9, 7, 7]
    assert law.rest_state(r=1.0).tolist() == [1, 1, 1]


def test_rest_says_what_it_needs():
    model = SUBJECTS["backlash"].thing
    with pytest.raises(ModelError, match="needs u"):
        model.rest_state(y=1.0)
    with pytest.raises(ModelError, match="There is no z"):
        model.rest_state(u=1.0, y=1.0, z=3.0)


# ---------------------------------------------------------------- python-control


@needs_control
@pytest.mark.parametrize("name", MODELS)
def test_a_control_system_responds_like_the_free_run(name):
    import control

    subject = SUBJECTS[name]
    system = subject.thing.to_control("plant")
    Ts, waves = subject.thing.Ts, subject.waves(N)
    assert isinstance(system, control.NonlinearIOSystem) and system.dt == (Ts or True)
    own = np.array([waves[label] for label in system.input_labels])
    response = control.input_output_response(system, np.arange(N) * (Ts or 1), own, at_rest(subject))
    expected = subject.expected(N)
    assert np.abs(np.ravel(response.outputs) - expected).max() <= 1e-12 * np.abs(expected).max()


@needs_control
def test_a_loop_can_be_closed():
    import control

    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.9, 0.1], Ts=0.1)
    gain = control.tf([2.0], [1.0], 0.1, name="gain", inputs="e", outputs="u")
    loop = control.interconnect(
        [model.to_control("plant"), gain, control.summing_junction(["r", "-y"], "e", name="sum")],
        inplist=["r"], outlist=["y"], inputs="r", outputs="y",
    )  # fmt: skip
    found = control.input_output_response(loop, np.arange(40) * 0.1, np.ones(40)).outputs
    expected = np.zeros(40)
    for i in range(1, 40):
        expected[i] = 0.9 * expected[i - 1] + 0.1 * 2 * (1 - expected[i - 1])
    assert np.allclose(found, expected, rtol=0, atol=1e-12)


@needs_control
def test_awkward_channels_stay_apart():
    import control

    names = ("a.b", "a_b", "temp [K]", "u[0]", "", "sys.x")
    weights = {n: i + 1 for i, n in enumerate(names)}
    F = y[k - 1] / 2 + u[k] + sum(w * signal(n)[k - 1] for n, w in weights.items())
    model = ns.Model(F, (), [], Ts=0.1)
    system = model.to_control()
    assert len(set(system.input_labels)) == len(names) + 1
    given = [str(s.base.label) for s in model.recursion.given]
    waves = {n: np.sin(np.arange(50) / (3 + i)) for i, n in enumerate(given)}
    own = np.array([waves[n] for n in given])
    response = control.input_output_response(system, np.arange(50) * 0.1, own, np.zeros(system.nstates))
    found = np.ravel(response.outputs)
    channels = {n: x for n, x in waves.items() if n != "u"}
    assert np.allclose(found[1:], model.simulate(waves["u"], float(found[0]), channels)[1:], rtol=0, atol=1e-12)


def test_without_control_the_command_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ModelError, match=r"pip install \"narx-sym\[interop\]\""):
        ns.NARX.from_terms(["y[k-1]", "u[k]"], [0.5, 1.0]).to_control()


# ---------------------------------------------------------------- SysIdentPy


def measured(n=500):
    """A system whose terms have three degrees, with a little noise; columns as SysIdentPy wants them."""
    rng = np.random.default_rng(0)
    source, output = rng.uniform(-1, 1, n), np.zeros(n)
    for i in range(3, n):
        output[i] = (
            0.5 * output[i - 1] - 0.1 * output[i - 2] + 0.8 * source[i - 2] + 0.3 * source[i - 1] * output[i - 1]
            + 0.2 * source[i - 3] ** 2 - 0.1 * output[i - 3] ** 3 + 0.05 + 1e-3 * rng.standard_normal()
        )  # fmt: skip
    return source[:, None], output[:, None]


def frols(X, Y, degree=3, **options):
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    settings = {"order_selection": False, "n_terms": 8, "ylag": 3, "xlag": 3, **options}
    return FROLS(**{"basis_function": Polynomial(degree=degree), "estimator": LeastSquares(), **settings}).fit(X=X, y=Y)


@needs_sysidentpy
@pytest.mark.parametrize(
    "options",
    (
        {"degree": 1, "n_terms": 5}, {"degree": 2}, {"degree": 3}, {"xlag": [3, 1, 2], "ylag": [2, 3]},
        {"model_type": "NFIR"}, {"model_type": "NAR", "degree": 2, "n_terms": 3},
        {"order_selection": True, "n_terms": None},
    ),
    ids=str,
)  # fmt: skip
def test_an_imported_model_runs_like_the_original(options):
    X, Y = measured()
    theirs = frols(X, Y, **options)
    model = from_sysidentpy(theirs, Ts=0.1)
    depth = theirs.max_lag
    free, one = (theirs.predict(X=X, y=Y, steps_ahead=s).ravel() for s in (None, 1))
    start = model.recursion.depth
    assert model.Ts == 0.1 and len(model.terms) == len(theirs.theta)
    assert np.abs(model.predict(ns.Record.from_arrays(X, Y, Ts=0.1))[depth:] - one[depth:]).max() <= 1e-9
    ours = model.simulate(X[depth - start :], Y[depth - start : depth].ravel() if start else 0.0)[start:]
    assert np.abs(ours - free[depth:]).max() <= 1e-9


@needs_sysidentpy
def test_what_cannot_be_imported_is_said():
    from sysidentpy.basis_function import Fourier, Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.simulation import SimulateNARMAX

    X, Y = measured(200)
    with pytest.raises(ModelError, match="not the basis Fourier"):
        from_sysidentpy(frols(X, Y, basis_function=Fourier(degree=2)))
    with pytest.raises(ModelError, match="2 inputs"):
        from_sysidentpy(frols(np.column_stack([X, X**2]), Y, xlag=[[1, 2], [1, 2]], ylag=2, degree=1, n_terms=4))
    with pytest.raises(ModelError, match="not fitted"):
        from_sysidentpy(FROLS(basis_function=Polynomial(degree=2)))
    with pytest.raises(ModelError, match="NoneType"):
        from_sysidentpy("a model")
    simulator = SimulateNARMAX(basis_function=Polynomial(degree=2), estimate_parameter=False)
    rows, theta = np.array([[2002, 0], [1001, 0], [1002, 0]]), np.array([[0.8], [0.5], [-0.1]])
    simulator.simulate(X_test=X, y_test=Y, model_code=rows, theta=theta)
    assert simulator.final_model[0].tolist() == [1001, 0] and simulator.theta[0] == 0.8  # rows sorted, theta not
    with pytest.raises(ModelError, match="SimulateNARMAX sorts"):
        from_sysidentpy(simulator)


@needs_sysidentpy
def test_a_permuted_theta_is_refused():
    X, Y = measured()
    theirs = frols(X, Y)
    theirs.final_model = theirs.final_model[::-1]
    with pytest.raises(ModelError, match="predictions differ"):
        from_sysidentpy(theirs)


def test_an_import_can_be_taken_further():
    """A stand-in with the attributes of a fitted model; no SysIdentPy is needed."""

    class Fitted:
        class Polynomial:
            pass

        basis_function = Polynomial()
        final_model, theta = np.array([[1001, 0], [2001, 1001], [0, 0]]), np.array([[0.5], [0.2], [0.1]])
        n_inputs, max_lag = 1, 1

        def predict(self, X, y, steps_ahead):
            late, source = y[:-1], X[:-1]
            return np.concatenate([y[:1], 0.5 * late + 0.2 * late * source + 0.1])

    model = from_sysidentpy(Fitted())
    assert model.terms == (y[k - 1], u[k - 1] * y[k - 1], sp.S.One)
    assert "y[k]" in model.export("c") and valued(model, "cubic_gain").export("st")


# ---------------------------------------------------------------- to SysIdentPy

TAKEN = {
    "linear": ns.NARX.from_terms(["y[k-1]", "y[k-3]", "u[k-2]", "1"], [0.5, -0.1, 0.8, 0.05], Ts=0.1),
    "products": ns.NARX.from_terms(["y[k-2]**2*u[k-1]", "u[k-4]**3", "y[k-1]"], [0.3, 0.2, 0.6]),
    "only inputs": ns.NARX.from_terms(["u[k-1]", "u[k-5]*u[k-1]"], [2.0, 0.4]),
    "only outputs": ns.NARX.from_terms(["y[k-1]", "y[k-2]"], [1.2, -0.5]),
    "around a point, with phi1": ns.NARX.from_terms(
        ["y[k-1]", "phi1[k-1]*u[k-1]", "u[k-1]**3"], [0.5, 0.1, 0.8], operating_point={u: 1.8, y: -0.4}
    ),
    "an effect without memory": valued(
        ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2]), "cubic_gain"
    ),
    "inverse": ns.NARX.from_terms(["u[k-1]", "y[k-1]*u[k-1]", "y[k-2]"], [0.7, 0.2, 0.1], input="y", output="u"),
}  # fmt: skip


@needs_sysidentpy
@pytest.mark.parametrize("name", TAKEN)
def test_a_model_runs_in_sysidentpy_as_here(name):
    model, rng = TAKEN[name], np.random.default_rng(1)
    source, output = rng.uniform(-1, 1, 400), rng.uniform(-0.5, 0.5, 400)
    theirs = model.to_sysidentpy()
    assert theirs.max_lag == model.recursion.depth
    free, one = (theirs.predict(X=source[:, None], y=output[:, None], steps_ahead=s).ravel() for s in (None, 1))
    pair = (source, output) if model.input == u else (output, source)
    assert np.abs(free - model.simulate(source, output[: theirs.max_lag])).max() <= 1e-9
    assert np.abs(one - model.predict(ns.Record.from_arrays(*pair, Ts=0.1))).max() <= 1e-9
    if model.input == u:
        back = from_sysidentpy(theirs)
        assert np.abs(back.simulate(source, output[: theirs.max_lag]) - free).max() <= 1e-9


@pytest.mark.parametrize(
    ("terms", "said"),
    (
        (["y[k-1]", "phi2[k-1]*u[k-1]"], "the term .*sign"),
        (["y[k-1]", "Abs(u[k-1])"], "the term .*abs"),
        (["y[k-1]", "u[k]"], r"cannot represent u\[k\]"),
        (["y[k-1]", "temp[k-1]"], r"cannot represent temp\[k-1\]: models of one input"),
        (["1"], "without samples"),
        (["y[k-1]", "u[k-500]"], "above 499"),
    ),
)
def test_what_has_no_place_in_sysidentpy_is_said(terms, said):
    """SysIdentPy is not needed to be told."""
    model = ns.NARX.from_terms(terms, [0.5, 0.1][: len(terms)], channels=["temp"])
    with pytest.raises(ModelError, match=said):
        model.to_sysidentpy()


def test_a_state_has_no_place_in_sysidentpy():
    with pytest.raises(ModelError, match="which an effect remembers"):
        SUBJECTS["backlash"].thing.to_sysidentpy()
    with pytest.raises(ModelError, match="no parameter values"):
        ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).to_sysidentpy()


def test_without_sysidentpy_the_command_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sysidentpy", None)
    monkeypatch.setitem(sys.modules, "sysidentpy.basis_function", None)
    with pytest.raises(ModelError, match="pip install sysidentpy"):
        TAKEN["linear"].to_sysidentpy()
