"""Whether a black box of the signals tells structure from noise, and what is done with its answer."""

import numpy as np
import pytest
import truths

import narx_sym as ns
from narx_sym.diagnosis.bases import fit_base, settled_again
from narx_sym.diagnosis.candidates import score
from narx_sym.diagnosis.gate import wanders
from narx_sym.diagnosis.refit import Split
from narx_sym.models.effects import EFFECTS

N, Ts = 2000, 0.01
t = Ts * np.arange(N)
u = 2 * truths.excite(np.random.default_rng(5), "random", N, Ts, 1.5)


def lagged(v):
    """Return a first-order lag of v."""
    y = np.zeros(N)
    for i in range(1, N):
        y[i] = 0.9 * y[i - 1] + 0.1 * v[i - 1]
    return y


def structure(y, catalogue=EFFECTS):
    """Return the share of the linear base's held-out error that follows from the signals."""
    record = ns.Record.from_arrays(u, y, Ts)
    base = fit_base(ns.identify(record, base="linear", n_y=1, n_u=1, delay=1), Split.of([record]))
    return score(base, [], catalogue, 0).structure


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


def test_a_wander_is_told_from_noise_and_from_a_line():
    rng = np.random.default_rng(6)
    white = rng.standard_normal(4000)
    assert wanders(white + np.cumsum(rng.standard_normal(4000)) / 10)
    assert not wanders(white)
    assert not wanders(truths.colour(rng, "ar95", 4000))
    assert not wanders(white + np.sin(np.arange(4000) / 5))


def test_a_base_out_of_a_local_minimum_is_fitted_again():
    record = ns.Record.from_arrays(u, lagged(u) + 0.01 * np.random.default_rng(7).standard_normal(N), Ts)
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.9, 0.1], Ts=Ts)
    good, poor = (fit_base(model, Split.of([record])) for _ in range(2))
    assert settled_again(good, [good]) is None  # no better
    poor.unknowns, poor.model = poor.problem.start(np.array([0.5, 0.5])), poor.model.replace(theta=[0.5, 0.5])
    del poor.errors
    again = settled_again(poor, [good])
    assert again is not None
    assert again.model.theta == pytest.approx(good.model.theta, rel=1e-3)
