"""A law as a root of a polynomial in m[k]: it is derived and printed, and the real root nearest to m[k-1] is taken."""

import numpy as np
import pytest
import sympy as sp
from sampling import some

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.inversion.analyses import Subject, document
from narx_sym.inversion.analyses import law as told
from narx_sym.inversion.solution import Polynomial
from narx_sym.inversion.solve import solve_for
from narx_sym.symbolic.signals import k, m, r, u, v, y

theta = sp.symbols("theta1:6", real=True)
# Of each degree: the terms of the model, their numbers, and the coefficients in m[k] from the highest power.
CASES = {
    2: (["y[k-1]", "u[k-1]", "u[k-1]**2", "u[k-2]*u[k-1]"], [0.6, 0.5, 0.2, 0.1]),
    3: (["y[k-1]", "u[k-1]", "u[k-1]**3", "y[k-1]*u[k-1]**2"], [0.6, -0.4, 0.3, 0.2]),
    4: (["y[k-1]", "u[k-1]", "u[k-1]**4", "u[k-2]*u[k-1]**3"], [0.6, 0.5, 0.1, 0.2]),
}
COEFFICIENTS = {
    2: (theta[2], theta[1] + theta[3] * m[k - 1], theta[0] * r[k] - r[k + 1]),
    3: (theta[2], theta[3] * r[k], theta[1], theta[0] * r[k] - r[k + 1]),
    4: (theta[2], theta[3] * m[k - 1], 0, theta[1], theta[0] * r[k] - r[k + 1]),
}


def law_of(degree, **options):
    terms, numbers = CASES[degree]
    return ns.NARX.from_terms(terms, numbers, **options).compensator()


@pytest.mark.parametrize("degree", some(CASES))
def test_its_coefficients_are_expressions(degree):
    law = law_of(degree)
    (found,) = law.polynomials
    named = dict(zip(law.model.symbols, theta, strict=False))
    assert found.degree == degree and tuple(c.xreplace(named) for c in found.coefficients) == COEFFICIENTS[degree]
    assert found.unknown == m[k] and found.last == m[k - 1]
    for numbers in (False, True):
        said = law.lines(numbers)[-1]
        assert said.startswith("m[k] is a root of ") and f"*m[k]**{degree} + " in said and "nearest to m[k-1]" in said
    assert ("where none is real" in said) == (degree % 2 == 0)
    (shown,) = law.latex_polynomials()
    assert shown.startswith("\\begin{aligned}\n0 &= ") and f"m_{{k}}^{{{degree}}}" in shown
    analysed = told(Subject(law.model))
    assert analysed.equations == [shown, law.latex()] and "is a root of" in analysed.lines[-1]
    assert shown in document(law.model)


@pytest.mark.parametrize("degree", CASES)
def test_the_nearest_real_root_is_taken_wherever_the_law_goes(degree):
    """Beside the eigenvalues of the companion matrix, at every sample."""
    law = law_of(degree)
    (polynomial,) = law.polynomials
    wave = 0.8 * np.sin(np.arange(120) / 9)
    run = compile(law.recursion)({"r": wave}, law.theta, {"m": 0.1})["m"]
    at = sp.lambdify((m[k - 1], r[k], r[k + 1]), polynomial.held(law.model.values).coefficients)
    real = 0
    for i in range(2, 118):
        roots = np.roots(at(run[i - 1], wave[i], wave[i + 1]))
        roots = roots.real[np.abs(roots.imag) < 1e-7]
        if roots.size:
            real += 1
            away = np.abs(
                roots - run[i - 1]
            )  # from a vertex two are as near: the higher one of this curve that opens up
            nearest = max(roots[away < away.min() + 1e-6])
            assert run[i] == pytest.approx(nearest, abs=1e-6)
    assert real > 60


def test_a_point_of_operation_moves_its_coefficients():
    law = law_of(2, operating_point={u: 1.5, y: -2.0})
    (found,) = law.polynomials
    _, b, c, d = law.model.symbols
    assert sp.expand(found.coefficients[1] - (b - 3 * c + d * (m[k - 1] - 1.5))) == 0
    gap = sum(e * t for e, t in found.terms) - (law.staged.stages[0].expr - law.staged.stages[0].target)
    assert sp.expand(gap) == 0


def test_what_is_no_polynomial_has_none():
    last = m[k - 1]
    assert Polynomial.of(theta[0] * m[k] - r[k], m[k], last) is None
    assert Polynomial.of(sp.tanh(m[k]) - r[k], m[k], last) is None
    assert Polynomial.of((m[k] - last) ** 2 * sp.sign(last) - m[k] ** 2 * sp.sign(last) - r[k], m[k], last) is None
    assert ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0]).compensator().polynomials == ()


def test_a_coefficient_that_samples_turn():
    """c*v m^2 + b m: the vertex where a target is not reached, whatever the sign of c*v; where nothing acts m stays."""
    c, b = theta[:2]
    found = solve_for(c * v[k] * m[k] ** 2 + b * r[k] * m[k], m[k], r[k + 1], m[k - 1], {c: 0.5, b: 1.0})
    f = sp.lambdify((v[k], r[k], r[k + 1], m[k - 1]), found.value.xreplace({c: 0.5, b: 1.0}), "math")
    for curve, slope in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        vertex = -slope / curve
        lowest = -(slope**2) / (2 * curve)
        assert f(curve, slope, lowest - np.sign(curve), 5.0) == pytest.approx(vertex)
        for wanted in (vertex - 2.0, vertex + 0.3):
            target = 0.5 * curve * wanted**2 + slope * wanted
            assert f(curve, slope, target, wanted + 0.1) == pytest.approx(wanted)
    assert f(0.0, 2.0, 3.0, 0.7) == pytest.approx(1.5) and f(0.0, 0.0, 3.0, 0.7) == 0.7
