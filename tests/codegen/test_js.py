"""JavaScript: it gives what the engines give, for the parameters that it is called with."""

import re

import javascript
import numpy as np
import pytest
import sympy as sp
from exported import AWKWARD, SUBJECTS, valued
from sampling import some

import narx_sym as ns
from narx_sym.codegen.export import written
from narx_sym.engines.compile import compile
from narx_sym.fit.simulate import rest_states
from narx_sym.symbolic.functions import TABLE
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, signal, u, y

needs_javascript = pytest.mark.skipif(
    bool(javascript.why_no_javascript()), reason=javascript.why_no_javascript() or "-"
)
N = 1000
LINEAR = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01)
p = signal("p")


def assert_same(found, expected, rtol=1e-12):
    assert found.keys() == expected.keys()
    for name, x in expected.items():
        assert np.array_equal(np.isnan(found[name]), np.isnan(x)), name
        size = np.nanmax(np.abs(x), initial=1e-300)
        np.testing.assert_allclose(found[name], x, rtol=0, atol=rtol * size, err_msg=name)


def by_the_engine(recursion, waves, theta, start):
    given = {str(b.label): waves[str(b.label)] for b in recursion.inputs}
    n = len(next(iter(given.values()))) if given else N
    return compile(recursion)(given, theta, start, length=n, on_divergence="nan")


@needs_javascript
@pytest.mark.parametrize("name", some(SUBJECTS, 8))
def test_it_agrees_with_the_engine_for_parameters_of_the_call(name):
    subject = SUBJECTS[name]
    recursion = subject.recursion
    waves, rng = subject.waves(N), np.random.default_rng(len(name))
    start = {str(b.label): subject.at_rest(str(b.label)) * rng.uniform(0.9, 1.1, recursion.depth + 1)
             for b in recursion.states}  # fmt: skip
    for factor in (1.0, rng.uniform(0.98, 1.02, len(recursion.parameters))):
        theta = np.array([float(subject.values[s]) for s in recursion.parameters]) * factor
        found = javascript.run(
            subject.export("js", "x1"), "x1", [waves[str(b.label)] for b in recursion.inputs], list(start.values()),
            None if np.isscalar(factor) else theta, N,
        )  # fmt: skip
        assert_same(found["runs"], by_the_engine(recursion, waves, theta, start))
        assert found["parameters"] == [str(s) for s in recursion.parameters]


@needs_javascript
def test_a_nan_is_kept_and_a_run_that_diverges_ends_in_nan():
    row = {r.name: r.cls for r in TABLE}
    kept = row["Max"](u[k], 0) + row["Min"](u[k], 1) + row["sign"](u[k]) + abs(u[k])
    recursion = Recursion(((y[k], kept),))
    wave = np.array([1.0, -2.0, np.nan, 1.0])
    found = javascript.run(written("js", recursion, {}, "x1"), "x1", [wave], [0.0])["runs"]
    assert_same(found, compile(recursion)({"u": wave}, on_divergence="nan"))
    assert np.isnan(found["y"]).tolist() == [False, False, True, True]
    growing = Recursion(((p[k], 3 * p[k - 1] ** 3 + u[k]), (y[k], y[k - 1] / 2 + p[k])))
    wave = np.ones(60)
    expected = compile(growing)({"u": wave}, initial={"p": 1.0, "y": 0.0}, on_divergence="nan")
    assert_same(javascript.run(written("js", growing, {}, "x1"), "x1", [wave], [1.0, 0.0])["runs"], expected)
    assert np.isnan(expected["y"]).any() and not np.isnan(expected["y"]).all()


@needs_javascript
def test_what_effects_remember_starts_by_itself():
    model = valued(LINEAR, "backlash at input", "creep", value=0.3, r=0.2, tau=0.5)
    expected = rest_states(model, 0.6, -1.9) | {"y": -1.9}
    told = javascript.run(model.export("js", "x1"), "x1", [np.ones(3)], [0.0] * len(model.recursion.states), at=[])
    at = [{"u": 0.6, "y": -1.9}[name] for name in told["rested"]]
    rest = javascript.run(model.export("js", "x1"), "x1", [np.ones(3)], [0.0] * len(told["states"]), at=at)["rest"]
    assert rest == pytest.approx([expected[name] for name in told["states"]], rel=1e-14)
    numbers = dict(zip(told["parameters"], told["values"], strict=True))
    moved = model.replace(theta=[2 * numbers[str(s)] for s in model.symbols])
    expected = rest_states(moved, 0.6, -1.9) | {"y": -1.9}
    again = javascript.run(
        model.export("js", "x1"), "x1", [np.ones(3)], [0.0] * len(told["states"]), moved.theta, at=at
    )["rest"]  # fmt: skip
    assert again == pytest.approx([expected[name] for name in told["states"]], rel=1e-14)


def test_the_comment_says_what_rest_takes():
    text = " ".join(valued(LINEAR, "drift", value=0.3).export("js", "law").replace("*", " ").split())
    assert "at has one number for each sequence in law.rested, in that order (y, t); t is the time of the first" in text
    assert "in that order (y)." in " ".join(LINEAR.export("js", "law").replace("*", " ").split())


@pytest.mark.parametrize("name", [*AWKWARD, "</script><script>alert(1)</script>", "<!--", "-->", "eval", "__proto__"])
def test_nothing_of_a_name_reaches_the_code(name):
    a = sp.Symbol(name or "a", real=True)
    text = ns.Model(y[k - 1] / 2 + signal(name)[k - 1] + a * u[k], (a,), [0.5]).export("js", "x1")
    comment, _, code = text.partition("*/")
    bare = re.sub(r'"(\\.|[^"\\])*"', '""', code)
    assert text.isascii() and comment.count("/*") == 1 and not re.search(r"/\*|\*/|//|`|'", bare)
    assert not re.search(r"</script|<!--|\beval\b\s*\(|new Function", text, re.I)
    assert "alert" not in re.sub(r"script_script_alert_1_script\w*", "", bare)
    assert "pwned" not in bare.replace("_pwned", "")
