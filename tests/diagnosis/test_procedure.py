"""What is hidden is named, nothing is named where nothing is hidden, and what is named can be added and used.

How often, and on measured records: `bench/battery.py` and `bench/one_number.py`.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import truths
from sampling import more, only
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.diagnosis.refit import Fitted, Split
from narx_sym.models.effects import EFFECTS, Catalogue
from narx_sym.report.comparison import Comparison
from narx_sym.tasks import revise

FIRST, N, WORST = 500, 3000, 1.5  # error after adding two effects, over the true noise
SHORT = 1500  # samples of the few diagnoses that are quick
# Where something else than the search is looked at, few effects are searched: deriving all of them takes longest.
FEW = only("backlash", "creep", "dead_zone", "drift", "quadratic_drag")


def based(c):
    """Return the record of a case and a linear base of its delay: the search for orders is short then."""
    record = ns.Record.from_arrays(c.u, c.y, c.Ts, channels=c.channels, name=c.name)
    # A held input acts one sample later.
    return record, ns.identify(record, base="linear", n_y=2, n_u=2, delay=c.info["delay"] + int(c.info["held"]))


def plain(diagnosis):
    """Return everything but the time."""
    return json.dumps({n: v for n, v in diagnosis.to_dict().items() if n != "seconds"})


# ---- one diagnosis in detail ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def play():
    """Return a record with backlash, its base, and its diagnosis."""
    record, base = based(truths.case("in", "backlash", FIRST, N=SHORT))
    return record, base, ns.diagnose(base, record, catalogue=FEW)


@pytest.mark.long
def test_reproducible(play):
    record, base, first = play
    theta = list(base.theta)
    assert plain(ns.diagnose(base, record, catalogue=FEW)) == plain(first)
    assert list(base.theta) == theta  # the caller's model stays as it is


def test_of_what_the_catalogue_does_not_know_the_nearest_is_told(play):
    record, base, _ = play
    found = ns.diagnose(base, record, catalogue=Catalogue({"drift": EFFECTS["drift"]}))
    step = found.steps[0]
    assert found.verdict == "outside_library" and step.nearest == ["drift"] and 0 < step.nearest_share < 0.2
    assert f"drift comes closest, and removes {100 * step.nearest_share:.0f} % of" in found.sentence()


@pytest.fixture(scope="module")
def nothing():
    """Return a record without a hidden effect, its base, and its diagnosis."""
    record, base = based(truths.case("null", "second_order", FIRST, N=SHORT))
    return record, base, ns.diagnose(base, record, seed=3)


def test_nothing_is_found_where_nothing_is(nothing):
    *_, d = nothing
    assert d.verdict == "nothing_detectable" and d.steps[0].smallest_detectable
    with pytest.raises(ns.ModelError, match="nothing_detectable"):
        _ = d.best


def test_steps_and_finding_are_told_as_data(nothing):
    """Of one step too where more are allowed; a floor below the noise of the sensor would be none."""
    record, base, d = nothing
    told = ns.diagnose(base, record, seed=3, catalogue=FEW, max_effects=2).to_dict()
    assert [s["finding"] for s in told["steps"]] == [told["finding"]] == ["nothing_detectable"]
    assert "steps" not in d.to_dict()
    assert told["units"] == {"u": "", "y": ""} and "units" not in told["steps"][0]
    nrmse = d.to_dict()["base"]["nrmse"]
    assert nrmse["noise_floor"] >= min(nrmse["sensor_noise"], nrmse["validation"]) - 1e-12


@more
def test_of_several_records_that_with_most_of_the_error_is_looked_at():
    rng = np.random.default_rng(5)
    records = []
    for name, n, c in (("still", 900, 0.0), ("rubbing", 600, 0.5)):
        u = np.sin(0.1 * np.arange(n))
        y = u + c * np.sign(np.diff(u, prepend=0.0)) + 0.01 * rng.standard_normal(n)
        records.append(ns.Record.from_arrays(u, y, 0.01, name=name))
    found = ns.diagnose(ns.identify(records, base="static", degree=1), records, catalogue=FEW)
    assert found.steps[0].base.worst == 1 and Comparison.of(found).name == "rubbing"


@pytest.mark.long
def test_nothing_is_reproducible_too(nothing):
    record, base, d = nothing
    assert plain(ns.diagnose(base, record, seed=3)) == plain(d)


def test_ladder_goes_down(play):
    *_, d = play
    assert d.verdict == "named"
    assert [rung["added"] for rung in d.ladder] == ["base", "backlash"]
    assert d.ladder[1]["validation"] < d.ladder[0]["validation"]
    assert d.ladder[1]["train"] < d.ladder[0]["train"]


def test_add_by_id_and_by_candidate(play):
    record, base, d = play
    free_run = base.info.nrmse.free_run
    by_candidate = base.add(d.best).fit(record)
    by_id = base.add("backlash", where="input").fit(record)
    for model in (by_candidate, by_id):
        assert model.effects[-1].effect == "backlash"
        assert model.info.nrmse.free_run < 0.9 * free_run
    assert base.effects == ()
    ratio = by_id.info.nrmse.free_run / by_candidate.info.nrmse.free_run
    assert ratio == pytest.approx(1.0, abs=0.05)


def test_add_refuses_what_is_unknown(play):
    _, base, _ = play
    with pytest.raises(ns.ModelError, match="Unknown effect"):
        base.add("magic")
    with pytest.raises(ns.ModelError, match="does not act at"):
        base.add("dead_zone", where="output")


def test_extended_model_survives_saving_and_compiling(play, tmp_path):
    record, _, d = play
    first = ns.free_run(d.model, record)
    assert np.sqrt(np.mean((record.y - first) ** 2)) < 0.1 * np.std(record.y)
    ns.save(d.model, tmp_path / "model.json")
    again = ns.load(tmp_path / "model.json")
    assert again.effects == d.model.effects
    np.testing.assert_allclose(ns.free_run(again, record), first, rtol=1e-9, atol=1e-12)
    for engine in ("python", "casadi"):
        np.testing.assert_allclose(ns.free_run(d.model, record, engine=engine), first, rtol=1e-7, atol=1e-9)
    assert again.export("c") == d.model.export("c")


# ---- two effects that hide each other -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pair():
    """Return the diagnosis of a record with a saturation and creep, and the true noise on its held-out samples."""
    c = truths.case("pair", "saturation+creep", FIRST, N=N)
    # The base is given: while two effects are missing, which orders fit best is a matter of rounding.
    record = ns.Record.from_arrays(c.u, c.y, c.Ts, name=c.name)
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], Ts=c.Ts)
    d = ns.diagnose(base.fit(record, method="free_run"), record, max_effects=2)
    return d, float(np.sqrt(np.mean((c.y - c.clean)[d.steps[0].base.split.held[0]] ** 2)))


@pytest.mark.bench
def test_a_pair_is_found_together(pair):
    d, noise = pair
    first = d.steps[0]
    assert set(first.pair.effects) == set(first.added) == {"saturation", "creep"}
    assert d.verdict == "helps_but_incomplete"  # no single effect is enough
    alone = min(c.nrmse["validation"] for c in first.candidates if "validation" in c.nrmse)
    assert first.pair.mean_square < 0.75 * alone**2
    assert np.sqrt(first.chosen.mean_square(first.base.split.held)) < WORST * noise
    assert {e.effect for e in d.model.effects} == {"saturation", "creep"}


@pytest.mark.bench
def test_a_pair_is_added_as_it_was_found(pair, monkeypatch):
    d, _ = pair
    monkeypatch.setattr(revise, "revised", lambda name, model, *rest, **known: (name, model))
    before = revise.Revision("base", d, d.base)
    name, model = revise.with_effect(before, d.steps[0].pair.effect, d.steps[0].trial.records, lambda told: None)
    assert name == f"+ {d.best.effect}" and model == d.steps[0].chosen.model


@pytest.mark.bench
def test_a_pair_is_told_in_words_and_data(pair):
    d, _ = pair
    first = d.steps[0]
    names = " and ".join(first.pair.effects)
    assert names in d.sentence() and "Together they remove" in d.sentence()
    rivals = [list(rival) for rival in first.pair.rivals]
    assert d.to_dict()["together"] == {
        "effects": list(first.pair.effects), "share": first.pair.share, "rivals": rivals,
        "probability": first.pair.probability,
    }  # fmt: skip
    assert 0 < first.pair.probability <= 1
    assert [r["added"] for r in d.ladder[:2]] == ["base", " + ".join(first.added)]
    assert d.ladder[1]["validation"] < d.ladder[0]["validation"]


# ---- what the data cannot tell --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def one_speed():
    """Return a slider moved to and fro at one speed: dry friction and drag give the same force."""
    rng = np.random.default_rng(FIRST)
    u = 5.0 * (2 * np.abs(np.arange(800) / 100 % 2 - 1) - 1)
    force = 2.0 * u + 3.0 * np.sign(np.diff(u, prepend=u[0]))
    return ns.Record.from_arrays(u, force + 0.1 * rng.standard_normal(800), Ts=0.01)


def test_one_speed_is_confused_and_gives_an_experiment(one_speed):
    record, u = one_speed, one_speed.u
    few = only("coulomb_friction", "quadratic_drag", "drift")
    d = ns.diagnose(ns.identify(record, base="static", degree=1), record, catalogue=few)
    assert d.verdict == "confused"
    assert {"coulomb_friction", "quadratic_drag"} <= set(d.confusion_set)
    e = d.experiment
    assert e is not None and set(e.separates) <= set(d.confusion_set)
    assert e.u.size == e.t.size and np.all(np.isfinite(e.u))
    assert e.u.min() >= u.min() - 1e-9 and e.u.max() <= u.max() + 1e-9
    assert e.sentence in d.sentence()


def test_an_effect_is_seen_at_the_promised_size_and_not_at_half_of_it():
    """In the rms by which it moves the output; more effects and machines: tests/bench/power.py."""
    rng = np.random.default_rng(3)
    u, y, bent = np.zeros(900), np.zeros(900), np.zeros(900)
    for k, w in enumerate(rng.standard_normal(899), 1):
        u[k] = 0.9 * u[k - 1] + 0.6 * w
        y[k], bent[k] = 0.8 * y[k - 1] + 0.2 * u[k - 1], 0.8 * bent[k - 1] + 0.2 * u[k - 1] ** 2
    y += 0.02 * rng.standard_normal(900)
    bent = (bent - bent.mean()) / np.std(bent)
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "1"])
    few = only("quadratic_gain", "cubic_gain", "backlash")

    def diagnosed(rms):
        record = ns.Record.from_arrays(u, y + rms * bent, 0.01)
        return ns.diagnose(base.fit(record, method="free_run"), record, catalogue=few)

    size = diagnosed(0.0).steps[0].smallest_detectable["quadratic_gain"]
    assert diagnosed(size).confusion_set == ["quadratic_gain"]
    less = diagnosed(size / 2)
    assert less.verdict == "nothing_detectable"
    # Too little to be named, and not called nothing: the one that it is comes nearest.
    assert less.steps[0].nearest[0] == "quadratic_gain" and "too small" in less.sentence()
    assert not diagnosed(0.0).steps[0].nearest


def test_nothing_is_promised_of_what_two_levels_hide():
    """A dead zone under two levels shows at no size."""
    rng = np.random.default_rng(5)
    steps = np.repeat(rng.choice([-1.0, 1.0], 90), 10)
    u = [steps, np.convolve(steps, np.ones(7) / 7, "same")]
    made = []
    for x in u:
        y = np.convolve(x, 0.2 * 0.8 ** np.arange(60))[:900] + 0.01 * rng.standard_normal(900)
        record = ns.Record.from_arrays(x, y, 0.01)
        base = ns.NARX.from_terms(["y[k-1]", "u[k]", "1"]).fit(record, method="free_run")
        few = only("dead_zone", "quadratic_spring")
        made.append(set(ns.diagnose(base, record, catalogue=few).steps[0].smallest_detectable))
    assert made == [{"quadratic_spring"}, {"dead_zone", "quadratic_spring"}]


@pytest.mark.parametrize("seed", [3, pytest.param(6, marks=more)])
def test_the_steps_of_a_converter_are_no_missing_effect(seed):
    """They follow from the signals, and no effect makes an error less than they are."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 12)
    y = lfilter([0.5], [1, -0.5], lfilter([0, 0.2], [1, -0.8], u))
    step = 0.03 * np.std(y)
    record = ns.Record.from_arrays(u, step * np.round(y / step), 0.1)
    assert ns.diagnose(ns.identify(record, base="linear"), record).verdict == "nothing_detectable"


@pytest.mark.more
def test_noise_on_an_input_of_two_levels_is_no_saturation():
    """It does not move the output, as what a saturation cuts off; where it does, it stays."""
    rng = np.random.default_rng(8)
    levels = np.repeat(rng.choice([-1.0, 1.0], 75), 12)
    noisy = levels + 0.02 * rng.standard_normal(levels.size)
    for moves, said in ((levels, 1), (noisy, 0)):
        y = lfilter([0, 0.2], [1, -0.8], moves) + 0.002 * rng.standard_normal(levels.size)
        record = ns.Record.from_arrays(noisy, y, 0.1)
        d = ns.diagnose(ns.identify(record, base="linear"), record)
        assert d.verdict == "nothing_detectable"
        assert sum("the output does not follow it" in note for note in d.data_notes) == said


@pytest.mark.parametrize("gap", [pytest.param(False, marks=more), pytest.param(True, marks=pytest.mark.long)])
def test_a_sensor_that_was_moved_is_no_play(gap):
    """Between records, or across a gap: a play that never moves is a constant for each of them."""
    rng = np.random.default_rng(11)
    parts = []
    for offset in (0.0, 0.3):
        u = np.repeat(rng.uniform(-1, 1, 60), 8)
        y = lfilter([0, 0.2], [1, -0.8], u) + 0.01 * rng.standard_normal(u.size) + offset
        parts.append((u, y))
    t = 0.1 * np.arange(parts[0][0].size)
    records = [ns.Record.from_arrays(*part, 0.1, name=f"{i}") for i, part in enumerate(parts)]
    if gap:
        u, y = (np.concatenate(x) for x in zip(*parts, strict=True))
        records = [ns.Record.from_arrays(u, y, t=np.concatenate([t, t + 500.0]))]
    d = ns.diagnose(ns.identify(records, base="linear"), records)
    assert d.verdict == "nothing_detectable" and any("Offsets" in note for note in d.data_notes)
    assert ns.evaluate(d.model, d.judged).free_run_nrmse == d.ladder[-1]["train"]


@pytest.mark.long
def test_a_single_sample_between_gaps_has_no_offset():
    """It is no segment; the offsets of the others stay in their places."""
    rng = np.random.default_rng(12)
    u = np.repeat(rng.uniform(-1, 1, 120), 8)
    y = lfilter([0, 0.2], [1, -0.8], u) + 0.01 * rng.standard_normal(u.size)
    y[481:] += 0.3
    record = replace(ns.Record.from_arrays(u, y, 0.1), breaks=(480, 481))
    d = ns.diagnose(ns.identify(record, base="linear"), record)
    assert d.verdict == "nothing_detectable"
    assert np.std(d.judged[0].y[481:] - y[481:]) < 1e-12 and np.mean(d.judged[0].y[481:] - y[481:]) < -0.25


def test_a_model_that_diverges_where_it_is_judged_is_infinitely_wrong():
    """Its error is compared with those of others, which goes on."""
    record = ns.Record.from_arrays(np.ones(40), np.linspace(1, 2, 40), Ts=1.0)
    for square, wrong in ((3.0, True), (0.1, False)):
        model = ns.NARX.from_terms(["y[k-1]**2", "u[k-1]"], theta=[square, 1.0])
        judged = Fitted(model, Split.whole([record]), None, None, True, {}, judged=True)
        assert np.isinf(judged.mean_square(judged.split.held)) == wrong
