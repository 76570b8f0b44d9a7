"""How far a diagnosis is: stages that are never gone back to, as a text and as numbers."""

import pickle

import live
import pytest
from sampling import only

import narx_sym as ns
from narx_sym.diagnosis.procedure import diagnose
from narx_sym.diagnosis.progress import BASE, ROUND, Course, Told, inside

MODEL = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "1"])
FEW = only("dead_zone", "cubic_gain", "saturation")


def diagnosed(**options):
    u, y = live.hidden(400)
    return diagnose(MODEL, ns.Record.from_arrays(u, y, Ts=live.TS), catalogue=FEW, **options)


def test_what_is_told_is_a_text_that_keeps_its_numbers():
    told = Told("trying each effect alone", 3, 6, 12, 40, (("backlash", 0.82), ("creep", 0.4)), 0.3)
    assert (
        told
        == "Step 3 of 6: trying each effect alone, 12 of 40 (so far: backlash removes 82 % of the squared error, creep 40 %)"
    )
    again = pickle.loads(pickle.dumps(told))
    assert again == told and vars(again) == vars(told) and again.fraction == pytest.approx(2.3 / 6)
    told.look = lambda: None
    assert pickle.loads(pickle.dumps(told)).look is None


def test_work_inside_other_work_counts_with_it():
    heard = []
    tell = inside(heard.append, before=1, after=2)
    tell(Told("b", 1, 2, 3, 4, (("x", 0.5),), 0.5))
    tell("a plain text")
    assert heard[0] == "Step 2 of 5: b, 3 of 4 (so far: x removes 50 % of the squared error)" and heard[
        0
    ].fraction == pytest.approx(1.5 / 5)
    assert heard[1] == "a plain text"


def test_a_stage_may_be_passed_over_and_a_second_turn_does_not_go_back():
    heard = []
    course = Course(heard.append, ["a", "b", "c"])
    course.reach("a")
    course.reach("c")
    course.say(done=3, of=4)
    course.say(done=0, of=2)
    course.say(done=1, of=2, turn=1, turns=2)
    assert [h.stage for h in heard] == [1, 3, 3, 3, 3] and [h.part for h in heard] == [0, 0, 0.75, 0.75, 0.75]


def test_rounds_beyond_the_plan_are_told_as_the_last_stage():
    """Where a second effect takes the place of the first, a further round runs: how many is not known beforehand."""
    heard = []
    course = Course(heard.append, [BASE, *ROUND])
    for stage in (BASE, *ROUND, *ROUND, "a stage that nobody planned", BASE):
        course.reach(stage)
        course.say(done=1, of=2)
    fractions = [h.fraction for h in heard]
    assert fractions == sorted(fractions) and fractions[-1] <= 1 and {h.stages for h in heard} == {1 + len(ROUND)}
    assert heard[-3].what == "a stage that nobody planned" and heard[-3].stage == 1 + len(ROUND)
    assert [h.stage for h in heard[: 2 * len(ROUND) + 2 : 2]] == list(range(1, 2 + len(ROUND)))


def test_what_cannot_be_told_does_not_end_the_work(fences):
    heard = []
    course = Course(heard.append, ["a"])
    course.reach("a")
    course.say(found=lambda: (("x", 1 / 0),))
    course.say(done=1, of=2, turns=0)
    assert len(heard) == 1 and len(fences) == 2
    fences.clear()
    course.say(found=lambda: (("x", 1.0),))
    course.say()
    assert [h.removed for h in heard] == [(), *[(("x", 1.0),)] * 2]


class Cancelled(Exception):
    pass


def test_what_a_listener_raises_goes_through():
    def cancel(now):
        if now.stage == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        diagnosed(report=cancel)


def test_a_diagnosis_says_the_same_whatever_becomes_of_its_progress(monkeypatch):
    told = diagnosed()
    for broken in ("reach", "say"):
        monkeypatch.setattr(Course, broken, lambda *_, **__: None)
        mute = diagnosed()
        assert told.to_dict() | {"seconds": 0} == mute.to_dict() | {"seconds": 0}
        monkeypatch.undo()


@pytest.mark.parametrize("rounds", [1, 2])
def test_a_diagnosis_tells_its_stages_and_what_it_has_found(rounds):
    heard = []
    found = diagnosed(max_effects=rounds, report=heard.append)
    fractions = [h.fraction for h in heard]
    assert fractions == sorted(fractions) and 0 <= fractions[0] and fractions[-1] <= 1
    assert {h.stages for h in heard} == {1 + len(ROUND) * rounds} and all(h.done <= h.of for h in heard)
    assert heard[0].what == BASE and heard[0].stage == 1 and len({h.stage for h in heard}) >= 4
    assert found.best.effect == "dead_zone" and "dead zone removes" in heard[-1].found
    assert not any(h.found for h in heard if h.stage < 3)


def test_a_search_may_be_ended_with_what_was_found():
    """It is asked for from the first moment on; every effect by itself has a brief look, and the first one is enough."""
    heard, looks = [], []

    def listen(now):
        heard.append(now)
        looks.extend([now.look()] if now.look else [])
        return True

    found = diagnosed(report=listen)
    assert found.best.effect == "dead_zone" and any("ended before every effect" in said for said in found.data_notes)
    whole = []
    diagnosed(report=whole.append)
    assert len(heard) < len(whole) and heard[-1].found.count("%") == 1 < whole[-1].found.count("%")
    (base,) = looks
    assert not base.candidates and base.steps[0].base.model.core == found.steps[0].base.model.core
