"""Clipped and stepped measurements, seen in the record itself."""

import numpy as np
import pytest
import truths
from sampling import more, only

import narx_sym as ns
from narx_sym.data.sensor import quantum, sensor_faults
from narx_sym.diagnosis import procedure
from narx_sym.report.words import what_next

N, Ts = 3000, 0.01
rng = np.random.default_rng(8)
t = Ts * np.arange(N)
u = np.sin(2 * t) + 0.5 * np.sin(5.1 * t)
y = np.convolve(u, np.exp(-np.arange(40) / 8) / 8)[:N] + 0.005 * rng.standard_normal(N)


def faults(values, floor=0.005):
    return sensor_faults([ns.Record.from_arrays(u, values, Ts)], floor)


def test_nothing_where_nothing_is():
    assert faults(y) == []
    assert faults(np.round(y, 6)) == []  # the digits of a file are no coarse converter


def test_a_machine_that_is_not_yet_on():
    (fault,) = faults(np.where(t < 3, 1.5, y))
    assert fault.effect == "frozen_sensor" and fault.rows == (0, 300)


def test_clipped():
    (fault,) = faults(np.minimum(y, 0.9))
    assert fault.effect == "sensor_saturation" and fault.size == 0.9
    assert fault.share == pytest.approx(np.mean(y >= 0.9))
    assert "cut off at 0.9" in fault.sentence
    assert [f.size for f in faults(np.clip(y, -0.7, 0.7))] == [0.7, -0.7]


def test_steps():
    (fault,) = faults(0.02 * np.round(y / 0.02))
    assert fault.effect == "quantisation" and fault.size == pytest.approx(0.02)
    assert fault.share == pytest.approx(0.02**2 / 12 / 0.005**2, rel=1e-3) or fault.share == 1.0
    assert "steps of 0.02" in fault.sentence


def test_rounding_cuts_nothing_off():
    """A converter rests at its last level for a while; what is cut off piles up there."""
    held = np.repeat(np.random.default_rng(3).uniform(-1, 1, N // 20), 20)
    smooth = np.convolve(held, np.exp(-np.arange(60) / 12) / 12)[:N]
    for step in (0.02, 0.05, 0.1):
        rounded = step * np.round(smooth / step)
        assert [f.effect for f in sensor_faults([ns.Record.from_arrays(held, rounded, Ts)], 0.005)] == ["quantisation"]
    cut = np.minimum(0.02 * np.round(smooth / 0.02), 0.4)
    assert "sensor_saturation" in [f.effect for f in sensor_faults([ns.Record.from_arrays(held, cut, Ts)], 0.005)]


def test_samples_that_stand_alone():
    """Placeholders and drop-outs, two in a row too; not the peaks of an input that passes at once, nor one step."""
    bad = np.array([200, 201, 900, 2400])
    (fault,) = faults(np.where(np.isin(np.arange(N), bad), -9999, y))
    assert fault.effect == "spikes" and fault.at == (200, 201, 900, 2400)
    assert (
        "4 samples of 'record' are far" in fault.sentence and ": rows 200, 201, 900, 2400. Dropouts" in fault.sentence
    )
    pulses = np.where(np.isin(np.arange(N), bad), 3.0, u)
    noise = 0.005 * rng.standard_normal(N)
    assert sensor_faults([ns.Record.from_arrays(pulses, 2 * pulses + noise, Ts)], 0.005) == []
    toggles = 0.5 * (np.arange(N) % 300 == 7)
    levels = [f.effect for f in sensor_faults([ns.Record.from_arrays(u, 0.5 * np.round(y / 0.5) + toggles, Ts)], 0.1)]
    assert "spikes" not in levels


def rubbing(force, spring, F=0.15):
    """Return the position of a part that rubs, on a spring or free; forces go up to one."""
    m, b, k = (0.02, 0.3, 1.5) if spring else (0.1, 1.0, 0.0)
    return truths.rubbing(force, Ts, m, b, k, F)[:, 0]


@pytest.mark.parametrize("spring", [False, True])
def test_a_part_that_sticks_is_not_cut_off(spring):
    """It comes to rest by itself, and rests elsewhere too. Without noise it stays at exactly one value."""
    growing = 2 / np.pi * np.arcsin(np.sin(1.5 * t)) * (0.4 + 0.02 * t)
    sweep = np.sin(2 * np.pi * (0.1 * t + 0.05 * t**2))
    for force in (growing, sweep):
        moved = rubbing(force, spring)
        for step in (0.0, 0.002):
            at = step * np.round(moved / step) if step else moved
            assert sensor_faults([ns.Record.from_arrays(force, at, Ts)], 1.0) == []
    cut = np.minimum(moved, np.quantile(moved, 0.9))
    assert "sensor_saturation" in [f.effect for f in sensor_faults([ns.Record.from_arrays(force, cut, Ts)], 1.0)]


def test_a_part_that_is_held_by_friction_has_no_frozen_sensor():
    """It rests many times, the longest rest is one of them; a sensor that froze twice rests twice."""
    force = np.repeat(np.random.default_rng(5).uniform(-1, 1, N // 75), 75)
    moved = rubbing(force, True, F=0.6)
    for step in (0.0, 0.01):
        at = step * np.round(moved / step) if step else moved
        assert [f.effect for f in sensor_faults([ns.Record.from_arrays(force, at, Ts)], 1.0)] == []
    twice = y.copy()
    twice[1000:1400], twice[2000:2300] = y[1000], y[2000]
    assert [f.effect for f in faults(twice)] == ["frozen_sensor"]


@pytest.mark.long
def test_the_next_step_leaves_the_frozen_rows_out():
    frozen = np.where((t > 18) & (t < 27), y[1801], y)
    record = ns.Record.from_arrays(u, frozen, Ts, name="stage")
    found = ns.diagnose(ns.identify(record, base="linear", n_y=1, n_u=1), record)
    assert "1801:2700 of 'stage'" in what_next(found) and "frozen_sensor" in found.sentence()


@more
def test_where_nothing_follows_the_frozen_rows_go_first():
    frozen = np.where((t > 3) & (t < 27), y[1801], y)
    record = ns.Record.from_arrays(u, frozen, Ts, name="stage")
    base = ns.NARX.from_terms(["u[k]"], [1e-3], Ts=Ts)
    assert "Delete the output values in the rows 301:2700" in what_next(ns.diagnose(base, record))


def test_a_sensor_that_freezes_is_told_from_friction_that_holds():
    rng = np.random.default_rng(2)
    wave = np.sin(np.arange(2000) / 60)
    noisy = wave + 0.01 * rng.standard_normal(2000)
    frozen = noisy.copy()
    frozen[900:1500] = frozen[900]
    (fault,) = sensor_faults([ns.Record.from_arrays(wave, frozen, 0.01)], 0.01)
    assert fault.effect == "frozen_sensor" and fault.rows == (900, 1500) and "900:1500" in fault.sentence
    assert fault.size == frozen[900] and fault.share == 0.3
    for y in (noisy, truths.play(wave, 0.4), np.round(noisy, 1)):  # a play holds again and again
        assert "frozen_sensor" not in {f.effect for f in sensor_faults([ns.Record.from_arrays(wave, y, 0.01)], 0.0)}


def test_the_steps_of_a_converter_are_those_that_were_measured(monkeypatch):
    """Offsets that are taken off between records hide the steps: they are read once, before."""
    rng = np.random.default_rng(4)
    u = np.interp(np.arange(600), np.arange(0, 630, 30), rng.uniform(-2, 2, 21))
    measured = [ns.Record.from_arrays(u, np.round((2 * u + level) / 0.05) * 0.05, 0.01) for level in (0.0, 3.0)]
    moved = [ns.Record.from_arrays(r.u, r.y - off, 0.01) for r, off in zip(measured, (0.0131, 3.0274), strict=True)]
    step = quantum(np.concatenate([r.y for r in measured]))
    assert step == pytest.approx(0.05) and quantum(np.concatenate([r.y for r in moved])) == 0
    (fault,) = sensor_faults(moved, 0.02, step)
    assert fault.effect == "quantisation" and fault.size == step
    read = []
    monkeypatch.setattr(procedure, "quantum", lambda y: read.append(len(y)) or step)
    monkeypatch.setattr(procedure, "_levelled", lambda *_: (moved, []) if len(read) == 1 else None)
    found = ns.diagnose(ns.identify(measured[0], base="static", degree=1), measured, catalogue=only("drift"))
    assert read == [1200] and [f.effect for f in found.faults] == ["quantisation"]
