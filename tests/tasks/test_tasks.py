"""One function for each thing that people ask for: what command line, page and report share."""

from dataclasses import replace

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.diagnosis import refit
from narx_sym.diagnosis.add import Addition
from narx_sym.diagnosis.steps import Step
from narx_sym.errors import DataError, FitError, ModelError
from narx_sym.tasks import base, revise
from narx_sym.tasks.add import add
from narx_sym.tasks.compare import compare, tracking, where_it_fails
from narx_sym.tasks.compensate import ahead, follow, law_of

N, TS = 600, 0.01
RNG = np.random.default_rng(4)
U = np.repeat(RNG.uniform(-2, 2, N // 12), 12) + 0.05 * RNG.standard_normal(N)


def simulated(gain=0.0):
    """A first-order lag with a cubic gain at its input."""
    y = np.zeros(N)
    for k in range(1, N):
        y[k] = 0.8 * y[k - 1] + 0.4 * (U[k - 1] + gain * U[k - 1] ** 3)
    return ns.Record.from_arrays(U, y, Ts=TS, name="lag")


LINEAR = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=TS)
INVERSE = ns.NARX.from_terms(["u[k-1]", "y[k]"], [0.5, 1.0], input="y", output="u", Ts=TS)


def test_a_base_from_a_file_is_fitted_and_goes_from_u_to_y(tmp_path):
    LINEAR.save(tmp_path / "good.json")
    assert base.read_base(tmp_path / "good.json").theta.tolist() == [0.8, 0.4]
    INVERSE.save(tmp_path / "inverse.json")
    with pytest.raises(ModelError, match=r"mine: this is an inverse model"):
        base.read_base(tmp_path / "inverse.json", "mine")
    (tmp_path / "bad.json").write_text("{}")
    with pytest.raises(ModelError, match=r"^mine") as error:
        base.read_base(tmp_path / "bad.json", "mine")
    assert str(tmp_path) not in str(error.value)
    with pytest.raises(ModelError, match="linear"):
        base.check_kind("cubic")


def test_another_sampling_time_is_refused():
    for same in (TS, None):
        base.check_pace(LINEAR, same, "The data have")
    with pytest.raises(
        DataError, match=r"^The data have Ts = 0.02 s, .* resample to 0.01 s, or fit a model to data at"
    ):
        base.check_pace(LINEAR, 0.02, "The data have")
    base.check_pace(ns.NARX.from_terms(["u[k]"], [2.0], Ts=TS), 0.02, "The data have")  # this one knows no rate


def test_what_to_know_about_a_record():
    y = np.round(simulated().y, 0)
    two = ns.Record.from_arrays(np.sign(U), y, Ts=TS)
    assert any("two values" in said for said in base.what_to_know([two]))
    one, other = replace(two, name="one", notes=("cut",)), replace(two, u=two.u * 2, name="other", notes=("cut",))
    said = base.what_to_know([one, other])  # levels are those of all together
    assert said["cut"] == ["one", "other"] and not any("two values" in text for text in said)


CUBIC = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.8, 0.4, 0.04], Ts=TS)


def test_the_last_fit_never_ends_above_where_it_began(monkeypatch):
    record = simulated(0.1)
    trial = refit.Trial.of([record], [record])
    begin = trial.as_given(CUBIC.replace(theta=[0.8, 0.4, 0.02]))
    good = trial.final(begin)
    assert trial.errors(good)["train"].free_run_nrmse < 1e-6
    assert trial.errors(good)["train"] == ns.evaluate(good.model, record)

    def fails(*_):
        raise FitError("no way")

    def worse(problem, begin, *_):
        return begin * 1.5, np.zeros(3), True

    for way in (fails, worse):
        monkeypatch.setattr(refit, "_minimum", way)
        assert trial.final(begin).model.theta.tolist() == [0.8, 0.4, 0.02]


def test_noise_of_the_first_samples_moves_no_error():
    """Three slow poles make much of it: from estimated starts the free run follows."""
    from scipy.signal import lfilter

    a, u = np.poly([0.99, 0.98, 0.97]), np.repeat(np.random.default_rng(2).uniform(-1, 1, 100), 20)
    clean = lfilter([0, 1e-5], a, u + 0.4 * u**3)
    noise = 0.01 * np.std(clean) * np.random.default_rng(3).standard_normal(u.size)
    record = ns.Record.from_arrays(u, clean + noise, TS)
    terms = ["y[k-1]", "y[k-2]", "y[k-3]", "u[k-1]", "u[k-1]**3"]
    model = ns.NARX.from_terms(terms, [*-a[1:], 1e-5, 4e-6], Ts=TS)
    assert ns.evaluate(model, record).free_run_nrmse == pytest.approx(0.01, rel=0.05)
    assert ns.metrics.nrmse(record.y, model.simulate(u, record.y[:3])) > 0.02  # from the measured ones


def step_of(before, after, validation):
    """A step that has found the second model beside the first one."""
    trial = refit.Trial.of([simulated(0.1)], validation)
    base = trial.as_given(before)
    made = Step(
        base, "named", [], [], 0.0, "estimate", 0.0, {}, [], chosen=trial.as_given(after), pair=Both(), trial=trial
    )
    made.finish(trial, base)
    return made


class Both:
    """Stands for two effects of the second model."""

    fitted, effects = None, ()


def test_what_helps_on_the_record_and_not_on_validation_data_is_not_added():
    other = simulated(0.0)  # a machine without the effect
    refused = step_of(LINEAR, CUBIC, [other])
    assert refused.chosen is None and refused.finding == "refused" and refused.verdict == "helps_but_incomplete"
    said = refused.sentence({"y": "um"})
    assert "the error on the record falls from" in said and "it rises from" in said and "nothing is added" in said
    added = step_of(LINEAR, CUBIC, [simulated(0.1)[300:]])
    assert added.chosen is not None and not added.refusal({})


def test_compare_says_the_errors_and_where_it_fails():
    found = compare(LINEAR, [simulated(0.1)])
    ((name, errors),) = found.errors
    assert name == "lag" and errors.free_run_nrmse > 0.05 and found.misfit is not None
    assert found.misfit.table()[0]["panel"] in ("u", "y") and not found.notes
    none, why_not = where_it_fails(INVERSE, [simulated()])
    assert none is None and "inverse" in why_not


def test_tracking_is_against_the_reference():
    y = simulated().y
    log = ns.Record.from_arrays(U, y, Ts=TS, channels={"r": y + 0.1}, name="log")
    found = tracking(log, "r")
    assert found.mape == pytest.approx(ns.mape(y + 0.1, y)) and found.nsavi == pytest.approx(ns.nsavi(U, y + 0.1))
    with pytest.raises(DataError, match="no channel 'q'"):
        tracking(log, "q")
    with pytest.raises(DataError, match="reference is in mm, the output in um"):
        tracking(replace(log, units={"y": "um", "r": "mm"}), "r")


def test_add_compares_before_and_after():
    made = add(Addition(LINEAR, "cubic_gain", "input"), [simulated(0.1)])
    names, errors = zip(*made.errors, strict=True)
    assert names == ("before", "before, fitted to these data", "with cubic_gain")
    before, refitted, after = (e.free_run_nrmse for e in errors)
    assert after < 0.2 * refitted and refitted <= before


def test_a_law_as_text_and_a_run_of_it():
    law = law_of(LINEAR)
    assert not law.why_not and law.lines[0].startswith("Stable: ") and "m[k] = " in law.lines[1]
    assert {".c", ".st"} <= set(law.sources)
    assert law.notes[:1] == law.lines[:1]
    assert law.notes[1] == ahead(LINEAR.compensator()) == "It looks 1 sample ahead in the reference."
    assert "no input" in law_of(ns.NARX.from_terms(["y[k-1]"], [0.5])).why_not
    r = np.sin(np.arange(200) / 20)
    run = follow(LINEAR.compensator(), r)
    assert run.start == pytest.approx(LINEAR.compensator().rest_input(r[0])) and run.effort == ns.nsavi(run.m, r)
    assert follow(LINEAR.compensator(), np.ones(50)).effort is None
    driven = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "w[k-1]"], [0.8, 0.4, 0.1], channels=["w"])
    with pytest.raises(ModelError, match="channel 'w'"):
        follow(driven.compensator(), r)


def test_a_revision_knows_what_was_done(monkeypatch):
    """The diagnosis itself has tests of its own: here a step with one candidate stands for it."""
    asked = []
    monkeypatch.setattr(revise, "revised", lambda *given, **more: asked.append((given, more)) or "made")
    assert revise.begin(LINEAR, [simulated()], print) == "made"
    assert asked[-1][0][0] == "model file"
    other = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=2 * TS)
    with pytest.raises(DataError, match=r"the model was identified at 0.02 s"):
        revise.begin(other, [simulated()], print)
    said = []
    revise.begin("static", [simulated(0.1)], said.append)
    assert asked[-1][0][0] == "static base" and said == ["Step 1 of 6: identifying a static base from 600 samples"]
