"""Clipped and stepped measurements, seen in the record itself."""

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.data.sensor import sensor_faults

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
    assert faults(np.where(t < 3, 1.5, y)) == []  # at rest before it starts


def test_clipped():
    (fault,) = faults(np.minimum(y, 0.9))
    assert fault.effect == "sensor_saturation" and fault.size == 0.9
    assert fault.share == pytest.approx(np.mean(y >= 0.9))
    assert "cut off at 0.9" in fault.sentence


def test_steps():
    (fault,) = faults(0.02 * np.round(y / 0.02))
    assert fault.effect == "quantisation" and fault.size == pytest.approx(0.02)
    assert fault.share == pytest.approx(0.02**2 / 12 / 0.005**2, rel=1e-3) or fault.share == 1.0
    assert "steps of 0.02" in fault.sentence


@pytest.mark.long
def test_a_diagnosis_says_it():
    record = ns.Record.from_arrays(u, 0.05 * np.round(y / 0.05), Ts)
    found = ns.diagnose(ns.identify(record, base="linear", n_y=1, n_u=1), record)
    assert [f.effect for f in found.faults] == ["quantisation"]
    assert "steps of 0.05" in found.sentence()
    assert found.to_dict()["sensor"][0]["size"] == pytest.approx(0.05)
