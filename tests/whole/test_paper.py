"""Every printed equation of the paper, transcribed once and compared by `simplify(ours - paper) == 0`.

The rows are those of the derivations: E1, E2 (examples), P5, P6, P8 (bench test), V1 (pneumatic valve).
"""

import ast

import numpy as np
import pytest
import sympy as sp
from paper import (
    BENCH,
    BENCH_INVERSE,
    EXAMPLE_1,
    EXAMPLE_2,
    MODELS,
    VALVE,
    VALVE_INVERSE,
    theta_1,
    theta_2,
    theta_3,
    theta_4,
    theta_5,
    theta_6,
)
from places import ROOT

import narx_sym as ns
from narx_sym import assumptions
from narx_sym.inversion.compensator import q
from narx_sym.models.analysis import constraint_matrix, continuum_conditions, phi1_, rest_map, u_, ybar
from narx_sym.symbolic.signals import breve_phi1, breve_phi2, k, m, phi1, phi2, r, u, y


def same(ours, paper):
    return sp.simplify(sp.expand(ours - paper)) == 0


def with_numbers(expr, printed):
    return expr.xreplace(printed.exact)


@pytest.mark.parametrize("name", MODELS)
def test_printed_equations(name):
    """The terms make the printed equation; those of the valve are printed with numbers."""
    printed = MODELS[name]
    ours = printed.model().F
    assert same(with_numbers(ours, printed) if "valve" in name else ours, printed.equation)


@pytest.mark.parametrize("name", [name for name, printed in MODELS.items() if printed.law is not None])
def test_printed_laws(name):
    """The derived law is the printed one, and put back into its model it gives the reference."""
    printed = MODELS[name]
    law = printed.model().compensator()
    assert same(with_numbers(law.equation.rhs, printed) if "valve" in name else law.equation.rhs, printed.law)
    assert law.residual() == 0
    assert law.preview == 1


# -- Example 1 -------------------------------------------------------------------------------------------------


def test_example_1_constraint():
    """Sigma_y = theta_1; the rest map alone gives S = [1 0 0 0 0] and c = 1."""
    model = EXAMPLE_1.model()
    assert model.sigma_y == theta_1
    assert same(rest_map(model), theta_1 * ybar)
    S, c = constraint_matrix(continuum_conditions(model), model.symbols)
    assert S == sp.Matrix([[1, 0, 0, 0, 0]]) and c == sp.Matrix([1])


def test_example_1_quasi_static():
    """Eq. (190919a)."""
    sets = EXAMPLE_1.model().quasi_static()
    loading = (theta_2 + theta_3 * phi1_ * u_ + theta_5 * phi1_) / (1 - theta_1 - theta_4 * phi1_)
    unloading = (-theta_2 + theta_3 * phi1_ * u_ + theta_5 * phi1_) / (1 - theta_1 + theta_4 * phi1_)
    assert same(sets.loading, loading)
    assert same(sets.unloading, unloading)


def test_example_1_attracting_condition():
    """Eq. (190919b), first line."""
    # Slip: the second line divides by theta_4 phi_2 and holds only where that is positive. It is not compared.
    assert_attracting(EXAMPLE_1.model(), theta_1 + theta_4 * phi2[k - 1] * phi1[k - 1])


def assert_attracting(model, slope):
    condition = model.quasi_static().attracting
    assert isinstance(condition, sp.StrictLessThan) and condition.rhs == 1
    assert isinstance(condition.lhs, sp.Abs) and same(condition.lhs.args[0], slope)


def test_example_1_is_not_invertible():
    # Slip: the example cannot be compensated by section 4, since these terms violate Assumption A1(i).
    with pytest.raises(ns.NotInvertible) as caught:
        EXAMPLE_1.model().compensator()
    message = str(caught.value)
    assert "A1(i)" in message and "phi2[k-1]" in message
    assert any(product in message for product in ("phi1[k-1]*u[k-1]", "u[k-1]*phi1[k-1]"))


# -- Example 2 -------------------------------------------------------------------------------------------------


def test_example_2_equation():
    """Eq. (190919c) and the unnumbered equation after it."""
    step = u[k - 2] - u[k - 3]
    paper = (
        theta_1 * y[k - 1] + theta_2 * sp.sign(step) + theta_3 * step * u[k - 2]
        + theta_4 * sp.sign(step) * step * y[k - 1] + theta_5 * (u[k - 1] - u[k - 2])
    )  # fmt: skip
    assert same(EXAMPLE_2.model().right, paper)


def test_example_2_grouping():
    """Eqs. (200919b), (200919c), (200919d)."""
    law = EXAMPLE_2.model().compensator()
    step = u[k - 2] - u[k - 3]
    assert same(law.A, 1 - theta_1 / q)
    assert same(law.B, theta_5 / q - theta_5 / q**2)
    f = theta_2 * sp.sign(step) + theta_3 * step * u[k - 2] + theta_4 * sp.sign(step) * step * y[k - 1]
    assert same(law.f, f)


# -- P5: the two models of the bench test ----------------------------------------------------------------------


def test_bench_constraint():
    """Sigma_y of the model and of the inverse, and the constraint (Eq. Constraints)."""
    for printed in (BENCH, BENCH_INVERSE):
        model = printed.model()
        assert same(rest_map(model), theta_1 * ybar)
        assert model.sigma_y == theta_1
        S, c = constraint_matrix(continuum_conditions(model), model.symbols)
        assert S == sp.Matrix([[1, 0, 0, 0, 0, 0]]) and c == sp.Matrix([1])


def test_bench_model_quasi_static():
    """Eq. (QuasiStatic:EP:Cms)."""
    sets = BENCH.model().quasi_static()
    loading = (theta_2 * phi1_ + theta_3 * phi1_ * u_ + theta_5 * phi1_ * u_**2) / (
        1 - theta_1 - theta_4 * phi1_ - theta_6 * phi1_ * u_
    )
    unloading = (theta_2 * phi1_ - theta_3 * phi1_ * u_ + theta_5 * phi1_ * u_**2) / (
        1 - theta_1 + theta_4 * phi1_ - theta_6 * phi1_ * u_
    )
    assert same(sets.loading, loading)
    assert same(sets.unloading, unloading)


def test_bench_model_attracting_condition():
    """Eq. (d090919), first line."""
    slope = theta_1 + theta_4 * phi1[k - 2] * phi2[k - 2] + theta_6 * phi1[k - 2] * u[k - 2]
    assert_attracting(BENCH.model(), slope)


def test_attracting_share_with_table_1():
    """u = 70 sin(2 pi t), 1 ms: |dF/dy| < 1 in 69 % of the loading samples, the printed second line in none."""
    # Slip: the caption of the figure prints 70 sin(2 pi k).
    volts = 70 * np.sin(2 * np.pi * np.arange(1001) * 1e-3)
    sets = BENCH.published().quasi_static().evaluate(volts)
    share = sets.attracting[sets.loading].mean()
    assert share == pytest.approx(0.69, abs=0.005)
    # Slip: theta_6 phi_1 < 0 while loading, so that the second line asks for u between swapped bounds.
    t1, _, _, t4, _, t6 = BENCH.theta
    step, volts = sets.phi1[sets.loading], volts[sets.loading]
    low, high = (-1 - t1 - t4 * step) / (t6 * step), (1 - t1 - t4 * step) / (t6 * step)
    assert not np.any((low < volts) & (volts < high))


def test_bench_inverse_quasi_static():
    """Not printed: by the steps of section 3, with `u_` and `phi1_` standing for the inverse's input y."""
    sets = BENCH_INVERSE.model().quasi_static()
    for branch, s in ((sets.loading, 1), (sets.unloading, -1)):
        above = theta_2 * phi1_ + s * theta_4 * phi1_ * u_ + s * theta_6 * u_**2
        assert same(branch, above / (1 - theta_1 - s * theta_3 * phi1_ - s * theta_5 * u_))
    slope = theta_1 + breve_phi2[k - 1] * (theta_3 * breve_phi1[k - 1] + theta_5 * y[k - 1])
    assert_attracting(BENCH_INVERSE.model(), slope)


# -- P6: constant input ----------------------------------------------------------------------------------------


def volts_frozen_at(level, direction, Ts=1e-3):
    """40 sin(2 pi t) that stops at `level` in the fifth second, while loading (1) or unloading (-1)."""
    t = Ts * np.arange(8000)
    volts = 40 * np.sin(2 * np.pi * t)
    side = (direction * (volts - level) >= 0) & (direction * np.cos(2 * np.pi * t) > 0) & (t >= 4)
    stop = int(np.argmax(side))
    volts[stop:] = level
    return volts, stop


def test_constant_input_keeps_the_output_exactly():
    """The model rests on its point of the loop: not one bit moves; loading and unloading differ."""
    model = BENCH.published()
    held = []
    for direction in (1, -1):
        volts, stop = volts_frozen_at(16.8, direction)
        output = model.simulate(volts, y0=0.0)[stop + model.n_u + 1 :]
        assert np.ptp(output) == 0.0
        held.append(output[0])
    assert 8 < held[1] - held[0] < 10  # um: the width of the loop there


def test_without_the_constraint_the_output_decays():
    free = BENCH.model([0.999, *BENCH.theta[1:]])
    volts, stop = volts_frozen_at(16.8, -1)
    output = free.simulate(volts, y0=0.0)
    assert abs(output[-1]) < 0.1 * abs(output[stop + 3])


# -- V1: the pneumatic valve -----------------------------------------------------------------------------------


@pytest.mark.parametrize("printed", [VALVE, VALVE_INVERSE])
def test_the_valve_models_have_a_continuum(printed):
    assert with_numbers(printed.model().sigma_y, printed) == 1


def test_valve_law_amplifies_while_rising():
    """With r at rest, m[k] - m[k-1] is the last increment times this factor: unstable while m rises."""
    law = with_numbers(VALVE.model().compensator().law, VALVE)
    dm, level = sp.symbols("dm level", positive=True)
    a, b, c, d = map(sp.Rational, ("19.76", "19.32", "9.44", "12.61"))
    for s, at_three in ((1, 1.515), (-1, 0.531)):
        new = law.xreplace({m[k - 1]: level, m[k - 2]: level - s * dm, r[k]: level, r[k + 1]: level})
        factor = sp.simplify((new - level) / (s * dm))
        assert same(factor, (a + s * (d - c) * level) / b)
        assert float(factor.subs(level, 3)) == pytest.approx(at_three, abs=5e-4)


# -- the continuum: what Sigma_y = 1 does and does not say -----------------------------------------------------


def test_sigma_y_of_one_is_not_enough():
    # Slip: Assumption 1 does not ban terms in u alone or a constant; this model meets it and drifts.
    drifting = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[1.0, 0.1])
    assert drifting.check(assumptions.ASSUMPTION_1) == []
    assert float(drifting.sigma_y.xreplace(drifting.values)) == 1.0
    assert not ns.analysis.continuum(drifting)
    conditions = [sp.simplify(c.lhs - c.rhs) for c in continuum_conditions(drifting)]
    assert set(conditions) == {theta_1 - 1, theta_2}
    assert [v.rule for v in drifting.check(assumptions.CONTINUUM)] == ["rest"]


def test_sign_squared_keeps_its_rest_value():
    # Slip: phi_2^2 = 1 only while the input moves; as a rewrite it would move Sigma_y.
    model = ns.NARX([y[k - 1], phi2[k - 1] ** 2 * y[k - 1]])
    assert rest_map(model) == theta_1 * ybar


def test_property_1_of_the_published_models():
    for model in (BENCH.published(), BENCH_INVERSE.published()):
        verdict = ns.analysis.property_1(model)
        assert verdict.holds and verdict.equilibria == "continuum"


# -- the derivations show the models as text -------------------------------------------------------------------


def written(script):
    """Yield every list of texts or of numbers that a script writes."""
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.List | ast.Tuple):
            try:
                yield ast.literal_eval(node)
            except ValueError:
                pass  # it holds more than constants


@pytest.mark.parametrize("script", sorted((ROOT / "derivations").rglob("*.py")), ids=lambda script: script.stem)
def test_a_derivation_writes_no_other_model(script):
    """Terms with phi2 and a product are those of one printed model, and six numbers from 1 are its values."""
    for found in written(script):
        texts = {x.replace("breve_", "") for x in found if isinstance(x, str)}
        if any("phi2[" in x and "*" in x for x in texts):
            assert [name for name, printed in MODELS.items() if texts <= set(printed.terms)], found
        elif len(found) > 4 and found[0] == "1":
            assert tuple(found) in [printed.values for printed in MODELS.values()], found
        elif len(found) == 6 and found[0] == 1 and not texts:
            assert list(found) in [printed.theta for printed in MODELS.values()], found


def test_the_derivations_write_the_printed_models():
    """What is compared above is there: each model, and each table."""
    found = [x for script in (ROOT / "derivations").rglob("*.py") for x in written(script)]
    for printed in MODELS.values():
        assert list(printed.terms) in [list(x) for x in found]
    assert BENCH.theta in found and BENCH_INVERSE.theta in found
