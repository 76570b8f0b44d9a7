"""Units of the numbers in a law: derived by dimension, beside hand derivations and a change of all units."""

import functools
import random
import re

import numpy as np
import pytest
import sympy as sp
from sampling import some

import narx_sym as ns
from narx_sym.codegen.registry import files
from narx_sym.codegen.units import (
    RAISED,
    Coefficients,
    by_unit,
    coefficient_units,
    coefficients_latex,
    numbers_told,
    units_told,
)
from narx_sym.engines.compile import compile
from narx_sym.inversion.solution import Root
from narx_sym.models.extend import extend, variants
from narx_sym.report.page import sections
from narx_sym.symbolic.recursion import Recursion, State

u, y, k, phi1, phi2 = ns.u, ns.y, ns.k, ns.phi1, ns.phi2
UNITS = {"u": "V", "y": "um", "temp": "degC"}
LINEAR = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=0.01)
known = functools.partial(ns.Model.replace, info=ns.models.info.Info(units={"u": "V", "y": "um"}))
CHANNELS = ["temp"]
ALL = [v for v in variants(LINEAR, CHANNELS) if v.id != "gravity"]  # the sine is of an angle in a unit of its own


def found(law, **options):
    """Return the rows of a table as a mapping from the unit to its numbers."""
    return {unit: numbers for numbers, unit in by_unit(law.coefficients(UNITS, **options))}


def with_effect(name, form="", where="", numbers=()):
    """Return the linear model with an effect; its other numbers are all different."""
    one = next(v for v in ALL if v.id == name and v.effect.form == form and v.where == (where or v.where))
    return numbered(extend(LINEAR, one).model, numbers)


def numbered(model, numbers=()):
    draw = random.Random(1)
    more = [draw.uniform(0.1, 0.9) for _ in model.symbols]
    return model.replace(theta=[*[0.8, 0.4, *numbers], *more][: len(model.symbols)])


# -- by hand -----------------------------------------------------------------------------------------------------------


def test_a_linear_law():
    """0.4 m[k] = r[k+1] - 0.8 r[k]: the gain is um/V, what stands beside r is V/um."""
    law = LINEAR.compensator()
    assert law.lines(numbers=True) == ["m[k] = 2.5*r[k+1] - 2.0*r[k]"]
    assert found(law) == {"V/um": "2, 2.5"}
    assert found(law, latex=True) == {"um/V": "0.4", "1": "0.8"}
    assert law.coefficients(UNITS) == (Coefficients(ns.symbolic.signals.m[k], "V", (2.0, 2.5), "V/um"),)


def test_a_linear_law_around_an_operating_point():
    law = LINEAR.replace(operating_point={u: 1.5, y: -7.0}).compensator()
    assert found(law) == {"V/um": "2, 2.5", "V": "5"}  # 1.5 + 2.5*7 - 2*7
    assert found(law, latex=True) == {"um/V": "0.4", "1": "0.8", "um": "0.6, 7"}  # 0.4*1.5


def test_a_law_with_products():
    """0.5 (m[k] - m[k-1]) = r[k+1] - r[k] - (0.25 sign phi u + 0.125 |phi| y + 2 |phi| phi) with numbers over 0.5."""
    terms = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]", "phi1[k-2]**2*y[k-1]"]
    law = ns.NARX.from_terms(terms, [1.0, 0.5, 0.15, 0.2, 0.35], Ts=0.01).compensator()
    assert found(law) == {"V/um": "2", "1/V": "0.3", "1/um": "0.4", "1/um/V": "0.7"}
    assert found(law, latex=True) == {"um/V": "0.5", "um/V²": "0.15", "1/V": "0.2", "1/V²": "0.35"}


def test_a_law_through_a_dead_zone():
    """v = u + 0.5 Max(-0.3, Min(0.3, u)): the core asks for v in V; both slopes are pure, where they meet is in V."""
    law = with_effect("dead_zone", where="input", numbers=(-0.5, 0.3)).compensator()
    assert law.lines(numbers=True)[0] == "v[k] = 2.5*r[k+1] - 2.0*r[k]"
    assert found(law) == {"V/um": "2, 2.5", "V": "0.15, 0.45", "1": "0.666667"}  # 0.3*0.5, 0.3*1.5, 1/1.5


def test_weights_of_plays_turn_the_unit_of_the_input_into_that_of_the_output():
    z, v = ns.symbolic.signals.signal("z"), ns.symbolic.signals.signal("v")
    p, w, c = sp.symbols("p w c", real=True)
    play = sp.Max(u[k] - sp.Float(0.25), sp.Min(u[k] + sp.Float(0.25), z[k - 1]))
    states = [State(z[k], play), State(v[k], p * u[k] + w * z[k])]
    model = ns.Model(v[k] + c * sp.Max(0, v[k] - 1.5), (p, w, c), [2.0, 0.5, 0.125], states=states)
    assert coefficient_units(model, UNITS) == {"p": "um/V", "w": "um/V", "c": "1"}
    rows = found(model.compensator())
    assert "0.25 in z[k]" in rows["V"].split(", ") and rows["um/V"] == "2.5" and "1.5" in rows["um"]


# -- by a change of units ----------------------------------------------------------------------------------------------

FACTORS = {"V": 3.0, "um": 0.7, "degC": 1.9, "s": 1.0, "1": 1.0}


def factor(unit):
    """Return by what numbers of a unit are multiplied: read from its text, which knows no pint."""
    above, *below = unit.split("/")
    found = 1.0
    for text, sign in (*((a, 1) for a in re.split("[·*]", above)), *((b, -1) for b in below)):
        name, power = re.fullmatch("([A-Za-z]+|1)(.*)", text).groups()
        found *= FACTORS[name] ** (sign * float(power.translate(RAISED) or 1))
    return found


def converted_law(model, recursion):
    """Return a law with every number converted by its unit, as far as it has one; None where two read alike."""
    made = []
    for left, right in recursion.updates:
        units = {}
        for one in numbers_told(model, recursion.updates, UNITS):
            for value in one.values if one.left == left else ():
                units.setdefault(value, set()).add(one.unit)
        numbers = {f for f in right.atoms(sp.Float) if abs(float(f)) in units}
        if any(len(units[abs(float(f))]) > 1 for f in numbers):
            return None
        scaled = {f: sp.Float(float(f) * factor(next(iter(units[abs(float(f))])))) for f in numbers}
        made.append((left, right.xreplace(scaled)))
    return Recursion(tuple(made), recursion.parameters)


@functools.cache
def runs(which):
    """Run a law, and the same law in other units; None where there is none, or its numbers cannot be told apart."""
    model = numbered(extend(LINEAR, ALL[which]).model)
    try:
        law = model.compensator()
    except ns.NotInvertible:
        return None
    recursion = law.recursion.subs(model.values)
    if any(len(root.args) > 5 for _, right in recursion.updates for root in right.atoms(Root)):
        return None  # which of several roots is taken, hangs on tolerances, and on limits of 1e9 that have no unit
    other = converted_law(model, recursion)
    if other is None:
        return None
    n = np.arange(60)
    given = {"r": 0.8 * np.sin(n / 4) + 0.3 * np.sin(n / 1.7), "temp": np.cos(n / 9), "t": 0.01 * n}
    scale = {"r": factor("um"), "temp": factor("degC"), "t": 1.0}
    got = []
    for one, by in ((recursion, dict.fromkeys(scale, 1.0)), (other, scale)):
        inputs = {str(b.label): given[str(b.label)] * by[str(b.label)] for b in one.inputs}
        start = {b: 0.0 for b in one.states}
        got.append(compile(one)(inputs, initial=start, on_divergence="nan")["m"])
    return got[0] * factor("V"), got[1]


@pytest.mark.parametrize("which", some(range(len(ALL)), every=20), ids=lambda i: f"{ALL[i].id}-{i}")
def test_a_law_in_other_units_asks_for_the_same_input(which):
    """Not by the algebra of units: the law runs with every number converted, on a converted reference."""
    made = runs(which)
    if made is None:
        pytest.skip("no law, several roots, or two of its numbers read alike")
    usual, other = made
    assert np.isfinite(usual).sum() > 5 and other == pytest.approx(usual, rel=1e-9, abs=1e-9, nan_ok=True)


# -- what does not follow ----------------------------------------------------------------------------------------------


def test_without_units_nothing_is_said():
    law = LINEAR.compensator()
    assert law.coefficients() == () and coefficients_latex(()) == "" and LINEAR.coefficient_units() == {}
    assert law.coefficients({"y": ""}) == () and units_told(LINEAR, LINEAR.recursion.updates) == []


def test_with_one_unit_only_what_follows_from_it_is_said():
    law = LINEAR.replace(operating_point={u: 1.5, y: -7.0}).compensator()
    assert by_unit(law.coefficients({"u": "V"}, latex=True)) == [("0.8", "1")]
    assert dict(by_unit(law.coefficients({"y": "um"}, latex=True))) == {"0.8": "1", "0.6, 7": "um"}
    assert by_unit(law.coefficients({"u": "V"})) == [("5", "V")]


def test_a_product_of_two_unknowns_has_no_unit_and_its_neighbours_have():
    a, b, c = sp.symbols("a b c", real=True)
    model = ns.Model(c * y[k - 1] + a * sp.exp(b * u[k - 1]) * a, (a, b, c), [1.0, 1.0, 0.5])
    assert coefficient_units(model, UNITS) == {"a": "um⁰⋅⁵", "b": "1/V", "c": "1"}
    model = ns.Model(c * y[k - 1] + a * b * u[k - 1], (a, b, c), [1.5, 1.0, 0.5])
    assert coefficient_units(model, UNITS) == {"a": "", "b": "", "c": "1"}


def test_a_parameter_is_no_signal_of_its_name():
    names = sp.symbols("m r t v", real=True)
    terms = (y[k - 1], u[k - 1], phi1[k - 1] ** 2, sp.S.One)
    model = ns.Model(sum(a * b for a, b in zip(names, terms, strict=True)), names, [0.5, 0.25, 0.125, 3.0])
    assert list(coefficient_units(model, UNITS).values()) == ["1", "um/V", "um/V²", "um"]


def test_an_exponent_and_a_wrong_argument_are_no_error():
    model = ns.NARX([y[k - 1], sp.exp(u[k - 1]), sp.tanh(3 * y[k - 1])])
    assert list(coefficient_units(model, UNITS).values()) == ["1", "um", "um"]
    a, b = sp.symbols("a b", real=True)
    model = ns.Model(y[k - 1] + a * sp.Abs(u[k - 1]) ** b, (a, b), [1.0, 0.5])
    assert coefficient_units(model, UNITS) == {"a": "", "b": "1"}


def test_an_equation_that_contradicts_itself_says_nothing():
    """V and um are added up: what stands beside them has no unit, in whatever order they stand."""
    a, b = sp.symbols("a b", real=True)
    for of in (sp.Max(u[k - 1], y[k - 1]), u[k - 1] + y[k - 1] + y[k - 2]):
        model = ns.Model(b * y[k - 1] + a * of**2, (a, b), [1.0, 0.5])
        assert coefficient_units(model, UNITS) == {"a": "", "b": "1"}


def test_a_number_with_two_units_is_told_with_its_equation():
    m, v = ns.symbolic.signals.m, ns.symbolic.signals.v
    told = (Coefficients(v[k], "um", (2.0, 3.0), "um"), Coefficients(m[k], "V", (2.0, 1e-7), "V"))
    assert by_unit(told) == [("2 in v[k], 3", "um"), ("1e-07, 2 in m[k]", "V")]
    assert r"2.0" not in coefficients_latex(told) and r"2 \text{ in } m_{k}" in coefficients_latex(told)
    assert r"1 \times 10^{-7}" in coefficients_latex(told)


# -- where it is told --------------------------------------------------------------------------------------------------


def test_the_command_tells_them_and_the_latex_has_them(run, tmp_path):
    known(LINEAR).save(tmp_path / "m.json")
    code, text, err = run("compensate", tmp_path / "m.json", "--latex", tmp_path / "law.tex")
    assert code == 0 and re.search(r"2, 2\.5 .*V/um", text), err
    assert r"0.4 & \mathrm{um/V} \\" in (tmp_path / "law.tex").read_text()
    code, text, err = run("derive", tmp_path / "m.json")
    assert code == 0 and "theta_2 = 0.4 um/V\n" in text and "theta_1 = 0.8\n" in text, err
    LINEAR.save(tmp_path / "m.json")
    code, text, err = run("compensate", tmp_path / "m.json", "--latex", tmp_path / "law.tex")
    assert code == 0 and "coefficients" not in text and "array" not in (tmp_path / "law.tex").read_text(), err
    code, text, err = run("derive", tmp_path / "m.json")
    assert code == 0 and "theta_2 = 0.4\n" in text, err
    code, text, err = run("compensate", tmp_path / "m.json", "--units", "A,mm")
    assert code == 0 and re.search(r"2, 2\.5 .*A/mm", text), err


@pytest.mark.parametrize("to", sorted(set(files().values()) - {"fmu", "fmu2"}))
def test_sources_have_them_in_their_comment_and_nothing_else_changes(to):
    law = LINEAR.compensator()
    bare, told = law.export(to), law.export(to, units=UNITS)
    said = "0.8 (pure)" if to == "js" else "2, 2.5 in V/um"
    if to == "js":
        said = "theta_1 (pure); theta_2 in um/V"
    assert "Units" not in bare and f"Units of the coefficients: {said}." in told
    assert re.sub(r"(?m)^.*Units[^\n]*\n", "", told) == bare
    assert "Units of the coefficients" in LINEAR.export(to, units=UNITS) and "Units" not in LINEAR.export(to)


def test_the_report_has_them_in_the_digits_of_its_equation():
    steps, noise = np.random.default_rng(3).standard_normal((2, 300))
    moved = np.cumsum(steps) / 10
    record = ns.Record.from_arrays(moved, LINEAR.simulate(moved, 0.0) + 0.01 * noise, Ts=0.01)
    some = ns.effects.Catalogue({"dead_zone": ns.EFFECTS["dead_zone"]})
    found = ns.diagnose(LINEAR, record, catalogue=some, channels=[])
    bare, told = (sections(found, units=units, keys=["derived"])[0].html for units in ({}, {"u": "V", "y": "um"}))
    rows = dict(re.findall(r"<td[^>]*>([\d.]+)</td><td[^>]*>([^<]+)</td>", told))
    assert "coefficients of the law" not in bare and sorted(rows.values()) == ["1", "um/V"]
    assert all(f"<mn>{number}</mn>" in bare for number in rows)


def test_powers_are_readable_in_ascii():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "phi1[k-2]**2*y[k-1]"], [0.5, 0.25, 0.375], Ts=0.01)
    assert "0.375 in 1/V^2" in model.export("c", units=UNITS)
