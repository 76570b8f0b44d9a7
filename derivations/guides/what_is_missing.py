# %% [markdown]
# # What is missing?
# No model is complete. `diagnose` compares a model with measurements, shows where it fails, finds the physical effect
# that explains most of the error, adds it, and compares the errors. If it finds no effect, it says how large an
# effect would have to be to be detected.
#
# | verdict | it means |
# |---|---|
# | `nothing_detectable` | no effect of the catalogue improves the base model more than by chance; other effects are not excluded |
# | `named` | one effect explains the error: on data that were not used in the fit, the rest can no longer be predicted from the signals, or is less than a tenth (rms) of what the effect removes. It is the best effect of the catalogue; an effect outside the catalogue may look the same |
# | `confused` | several effects explain the error equally well; an input that distinguishes them is proposed (`next.csv`). `base` in the set means the dynamics of the base model itself: at one speed they cannot be distinguished from a friction or a slack; the model shown has the effect instead |
# | `helps_but_incomplete` | the best effect helps, but something else is missing too: use a larger `--max-effects`. Two effects that only help together are added together (`together` in the JSON) |
# | `outside_library` | no effect of the catalogue explains it; look at where the model fails |
# | `closed_loop` | the input reacts to the output, as in closed loop, so the controller could be mistaken for the plant. An effect is only named if the setpoint is given (`--channels setpoint`) and causes nine tenths of the input's movement, and the effect removes nine tenths of the squared error. Otherwise record in manual mode. If the controller output is in percent, a fraction or mA, the valve is checked for stiction; if none is found, this is no proof |
#
# The same on the command line:
#
# ```console
# narx-sym diagnose stage.csv --base linear --max-effects 3 --units V,um --json found.json --save better.json --plot found.png --report found.html
# narx-sym compare better.json stage.csv
# narx-sym add model.json backlash stage.csv --out model2.json
# narx-sym effects
# ```
#
# ## What you know of the machine
# `--machine` (`machine=`) gives the kind of machine: thermal, tank, drive, motion-force (a moved part with a measured
# force), smart-material, soft, propeller, valve, structure, circuit, battery, process or pendulum. Effects that are
# impossible there are listed and not considered. Effects that mean the same there have one name: in a heater a
# quadratic and a hardening spring are both "a loss that grows faster than linearly". A few effects are tried only
# there, such as gravity of a pendulum. If the units fit only one kind of machine, such as W -> degC, it is chosen
# automatically; this is printed, and `--machine none` switches it off. `--role
# command=setpoint,speed=derivative-of-y` (`roles=` of `ns.read`) gives the meaning of further columns.

# %%
import tempfile
from pathlib import Path

import narx_sym as ns
from narx_sym import plants
from narx_sym.tasks.compensate import track
from narx_sym.tasks.reference import sine, usual

volts = plants.filtered_noise(N=5000, Ts=0.01, cutoff=0.5, peak=75.0, seed=5)
record = ns.Record.from_arrays(volts, plants.bouc_wen(volts, Ts=0.01), Ts=0.01)

# %% [markdown]
# ## A base, and what it lacks
# The actuator has hysteresis; a linear model has none.

# %%
linear = ns.identify(record, base="linear")  # or "static", "narx", or a model of your own
found = ns.diagnose(linear, record, max_effects=1)
print(found.sentence({"u": "V", "y": "um"}))
print(found.verdict, found.confusion_set, found.best.effect)

# %%
found.plot_ladder()

# %%
found.plot_candidates()

# %%
found.plot_where_it_fails({"u": "V", "y": "um"})

# %% [markdown]
# ## Add it
# `found.model` is the fitted result. The step alone, or an effect of your choice: `add`, then `fit`.

# %%
better = linear.add(found.best).fit(record)  # or linear.add("backlash").fit(record)
print(ns.latex(better))
before, after = ns.evaluate(linear, record), ns.evaluate(found.model, record)
print(f"free-run error of the record's range: {before.free_run_mape:.3g} % before, {after.free_run_mape:.3g} % after")

# %% [markdown]
# ## How it decides
# First comes a score test. For each effect SymPy derives the derivative of the free run with respect to its
# coefficient, at each place where the effect may act (at the input, as a force or inside, on the motion, in a
# friction, at the output, at the sensor). What the parameters of the base model can reproduce is projected out. The
# test compares all effects and shapes at once with simulated maxima, after whitening with a noise model. Then each
# form of each effect is fitted in free run, together with linear parts of several orders and delays, and
# cross-validated; linear parts without an effect are compared in the same way. The best model has the smallest
# penalised log loss: the logarithm of the cross-validated error, plus 0.1 per parameter, plus 0.27 per effect. A
# further resonance counts as an effect, and so does a lag inside an effect if the linear part has no such pole. If no
# single effect is enough, pairs are fitted too. Terms that the effect makes redundant are deleted, and a coefficient
# that cannot be distinguished from 1 is fixed to 1. How often the result is correct: [](../results/named.md).
#
# At the end the base model and the model with the effect are fitted again, on the whole records at their sampling
# rate, and their errors are computed by [the protocol](what_the_figures_mean.py): on the records, and on validation
# data that no model is fitted to. Validation data are the records of `validation=` (`--validate`), else the last part
# of each record. **An effect is only added if the error falls on both.** If it rises on the validation data, the
# report says so.
#
# ## The next experiment
# If several effects explain a record, about 30 inputs are simulated with each of them: ramps, triangles, stairs,
# sines, fast moves, noise, rest. The proposed input is the one for which the two most similar effects differ most
# after a refit. It stays within the range and rate of the record; `limits=(-5, 5)` (`--limits -5 5`) gives the range
# of the actuator. Some effects only differ for larger inputs, such as a cubic and a saturation. If the present range
# does not decide, twice the range is tried as well: the sentence gives the difference there, and `next_wider.csv`
# contains the input.
#
# ## Show it
# One HTML file shows the result: what was found and what to do next, measured and simulated output, the errors step
# by step, where the model fails, the candidates, the model before and after, the derived sets and law, the next
# experiment, and the data and settings. It needs no network, can be printed, and has a light and a dark mode. The
# numbers of the pictures, the model file and the next input can be downloaded from it. Long curves are reduced to the
# extremes of each interval: for a record of 50 000 samples the page had 2.1 MB and took 3 to 5 s in addition to the
# diagnosis (`python tests/bench/report.py`).
#
# In *Try it* the page itself simulates the base model and the candidates (two float32 numbers per sample; of a very
# long record the first 200 000 samples). Move a parameter, and loop, error and rms change; the fitted value and its
# two standard errors are marked. Click a dot in the pictures of the errors to zoom to the largest error of its cell.
# Drag the reference, and see the input that the law computes. The page contains the equations as written by
# `model.export("js")`, so it needs no network and no `eval`. A notebook can show the same part (`pip install
# "narx-sym[notebook]"`, Jupyter and marimo): `tried = found.live()`, then `tried.model` is the model with the
# parameters as the sliders stand.

# %%
with tempfile.TemporaryDirectory() as folder:
    page = Path(folder) / "found.html"
    found.report(page, units={"u": "V", "y": "um"})
    size, live = page.stat().st_size, page.read_text(encoding="utf-8").count(".simulate(inputs, start, parameters)")
print(f"{size / 1e6:.1f} MB")

# %% [markdown]
# ## On a page, with clicks
#
# ```console
# pip install "narx-sym[app]"
# narx-sym app stage.csv
# ```
#
# opens a page in your browser for the same steps: drop a data file, choose columns, rows and a base model, see the
# panels of the report, point at a candidate to see its simulation, press *Add* to add it, undo and redo (Ctrl+Z,
# Ctrl+Y), edit a term as text, move a parameter with the sliders of the report, derive the compensator, and download
# the model, its LaTeX and C, the law and the report. An error message stands at the field that caused it until the
# field is correct.
#
# Long computations run in a separate process. *Cancel* stops it and changes nothing. While effects are searched, the
# page shows the base and what it lacks, and the best effects so far with bars of the error that they leave; *Take the
# best so far* ends the search with these. In Python, `report=` receives the same: each text has the attributes `stage`,
# `stages`, `done`, `of`, `removed`, `found` and `fraction`, the one of the fitted base a `look()` at it, and a listener
# that returns True ends the search.
#
# Under *Law* the law runs along a reference: the measured output or its first seconds, a sine, or a column of a
# file, within limits of the input and of its change per sample. The page shows the reference, the output of the model
# with the law and without it (with the inverse of the straight line through the data, within the same limits), the
# input, the rms and largest errors, and the number of samples at a limit. Time, reference, input and output can be
# downloaded as CSV. Undo and redo
# apply to a run too. In Python:

# %%
piece = usual(record)
reference = sine(record.Ts, piece.offset, piece.amplitude, piece.frequency, seconds=2 / piece.frequency)
run = track(better.compensator(), reference, limits=(float(record.u.min()), float(record.u.max())))
for name, (rms, largest) in run.errors.items():
    print(f"{name}: {rms:.3g} um rms, {largest:.3g} um at most")

# %% [markdown]
# The page listens on 127.0.0.1 only, refuses requests with a foreign Host or Origin, sends nothing to other machines,
# and saves uploads up to `--max-mb` (50) into a private folder that is removed at the end (Ctrl-C). Every opened page
# has its own data and a random address; after a reload it shows them again. Other users of the same machine can open
# a page too, and then see the file named on the command line. `--port`, `--no-browser`.

# %%
assert found.best.effect == "hysteresis" and "hysteresis" in found.confusion_set
assert after.free_run_mape < before.free_run_mape / 10
assert 100_000 < size < 5_000_000 and live >= 2
assert run.errors["with the law"][0] < run.errors["without"][0]
