"""A root that is proved to be alone is found in every language, with a fixed number of steps."""

import numpy as np
import pytest
import sympy as sp
from sampling import matrix, more
from test_beyond_reach import REFERENCE, TS, in_c, in_casadi, in_javascript, in_st
from test_c import arguments, needs_gcc, stepped

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.symbolic.recursion import State
from narx_sym.symbolic.signals import k, signal, u, y

MODELS = {
    "soft": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "tanh(u[k-1])"], [0.5, 0.5, 0.4], Ts=TS),
    "cubic": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.5, 1.0, 0.2], Ts=TS),
    "falls": ns.NARX.from_terms(
        ["y[k-1]", "u[k-2]", "atan(u[k-2])", "abs(u[k-2])"], [0.5, -1.0, -0.2, 0.3], Ts=TS
    ),
    "nearly flat": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.5, 1e-5, 0.9], Ts=TS),
}  # fmt: skip


# CasADi runs all of them, C one; a browser takes its time, and a parser of Structured Text minutes for so many steps.
QUICK = {(in_c, "falls"), *((in_casadi, name) for name in MODELS)}


@pytest.mark.parametrize("where, name", matrix(QUICK, (in_c, in_casadi, in_javascript, in_st), MODELS))
def test_languages_without_a_root_finder_find_it(where, name, tmp_path):
    law = MODELS[name].compensator()
    assert not law.closed_form and "found by bracketing" in law.checked
    n = 12 if where is in_st else REFERENCE.size  # its interpreter is slow
    target = REFERENCE[:n]
    expected = law.follow(target, 0.1, share=None).m
    taken = np.concatenate([target[law.preview :], np.full(law.preview, target[-1])])
    assert np.abs(where(law, taken, tmp_path)[:n] - expected).max() < 1e-9 * np.abs(expected).max()


def test_names_of_the_user_stay_apart():
    """A channel that is called as the steps would be; the machine code runs them too."""
    made = ns.NARX.from_terms(
        ["y[k-1]", "u[k-1]", "u[k-1]**3", "m_half_3[k-1]"], [0.5, 1.0, 0.2, 0.3], channels=["m_half_3"], Ts=TS
    )
    law, beside = made.compensator(), {"m_half_3": np.cos(np.arange(REFERENCE.size) / 5)}
    expected = law.follow(REFERENCE, 0.1, beside, share=None).m
    exported = law.exported(share=None)
    assert {str(b.label) for b in exported.inputs} == {"r", "m_half_3"}
    column = {"r": REFERENCE, **beside}
    given = {b: np.concatenate([np.full(exported.depth, c[0]), c, np.full(5, c[-1])]) for b, c in column.items()}
    start = {**law.start(REFERENCE[0], 0.1), "y": REFERENCE[0], "m": 0.1}
    found = compile(exported, "native")(
        given, law.theta, {n: v for n, v in start.items() if n in map(str, exported.states)}
    )
    assert np.abs(found["m"][exported.depth :][: expected.size] - expected).max() < 1e-9


@more
@needs_gcc
def test_a_state_may_start_from_a_parameter(tmp_path):
    w, (a, b, c) = signal("w"), sp.symbols("a b c", real=True)
    state = State(w[k], w[k - 1] / 2 + u[k - 1] / 9, initial=c * u[k])
    own = a * y[k - 1] + b * u[k - 1] + b * sp.tanh(u[k - 1]) + w[k]
    law = ns.Model(own, (a, b, c), [0.5, 0.5, 2 / 9], states=[state], Ts=TS).compensator()
    assert not law.closed_form
    source = law.export("c", limits=None)
    rest = {"m": 0.1, "y": 0.2}
    found = stepped(tmp_path, source, "law", {"r": REFERENCE[1:]}, [rest[n] for n in arguments(source, "law_init")])
    expected = law.follow(REFERENCE, 0.1, share=None).m
    assert np.abs(found - expected[:-1]).max() < 1e-9
