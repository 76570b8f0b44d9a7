"""References, and a law run over them: what the page and Python's API compute is the same."""

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.errors import DataError, ModelError
from narx_sym.fit.laws.start import rests_at
from narx_sym.tasks.compensate import law_of, straight, track
from narx_sym.tasks.reference import MOST, from_file, measured, sine, usual

TS = 0.01


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.standard_normal(600)) / 10
    y = np.zeros(600)
    for k in range(1, 600):
        y[k] = 0.9 * y[k - 1] + 0.2 * u[k - 1]
    return ns.Record.from_arrays(u, y + 0.001 * rng.standard_normal(600), Ts=TS)


@pytest.fixture(scope="module")
def law(record):
    return ns.NARX.from_terms(["y[k-1]", "u[k-1]", "1"]).fit(record).compensator()


def test_a_sine_begins_at_rest():
    made = sine(TS, 1.0, 2.0, 5.0, 0.4)
    assert made.r.size == 40 and made.r[0] == -1.0 and made.r.max() == pytest.approx(3.0)
    assert np.argmax(np.abs(np.diff(made.r))) > 2 and made.t[-1] == pytest.approx(0.39)


def test_where_limits_let_a_model_rest(record, law):
    """The gain at rest is 0.2 / (1 - 0.9); an integrator rests nowhere."""
    model = law.model
    slope, offset = model.theta[1] / (1 - model.theta[0]), model.theta[2] / (1 - model.theta[0])
    assert rests_at(model, (-1.0, 3.0)) == pytest.approx((offset - slope, offset + 3 * slope), rel=1e-6)
    found = law_of(model, (-1.0, 3.0))
    assert (
        found.limits == (-1.0, 3.0)
        and found.rests == rests_at(model, (-1.0, 3.0))
        and "the steady state of the model" in found.notes[-1]
    )
    assert law_of(model).rests is None
    integrator = model.replace(theta=[1.0, 0.2, 0.0])
    assert rests_at(integrator, (-1.0, 3.0)) is None


def test_the_measured_output_begins_at_0_and_may_be_cut(record):
    assert np.array_equal(measured(record).r, record.y) and measured(record).t[0] == 0
    assert np.array_equal(measured(record, 1.5).r, record.y[:150])


def test_the_usual_reference_is_within_the_outputs(record):
    found = usual(record)
    assert record.y.min() < found.offset - found.amplitude < found.offset + found.amplitude < record.y.max()
    made = sine(TS, found.offset, found.amplitude, found.frequency, 4 / found.frequency)
    assert 2 * np.pi * found.frequency * TS < 0.5 and made.r.size > 40


@pytest.mark.parametrize(
    "make, why",
    [
        (lambda: sine(TS, 0, 1, 51, 1), "at most 50 Hz"), (lambda: sine(TS, 0, 1, 0, 1), "frequency must be positive"),
        (lambda: sine(TS, 0, 1, 1, -1), "duration must be positive"), (lambda: sine(TS, 0, 1, 1, 0.01), "between 2"),
        (lambda: sine(TS, 0, 1, 1, 1e9), f"and {MOST}"),
    ],
)  # fmt: skip
def test_a_reference_that_cannot_be_is_one_message(make, why):
    with pytest.raises(DataError, match=why) as error:
        make()
    assert "\n" not in str(error.value)


def test_a_reference_from_a_file(tmp_path):
    path = tmp_path / "secret.csv"
    path.write_text("t,a [m],b\n5,0,1\n5.1,1,2\n5.2,0,3\n")
    with pytest.raises(DataError, match=r"^wanted\.csv: which column") as error:
        from_file(path, "wanted.csv")
    assert "secret" not in str(error.value)
    with pytest.warns(UserWarning, match="converted"):
        made = from_file(path, "wanted.csv", "a", "mm")
    assert made.r.tolist() == [0, 1000, 0] and made.t == pytest.approx([0, 0.1, 0.2]) and made.Ts == pytest.approx(0.1)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("limits, rate", ((None, None), ((-0.1, 0.3), None), ((-2.0, 2.0), 0.001)))
def test_what_is_tracked_is_what_the_api_gives(law, limits, rate):
    reference = sine(TS, 0.2, 0.7, 0.5, 4.0)
    found = track(law, reference, limits, rate)
    m = law.run(reference.r, limits=limits, rate=rate)
    y = law.model.simulate(m, reference.r[0], u0=law.rest_input(reference.r[0], limits))
    bare = law.model.simulate(found.plain.m, reference.r[0], u0=found.plain.m[0])
    assert np.array_equal(bare, found.plain.y)
    assert np.array_equal(found.m, m) and np.array_equal(found.y, y)
    gap = y - reference.r
    rms, most = found.errors["with the law"]
    assert rms == pytest.approx(np.sqrt(np.mean(gap**2)), abs=1e-11)
    assert most == pytest.approx(np.abs(gap).max(), abs=1e-11)
    assert found.errors["without"][0] == pytest.approx(np.sqrt(np.mean((bare - reference.r) ** 2)))
    assert found.held.any() == bool(found.holds) == (limits is not None)
    assert not any(found.holds and found.holds in text.lower() for text in found.notes)
    columns = found.columns({"u": "V", "y": ""})
    assert list(columns) == ["t [s]", "r", "m [V]", "y"] and columns["y"] is found.y


def test_without_the_law_the_best_constant_gain_goes_in_within_the_same_limits(law):
    r = np.repeat([-1.0, 1.0, -1.0], 5)
    free, held = straight(law.model, r), straight(law.model, r, (-0.1, 0.1), 0.03)
    assert np.allclose(free.offset + free.slope * r, free.m)
    assert np.abs(held.m).max() <= 0.1 and np.abs(np.diff(held.m)).max() == pytest.approx(0.03)


def test_no_other_constant_gain_comes_nearer(law):
    r = sine(TS, 0.3, 0.7, 0.5, 6.0).r
    best = straight(law.model, r)

    def error(offset, slope):
        m = offset + slope * r
        return np.sqrt(np.mean((law.model.simulate(m, r[0], u0=m[0]) - r) ** 2))

    least = error(best.offset, best.slope)
    for offset in (-0.02, 0, 0.02):
        for slope in (-0.02, 0, 0.02):
            assert error(best.offset + offset, best.slope + slope) >= least


@pytest.mark.parametrize("model", (["y[k-1]", "phi1[k-1]"], ["y[k-1]", "u[k-1]"]), ids=["paper", "integrator"])
def test_a_constant_gain_is_found_where_there_is_no_gain_at_rest(model):
    built = ns.NARX.from_terms(model, [1.0, 0.5])
    r = 0.4 * np.sin(np.arange(400) / 40)
    best = straight(built, r)
    unscaled = built.simulate(r, r[0], u0=r[0])
    assert np.std(best.y - r) <= np.std(unscaled - r) and np.all(np.isfinite(best.m))


def test_another_pace_and_a_channel_are_refused(law):
    with pytest.raises(DataError, match=r"Ts = 0.02 s"):
        track(law, sine(0.02, 0, 0.1, 0.5, 2.0))
    driven = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "w[k-1]"], [0.5, 0.2, 0.1], channels=["w"])
    with pytest.raises(ModelError, match="needs the channel 'w'"):
        track(driven.compensator(), sine(TS, 0, 0.1, 0.5, 2.0))
