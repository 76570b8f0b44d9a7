# %% [markdown]
# # Models with memory of the reversals of the input
# A NARX model only knows the last inputs and outputs. After a small loop inside a large one, a real piezo continues
# along the large loop, as if the small one had not happened. For this a model must remember the reversals of the
# input. A **play** does this: $z_j[k] = \max(u[k] - r_j, \min(u[k] + r_j, z_j[k-1]))$ follows the input once the
# slack $r_j$ is taken up. The base `play` (`narx-sym fit data.csv --base play`) is
#
# $$v[k] = p_0 u[k] + \sum_j p_j z_j[k], \qquad y[k] = a\,y[k-1] + (1 - a)\,\mathrm{curve}(v[k-d])$$
#
# (Prandtl, Ishlinskii; the curve is a broken line, Kuhnen 2003). It is a normal model, so everything that is derived
# for models is available. With `--creep` a part of $v$ is delayed.

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import plots
from narx_sym.fit.bases.play import Shape, branch_after
from narx_sym.inversion.plays import inverse_of
from narx_sym.models.analysis import property_1, steady_state

rng = np.random.default_rng(3)
turns = rng.uniform(-2, 2, 60)
volts = np.interp(np.arange(1800), np.arange(60) * 30, turns)
truth = Shape((0.4, 0.9, 1.5), (0.5,), 0).model({}, [0.5, 1.0, 0.6, 0.4, 0.3, 0.0, -0.2])
stage = truth.simulate(volts, volts[0], warn=False) + 0.005 * rng.standard_normal(volts.size)
record = ns.Record.from_arrays(volts, stage, Ts=0.01)
model = ns.identify(record, base="play", plays=5)
print("\n".join(model.lines(numbers=True)))
print(model.info.selection.reason, model.info.nrmse)

# %% [markdown]
# ## First-order reversal curves
# The input goes from the top down to a level, and up again. Each reversal starts a new curve, and all curves meet at
# the top, where the small loops are forgotten.

# %%
plots.plot_reversal_curves(model, record)

# %%
curves = plots.reversal_curves(model)
tops = np.array([run[-1] for _, run in curves])
assert np.ptp(tops) < 1e-2 * np.ptp(stage)  # but for the lag

# %% [markdown]
# In steady state a play can be anywhere in its slack: this is a continuum of equilibria. After a reversal of the
# input a play either stays or moves, so the quasi-static sets depend on the positions of the plays at the reversal.

# %%
sets = model.quasi_static()
assert sets.turns and len(steady_state(model).held) == len(sets.turns)
assert property_1(model).holds

# %% [markdown]
# After a given history the quasi-static branch is one expression, until the next reversal.

# %%
branch = branch_after(model, volts[:700])
print("y =", sp.latex(branch))
slow = np.concatenate([volts[:700], np.linspace(volts[699], 1.9, 500), np.full(60, 1.9)])
assert abs(model.simulate(slow, warn=False)[-1] - branch.xreplace({ns.u[ns.k]: sp.Float(1.9)})) < 1e-9

# %% [markdown]
# ## The inverse of a sum of plays is a sum of plays
# With $r_0 = 0 < r_1 < \dots$ and slopes $S_j = p_0 + \dots + p_j > 0$. A play of radius $\rho$ over a rising function of
# plays is again one: where $v$ moves on after a turn of $u$ by $2 r_j$, it has moved by
# $2\rho_j = 2\sum_{i<j} p_i (r_j - r_i)$, so $\mathrm{play}(v; \rho_j) = S_j z_j + \sum_{i>j} p_i z_i$. The inverse is
# $u = \sum_j q_j \mathrm{play}(v; \rho_j)$ where all $z_j$ must cancel but $z_0 = u$:
# $q_0 S_0 = 1$ and $p_j (q_0 + \dots + q_{j-1}) + q_j S_j = 0$. Derived here for four:

# %%
p, r = sp.symbols("p_0:4", positive=True), (sp.S.Zero, *sp.symbols("r_1:4", positive=True))
q, rho = inverse_of(list(p), list(r))
for name, listed in (("q", q), (r"\rho", rho)):
    for j, e in enumerate(listed):
        print(f"{name}_{j} =", sp.latex(sp.factor(e) if name == "q" else e))
S = [sum(p[: j + 1]) for j in range(4)]
assert sp.simplify(q[0] * S[0] - 1) == 0
assert all(sp.simplify(p[j] * sum(q[:j]) + q[j] * S[j]) == 0 for j in range(1, 4))

# %% [markdown]
# The law first inverts the lag and the curve, then the plays. It takes the positions of its plays from those of the
# model, so after a limit it continues from the state of the machine. Every slope is positive, which proves that there
# is exactly one input.

# %%
law = model.compensator()
print(law.checked)
print(*(line[:110] for line in law.lines()), sep="\n")
reference = 1.5 * np.sin(np.arange(900) / 40) * np.linspace(1, 0.2, 900)
m = law.run(reference, m0=0.0)
run = model.simulate(m, 0.0, u0=0.0, warn=False)
assert np.abs(run - reference).max() < 1e-12
tracked = truth.simulate(m, 0.0, u0=0.0, warn=False)
print(f"on the machine itself: {100 * np.abs(tracked - reference).mean() / np.ptp(reference):.2f} % of the range")

# %% [markdown]
# ## What one record can show
# With one loop of one size the plays and the static curve cannot be distinguished, because both bend the loop. The
# fit starts from equal weights that explain the first loop. With one frequency a lag and a delay cannot be
# distinguished; the smallest delay is chosen. If most of the error on a new record is an offset of its sensor,
# `compare` says so, and `--align` estimates it.
#
# `--base auto` tries `static`, `linear`, `narx`, `play` and `bouc-wen` in cross-validation, with a penalty of 0.1 in
# ln(mean square) per parameter, and prints the reason of its choice. Every base model uses the measurements before a
# validation block to initialise its memory, and an offset of the sensor is estimated for each. The choice depends on
# the record: for a measured piezo stage on one sine the advantage of four plays is small (0.011 with 8 parameters;
# `narx` 0.010 with 11); with a varying amplitude it is large (0.022 with 9; `narx` 0.084 with 6).

# %%
bouc_wen = ns.identify(record, base="bouc-wen")
print(bouc_wen.info.nrmse, bouc_wen.info.selection.reason)
assert model.info.nrmse.free_run < 0.5 * bouc_wen.info.nrmse.free_run
