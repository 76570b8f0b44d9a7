"""What an identification has seen: range, rate, frequency; warnings by how much a run goes beyond; unfinished fits."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.data.coverage import frequency, rate, seen
from narx_sym.data.record import Record
from narx_sym.errors import ModelError
from narx_sym.fit.coverage import beyond
from narx_sym.fit.least_squares import fit
from narx_sym.fit.simulate import extrapolates
from narx_sym.models.info import Info

TS = 0.01
TERMS = ["y[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]"]


def sine(size=1.0, hertz=1.0, n=1_000, level=0.0):
    return level + size * np.sin(2 * np.pi * hertz * TS * np.arange(n))


def model_of(source):
    truth = ns.NARX.from_terms(TERMS, [1.0, 2.0, -0.3])
    record = Record.from_arrays(source, truth.simulate(source, 0.0), Ts=TS)
    return ns.NARX.from_terms(TERMS).fit(record, ["continuum"]), record


@pytest.fixture(scope="module")
def model():
    return model_of(sine())[0]


@pytest.fixture(scope="module")
def linear():
    truth = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])
    return ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(Record.from_arrays(sine(), truth.simulate(sine(), 0.0), Ts=TS))


def said(call, *arguments, **options):
    return told(call, *arguments, **options)[1]


def told(call, *arguments, **options):
    """What a call returns, and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = call(*arguments, **options)
    return found, [str(w.message) for w in caught]


# ---------------------------------------------------------------- measures


def test_rate_and_frequency_of_a_sine_and_of_steps():
    assert rate([sine(3.0, 2.0)], TS) == pytest.approx(3 * 2 * np.pi * 2, rel=0.01)
    assert frequency([sine(3.0, 2.0, level=50)], TS) == pytest.approx(2.0, abs=0.25)
    assert frequency([sine(n=500), sine(hertz=8.0, n=500)], TS) == pytest.approx(8.0, abs=0.5)
    assert rate([np.array([0.0, 0, 4, 4])], TS) == 400 and rate([np.array([1.0])], TS) == 0
    assert frequency([np.full(50, 7.0)], TS) == 0
    both = sine(hertz=3.0) + 0.05 * np.random.default_rng(0).standard_normal(1_000)
    assert frequency([both], TS) == pytest.approx(3.0, abs=0.3)  # a little noise is no signal


def test_what_is_constant_but_for_rounding_has_no_frequency():
    """A law that holds its input moves it by 1e-16: that is no fast motion."""
    still = 0.3 + 1e-16 * np.sign(np.random.default_rng(0).standard_normal(400))
    assert np.ptp(still) > 0 and frequency([still], 0.01) == 0.0
    assert frequency([0.3 + 1e-6 * np.sin(np.arange(400))], 0.01) > 0.0


def test_pieces_are_not_joined():
    jump = [sine(), 100 + sine()]
    assert rate(jump, TS) == rate(jump[:1], TS) and frequency(jump, TS) < 1.5
    assert seen({"u": jump}, TS)["ranges"]["u"] == pytest.approx([-1, 101])


def test_a_long_record_is_read_in_pieces():
    n = 300_000
    assert frequency([sine(hertz=5.0, n=n)], TS) == pytest.approx(5.0, abs=0.1)
    later = np.concatenate([sine(hertz=1.0, n=n), sine(hertz=20.0, n=n)])
    assert frequency([later], TS) == pytest.approx(20.0, abs=0.1)


# ---------------------------------------------------------------- warnings


def test_a_fit_keeps_what_it_has_seen(model):
    assert model.info.ranges["u"] == pytest.approx([-1, 1], abs=1e-3)
    assert model.info.rates["u"] == pytest.approx(2 * np.pi, rel=0.01)
    assert model.info.frequencies["u"] == pytest.approx(1.0, abs=0.3)
    assert set(model.info.rates) == set(model.info.frequencies) == {"u", "y"}


def test_the_line_through_the_data_and_the_band_around_it():
    source = sine(level=4.0)
    record = Record.from_arrays(source, 3 * source + 2 + 0.1 * np.sign(sine(hertz=7.0)), Ts=TS)
    model = ns.NARX.from_terms(["1", "u[k]"]).fit(record)
    assert model.info.line == pytest.approx([2.0, 3.0], abs=0.02)
    assert model.info.band == pytest.approx(0.1, abs=0.03)
    # Through zero where zero lies well inside both ranges, though the input lingers on one side.
    lingering = np.where(np.arange(1_000) < 900, 1.0, -1.0) * np.abs(sine())
    swing = Record.from_arrays(lingering, 3 * lingering + 0.3 * lingering**2, Ts=TS)
    assert ns.NARX.from_terms(["1", "u[k]"]).fit(swing).info.line[0] == 0.0


def test_within_what_was_seen_nothing_is_said(model):
    assert not said(model.simulate, sine(), 0.0)
    assert not said(model.simulate, sine(0.5, 0.8, n=300), 0.0)
    assert not said(model.simulate, np.full(300, 0.5), 0.0)
    assert not said(model.simulate, sine(1.0, 1.0, n=90), 0.0)  # too short to tell its frequency


@pytest.mark.parametrize(
    "source, words",
    (
        (sine(1.5, 0.5), ["the input leaves the identified inputs [-1, 1] by 0.5 [unit of u], 25 % of their range"]),
        (sine(0.2, 5.0), ["the input is faster: 99 % of its power lies below"]),
        (sine(0.9, 3.0), ["changes by up to 16.", "is faster"]),
        (np.where(np.arange(600) < 300, 0.0, 0.9), ["changes by up to 90 [unit of u]/s, in identification by up to 6.279 (14.3 times)", "is faster"]),
        (sine(2.0, 3.0), ["leaves the identified inputs", "changes by up to", "is faster"]),
    ),
)  # fmt: skip
def test_beyond_it_each_quantity_is_said_with_its_unit(model, source, words):
    found = said(model.simulate, source, 0.0)
    assert len(found) == len(words) and all(w in f for w, f in zip(words, found, strict=True)), found
    assert all(f.endswith(": this extrapolates") for f in found)


def test_by_how_much():
    info = Info(ranges={"u": (0.0, 2.0)}, rates={"u": 2.0}, frequencies={"u": 1.0})
    assert beyond(info, "u", "input", [np.array([0.0, 2.019])], None) == []  # one per cent is not worth a word
    assert "by 0.03 [unit of u], 1.5 % of" in beyond(info, "u", "input", [np.array([-0.03, 0.0])], None)[0]
    known = replace(info, units={"u": "V", "y": "mm"})
    assert "by 0.03 V, 1.5 % of" in beyond(known, "u", "input", [np.array([-0.03, 0.0])], None)[0]
    assert len(beyond(info, "u", "input", [np.array([0.0, 2.1])], 1.0)) == 1
    assert (
        "4 [unit of u]/s, in identification by up to 2 (2 times)"
        in beyond(info, "u", "input", [np.array([0.0, 1])], 0.25)[0]
    )
    quick = 1 + 0.9 * np.sin(2 * np.pi * 4.0 * 0.01 * np.arange(2_000))
    found = beyond(replace(info, rates={"u": 1e9}), "u", "input", [quick], 0.01)
    assert len(found) == 1 and "below 4." in found[0] and "Hz (4." in found[0] and found[0].endswith(" times)")
    assert beyond(Info(), "u", "input", [quick], 0.01) == []
    assert "times" not in beyond(Info(rates={"u": 0.0}), "u", "input", [quick], 0.01)[0]


def test_the_step_at_the_start_counts(model):
    assert not said(model.simulate, np.full(50, 0.5), 0.0)
    assert "changes by up to 50" in said(model.simulate, np.full(50, 0.5), 0.0, u0=0.0)[0]


def test_work_inside_says_nothing(model):
    record = model_of(sine(3.0))[1]
    assert not said(ns.evaluate, model, record) and not said(ns.free_run, model, record)
    assert extrapolates(model, [record.u])  # `compare` says it
    at_tenth = extrapolates(model, [record.u], 10 * model.Ts)  # per second of the record, not of the model
    assert extrapolates(model, [record.u]) != at_tenth


def test_a_law_says_it_of_its_reference(linear):
    law = linear.compensator()
    low, high = linear.info.ranges["y"]
    middle, size = (low + high) / 2, (high - low) / 2
    assert not said(law.run, sine(0.5 * size, 0.8, level=middle))
    far = said(law.run, sine(1.1 * size, 0.8, level=middle))
    assert any("the reference leaves the identified outputs" in f and "[unit of y], 5 % of" in f for f in far)
    quick = said(law.run, sine(0.15 * size, 5.0, level=middle))
    assert len(quick) == 1 and "the reference is faster" in quick[0]
    jump = np.where(np.arange(300) < 150, middle, middle + 0.2 * size)
    assert any("the reference changes by up to" in f and "[unit of y]/s" in f for f in said(law.run, jump))


# ---------------------------------------------------------------- files and the command


def test_it_is_in_the_model_file_and_files_without_it_load(model, tmp_path):
    path = tmp_path / "m.json"
    ns.save(model, path)
    assert ns.load(path).info.rates == model.info.rates
    assert said(ns.load(path).simulate, sine(2.0), 0.0) == said(model.simulate, sine(2.0), 0.0)
    data = json.loads(path.read_text())
    older = {**data, "info": {n: v for n, v in data["info"].items() if n not in ("rates", "frequencies")}}
    path.write_text(json.dumps(older))
    assert len(said(ns.load(path).simulate, sine(2.0, 5.0), 0.0)) == 1  # the range alone
    for name in ("rates", "frequencies"):
        for wrong in ([1], {"u": -1}, {"u": "fast"}, {"u": None}):
            path.write_text(json.dumps({**data, "info": {**data["info"], name: wrong}}))
            with pytest.raises(ModelError, match=f"info.{name}"):
                ns.load(path)


def test_the_commands_say_it_on_stderr(model, linear, tmp_path, run, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ns.save(model, "m.json")
    t = TS * np.arange(1_000)

    def write(name, **columns):
        rows = np.column_stack([t, *columns.values()])
        np.savetxt(name, rows, delimiter=",", header=",".join(["t", *columns]), comments="")

    wide = sine(2.0, 0.5)
    write("wide.csv", u=wide, y=ns.NARX.from_terms(TERMS, [1.0, 2.0, -0.3]).simulate(wide, 0.0))
    write("same.csv", u=sine(), y=sine(2.0))
    ns.save(linear, "linear.json")
    low, high = linear.info.ranges["y"]
    write("r.csv", r=(low + high) / 2 + 0.6 * (high - low) * sine(1.0, 0.8))
    code, out, err = run("simulate", "m.json", "wide.csv", "--input", "u", "--y0", "0", "--out", "s.csv")
    assert code == 0 and "leaves the identified inputs [-1, 1] by 1 [unit of u], 50 %" in err and "leaves" not in out
    code, _, err = run("compare", "m.json", "wide.csv", "same.csv", "--no-plot")
    assert code == 0 and "wide" in err and err.count("this extrapolates") == 1
    code, _, err = run("compensate", "linear.json", "--reference", "r.csv", "--out", "c.csv")
    assert code == 0 and "the reference leaves the identified outputs" in err
    code, _, err = run("simulate", "m.json", "same.csv", "--input", "u", "--y0", "0", "--out", "s.csv")
    assert code == 0 and err == ""


# ---------------------------------------------------------------- fits that do not converge


def test_a_fit_that_does_not_converge_says_so_and_keeps_the_best():
    source = sine(3.0, 1.0) + sine(1.0, 0.3)
    truth = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.9, 0.5, -0.02])
    out = truth.simulate(source, 0.0) + 0.05 * np.random.default_rng(0).standard_normal(source.size)
    record = Record.from_arrays(source, out, Ts=TS)
    start = [0.5, 0.1, 0.05]
    worst = ns.evaluate(ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], start), record).free_run_nrmse
    short = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], start)
    with pytest.warns(UserWarning, match="stopped before it converged.*best parameters found are kept") as caught:
        short = short.fit(record, method="free_run", max_steps=3)
    assert caught[0].filename == __file__
    assert short.info.converged is False and np.all(np.isfinite(short.theta))
    assert short.info.nrmse.free_run < worst
    whole = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], start)
    whole, silent = told(whole.fit, record, method="free_run")
    assert not silent and whole.info.converged is True
    assert whole.info.nrmse.free_run < short.info.nrmse.free_run


def test_auto_warns_where_it_keeps_an_unfinished_free_run():
    truth = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.9, 0.5])
    source = np.random.default_rng(1).standard_normal(500)
    out = truth.simulate(source, 0.0)
    record = Record.from_arrays(source, out + 0.5 * np.random.default_rng(2).standard_normal(500), Ts=TS)
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"])
    short, warned = told(model.fit, record, method="auto", max_steps=2)
    assert any("stopped before it converged" in w for w in warned)
    assert short.info.method == "free_run" and short.info.converged is False
    assert not said(fit, model, record, method="auto", max_steps=2, warn=False)
    whole, silent = told(model.fit, record, method="auto")
    assert not silent and whole.info.converged is True
