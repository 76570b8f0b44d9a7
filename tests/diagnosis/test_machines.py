"""Machines that are simulated by other means than the package's own equations, diagnosed with all defaults."""

from types import SimpleNamespace

import numpy as np
import pytest
import truths
from sampling import more, only
from scipy.signal import cont2discrete, dlsim, lfilter

import narx_sym as ns
from narx_sym.diagnosis.table.hypotheses import Core, Hypothesis
from narx_sym.diagnosis.table.rounds import Table
from narx_sym.diagnosis.table.search import Search
from narx_sym.diagnosis.table.starts.arx import resampled, start_beside, zeroed
from narx_sym.diagnosis.table.verdict import distinct
from narx_sym.models.effects import EFFECTS, Catalogue
from narx_sym.models.extend import Variant, variants


def record_of(u, y, Ts, noise, seed=0):
    """Return a record with noise, a share of the spread of y."""
    y = y + noise * np.std(y) * np.random.default_rng(seed).standard_normal(y.size)
    return ns.Record.from_arrays(u, y, Ts=Ts)


def linear(num, den, u, Ts):
    """Return the response of a continuous transfer function to a held input."""
    b, a, dt = cont2discrete((num, den), Ts)
    return dlsim((b.ravel(), a, dt), u)[1].ravel()


def smooth(rng, n, pole):
    """Return noise through a lag, from -1 to 1 or so."""
    x = lfilter([1 - pole], [1, -pole], rng.standard_normal(n + 300))[300:]
    return x / np.std(x)


def diagnosed(record, catalogue=EFFECTS):
    return ns.diagnose(ns.identify(record, base="linear"), record, catalogue=catalogue)


LAGS = only("rate_dependence", "inertia", "creep", "saturation", "drift")  # what a base of too few lags may look like


@pytest.fixture(scope="module")
def flexible():
    """Return a linear axis, an integrator and a resonance, sampled so fast that its poles are all near 1."""
    rng, Ts = np.random.default_rng(212), 0.004
    t = Ts * np.arange(6000)
    u = sum(
        np.cos(2 * np.pi * f * t + p) for f, p in zip(np.geomspace(0.3, 25, 40), rng.uniform(0, 6, 40), strict=True)
    )
    y = linear([1], np.convolve([0.03, 0.25, 0], [1 / 60**2, 0.1 / 60, 1]), u, Ts)
    return record_of(u, y, Ts, 0.002)


def test_poles_near_one_start_where_the_free_run_does(flexible):
    a = -np.real(np.poly([1.0, np.exp(-0.004 / 0.12), *np.exp(np.roots([1, 6, 3600]) * 0.004)]))[1:]
    search = Search(ns.identify(flexible, base="linear", n_y=1, n_u=1, delay=1), [flexible], [(4, 4)])
    core, frame = Core(4, 4, 1), search.frame((), False)
    start, errors = start_beside(frame.pieced, core, a)
    x = np.zeros(frame.size)
    x[frame.used(core)[: start.size]] = start
    begun = frame.problem.begun(x, errors)
    assert np.sqrt(frame.error(begun, core)) < 0.0025 < 0.1 < np.sqrt(frame.error(x, core))


@pytest.mark.long
def test_a_fast_sampled_flexible_axis_misses_nothing(flexible):
    found = diagnosed(flexible).steps[0]
    assert found.verdict == "nothing_detectable" and not found.nearest
    assert found.nrmse(found.base)["validation"] < 0.003  # the noise is 0.002


def test_a_mean_over_samples_leaves_no_trace():
    """An input that is held and averaged makes a linear model of the same order inexact, not the machine."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1, 1, 100), 25)
    record = record_of(u, linear([-0.25, 1], [0.25, 1.0, 1], u, 0.05), 0.05, 0.01)
    found = diagnosed(record, LAGS).steps[0]
    assert found.verdict == "nothing_detectable" and not found.nearest


def test_what_holds_the_motion_of_a_static_core_is_a_play():
    holding = next(Variant(e, "motion", "y") for e in EFFECTS["coulomb_friction"] if "motion" in e.places)
    static, lag = (ns.NARX.from_terms(terms, [0.5] * len(terms)) for terms in (["u[k-1]"], ["y[k-1]", "u[k-1]"]))
    assert holding.beside(1) and not holding.beside(0)
    assert not [v for v in variants(static) if v.where == "motion"]
    assert [v for v in variants(lag) if v.where == "motion"]


def test_one_free_run_under_two_names_is_one_partner():
    class Fitted:
        def __init__(self, parameters, price):
            self.parameters, self.before_judged = parameters, price

    rows = [Fitted(5, -4.0), Fitted(5, -3.999), Fitted(6, -3.998), Fitted(5, -3.9)]
    assert list(distinct(rows)) == [rows[0], rows[2], rows[3]]


@pytest.mark.parametrize(("after", "shows"), [(0.9, True), (1.0, True), (1.04, False)])
def test_no_winner_raises_the_error_that_is_shown(after, shows):
    """On all blocks it may fall all the same: of a record with one step most of it is before that."""

    def own(error):
        return SimpleNamespace(split=SimpleNamespace(held="held"), mean_square=lambda masks: error)

    table = SimpleNamespace(own=own, worth=lambda best, base: True, _needed=lambda best, base: True)
    assert Table._shows(table, after, 1.0) == shows


def test_an_effect_does_not_leave_the_table_with_one_core():
    """The best core may have a pole that cannot be held: the effect is fitted with the next one."""

    def row(size, ids=("drift",)):
        core = SimpleNamespace(given=False)
        return SimpleNamespace(ids=ids, size=size, hypothesis=SimpleNamespace(effects=ids, core=core))

    large, middle, small, other = row((2, 3)), row((3, 3)), row((2, 2)), row((2, 3), ("creep",))
    rows, stands = [middle, other], [small]
    search = SimpleNamespace(finish=rows.append)
    table = SimpleNamespace(
        rows=rows, search=search, holds=stands.__contains__, _lost=set(),
        _cores={(("drift",), False): [large, middle, small], (("creep",), False): [other]},
    )  # fmt: skip
    Table._instead(table, large)  # another row has it
    assert rows == [middle, other]
    rows.remove(middle)
    Table._instead(table, middle)
    assert rows == [other, small]
    rows.remove(small)
    Table._instead(table, small)  # it could be held: it lost for another reason
    assert rows == [other]
    rows.remove(other)
    Table._instead(table, other)  # no core is left
    assert rows == []


@pytest.mark.parametrize(
    ("pole", "effects", "grows"), [(0.9, 0, False), (1.0005, 0, False), (1.08, 0, True), (1.08, 1, False)]
)
def test_no_base_of_an_axis_has_a_pole_that_grows(pole, effects, grows):
    """Its free run starts again and again, and would hide it; a friction holds such an axis."""
    a = -np.poly([1.0, pole])[1:]
    row = SimpleNamespace(a=a, hypothesis=SimpleNamespace(core=Core(2, 2, 0, True), effects=(None,) * effects))
    assert Search.grows(SimpleNamespace(slow=np.exp(-4 / 1000)), row) == grows


@pytest.mark.parametrize(("pole", "at_rest", "kept"), [(1.0, True, True), (1.05, True, False), (1.05, False, True)])
def test_an_end_stop_holds_nothing_that_grows(pole, at_rest, kept):
    """Between its ends such a machine runs away from wherever it stands; what rubs holds it."""
    core = SimpleNamespace(given=False, integrating=False)
    effect = SimpleNamespace(where="motion", effect=SimpleNamespace(at_rest=at_rest))
    row = SimpleNamespace(
        hypothesis=SimpleNamespace(core=core, effects=(effect,)), a=np.array([pole]), met_at_rest=True, fitted=0.1,
        linearised=None, expands=set(),
    )  # fmt: skip
    search = SimpleNamespace(
        slow=np.exp(-4 / 146), tried=set(), runs_away=lambda row, a=None: True, _driven=lambda row, error: True
    )
    assert Search._keeps(search, row) == kept


def test_half_of_a_pair_is_what_promises_most():
    """A curve alone removes more of a loop than the loop alone does, but only beside the loop a curve explains all."""

    def row(price, *shares):
        named = [SimpleNamespace(variant=SimpleNamespace(id=name)) for name, _ in shares]
        scored = SimpleNamespace(directions=named, shares=np.array([share for _, share in shares]))
        return SimpleNamespace(ids=("hysteresis",), before_judged=price, scored=scored)

    table = SimpleNamespace(screened=lambda r: r.scored)
    curve = row(-7.0, ("creep", 0.4))
    loop = row(-6.9, ("hysteresis", 0.99), ("saturation", 0.8))  # what it has itself it needs no more
    assert Table._promised(table, curve) == pytest.approx(-7.0 + np.log(0.6))
    assert Table._promised(table, loop) == pytest.approx(-6.9 + np.log(0.2))


@pytest.mark.long
def test_a_large_core_that_imitates_a_line_is_priced_as_an_effect():
    """On a sine undamped poles of a large core follow the third harmonic of a bent response."""
    rng, t = np.random.default_rng(3), 0.03 * np.arange(2400)
    u = 1.8 + 1.78 * np.sin(2 * np.pi * t)
    y = lfilter([0.5], [1, -0.5], 11.9 * (u - 0.003 * u**3))
    record = ns.Record.from_arrays(u, y - y.mean() + 0.07 * rng.standard_normal(u.size), 0.03)
    search = Search(ns.identify(record, base="linear"), [record])
    large = [r for r in search.bases([0, 1, 2, 3]) if r.size.n_y > 3]
    assert all(r.more == (r.size.n_y - 3) // 2 == r.count for r in large)
    found = ns.diagnose(ns.identify(record, base="linear"), record)
    assert "saturation" in found.confusion_set


@pytest.mark.parametrize(("tail", "counts"), [((), {1: 2, 0: 1}), ((0.8,), {2: 2, 1: 1, 0: 1})], ids=["one", "two"])
def test_a_lag_of_an_effects_own_is_priced_where_the_machine_has_no_such_pole(tail, counts):
    """Behind a pole that the linear core has too, an effect has its place; a pole more is a rate dependence beside it."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-1, 1, 80), 15)
    y = lfilter([1.0], np.poly([0.9, *tail]), np.concatenate([[0.0], u[:-1]]))
    record = ns.Record.from_arrays(u, y + 0.002 * y.std() * rng.standard_normal(u.size), 0.01)
    base = ns.identify(record, base="linear", n_y=1, n_u=1, delay=1)
    search = Search(base, [record])
    search.bases([0, 1])
    saturation = {v.effect.lagged: v for v in variants(base, [], EFFECTS) if v.id == "saturation" and not v.lag}
    for n_y, count in counts.items():
        assert 1 + search._more(Hypothesis(Core(n_y, 1), (saturation[True],))) == count
        assert 1 + search._more(Hypothesis(Core(n_y, 1), (saturation[False],))) == 1


def test_a_row_is_carried_to_a_higher_rate():
    """Poles and zeros decay as much in as many samples; the gain stays."""
    factor, a, b = 5, np.array([1.3, -0.4]), np.array([0.5, -0.3])
    a_own, b_own = resampled(a, factor), zeroed(b, factor)
    gain = b_own.sum() * (1 - a_own.sum()) / (1 - a.sum()) / (1 - a_own.sum())
    assert gain == pytest.approx(b.sum() / (1 - a.sum()))
    assert -b_own[1] / b_own[0] == pytest.approx(0.6 ** (1 / factor))
    for unclear in ([0.0, 0.3], [0.3, -0.3]):  # no first coefficient, no gain
        made = zeroed(np.array(unclear), factor)
        assert np.isfinite(made).all() and made.sum() == pytest.approx(sum(unclear))


@pytest.mark.long
def test_a_structure_of_four_resonances_is_followed():
    """None of its parts does for the whole: the core is found by where fits of larger ones begin."""
    rng, Ts, N = np.random.default_rng(77), 0.002, 4000
    t = Ts * np.arange(N)
    u = np.sin(2 * np.pi * (0.5 + 8.0 * t) * t) + 0.25 * smooth(rng, N, 0.6)
    y = linear([4.0], [0.3, 1.0], u, Ts)
    for f, damping, gain in ((7, 0.02, 9.0), (18, 0.015, 13.0), (34, 0.012, 15.0), (52, 0.012, 18.0)):
        w = 2 * np.pi * f
        y = y + linear([gain, 0.0], [1.0, 2 * damping * w, w**2], u, Ts)
    record = record_of(u, y, Ts, 0.01)
    rows = Search(ns.identify(record, base="linear"), [record]).bases([0, 1])
    best = min(rows, key=lambda r: r.price)
    assert best.size.n_y >= 9 and best.held < 0.02**2


@pytest.mark.long
def test_a_gap_in_an_elastic_gear_is_named():
    """The gap lies between what is driven and what is measured: neither the input nor the output has a play."""
    rng, Ts, N, sub, gap = np.random.default_rng(5), 0.004, 2500, 8, 4.0
    t = Ts * np.arange(N + 1)
    u = 4 * sum(
        np.cos(2 * np.pi * f * t + p) for f, p in zip(np.geomspace(0.2, 5, 15), rng.uniform(0, 6, 15), strict=True)
    )
    y, x, speed = np.zeros(N), 4.0, 0.0
    for k in range(N):
        y[k] = x
        for i in range(sub):
            twist = u[k] + (u[k + 1] - u[k]) * i / sub - x
            force = np.sign(twist) * max(abs(twist) - gap, 0.0)
            speed += Ts / sub * (1200.0 * force - 8.0 * speed)
            x += Ts / sub * speed
    found = diagnosed(record_of(u[:N], y, Ts, 0.004))
    best = found.best
    assert found.confusion_set[0] == "backlash" and best.variant.effect.form == "elastic"
    assert best.parameters["r"] == pytest.approx(gap, rel=0.05) and best.parameters["d"] == pytest.approx(1.0, rel=0.02)


@more
@pytest.mark.parametrize(
    "m, k, F", [(0.02, 1.5, 0.6), (0.1, 0.0, 0.15)], ids=["nearly stuck on a spring", "on an axis that integrates"]
)
def test_a_friction_is_found_that_no_core_stands_without(m, k, F):
    """Without it the poles of most cores run away; with it they start from what is measured."""
    rng, t = np.random.default_rng(1), np.arange(3000) * 0.01
    waves = 0.6 * np.sin(0.5 * np.pi * t) + 0.4 * np.sin(1.66 * np.pi * t + 1)
    u = waves if k else np.repeat(rng.uniform(-1, 1, 40), 75)
    y = truths.rubbing(u, 0.01, m, 0.3 if k else 1.0, k, F)[:, 0]
    record = ns.Record.from_arrays(u, y + 0.005 * y.std() * rng.standard_normal(3000), 0.01)
    found = ns.diagnose(ns.identify(record, base="linear"), record)
    assert found.confusion_set == ["coulomb_friction"]
    assert found.ladder[-1]["train"] < 0.01


@pytest.mark.parametrize(
    ("m", "k", "measured"),
    [
        pytest.param(0.3, 0.0, 1, id="a speed", marks=more),
        pytest.param(0.1, 0.0, 0, id="an axis", marks=pytest.mark.bench),
        pytest.param(0.02, 1.5, 0, id="a stage on a spring", marks=pytest.mark.bench),
    ],
)
def test_friction_that_a_load_presses_on_is_that_of_the_load(m, k, measured):
    """It was told as a friction of one size and a gain that depends on the load: it holds, as the load lets it."""
    rng, t = np.random.default_rng(3), np.arange(3000) * 0.01
    load = 50.0 + 40.0 * np.sin(0.9 * t)
    u = np.interp(t, np.arange(0.0, 31.0, 0.7), rng.uniform(-2, 2, 45))
    y = truths.rubbing(u, 0.01, m, 0.5, k, 0.01 * load)[:, measured]
    y = y + 0.005 * y.std() * rng.standard_normal(3000)
    record = ns.Record.from_arrays(u, y, 0.01, channels={"load": load, "room": np.sin(0.3 * t)})
    found = diagnosed(record)
    assert found.verdict == "named" and found.confusion_set == ["channel_friction:load"]
    assert found.ladder[-1]["validation"] < 0.02


@pytest.mark.bench
def test_a_motor_that_does_not_begin_where_its_command_is():
    """Short records, each from rest at zero while the command stands elsewhere already: no derivative tells where."""
    rng, records = np.random.default_rng(6), []
    for _ in range(8):
        u = np.repeat(rng.uniform(-1, 1, 6), 25)
        y, at = np.zeros(150), 0.0
        for k in range(3, 150):
            y[k] = at = at + np.clip(u[k - 3] - at, -0.05, 0.035)
        records.append(ns.Record.from_arrays(u, 2 * y + 0.005 * rng.standard_normal(150), 0.02))
    found = ns.diagnose(ns.identify(records, base="linear"), records)
    assert found.confusion_set[0] == "rate_limit" and found.best.variant.effect.form == "two speeds"
    speeds = sorted(abs(float(found.best.parameters[n])) for n in "re")
    assert speeds == pytest.approx([0.035, 0.05], rel=0.05)


@pytest.mark.bench
def test_a_damper_whose_bump_and_rebound_differ_is_no_end_stop():
    """Its force follows the speed through a spring and oil, and yields: other levels in the two directions."""
    t = np.arange(3000) * 0.01
    u = 0.01 * (np.sin(2 * np.pi * 0.7 * t) + 0.6 * np.sin(2 * np.pi * 1.9 * t + 1))
    force, f = np.zeros(3000), 0.0
    for k in range(1, 3000):
        f = np.clip(0.8 * f + 4e5 * (u[k] - u[k - 1]), -300.0, 550.0)
        force[k] = f + 4000 * u[k]
    found = diagnosed(record_of(u, force, 0.01, 0.01))
    assert found.confusion_set[0] == "coulomb_friction" and found.best.variant.effect.form == "viscoelastic"
    assert found.ladder[-1]["validation"] < 0.015


@pytest.mark.bench
def test_several_measured_inputs_are_found_together():
    """Of four channels three act, as the input does: each alone leaves most of it. Their names are those of states."""
    rng = np.random.default_rng(4)
    u, *beside = (smooth(rng, 3000, 0.95) for _ in range(5))
    x = 2 * u + 0.6 * beside[0] + 0.6 * beside[1] - 1.2 * beside[3]
    y = lfilter([0.2], [1, -0.8], x)
    channels = dict(zip(("w1", "p", "f", "p1"), beside, strict=True))
    record = ns.Record.from_arrays(u, y + 0.01 * y.std() * rng.standard_normal(3000), 0.05, channels=channels)
    found = ns.diagnose(ns.identify(record, base="linear"), record, max_effects=3)
    assert sorted(found.confusion_set) == ["channel:p", "channel:p1", "channel:w1"]
    assert len(found.steps[0].added) == 3 and found.ladder[-1]["validation"] < 0.012
    assert found.sentence().startswith("3 effects are probably missing")


@pytest.mark.bench
def test_a_slack_is_found_beside_channels_that_are_called_like_its_states():
    rng = np.random.default_rng(5)
    u, load = smooth(rng, 2500, 0.95), smooth(rng, 2500, 0.98)
    y = lfilter([0.2], [1, -0.8], truths.play(2 * u, 0.7) + 0.8 * load)
    record = ns.Record.from_arrays(u, y + 0.01 * y.std() * rng.standard_normal(2500), 0.05, channels={"p": load})
    found = ns.diagnose(ns.identify(record, base="linear"), record, max_effects=2)
    assert {e for step in found.steps for e in step.added} == {"backlash", "channel:p"}
    assert found.ladder[-1]["validation"] < 0.02


@pytest.mark.long
def test_friction_of_the_driven_mass_of_a_drive_train():
    """Its torque passes the zeros of the train, as the motor's does: motor torque in, motor speed out."""
    rng, Ts, N, sub = np.random.default_rng(12), 0.002, 4000, 10
    u = smooth(rng, N, 0.6) * 1.2
    y, motor, load, twist = np.zeros(N), 0.0, 0.0, 0.0
    for k in range(N):
        y[k] = motor
        for _ in range(sub):
            coupling = 60.0 * twist + 0.05 * (motor - load)
            motor += Ts / sub * (u[k] - coupling - 0.35 * np.tanh(motor / 0.05)) / 0.002
            load += Ts / sub * (coupling - 0.01 * load) / 0.006
            twist += Ts / sub * (motor - load)
    found = diagnosed(record_of(u, y, Ts, 0.005))
    assert found.confusion_set[0] == "coulomb_friction" and found.best.variant.where == "force"
    base, after = (rung["validation"] for rung in found.ladder[:2])
    assert after < base / 3


@pytest.mark.long
def test_what_nobody_recorded_before_the_start_is_no_effect():
    """A record begins with a step, and with a dead time its first samples answer the input before it."""
    rng, N, late = np.random.default_rng(3), 2400, 30
    u = np.repeat(rng.choice([-1.0, 1.0], N // 40), 40)
    y = lfilter([0.01], np.convolve([1, -0.96], [1, -0.85]), np.r_[np.zeros(late), u][:N])
    record = record_of(u, y, 10.0, 0.01)
    found = diagnosed(record)
    assert found.verdict == "nothing_detectable" and found.steps[0].finding == "nothing_detectable"
    assert found.ladder[0]["validation"] < 0.015


@pytest.mark.long
def test_a_motor_that_is_recorded_as_a_speed_breaks_loose_by_a_jump():
    """It stands until the voltage is well above that at which it stops again."""
    Ts, fine, tau, gain = 0.02, 40, 0.1, 18.0
    t = Ts * np.arange(2000)
    u = 3 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * t / 4))  # a slow triangle
    y, speed = np.zeros(t.size), 0.0
    for k in range(t.size):
        y[k] = speed
        for _ in range(fine):
            holds = 0.2 + 0.7 * np.exp(-((speed / 0.5) ** 2))  # [V]
            if speed == 0 and abs(u[k]) <= holds:
                continue
            side = np.sign(speed) or np.sign(u[k])
            new = speed + Ts / fine / tau * (gain * (u[k] - holds * side) - speed)
            speed = new if new * side > 0 else 0.0
    found = diagnosed(record_of(u, y, Ts, 0.01))
    assert found.confusion_set == ["stiction"]
    base, after = (rung["train"] for rung in found.ladder)
    assert after < 0.02 < 0.04 < base


@more
def test_an_input_that_never_turns_back_shows_no_loop():
    """On a ramp a hysteresis is a curve, and follows any bend: it was named for a gain that falls beyond a level."""
    u = np.linspace(0, 10, 2000)
    y = lfilter([0.1], [1, -0.9], np.where(u < 7, u, 7 - 0.8 * (u - 7)))
    few = only("backlash", "cubic_gain", "hysteresis")

    def told(u, y):
        record = record_of(u, y, 0.01, 0.005)
        found = ns.diagnose(ns.identify(record, base="linear"), record, catalogue=few)
        ways = {(v.id, v.driver) for row in found.hypotheses for v in row.hypothesis.effects}
        return found, ways & {("hysteresis", "u"), ("backlash", "u")}

    found, loops = told(u, y)
    assert not loops and found.confusion_set[:1] != ["hysteresis"]
    assert any("never turns back" in note for note in found.data_notes)
    back, loops = told(np.concatenate([u, u[::-20]]), np.concatenate([y, y[::-20]]))
    assert loops and not any("never turns back" in note for note in back.data_notes)


@more
def test_what_acts_in_the_last_samples_only_is_not_called_nothing():
    """A gain that ends where the amplitude goes at last: no sample that is compared shows it."""
    k, n = np.arange(3000), 3000
    u = np.where(k < 0.93 * n, 1.0, 1.6) * np.sin(2 * np.pi * k / 120 * (1 + k / n))
    y = lfilter([0.05], [1, -0.95], np.clip(u, -1.02, 1.02))
    found = diagnosed(record_of(u, y, 0.01, 0.01))
    first = found.steps[0].base
    assert found.verdict == "nothing_detectable"
    assert found.ladder[0]["validation_rms"] > 3 * np.sqrt(first.mean_square(first.split.train))
    assert found.steps[0].finding == "unexplained" and "most of it in the last samples" in found.sentence()


@more
def test_of_two_effects_at_the_input_one_acts_behind_the_other():
    """An amplifier that saturates behind a slack: side by side no two effects explain it, and friction was named."""
    rng, n = np.random.default_rng(71), 3000
    u = sum(
        rng.uniform(0.5, 1.5) * np.sin(2 * np.pi * f * 0.01 * np.arange(n) + rng.uniform(0, 6.28))
        for f in rng.uniform(0.15, 2.0, 4)
    )
    p, most = np.full(n, u[0]), np.abs(u).max()
    for i in range(1, n):
        p[i] = max(u[i] - 0.12 * most, min(u[i] + 0.12 * most, p[i - 1]))
    y = lfilter([0, 0.06], np.convolve([1, -0.88], [1, -0.5]), np.clip(p, -0.6 * most, 0.6 * most))
    record = record_of(u, y, 0.01, 0.01)
    few = only("backlash", "saturation", "coulomb_friction")
    found = ns.diagnose(ns.identify(record, base="linear"), record, catalogue=few, max_effects=2)
    assert sorted(e for s in found.steps for e in s.added) == ["backlash", "saturation"]
    left = np.sqrt(found.last.mean_square(found.steps[0].base.split.held)) / np.std(record.y)
    assert left < 1.2 * 0.01 and found.model.compensator().closed_form


def sharp_loop(path, width, beta):
    """Return a Bouc-Wen memory of exponent 2 along a path, in small steps, (N,)."""
    z, out = 0.0, []
    for dx in np.diff(path, prepend=path[0]) / width:
        parts = 1 + int(abs(dx) / 0.02)
        for _ in range(parts):
            z += dx / parts * (1 - z * z * (beta + (1 - beta) * (1 if z * dx >= 0 else -1)))
        out.append(z)
    return np.array(out)


def staircase(rng, n):
    """Return ramps between random turning points, of one speed, (n,)."""
    points = np.cumsum(np.append(0.0, np.diff(rng.uniform(-2, 2, 40))))
    at = np.cumsum(np.append(0.0, np.abs(np.diff(points))))
    return np.interp(np.linspace(0, at[-1], n), at, points)


@pytest.fixture(scope="module")
def sharp():
    u = staircase(np.random.default_rng(3), 3000)
    y = lfilter([0, 0.2], [1, -0.8], u) + 0.4 * sharp_loop(u, 0.5, 0.55)
    return record_of(u, y, 0.01, 0.01)


@pytest.mark.bench
def test_a_loop_that_leaves_something_is_asked_in_a_closer_form(sharp):
    found = diagnosed(sharp)
    assert found.verdict == "named" and found.confusion_set == ["hysteresis"]
    assert found.best.variant.effect.form == "Bouc-Wen, sharp"
    assert found.last.mean_square(found.last.split.held) < (1.1 * 0.01 * np.std(sharp.y)) ** 2
    forms = {v.effect.form for row in found.hypotheses for v in row.hypothesis.effects if v.id != "hysteresis"}
    assert not any("sharp" in form for form in forms)


@more
def test_without_its_own_form_a_loop_is_a_superposition_of_plays(sharp):
    """Without the closer forms a superposition of plays costs least, with weights of one sign."""
    usual = Catalogue({name: [e for e in forms if not e.closer] for name, forms in EFFECTS.items()})
    found = ns.diagnose(ns.identify(sharp, base="linear"), sharp, catalogue=usual)
    cheapest = min((r for r in found.hypotheses if r.ids == ("hysteresis",)), key=lambda r: r.price)
    assert found.confusion_set == ["hysteresis"] and found.best.row is cheapest
    assert found.best.variant.effect.form == "play superposition" and cheapest.charged == 1


@pytest.mark.parametrize(
    "dearer, held, shown, told",
    [(0.2, True, True, "b"), (0.3, True, True, "a"), (0.2, False, True, "a"), (0.2, True, False, "a")],
    ids=["leaves nothing", "costs one effect more", "cannot be held", "is none at the own rate"],
)
def test_of_a_winner_the_cheapest_form_that_leaves_nothing_is_shown(dearer, held, shown, told):
    def row(form, price, left):
        return SimpleNamespace(
            form=form, ids=("x",), hypothesis=SimpleNamespace(effects=(form,)), price=price, left=left
        )

    best, other = row("a", 1.0, 0.5), row("b", 1.0 + dearer, 0.0)
    again = row("b", 1.05 + dearer, 0.0)  # the same form beside a dearer core
    table = SimpleNamespace(
        rows=[again, other, best], holds=lambda r: held or r is best, left=lambda r, base: r.left,
        _shows=lambda r, base: shown,
    )  # fmt: skip
    assert Table.complete(table, best, None).form == told
    assert Table.complete(table, best, None) is not again


def test_closer_forms_are_no_usual_ways():
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "1"])
    assert {v.effect.form for v in variants(base, closer=True)} == {"Bouc-Wen, wide", "Bouc-Wen, sharp"}
    assert not any(v.effect.closer for v in variants(base))


@pytest.mark.bench
def test_what_imitated_a_slack_goes_when_the_slack_comes():
    case = truths.case("pair", "saturation+backlash", 9911, "sine", level=0.005, Ts=0.005)
    record = ns.Record.from_arrays(case.u, case.y, case.Ts)
    found = ns.diagnose(ns.identify(record, base="linear"), record, max_effects=3)
    first, second = found.steps[:2]
    (imitator,) = set(first.added) - {"cubic_gain"}  # of the slack, beside what bends as the saturation does
    assert second.added == ["backlash"] and second.withdrawn == [imitator]
    assert found.rungs[2] == f"+ backlash instead of {imitator}"
    assert {e.effect for e in found.model.effects} == {"cubic_gain", "backlash"}
    assert second.nrmse(second.chosen)["validation"] < second.nrmse(second.base)["validation"] * 1.05
    told = found.to_dict()
    assert told["ladder"][2]["withdrawn"] == told["steps"][1]["withdrawn"] == [imitator]


def banded(seed):
    """Return a record of a damper whose band is slack after each reversal."""
    rng = np.random.default_rng(seed)
    i = np.arange(3000)
    u = rng.uniform(8, 12) * np.sin(i / rng.uniform(30, 60)) * (1 - 0.3 * np.sin(i / 700))
    at, y, gap, way = 0.0, np.empty(i.size), rng.uniform(0.6, 1.2), rng.uniform(0.5, 1.0)
    for k, here in enumerate(u):
        at = min(max(at, here - gap - way), here + gap + way)  # where the band is
        y[k] = 0.02 * here + np.sign(here - at) * max(abs(here - at) - gap, 0.0) / way
    return record_of(u, y, 0.01, 0.02, seed)


@more
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_damper_whose_band_is_slack_after_each_reversal_has_friction_and_a_slack(seed):
    record = banded(seed)
    found = ns.diagnose(ns.identify(record, base="linear"), record, max_effects=2)
    assert found.steps[0].added == ["coulomb_friction", "backlash"]
    assert found.ladder[-1]["validation"] < 0.03 < 0.1 < found.ladder[0]["validation"]


@more
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_slack_of_what_rubs_comes_after_what_rubs(seed):
    """Of the two the friction is added first: a slack elsewhere explains more by itself, and is no part of the pair."""
    record = banded(seed)
    few = only("backlash", "coulomb_friction", "hysteresis")
    one = ns.diagnose(ns.identify(record, base="linear"), record, catalogue=few)
    assert one.steps[0].added == ["coulomb_friction"]
    both = ns.diagnose(one.model, record, catalogue=few)
    assert both.confusion_set == ["backlash"] and both.best.where == "friction"
    assert both.ladder[-1]["validation"] < 0.03


def test_without_a_friction_there_is_none_of_its_slack():
    record = banded(2)
    search = Search(ns.identify(record, base="linear", n_y=1, n_u=1, delay=1), [record])
    slack, rubs = (
        next(Variant(e, where, driver) for e in EFFECTS[name] if e.form == form)
        for name, form, where, driver in (
            ("backlash", "of what rubs", "friction", "friction"), ("coulomb_friction", "elastic", "output", "u")
        )
    )  # fmt: skip
    search.limits |= {slack: {"w": (0.05, 0.9)}, rubs: {"r": (0.1, 5.0)}}
    bare = search.bases([0])[0]
    (friction, *_) = search.look([bare], rubs, [(1.5,)])
    (both, *_) = search.look([friction], slack, [(0.5,)])
    assert both.ids == ("coulomb_friction", "backlash") and both.fitted < 0.1 * friction.fitted
    assert search.added(bare, slack, both) is None and search.look([bare], slack, [(0.5,)]) == []


@more
def test_what_counts_samples_counts_more_of_them_at_the_records_own_rate():
    """A position sensor whose blips are longer than a step: the velocity over as long a time is that of the table."""
    rng, n = np.random.default_rng(3), 9000
    u = 20 * np.abs(2 * ((5 * np.arange(n) / n) % 1) - 1)
    moving = np.sign(np.diff(u, prepend=u[0] + 1))
    y = 0.02 * u + lfilter([0.2], [1, -0.8], moving)
    read = u + 0.1 * (rng.random(n) < 0.01) + 0.01 * rng.standard_normal(n)
    record = record_of(read, y, 0.01, 0.01)
    forms = [e for e in EFFECTS["coulomb_friction"] if e.form == "averaged velocity"]
    found = ns.diagnose(ns.identify(record, base="static"), record, catalogue=Catalogue({"coulomb_friction": forms}))
    (candidate,) = found.candidates
    (row,) = {r for r in found.hypotheses if r.hypothesis == candidate.row.hypothesis}
    (averaged,) = (dict(v.fixed)["n"] for v in row.hypothesis.effects)
    (note,) = (text for text in found.data_notes if "averaged into one" in text)
    factor = int(note.split()[5])
    (added,) = found.last.model.effects
    assert factor > 1 and added.fixed["n"] == factor * averaged and f"n = {factor * averaged}" in str(candidate.variant)
    assert found.ladder[-1]["validation"] < 1.2 * np.sqrt(row.held) + 0.01


def test_without_noise_nothing_is_missing_that_rounding_makes():
    """An input that is held and averaged leaves 1e-3 at the working rate; at the record's own it is 1e-14."""
    u = np.repeat(np.random.default_rng(4).uniform(-1, 1, 60), 50)
    found = diagnosed(record_of(u, linear([1], [0.15, 1], u, 0.01), 0.01, 0.0), LAGS).steps[0]
    assert found.finding == "nothing_detectable" and not found.nearest
    assert found.nrmse(found.base)["validation"] < 1e-9


@more
@pytest.mark.parametrize(
    "moved, told",
    [(lambda u: truths.play(u, 0.4), {"backlash"}), (lambda u: np.clip(u, -1.2, 1.2), {"saturation", "output_limit"})],
    ids=["slack", "limit"],
)
def test_without_noise_what_is_exact_is_told_by_its_parameters(moved, told):
    """A play and five of them leave nothing but rounding, as do a limit of the input and of the output of a gain.

    What holds the motion of a core that forgets at once is that play, too.
    """
    t = 0.01 * np.arange(2000)
    u = 2 * np.sin(2 * np.pi * 0.3 * t) + np.sin(2 * np.pi * 0.97 * t)
    found = diagnosed(record_of(u, 1.5 * moved(u), 0.01, 0.0))
    assert set(found.confusion_set) == told
    assert found.ladder[-1]["validation"] < 1e-9


@more
@pytest.mark.parametrize(("axis", "rest"), [(True, 0), (False, 0), (False, 12)])
def test_of_records_that_each_answer_a_step_the_levels_tell(axis, rest):
    """A dead zone shows in what comes of the levels; what only acts where something turns does not."""
    records = []
    for level in (10, 20, 40, 60, 100):
        speed = lfilter([0, 0.1], [1, -0.9], np.full(400, max(level - rest, 0.0)))
        y = lfilter([0, 1], [1, -1.0 if axis else -0.97], speed)
        y += 0.05 * np.random.default_rng(level).standard_normal(400)
        records.append(ns.Record.from_arrays(np.full(400, float(level)), y, 0.01, name=f"r{level}"))
    few = only("backlash", "creep", "dead_zone", "drift", "hysteresis", "quadratic_drag")
    found = ns.diagnose(ns.identify(records, base="linear"), records, catalogue=few)
    assert found.confusion_set == ([] if rest == 0 else ["dead_zone"]), found
