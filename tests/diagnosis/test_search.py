"""One compiled frame holds every core: its points are the models, its fits find them; rates and integrating axes."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
import truths
from sampling import more, only, some
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.data.evidence.rate import MOST, left_out, working
from narx_sym.diagnosis.progress import BASE, ROUND, Course
from narx_sym.diagnosis.table.exchange import instead
from narx_sym.diagnosis.table.frame import Frame
from narx_sym.diagnosis.table.hypotheses import Core, Hypothesis, written
from narx_sym.diagnosis.table.rounds import Table
from narx_sym.diagnosis.table.row import Row
from narx_sym.diagnosis.table.search import Search
from narx_sym.diagnosis.table.starts.arx import arx_start, gains, start_beside
from narx_sym.diagnosis.table.starts.restart import restarted
from narx_sym.diagnosis.table.verdict import ALIKE, PER_EFFECT
from narx_sym.fit.bases.integrating import at_one, drives, slowest
from narx_sym.fit.evaluate import free_run
from narx_sym.models.effects import EFFECTS
from narx_sym.models.extend import Variant

N, Ts = 1500, 0.01
u = 2 * truths.excite(np.random.default_rng(5), "random", N, Ts, 1.5) + 1.0
LARGEST = Core(2, 3)
COULOMB = next(Variant(e, "inside", "y") for e in EFFECTS["coulomb_friction"] if e.form == "smooth")


def lagged(v, a=0.9, b=0.1):
    """Return a first-order lag of v."""
    return lfilter([0, b], [1, -a], v)


def small(record):
    """Return the base of few orders: the search looks for its own."""
    return ns.identify(record, base="linear", n_y=1, n_u=1, delay=1)


@pytest.fixture(scope="module")
def linear():
    record = ns.Record.from_arrays(u, lagged(u) + 3.0 + 0.01 * np.random.default_rng(1).standard_normal(N), Ts)
    return record, small(record)


@pytest.mark.parametrize("core", [Core(1, 1, 1), Core(2, 2, 0), Core(0, 2, 3)])
def test_a_point_of_the_frame_is_the_model(linear, core):
    record, base = linear
    frame = Frame(base, LARGEST, [COULOMB], [record])
    x = np.zeros(frame.size)
    x[[0, 1][: core.n_y]] = [0.6, 0.2][: core.n_y]
    x[2 : 2 + core.n_u], x[5], x[6], x[7] = [0.1, 0.05][: core.n_u], 0.02, -0.03, 0.01
    frame.late(core)
    simulated = frame.problem.run(x)[0] * frame.problem.spread
    model = written(Hypothesis(core, (COULOMB,)), base).replace(theta=frame.theta(x, core))
    # The first samples differ: the frame holds the input before the record starts.
    late = simulated[-1000:] - (free_run(model, record) - record.y)[-1000:]
    assert np.abs(late).max() < 1e-6


@pytest.mark.parametrize(
    "variant, parts",
    [
        (COULOMB, lambda v, w: (v, w)),
        (next(Variant(e, "input", "u", "w") for e in EFFECTS["channel_gain"]), lambda v, w: (v + 0.3 * w * v, w)),
        (next(Variant(e, "input", "u", at="w") for e in EFFECTS["quadratic_gain"]), lambda v, w: (v, w + 0.3 * w**2)),
    ],
    ids=["in the machine", "a product of the inputs", "at the further input"],
)
def test_each_input_comes_as_late_as_it_does(variant, parts):
    """A point of the frame is the model; with the true lags it leaves nothing, and the first lags are found."""
    w, v = np.roll(u, 400) / 3, u - u[0]
    first, second = parts(v, w - w[0])
    driven = np.concatenate([np.zeros(2), 0.1 * first[:-2]]) + np.concatenate([np.zeros(7), 0.2 * second[:-7]])
    y = lfilter([1.0], [1, -0.8], driven)
    record = ns.Record.from_arrays(v, y, Ts, channels={"w": w - w[0]}, roles={"w": "input"})
    base = ns.NARX.from_terms(["y[k-1]", "u[k-2]", "w[k-6]", "1"], [0.8, 0.1, 0.2, 0.0], channels=["w"], Ts=Ts)
    selection = replace(base.info.selection, base="linear")
    base = base.replace(info=replace(base.info, selection=selection, roles={"w": "input"}))
    search = Search(base, [record])
    assert search.family == "linear" and search.further == (("w", 6),)
    core = Core(1, 1, 2, further=(("w", 7),))
    frame = Frame(base, replace(core.at_once, n_y=2, n_u=2), [variant], [record])
    x = np.zeros(frame.size)
    x[[0, 2, 4, 7]] = 0.8, 0.1, 0.2, 0.3 if variant.where == "input" else -0.02
    x[frame.added[0][1]] = 0.1
    made = written(Hypothesis(core, (variant,)), base).replace(theta=frame.theta(x, core))
    difference = frame.errors(x, core)[0] - (free_run(made, record) - record.y)
    assert np.abs(difference[200:]).max() < 1e-9
    if variant.where == "input":
        assert np.abs(frame.errors(x, core)[0][200:]).max() < 1e-9
    rows = [r for r in search.bases([1, 2]) if r.size == core.at_once]
    assert variant.where == "input" or [r.hypothesis.core.inputs for r in rows] == [(("u", 2), ("w", 7))]


@pytest.mark.parametrize(
    "seen, told",
    [(np.abs, "absolute_sensor"), pytest.param(lambda x: np.maximum(x, 0.0), "output_limit", marks=more)],
    ids=["rectified", "limited"],
)
def test_a_sensor_that_shows_one_direction_has_a_limit_and_loses_no_sign(seen, told):
    y = seen(lagged(u - 0.8)) + 0.01 * np.random.default_rng(3).standard_normal(N)
    record = ns.Record.from_arrays(u, y, Ts)
    found = ns.diagnose(small(record), record, catalogue=only("absolute_sensor", "output_limit", "quadratic_gain"))
    assert found.confusion_set == [told]
    assert told != "absolute_sensor" or found.best.parameters["c"] > 0.75


def test_a_coefficient_is_estimated_where_the_linear_gain_says_nothing_of_it():
    """Of y = b (u + c u^3) the sign of a linear gain is that of neither: it is bent by what is missing."""
    record = ns.Record.from_arrays(u, lagged(u - 0.7 * u**3), Ts)
    core, cube = Core(1, 2, 1), u**3
    assert gains([record], core, np.array([0.9]), [[u], [cube]]) == pytest.approx([-0.7], abs=1e-9)
    assert gains([record], core, np.array([0.9]), [[u], [cube], [u**2]]) == pytest.approx([-0.7, 0.0], abs=1e-9)
    assert np.isnan(gains([record], core, np.array([0.9]), [[u], [np.inf * cube]])).all()


@pytest.mark.parametrize("id, w", [("cubic_gain", u - 0.08 * u**3), ("dead_zone", u - np.clip(u, -1.5, 1.5))])
def test_a_core_is_estimated_behind_an_effect_at_the_input(linear, id, w):
    """From a core of wrong sign, without the effect: nearly there, or no worse than before where nothing is seen."""
    record, core = ns.Record.from_arrays(u, lagged(w), Ts), Core(1, 1, 1)
    variant = next(Variant(e, "input", "u") for e in EFFECTS[id] if not e.form)
    frame = Frame(linear[1], LARGEST, [variant], [record])
    frame.limit([dict.fromkeys(variant.shape, (0.1, 3.0))], 1.1)
    x = frame.placed(core, np.array([0.7, -0.01, 0.0]))
    (_, shape), before = frame.added[0], frame.error(x, core)
    x[shape] = 1.5
    found = restarted(frame, x, core)
    assert frame.error(found, core) < 0.03 * before
    assert frame.error(restarted(frame, found, core), core) <= frame.error(found, core)
    away = found.copy()
    away[frame.used(core)[:1]] = 1.5
    assert frame.error(restarted(frame, away, core), core) < before


def moved(at):
    """Return the output of a mass on a spring and its friction: y[k] = at(1.5 y[k-1] - 0.6 y[k-2] + 0.1 u[k-1], ...)."""
    out = np.zeros(N)
    for i in range(2, N):
        out[i] = at(1.5 * out[i - 1] - 0.6 * out[i - 2] + 0.1 * u[i - 1], out[i - 1], out[i - 2])
    return out


@pytest.mark.parametrize(
    "id, form, where, at",
    [
        ("coulomb_friction", "", "inside", lambda free, y, older: free - 0.05 * np.sign(y - older)),
        ("quadratic_drag", "", "inside", lambda free, y, older: free - 1.5 * (y - older) * abs(y - older)),
        ("coulomb_friction", "holding", "motion", lambda free, y, older: free - np.clip(free - y, -0.08, 0.08)),
    ],
    ids=["inside", "a curve", "holding"],
)  # fmt: skip
def test_a_core_is_estimated_beside_an_effect_on_the_machine(linear, id, form, where, at):
    """From a core of wrong signs, without the effect: its free run is nearly right at once."""
    y = moved(at)
    record, core = ns.Record.from_arrays(u, y, Ts), Core(2, 1, 1)
    variant = next(Variant(e, where, "y") for e in EFFECTS[id] if e.form == form)
    frame = Frame(linear[1], LARGEST, [variant], [record])
    frame.limit([dict.fromkeys(variant.shape, (1e-3, 3.0))], 1.1)
    x = frame.placed(core, np.array([0.2, 0.1, -0.1, 0.0]))
    x[frame.added[0][1]] = 0.02
    found = restarted(frame, x, core)
    assert frame.error(found, core) < 0.02 < 0.5 < frame.error(x, core)
    assert found[frame.used(core)[:3]] == pytest.approx([1.5, -0.6, 0.1], rel=0.1)


def test_a_core_is_estimated_beside_a_force_that_takes_the_way_of_the_input():
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.9, 0.1], Ts=Ts)
    wrong = np.array([0.2, -0.1, 0.1, 0.0])
    core, y = Core(1, 2, 1), np.zeros(N)
    acts = np.zeros(N)
    for i in range(1, N):
        acts[i] = u[i - 1] - 0.1 * y[i - 1] ** 3
        y[i] = 0.9 * y[i - 1] + 0.2 * acts[i] - 0.1 * acts[i - 1]
    variant = next(Variant(e, "force", "y") for e in EFFECTS["hardening_spring"])
    frame = Frame(base, LARGEST, [variant], [ns.Record.from_arrays(u, y, Ts)])
    found = restarted(frame, frame.placed(core, wrong), core)
    assert frame.error(found, core) < 1e-3 < 1 < frame.error(frame.placed(core, wrong), core)
    assert found[frame.added[0][0]] == pytest.approx([-0.1], rel=0.2)


def test_the_fit_reaches_the_truth_and_the_noise(linear):
    record, base = linear
    search = Search(base, [record])
    best = min(search.bases([0, 1, 2]), key=lambda r: r.price)
    assert (best.hypothesis.core.n_y, best.hypothesis.core.n_u, best.hypothesis.core.delay) == (1, 1, 1)
    assert best.frame.theta(best.values, best.hypothesis.core)[:2] == pytest.approx([0.9, 0.1], abs=2e-3)
    assert np.sqrt(best.held) * np.std(record.y) == pytest.approx(0.01, rel=0.1)
    assert not search.integrating


def test_a_start_stays_where_the_output_goes(linear):
    """What a held-out block would tell of its start may be hidden by a limit: no step leads back from far away."""
    record, base = linear
    frame = Frame(base, LARGEST, [COULOMB], [record])
    x = np.zeros(frame.size)
    x[0], x[2], x[6], x[7] = 0.9, 0.1, 0.01, 0.1
    at = [i for i, s in enumerate(frame.problem.starts, frame.problem.free) if s.back is not None]
    x[at] = 1e3
    late = np.arange(12) > 5
    found, _ = frame.fit(x, Core(2, 3), 1, use=late)
    assert np.abs(found[at]).max() <= np.ptp(record.y)


def test_a_start_of_a_memory_stays_where_the_memory_goes(linear):
    """From far away a loop is a transient: it would take the place of whatever drifts at first."""
    record, base = linear
    loop = next(e for e in EFFECTS["hysteresis"] if e.form == "Bouc-Wen")
    frame = Frame(base, LARGEST, [Variant(loop, "inside", "y")], [record])
    x = np.zeros(frame.size)
    x[0], x[2], x[6], x[7], x[8] = 0.9, 0.1, 0.01, 0.5, 0.5
    (at,) = (i for i, s in enumerate(frame.problem.starts, frame.problem.free) if s.back is None)
    goes = frame.problem.reach(x, 0)
    assert np.isfinite(goes).sum() == 1 and 0.5 < goes[-1] <= np.ptp(record.y) + 1e-9
    x[at] = -1e3
    found, _ = frame.fit(x, Core(2, 3), 1)
    assert 0 < abs(found[at]) <= goes[-1]


def test_a_start_that_is_not_forgotten_is_a_parameter(linear):
    """A play that its input never takes up is a constant: of several records each has one of its own. So is a slow pole."""
    record, base = linear
    slack = Variant(next(e for e in EFFECTS["backlash"] if "input" in e.places and not e.form), "input", "u")
    small = ns.Record.from_arrays(1.0 + 0.01 * (u - 1.0), record.y, Ts)

    def row(*records, pole=0.9):
        frame = Frame(base, LARGEST, [slack], records)
        x = np.zeros(frame.size)
        x[0], x[2], x[6], x[7] = pole, 0.1, 1.0, 0.3
        return Row(Hypothesis(LARGEST, (slack,)), frame, x, 0.0, 4)

    pole = -1 / np.log(0.9) / N  # is forgotten in ten samples
    assert row(small).paid == pytest.approx(5 + pole) and not row(small).goes_back
    assert row(small, small, pole=0.9999).paid == pytest.approx(4 + 2 + 2)
    assert 5 < row(small, record).paid < 5.2 and row(small, record).goes_back
    assert 4 < row(record).paid < 4.2  # it is taken up after a few samples
    elastic = Variant(next(e for e in EFFECTS["backlash"] if e.form == "elastic"), "inside", "uy")
    frame = Frame(base, LARGEST, [elastic], [record])
    bare = Row(Hypothesis(LARGEST, (elastic,)), frame, np.zeros(frame.size), 0.0, 4)
    assert bare.paid == 4 and bare.goes_back  # a dead zone between two signals remembers nothing


def test_a_partner_is_looked_at_beside_the_best_core(linear):
    record, base = linear
    search = Search(base, [record])
    rows = search.bases([1])
    best = sorted(rows, key=lambda r: r.parameters)[1]
    search.limits[COULOMB] = dict.fromkeys(COULOMB.shape, (1e-3, 1.0))
    looks = search.look(rows, COULOMB, [(0.1,) * len(COULOMB.shape)], best)
    assert best.size in {r.size for r in looks}


def test_an_integrating_axis_is_recognised_and_kept():
    y = np.cumsum(lagged(u - 1.0, 0.8, 0.02))
    record = ns.Record.from_arrays(u - 1.0, y + 1e-4 * np.random.default_rng(2).standard_normal(N), Ts)
    base = ns.identify(record, base="linear", n_y=2, n_u=1, delay=1)
    search = Search(base, [record])
    best = min(search.bases([0, 1, 2]), key=lambda r: r.price)
    assert search.integrating and best.hypothesis.core.integrating
    assert slowest(best.values[: best.hypothesis.core.n_y]) == pytest.approx(1.0, abs=1e-9)
    assert len(search.cut) == 12


def test_a_sensor_that_drifts_is_no_axis_that_integrates():
    # A pole at 1 imitates the ramp, but the input does not pass through it.
    y = lagged(u) + np.linspace(0.0, 30.0, N)
    record = ns.Record.from_arrays(u, y + 1e-3 * np.random.default_rng(2).standard_normal(N), Ts)
    search = Search(small(record), [record])
    search.bases([0, 1, 2])
    assert not search.integrating


@pytest.mark.parametrize("seed", [2, *(pytest.param(s, marks=more) for s in (4, 8, 12))])
def test_what_wanders_beside_a_lag_is_no_axis_that_integrates(seed):
    """As a heater in a room: in pieces a pole at 1 follows what wanders, but no input makes it."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(rng.choice([-1.0, 1.0], N // 12 + 1), 12)[:N]
    y, away = lagged(levels, 0.975, 0.025), np.cumsum(np.cumsum(rng.standard_normal(N)))
    away -= np.linspace(away[0], away[-1], N)
    made = y / np.std(y) + 0.06 * away / np.std(away) + 0.003 * rng.standard_normal(N)
    record = ns.Record.from_arrays(levels, made, 0.8)
    search = Search(small(record), [record])
    search.bases([0, 1, 2])
    assert not search.integrating and not search.leaks


def test_the_working_rate_keeps_what_moves():
    t = np.arange(40_000) * 1e-3
    slow = ns.Record.from_arrays(np.sin(t), np.sin(t) + 0.1 * np.sin(3 * t), 1e-3)
    (found,), factor = working([slow])
    assert factor > 10 and 1200 <= len(found) <= MOST
    assert found.Ts == pytest.approx(factor * 1e-3)
    assert found.y[7] == pytest.approx(slow.y[7 * factor : 8 * factor].mean())
    fast = ns.Record.from_arrays(u, np.random.default_rng(0).standard_normal(N), Ts)
    assert working([fast])[1] == 1


def test_of_a_long_record_the_end_is_looked_at_too():
    noise = np.random.default_rng(1).standard_normal(20_000)
    found, factor = working([ns.Record.from_arrays(noise, noise, Ts)])
    assert factor == 1 and [len(r) for r in found] == [MOST // 3] * 3
    assert found[0].t[0] == 0 and found[-1].t[-1] == pytest.approx(19_999 * Ts)
    short = ns.Record.from_arrays(noise[:5000], noise[:5000], Ts)
    few = ns.Record.from_arrays(noise[:500], noise[:500], Ts)
    assert [len(r) for r in working([few, short])[0]] == [500, 5000]  # what a short one leaves, a long one has


def test_of_a_record_with_many_gaps_the_longest_pieces_are_compared():
    y = np.random.default_rng(2).standard_normal(4000)
    cut = replace(ns.Record.from_arrays(y, y, Ts, name="cut"), breaks=tuple(range(1000, 4000, 100)))
    found, factor = working([cut])
    assert len(found) == 24 and len(found[0]) == 1000 and {len(r) for r in found[1:]} == {100}
    assert factor == 1 and "24 longest" in left_out(cut, 1)[0] and left_out(cut[:1000], 1) == []
    each = [replace(cut, name=f"r{i}") for i in range(30)]
    assert len(working(each)[0]) == 30  # every record is there


def test_a_structure_with_several_resonances():
    """Two lightly damped ones; a hum, which no input drives, does not pass for a third."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(3)
    poles = [r * np.exp(s * 1j * w) for r, w in ((0.97, 0.5), (0.98, 1.1)) for s in (1, -1)]
    white, t = rng.standard_normal(N), np.arange(N)
    y = lfilter([0.0, 1.0, 0.6], np.poly(poles).real, white)
    found = {}
    for name, beside in (
        ("alone", 0.0),
        ("hum", 0.3 * np.std(y) * np.sin(0.11 * t) + 0.15 * np.std(y) * np.sin(0.22 * t)),
    ):
        record = ns.Record.from_arrays(white, y + beside + 0.01 * np.std(y) * rng.standard_normal(N), Ts)
        search = Search(small(record), [record])
        best = min(search.bases([0, 1]), key=lambda r: r.price)
        found[name] = (search.higher, best)
    assert found["alone"][0] == [(5, 5)] and np.sqrt(found["alone"][1].held) < 0.02
    assert found["hum"][0] == [(5, 5)]


@pytest.mark.long
def test_a_tank_is_an_integrator_but_for_its_outflow():
    rng, n = np.random.default_rng(6), 1000
    inflow = np.repeat(rng.uniform(0.1, 3.0, n // 50), 50)
    level = np.full(n, 4.0)
    for i in range(1, n):
        level[i] = max(level[i - 1] + 0.1 * (1.2 * inflow[i - 1] - np.sqrt(level[i - 1])), 0.0)
    record = ns.Record.from_arrays(inflow, level + 0.01 * rng.standard_normal(n), 1.0)
    found = ns.diagnose(ns.identify(record, base="linear"), record)
    assert found.confusion_set[0] == "sqrt_outflow" and found.ladder[-1]["validation"] < 0.02
    (row,) = [r for r in found.hypotheses if r.ids == ("sqrt_outflow",)][:1]
    assert slowest(row.a) > slowest(row.linearised)


RUBBING = only("coulomb_friction", "quadratic_drag")


@pytest.mark.parametrize("standing", (False, pytest.param(True, marks=pytest.mark.long)))
def test_friction_of_a_motor_that_is_recorded_as_a_speed(standing):
    """J w' = k u - b w - F sign(w), exact for a held input while it moves; it stands until the torque overcomes F."""
    rng, n = np.random.default_rng(8), 1500
    torque = np.interp(np.arange(n), np.arange(0, n + 30, 30), rng.uniform(-2.0, 2.0, n // 30 + 1))
    speed, friction = np.zeros(n), 0.5 if standing else 0.0
    for i in range(1, n):
        reached = 0.95 * speed[i - 1] + 0.05 * 3.0 * torque[i - 1]
        speed[i] = np.sign(reached) * max(abs(reached) - 0.05 * 3.0 * friction, 0.0)
    noisy = speed + 0.005 * np.std(speed) * rng.standard_normal(n)
    record = ns.Record.from_arrays(torque, noisy, 0.01)
    found = ns.diagnose(small(record), record, catalogue=EFFECTS if standing else RUBBING)
    if standing:
        assert (found.verdict, found.confusion_set) == ("named", ["coulomb_friction"])
        assert found.best.variant.effect.standing and found.best.where == "motion"
    else:
        assert found.verdict == "nothing_detectable"


def slack(x, r):
    return x[0] + truths.play(x - x[0], r)


@pytest.mark.long
def test_an_effect_is_found_again_where_it_acts_elsewhere():
    """A slack before the actuator and one behind it."""
    rng, n = np.random.default_rng(4), 1500
    u = np.interp(np.arange(n), np.arange(0, n + 25, 25), rng.uniform(-2, 2, n // 25 + 1))
    x = lagged(slack(u, 0.4), 0.85, 0.15)
    record = ns.Record.from_arrays(u, slack(x, 0.25) + 0.005 * rng.standard_normal(n), 0.01)
    few = only("backlash", "dead_zone")
    found = ns.diagnose(ns.identify(record, base="linear"), record, catalogue=few, max_effects=2)
    assert [(e.effect, e.where) for e in found.model.effects] == [("backlash", "input"), ("backlash", "output")]
    widths = [v for s, v in found.model.values.items() if str(s).startswith("r_")]
    assert widths == pytest.approx([0.4, 0.25], rel=0.1)
    assert found.ladder[-1]["train"] < 0.012  # 0.008 is noise; a lag in the first one's place leaves 0.02


def test_a_bent_response_to_a_sine_is_no_axis_that_integrates():
    # Two poles that swing without damping imitate the third harmonic: they lie on the unit circle, but not at 1.
    sine = np.sin(2 * np.pi * 0.3 * Ts * np.arange(N))
    y = lagged(2 * np.tanh(sine / 2)) + 2e-3 * np.random.default_rng(3).standard_normal(N)
    record = ns.Record.from_arrays(sine, y, Ts)
    search = Search(small(record), [record])
    search.bases([0, 1, 2, 3])
    assert not search.integrating


def test_poles_at_one():
    assert at_one(np.array([1.0]), 0.998) and at_one(np.array([1.9, -0.9]), 0.998)
    assert at_one(np.array([2 * 0.9999, -(0.9999**2) - 1e-6]), 0.998)  # one swing is longer than the record
    swings = np.exp([0.05j, -0.05j])
    assert not at_one(-np.poly(swings)[1:].real, 0.998) and not at_one(np.array([0.9]), 0.998)
    assert not at_one(np.array([-1.0]), 0.998)
    for turns, near in ((0.8, True), (1.2, False)):  # within the record, whose quarter is the slowest time constant
        pair = 0.9999 * np.exp([1j * turns * 2 * np.pi / 1200, -1j * turns * 2 * np.pi / 1200])
        assert at_one(-np.poly(pair)[1:].real, np.exp(-4 / 1200)) == near


def test_a_resonance_that_hardly_decays_is_no_line_of_the_spectrum():
    # Its poles lie where those of an imitated line do, but the output follows the input from rest too.
    a, noise = np.array([2 * 0.9985 * np.cos(0.2), -(0.9985**2)]), 0.02
    y = np.zeros(N)
    for i in range(2, N):
        y[i] = a @ y[[i - 1, i - 2]] + 0.04 * u[i - 1]
    record = ns.Record.from_arrays(u, y + noise * np.random.default_rng(4).standard_normal(N), Ts)
    base = ns.identify(record, base="linear", n_y=2, n_u=1, delay=1)
    search = Search(base, [record])
    best = min(search.bases([0, 1, 2]), key=lambda r: r.price)
    assert slowest(a) > search.slow and search.swings and not search.integrating
    assert np.sqrt(best.held) * np.std(record.y) == pytest.approx(noise, rel=0.1)
    found = ns.diagnose(base, record, catalogue=only("periodic_disturbance", "drift", "hysteresis"))
    assert found.verdict == "nothing_detectable"


def test_a_line_is_not_driven_where_the_record_does_not_begin_at_rest():
    """A free run starts from the first samples, whatever they are: they say nothing for a drive."""
    k, noise = np.arange(1200), 0.02 * np.random.default_rng(7).standard_normal(1200)
    wave, line = np.sin(0.25 * k), 0.3 * np.cos(0.75 * k)
    jump = np.where(k < 2, 5.0, 0.0)
    poles = 0.99999 * np.exp([0.75j, -0.75j])
    record = ns.Record.from_arrays(wave, wave + line + jump + noise, Ts)
    a = -np.poly(poles)[1:].real
    assert not drives(a, 2, [("u", 2)], [record], 0.997, float(np.var(noise)))
    swings = lfilter([0.0, 0.1], [1.0, *-a], wave + np.random.default_rng(8).standard_normal(1200))
    record = ns.Record.from_arrays(wave, swings + jump + noise, Ts)
    assert drives(a, 2, [("u", 2)], [record], 0.997, float(np.var(noise)))


def test_an_axis_that_leaks_slowly_keeps_its_pole():
    # Drag decays slower than a stretch of a long record: no integrator, no drift.
    rng = np.random.default_rng(5)
    driven = np.repeat(rng.standard_normal(900), 20)
    pole = 0.9993
    y = lfilter([0.0, 0.02], [1.0, -pole], driven)
    record = ns.Record.from_arrays(driven, y + 0.01 * np.std(y) * rng.standard_normal(y.size), Ts)
    base = small(record)
    search = Search(base, [record[i : i + 2000] for i in (0, 8000, 16000)])
    best = min(search.bases([0, 1, 2]), key=lambda r: r.price)
    assert pole > search.slow and search.leaks and not search.integrating
    assert slowest(best.a) == pytest.approx(pole, abs=1e-4)


@pytest.mark.parametrize("kind", some(["lag", "gain", "late"]))
@pytest.mark.parametrize("n", some([300, 1000]))
def test_a_base_that_follows_exactly_misses_nothing(kind, n):
    """What rounding leaves is not an effect, and the gate does not divide by it."""
    v = np.random.default_rng(0).standard_normal(n)
    y = {"gain": 2 * v, "lag": np.zeros(n), "late": np.r_[0.0, v[:-1]]}[kind]
    for i in range(1, n if kind == "lag" else 0):
        y[i] = 0.5 * y[i - 1] + 0.5 * v[i - 1]
    record = ns.Record.from_arrays(v, y, Ts)
    found = ns.diagnose(ns.identify(record, base="linear", n_y=1, n_u=2, delay=0), record)
    assert found.verdict == "nothing_detectable" and not found.confusion_set
    assert all(np.isfinite(size) for size in found.steps[0].smallest_detectable.values())


@pytest.mark.long
@pytest.mark.parametrize("n", [100, 150])
def test_an_axis_of_few_samples_is_judged(n):
    """Its free run starts again and again; each piece must be longer than what is fitted to it."""
    rng = np.random.default_rng(5)
    wanted = np.interp(np.arange(n), np.arange(0, n + 50, 50), rng.normal(size=n // 50 + 1))
    u, y, speed, position = np.zeros(n), np.zeros(n), 0.0, 0.0
    for k in range(n):
        y[k] = position + 1e-4 * rng.standard_normal()
        u[k] = 20 * (wanted[k] - position) - 2 * speed
        for _ in range(10):
            free = speed + 0.001 * (u[k] - 0.5 * speed)
            speed = np.sign(free) * max(abs(free) - 0.001 * 0.8, 0.0)
            position += 0.001 * speed
    record = ns.Record.from_arrays(u, y, Ts=0.01)
    found = ns.diagnose(ns.identify(record, base="linear"), record)
    assert "coulomb_friction" in found.confusion_set


@pytest.mark.long
def test_a_given_dead_time_is_kept():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.normal(size=20), 30)
    y = lfilter([0.3], [1, -0.7], np.concatenate([np.zeros(2), np.sign(u) * np.maximum(np.abs(u) - 0.5, 0)])[:600])
    record = ns.Record.from_arrays(u, y + 0.005 * rng.standard_normal(600), Ts=0.01)
    base = ns.identify(record, base="linear", delay=2)
    assert ns.diagnose(base, record, delay=2).model.delay == 2
    late = ns.diagnose(base, record, delay=5)
    assert {row.hypothesis.core.delay for row in late.hypotheses} == {5} and late.model.delay == 5


def test_a_row_that_is_judged_later_has_its_error():
    """Its error is infinite while it is not judged: that is not kept."""
    frame = SimpleNamespace(counts=np.ones(12), late=lambda delay: None, held_out=lambda *_: np.full(12, 0.5))
    row = Row(Hypothesis(Core(1, 1, 0)), frame, np.zeros(3), 0.4, 3)
    assert np.isinf(row.held) and row.judged().held == 0.5


def test_what_needs_memory_is_tried_though_the_best_core_has_none():
    """A gain that depends on the output is none beside a core without memory, but it is beside the others."""
    rng = np.random.default_rng(4)
    u = np.sin(np.arange(1200) / 12) + 0.1 * rng.standard_normal(1200)
    record = ns.Record.from_arrays(u, 2.0 * u + 0.05 * rng.standard_normal(1200), Ts=0.01)
    table = Table(small(record), [record], [], ns.EFFECTS, 0, Course(lambda *_: None, [BASE, *ROUND]))
    assert table.base.hypothesis.core.n_y == 0
    with patch.object(Table, "_fit") as fit:
        table.singles(table.base)
    assert "bilinear_gain" in {v.id for v in fit.call_args.args[1]}


# -- larger cores, places, the own rate ---------------------------------------------------------------------------------


def of(id, form, where, driver="u"):
    return next(Variant(e, where, driver) for e in EFFECTS[id] if e.form == form)


def test_an_effect_is_placed_after_a_closer_look():
    """A brief look likes one place better; fitted with every core the other one is."""
    worse, better = (
        SimpleNamespace(hypothesis=name, values=0, before_judged=b) for name, b in (("x", 1.0), ("y", 0.0))
    )
    forgotten = []
    search = SimpleNamespace(
        one_more=lambda bases, looks: [worse if looks == "first" else better, "other core"],
        fitted=lambda hypothesis, values, steps: None,  # what diverges stays as it was
        forget=forgotten.append,
    )
    assert Table._placed(SimpleNamespace(search=search), [], ["first", "second"])[0] is better
    assert forgotten == ["x"]


@pytest.mark.parametrize("weights, charged", [([0.1, 0.2, 0.3], 1), ([-0.1, -0.2, -0.3], 1), ([0.1, -0.2, 0.3], 2)])
def test_a_superposition_with_weights_of_both_signs_costs_two(linear, weights, charged):
    plays = of("hysteresis", "play superposition", "output")
    frame = Frame(linear[1], LARGEST, (plays,), [linear[0]])
    values = np.zeros(frame.size)
    values[frame.added[0][0][:3]] = weights
    row = Row(Hypothesis(Core(1, 1), (plays,)), frame, values, 0.1, 4)
    assert (row.count, row.charged) == (1, charged)


def test_what_only_filters_is_one_of_few_beside_another_effect(linear):
    record, model = linear
    lags, gain = of("creep", "", "output"), of("quadratic_gain", "", "input")

    def charged(*effects):
        frame = Frame(model, LARGEST, effects, [record])
        return Row(Hypothesis(Core(1, 1), effects), frame, np.zeros(frame.size), 0.1, 4).charged

    assert (charged(), charged(lags), charged(gain)) == (0, 1, 1)
    assert charged(gain, lags) == pytest.approx(1 + np.log(2) / np.log(25))  # of two, not of 25


def test_no_winner_costs_clearly_more_at_the_own_rate_than_another():
    names = [("a",), ("b",), ("c", "d"), ("e", "f")]
    rows = [SimpleNamespace(ids=n, price=i, parameters=0, beyond=lambda base, n=n: n) for i, n in enumerate(names)]
    asked = []

    def worth(row, base, by):
        asked.append((row.ids, by))
        return row.ids in dear

    table = SimpleNamespace(beside=lambda base: rows, holds=lambda row: True, worth=worth)
    dear = []
    assert Table._needed(table, rows[0], None) and Table._needed(table, rows[3], None)
    assert asked == [(("b",), PER_EFFECT), (("a",), ALIKE), (("c", "d"), PER_EFFECT)]
    for other, best in ((("b",), 0), (("a",), 3), (("c", "d"), 3)):
        dear = [other]
        assert not Table._needed(table, rows[best], None)


def test_what_is_missing_beside_a_winner_is_missing_at_the_own_rate():
    """A mean over several samples leaves what no effect removes: it is asked where it would decide."""
    base, near, far = (SimpleNamespace(held=h) for h in (1.0, 0.001, 0.2))
    rates = SimpleNamespace(
        screened=lambda row: SimpleNamespace(missing=0.4), checked=lambda row: SimpleNamespace(missing=0.05)
    )
    assert Table.left(rates, near, base) == 0.4  # it removes all but a tenth of the rms: nothing to decide
    assert Table.left(rates, far, base) == 0.05
    rates.checked = lambda row: SimpleNamespace(missing=0.2)
    assert Table.left(rates, far, base) == 0.4  # something is left at both rates
    rates.screened = lambda row: SimpleNamespace(missing=0.02)
    assert Table.left(rates, far, base) == 0.02


def test_what_costs_less_at_the_own_rate_is_a_rival():
    """Where nothing else is one; a hypothesis that cannot be held is none, nor one that is far dearer."""
    kinds = {"parameters": 4, "becomes": frozenset(), "count": 1}
    best, missed, dear, wild = (
        SimpleNamespace(ids=(n,), price=p, **kinds) for n, p in (("a", 0.0), ("b", 0.4), ("c", 1.0), ("d", 0.3))
    )
    rows = [best, missed, dear, wild]
    table = SimpleNamespace(holds=lambda row: row is not wild, worth=lambda row, than: row in cheaper)
    cheaper = [missed, dear, wild]
    assert Table.unsure(table, [best], rows) == [best, missed]
    assert Table.unsure(table, [best, dear], rows) == [best, dear]
    cheaper = []
    assert Table.unsure(table, [best], rows) == [best]


def one_of_a_table(price, *ids):
    """A row whose blocks all have one error."""
    effects = tuple(SimpleNamespace(id=i) for i in ids)
    core = SimpleNamespace(given=False)
    return SimpleNamespace(
        price=price, before_judged=price, ids=ids, count=len(ids), parameters=len(ids), becomes=frozenset(),
        blocks=np.full(12, np.exp(price)), hypothesis=SimpleNamespace(effects=effects, core=core),
        beyond=lambda known: effects[len(known.ids) :],
    )  # fmt: skip


def test_what_a_new_effect_makes_superfluous_is_withdrawn():
    """Of a loop, a curve and a slack: the slack alone beside the curve costs less than beside loop and curve."""
    row = one_of_a_table
    known, best = row(-6.0, "loop", "curve"), row(-7.0, "loop", "curve", "slack")
    curve, other, dear = row(-2.0, "curve"), row(-5.9, "spring", "curve"), row(-5.0, "drag", "curve")
    rows, prices = [known, best, curve, other, dear], {}

    def added(base, variant, like):
        assert variant.id == "slack" and like is best
        rows.append(row(prices.get(base.ids, -1.0), *base.ids, "slack"))

    def held(choose):
        base, made = choose()
        return (base, made) if made is not None and table.holds(made) else (known, None)

    table = SimpleNamespace(rows=rows, search=SimpleNamespace(added=added), held=held, holds=lambda r: True)
    assert instead(table, best, known) == (known, best, [])
    prices[dear.ids] = -9.0  # too dear before to be asked
    assert instead(table, best, known) == (known, best, [])
    prices[other.ids] = -7.5
    base, made, gone = instead(table, best, known)
    assert base is other and made.ids == ("spring", "curve", "slack") and gone == ["loop"]
    prices[curve.ids] = -8.0
    base, made, gone = instead(table, best, known)
    assert base is curve and made.ids == ("curve", "slack") and gone == ["loop"]
    rows.append(pair := row(-8.5, "spring", "curve", "slack"))  # fitted before
    assert instead(table, best, known)[:2] == (other, pair)
    table.holds = lambda r: r is best or "slack" not in r.ids
    assert instead(table, best, known) == (known, best, [])


@pytest.mark.parametrize(
    ("named", "beside", "found"), [(-9.5, None, True), (-9.5, -9.8, True), (-9.5, -10.1, False), (-9.95, None, False)]
)
def test_two_effects_take_the_place_of_one_that_imitated_them(named, beside, found):
    """A cubic removes nearly all of what a saturation and creep do: what the first round knew better it may say now."""
    row = one_of_a_table
    known, alone, pair = row(named, "cubic"), row(-9.4, "saturation"), row(-10.0, "saturation", "creep")
    best = row(beside, "cubic", "spring") if beside else None
    table = SimpleNamespace(
        rows=[r for r in (known, alone, pair, best) if r], held=lambda choose: choose(), holds=lambda r: True,
        search=SimpleNamespace(added=lambda *given: None),
    )  # fmt: skip
    assert instead(table, best, known) == ((alone, pair, ["cubic"]) if found else (known, best, []))


@pytest.mark.parametrize(("bend", "kept"), [(0.02, True), (-0.02, False), (-0.2, True)])
def test_a_cubic_that_falls_and_does_not_turn_back_is_a_saturation(linear, bend, kept):
    """It costs as much, and means something outside the data; where the catalogue has none, the cubic stays."""
    record, base = linear
    moved = record.u - float(base.operating_point[base.input])
    assert (np.min(1 + 3 * bend * moved**2) > 0) == (bend > -0.1)
    search = Search(base, [ns.Record.from_arrays(record.u, lagged(moved + bend * moved**3), Ts)])
    cubic = next(Variant(e, "input", "u") for e in EFFECTS["cubic_gain"])
    search.limits[cubic] = {}
    bases = search.bases([1])
    (row, *_) = search.look(bases, cubic, [()])
    assert row.values[row.frame.added[-1][0][0]] == pytest.approx(bend, rel=0.2)
    assert row.expands == (set() if kept else {"saturation"}) and search._keeps(row)
    search.tried = set(EFFECTS)
    assert search._keeps(row) == kept and bool(search.look(bases, cubic, [()])) == kept


@pytest.mark.parametrize(("share", "whole"), [(1.0, True), (0.6, False)])
def test_an_effect_is_whole_where_that_costs_less(linear, share, whole):
    """The share is a parameter only where it says something: a dead zone of 0.98 is one with the error of its fit."""
    record, base = linear
    moved = record.u - float(base.operating_point[base.input])
    passed = moved - share * np.clip(moved, -0.4, 0.4)
    noise = 0.01 * np.random.default_rng(2).standard_normal(N)
    search = Search(base, [ns.Record.from_arrays(record.u, lagged(passed) + noise, Ts)])
    zone = next(Variant(e, "input", "u") for e in EFFECTS["dead_zone"] if not e.form)
    search.limits[zone] = {"r": (0.05, 2.0)}
    bases = search.bases([1])
    row = search.finish(search.look(bases, zone, [(0.3,)])[0])
    (at,), (r,) = row.frame.added[-1]
    assert row.values[[at, r]] == pytest.approx([share, 0.4], abs=0.03)
    assert (row.values[at] == 1.0) == whole
    core = row.hypothesis.core
    assert row.parameters == row.frame.parameters(core) == search.frame((zone,), False).parameters(core) - whole


@pytest.mark.parametrize("unit", [2.0**-30, 2.0**30], ids=["small", "large"])
def test_a_start_is_the_same_in_all_units(unit):
    t = np.arange(2000) / 250
    u = 2 * np.abs(2 * (t % 1) - 1) - 1
    y = lfilter([0.02], [1, -1.7, 0.72], u) + 1e-3 * np.random.default_rng(0).standard_normal(u.size)
    core, scale = Core(2, 3), np.array([1, 1, unit, unit, unit, unit])
    plain, scaled = (ns.Record.from_arrays(u, y * s, Ts=0.01) for s in (1.0, unit))
    assert np.array_equal(arx_start([scaled], core), scale * arx_start([plain], core))
    a = np.array([1.7, -0.72])
    found = [start_beside([r], core, a)[0] for r in (plain, scaled)]
    assert np.array_equal(found[1], scale * found[0])


@pytest.mark.more
def test_an_effect_that_hardly_acts_is_no_excuse_for_poles_that_swing_by_themselves():
    """A hum on a lag: a core that swings as it does, beside an effect of no size, was told as its rival."""
    rng, n = np.random.default_rng(3), 4000
    u = lfilter([0.16], [1, -0.987], rng.standard_normal(n))
    hum = 0.12 * np.sin(2 * np.pi * 0.065 * np.arange(n) + 1)
    y = lfilter([0, 0.026], [1, -0.974], u) + hum + 0.01 * rng.standard_normal(n)
    record = ns.Record.from_arrays(u, y, 0.0013)
    found = ns.diagnose(ns.identify(record, base="linear"), record)
    assert found.verdict == "named" and found.confusion_set == ["periodic_disturbance"]
