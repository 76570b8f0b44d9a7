"""The smooth sign: a symbolic substitution that tends to the sign, in models, laws and files."""

import numpy as np
import pytest
import sympy as sp
from paper import BENCH, BENCH_INVERSE
from sampling import some

import narx_sym as ns
from narx_sym.errors import ModelError
from narx_sym.inversion.stability import direction
from narx_sym.models.model import Model
from narx_sym.symbolic.signals import breve_phi1, breve_phi2, k, m, phi1, phi2, r, u, y
from narx_sym.symbolic.smoothing import DEFAULT, FORMS, smoothed

GOAL = 40 * np.sin(2e-3 * np.pi * np.arange(4000))


def bench():
    return BENCH.published()


def inverse():
    return BENCH_INVERSE.published()


def record(n=6000):
    volts = ns.plants.filtered_noise(N=n, seed=0)
    return ns.Record.from_arrays(volts, ns.plants.bouc_wen(volts), Ts=1e-3)


def reversals(x):
    return int(np.sum(np.diff(np.sign(np.diff(x))) != 0))


@pytest.mark.parametrize("form", FORMS)
def test_each_form_is_an_odd_step(form):
    x = sp.Symbol("x", real=True)
    f = FORMS[form](x)
    assert sp.simplify(f + f.subs(x, -x)) == 0 and sp.limit(f, x, sp.oo) == 1 and f.subs(x, 0) == 0
    assert sp.diff(f, x).subs(x, 0) == 1  # all forms have the same slope at rest


def test_what_is_replaced():
    eps = {u: 0.5}
    step = u[k - 1] - u[k - 2]
    soft = sp.tanh(2 * phi1[k - 1])
    assert smoothed(phi2[k - 1] * phi1[k - 1] * u[k - 1], eps) == soft * phi1[k - 1] * u[k - 1]
    assert smoothed(sp.sign(step), eps) == sp.tanh(2 * step)
    assert smoothed(sp.Abs(step), eps) == step * sp.tanh(2 * step)
    assert smoothed(sp.Abs(phi1[k - 2]), eps) == phi1[k - 2] * sp.tanh(2 * phi1[k - 2])
    for other in (sp.sign(u[k - 1]), sp.sign(u[k - 1] - y[k - 1]), sp.Abs(1.6 * u[k] - y[k - 1]), breve_phi2[k - 1]):
        assert smoothed(other * y[k - 1], eps) == other * y[k - 1]
    assert smoothed(breve_phi2[k - 1], {y: 0.1}) == sp.tanh(10 * breve_phi1[k - 1])
    assert smoothed(sp.sign(step), eps, lambda x: sp.sin(x)) == sp.sin(2 * step)


def test_smoothing_and_inverting_commute():
    for model in (bench(), inverse()):
        first, second = model.smooth(0.01).compensator(), model.compensator().smooth(0.01)
        assert sp.expand(first.law - second.law) == 0
        assert second.residual() == 0 and not second.law.has(sp.sign)
        assert second.law.has(sp.tanh) and (second.f is None or sp.expand(second.f - first.f) == 0)
    law = bench().compensator().smooth(0.01)
    assert sp.tanh(100 * (m[k - 1] - m[k - 2])) in law.law.atoms(sp.tanh)
    assert sp.tanh(100 * (r[k + 1] - r[k])) in inverse().compensator().smooth(0.01).law.atoms(sp.tanh)


def test_a_model_follows_its_smooth_law():
    model = bench().smooth(0.05)
    volts = model.compensator().run(GOAL, 0.0)
    # Before the start both rest; y[0] = 0 is the reference's first sample.
    assert np.abs(model.simulate(volts, u0=0.0, y0=0.0) - GOAL)[1:].max() < 1e-9


@pytest.mark.parametrize("form", some(FORMS))
def test_the_smooth_law_tends_to_the_sharp_one(form):
    law = bench().compensator()
    sharp = law.run(GOAL, 0.0)
    far, near = (np.abs(law.smooth(eps, form).run(GOAL, 0.0) - sharp).max() for eps in (0.1, 1e-3))
    assert near < 0.05 < far


def test_the_default_is_a_part_of_the_records_step(tmp_path):
    data = record()
    model = BENCH.model().fit(data, ["continuum"])
    for name, x in (("u", data.u), ("y", data.y)):
        assert model.info.steps[name] == pytest.approx(np.median(np.abs(np.diff(x))), rel=1e-3)
    smooth = model.smooth()
    eps = float(f"{DEFAULT * model.info.steps['u']:.2g}")
    assert smooth.F.atoms(sp.tanh) == {sp.tanh(phi1[k - 2] / sp.Rational(str(eps)))}
    assert np.array_equal(smooth.theta, model.theta) and smooth.info.ranges == model.info.ranges
    assert smooth.info.nrmse is None  # that was the other model's
    refitted = model.smooth().fit(data)
    assert refitted.constraints and refitted.theta[0] == 1.0 and not np.array_equal(refitted.theta, model.theta)
    ns.save(refitted, tmp_path / "smooth.json")
    again = ns.load(tmp_path / "smooth.json")
    assert again.F == refitted.F and again.compensator().residual() == 0


@pytest.mark.parametrize("form", FORMS)
def test_files_keep_every_form(form, tmp_path):
    model = bench().smooth(0.01, form)
    ns.save(model, tmp_path / "smooth.json")
    given = np.cumsum(np.random.default_rng(0).standard_normal(200))
    np.testing.assert_allclose(ns.load(tmp_path / "smooth.json").simulate(given, 0.0), model.simulate(given, 0.0))


def test_a_model_that_is_no_sum_of_terms():
    a, b = sp.symbols("a b", real=True)
    model = Model(y[k - 1] + a * phi1[k] + b * sp.Abs(phi1[k]) * sp.Abs(u[k - 1] - y[k - 1]), (a, b), [1.0, 0.2])
    smooth = model.smooth(0.1)
    assert smooth.F.has(sp.tanh) and len(smooth.F.atoms(sp.Abs)) == 1  # |u - y| is no step
    given = np.sin(np.arange(100) / 9)
    assert np.abs(smooth.simulate(given, 0.0) - model.simulate(given, 0.0)).max() < 0.05


def test_chattering_falls_and_tracking_is_kept():
    """Table 1's inverse: two extra reversals at each turning point, none with the smooth sign."""
    law = inverse().compensator()
    found = {}
    for name, one in (("sharp", law), ("smooth", law.smooth(0.02))):
        volts = one.run(GOAL, 0.0)
        found[name] = (reversals(volts), ns.mape(GOAL, ns.plants.bouc_wen(volts)), ns.nsavi(volts, GOAL))
    assert found["sharp"][0] > 2 * reversals(GOAL) and found["smooth"][0] <= reversals(GOAL) + 1
    assert found["smooth"][1] < found["sharp"][1] and abs(found["smooth"][2] - found["sharp"][2]) < 0.005


def test_the_internal_dynamics_keep_the_direction():
    sharp, smooth = bench().compensator(), bench().compensator().smooth(0.05)
    assert sp.expand(sharp.internal.eigenvalue - smooth.internal.eigenvalue) == 0
    assert smooth.internal.turns[direction] == sp.tanh(20 * (m[k - 1] - m[k - 2]))


def test_bad_widths_and_forms():
    model = bench()
    with pytest.raises(ModelError, match="Give eps"):
        model.smooth()
    for bad in (0.0, -1.0, np.nan, "wide"):
        with pytest.raises(ModelError, match="positive number"):
            model.smooth(bad)
    with pytest.raises(ModelError, match="Unknown smooth form 'box'"):
        model.smooth(0.1, "box")
    with pytest.raises(ModelError, match="Give eps"):
        model.compensator().smooth()
