"""An axis that integrates is found by the linear base; sampling times that only differ by a clock are one."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.data.evidence.rate import at_one_step

N, TS = 4000, 0.01


def force(seed):
    """A force that sends the axis back and forth, so that its position stays near."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) * TS
    return sum(
        a * np.sin(w * t + p) for a, w, p in zip((1, 0.6, 0.3), (1.0, 2.7, 7.1), rng.uniform(0, 6, 3), strict=True)
    )


def axis(u, pole=1.0):
    """A mass with viscous drag: the speed is a lag of the force, and the position its sum."""
    y, v = np.zeros(N), 0.0
    for k in range(1, N):
        v = 0.97 * v + 0.03 * u[k - 1]
        y[k] = pole * y[k - 1] + TS * v
    return y + 1e-4 * np.random.default_rng(9).standard_normal(N)


def test_an_axis_that_integrates_has_a_pole_at_one():
    model = ns.identify(ns.Record.from_arrays(force(0), axis(force(0)), Ts=TS), base="linear", n_u=1, delay=1)
    assert model.constraints == (sp.Eq(model.sigma_y, 1),)
    assert model.sigma_y.xreplace(model.values) == pytest.approx(1, abs=1e-12)
    other = ns.Record.from_arrays(force(1), axis(force(1)), Ts=TS)
    assert ns.evaluate(model, other).free_run_nrmse < 0.02


def test_a_slow_lag_keeps_its_pole():
    model = ns.identify(
        ns.Record.from_arrays(force(0), axis(force(0), pole=0.99), Ts=TS), base="linear", n_u=1, delay=1
    )
    assert not model.constraints
    coefficients = [model.values.get(c, 0) for c, term in model.parts() if term.has(ns.y)]
    assert np.abs(np.roots([1, *(-float(c) for c in coefficients)])).max() == pytest.approx(0.99, abs=0.003)


def test_what_is_held_out_moves():
    moving, rest = N // 4, np.arange(N) >= N // 4
    y = lfilter([0.0, 0.1], [1.0, -0.9], force(0))
    y[rest] = 0.0  # the sensor is off for the rest of the record
    model = ns.identify(ns.Record.from_arrays(np.where(rest, 0.0, force(0)), y, Ts=TS), base="linear")
    part = ns.Record.from_arrays(force(0)[:moving], y[:moving], Ts=TS)
    assert ns.evaluate(model, part).free_run_nrmse < 0.1


def test_one_step_is_enough():
    """A step that is over soon is all of the movement; the noise before it is none, and after it the sensor rests."""
    rng = np.random.default_rng(0)
    u = (np.arange(2000) >= 900) * 1.0
    y = lfilter([0.1], [1, -0.9], u) + 0.003 * rng.standard_normal(2000)
    y[1000:] = 1.0
    for first, last in ((0, 2000), (0, 940), (700, 2000)):
        made = ns.identify(ns.Record.from_arrays(u[first:last], y[first:last], 0.01), base="linear", n_u=1, delay=0)
        assert ns.evaluate(made, ns.Record.from_arrays(u[800:1000], y[800:1000], 0.01)).free_run_nrmse < 0.1


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_a_sensor_that_drifts_does_not_integrate(noise):
    """Without noise a pole at 1 describes the ramp exactly, and rounding would choose its form."""
    y = lfilter([0.0, 0.1], [1.0, -0.9], force(0)) + noise * np.random.default_rng(5).standard_normal(N)
    record = ns.Record.from_arrays(force(0), y + 3 * np.arange(N) / N, Ts=TS)
    assert not ns.identify(record, base="linear").constraints


def test_two_clocks_are_one_sampling_time():
    u = force(0)
    records = [ns.Record.from_arrays(u, axis(u), Ts=Ts, name=str(Ts)) for Ts in (TS, TS * 1.00002)]
    assert ns.identify(records, base="linear", n_y=2, n_u=1, delay=1).Ts == TS
    slower = ns.Record.from_arrays(u, axis(u), Ts=TS * 2, name="slow")
    with pytest.raises(ns.DataError, match=r"different sampling times \(0.01: 0.01 s, slow: 0.02 s\)"):
        ns.identify([records[0], slower], base="linear")


def test_what_one_logger_records_has_one_step():
    t = TS * np.arange(N)
    fast, slow = (
        replace(ns.Record.from_arrays(np.sin(3 * s * t), np.cos(2 * s * t), Ts=s * TS, name=f"{s}"), breaks=(400,))
        for s in (1.0, 1.04)
    )
    one, two = at_one_step([fast, slow])
    assert two is slow and one.Ts == slow.Ts and len(one.breaks) == 1
    for part in one.segments():  # each begins with its own first sample, and is a line between two of its samples
        assert np.abs(part.u - np.sin(3 * part.t)).max() < 2e-4 and np.abs(part.y - np.cos(2 * part.t)).max() < 2e-4
        assert np.allclose(np.diff(part.t), slow.Ts)
    assert one.t[one.breaks[0]] == fast.t[400] and fast.t[-1] - one.t[-1] < slow.Ts
    assert "resampled from Ts = 0.01 s to 0.0104 s" in one.notes[-1]


def test_a_record_at_rest_is_one_among_others():
    u = force(0)
    moved = ns.Record.from_arrays(u, axis(u), Ts=TS, name="moved")
    held = ns.Record.from_arrays(0.1 * u, np.zeros(u.size), Ts=TS, name="held")
    alone, both = (ns.identify(r, base="linear", n_y=2, n_u=1, delay=1) for r in ([moved], [moved, held]))
    assert both.info.nrmse.free_run >= alone.info.nrmse.free_run
    with pytest.raises(ns.DataError, match=r"'held': the output is constant"):
        ns.identify([held, held], base="linear")
    same = ns.Record.from_arrays(moved.y, moved.y, Ts=TS, name="same")
    with pytest.raises(ns.DataError, match=r"'same': output and input are the same signal"):
        ns.identify([moved, held, same], base="linear")


def test_steps_to_several_levels_are_enough_where_each_record_begins_with_one():
    def answer(level):
        return ns.Record.from_arrays(np.full(N, float(level)), 2 * level * (1 - 0.97 ** np.arange(N)), Ts=TS)

    model = ns.identify([answer(level) for level in (1, 2, 4)], base="linear", n_y=1, n_u=1, delay=1)
    assert dict(zip(map(str, model.terms), model.theta, strict=True))["y[k - 1]"] == pytest.approx(0.97, abs=1e-6)
    assert model.info.nrmse.free_run < 1e-6
    with pytest.raises(ns.DataError, match="the input is constant"):
        ns.identify([answer(2), answer(2)], base="linear")


def test_a_short_record_is_resampled_not_the_long_one():
    t = TS * np.arange(N)
    long = ns.Record.from_arrays(np.sin(t), np.cos(t), Ts=TS, name="long")
    short = ns.Record.from_arrays(np.sin(1.04 * t[:20]), np.cos(1.04 * t[:20]), Ts=1.04 * TS, name="short")
    kept, moved = at_one_step([long, short])
    assert kept is long and moved.Ts == TS and moved.t[-1] <= short.t[-1] < moved.t[-1] + TS
