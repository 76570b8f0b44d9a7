# %% [markdown]
# # Your first record
# From a CSV to an input that makes the machine follow a reference: six commands, then the same in Python. The CSV has
# a header `t,u,y`: time in seconds, input, output. (Other names: `--time`, `--input`, `--output`; no time column:
# `--ts 0.005`; some rows only: `--rows 20:5000`; several files are several experiments.)
#
# This page has no machine, so a simulated piezo actuator writes the two files.

# %%
import os
import subprocess
import sys
import tempfile

import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import k, phi1, plants, plots, u, y

folder = tempfile.TemporaryDirectory()
home = os.getcwd()
os.chdir(folder.name)
t = 0.01 * np.arange(5000)
volts = plants.filtered_noise(N=5000, Ts=0.01, cutoff=0.5, peak=75.0, seed=5)
measured = np.column_stack([t, volts, plants.bouc_wen(volts, Ts=0.01)])
np.savetxt("my_data.csv", measured, fmt="%.8g", delimiter=",", header="t,u,y", comments="")
wanted = np.column_stack([t[:1000], 30 * np.sin(t[:1000])])
np.savetxt("wanted.csv", wanted, fmt="%.8g", delimiter=",", header="t,r", comments="")


def shell(line):
    """Run a command and print what it prints."""
    command = [sys.executable, "-m", "narx_sym", *line.split()[1:]]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "COLUMNS": "110"})
    print(done.stdout if done.returncode == 0 else done.stderr)
    assert done.returncode == 0, line


# %% [markdown]
# ## Fit
# `fit` selects the terms by the error reduction ratio, imposes Sigma_y = 1, fits one step ahead and in free run, and
# keeps the better free run. Leave out a start transient (`--rows 20:`): it can change what is selected.
# `--for-compensation` keeps the model invertible (Assumption A1) and passes over models whose law would run away.

# %%
shell("narx-sym fit my_data.csv --for-compensation --out model.json")

# %% [markdown]
# ## Compare
# One-step **and** free-run errors: one-step accuracy alone says nothing. Here it is the file of the fit; always try one
# that was not used in the fit (`--validate other.csv` puts it beside). The free run covers the whole record, from start
# states that are estimated on it; with `--align` a constant offset of the sensor is estimated too.

# %%
shell("narx-sym compare model.json my_data.csv --units V,um --plot compare.png")

# %% [markdown]
# ## Derive
# Sigma_y, the equilibria, the quasi-static sets, where they attract, and which assumption each term meets.

# %%
shell("narx-sym derive model.json --latex derivation.tex --plot sets.png")

# %% [markdown]
# ## Compensate
# The law in your units, as C99 source with a self-test and as Structured Text for a PLC, and run over a reference.
# `wanted.csv` has one signal column; the law looks `tau_d` samples ahead and holds the last value at the end. It starts
# from rest and prints where; `simulate --u0 --y0` starts there too. A reference or an input beyond the range, rate or
# frequency seen in identification is said, with by how much, and so is a law that amplifies its own errors; one that
# runs away is refused.

# %%
shell("narx-sym compensate model.json --latex law.tex --c law.c --st law.st")
shell("narx-sym compensate model.json --reference wanted.csv --out input.csv")
shell("narx-sym simulate model.json input.csv --input m --u0 0 --y0 0 --out expected.csv")

# %% [markdown]
# After a run on the machine, log reference, compensated input and output in one file:
# `narx-sym compare model.json log.csv --input m --reference r` gives tracking error and effort (NSAVI).
#
# ## The same in Python

# %%
record = ns.read("my_data.csv", u="u", y="y")  # gaps, jitter, rounding: said in record.notes
model = ns.identify(record, base="narx", for_compensation=True)
print(ns.latex(model))
print(f"Sigma_y = {model.sigma_y}, theta = {np.round(model.theta, 5)}")

# %%
law = model.compensator()
print(ns.latex(law))
print("put back into the model it gives r[k+tau_d], up to:", law.residual())
m = law.run(wanted[:, 1], m0=0.0)
position = plants.bouc_wen(m, Ts=0.01)
plain = plants.bouc_wen(wanted[:, 1], Ts=0.01)
errors = ns.mape(wanted[:, 1], plain), ns.mape(wanted[:, 1], position)
print(f"mean error, share of the range: {errors[0]:.2f} % without the law, {errors[1]:.2f} % with it")

# %%
figure, ax = plots.new_axes(figsize=(6, 4))
ax.plot(wanted[:, 1], plain, color=plots.RED, label="the reference as voltage")
ax.plot(wanted[:, 1], position, color=plots.BLUE, label="through the law")
ax.set(xlabel="wanted [um]", ylabel="simulated machine [um]")
ax.legend()
figure

# %% [markdown]
# ## A model of your own
# Terms are text, with any delay, lag and the functions sign, abs, sin, cos, tanh, exp, Max, Min. A fit returns the
# fitted model.

# %%
small = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"])
small = small.fit(record, constraints=["continuum"], method="free_run")  # or [sympy.Eq(small.sigma_y, 1), ...]
pool = ns.pool(n_y=1, n_u=2, degree=3, rules=ns.assumptions.CONTINUUM)
print(pool, *list(dict.fromkeys(v.reason for v in pool.excluded))[:4], sep="\n")

# %% [markdown]
# A physical equation that is not linear in its parameters is a `Model`; it is fitted in free run with derived
# sensitivities, like every other model. Here it is the simulated actuator's own equation, so its four numbers come back.

# %%
a, b, c, d = sp.symbols("a b c d", real=True)
h = d * u[k - 1] - y[k - 1]
bouc_wen = ns.Model(y[k - 1] + a * phi1[k] + b * abs(phi1[k]) * h + c * phi1[k] * abs(h), (a, b, c, d), [1, 0, 0, 2])
bouc_wen = bouc_wen.fit(record, method="free_run")
print(ns.latex(bouc_wen))
print(f"a, b, c, d = {np.round(bouc_wen.theta, 4)}, simulated with 0.7, 0.008, 0.008, 1.6")

# %% [markdown]
# ## Logs of measuring systems
# MDF 4 (`.mf4`), TDMS and MATLAB 7.3 are read where they are (`pip install "narx-sym[logs]"`): choose the channels by name,
# `--input Voltage --output Position`; a name that is not there is answered with the one that may be meant. Channels of
# several rates are interpolated to the stamps of the fastest of those chosen, and that is said.
#
# Units that stand in a log, or in the header of a CSV (`t,u [V],y [um]`, which `--input u` finds), go with the record and
# with the model that is fitted to it: tables, pictures, reports, laws and FMUs have them. What `--units V,um,temp=degC` says
# (of the input, the output, and channels by name) wins. The unit of a parameter follows from the term that it multiplies. A
# record in mV is converted for a model in V, and that is said; one in A is refused. A unit that is not known, such as `%` or
# `inc`, is a label that converts to nothing else.
#
# The numbers of a law get their units in the same way: what is added up has one unit, every equation is an equation for
# units too, and what these leave open has none. `law.coefficients()` has them, a table after the law and a line in the
# comment of exported C and Structured Text tell them.

# %%
log = None
try:
    import nptdms
except ImportError:
    print("npTDMS is not installed here")
else:
    rates = {"wf_increment": 0.01, "wf_start_offset": 0.0}
    channels = {
        "Voltage": (volts, rates | {"unit_string": "V"}),
        "Position": (measured[:, 2], rates | {"unit_string": "um"}),
        "Temperature": (np.linspace(20, 21, 501), {"wf_increment": 0.1, "wf_start_offset": 0.0}),
    }
    with nptdms.TdmsWriter("log.tdms") as file:
        file.write_segment([nptdms.ChannelObject("stage", n, x, properties=p) for n, (x, p) in channels.items()])
    log = ns.read("log.tdms", u="Voltage", y="Position", channels=["Temperature"])
    print(log, *log.notes, sep="\n")

volts_in = ns.Record.from_arrays(volts, measured[:, 2], Ts=0.01, units={"u": "V", "y": "um"}, name="in V")
gain = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"]).fit(volts_in)
milli = ns.Record.from_arrays(1000 * volts, measured[:, 2], Ts=0.01, units={"u": "mV", "y": "um"}, name="in mV")
print(ns.evaluate(gain, milli))
try:
    ns.evaluate(gain, ns.Record.from_arrays(volts, measured[:, 2], Ts=0.01, units={"u": "A", "y": "um"}, name="in A"))
except ns.DataError as error:
    print(error)

stage = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"]).fit(volts_in, ["continuum"])
stage_law = stage.compensator()
print(*stage_law.lines(numbers=True), *((c.values, c.unit) for c in stage_law.coefficients()), sep="\n")

# %%
assert {c.unit for c in stage_law.coefficients()} == {"V/um", "1/V"}
assert log is None or log.units == {"u": "V", "y": "um"}
assert np.isclose(ns.evaluate(gain, milli).free_run_nrmse, ns.evaluate(gain, volts_in).free_run_nrmse)
assert log is None or (np.array_equal(log.u, volts) and abs(log.channels["Temperature"][10] - 20.002) < 1e-9)
files = "model.json compare.png derivation.tex sets.png law.tex law.c law.st input.csv expected.csv".split()
assert all(os.path.getsize(name) > 0 for name in files)
expected, planned = ns.read("expected.csv"), ns.read("input.csv", u="m", y="r")
os.chdir(home)
folder.cleanup()
assert ns.metrics.nrmse(planned.y, expected.y) < 0.02  # the law inverts the model
assert law.residual() == 0 and errors[1] < errors[0] / 5
assert np.allclose(bouc_wen.theta, [0.7, 0.008, 0.008, 1.6], rtol=0.02)
