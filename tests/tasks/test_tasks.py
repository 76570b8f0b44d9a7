"""One function for each thing that people ask for: what command line, page and report share."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.diagnosis.add import Addition
from narx_sym.diagnosis.refit import Fitted, Split, settle
from narx_sym.errors import DataError, FitError, ModelError
from narx_sym.fit.freerun import FreeRun
from narx_sym.fit.least_squares import free_run_error
from narx_sym.tasks import base, finish, revise
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


def test_a_fit_on_all_that_fails_keeps_the_parameters(monkeypatch):
    record = simulated()
    good = finish.fit_on_all(LINEAR, [record])
    assert not good.note and good.model is not LINEAR and free_run_error(good.model) < 1e-6

    def fails(*_, **__):
        raise FitError("no way")

    monkeypatch.setattr(finish, "settle", fails)
    kept = finish.fit_on_all(LINEAR, [record])
    assert "no way" in kept.note and kept.model.theta.tolist() == [0.8, 0.4]
    assert free_run_error(kept.model) < 1e-6


def rung(model, record):
    """A model as a diagnosis has fitted it on its training blocks, without moving its parameters."""
    split = Split.of([record])
    problem = FreeRun(model, list(split.records), (), split.train)
    return Fitted(model, split, problem, problem.start(model.theta), True, {})


class Found:
    """A diagnosis that added a cubic gain to a lag, as `finish` sees it."""

    def __init__(self, record, second):
        base = settle(LINEAR, Split.of([record]))
        self.rungs, self.judged = ["base", "+ cubic"], []
        self.steps = [SimpleNamespace(base=base, chosen=rung(second, record), nrmse=self.nrmse)]

    def nrmse(self, fitted):
        """Say a small error, whatever the model does."""
        return {"train": 0.01, "validation": 0.01}


CUBIC = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.8, 0.4, 0.04], Ts=TS)


def test_what_is_saved_is_what_was_shown(monkeypatch):
    record = simulated(0.1)
    made, errors = finish.finish(Found(record, CUBIC), [record])
    assert not made.note and len(made.model.terms) == 3
    assert dict(errors)["base + cubic, fitted on all samples"].free_run_nrmse < 1e-6
    # The fit on all samples ends where it should not: what the training blocks gave is kept.
    worse = rung(CUBIC.replace(theta=[0.8, 0.4, 0.07]), record)
    monkeypatch.setattr(finish, "settle", lambda *_, **__: worse)
    made, _ = finish.finish(Found(record, CUBIC), [record])
    assert "instead of 0.01" in made.note and made.model.theta.tolist() == CUBIC.theta.tolist()


def test_a_model_worse_than_its_base_is_not_saved(monkeypatch):
    record = simulated(0.1)
    wrong = CUBIC.replace(theta=[0.8, 0.4, 0.4])
    monkeypatch.setattr(finish, "settle", lambda model, *_, **__: rung(model, record))
    made, errors = finish.finish(Found(record, wrong), [record])
    assert "no better than that of the base" in made.note and len(made.model.terms) == 2
    # Its fit on all samples is worse than what was shown: it is not taken, and has no row.
    assert [name for name, _ in errors][-1] == "base, fitted on the training blocks"


def test_noise_of_the_first_samples_does_not_keep_a_model_back():
    """Three slow poles make much of it: from the start that its fit found the free run follows."""
    from scipy.signal import lfilter

    a, u = np.poly([0.99, 0.98, 0.97]), np.repeat(np.random.default_rng(2).uniform(-1, 1, 100), 20)
    clean = lfilter([0, 1e-5], a, u + 0.4 * u**3)
    record = ns.Record.from_arrays(
        u, clean + 0.01 * np.std(clean) * np.random.default_rng(3).standard_normal(u.size), TS
    )
    terms = ["y[k-1]", "y[k-2]", "y[k-3]", "u[k-1]"]
    straight = ns.NARX.from_terms(terms, [*-a[1:], 1.2e-5], Ts=TS)
    bent = ns.NARX.from_terms([*terms, "u[k-1]**3"], [*-a[1:], 1e-5, 4e-6], Ts=TS)
    found = Found(record, bent)
    base, chosen = (settle(m, Split.of([record])) for m in (straight, bent))
    found.steps = [SimpleNamespace(base=base, chosen=chosen, nrmse=lambda fitted: {"train": 0.011})]
    made, errors = finish.finish(found, [record])
    assert len(made.model.terms) == 5 and made.nrmse < 0.013
    measured = errors[-1][1].free_run_nrmse
    assert measured > 1.2 * made.nrmse and f"from them it leaves {measured:.3g}" in made.note


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
    assert not law.why_not and "m[k] = " in law.lines[0] and {".c", ".st"} <= set(law.sources)
    assert law.notes[0] == ahead(LINEAR.compensator()) == "It looks 1 sample ahead in the reference."
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
    assert asked[-1][0][0] == "static base" and said == ["Step 1 of 7: identifying a static base from 600 samples"]
