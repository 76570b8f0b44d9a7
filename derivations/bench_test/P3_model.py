# %% [markdown]
# # P3: the model M, Table 1 (first half)
# Constrained least squares with $\Sigma_y = \theta_1 = 1$ on the data of P1.

# %%
import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plants, plots
from narx_sym.engines.columns import Columns
from narx_sym.models.analysis import constraint_matrix, continuum_conditions

TERMS = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
TABLE_1 = np.array([1.00, 0.77, 1.44e-2, -9.60e-3, 3.15e-4, -2.47e-4])


def bench(seed):
    volts = plants.filtered_noise(seed=seed, peak=75.0)
    return ns.Record.from_arrays(volts, plants.bouc_wen(volts), Ts=1e-3)


record = bench(0)
model = ns.NARX.from_terms(TERMS)
print(ns.latex(model))

# %% [markdown]
# ## The constraint is derived, then eliminated

# %%
S, c = constraint_matrix(continuum_conditions(model), model.symbols)
print(f"S = {ns.latex(S)}, c = {ns.latex(c)}")
model = model.fit(record, constraints=["continuum"])
print(model.latex(numbers=True))

# %% [markdown]
# ## The same by the printed estimator
# Eq. (ConstrainedParameters_Estimator), with scaled columns: the normal equations square the condition number.

# %%
data = Columns([*model.terms, ns.y[ns.k]])({"u": record.u, "y": record.y})
Psi, target = data[:, :-1], data[:, -1]
scale = np.linalg.norm(Psi, axis=0)
inverse = np.linalg.inv((Psi / scale).T @ (Psi / scale))
row = np.array(S, dtype=float) / scale
free = inverse @ (Psi / scale).T @ target
paper_estimator = (
    free - inverse @ row.T @ np.linalg.inv(row @ inverse @ row.T) @ (row @ free - np.array(c, dtype=float).ravel())
) / scale

# %% [markdown]
# ## Against Table 1
# The paper shows one realisation of unknown amplitude; five seeds say how far the parameters move.

# %%
seeds = np.array([ns.NARX.from_terms(TERMS).fit(bench(seed), constraints=["continuum"]).theta for seed in range(5)])
table = Table("parameter", "here", "printed estimator", "Table 1", "five seeds")
for i, symbol in enumerate(model.symbols):
    low, high = seeds[:, i].min(), seeds[:, i].max()
    table.add_row(str(symbol), f"{model.theta[i]:.4g}", f"{paper_estimator[i]:.4g}", f"{TABLE_1[i]:.4g}",
                  f"{low:.3g} ... {high:.3g}")  # fmt: skip
Console().print(table)

figure, ax = plots.new_axes(figsize=(7, 4))
for i in range(1, 6):
    ax.plot([i] * 5, seeds[:, i] / TABLE_1[i], color=plots.SKY, marker="o", ms=7, ls="none", mec=plots.BLUE,
            label="five noise seeds" if i == 1 else None)  # fmt: skip
    ax.plot(i, model.theta[i] / TABLE_1[i], color=plots.RED, marker="x", ms=9, mew=2, ls="none",
            label="seed 0" if i == 1 else None)  # fmt: skip
ax.axhline(1, color=plots.BLACK, lw=1.2, label="Table 1")
ax.set_xticks(range(1, 6), [rf"$\theta_{i + 1}$" for i in range(1, 6)])
ax.set(
    ylabel="estimate / value of Table 1", ylim=(0.9, 1.4), title=r"model $\mathcal{M}$ ($\theta_1 = 1$ by constraint)"
)
ax.legend(loc="upper left", fontsize=9)
figure

# %%
assert model.theta[0] == 1.0 and S[0, 0] == 1 and sum(S) == 1
assert np.allclose(paper_estimator, model.theta, rtol=1e-3)
assert np.all(np.sign(model.theta) == np.sign(TABLE_1))
assert np.all(np.abs(model.theta / TABLE_1 - 1) < [1e-12, 0.03, 0.12, 0.16, 0.05, 0.05])
