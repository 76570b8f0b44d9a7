"""Derivatives that users may ask for: by samples that phi1 hides, with signs, at every lag; and of runs."""

import numpy as np
import pytest
import sympy as sp
from sampling import some

import narx_sym as ns
from narx_sym.engines.numpy import lambdify
from narx_sym.symbolic.signals import breve_phi1, breve_phi2, expand_phi, k, phi1, phi2, samples, u, y

FACTORS = [u[k - 1], u[k - 2], y[k - 1], y[k - 3], phi1[k - 1], phi1[k - 2], phi2[k - 1], phi2[k - 2], breve_phi1[k - 1],
           breve_phi2[k - 2], sp.Abs(phi1[k - 1]), sp.sign(y[k - 1] - u[k - 2]), sp.Max(u[k - 1], y[k - 2], phi1[k - 2]),
           sp.tanh(phi1[k - 1] * u[k - 3]), sp.exp(-(phi1[k - 2] ** 2)), sp.Min(0, breve_phi1[k - 2])]  # fmt: skip


@pytest.mark.parametrize("seed", some(range(40), 4))
def test_a_derivative_is_the_slope_at_every_sample(seed):
    rng = np.random.default_rng(seed)
    expr = sp.Add(*(float(rng.uniform(-2, 2)) * sp.Mul(*rng.choice(FACTORS, rng.integers(1, 4))) for _ in range(3)))
    named = {s: sp.Dummy() for s in samples(expand_phi(expr))}
    value = lambdify([expand_phi(expr).xreplace(named)], list(named.values()))
    at = rng.uniform(-1, 1, len(named))
    for i, s in enumerate(named):
        slope = lambdify([expand_phi(ns.derivative(expr, s)).xreplace(named)], list(named.values()))(*at)[0]
        step = 1e-6 * np.eye(len(named))[i]
        expected = (value(*(at + step))[0] - value(*(at - step))[0]) / 2e-6
        assert slope == pytest.approx(expected, rel=1e-6, abs=1e-7)
    assert not ns.derivative(expr, u[k - 1]).has(sp.DiracDelta, sp.Derivative, sp.Subs)
    assert ns.derivative(expr, u[k - 9]) == 0


def test_phi_stays_where_it_is_not_differentiated_by():
    a = sp.Symbol("a", real=True)
    F = a * phi2[k - 2] * phi1[k - 2] * u[k - 2] + y[k - 1]
    assert sp.expand(ns.derivative(F, u[k - 2]) - a * phi2[k - 2] * (phi1[k - 2] + u[k - 2])) == 0
    assert sp.expand(ns.derivative(F, u[k - 3]) + a * phi2[k - 2] * u[k - 2]) == 0
    assert ns.derivative(F, phi1[k - 2]) == a * phi2[k - 2] * u[k - 2] and ns.derivative(F, a) == F.coeff(a)
    assert ns.derivative(sp.sign(u[k - 4] - u[k - 5]), u[k - 5]) == 0 and ns.derivative(3, u[k]) == 0


def test_a_run_moves_with_its_parameters_as_its_sensitivities_say():
    terms = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "u[k-2]**2"]
    model = ns.NARX.from_terms(terms, [0.9, 0.7, 0.1, 0.05])
    extended, directions = model.sensitivities()
    wave = np.sin(0.3 * np.arange(100)) + 0.2 * np.sin(1.1 * np.arange(100))
    start = dict.fromkeys(map(str, extended.states), 0.0)
    found = extended.compile()({"u": wave}, model.theta, start)
    for i, moved in enumerate(directions):
        step = 1e-6 * np.eye(4)[i]
        runs = [model.recursion.compile()({"u": wave}, model.theta + s * step, {"y": 0.0})["y"] for s in (1, -1)]
        assert np.allclose(found[moved[y].name], (runs[0] - runs[1]) / 2e-6, rtol=1e-5, atol=1e-7)
    assert ns.sensitivities(model.recursion)[0] == extended
