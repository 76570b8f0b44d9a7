"""Laws beyond Assumption A1: effects that remember, branches, limits, what cannot be reached."""

import shutil
import subprocess
import warnings

import numpy as np
import pytest
import sympy as sp
from sampling import more, some

import narx_sym as ns
from narx_sym.engines.compile import ENGINES, compile
from narx_sym.errors import ModelError, NotInvertible, Unreachable
from narx_sym.fit.laws.run import told
from narx_sym.fit.laws.trial import Trial
from narx_sym.fit.simulate import rest_states
from narx_sym.models.extend import extend, variants
from narx_sym.models.info import Info
from narx_sym.symbolic.signals import k, m, phi1, r, samples, signal, u, x, y

gcc = shutil.which("gcc")
a, b, c, d = sp.symbols("a b c d", real=True)
MEMORY = d * u[k - 1] - y[k - 1]


def bouc_wen(theta=(0.7, 0.008, 0.0081, 1.6), **options):
    return ns.Model(
        y[k - 1] + a * phi1[k] + b * sp.Abs(phi1[k]) * MEMORY + c * phi1[k] * sp.Abs(MEMORY),
        (a, b, c, d),
        theta,
        **options,
    )


BASES = {
    "static": ns.NARX.from_terms(["u[k]"], [1.5], Ts=0.01, operating_point={u: 0.4, y: 2.0}),
    "first order": ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.3], Ts=0.01),
    "second order": ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01),
    "delayed": ns.NARX.from_terms(["y[k-1]", "u[k-2]"], [0.7, 0.4], Ts=0.01, operating_point={u: -1.0, y: 3.0}),
    "continuum": ns.NARX.from_terms(
        ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"], [1.0, 0.7, 0.1, -0.2],
        Ts=0.01, operating_point={u: 0.3, y: -2.0},
    ),
    "Bouc-Wen": bouc_wen((0.7, 0.1, 0.11, 1.6), Ts=0.01),
}  # fmt: skip
# Effect, place, driver, form: the range of its coefficients.
EFFECTS = {
    ("dead_zone", "input", "u", ""): (0.05, 0.9),
    ("backlash", "input", "u", ""): (0.05, 0.9),
    ("saturation", "input", "u", "hard"): (0.05, 0.8),
    ("saturation", "input", "u", "soft"): (0.05, 0.8),
    ("asymmetric_gain", "input", "u", ""): (-0.5, 0.5),
    ("quadratic_gain", "input", "u", ""): (-0.1, 0.1),
    ("cubic_gain", "input", "u", ""): (0.01, 0.3),
    ("input_delay", "input", "u", ""): (0.05, 0.3),
    ("rate_dependence", "input", "u", ""): (0.05, 0.8),
    ("rate_limit", "input", "u", ""): (0.05, 0.8),
    ("rate_limit", "input", "u", "two speeds"): (0.05, 0.8),
    ("uneven_speed", "motion", "y", ""): (-0.3, 0.5),
    ("ageing", "input", "t", ""): (-0.1, 0.1),
    ("channel_gain:temp", "input", "channel", ""): (-0.4, 0.4),
    ("hysteresis", "input", "u", "Bouc-Wen"): (-0.3, 0.3),
    ("backlash", "output", "y", ""): (0.05, 0.9),
    ("creep", "output", "y", ""): (0.05, 0.5),
    ("hysteresis", "output", "y", "Bouc-Wen"): (-0.3, 0.3),
    ("drift", "output", "t", ""): (-0.5, 0.5),
    ("channel:temp", "output", "channel", ""): (-0.5, 0.5),
    ("saturation", "input", "u", "hard, two limits"): (-0.3, 0.3),
    ("hysteresis", "inside", "y", "Bouc-Wen"): (-0.1, 0.1),
    ("hysteresis", "inside", "y", "Bouc-Wen force"): (-0.05, 0.05),
    ("hysteresis", "input", "u", "Bouc-Wen, sharp"): (-0.3, 0.3),
    ("hysteresis", "output", "y", "Bouc-Wen, sharp"): (-0.3, 0.3),
    ("hysteresis", "inside", "y", "Bouc-Wen, sharp"): (-0.1, 0.1),
    ("hardening_spring", "inside", "y", ""): (-0.02, 0.02),
    ("coulomb_friction", "inside", "y", ""): (-0.02, 0.02),
    ("stribeck_friction", "inside", "y", ""): (-0.02, 0.02),
    ("quadratic_drag", "inside", "y", ""): (-0.02, 0.02),
    ("inertia", "inside", "y", ""): (-0.05, 0.05),
    ("coulomb_friction", "force", "y", "smooth"): (-0.2, 0.2),
    ("hardening_spring", "force", "y", ""): (-0.1, 0.1),
    ("quadratic_spring", "inside", "y", ""): (-0.02, 0.02),
    ("gravity", "inside", "y", ""): (-0.05, 0.05),
    ("end_stop", "inside", "y", "upper"): (0.0, 0.3),
    ("sqrt_outflow", "inside", "y", ""): (-0.05, 0.05),
    ("channel_friction:temp", "inside", "y", ""): (-0.02, 0.02),
    ("channel_friction:temp", "force", "y", "smooth"): (-0.2, 0.2),
    ("channel_friction:temp", "motion", "y", "holding"): (0.05, 0.5),
    ("stiction", "input", "u", "of a valve"): (0.05, 0.9),
    ("coulomb_friction", "motion", "y", "holding"): (0.05, 0.5),
    ("stiction", "motion", "y", ""): (0.05, 0.5),
    ("end_stop", "motion", "y", "rigid upper"): (0.05, 0.5),
    ("end_stop", "motion", "y", "rigid both sides"): (0.05, 0.5),
    ("output_limit", "sensor", "y", "both sides"): (0.05, 0.5),
    ("absolute_sensor", "sensor", "y", ""): (0.01, 0.05),
}
DISTURBED = ("offset", "periodic_disturbance")  # from the first sample on: no run of these starts at rest
ALONE = ("bilinear_gain", "orifice", "charge_curve")  # tested alone below
SHAPES = {"tau": 0.05, "b": 0.7, "g": 0.9, "d": 1.1, "f": 3.0}


def with_effect(base, effect, coefficient):
    """Add one effect; None where it does not act on this base."""
    name, where, driver, form = effect
    every = [o for closer in (False, True) for o in variants(base, ["temp"], closer=closer)]
    listed = (o for o in every if (o.id, o.where, o.driver) == (name, where, driver))
    found = next((o for o in listed if form in ("", o.effect.form)), None)
    if found is None:
        return None
    added = extend(base, found)
    values = dict(zip(base.symbols, base.theta, strict=True)) | dict.fromkeys(added.coefficients, coefficient)
    values |= {s: SHAPES.get(p, 0.25) for s, p in zip(added.shape, found.shape, strict=True)}
    return added.model.replace(theta=[values[s] for s in added.model.symbols])


def reference(model, size=1.0, n=160):
    """A wave that starts at rest at the operating point."""
    i = np.maximum(np.arange(n) - 8.0, 0.0)
    wave = 0.7 * np.sin(i / 15) + 0.4 * np.sin(i / 6.1) - (0.7 / 15 + 0.4 / 6.1) * i * np.exp(-i / 10)
    return model.operating_point.get(y, 0.0) + size * wave


def temperature(n=160):
    return np.sin(np.maximum(np.arange(n) - 8.0, 0.0) / 25)


def followed(model, law, target, **options):
    """How far the model leaves the reference when the law drives it, once its first command has arrived."""
    u0, y0 = (model.operating_point.get(s, 0.0) for s in (u, y))
    channels = {"temp": temperature(target.size)} if model.channels else {}
    driven = law.run(target, u0, channels, **options)
    return np.abs(model.simulate(driven, y0, channels, u0=u0) - target)[law.preview :].max()


# ---------------------------------------------------------------- the round trip


def test_no_effect_of_the_catalogue_is_missing_here():
    assert {name.partition(":")[0] for name, *_ in EFFECTS} | {*DISTURBED, *ALONE} == set(ns.EFFECTS)


@pytest.mark.parametrize("name", DISTURBED)
def test_a_disturbance_is_followed_once_the_start_is_forgotten(name):
    model = with_effect(BASES["first order"], (name, "output", "t", ""), 0.2)
    law, target = model.compensator(), reference(model)
    assert law.residual() == 0 and law.closed_form
    left = np.abs(model.simulate(law.run(target, 0.0), 0.0, u0=0.0) - target)
    assert left[law.preview] > 0.01 and left[-20:].max() < 1e-9


@pytest.mark.parametrize(
    ("name", "c"), [("bilinear_gain", -0.1), ("bilinear_gain", 0.1), ("orifice", 0.1), ("charge_curve", 0.2)]
)
def test_what_bends_the_newest_input_of_a_base(name, c):
    """Of a product the law divides by the gain where the output is; else it finds the root nearest to its last input."""
    base = BASES["first order"]
    (found,) = (o for o in variants(base) if o.id == name and o.lag == base.delay)
    added = extend(base, found)
    model = added.model.replace(theta=[*base.theta, *[c] * len(added.coefficients), *[0.25] * len(added.shape)])
    law = model.compensator()
    assert law.residual() == 0 and law.closed_form == (name == "bilinear_gain")
    assert followed(model, law, reference(model)) < 1e-9


@pytest.mark.parametrize("name", ("first order", pytest.param("continuum", marks=pytest.mark.long)))
@pytest.mark.parametrize(
    "effect", some(sorted(EFFECTS), every=6), ids=lambda e: "-".join(filter(None, e)).replace(" ", "_")
)
def test_every_effect_has_a_law(effect, name):
    name = "second order" if effect[1] == "force" else name  # without zeros a force is an effect inside
    model = with_effect(BASES[name], effect, EFFECTS[effect][1])
    law = model.compensator()
    assert law.residual() == 0 and "r" in map(str, (s.label for s in law.recursion.inputs))
    assert followed(model, law, reference(model, 0.5)) < 1e-9
    written = law.latex()
    assert written.count("{") == written.count("}") and all(bad not in written for bad in ("Root", "1+k", "None"))
    assert law.closed_form == (effect[3] != "soft" and effect[0] != "cubic_gain")


@pytest.mark.parametrize(
    "effect", (("dead_zone", "input", "u", ""), ("backlash", "input", "u", ""), ("backlash", "output", "y", ""))
)
@pytest.mark.parametrize("size", some([1.0, 0.999, 1.04]))
def test_full_effects_are_jumped_over(effect, size):
    model = with_effect(BASES["first order"], effect, size)
    law = model.compensator()
    target = reference(model)
    assert followed(model, law, target) < 1e-9
    still = np.concatenate([target, np.full(60, target[-1])])
    driven = law.run(still, 0.0)
    assert np.abs(np.diff(driven[-50:])).max() < 1e-6  # at rest the input rests: rounding does not make it jump


def test_a_pure_delay_is_a_preview():
    model = with_effect(BASES["first order"], ("input_delay", "input", "u", ""), 1.0)
    law = model.compensator()
    assert law.preview == 2 and followed(model, law, reference(model)) < 1e-9


def test_the_start_is_at_rest():
    """With creep the inner output is not the output."""
    model = with_effect(BASES["continuum"], ("creep", "output", "y", ""), 0.25)
    rest = rest_states(model, 0.3, 5.0)
    assert rest["x"] == pytest.approx(7.0 / 1.25) and rest["w1"] == rest["w2"] == pytest.approx(rest["x"])
    assert np.abs(model.simulate(np.full(30, 0.3), 5.0, u0=0.3) - 5.0).max() < 1e-9
    law = model.compensator()
    assert law.start(5.0, 0.3) == {"m": 0.3, "r": 5.0, "y": 5.0} | rest
    assert law.run(np.full(30, 5.0), 0.3) == pytest.approx(np.full(30, 0.3))
    moving = 5.0 + reference(model) + 2.0
    driven = law.run(moving, 0.3)
    assert np.abs(model.simulate(driven, 5.0, u0=0.3) - moving)[1:].max() < 1e-9


# ---------------------------------------------------------------- the physical Bouc-Wen model


def test_the_law_of_the_physical_model():
    model = bouc_wen()
    law = model.compensator()
    assert law.closed_form and law.residual() == 0 and law.preview == 0 and len(law.branches) == 2
    memory, rise = d * m[k - 1] - r[k - 1], r[k] - r[k - 1]
    for s, branch in zip((-1, 1), law.branches, strict=True):
        assert sp.simplify(branch.solution - m[k - 1] - rise / (a + b * s * memory + c * sp.Abs(memory))) == 0
    assert isinstance(law.law, sp.Piecewise) and law.recursion.updates == ((m[k], law.law),)
    written = law.latex()
    assert r"m_{k} &= \begin{cases} m_{k-1} + \frac{r_{k} - r_{k-1}}{" in written
    assert r"\text{if }r_{k} < r_{k-1}" in written
    target = 40 * np.sin(np.arange(2000) / 160)
    assert np.abs(model.simulate(law.run(target, 0.0), 0.0, u0=0.0) - target).max() < 1e-9
    assert "exactly one m[k] for every r[k] where" in law.checked
    counted = law.check(target, 0.0)
    assert counted.good and counted.points == 200 and "exactly one solution at each" in str(counted)


def test_the_law_tracks_the_plant():
    u_values = ns.plants.filtered_noise(N=20_000, seed=3)
    record = ns.Record.from_arrays(u_values, ns.plants.bouc_wen(u_values), Ts=1e-3)
    model = bouc_wen((1, 0, 0, 2)).fit(record, method="free_run")
    target = 40 * np.sin(2 * np.pi * 1e-3 * np.arange(5000))
    law = model.compensator()
    driven = law.run(target, 0.0)
    assert ns.mape(target, ns.plants.bouc_wen(driven)) < 0.03 and ns.nsavi(driven, target) < 1.15
    assert law.check().good and law.check().points == 200  # the identified range is known


def test_where_branches_overlap_it_is_said():
    """Far outside, a + b s h + c |h| changes its sign: the output turns back."""
    model = bouc_wen((0.7, 0.05, 0.0, 1.6))
    law = model.compensator()
    counted = law.check(40 * np.sin(np.arange(400) / 30), 0.0)
    assert not counted.good and counted.several > 0.05 and counted.none > 0.2 and "several at" in str(counted)


# ---------------------------------------------------------------- jumps, saturation, limits


def test_a_jump_has_regions_with_none_and_with_two():
    model = ns.NARX.from_terms(["y[k-1]", "phi2[k-1]*y[k-1]", "phi1[k-1]"], [1.0, 0.1, 0.5])
    model = model.replace(info=Info(ranges={"u": (-1, 1), "y": (-1, 1)}))
    law = model.compensator()
    assert law.residual() == 0
    assert "two solutions while" in law.checked and "no solution while" in law.checked
    counted = law.check()
    assert 0.1 < counted.none < 0.9 and 0.1 < counted.several < 0.9
    with pytest.raises(Unreachable, match=r"cannot be reached at sample 11: r = .* at most .*no solution while"):
        law.run(0.5 * np.sin(np.arange(100) / 20), 0.0)


def saturated(size=1.0, form="hard"):
    return with_effect(BASES["static"], ("saturation", "input", "u", form), size)


@pytest.mark.parametrize("form, share", (("hard", 1.0), ("soft", 1.0), pytest.param("hard", 1.03, marks=more)))
def test_a_reference_out_of_reach_is_an_error_unless_clipped(form, share):
    model = saturated(share, form)
    law = model.compensator()
    target = reference(model, 0.3)
    assert followed(model, law, target) < 1e-9
    target = reference(model, 0.6)
    with pytest.raises(Unreachable, match=r"at sample (\d+): r = .*at (most|least) .* missed.*--clip") as error:
        law.run(target, 0.4)
    first = error.value.at
    reach = 2.0 + 1.5 * 0.25
    assert abs(target[first] - 2.0) > reach - 2.0 - 1e-9 > abs(target[first - 1] - 2.0) - 1e-9
    with pytest.warns(UserWarning, match=r"misses the reference in .* of the samples, first at sample"):
        driven = law.run(target, 0.4, clip=True)
    out = model.simulate(driven, 2.0, u0=0.4)
    nearest = np.clip(target, 2.0 - 1.5 * 0.25, reach)
    assert np.all(np.isfinite(driven)) and np.abs(out - nearest).max() < 1e-6
    found = law.follow(target, 0.4)
    assert np.array_equal(found.missed, np.abs(out - target) > 1e-6 * np.ptp(target)) and found.y == pytest.approx(out)


def test_limits_and_rate_hold_the_input_and_the_law_recovers():
    model = BASES["continuum"]
    law = model.compensator()
    target = reference(model, 1.0, 400)
    free = law.run(target, 0.3)
    for options in ({"limits": (-0.5, 0.9)}, {"rate": 0.05}, {"limits": (-0.5, 0.9), "rate": 0.2}):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            driven = law.run(target, 0.3, **options)
        assert [w for w in said if "the input is at a limit of the actuator in" in str(w.message)]
        low, high = options.get("limits", (-9, 9))
        assert low <= driven.min() and driven.max() <= high
        assert np.abs(np.diff(driven)).max() <= options.get("rate", 9) + 1e-12
        found = law.follow(target, 0.3, **options)
        assert np.array_equal(found.m, driven) and 0 < found.held.mean() < 1
        out = model.simulate(driven, -2.0, u0=0.3)
        assert found.y == pytest.approx(out, abs=1e-9)
        assert (np.abs(out - target) < 1e-9).mean() > 0.2
        # What a limit took away is made up for: without the model beside it a law of this kind is off for ever.
        assert not found.missed[1:][~found.held[:-1]].any()
    wide = {"limits": (-9, 9), "rate": 5}
    assert law.run(target, 0.3, **wide) == pytest.approx(free, abs=1e-9)
    for bad in ({"limits": (1, -1)}, {"rate": 0}, {"rate": -1}, {"limits": (np.nan, 1)}):
        with pytest.raises(ModelError, match="Limits are a lower and a higher"):
            law.run(target, 0.3, **bad)


def test_an_identified_inverse_has_limits_too():
    inverse = ns.NARX.from_terms(["u[k-1]", "breve_phi1[k-1]"], (1.0, 1.2), input="y", output="u", lead=2)
    law = inverse.compensator()
    target = np.sin(np.arange(90) / 9)
    with pytest.warns(UserWarning, match="at a limit"):
        driven = law.run(target, 0.0, limits=(-0.7, 0.8))
    assert driven.min() == -0.7 and driven.max() == 0.8


def test_a_force_beside_the_input_takes_its_way_without_its_delay():
    """Friction of the driven mass passes the zeros of the core, from the newest output on; the law takes it off."""
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-3]", "u[k-4]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01)
    model = with_effect(base, ("coulomb_friction", "force", "y", "smooth"), -0.2)
    assert (model.delay, model.n_u, model.n_y) == (3, 4, 2)
    rng = np.random.default_rng(0)
    driven, found = np.r_[np.zeros(4), np.cumsum(rng.standard_normal(296)) / 4], np.zeros(300)
    s = float(model.theta[-1])
    for i in range(4, 300):
        forces = [driven[i - 3 - j] - 0.2 * np.tanh((found[i - 1 - j] - found[i - 2 - j]) / s) for j in range(2)]
        found[i] = 1.2 * found[i - 1] - 0.4 * found[i - 2] + 0.15 * forces[0] + 0.1 * forces[1]
    np.testing.assert_allclose(model.simulate(driven, 0.0, u0=0.0), found, atol=1e-12)
    law = model.compensator()
    assert "exactly one" in str(law.checked)
    target = reference(model)
    assert followed(model, law, target) < 1e-9


# ---------------------------------------------------------------- numbers, C, LaTeX


LIMITS = {"limits": (-2, 2), "rate": 0.3}


@pytest.mark.parametrize(("name", "limits"), [("backlash", {}), ("delayed", LIMITS)])
def test_every_engine_runs_a_law(name, limits, tmp_path):
    slack = ("backlash", "output", "y", "")
    model = BASES[name] if limits else with_effect(BASES["continuum"], slack, 0.6)
    law = model.compensator()
    recursion = law.limited(**limits) if limits else law.recursion
    given = {str(s.label): 0.3 + 0.4 * np.sin(np.arange(150) / 9) for s in recursion.inputs}
    start = {str(s.label): 0.1 for s in recursion.states}
    runs = [compile(recursion, engine)(given, model.theta, start)["m"] for engine in ENGINES]
    for run in runs[1:]:
        np.testing.assert_allclose(run, runs[0], rtol=1e-9, atol=1e-11)
    if gcc is None:
        pytest.skip("no gcc in PATH")
    (tmp_path / "law.c").write_text(law.export("c", **limits))
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-DLAW_SELF_TEST"]
    subprocess.run([gcc, *flags, str(tmp_path / "law.c"), "-o", str(tmp_path / "law"), "-lm"], check=True)
    done = subprocess.run([str(tmp_path / "law")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_a_law_without_closed_form_says_so():
    model = with_effect(BASES["first order"], ("cubic_gain", "input", "u", ""), -0.2)
    law = model.compensator()
    assert not law.closed_form and compile(law.recursion).engine == "python"
    with pytest.raises(NotInvertible, match=r"cannot be exported: m\[k\] has no closed form"):
        law.export("c")
    with pytest.raises(ModelError, match="no rule for Root"):
        compile(law.recursion, "casadi")({"r": np.ones(5)}, model.theta, {"m": 0.0, "v": 0.0})
    assert "nearest to" in law.latex() and "nearest to m[k-1]" in repr(law)
    assert "nearest to" not in law.internal.latex() and "Derivative" not in law.internal.latex()


def test_an_exponential_of_a_difference_does_not_overflow():
    """exp(-r[k]**2) exp(2 r[k] r[k-1]) is 0 times infinity where exp(-(r[k] - r[k-1])**2) is 1."""
    base = ns.NARX.from_terms(["y[k-1]", "u[k-2]"], [0.7, 0.4], operating_point={u: -1.0, y: 30.0})
    model = with_effect(base, ("stribeck_friction", "inside", "y", ""), 0.01)
    model = with_effect(model, ("coulomb_friction", "motion", "y", "holding, of a speed"), 0.7)
    law = model.compensator()
    target = 30 + np.sin(np.arange(80) / 9)
    start = law.rest_input(30.0, None)
    given, initial = {"r": target}, {"m": start, "free": 30.0, "y": 30.0}
    found = [compile(law.recursion, engine)(given, model.theta, initial)["m"] for engine in ENGINES]
    for run in found:
        np.testing.assert_allclose(run, found[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "value"),
    [
        (("cubic_gain", "input", "u", ""), -0.02),  # a root finder
        (("hysteresis", "output", "u", "Bouc-Wen"), 0.2),
        (("saturation", "input", "u", "soft"), 0.4),
    ],
)
def test_the_derivative_of_a_law_is_the_limit_of_small_errors(effect, value):
    model = with_effect(ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.6, 0.4, 0.3]), effect, value)
    law = model.compensator()
    assert law.staged
    u = np.sin(np.arange(80) / 7)
    trial = Trial.of_input(law, u, 0.0)
    (small,) = trial.error_growth([9], 16)
    exact = law.internal.along(trial.prepared.given["r"][trial.prepared.depth :][:80], 0.0, at=9)
    assert exact[0] == 1 and exact[1] > 0
    np.testing.assert_allclose(exact[:8], small, rtol=1e-5)


def test_a_polynomial_hysteresis_without_a_delay_of_its_own():
    """The newest input in every hysteresis term: each branch is a quadratic equation."""
    model = ns.NARX.from_terms(
        ["y[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]", "phi1[k-1]*u[k-2]"],
        [1.0, 0.7, 0.1, -0.15, 0.02],
    )
    law = model.compensator()
    assert law.closed_form and len(law.branches) == 2 and law.residual() == 0
    assert followed(model, law, reference(model)) < 1e-9 and law.check(reference(model), 0.0).good


def test_what_still_has_no_law():
    fast = next(
        o for o in variants(BASES["first order"]) if o.id == "coulomb_friction" and o.where == "output" and not o.lag
    )
    added = extend(BASES["first order"], fast).model.replace(theta=[0.8, 0.3, 0.1])
    with pytest.raises(
        NotInvertible, match=r"u\[k\] cannot be isolated: the effect coulomb_friction .* only through its sign"
    ):
        added.compensator()
    early = next(
        o
        for o in variants(BASES["first order"])
        if o.effect.form == "Bouc-Wen" and o.driver == "u" and o.where == "output"
    )
    added = extend(BASES["first order"], early).model.replace(theta=[0.8, 0.3, 0.1, 0.7, 0.9])
    assert "1 sample(s) before the linear part" in added.compensator().checked


# ---------------------------------------------------------------- hidden effects on the plant


def distorted(volts):
    """The bench test behind a dead zone of 5 % of the input's range."""
    return ns.plants.bouc_wen(volts - np.clip(volts, -3.75, 3.75))


def test_a_completed_model_has_a_better_law():
    noise = ns.plants.filtered_noise(N=3000, seed=1)
    record = ns.Record.from_arrays(noise, distorted(noise), Ts=1e-3)
    incomplete = bouc_wen((0.7, 0.008, 0.008, 1.6)).fit(record, method="free_run")
    complete = incomplete.add("dead_zone").fit(record)
    target = 40 * np.sin(2 * np.pi * 1e-3 * np.arange(6000))
    before, after = (ns.mape(target, distorted(o.compensator().run(target, 0.0))) for o in (incomplete, complete))
    assert after < before / 5 and after < 0.05


# ---------------------------------------------------------------- the command


def test_compensate_with_limits(run, tmp_path):
    model = with_effect(BASES["first order"], ("dead_zone", "input", "u", ""), 1.0)
    ns.save(model, tmp_path / "model.json")
    rows = "\n".join(f"{0.01 * i:.2f},{z:.9g}" for i, z in enumerate(reference(model)))
    (tmp_path / "ref.csv").write_text("t,r\n" + rows)

    asked = f"compensate {tmp_path}/model.json --reference {tmp_path}/ref.csv --out {tmp_path}/m.csv --m0 0".split()
    code, out, err = run(*asked, "--limits", "-0.8", "0.8", "--rate", "0.5", "--c", tmp_path / "law.c")
    assert code == 0 and "at a limit of the actuator in" in err and "m[k] = Piecewise" in out.replace("\n", " ")
    assert "Checked: exactly one v[k]" in " ".join(out.split()) and "0.8" in (tmp_path / "law.c").read_text()
    driven = ns.read(tmp_path / "m.csv", u="m", y="r").u
    assert driven.max() <= 0.8 and np.abs(np.diff(driven)).max() <= 0.5 + 1e-9
    ns.save(saturated(), tmp_path / "model.json")
    code, _, err = run(*asked)
    assert code == 2 and "cannot be reached at sample" in err and "Traceback" not in err
    code, _, err = run(*asked, "--clip")
    assert code == 0 and "misses the reference" in err


def test_the_stages_are_ordered():
    """What is computed ahead of k is shifted in the recursion, and stands in true time in the law."""
    model = with_effect(BASES["delayed"], ("backlash", "output", "y", ""), 0.5)
    law = model.compensator()
    assert [left for left, _ in law.updates] == [x[k + 2], m[k], signal("p")[k + 2]]
    assert [left for left, _ in law.recursion.updates] == [x[k], m[k], signal("p")[k]]
    assert {s.indices[0] for s in samples(law.recursion.updates[0][1], r)} == {k + 2}
    assert law.preview == 2 and law.lines()[0].startswith("x[k+2] = Piecewise")


@pytest.mark.parametrize("pole, unstable", [(1.05, True), (0.95, False), (1.0, False)])
def test_an_unstable_model_is_told(pole, unstable):
    """Its law is exact, and no input that was computed ahead holds it."""
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [pole, 0.1], Ts=1.0).compensator()
    reference = 1 + 0.3 * np.sin(np.arange(600) / 60)
    _, said = told(law, reference, (1 - pole) / 0.1)
    assert any("the model is unstable" in text for text in said) == unstable


@pytest.mark.parametrize(
    "options, why",
    [
        (("--limits", "1", "0"), "a lower and a higher number"),
        (("--rate", "-1"), "a rate is a positive number"),
        (("--share", "3"), "share must be above 0 and at most 1"),
        (("--share", "0"), "share must be above 0 and at most 1"),
    ],
)
def test_what_no_actuator_has_is_refused_without_a_reference_too(run, tmp_path, options, why):
    ns.save(BASES["first order"], tmp_path / "model.json")
    code, _, err = run("compensate", tmp_path / "model.json", *options)
    assert code == 2 and why in " ".join(err.split())


def test_an_input_before_the_start_is_within_the_limits():
    law, target = BASES["first order"].compensator(), np.linspace(0.0, 0.5, 40)
    assert law.run(target, 0.8, limits=(-1.0, 0.8)).max() <= 0.8
    with pytest.raises(ns.errors.ModelError, match=r"m0 = 5, is outside the limits -1 to 0\.8"):
        law.run(target, 5.0, limits=(-1.0, 0.8))
