"""Units: what a file says goes with the record, what two records differ by is converted, parameters follow by dimension."""

import io
import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest
import sympy as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st
from places import ROOT
from test_logs import mdf, tdms

import narx_sym as ns
from narx_sym.cli.options import unit_names
from narx_sym.codegen.units import coefficient_units
from narx_sym.data.units import converted, in_header, in_units, shown, unit
from narx_sym.errors import DataError
from narx_sym.files.atomic import write_csv
from narx_sym.models.extend import extend, variants
from narx_sym.report import parameters
from narx_sym.report.page import sections
from narx_sym.symbolic.functions import TABLE, X

u, y, k, phi1, phi2 = ns.u, ns.y, ns.k, ns.phi1, ns.phi2
UNITS = {"u": "V", "y": "um"}
CATALOGUE = ns.effects.Catalogue({"dead_zone": ns.EFFECTS["dead_zone"]})


def csv(path, head="t,u [V],y (um)"):
    t = np.arange(1000) * 0.001
    np.savetxt(path, np.column_stack([t, np.sin(9 * t), np.cos(9 * t) / 2]), delimiter=",", header=head, comments="")
    return path


# -- from a file to the report ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "name"),
    (
        pytest.param(mdf, "a.mf4", id="mdf"),
        pytest.param(tdms, "a.tdms", id="tdms", marks=pytest.mark.long),
        pytest.param(csv, "a.csv", id="csv", marks=pytest.mark.long),
    ),
)
def test_units_in_a_file_reach_the_report(kind, name, tmp_path):
    columns = {} if kind is csv else {"u": "Voltage", "y": "Position", "channels": ["Temp C"]}
    record = ns.read(kind(tmp_path / name), **columns)
    assert record.units == (UNITS if kind is csv else UNITS | {"Temp_C": "degC"})
    assert all(part.units == record.units for part in (*record.split(0.5), record[3:90], record.smoothed(0.02)))
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(record)
    assert {n: model.info.units[n] for n in UNITS} == UNITS
    model.save(tmp_path / "m.json")
    assert ns.load(tmp_path / "m.json").info.units == model.info.units
    found = ns.diagnose(model, record, catalogue=CATALOGUE, channels=[])
    html = {s.key: s.html for s in sections(found, keys=["model", "verdict"])}
    assert "um/V" in html["model"] and " um" in html["verdict"]
    assert "um" in found.sentence() and "mm" in found.sentence({"y": "mm"})


def test_what_the_user_says_wins(tmp_path):
    record = ns.read(csv(tmp_path / "a.csv"), units={"u": "A"})
    assert record.units == {"u": "A", "y": "um"}
    with pytest.raises(ns.DataError, match="units of 'q', which is no signal"):
        ns.read(tmp_path / "a.csv", units={"q": "A"})


def test_a_column_is_found_without_its_unit_unless_two_have_its_name(tmp_path):
    path = csv(tmp_path / "a.csv", "t [ms],u [V],u [A]")
    with pytest.raises(ns.DataError, match="no column 'u'"):
        ns.read(path, y="u [A]")
    record = ns.read(path, u="u [V]", y="u [A]")
    assert record.units == {"u": "V", "y": "A"} and record.Ts == pytest.approx(1e-6)
    assert any("converted from ms to s" in n for n in record.notes)
    with pytest.raises(ns.DataError, match="time column 't \\[mm\\]' is in mm, not in s; give --ts"):
        ns.read(csv(tmp_path / "b.csv", "t [mm],u,y"))


def test_pint_is_loaded_only_where_units_are_computed(tmp_path):
    path = str(csv(tmp_path / "a.csv", "t,u [V],y [um]"))
    code = f"import sys; from narx_sym.cli import main; import narx_sym as ns; ns.read({path!r}); print('pint' in sys.modules)"
    made = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert made.stdout.strip() == "False", made.stderr


@pytest.mark.parametrize(("text", "name", "label"), [
    ("u [V]", "u", "V"), ("y (um)", "y", "um"), ("F [N/(m s)]", "F", "N/(m s)"), ("temp(%)", "temp", "%"), ("x [inc]", "x", "inc"),
    ("y (filtered)", "y (filtered)", ""), ("y[1]", "y[1]", ""), ("u", "u", ""), ("[V]", "[V]", ""),
])  # fmt: skip
def test_names_of_columns(text, name, label):
    assert in_header(text) == (name, label)


# -- labels ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("own", "wanted", "factor"), [
    ("mm", "um", 1000.0), ("mV", "V", 1e-3), ("m3/h", "l/min", 1000 / 60), ("deg", "rad", np.pi / 180), ("inc", "inc", 1.0),
    ("rpm", "rad/s", np.pi / 30), ("V", "A", None), ("counts", "rad", None), ("%", "1", None), ("inc", "mm", None),
])  # fmt: skip
def test_what_converts(own, wanted, factor):
    found = converted(np.array([2.0]), own, wanted)
    assert found is None if factor is None else found == pytest.approx([2 * factor])


def test_degrees_have_an_offset():
    assert converted(20.0, "degC", "K") == pytest.approx(293.15)


@settings(max_examples=40, deadline=None)
@given(st.text(min_size=1, max_size=60))
@example("1")
@example("A1")
@example("A2")
def test_any_label_is_a_unit_and_is_printed_as_it_is_written(label):
    assert shown(unit(label), [label]) in (label, "1") or label != label.strip()
    assert shown(unit(label) / unit(label), [label]) == "1"


@pytest.mark.parametrize("label", ("9**9**9**9", "m**9**9**9**9", "m9999999", "(" * 40 + "m"))
def test_no_label_is_computed(label):
    assert str(unit(label)).startswith("own_")


# -- records ---------------------------------------------------------------------------------------------------------


def record(units, scale=1.0, name="record"):
    rng = np.random.default_rng(3)
    moved = np.cumsum(rng.standard_normal(300)) / 10
    out = np.zeros(300)
    for i in range(1, 300):
        out[i] = 0.8 * out[i - 1] + 0.4 * moved[i - 1]
    return ns.Record.from_arrays(moved, out * scale, Ts=0.01, units=units, name=name)


def test_a_record_in_other_units_is_converted_and_it_is_said():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(record(UNITS))
    other = record({"u": "V", "y": "mm"}, 1e-3)
    assert ns.evaluate(model, other).free_run_nrmse < 1e-9 and model.fit(other).theta == pytest.approx([0.8, 0.4])
    assert model.predict(other) == pytest.approx(record(UNITS).y)
    (same,) = in_units([other], model.info.units)
    assert same.notes == ("y is converted from mm to um",) and same.units == UNITS
    assert in_units([record({})], model.info.units)[0].units == {}  # nothing is known, nothing is done
    both = ns.identify([record(UNITS), other], base="linear")
    assert both.info.units == UNITS and both.info.nrmse.free_run < 1e-6


def test_a_record_of_another_dimension_is_refused_in_one_sentence(tmp_path, run):
    def write(name, head):
        r = record({})
        return (
            np.savetxt(tmp_path / name, np.column_stack([r.t, r.u, r.y]), delimiter=",", header=head, comments="")
            or tmp_path / name
        )

    volts, amperes, milli = (
        write("v.csv", "t,u [V],y [um]"),
        write("a.csv", "t,u [A],y [um]"),
        write("m.csv", "t,u [mV],y [um]"),
    )
    out = tmp_path / "m.json"
    code, text, err = run("fit", volts, "--base", "linear", "--delay", "1", "--out", out)
    assert code == 0 and "um/V" in text, err
    for command in (["compare", out, amperes, "--no-plot"], ["diagnose", amperes, "--base", out],
                    ["add", out, "dead_zone", amperes, "--out", tmp_path / "x.json"]):  # fmt: skip
        code, _, err = run(*command)
        assert code == 2 and err.count("\n") == 1, err
        assert "is in A -> um, but the model was identified in V -> um" in err and "give a record in V, or say" in err
    code, text, err = run("compare", out, milli, "--no-plot")
    assert code == 0 and "u is converted from mV to V" in err
    run.good("compare", out, amperes, "--no-plot", "--units", "V,")  # the user says what it really is in
    code, text, _ = run("compensate", out)
    assert code == 0 and "with m in V, r in um" in text
    code, _, err = run("fit", volts, amperes, "--base", "linear", "--out", out)
    assert code == 2 and "the record before it was measured in V -> um" in err


def test_law_and_fmu_have_the_units_of_the_model(tmp_path, run):
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).fit(record(UNITS))
    model.save(tmp_path / "m.json")
    for made, units in ((model, {"u": "V", "y": "um"}), (model.compensator(), {"m": "V", "r": "um"})):
        found = ET.fromstring(zipfile.ZipFile(io.BytesIO(made.export("fmu"))).read("modelDescription.xml"))
        assert {v.get("name"): v.get("unit") for v in found.iter("Float64") if v.get("name") in units} == units
    wanted = (1 + 0.2 * np.sin(np.arange(100) / 10)) / 1000  # [mm]
    for head, values in (("t,r", 1000 * wanted), ("t,r [mm]", wanted)):
        table = np.column_stack([np.arange(100) * 0.01, values])
        np.savetxt(tmp_path / "r.csv", table, delimiter=",", header=head, comments="")
        out = tmp_path / f"{len(head)}.csv"
        code, _, err = run("compensate", tmp_path / "m.json", "--reference", tmp_path / "r.csv", "--out", out)
        assert code == 0 and ("'r [mm]' is converted from mm to um" in err) == ("mm" in head), err
    first, second = (ns.read(tmp_path / f"{n}.csv", u="m", y="r") for n in (3, 8))
    assert second.u == pytest.approx(first.u) and second.y == pytest.approx(first.y)
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header="t,r [A]", comments="")
    code, _, err = run("compensate", tmp_path / "m.json", "--reference", tmp_path / "r.csv", "--out", out)
    assert code == 2 and err.count("\n") == 1 and "is in A, which does not convert to um, the model's" in err


@pytest.mark.parametrize("units", ({"u": 3}, {"u": ""}, {"u": "V" * 200}, {"u": "a\nb"}, ["V"], "V"))
def test_a_model_file_with_other_units_than_texts_is_refused(units, tmp_path):
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.9, 0.1])
    model.save(tmp_path / "m.json")
    plain = json.loads((tmp_path / "m.json").read_text())
    assert "units" not in plain["info"] and ns.load(tmp_path / "m.json").info.units == {}
    (tmp_path / "m.json").write_text(json.dumps(plain | {"info": {"units": units}}))
    with pytest.raises(ns.ModelError, match=r"'info\.units.* must be"):
        ns.load(tmp_path / "m.json")


# -- parameters ------------------------------------------------------------------------------------------------------


def test_parameters_follow_by_dimension():
    terms = {
        y[k - 1]: "1", u[k - 1]: "um/V", phi1[k]: "um/V", phi2[k] * phi1[k] * u[k]: "um/V²", phi1[k] * y[k - 1]: "1/V",
        sp.S.One: "um", sp.sign(u[k]): "um", abs(u[k]) * u[k]: "um/V²", y[k - 1] ** 2: "1/um", y[k - 1] ** 3: "1/um²",
        ns.symbolic.signals.signal("w")[k] * u[k]: "um/degC/V",
    }  # fmt: skip
    model = ns.NARX(list(terms))
    found = coefficient_units(model, UNITS | {"w": "degC"})
    assert [found[str(s)] for s in model.symbols] == list(terms.values())
    bare = coefficient_units(model, {"u": "V"})
    assert bare["theta_1"] == "1" and bare["theta_2"] == "" and bare["theta_5"] == "1/V" and bare["theta_11"] == ""


@pytest.mark.parametrize("row", [r for r in TABLE if not r.extreme], ids=lambda r: r.name)
def test_every_elementary_function_has_its_rule(row):
    model = ns.NARX([row.cls(u[k])]) if row.name != "sqrt" else ns.NARX([sp.sqrt(u[k])])
    (found,) = coefficient_units(model, UNITS).values()
    assert found == {"kept": "um/V", "none": "um", "sign": "um", "root": "um/V⁰⋅⁵"}[row.dimension]
    assert X not in model.F.free_symbols


def test_a_name_that_means_another_term_in_each_model_has_the_unit_of_its_own():
    before, after = (ns.NARX.from_terms(["y[k-1]", term], [0.9, 0.1]) for term in ("1", "u[k-1]"))
    rows = {r.term: r for r in parameters.parameters(before, after, UNITS, {})}
    assert rows["1"].name == "theta_2 of the base" and rows["u[k-1]"].name == "theta_2"
    assert (rows["1"].status, rows["1"].unit, rows["u[k-1]"].unit) == ("deleted", "um", "um/V")


def added(effect, form="", where=""):
    base = ns.NARX([y[k - 1], u[k - 1]], [0.9, 0.1], Ts=0.01)
    one = next(
        v
        for v in variants(base, ["temp"])
        if v.id == effect and v.effect.form == form and v.where in (where or v.where)
    )
    model = extend(base, one).model
    (effect,) = model.effects
    units = UNITS | {"temp": "degC"}
    shapes = {str(s): parameters.shape_unit(one.effect.unit.get(n, ""), effect, units) for n, s in effect.shape.items()}
    found = coefficient_units(model, units, shapes)
    return {own: found[str(s)] for own, s in effect.symbols.items() if str(s) in found}


@pytest.mark.parametrize(("effect", "form", "where", "units"), [
    ("hysteresis", "Bouc-Wen", "output", {"c": "um/V", "b": "1/V"}), ("hysteresis", "Bouc-Wen actuator", "inside", {"c1": "um/V", "d": "um/V"}),
    ("coulomb_friction", "", "inside", {"c": "um"}), ("coulomb_friction", "Dahl", "output", {"c": "um", "r": "V"}),
    ("coulomb_friction", "smooth", "output", {"c": "um", "s": "V per sample"}), ("stiction", "of a valve", "input", {"r": "V", "e": "V"}),
    ("dead_zone", "behind a lag", "input", {"c": "1", "r": "V", "tau": "s"}), ("creep", "", "output", {"c": "1", "tau": "s"}),
    ("drift", "bent", "output", {"c1": "um/s", "c2": "um/s²"}), ("channel:temp", "", "output", {"c": "um/degC"}),
])  # fmt: skip
def test_effects_have_the_units_of_what_they_read(effect, form, where, units):
    found = added(effect, form, where)
    assert {n: found[n] for n in units} == units


@pytest.mark.parametrize(
    ("text", "units"),
    (
        ("", {}), ("V,um", {"u": "V", "y": "um"}), (",um", {"y": "um"}), ("V", {"u": "V"}),
        ("V,um,temp=degC", {"u": "V", "y": "um", "temp": "degC"}), ("y=mm,u=V", {"u": "V", "y": "mm"}),
    ),
)  # fmt: skip
def test_units_on_the_command_line(text, units):
    assert unit_names(text) == units


def test_a_third_unit_needs_a_name():
    with pytest.raises(DataError, match="then those of channels as temp=degC"):
        unit_names("V,um,degC")


def test_units_of_a_channel_reach_the_model(run, tmp_path):
    rng = np.random.default_rng(0)
    u, temp = rng.standard_normal((2, 200))
    y = np.concatenate([[0], 0.5 * u[:-1] + 0.1 * temp[:-1]])
    write_csv(tmp_path / "a.csv", {"t": np.arange(200) * 0.1, "u": u, "y": y, "temp": temp})
    out = tmp_path / "m.json"
    given = ("fit", tmp_path / "a.csv", "--out", out, "--base", "linear", "--channels")
    run.good(*given, "temp", "--units", "V,um,temp=degC")
    assert ns.load(out).info.units == {"u": "V", "y": "um", "temp": "degC"}
    code, _, err = run(*given, "", "--units", "V,um,temp=degC")
    assert code == 2 and "units of 'temp', which is no signal" in err
