"""What a record says before any model."""

from dataclasses import replace

import evidence
import numpy as np
import pytest
import truths
from sampling import only, some
from scipy.signal import butter, lfilter

import narx_sym as ns
from narx_sym.data.evidence.dead_time import dead_time
from narx_sym.data.evidence.feedback import feedback
from narx_sym.data.evidence.levels import one_speed, one_way, turns, two_levels
from narx_sym.data.evidence.noise import sensor_noise, unexplained
from narx_sym.data.evidence.stiction import span_of, sticking
from narx_sym.diagnosis.procedure import diagnose
from narx_sym.fit.identify import identify


@pytest.mark.parametrize(("d", "source"), [(0, "steps"), (7, "two levels"), (60, "noise")])
def test_a_dead_time_is_found_exactly(d, source):
    rng = np.random.default_rng(d)
    _, record = evidence.delayed(evidence.driven(source, rng, 1000), d, rng)
    found = dead_time([record])
    assert found.samples == d and d in found.among
    assert found.long == (d >= 4)


@pytest.mark.parametrize("seed", some(range(4), 2))
def test_a_loop_is_recognised(seed):
    kind, record = evidence.loop(np.random.default_rng(seed), 800)
    assert feedback(record).found, kind


def test_without_the_setpoint_many_loops_are_recognised():
    loops = [evidence.loop(np.random.default_rng(seed), 800)[1] for seed in range(4)]
    bare = [ns.Record.from_arrays(r.u, r.y, Ts=r.Ts) for r in loops]
    assert sum(feedback(r).found for r in bare) >= 3


def test_a_controller_that_answers_one_sample_late_is_seen_by_the_past():
    """A setpoint that wanders and is not recorded hides the form of the answer, not that it is foretold."""
    rng = np.random.default_rng(0)
    n, u, y = 1500, np.zeros(1500), np.zeros(1500)
    wanted = np.cumsum(0.02 * rng.standard_normal(n))
    for k in range(1, n):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1] + 0.05 * rng.standard_normal()
        u[k] = 2 * (wanted[k] - y[k - 1])
    assert feedback(ns.Record.from_arrays(u, y, Ts=0.1)).found


def test_the_controller_of_an_unstable_plant_is_seen_by_its_sign():
    """A levitated body: state feedback without an integral, and a setpoint that is not recorded."""
    found = []
    for seed in range(4, 8):
        rng = np.random.default_rng(seed)
        u, y, v = np.zeros(2000), np.zeros(2000), 0.0
        for k in range(1, u.size):
            v += 0.002 * y[k - 1] + 0.02 * u[k - 1] + 0.002 * rng.standard_normal()
            y[k] = y[k - 1] + v
            wanted = 0.3 * np.sin(k / 40) + 0.01 * rng.standard_normal()
            u[k] = 0.3 * u[k - 1] + 0.5 * (wanted - y[k]) - 6 * (y[k] - y[k - 1])
        found.append(feedback(ns.Record.from_arrays(u, y, Ts=0.001)).found)
    assert sum(found) >= 3


def _held_loop(every, rng):
    """A lag of 0.3 s at 10 ms under a PI controller that acts every so many samples, with a load; u, y, the setpoint."""
    n, x, whole, load = 4000, 0.0, 0.0, 0.0
    u, y, wanted = np.zeros(n), np.zeros(n), np.repeat(rng.uniform(-1, 1, n // 400), 400)
    for k in range(n):
        y[k], u[k] = x + 0.005 * rng.standard_normal(), u[k - 1]
        if k % every == 0:
            whole += (wanted[k] - y[k]) * 0.01 * every
            u[k] = 3 * (wanted[k] - y[k]) + 6 * whole
        load = 0.99 * load + 0.02 * rng.standard_normal()
        x += 0.033 * (u[k] + load - x)
    return u, y


@pytest.mark.parametrize("every", [3, 5, 10])
def test_a_controller_that_holds_its_output_answers_when_it_moves(every):
    u, y = _held_loop(every, np.random.default_rng(every))
    assert feedback(ns.Record.from_arrays(u, y, Ts=0.01)).found


def test_an_input_that_is_held_and_answers_nothing_is_no_loop():
    found = []
    for seed, every in enumerate((3, 10, 25)):
        rng, t = np.random.default_rng(seed), 0.01 * np.arange(6000)
        waves = sum(
            np.sin(2 * np.pi * f * t + p) for f, p in zip((0.11, 0.37, 0.83), rng.uniform(0, 6, 3), strict=True)
        )
        for u in (waves, lfilter([1.0], [1.0, -0.9], rng.standard_normal(t.size))):
            held = np.repeat(u[::every], every)[: t.size]
            y = lfilter([0.0, 0.04], [1.0, -0.96], held)
            y += 0.01 * y.std() * rng.standard_normal(t.size)
            found.append(feedback(ns.Record.from_arrays(held, y, Ts=0.01)).found)
    assert not any(found)


def test_who_took_a_record_in_the_open_loop_may_say_so():
    """A lead passes more of its input on at once than in the end, as a controller does read backwards."""
    rng = np.random.default_rng(0)
    u = lfilter([1.0], [1.0, -0.9], rng.standard_normal(1500))
    y = lfilter([5.0, -4.9], [1.0, -0.9], u)
    record = ns.Record.from_arrays(u, y + 0.01 * y.std() * rng.standard_normal(u.size), Ts=0.01)
    base = identify(record, base="linear")
    found = diagnose(base, record)
    assert found.verdict == "closed_loop" and "--open-loop" in found.sentence()
    assert diagnose(base, record, open_loop=True, catalogue=only("drift", "saturation")).verdict == "nothing_detectable"


def test_dampers_read_backwards_are_seldom_taken_for_controllers():
    assert evidence.dampers(seed=3, count=60) <= 3


@pytest.mark.parametrize("source", evidence.INPUTS)
def test_an_open_loop_is_none(source):
    for d, noise in ((0, 0.0), (0, 0.03), (2, 0.003)):
        rng = np.random.default_rng(d)
        assert not feedback(evidence.delayed(evidence.driven(source, rng, 800), d, rng, noise)[1]).found


def test_nothing_is_named_in_closed_loop():
    _, record = evidence.loop(np.random.default_rng(0), 800)
    found = diagnose(identify(record, base="linear", n_y=1, n_u=1, delay=1, lags={"setpoint": []}), record)
    assert found.verdict == "closed_loop" and not found.candidates and "closed loop" in found.sentence()
    assert "closed_loop" in str(found.to_dict()) and found.model is found.steps[0].base.model


@pytest.mark.long
def test_a_valve_is_asked_for_without_a_setpoint_too():
    """That the loop is closed is seen; the valve then "may stick", and nothing is said of one in order."""
    told = {5.0: 0, 0.1: 0}
    for stiction in told:
        for seed in range(4):
            record = evidence.valve_loop(np.random.default_rng(seed), stiction, 0.5 * stiction)
            bare = ns.Record.from_arrays(record.u, record.y, Ts=record.Ts)
            if feedback(bare).found:
                first = diagnose(identify(bare, base="linear"), bare).steps[0]
                assert first.verdict == "closed_loop" and ("may stick" in first.sentence({})) == bool(first.valves)
                told[stiction] += bool(first.valves)
    assert told[5.0] >= 2 and told[0.1] == 0


def test_valves_that_stick_and_valves_in_order():
    rng = np.random.default_rng(7)
    judged = [(S, sticking(evidence.valve_loop(rng, S, 0.5 * S, 500))) for S in (5.0, 0.1, 4.0, 0.2)]
    assert sum(found.found == (S > 1) for S, found in judged) >= 3
    for _, found in judged:
        assert ("The valve probably sticks" in found.sentence) == found.found and found.band >= found.found


@pytest.mark.parametrize(("span", "low", "unit"), [(1.0, 0.0, ""), (16.0, 4.0, "mA")])
def test_a_valve_sticks_in_every_unit_of_its_controller(span, low, unit):
    loop = evidence.valve_loop(np.random.default_rng(3), 5.0, 2.5)
    u, units = low + loop.u * span / 100, {"u": unit} if unit else None
    other = ns.Record.from_arrays(u, loop.y, Ts=loop.Ts, channels=loop.channels, units=units)
    found, same = sticking(loop), sticking(other)
    assert found.found and same.found and np.isclose(100 * same.band / span, found.band)


def test_without_a_setpoint_that_moves_a_valve_only_may_stick():
    """A load that steps looks like a valve then; a setpoint that is recorded with its unit is one."""
    loop = evidence.valve_loop(np.random.default_rng(3), 5.0, 2.5)
    found = sticking(ns.Record.from_arrays(loop.u, loop.y, Ts=loop.Ts))
    assert found.perhaps and not found.found and "may stick" in found.sentence
    moved = {"setpoint_m3_h": loop.channels["setpoint"]}
    assert sticking(ns.Record.from_arrays(loop.u, loop.y, Ts=loop.Ts, channels=moved)).found


def cycling(static, moving, load=0.0, n=1200):
    """Return a flow loop under integral control at a setpoint that rests; its valve sticks within `static` % of span."""
    rng = np.random.default_rng(5)
    u, y, x, flow, total = np.zeros(n), np.zeros(n), 50.2, 0.0, 0.0
    for k in range(n):
        y[k] = flow + 0.02 * rng.standard_normal()
        total -= 0.02 * y[k]
        u[k] = 50 + total - 0.1 * y[k]
        if abs(u[k] - x) > static:
            x = u[k] - moving * np.sign(u[k] - x)
        flow += 0.3 * (4 * (x - 50) + load * np.sin(0.02 * k) - flow)
    return ns.Record.from_arrays(u, y, Ts=10.0, channels={"setpoint": np.zeros(n)})


def test_a_loop_that_cycles_by_its_valve_at_rest():
    """The valve of a loop may stick within its specification, and make it cycle; a load moves OP by far more."""
    found = sticking(cycling(0.4, 0.1))
    assert found.perhaps and found.band < 1.0 and 2 * found.band >= np.ptp(found.record.u)
    assert "may stick" in found.sentence
    driven = sticking(cycling(1.0, 0.5, load=60.0))
    assert not driven.perhaps and driven.band >= 1.0 and "times as large: this comes from the load" in driven.sentence


def test_a_load_on_a_healthy_loop_is_no_valve_that_sticks():
    """Under feedback the controller's output follows the load, which a process without a model of the load cannot tell."""
    wrong = []
    for seed in range(20, 40):
        kind, loop = evidence.loop(np.random.default_rng(seed), 1500)
        u = 10 + 80 * (loop.u - loop.u.min()) / np.ptp(loop.u)
        scaled = ns.Record.from_arrays(u, loop.y, Ts=loop.Ts, channels=loop.channels)
        wrong += [kind] if sticking(scaled).found else []
    assert len(wrong) <= 1, wrong


def test_a_setpoint_that_tells_nothing():
    rng = np.random.default_rng(4)
    _, record = evidence.delayed(evidence.driven("steps", rng, 800), 1, rng)

    def seen(setpoint):
        return feedback(ns.Record.from_arrays(record.u, record.y, Ts=record.Ts, channels={"setpoint": setpoint}))

    for copy in (record.u, record.y, np.array([float(f"{v:.8g}") for v in record.y])):
        assert not seen(copy).given and not seen(copy).found
    resting = seen(np.full(800, 2.0))
    assert resting.given and resting.unseen and "leave the setpoint out" in resting.sentence
    _, loop = evidence.loop(np.random.default_rng(0), 800)
    still = ns.Record.from_arrays(loop.u, loop.y, Ts=loop.Ts, channels={"setpoint": np.zeros(800)})
    assert feedback(still).found and "taken in closed loop: the output explains" in feedback(still).sentence
    other = seen(np.roll(record.u, 7))
    assert other.given and not other.unseen and "has a setpoint" in other.sentence


@pytest.mark.parametrize("name", ["setpoint", "SP", "r", "r_deg", "Ref", "setpoint_m3_h"])
def test_a_reference_is_a_setpoint(name):
    _, loop = evidence.loop(np.random.default_rng(0), 300)
    named = ns.Record.from_arrays(loop.u, loop.y, Ts=loop.Ts, channels={name: np.arange(300.0)})
    assert feedback(named).given
    other = ns.Record.from_arrays(loop.u, loop.y, Ts=loop.Ts, channels={"rate": np.arange(300.0)})
    assert not feedback(other).given


@pytest.mark.parametrize("source", ["steps", "multisine", "noise"])
def test_the_noise_of_the_sensor(source):
    rng = np.random.default_rng(5)
    _, record = evidence.delayed(evidence.driven(source, rng, 1500), 1, rng, 0.0)
    size = 0.01 * np.std(record.y)
    load = np.cumsum(rng.standard_normal(1500)) * 0.05 * size  # slow: not the sensor's
    noisy = ns.Record.from_arrays(record.u, record.y + load + size * rng.standard_normal(1500), Ts=0.1)
    assert 0.7 < sensor_noise([noisy]) / size < 1.5


def test_periods_that_drift_are_no_noise():
    rng, t = np.random.default_rng(0), np.arange(1200)
    u = np.sign(np.sin(2 * np.pi * t / 100))  # jumps: differences alone would not do
    y = u * (1 + 0.3 * t / 1200) + t / 400 + 0.01 * rng.standard_normal(1200)
    assert 0.7 < sensor_noise([ns.Record.from_arrays(u, y, Ts=0.1)], 100) / 0.01 < 1.5


def test_what_the_sensor_cannot_make_is_said():
    slow = np.sin(2 * np.pi * 2.0 * np.arange(1000) * 0.01)
    said = unexplained(slow, 0.01, 0.01)
    assert "0.707 rms" in said and "2 Hz" in said
    assert unexplained(0.01 * slow, 0.01, 0.01) == unexplained(slow, 0.0, 0.01) == ""


def test_every_base_takes_a_long_dead_time():
    rng = np.random.default_rng(1)
    u = evidence.driven("steps", rng, 600)
    y = np.zeros(600)
    for k in range(9, 600):
        y[k] = 0.8 * y[k - 1] + 0.2 * u[k - 9]
    record = ns.Record.from_arrays(u, y + 0.002 * rng.standard_normal(600), Ts=0.1)
    assert identify(record, base="linear", n_y=1, n_u=1).delay == identify(record, base="static").delay == 9
    assert identify(record, base="linear", n_y=1, n_u=1, delay=2).delay == 2


def test_hysteresis_is_no_dead_time():
    u = np.sin(2 * np.pi * np.arange(1200) / 150)
    rng = np.random.default_rng(0)
    assert not dead_time(
        [ns.Record.from_arrays(u, truths.play(u, 0.4) + 0.01 * rng.standard_normal(1200), Ts=0.01)]
    ).long


@pytest.mark.long
@pytest.mark.parametrize("friction", (0.0, 0.3))
def test_friction_of_an_axis_under_control_is_named_and_a_healthy_one_has_none(friction):
    rng = np.random.default_rng(3)
    verdict = "coulomb_friction" if friction else "closed_loop"
    record = evidence.servo(rng, friction, 2000)
    found = diagnose(identify(record, base="linear", lags={"setpoint": []}), record)
    assert verdict in (found.verdict, *found.confusion_set)
    assert "taken in closed loop" in found.sentence() and ("only a small part" in found.sentence()) == bool(friction)


def test_what_y_remembers_of_steps_on_sines_is_no_answer():
    """After a step the past of the input foretells it badly; what a lag makes of the step helps, but is no controller."""
    found = []
    for seed in range(6):
        rng, t = np.random.default_rng(seed), 0.01 * np.arange(6000)
        steps = np.repeat(rng.uniform(-4, 4, 100), 60)
        u = 8 * np.sin(0.5 * np.pi * t) + 5 * np.sin(0.14 * np.pi * t) + steps
        y = lfilter([0.0, 0.04 * 33], [1.0, -0.967], u) + 0.3 * rng.standard_normal(t.size)
        found.append(feedback(ns.Record.from_arrays(u, y, Ts=0.01)).found)
    assert sum(found) <= 1


def test_the_force_of_a_viscoelastic_damper_is_no_answer_of_its_displacement():
    """It follows the speed, and a speed returns to its mean by itself."""
    found = []
    for seed in range(6):
        rng, over, fine = np.random.default_rng(seed), 20, 0.00025
        b, a = butter(2, 3, fs=1 / fine)
        u = lfilter(b, a, rng.standard_normal(3000 * over))
        u *= 4 / u.std()
        y = (12 * u + 0.3 * np.gradient(u, fine))[::over]
        y += 0.008 * y.std() * rng.standard_normal(y.size)
        found.append(feedback(ns.Record.from_arrays(u[::over], y, Ts=fine * over)).found)
    assert sum(found) <= 1


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_sweep_that_begins_again_is_no_answer(noise):
    """Where it jumps back a fit of its past is bent everywhere: what goes on as before is not new all the same."""
    rng, ramp = np.random.default_rng(0), np.arange(1.0, 71.0)
    u = np.tile(np.concatenate([ramp, -ramp]), 10)
    moved = np.sign(u) * np.maximum(np.abs(u) - 8, 0)
    y = 2.2 * moved + noise * (moved != 0) * rng.standard_normal(u.size)
    found = feedback(ns.Record.from_arrays(u, y, Ts=1.0))
    assert not found.found and found.fresh < 0.03


@pytest.mark.parametrize(("way", "back"), [("up", False), ("down", False), ("up and down", True), ("noisy up", False)])
def test_whether_a_signal_turns_back(way, back):
    up = np.linspace(-1, 3, 400)
    ways = {"up": up, "down": -up, "up and down": np.concatenate([up, up[:200:-1]])}
    noisy = up + 0.02 * np.random.default_rng(0).standard_normal(400)
    assert turns(ways.get(way, noisy)) is back
    assert not turns(np.ones(3))


@pytest.mark.parametrize(
    ("shape", "said"),
    [(lambda t: np.clip(t - 1, 0, 6), "a lag and a drift cannot be distinguished"), (lambda t: t**2, "static curve"), (np.floor, "static curve"),
     (lambda t: 1.0 * (t > 3), "static curve"), (np.sin, None)],
    ids=["ramp", "faster and faster", "staircase", "step", "back"],
)  # fmt: skip
def test_a_ramp_tells_no_curve_from_a_lag_or_a_drift(shape, said):
    t = np.arange(900) / 100
    told = one_way(ns.Record.from_arrays(shape(t), np.zeros(900), 0.01))
    assert [note.endswith(said) for note in told] == ([True] if said else [])


def test_levels_between_which_there_is_a_gap_are_no_ramp():
    u = np.repeat([0.0, 1.0], 100)
    record = ns.Record.from_arrays(u, u, 0.01)
    (said,) = one_way(replace(record, breaks=(100,)))
    assert said.endswith("static curve")


def test_an_input_of_one_speed():
    """A triangle, with the blips of its sensor, and one way there and back; no sine, noise, levels or single way."""
    t, rng = np.arange(6000) / 6000, np.random.default_rng(0)

    def record(u):
        return ns.Record.from_arrays(u, lfilter([0.1], [1, -0.9], u), Ts=0.01, name="seal")

    def triangle(cycles):
        return np.abs(2 * ((cycles * t) % 1) - 1)

    blips = 0.02 * (rng.random(t.size) < 0.01)
    assert all(one_speed([record(u)]) for u in (triangle(5), triangle(5) + blips, triangle(1)))
    others = {
        "sine": np.sin(10 * np.pi * t), "noise": lfilter([1], [1, -0.99], rng.standard_normal(t.size)),
        "levels": np.sign(np.sin(10 * np.pi * t)), "two speeds": triangle(5) + (t > 0.5) * triangle(20),
        "ramp": t,
    }  # fmt: skip
    assert not [name for name, u in others.items() if one_speed([record(u)])]
    assert one_speed([record(triangle(5)), record(triangle(5))])
    assert not one_speed([record(triangle(5)), record(triangle(20))])  # together they move at two


def test_a_setpoint_that_hardly_moves_does_not_clear_the_load():
    """One step, or a historian's jitter, on a loop that its load moves: what looks like stiction may be the load."""
    loop = cycling(0.4, 0.1)
    resting = np.full(len(loop), float(loop.y.mean()))
    jitter = resting + 1e-5 * np.random.default_rng(0).standard_normal(len(loop))
    once = resting + np.ptp(loop.y) * (np.arange(len(loop)) > 250)
    for setpoint in (resting, jitter, once):
        found = sticking(ns.Record.from_arrays(loop.u, loop.y, Ts=loop.Ts, channels={"setpoint": setpoint}))
        assert found.band and found.perhaps and not found.found


def test_a_bent_valve_is_none_that_sticks():
    """An equal-percentage valve, ten times steeper open than shut, behind a controller whose setpoint moves far."""
    rng, n = np.random.default_rng(5), 1500
    wanted = 50 + np.repeat(rng.uniform(-15, 15, n // 300), 300)
    op, pv, total, level = np.zeros(n), np.zeros(n), 50.0, 0.0
    for k in range(n):
        pv[k] = 50 + level + 0.1 * rng.standard_normal()
        error = wanted[k] - pv[k]
        total += 0.05 * error
        op[k] = np.clip(total + error, 0, 100)
        moved = 50.0 ** (op[max(k - 3, 0)] / 100 - 0.5) / np.log(50) * 100 - 100 / np.log(50)
        level += 0.03 * (moved - level)
    assert not sticking(ns.Record.from_arrays(op, pv, Ts=1.0, channels={"setpoint": wanted})).found


def test_of_an_output_in_another_unit_no_span_is_guessed():
    loop = cycling(0.4, 0.1)
    for unit, span in (("", 100.0), ("%", 100.0), ("m3/h", 0.0), ("V", 0.0)):
        assert span_of(ns.Record.from_arrays(loop.u, loop.y, Ts=loop.Ts, units={"u": unit} if unit else {})) == span


def test_two_levels_have_noise_only_where_it_is_more_than_rounding():
    u = np.where(np.arange(60) % 20 < 10, 0.1, 0.7)
    assert two_levels(u + 1e-16 * np.arange(60)) is None and two_levels(u) is None
    assert two_levels(u + 0.01 * np.sin(2.5 * np.arange(60))) is not None
    assert two_levels(u + 0.01 * np.sin(0.5 * np.arange(60))) is None  # what goes on from sample to sample excites
    assert two_levels(np.where(np.arange(60) == 7, 3.0, u + 0.001 * np.sin(2.5 * np.arange(60)))) is None  # a pulse
