"""What no model can know of a new record is estimated on its first part: where it starts, and the sensor's drift."""

import json

import numpy as np
import pytest
from places import SHARED, needs_shared

import narx_sym as ns
from narx_sym.errors import FitError, ModelError

N, TS = 800, 0.01
RNG = np.random.default_rng(8)
U = np.cumsum(RNG.standard_normal(N)) / 8
LINEAR = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.99, 0.02], Ts=TS)
BENT = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]"], [1.0, 0.8, -0.3], Ts=TS)


def driven(model, start=0.0, offset=0.0, noise=0.0):
    y = model.simulate(U, start) + offset + noise * RNG.standard_normal(N)
    return ns.Record.from_arrays(U, y, Ts=TS, name="run")


def test_an_offset_is_estimated_and_said():
    found = BENT.aligned(driven(BENT, offset=2.0), first=3.0)
    assert found.raw > 1.0 and found.aligned < 0.1 * found.raw and found.first == (301,)
    assert found.offsets == pytest.approx((2.0,), abs=0.25)  # the run starts 2.0 too high, and that takes a while
    still = ns.NARX.from_terms(["u[k]"], [0.7], Ts=TS)  # nothing starts here: exact
    found = still.aligned(driven(still, offset=-3.0))
    assert found.aligned < 1e-12 and found.offsets == pytest.approx((-3.0,), abs=1e-12)
    none = BENT.aligned(driven(BENT))
    assert none.raw == none.started == none.aligned == 0.0 and not none.offset_explains and not none.sentence()


def test_a_wrong_first_sample_is_no_fault_of_the_model():
    record = driven(LINEAR, start=3.0)
    y = record.y.copy()
    y[0] += 4.0  # a spike where the run begins
    spiked = ns.Record.from_arrays(U, y, Ts=TS)
    found = LINEAR.aligned(spiked)
    assert found.started < 1e-6 < found.raw
    assert (
        found.raw
        == pytest.approx(  # the same samples, by hand
            np.sqrt(np.mean((y - LINEAR.simulate(U, y[0]))[101:] ** 2)) / np.std(y[101:]), rel=1e-9
        )
    )


def test_what_the_estimate_saw_does_not_count():
    record = driven(LINEAR)
    y = record.y.copy()
    y[1:90] += np.sin(np.arange(89))  # wrong in the first part only
    found = LINEAR.aligned(ns.Record.from_arrays(U, y, Ts=TS))
    assert found.raw < 1e-12


def test_a_slow_record_has_samples_enough_for_its_start():
    """A second of a tank that is sampled every four seconds is one sample: nothing can be estimated on it."""
    tank = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], [1.8, -0.81, 0.01], Ts=4.0)
    y = tank.simulate(U, 5.0) + 0.01 * np.random.default_rng(2).standard_normal(N)
    found = tank.aligned(ns.Record.from_arrays(U, y, Ts=4.0))
    assert found.first == (50,) and found.started < 1.1 * 0.01 / np.std(y[50:])
    assert tank.aligned(ns.Record.from_arrays(U, y, Ts=4.0), first=40.0).first == (11,)  # what is asked for is kept


def test_each_segment_has_its_own_offset():
    parts = [driven(BENT, offset=o)[:400] for o in (1.0, -1.0)]
    found = BENT.aligned(parts, first=2.0)
    assert found.offsets == pytest.approx((1.0, -1.0), abs=0.2) and found.first == (200, 200)
    assert found.constant > 0.9 and found.sentence("um").endswith(" um of the error is an offset of the new record")


def test_a_first_part_that_shows_something_else_is_said():
    """An offset that the start hides is no advice; what is estimated there all the same is told as what it is."""
    still = ns.NARX.from_terms(["u[k]"], [0.7], Ts=TS)
    y = 0.7 * U + 2.0
    y[:41] -= 8.0
    found = still.aligned(ns.Record.from_arrays(U, y, Ts=TS), first=0.4)
    assert found.constant > 0.99 and found.aligned > found.started == found.raw
    assert not found.offset_explains and not found.sentence()
    assert found.advice(False, "um").startswith("2 um of the error is a constant that the first part does not show")
    assert f"larger ({found.aligned:.3g} instead of {found.raw:.3g})" in found.advice(True)
    shown = still.aligned(driven(still, offset=2.0))
    assert shown.advice(False).endswith("--align estimates it") and not shown.advice(True)
    none = LINEAR.aligned(driven(LINEAR))
    assert not none.advice(False) and not none.advice(True)


def test_refusals():
    with pytest.raises(ModelError, match="positive"):
        LINEAR.aligned(driven(LINEAR), first=-1.0)
    with pytest.raises(FitError, match="too few"):
        LINEAR.aligned(driven(LINEAR)[:6])


def test_compare_suggests_it_and_writes_it(run, tmp_path):
    record = driven(BENT, offset=2.0, noise=0.001)
    BENT.save(tmp_path / "model.json")
    rows = np.column_stack([record.t, record.u, record.y])
    np.savetxt(tmp_path / "d.csv", rows, delimiter=",", header="t,u,y", comments="")
    call = ["compare", tmp_path / "model.json", tmp_path / "d.csv", "--no-plot", "--units", "V,um"]
    code, out, err = run(*call)
    assert code == 0 and "start estimated" in out and "offset estimated" not in out
    assert "um of the error is an offset of the new record; --align estimates it" in err
    code, out, err = run(*call, "--align", "--align-on", "0.5", "--json", tmp_path / "c.json")
    assert code == 0 and "offset estimated" in out and "--align" not in err
    (row,) = json.loads((tmp_path / "c.json").read_text())["free_run_after_the_first_part"]
    assert row["offset_estimated"] < 0.5 * row["raw"] and row["first_samples"] == [51]


@needs_shared
def test_most_of_the_error_on_the_real_piezo_is_an_offset():
    """The six terms as identified from the full-range sine; most of their error on varying amplitudes is a drift."""
    terms = ["phi1[k-1]", "phi1[k-2]*phi2[k-2]*u[k-2]", "phi1[k-2]*phi2[k-2]*y[k-1]", "phi1[k-2]*u[k-2]*y[k-1]"]
    theta = [9.0028, 12.5264, -0.775817, 0.0728965, -0.0318365, 1.0]
    train, test = (
        ns.read(SHARED / "piezo_dbo" / name, rows=rows)
        for name, rows in (
            ("train_1Hz_full_range.csv", slice(20, None)),
            ("test_varying_amplitude.csv", slice(20, 5000)),
        )
    )
    point = ns.fit.identify.operating_point(train)
    model = ns.NARX.from_terms([*terms, "phi1[k-2]*y[k-1]", "y[k-1]"], theta, operating_point=point, Ts=train.Ts)
    found = model.aligned(test)
    assert found.raw == pytest.approx(0.080, abs=0.002) and found.aligned <= 0.032
    assert found.sentence("um") == "0.83 um of the error is an offset of the new record"
