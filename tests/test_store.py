"""Model files: what is saved comes back, byte for byte."""

import json

import numpy as np
import pytest
import sympy as sp

import narx_sym as ns
from narx_sym.signals import k, phi1, u, y

a, b, d = sp.symbols("a b d", real=True)
MODELS = {
    "narx": ns.NARX.from_terms(["y[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]**2", "abs(u[k-1])"], [1.0, 1e-17, -2.5]),
    "unfitted": ns.NARX.from_terms(["y[k-1]", "u[k-1]"]),
    "inverse": ns.NARX.from_terms(["u[k-1]", "phi1[k-1]"], [1.0, 1.3], input="y", output="u", lead=2),
    "shifted": ns.NARX.from_terms(["y[k-1]", "phi1[k-1]"], [1.0, 2.0], operating_point={u: 1.8, y: -96.1}, Ts=0.005),
    "channel": ns.NARX.from_terms(["y[k-1]", "temp[k]*u[k-1]"], [0.5, 2.0], channels=["temp"]),
    "equation": ns.Model(
        y[k - 1] + a * phi1[k] + b * sp.Abs(phi1[k]) * (d * u[k - 1] - y[k - 1]), (a, b, d), [0.7, 0.01, 1.6]
    ),
    "constrained": ns.NARX.from_terms(["y[k-1]", "y[k-2]", "phi1[k-1]"], constraints=("continuum",)),
}


@pytest.mark.parametrize("name", MODELS)
def test_round_trip(name, tmp_path):
    model = MODELS[name]
    ns.save(model, tmp_path / "a.json")
    loaded = ns.load(tmp_path / "a.json")
    ns.save(loaded, tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert loaded.F == model.F and loaded.symbols == model.symbols and loaded.lead == model.lead
    assert loaded.operating_point == model.operating_point and loaded.recursion == model.recursion
    assert (loaded.theta is None) == (model.theta is None)
    if model.theta is not None:
        assert np.array_equal(loaded.theta, model.theta)


def test_constraints_come_back(tmp_path):
    model = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"])
    t1, t2, _ = model.symbols
    model.constraints = (sp.Eq(t1 + t2, 1),)
    ns.save(model, tmp_path / "m.json")
    assert sp.simplify(ns.load(tmp_path / "m.json").constraints[0].lhs - (t1 + t2 - 1)) == 0


def test_fit_information_comes_back(tmp_path):
    t = np.arange(500) * 0.01
    source = np.sin(3 * t) + 0.3 * np.sin(17 * t)
    record = ns.Record.from_arrays(source, 2 * source + 0.1 * source**2, Ts=0.01)
    model = ns.identify(record, base="static")
    ns.save(model, tmp_path / "m.json")
    assert ns.load(tmp_path / "m.json").info == json.loads(json.dumps(model.info))
