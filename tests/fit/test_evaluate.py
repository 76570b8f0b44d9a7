"""The one protocol: free run over the whole record, from start states that are estimated on it."""

import json

import numpy as np
import pytest
import sympy as sp

import narx_sym as ns
from narx_sym.errors import Diverged
from narx_sym.fit.evaluate import digits, started
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.recursion import State

N, TS = 800, 0.01
RNG = np.random.default_rng(8)
U = np.cumsum(RNG.standard_normal(N)) / 8
LINEAR = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.99, 0.02], Ts=TS)
BENT = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]"], [1.0, 0.8, -0.3], Ts=TS)
AXIS = ns.NARX(
    [ns.y[ns.k - 1], ns.y[ns.k - 2], ns.u[ns.k - 1], sp.S.One], [1.9, -0.9, 0.1, 0.002], Ts=TS,
    constraints=[sp.Eq(sp.Symbol("theta_1", real=True) + sp.Symbol("theta_2", real=True), 1)],
)  # fmt: skip

PLAY = extend(LINEAR, next(v for v in variants(LINEAR) if v.id == "backlash" and v.where == "output")).model
PLAY = PLAY.replace(theta=[0.99, 0.02, 1.0, 0.3])


def driven(model, start=0.0, offset=0.0, noise=0.0):
    y = model.simulate(U, start) + offset + noise * RNG.standard_normal(N)
    return ns.Record.from_arrays(U, y, Ts=TS, name="run")


def test_a_wrong_first_sample_is_no_fault_of_the_model():
    record = driven(LINEAR, start=3.0)
    y = record.y.copy()
    y[0] += 4.0  # a spike where the run begins
    spiked = ns.Record.from_arrays(U, y, Ts=TS)
    assert ns.evaluate(LINEAR, spiked).free_run_nrmse < 1e-9
    # From the measured first sample the spike would be in the whole run.
    assert np.std(y - LINEAR.simulate(U, y[0])) > 0.1 * np.std(y)


def test_the_estimated_start_has_the_least_error_of_all_starts():
    record = driven(LINEAR, start=3.0, noise=0.2)
    best = ns.evaluate(LINEAR, record).free_run_nrmse
    for shift in (-0.3, -0.01, 0.01, 0.3):
        run = LINEAR.simulate(U, ns.free_run(LINEAR, record)[1] / 0.99 - 0.02 / 0.99 * U[0] + shift)
        assert np.sqrt(np.mean((record.y - run)[1:] ** 2)) > best * np.std(record.y) * (1 - 1e-9)


def test_the_number_is_that_of_the_run():
    record = driven(BENT, noise=0.1)
    found, run = ns.evaluate(BENT, record), ns.free_run(BENT, record)
    assert found.free_run_nrmse == ns.metrics.nrmse(record.y, run)
    assert found.free_run_mape == ns.mape(record.y, run)
    assert found.free_run_rms == ns.metrics.rmse(record.y, run)
    assert found.fit == 100 * (1 - found.free_run_nrmse) == ns.metrics.fit_percent(record.y, run)


def test_every_contiguous_record_starts_anew():
    both = driven(LINEAR, start=3.0)
    y = np.concatenate([both.y[:400], driven(LINEAR, start=-5.0).y[:400]])
    u = np.concatenate([U[:400], U[:400]])
    record = ns.Record(u=u, y=y, t=np.arange(800) * TS, Ts=TS, breaks=(400,))
    assert ns.evaluate(LINEAR, record).free_run_nrmse < 1e-9
    assert ns.evaluate(LINEAR, [record[:400], record[400:]]).free_run_nrmse < 1e-9


def test_the_memory_of_an_effect_is_a_start_state():
    record = ns.Record.from_arrays(U, PLAY.simulate(U, 0.0), Ts=TS)
    assert ns.evaluate(PLAY, record[300:]).free_run_nrmse < 1e-6  # it begins in the middle of its loop


def test_an_offset_is_estimated_where_it_is_asked_for():
    still = ns.NARX.from_terms(["u[k]"], [0.7], Ts=TS)
    record = driven(still, offset=-3.0)
    assert ns.evaluate(still, record).free_run_rms == pytest.approx(3.0)
    assert ns.evaluate(still, record, align=True).free_run_nrmse < 1e-12
    assert started(still, record, align=True).offset == pytest.approx(-3.0)
    bent = driven(BENT, offset=2.0)
    aligned = ns.evaluate(BENT, bent, align=True).free_run_nrmse
    assert aligned < 0.1 * ns.evaluate(BENT, bent).free_run_nrmse
    assert started(BENT, bent, align=True).offset == pytest.approx(2.0, abs=0.25)


def test_the_load_of_an_axis_is_estimated_on_each_record_and_told():
    record = driven(AXIS)
    other = ns.Record.from_arrays(U, AXIS.replace(theta=[1.9, -0.9, 0.1, -0.004]).simulate(U, 0.0), Ts=TS)
    assert ns.evaluate(AXIS, record).free_run_nrmse < 1e-9
    found = ns.evaluate(AXIS, other)
    assert found.free_run_nrmse < 1e-9 and found.own_load_nrmse > 0.1
    assert started(AXIS, other).load == pytest.approx(-0.006)
    fitted = AXIS.fit([record, other], method="free_run")
    assert sum(fitted.theta[:2]) == pytest.approx(1.0, abs=1e-14)  # an integrator stays one
    assert ns.evaluate(LINEAR, record).own_load_nrmse is None


def test_what_diverges_has_an_infinite_error_and_says_where():
    wild = ns.NARX.from_terms(["y[k-1]", "u[k-1]*y[k-1]"], [9.0, 1.0], Ts=TS)
    record = driven(LINEAR, start=1.0)
    assert ns.evaluate(wild, record).free_run_nrmse == np.inf
    with pytest.raises(Diverged, match="sample"):
        ns.free_run(wild, record)


@pytest.mark.parametrize("model", (LINEAR, BENT, AXIS))
def test_printed_numbers_run_like_the_model(model):
    """What is printed, read back, has a free run that differs by a hundredth of the error at most."""
    record = driven(model, noise=0.05)
    fitted = model.fit(record, method="free_run")
    (line,) = fitted.lines(numbers=True)
    printed = ns.Model(parse(line.partition(" = ")[2]), (), [], Ts=TS)
    run = ns.free_run(fitted, record, loads=False)  # no constraint stands on paper
    moved = np.sqrt(np.mean((ns.free_run(printed, record) - run) ** 2))
    assert moved <= 0.0101 * np.sqrt(np.mean((record.y - run) ** 2))
    assert 4 <= fitted.info.digits == digits(fitted, record) < 12
    fewer = fitted.replace(theta=[float(f"{v:.{fitted.info.digits - 1}g}") for v in fitted.theta])
    if fitted.info.digits > 4:  # and no more digits than that needs
        assert np.sqrt(np.mean((ns.free_run(fewer, record, loads=False) - run) ** 2)) > 0.01 * np.sqrt(
            np.mean((record.y - run) ** 2)
        )


def test_printed_states_run_like_the_model():
    record = driven(PLAY, noise=0.01)
    fitted = LINEAR.add("backlash").fit(record)
    *states, last = (line.partition(" = ") for line in fitted.lines(numbers=True))
    names = [left.partition("[")[0] for left, _, _ in states]
    kept = [
        State(s.left, parse(right, signals=names), s.initial, s.group)
        for s, (_, _, right) in zip(fitted.states, states, strict=True)
    ]
    printed = ns.Model(parse(last[2], signals=names), (), [], states=kept, Ts=TS)
    run = ns.free_run(fitted, record)
    left = np.sqrt(np.mean((record.y - run) ** 2))
    assert np.sqrt(np.mean((ns.free_run(printed, record) - run) ** 2)) <= 0.0101 * left


def test_compare_prints_the_number_of_evaluate(run, tmp_path):
    record = driven(BENT, offset=2.0, noise=0.001)
    BENT.save(tmp_path / "model.json")
    rows = np.column_stack([record.t, record.u, record.y])
    np.savetxt(tmp_path / "d.csv", rows, delimiter=",", header="t,u,y", comments="")
    call = ["compare", tmp_path / "model.json", tmp_path / "d.csv", "--no-plot", "--json", tmp_path / "c.json"]
    code, out, err = run(*call)
    assert code == 0 and "start states" in out and "--align estimates the offset" in err
    measured = ns.read(tmp_path / "d.csv")
    (row,) = json.loads((tmp_path / "c.json").read_text())["errors"]
    assert row["free_run_nrmse"] == ns.evaluate(BENT, measured).free_run_nrmse
    code, out, err = run(*call, "--align", "--validate", tmp_path / "d.csv")
    first, second = json.loads((tmp_path / "c.json").read_text())["errors"]
    assert code == 0 and "estimated offset of the sensor" in err and second["record"].endswith("(validation)")
    assert first["free_run_nrmse"] == ns.evaluate(BENT, measured, align=True).free_run_nrmse < row["free_run_nrmse"]
