"""Directions where little moves: a core that has lost its input, and a disturbance at the input's own frequencies."""

import numpy as np
import pytest
from sampling import only

import narx_sym as ns
from narx_sym.diagnosis.refit import Split, prune, settle
from narx_sym.diagnosis.screening.directions import CYCLES, Linearised
from narx_sym.diagnosis.screening.scored import linearised
from narx_sym.fit.freerun import FreeRun
from narx_sym.models.effects import EFFECTS
from narx_sym.models.extend import Variant, extend

N, Ts = 800, 0.01
t = Ts * np.arange(N)
noise = 0.05 * np.random.default_rng(0).standard_normal(N)
FRICTION = Variant(next(e for e in EFFECTS["coulomb_friction"] if not e.form), "output", "u")


def line_of(fitted):
    return Linearised(FreeRun(fitted.model, list(fitted.split.records), []), fitted.unknowns)


@pytest.fixture(scope="module")
def rubbing():
    """Return a static base with friction, where nothing but friction is in the data: its line is superfluous."""
    u = 2 * np.sin(2.5 * t)
    record = ns.Record.from_arrays(u, 1 + 3 * np.sign(np.diff(u, prepend=-1e-3)) + noise, Ts)
    base = settle(ns.NARX.from_terms(["u[k]", "1"], Ts=Ts).fit(record), Split.of([record]))
    model = extend(base.model, FRICTION).model
    return base, settle(model, base.split, np.array([*base.model.theta, 3.0]))


def test_a_core_that_lost_its_input_is_not_moved_from_there(rubbing):
    base, fitted = rubbing
    smaller = prune(fitted, base)
    assert len(smaller.model.symbols) == 2  # the constant and the friction
    few = only("drift", "quadratic_gain")
    directions, matrix = line_of(smaller).directions([], few)
    assert {d.variant.id for d in directions} == {"drift"} and matrix.shape[1] == 3  # a line; a line and its bend


def test_the_last_term_with_the_input_stays(rubbing):
    base, _ = rubbing
    slow = extend(base.model, Variant(EFFECTS["drift"][0], "output", "t"))
    record = ns.Record.from_arrays(base.split.records[0].u, 1 + t + noise, Ts)
    fitted = settle(slow.model, Split.of([record]), np.array([0.0, 1.0, 1.0]))
    before = settle(base.model, fitted.split)
    assert ns.u in prune(fitted, before).model.recursion.inputs


def test_an_effect_that_does_not_apply_is_named(rubbing):
    base, _ = rubbing
    with pytest.raises(ns.NarxError, match="The effect uneven_speed does not apply to this model"):
        base.model.add("uneven_speed").fit(base.split.records[0])


def disturbed(frequency, n=4000, bent=0.0, turns=1.0):
    """Return the frequencies [Hz] at which a periodic disturbance is tried; the input is a triangle of 1 Hz."""
    time = Ts * np.arange(n)
    u = 2 * np.abs(2 * (turns * time % 1.0) - 1) - 1
    y = (
        u
        + bent * u**3
        + 0.3 * np.sin(2 * np.pi * frequency * time)
        + 0.02 * np.random.default_rng(1).standard_normal(n)
    )
    fitted = settle(
        ns.NARX.from_terms(["u[k]", "1"], Ts=Ts).fit(ns.Record.from_arrays(u, y, Ts)),
        Split.of([ns.Record.from_arrays(u, y, Ts)]),
    )
    few = only("periodic_disturbance", "drift")
    directions, _ = line_of(fitted).directions([], few)
    return [d.shape[0] for d in directions if d.variant.id == "periodic_disturbance"]


def test_a_disturbance_is_none_at_the_frequencies_of_the_input():
    assert min(abs(f - 3.37) for f in disturbed(3.37)) < 0.01
    assert all(abs(f - round(f)) > 0.01 for f in disturbed(3.0))


def test_hum_at_a_high_multiple_of_the_input_is_a_disturbance():
    """What bends shows in low multiples first: mains hum stands above them all, and in none of them."""
    assert min(abs(f - 14.0) for f in disturbed(14.0)) < 0.01
    assert all(abs(f - round(f)) > 0.01 for f in disturbed(0.0, bent=0.5))
    nyquist = 0.5 / Ts  # between the last multiple below it and the next one, which no spectrum shows
    assert min(abs(f - 0.99 * nyquist) for f in disturbed(0.99 * nyquist, turns=nyquist / 9.6)) < 0.05


def test_a_few_cycles_are_no_disturbance():
    duration = 4000 * Ts
    assert all(f * duration >= CYCLES for f in disturbed(3.5 / duration))


def test_an_outlet_is_sought_below_the_lowest_level():
    """However high the level goes above the operating point: the outlet is where the tank was not emptied."""
    (sqrt,) = EFFECTS["sqrt_outflow"]
    u = np.where(t % 2 < 1.8, -0.5, 4.0)
    record = ns.Record.from_arrays(u, 0.9 * u + noise, Ts)
    fitted = settle(ns.NARX.from_terms(["y[k-1]", "u[k]", "1"], Ts=Ts).fit(record), Split.of([record]))
    line, variant = line_of(fitted), Variant(sqrt, "inside", "y")
    assert 0.45 < min(a for (a,) in line.grid(variant)) < 0.55 < 0.2 * record.y.max()


def test_directions_are_those_along_the_fitted_run_from_where_it_begins():
    """Beside the input a spring acts before the first sample too: known or not when the fit began, it begins so."""
    u = np.sin(3 * t) + np.sin(0.7 * t)
    core = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-3]", "u[k-4]", "1"], theta=[1.5, -0.6, 0.06, 0.04, 0.0], Ts=Ts)
    spring = Variant(EFFECTS["hardening_spring"][0], "force", "y")
    model = extend(core, spring).model
    plant = model.replace(theta=[*core.theta, -0.3])
    record = ns.Record.from_arrays(u, plant.simulate(u, y0=0.0, warn=False) + noise, Ts)
    fitted = settle(model, Split.of([record]), plant.theta)
    line = linearised(fitted)
    np.testing.assert_allclose(line.residual, fitted.errors[0][fitted.problem.depth :], rtol=1e-9, atol=1e-12)
