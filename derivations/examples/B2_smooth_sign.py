# %% [markdown]
# # B2: a smooth sign
# The paper's future work: "the use of smoother functions in place of the sign function". sign(x) becomes tanh(x/ε), a
# substitution in the model or in the law; the two commute. ε is measured in median steps of the record. Chattering is
# counted in reversals of m beyond those of r and in the roughness $\sum|\Delta^2 m|$.

# %%
import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plants, plots
from narx_sym.symbolic.smoothing import DEFAULT

TERMS = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
INVERSE_TERMS = [
    "u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]",
    "phi2[k-1]*y[k-1]*u[k-1]", "phi2[k-1]*y[k-1]**2",
]  # fmt: skip
noise = plants.filtered_noise(seed=0, peak=75.0)
record = ns.Record.from_arrays(noise, plants.bouc_wen(noise), Ts=1e-3)
reference = 40 * np.sin(2e-3 * np.pi * np.arange(10_000))
models = {
    "strategy 1": ns.NARX.from_terms(TERMS),
    "strategy 2": ns.NARX.from_terms(INVERSE_TERMS, input="y", output="u", lead=2),
}
models = {name: model.fit(record, ["continuum"]) for name, model in models.items()}
laws = {name: model.compensator() for name, model in models.items()}
print(ns.latex(models["strategy 2"].smooth(0.01)))
print(laws["strategy 2"].smooth(0.01).latex())

# %% [markdown]
# ## After identification, and before it
# The law of the smoothed model is the smoothed law. Fitting the smooth model instead changes little.

# %%


def reversals(x):
    return int(np.sum(np.diff(np.sign(np.diff(x))) != 0))


def run(law):
    """(tracking MAPE [%], NSAVI, reversals beyond those of r, roughness [V]) on the plant."""
    m = law.run(reference, m0=0.0)
    rough = float(np.abs(np.diff(m, 2)).sum())
    error, effort = ns.mape(reference, plants.bouc_wen(m)), ns.nsavi(m, reference)
    return error, effort, reversals(m) - reversals(reference), rough


table = Table("law", "sign", "MAPE [%]", "NSAVI", "extra reversals", "roughness [V]")
figures = {}
for name, law in laws.items():
    rows = {
        "sharp": law,
        "smooth, default ε": law.smooth(),
        "smooth, then fitted": models[name].smooth().fit(record).compensator(),
    }
    for word, one in rows.items():
        error, effort, extra, rough = figures[name, word] = run(one)
        table.add_row(name, word, f"{error:.3f}", f"{effort:.4f}", str(extra), f"{rough:.2f}")
Console().print(table)

# %% [markdown]
# ## The width
# Wider than a step of the record, the sign no longer knows the direction where m or r moves slowly: the hysteresis
# itself is smoothed away and tracking is lost. 0.3 median steps are the default.

# %%
widths = np.geomspace(0.01, 10, 13)  # in median steps of the record
study = {
    name: np.array([run(law.smooth({s: w * step for s, step in models[name].info.steps.items()})) for w in widths])
    for name, law in laws.items()
}
figure, axes = plots.new_axes(1, 4, figsize=(15, 4.2))
titles = ("tracking MAPE [%]", "NSAVI", "reversals of m beyond those of r", r"roughness $\sum|\Delta^2 m|$ [V]")
for column, (ax, title) in enumerate(zip(axes, titles, strict=True)):
    for (name, values), colour, marker in zip(study.items(), (plots.ORANGE, plots.BLUE), ("o", "s"), strict=True):
        ax.plot(widths, values[:, column], color=colour, marker=marker, ms=5, label=name)
        ax.axhline(figures[name, "sharp"][column], color=colour, ls=":", label=f"{name}, sign")
    ax.axvline(DEFAULT, color=plots.BLACK, ls="--", lw=1, label="default")
    ax.set_xscale("log")
    ax.set(xlabel="ε / median step of the record", ylabel=title)
axes[0].set_yscale("log")
axes[0].set_yticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"])
axes[0].minorticks_off()
axes[0].legend(loc="upper left", fontsize=8)
figure

# %%
for name, law in laws.items():
    smooth = models[name].smooth(0.01).compensator()
    assert (smooth.law - law.smooth(0.01).law).expand() == 0 and smooth.residual() == 0
    sharp, soft = figures[name, "sharp"], figures[name, "smooth, default ε"]
    assert soft[0] <= 1.02 * sharp[0] and abs(soft[1] - sharp[1]) < 0.005  # tracking and effort are kept
    assert soft[2] <= sharp[2] and soft[3] <= 1.001 * sharp[3]
    assert study[name][-1, 0] > 4 * sharp[0]  # too wide
assert figures["strategy 1", "sharp"][2] <= 1  # every sign stands beside phi1: nothing jumps
assert figures["strategy 2", "sharp"][2] > 30 and figures["strategy 2", "smooth, default ε"][2] <= 1
