# %% [markdown]
# # P6: a constant input
# The input 40 sin(2πt) V stops at 16.8 V, once while loading and once while unloading.
# The model must stay on its point of the loop.

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import plants, plots
from narx_sym.models.analysis import continuum_conditions, rest_map, ybar

TERMS = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
model = ns.NARX.from_terms(TERMS, theta=[1.00, 0.77, 1.44e-2, -9.60e-3, 3.15e-4, -2.47e-4])

# %% [markdown]
# ## By algebra
# At rest only $\theta_1 \bar y$ is left. With $\theta_1 = 1$ every $\bar y$ is an equilibrium.
# $\Sigma_y = 1$ alone would not do: $y_k = y_{k-1} + \theta u_{k-1}$ meets Assumption 1 too, and drifts.

# %%
print(ns.latex(ns.analysis.steady_state(model)))
drifting = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[1.0, 0.1])
print(ns.latex(continuum_conditions(drifting)))
print(ns.analysis.property_1(model).reason, "/", ns.analysis.property_1(drifting).reason)

# %% [markdown]
# ## In numbers
# Not one bit of the output moves once the last difference has passed through the model.

# %%
t = 1e-3 * np.arange(8000)
runs = {}
for name, direction in (("loading", 1), ("unloading", -1)):
    volts = 40 * np.sin(2 * np.pi * t)
    past = (direction * (volts - 16.8) >= 0) & (direction * np.cos(2 * np.pi * t) > 0) & (t >= 4)
    stop = int(np.argmax(past))
    volts[stop:] = 16.8
    runs[name] = (stop, volts, plants.bouc_wen(volts), model.simulate(volts, y0=0.0))
moved = {name: float(np.ptp(output[stop + 3 :])) for name, (stop, _, _, output) in runs.items()}
gaps = {name: float(abs(output[-1] - plant[-1])) for name, (_, _, plant, output) in runs.items()}
print("movement at rest [um]:", moved, "distance to the plant [um]:", gaps)

# %%
figure, axes = plots.new_axes(1, 3, figsize=(13, 4.2))
styles = {"loading": (plots.BLUE, ">", "-"), "unloading": (plots.RED, "<", "--")}
for name, (_, volts, plant, output) in runs.items():
    colour, marker, line = styles[name]
    shown = slice(2600, 5600)
    axes[0].plot(t[shown], volts[shown], color=colour, lw=1.6, ls=line, label=f"stop while {name}")
    axes[1].plot(t[shown], plant[shown], color=plots.BLACK, lw=2.6, alpha=0.35,
                 label="plant" if name == "loading" else None)  # fmt: skip
    axes[1].plot(t[shown], output[shown], color=colour, lw=1.4, ls=line,
                 label=f"model, stop while {name}")  # fmt: skip
    axes[2].plot(volts[-1], output[-1], color=colour, marker=marker, ms=11, ls="none", label=f"at rest after {name}",
                 zorder=3)  # fmt: skip
stop, volts, plant, output = runs["unloading"]
period = slice(stop - 1300, stop - 299)
axes[2].plot(volts[period], plant[period], color=plots.BLACK, lw=2.6, alpha=0.35, label="plant")
axes[2].plot(volts[period], output[period], color=plots.ORANGE, lw=1.4, ls="--", label="model")
axes[0].set(xlabel="time [s]", ylabel="u [V]", ylim=(-45, 62))
axes[1].set(xlabel="time [s]", ylabel="y [um]", ylim=(-40, 62))
axes[2].set(xlabel="u [V]", ylabel="y [um]")
for ax in axes:
    ax.legend(loc="upper left", fontsize=8)
figure

# %%
assert sp.simplify(rest_map(model).xreplace({model.symbols[0]: sp.S.One}) - ybar) == 0
assert ns.analysis.continuum(model) and ns.analysis.property_1(model).holds
assert not ns.analysis.continuum(drifting) and not ns.analysis.property_1(drifting).holds
assert moved == {"loading": 0.0, "unloading": 0.0}
assert max(gaps.values()) < 0.02 * 70  # um, of the 70 um the loop spans
assert 8 < runs["unloading"][3][-1] - runs["loading"][3][-1] < 10  # um: two points of one loop at 16.8 V
