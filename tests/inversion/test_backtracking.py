"""Where an earlier choice leaves no input later, the run goes back; what cannot be mended so is said."""

import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import sympy as sp
from bench.attack import KEPT, Run, bases, drawn, with_effect
from sampling import more, some

import narx_sym as ns
from narx_sym.errors import Unreachable
from narx_sym.fit.laws.backtracking import open_stages
from narx_sym.inversion.solve import solve_for
from narx_sym.models.extend import variants
from narx_sym.models.info import Info
from narx_sym.symbolic.signals import k, m, r


# The models that the seeds below stand for are drawn from these effects.
def as_drawn(e):
    """Return an effect as it was when the seeds were drawn."""
    places = {place: drivers for place, drivers in e.places.items() if place != "force"}
    return replace(e, centred=e.centred and e.family != "disturbance", places=places)


DRAWN = ns.effects.Catalogue(
    {name: [as_drawn(e) for e in forms if not e.standing and e.form != "elastic"] for name, forms in KEPT.items()}
)


def attacked(seed):
    """Return the run of a random model."""
    rng = np.random.default_rng(seed)
    return Run(drawn(rng, 1 + seed % 2, DRAWN)[1], rng)


def missed(run, found):
    return np.abs(run.output(found.m) - run.y) > run.size


def follow(run, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return run.law.follow(run.y, run.u0, run.channels, share=None, **options)


# A drag that turns back, a loop that two inputs follow, a friction that two inputs overcome.
SEEDS = (7212, pytest.param(7552, marks=pytest.mark.long), pytest.param(7100, marks=pytest.mark.long))


@pytest.mark.parametrize("seed", SEEDS)
def test_follow_goes_back_to_where_two_inputs_were_right(seed):
    run = attacked(seed)
    ahead = follow(run, back=False)
    assert missed(run, ahead).any() and not ahead.tried
    found = follow(run)
    assert found.tried and not found.missed.any() and not missed(run, found).any()
    assert "revised earlier choices" in found.report[-1]


@pytest.mark.parametrize("seed", (31065, pytest.param(52423, marks=more)))
def test_what_turns_and_what_acts_in_a_row_need_no_other_choice(seed):
    """A gain that turns, whose sides then follow each other the other way round; a lag behind a stop that spills over."""
    run = attacked(seed)
    ahead = follow(run, back=False)
    assert not missed(run, ahead).any() and not ahead.tried


def drag():
    """Return a run in which the input had hardly moved where the other one of two was right."""
    listed = [
        v for v in variants(bases()["delayed"], []) if (v.id, v.where) == ("quadratic_drag", "output") and v.lag == 2
    ]
    model = with_effect(bases()["delayed"], listed[0], np.random.default_rng(0))
    run = Run(model.replace(theta=[0.7, 0.4, -0.28]), np.random.default_rng(0))
    run.u = run.u0 + np.concatenate(
        [np.zeros(45), [-0.05, -0.73, -0.21, -0.31, -0.33, 0.83, 0.65, -0.04, -0.87], np.zeros(46)]
    )
    run.y = run.output(run.u)
    return run


def test_a_choice_far_outside_is_found():
    run = drag()
    assert missed(run, follow(run, back=False)).any()
    found = follow(run)
    assert found.tried and not missed(run, found).any()


def with_jump(model, size, ranges=None):
    """Add the sign of the input to an output."""
    wanted = ("coulomb_friction", "output", "u", "of a speed")
    listed = [o for o in variants(model, []) if (o.id, o.where, o.driver, o.effect.form) == wanted]
    model = with_effect(model, listed[0], np.random.default_rng(0))
    return model.replace(theta=[*model.theta[:-1], size], info=Info(ranges=ranges or {}))


WAVE = 2 * np.sin(np.arange(120) / 10)  # from rest, through the jump and back


def test_a_jump_of_a_model_that_remembers_nothing():
    """No earlier choice helps, and no sample is like another one because nothing is remembered."""
    law = with_jump(ns.NARX.from_terms(["u[k]"], [1.5]), 0.8).compensator()
    with pytest.raises(Unreachable, match="no solution while") as error:
        law.run(WAVE, 0.0)
    assert error.value.at == 1
    with pytest.warns(UserWarning, match="misses the reference"):
        driven = law.run(WAVE, 0.0, clip=True)
    within = np.abs(WAVE) < 0.8
    assert np.abs(driven[within]).max() < 1e-9 and np.array_equal(law.follow(WAVE, 0.0).missed[1:], within[1:])


@pytest.mark.parametrize(
    "terms, theta", ((["u[k]", "u[k]**3"], []), pytest.param(["u[k]", "u[k]**3", "y[k-1]"], [0.3], marks=more))
)
def test_a_root_far_outside_what_was_identified_is_none(terms, theta):
    """A cubic term that is next to nothing has its own roots."""
    model = ns.NARX.from_terms(terms, [1.5, -1.5e-5, *theta])
    law = with_jump(model, 0.8, ranges={"u": (-8, 6), "y": (-12, 10)}).compensator()
    with pytest.raises(Unreachable) as error:
        law.run(WAVE, 0.0)
    assert error.value.at == 1
    with pytest.warns(UserWarning, match="misses the reference"):
        driven = law.run(WAVE, 0.0, clip=True)
    assert np.abs(driven).max() < 1.5 and np.abs(driven[1]) < 1e-9


def test_a_choice_on_which_nothing_depends_is_not_changed():
    """Two inputs give the same v: only v has a future."""
    base, rng = bases()["static"], np.random.default_rng(0)
    for name, where in (("stribeck_friction", "output"), ("quadratic_gain", "input")):
        listed = [v for v in variants(base, []) if (v.id, v.where, v.driver, v.effect.form) == (name, where, "u", "")]
        base = with_effect(base, listed[0], rng)
    law = base.compensator()
    assert len(law.staged.stages) == 2 and [str(s.unknown) for s in open_stages(law)] == ["v[k]"]


def test_what_no_choice_reaches_stays_missed():
    """A reference beyond the reach of a model, at which no earlier input helps."""
    base = bases()["static"]
    listed = [v for v in variants(base, []) if (v.id, v.where, v.effect.form) == ("saturation", "input", "hard")]
    model = with_effect(base, listed[0], np.random.default_rng(0))
    model = model.replace(theta=[1.5, 1.0, 0.25])
    target = 2.0 + np.sin(np.arange(60) / 8)
    found = model.compensator().follow(target, 0.4)
    assert found.missed.any() and not found.runs_away


def test_a_law_that_runs_away_says_so():
    """Its own error grows from sample to sample until nothing reaches the reference."""
    run = attacked(31010)
    found = follow(run)
    assert missed(run, found).any() and found.runs_away and "diverges" in found.report[-1]
    with pytest.raises(Unreachable, match="The law diverges: until then a disturbance of its input grows"):
        run.law.run(run.y, run.u0, run.channels, share=None)


def test_what_a_law_has_run_away_from_is_not_called_out_of_reach():
    """The model has made that output: what cannot be reached is what the law's own errors leave."""
    model = bases()["first order"]
    listed = [v for v in variants(model, []) if (v.id, v.where, v.lag) == ("coulomb_friction", "output", 0)]
    slow = next(v for v in listed if "averaged velocity" in str(v) and "n = 4" in str(v))
    run = Run(with_effect(model, slow, np.random.default_rng(1)), np.random.default_rng(1))
    assert run.law.check().proved and follow(run).runs_away
    with pytest.raises(Unreachable, match=r"^The law does not reach the reference"):
        run.law.run(run.y, run.u0, share=None)


def test_a_sign_beside_plays_is_no_sum_of_plays():
    """The slope of a sign is zero, but it is not constant."""
    w, last = m[k], m[k - 1]
    radii = {1: sp.Rational(1, 10), 2: sp.Rational(1, 5)}
    plays = sp.Add(*(sp.Max(w - a, sp.Min(w + a, r[k - n])) for n, a in radii.items()))
    together = {r: sp.S.Zero}
    plain = solve_for(w + plays, w, r[k], last, {sp.Symbol("a"): 1.0}, together=together)
    assert plain.how == "plays"
    beside = solve_for(w + plays + sp.sign(w - last), w, r[k], last, {sp.Symbol("a"): 1.0}, together=together)
    assert beside.how != "plays"


@pytest.mark.parametrize("seed", (7, pytest.param(9, marks=more)))
def test_a_sensor_that_folds_leaves_a_choice(seed):
    """Only the output reads the sensor, but the input that its side asks for has a future."""
    base = bases()["delayed continuum"]
    listed = [v for v in variants(base, []) if (v.id, v.where) == ("absolute_sensor", "sensor")]
    model = with_effect(base, listed[0], np.random.default_rng(0)).replace(theta=[1.0, 0.7, 0.1, 0.9])
    run = Run(model, np.random.default_rng(seed))
    assert missed(run, follow(run, back=False)).any()
    found = follow(run)
    assert found.tried and not missed(run, found).any()


@pytest.mark.parametrize("case", some(product((2, 3), range(8)), 5), ids=str)
def test_a_channel_that_is_known_changes_no_choice(case):
    """It is read ahead, up to the sample of the output: what it adds there is the same for every input."""
    late, seed = case
    terms = ["y[k-1]", f"u[k-{late}]", f"u[k-{late}]**2", f"u[k-{late + 1}]", "w[k]"]
    n, rng, runs = np.arange(60), np.random.default_rng(seed), []
    u, w = 0.8 * np.sin(0.5 * n + rng.uniform(0, 6)) * (n >= 8), rng.normal(size=60) * (n >= 8)
    for size in (0.0, 0.4):
        model = ns.NARX.from_terms(terms, [0.5, 0.3, 1.0, 0.4, size], channels=["w"])
        made = model.simulate(u, 0.0, {"w": w}, u0=0.0)
        runs.append(model.compensator().follow(made, 0.0, {"w": w}, share=None))
    assert runs[0].tried == runs[1].tried > 0 and np.abs(runs[0].m - runs[1].m)[:-late].max() < 1e-9
