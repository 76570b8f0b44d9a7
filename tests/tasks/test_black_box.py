"""An FMU as a black base: its run, what is missing at its input or output, and what it refuses."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from typer.testing import CliRunner

import narx_sym as ns
from narx_sym.cli.main import app
from narx_sym.errors import ModelError
from narx_sym.files.atomic import write_csv

pytest.importorskip("fmpy", reason="the extra fmu is not installed here")
if shutil.which("cc") is None:
    pytest.skip("no C compiler here", allow_module_level=True)

N, TS = 700, 0.02
RNG = np.random.default_rng(11)
U = np.repeat(RNG.uniform(-1, 1, N // 10), 10)
NOISE = RNG.standard_normal(N)
PLANT = ns.from_equations("y[k] = 1.6*y[k-1] - 0.68*y[k-2] - 0.004*y[k-1]**3 + b*u[k-1]\nb ~ 0.08", TS)


def plant(u):
    """The plant along an input, from rest at zero."""
    y = [0.0, 0.08 * u[0]]
    for before in u[1:-1]:
        y.append(1.6 * y[-1] - 0.68 * y[-2] - 0.004 * y[-1] ** 3 + 0.08 * before)
    return np.array(y)


def play(x, r):
    out, w = np.empty(x.size), x[0]
    for i, value in enumerate(x):
        out[i] = w = min(max(w, value - r), value + r)
    return out


def measured(y):
    return ns.Record.from_arrays(U, y + 0.01 * y.std() * NOISE, TS)


def put(folder, model, to="fmu"):
    path = folder / "plant.fmu"
    path.write_bytes(model.export(to, name="plant"))
    return path


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return ns.from_fmu(put(tmp_path_factory.mktemp("fmu"), PLANT))


@pytest.mark.parametrize("to", ["fmu", "fmu2"])
def test_it_runs_along_each_part_of_a_record_and_is_compared_with_it(to, tmp_path):
    box = ns.from_fmu(put(tmp_path, PLANT, to))
    record = box.beside(measured(plant(U)))
    assert record.channels["fmu"] == pytest.approx(plant(U), abs=1e-9)
    assert ns.evaluate(box.model(), record).free_run_nrmse == pytest.approx(0.01, rel=0.1)
    broken = box.beside(replace(measured(plant(U)), breaks=(200,)))
    assert broken.channels["fmu"][200:] == pytest.approx(box.run(U[200:], TS))  # it starts anew


def test_its_base_is_its_own_run_whatever_the_linear_model_is(box):
    record = box.beside(measured(plant(U)))
    base = box.model([record])
    assert {s.base.name for s in base.F.atoms(sp.Indexed)} == {"fmu", "fmu_input", "u", "y"}
    run = ns.free_run(base, replace(record, y=record.channels["fmu"]))
    assert run == pytest.approx(record.channels["fmu"], abs=1e-6)


def test_an_effect_at_its_input_is_named_and_tried_with_the_fmu_itself(box):
    record = box.beside(measured(plant(np.clip(U, -0.5, 0.5))))
    found = ns.diagnose(box.model([record]), record)
    assert found.confusion_set == ["saturation"] and found.model.effects[0].where == "input"
    assert found.ladder[0]["train"] > 0.3
    assert box.again(found, [record]) < 0.02


def test_an_effect_at_its_output_is_named_and_needs_no_other_run(box):
    record = box.beside(measured(play(plant(U), 0.1)))
    found = ns.diagnose(box.model([record]), record)
    assert found.confusion_set == ["backlash"] and found.model.effects[0].where == "output"
    assert box.again(found, [record]) is None


def test_nothing_is_named_where_it_is_the_machine(box):
    record = box.beside(measured(plant(U)))
    assert ns.diagnose(box.model([record]), record).verdict == "nothing_detectable"


def test_only_the_output_is_diagnosed_where_no_linear_model_follows(tmp_path):
    bent = ns.from_equations("y[k] = a*y[k-1] + 0.4*abs(u[k-1])\na ~ 0.6", TS)
    box = ns.from_fmu(put(tmp_path, bent))
    base = box.model([box.beside(measured(plant(U)))])
    assert {s.base.name for s in base.F.atoms(sp.Indexed)} == {"fmu"}


def test_what_is_no_such_fmu_is_refused(box, tmp_path, monkeypatch):
    (tmp_path / "text.fmu").write_text("no archive")
    with pytest.raises(ModelError, match=r"text.fmu: this cannot be read as an FMU"):
        ns.from_fmu(tmp_path / "text.fmu")
    two = ns.from_equations("load = channel\ny[k] = a*y[k-1] + u[k-1] + load[k-1]\na ~ 0.6", TS)
    path = put(tmp_path, two)
    with pytest.raises(ModelError, match=r"which input is meant\? It has load, u"):
        ns.from_fmu(path)
    assert ns.from_fmu(path, u="load").u == "load"
    path.write_bytes(PLANT.export("fmu", name="plant"))
    with pytest.raises(ModelError, match="does not run along the record"):
        ns.from_fmu(path).run(U, 0.7 * TS)  # its step is a multiple of its sampling time
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(ModelError, match=r"narx-sym\[fmu\]"):
        ns.from_fmu(path)


def test_the_commands_take_it(box, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    y = measured(plant(np.clip(U, -0.5, 0.5))).y
    write_csv("record.csv", {"t": TS * np.arange(N), "volts": U, "way": y})
    names = ["record.csv", "--input", "volts", "--output", "way"]
    done = CliRunner().invoke(app, ["compare", str(box.path), *names, "--no-plot", "--json", "errors.json"])
    assert done.exit_code == 0, done.output
    found = json.loads(Path("errors.json").read_text())["errors"][0]["free_run_nrmse"]
    assert found == pytest.approx(np.std(y - plant(np.array(U))) / np.std(y), rel=0.05)
    done = CliRunner().invoke(app, ["diagnose", *names, "--base", str(box.path), "--quiet"])
    assert done.exit_code == 0 and "aturation" in done.output, done.output
    done = CliRunner().invoke(app, ["diagnose", *names, "--base", str(box.path), "--save", "model.json"])
    assert done.exit_code and "--save needs a base that is an equation" in str(done.exception)
