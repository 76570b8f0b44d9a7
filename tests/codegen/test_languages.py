"""What every target writes is run over a record, and agrees with the package's own run; what it cannot say is refused."""

import numpy as np
import pytest
import sympy as sp
from exported import of, valued
from languages import REFERENCE, RUN, TS, arguments, law_over, needs_gcc, run, stepped
from sampling import matrix, some

import narx_sym as ns
from narx_sym.codegen import registry
from narx_sym.codegen.export import written
from narx_sym.engines.compile import compile
from narx_sym.errors import ModelError
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, r, signal, u, y

N = 300
MODEL = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "Max(u[k-2], y[k-1])"], [0.6, -0.1, 0.4, 0.05], Ts=TS)
LINEAR = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=TS)
BENT = ns.NARX.from_terms(["y[k-1]", "tanh(u[k-1])"], [0.5, 0.5], Ts=TS)
p = signal("p")


def test_every_target_has_a_run():
    assert set(RUN) == set(registry.exports())


@pytest.mark.parametrize("to", registry.exports())
def test_what_it_writes_gives_what_python_gives(to, tmp_path):
    subject = of(MODEL)
    expected = subject.expected(N)
    assert np.abs(run(to, subject, N, tmp_path) - expected).max() <= 1e-12 * np.abs(expected).max()
    assert np.ptp(expected) > 0.5


def test_one_more_target_is_everywhere(run, tmp_path, monkeypatch):
    """One function is all that a new target takes: method, command line and page know it by its name or its ending."""
    registry.exports()
    monkeypatch.setattr(registry, "_EXPORTS", dict(registry._EXPORTS))

    @registry.export("words", "Plain words", ".words")
    def write(request):
        return f"{request.name}: {len(request.recursion.updates)} equations"

    assert MODEL.export("words") == "model: 1 equations"
    LINEAR.save(tmp_path / "model.json")
    code, text, err = run("compensate", tmp_path / "model.json", "--export", tmp_path / "law.words")
    assert code == 0 and not err and "Plain words" in text
    assert (tmp_path / "law.words").read_text().startswith("law:")
    with pytest.raises(ModelError, match="c, casadi, fmu, fmu2, js, plcopen, st"):
        MODEL.export("fortran")
    code, _, err = run("compensate", tmp_path / "model.json", "--export", tmp_path / "law.f90")
    assert code == 2 and ".c, .fmu, .js, .st, .words, .xml" in err and not (tmp_path / "law.f90").exists()


ZETA = Recursion(((y[k], sp.zeta(u[k])),))
NO_CASE = Recursion(((y[k], sp.Piecewise((u[k], u[k] > 0))),))
BARE = ns.NARX.from_terms(["y[k-1]"])
REFUSED = [
    *((to, ZETA, {}, "rule for zeta") for to in ("c", "st", "js")),
    *((to, BARE, {}, "No value") for to in ("c", "st", "js", "casadi", "plcopen")),
    *((to, Recursion(((p[k], r[k]),)), {"output": "z"}, "does not compute z") for to in ("c", "st", "js", "casadi")),
    *(("st", LINEAR, {"name": n}, "function block") for n in ("my law", "a__b", "a_", "1a", "_a", "if", "Max", "x" * 33)),
    *(("js", LINEAR, {"name": n}, "name of a constant") for n in ("my law", "class", "1a", "simulate")),
    *((to, LINEAR, {"name": "my law"}, "identifier") for to in ("c", "fmu", "fmu2")),
    ("casadi", LINEAR, {"name": "my model"}, "CasADi function"),
    ("casadi", Recursion(((y[k], y[k - 1] + k * u[k]),)), {}, "time index"),
    ("c", Recursion(((y[k], sp.oo * u[k]),)), {}, "no literal"),
    ("c", Recursion(((p[k], p[k - 1] / 2), (y[k], p[k]))), {"initial": {p: sp.Symbol("a") + u[k]}}, "signals and numbers only"),
    *(("c", ns.NARX.from_terms(["u[k-1]"], [v]), {"single": True}, "single precision") for v in (1e-60, 1e60)),
    ("js", LINEAR, {"single": True}, "double precision"),
    ("st", NO_CASE, {}, "last case"),
    ("fmu", LINEAR.replace(Ts=None), {}, "sampling time"),
    ("fmu", LINEAR, {"units": {"u": "V\x00"}}, "cannot be printed"),
]  # fmt: skip


@pytest.mark.parametrize(("to", "thing", "options", "words"), REFUSED)
def test_what_a_target_cannot_say_is_refused(to, thing, options, words):
    with pytest.raises(ModelError, match=words):
        written(to, thing, {}, **options) if isinstance(thing, Recursion) else thing.export(to, **options)


@pytest.mark.parametrize("to", ("c", "st", "js", "plcopen"))
def test_the_same_thing_gives_the_same_text_and_says_how_it_is_sampled(to):
    law = LINEAR.compensator()
    text = law.export(to)
    assert text == law.export(to) and "Sampling time: 0.01 s" in text and "eval" not in text
    assert to != "c" or "m[k] = 2.5*r[k+1] - 2.0*r[k]\n" in text


# -- laws whose reference cannot be reached ----------------------------------------------------------------------------

MODELS = {
    "kink": ns.NARX.from_terms(["y[k-1]", "Max(u[k-1], 0)"], [0.5, 0.5], Ts=TS),
    "bent": BENT,
    "saturated": ns.NARX.from_terms(["y[k-1]", "y[k-2]", "Max(Min(u[k-1], 1), -1)"], [0.9, -0.2, 0.3], Ts=TS),
    "vertex": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2"], [0.6, 0.5, 0.15], Ts=TS),
    "late": ns.NARX.from_terms(["y[k-1]", "tanh(u[k-3])"], [0.5, 0.5], Ts=TS),
    "creeping": valued(BENT, "creep", value=0.05, tau=0.1),
}
LAWS = ("c", "st", "casadi", "js", "fmu")
QUICK = {("c", "bent"), ("st", "kink"), ("js", "vertex"), ("fmu", "late"), *(("casadi", name) for name in MODELS)}


def follows(to, model, folder, n=REFERENCE.size, tolerance=1e-9, **options):
    """Whether an exported law does what Python does; return Python's run."""
    subject = law_over(model)
    own = subject.thing.follow(REFERENCE[:n], 0.1, **options)
    assert np.abs(run(to, subject, n, folder) - own.m).max() <= tolerance * np.abs(own.m).max()
    return own


@pytest.mark.parametrize("to, name", matrix(QUICK, LAWS, MODELS))
@pytest.mark.filterwarnings("ignore:the model misses:UserWarning")
def test_it_goes_on_from_where_the_machine_is(name, to, tmp_path):
    """From there on too, in every language."""
    law = MODELS[name].compensator()
    found = follows(to, MODELS[name], tmp_path)
    assert 0.1 < found.unreached.mean() < 0.9 and law.closed_form
    assert np.array_equal(found.m, law.run(REFERENCE, 0.1, clip=True))


@pytest.mark.parametrize("to", some(["casadi", "c", "st", "js"]))
def test_a_gain_that_turns_is_followed(to, tmp_path):
    """Where the output is above 1 the gain is negative: the sides of the kink follow each other the other way round."""
    regressors = ["y[k-1]", "u[k-1]", "u[k-1]*y[k-1]", "abs(u[k-1])"]
    found = follows(to, ns.NARX.from_terms(regressors, [0.5, 0.5, -0.5, 0.1], Ts=TS), tmp_path)
    assert REFERENCE.max() > 1.5 and not found.unreached.any()


def test_it_is_said_on_top_of_the_source():
    for to in ("c", "st", "js", "plcopen"):
        text = " ".join(BENT.compensator().export(to).replace("*", " ").split())
        assert "as close as it can and continues from there" in text and "takes one at once" not in text
        assert "as close as it can" not in LINEAR.compensator().export(to)
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
    for given in ({"m": 0.0, "r": 0.0}, law.start(0.0, 0.0)):
        assert len(law.rest_state(share=None, **given)) == len(law.recursion.past)
    assert of(law).recursion == law.recursion


@pytest.mark.parametrize("effect", ("drift", "periodic_disturbance", "creep", "ageing"))
def test_a_state_at_rest_takes_what_start_gives(effect):
    """Also of a law that computes nothing of what its model remembers."""
    law = valued(LINEAR, effect, value=0.05, tau=0.1, f=3.0).compensator()
    state = law.rest_state(share=None, **law.start(0.2, 0.1))
    given = [0.2 if str(s.base.label) == "r" else 0.0 for s in law.exported().given]
    _, output = law.export("casadi", share=None)(state, given)
    assert state.shape == (len(law.exported(share=None).past),) and np.isfinite(float(output))


# -- laws by a root that is proved to be alone: a fixed number of steps in every language --------------------------------

ROOTS = {
    "soft": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "tanh(u[k-1])"], [0.5, 0.5, 0.4], Ts=TS),
    "cubic": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.5, 1.0, 0.2], Ts=TS),
    "falls": ns.NARX.from_terms(["y[k-1]", "u[k-2]", "atan(u[k-2])", "abs(u[k-2])"], [0.5, -1.0, -0.2, 0.3], Ts=TS),
    "nearly flat": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.5, 1e-5, 0.9], Ts=TS),
}
# CasADi runs all of them, C one; a browser takes its time, and a parser of Structured Text minutes for so many steps.
QUICK_ROOTS = {("c", "falls"), *(("casadi", name) for name in ROOTS)}


@pytest.mark.parametrize("to, name", matrix(QUICK_ROOTS, ("c", "casadi", "js", "st"), ROOTS))
def test_languages_without_a_root_finder_find_it(to, name, tmp_path):
    law = ROOTS[name].compensator()
    assert not law.closed_form and "found by bracketing" in law.checked
    follows(to, ROOTS[name], tmp_path, 12 if to == "st" else REFERENCE.size, share=None)


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
    start = {n: v for n, v in start.items() if n in map(str, exported.states)}
    found = compile(exported, "native")(given, law.theta, start)
    assert np.abs(found["m"][exported.depth :][: expected.size] - expected).max() < 1e-9


# -- a law of a model that knows its records ---------------------------------------------------------------------------


@needs_gcc
def test_the_source_starts_at_the_rest_of_its_reference_and_keeps_the_known_range(tmp_path):
    i = np.arange(1500)
    moved = 1.8 + 1.5 * np.sin(0.02 * i) + 0.3 * np.sin(0.13 * i)
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]", "1"], [0.9, 0.2, 0.05, 0.3], Ts=TS)
    measured = model.simulate(moved, 0.0) + 1e-3 * np.random.default_rng(0).standard_normal(i.size)
    law = model.fit(ns.Record.from_arrays(moved, measured, TS)).compensator()
    low, high = law.model.info.ranges["u"]
    assert str(law.stability()).endswith("y from {:.4g} to {:.4g}.".format(*law.model.info.ranges["y"]))
    source = law.export("c")
    assert "law_init(law_state *past, law_real r)" in source
    for level in (4.5, 8.0):
        reference = level + np.where(i[:200] < 20, 0.0, 6.0 * np.sin(0.05 * (i[:200] - 20)))
        found = stepped(tmp_path, source, "law", {"r": reference[1:]}, [float(reference[0])])
        expected = law.run(reference, limits=(low, high))[:-1]
        assert np.abs(found - expected).max() <= 2e-3 * (high - low) and found.min() >= low and found.max() <= high
        assert abs(found[0] - law.rest_input(level)) <= 1e-3 * (high - low)
    free = stepped(tmp_path, law.export("c", limits=None), "law", {"r": reference[1:]}, [float(reference[0])])
    assert free.max() > high
