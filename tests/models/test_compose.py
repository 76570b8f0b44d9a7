"""Models put together give what the parts give one after the other, and are models like any other."""

import numpy as np
import pytest
import sympy as sp
from sampling import more

import narx_sym as ns
from narx_sym.errors import ModelError, NarxError
from narx_sym.fit.simulate import rest_states
from narx_sym.models import compose
from narx_sym.models.analysis import rest_map, steady_state, ubar, ybar
from narx_sym.models.extend import extend, find, variants
from narx_sym.symbolic.signals import k, u, y

N = np.arange(150)
ADDED = ("backlash", "saturation", "dead_zone", "deadband", "offset", "hysteresis", "creep")


def part(rng, delay=None):
    """A random stable model, with an operating point, a channel or an effect now and then."""
    a, b, c = (
        float(rng.uniform(-0.5, 0.8)),
        float(rng.uniform(0.3, 1.2)) * (-1) ** rng.integers(2),
        float(rng.uniform(-0.1, 0.1)),
    )
    d = int(rng.integers(0, 3)) if delay is None else delay
    terms, theta = (
        ([f"u[k-{d}]"], [b]),
        (["y[k-1]", f"u[k-{d}]"], [a, b]),
        (["y[k-1]", "y[k-2]", f"u[k-{d}]", f"u[k-{d + 1}]"], [a, -0.2, b, b / 3]),
        (["y[k-1]", f"phi1[k-{d}]", f"phi2[k-{d + 1}]*phi1[k-{d + 1}]*u[k-{d + 1}]"], [1.0, b, c]),
        (["y[k-1]", f"u[k-{d}]", f"u[k-{d}]**2"], [a, b, c / 4]),
        (["y[k-1]", f"u[k-{d}]", "w[k-1]"], [a, b, 0.2]),
    )[rng.integers(6)]
    point = {"u": float(rng.uniform(-1, 1)), "y": float(rng.uniform(-1, 1))} if rng.random() < 0.3 else None
    model = ns.NARX.from_terms(
        terms, theta, channels=["w"] if "w[k-1]" in terms else [], operating_point=point, Ts=0.01
    )
    if rng.random() < 0.35:
        listed = [v for v in variants(model) if v.id in ADDED and not v.raw and v.where != "sensor"]
        added = extend(model, listed[rng.integers(len(listed))])
        sizes = {
            s: 0.1 if s in added.coefficients else float(rng.uniform(0.1, 0.4))
            for s in added.coefficients + added.shape
        }
        model = added.model.replace(theta=[*theta, *(sizes[s] for s in added.model.symbols[len(theta) :])], Ts=0.01)
    return model


def start_of(whole, name, u0, y0, channels):
    """What a state of the whole is before the start."""
    return rest_states(whole, u0, y0, channels)[name]


def hand(kind, a, b, whole, source, channels, u0, y0):
    """The run of the whole, by the runs of its parts."""
    first = {n: c[0] for n, c in channels.items()}

    def run(model, x, begin, before):
        return model.simulate(x, begin, {n: channels[n] for n in model.channels}, u0=before, warn=False)

    held = start_of(whole, "y_1", u0, y0, first)
    if kind == "series":
        return run(b, run(a, source, held, u0), y0, held)
    if kind == "parallel":
        return run(a, source, held, u0) + run(b, source, y0 - held, u0)
    made = run(whole, source, y0, u0)  # around a loop: its own output, once through both
    return run(a, source - run(b, made, held, y0), y0, u0 - held)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("seed", [*range(6), *(pytest.param(i, marks=more) for i in range(6, 500))])
def test_a_whole_is_what_its_parts_do_in_turn(seed, tmp_path):
    rng = np.random.default_rng(seed)
    kind = ("series", "parallel", "feedback")[seed % 3]
    a, b = part(rng, int(rng.integers(1, 3)) if kind == "feedback" else None), part(rng)
    if kind == "feedback":
        b = ns.NARX.from_terms(["y[k-1]", "u[k]"], [0.3, float(rng.uniform(-0.3, 0.3))], Ts=0.01)
    at_once = a.recursion.graph.delays(a.input)[y] == 0
    if kind == "feedback" and at_once:  # through an effect beside the core
        with pytest.raises(ModelError, match="Algebraic loop"):
            a.feedback(b)
        return
    whole = {"series": lambda: a >> b, "parallel": lambda: a + b, "feedback": lambda: a.feedback(b)}[kind]()
    source = 0.4 * np.sin(2 * np.pi * N / 70 + rng.uniform(0, 6)) + 0.1 * np.sin(2 * np.pi * N / 23)
    channels = {"w": np.cos(0.05 * N)} if "w" in whole.channels else {}
    u0 = float(source[0])
    held, y0 = {name: np.full(400, c[0]) for name, c in channels.items()}, 0.0
    for _ in range(12):  # where all of it rests: no start contradicts another, and nothing has moved before
        y0 = float(whole.simulate(np.full(400, u0), y0, held, u0=u0, warn=False)[-1])
    expected = hand(kind, a, b, whole, source, channels, u0, y0)
    found = whole.simulate(source, y0, channels, u0=u0, warn=False)
    assert np.abs(found - expected).max() <= 1e-12 * (1 + np.abs(expected).max())
    assert len({str(s) for s in whole.symbols}) == len(whole.symbols) == len(a.symbols) + len(b.symbols)
    ns.save(whole, tmp_path / "m.json")
    assert ns.load(tmp_path / "m.json") == whole and whole.export("c") and whole.lambdify().returns[-1] == "y[k]"
    try:
        law = whole.compensator()
    except ns.NotInvertible as error:
        assert str(error)
        return
    assert law.residual() == 0
    try:
        followed = law.follow(found, u0, channels, share=None)
    except NarxError:  # it runs away, and says so
        return
    if followed.missed.any() or followed.runs_away or not law.closed_form:
        return
    ahead = law.preview
    made = whole.simulate(followed.m, float(found[0]), channels, u0=u0, warn=False)
    assert np.abs(made - found)[ahead:].max() <= 1e-9 * (1 + np.ptp(found))


def test_delays_and_orders_add_up():
    a, b = (ns.NARX.from_terms(["y[k-1]", f"u[k-{d}]", f"u[k-{d + 1}]"], [0.5, 1.0, 0.3]) for d in (2, 3))
    assert (a >> b).delay == 5 and (a >> b).n_u == 7 and (b >> a >> b).delay == 8
    assert (a + b).delay == 2 and a.feedback(b).delay == 2
    assert [str(s) for s in (a >> b >> a).symbols] == [f"theta_{i}" for i in range(1, 10)]
    assert a >> b == a >> b and (a >> b) != (b >> a) and hash(a >> b) == hash(a >> b)


def test_an_effect_in_front_or_behind_is_the_effect_added_there():
    linear = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.5], Ts=0.01)
    wave = np.sin(0.1 * N)
    for name, place in (("backlash", "input"), ("saturation", "input"), ("backlash", "output")):
        one = find(name)[0][0]
        variant = next(v for v in variants(linear) if v.effect is one and v.where == place)
        added = extend(linear, variant)
        own = (0.7, 0.3, 0.2)[: len(added.coefficients + added.shape)]
        whole = one >> linear if place == "input" else linear >> one
        theta = [*own, 0.5, 0.5] if place == "input" else [0.5, 0.5, *own]
        expected = added.model.replace(theta=[0.5, 0.5, *own]).simulate(wave, 0.0)
        assert whole.theta is None
        assert np.allclose(whole.replace(theta=theta).simulate(wave, 0.0), expected, rtol=0, atol=1e-12)


def test_the_whole_rests_where_its_parts_do():
    a = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2"], [0.5, 0.5, 0.1], operating_point={"u": 1.0, "y": 2.0})
    b = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.2, 2.0], operating_point={"u": 0.5, "y": -1.0})
    for whole in (a >> b, a + b, a.feedback(b)):
        for level in (-0.4, 0.7):
            at = float(whole.simulate(np.full(400, level), 0.0)[-1])
            points = [complex(e.xreplace(whole.values).xreplace({ubar: level})) for e in steady_state(whole).equilibria]
            assert min(abs(point - at) for point in points) < 1e-10
            assert float(rest_map(whole).xreplace(whole.values).xreplace({ubar: level, ybar: at})) == pytest.approx(at)
    assert (a >> b).sigma_y == (a >> b).symbols[3]


def test_what_does_not_fit_is_refused():
    a = ns.NARX.from_terms(["y[k-1]", "u[k]"], [0.5, 1.0], Ts=0.01)
    for make, said in (
        (lambda: a >> a.replace(Ts=0.02), "different sampling times"),
        (lambda: a >> 3, "can be combined"),
        (lambda: a + ns.NARX.from_terms(["y[k-1]", "v2[k-1]"], [0.5, 1.0], input="v2"), "same input"),
        (lambda: a.feedback(a), "Algebraic loop"),
        (lambda: a >> ns.NARX.from_terms(["u[k-1]", "y[k-1]"], [0.5, 1.0], input="y", output="u"), "can be combined"),
    ):
        with pytest.raises(ModelError, match=said):
            make()


def test_names_of_the_user_stay_apart():
    """Parameters, states and channels with one name in both; the same channel is one."""
    w, c = ns.signals.signal("y_1"), sp.Symbol("c", positive=True)
    state = compose.State(w[k], u[k - 1] / 2)
    model = ns.Model(c * y[k - 1] + w[k] + ns.signals.signal("d")[k - 1], (c,), [0.5], states=[state])
    whole = model >> model
    assert whole.channels == ("d",) and [str(s) for s in whole.symbols] == ["c", "c_2"]
    assert all(s.is_positive for s in whole.symbols) and len({s.left.base for s in whole.states}) == 3
    channels = {"d": np.cos(0.1 * N)}
    between = whole.states[1].left.base.name
    held = start_of(whole, between, 0.0, 0.0, {"d": 1.0})
    inner = model.simulate(np.sin(0.1 * N), held, channels, u0=0.0)
    expected = model.simulate(inner, 0.0, channels, u0=held)
    assert np.allclose(whole.simulate(np.sin(0.1 * N), 0.0, channels, u0=0.0), expected, rtol=0, atol=1e-12)
