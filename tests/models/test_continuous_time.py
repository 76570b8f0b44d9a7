"""Differential equations behind sampled models: exact where the input is held, intervals that hold the truth."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from sampling import more
from scipy.linalg import expm

import narx_sym as ns
from narx_sym.models.continuous_time import NORMAL
from narx_sym.models.extend import Variant, extend, find, variants

EVERY = [*variants(ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], Ts=0.01), ["w"])]
FIRST = {v.id: i for i, v in reversed([*enumerate(EVERY)])}.values()

# -- machines, sampled by a matrix exponential: nothing of the package ---------------------------------------------


def held(A: np.ndarray, B: np.ndarray, u: np.ndarray, Ts: float, late: float = 0.0) -> np.ndarray:
    """First state of x' = A x + B u(t - late) at k Ts, for an input that is held between samples."""
    n = len(A)

    def over(T: float) -> tuple[np.ndarray, np.ndarray]:
        whole = expm(np.block([[A, B[:, None]], [np.zeros((1, n + 1))]]) * T)
        return whole[:n, :n], whole[:n, n]

    steps = int(late // Ts)
    rest = late - steps * Ts
    (P, p), (Q, q) = over(rest), over(Ts - rest)
    x, y = np.zeros(n), np.zeros(u.size)
    for k in range(u.size - 1):
        old, new = (u[k - steps - 1] if k > steps else 0.0), (u[k - steps] if k >= steps else 0.0)
        x = Q @ (P @ x + p * old) + q * new
        y[k + 1] = x[0]
    return y


def rubbing(m: float, d: float, F: float, slow: float, u: np.ndarray, Ts: float, parts: int = 10) -> np.ndarray:
    """Position of m v' + d v = u - F tanh(v / slow), by Runge and Kutta's method in parts of a sample."""
    h, v, x, y = Ts / parts, 0.0, 0.0, np.zeros(u.size)

    def rate(v: float, push: float) -> float:
        return (push - d * v - F * np.tanh(v / slow)) / m

    for k in range(u.size - 1):
        for _ in range(parts):
            a = rate(v, u[k])
            b = rate(v + h / 2 * a, u[k])
            c = rate(v + h / 2 * b, u[k])
            e = rate(v + h * c, u[k])
            x += h * (v + h / 6 * (a + b + c))
            v += h / 6 * (a + 2 * b + 2 * c + e)
        y[k + 1] = x
    return y


def steps(rng: np.random.Generator, n: int, hold: int) -> np.ndarray:
    return np.repeat(rng.uniform(-1, 1, n // hold + 1), hold)[:n]


def recorded(u: np.ndarray, y: np.ndarray, Ts: float, rng: np.random.Generator, noise: float) -> ns.Record:
    return ns.Record.from_arrays(u, y + noise * y.std() * rng.standard_normal(y.size), Ts=Ts)


def fitted(terms: list[str], record: ns.Record, **options: object) -> ns.NARX:
    first = ns.NARX.from_terms(terms).fit(record, **options)
    return first.fit(record, method="free_run", **options)


def oscillator(rng: np.random.Generator) -> tuple[ns.NARX, ns.Record, dict[str, float]]:
    m, f, zeta = rng.uniform(0.5, 3), rng.uniform(1, 3), rng.uniform(0.1, 0.6)
    w = 2 * np.pi * f
    d, k = 2 * zeta * w * m, m * w**2
    u, Ts = steps(rng, 1500, 7), 1 / (f * 25)
    y = held(np.array([[0, 1], [-k / m, -d / m]]), np.array([0, 1 / m]), u, Ts)
    record = recorded(u, y, Ts, rng, 0.02)
    true = {"mass": m, "viscous friction": d, "stiffness": k, "natural frequency": f, "damping ratio": zeta}
    return fitted(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], record), record, true | {"gain": 1 / k}


def thermal(rng: np.random.Generator) -> tuple[ns.NARX, ns.Record, dict[str, float]]:
    tau, K, Ts = rng.uniform(5, 50), rng.uniform(-3, 3), 1.0
    u, late = steps(rng, 1200, 20), rng.uniform(2, 3)  # between two samples
    record = recorded(u, held(np.array([[-1 / tau]]), np.array([K / tau]), u, Ts, late), Ts, rng, 0.02)
    model = fitted(["y[k-1]", "u[k-3]", "u[k-4]"], record)
    return model, record, {"time constant": tau, "gain": K, "dead time": late}


def delayed(rng: np.random.Generator) -> tuple[ns.NARX, ns.Record, dict[str, float]]:
    fast, K, Ts, steps_late = rng.uniform(3, 6), rng.uniform(0.5, 3), 0.1, int(rng.integers(1, 6))
    slow = fast * rng.uniform(2, 4)
    fast, slow = fast * Ts, slow * Ts
    u, a, b = steps(rng, 2000, 15), 1 / fast, 1 / slow
    y = held(np.array([[0, 1], [-a * b, -a - b]]), np.array([0, K * a * b]), u, Ts, steps_late * Ts)
    record = recorded(u, y, Ts, rng, 0.01)
    late = steps_late + 1
    model = fitted(["y[k-1]", "y[k-2]", f"u[k-{late}]", f"u[k-{late + 1}]"], record)
    found = {"time constant": slow, "gain": K, "natural frequency": np.sqrt(a * b) / 2 / np.pi}
    return model, record, found | {"dead time": steps_late * Ts}


def rubbing_axis(Ts: float, more: list[str], values: list[float]) -> ns.Model:
    """An axis that integrates, with smooth friction: its pole, half of B(1), further coefficients, c and s."""
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]", *more], Ts=Ts)
    a1, a2, *_ = base.symbols
    (form,) = [f for f in find("coulomb_friction")[0] if f.form == "smooth"]
    wide = extend(base.replace(constraints=[sp.Eq(a1 + a2, 1)]), Variant(form, "inside", "y")).model
    pole, half, *others = values
    return wide.replace(theta=[1 + pole, -pole, half, half, *others], Ts=Ts)


def friction(rng: np.random.Generator) -> tuple[ns.Model, ns.Record, dict[str, float]]:
    m, d, F, Ts = rng.uniform(0.5, 2), rng.uniform(2, 6), rng.uniform(0.1, 0.3), 0.0025
    u, slow = 1.5 * steps(rng, 4000, 80), 0.2 / d
    record = recorded(u, rubbing(m, d, F, slow, u, Ts), Ts, rng, 0.05)
    p = 1 - d / m * Ts
    B = (1 - p) * Ts / d
    begin = rubbing_axis(Ts, [], [p, B / 2, -F * B, slow * Ts])
    true = {"mass": m, "viscous friction": d, "Coulomb friction": F, "speed at which friction is reached": slow}
    return begin.fit(record, method="free_run"), record, true


MACHINES = [oscillator, thermal, delayed, friction]


def machine(seed: int) -> tuple[ns.Model, ns.Record, dict[str, float]]:
    return MACHINES[seed % len(MACHINES)](np.random.default_rng(seed))


def misses(seed: int) -> dict[str, float]:
    """How many standard errors each quantity is off; one without an error must be exact."""
    model, record, true = machine(seed)
    found = model.continuous(records=record)
    assert found.exact and {q.name for q in found.quantities} >= set(true)
    off = {n: (found[n].value - v, found[n].error) for n, v in true.items()}
    assert all(abs(by) < 1e-12 for by, error in off.values() if not error)
    return {n: float(by / error) for n, (by, error) in off.items() if error}


@pytest.mark.parametrize("seed", range(len(MACHINES)))
def test_quantities_of_simulated_machines(seed: int) -> None:
    assert max(map(abs, misses(seed).values())) < 4


@pytest.mark.more
def test_intervals_hold_the_truth() -> None:
    off = [abs(z) for seed in range(100, 140) for z in misses(seed).values()]
    assert 0.85 <= np.mean([z < NORMAL for z in off]) <= 0.99
    assert max(off) < 5


# -- exact, without noise --------------------------------------------------------------------------------------


def test_a_held_input_gives_back_the_differential_equation() -> None:
    m, d, k, Ts = 2.0, 3.0, 50.0, 0.02
    u = steps(np.random.default_rng(0), 400, 5)
    y = held(np.array([[0, 1], [-k / m, -d / m]]), np.array([0, 1 / m]), u, Ts)
    model = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"]).fit(ns.Record.from_arrays(u, y, Ts=Ts))
    found = model.continuous()
    for name, value in {"m": m, "d": d, "k": k, "K": 1 / k, "T_z": 0.0}.items():
        assert found[name].value == pytest.approx(value, rel=1e-7, abs=1e-9)
    y_, t = sp.Function("y"), sp.Symbol("t", real=True)
    m_, d_, k_, T_z = sp.symbols("m d k T_z")
    u_ = sp.Function("u")(t)
    left = m_ * y_(t).diff(t, 2) + d_ * y_(t).diff(t) + k_ * y_(t)
    assert sp.simplify(found.equation.lhs - left) == 0
    assert sp.simplify(found.equation.rhs.doit() - (u_ + T_z * u_.diff(t))) == 0
    assert "\\frac{d^{2}}{d t^{2}}" in found.latex() and found._repr_latex_().startswith("$")


def test_the_time_constant_is_a_logarithm() -> None:
    model = ns.NARX.from_terms(["y[k-1]", "u[k-3]"], theta=[0.9, 0.2], Ts=0.1)
    found = model.continuous(units={"u": "W", "y": "K"})
    p = sp.Symbol("p_1")
    assert sp.simplify(found["time constant"].expression.subs(sp.Float(0.1), sp.Rational(1, 10)) + 0.1 / sp.log(p)) == 0
    assert found["gain"].value == pytest.approx(2.0) and found["gain"].unit == "K/W"
    assert found["dead time"].value == pytest.approx(0.2) and found["dead time"].error != found["dead time"].error
    assert found.exact and found.to_dict()["quantities"][0]["low"] is None
    with pytest.raises(ns.ModelError, match="There is no quantity"):
        found["mass"]


def test_without_zeros_the_mean_lag_tells_the_delay() -> None:
    """A dead time between two samples of a mass: three samples of the input act; the delay is that of slow motion."""
    m, d, k, Ts, late = 1.0, 1.0, 40.0, 0.02, 0.033
    u = steps(np.random.default_rng(1), 600, 6)
    y = held(np.array([[0, 1], [-k / m, -d / m]]), np.array([0, 1 / m]), u, Ts, late)
    terms = ["y[k-1]", "y[k-2]", "u[k-2]", "u[k-3]", "u[k-4]"]
    found = ns.NARX.from_terms(terms).fit(ns.Record.from_arrays(u, y, Ts=Ts)).continuous()
    assert not found.exact and "samples of the input act" in found.notes[0]
    assert found["dead time"].value == pytest.approx(late, abs=1e-4)
    assert found["mass"].value == pytest.approx(m, rel=1e-6)


def test_what_is_no_differential_equation_is_refused() -> None:
    with pytest.raises(ns.ModelError, match="alternates from sample to sample"):
        ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[-0.7, 1.0], Ts=0.1).continuous()
    with pytest.raises(ns.ModelError, match="sampling time"):
        ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.7, 1.0]).continuous()
    with pytest.raises(ns.ModelError, match="parameter values"):
        ns.NARX.from_terms(["y[k-1]", "u[k-1]"], Ts=0.1).continuous()
    with pytest.raises(ns.ModelError, match="steady input does not act"):
        ns.NARX.from_terms(["y[k-1]", "phi1[k-1]"], theta=[0.7, 1.0], Ts=0.1).continuous()
    lag = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.7, 1.0], Ts=0.1)
    with pytest.raises(ns.ModelError, match="depends on the internal state"):
        (lag >> lag).continuous()
    faded = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], theta=[0.6, 0.16, 1.0], Ts=0.1)  # poles 0.8 and -0.2
    with pytest.raises(ns.ModelError, match="alternates"):
        ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], theta=[0.2, 0.48, 1.0], Ts=0.1).continuous()  # 0.8 and -0.6
    found = faded.continuous()
    assert "decays" in found.notes[0] and found["time constant"].value == pytest.approx(-0.1 / np.log(0.8))


# -- scale and units -------------------------------------------------------------------------------------------


AXIS = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], theta=[1.9, -0.9, 0.01], Ts=0.01)


@pytest.mark.parametrize("scale", [{"u": (35.15, "N/V")}, {"u": "35.15 N/V"}, "u=35.15N/V", "35.15N/V"])
def test_a_scale_turns_the_input_into_newtons(scale: object) -> None:
    found = AXIS.continuous(scale=scale, units={"y": "m"})
    plain = AXIS.continuous(units={"u": "V", "y": "m"})
    assert (found["mass"].unit, plain["mass"].unit) == ("kg", "V s²/m")
    assert found["viscous friction"].unit == "N s/m" and found["integrator gain"].unit == "m/(V s)"
    assert found["mass"].value == pytest.approx(35.15 * plain["mass"].value)
    assert plain["viscous friction"].value == pytest.approx((1 - 0.9) * 0.01 / 0.01)


@pytest.mark.parametrize(
    "scale", ["35", "N/V", "-3 N/V", {"y": "3 N/V"}, {"u": (1,)}, "3 N", {"u": ("x", "N/V")}, "3 N/A"]
)
def test_a_scale_that_cannot_be_read_is_refused(scale: object) -> None:
    with pytest.raises(ns.ModelError, match="per A, but the input is in V" if scale == "3 N/A" else "scale"):
        AXIS.continuous(scale=scale, units={"u": "V"})


# -- effects: forces as a test at constant speed measures them ---------------------------------------------------


def with_effect(
    effect: str, form: str, where: str, values: list[float], base: ns.Model = AXIS, driver: str = "y", **more: object
) -> ns.Model:
    (one,) = [f for f in find(effect)[0] if f.form == form]
    wide = extend(base, Variant(one, where, driver, **more)).model
    return wide.replace(theta=[*base.theta, *values])


def speed(model: ns.Model, push: float) -> float:
    y = model.simulate(np.full(4000, push), y0=0.0)
    return float(y[-1] - y[-2]) / model.Ts


@pytest.mark.parametrize(
    ("form", "where", "values"),
    [("", "inside", [-0.002]), ("smooth", "inside", [-0.002, 1e-5]), ("holding", "motion", [1.0, 0.002])],
)
@pytest.mark.parametrize("push", [1.0, -1.0])
def test_friction_is_the_force_that_steady_speeds_lack(form: str, where: str, values: list[float], push: float) -> None:
    model = with_effect("coulomb_friction", form, where, values)
    found = model.continuous()
    d, F = found["viscous friction"].value, found["Coulomb friction"].value
    assert F == pytest.approx(0.2)
    assert push - d * speed(model, push) == pytest.approx(F * np.sign(push), rel=1e-6)


def test_friction_beside_the_input_has_the_unit_of_the_input() -> None:
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], theta=[1.9, -0.9, 0.006, 0.004], Ts=0.01)
    model = with_effect("coulomb_friction", "smooth", "force", [-0.3, 1e-5], base)
    found = model.continuous(scale="10 N/V", units={"y": "m"})
    assert found["Coulomb friction"].value == pytest.approx(3.0)
    assert found["Coulomb friction"].in_input == pytest.approx(0.3)
    assert found["v_C"].value == pytest.approx(1e-3) and found["v_C"].unit == "m/s"
    assert 1.0 - found["viscous friction"].value / 10 * speed(model, 1.0) == pytest.approx(0.3, rel=1e-6)


def test_drag_stribeck_and_uneven_speed() -> None:
    drag = with_effect("quadratic_drag", "", "inside", [-0.5])
    found, v = drag.continuous(), speed(drag, 1.0)
    assert found["d"].value * v + found["quadratic drag"].value * v**2 == pytest.approx(1.0, rel=1e-6)
    uneven = with_effect("uneven_speed", "", "motion", [-0.1])
    found, v = uneven.continuous(), speed(uneven, -1.0)
    assert (found["d"].value + found["d_f"].value) * v == pytest.approx(-1.0, rel=1e-6)
    assert found["mean viscous friction"].value == pytest.approx(found["d"].value + found["d_f"].value / 2)
    fast = with_effect("stribeck_friction", "", "inside", [-0.002, 0.02])
    assert fast.continuous()["Stribeck speed"].value == pytest.approx(2.0)
    assert fast.continuous()["Stribeck friction"].value == pytest.approx(0.2)


def test_a_spring_holds_what_pushes_it() -> None:
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], theta=[1.8, -0.85, 0.05], Ts=0.01)
    model = with_effect("hardening_spring", "", "inside", [-0.02], base)
    found, y = model.continuous(), model.simulate(np.full(3000, 0.5), y0=0.0)[-1]
    assert found["k"].value * y + found["cubic stiffness"].value * y**3 == pytest.approx(0.5, rel=1e-6)


def test_effects_before_and_behind_have_widths_and_times() -> None:
    lag = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2], Ts=0.1)
    cases = {
        ("backlash", "", "input"): ([1.0, 0.3], "half-width of the play", 0.3, "V"),
        ("saturation", "hard", "input"): ([1.0, 0.7], "limit of the saturation", 0.7, "V"),
        ("dead_zone", "", "input"): ([1.0, 0.1], "half-width of the dead zone", 0.1, "V"),
        ("rate_limit", "", "input"): ([1.0, 0.05], "limit of speed", 0.5, "V/s"),
        ("rate_dependence", "", "input"): ([1.0, 0.4], "time constant of the actuator", 0.4, "s"),
    }
    for (effect, form, where), (values, name, value, unit) in cases.items():
        one = with_effect(effect, form, where, values, lag, "u").continuous(units={"u": "V", "y": "m"})[name]
        assert (one.value, one.unit, one.effect) == (pytest.approx(value), unit, effect)
    creeps = with_effect("creep", "", "output", [0.2, 5.0], lag).continuous()
    assert creeps["shortest time constant of creep"].value == 5.0 and creeps["share of creep"].value == 0.2
    slack = with_effect("backlash", "", "output", [1.0, 0.3], lag).continuous(units={"u": "V", "y": "m"})
    assert slack["half-width of the play"].unit == "m"


@pytest.mark.parametrize(
    ("form", "name", "at"),
    [
        ("of a first lag, spilling over", "upper end stop of the first lag", 3.5),
        ("of a first lag, lower", "lower end stop of the first lag", 2.5),
    ],
)
def test_the_stop_of_a_first_lag_has_the_unit_of_the_input(form: str, name: str, at: float) -> None:
    """An upper tank spills over where an input at rest of that size would bring it."""
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.9, 0.3], operating_point={"u": 3.0, "y": 9.0}, Ts=4.0)
    added = extend(base, next(v for v in variants(base) if v.effect.id == "end_stop" and v.effect.form == form))
    sizes = {**dict.fromkeys(added.coefficients, 0.9), **dict(zip(added.shape, (0.5, 120.0), strict=True))}
    found = added.model.replace(theta=[0.9, 0.3, *(sizes[s] for s in added.model.symbols[2:])]).continuous()
    assert found[name].value == pytest.approx(at) and found[name].unit == found["gain"].unit.partition("/")[2].strip(
        "()"
    )
    assert found["time constant of the first lag"].value == pytest.approx(120.0)


def test_a_slack_takes_its_part_of_the_friction_that_slips() -> None:
    """Of 5 N, 0.8 times the half that the band hides: 3 N are passed on, over a slack of half of 0.4 mm."""
    way = ns.NARX.from_terms(["u[k]", "u[k-1]"], [2.0, -1.9], Ts=0.01)
    rubs = with_effect("coulomb_friction", "elastic", "output", [5.0, 0.4], way, "u")
    slack = with_effect("backlash", "of what rubs", "friction", [0.8, 0.5], rubs, "friction")
    found = slack.continuous(units={"u": "mm", "y": "N"})
    told = {n: (found[n].value, found[n].unit) for n in ("Coulomb friction", "half-width of the slack")}
    assert told == {
        "Coulomb friction": (pytest.approx(3.0), "N"),
        "half-width of the slack": (pytest.approx(0.2), "mm"),
    }
    assert slack.simulate(np.r_[np.zeros(9), np.full(9, 3.0)], 0.0)[-1] == pytest.approx(0.3 + 3.0)
    spring = with_effect("coulomb_friction", "viscoelastic", "output", [5.0, 0.4, 0.3, 0.1], way, "u").continuous()
    assert [spring[f"Coulomb friction {n}"].value for n in ("up", "down")] == [2.0, 1.5]


def test_a_width_stays_positive() -> None:
    """tanh(x / s) with -s and -c is the same, and no friction that drives."""
    model, record, _ = machine(123)
    mirrored = model.fit(record, method="free_run")
    assert model.theta[-1] > 0 and mirrored.theta[-1] > 0


def test_a_width_from_an_operating_point_says_so() -> None:
    lag = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2], Ts=0.1, operating_point={"u": 2.0, "y": 4.0})
    model = with_effect("saturation", "hard, two limits", "input", [1.0, 0.7, 0.5], lag, "u")
    found = model.continuous()
    assert found["upper limit of the saturation"].value == pytest.approx(2.7)
    assert found["lower limit of the saturation"].value == pytest.approx(1.5)
    raw = with_effect("saturation", "hard, two limits", "input", [1.0, 0.7, 0.5], lag, "u", raw=True).continuous()
    assert raw["upper limit of the saturation"].value == pytest.approx(0.7)


@pytest.mark.parametrize(
    "one", [pytest.param(v, id=str(v), marks=[] if i in FIRST else more) for i, v in enumerate(EVERY)]
)
def test_no_effect_is_told_per_sample(one: Variant) -> None:
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], theta=[1.8, -0.82, 0.02, 0.01], Ts=0.01)
    wide = extend(base, one).model
    model = wide.replace(theta=[*base.theta, *([0.5] * (len(wide.symbols) - 4))])
    found = model.continuous(units={"u": "V", "y": "m"})
    effects = [q for q in found.quantities if q.effect]
    assert effects and not any("sample" in q.unit or "driver" in q.unit for q in effects)
    brought = set(model.effects[0].symbols.values())
    assert brought <= {s for q in effects for s in q.expression.free_symbols}  # each parameter stands in some quantity
    assert len({str(q.symbol) for q in found.quantities}) == len(found.quantities)
