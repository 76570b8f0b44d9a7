# %% [markdown]
# # A law on a PLC, and elsewhere
# Models (with their added effects) and laws can be exported as source code or as objects of other libraries:
#
# | call | it gives |
# |---|---|
# | `law.export("c")`, `model.export("c", single=True)` | one C99 file: state in a struct, `law_init`, `law_step`, no heap, a self-test behind `-DLAW_SELF_TEST` |
# | `law.export("st")`, `model.export("st")` | an IEC 61131-3 `FUNCTION_BLOCK` in LREAL or REAL that starts from rest in its first scan |
# | `law.export("plcopen")`, `model.export("plcopen")` | PLCopen XML (TC6 2.01) to import: the same block, and a program that tests it on the controller |
# | `model.export("fmu")`, `law.export("fmu2")` | the bytes of an FMU for co-simulation, FMI 3.0 or 2.0: source, binary, tunable parameters |
# | `model.export("js")`, `law.export("js")` | a JavaScript constant for a page or Node: `simulate` over whole arrays, the parameters as arguments |
# | `model.export("casadi")`, `law.export("casadi")` | one step as a CasADi `Function` (state, inputs) -> (next, output) |
# | `model.to_control()` | a `control.NonlinearIOSystem` with dt = Ts (`pip install "narx-sym[interop]"`) |
# | `model.to_sysidentpy()` | a polynomial model as a fitted `FROLS` of SysIdentPy, with the same free run |
# | `fit.interop.from_sysidentpy(frols)` | the other way: a fitted polynomial model of SysIdentPy, each theta at its term |
# | `narx_sym.sklearn.NARXRegressor()` | `identify` as a scikit-learn estimator for its searches and splitters (`pip install "narx-sym[sklearn]"`) |
#
# ## A model whose law has cases
# In the physical actuator the newest input is inside |phi1|, and a dead zone was added. You need no code of your own:
# the model is inverted in stages, y <- x <- v <- u, each of them one equation in one unknown. The internal states of
# effects are computed in parallel.

# %%
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import k, phi1, plants, u, y

a, b, c, d = sp.symbols("a b c d", real=True)
h = d * u[k - 1] - y[k - 1]
actuator = ns.Model(
    y[k - 1] + a * phi1[k] + b * abs(phi1[k]) * h + c * phi1[k] * abs(h),
    (a, b, c, d),
    [0.7, 0.008, 0.008, 1.6],
    Ts=1e-3,
)
volts = plants.filtered_noise(N=10_000, peak=75.0, seed=1)
slack = np.sign(volts) * np.maximum(np.abs(volts) - 4.0, 0.0)  # the amplifier answers beyond 4 V only
record = ns.Record.from_arrays(volts, plants.bouc_wen(slack), Ts=1e-3)
model = actuator.add("dead_zone").fit(record)
law = model.compensator()
print(ns.latex(law))
print(f"closed form: {law.closed_form}; looks {law.preview} samples ahead; checked: {law.checked}")

# %% [markdown]
# Piecewise functions (dead zone, play, saturation, Bouc-Wen) are solved branch by branch, quadratics and tanh in
# closed form, and others by a root finder. Then `closed_form` is False, and source code is only exported if it is
# proved that there is exactly one root, which is found in a fixed number of steps. If a dead zone or a play allows
# several inputs, the one closest to the last input is chosen.
#
# ## Limits of the machine
# `limits` is the actuator's range, `rate` its largest change per sample. If a reference cannot be reached, an error
# names the first sample. With `clip=True` or limits the law comes as close as possible instead, and a message gives
# the fraction of such samples. Exported code always comes as close as possible: if some references are out of reach,
# it also computes the model, and the law continues from the model's output. It starts from the two values `m` and `y`
# at rest (see `law.start`).

# %%
reference = 30 * np.sin(2 * np.pi * 1e-3 * np.arange(3000))
run = law.follow(reference, limits=(-60, 60), rate=5)
print(
    f"held at a limit: {np.mean(run.held):.1%} of the samples, farthest from the reference {np.abs(run.error).max():.2g} um"
)

# %% [markdown]
# On the command line: `narx-sym compensate model.json --reference wanted.csv --out input.csv --limits -60 60 --rate 5`.
#
# ## Go or no go
# Before the law runs on the machine, `commission` predicts its error. The input of the law is applied to many models
# that fit the records (moving-block bootstrap), and a part of the unexplained error on the records, resampled, is
# added to each run. The error on 20 machines that were not in the records lies in the 95 % band for 95 % of the
# samples (`tests/tasks/test_commission.py`); for very short records (a few correlation lengths of the noise) less
# often. The result lists all reasons against the run: an input at its limits or outside the recorded range, rate or
# frequency, an unstable law, or an error that is no smaller than without the law. "Without the law" means the
# constant gain and offset that bring the model closest to this reference, so a lag in the records does not make the
# law look better than it is.

# %%
before = law.commission(reference, record, limits=(-60, 60), rate=5, draws=50)
print(before.sentence())
assert before.expected < before.without

# %% [markdown]
# On the command line, with a picture: `narx-sym commission model.json my_data.csv --reference wanted.csv --limits -60 60`.
#
# ## Where it starts, and when it rings
# Without `m0` a law starts from the input for which the first output is a steady state of the model, within the
# recorded inputs and the limits. The poles of a law are the zeros of the model. A zero near -1, caused by a fast
# resonance or half a sample of delay, makes the input alternate from sample to sample; a zero below -1 makes it
# diverge. Then the law is damped: in each sample only the fraction $a$ of the computed change is applied, $m[k] =
# m[k-1] + a (\tilde m[k] - m[k-1])$, and the model computed with the law corrects the rest later. With $A y = q^{-1}
# B m$ the poles are the zeros of $a B + (1 - a)(1 - q^{-1}) b_0 A$. The fraction is chosen so that a disturbance
# decays as fast as possible; `share=None` (`--share none`) switches damping off.

# %%
b_0 = 0.23
poles, zero = (1.2, -0.65), -1.05
resonance = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [*poles, b_0, -zero * b_0], Ts=1e-3)
ringing = resonance.compensator()
print(ringing.damping().sentence)
smooth = 20 - 20 * np.cos(np.pi * np.minimum(np.arange(1500) / 1000, 1))
calm = ringing.run(smooth, 1.0)

# %% [markdown]
# ## Structured Text

# %%
block = law.export("st", limits=(-60, 60), rate=5)
print(block[block.index("FUNCTION_BLOCK") :][:900], "...")

# %% [markdown]
# Development systems import PLCopen XML: `narx-sym compensate model.json --export law.xml`. The program `law_test` beside
# the block takes one sample per scan; then `finished` is TRUE, and `passed` where every value was the one computed here.

# %%
project = law.export("plcopen", limits=(-60, 60), rate=5)
print(project[project.index('<pou name="law_test"') :][:400], "...")

# %% [markdown]
# ## C
# With a compiler at hand the file tests itself; the figures it compares with were computed here.

# %%
source = law.export("c", limits=(-60, 60), rate=5)
print(source[source.index("#include") :][:900], "...")
passed = None
if compiler := shutil.which("gcc") or shutil.which("cc"):
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "law.c").write_text(source)
        subprocess.run(
            [compiler, "-std=c99", "-O2", "-DLAW_SELF_TEST", "law.c", "-o", "law", "-lm"], cwd=folder, check=True
        )
        passed = subprocess.run([Path(folder, "law")]).returncode == 0
print("self-test passed:", passed)

# %% [markdown]
# ## FMU
# For co-simulation in other tools, FMI 3.0 or 2.0. The C source is inside, and a binary for this machine where a
# compiler is found. Parameters are tunable, the values before the start (`u_rest`, `y_rest`) are parameters too; the
# communication step is a multiple of Ts, any other is an error with a message. A step takes the inputs as they are at its
# beginning, and after it they can no longer be changed. A model whose newest input is u[k-1] or older ends the step of
# sample k with y[k+1]: it is the free run, in time. What answers an input at once is one sample late, a model with u[k] in it
# and every law: a step from sample k takes r[k+1], or what the preview of the law is, and ends with m[k]. To have m in time,
# give the reference one sample earlier: at the time t the one of t + 2 Ts in the place of t + Ts. Then law and plant in one
# co-simulation follow it exactly; the description inside says which of both an FMU is. On the command line:
# `narx-sym compensate model.json --fmu law.fmu` (`--fmu2` for FMI 2.0). `pip install "narx-sym[fmu]"` brings fmpy, which
# checks and runs such files; writing them needs nothing beside the C compiler.

# %%
stage = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], [1.2, -0.4, 0.2], Ts=1e-3)
wave = np.sin(np.arange(500) / 30)
gap = None
with tempfile.TemporaryDirectory() as folder:
    Path(folder, "stage.fmu").write_bytes(stage.export("fmu", units={"u": "V", "y": "um"}))
    try:
        import fmpy
    except ImportError:
        fmpy = None
    if fmpy and compiler:
        given = np.rec.fromarrays([np.arange(500) * 1e-3, wave], names=["time", "u"])
        other = fmpy.simulate_fmu(
            f"{folder}/stage.fmu", input=given, output=["y"], step_size=1e-3, output_interval=1e-3, stop_time=0.499
        )
        gap = np.abs(other["y"] - stage.simulate(wave, 0.0, u0=0.0)).max()
print("farthest from the free run:", gap)

# %% [markdown]
# ## JavaScript
# The parameters are arguments, so a page can move them: the report's sliders run this text. It needs no `eval`.

# %%
script = model.export("js")
print(script[script.index("function simulate") :][:700], "...")

# %% [markdown]
# ## CasADi
# `recursion.past` and `recursion.given` are the orders of the state and of the inputs; for a law those of `law.exported()`.

# %%
step = model.export("casadi")
print(model.recursion.past, model.recursion.given)
state, output = step(model.rest_state(u=0.0, y=0.0), [1.0])
print(output)

# %% [markdown]
# ## The law's own dynamics
# A law remembers. Where its Jacobian, apart from the eigenvalue that is exactly 1 (every law of a Sigma_y = 1 model
# integrates), is beyond 1, a disturbance of m grows from sample to sample. `compensate` says so for the identified
# range; `law.run` warns when a reference leads there for so long that a disturbance doubles, with share, first time,
# growth, and whether it shrinks again: a short visit is not a divergence. [](../examples/V1_valve.py) has the example.
# A sign that makes m chatter can be smoothed before or after the fit: [](../examples/B2_smooth_sign.py).

# %%
terms = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"]
polynomial = ns.NARX.from_terms(terms).fit(record, constraints=["continuum"])
inside = polynomial.compensator().internal  # Jacobian, fixed points, where it attracts
print("repelling where", ns.latex(inside.region))
soft = polynomial.compensator().smooth()  # sign(x) -> tanh(x/eps)
print(*soft.lines(), sep="\n")

# %%
assert "eval" not in script and all(f'"{s}"' in script for s in model.symbols)
assert law.closed_form and "FUNCTION_BLOCK" in block and "law_step" in source
assert passed in (True, None)
assert project.count("<pou ") == 2
assert gap is None or gap <= 1e-9
assert run.m.min() >= -60 and run.m.max() <= 60 and np.abs(np.diff(run.m)).max() <= 5 + 1e-9
tracked = plants.bouc_wen(np.sign(run.m) * np.maximum(np.abs(run.m) - 4.0, 0.0))[1000:]
assert ns.mape(reference[1000:], tracked) < 1
part = ringing.share()
locus = part * np.array([b_0, -zero * b_0, 0, 0]) + (1 - part) * b_0 * np.convolve([1, -1], [1, *np.negative(poles)])
assert np.abs(np.roots(locus)).max() < 0.8 < abs(zero)
assert np.abs(np.diff(calm[50:])).max() < 3 * np.abs(np.diff(smooth)).max()
assert np.abs(resonance.simulate(calm, 0.0, u0=0.0) - smooth)[100:].max() < 0.0035 * 40
assert "tanh" in " ".join(soft.lines())
