# %% [markdown]
# # P5: quasi-static sets of M and of the inverse
# Parameters of Table 1, input 70 sin(2πt) V (the caption prints 70 sin(2πk)), 1 ms.

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import plots
from narx_sym.models.analysis import phi1_, u_

model = ns.NARX.from_terms(
    [
        "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
        "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
    ],
    theta=[1.00, 0.77, 1.44e-2, -9.60e-3, 3.15e-4, -2.47e-4],
)  # fmt: skip
inverse = ns.NARX.from_terms(
    [
        "u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]",
        "phi2[k-1]*y[k-1]*u[k-1]", "phi2[k-1]*y[k-1]**2",
    ],
    theta=[1.00, 1.27, -2.13e-2, 1.37e-2, -1.07e-5, 7.99e-6],
    input="y", output="u", lead=2,
)  # fmt: skip

# %% [markdown]
# ## The expressions
# $\tilde y$ solves the model with all outputs equal. In the inverse, $u$ and $\phi_1$ stand for its input.

# %%
sets, inverse_sets = model.quasi_static(), inverse.quasi_static()
print(ns.latex(sets))
print(ns.latex(inverse_sets))

# %% [markdown]
# ## Attracting and repelling regions
# The paper's second line of (d090919) divides by $\theta_6\phi_1$, negative while loading, and holds in no sample.
# The first line, $|\partial F/\partial y| < 1$, holds in 69 % of them.

# %%
t = 1e-3 * np.arange(1000)
volts, microns = 70 * np.sin(2 * np.pi * t), 40 * np.sin(2 * np.pi * t)
numbers = sets.evaluate(volts)
share = numbers.attracting[numbers.loading].mean()
theta_1, _, _, theta_4, _, theta_6 = model.theta
x, step = volts[numbers.loading], numbers.phi1[numbers.loading]
low = (-1 - theta_1 - theta_4 * step) / (theta_6 * step)
high = (1 - theta_1 - theta_4 * step) / (theta_6 * step)
second_line = np.mean((low < x) & (x < high))
print(f"loading: first line {100 * share:.0f} %, printed second line {100 * second_line:.0f} % of the samples")

# %%
figure, axes = plots.new_axes(1, 2, figsize=(12, 5.8))
plots.plot_quasi_static(model, volts, y0=0.0, ax=axes[0], units={"u": "V", "y": "um"})
plots.plot_quasi_static(inverse, microns, y0=0.0, ax=axes[1], units={"u": "V", "y": "um"})
axes[0].set_title("model: " + axes[0].get_title())
axes[1].set_title("inverse model: " + axes[1].get_title())
figure

# %%
a, b, c, d, e, f = model.symbols
for s, ours in ((1, sets.loading), (-1, sets.unloading)):
    above = b * phi1_ + s * c * phi1_ * u_ + e * phi1_ * u_**2
    assert sp.simplify(ours - above / (1 - a - s * d * phi1_ - f * phi1_ * u_)) == 0
for s, ours in ((1, inverse_sets.loading), (-1, inverse_sets.unloading)):
    above = b * phi1_ + s * d * phi1_ * u_ + s * f * u_**2
    assert sp.simplify(ours - above / (1 - a - s * c * phi1_ - s * e * u_)) == 0
assert abs(share - 0.69) < 0.005 and second_line == 0
assert "counter-clockwise" in axes[0].get_title()
assert "counter-clockwise" not in axes[1].get_title()  # the loop of the inverse turns the other way
