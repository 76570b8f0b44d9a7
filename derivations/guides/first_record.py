# %% [markdown]
# # Your first record
# This page goes from a CSV file to an input with which the machine follows a reference: six commands, then the same
# in Python. The CSV file has a header `t,u,y`: time in seconds, input, output. (Other names: `--time`, `--input`,
# `--output`; no time column: `--ts 0.005`; some rows only: `--rows 20:5000`; several files are several experiments.)
#
# There is no real machine here: a simulated piezo actuator writes the two files.

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
# `fit` selects the terms by the error reduction ratio, imposes Sigma_y = 1, and fits one step ahead and
# from there in free run. Leave out a start transient (`--rows 20:`): it can change what is selected.
# `--for-compensation` only uses terms for which a law exists (Assumption A1), and skips models with an unstable law.

# %%
shell("narx-sym fit my_data.csv --for-compensation --out model.json")

# %% [markdown]
# ## Compare
# `compare` prints one-step **and** free-run errors: a small one-step error alone does not mean a good model. Here the
# data are those of the fit; always use a second file too (`--validate other.csv`). The free run covers the whole
# record, from start states that are estimated on it; with `--align` a constant offset of the sensor is estimated too.

# %%
shell("narx-sym compare model.json my_data.csv --units V,um --plot compare.png")

# %% [markdown]
# ## Derive
# `derive` prints Sigma_y, the equilibria and the quasi-static sets, where they are attracting, and which assumptions
# each term meets.

# %%
shell("narx-sym derive model.json --latex derivation.tex --plot sets.png")

# %% [markdown]
# ## Compensate
# `compensate` writes the law in your units, as C99 source with a self-test and as Structured Text for a PLC, and runs
# it along a reference. `wanted.csv` has one signal column. The law needs the reference `tau_d` samples ahead; at the
# end it repeats the last value. It starts from rest and prints the start values, for `simulate --u0 --y0`. A message
# tells if the reference or the input leaves the range, rate or frequency of the data of the fit, and by how much, or
# if the law amplifies its own errors. A law that diverges is refused.

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
# Terms are written as text, with any lags and the functions sign, abs, sin, cos, tanh, exp, Max, Min. `fit` returns
# the fitted model.

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
# MDF 4 (`.mf4`), TDMS and MATLAB 7.3 files are read directly (`pip install "narx-sym[logs]"`). Choose the channels by
# name, `--input Voltage --output Position`; if a name is wrong, the message suggests a similar one. Channels with
# different rates are interpolated to the time stamps of the fastest chosen one; a note says so.
#
# Units that stand in a log, or in the header of a CSV (`t,u [V],y [um]`, which `--input u` finds), are stored in the
# record and in the model that is fitted to it; tables, pictures, reports, laws and FMUs show them. `--units
# V,um,temp=degC` (input, output, channels by name) replaces them. The unit of a parameter follows from its term. For
# a model in V, a record in mV is converted, with a note; a record in A is refused. An unknown unit, such as `%` or
# `inc`, is only a label and is never converted.
#
# The coefficients of a law get their units in the same way: all terms of a sum have the same unit. A coefficient
# whose unit is not determined by this has none. `law.coefficients()` returns the units; the table after the law and
# the comments in exported C and Structured Text show them.

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
