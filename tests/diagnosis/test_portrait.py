"""The portrait of what is missing: its unit and sign, what stands first, what chance makes of it, and the law over it."""

import numpy as np
import pytest
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.data.evidence.rate import means
from narx_sym.diagnosis.misfit import portrait_of

N, TS, NOISE = 6000, 0.01, 0.002
BASE = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], [1.6, -0.68, 0.08], Ts=TS)  # a gain of one
AXIS = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], [1.9, -0.9, 0.01], Ts=TS)  # integrates


def measured(model=BASE, missing=lambda u, t: 0 * u, seed=0):
    """A record of a model that is driven by something more than the input, and its free-run error."""
    rng = np.random.default_rng(seed)
    u, t = lfilter([0.02], [1, -0.98], rng.standard_normal(N)), TS * np.arange(N)
    u = u / u.std()
    a1, a2, b = model.theta
    clean = [lfilter([0, b], [1, -a1, -a2], x) for x in (u, u + missing(u, t))]
    record = ns.Record.from_arrays(u, clean[1] + NOISE * rng.standard_normal(N), TS)
    return record, record.y - clean[0]


@pytest.mark.parametrize("model", [BASE, AXIS], ids=["gain", "integrates"])
@pytest.mark.parametrize("factor", [1, 5])
def test_it_is_the_missing_input_in_its_unit_and_sign(model, factor):
    record, error = measured(model, lambda u, t: 0.3 * np.sin(2 * np.pi * 0.2 * t))
    found = portrait_of(model, record, error, factor)
    true = means(0.3 * np.sin(2 * np.pi * 0.2 * record.t), factor)[-found.t.size :]
    assert found.unit_of == "u"
    assert np.std(found.missing - true) < 0.03


@pytest.mark.parametrize(
    "missing, first",
    [
        (lambda u, t: 0.3 * u**2, "u"), (lambda u, t: 0.02 * t, "time"), (lambda u, t: 0.02 * (t - 30) * u, "u|time"),
        (lambda u, t: 0.05 * (v := np.gradient(lfilter([0.08], [1, -1.6, 0.68], u)) / 0.05) * np.abs(v), "velocity"),
        (lambda u, t: 0.3 * np.sin(2 * np.pi * 3.3 * t), "period"),
    ],
    ids=["curve", "drift", "ageing", "speed", "hum"],
)  # fmt: skip
def test_the_variable_that_acts_stands_first(missing, first):
    found = portrait_of(BASE, *measured(missing=missing), 2)
    assert found.view.name == first and found.seen(found.view)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_leaves_the_band_of_chance_where_nothing_is_missing(seed):
    assert not portrait_of(BASE, *measured(seed=seed), 3).seen()


def test_a_law_and_what_it_leaves_make_up_the_portrait():
    record, error = measured(missing=lambda u, t: 0.3 * u**2)
    half = error - lfilter([0, 0.08], [1, -1.6, 0.68], 0.15 * record.u**2)
    found = portrait_of(BASE, record, error, 2, {"half": half, "all": 0 * error})
    left = found.left("half")
    np.testing.assert_allclose(found.of("half").mean + left.mean, found.view.mean, atol=1e-9)
    np.testing.assert_allclose(found.of("half").mean, found.view.mean / 2, atol=0.05)
    assert found.left("all").share < 1e-9 and found.to_dict()["laws"]["half"]["left"] > 0.1


def test_half_passes_at_the_bandwidth():
    """A forcing of that frequency is half of its size, a slow one whole."""
    sizes = []
    for part in (1, 0.05):
        frequency = part / (10 * TS)
        found = portrait_of(BASE, *measured(missing=lambda u, t, f=frequency: np.sin(2 * np.pi * f * t)))
        assert found.bandwidth == pytest.approx(1 / (10 * TS))
        sizes.append(found.missing.std() * np.sqrt(2))
    assert sizes == pytest.approx([0.5, 1.0], rel=0.1)


def test_the_output_of_a_base_without_memory_is_no_cause():
    static = ns.NARX.from_terms(["u[k]"], [1.0], Ts=TS)
    record, _ = measured()
    found = portrait_of(static, record, record.y - record.u)
    assert not {"y", "velocity"} & {p.name for p in found.views}
