"""An effect whose share cannot be told from 1 is whole: it has no coefficient, and laws are those of textbooks."""

import numpy as np
import pytest
import sympy as sp

import narx_sym as ns
from narx_sym.diagnosis.refit import Split, settle, whole
from narx_sym.models.added import newer
from narx_sym.models.effects import EFFECTS
from narx_sym.models.extend import Variant, extend
from narx_sym.models.rewrite import held, without
from narx_sym.symbolic.signals import k, signal, u, v

Ts, N = 0.01, 1500
t = Ts * np.arange(N)
U = np.sin(1.3 * t) + 0.7 * np.sin(3.3 * t + 1) + 0.4 * np.sin(7.1 * t + 2)
BASE = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=Ts)
FORMS = {
    "backlash": (EFFECTS["backlash"][0], [0.3]),
    "hard": (next(e for e in EFFECTS["saturation"] if e.form == "hard"), [0.9]),
    "soft": (next(e for e in EFFECTS["saturation"] if e.form == "soft"), [0.9]),
    "rate_limit": (EFFECTS["rate_limit"][0], [0.02]),
}


def fitted(name, share, noise=0.01):
    """Return a machine with a share of an effect, fitted from a simulation of itself with noise."""
    effect, shape = FORMS[name]
    model = extend(BASE, Variant(effect, "input", "u")).model.replace(theta=[0.8, 0.2, share, *shape])
    y = model.simulate(U, 0.0, u0=U[0])
    record = ns.Record.from_arrays(U, y + noise * np.std(y) * np.random.default_rng(0).standard_normal(N), Ts)
    return settle(model, Split.of([record]))


@pytest.mark.parametrize("name", FORMS)
def test_a_share_that_is_one_but_for_noise_goes(name):
    before = fitted(name, 1.0)
    after = whole(before)
    assert len(after.model.symbols) == len(before.model.symbols) - 1
    effect = after.model.effects[0]
    assert effect.coefficients == {} and effect.full and effect.effect == before.model.effects[0].effect
    assert after.mean_square(after.split.held) < 1.01 * before.mean_square(before.split.held)
    assert after.model.values[effect.shape["r"]] == pytest.approx(FORMS[name][1][0], rel=0.02)


@pytest.mark.parametrize("name", FORMS)
def test_a_share_of_nine_tenths_stays(name):
    before = fitted(name, 0.9)
    assert whole(before) is before and float(before.model.theta[2]) == pytest.approx(0.9, abs=0.02)


def test_laws_of_whole_effects_are_those_of_textbooks():
    soft = whole(fitted("soft", 1.0)).model
    assert "nearest" in repr(fitted("soft", 0.97).model.compensator())  # no closed form
    assert "log" in repr(soft.compensator())  # artanh
    slack = whole(fitted("backlash", 1.0)).model
    assert next(s.right for s in slack.states if s.left == v[k]).func == sp.Indexed  # v[k] is what passes the play
    wanted = 0.5 * np.sin(2.5 * t)
    for model in (soft, slack):
        m = model.compensator().run(wanted, 0.0)
        assert np.abs(model.simulate(m, 0.0, u0=0.0)[20 : m.size] - wanted[20 : m.size]).max() < 1e-6


def test_a_whole_effect_is_known_again_and_kept(tmp_path):
    model = whole(fitted("backlash", 1.0)).model
    (effect,) = model.effects
    assert newer(model, BASE) == [effect] and newer(model, model) == []
    ns.save(model, tmp_path / "m.json")
    assert ns.load(tmp_path / "m.json").effects == (effect,)
    assert without(model, [model.symbols[0]]).effects == (effect,)  # the core lost a term
    more = extend(model, Variant(EFFECTS["backlash"][0], "output", "y")).model
    assert [e.group for e in newer(more, model)] == ["backlash2"]


def test_an_effect_of_which_nothing_is_left_is_gone():
    model = fitted("backlash", 0.9).model
    c = model.effects[0].coefficients["c"]
    assert without(model, [c]).effects == () and held(model, {c: sp.S.Zero}).effects == ()
    assert u in held(model, {c: sp.S.One}).recursion.inputs and len(held(model, {c: sp.S.One}).effects) == 1


def test_a_whole_delay_that_has_no_other_parameter_is_told_from_a_second_one():
    delay = Variant(EFFECTS["input_delay"][0], "input", "u", fixed=(("d", 2),))
    first = extend(BASE, delay)
    model = held(first.model.replace(theta=[0.8, 0.2, 1.0]), {first.coefficients[0]: sp.S.One})
    second = extend(model, delay).model
    assert len({e.group for e in second.effects}) == 2 and len(newer(second, model)) == 1


def test_what_stands_behind_a_curve_starts_where_the_curve_puts_it():
    """Off zero a saturation holds the input back; a rate limit behind it does not begin by following the input."""
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=Ts, operating_point={u: 0.3})
    soft = extend(base, Variant(FORMS["soft"][0], "input", "u", raw=True)).model
    slow = extend(soft, Variant(EFFECTS["rate_limit"][0], "input", "u")).model.replace(
        theta=[0.8, 0.2, 1.0, 0.4, 1.0, 0.001]
    )
    rest = 0.4 * np.tanh(0.3 / 0.4) - 0.3
    assert float(slow.starts[signal("w")].xreplace(slow.values | {u[k]: 0.3})) == pytest.approx(rest)
    still = slow.simulate(np.full(50, 0.3), rest, u0=0.3)
    assert np.ptp(still) < 1e-12
