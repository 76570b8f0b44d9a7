"""C99 source: it compiles without a warning and gives what Python gives."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
import sympy as sp

import narx_sym as ns
from narx_sym.compile import compile, to_c
from narx_sym.errors import ModelError
from narx_sym.recursion import Recursion
from narx_sym.sensitivity import sensitivities
from narx_sym.signals import k, phi1, phi2, r, signal, u, y

gcc = shutil.which("gcc")
needs_gcc = pytest.mark.skipif(gcc is None, reason="no C compiler here")
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
PAPER = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]", "phi1[k-2]*u[k-2]**2",
    "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
THETA = [1.0, 0.77, 1.44e-2, -9.60e-3, 3.15e-4, -2.47e-4]
p = signal("p")
a = sp.Symbol("a", real=True)


def models():
    paper = ns.NARX.from_terms(PAPER, THETA)
    shifted = ns.NARX.from_terms(PAPER, THETA, operating_point={u: 1.8, y: -95.9})
    inverse = ns.NARX.from_terms(
        ["u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]"], [1.0, 1.27, -0.02], input="y", output="u", lead=2
    )
    play = Recursion(((p[k], sp.Max(u[k] - a, sp.Min(u[k] + a, p[k - 1]))), (y[k], p[k] + sp.tanh(u[k - 3]) / 3)), (a,))
    cases = Recursion(((y[k], sp.Piecewise((y[k - 1] / 2, u[k] > a), (sp.Abs(u[k]) ** 3, True))),), (a,))
    return {
        "model": (paper.recursion, paper.values),
        "shifted": (shifted.recursion, shifted.values),
        "law": (paper.compensator().recursion, paper.values),
        "shifted_law": (shifted.compensator().recursion, shifted.values),
        "inverse_law": (inverse.compensator().recursion, inverse.values),
        "play": (play, {a: 0.3}),
        "cases": (cases, {a: 0.2}),
        "memoryless": (Recursion(((y[k], 2 * u[k] + phi2[k] * phi1[k]),)), {}),
    }


@pytest.fixture(params=models())
def case(request):
    return request.param, *models()[request.param]


def run_in_c(folder, name, recursion, values, inputs, rest, single=False):
    """Step the exported source over arrays."""
    path = folder / f"{name}.c"
    path.write_text(to_c(recursion, values, name, single))
    subprocess.run([gcc, *FLAGS, "-O2", "-shared", "-fPIC", path, "-o", folder / f"{name}.so", "-lm"], check=True)
    library = ctypes.CDLL(str(folder / f"{name}.so"))
    number = ctypes.c_float if single else ctypes.c_double
    step, start = getattr(library, f"{name}_step"), getattr(library, f"{name}_init")
    step.restype = number
    state = ctypes.create_string_buffer(4096)
    start(state, *[number(v) for v in rest])
    return np.array([step(state, *[number(v) for v in row]) for row in zip(*inputs, strict=True)])


@needs_gcc
def test_compiles_cleanly_and_passes_its_own_test(case, tmp_path):
    name, recursion, values = case
    path = tmp_path / "x.c"
    path.write_text(to_c(recursion, values, name))
    subprocess.run(
        [gcc, *FLAGS, f"-D{name.upper()}_SELF_TEST", path, "-o", tmp_path / "x", "-lm"], check=True, capture_output=True
    )
    told = subprocess.run([tmp_path / "x"], capture_output=True, text=True)
    assert told.returncode == 0 and "passed" in told.stdout


@needs_gcc
def test_law_agrees_with_python_on_50_000_samples(tmp_path):
    model = ns.NARX.from_terms(PAPER, THETA)
    law = model.compensator()
    reference = 40 * np.sin(2 * np.pi * np.arange(50_001) * 1e-3)
    m = law.run(reference, 0.0)[:-1]
    found = run_in_c(tmp_path, "law", law.recursion, model.values, [reference[1:]], [0.0, reference[0]])
    assert np.abs(found - m).max() <= 1e-12 * np.abs(m).max()


@needs_gcc
def test_single_precision(tmp_path):
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "tanh(u[k-1])"], [0.8, 0.5, 0.1])
    source = to_c(model.recursion, model.values, "small", single=True)
    assert "double" not in source.split("#ifdef")[0].replace("instead of double", "")
    wave = np.sin(np.arange(2000) / 50)
    found = run_in_c(tmp_path, "small", model.recursion, model.values, [wave[:-1]], [0.0], single=True)
    assert np.allclose(found, model.simulate(wave, 0.0)[1:], atol=1e-5)


@needs_gcc
def test_a_wrong_source_fails_its_own_test(tmp_path):
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.5])
    path = tmp_path / "x.c"
    path.write_text(model.to_c("x").replace("0.8", "0.7", 2))
    subprocess.run([gcc, "-DX_SELF_TEST", path, "-o", tmp_path / "x", "-lm"], check=True)
    assert subprocess.run([tmp_path / "x"], capture_output=True).returncode == 1


def test_what_c_cannot_say_is_refused():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.5])
    with pytest.raises(ModelError, match="identifier"):
        model.to_c("my law")
    with pytest.raises(ModelError, match="time index"):
        to_c(Recursion(((y[k], k * r[k]),)), {})
    with pytest.raises(ModelError, match="rule"):
        to_c(Recursion(((y[k], sp.zeta(u[k])),)), {})


@needs_gcc
def test_constants_are_numbers(tmp_path):
    turning = Recursion(((y[k], sp.cos(2 * sp.pi * u[k]) + sp.E * y[k - 1] / 9),))
    wave = np.linspace(0, 1, 50)
    found = run_in_c(tmp_path, "turning", turning, {}, [wave], [0.0])
    assert np.allclose(found[1:], compile(turning)({"u": wave}, (), {"y": found[0]})["y"][1:], rtol=0, atol=1e-12)


def test_step_by_step_is_the_same_recursion():
    """The self-test's expected values come from the engines, not from the C printer."""
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])
    assert compile(model.recursion)({"u": np.ones(4)}, [0.5, 1.0], {"y": 0.0})["y"].tolist() == [0.0, 1.0, 1.5, 1.75]


def test_the_last_state_is_returned_unless_another_is_named():
    pair = Recursion(((p[k], p[k - 1] / 2 + u[k]), (y[k], y[k - 1] / 3 + p[k])))
    assert "returns y[k]" in to_c(pair, {}) and "returns p[k]" in to_c(pair, {}, output=p)
    assert to_c(pair, {}, output="p") == to_c(pair, {}, output=p)
    with pytest.raises(ModelError, match="does not compute z"):
        to_c(pair, {}, output="z")


@needs_gcc
def test_sensitivities_behind_the_output(tmp_path):
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.5])
    extended, _ = sensitivities(model.recursion)
    wave = np.sin(np.arange(100) / 9)
    path = tmp_path / "s.c"
    path.write_text(to_c(extended, model.values, "s", output=y))
    flags = ["-shared", "-fPIC", path, "-o", tmp_path / "s.so", "-lm"]
    subprocess.run([gcc, *FLAGS, *flags], check=True)
    library, number = ctypes.CDLL(str(tmp_path / "s.so")), ctypes.c_double
    library.s_step.restype = number
    state = ctypes.create_string_buffer(4096)
    library.s_init(state, *[number(0.0)] * 4)
    found = [library.s_step(state, number(value)) for value in wave[:-1]]
    assert np.allclose(found, model.simulate(wave, 0.0)[1:], rtol=0, atol=1e-12)


AWKWARD = (
    "x", "past", "t", "k", "sample", "expected", "worst", "double", "case", "sin", "fabs", "main", "printf", "x0_1",
    "shared_0", "a_state", "a_real", "a", "INFINITY", "température", "2nd",
)  # fmt: skip


@needs_gcc
@pytest.mark.parametrize("state", ("x", "past", "sample", "double"))
def test_names_of_signals_do_not_matter(state, tmp_path):
    others = [n for n in AWKWARD if n != state]
    z = signal(state)
    total = sum((i + 1) * signal(n)[k - i % 3] for i, n in enumerate(others))
    recursion = Recursion(((z[k], z[k - 1] / 2 + sp.sin(total) + sp.Abs(total) / 9), (y[k], z[k] + y[k - 2] / 3)))
    path = tmp_path / "a.c"
    path.write_text(to_c(recursion, {}, "a"), encoding="utf-8")
    subprocess.run([gcc, *FLAGS, "-DA_SELF_TEST", path, "-o", tmp_path / "a", "-lm"], check=True, capture_output=True)
    assert "passed" in subprocess.run([tmp_path / "a"], capture_output=True, text=True, check=True).stdout
