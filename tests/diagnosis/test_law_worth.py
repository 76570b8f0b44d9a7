"""Of forms that explain alike the one with the better law is added."""

import pickle

import numpy as np
import pytest
from sampling import more, only

import narx_sym as ns
from narx_sym import plants
from narx_sym.diagnosis.steps import Step, law_worth
from narx_sym.models.effects import Catalogue

TS = 1e-3
KERNEL = ["y[k-1]", "phi1[k-1]", "phi2[k-1]*phi2[k-2]*phi1[k-2]"]  # it extrapolates the input by a sample
IMITATES = [
    *KERNEL, "phi2[k-1]*phi1[k-1]*y[k-1]", "phi1[k-1]*u[k-1]**2", "phi1[k-1]*u[k-2]**2", "phi2[k-1]*phi1[k-2]*u[k-1]",
    "phi1[k-2]*u[k-1]*y[k-1]", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip


def measured(seed, n=5000):
    volts = plants.filtered_noise(N=n, Ts=TS, seed=seed)
    return ns.Record.from_arrays(volts, plants.bouc_wen(volts, TS), Ts=TS)


def test_what_a_law_is_worth():
    record = measured(0, 2000)
    for terms, theta, worth in (
        (["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, 0.5], 2),
        (["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, -2.0], 0),  # unstable
        (KERNEL, [1.0, 3.2, -1.6], 1),  # two inputs for one output
        (["y[k-1]"], [0.5], 0),  # none
    ):
        known = ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(record).info
        assert law_worth(ns.NARX.from_terms(terms, theta, info=known)) == worth


@pytest.mark.parametrize("seed", (3, pytest.param(4, marks=more)))
def test_the_form_that_is_added_has_a_law_that_tracks(seed, monkeypatch):
    """An actuator with hysteresis, from a base that imitates a part of it: what explains alike may have no good law."""
    record, taken, replace = measured(seed), [], Step.replace
    forms = [e for e in ns.EFFECTS["hysteresis"] if e.form in ("Bouc-Wen", "Bouc-Wen actuator")]
    base = ns.NARX.from_terms(IMITATES).fit(record, ["continuum"], method="free_run")

    def seen(step, other):
        taken.append(step.chosen.model)
        replace(step, other)

    monkeypatch.setattr(Step, "replace", seen)
    found = ns.diagnose(base, record, catalogue=Catalogue({"hysteresis": forms}))
    sine = 40 * np.sin(2 * np.pi * TS * np.arange(2000))
    assert found.candidates[0].model is found.model and law_worth(found.model) == 2
    assert ns.mape(sine, plants.bouc_wen(found.model.compensator().run(sine, 0.0), TS)) < 0.03
    assert law_worth(taken[0]) < 2 and repr(taken[0]) != repr(found.model)  # what would have been added
    assert repr(pickle.loads(pickle.dumps(found.steps[0])).last.model) == repr(found.model)  # as a fleet does


def test_an_axis_that_integrates_offers_its_other_forms(monkeypatch):
    """The table fits it in pieces, what is shown in one run: each is judged on the samples that it was fitted on."""
    rng, Ts, n = np.random.default_rng(1), 0.01, 900
    u, y, speed = np.repeat(rng.uniform(-1, 1, n // 30), 30), np.zeros(n), 0.0
    for i in range(1, n):
        free = speed + Ts * 5 * (u[i - 1] - speed)
        speed = np.sign(free) * max(abs(free) - Ts * 5 * 0.15, 0.0)
        y[i] = y[i - 1] + Ts * speed
    record = ns.Record.from_arrays(u, y + 5e-4 * y.std() * rng.standard_normal(n), Ts)
    asked = []
    monkeypatch.setattr(Step, "falls", lambda step, fitted: asked.append(repr(fitted.model)))
    base = ns.identify(record, base="linear", n_y=2, n_u=1, delay=1)
    found = ns.diagnose(base, record, catalogue=only("coulomb_friction"))
    assert found.steps[0].refused is not None and not found.model.effects
    assert len(set(asked)) > 1
