"""The derivatives that a run carries along: by lanes of machine code, and as further states of the recursion."""

import numpy as np
import pytest
import sympy as sp
from sampling import some

import narx_sym as ns
from narx_sym.engines.machine.lanes import Lanes
from narx_sym.engines.slopes import LONGEST, Extended, Tangents, with_slopes
from narx_sym.fit.bases.play import Shape
from narx_sym.fit.freerun import starts
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.sensitivity import Tangent
from narx_sym.symbolic.signals import k, u, y

BASE = ns.NARX([y[k - 1], y[k - 2], u[k - 1], u[k - 2], sp.S.One], theta=[1.2, -0.4, 0.15, 0.05, 0.01])
RNG = np.random.default_rng(3)
CASES = list({v.effect: v for v in variants(BASE)}.values())


def both(recursion, parameters, groups, output):
    """Return the same derivatives by machine code and by the text engines' recursion."""
    lanes = with_slopes(recursion, groups, output)
    assert isinstance(lanes, Tangents)
    return lanes, Extended(recursion, parameters, groups, output)


@pytest.mark.parametrize("variant", some(CASES, 6), ids=str)
def test_lanes_equal_the_extended_recursion(variant):
    model = extend(BASE, variant).model
    they_agree(model, np.concatenate([BASE.theta, RNG.uniform(0.01, 0.05, len(model.symbols) - 5)]))


@pytest.mark.parametrize("variant", some(CASES, 6), ids=str)
def test_they_are_those_of_finite_differences_where_the_input_rests(variant):
    """A play whose input rests stands where both arguments of its Max are equal."""
    model = extend(BASE, variant).model
    theta = np.concatenate([BASE.theta, RNG.uniform(0.01, 0.05, len(model.symbols) - 5)])
    recursion, groups = model.recursion, tuple(s.states for s in starts(model))
    held = np.repeat(np.random.default_rng(7).normal(size=40), 8)
    inputs = {str(b.label): held for b in recursion.inputs}
    begin = [([str(state.label) for state in s.states], s.shape(recursion.depth)) for s in starts(model)]
    initial = {str(b.label): 0.013 * np.ones(max(1, recursion.depth)) for b in recursion.states}
    walk = with_slopes(recursion, groups, y).over(inputs, initial, begin)

    def run(point):
        walk.run(point)
        return walk.states["y"].copy()

    run(theta)
    slopes = walk.slopes.copy()
    for i in range(theta.size):
        h = 1e-6 * abs(theta[i])
        up, down = theta.copy(), theta.copy()
        up[i], down[i] = theta[i] + h, theta[i] - h
        there = (run(up) - run(down)) / (2 * h)
        off = np.abs(slopes[:, i] - there) / (np.abs(there).max() + 1e-3)
        assert np.median(off) < 1e-5, model.symbols[i]  # a kink on the way shows in few samples


def test_a_play_of_the_input_has_a_number_for_its_own_start():
    """No parameter moves it: whole vectors of zeros were most of the work of a model with ten plays."""
    theta = [0.6, 1.0, *np.linspace(0.2, 0.6, 5), 0.1, -0.2, 0.1, 0.9]
    model = Shape((0.1, 0.2, 0.4, 0.6, 0.8), (0.2,), 1, creep=True).model({}, theta)
    recursion, groups = model.recursion, tuple(s.states for s in starts(model))
    tangent, states = Tangent.of(recursion, model.symbols), list(recursion.states)
    lanes = Lanes.of(recursion, tangent, groups, states.index(y))
    plays = {states.index(s.left.base): s.left.base for s in model.memory if str(s.left.base.label).startswith("z")}
    assert len(plays) == 5 and states.index(y) not in lanes.few
    for i, base in plays.items():
        assert lanes.few[i] == (len(model.symbols) + next(g for g, group in enumerate(groups) if base in group),)
    they_agree(model, np.array(theta))


def they_agree(model, theta):
    """Compare the derivatives of a run by both engines."""
    rng = np.random.default_rng(1)
    n, depth = 300, max(1, model.recursion.depth)
    inputs = {str(b.label): np.cumsum(rng.normal(size=n)) / 20 for b in model.recursion.inputs}
    initial = {str(b.label): rng.normal(size=depth) / 10 for b in model.recursion.states}
    groups = tuple(s.states for s in starts(model))
    begin = [([str(state.label) for state in s.states], s.shape(depth)) for s in starts(model)]
    runs = []
    for one in both(model.recursion, model.symbols, groups, model.output):
        walk = one.over(inputs, initial, begin)
        walk.run(theta)
        runs.append((walk.states["y"], walk.slopes))
    (run, slopes), (again, extended) = runs
    assert slopes.shape == extended.shape == (n, len(model.symbols) + len(groups))
    np.testing.assert_array_equal(np.isfinite(run), np.isfinite(again))
    good = np.isfinite(run) & np.isfinite(extended).all(axis=1)
    assert good.sum() > n // 2
    np.testing.assert_allclose(run[good], again[good], rtol=1e-9, atol=1e-12)
    size = np.abs(extended[good]).max(axis=0) + 1e-12
    assert np.abs((slopes[good] - extended[good])[depth:] / size).max(initial=0.0) < 1e-8


def test_a_second_run_forgets_the_first():
    a, b = sp.symbols("a b")
    recursion = Recursion(((y[k], a * y[k - 1] + b * u[k - 1]),), (a, b))
    walk = with_slopes(recursion, ((y,),), y).over({"u": np.ones(20)}, {"y": 1.0}, [(["y"], np.ones(1))])
    walk.run(np.array([2e300, 0.0]))
    assert np.isnan(walk.states["y"][3:]).all() and np.isnan(walk.slopes[3:]).all()
    walk.run(np.array([0.5, 0.0]))
    np.testing.assert_allclose(walk.states["y"], 0.5 ** np.arange(20.0))
    np.testing.assert_allclose(walk.slopes[1:, 2], 0.5 ** np.arange(1.0, 20.0))


def test_what_reaches_too_far_back_is_a_further_state():
    a = sp.Symbol("a")
    far = Recursion(((y[k], a * y[k - LONGEST - 1] + u[k]),), (a,))
    assert isinstance(with_slopes(far, (), y), Extended)
