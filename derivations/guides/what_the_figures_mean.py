# %% [markdown]
# # What the figures mean
# Five figures come up again and again. Each is computed here once, by hand beside the package.

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
# `predict` is told the measured past at every sample, `simulate` only the input and where it starts. A model that
# repeats the last sample has a tiny one-step error and knows nothing. Judge by the free run.

# %%
errors = ns.evaluate(model, record)
lazy = ns.NARX.from_terms(["y[k-1]"], [1.0])
held = ns.evaluate(lazy, record)
print(f"linear model: one step {errors.one_step_mape:.2f} %, free run {errors.free_run_mape:.2f} %")
print(f"'as before':  one step {held.one_step_mape:.2f} %, free run {held.free_run_mape:.2f} %")

# %% [markdown]
# ## MAPE
# The paper's: the mean absolute error as a share of the measured **range**, in %. Not the mean of relative errors, as the
# name has it elsewhere.

# %%
target, answer = np.array([0.0, 1.0, 2.0]), np.array([0.1, 1.0, 1.9])
by_hand = 100 * np.mean(np.abs(target - answer)) / np.ptp(target)
print(ns.mape(target, answer), by_hand)

# %% [markdown]
# ## NRMSE
# The root mean square error over the standard deviation of what was measured: 0 is exact, 1 is as good as a constant.
# Both are over all samples: of a record with a gap, or of several records, as if they stood in one. MATLAB's fit in per
# cent is 100 (1 - NRMSE).
#
# ## The protocol
# **The error of a model on a record is that of its free run over the whole record, at the record's own rate, from start
# states that are estimated on that record.** A gap starts a new run. Nothing else is fitted to the record, unless it is
# asked for: `--align` (`align=True`) also estimates a constant offset of the sensor, by which two records of one machine
# may differ ([a piezo stage](../results/paper.md#a-real-piezo-stage) is an example). The first samples, which the model
# looks back at, are the measured ones. MATLAB's `compare` estimates start states in the same way.
#
# Start states are the outputs before the first computed sample and what effects remember. Of a model that integrates (a
# constraint keeps the sum of the coefficients of older outputs at 1) the constant load counts as one too: nobody knows it
# on another day, and an axis drifts with it. The error with the model's own load stands beside (`own_load_nrmse`).
#
# `evaluate`, `free_run`, `narx-sym compare`, the headline and the ladder of a diagnosis, its page and its JSON all give
# this number. Validation data are records that no model is fitted to: those of `--validate`, else the last part of each
# record. Errors of cross-validation, by which effects are compared at a working rate, stand under that name.

# %%
nrmse = np.sqrt(np.mean((target - answer) ** 2)) / np.std(target)
print(ns.metrics.nrmse(target, answer), nrmse)

# %% [markdown]
# ## NSAVI
# How much more the compensated input moves than the reference: the sum of absolute increments of m over that of r.

# %%
m, r = np.array([0.0, 2.0, 1.0]), np.array([0.0, 1.0, 1.5])
print(ns.nsavi(m, r), np.abs(np.diff(m)).sum() / np.abs(np.diff(r)).sum())

# %% [markdown]
# ## Shares, floors and intervals of a diagnosis
# The *noise floor* is an estimate of what no model could explain. The *share* of an effect is how much of the removable
# error (that of the base beyond the floor) it removes in cross-validation, on held-out blocks; its 95 % interval comes
# from resampling those blocks. It can leave 0 ... 100 %, because both ends of the scale are estimates.
# What *could not have been seen* is computed effect by effect, for the base, the noise and the input of this record: the
# rms by which an effect must move the output to be seen in about 80 % of such records. It must pass the test and be worth
# its price, with what a refit of the base leaves of it. How far that holds: "When an effect is named".

# %%
found = ns.diagnose(model, record)
first = found.table()[0]
print(f"{first['effect']}: {first['share']:.1%}, {first['low']:.1%} to {first['high']:.1%}; floor {found.floor:.3g} um")

# %% [markdown]
# ## Intervals of the book
# Counts such as 35 of 37 stand with their 95 % Wilson interval: the range of true rates with which that count is not
# surprising. min / median / max are over seeds, and say how far a single seed may move.

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
