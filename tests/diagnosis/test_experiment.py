"""The next experiment: it keeps the record's limits, and separates what the record confuses."""

import re
from dataclasses import replace

import numpy as np
import pytest
import truths

from narx_sym.data.record import Record, read_signal
from narx_sym.diagnosis.experiment import Limits, family, propose
from narx_sym.diagnosis.experiment.proposal import Experiment
from narx_sym.diagnosis.refit import Split, settle
from narx_sym.errors import ModelError
from narx_sym.fit.freerun import FreeRun
from narx_sym.models.effects import EFFECTS
from narx_sym.models.extend import Variant, extend
from narx_sym.models.model import NARX
from narx_sym.symbolic.signals import k, u, y

N, TS, NOISE = 2000, 0.01, 0.02
T = TS * np.arange(N)
RNG = np.random.default_rng(0)
UNITS = {"u": "V", "y": "um"}


def triangle(phase):
    return 1 - np.abs((4 * phase + 1) % 4 - 2)


def play(x, r):
    return x[0] + truths.play(x - x[0], r)


def static():
    return NARX([u[k], 1], [0.5, 0.0], Ts=TS)


def with_effect(base, name, where, start, form="", driver="u", channel=None):
    effect = next(f for f in EFFECTS[name] if f.form == form)
    model = extend(base, Variant(effect, where, driver, channel)).model
    model = model.replace(theta=[*base.theta, *start])
    return model


def fitted(model, record):
    return settle(model, Split.of(record)).model


@pytest.fixture(scope="module")
def one_speed():
    """Dry friction and a rate term, from a triangle of one speed: both describe it exactly."""
    u_ = 10 * triangle(np.arange(N) / 400)
    record = Record.from_arrays(u_, 0.5 * u_ + 0.3 * np.sign(np.diff(u_, prepend=-0.1)), TS)
    friction = fitted(with_effect(static(), "coulomb_friction", "output", [0.1]), record)
    rate = fitted(NARX([u[k], u[k - 1], 1], [0.5, 0.0, 0.0], Ts=TS), record)
    return {"coulomb_friction": friction, "rate_dependence": rate}, record


@pytest.fixture(scope="module")
def loops():
    """Backlash and Bouc-Wen hysteresis, from a sine through a play."""
    u_ = 5 * np.sin(2 * np.pi * 0.4 * T)
    record = Record.from_arrays(u_, 0.5 * play(u_, 0.8) + NOISE * np.random.default_rng(1).standard_normal(N), TS)
    backlash = fitted(with_effect(static(), "backlash", "input", [1.0, 0.7]), record)
    hysteresis = fitted(with_effect(static(), "hysteresis", "output", [-0.3, 0.25, 1.0], "Bouc-Wen"), record)
    return {"backlash": backlash, "hysteresis": hysteresis}, record


def kept(limits, signal):
    assert limits.low <= signal.min() and signal.max() <= limits.high
    assert np.abs(np.diff(signal)).max() <= limits.rate * (1 + 1e-9)
    assert signal[[0, -1]] == pytest.approx(limits.centre, abs=1e-9 * limits.half)


INPUTS = {
    "triangle": 3 + triangle(T),
    "one slow sweep": triangle(T / T[-1]),
    "staircase": np.repeat(RNG.uniform(-2, 5, N // 100), 100),
    "binary": np.repeat(RNG.choice([-1.0, 1.0], N // 20), 20),
    "noise": RNG.standard_normal(N),
    "smooth": np.cumsum(np.cumsum(RNG.standard_normal(N)) * 1e-3),
}


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("n", [30, 501, 2000])
def test_signals_keep_range_and_rate_and_return_to_the_centre(name, n):
    limits = Limits.of([Record.from_arrays(INPUTS[name], INPUTS[name], TS)])
    signals = list(family(limits, n, TS, unit="V"))
    assert len({words for words, _ in signals}) == len(signals) >= (4 if n == N else 1)
    for _, signal in signals:
        assert signal.shape == (n,)
        kept(limits, signal)


def test_family_has_all_kinds():
    words = " ".join(w for w, _ in family(Limits(-1, 1, 0.1), 4000, TS))
    for kind in ("ramp", "triangle", "staircase", "growing", "% of the amplitude", "then sine", "random levels",
                 "filtered noise", "fast moves", "rest at"):  # fmt: skip
        assert kind in words


def test_jumps_are_allowed_where_the_record_jumps():
    assert Limits.of([Record.from_arrays(INPUTS["binary"], INPUTS["binary"], TS)]).rate == pytest.approx(2)
    glitch = np.sin(T) + 10 * (np.arange(N) > N // 2)
    assert Limits.of([Record.from_arrays(glitch, glitch, TS)]).rate < 0.02


def test_friction_and_rate_term_need_two_speeds(one_speed):
    models, record = one_speed
    found = propose(models, record, NOISE, units=UNITS)
    assert found.present < 1e-9
    assert found.ratio > 5 and found.clear
    assert found.name.startswith("triangle") and " then " in found.name
    first, second = (np.median(np.abs(np.diff(part))) for part in np.array_split(found.u, 2))
    assert max(first, second) > 2 * min(first, second)
    kept(Limits.of([record]), found.u)


def test_nothing_but_the_speed_separates_them(one_speed):
    models, record = one_speed
    only = {name: signal for name, signal in family(Limits.of([record]), N, TS)}
    slow = next(signal for name, signal in only.items() if name.startswith("slow ramp"))
    runs = {name: m.simulate(slow, 0.0) for name, m in models.items()}
    gap = runs["coulomb_friction"] - runs["rate_dependence"]
    assert np.std(gap) > NOISE  # plainly different, but a refit of the coefficient absorbs it
    found = propose(models, Record.from_arrays(slow, runs["rate_dependence"], TS), NOISE)
    assert found.present < 0.1 * NOISE


def test_backlash_and_hysteresis(loops):
    models, record = loops
    found = propose(models, record, NOISE, units=UNITS)
    assert found.separates == ["backlash", "hysteresis"]
    assert found.separation > 1.2 * found.present and found.ratio > 1.5
    assert all(run.shape == found.u.shape == found.t.shape for run in found.outputs.values())
    assert found.sentence.startswith(
        "To decide between backlash and hysteresis: run this 20 s input, from rest at 0 V: "
    )
    assert "times the noise" in found.sentence and " nm rms" in found.sentence
    kept(Limits.of([record]), found.u)


def test_a_real_refit_leaves_at_least_what_is_promised(loops):
    models, record = loops
    found = propose(models, record, NOISE)
    for truth, one in (("backlash", "hysteresis"), ("hysteresis", "backlash")):
        problem = FreeRun(models[one], Record.from_arrays(found.u, found.outputs[truth], TS), [])
        refit = problem.minimise(problem.start(models[one].theta), 40)
        assert np.sqrt(np.mean(refit.fun**2)) * problem.spread > 0.8 * found.separation


def test_same_twice_and_saved(loops, tmp_path):
    models, record = loops
    first, second = (propose(models, record, NOISE, seed=3) for _ in range(2))
    assert first.name == second.name and np.array_equal(first.u, second.u)
    first.save(tmp_path / "next.csv")
    back, step, _ = read_signal(tmp_path / "next.csv", "u")
    assert back == pytest.approx(first.u, abs=1e-8) and step == pytest.approx(TS)


def test_length(loops):
    models, record = loops
    assert propose(models, record, NOISE, longest=700).u.size == 700


def test_what_a_refit_absorbs_is_no_difference():
    u_ = np.sin(T)
    record = Record.from_arrays(u_, 0.5 * u_, TS)
    one, two = static(), NARX([u[k], 1], [0.7, 0.1], Ts=TS)
    found = propose({"offset": one, "drift": two}, record, NOISE)
    assert found.separation < 1e-9 and not found.visible and not found.clear
    assert found.sentence.startswith("No tested input within the present range and rate distinguishes offset and drift")


def test_little_gain_is_said(loops):
    models, record = loops
    best = propose(models, record, NOISE)
    again = Record.from_arrays(best.u, best.outputs["backlash"], TS)
    found = propose(models, again, NOISE)
    assert not found.clear and re.search("(hardly|no) better than the present record", found.sentence)


def test_three_candidates_with_time_and_a_channel(loops):
    models, record = loops
    warm = Record.from_arrays(record.u, record.y, TS, channels={"temperature": 20 + np.sin(T)})
    more = {
        **models,
        "ageing": with_effect(static(), "ageing", "input", [0.01], driver="t"),
        "channel:temperature": with_effect(
            static(), "channel", "output", [0.01], driver="channel", channel="temperature"
        ),
    }
    found = propose(more, warm, NOISE)
    assert set(found.outputs) == set(more) and np.isfinite(found.separation)
    assert "backlash, hysteresis, ageing and channel:temperature" in found.sentence
    assert "any two of their outputs" in found.sentence
    # The temperature is held: an offset, which each of the others has too.
    assert ("backlash", "channel:temperature") in found.together
    assert ("backlash", "hysteresis") not in found.together
    assert "No tested input distinguishes backlash and channel:temperature." in found.sentence


def test_unstable_models_skip_signals_or_give_nothing():
    u_ = np.sin(2 * np.pi * T)
    record = Record.from_arrays(u_, 0.5 * u_, TS)
    wild = NARX([y[k - 1], u[k]], [1.5, 0.1], Ts=TS)
    assert propose({"inertia": wild, "offset": static()}, record, NOISE) is None
    # Integrates its input: stays near on what has no mean, runs away on what rests beside zero.
    drifting = NARX([y[k - 1], u[k]], [1.0, 0.06], Ts=TS)
    found = propose({"inertia": drifting, "offset": static()}, record, NOISE)
    assert found is not None and np.abs(found.outputs["inertia"]).max() < 2


def test_an_output_that_dies_away_is_zero():
    """A record holds no values whose squares are no numbers; a model that the input does not drive gives such."""
    u_ = np.sin(2 * np.pi * T)
    fading = NARX([y[k - 1]], [0.5], Ts=TS)
    found = propose({"inertia": fading, "offset": static()}, Record.from_arrays(u_, 0.5 * u_, TS), NOISE)
    assert found is not None and not np.any(found.outputs["inertia"])


def test_what_cannot_be_decided(loops):
    models, record = loops
    assert propose({"backlash": models["backlash"]}, record, NOISE) is None
    inverse = NARX.from_terms(["u[k-1]", "y[k]"], [0.1, 2.0], input="y", output="u")
    with pytest.raises(ModelError, match="inverse"):
        propose({"backlash": models["backlash"], "hysteresis": inverse}, record, NOISE)
    with pytest.raises(ModelError, match="fit"):
        propose({"backlash": models["backlash"], "offset": NARX([u[k]])}, record, NOISE)


def test_twice_the_range_is_looked_at_where_this_one_does_not_decide(tmp_path):
    """A cubic comes near a tanh, and leaves it beyond the range; limits that are given are kept."""
    u_ = np.sin(2 * np.pi * 0.4 * T)
    x = static()
    models = {
        "saturation": with_effect(x, "saturation", "input", [1.0, 2.0], "soft"),
        "cubic_gain": with_effect(x, "cubic_gain", "input", [-0.04]),
    }
    record = Record.from_arrays(u_, models["saturation"].simulate(u_, 0.0), TS)
    models = {name: fitted(model, record) for name, model in models.items()}
    found = propose(models, record, 1e-4, units=UNITS)
    assert not found.clear and found.wider.clear and found.wider.separation > 3 * found.separation
    assert np.allclose(found.wider.limits, (-2, 2), atol=0.01) and "twice as far (-2 ... 2 V)" in found.sentence
    found.save(tmp_path / "next.csv")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["next.csv", "next_wider.csv"]
    again = propose(models, record, 1e-4, units=UNITS, limits=(-2, 2))
    assert again.clear and again.wider is None and 1.8 < again.u.max() <= 2
    assert again.separation == pytest.approx(found.wider.separation, rel=1e-2)
    kept(Limits.of([record], (-2, 2)), again.u)
    near = propose(models, record, 1e-4, limits=(-0.5, 0.5))
    assert np.abs(near.u).max() <= 0.5 and near.wider is None
    assert "No tested input within -0.5 ... 0.5 at the present rate" in near.sentence


@pytest.mark.parametrize("limits", [(1.0, 1.0), (2.0, -2.0), (0.0, np.inf), (np.nan, 1.0)])
def test_limits_that_are_none(loops, limits):
    with pytest.raises(ModelError, match="two finite numbers"):
        propose(*loops, NOISE, limits=limits)


def test_beyond_the_record_it_says_that_the_models_extrapolate():
    t = np.linspace(0, 1, 50)
    u = 5 + np.sin(6 * t)
    models = ["backlash", "hysteresis"]
    found = Experiment(models, "a sine", t, u, 1.0, 0.1, 0.1, {m: u for m in models}, seen=(0.0, 5.5), units={"u": "V"})
    assert "from rest at 5 V" in found.sentence and "Beyond 0 ... 5.5 V the models extrapolate." in found.sentence
    assert "extrapolate" not in replace(found, seen=(0.0, 7.0)).sentence
