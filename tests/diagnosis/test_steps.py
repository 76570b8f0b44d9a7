"""What steps show: one of them nothing but a linear machine, several sizes a dead zone, and creep behind a core's lags."""

import numpy as np
from sampling import more, only
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.data.evidence.levels import one_step
from narx_sym.report.words import headline, what_next


def limited(level: float, seed: int, back: bool = False, rest: int = 20) -> ns.Record:
    """Return the answer of a lag whose speed is limited to one step of the input, and back."""
    u = level * np.repeat([0.0, 1.0, 0.0 if back else 1.0], (rest, 120, 100))
    v = np.zeros(u.size)
    for i in range(1, u.size):
        v[i] = v[i - 1] + np.clip(u[i] - v[i - 1], -0.02, 0.02)
    y = lfilter([0, 0.1], [1, -0.9], v) + 0.002 * np.random.default_rng(seed).standard_normal(u.size)
    return ns.Record.from_arrays(u, y, Ts=0.01, name=f"{level}")


def test_of_one_step_nothing_is_named():
    record, noise = limited(1.0, 1), np.random.default_rng(2).standard_normal(240)
    assert one_step([record]) and one_step([record, limited(1.0, 2, rest=30)])
    assert not one_step([limited(1.0, 1, back=True)]) and not one_step([record, limited(0.5, 1)])
    assert not one_step([ns.Record.from_arrays(noise, record.y, Ts=0.01)])
    last = ns.Record.from_arrays(np.append(record.u, 0.0), np.append(record.y, record.y[-1]), Ts=0.01)
    assert one_step([last])  # the record ends before the second one has an answer
    base = ns.identify(record, base="linear", n_y=2, n_u=1, delay=1)
    found = ns.diagnose(base, record, catalogue=only("rate_limit", "backlash", "saturation", "drift"))
    assert found.verdict == "nothing_detectable" and not found.steps[0].smallest_detectable
    assert found.steps[0].finding == "one_step" and "The input is a single step" in found.sentence()
    assert headline(found) == "No effect can be named from a single step of the input."
    assert what_next(found) == "Record steps of several sizes, up and down."


@more
def test_steps_of_two_sizes_show_what_one_does_not():
    records = [limited(level, i, back=True) for i, level in enumerate((0.3, 1.0))]
    assert ns.diagnose(ns.identify(records, base="linear"), records).confusion_set == ["rate_limit"]


@more
def test_a_record_at_rest_tells_of_a_dead_zone():
    rng, records = np.random.default_rng(5), []
    for level in (0.4, 0.9, -1.5, 2.5):
        u = level * np.repeat([0.0, 1.0, 0.0], (20, 120, 120))
        y = lfilter([0, 0.1], [1, -0.9], u - np.clip(u, -0.6, 0.6))
        noise = 0.002 * rng.standard_normal(u.size) * (abs(level) > 0.6)
        records.append(ns.Record.from_arrays(u, y + noise, Ts=0.01, name=f"{level}"))
    few = only("dead_zone", "saturation", "backlash")
    found = ns.diagnose(ns.identify(records, base="linear"), records, catalogue=few)
    assert found.candidates[0].effect == "dead_zone"
    assert abs(found.candidates[0].parameters["r"] - 0.6) < 0.02


@more
def test_the_lags_of_a_core_do_not_stand_for_creep_behind_a_limit():
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-1, 1, 250), 12)
    fast = lfilter([0, 0.1, 0.08], [1, -1.5, 0.6], np.clip(u, -0.6, 0.6))
    slow = [np.exp(-0.01 / tau) for tau in (0.7, 2.1, 6.3)]
    y = fast + 0.06 * sum(lfilter([0, 1 - a], [1, -a], fast) for a in slow)
    record = ns.Record.from_arrays(u, y + 0.003 * np.std(y) * rng.standard_normal(u.size), Ts=0.01)
    found = ns.diagnose(ns.identify(record, base="linear"), record)
    assert found.confusion_set == ["saturation", "creep"]
