"""Equilibria against brute force: as many as there are, in any units."""

import numpy as np
import pytest
import sympy as sp

from narx_sym import NARX
from narx_sym.errors import ModelError
from narx_sym.models.analysis import continuum, property_1, steady_state, ubar, ybar
from narx_sym.models.extend import extend, variants
from narx_sym.models.info import Info
from narx_sym.models.rest.equilibria import resting, resting_points


def polynomial(theta, **other):
    """y[k] = theta_0 + theta_1 y[k-1] + theta_2 y[k-1]**2 + ..."""
    terms = ["1", "y[k-1]", *(f"y[k-1]**{n}" for n in range(2, len(theta)))]
    return NARX.from_terms(terms, list(theta), **other)


def test_all_real_roots_are_equilibria():
    """Those too that SymPy writes with complex numbers: three real roots of a cubic."""
    rng = np.random.default_rng(0)
    for i in range(12):
        theta = rng.normal(size=5) if i % 2 else [rng.uniform(-0.03, 0.03), 1 + rng.uniform(0.1, 0.5), 0.0, -0.3]
        roots = np.roots(np.polysub(theta[::-1], [1, 0]))
        real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        found = steady_state(polynomial(theta)).equilibria
        assert np.allclose(np.array(found, dtype=float), real, rtol=1e-6), (theta, found, real)


@pytest.mark.parametrize("theta", ((1.2, 0.0, -0.1), (1.2, -0.3), (0.9, 0.0, 0.2, 0.1)))
def test_real_roots_at_an_input(theta):
    """With an input equilibria are formulas, or what the equation tells: no complex number stands for a real one."""
    terms = [f"y[k-1]**{i}" for i, c in enumerate(theta, 1) if c]
    found = steady_state(NARX.from_terms([*terms, "u[k-1]"], [*(c for c in theta if c), 0.05]))
    assert "I" not in str(found.equilibria)
    for level in (-3.0, 0.3, 1.0, 2.0):
        roots = np.roots([*reversed(theta[1:]), theta[0] - 1.0, 0.05 * level])
        real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        np.testing.assert_allclose(found.at(level), real, rtol=1e-9)
    with pytest.raises(ModelError, match="Every output"):
        steady_state(NARX.from_terms(["y[k-1]", "phi1[k-1]"], [1.0, 0.5])).at(1.0)
    with pytest.raises(ModelError, match="depend on"):
        steady_state(NARX.from_terms(["y[k-1]", "u[k-1]"])).at(1.0)


@pytest.mark.parametrize("size", (1e-12, 1e-9, 1.0, 1e9))
def test_a_change_of_units_changes_no_equilibrium(size):
    """0 and +-0.3, and a double root, in any unit of y; a pump that fills a cylinder, in any unit of u."""
    bistable = polynomial([0.0, 1.5, 0.0, -0.5 / (0.3 * size) ** 2])
    found = property_1(bistable)
    assert found.holds and np.allclose(np.array(found.equilibria) / size, [-0.3, 0, 0.3], atol=1e-12)
    double = [-0.3 * (0.7 * size) ** 2 / size, 1 + 2 * 0.3 * 0.7, -0.3 / size]
    assert property_1(polynomial(double)).equilibria == [pytest.approx(0.7 * size)]
    pump = NARX.from_terms(["y[k-1]", "u[k-1]"], [1.0, 1e-10 * size], info=Info(ranges={"u": (0.0, 1e7 / size)}))
    assert not continuum(pump) and not property_1(pump).holds and steady_state(pump).equilibria == []


@pytest.mark.parametrize("size", (1e-9, 1.0, 1e9))
def test_what_cancels_but_for_rounding_is_zero(size):
    terms = ["y[k-1]", "y[k-2]", "y[k-3]", "u[k-1]", "u[k-2]", "u[k-3]"]
    model = NARX.from_terms(terms, [0.7, 0.2, 0.1, 0.1 * size, -0.3 * size, 0.2 * size])
    assert continuum(model) and steady_state(model).equilibria == "continuum"
    drifting = model.replace(theta=[0.7, 0.2, 0.1, 0.1 * size, -0.3 * size, 0.200001 * size])
    assert not continuum(drifting) and steady_state(drifting).equilibria == []


def test_neighbours_that_the_coefficients_tell_apart_are_two():
    """Beside a root at 1 there are two at 1e-7 and 2e-7."""
    theta = -np.poly([1.0, 1e-7, 2e-7])[::-1] + [0, 1, 0, 0]
    assert np.allclose(np.array(steady_state(polynomial(theta)).equilibria, dtype=float), [1e-7, 2e-7, 1.0], rtol=1e-4)


@pytest.mark.parametrize("form", ["hard", "soft"])
def test_an_effect_rests_with_its_own_shape(form):
    """Where a function of the input has a parameter inside, the equilibrium is that of its value."""
    bare = NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=0.01)
    forms = [v for v in variants(bare) if v.id == "saturation" and v.where == "input" and v.effect.form == form]
    model = extend(bare, forms[0]).model.replace(theta=[0.8, 0.2, 0.5, 0.25])
    excess = resting(model)
    assert excess.free_symbols == {ybar, ubar}
    for level in (-1.5, 0.1, 2.0):
        (rests,) = resting_points(excess.xreplace({ubar: sp.Float(level)}), ybar).points
        assert rests == pytest.approx(model.simulate(np.full(400, level), 0.0)[-1], rel=1e-9)
