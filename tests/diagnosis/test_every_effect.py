"""No effect of the catalogue without a hidden instance that is recovered, and without a law.

The tests run over the catalogue itself: an effect that joins it joins them, and fails where its instance is missing.
"""

import warnings

import numpy as np
import pytest
import truths
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.diagnosis.screening.directions import Linearised
from narx_sym.fit.freerun import FreeRun
from narx_sym.models.effects import EFFECTS, Catalogue

SEED, N, LEVEL = 500, 1500, 0.01
SHARE = 0.8  # of what the effect adds to the squared error, removed along a tangent or by a fit
ABOVE = {"absolute_sensor": 1.5}  # input of a record that is below zero now and then: else a base sees nothing of it
START = 300  # samples until the start of a run is forgotten


def lagged(v):
    """A first-order lag; nothing of the package."""
    return lfilter([0, 0.1], [1, -0.9], v)


def moved(step):
    """An output that starts at zero and goes by `step(y, before, i)` from sample to sample."""
    y = np.zeros(N)
    for i in range(2, N):
        y[i] = step(y[i - 1], y[i - 1] - y[i - 2], i)
    return y


def followed(u, most):
    """What follows an input by no more than that from sample to sample."""
    return moved(lambda y, v, i: y + np.clip(u[i] - y, -most, most))


def soft(d, f):
    """What is left of a push d that f holds."""
    return np.sign(d) * max(abs(d) - f, 0.0)


def changed(u, name):
    """Return the output of a lag that one effect has changed, for what the truths do not hold."""
    return {
        "stiction": lambda: moved(lambda y, v, i: y + soft(0.1 * (u[i - 1] - y), 0.004 if v else 0.01)),
        "end_stop": lambda: moved(lambda y, v, i: y + 0.1 * (u[i - 1] - y) - 0.2 * max(y - 0.6, 0.0)),
        "sqrt_outflow": lambda: moved(lambda y, v, i: y + 0.1 * (u[i - 1] / 4 + 1.0 - max(y + 1.0, 0.0) ** 0.5)),
        "channel_friction": lambda: moved(
            lambda y, v, i: y + soft(0.8 * v + 0.02 * (u[i - 1] - y), 0.002 * (1.0 + load()[i]))
        ),
        "gravity": lambda: moved(lambda y, v, i: y + 0.1 * (u[i - 1] / 3 - np.sin(y))),
        "orifice": lambda: moved(lambda y, v, i: y + 0.1 * np.sign(u[i - 1] - y) * abs(u[i - 1] - y) ** 0.5),
        "charge_curve": lambda: lagged(u) + 0.2 * (q := np.cumsum(u) * 0.01) + 0.05 * q**2 - 0.02 * q**3,
        "absolute_sensor": lambda: np.abs(lagged(u)),
        "output_limit": lambda: np.minimum(lagged(u), 0.7),
        "offset": lambda: lagged(u) + 0.2,
        "inertia": lambda: lagged(lagged(u)),
        "input_delay": lambda: lagged(np.concatenate([np.zeros(3), u[:-3]])),
        "rate_limit": lambda: lagged(followed(u, 0.08)),
        "uneven_speed": lambda: moved(lambda y, v, i: y + (0.1 if u[i - 1] > y else 0.06) * (u[i - 1] - y)),
        "rate_dependence": lambda: lagged(u + 3.0 * np.diff(u, prepend=0.0)),
    }[name]()


def load():
    """A slow channel beside the input."""
    return np.sin(np.arange(N) / 170)


def hidden(name):
    """Return a record with one hidden effect, the terms of a base that lacks it, and the output without noise."""
    kind = next((k for k in truths.GROUPS["in"] if k.partition(":")[0] == name), None)
    if kind is None:
        u = ABOVE.get(name, 0.0) + 2 * truths.excite(np.random.default_rng(SEED), "random", N, 0.01, 1.5)
        clean = changed(u, name)
        y = clean + LEVEL * np.std(clean) * np.random.default_rng(1).standard_normal(N)
        inertia = ["y[k-2]"] if name == "channel_friction" else []
        channels = {"temperature": load()} if name.startswith("channel") else {}
        return ns.Record.from_arrays(u, y, Ts=0.01, channels=channels), ["y[k-1]", "u[k-1]", *inertia], clean
    c = truths.case("in", kind, SEED, level=LEVEL, N=N)
    d = c.info["delay"] + int(c.info["held"])
    terms = ["y[k-1]", "y[k-2]", *(f"u[k-{d + i}]" for i in range(3)), "1"]
    return ns.Record.from_arrays(c.u, c.y, c.Ts, channels=c.channels), terms, c.clean


def based(name):
    record, terms, clean = hidden(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return record, ns.NARX.from_terms(terms, Ts=record.Ts).fit(record, method="free_run"), clean


def along(record, base, clean, name):
    """Return the squared error of a base over the true noise: refitted alone, and with the best direction of an effect."""
    problem = FreeRun(base, record, [])
    around = Linearised(problem, problem.start(base.theta))
    directions, matrix = around.directions(sorted(record.channels), Catalogue({name: EFFECTS[name]}))
    tangents = [around.own, *(np.column_stack([around.own, matrix[:, d.columns]]) for d in directions)]
    left = [around.residual - D @ np.linalg.lstsq(D, around.residual, rcond=None)[0] for D in tangents]
    alone, *found = np.sum(np.square(left), axis=1) / np.sum((record.y - clean)[problem.depth :] ** 2)
    return alone, min(found)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_hidden_instance_lies_along_the_effects_direction(name):
    alone, found = along(*based(name), name)
    assert alone > 2.0  # it is hidden there
    assert alone - found > SHARE * (alone - 1.0)


@pytest.mark.parametrize(("name", "other"), [("dead_zone", "drift"), ("creep", "cubic_gain"), ("backlash", "drift")])
def test_it_does_not_lie_along_another(name, other):
    alone, found = along(*based(name), other)
    assert alone - found < 0.5 * (alone - 1.0)


def test_an_effect_between_two_filters_is_found_there():
    """A first lag that overflows, and a second one: none of the other forms of an end stop explains it."""
    u = 2 * truths.excite(np.random.default_rng(SEED), "random", N, 0.01, 1.5)
    first = moved(lambda y, v, i: min(y + (u[i] - y) / 21, 0.6))
    clean = lagged(first)
    y = clean + LEVEL * np.std(clean) * np.random.default_rng(1).standard_normal(N)
    record = ns.Record.from_arrays(u, y, Ts=0.01)
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], Ts=0.01).fit(record, method="free_run")
    model = base.add("end_stop").fit(record)
    assert model.effects[0].form == "of a first lag, upper"
    _, _, r, tau = model.theta
    assert model.effects[0].coefficients == {} and r == pytest.approx(0.6, rel=0.05)
    assert tau == pytest.approx(0.2, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("name", EFFECTS)
def test_a_hidden_instance_is_recovered(name):
    """The whole way: the effect is added by its name and fitted, and its part of the error is gone."""
    record, base, clean = based(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = base.add(name + ":temperature" * name.startswith("channel")).fit(record)
    runs = [ns.free_run(one, record) for one in (base, model)]
    before, after, noise = (np.mean((record.y - x)[START:] ** 2) for x in (*runs, clean))
    assert before - after > SHARE * (before - noise)
