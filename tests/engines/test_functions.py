"""One row per elementary function: every engine and every language computes what SymPy says."""

import json
import math
import shutil
import subprocess
from dataclasses import MISSING, fields

import numpy as np
import pytest
import sympy as sp
from iec import Block
from sampling import some

from narx_sym.codegen.export import written
from narx_sym.engines.columns import Columns
from narx_sym.engines.compile import ENGINES, compile
from narx_sym.inversion.solve import solve_for
from narx_sym.models.pool import pool
from narx_sym.symbolic.functions import NAMES, TABLE, Elementary, X, Y, arguments_of, row_of
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.printing import latex, text
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.sensitivity import derivative
from narx_sym.symbolic.signals import k, samples, signal, u, y

W = signal("w")
ROWS = pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
# Both signs where a function has values; within (-1, 1), where all but those of positive numbers have one.
POINTS = {"sqrt": (0.0, 1e-12, 0.3, 2.0, 1e6), "log": (1e-12, 0.3, 1.0, 2.0, 1e6)}
USUAL = (-0.95, -0.4, -1e-9, 1e-9, 0.2, 0.7)
SECOND = (0.3, -0.7, -3e-9, 1e-8, -0.2, 0.6)


def node(row):
    """An expression with the function in it, of one or three arguments."""
    return row.cls(u[k], W[k], u[k] + W[k]) if row.extreme else row.cls(u[k])


def given(row):
    first = np.array(POINTS.get(row.name, USUAL))
    return {"u": first} | ({"w": np.array(SECOND)} if row.extreme else {})


def exact(expr, values):
    """Evaluate with 40 digits at each point."""
    rows = [dict(zip(values, map(sp.Float, row), strict=True)) for row in zip(*values.values(), strict=True)]
    found = []
    for row in rows:
        exactly = {s: sp.Rational(float(row[str(s.base.label)])) for s in samples(expr)}
        found.append(float(expr.xreplace(exactly).evalf(40)))
    return np.array(found)


def close(found, expected):
    np.testing.assert_allclose(np.asarray(found, dtype=float), expected, rtol=1e-12, atol=1e-300)


def test_a_row_without_a_column_is_refused():
    whole = {f.name: getattr(NAMES["sign"], f.name) for f in fields(Elementary)}
    needed = [f.name for f in fields(Elementary) if f.default is MISSING]
    assert {"name", "cls", "native", "numpy", "python", "c", "st", "casadi", "javascript", "dimension", "sides",
            "inverse", "everywhere"} == set(needed)  # fmt: skip
    for name in needed:
        with pytest.raises(TypeError, match=name):
            Elementary(**{n: v for n, v in whole.items() if n != name})
    assert len(NAMES) == sum(1 + len(row.also) for row in TABLE)


@ROWS
def test_every_engine_computes_it(row):
    expr = node(row)
    recursion, inputs = Recursion(((y[k], 2 * expr),)), given(row)
    for engine in ENGINES:
        close(compile(recursion, engine)(inputs)["y"] / 2, exact(expr, inputs))
    close(Columns([u[k] * expr])(inputs)[:, 0], inputs["u"] * exact(expr, inputs))


@ROWS
def test_every_engine_keeps_what_is_not_a_number(row):
    if row.dimension == "sign" and row.sides[0] == 0:
        return  # a step is 0 or 1 of anything
    expr, inputs = node(row), {name: x.copy() for name, x in given(row).items()}
    for name in inputs:
        broken = inputs | {name: np.where(np.arange(inputs[name].size) == 2, np.nan, inputs[name])}
        for engine in ENGINES:
            found = compile(Recursion(((y[k], expr),)), engine)(broken, on_divergence="nan")["y"]
            assert np.isnan(found[2]) and np.isfinite(found[:2]).all(), engine


@ROWS
def test_the_grammar_reads_what_the_printer_writes(row):
    expr = node(row)
    assert row_of(expr) is row and len(arguments_of(expr)) == (3 if row.extreme else 1)
    assert parse(text(expr), signals=["w"]) == expr and latex(expr)
    for name in (row.name, *row.also):
        assert parse(f"{name}(u[k-1]{', y[k-1]' if row.extreme else ''})").func == row.cls(u[k], y[k]).func \
            if row.extreme else row_of(parse(f"{name}(u[k-1])")) is row  # fmt: skip


@ROWS
def test_its_derivative_is_in_the_table_too(row):
    expr = node(row)
    slope = derivative(expr, u[k])
    assert all(row_of(f) for f in slope.atoms(sp.Function)) and not slope.has(sp.Derivative, sp.DiracDelta)
    inputs, step = given(row), 1e-6
    at = {name: x[np.abs(x) > 10 * step] for name, x in inputs.items()}
    if len(set(map(len, at.values()))) > 1:
        at = {name: x[[0, 1, 4]] for name, x in inputs.items()}
    sides = [exact(expr, at | {"u": at["u"] + s * step * np.maximum(1, at["u"])}) for s in (1, -1)]
    rough = (sides[0] - sides[1]) / (2 * step * np.maximum(1, at["u"]))
    found = compile(Recursion(((y[k], slope + 0 * u[k]),)))(at | ({} if samples(slope) else {"u": at["u"]}))["y"]
    np.testing.assert_allclose(found, rough, rtol=1e-5, atol=1e-6)
    if row.sides:
        for side, of in zip(row.sides, (-0.3, 0.7), strict=True):
            assert float(side.xreplace({X: sp.Float(of)})) == exact(expr, {"u": [of]})[0]
            there = slope.xreplace({u[k]: sp.Float(of)})
            assert float(there) == float(sp.diff(side, X).xreplace({X: sp.Float(of)}))


@ROWS
def test_its_inverse_and_its_values(row):
    if row.inverse is None:
        return
    low, high = (float(v) for v in row.values)
    points = np.array(POINTS.get(row.name, USUAL))
    levels = exact(node(row), {"u": points})
    assert (low < levels).all() and (levels < high).all() and (np.diff(levels) > 0).all()
    back = [float(row.inverse.xreplace({X: sp.Float(v, 40)})) for v in levels]
    np.testing.assert_allclose(back, points, rtol=1e-9, atol=1e-15)  # the levels are doubles
    found = solve_for(3 * row.cls(u[k] / 2), u[k], y[k], u[k - 1], {sp.Symbol("unused"): 1.0})
    assert found.how == "inverse function" and math.isclose(
        float(found.value.xreplace({y[k]: 3 * sp.Float(levels[-1], 40)})), 2 * points[-1], rel_tol=1e-9
    )


@ROWS
def test_what_it_makes_of_a_unit(row):
    """In other units, a power of 4 smaller, the values scale as the row says."""
    expr, inputs = node(row), given(row)
    scaled = {name: x / 4 for name, x in inputs.items()}
    before, after = exact(expr, inputs), exact(expr, scaled)
    kept = {"kept": before / 4, "sign": before, "root": before / 2}
    ways = {name: bool(np.allclose(after, x, rtol=1e-12, atol=0)) for name, x in kept.items()}
    assert ways == dict.fromkeys(kept, False) | ({row.dimension: True} if row.dimension != "none" else {})


@ROWS
def test_a_pool_takes_what_has_a_value_everywhere(row):
    wide = np.array([-1e3, -1.5, 0.0, 1.5, 1e3])
    if row.extreme:
        return
    with np.errstate(all="ignore"):
        values = compile(Recursion(((y[k], row.cls(u[k])),)))({"u": wide}, on_divergence="nan")["y"]
    if not row.everywhere:
        assert not np.isfinite(values).all()
        with pytest.raises(Exception, match="Unknown function"):
            pool(1, 1, 1, functions=[row.name])
    else:
        assert any(f.has(row.cls) for f in pool(1, 1, 1, functions=[row.name]))


@pytest.mark.skipif(not shutil.which("gcc"), reason="no C compiler")
def test_c_that_is_compiled(tmp_path):
    """All rows in one program; each reads its points and writes its values."""
    includes, calls = [], []
    for i, row in enumerate(TABLE):
        source = written("c", Recursion(((y[k], node(row)),)), {}, f"f{i}")
        (tmp_path / f"f{i}.c").write_text(source)
        includes.append(f'#include "f{i}.c"')
        for point in zip(*given(row).values(), strict=True):
            shown = ", ".join(map(repr, map(float, point)))
            calls.append(f'{{ f{i}_state s; f{i}_init(&s); printf("%.17g\\n", f{i}_step(&s, {shown})); }}')
    lines = ["#include <stdio.h>", *includes, "int main(void) {", *calls, "return 0; }"]
    (tmp_path / "main.c").write_text("\n".join(lines))
    command = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "main.c", "-o", "run", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    found = subprocess.run([tmp_path / "run"], check=True, capture_output=True, text=True).stdout.split()
    close(found, np.concatenate([exact(node(row), given(row)) for row in TABLE]))
    for i, row in enumerate(TABLE):  # single precision has its own names
        (tmp_path / "one.c").write_text(written("c", Recursion(((y[k], node(row)),)), {}, f"g{i}", single=True))
        one = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-Wdouble-promotion", "-c", "one.c"]
        subprocess.run(one, cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.parametrize("row", some(TABLE), ids=lambda row: row.name)
def test_structured_text_that_is_interpreted(row):
    pytest.importorskip("blark")
    block, inputs = Block(written("st", Recursion(((y[k], node(row)),)), {}, "x1")), given(row)
    names = {name: name.upper() for name in inputs}
    found = [block.scan(**{names[n]: float(x) for n, x in zip(inputs, row_, strict=True)})
             for row_ in zip(*inputs.values(), strict=True)]  # fmt: skip
    np.testing.assert_allclose(found, exact(node(row), inputs), rtol=1e-12, atol=3e-16)  # 1 - 2/(...)


@pytest.mark.skipif(not shutil.which("node"), reason="no JavaScript engine")
def test_javascript():
    checks = []
    for row in TABLE:
        one = "(a, b, c) => " + (row.javascript.format(x=row.javascript.format(x="a", y="b"), y="c") if row.extreme
                                 else row.javascript.format(x="a"))  # fmt: skip
        points = [(*p, p[0] + p[1]) if row.extreme else p for p in zip(*given(row).values(), strict=True)]
        checks.append(f"{json.dumps([list(map(float, p)) for p in points])}.map(p => ({one})(...p))")
    script = f"console.log(JSON.stringify([{', '.join(checks)}]))"
    found = json.loads(subprocess.run(["node", "-e", script], check=True, capture_output=True, text=True).stdout)
    for row, values in zip(TABLE, found, strict=True):
        close(values, exact(node(row), given(row)))


def test_definitions_say_the_same():
    for row in TABLE:
        if row.definition is not None:
            of = dict(zip((X, Y), (u[k], W[k]), strict=True))
            written = row.definition.xreplace(of)
            inputs = given(row)
            found = exact(written, inputs if samples(written, W) else {"u": inputs["u"]})
            close(found, exact(row.cls(u[k], W[k]) if row.extreme else row.cls(u[k]), inputs))
