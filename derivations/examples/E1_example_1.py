# %% [markdown]
# # E1: Example 1, the constraint and the quasi-static sets
# Model of Eq. (170919a). Wanted: $\Sigma_y$, the constraint $S\theta = c$, the sets $\tilde y$ for
# $\phi_2 = \pm 1$ (Eq. 190919a) and the attracting condition (Eq. 190919b).

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import plants, plots
from narx_sym.models.analysis import constraint_matrix, continuum_conditions, phi1_, u_

k = ns.k

terms = ["y[k-1]", "phi2[k-1]", "phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]", "phi1[k-1]"]
model = ns.NARX.from_terms(terms)
print(ns.latex(model))

# %% [markdown]
# ## Static analysis
# All signals are held constant; $\phi_1$ and $\phi_2$ vanish by themselves.
# What remains must hold for every $\bar y$: that is $S\theta = c$.

# %%
print(ns.latex(ns.analysis.steady_state(model)))
S, c = constraint_matrix(continuum_conditions(model), model.symbols)
print(f"S = {ns.latex(S)}, c = {ns.latex(c)}")

# %% [markdown]
# ## Quasi-static analysis
# The paper's second line of (190919b) divides by $\theta_4\phi_2$ and holds only where that is positive.
# The condition kept here is its first line, $|\partial F/\partial y| < 1$.

# %%
sets = model.quasi_static()
print(ns.latex(sets))

# %% [markdown]
# ## What the condition is good for
# With $\theta_1 = 1$ the slope is $1 + \theta_4 |\phi_1|$: this structure attracts everywhere
# ($\theta_4 < 0$, not too large) or nowhere. Fitted to the bench test it attracts nowhere.
# The one-step error looks excellent, and the free run explodes.

# %%
volts = plants.filtered_noise(seed=0)
bench = ns.Record.from_arrays(volts, plants.bouc_wen(volts), Ts=1e-3)
fitted = ns.NARX.from_terms(terms).fit(bench, constraints=["continuum"])
pair = ns.evaluate(fitted, bench)
run = ns.mape(bench.y, fitted.simulate(bench.u, bench.y[:2]))  # from the measured start
print(f"theta_4 = {fitted.theta[3]:.3g}, one-step MAPE {pair.one_step_mape:.2g} %, free run {run:.2g} %")

# %% [markdown]
# ## The picture, with numbers that attract

# %%
model = ns.NARX.from_terms(terms, [1.0, 0.02, 0.002, -0.01, 0.7])
sine = 40 * np.sin(2 * np.pi * np.arange(1000) * 1e-3)
plots.plot_quasi_static(model, sine, y0=0.0, units={"u": "V", "y": "um"})

# %%
theta = model.symbols
loading = (theta[1] + theta[2] * phi1_ * u_ + theta[4] * phi1_) / (1 - theta[0] - theta[3] * phi1_)
unloading = (-theta[1] + theta[2] * phi1_ * u_ + theta[4] * phi1_) / (1 - theta[0] + theta[3] * phi1_)
assert model.sigma_y == theta[0]
assert S == sp.Matrix([[1, 0, 0, 0, 0]]) and c == sp.Matrix([1])
assert sp.simplify(sets.loading - loading) == 0
assert sp.simplify(sets.unloading - unloading) == 0
slope = theta[0] + theta[3] * ns.phi2[k - 1] * ns.phi1[k - 1]
assert sp.simplify(sets.attracting.lhs.args[0] - slope) == 0 and sets.attracting.rhs == 1
assert fitted.theta[3] > 0 and pair.one_step_mape < 0.1 and run > 100
assert model.quasi_static().evaluate(sine).attracting[1:].all()
