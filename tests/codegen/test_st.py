"""Structured Text: a parser of the standard's grammar reads it, and walking its tree gives what Python gives."""

import importlib.util
import math
import re

import numpy as np
import pytest
import sympy as sp
from exported import AWKWARD, SUBJECTS
from iec import IDENTIFIER, KEYWORDS, Block
from languages import run
from sampling import some

import narx_sym as ns
from narx_sym.codegen.export import written
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, signal, u, y

needs_blark = pytest.mark.skipif(importlib.util.find_spec("blark") is None, reason="blark is not installed here")
N = 600
p = signal("p")


@needs_blark
@pytest.mark.parametrize("name", some(SUBJECTS, 14))
def test_the_interpreted_text_agrees_with_python(name, tmp_path):
    subject = SUBJECTS[name]
    expected = subject.expected(N)
    assert (
        np.abs(run("st", subject, N, tmp_path) - expected).max() <= 1e-12 * np.abs(expected).max()
        and np.ptp(expected) > 0
    )


WAVE = np.concatenate([np.zeros(5), np.sin(np.arange(60) / 4)])
MIXED = ns.NARX.from_terms(
    ["y[k-1]", "y[k-2]", "Max(u[k-1], y[k-1])", "sign(u[k-2])*u[k-1]", "u[k-3]"], [0.5, 0.1, 0.3, 0.2, 0.1]
)


def mixed(source):
    block = Block(source)
    return np.array([block.scan(U=x, Y_REST=0.4) for x in [0.0, *WAVE.tolist()]])[: WAVE.size]


@needs_blark
@pytest.mark.parametrize(
    "wrong",
    some([
        None, (" + ", " - "), ("y_past[1]", "y_past[2]"), ("y_past[2] := y_past[1];", ""), ("MAX", "MIN"),
        ("> 0.0", "< 0.0"), ("u_past[1] := u;", ""), ("0.3", "0.31"), ("u_past[2] := u_past[1];", "u_past[2] := u;"),
        ("u_past[2]", "u_past[3]"),
    ], 5),
)  # fmt: skip
def test_a_wrong_text_is_seen(wrong):
    """What catches a wrong sign, a wrong shift of the state, a wrong function and a wrong index."""
    expected = MIXED.simulate(WAVE, 0.4, u0=0.0)
    start, end, step = MIXED.export("st", "x1").partition("END_IF;")
    if wrong is None:
        assert np.abs(mixed(start + end + step) - expected).max() <= 1e-12
        return
    assert step.replace(*wrong, 1) != step
    with pytest.raises(AssertionError, match=r"is not small|outside"):
        gap = np.abs(mixed(start + end + step.replace(*wrong, 1)) - expected).max()
        assert gap <= 1e-3, "is not small"


@pytest.mark.parametrize("name", AWKWARD)
def test_any_name_becomes_a_legal_one(name):
    source = ns.Model(y[k - 1] / 2 + signal(name)[k - 1] + 2 * u[k], (), []).export("st", "x1")
    assert source.count("(*") == source.count("*)") == 1 and source.isascii() and "\\" not in source
    declared = re.findall(r"^    (\w+) : ", source, re.M)
    assert len({n.upper() for n in declared}) == len(declared) == 7
    assert all(IDENTIFIER.fullmatch(n) and n.upper() not in KEYWORDS and len(n) <= 32 for n in declared)


def test_names_that_differ_in_case_only_stay_two():
    source = ns.Model(y[k - 1] / 2 + signal("Load")[k] + 2 * signal("LOAD")[k] + u[k], (), []).export("st")
    assert len({line.split(":")[0].strip().lower() for line in re.findall(r"^ +\w+ : LREAL;", source, re.M)}) == 4


@needs_blark
def test_what_a_branch_needs_is_computed_in_it():
    """A controller stops at a division by zero, also where its result is not used."""
    shared = 1 / u[k] + u[k] / 2
    recursion = Recursion(((y[k], sp.Piecewise((shared**2 + shared, u[k] > 0), (y[k - 1], True))),))
    block = Block(written("st", recursion, {}, "x1"))
    found = [block.scan(U=x, Y_REST=0.5) for x in (0.0, 2.0, 0.0, -1.0)]
    assert found == pytest.approx([0.5, 3.75, 3.75, 3.75])


@needs_blark
def test_restart():
    block = Block(ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0]).export("st"))
    first = [block.scan(U=x, Y_REST=0.2) for x in (1.0, 2.0)]
    assert first == [1.1, 2.55]
    again = [block.scan(U=1.0, Y_REST=0.2, RESTART=True), block.scan(U=2.0, RESTART=False)]
    assert again == first


@needs_blark
def test_single_precision():
    source = written("st", Recursion(((y[k], (u[k] ** 2 + 1) ** sp.Rational(3, 7)),)), {}, "x1", single=True)
    assert "LREAL" not in source and "REAL#0.428" in source
    Block(source)


@needs_blark
@pytest.mark.parametrize("name", ("tanh", "sinh"))
def test_small_arguments_keep_their_digits(name):
    """To the last digits of doubles, at any size and on both sides of where the formula changes."""
    block = Block(ns.NARX.from_terms([f"{name}(u[k-1])"], [1.0]).export("st"))
    sizes = [1e-300, 1e-12, 1e-6, 1e-3, 0.1, 0.49999, 0.5, 0.50001, 1.0, 10.0, 19.9]
    given = [sign * x for x in sizes for sign in (1, -1)]
    np.testing.assert_allclose([block.scan(U=x) for x in given], [getattr(math, name)(x) for x in given], rtol=2e-15)
