"""At one speed an effect and the memory of a linear base are one signal: both are told, and a second speed decides."""

from dataclasses import replace

import numpy as np
import pytest
import truths
from places import SHARED, needs_shared
from sampling import only
from scipy.signal import lfilter, sawtooth

import narx_sym as ns
from narx_sym.models.effects import EFFECTS, Catalogue
from narx_sym.report.words import what_next

N, TS, NOISE = 1000, 0.01, 0.01
FEW = only("backlash", "dead_zone", "drift")


def triangle(cycles):
    return sawtooth(2 * np.pi * cycles * np.arange(N) / N + np.pi / 2, 0.5)


def slack(u):
    """Return a slack of 0.2 behind a short lag, (N,)."""
    return lfilter([0.2], [1, -0.8], truths.play(u, 0.2))


def lag(u):
    return lfilter([0.1], [1, -0.9], u)


def measured(machine, u, seed, rms=NOISE):
    noise = rms * np.random.default_rng(seed).standard_normal(len(u))
    return ns.Record.from_arrays(u, machine(u) + noise, Ts=TS, name=f"record {seed}")


def diagnosed(records, catalogue=FEW):
    return ns.diagnose(ns.identify(records, base="linear", n_y=1, n_u=2, delay=0), records, catalogue=catalogue)


@pytest.fixture(scope="module")
def one():
    """Return the record of a slack at one speed, and its diagnosis."""
    record = measured(slack, triangle(4), 0, 1.5 * NOISE)
    return record, diagnosed(record)


def test_a_slack_may_be_the_memory_of_the_base(one):
    _, found = one
    assert found.verdict == "confused" and found.confusion_set[-1] == "base" and len(found.confusion_set) > 1
    assert any("moves at one speed" in note and "A static base model" in note for note in found.data_notes)
    assert "cannot tell" not in found.sentence() and "cannot be distinguished" in found.sentence()
    assert found.to_dict()["confusion_set"] == found.confusion_set
    assert found.ladder[1]["validation"] < 0.2 * found.ladder[0]["validation"]  # of the base without memory
    assert found.experiment.clear and found.experiment.separates[-1] == "base"
    assert f"a linear base model alone leaves {found.steps[0].linear:.3g}" in found.sentence()
    assert found.steps[0].linear < 4 * NOISE


@pytest.mark.more
def test_where_the_noise_is_less_a_slack_in_front_of_a_lag_does_better():
    found = diagnosed(measured(slack, triangle(4), 0, NOISE / 2))
    assert (found.verdict, found.confusion_set) == ("named", ["backlash"])
    assert found.best.parameters["r"] == pytest.approx(0.2, rel=0.02) and found.best.where == "input"


@pytest.mark.more
def test_an_effect_of_ones_own_may_be_the_memory_too(one):
    own = [replace(e, id="my_play", family="mine") for e in EFFECTS["backlash"]]
    found = diagnosed(one[0], Catalogue({"my_play": own}))
    assert found.confusion_set == ["my_play", "base"]


@pytest.mark.more
def test_progress_goes_on_through_both_bases(one):
    told = []
    ns.diagnose(one[1].base, one[0], catalogue=FEW, report=told.append)
    parts = [now.fraction for now in told if hasattr(now, "fraction")]
    assert parts == sorted(parts) and parts[0] == 0 and parts[-1] > 0.8


@pytest.mark.more
def test_the_proposed_experiment_names_it(one):
    record, first = one
    found = diagnosed([record, measured(slack, first.experiment.u, 1)])
    assert (found.verdict, found.confusion_set) == ("named", ["backlash"])
    assert not any("one speed" in note for note in found.data_notes)


@pytest.mark.parametrize(
    ("machine", "rms"),
    [
        (lag, NOISE), (lambda u: 2 * u, 0.0), pytest.param(lag, 0.0, marks=pytest.mark.more),
        pytest.param(lambda u: 2 * u, NOISE, marks=pytest.mark.more),
    ],
    ids=["lag", "exact gain", "exact lag", "gain"],
)  # fmt: skip
def test_a_linear_machine_has_nothing_missing(machine, rms):
    found = diagnosed(measured(machine, triangle(4), 2, rms))
    assert found.verdict == "nothing_detectable"
    assert any("moves at one speed" in note and "leaves" not in note for note in found.data_notes)
    assert what_next(found).startswith("Record at a second speed or stroke")


def test_of_two_speeds_nothing_is_said():
    found = diagnosed([measured(lag, triangle(4), 3), measured(lag, triangle(12), 4)])
    assert found.verdict == "nothing_detectable" and not any("one speed" in note for note in found.data_notes)
    assert "a second speed" not in what_next(found)


@pytest.mark.bench
@needs_shared
def test_a_seal_is_friction_or_the_base():
    record = ns.read(SHARED / "pneumatic_seal_friction" / "Oring_3bar.csv")
    assert diagnosed(record, EFFECTS).confusion_set == ["coulomb_friction", "base"]
