"""Bases that remember where the input turned."""

import numpy as np
import pytest
import sympy as sp
from places import SHARED, needs_shared

import narx_sym as ns
from narx_sym.errors import FitError, ModelError
from narx_sym.fit.bases.choice import choose_base
from narx_sym.fit.bases.play import Shape, branch_after, identify_play
from narx_sym.models.rest_map import plays
from narx_sym.symbolic.signals import k, u

N, TS = 900, 0.01
RNG = np.random.default_rng(2)
U = np.interp(np.arange(N), np.arange(0, N + 30, 30), RNG.uniform(-2, 2, N // 30 + 1))


def plays_by_hand(source, radii, weights, a=0.6, bend=-0.2, at=0.5, start=0.0):
    """A stage of plays behind a bent curve and a lag, in plain loops."""
    held, out, before = [source[0]] * len(radii), np.empty(len(source)), start
    for i, x in enumerate(source):
        held = [max(x - r, min(x + r, z)) for r, z in zip(radii, held, strict=True)]
        v = weights[0] * x + sum(w * z for w, z in zip(weights[1:], held, strict=True))
        before = a * before + (1 - a) * (v + bend * max(v - at, 0.0)) if i else start
        out[i] = before
    return out


@pytest.fixture(scope="module")
def found():
    made = plays_by_hand(U, [0.5, 1.1], [1.0, 0.8, 0.4])
    record = ns.Record.from_arrays(U, made + 0.002 * RNG.standard_normal(N), Ts=TS)
    return record, ns.identify(record, base="play", plays=4)


def test_the_recursion_is_the_stage_by_hand():
    theta = [0.6, 1.0, 0.8, 0.4, 0.0, -0.2]
    model = Shape((0.5, 1.1), (0.5,), 0).model({}, theta)
    run = model.simulate(U, 0.3)
    assert run == pytest.approx(plays_by_hand(U, [0.5, 1.1], [1.0, 0.8, 0.4], start=0.3), abs=1e-13)
    assert model.sigma_y == sp.Symbol("a", real=True) and [str(s.left) for s in model.memory] == ["z1[k]", "z2[k]"]


def test_a_play_base_follows_a_stage_of_plays(found):
    record, model = found
    line = np.polyval(np.polyfit(record.u, record.y, 1), record.u)
    assert model.info.nrmse.free_run < 0.02 < 0.1 * np.std(record.y - line) / np.std(record.y)
    assert all(value >= 0 for s, value in model.values.items() if str(s).startswith("p_"))
    assert "the delay is the smallest" in model.info.selection.reason and model.delay == 0
    assert np.all(np.isfinite(model.standard_errors))  # though the start of a narrow play moves nothing


def test_it_is_saved_printed_and_derived(found, tmp_path):
    _, model = found
    model.save(tmp_path / "m.json")
    again = ns.load(tmp_path / "m.json")
    assert again.F == model.F and again.states == model.states and again.theta.tolist() == model.theta.tolist()
    assert r"\max" in model.latex() and "z4[k] = Max(" in "\n".join(model.lines())
    assert model.recursion.graph.delays(u)[ns.y] == 0 and model.states[0].left == ns.symbolic.signals.signal("z1")[k]


def test_the_branch_after_a_history_is_where_a_slow_run_goes():
    model = Shape((0.5, 1.1), (0.5,), 1).model({u: 0.2, ns.y: -3.0}, [0.6, 1.0, 0.8, 0.4, 0.1, -0.2])
    history = U[:500]
    curve = sp.lambdify(u[k], branch_after(model, history))
    for end in (history[-1] + 1.7, history[-1] - 0.9):
        slow = np.concatenate([history, np.linspace(history[-1], end, 300), np.full(60, end)])
        assert model.simulate(slow, 0.0, warn=False)[-1] == pytest.approx(float(curve(end)), abs=1e-11)
    with pytest.raises(ModelError, match="only memory is plays"):
        branch_after(ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0]), history)


def test_creep_is_found_and_inverted(tmp_path):
    truth = Shape((0.4, 0.9), (), 0, creep=True).model({}, [0.5, 1.0, 0.6, 0.4, 0.0, 0.1, 0.99])
    record = ns.Record.from_arrays(U, truth.simulate(U, U[0], warn=False) + 0.001 * RNG.standard_normal(N), Ts=TS)
    model = ns.identify(record, base="play", delay=0, plays=3, creep=True)
    assert model.info.selection.reason.startswith(f"{len(plays(model))} of 3 plays have a nonzero weight") and plays(
        model
    )
    assert model.values[sp.Symbol("g", real=True)] == pytest.approx(0.1, abs=0.03)
    assert model.values[sp.Symbol("b", real=True)] == pytest.approx(0.99, abs=0.01)
    model.save(tmp_path / "m.json")
    law, wave = ns.load(tmp_path / "m.json").compensator(), np.sin(np.arange(300) / 30)
    assert [s.how for s in law.staged.stages][1:] == ["linear", "plays"]
    assert np.abs(model.simulate(law.run(wave, 0.0), 0.0, u0=0.0, warn=False) - wave).max() < 1e-12


def test_refusals(found):
    record, _ = found
    with pytest.raises(FitError, match="falls when the input rises"):
        ns.identify(ns.Record.from_arrays(U, -record.y, Ts=TS), base="play")
    with pytest.raises(ModelError, match="from 1 to 50 plays"):
        identify_play([record], {}, plays=0)
    with pytest.raises(ModelError, match="at 0 to 50 places, not -1"):
        identify_play([record], {}, knots=-1)


@pytest.mark.long
@needs_shared
def test_plays_beat_lags_on_the_real_piezo():
    """Judged as every other model: fitted on one sine, with the offset of the other record."""
    train = ns.read(SHARED / "piezo_dbo" / "train_1Hz_full_range.csv", rows=slice(20, None))
    test = ns.read(SHARED / "piezo_dbo" / "test_varying_amplitude.csv", rows=slice(20, 5000))
    errors = {
        base: ns.evaluate(ns.identify(train, base=base), test, align=True).free_run_nrmse for base in ("play", "linear")
    }
    assert errors["play"] <= 0.028 and errors["play"] <= 0.6 * errors["linear"]
    creeping = ns.identify(train, base="play", creep=True)
    assert ns.evaluate(creeping, test, align=True).free_run_nrmse <= 0.022


def test_a_bouc_wen_base_is_the_papers_actuator_again():
    volts = 40 * U
    record = ns.Record.from_arrays(volts, ns.plants.bouc_wen(volts, Ts=TS), Ts=TS)
    model = ns.identify(record, base="bouc-wen")
    c1, c2, c3, d, h0 = model.theta
    assert (c1, c2, c3, d) == pytest.approx((0.7, 0.008, 0.008, 1.6), rel=0.05) and abs(h0) < 1.0
    assert "bare" in model.info.selection.reason and model.info.nrmse.free_run < 0.01
    law = model.compensator()
    m = law.run(30 * np.sin(np.arange(300) / 30), 0.0)
    assert law.closed_form
    assert model.simulate(m, 0.0, u0=0.0)[1:] == pytest.approx(30 * np.sin(np.arange(300) / 30)[1:], abs=1e-9)


def test_a_lag_behind_the_actuator_is_found():
    volts = 40 * U
    bare, late = ns.plants.bouc_wen(volts, Ts=TS), np.zeros(N)
    for i in range(1, N):
        late[i] = 0.7 * late[i - 1] + 0.3 * bare[i]
    record = ns.Record.from_arrays(volts, late, Ts=TS)
    model = ns.identify(record, base="bouc-wen", delay=0)
    assert model.values[sp.Symbol("a", real=True)] == pytest.approx(0.7, abs=0.02)
    assert ns.evaluate(model, record).free_run_nrmse < 0.02  # what stands before the lag was not measured


def test_auto_takes_the_best_free_run_on_blocks_that_no_fit_saw_at_a_price():
    record = ns.Record.from_arrays(U, 0.5 * U + 0.02 * RNG.standard_normal(N), Ts=TS)
    seen = []

    def identified(base, records, size):
        seen.append((base, [len(r) for r in records]))
        if base == "narx":
            raise FitError("does not follow")
        gains = {"static": 0.5, "linear": 0.5, "play": 0.3, "bouc-wen": 0.2}
        more = {"linear": 4}.get(base, 0)  # as good, with more parameters
        terms, theta = ["u[k]", *(f"u[k-{i}]" for i in range(1, 1 + more))], [gains[base], *[0.0] * more]
        return ns.NARX.from_terms(terms, theta, Ts=TS)

    model = choose_base([record], identified)
    assert model.info.selection.base == "static" and len(model.symbols) == 1
    assert (
        model.info.selection.reason.startswith("static 0.0")
        and "compared with linear 0.0" in model.info.selection.reason
    )
    assert seen[0] == ("static", [150, 300, 150]) and seen[-1] == ("static", [N])
    with pytest.raises(FitError, match="does not follow"):
        choose_base([record], lambda base, records, size: identified("narx", records, size))


def test_an_offset_of_the_sensor_decides_for_no_base():
    """A model with Sigma_y = 1 takes the offset of the next record along; one that forgets its start cannot."""
    first, later = (ns.Record.from_arrays(U, 0.5 * U + moved, Ts=TS) for moved in (0.0, 0.3))
    forms = {"static": (["u[k]"], [0.5]), "narx": (["y[k-1]", "phi1[k]"], [1.0, 0.47])}

    def identified(base, records, size):
        if base not in forms:
            raise FitError("does not follow")
        return ns.NARX.from_terms(*forms[base], Ts=TS)

    assert choose_base([first, later], identified).info.selection.base == "static"


def test_a_block_in_which_nothing_moves_stops_no_base():
    still = np.concatenate([np.full(N // 5, U[0]), U])  # the first of six blocks

    def identified(base, records, size):
        assert all(np.ptp(r.u) for r in records)
        return ns.NARX.from_terms(["u[k]"], [0.5], Ts=TS)

    assert choose_base([ns.Record.from_arrays(still, 0.5 * still, Ts=TS)], identified).info.selection.base == "static"
