"""No wrong number in silence: run-away laws, useless fits, hand-made model files, overwritten inputs, Ctrl-C."""

import signal
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest

import narx_sym as ns
from narx_sym import __main__ as command
from narx_sym.cli import stop
from narx_sym.errors import FitError, NotInvertible
from narx_sym.fit import identify as identification
from narx_sym.fit.bases.judged import periodic_growth
from narx_sym.models.info import Info

TERMS = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"]


def bench(N=3000, Ts=0.01, peak=70.0, seed=2, u0=0.0, y0=0.0):
    u = ns.plants.filtered_noise(N=N, Ts=Ts, cutoff=0.5, peak=peak, seed=seed)
    return ns.Record.from_arrays(u + u0, ns.plants.bouc_wen(u, Ts=Ts) + y0, Ts=Ts)


def with_ranges(model, u=(-1.0, 1.0), y=(-1.0, 1.0)):
    return model.replace(info=Info(ranges={"u": u, "y": y}))


@pytest.mark.parametrize("base", ("narx", "linear", "static"))
@pytest.mark.parametrize("delay", (0, pytest.param(1, marks=pytest.mark.long), pytest.param(2, marks=pytest.mark.long)))
def test_for_compensation_always_gives_a_law(base, delay):
    record = bench(N=1200)
    model = ns.identify(record, base=base, delay=delay, for_compensation=True)
    law = model.compensator()
    assert law.residual() == 0 and law.preview == delay
    assert model.info.selection.stable_law in (True, False)


def test_the_term_that_is_inverted_is_never_left_out():
    """A lightly damped resonance: ERR would not choose phi1[k-1]."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(1500)
    y = np.zeros_like(u)
    for i in range(2, u.size):
        y[i] = 1.9 * y[i - 1] - 0.95 * y[i - 2] + 0.01 * u[i - 2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = ns.identify(ns.Record.from_arrays(u, y, Ts=0.01), for_compensation=True)
        except (FitError, NotInvertible):
            return
    assert model.compensator(force=True).residual() == 0


def test_a_useless_fit_is_said():
    rng = np.random.default_rng(1)
    record = ns.Record.from_arrays(rng.standard_normal(500), rng.standard_normal(500), Ts=1.0)
    with pytest.warns(UserWarning, match="no better than a constant"):
        ns.identify(record, base="static")


def test_an_unbounded_model_is_said():
    model = with_ranges(ns.NARX.from_terms(["y[k-1]", "phi1[k-1]*u[k-1]"], [1.0, 1.0]))
    model = model.replace(info=replace(model.info, line=(0.0, 0.0)))
    assert periodic_growth(model) < 1.0
    drifting = with_ranges(ns.NARX.from_terms(["y[k-1]", "phi2[k-1]*phi1[k-1]"], [1.0, 1.0]))
    drifting = drifting.replace(info=replace(drifting.info, line=(0.0, 0.0)))
    assert periodic_growth(drifting) > 5.0


def test_a_hand_made_model_on_biased_data_starts_on_the_data():
    record = bench(u0=500.0, y0=-900.0)
    model = ns.NARX.from_terms(TERMS).fit(record, ["continuum"])
    offset, slope = model.info.line
    assert offset + slope * record.u.mean() == pytest.approx(record.y.mean(), rel=1e-6)
    centred = ns.NARX.from_terms(TERMS).fit(bench(), ["continuum"])
    assert centred.info.line[0] == 0.0


def test_an_offset_between_records_hides_nothing():
    """The output is noise around another level in each: the levels are no merit of a model."""
    rng = np.random.default_rng(3)
    listed = [
        ns.Record.from_arrays(level + rng.standard_normal(400), level + rng.standard_normal(400), 0.01, name=str(level))
        for level in (0, 50)
    ]
    with pytest.warns(UserWarning, match="Along the record '(0|50)' the free run is no better than a constant"):
        model = ns.identify(listed, base="static", degree=1)
    assert ns.evaluate(model, listed).free_run_nrmse < 0.1


def test_another_sampling_time_is_said():
    model = ns.NARX.from_terms(TERMS).fit(bench(), ["continuum"])
    other = bench()
    with pytest.warns(UserWarning, match=r"Ts = 0.02 s"):
        ns.evaluate(model, ns.Record.from_arrays(other.u, other.y, Ts=0.02))


def test_no_closed_form_is_looked_for_for_ever(tmp_path):
    from narx_sym.inversion.analyses import summary

    model = ns.NARX.from_terms(["y[k-1]", "exp(exp(exp(y[k-1])))", "u[k-1]"], [0.5, 0.1, 1.0])
    assert any("no closed-form" in line for _, lines in summary(model) for line in lines)


def test_interrupted(monkeypatch, capsys, tmp_path):
    record = bench(N=200)
    rows = "\n".join(f"{a},{b},{c}" for a, b, c in zip(record.t, record.u, record.y, strict=True))
    (tmp_path / "d.csv").write_text("t,u,y\n" + rows)

    def interrupt(*_, **__):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(stop, "pressed", False)
    monkeypatch.setattr(identification, "identify", interrupt)
    monkeypatch.setattr(sys, "argv", ["narx-sym", "fit", str(tmp_path / "d.csv"), "--out", str(tmp_path / "m.json")])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 130 and "interrupted" in capsys.readouterr().err
    assert not (tmp_path / "m.json").exists()
