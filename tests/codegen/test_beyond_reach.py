"""Laws without limits whose reference cannot be reached: every language does what Python does, from there on too."""

import importlib.util
import shutil

import javascript
import numpy as np
import pytest
from exported import of, valued
from iec import Block
from sampling import matrix, some
from test_c import arguments, stepped

import narx_sym as ns

TS, N = 0.01, 120
MODELS = {
    "kink": ns.NARX.from_terms(["y[k-1]", "Max(u[k-1], 0)"], [0.5, 0.5], Ts=TS),
    "bent": ns.NARX.from_terms(["y[k-1]", "tanh(u[k-1])"], [0.5, 0.5], Ts=TS),
    "saturated": ns.NARX.from_terms(["y[k-1]", "y[k-2]", "Max(Min(u[k-1], 1), -1)"], [0.9, -0.2, 0.3], Ts=TS),
    "vertex": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2"], [0.6, 0.5, 0.15], Ts=TS),
    "late": ns.NARX.from_terms(["y[k-1]", "tanh(u[k-3])"], [0.5, 0.5], Ts=TS),
    "creeping": valued(ns.NARX.from_terms(["y[k-1]", "tanh(u[k-1])"], [0.5, 0.5], Ts=TS), "creep", value=0.05, tau=0.1),
}
REFERENCE = np.concatenate([np.full(6, 0.2), 0.2 + 1.8 * np.sin(np.arange(1, N - 5) / 8)])


def in_c(law, taken, folder):
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler here")
    source = law.export("c")
    rest = {"m": 0.1, "y": 0.2}
    return stepped(folder, source, "law", {"r": taken}, [rest[a] for a in arguments(source, "law_init")])


def in_st(law, taken, folder):
    if importlib.util.find_spec("blark") is None:
        pytest.skip("blark is not installed here")
    block = Block(law.export("st"))
    rest = {a: v for a, v in {"M_REST": 0.1, "Y_REST": 0.2}.items() if a in block.inputs}
    return np.array([block.scan(**{block.inputs[0]: float(x)}, **rest) for x in taken])


def in_casadi(law, taken, folder):
    step, state, found = law.export("casadi"), law.rest_state(m=0.1, y=0.2, r=0.2), []
    for x in taken:
        state, output = step(state, [x])
        found.append(float(output))
    return np.array(found)


def in_javascript(law, taken, folder):
    if why := javascript.why_no_javascript():
        pytest.skip(why)
    recursion, begin = law.exported(), law.start(0.2, 0.1)
    depth = recursion.depth
    held = np.concatenate([np.full(depth + law.preview, 0.2), taken])
    start = [begin.get(str(b.label), 0.0) for b in recursion.states]
    return javascript.run(law.export("js"), "law", [held], start)["runs"]["m"][depth:][:N]


def in_an_fmu(law, taken, folder):
    pytest.importorskip("fmpy")
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    from fmus import opened

    with opened(law.export("fmu"), folder) as fmu:
        one = fmu.instance()
        one.begin(**{a: v for a, v in {"m_rest": 0.1, "y_rest": 0.2}.items() if a in fmu.references})
        found = one.run(TS, r=taken)[1:]
        one.close()
    return found


LANGUAGES = (in_c, in_st, in_casadi, in_javascript, in_an_fmu)
QUICK = {(in_c, "bent"), (in_st, "kink"), (in_javascript, "vertex"), (in_an_fmu, "late")}
QUICK |= {(in_casadi, name) for name in MODELS}


@pytest.mark.parametrize("language, name", matrix(QUICK, LANGUAGES, MODELS))
@pytest.mark.filterwarnings("ignore:the model misses:UserWarning")
def test_it_goes_on_from_where_the_machine_is(name, language, tmp_path):
    law = MODELS[name].compensator()
    run = law.follow(REFERENCE, 0.1)
    assert 0.1 < run.unreached.mean() < 0.9 and law.closed_form
    taken = np.concatenate([REFERENCE, np.full(law.preview, REFERENCE[-1])])[law.preview :]
    found = language(law, taken, tmp_path)
    assert np.abs(found - run.m).max() <= 1e-9 * np.abs(run.m).max()
    assert np.array_equal(run.m, law.run(REFERENCE, 0.1, clip=True))


@pytest.mark.parametrize("language", some([in_casadi, in_c, in_st, in_javascript]))
def test_a_gain_that_turns_is_followed(language, tmp_path):
    """Where the output is above 1 the gain is negative: the sides of the kink follow each other the other way round."""
    regressors = ["y[k-1]", "u[k-1]", "u[k-1]*y[k-1]", "abs(u[k-1])"]
    law = ns.NARX.from_terms(regressors, [0.5, 0.5, -0.5, 0.1], Ts=TS).compensator()
    run = law.follow(REFERENCE, 0.1)
    assert REFERENCE.max() > 1.5 and not run.unreached.any()
    taken = np.concatenate([REFERENCE, np.full(law.preview, REFERENCE[-1])])[law.preview :]
    assert np.abs(language(law, taken, tmp_path) - run.m).max() <= 1e-9 * np.abs(run.m).max()


def test_it_is_said_on_top_of_the_source():
    bent, straight = MODELS["bent"].compensator(), ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.5]).compensator()
    for to in ("c", "st", "js", "plcopen"):
        text = " ".join(bent.export(to).replace("*", " ").split())
        assert "as near as it can and goes on from there" in text
        assert "as near as it can" not in straight.export(to)
        assert "takes one at once" not in text
    several = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2", "u[k-2]"], [0.6, 0.5, 0.15, 0.3]).compensator()
    assert "takes one at once" in several.export("c")


def test_what_effects_remember_starts_by_itself():
    """Whoever calls init gives input and output; Python starts there too."""
    law = MODELS["creeping"].compensator()
    assert set(arguments(law.export("c"), "law_init")) <= {"m", "y"}
    state = dict(zip(map(str, law.exported().past), law.rest_state(m=0.1, y=0.2, r=0.2), strict=True))
    begin = law.start(0.2, 0.1)
    assert state["x[k - 1]"] == pytest.approx(begin["x"], abs=1e-15) and 0 < begin["x"] < 0.2


def test_the_state_of_a_damped_law_fits_its_step():
    law = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.65, 0.23, 0.2415], Ts=TS).compensator()
    assert law.share() < 1
    following, _ = law.export("casadi")(law.rest_state(m=0.0, y=0.0, r=0.0), [0.0])
    assert not np.array(following).any()
    assert len(law.rest_state(share=None, m=0.0, r=0.0)) == len(law.recursion.past)
    assert len(law.rest_state(share=None, **law.start(0.0, 0.0))) == len(law.recursion.past)
    assert of(law).recursion == law.recursion


@pytest.mark.parametrize("effect", ("drift", "periodic_disturbance", "creep", "ageing"))
def test_a_state_at_rest_takes_what_start_gives(effect):
    """Also of a law that computes nothing of what its model remembers."""
    linear = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=TS)
    law = valued(linear, effect, value=0.05, tau=0.1, f=3.0).compensator()
    state = law.rest_state(share=None, **law.start(0.2, 0.1))
    _, output = law.export("casadi", share=None)(
        state, [0.2 if str(s.base.label) == "r" else 0.0 for s in law.exported().given]
    )
    assert state.shape == (len(law.exported(share=None).past),) and np.isfinite(float(output))
