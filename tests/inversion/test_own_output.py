"""A law makes the output that its own model has made, from the same state; what it says about itself holds."""

import numpy as np
import pytest
import sympy as sp
from bench.attack import Run, bases, moved, outcome, with_effect
from sampling import some

import narx_sym as ns
from narx_sym.engines.roots import nearest
from narx_sym.models.extend import variants
from narx_sym.symbolic.signals import k, phi1, u, y

FIRST = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.6, 0.4], Ts=0.01)


def made_of(base, *effects, seed=0, sizes=None):
    """Put effects (id, place, form, lag) into a base, with random numbers."""
    model, rng = base, np.random.default_rng(seed)
    for name, where, form, lag in effects:
        listed = [v for v in variants(model, ["temp"]) if (v.id, v.where) == (name, where) and form in v.effect.form]
        model = with_effect(model, next(v for v in listed if v.lag == lag), rng)
    if sizes:
        model = model.replace(theta=[sizes.get(str(s), v) for s, v in zip(model.symbols, model.theta, strict=True)])
    return model


COMBINED = {
    "backlash, friction": (("backlash", "input", "", 0), ("coulomb_friction", "output", "", 1)),
    "plays, friction": (("hysteresis", "input", "play", 0), ("coulomb_friction", "output", "", 1)),
    "dead zone, friction": (("dead_zone", "input", "", 0), ("coulomb_friction", "output", "", 1)),
    "Stribeck": (("stribeck_friction", "output", "", 1),),
    "backlash, Stribeck": (("backlash", "input", "", 0), ("stribeck_friction", "output", "", 1)),
    "smooth friction, plays": (("coulomb_friction", "output", "smooth", 1), ("hysteresis", "input", "play", 0)),
    "friction that holds": (("backlash", "input", "", 0), ("coulomb_friction", "motion", "holding", 0)),
    "friction that holds, a limit": (
        ("coulomb_friction", "motion", "holding", 0),
        ("output_limit", "sensor", "upper", 0),
    ),
    "stick and slip": (("stiction", "motion", "", 0),),
    "a sticking valve": (("stiction", "input", "valve", 0),),
    "two slopes, a rigid stop": (("dead_zone", "input", "two slopes", 0), ("end_stop", "motion", "rigid upper", 0)),
    "a tank that overflows into another": (("end_stop", "input", "of a first lag, upper", 0),),
    "a dead zone between two lags": (("dead_zone", "input", "behind a lag", 0),),
    "bent, friction": (("quadratic_gain", "input", "", 0), ("coulomb_friction", "output", "", 1)),
}


DELAY = ("input_delay", "input", "", 0)

SLOW = [n for n in COMBINED if "Stribeck" in n]


@pytest.mark.parametrize(
    "name",
    [*some([n for n in COMBINED if n not in SLOW], every=4), *(pytest.param(n, marks=pytest.mark.long) for n in SLOW)],
)
def test_a_law_makes_its_models_own_output(name):
    """The jumps of a sign, and pairs of roots, are found whatever stands beside them."""
    run = Run(made_of(FIRST, *COMBINED[name], seed=1), np.random.default_rng(1))
    driven = run.follow().m
    missed = np.abs(run.output(driven) - run.y) > run.size
    # Of two inputs that are both right, the one that was not taken may have been the only one to go on from.
    assert not missed.any() or (not run.law.check().proved and not run.lost(driven, int(np.argmax(missed))))


@pytest.mark.parametrize("seed", (7002, *(pytest.param(n, marks=pytest.mark.long) for n in (7000, 7005, 7008, 7435))))
def test_a_law_does_the_same_in_every_language(seed):
    """A random model; the last one has superposed plays at its input and friction inside."""
    assert outcome(seed)[0] == "follows"


def test_a_channel_that_moves_the_start_is_no_error_of_zero():
    """It moves the output before the first command, which a law that starts from rest does not know."""
    law = ns.NARX.from_terms(["y[k-1]", "phi1[k-3]", "w[k-1]"], [1.0, 0.5, 0.1], channels=["w"]).compensator()
    target = np.zeros(40)
    found = law.follow(target, 0.0, {"w": np.ones(40)})
    made = law.model.simulate(found.m, 0.0, {"w": np.ones(40)}, u0=0.0)
    assert np.array_equal(found.y, made) and found.error == pytest.approx(np.abs(made)[law.preview :].max())
    assert (
        found.missed[law.preview :].all() and not found.unreached.any() and "is not at rest at the start" in found.why
    )


@pytest.mark.parametrize("options", ({}, {"limits": (-9.0, 9.0)}, {"rate": 0.5}, {"share": 0.6}))
@pytest.mark.parametrize("base", ("first order", "delayed", "continuum", "delayed, a further delay"))
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_is_reported_is_what_the_model_does_by_itself(base, options):
    """Whether it rests at the start or not: the model rests nowhere near 5 with the output at 1."""
    model = made_of(bases()["delayed"], DELAY, sizes={"c_input_delay": 0.3}) if "," in base else bases()[base]
    law, target, ahead = model.compensator(), 1.0 + 0.5 * np.sin(np.arange(60) / 6), model.compensator().preview
    found = law.follow(target, 5.0, **options)
    made = model.simulate(found.m, target[0], u0=5.0)
    gap = np.abs(made - target)[ahead:]
    assert np.array_equal(found.y, made) and found.error == gap.max()
    assert np.array_equal(found.missed[ahead:], gap > 1e-6 * np.ptp(target) + 1e-12 * (1 + target.max()))
    assert (base == "continuum") == (found.aside == 0)
    if not options and found.aside:  # no sample is out of reach, and the report says what is missed
        assert not found.unreached.any() and found.error > 0.1 and np.array_equal(law.run(target, 5.0), found.m)
        assert f"by {found.error:.3g} at most. The model is not at rest at the start" in found.report[-1]


def test_nothing_is_proved_that_does_not_hold():
    bounded = ns.NARX([y[k - 1], sp.tanh(u[k - 1])], [0.9, 0.1]).compensator()
    assert "theta_1*r[k]" in bounded.checked and "nothing else is reached" in bounded.checked
    changing = ns.NARX([y[k - 1], u[k - 1], sp.Abs(phi1[k - 1]) * u[k - 1]], [0.5, 1.0, -0.3]).compensator()
    assert "exactly one" not in changing.checked and not changing.check().proved
    over = made_of(ns.NARX.from_terms(["u[k]"], [1.5]), ("saturation", "input", "hard", 0))
    over = over.replace(theta=[1.5, 1.5, 0.25])
    assert "nothing else is reached" not in over.compensator().checked
    cubic = made_of(FIRST, ("cubic_gain", "input", "", 0), sizes={"c_cubic_gain": 0.2}).compensator()
    assert "proved: the slope is at least" in cubic.checked and cubic.check().proved
    falling = made_of(FIRST, ("cubic_gain", "input", "", 0), sizes={"c_cubic_gain": -0.2}).compensator()
    assert "not proved" in falling.checked and not falling.check().proved and not falling.check().good


def test_no_pair_of_roots_is_jumped_over():
    """A search by widening steps saw the same sign on both sides of two roots."""
    import narx_sym.engines.roots as bounds

    def gap(w):
        return 0.4 * w + bounds.exp(-1 * ((w - 2.0) * 20.0) * ((w - 2.0) * 20.0)) - 1.2

    roots = [nearest(gap, last, -1e9, 1e9, 1.0) for last in (0.0, 1.95, 2.05, 9.0)]
    assert all(abs(gap(x)) < 1e-12 for x in roots) and len({round(x, 6) for x in roots}) == 3
    assert nearest(lambda w: w * w + 1.0, 0.3, -1e9, 1e9, 1.0) == pytest.approx(0.0, abs=1e-4)  # the least gap


@pytest.mark.parametrize("effect", ("dead_zone", "backlash", pytest.param("hysteresis", marks=pytest.mark.long)))
def test_at_rest_the_input_rests(effect):
    """Rounding of the model beside a law does not make the input jump across what does nothing."""
    model = made_of(FIRST, (effect, "input", "play" if effect == "hysteresis" else "", 0), seed=4)
    shares = [s for s in model.symbols if str(s).startswith("c")]
    model = model.replace(
        theta=[1.0 / len(shares) if s in shares else v for s, v in zip(model.symbols, model.theta, strict=True)]
    )
    wave = np.concatenate([moved(np.random.default_rng(2), 60), np.full(60, 0.7)])
    law, target = model.compensator(), model.simulate(wave, 0.0, u0=0.0)
    for options in ({}, {"limits": (-50.0, 50.0)}):
        found = law.follow(target, 0.0, **options)
        assert found.error < 1e-9 and np.abs(np.diff(found.m[-40:])).max() < 1e-6, effect


def test_at_rest_no_sign_is_one_of_rounding():
    """What is measured is 2 away from where it rests, so its last digits are those of 2: the memory inside is 1e-15."""
    sizes = {
        "c_creep": 0.382914285394765, "tau_creep": 0.0449881341885663,
        "c1_channel_friction_temp": -0.0185803993833454, "c2_channel_friction_temp": 0.0270760450472614,
    }  # fmt: skip
    model = made_of(
        bases()["continuum"], ("creep", "output", "", 0), ("channel_friction:temp", "inside", "", 0), sizes=sizes
    )
    run = Run(model, np.random.default_rng(101071))
    assert np.abs(run.output(run.follow().m) - run.y).max() < run.size
