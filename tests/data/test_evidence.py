"""What a record says before any model."""

import evidence
import numpy as np
import pytest

import narx_sym as ns
from narx_sym.data.evidence.dead_time import dead_time
from narx_sym.fit.identify import identify


@pytest.mark.parametrize(("d", "source"), [(0, "steps"), (7, "two levels"), (60, "noise")])
def test_a_dead_time_is_found_exactly(d, source):
    rng = np.random.default_rng(d)
    _, record = evidence.delayed(evidence.driven(source, rng, 1000), d, rng)
    found = dead_time([record])
    assert found.samples == d and d in found.among
    assert found.long == (d >= 4)


def test_every_base_takes_a_long_dead_time():
    rng = np.random.default_rng(1)
    u = evidence.driven("steps", rng, 600)
    y = np.zeros(600)
    for k in range(9, 600):
        y[k] = 0.8 * y[k - 1] + 0.2 * u[k - 9]
    record = ns.Record.from_arrays(u, y + 0.002 * rng.standard_normal(600), Ts=0.1)
    for base in ("linear", "static"):
        assert identify(record, base=base).delay == 9
    assert identify(record, base="linear", delay=2).delay == 2


def test_hysteresis_is_no_dead_time():
    u = np.sin(2 * np.pi * np.arange(1200) / 150)
    held = np.zeros(1200)
    for k in range(1, 1200):
        held[k] = min(max(held[k - 1], u[k] - 0.4), u[k] + 0.4)
    rng = np.random.default_rng(0)
    assert not dead_time([ns.Record.from_arrays(u, held + 0.01 * rng.standard_normal(1200), Ts=0.01)]).long
