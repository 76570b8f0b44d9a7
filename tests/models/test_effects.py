"""The catalogue: every effect is described, reads back as text, and can be joined by the user's own."""

import json
import pickle

import numpy as np
import pytest
import sympy as sp
from places import SHARED, needs_shared

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.errors import ModelError
from narx_sym.models.effects import DETECTED, EFFECTS, PLACES, Catalogue, Scan, effect, load_effects, text_effect
from narx_sym.models.effects._effect import SEQUENCES
from narx_sym.models.extend import extend, find, variants
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.mathml import mathml
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, samples, signal, u, x

IDS = (
    "hysteresis", "backlash", "coulomb_friction", "stribeck_friction", "quadratic_drag", "inertia", "dead_zone",
    "saturation", "asymmetric_gain", "quadratic_gain", "cubic_gain", "input_delay", "rate_dependence",
    "rate_limit", "uneven_speed", "hardening_spring", "quadratic_spring", "bilinear_gain", "creep", "offset", "drift", "periodic_disturbance",
    "gravity", "orifice", "charge_curve", "channel", "channel_gain", "ageing", "absolute_sensor", "output_limit", "stiction", "end_stop",
    "sqrt_outflow", "channel_friction", "sensor_saturation", "quantisation",
)  # fmt: skip
ALL = EFFECTS.all()
LINEAR = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01)


def named(one):
    return f"{one.id} {one.form}".strip().replace(" ", "-")


def form_of(one):
    """Its equations, whole numbers put in for steps."""
    return one.equations(Ts=0.01, **{p: 2 for p, s in one.scan.items() if s.of == "steps"})


def read_back(expr, states):
    names = [str(s.left.base.label) for s in states]
    real = {s: sp.Symbol(s.name, real=True) for s in expr.free_symbols if isinstance(s, sp.Symbol) and s != k}
    expr = expr.xreplace({s: r for s, r in real.items() if s.is_positive})
    symbols = [s.name for s in expr.free_symbols if isinstance(s, sp.Symbol) and s != k]
    return expr, parse(ns.text(expr), signals=[*SEQUENCES, *names], symbols=symbols)


def test_ids_are_those_that_were_agreed():
    assert sorted(IDS) == sorted([*EFFECTS, *DETECTED])


@pytest.mark.parametrize("one", ALL, ids=named)
def test_described(one):
    assert one.source and len(one.sentence) > 15 and one.sentence.endswith(".")
    assert "_" not in one.sentence and one.written
    assert set(one.scan) == set(one.shape)
    refined = {p for p in one.shape if one.scan[p].of != "steps"}
    assert refined <= set(one.unit) <= set(one.shape)
    assert set(one.places) <= set(PLACES) and all(one.places.values())
    assert one.share[0] < one.share[1] and (one.sign, one.full) == (int(one.share[0] >= 0), one.share[1] == 1)
    assert EFFECTS[one.id].count(one) == 1
    assert {other.sentence for other in EFFECTS[one.id]} == {one.sentence}


@pytest.mark.parametrize("one", ALL, ids=named)
def test_equations_read_back_and_print(one):
    form = form_of(one)
    assert form.z
    for expr in (*form.z, *(e for s in form.states for e in (s.right, sp.sympify(s.initial)))):
        expected, found = read_back(expr, form.states)
        assert found == expected or np.allclose(*[_number(e) for e in (found, expected)], rtol=1e-14)
        shown = ns.latex(expr)
        assert shown.count("{") == shown.count("}") and "Piecewise" not in shown and "**" not in shown
        assert mathml(expr).startswith("<math")


def _number(expr):
    """A number that tells expressions apart; floats print shorter than SymPy keeps them."""
    atoms = sorted(samples(expr), key=str) + sorted((s for s in expr.free_symbols if s.is_Symbol and s != k), key=str)
    return float(expr.xreplace({s: sp.Float(0.3 + 0.17 * i) for i, s in enumerate(atoms)}))


def along(one, shape):
    """What an effect contributes along a random way of what drives it."""
    rng = np.random.default_rng(3)
    seen = {name: np.cumsum(rng.standard_normal(400)) for name in SEQUENCES}
    form = form_of(one)
    out = signal("out")
    updates = [(s.left, s.right) for s in form.states] + [(out[k], form.z[0])]
    known = {s: shape[s.name] for _, right in updates for s in right.free_symbols if getattr(s, "name", "") in shape}
    run = compile(Recursion(tuple((left, sp.sympify(right).xreplace(known)) for left, right in updates)))
    start = {
        str(s.left.base.label): float(seen["x"][0]) if samples(sp.sympify(s.initial)) else 0.0 for s in form.states
    }
    return run(seen, initial=start)["out"][4:]


STOPS = ["upper", "lower", "both sides", "rigid upper", "rigid lower", "rigid both sides"]
MEMORIES = [*(f"Bouc-Wen{more}" for more in ("", ", wide", ", sharp", " force", " actuator")), "play superposition"]
FOLLOWS = {  # from the equations: of which forms it holds
    "at_rest": [*(("end_stop", f) for f in STOPS), *(("output_limit", f) for f in STOPS[:3])],
    "turning": [*(("backlash", f) for f in ("", "elastic", "behind a lag")), *(("hysteresis", f) for f in MEMORIES)],
    "weights": [("hysteresis", "play superposition")],
    "lagged": [
        *((name, "behind a lag") for name in ("dead_zone", "saturation", "backlash")),
        *(("end_stop", f"of a first lag, {f}") for f in ("upper", "lower", "spilling over")),
        ("coulomb_friction", "viscoelastic"),
    ],
}  # fmt: skip
LIMITS = {
    ("stribeck_friction", ""): ("s", np.inf, "coulomb_friction"),
    **{("stiction", form): ("e", 0.0, "coulomb_friction") for form in ("", "of a speed")},
    ("stiction", "of a valve"): ("e", 0.0, "backlash"),
    **{("channel_friction", f): ("q", 0.0, "coulomb_friction") for f in ("holding", "holding, of a speed")},
}


@pytest.mark.parametrize("one", ALL, ids=named)
def test_what_follows_from_its_equations(one):
    key = (one.id, one.form)
    assert {name: key in FOLLOWS[name] for name in FOLLOWS} == {name: getattr(one, name) for name in FOLLOWS}
    assert one.limit == LIMITS.get(key, ()) and one.series == ((3, "saturation") if one.id == "cubic_gain" else ())
    assert one.standing == ("of a speed" in one.form)


def test_what_follows_is_so_for_ones_own():
    """What is made of x itself needs no flags: an end stop, and the cubic of another smooth limit."""

    @effect("inside", driver="y", scan={"r": Scan("amplitude", (0.5,))}, id="own_stop", register=False)
    def stop(x, r):
        return -2 * sp.Max(x[k] - r, 0)

    assert stop.at_rest and not stop.turning and stop.limit == () and stop.unit == {"r": "unit of the driver"}


@pytest.mark.parametrize("one", [e for e in ALL if e.limit], ids=named)
def test_at_its_limit_it_is_another_effect(one):
    name, value, other = one.limit
    shape = {p: sp.Float(0.7) for p in one.shape}
    shape[name] = sp.Float({0.0: 1e-12, np.inf: 1e9}[value])
    found = along(one, shape)
    simpler = [e for e in EFFECTS[other] if len(e.shape) < len(one.shape) and set(e.places) & set(one.places)]
    gaps = [np.abs(found - along(e, {p: sp.Float(0.7) for p in e.shape})).max() for e in simpler]
    assert min(gaps) < 1e-9 and np.abs(found).max() > 0.5
    shape[name] = sp.Float(0.5)
    assert np.abs(along(one, shape) - found).max() > 1e-3


# ---------------------------------------------------------------- one's own, from Python


@pytest.fixture
def restored():
    before = {name: list(forms) for name, forms in EFFECTS.items()}
    yield
    EFFECTS.clear()
    EFFECTS.update(before)


def test_ten_lines_make_an_effect(restored):
    @effect("input", scan={"r": Scan("amplitude", (0.5, 1.0), unit="V")}, share=(0, np.inf), source="Smith 2020")
    def soft_limit(x, r):
        """Large inputs do less, softly."""
        return sp.atan(x[k] / r) * r - x[k]

    assert soft_limit in EFFECTS.all() and find("soft_limit") == ([soft_limit], None)
    added = extend(LINEAR, next(v for v in variants(LINEAR) if v.effect is soft_limit))
    assert [str(s) for s in added.model.symbols[-2:]] == ["c_soft_limit", "r_soft_limit"]
    full = added.model.replace(theta=[*LINEAR.theta, 0.5, 1.0])
    assert np.all(np.isfinite(full.simulate(np.sin(np.arange(50) / 5), 0.0)))


def test_a_shape_parameter_without_a_scan_rule_is_refused():
    with pytest.raises(ModelError, match="'r'"):

        @effect("input")
        def unscanned(x, r):
            return x[k] / r

    with pytest.raises(ModelError, match="a place is one of"):

        @effect("beside")
        def misplaced(x):
            return x[k]

    with pytest.raises(ModelError, match="like a coefficient"):
        effect("input", scan={"c1": Scan("amplitude", (1.0,))}, id="own", register=False)(lambda x, c1: c1 * x[k])
    assert not {"unscanned", "misplaced"} & set(EFFECTS)


def test_the_same_form_twice_replaces_the_first():
    catalogue = Catalogue()
    made = [effect("input", id="same", form=f, register=False)(lambda x: x[k]) for f in ("a", "b", "a")]
    for one in made:
        catalogue.add(one)
    assert catalogue.all() == [made[1], made[2]] and not catalogue.without("same").all()


# ---------------------------------------------------------------- one's own, from a file

FILE = """
[[effect]]
id = "my_stick_slip"
where = "output"
driver = "u"
z = "tanh((x[k] - x[k-1])/s)"
scan = { s = { of = "speed", values = [0.1, 0.5, 1.5] } }
unit = { s = "V per sample" }
sentence = "My own friction."
source = "Smith 2020"

[[effect]]
id = "my_play"
where = "input"
z = ["p[k] - x[k]"]
states = [{ state = "p", update = "Max(x[k] - w, Min(x[k] + w, p[k-1]))", initial = "x[k]" }]
scan = { w = "amplitude" }
sign = 1
sentence = "Slack before the input."

[[effect]]
id = "my_heat"
where = ["output", "inside"]
driver = "channel"
z = "h[k]"
states = [{ state = "h", update = "exp(-Ts/tau)*h[k-1] + (1 - exp(-Ts/tau))*channel[k]" }]
scan = { tau = "time" }
sentence = "A temperature acts late."

[[effect]]
id = "my_echo"
where = { inside = "y", output = ["u", "y"] }
z = "x[k-n] - x[ k - n ]*abs(x[k])"
scan = { n = { of = "steps", values = [1, 4] } }
sentence = "It comes back."
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(FILE)
    catalogue = Catalogue()
    load_effects(path, catalogue)
    return catalogue


def test_effects_from_a_file(own, tmp_path):
    assert list(own) == ["my_stick_slip", "my_play", "my_heat", "my_echo"]
    friction, play, heat, echo = own.all()
    assert friction.places == {"output": ("u",)} and friction.scan == {
        "s": Scan("speed", (0.1, 0.5, 1.5), unit="V per sample")
    }
    assert friction.source == "Smith 2020" and friction.unit == {"s": "V per sample"} and friction.sign == 0
    assert play.arguments == ("x", "w") and play.sign == 1 and heat.arguments == ("channel", "Ts", "tau")
    assert echo.equations(n=4).z == (x[k - 4] - x[k - 4] * sp.Abs(x[k]),)
    assert str(play.equations().z[0]) == "p[k] - x[k]"
    assert find("my_heat:temp", own)[1] == "temp"
    again = pickle.loads(pickle.dumps(own))
    assert again["my_echo"][0].equations(n=4) == echo.equations(n=4)


def test_they_are_what_python_makes(own):
    """A text and a function with the same equation give the same models."""
    both = {"my_stick_slip": ("coulomb_friction", "smooth"), "my_play": ("backlash", "")}
    for name, (other, form) in both.items():
        mine = next(v for v in variants(LINEAR, catalogue=own) if v.effect.id == name)
        theirs = next(
            v for v in variants(LINEAR) if v.effect.id == other and v.effect.form == form and v.driver == mine.driver
            and v.where == mine.where and v.lag == mine.lag
        )  # fmt: skip
        models = [extend(LINEAR, v).model for v in (mine, theirs)]
        theta = [*LINEAR.theta, 0.2, 0.3]
        wave = np.sin(np.arange(100) / 9)
        runs = []
        for model in models:
            runs.append(model.replace(theta=theta).simulate(wave, 0.0))
        assert np.array_equal(*runs), name


def test_every_variant_from_a_file_runs_and_is_saved(own, tmp_path):
    found = list(variants(LINEAR, ["temp"], own))
    assert len(found) == 2 + 1 + 2 + 8  # an own delay of the input where u drives the output
    for variant in found:
        added = extend(LINEAR, variant)
        theta = [*LINEAR.theta, *[0.01] * len(added.coefficients), *[0.3] * len(added.shape)]
        model = added.model.replace(theta=theta)
        run = model.simulate(np.sin(np.arange(60) / 5), 0.0, {"temp": np.cos(np.arange(60) / 20)})
        assert np.all(np.isfinite(run))
        ns.save(model, tmp_path / "m.json")
        assert ns.load(tmp_path / "m.json").recursion == model.recursion


def test_json_says_the_same(own, tmp_path):
    data = {"effect": [{"id": "my_play", "where": "input", "z": "p[k] - x[k]", "scan": {"w": "amplitude"}, "sign": 1,
                        "states": [{"state": "p", "update": "Max(x[k] - w, Min(x[k] + w, p[k-1]))", "initial": "x[k]"}],
                        "sentence": "Slack before the input."}]}  # fmt: skip
    (tmp_path / "own.json").write_text(json.dumps(data))
    (one,) = load_effects(tmp_path / "own.json", own)  # the same again replaces
    assert len(own["my_play"]) == 1 and own["my_play"][0] is one
    assert text_effect(data["effect"][0]).equations() == one.equations()


def test_a_file_goes_into_the_catalogue(restored, tmp_path):
    (tmp_path / "own.toml").write_text(FILE)
    assert [e.id for e in load_effects(tmp_path / "own.toml")] == [n for n in EFFECTS if n.startswith("my_")]


MINE = {"id": "mine", "where": "input", "z": "x[k]**2", "sentence": "Mine."}
PLAYS = {"z": "p[k]", "states": [{"state": "p", "update": "p[k-1] + x[k]"}]}
WRONG = {
    "no id": ("plain name", {"id": 3}),
    "id with a colon": ("plain name", {"id": "a:b"}),
    "unknown field": ("unknown field 'drivers'", {"drivers": "u"}),
    "unknown place": ("a place is one of", {"where": "beside"}),
    "no place": ("list of different", {"where": []}),
    "unknown driver": ("a driver is one of", {"driver": "w"}),
    "drivers at two places": ("not both", {"where": {"input": "u"}, "driver": "u"}),
    "channel that is not used": ("no equation uses", {"driver": "channel"}),
    "no equation": ("'z'", {"z": []}),
    "long equation": ("text", {"z": "x[k]+" * 1000 + "1"}),
    "attack": ("Cannot read|unknown", {"z": "__import__('os').system('true')"}),
    "unknown function": ("unknown function", {"z": "gamma(x[k])"}),
    "unknown parameter": ("needs a rule in 'scan'", {"z": "x[k]/s"}),
    "phi": ("write x", {"z": "phi1[k]"}),
    "the future": ("not known", {"z": "x[k+1]"}),
    "the present output": ("not known", {"where": "inside", "z": "y[k]*u[k]", "driver": "uy"}),
    "a state not known yet": ("not known yet", PLAYS | {"states": [{"state": "p", "update": "p[k] + x[k]"}]}),
    "a state of a sequence's name": ("another name", {"states": [{"state": "x", "update": "u[k]"}]}),
    "states twice": ("another name", PLAYS | {"states": PLAYS["states"] * 2}),
    "a state without an update": ("a state has the fields", {"states": [{"state": "p"}]}),
    "states as a text": ("list", {"states": "p"}),
    "an initial value by a parameter": (
        "only signals", PLAYS | {"states": [{"state": "p", "update": "x[k]*s", "initial": "s"}], "scan": {"s": "speed"}},
    ),
    "an initial value by a state": ("may contain", PLAYS | {"states": [{"state": "p", "update": "p[k-1]", "initial": "p[k]"}]}),
    "a lag that is refined": ("Cannot read", {"z": "x[k-s]", "scan": {"s": "speed"}}),
    "scan of nothing": ("no equation", {"scan": {"s": "speed"}}),
    "unknown scan": ("a scan is of", {"z": "x[k]/s", "scan": {"s": "range"}}),
    "scan of zero": ("above 0", {"z": "x[k]/s", "scan": {"s": {"of": "amplitude", "values": [0]}}}),
    "half a step": ("whole samples", {"z": "x[k-n]", "scan": {"n": {"of": "steps", "values": [0.5]}}}),
    "late times": ("between 0", {"z": "x[k]/s", "scan": {"s": {"of": "time", "values": [2]}}}),
    "no scan values": ("1 to 50", {"z": "x[k]/s", "scan": {"s": {"of": "speed", "values": []}}}),
    "power": ("power", {"z": "x[k]/s", "scan": {"s": {"of": "speed", "power": 9}}}),
    "name of a coefficient": ("another name", {"z": "x[k]/c1", "scan": {"c1": "speed"}}),
    "unit of nothing": ("not a shape parameter", {"unit": {"s": "V"}}),
    "sign": ("'sign'", {"sign": -1}),
    "centred": ("'centred'", {"centred": 1}),
    "infinite": ("division by zero", {"z": "x[k]/0"}),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_effects_are_refused(name, tmp_path):
    said, changed = WRONG[name]
    (tmp_path / "own.json").write_text(json.dumps({"effect": [MINE, MINE | changed | {"form": "other"}]}))
    catalogue = Catalogue()
    with pytest.raises(ModelError, match=rf"own\.json: .*({said})"):
        load_effects(tmp_path / "own.json", catalogue)
    assert not catalogue  # all or none


@pytest.mark.parametrize(
    "name, content, said",
    (
        ("a.toml", "[[effect]\n", "no valid TOML"),
        ("a.json", "{", "no valid JSON"),
        ("a.json", "[" * 100_000, "no valid JSON|larger"),
        ("a.json", "[]", "nothing else"),
        ("a.toml", "title = 'x'\n" + FILE, "nothing else"),
        ("a.toml", "effect = []", "1 to"),
        ("a.toml", "effect = [3]", "table of fields"),
        ("a.toml", "#" * 200_001, "larger"),
        ("a.toml", FILE + FILE, "already"),
        ("a.toml", FILE.replace("my_play", "backlash"), "already"),
    ),
)
def test_wrong_files_are_refused(name, content, said, tmp_path):
    (tmp_path / name).write_text(content)
    before = EFFECTS.all()
    with pytest.raises(ModelError, match=said):
        load_effects(tmp_path / name)
    assert EFFECTS.all() == before


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(ModelError, match="no such file"):
        load_effects(tmp_path / "none.toml")
    with pytest.raises(ModelError, match="cannot be read"):
        load_effects(tmp_path)


def test_the_base_of_the_wrong_ones_is_good():
    assert text_effect(MINE).equations().z == (x[k] ** 2,)
    assert text_effect(MINE | {"z": "u[k]*y[k-1]", "where": "inside", "driver": "uy"}).arguments == ("u", "y")
    assert text_effect(MINE | {"z": "u[k] + Ts"}).equations(Ts=0.5).z == (u[k] + sp.Float(0.5),)


@needs_shared
def test_the_hysteresis_of_the_benchmark_lies_in_its_range():
    """Noel & Schoukens (2016): beta gamma = 800, delta / gamma = -1.375; the loop stiffens."""
    record = ns.read(SHARED / "boucwen" / "train_multisine.csv")[:4000]
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k]", "u[k-1]", "u[k-2]"], Ts=record.Ts).fit(record)
    model = base.add("hysteresis", "inside").fit(record)
    found = {str(s): value for s, value in zip(model.symbols, model.theta, strict=True)}
    assert found["b_hysteresis"] == pytest.approx(800, rel=0.02)
    assert found["g_hysteresis"] == pytest.approx(-1.375, rel=0.01)
    assert ns.evaluate(model, ns.read(SHARED / "boucwen" / "test_multisine.csv")).free_run_rms < 3e-6  # of 6.7e-4


@needs_shared
def test_a_memory_is_found_beside_a_start_that_hardly_matters():
    """The third output has a weight of 4e-4: its start takes a step of a thousand ranges, where a memory is to move."""
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "y[k-3]", "u[k-1]"], Ts=1 / 750)
    added = extend(base, next(v for v in variants(base) if v.effect.form == "Bouc-Wen force"))
    theta = [
        1.94973081,
        -0.994132858,
        3.54012329e-4,
        8.69008806e-7,
        -0.0438245773,
        1.70432539e-4,
        799.526767,
        -1.37680355,
    ]
    record = ns.read(SHARED / "boucwen" / "test_multisine.csv")  # begins in the middle of a loop: 5.2e-5 from rest
    assert ns.evaluate(added.model.replace(theta=theta), record).free_run_rms < 6e-6
