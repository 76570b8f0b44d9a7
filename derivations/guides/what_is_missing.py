# %% [markdown]
# # What is missing?
# No model is complete. `diagnose` compares it with the measurements, shows where it fails, names the physical effect
# that would explain most of it, adds it, and shows the error fall. Where it names nothing it says how small an effect
# of the catalogue it could have missed.
#
# | verdict | it means |
# |---|---|
# | `nothing_detectable` | no effect of the catalogue improves the base by more than chance would; others are not excluded |
# | `named` | what one effect leaves no longer follows from the signals, or is less than a tenth of what it removes (rms), on data that were not used for fitting. It is the best of the catalogue; something outside of it may draw the same curve |
# | `confused` | several effects explain it equally well; an input that would tell them apart is proposed (`next.csv`). `base` in the set means the memory of the base itself: at one speed it and a friction or a slack are one signal, and the model that is shown has the effect in its stead |
# | `helps_but_incomplete` | the best effect helps, and something else is missing too. Where two effects hide each other they are added together (`together` in the JSON): raise `--max-effects` |
# | `outside_library` | no effect of the catalogue explains it; look at where the model fails |
# | `closed_loop` | the input answers the output, as that of a controller does: what the controller does would be taken for the plant. An effect is named all the same where the setpoint is given (`--channels setpoint`), makes nine tenths of the input's movement, and one effect removes nine tenths of the squared error. Else nothing is named: record with the controller in manual. Of a loop whose output is in percent, a fraction or mA it is said whether its valve sticks; it may where the setpoint never moves, and that nothing is seen is no proof |
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
# `--machine` (`machine=`) says what was measured: thermal, tank, drive, motion-force (what is moved and gives a force),
# smart-material, soft, propeller, valve, structure, circuit, battery, process or pendulum. Effects that are impossible
# there are not considered, and listed; what is one thing there is one name (in a heater a quadratic and a hardening
# spring both are "a loss that grows faster than linearly"); and a few effects are tried only there, such as gravity of
# a pendulum. Units tell it where only one kind of machine has them, as W -> degC; that is printed, and `--machine none`
# switches it off. `--role command=setpoint,speed=derivative-of-y` (`roles=` of `ns.read`) says what further columns are.

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
# Every effect is a direction: the derivative of the free run with respect to its coefficient, derived by SymPy for
# each place where it may act (at the input, as a force or inside, on the motion, in a friction, at the output, at the
# sensor) and compiled. What a refit of the base could absorb is projected out. The gate tests all effects and shapes
# at once against simulated maxima, after whitening with a noise model. Then each form of each effect is fitted in
# free run beside cores of several orders and delays, cross-validated on held-out blocks, and stands in one table with the
# cores that have no effect. One price decides: the logarithm of the held-out error, plus 0.1 per parameter, plus 0.27
# per effect. A further resonance counts as an effect, and so does a lag of an effect's own where the linear core has
# no such pole. Where no effect is enough, the pairs that explain most together are fitted too. What the new effect
# makes redundant is deleted, and a share of an effect that cannot be told from 1 goes: a slack is whole, and its law
# that of textbooks. How often all this is right, and where it is not: [](../results/named.md).
#
# In the end the base and what was found are fitted once more, over the whole records at their own rate, and judged by
# [the protocol](what_the_figures_mean.py): on the records, and on validation data that no model is fitted to. These are
# the records of `validation=` (`--validate`), else the last part of each record. **An effect is only added where the
# error falls on both.** Where it falls on the record and rises on the validation data, that is what is said.
#
# ## The next experiment
# Where several effects explain a record, some 30 inputs are simulated with each of them: ramps, triangles, stairs, sines,
# fast moves, noise, rest. Proposed is the one on which the two that come closest differ most after a refit. It keeps the
# range and the rate of the record; `limits=(-5, 5)`, on the command line `--limits -5 5`, says what the actuator may do.
# Some pairs differ only further out: a cubic and a saturation are one curve until they bend. Where the present range does
# not decide, twice that range is looked at: the sentence says what it would show, and `next_wider.csv` has the input.
#
# ## Show it
# One HTML file tells the story: what was found and what to do next, measured and simulated, the error step by step,
# where the model fails, the candidates, the model before and after, what follows from it, the next experiment, and
# where the figures come from. It needs no network, prints well, and follows light and dark. The numbers behind the
# pictures, the model file and the next input can be downloaded from it. Long lines are thinned to the extremes of each
# interval: a record of 50 000 samples gave a page of 2.1 MB in 3 to 5 s beyond the diagnosis
# (`python tests/bench/report.py`).
#
# In *Try it* the page itself runs the base and the candidates over the record (two float32 numbers per sample, of a very
# long record the first 200 000 samples): move a parameter, and loop, error and rms follow; the optimum and its two
# standard errors are marked. A dot of the maps of errors zooms to where its cell is worst. Drag the reference, and see
# the input of the law. The recursions stand in the page as `model.export("js")` writes them, so it works without a network
# and without `eval`. The same part stands in a notebook (`pip install "narx-sym[notebook]"`, Jupyter and marimo):
# `tried = found.live()`, then `tried.model` is the model with the parameters as the sliders stand.

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
# opens a page in your browser where the same way is walked with clicks: drop a CSV, choose columns, rows and a base, see
# the panels of the report, point at a candidate to see its run, press *Add* and watch the error fall, undo and redo
# (Ctrl+Z, Ctrl+Y), change a term as text, move a parameter with the sliders of the report, open the
# compensator, take away the model, its LaTeX and C, the law and the report. What is wrong with a field stands at that field, which keeps what was typed, until it is right.
#
# Long work runs in a process of its own, which *Cancel* ends; everything stays as it was before. A bar shows the step of
# how many, and beside it stands what the best row so far removes of the squared error; the terminal shows the same line.
# In Python, `report=` hears it: each text has the attributes `stage`, `stages`, `done`, `of`, `found` and `fraction`.
#
# Under *Law* the law runs over a reference: the measured output or its first seconds, a sine, a staircase, a drawing, or a
# column of a CSV, within limits of the input and of its change per sample. A drawing is made in a picture where the
# identified range of the output is shaded: press and draw, click for a point, drag a point; or go from point to point with
# Tab and move it with the arrows, Enter sets a point, Delete takes it away, Ctrl+Z takes back. Its points stand below as
# text, which may be typed or pasted: a time and a level in each line. It is sampled as often as the record, straight
# between points, level before the first and after the last (`drawn` in `narx_sym.tasks.reference`). Where the
# compensator was opened with limits of the input, dashed lines mark where the model rests at them. Shown are the reference, the model's output with the law
# and without (there the straight line through the data is inverted, within the same limits), the input, the errors as
# rms and largest value, and in how many samples limits hold the input; time, reference, input and output are a CSV to
# take away. A run belongs to its model: it goes with an undo, and comes back with a redo. In Python:

# %%
piece = usual(record)
reference = sine(record.Ts, piece.offset, piece.amplitude, piece.frequency, seconds=2 / piece.frequency)
run = track(better.compensator(), reference, limits=(float(record.u.min()), float(record.u.max())))
for name, (rms, largest) in run.errors.items():
    print(f"{name}: {rms:.3g} um rms, {largest:.3g} um at most")

# %% [markdown]
# The page listens on 127.0.0.1 only, refuses requests with a foreign Host or Origin, asks no other machine for anything
# and takes uploads up to `--max-mb` (50) into a private folder that is removed at the end (Ctrl-C). Every page
# that is opened has its own data, under an address that is drawn at random; loaded anew, it shows them again. Whoever
# else is logged in on the same machine may open a page too, and then sees the file named on the command line. `--port`, `--no-browser`.

# %%
assert found.best.effect == "hysteresis" and "hysteresis" in found.confusion_set
assert after.free_run_mape < before.free_run_mape / 10
assert 100_000 < size < 5_000_000 and live >= 2
assert run.errors["with the law"][0] < run.errors["without"][0]
