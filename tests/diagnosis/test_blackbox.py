"""Whether a black box of the signals tells structure from noise, and what is done with its answer."""

import numpy as np
import pytest
import truths
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.diagnosis.refit import Split, settle
from narx_sym.diagnosis.screening.scored import screen
from narx_sym.models.effects import EFFECTS

N, Ts = 2000, 0.01
t = Ts * np.arange(N)
u = 2 * truths.excite(np.random.default_rng(5), "random", N, Ts, 1.5)


def lagged(v):
    """Return a first-order lag of v."""
    return lfilter([0, 0.1], [1, -0.9], v)


def structure(y, catalogue=EFFECTS):
    """Return the share of the linear base's held-out error that follows from the signals."""
    record = ns.Record.from_arrays(u, y, Ts)
    base = settle(ns.identify(record, base="linear", n_y=1, n_u=1, delay=1), Split.of([record]))
    return screen(base, [], catalogue, 0).structure


@pytest.mark.parametrize(
    "noise", ["ar95", *(pytest.param(n, marks=pytest.mark.long) for n in ("white", "ar80", "band"))]
)
def test_noise_of_any_colour_has_no_structure(noise):
    y = lagged(u)
    assert structure(y + 0.02 * truths.colour(np.random.default_rng(3), noise, N)) < 0.1


def test_structure_that_the_catalogue_does_not_have():
    noise = 0.01 * np.random.default_rng(4).standard_normal(N)
    few = type(EFFECTS)({n: EFFECTS[n] for n in ("drift", "input_delay")})
    assert structure(lagged(u + 0.3 * np.sin(1.5 * u)) + noise, few) > 0.6
    assert structure(lagged(u) + noise + 0.05 * np.sin(2 * np.pi * 7.3 * t), few) > 0.6
