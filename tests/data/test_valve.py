"""The physical valve: a truth of its own, checked against mechanics and another solver; smoothing of records."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import narx_sym as ns
from narx_sym.data.plants import bouc_wen, filtered_noise, valve
from narx_sym.errors import DataError

K, STROKE, S, FC, FS = 52_538.0, 0.1016, 0.064516, 280.2, 336.3
PLAY = 4 * FC / (K * STROKE)  # half the dead band [V]


def sine(n=2000, size=0.56):
    return 3 + size * np.sin(0.002 * np.pi * np.arange(n))


def test_the_springs_range_is_the_signals_range():
    """100 in^2 times 12 psi is 300 lbf/in times 4 in: the data sheet is consistent."""
    psi, pound, inch = 6894.757, 4.448222, 0.0254
    assert pytest.approx(S * 12 * psi, rel=1e-3) == K * STROKE
    assert pytest.approx(63 * pound, rel=1e-3) == FC and pytest.approx(1.2 * FC, rel=1e-3) == FS
    assert pytest.approx(300 * pound / inch, rel=1e-3) == K


def test_it_sticks_until_breakaway_and_rests_within_the_dead_band():
    slow = 3 + 0.002 * np.arange(1000)  # 0.2 V/s
    y = valve(slow, tau=1e-3)
    moved = int(np.argmax(y > 3 + 1e-9))
    assert slow[moved] - 3 == pytest.approx(4 * FS / (K * STROKE), abs=0.01)
    # It jumps from static to Coulomb friction and past it, then follows at the distance of Coulomb and viscous friction.
    rate = 0.2 / 4 * STROKE
    assert slow[-1] - y[-1] == pytest.approx(PLAY + 4 * 612.9 * rate / (K * STROKE), abs=0.01)
    stepped = valve(np.concatenate([np.full(10, 3.0), np.full(500, 3.6)]))
    assert abs(3.6 - stepped[-1]) <= PLAY + 0.01 and np.ptp(stepped[-200:]) == 0.0
    assert np.ptp(valve(3 + 0.05 * np.sin(np.arange(600) / 20))) == 0.0


def test_the_stops():
    y = valve(np.concatenate([np.linspace(3, 9, 300), np.full(100, 9.0), np.linspace(9, -3, 500)]))
    assert y.max() == pytest.approx(5.0) and y.min() == pytest.approx(1.0)


def test_smaller_steps_change_little():
    fine, coarse = valve(sine(), substeps=80), valve(sine())
    assert np.abs(fine - coarse).max() < 0.003


def test_against_another_solver():
    """Stiff integration of the same valve with friction made continuous."""
    tau, M, Fv, vs, soft = 0.2, 1.361, 612.9, 2.54e-4, 1e-6
    full = K * STROKE / S

    def rates(t, state):
        p, x, v = state
        u = 3 + 0.56 * np.sin(0.2 * np.pi * t)
        friction = (FC + (FS - FC) * np.exp(-((v / vs) ** 2))) * np.tanh(v / soft) + Fv * v
        return [(full * (u - 1) / 4 - p) / tau, v, (S * p - K * x - friction) / M]

    t = 0.01 * np.arange(1000)
    start = [full / 2, STROKE / 2, 0.0]
    run = solve_ivp(rates, (0, t[-1]), start, "LSODA", t, rtol=1e-7, atol=[1e-2, 1e-9, 1e-9], max_step=2e-3)
    assert np.abs(1 + 4 * run.y[1] / STROKE - valve(sine(1000))).max() < 0.01


def test_bad_inputs():
    for bad in ([3.0], [3.0, np.nan], np.ones((5, 2))):
        with pytest.raises(DataError, match="valve needs an input"):
            valve(bad)


def test_substeps_of_the_bench_plant():
    u = filtered_noise(N=2000, Ts=0.02, cutoff=0.5, seed=1)
    ramps = np.interp(np.arange(0, 1999 * 20 + 1) / 20, np.arange(2000), u)
    np.testing.assert_allclose(bouc_wen(u, Ts=0.02, substeps=20), bouc_wen(ramps, Ts=0.001)[::20], atol=1e-9)


# -- smoothing of a record -------------------------------------------------------------------------------------


def noisy(n=2000, size=0.01):
    t = 0.01 * np.arange(n)
    y = np.sin(t)
    return ns.Record.from_arrays(t, y + size * np.random.default_rng(0).standard_normal(n), Ts=0.01), y


def test_quadratic_regression_keeps_a_parabola_and_lowers_noise():
    t = 0.01 * np.arange(300)
    parabola = ns.Record.from_arrays(t, 1 + 2 * t - 3 * t**2, Ts=0.01)
    np.testing.assert_allclose(parabola.smoothed(0.5).y, parabola.y, atol=1e-12)
    record, y = noisy()
    smooth = record.smoothed(0.5)
    assert np.std(smooth.y - y) < 0.3 * np.std(record.y - y)
    assert np.array_equal(smooth.u, record.u) and "51 samples" in smooth.notes[-1] and smooth.Ts == record.Ts
    # The middle sample is a least-squares parabola through its window.
    window = np.arange(-25, 26)
    assert smooth.y[700] == pytest.approx(np.polyval(np.polyfit(window, record.y[675:726], 2), 0))


def test_segments_are_smoothed_on_their_own():
    record, _ = noisy(400)
    jump = np.where(np.arange(400) < 200, 0.0, 10.0)
    broken = ns.Record(record.u, record.y + jump, record.t, 0.01, breaks=(200,))
    assert np.abs(broken.smoothed(0.5).y - jump - record.y).max() < 0.1
    for seconds in (0.01, 3.0):
        with pytest.raises(DataError, match="a window of"):
            broken.smoothed(seconds)
