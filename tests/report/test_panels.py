"""Every part of the report has a row here: what it tells of the stage with play, and how many pictures it draws."""

import json
import pickle
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.data.examples import STAGE_UNITS
from narx_sym.diagnosis.procedure import Diagnosis
from narx_sym.diagnosis.steps import NO_FLOOR, Step
from narx_sym.diagnosis.table.candidates import Pair
from narx_sym.report import hero, page, words
from narx_sym.report.panels import registry, verdict
from narx_sym.report.panels.registry import Material, panels
from narx_sym.report.picture import Picture
from narx_sym.symbolic.numbers import few, sized

# Key of the part: a text that only it tells, and the number of its pictures on the stage's diagnosis.
CASES = {
    "verdict": ("falls from", 2),
    "try_it": ("Move a parameter", 0),
    "compare": ("The free run uses only the measured input", 4),
    "ladder": ("The noise floor is an estimate", 0),
    "where": ("of the missing input", 12),
    "candidates": ("of the removable error", 1),
    "model": ("Parameters before and after", 0),
    "derived": ("The law with numbers", None),  # sets of the base where those of the model are not derived
    "experiment": ("next.csv", 2),
    "provenance": ("SHA-256", 0),
}


@pytest.fixture(scope="module")
def material(stage_diagnosis):
    return Material(stage_diagnosis, STAGE_UNITS)


def test_every_part_has_a_case():
    assert set(CASES) == set(panels())


@pytest.mark.parametrize("key", panels())
def test_what_it_tells(key, material, stage_parts):
    text, count = CASES[key]
    assert text in stage_parts[key] and (key == "verdict" or panels()[key].title in stage_parts[key])
    drawn = material.pictures(key)
    assert count is None or len(drawn) == count
    assert len({p.key for p in drawn}) == len(drawn) and all(p.alt for p in drawn)


def test_the_values_are_those_of_the_last_model(stage_diagnosis):
    (made,) = page.sections(stage_diagnosis, STAGE_UNITS, keys=["verdict"])
    (effect,) = stage_diagnosis.model.effects
    errors = {row["symbol"]: row["standard_error"] for row in stage_diagnosis.model.table()}
    for symbol in effect.shape.values():
        value, half = float(stage_diagnosis.model.values[symbol]), 1.96 * errors[str(symbol)]
        said, low, high = re.search(rf"{effect.effect} ([\d.]+) rad.*?95.%: ([\d.]+) to ([\d.]+)\)", made.html).groups()
        assert float(said) == pytest.approx(value, rel=5e-3)
        assert (float(low), float(high)) == pytest.approx((value - half, value + half), abs=0.1 * half)


def test_keys_of_pictures_are_unique_on_the_page(material):
    keys = [p.key for key in panels() for p in material.pictures(key)]
    assert len(keys) == len(set(keys)) > 10


def only(monkeypatch, *keys):
    """Leave some parts registered."""
    monkeypatch.setattr(registry, "_PANELS", {key: part for key, part in panels().items() if key in keys})


def test_one_more_part_is_on_the_page(stage_diagnosis, monkeypatch):
    """One function is all that a new part takes; without a template of its own it shows its pictures."""
    only(monkeypatch, "candidates", "ladder")

    def draws(material):
        error = material.diagnosis.misfit.residual
        return [Picture("histogram", "Histogram", "How the error is spread.", lambda ax: ax.hist(error), {"e": error})]

    @registry.panel("How the error is spread", order=45, draws=draws)
    def spread(material):
        return {}

    made = page.sections(stage_diagnosis, STAGE_UNITS)
    assert [s.key for s in made] == ["ladder", "spread", "candidates"]
    assert made[1].title == "How the error is spread" and "How the error is spread." in made[1].html


def test_the_app_shows_what_is_still_missing_beside_what_was_added(stage_diagnosis):
    """The switches go the whole way; words, candidates and maps are of the last model."""
    from narx_sym.app.story import Story
    from narx_sym.tasks.revise import Revision

    base = Revision("linear base", stage_diagnosis, stage_diagnosis.base)
    nothing = replace(stage_diagnosis.steps[0], verdict="nothing_detectable", candidates=[], confusion_set=[])
    left = replace(stage_diagnosis, steps=[replace(nothing, base=nothing.chosen, chosen=None, experiment=None)])
    last = Revision("+ backlash", left, stage_diagnosis.model, "backlash")
    of = page.material(Story.of([base, last]), STAGE_UNITS, later=left)
    told = of.once(hero.told)
    assert [one["name"] for one in told["models"]] == ["base", "+ backlash"]
    assert told["chosen"] == 1 and told["add"] is None
    far = hero.told(page.material(Story.of([base, *[last] * 6]), STAGE_UNITS, later=left))
    assert (
        len(far["models"]) == 3
        and far["chosen"] == 2
        and far["models"][2]["name"].endswith("+ backlash" + " + backlash" * 5)
    )
    text = page.page(of, framed=True)
    assert "Backlash added. No further effect can be detected" in text and "No effect of the catalogue" in text
    assert "80 % of such records." in text and words.fall(of.diagnosis, STAGE_UNITS, whole=False) in text
    assert all(f'<section id="{key}"' in text for key in panels() if key != "experiment")


def test_a_diagnosis_goes_to_another_process(stage_diagnosis):
    """The live page diagnoses in a process of its own."""
    came = pickle.loads(pickle.dumps(stage_diagnosis))
    assert came.to_dict() == stage_diagnosis.to_dict()
    assert came.best.model.equation == stage_diagnosis.best.model.equation


def test_what_helps_but_has_rivals_says_so_and_keeps_its_experiment(stage_diagnosis):
    first = replace(stage_diagnosis.steps[0], verdict="helps_but_incomplete")
    both, (one, other) = replace(stage_diagnosis, steps=[first]), first.confusion_set
    assert f"It could also be {other}." in first.sentence({}) and first.experiment.sentence in first.sentence({})
    assert words.headline(both).lower().startswith(f"{words.spaced(one)} or {words.spaced(other)} helps, but")
    (made,) = page.sections(both, STAGE_UNITS, keys=["verdict"])
    assert 'href="#experiment"' in made.html


def test_the_fall_is_told_in_the_numbers_of_evaluate(stage_diagnosis):
    said, before, after = words.fall(stage_diagnosis, STAGE_UNITS), *stage_diagnosis.ladder
    for part in ("validation_rms", "train_rms"):
        assert f"falls from {few(1e3 * before[part])} to {few(1e3 * after[part])} µm" in said
    assert said.startswith("The error on the last part of the record (from row ")


def test_what_validation_data_do_not_confirm_is_the_verdict(stage_diagnosis):
    first = stage_diagnosis.steps[0]
    step = replace(first, chosen=None, refused=first.chosen, verdict="helps_but_incomplete")
    found = replace(stage_diagnosis, steps=[step])
    assert step.finding == "refused" and found.model is first.base.model and len(found.ladder) == 1
    assert words.fall(found, STAGE_UNITS).endswith(", so nothing is added.")
    assert words.headline(found).startswith("With backlash the error falls on the record and")
    assert step.to_dict(None)["refused"] and not first.to_dict(None)["refused"]


def test_what_explains_as_much_as_a_pair_is_told_with_it(stage_diagnosis):
    first = stage_diagnosis.steps[0]

    def told(*rivals):
        pair = Pair(("backlash", "creep"), first.chosen, 0.9, rivals, probability=0.61)
        step = replace(first, pair=pair, verdict="helps_but_incomplete")
        found = replace(stage_diagnosis, steps=[step])
        sure = "may be" if rivals else "are probably"
        assert words.headline(found) == f"Two effects {sure} missing: backlash and creep."
        assert bool(words.doubt(found)) == bool(rivals)
        return step.sentence({}), words.badge(found), pair.sure

    sentence, badge, sure = told()
    assert "It could also be" not in sentence and badge == "61 %: best explanation"
    assert sure == ("backlash", "creep")
    sentence, badge, sure = told(("backlash", "drift"), ("backlash",))
    assert sentence.endswith(" It could also be backlash with drift, or backlash; backlash is in all of them.")
    assert badge == "61 %: the most probable; also possible: backlash with drift, or backlash" and sure == ("backlash",)
    sentence, _, sure = told(*((name, "drift") for name in "abcd"))
    assert sentence.endswith("a with drift, or b with drift, or c with drift, or one of 1 more.") and not sure


def test_a_single_sine_is_in_the_headline(stage_diagnosis):
    record = stage_diagnosis.steps[0].base.split.records[0]
    sine = replace(record, u=np.sin(2 * np.pi * 1.3 * record.t))
    base = stage_diagnosis.steps[0].base
    first = replace(stage_diagnosis.steps[0], verdict="named", confusion_set=["backlash"])
    assert words.headline(replace(stage_diagnosis, steps=[first])) == "Backlash is probably missing."
    alone = replace(first, base=replace(base, split=replace(base.split, records=[sine])))
    said = words.headline(replace(stage_diagnosis, steps=[alone]))
    assert said == "Backlash is probably missing; a single sine cannot distinguish similar effects."


def test_two_effects_that_leave_more_than_noise_are_not_all(stage_diagnosis):
    first = stage_diagnosis.steps[0]
    pair = Pair(("backlash", "creep"), first.chosen, 0.9, all=False)
    step = replace(first, pair=pair, verdict="helps_but_incomplete")
    assert step.sentence({}).endswith(" in cross-validation, but something else is missing too.")
    found = replace(stage_diagnosis, steps=[step])
    assert words.headline(found) == "Two effects are probably missing: backlash and creep."
    assert words.badge(found) == "best explanation; something else is missing too"
    assert words.doubt(found) == "something is still missing from its model"


def test_an_effect_without_a_size_of_its_own_is_told_by_what_it_moves(stage_diagnosis):
    d, (_, after) = stage_diagnosis, verdict.Comparison.of(stage_diagnosis).runs.values()
    before = verdict.Comparison.of(d).runs["base"]
    assert f"{sized(float(np.sqrt(np.mean((before - after) ** 2))), 'um')} rms" in verdict.moved(d, d.last, "um")


def test_a_law_is_tried_along_the_record_before_it_may_run(stage_diagnosis, monkeypatch):
    named = replace(stage_diagnosis.steps[0], verdict="named", confusion_set=["backlash"])
    of = page.material(replace(stage_diagnosis, steps=[named]), STAGE_UNITS)
    colour, answer, _ = verdict.lamp(of)
    assert (colour, answer) == ("good", "Yes,")
    tried = verdict.track

    def worse(law, reference, limits):
        run = tried(law, reference, limits)
        return replace(run, plain=run, y=run.y + np.ptp(run.y))

    monkeypatch.setattr(verdict, "track", worse)
    assert verdict.lamp(of)[:2] == ("warn", "Not yet:") and "worse than a constant gain" in verdict.lamp(of)[2]


def test_a_size_whose_interval_includes_zero_is_not_fixed_by_the_data():
    assert (
        verdict.interval("share 0.02, 95 % -0.4 ... 0.5")
        == "share 0.02: not fixed by the data (95\u00a0%: -0.4 to 0.5)"
    )
    assert verdict.interval("gain -17.3 N, 95 % -19.4 ... -15.3") == "gain -17.3 N (95\u00a0%: -19.4 to -15.3)"


def test_no_noise_is_more_than_what_is_left(stage_diagnosis):
    """An estimate from differences is too large where a record is slow: then nothing is said of the sensor."""
    first = replace(stage_diagnosis.steps[0], floor=0.02)
    said = {sensor: replace(first, sensor=sensor) for sensor in (0.01, 0.02, 0.03)}
    assert "sensor noise alone 0.01" in said[0.01].sentence({})
    assert "all of it sensor noise" in said[0.02].sentence({})
    assert "the sensor" not in said[0.03].sentence({})
    spread = first.base.problem.spread
    assert said[0.03].to_dict(None)["base"]["nrmse"]["sensor_noise"] == pytest.approx(0.02 / spread)


def test_repeated_periods_are_no_floor_where_a_model_leaves_less(stage_diagnosis):
    """What a machine does by itself does not repeat with its input, and is no noise."""
    first = stage_diagnosis.steps[0]
    left = float(np.sqrt(first.last.mean_square(first.base.split.held)))
    for floor, kept in ((0.5 * left, True), (1.04 * left, True), (3 * left, False)):
        step = replace(first, floor=floor, floor_kind="repeated periods")
        step.hear(0.1 * left)
        assert (step.floor, step.floor_kind) == ((floor, "repeated periods") if kept else (left, "estimate"))


def test_a_pair_is_not_what_data_cannot_tell_apart(stage_diagnosis):
    first = stage_diagnosis.steps[0]
    pair = Pair(tuple(first.confusion_set), first.chosen, 0.9)
    both = replace(stage_diagnosis, steps=[replace(first, pair=pair)])
    (made,) = page.sections(both, STAGE_UNITS, keys=["candidates"])
    assert "These two effects together help most" in made.html and "tell" not in made.html.partition("<article")[0]


def test_a_floor_that_is_not_estimated_is_neither_a_figure_nor_a_line(stage_diagnosis):
    first = replace(stage_diagnosis.steps[0], floor_kind=NO_FLOOR)
    looped, keys = replace(stage_diagnosis, steps=[first]), ["verdict", "compare", "ladder", "where"]
    told = "".join(s.html for s in page.sections(looped, STAGE_UNITS, keys=keys))
    assert "The noise floor is not estimated in closed loop." in told
    assert "Noise floor" not in told and "noise floor (± rms)" not in told and "noise floor, " not in told


@pytest.mark.parametrize("value, said", [(443.2, "440"), (-0.1149, "-0.11"), (3.74e-8, "3.7e-08"), (12345.0, "12000")])
def test_few_digits_need_no_exponent(value, said):
    assert few(value, 2) == said


@pytest.mark.parametrize(
    "value, unit, said",
    [
        (0.0024, "m", "2.4 mm"), (0.05, "mm/s", "50 µm/s"), (0.05, "um", "50 nm"), (2e-3, "cm", "20 µm"),
        (0.02, "kN", "20 N"), (3e-3, "Nm", "3 mNm"), (2e-12, "V", "2e-12 V"), (0.1, "m", "0.1 m"), (3820, "N", "3820 N"),
        (0.01, "%", "0.01 %"), (0.01, "m²", "0.01 m²"), (0.01, "min", "0.01 min"), (0.01, "°C", "0.01 °C"), (0.01, "", "0.01"),
        (0.0, "m", "0 m"), (float("nan"), "m", "nan m"),
    ],
)  # fmt: skip
def test_a_small_size_takes_a_prefix_where_its_unit_has_one(value, unit, said):
    assert sized(value, unit) == said


def test_sizes_that_are_compared_share_a_prefix_where_they_are_not_far():
    assert sized(5e-6, "m", beside=4e-3) == "0.005 mm" and sized(2e-9, "m", beside=4e-3) == "2 nm"
    assert sized(0.01, "mm", beside=0.2) == "0.01 mm"


LEFT = "The remaining error is larger", "more error than noise", "a disturbance of the machine"
SMALL = "A small part of the error is unexplained", "a small unexplained error", "A longer record"
NONE = "The base model does not follow the output", "the base model does not follow", "another base"


@pytest.mark.parametrize(
    "nothing, trace, unexplained, title, badge, advice",
    [
        (False, "", "", "No missing effect can be detected", "nothing found", "Keep the model"),
        (False, "Something is left", "", *SMALL),
        (False, "Something is left", "more", *LEFT),
        (False, "", "more", *LEFT),
        (True, "", "more", *NONE),
    ],
)
def test_nothing_found_is_four_things(nothing, trace, unexplained, title, badge, advice):
    step = SimpleNamespace(
        verdict="nothing_detectable", confusion_set=[], unexplained=unexplained, base=None, chosen=None,
        valves=[], trace=trace, follows_nothing=nothing, one_step=False, refused=None,
    )  # fmt: skip
    step.finding = Step.finding.fget(step)
    found = SimpleNamespace(steps=[step], rungs=["base"], faults=[], one_speed=False, aside=("load",))
    assert words.headline(found).startswith(title) and advice in words.what_next(found)
    assert ("not used: load" in words.what_next(found)) == (badge != "nothing found")
    assert words.BADGES[step.finding] == badge


@pytest.mark.parametrize(
    "given, unseen, word", [(True, False, "taken"), (False, False, "probably"), (False, True, "perhaps")]
)
def test_the_badge_of_a_loop_is_no_surer_than_its_headline(given, unseen, word):
    loop, badge = SimpleNamespace(given=given, unseen=unseen), f"{word} in closed loop"
    step = SimpleNamespace(verdict="closed_loop", confusion_set=[], valves=[], loop=loop, pair=None, refused=None)
    step.finding = Step.finding.fget(step)
    said = words.headline(SimpleNamespace(steps=[step]))
    assert words.BADGES[step.finding] == badge and badge.split()[0].removesuffix("en") in said.lower()


def test_a_damped_law_starts_from_the_states_that_its_script_has():
    """The script is damped and has the model beside it."""
    law = ns.NARX.from_terms(
        ["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.65, 0.23, 0.2415], Ts=1e-3
    ).compensator()
    assert law.share() < 1
    seen = SimpleNamespace(y=np.linspace(-1, 3, 50), u=np.linspace(0, 4, 50), worst=slice(0, 20))
    told = hero.reference(law, [SimpleNamespace(fitted=SimpleNamespace(model=law.model))], seen)
    states = re.search(r"states = (\[.*?\])", law.export("js", "law"))[1]
    assert len(told["start"]) == len(json.loads(states)) == len(law.exported().states) > len(law.recursion.states)


@pytest.mark.parametrize(
    "every, added, exhausted", [(True, ["a", "b"], True), (False, ["a", "b"], False), (True, ["a"], False)]
)
def test_two_effects_that_are_all_need_no_third(every, added, exhausted):
    step = SimpleNamespace(pair=SimpleNamespace(all=every), added=added, chosen=object(), refused=None)
    assert Diagnosis.exhausted.fget(SimpleNamespace(steps=[step])) == exhausted


def test_a_channel_is_called_as_the_user_calls_it():
    assert words.spaced("channel_friction:Oil_temp") == "channel friction:Oil_temp"
    assert words.begun(words.spaced("channel:Oil_temp")) == "Channel:Oil_temp"


def test_a_part_that_fails_takes_no_other_with_it(stage_diagnosis, monkeypatch, fences):
    only(monkeypatch, "verdict", "ladder")
    monkeypatch.setitem(registry._PANELS, "ladder", replace(panels()["ladder"], tell=lambda material: 1 / 0))
    made = {s.key: s.html for s in page.sections(stage_diagnosis, STAGE_UNITS)}
    assert "could not be made" in made["ladder"] and CASES["verdict"][0] in made["verdict"]
    assert fences == ["The part ladder of the report failed; the computation continues"]
    fences.clear()
