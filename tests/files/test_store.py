"""Model files: what is saved comes back, byte for byte."""

import json

import numpy as np
import pytest
import sympy as sp
from sampling import some

import narx_sym as ns
from narx_sym.errors import ModelError, ParseError
from narx_sym.models.added import AddedEffect
from narx_sym.models.extend import extend, variants
from narx_sym.models.info import Info, Nrmse, Selection
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.signals import k, phi1, u, y

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
    model = model.replace(constraints=(sp.Eq(t1 + t2, 1),))
    ns.save(model, tmp_path / "m.json")
    assert sp.simplify(ns.load(tmp_path / "m.json").constraints[0].lhs - (t1 + t2 - 1)) == 0


def test_fit_information_comes_back(tmp_path):
    t = np.arange(500) * 0.01
    source = np.sin(3 * t) + 0.3 * np.sin(17 * t)
    record = ns.Record.from_arrays(source, 2 * source + 0.1 * source**2, Ts=0.01)
    model = ns.identify(record, base="static")
    ns.save(model, tmp_path / "m.json")
    assert ns.load(tmp_path / "m.json").info == model.info and model.info.selection.base == "static"


# ---------------------------------------------------------------- models with effects

LINEAR = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01)
CONTINUUM = ns.NARX.from_terms(
    ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"], [1.0, 0.7, 0.01], Ts=0.005, constraints=("continuum",),
    operating_point={u: 0.3, y: -2.0},
)  # fmt: skip
N = 80
WAVE = np.sin(np.arange(N) / 7) + 0.4 * np.sin(np.arange(N) / 2.3)
TEMP = {"temp": np.cos(np.arange(N) / 30)}


def with_values(added):
    """Small coefficients, shape parameters of the size of the signals."""
    rest = [0.001] * len(added.coefficients) + [0.3] * len(added.shape)
    base = len(added.model.symbols) - len(rest)
    return added.model.replace(theta=[*BASES[base].theta, *rest])


BASES = {len(m.symbols): m for m in (LINEAR, CONTINUUM)}


def saved_and_loaded(model, folder):
    ns.save(model, folder / "a.json")
    loaded = ns.load(folder / "a.json")
    ns.save(loaded, folder / "b.json")
    assert (folder / "a.json").read_bytes() == (folder / "b.json").read_bytes()
    return loaded


@pytest.mark.parametrize("base", (LINEAR, CONTINUUM), ids=("linear", "continuum"))
@pytest.mark.parametrize("part", some(range(5), 5))
def test_every_variant_comes_back(base, part, tmp_path):
    for variant in list(variants(base, ["temp"]))[part::5]:
        model = with_values(extend(base, variant))
        loaded = saved_and_loaded(model, tmp_path)
        assert loaded == model and loaded.effects == model.effects and loaded.predictor == model.predictor, str(variant)
        assert bool(loaded.constraints) == bool(base.constraints)
        runs = [m.simulate(WAVE, base.operating_point.get(y, 0.0), TEMP) for m in (model, loaded)]
        assert np.array_equal(*runs), str(variant)


def test_several_effects_come_back_without_the_catalogue(tmp_path, monkeypatch):
    model = LINEAR
    for wanted in ("backlash", "hardening_spring", "creep", "backlash"):
        model = extend(model, next(v for v in variants(LINEAR) if v.effect.id == wanted)).model
    model = model.replace(theta=[*LINEAR.theta, 0.1, 0.2, -0.02, 0.03, 0.5, 0.1, 0.1])
    ns.save(model, tmp_path / "m.json")
    monkeypatch.setattr("narx_sym.models.effects._effect.EFFECTS", {})
    loaded = ns.load(tmp_path / "m.json")
    assert loaded.recursion == model.recursion and [e.effect for e in loaded.effects][-1] == "backlash"
    assert np.array_equal(loaded.simulate(WAVE, 0.0), model.simulate(WAVE, 0.0))


def test_terms_may_read_states(tmp_path):
    """The base's terms act on what a state makes of the input."""
    data = {
        "schema": 1, "kind": "narx", "input": "u", "output": "y", "terms": ["y[k-1]", "v[k-1]"], "theta": [0.5, 1.0],
        "states": [{"state": "v", "update": "Max(-1, Min(1, u[k]))", "initial": "1", "group": ""}],
    }  # fmt: skip
    (tmp_path / "m.json").write_text(json.dumps(data))
    loaded = saved_and_loaded(ns.load(tmp_path / "m.json"), tmp_path)
    assert loaded.simulate([5.0, 5.0, 5.0], 0.0).tolist() == [0.0, 1.0, 1.5]


PLAY = {"state": "p", "update": "Max(u[k] - r, Min(u[k] + r, p[k-1]))", "initial": "u[k]", "group": "backlash"}
GOOD = {
    "schema": 1, "kind": "equation", "input": "u", "output": "y", "F": "a*y[k-1] + p[k]", "symbols": ["a", "r"],
    "theta": [0.5, 0.1], "states": [PLAY],
    "info": {"effects": [{"effect": "backlash", "coefficients": ["a"], "shape": ["r"], "fixed": {}}]},
}  # fmt: skip
BAD_STATES = {
    "no list": ("list", {"states": "p"}),
    "no objects": ("must be an object", {"states": ["p"]}),
    "unknown field": ("'more'", {"states": [PLAY | {"more": "1"}]}),
    "missing field": ("'initial'", {"states": [{n: v for n, v in PLAY.items() if n != "initial"}]}),
    "no identifier": ("plain name", {"states": [PLAY | {"state": "p q"}]}),
    "long name": ("plain name", {"states": [PLAY | {"state": "p" * 101}]}),
    "long group": ("characters", {"states": [PLAY | {"group": "p" * 101}]}),
    "the output's name": ("means something else", {"states": [PLAY | {"state": "y"}]}),
    "a parameter's name": ("twice", {"states": [PLAY | {"state": "a"}]}),
    "a channel's name": ("twice", {"channels": ["p"]}),
    "twice": ("twice", {"states": [PLAY, PLAY]}),
    "parameter twice": ("twice", {"symbols": ["a", "r", "a"], "theta": [0.5, 0.1, 0.2]}),
    "too many": ("at most", {"states": [PLAY | {"state": f"p{i}"} for i in range(201)]}),
    "not causal": ("not known yet", {"states": [PLAY | {"update": "r*p[k]"}]}),
    "the present output": ("not known yet", {"states": [PLAY | {"update": "r*y[k]"}]}),
    "the future": ("after k", {"states": [PLAY | {"update": "r*u[k+1]"}]}),
    "unknown name": ("unknown", {"states": [PLAY | {"update": "r*u[k] + q"}]}),
    "attack": ("Cannot read|unknown", {"states": [PLAY | {"update": "__import__('os').system('true')"}]}),
    "unknown name in the initial value": ("unknown name", {"states": [PLAY | {"initial": "q"}]}),
    "state in the initial value": ("unknown sequence", {"states": [PLAY | {"initial": "p[k]"}]}),
    "phi in the initial value": ("measured signals", {"states": [PLAY | {"initial": "phi1[k]"}]}),
    "time only in the initial value": ("measured signals", {"states": [PLAY | {"initial": "t[k]"}]}),
    "a parameter that nothing uses": ("does not appear", {"symbols": ["a", "r", "b"], "theta": [0.5, 0.1, 1.0]}),
    "an output without x": ("does not contain", {"states": [PLAY, {"state": "x", "update": "r*y[k-1]", "initial": "0"}]}),
    "effects as text": ("'effects'", {"info": {"effects": "backlash"}}),
    "an effect's unknown field": ("'effects'", {"info": {"effects": [{"effect": "a", "coefficients": [], "b": 1}]}}),
    "an effect without a name": ("must be a text", {"info": {"effects": [{"effect": 1, "coefficients": []}]}}),
    "coefficients that are none": ("not a parameter", {"info": {"effects": [{"effect": "a", "coefficients": ["q"]}]}}),
}  # fmt: skip


MODEL = {"schema": 1, "kind": "narx", "input": "u", "output": "y", "terms": ["y[k-1]", "u[k-1]"], "theta": [0.5, 1.0]}
TEXT = json.dumps(MODEL)
BAD_MODELS = {
    "foreign schema": ("99", {"schema": 99}), "schema true": ("schema", {"schema": True}),
    "unknown field": ("unknown field", {"__class__": "os"}), "wrong kind": ("kind", {"kind": "exe"}),
    "code in a term": ("Cannot read", {"terms": ["__import__('os').system('x')", "u[k-1]"]}),
    "huge power": ("power", {"terms": ["y[k-1]", "u[k-1]**9**9**9"]}),
    "repeated term": ("twice", {"terms": ["u[k-1]", "u[k-1]"]}), "future input": ("", {"terms": ["y[k-1]", "u[k+1]"]}),
    "too few values": ("2 parameters", {"theta": [1.0]}), "text as value": ("theta", {"theta": ["a", 1.0]}),
    "not a number": ("", {"theta": [None, 1.0]}), "input as a list": ("", {"input": ["u"]}), "negative Ts": ("", {"Ts": -1}),
    "operating point": ("operating_point", {"operating_point": {"q": 1}}), "zero Ts": ("", {"Ts": 0}),
    "far operating point": ("", {"operating_point": {"u": 1e300}}), "negative std": ("", {"std": [-1.0, 0.1]}),
    "lead": ("lead", {"lead": -1}), "lead of a direct model": ("", {"lead": 5}), "unused channel": ("", {"channels": ["a"]}),
    "constraint on signals": ("", {"constraints": ["y[k]"]}), "broken constraint": ("", {"constraints": ["theta_1 - 2"]}),
    "broken continuum": ("", {"constraints": ["continuum"]}), "reversed ranges": ("", {"info": {"ranges": {"u": [1, -1]}}}),
    "nothing": ("JSON", b""), "no text": ("JSON", b"\xff" * 10), "too large": ("larger than", b"\0" * 3_000_000),
    "half": ("JSON", "{"), "a list": ("schema", "[]"), "deep": ("JSON", "[" * 100_000), "two models": ("JSON", TEXT + TEXT),
    "no schema": ("schema", '{"terms": []}'), "field twice": ("appears twice", TEXT.replace("{", '{"theta": [9.0], ', 1)),
    "NaN": ("no number", TEXT.replace("0.5", "NaN")), "infinite": ("no number", TEXT.replace("0.5", "-Infinity")),
    "huge value": ("too large", TEXT.replace("0.5", "1e999")), "long value": ("JSON", TEXT.replace("0.5", "1" * 5000)),
    "half a letter": ("input", TEXT.replace('"u"', '"\\ud800"')), "two bytes a letter": ("JSON", TEXT.encode("utf-16")),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_MODELS)
def test_bad_models_are_refused_with_one_message(name, tmp_path, run):
    said, bad = BAD_MODELS[name]
    text = json.dumps(MODEL | bad) if isinstance(bad, dict) else bad
    path = tmp_path / "m.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ModelError, match=rf"m\.json: .*{said}"):
        ns.load(path)
    code, _, err = run("derive", path)
    assert code == 2 and err.startswith("narx-sym: ") and err.count("\n") == 1


@pytest.mark.parametrize("name", BAD_STATES)
def test_bad_states_are_refused(name, tmp_path):
    said, changed = BAD_STATES[name]
    (tmp_path / "m.json").write_text(json.dumps(GOOD | changed))
    with pytest.raises(ModelError, match=rf"m\.json: .*({said})"):
        ns.load(tmp_path / "m.json")


def test_an_initial_value_may_be_a_parameter(tmp_path):
    found = []
    for begin in ("r", "0.1", "u[k]"):
        (tmp_path / "m.json").write_text(json.dumps(GOOD | {"states": [PLAY | {"initial": begin}]}))
        model = saved_and_loaded(ns.load(tmp_path / "m.json"), tmp_path)
        found.append(model.simulate([0.0, 0.05, 0.0], 0.0).tolist())
    assert found[0] == found[1] != found[2]


def test_the_base_of_these_is_good(tmp_path):
    (tmp_path / "m.json").write_text(TEXT)
    assert ns.load(tmp_path / "m.json").theta.tolist() == [0.5, 1.0]
    (tmp_path / "m.json").write_text(json.dumps(GOOD))
    loaded = saved_and_loaded(ns.load(tmp_path / "m.json"), tmp_path)
    assert loaded.simulate([0.0, 1.0, 0.0], 0.0).tolist() == pytest.approx([0.0, 0.9, 0.45 + 0.1])


OLD = {
    "schema": 1, "kind": "equation", "input": "u", "output": "y", "symbols": ["a", "b", "c_backlash", "r_backlash", "c_channel_temp"],
    "F": "a*y[k-1] + b*v[k-1] + c_channel_temp*temp[k]", "channels": ["temp"], "theta": [0.5, 1.0, 0.9, 0.2, 0.1],
    "std": [0.1, 0.2, None, 0.0, 0.3], "Ts": 0.01,
    "states": [
        {"state": "p", "update": "Max(u[k] - r_backlash, Min(u[k] + r_backlash, p[k-1]))", "initial": "u[k]", "group": "backlash"},
        {"state": "v", "update": "u[k] + c_backlash*(p[k] - u[k])", "initial": "u[k]", "group": ""},
    ],
    "info": {
        "method": "free_run", "converged": True, "samples": 500, "nrmse": {"one_step": 0.1, "free_run": 0.2}, "note": "by hand",
        "ranges": {"u": [-1, 1], "y": [-2, 2]}, "rates": {"u": 3}, "line": [0.0, 2.0], "band": 0.5, "steps": {"u": 0.1},
        "selection": {"base": "linear", "candidates": 9, "reason": "smallest"},
        "effects": [
            {"effect": "backlash", "form": "", "where": "input", "driver": "u", "coefficients": ["c_backlash"],
             "shape": ["r_backlash"], "fixed": {"n": 3}},
            {"effect": "channel:temp", "coefficients": ["c_channel_temp"]},
        ],
    },
}  # fmt: skip


def test_files_of_the_first_schema_are_read(tmp_path):
    (tmp_path / "old.json").write_text(json.dumps(OLD))
    model = ns.load(tmp_path / "old.json")
    _, _, c, r, temperature = model.symbols
    assert model.effects == (
        AddedEffect("backlash", "", "input", "u", "backlash", {"c": c}, {"r": r}, {"n": 3}),
        AddedEffect("channel:temp", group="channel_temp", coefficients={"c": temperature}),
    )
    assert model.info == Info(
        "free_run", True, 500, Nrmse(0.1, 0.2), {"u": (-1.0, 1.0), "y": (-2.0, 2.0)}, {"u": 3.0}, {}, {"u": 0.1},
        (0.0, 2.0), 0.5, Selection("linear", 9, 0, "smallest"),
    )  # fmt: skip
    assert model.standard_errors[:2] == (0.1, 0.2) and np.isnan(model.standard_errors[2])
    ns.save(model, tmp_path / "new.json")
    written = json.loads((tmp_path / "new.json").read_text())
    assert written["schema"] == 2 and "std" not in written and "effects" not in written["info"]
    again = saved_and_loaded(model, tmp_path)
    assert again.recursion == model.recursion and again.effects == model.effects and again.info == model.info


@pytest.mark.parametrize(
    "changed",
    (
        {"info": {"converged": 1}}, {"info": {"samples": 1.5}}, {"info": {"nrmse": {"one_step": 1.0}}}, {"info": {"method": 3}},
        {"info": {"selection": {"base": 1}}}, {"info": {"selection": {"candidates": "9"}}}, {"info": {"more": 1}},
        {"info": {"steps": {"u": 0}}}, {"info": {"nrmse": {"one_step": "a", "free_run": 1.0}}}, {"info": []},
        {"effects": [{"effect": "a", "coefficients": ["a"]}]}, {"effects": [{"effect": "a", "coefficients": {"c": "q"}}]},
        {"effects": [{"effect": "a", "coefficients": {}, "fixed": {"n": 1.5}}]}, {"std": [0.1, 0.1]},
        {"standard_errors": [0.1]}, {"standard_errors": [-0.1, 0.1]},
    ),
)  # fmt: skip
def test_what_stands_beside_the_equations_is_checked(changed, tmp_path):
    good = {n: v for n, v in GOOD.items() if n != "info"} | {"schema": 2, "info": {"method": "one_step"}}
    (tmp_path / "m.json").write_text(json.dumps(good))
    assert ns.load(tmp_path / "m.json").info.method == "one_step"
    (tmp_path / "m.json").write_text(json.dumps(good | changed))
    with pytest.raises(ModelError, match=r"m\.json: .*(info|effects|standard_errors|std)"):
        ns.load(tmp_path / "m.json")


def test_what_could_not_be_read_back_is_not_written(tmp_path):
    variant = next(v for v in variants(LINEAR, ["temp [C]"]) if v.channel)
    with pytest.raises(ModelError, match="plain name"):
        ns.save(extend(LINEAR, variant).model, tmp_path / "m.json")
    assert not list(tmp_path.iterdir())


def test_a_parameter_may_be_called_k(tmp_path):
    stiffness, b = sp.symbols("k b", real=True)
    model = ns.Model(b * y[k - 1] - stiffness * u[k - 2] ** 2, (stiffness, b), [0.3, 0.5])
    loaded = saved_and_loaded(model, tmp_path)
    assert loaded.F == model.F and loaded.symbols == model.symbols
    with pytest.raises(ParseError, match="unknown name 'k'"):
        parse("k*u[k-1]")


@pytest.mark.parametrize(
    "factor", (sp.Piecewise((u[k - 1], u[k - 1] > 0), (0, True)), u[k - 1] * sp.Float(1e-305), u[k - 1] ** 40)
)
def test_nothing_is_written_that_could_not_be_read(factor, tmp_path):
    a, b = sp.symbols("a b", real=True)
    path = tmp_path / "m.json"
    path.write_text("what was there before")
    with pytest.raises(ModelError, match="could not be read again"):
        ns.save(ns.Model(a * y[k - 1] + b * factor, (a, b), [0.5, 1.0]), path)
    assert path.read_text() == "what was there before"


def test_constants_with_names_are_numbers_in_a_file(tmp_path):
    a, b = sp.symbols("a b", real=True)
    model = ns.Model(a * y[k - 1] + b * sp.E * u[k - 1] + sp.pi * u[k - 2], (a, b), [0.5, 1.0])
    step = np.ones(9)
    assert np.array_equal(saved_and_loaded(model, tmp_path).simulate(step, 0.0), model.simulate(step, 0.0))
