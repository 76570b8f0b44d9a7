"""The Python API with what it cannot use: one clear error of this package, never a number from it."""

import ast

import numpy as np
import pytest
from paper import BENCH
from places import PACKAGE

import narx_sym as ns
from narx_sym.data.evidence.stiction import sticking
from narx_sym.errors import NarxError

N, TS = 200, 0.01
U = np.cumsum(np.random.default_rng(0).standard_normal(N)) / 5
MODEL = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=TS)
DRIVEN = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "w[k-1]"], [0.8, 0.2, 0.1], channels=["w"])
Y = MODEL.simulate(U, 0.0)
RECORD = ns.Record.from_arrays(U, Y, TS)
MASK = np.arange(N) == 7
MASKED = np.ma.masked_array(Y, mask=MASK)
LAW = MODEL.fit(RECORD).compensator()

MISSING = {
    "input": lambda: MODEL.simulate(MASKED, 0.0),
    "start": lambda: MODEL.simulate(U, np.ma.masked_array([1.0], [True])),
    "channel": lambda: DRIVEN.simulate(U, 0.0, {"w": MASKED}),
    "reference": lambda: LAW.run(MASKED),
    "commissioned": lambda: LAW.commission(MASKED, RECORD, draws=20),
    "static set": lambda: LAW.model.quasi_static().evaluate(MASKED, 1),
    "mape": lambda: ns.mape(MASKED, Y),
    "nrmse": lambda: ns.metrics.nrmse(Y, MASKED),
    "nsavi": lambda: ns.nsavi(MASKED, Y),
    "record": lambda: ns.Record.from_arrays(U, MASKED, TS),
    "stamps": lambda: ns.Record.from_arrays(U, Y, t=np.ma.masked_array(np.arange(N) * TS, mask=MASK)),
    "plant": lambda: ns.plants.bouc_wen(MASKED, Ts=TS),
}


@pytest.mark.parametrize("name", MISSING)
def test_what_is_masked_is_missing(name):
    with pytest.raises(NarxError, match=r"missing|finite"):
        MISSING[name]()


def test_a_mask_that_hides_nothing_changes_nothing():
    whole = np.ma.masked_array(np.arange(5), mask=False)
    assert np.array_equal(MODEL.simulate(whole, 0.0), MODEL.simulate(np.arange(5.0), 0.0))


def test_an_operating_point_may_be_given_by_name():
    by_name, by_sequence = (MODEL.replace(operating_point=p) for p in ({"u": 1.0, "y": 2.0}, {ns.u: 1.0, ns.y: 2.0}))
    assert by_name.operating_point == by_sequence.operating_point == {ns.u: 1.0, ns.y: 2.0}
    assert by_name.expand() == by_sequence.expand() != MODEL.expand()
    found = ns.identify(RECORD, base="linear", n_y=1, n_u=1, delay=1, point={"u": 0.1, "y": 0.2})
    assert found.operating_point == {ns.u: 0.1, ns.y: 0.2}


WRONG = {
    "point of nothing": (lambda: MODEL.replace(operating_point={"q": 1.0}), "'q' is neither"),
    "point of a sample": (lambda: MODEL.replace(operating_point={ns.u[ns.k]: 1.0}), "neither"),
    "point of text": (lambda: MODEL.replace(operating_point={"u": "a"}), "finite number"),
    "point as a list": (lambda: MODEL.replace(operating_point=[1, 2]), "must be a mapping"),
    "point of identify": (lambda: ns.identify(RECORD, point="mean"), "must be a mapping"),
    "array as a record": (lambda: MODEL.predict(U), "Give a Record"),
    "none as a record": (lambda: MODEL.fit(None), "Give a Record"),
    "text as a record": (lambda: LAW.commission(Y, "log.csv", draws=20), "Give a Record"),
    "array to identify": (lambda: ns.identify(U), "Give a Record"),
    "array to diagnose": (lambda: ns.diagnose(MODEL, U), "Give a Record"),
    "model and record exchanged": (lambda: ns.diagnose(RECORD, MODEL), "Give a model"),
    "file as a model": (lambda: ns.evaluate("model.json", RECORD), "Give a model"),
    "lag as text": (lambda: ns.identify(RECORD, n_y="1"), "n_y must be a whole number"),
    "half a lag": (lambda: ns.identify(RECORD, n_u=1.5), "n_u must be a whole number"),
    "delay as text": (lambda: ns.diagnose(MODEL, RECORD, delay="a"), "delay must be a whole number"),
    "a channel like the reference": (lambda: ns.identify(RECORD, base="linear", lags={"r": 1}), "another name"),
    "lags as a list": (lambda: ns.identify(RECORD, lags=["w"]), "must be a mapping"),
    "channels as a list": (lambda: DRIVEN.simulate(U, 0.0, [U]), "must be a mapping"),
    "channels of a record": (lambda: ns.Record.from_arrays(U, Y, TS, channels=[U]), "must be a mapping"),
    "parameters as text": (lambda: ns.NARX.from_terms(["y[k-1]"], ["a"]), "lists of numbers"),
    "one parameter": (lambda: ns.NARX.from_terms(["y[k-1]"], 0.5), "lists of numbers"),
    "negative time": (lambda: MODEL.replace(Ts=-1), "positive number"),
    "one limit": (lambda: LAW.run(Y, limits=3), "a lower and a higher number"),
    "one limit of an experiment": (lambda: ns.diagnose(MODEL, RECORD, limits=3), "two finite numbers"),
    "start as text": (lambda: LAW.run(Y, m0="x"), "m0"),
    "input as text": (lambda: MODEL.simulate("abc", 0.0), "must be numbers"),
    "complex input": (lambda: MODEL.simulate(U + 1j, 0.0), "must be numbers"),
    "no draws": (lambda: LAW.commission(Y, RECORD, draws=0), "At least 2 parameter sets"),
    "two columns": (lambda: MODEL.simulate(np.ones((5, 2)), 0.0), "shape"),
    "limits exchanged": (lambda: ns.diagnose(MODEL, RECORD, limits=(2, -2)), "the smaller one first"),
    "property 1 without numbers": (lambda: ns.analysis.property_1(BENCH.model()), "fit the model or give theta"),
    "sets without numbers": (lambda: BENCH.model().quasi_static().evaluate([1.0, 2.0]), "no parameter values"),
    "eigenvalues without numbers": (lambda: BENCH.model().compensator().internal.radius(1, 1), "theta_"),
    "an output of a controller without a span": (lambda: sticking(ns.Record.from_arrays(U - 60, Y, TS)), "span"),
    "no window": (lambda: RECORD.smoothed(float("nan")), "window"),
}


@pytest.mark.parametrize("name", WRONG)
def test_one_clear_error(name):
    call, said = WRONG[name]
    with pytest.raises(NarxError, match=said) as error:
        call()
    assert "\n" not in str(error.value)


def errors_of(function, others, seen):
    """Return the project's errors that a function raises, itself or through functions beside it."""
    found = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Raise) and node.exc is not None:
            name = ast.unparse(node.exc.func if isinstance(node.exc, ast.Call) else node.exc)
            found |= {name} if name in vars(ns.errors) else set()
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id not in seen:
            seen.add(node.func.id)
            if isinstance(others.get(node.func.id), ast.FunctionDef):
                found |= errors_of(others[node.func.id], others, seen)
    return found


def public_functions():
    """Yield each function and method of the public names with what else its module defines."""
    listed = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8")).body
    for node in (n for n in listed if isinstance(n, ast.ImportFrom) and n.module):
        path = PACKAGE.joinpath(*node.module.split(".")).with_suffix(".py")
        if not path.is_file():
            continue
        others = {f.name: f for f in ast.parse(path.read_text(encoding="utf-8")).body if hasattr(f, "name")}
        for one in (others[a.name] for a in node.names if a.name in others):
            for f in [one] if isinstance(one, ast.FunctionDef) else getattr(one, "body", []):
                if isinstance(f, ast.FunctionDef) and not f.name.startswith("_"):
                    yield f"{one.name}.{f.name}", f, others


def test_docstrings_name_the_errors():
    listed = list(public_functions())
    assert len(listed) > 60
    silent = {
        name: missing
        for name, f, others in listed
        if (missing := {e for e in errors_of(f, others, set()) if e not in (ast.get_docstring(f) or "")})
    }
    assert not silent
