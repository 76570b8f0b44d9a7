"""A model plus an effect is a model: it contains the base, runs, predicts, prints, and moves along its direction."""

import shutil
import subprocess
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
import sympy as sp
import truths
from sampling import more, some

import narx_sym as ns
from narx_sym.diagnosis.screening.directions import Linearised
from narx_sym.engines.compile import compile
from narx_sym.errors import Diverged, ModelError, NotInvertible
from narx_sym.fit.constraints import constraint_equations
from narx_sym.fit.freerun import FreeRun
from narx_sym.fit.simulate import arrays, initial_values
from narx_sym.models.effects import EFFECTS, Catalogue, Form, effect
from narx_sym.models.extend import equations, extend, find, variants
from narx_sym.models.info import Info
from narx_sym.models.rewrite import without
from narx_sym.symbolic.recursion import State
from narx_sym.symbolic.signals import k, m, signal, t, u, v, x, y

gcc = shutil.which("gcc")
BASES = {
    "linear": ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01),
    "continuum": ns.NARX.from_terms(
        ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"], [1.0, 0.7, 0.1, -0.2],
        Ts=0.01, constraints=["continuum"], operating_point={u: 0.3, y: -2.0},
    ),
    "static": ns.NARX.from_terms(["u[k]", "u[k]**2"], [1.5, 0.2], Ts=0.01),
}  # fmt: skip
N, REST = 300, 20
EVERY = [(name, v) for name, base in BASES.items() for v in variants(base, ["temp"])]
# One variant of each effect is quick, further places, forms and drivers are asked with -m more; those that act later, or
# in another reference or base, are long.
QUICK = {v.id: i for i, (n, v) in reversed([*enumerate(EVERY)])}.values()
FIRST = {(v.id, v.effect.form, v.where, v.driver): i for i, (n, v) in reversed([*enumerate(EVERY)])}.values()
MARKS = [[] if i in QUICK else more if i in FIRST else pytest.mark.long for i in range(len(EVERY))]
MARKED = [pytest.param(*pair, marks=marks) for pair, marks in zip(EVERY, MARKS, strict=True)]
IDS = [f"{name}-{v}".replace(" ", "_") for name, v in EVERY]


def record_of(base):
    """An experiment that starts at rest at the operating point: nothing has a past."""
    i = np.arange(N - REST)
    wave = 0.8 * np.sin(i / 17) + 0.5 * np.sin(i / 5.3) + 0.21 * np.sin(i / 2.17)
    source = base.operating_point.get(u, 0.0) + np.concatenate([np.zeros(REST), wave])
    temp = np.concatenate([np.zeros(REST), np.cos(i / 40)])
    start = base.operating_point.get(y, 0.0)
    clean = base.simulate(source, start)
    noise = 0.05 * np.random.default_rng(3).standard_normal(N)
    noise[:REST] = 0.0
    return ns.Record.from_arrays(source, clean + noise, Ts=0.01, channels={"temp": temp})


RECORDS = {name: record_of(base) for name, base in BASES.items()}


def valued(added, base, c=0.0):
    """Put values in: the base's, c for every coefficient, shapes inside the range of the signals."""
    sizes = {"tau": 0.05, "f": 3.0, "b": 0.7, "d": 1.1, "r_rate_limit": 0.02, "e_rate_limit": 0.03}
    shapes = [sizes.get(str(s), sizes.get(str(s).split("_")[0], 0.25)) for s in added.shape]
    given = dict.fromkeys(added.coefficients, c) | dict(zip(added.shape, shapes, strict=True))
    given |= dict(zip(base.symbols, base.theta, strict=True))
    return added.model.replace(theta=[given[s] for s in added.model.symbols])


def run(model, record):
    return model.simulate(record.u, record.y[0], {**record.channels, "t": record.t})


def first(base, wanted, where=None, driver=None):
    found = (v for v in variants(base, ["temp"]) if v.id == wanted and where in (None, v.where))
    return next(v for v in found if driver in (None, v.driver))


# ---------------------------------------------------------------- every variant of every base


@pytest.mark.parametrize("name, variant", MARKED, ids=IDS)
def test_a_variant_is_a_model(name, variant):
    base, record = BASES[name], RECORDS[name]
    added = extend(base, variant)
    expected = run(base, record)
    assert np.abs(run(valued(added, base), record) - expected).max() <= 1e-12
    c = 1e-3 if variant.where == "inside" else 0.02
    model = valued(added, base, c)
    free = run(model, record)
    assert np.all(np.isfinite(free)) and np.abs(free - expected).max() > 1e-6
    # What the model makes itself it predicts without error, once the start is over.
    own = ns.Record.from_arrays(record.u, free, Ts=0.01, channels=record.channels)
    # Where a sensor bends what it sees, that is found step by step.
    late = slice(max(model.recursion.depth, model.predictor.depth) + (10 if variant.where == "sensor" else 2), None)
    if not set(variant.effect.arguments) & {"t", "channel"} or base.n_y < 2:
        assert np.abs(model.predict(own) - free)[late].max() < 1e-9
    assert set(map(str, model.symbols)) == {str(s) for s in (*base.symbols, *added.coefficients, *added.shape)}
    assert model.effects[0].effect == variant.id
    assert constraint_equations(model, None) == constraint_equations(base, None)
    for shown in (model.latex(), model.latex(numbers=True), *(ns.latex(s.right) for s in model.states)):
        assert shown.count("{") == shown.count("}") and "**" not in shown


@pytest.mark.parametrize("name, variant", MARKED, ids=IDS)
def test_the_direction_is_the_derivative_of_the_free_run(name, variant):
    base, record = BASES[name], RECORDS[name]
    problem = FreeRun(base, record, [])
    around = Linearised(problem, problem.start(base.theta))
    added = extend(base, variant)
    values = dict(zip(added.shape, valued(added, base).theta[len(base.theta) + len(added.coefficients) :], strict=True))
    form = equations(base, variant)
    own = {sp.Symbol(p, real=True): values[s] for p, s in zip(variant.shape, added.shape, strict=True)}
    found = around.moved(variant.where, around.contributions(form, own))
    data = arrays(valued(added, base), record)
    depth = max(1, added.model.recursion.depth)
    begin = initial_values(valued(added, base), data, depth)  # where it starts from is a direction of its own
    assert found.shape == (N - problem.depth, len(added.coefficients))
    for j, c in enumerate(added.coefficients):
        runs = []
        for small in (1e-6, -1e-6):
            model = valued(added, base)
            theta = model.theta.copy()
            theta[model.symbols.index(c)] = small
            runs.append(compile(model.recursion)(data, theta, begin, start=depth)["y"])
        expected = (runs[0] - runs[1])[problem.depth :] / 2e-6
        assert np.linalg.norm(found[:, j] - expected) <= 1e-5 * np.linalg.norm(expected)
        assert np.any(expected)


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=more)], ids=["one form", "every form"])
@pytest.mark.parametrize("name", ("linear", pytest.param("continuum", marks=pytest.mark.long)))
def test_an_output_effect_is_taken_off_before_the_core_predicts(name, every):
    """By hand: the core sees the past measured outputs without the effect's part."""
    base, record = BASES[name], RECORDS[name]
    problem = FreeRun(base, record, [])
    around = Linearised(problem, problem.start(base.theta))
    tried = set()
    for variant in variants(base, ["temp"]):
        if variant.where != "output" or variant.driver == "y" or (variant.effect.id in tried and not every):
            continue
        added = extend(base, variant)
        model = valued(added, base, 0.1)
        form = equations(base, variant)
        values = [model.values[s] for s in added.shape]
        symbols = [sp.Symbol(p, real=True) for p in variant.shape]
        (z,) = around.contributions(form, dict(zip(symbols, map(float, values), strict=True)))
        part = 0.1 * z.sum(axis=1)
        core = ns.Record.from_arrays(record.u, record.y - part, Ts=0.01)
        late = slice(REST, None)
        assert np.abs(model.predict(record) - base.predict(core) - part)[late].max() < 1e-9, str(variant)
        tried.add(variant.effect.id)
    assert {"drift", "channel", "hysteresis", "coulomb_friction", "offset"} <= tried


SLIPS = sp.sign(y[k - 1] - y[k - 2])


def c_models(base, inner):
    """One model per effect, form, place and driver; with or without the inner output `x`."""
    found = {}
    for variant in variants(base, ["temp"]):
        if (variant.where == "output") == inner:
            key = (variant.id, variant.effect.form, variant.where, variant.driver)
            found.setdefault(key, valued(extend(base, variant), base, 0.02))
    return list(found.values())


def built(folder, sources, body):
    """Compile several sources into one program without a warning; each has its own prefix."""
    path = folder / "all.c"
    path.write_text("\n".join([*sources, "#include <stdio.h>", "int main(void)", "{", *body, "}"]))
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    subprocess.run([gcc, *flags, path, "-o", folder / "all", "-lm"], check=True, capture_output=True)
    return subprocess.run([folder / "all"], capture_output=True, text=True, check=True).stdout


@pytest.mark.skipif(gcc is None, reason="no C compiler here")
@pytest.mark.parametrize("inner", (pytest.param(False, marks=more), True))
@pytest.mark.parametrize("name", ("linear", pytest.param("continuum", marks=pytest.mark.long)))
def test_c_source_of_every_effect_passes_its_own_test(name, inner, tmp_path):
    # Without forces that hold it, rounding decides the sign of a difference at rest.
    models = [m for m in c_models(BASES[name], inner) if name == "linear" or not m.recursion.updates[-1][1].has(SLIPS)]
    written = {f"m{i}": model.export("c", f"m{i}") for i, model in enumerate(models)}
    written = {prefix: source for prefix, source in written.items() if "int main" in source}  # else its test diverges
    sources = []
    for prefix, source in written.items():
        sources += [f"#define {prefix.upper()}_SELF_TEST", f"#define main main_{prefix}", source, "#undef main"]
    calls = " + ".join(f"main_{prefix}()" for prefix in written)
    assert built(tmp_path, sources, [f"return {calls};"]).count("passed") == len(written) > 5


# ---------------------------------------------------------------- several effects


def test_several_effects_by_hand():
    """Play before the input, a cubic spring inside, and a drift beside."""
    base, record = BASES["linear"], RECORDS["linear"]
    model = base
    for wanted, where in (("backlash", "input"), ("hardening_spring", None), ("drift", None)):
        model = extend(model, first(base, wanted, where)).model
    assert [str(s) for s in model.symbols[4:]] == [
        "c_backlash", "r_backlash", "c_hardening_spring", "c_drift",
    ]  # fmt: skip
    c, r, spring, drift = 0.6, 0.2, -0.05, 0.3
    model = model.replace(theta=[*base.theta, c, r, spring, drift])
    a1, a2, b1, b2 = base.theta
    w, p, inner = np.zeros(N), np.zeros(N), np.zeros(N)
    inner[:2] = -drift * record.t[:2]  # the first outputs are given: what the drift has in them is not the base's
    for i in range(1, N):
        p[i] = max(record.u[i] - r, min(record.u[i] + r, p[i - 1]))
        w[i] = record.u[i] + c * (p[i] - record.u[i])
        if i > 1:
            inner[i] = (
                a1 * inner[i - 1] + a2 * inner[i - 2] + b1 * w[i - 1] + b2 * w[i - 2] + spring * inner[i - 1] ** 3
            )
    assert np.abs(run(model, record) - inner - drift * record.t)[2:].max() < 1e-12
    assert [e.effect for e in model.effects] == ["backlash", "hardening_spring", "drift"]
    assert model.inner == x and {s.left.base for s in model.states} == {signal("p"), v, x}
    assert model.n_y == 2 and model.n_u == 2 and model.delay == 1


@pytest.mark.parametrize("name", ("linear", pytest.param("continuum", marks=more)))
@pytest.mark.parametrize(
    "chosen",
    some((
        (("rate_dependence", "input"), ("creep", "output"), ("hardening_spring", "inside")),
        (("dead_zone", "input"), ("channel:temp", "output"), ("hysteresis", "inside")),
        (("backlash", "output"), ("ageing", "input"), ("quadratic_drag", "inside")),
        (("quadratic_gain", "input"), ("offset", "output"), ("bilinear_gain", "inside")),
    ), 2),
)  # fmt: skip
def test_the_order_of_input_inside_and_output_does_not_matter(name, chosen):
    base, record = BASES[name], RECORDS[name]
    runs = []
    for order in permutations(chosen):
        model, values = base, dict(zip(base.symbols, base.theta, strict=True))
        for wanted, where in order:
            added = extend(model, first(model, wanted, where))
            values |= dict.fromkeys(added.coefficients, 0.002) | dict.fromkeys(added.shape, 0.3)
            model = added.model
        model = model.replace(theta=[values[s] for s in model.symbols])
        runs.append(run(model, record))
    assert all(np.abs(r - runs[0]).max() < 1e-11 for r in runs) and np.all(np.isfinite(runs[0]))


def test_what_waits_for_values_starts_as_measured():
    """An effect at the input, added after one that the input drives, has no value yet that a memory could start from."""
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], Ts=0.01)
    data = {"u": np.arange(5.0), "y": np.arange(5.0)}
    behind = [added for w in variants(base) if w.where == "output" and (added := extend(base, w).model).memory]
    assert len(behind) > 3
    for model in behind:
        late = extend(model, first(model, "dead_zone", "input")).model
        assert all(np.isfinite(value).all() for value in initial_values(late, data, 2).values()), model.effects


def test_a_tank_that_spills_over_remembers_its_level_by_itself():
    """Its level at the start is unknown and is fitted, as that of any other memory."""
    (form,) = (e for e in EFFECTS["end_stop"] if "spilling" in e.form)
    base, record = BASES["linear"], RECORDS["linear"]
    variant = next(w for w in variants(base) if w.effect is form)
    model = extend(base, variant).model
    assert [str(s.left) for s in model.memory] == ["w[k]"]
    problem = FreeRun(model.replace(theta=[*base.theta, 1.0, 0.5, 0.3, 0.05]), record, [])
    assert problem.starts[-1].states == (model.memory[0].left.base,)


def test_the_same_effect_twice_gets_numbers():
    base, record = BASES["linear"], RECORDS["linear"]
    variant = first(base, "backlash", "input")
    one = extend(base, variant)
    two = extend(one.model, variant)
    three = extend(two.model, first(two.model, "backlash", "output"))
    names = [str(s) for s in three.model.symbols[4:]]
    assert names == ["c_backlash", "r_backlash", "c_backlash2", "r_backlash2", "c_backlash3", "r_backlash3"]
    assert [str(s.left) for s in three.model.states] == ["p[k]", "passed[k]", "p_2[k]", "v[k]", "x[k]", "p_3[k]"]
    assert {s.group for s in three.model.memory} == {"backlash", "backlash2", "backlash3"}
    # The second one acts on what the first one lets through: two plays are one of both slacks.
    both = two.model.replace(theta=[*base.theta, 1.0, 0.3, 1.0, 0.2])
    alone = one.model.replace(theta=[*base.theta, 1.0, 0.5])
    assert np.abs(run(both, record) - run(alone, record)).max() < 1e-12


@pytest.mark.parametrize("order", some([*permutations(("backlash", "saturation", "dead_zone"))], 4))
def test_at_the_input_one_acts_behind_the_other(order):
    """An amplifier that saturates and a slack behind it, by hand; the law takes off one after the other."""
    base, record = BASES["linear"], RECORDS["linear"]
    sizes = {"backlash": 0.2, "saturation": 0.6, "dead_zone": 0.1}
    by_hand = {"saturation": lambda w: np.clip(w, -0.6, 0.6), "dead_zone": lambda w: w - np.clip(w, -0.1, 0.1)}

    def slack(w):
        return w[0] + truths.play(w - w[0], 0.2)

    model, passed, values = base, record.u, [*base.theta]
    for wanted in order[:2]:
        form = "hard" if wanted == "saturation" else ""
        variant = next(v for v in variants(model) if (v.id, v.effect.form, v.where) == (wanted, form, "input"))
        model, values = extend(model, variant).model, [*values, 1.0, sizes[wanted]]
        passed = by_hand.get(wanted, slack)(passed)
    model = model.replace(theta=values)
    core = base.simulate(passed, record.y[0])
    assert np.abs(run(model, record) - core)[2:].max() < 1e-12 and np.abs(passed - record.u).max() > 0.1
    law = model.compensator()
    assert law.residual() == 0 and law.closed_form
    reference = 0.3 * np.sin(np.arange(N) / 20.0)
    assert followed(model, law, reference, None, 150) < 1e-9


def test_without_takes_an_effect_off_again():
    base, record = BASES["continuum"], RECORDS["continuum"]
    one = extend(base, first(base, "creep"))
    two = extend(one.model, first(one.model, "backlash", "input"))
    three = extend(two.model, first(two.model, "quadratic_drag", "inside"))
    full = three.model
    full = full.replace(theta=[*base.theta, 0.1, 0.05, 0.3, 0.2, 0.01])
    left = without(full, [*one.coefficients, *three.coefficients])
    assert [str(s) for s in left.symbols[4:]] == ["c_backlash", "r_backlash"]
    assert [e.effect for e in left.effects] == ["backlash"]
    assert not any(str(s.left).startswith("w") for s in left.states)
    only = extend(base, first(base, "backlash", "input")).model.replace(theta=[*base.theta, 0.3, 0.2])
    assert left.theta.tolist() == only.theta.tolist()
    assert np.abs(run(left, record) - run(only, record)).max() < 1e-12
    none = without(left, two.coefficients)
    assert none.symbols == base.symbols and none.effects == ()
    assert np.abs(run(none, record) - run(base, record)).max() < 1e-12
    assert constraint_equations(none, None) == constraint_equations(base, None)


# ---------------------------------------------------------------- variants


def test_variants_fit_the_model():
    static, shifted = BASES["static"], BASES["continuum"]
    assert not any(one.where == "inside" and one.driver != "y" for one in variants(static))
    assert {one.effect.id for one in variants(shifted, ["temp"])} == set(EFFECTS)
    assert any(one.raw for one in variants(shifted)) and not any(one.raw for one in variants(BASES["linear"]))
    assert {one.lag for one in variants(static)} == {0} and {one.lag for one in variants(shifted)} == {0, 1}
    assert not any(one.channel for one in variants(shifted))
    assert {one.channel for one in variants(shifted, ["a", "b"]) if one.channel} == {"a", "b"}
    listed = [str(one) for one in variants(shifted, ["temp"])]
    assert len(set(listed)) == len(listed)


def test_raw_means_measured_from_zero():
    base, record = BASES["continuum"], RECORDS["continuum"]
    around, raw = (next(o for o in variants(base) if o.id == "asymmetric_gain" and o.raw == r) for r in (False, True))
    for variant, offset in ((around, 0.3), (raw, 0.0)):
        added = extend(base, variant)
        start = {"y": record.y[0], "v": 0.0}
        model = valued(added, base, 1.0)
        seen = compile(model.recursion)({"u": record.u}, model.theta, start)["v"]
        assert np.allclose(seen[REST:], (record.u - 0.3 + np.abs(record.u - offset))[REST:], rtol=0, atol=1e-12)


def test_unknown_effects_are_refused():
    assert find("backlash") == (EFFECTS["backlash"], None) and find("channel:load")[1] == "load"
    for wrong, said in (
        ("levitation", "Unknown effect"),
        ("channel", "Name the channel"),
        ("drift:temp", "does not use"),
    ):
        with pytest.raises(ModelError, match=said):
            find(wrong)


# ---------------------------------------------------------------- names


def test_channels_may_not_be_called_like_something_else():
    base = BASES["linear"]
    for name in ("u", "y", "t", "x", "v", "r", "m", "k", "phi1", "breve_phi2", "theta_1"):
        variant = next(one for one in variants(base, [name]) if one.channel)
        with pytest.raises(ModelError, match="rename the column"):
            extend(base, variant)
    play = extend(base, first(base, "backlash", "input")).model  # has a state p
    with pytest.raises(ModelError, match=r"'p'.*rename the column"):
        extend(play, next(one for one in variants(play, ["p"]) if one.channel))
    inner = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "x[k-1]"], channels=["x"])
    with pytest.raises(ModelError, match="rename the column"):
        extend(inner, first(inner, "drift"))


def test_a_state_gets_another_name_than_a_channel_and_a_parameter():
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "p[k-1]"], [0.5, 1.0, 0.3], channels=["p"], Ts=0.01)
    added = extend(base, first(base, "backlash", "input"))
    assert [str(s.left) for s in added.model.states] == ["p_2[k]", "v[k]"] and added.model.channels == ("p",)
    model = added.model.replace(theta=[0.5, 1.0, 0.3, 0.0, 0.2])
    record = RECORDS["linear"]
    temp = record.channels["temp"]
    expected = base.simulate(record.u, 0.0, {"p": temp})
    assert np.abs(model.simulate(record.u, 0.0, {"p": temp}) - expected).max() < 1e-12
    p = sp.Symbol("p", real=True)
    named = ns.Model(p * y[k - 1] + u[k - 1], [p], [0.5], Ts=0.01)
    assert str(extend(named, first(named, "backlash", "input")).model.states[0].left) == "p_2[k]"
    taken = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "c_drift[k]"], channels=["c_drift"])
    assert [str(c) for c in extend(taken, first(taken, "drift")).coefficients] == ["c_drift2"]


def test_what_holds_and_what_is_shown_by_hand(tmp_path):
    """Friction that holds the step, and a sensor that shows the size of all the rest; in either order."""
    base, record = BASES["linear"], RECORDS["linear"]
    chosen = {
        "coulomb_friction": ("motion", [1.0, 0.03]),
        "offset": ("output", [-0.3]),
        "absolute_sensor": ("sensor", [1.0]),
    }
    a1, a2, b1, b2 = base.theta
    inner = np.zeros(N)
    inner[:2] = 0.3  # the sensor shows 0: the offset is not the core's
    for i in range(2, N):
        step = a1 * inner[i - 1] + a2 * inner[i - 2] + b1 * record.u[i - 1] + b2 * record.u[i - 2] - inner[i - 1]
        inner[i] = inner[i - 1] + np.sign(step) * max(abs(step) - 0.03, 0.0)
    rests = np.mean(np.diff(inner) == 0.0)
    assert 0.2 < rests < 0.9
    for order in permutations(chosen):
        model, values = base, dict(zip(base.symbols, base.theta, strict=True))
        for name in order:
            where, numbers = chosen[name]
            added = extend(model, first(model, name, where))
            values |= dict(zip([*added.coefficients, *added.shape], numbers, strict=True))
            model = added.model
        model = model.replace(theta=[values[s] for s in model.symbols])
        assert np.abs(run(model, record) - np.abs(inner - 0.3))[2:].max() < 1e-12
        assert model.driven == signal("free") and model.inner == x and model.n_y == 2 and model.delay == 1
        ns.save(model, tmp_path / "m.json")
        assert ns.load(tmp_path / "m.json").recursion == model.recursion


def banded(u, gain, force, way, slack):
    """Return the force of a spring and of a band that slips: it is slack over a way, then taut over another."""
    at, out = u[0], np.empty(u.size)
    for i, here in enumerate(u):
        at = min(max(at, here - slack - way), here + slack + way)  # where the band is, at most that far behind
        stretched = np.sign(here - at) * max(abs(here - at) - slack, 0.0)
        out[i] = gain * here + force * stretched / way
    return out


def test_a_friction_that_a_slack_takes_effect(tmp_path):
    """A slack in what rubs: near the middle of its way the friction passes nothing on."""
    base = ns.NARX.from_terms(["u[k]"], [1.5], Ts=0.01)
    slack = next(v for v in EFFECTS["backlash"] if v.form == "of what rubs")
    assert all(v.effect != slack for v in variants(base))
    rubs = next(v for v in variants(base) if (v.id, v.effect.form) == ("coulomb_friction", "elastic"))
    with pytest.raises(ModelError, match="elastic friction"):
        extend(base, replace(rubs, effect=slack, where="friction", driver="friction"))
    model = extend(base, rubs).model
    model = extend(model, next(v for v in variants(model) if v.effect == slack)).model
    force, way, gap = 0.7, 0.2, 0.3
    values = dict(zip(base.symbols, base.theta, strict=True)) | {
        sp.Symbol("c_coulomb_friction", real=True): force * (way + gap) / way,
        sp.Symbol("r_coulomb_friction", real=True): way + gap,
        sp.Symbol("c_backlash", real=True): 1.0,
        sp.Symbol("w_backlash", real=True): gap / (way + gap),
    }
    model = model.replace(theta=[values[s] for s in model.symbols])
    source = RECORDS["linear"].u
    assert np.abs(model.simulate(source, 1.5 * source[0]) - banded(source, 1.5, force, way, gap)).max() < 1e-12
    ns.save(model, tmp_path / "m.json")
    assert ns.load(tmp_path / "m.json").recursion == model.recursion
    law, target = model.compensator(), np.sin(np.arange(200) / 15)
    assert law.closed_form and law.residual() == 0
    driven = law.run(target, 0.0)
    assert np.abs(banded(np.r_[0.0, driven], 1.5, force, way, gap)[1:] - target).max() < 1e-9


@pytest.mark.parametrize(
    "richer, plain",
    (
        (("dead_zone", "two slopes", "input", {"g": 1.0}), ("dead_zone", "", "input", {})),
        (("stiction", "", "motion", {"e": 1e-9}), ("coulomb_friction", "holding", "motion", {})),
        (("stiction", "of a valve", "input", {"e": 1e-9}), ("backlash", "", "input", {})),
        (("end_stop", "rigid upper", "motion", {"r": 9.0}), ("end_stop", "upper", "inside", {"r": 9.0})),
        (("output_limit", "both sides", "sensor", {"e": 9.0}), ("output_limit", "upper", "sensor", {})),
        (("coulomb_friction", "Dahl", "inside", {"r": 1e-9}), ("coulomb_friction", "", "inside", {})),
    ),
)
def test_a_form_contains_another(richer, plain):
    base, runs = BASES["linear"], []
    for name, form, where, numbers in (richer, plain):
        variant = next(v for v in variants(base) if (v.id, v.effect.form, v.where) == (name, form, where))
        added = extend(base, variant)
        c = 0.01 if where == "inside" and name == "coulomb_friction" else 1.0
        shapes = [numbers.get(p, 0.05) for p in variant.shape]
        model = added.model.replace(theta=[*base.theta, c, *shapes])
        runs.append(run(model, RECORDS["linear"]))
    assert np.abs(runs[0] - runs[1]).max() < 1e-6 and np.ptp(runs[0]) > 0.1


def test_the_input_may_have_any_name():
    base = ns.NARX.from_terms(
        ["y[k-1]", "y[k-2]", "force[k-1]", "force[k-2]"], BASES["linear"].theta, input="force", Ts=0.01
    )
    record = RECORDS["linear"]
    for wanted, where in (("backlash", "input"), ("coulomb_friction", "motion"), ("hysteresis", "output")):
        named, plain = (valued(extend(b, first(b, wanted, where)), b, 0.3) for b in (base, BASES["linear"]))
        assert np.array_equal(named.simulate(record.u, 0.0), plain.simulate(record.u, 0.0))
        target = plain.simulate(np.sin(np.arange(60) / 9), 0.0, u0=0.0)
        assert np.array_equal(*(model.compensator().run(target, 0.0) for model in (named, plain)))


def test_inverse_models_have_no_effects():
    inverse = ns.NARX.from_terms(["u[k-1]", "y[k]"], [0.5, 1.0], input="y", output="u", lead=2)
    with pytest.raises(ModelError, match="inverse"):
        extend(inverse, first(BASES["linear"], "drift"))
    left = without(inverse, inverse.symbols[:1])
    assert left.lead == 2 and left.input == y and left.output == u


def test_without_follows_what_is_read_to_the_end():
    a, b = signal("a"), signal("b")
    c, d = sp.symbols("c d", real=True)
    chain = [State(a[k], a[k - 1] / 2 + u[k]), State(b[k], b[k - 1] / 2 + a[k])]
    model = ns.Model(d * u[k - 1] + c * b[k], [c, d], [0.1, 0.2], states=chain)
    assert len(without(model, []).states) == 2
    assert without(model, [c]).states == ()  # a is read by b only, b by nothing
    two = ns.Model(d * u[k - 1] + c * a[k], [c, d], [0.1, 0.2], states=chain)
    assert [s.left for s in without(two, []).states] == [a[k]]
    variant = first(BASES["linear"], "periodic_disturbance")
    added = extend(BASES["linear"], variant)
    half = without(added.model, added.coefficients[:1])
    assert list(half.effects[0].coefficients.values()) == [added.coefficients[1]]


# ---------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize("where", ("input", "output"))
def test_a_diverging_run_shows_the_output(where):
    base = ns.NARX.from_terms(["y[k-1]", "y[k-1]**3", "u[k-1]"], [1.1, 0.3, 1.0], Ts=0.01)
    model = extend(base, first(base, "backlash", where)).model
    model = model.replace(theta=[*base.theta, 0.3, 0.1])
    with pytest.raises(Diverged) as caught:
        model.simulate(np.ones(200), 0.0)
    said, at = str(caught.value), caught.value.at
    assert said.startswith("The simulation of y diverges") and "Largest terms" in said
    assert ("dF/dy[k-1]" if where == "input" else "dF/dx[k-1]") in said
    path = caught.value.trajectory[:at]
    assert np.all(np.isfinite(path)) and np.abs(path[-1]) > 1e3
    assert np.array_equal(path, model.simulate(np.ones(at), 0.0))
    with pytest.raises(Diverged, match=f"The simulation of {'y' if where == 'input' else 'x'} diverges"):
        compile(model.recursion)({"u": np.ones(200)}, model.theta, {"y": 0.0, "p": 0.0, "x": 0.0, "v": 0.0})


def test_an_initial_value_must_be_finite():
    q = signal("q")
    c = sp.Symbol("c", real=True)
    model = ns.Model(y[k - 1] / 2 + c * q[k], [c], [1.0], states=[State(q[k], q[k - 1] / 2 + u[k], 1 / u[k])])
    assert initial_values(model, {"u": np.full(3, 2.0), "y": np.zeros(3)}, 2)["q"].tolist() == [
        2.25,
        3.125,
    ]  # from 0.5, driven
    with pytest.raises(ModelError, match=r"initial value of q\[k\], 1/u\[k\], is not finite at u\[k\] = 0"):
        model.simulate(np.zeros(5), 0.0)


# ---------------------------------------------------------------- equations, analysis, laws


def test_all_equations_are_shown():
    base = BASES["linear"]
    model = base
    for wanted, where in (("backlash", "input"), ("drift", None)):
        model = extend(model, first(model, wanted, where)).model
    model = model.replace(theta=[*base.theta, 0.6, 0.2, 0.3])
    shown = model.latex(numbers=True)
    assert [shown.count(f"{left}_{{k}} &=") for left in "pvxy"] == [1, 1, 1, 1] and shown.count("aligned") == 2
    assert shown.index("p_{k} &=") < shown.index("v_{k} &=") < shown.index("x_{k} &=") < shown.index("y_{k} &=")
    assert "0.2" in shown and "r_" not in shown and "r_{backlash}" in model.latex()
    assert [line.split(" = ")[0] for line in repr(model)[6:-1].split("; ")] == ["p[k]", "v[k]", "x[k]", "y[k]"]
    rows = {row["symbol"]: row["term"] for row in model.table()}
    assert rows["theta_1"] == "x[k-1]" and rows["theta_3"] == "v[k-1]" and rows["c_drift"] == "t[k]"
    shifted = extend(BASES["continuum"], first(BASES["continuum"], "drift")).model
    assert shifted.latex().count("around the operating point") == 1


def test_sigma_y_is_that_of_the_core():
    base = BASES["linear"]
    for wanted, where in (("drift", "output"), ("dead_zone", "input"), ("backlash", "input")):
        assert extend(base, first(base, wanted, where)).model.sigma_y == base.sigma_y
    with pytest.raises(ModelError, match="memory in the effect hysteresis"):
        extend(base, first(base, "hysteresis", "inside", "y")).model.sigma_y


def test_static_equations_of_an_extended_model():
    base = BASES["linear"]
    model = extend(base, first(base, "offset", "output")).model
    c = model.symbols[-1]
    assert sp.simplify(model.quasi_static().loading - base.quasi_static().loading - c) == 0
    loop = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]"], [0.5, 0.4, 0.1], Ts=0.01)
    seen = extend(loop, first(loop, "offset", "output")).model  # its differences are written out
    assert sp.simplify(seen.quasi_static().loading - loop.quasi_static().loading - seen.symbols[-1]) == 0
    bent = extend(loop, first(loop, "quadratic_gain")).model
    with pytest.raises(ModelError, match="time difference"):
        bent.quasi_static()


def followed(model, law, reference, channels=None, late=0):
    """How far the model leaves the reference when the law drives it."""
    m = law.run(reference, 0.0, channels)
    out = model.simulate(m, reference[: max(1, model.recursion.depth)], channels)
    return np.abs(out - reference)[late:].max()


def test_a_law_has_the_clock_of_a_drift():
    base, i = BASES["linear"], np.arange(N)
    law = valued(extend(base, first(base, "drift", "output")), base, 0.02).compensator()
    reference = np.where(i < REST, 0.0, np.sin((i - REST) / 20) - np.sin((i - REST) / 7) * 20 / 70)
    assert t in law.recursion.inputs
    ours, given = law.run(reference, 0.0), law.run(reference, 0.0, {"t": i * base.Ts})
    assert np.array_equal(ours[:-1], given[:-1])  # only the law's own clock goes on after the end
    assert np.array_equal(ours, law.run(np.append(reference, reference[-1]), 0.0)[:-1])


@pytest.mark.parametrize("name", ("linear", "continuum"))
def test_without_values_what_is_not_linear_has_no_law_and_says_which_effect(name):
    base = BASES[name]
    for wanted, where, driver, said in (
        ("dead_zone", "input", "u", r"u\[k-1\] cannot be isolated: the effect dead_zone uses it other than linearly"),
        ("channel_gain:temp", "input", "channel", "the effect channel_gain:temp uses it"),
        ("coulomb_friction", "output", "u", r"u\[k\] cannot be isolated: the effect coulomb_friction"),
        ("backlash", "input", "u", r"the effect backlash remembers it \(p\[k\]\)"),
        ("backlash", "output", "y", "the effect backlash remembers it"),
    ):
        with pytest.raises(NotInvertible, match=said):
            extend(base, first(base, wanted, where, driver)).model.compensator()


def test_an_effect_on_the_inner_output_needs_values():
    own = Catalogue()
    own.add(effect("output", driver="y", id="own", register=False)(lambda x: x[k] ** 2))
    base = BASES["linear"]
    model = extend(base, next(variants(base, catalogue=own))).model
    with pytest.raises(NotInvertible, match=r"the effect own acts on the inner output x\[k\]"):
        model.compensator()
    law = valued(extend(base, next(variants(base, catalogue=own))), base, 0.1).compensator()
    assert law.residual() == 0 and [s.how for s in law.staged.stages] == ["quadratic", "linear"]


def test_what_remembers_through_others_is_found():
    """In sub-steps h[k] depends on h[k-1] only through further states."""
    own = Catalogue()
    q, h = signal("q"), signal("h")

    @effect("input", id="own", register=False)
    def stepped(x):
        return Form((h[k],), (State(q[k], h[k - 1] / 2 + x[k]), State(h[k], q[k] / 2)))

    own.add(stepped)
    base = BASES["linear"]
    model = extend(base, next(variants(base, catalogue=own))).model
    assert [s.left for s in model.recurrent] == [q[k], h[k]] and {s.left for s in model.hidden} == {h[k]}
    law = model.compensator()  # linear: no values are needed
    assert law.residual() == 0
    assert [left for left, _ in law.updates] == [v[k], m[k], q[k], h[k]]


# ---------------------------------------------------------------- a model does not change


def test_a_model_does_not_change():
    base = BASES["linear"]
    for name in ("theta", "F", "Ts", "info", "anything"):
        with pytest.raises(AttributeError, match=rf"does not change: model.replace\({name}=...\) returns another"):
            setattr(base, name, None)
    with pytest.raises(AttributeError, match="does not change"):
        del base.F
    for array in (base.theta, base.compensator().theta, base.replace(theta=base.theta).theta):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0


def test_replace_keeps_everything_else():
    base = BASES["linear"].replace(standard_errors=[0.1] * 4, info=Info(line=(0.0, 1.0)))
    assert type(base) is ns.NARX and base.F == BASES["linear"].F and BASES["linear"].standard_errors is None
    other = base.replace(theta=[1, 2, 3, 4])
    assert other.theta.tolist() == [1, 2, 3, 4] and other.info == base.info and other.recursion is base.recursion
    assert other.standard_errors is None  # they were those of the other theta
    shorter = base.replace(terms=base.terms[:2], theta=[0.5, 0.2])
    assert type(shorter) is ns.NARX and shorter.symbols == base.symbols[:2] and shorter.Ts == base.Ts
    moved = base.replace(operating_point={y: 3.0})
    assert type(moved) is ns.NARX and moved.terms == base.terms and moved.right != base.right
    equation = base.replace(F=base.F + 1)
    assert type(equation) is ns.Model and equation.theta.tolist() == base.theta.tolist()
    with pytest.raises(ModelError, match="no field 'thetas'"):
        base.replace(thetas=[1.0])
    with pytest.raises(ModelError, match="has 4 parameters, but 2 values were given"):
        base.replace(theta=[1.0, 2.0])
    with pytest.raises(ModelError, match="has 4 parameters, but 2 values were given"):
        base.replace(F=base.F, theta=[1.0, 2.0])
    with pytest.raises(ModelError, match="not a finite number"):
        base.replace(theta=[1.0, 2.0, np.nan, 0.0])


def test_an_effect_may_act_at_a_further_input(tmp_path):
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u2[k-3]"], [0.8, 0.5, 0.4], channels=["u2"])
    base = base.replace(operating_point={"u": 0.3, "y": 1.0}, info=Info(roles={"u2": "input"}, units={"u2": "V"}))
    listed = [v for v in variants(base, ["u2"]) if v.at == "u2"]
    assert {v.where for v in listed} >= {"input", "output", "inside"} and "driven by u2" in str(listed[0])
    assert not any(v.id == "channel:u2" for v in variants(base, ["u2"]))
    chosen = [next(v for v in listed if v.id == n and v.where == "input") for n in ("dead_zone", "backlash")]
    model = base
    for variant in chosen:  # a slack behind a dead zone
        model = extend(model, variant).model
    values = {"c_dead_zone": 1.0, "r_dead_zone": 0.2, "c_backlash": 1.0, "r_backlash": 0.1}
    model = model.replace(theta=[*base.theta, *(values[str(s)] for s in model.symbols[3:])])
    ns.save(model, tmp_path / "m.json")
    u, u2 = np.random.default_rng(0).standard_normal((2, 80))
    v, slack, y = np.sign(u2) * np.maximum(np.abs(u2) - 0.2, 0), np.zeros(80), np.full(80, 0.5)
    slack[0] = v[0]
    for i in range(1, 80):
        slack[i] = min(max(slack[i - 1], v[i] - 0.1), v[i] + 0.1)
    for i in range(3, 80):
        y[i] = 1.0 + 0.8 * (y[i - 1] - 1.0) + 0.5 * (u[i - 1] - 0.3) + 0.4 * slack[i - 3]
    for made in (model, ns.load(tmp_path / "m.json")):
        assert np.allclose(made.simulate(u, 0.5, {"u2": u2}, warn=False)[60:], y[60:], atol=1e-4)
        assert made.effects[-1].driver == "u2" and "v_u2[k-3]" in made.lines()[-1]
