"""C99 source: it compiles without a warning and gives what Python gives."""

import re

import numpy as np
import pytest
import sympy as sp
from drawn import recursions
from exported import AWKWARD, SUBJECTS, Subject
from hypothesis import HealthCheck, assume, given, reject, settings
from languages import arguments, built, needs_gcc, run, self_tested, stepped
from sampling import some

import narx_sym as ns
from narx_sym.codegen.export import written
from narx_sym.codegen.layout import newest
from narx_sym.errors import Diverged, ModelError
from narx_sym.models.info import Info
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, lag, signal, u, y

N = 50_000
p = signal("p")


def code(source):
    """The source without its comment."""
    return re.sub(r"/\*.*?\*/", "", source, flags=re.S)


@needs_gcc
@pytest.mark.parametrize("single", (False, True))
@pytest.mark.parametrize("name", some(SUBJECTS, 8))
def test_compiles_cleanly_and_passes_its_own_test(name, single, tmp_path):
    end, told = self_tested(tmp_path, SUBJECTS[name].export("c", "x1", single=single), "x1")
    assert end == "passed", told


@needs_gcc
@pytest.mark.parametrize("name", some([n for n in SUBJECTS if n != "awkward"], every=4))
def test_agrees_with_python_on_50_000_samples(name, tmp_path):
    subject = SUBJECTS[name]
    found, expected = run("c", subject, N, tmp_path), subject.expected(N)
    assert found.shape == expected.shape and np.ptp(expected) > 0
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@needs_gcc
@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@given(recursions())
def test_random_recursions_agree(tmp_path, made):
    recursion, n, _ = made
    assume(recursion.inputs)
    subject = Subject(recursion, dict(zip(recursion.parameters, (0.05, -0.07), strict=True)))
    try:
        decided = [subject.expected(n, of=b) for b in recursion.states if str(b.label).startswith("tie")]
    except Diverged:  # what these inputs drive away has nothing to compare
        reject()
    assume(all(np.abs(x).min() > 1e-9 for x in decided))
    found = run("c", subject, n, tmp_path, output=recursion.states[0])
    assert np.abs(found - subject.expected(n, of=recursion.states[0])).max() <= 1e-12


@needs_gcc
def test_units_stand_in_the_comment_and_cannot_end_it(tmp_path):
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.4], Ts=0.01).compensator()
    told = law.export("c", units={"u": "V", "y": "µm/s²"})
    assert "Units: r in um/s^2, m in V." in told and "Units" not in law.export("c")
    for end in ("*/ int x = 1 /", "*) x := 1; (*", "V\n#error", "\\", "??/"):
        for language in ("c", "st", "js"):
            both = [law.export(language, units={"u": label, "y": "mm"}) for label in ("V", end)]
            lines = [re.findall(r"(?m)^(?: \*)? +Units of the coefficients:(.*)\n", one) for one in both]
            assert all(re.fullmatch(r"[A-Za-z0-9_ .,;:()=+/%^-]+\.", one) for (one,) in lines), lines
            plain, hostile = (one.replace(line, "") for one, (line,) in zip(both, lines, strict=True))
            assert plain.replace("m in V.", "") == re.sub(r"m in [^\n]*\.(?=\n)", "", hostile), hostile[:900]
    built(tmp_path, law.export("c", units={"u": "*/ int x = 1 /"}), "-DLAW_SELF_TEST")


@needs_gcc
def test_awkward_names_agree_too(tmp_path):
    """All signals rest alike and move alike, but by another factor each: a mixed-up pair would show."""
    subject = SUBJECTS["awkward"]
    assert np.abs(run("c", subject, 500, tmp_path) - subject.expected(500)).max() <= 1e-12
    assert not (tmp_path / "pwned").exists()


def test_nothing_of_a_name_reaches_the_code():
    source = ns.Model(y[k - 1] / 2 + sum(signal(name)[k - 1] for name in AWKWARD) + u[k], (), []).export("c", "x1")
    assert source.count("/*") == source.count("*/") == 1 and "??" not in source and "\\\n" not in source
    assert source.isascii() and "system" not in re.sub(r"x_system\w*", "", code(source))
    names = set(re.findall(r"[A-Za-z_]\w*", code(source).split("#ifdef")[0]))
    assert all(len(n) <= 63 for n in names) and not {"EOF", "NULL", "__DATE__", "INFINITY"} & names


def test_only_the_libraries_that_are_used():
    plain = ns.NARX.from_terms(["y[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]"], [0.8, 0.5]).export("c")
    assert "#include" not in plain.split("#ifdef")[0] and "-lm" not in plain
    assert "#include <math.h>" in ns.NARX.from_terms(["tanh(u[k-1])"], [0.8]).export("c")
    every = "".join(code(subject.export("c", "x1")) for subject in [*SUBJECTS.values()][::4])
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|goto|static (?!const|x1_real x1_))", every)


@needs_gcc
def test_single_precision(tmp_path):
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "tanh(u[k-1])", "Max(u[k-1], 0)"], [0.8, 0.5, 0.1, 0.2])
    source = model.export("c", "small", single=True)
    assert "double" not in code(source).split("#ifdef")[0] and "tanhf(" in source
    wave = np.sin(np.arange(2000) / 50)
    found = stepped(tmp_path, source, "small", {"u": wave[:-1]}, [0.0])
    assert np.allclose(found, model.simulate(wave, 0.0)[1:], atol=1e-5)
    assert self_tested(tmp_path, source, "small")[0] == "passed"


@needs_gcc
@pytest.mark.filterwarnings("ignore:the model misses:UserWarning")
@pytest.mark.parametrize("name", ("tanh", "atan"))
def test_single_precision_where_a_bounded_function_ends(name, tmp_path):
    """A number just inside the limit is rounded onto it, or beyond: infinite, or of the other sign."""
    model = ns.NARX.from_terms(["y[k-1]", f"{name}(u[k-1])"], [0.5, 0.5], Ts=0.01)
    source = model.compensator().export("c", "x", single=True)
    r = np.repeat([0.1, 3.0, -3.0, 0.1], 20)
    found = stepped(tmp_path, source, "x", {"r": r}, [0.1])
    assert np.isfinite(found).all() and (found[20:40] > 8).all() and (found[40:60] < -8).all()
    wide = model.compensator().run(np.insert(r, 0, 0.1), 0.1, clip=True)[:-1]
    assert np.abs(model.simulate(found, 0.1, u0=0.1) - model.simulate(wide, 0.1, u0=0.1)).max() < 1e-5
    assert self_tested(tmp_path, source, "x")[0] == "passed"


@needs_gcc
@pytest.mark.parametrize("wrong", (("0.8", "0.7"), ("past->y[0]", "past->y[1]"), (" + ", " - ")))
def test_a_wrong_source_fails_its_own_test(wrong, tmp_path):
    source = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "Min(u[k-2], y[k-1])"], [0.8, 0.1, 0.5, 0.3]).export(
        "c", "x"
    )
    step, _ = source.split("x_real x_step")[-1].split("#ifdef")
    changed = source.replace(step, step.replace(*wrong, 1))
    assert changed != source
    end, told = self_tested(tmp_path, changed, "x")
    assert end == "FAILED" and "FAILED" in told


@needs_gcc
def test_a_nan_is_kept(tmp_path):
    """fmax and fmin would hide it, and so would a sign."""
    recursion = Recursion(((p[k], sp.Max(u[k], 0) + sp.Min(u[k], 1)), (y[k], sp.sign(p[k]) + sp.Max(0, p[k - 1], 1))))
    found = stepped(tmp_path, written("c", recursion, {}, "x1"), "x1", {"u": np.array([1.0, np.nan, 1.0, 1.0])}, [0.0])
    assert np.isnan(found).tolist() == [False, True, True, False]


@needs_gcc
def test_what_a_nan_leaves_is_said_and_ends_with_init(tmp_path):
    """Within limits too: m is no number until init is called again."""
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=0.01).compensator()
    source = law.export("c", "x", limits=(-1, 1))
    assert "until x_init is called again" in " ".join(source.split()) and "finite numbers" in law.export("st")
    found = stepped(
        tmp_path, source, "x", {"r": np.array([0.3, np.nan, 0.3, 0.3])}, [0.0] * len(arguments(source, "x_init"))
    )
    assert np.isnan(found).tolist() == [False, True, True, True]


@needs_gcc
def test_no_case_is_no_number(tmp_path):
    recursion = Recursion(((y[k], sp.Piecewise((u[k], u[k] > 0))),))
    source = written("c", recursion, {}, "x1")
    found = stepped(tmp_path, source, "x1", {"u": np.array([1.0, -1.0])}, [])
    assert found[0] == 1.0 and np.isnan(found[1])


def test_a_run_that_diverges_has_no_self_test():
    source = ns.NARX.from_terms(["y[k-1]", "y[k-1]**3", "u[k-1]"], [9.0, 9.0, 1.0]).export("c")
    assert "No self-test" in source and "main" not in source


def test_the_self_test_moves_where_the_model_was_identified():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.5], operating_point={u: 50.0})
    assert 49 <= float(re.search(r"u\[\d+\] = \{\s*([\d.]+),", model.export("c")).group(1)) <= 51
    model = model.replace(info=Info(ranges={"u": (100.0, 300.0), "y": (0.0, 9.0)}))
    assert float(re.search(r"u\[\d+\] = \{\s*([\d.]+),", model.export("c")).group(1)) > 99
    assert float(re.search(r"r\[\d+\] = \{\s*([\d.]+),", model.compensator().export("c")).group(1)) < 10


def test_the_last_state_is_returned_unless_another_is_named():
    pair = Recursion(((p[k], p[k - 1] / 2 + u[k]), (y[k], y[k - 1] / 3 + p[k])))
    assert "returns y[k]" in written("c", pair, {}) and "returns p[k]" in written("c", pair, {}, output=p)
    assert written("c", pair, {}, output="p") == written("c", pair, {}, output=p)
    with pytest.raises(ModelError, match="does not compute z"):
        written("c", pair, {}, output="z")


@needs_gcc
def test_correct_code_passes_where_few_roundings_turn_a_branch(tmp_path):
    """One in eight of the runs with other last bits shows it."""
    from bench.attack import KEPT, drawn

    _, model = drawn(np.random.default_rng(13), 2, KEPT)
    source = model.compensator().export("c", "x")
    assert self_tested(tmp_path, source, "x")[0] == "passed"


@needs_gcc
def test_correct_code_passes_where_rounding_grows(tmp_path):
    """An unstable run multiplies the last bits: the self-test allows what they do, and no more."""
    growing = Recursion(((y[k], 2.1 * y[k - 1] - 0.3 * y[k - 2] + u[k] * y[k - 1] / 3 + u[k - 1]),))
    chaotic = Recursion(((y[k], 3.99 * y[k - 1] * (1 - y[k - 1])), (signal("w")[k], y[k] + u[k])))
    for name, recursion in {"grows": growing, "chaos": chaotic}.items():
        source = written("c", recursion, {}, name, ranges={"y": (0.2, 0.6)})
        if name == "chaos":  # nothing can be said about such a run
            assert "No self-test" in source
            continue
        for text, end in ((source, "passed"), (source.replace("0.3", "0.30001"), "FAILED")):
            assert self_tested(tmp_path, text, name)[0] == end


@needs_gcc
def test_both_outputs_run_in_c_and_casadi_as_here(tmp_path):
    first = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u2[k-1]*y[k-1]"], [0.8, 0.5, 0.1], channels=["u2"])
    second = ns.NARX.from_terms(["y[k-1]", "u2[k-2]", "y1[k-1]"], [0.7, 0.4, 0.2], channels=["u2", "y1"])
    system, rng = ns.System({"y1": first, "y2": second}), np.random.default_rng(5)
    u, u2 = 0.5 * rng.standard_normal((2, 300))
    depth = system.recursion.depth
    still = {n: np.concatenate([np.full(depth, x[0]), x]) for n, x in (("u", u), ("u2", u2))}
    runs = system.simulate(still, {"y1": 0.3, "y2": 0.3})
    source = system.export("c", "plant")
    rest = [float(still[n][0]) if n in still else 0.3 for n in arguments(source, "plant_init")]
    late = {n: still[n][depth - i :][:300] for n, i in ((b.name, i) for b, i in newest(system.recursion).items())}
    found = [
        stepped(tmp_path, source.replace("return y1;", f"return {what};"), "plant", late, rest)
        for what in ("y1", "past->y2[0]")
    ]
    state = [0.3 if s.base.name[0] == "y" else still[s.base.name][0] for s in system.recursion.past]
    step = system.export("casadi")
    both = []
    for i in range(300):
        given = [still[s.base.name][depth + i - lag(s)] for s in system.recursion.given]
        state, out = step(state, given)
        both.append(np.asarray(out).ravel())
    for j, name in enumerate(("y1", "y2")):
        assert np.abs(found[j] - runs[name][depth:]).max() < 1e-12
        assert np.abs(np.array(both)[:, j] - runs[name][depth:]).max() < 1e-12
    with pytest.raises(ns.ModelError, match="exported to c and casadi"):
        system.export("st")
