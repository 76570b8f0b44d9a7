# %% [markdown]
# # What the figures mean
# This page explains the figures that appear everywhere. Each is computed by hand and by the package.

# %%
import numpy as np

import narx_sym as ns
from narx_sym import plants

volts = plants.filtered_noise(N=5000, Ts=0.01, cutoff=0.5, peak=75.0, seed=5)
rng = np.random.default_rng(0)
clean = plants.bouc_wen(volts, Ts=0.01)
record = ns.Record.from_arrays(volts, clean + 0.2 * rng.standard_normal(clean.size), Ts=0.01)
model = ns.identify(record, base="linear")

# %% [markdown]
# ## One step, and free run
# `predict` uses the measured past at every sample; `simulate` (the free run) uses only the input and the start
# values. A model that repeats the last sample has a tiny one-step error but is useless. Judge a model by its free
# run.

# %%
errors = ns.evaluate(model, record)
lazy = ns.NARX.from_terms(["y[k-1]"], [1.0])
held = ns.evaluate(lazy, record)
print(f"linear model: one step {errors.one_step_mape:.2f} %, free run {errors.free_run_mape:.2f} %")
print(f"'as before':  one step {held.one_step_mape:.2f} %, free run {held.free_run_mape:.2f} %")

# %% [markdown]
# ## MAPE
# MAPE as in the paper: the mean absolute error in % of the measured **range**. It is not the mean of relative errors,
# which has the same name elsewhere.

# %%
target, answer = np.array([0.0, 1.0, 2.0]), np.array([0.1, 1.0, 1.9])
by_hand = 100 * np.mean(np.abs(target - answer)) / np.ptp(target)
print(ns.mape(target, answer), by_hand)

# %% [markdown]
# ## NRMSE
# The root mean square error divided by the standard deviation of the measured output: 0 is exact, 1 is no better than
# a constant. MAPE and NRMSE use all samples, also across a gap or over several records. MATLAB's fit in per cent
# is 100 (1 - NRMSE).
#
# ## The protocol
# **The error of a model on a record is that of its free run over the whole record, at the record's own rate, from
# start states that are estimated on that record.** A gap starts a new run. Nothing else is fitted to the record.
# Optionally, `--align` (`align=True`) also estimates a constant offset of the sensor, which may differ between two
# records of one machine ([a piezo stage](../results/paper.md#a-real-piezo-stage) is an example). The first samples,
# as many as the largest lag, are the measured ones. MATLAB's `compare` estimates start states in the same way.
#
# Start states are the outputs before the first computed sample and the internal states of effects. If the model is an
# integrator (a constraint keeps the sum of the coefficients of older outputs at 1), a constant load is estimated too:
# it is unknown on another day, and the output drifts with it. `own_load_nrmse` is the error with the load of the
# model.
#
# `evaluate`, `free_run`, `narx-sym compare`, and the headline, error ladder, page and JSON of a diagnosis all give
# this number. Validation data are records that no model is fitted to: those of `--validate`, else the last part of
# each record. Effects are compared by cross-validated errors, at a working rate; these are always called
# cross-validated.

# %%
nrmse = np.sqrt(np.mean((target - answer) ** 2)) / np.std(target)
print(ns.metrics.nrmse(target, answer), nrmse)

# %% [markdown]
# ## NSAVI
# NSAVI is the movement of the compensated input relative to that of the reference: the sum of absolute increments of
# m over that of r.

# %%
m, r = np.array([0.0, 2.0, 1.0]), np.array([0.0, 1.0, 1.5])
print(ns.nsavi(m, r), np.abs(np.diff(m)).sum() / np.abs(np.diff(r)).sum())

# %% [markdown]
# ## Fractions, noise floor and intervals of a diagnosis
# The *noise floor* is an estimate of the error that no model can explain. The *removable error* is the error of the
# base model above this floor. Each effect removes a fraction of it in cross-validation; the 95 % interval of this
# fraction comes from resampling the blocks. It can lie outside 0 ... 100 %, because both ends of the scale are
# estimates. The *detection limit* of an effect is the rms by which it must move the output to be detected in about 80
# % of such records, for the base model, the noise and the input of this record. To be detected, the part of the
# effect that the base model cannot reproduce must pass the score test and reduce the penalised log loss.

# %%
found = ns.diagnose(model, record)
first = found.table()[0]
print(f"{first['effect']}: {first['share']:.1%}, {first['low']:.1%} to {first['high']:.1%}; floor {found.floor:.3g} um")

# %% [markdown]
# ## Intervals of the book
# Counts such as 35 of 37 have a 95 % Wilson interval: the range of true rates for which this count is not surprising.
# min / median / max are taken over seeds; they show how much a single seed can differ.

# %%
hits, cases, z = 35, 37, 1.959964
centre = (hits + z**2 / 2) / (cases + z**2)
half = z / (cases + z**2) * np.sqrt(hits * (cases - hits) / cases + z**2 / 4)
print(f"{hits} of {cases}: {100 * (centre - half):.0f} ... {100 * (centre + half):.0f} %")

# %%
assert held.one_step_mape < 5 < held.free_run_mape
assert np.isclose(ns.mape(target, answer), by_hand) and np.isclose(ns.metrics.nrmse(target, answer), nrmse)
assert np.isclose(ns.nsavi(m, r), 2.0)
assert first["effect"] == "hysteresis" and first["low"] <= first["share"] <= first["high"]
assert 0.1 < found.floor < 0.4  # 0.2 um of noise were added
assert (round(100 * (centre - half)), round(100 * (centre + half))) == (82, 99)
