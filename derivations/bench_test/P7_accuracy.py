# %% [markdown]
# # P7: accuracy of the models, Table 2
# Free run over 50 s of 40 sin(2πt) V, mean absolute error in per cent of the range.
# The paper shows one realisation, a good one. Here are ten noise seeds with the paper's figure marked.

# %%
import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plants, plots
from narx_sym.fit.bases import select as selection

PAPER = {"model": 0.398, "inverse": 0.413, "black box": 1.494}
TERMS = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
INVERSE_TERMS = [
    "u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]",
    "phi2[k-1]*y[k-1]*u[k-1]", "phi2[k-1]*y[k-1]**2",
]  # fmt: skip

sine = 40 * np.sin(2 * np.pi * 1e-3 * np.arange(50_000))
validation = ns.Record.from_arrays(sine, plants.bouc_wen(sine), Ts=1e-3)


def bench(seed):
    volts = plants.filtered_noise(seed=seed, peak=75.0)
    return ns.Record.from_arrays(volts, plants.bouc_wen(volts), Ts=1e-3)


def direct(**options):
    return ns.NARX.from_terms(TERMS, **options)


def inverse(**options):
    return ns.NARX.from_terms(INVERSE_TERMS, input="y", output="u", lead=2, **options)


def free_run_mape(model):
    return ns.evaluate(model, validation).free_run_mape


# %% [markdown]
# ## The published parameters

# %%
print(ns.latex(direct()))
print(ns.latex(inverse()))
published = {
    "model": free_run_mape(direct(theta=[1.00, 0.77, 1.44e-2, -9.60e-3, 3.15e-4, -2.47e-4])),
    "inverse": free_run_mape(inverse(theta=[1.00, 1.27, -2.13e-2, 1.37e-2, -1.07e-5, 7.99e-6])),
}

# %% [markdown]
# ## Fitted
# Constrained least squares over ten seeds. The black box is a polynomial in $y_{k-1}, u_{k-1}, u_{k-2}$ without
# $\phi_1$, $\phi_2$ and constraint, invertible by A1(i), with as many picks as the models. (The paper does not show
# its own.)

# %%
records = [bench(seed) for seed in range(10)]
polynomials = ns.pool(n_y=1, n_u=2, degree=3, phi=False, rules=("A1(i)",))
fitted = {"model": [], "inverse": [], "black box": []}
for record in records:
    fitted["model"].append(direct().fit(record, constraints=["continuum"]))
    fitted["inverse"].append(inverse().fit(record, constraints=["continuum"]))
    fitted["black box"].append(selection.select(polynomials, record, continuum=False, n_terms=5).model)
scores = {name: np.array([free_run_mape(one) for one in models]) for name, models in fitted.items()}
print(ns.latex(fitted["black box"][0]))

# %% [markdown]
# ## One-step accuracy says nothing
# With $n_y = 2$ the model $2y_{k-1} - y_{k-2}$ predicts one step almost perfectly and drifts away in free run.

# %%
straight = ns.NARX.from_terms(["y[k-1]", "y[k-2]"], theta=[2.0, -1.0])
held = ns.evaluate(straight, validation)
run = ns.mape(validation.y, straight.simulate(validation.u, validation.y[:2], warn=False))  # from the measured start
print(f"2 y[k-1] - y[k-2]: one-step MAPE {held.one_step_mape:.4f} %, free run {run:.3g} %")

# %%
table = Table("free-run MAPE [%]", "paper", "Table 1 values", "seed 0", "ten seeds: min / median / max")
for name, values in scores.items():
    spread = " / ".join(f"{f(values):.2f}" for f in (np.min, np.median, np.max))
    shown = f"{published[name]:.3f}" if name in published else ""
    table.add_row(name, f"{PAPER[name]:.3f}", shown, f"{values[0]:.3f}", spread)
Console().print(table)

figure, ax = plots.new_axes(figsize=(7, 4))
for place, (name, values) in enumerate(scores.items()):
    first = place == 0
    ax.plot(place + np.linspace(-0.15, 0.15, 10), values, color=plots.SKY, mec=plots.BLUE, marker="o", ms=7, ls="none",
            label="ten noise seeds, fitted" if first else None)  # fmt: skip
    if name in published:
        ax.plot(place, published[name], color=plots.BLACK, marker="x", ms=9, mew=2, ls="none",
                label="parameters of Table 1" if first else None)  # fmt: skip
    ax.hlines(
        PAPER[name], place - 0.3, place + 0.3, color=plots.RED, lw=2, label="Table 2 of the paper" if first else None
    )
ax.set_yscale("log")
ax.set_xticks(range(3), ["model M", "inverse model", "black box"])
ax.set_yticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"])
ax.minorticks_off()
ax.set(ylabel="free-run MAPE [%]", xlim=(-0.6, 2.6))
ax.legend(loc="upper left", fontsize=9)
figure

# %%
assert abs(published["model"] - 0.33) < 0.01 and 0.43 < published["inverse"] < 0.48
assert scores["model"][0] < 1.43 and scores["inverse"][0] < 1.08  # the measured ranges
# The inverse stays above the printed 0.413 in every seed.
assert np.median(scores["model"]) < 0.8 and np.min(scores["inverse"]) > 0.41
assert np.median(scores["black box"]) > 2 * max(np.median(scores["model"]), np.median(scores["inverse"]))
assert held.one_step_mape < 0.01 and run > 100
