# %% [markdown]
# # P8: the two compensation laws
# Strategy 1 inverts M by algebra; strategy 2 reads the law off the identified inverse.

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import plots

k, m, r = ns.k, ns.m, ns.r
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
# ## Strategy 1
# Eq. (InputCompensation:Cms). Put back into M, the law gives $r_{k+1}$ identically.

# %%
law = model.compensator()
print(ns.latex(law))
print("residual:", law.residual(), " reference ahead of k:", law.preview)

# %% [markdown]
# ## Strategy 2
# Eq. (InputCompensation:Cci). The inverse's $y_{k-1}$ is the measured $y_{k+1}$, so that the law uses $r_{k+1}$.

# %%
second = inverse.compensator()
print(ns.latex(second))
print("reference ahead of k:", second.preview)

# %% [markdown]
# ## Both laws at work, from rest

# %%
t = 1e-3 * np.arange(3011)
reference = 40 * np.sin(2 * np.pi * np.maximum(t - 0.01, 0))
volts, second_volts = law.run(reference, m0=0.0), second.run(reference, m0=0.0)
error = np.abs(model.simulate(volts, y0=0.0) - reference).max()
print(f"largest error of M under its own law: {error:.1e} um")

figure, (left, right) = plots.new_axes(1, 2, figsize=(11, 4.2))
for x, colour, style, name in (
    (volts, plots.ORANGE, "-", "strategy 1: from M"), (second_volts, plots.BLUE, "--", "strategy 2: from the inverse"),
):  # fmt: skip
    left.plot(t, x, color=colour, ls=style, lw=1.6, label=name)
    right.plot(reference[2010:], x[2010:], color=colour, ls=style, lw=1.6, label=name)
left.set(xlabel="time [s]", ylabel="m [V]", ylim=(-55, 72))
right.set(xlabel="r [um]", ylabel="m [V]", title="last period: the inverse loop")
for ax in (left, right):
    ax.legend(loc="upper left", fontsize=9)
figure

# %%
a, b, c, d, e, f = model.symbols
turn, step, sign = m[k - 1] - m[k - 2], r[k + 1] - r[k], sp.sign
paper = (
    r[k + 1] - a * r[k] + b * m[k - 1] - (c * m[k - 1] + d * r[k]) * sign(turn) * turn
    - (e * m[k - 1] ** 2 + f * m[k - 1] * r[k]) * turn
) / b  # fmt: skip
second_paper = (
    a * m[k - 1] + b * step + (c * m[k - 1] + d * r[k + 1]) * sign(step) * step
    + (e * r[k + 1] * m[k - 1] + f * r[k + 1] ** 2) * sign(step)
)  # fmt: skip
assert sp.simplify(sp.expand(law.equation.rhs - paper)) == 0 and law.residual() == 0
assert sp.simplify(sp.expand(second.equation.rhs - second_paper)) == 0 and second.residual() == 0
assert law.preview == second.preview == 1
assert error < 1e-9
