"""Speeds that a motor does not exceed, uneven ones, and an axis between two hard stops: named with their sizes."""

import numpy as np
import pytest
from sampling import more
from scipy.signal import lfilter

import narx_sym as ns

N, Ts = 1200, 0.01


def noise(seed=3):
    """A random input of bandwidth 0.5 Hz, unit size."""
    x = lfilter([0.2], [1, -0.8], lfilter([0.03], [1, -0.97], np.random.default_rng(seed).standard_normal(N)))
    return x / x.std()


def steps(seed=3):
    """An input that jumps every 0.6 s."""
    return np.repeat(np.random.default_rng(seed).uniform(-1.5, 1.5, N // 60), 60)


def limited(u, up, down):
    """What follows the input by no more than that from sample to sample."""
    w = np.array(u)
    for i in range(1, N):
        w[i] = min(max(u[i], w[i - 1] - down), w[i - 1] + up)
    return w


def moved(u, step, low=-np.inf, high=np.inf):
    """An output that starts at zero and goes by `step(y, u)`, between two hard stops."""
    y = np.zeros(N)
    for i in range(1, N):
        y[i] = min(max(y[i - 1] + step(y[i - 1], u[i - 1]), low), high)
    return y


def servo(w):
    """A well damped second-order machine."""
    return lfilter([0, 0.05], [1, -1.6, 0.65], w)


def found(u, y):
    record = ns.Record.from_arrays(u, y + 0.01 * y.std() * np.random.default_rng(1).standard_normal(N), Ts)
    return ns.diagnose(ns.identify(record, base="linear"), record)


@more
@pytest.mark.parametrize("case", [(noise, 0.08, 0.048), (steps, 0.08, 0.08), (noise, 0.08, 0.08), (steps, 0.08, 0.04)])
def test_a_motor_at_one_speed_is_named_with_its_speeds(case):
    wave, up, down = case
    d = found(wave(), servo(limited(wave(), up, down)))
    assert (d.verdict, d.confusion_set) == ("named", ["rate_limit"])
    shape = d.best.parameters
    assert shape["r"] == pytest.approx(up, rel=0.05) and shape.get("e", shape["r"]) == pytest.approx(down, rel=0.05)
    assert d.ladder[-1]["validation"] < 0.015


@more
@pytest.mark.parametrize("wave", [noise, steps])
def test_what_empties_more_slowly_than_it_fills_is_named(wave):
    d = found(wave(), moved(wave(), lambda y, u: (0.15 if u > y else 0.06) * (u - y)))
    assert (d.verdict, d.confusion_set) == ("named", ["uneven_speed"])
    assert d.best.parameters["c"] == pytest.approx(0.06 / 0.15 - 1, abs=0.03)


@more
@pytest.mark.parametrize("wave", [noise, steps])
def test_an_axis_between_two_hard_stops_is_named_with_both(wave):
    d = found(wave(), moved(wave(), lambda y, u: 0.02 * u, low=-0.55, high=0.9))
    assert (d.verdict, d.confusion_set) == ("named", ["end_stop"])
    shape = d.best.parameters
    assert (shape["r"], shape["e"]) == (pytest.approx(0.9, abs=0.02), pytest.approx(0.55, abs=0.02))


@more
def test_a_force_that_ends_where_the_input_moves_is_a_friction():
    # a damper whose valve opens at a force of its own on each side, in series with a stiffness: no way ends there
    f, u = np.zeros(N), noise()
    for i in range(1, N):
        f[i] = min(max(0.87 * f[i - 1] + 20 * (u[i] - u[i - 1]), -1.0), 1.3)
    d = found(u, f + 0.06 * u + 0.002 * np.gradient(u, Ts))
    assert d.confusion_set[0] == "coulomb_friction" and not {"end_stop", "output_limit"} & set(d.confusion_set)


@more
def test_a_stop_that_only_a_swing_reaches_is_a_stop():
    k, y = np.arange(N), np.zeros(N)
    u = np.sin(0.05 * k * (0.5 + 1.5 * k / N))
    for i in range(2, N):  # at rest the input moves it by 0.2, at its resonance by four times as much
        swing = 1.98 * y[i - 1] - 0.98 * y[i - 2] + 0.01 * (0.2 * u[i - 1] - y[i - 1])
        y[i] = min(max(swing, -0.5), 0.6)
    assert y.max() == 0.6 and found(u, y).confusion_set == ["end_stop"]
