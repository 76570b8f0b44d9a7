"""Go or no go: what is expected of a law is what the machine then does."""

import json
from dataclasses import replace

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.files.atomic import write_csv
from narx_sym.fit.bootstrap import as_large, fresh_blocks, moving_blocks

TS, NOISE, N = 0.01, 0.01, 1500
T = np.arange(N) * TS
GOAL = 0.8 * np.sin(2 * np.pi * 0.3 * T) * np.minimum(T, 1)


def machine(u, seed):
    """A lag with a measured output."""
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    return y + NOISE * np.random.default_rng(seed).standard_normal(len(u))


def log(seed):
    rng = np.random.default_rng([seed, 1])
    u = np.zeros(N)
    for k, w in enumerate(rng.standard_normal(N - 1), 1):
        u[k] = 0.95 * u[k - 1] + 0.5 * w
    return ns.Record.from_arrays(u, machine(u, seed), Ts=TS)


def law_from(record):
    return ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(record, method="free_run").compensator()


@pytest.fixture(scope="module")
def found():
    record = log(0)
    return law_from(record).commission(GOAL, record, draws=60)


def test_what_is_expected_is_what_comes():
    below, inside = 0, []
    for seed in range(20):
        record = log(seed)
        one = law_from(record).commission(GOAL, record, draws=60, seed=seed)
        error = machine(one.run.m, 100 + seed) - GOAL
        below += np.sqrt(np.mean(error**2)) <= one.worst
        inside.append(np.mean((one.low <= error) & (error <= one.high)))
        assert one.expected == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.1)
    assert below >= 17 and np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_what_one_record_does_not_tell_of_its_own_noise_is_in_the_errors():
    """Of white noise the mean square of a new record differs from that of an old one by two such spreads."""
    x, rng = np.random.default_rng(1).standard_normal(900), np.random.default_rng(2)
    fresh = np.mean(fresh_blocks(x, 10, 4000, 900, rng) ** 2, axis=1)
    same = np.mean(moving_blocks(x, 10, 4000, rng) ** 2, axis=1)
    assert np.var(fresh) == pytest.approx(2 * np.var(same), rel=0.15) and np.mean(fresh) == pytest.approx(1, abs=0.1)
    assert fresh_blocks(x, 10, 3, 2000, rng).shape == (3, 2000)


def test_a_part_is_no_larger_than_the_whole():
    """What a start leaves in few blocks is not what is left as a rule."""
    record = log(0)
    y = record.y + 2.0 * 0.8 ** np.arange(N)
    one = law_from(record).commission(GOAL, ns.Record.from_arrays(record.u, y, Ts=TS), draws=60)
    assert one.unexplained < 1.001 * one.expected


def test_nothing_speaks_against_a_good_law(found):
    assert found.go and found.unexplained == pytest.approx(NOISE, rel=0.1) and found.at_limits == 0
    assert found.without > 5 * found.expected and found.steepest == pytest.approx(np.abs(np.diff(found.run.m)).max())
    assert found.sentence({"y": "mm"}).startswith(f"Go. Expected: an error of {1e3 * found.expected:.3g} µm rms")


def lag(u, share, gain=2.0):
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = (1 - share) * y[k - 1] + share * gain * u[k - 1]
    return y


def test_the_law_is_compared_with_the_best_constant_gain():
    """An actuator with lag: the line through its record has less than its gain, which is no fault of who has no law."""
    u, noise = log(0).u, NOISE * np.random.default_rng(5).standard_normal(N)
    record = ns.Record.from_arrays(u, lag(u, 0.01) + noise, Ts=TS)
    one = law_from(record).commission(GOAL, record, draws=40)
    grid = [np.sqrt(np.mean((lag(GOAL * b, 0.01) - GOAL) ** 2)) for b in np.linspace(0.05, 3, 300)]
    assert one.law.model.info.line[1] < 1  # its inverse would make the error more than 5 times what it need be
    assert one.without == pytest.approx(np.hypot(min(grid), one.unexplained), rel=0.05)
    assert f"{one.without / one.expected:.3g} times less than with the best constant gain" in one.sentence()
    assert f"(input = {one.plain.slope:.3g} r" in one.sentence()


def test_what_holds_the_input_is_said_once():
    record, limits = log(0), (-0.5, 0.5)
    law = law_from(record)
    one = law.commission(GOAL, record, draws=20, limits=limits)
    assert 0 < one.at_limits == law.follow(GOAL, limits=limits).held.mean()


def test_with_and_without_the_law_are_measured_alike():
    record = log(0)
    one = law_from(record).commission(np.full(N, 0.3), record, draws=60)
    assert one.go and one.without == pytest.approx(one.expected, rel=0.01)  # at rest a law is no better
    assert one.without == pytest.approx(one.unexplained, rel=0.01)  # what is left is part of both
    assert "no less than with the best constant gain" in one.sentence()


def test_a_law_that_does_worse_than_a_constant_gain_is_no_go():
    record = log(0)
    law = law_from(record)
    slow = law.commission(GOAL, record, draws=30, m0=5.0, rate=0.02)  # it comes from far away
    assert not slow.go and any("larger than with the best constant gain" in text for text in slow.against)


@pytest.mark.parametrize(
    ("options", "scale", "word"),
    (
        ({"limits": (-0.3, 0.3)}, 1, "The input is at a limit for"),
        ({"rate": 1e-4}, 1, "The input is at a limit for"),
        ({}, 5, "The reference"),
    ),
)
@pytest.mark.filterwarnings("ignore")
def test_what_speaks_against_it(options, scale, word):
    record = log(0)
    one = law_from(record).commission(scale * GOAL, record, draws=30, **options)
    assert not one.go and any(word in text for text in one.against) and one.sentence().startswith("No go.")


def test_the_same_seed_gives_the_same_figures(found):
    record = log(0)
    again = law_from(record).commission(GOAL, record, draws=60)
    assert np.array_equal(again.errors, found.errors)


def test_on_the_command_line(run, tmp_path):
    record = log(0)
    write_csv(tmp_path / "log.csv", {"t": record.t, "u": record.u, "y": record.y})
    write_csv(tmp_path / "wanted.csv", {"t": T, "r": GOAL})
    law_from(record).model.save(tmp_path / "model.json")
    code, out, _ = run(
        f"commission {tmp_path}/model.json {tmp_path}/log.csv --reference {tmp_path}/wanted.csv --json "
        f"{tmp_path}/c.json --plot {tmp_path}/c.png --units V,mm --draws 30"
    )
    assert code == 0 and out.startswith("Go. Expected") and (tmp_path / "c.png").stat().st_size > 10_000
    said = json.loads((tmp_path / "c.json").read_text())
    assert said["go"] and said["expected"] < said["worst"] < said["without"] and said["against"] == []
    assert set(said["without_input"]) == {"offset", "slope"}
    code, _, err = run(
        f"commission {tmp_path}/model.json {tmp_path}/log.csv --reference {tmp_path}/none.csv --plot {tmp_path}/d.png"
    )
    assert code == 2 and "none.csv" in err and not (tmp_path / "d.png").exists()


def test_a_law_with_a_channel_is_refused():
    n = 200
    rng = np.random.default_rng(0)
    u, w = rng.standard_normal((2, n))
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.5 * y[k - 1] + u[k - 1] + 0.3 * w[k - 1]
    record = ns.Record.from_arrays(u, y, Ts=1.0, channels={"w": w})
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "w[k-1]"], channels=["w"]).fit(record).compensator()
    with pytest.raises(ns.ModelError, match="one input"):
        law.commission(np.zeros(50), record)


def test_the_law_of_an_inverse_model_is_refused():
    record = log(0)
    model = ns.identify_inverse(record.smoothed(0.1), lead=1, n_terms=2)
    with pytest.raises(ns.ModelError, match="one input and one output"):
        model.compensator().commission(GOAL, record)


def test_residuals_are_as_large_as_the_noise_was():
    """What a fit of p parameters leaves of n independent samples is smaller by (n - p) / n; little is left of few."""
    rng = np.random.default_rng(0)
    sizes = {False: [], True: []}
    for _ in range(300):
        A, e = rng.standard_normal((30, 6)), rng.standard_normal(30)
        left = e - A @ np.linalg.lstsq(A, e, rcond=None)[0]
        sizes[False].append(np.mean(left**2))
        sizes[True].append(np.mean(as_large(left, 6) ** 2))
    assert np.mean(sizes[False]) < 0.85 and 0.9 < np.mean(sizes[True]) < 1.15
    slow = np.convolve(rng.standard_normal(340), np.ones(40) / 40, "valid")
    assert np.std(as_large(slow, 3)) > 1.1 * np.std(slow)


def test_what_no_sensor_makes_has_no_bound(found):
    """What a model lacks is drawn by chance, and may be none: it is said where the sensor makes clearly less."""
    assert found.sensor == pytest.approx(NOISE, rel=0.2) and "no bound" not in found.sentence()
    assert "no bound is known for it" in replace(found, sensor=found.unexplained / 3).sentence()
    assert "no bound" not in replace(found, sensor=0.0).sentence()  # nothing is known of it
