# %% [markdown]
# # B1: the law of the physical Bouc-Wen model
# Beyond the paper. With $h_{k-1} = d\,u_{k-1} - y_{k-1}$ the plant of P1 is
# $y_k = y_{k-1} + a\,\phi_{1,k} + b\,|\phi_{1,k}|\,h_{k-1} + c\,\phi_{1,k}\,|h_{k-1}|$.
# The newest input stands inside $|\phi_{1,k}|$: Assumption A1(i) is violated, and section 4 gives no law.

# %%
import numpy as np
import sympy as sp
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import k, m, phi1, plants, plots, r, u, y

PAPER = (0.322, 1.13)
a, b, c, d = sp.symbols("a b c d", real=True)
memory = d * u[k - 1] - y[k - 1]
F = y[k - 1] + a * phi1[k] + b * sp.Abs(phi1[k]) * memory + c * phi1[k] * sp.Abs(memory)
t = 1e-3 * np.arange(50_000)
reference = 40 * np.sin(2 * np.pi * t)


def fitted(seed, noise=0.0):
    volts = plants.filtered_noise(seed=seed, peak=75.0)
    output = plants.bouc_wen(volts)
    output = output + noise * np.std(output) * np.random.default_rng(1000 + seed).standard_normal(output.size)
    record = ns.Record.from_arrays(volts, output, Ts=1e-3)
    return ns.Model(F, (a, b, c, d), theta=[1, 0, 0, 2]).fit(record, method="free_run")


# %% [markdown]
# ## By branches
# For each sign of $\phi_{1,k}$ the equation is affine in $m_k$. It has one kink, at $m_k = m_{k-1}$, where the output
# is $r_{k-1}$. While both slopes are positive the map rises: $r_k$ lies above $r_{k-1}$ on one branch only.

# %%
model = fitted(0)
law = model.compensator()
print(ns.latex(model))
print(ns.latex(law))
print("put back into the model, branch by branch:", law.residual())
h, rise = d * m[k - 1] - r[k - 1], r[k] - r[k - 1]
expected = [m[k - 1] + rise / (a + b * s * h + c * sp.Abs(h)) for s in (-1, 1)]
print("checked:", law.checked)

# %% [markdown]
# ## On the plant
# Five noise realisations (`tests/bench/laws.py` has twenty), without and with 1 % noise on the identification data.

# %%
found = {}
for noise in (0.0, 0.01):
    runs = []
    for seed in range(5):
        volts = fitted(seed, noise).compensator().run(reference, m0=0.0)
        runs.append((ns.mape(reference, plants.bouc_wen(volts)), ns.nsavi(volts, reference)))
    found[noise] = np.array(runs)
plain = plants.bouc_wen(reference)
table = Table("identified from", "tracking MAPE [%]: min / median / max", "NSAVI, median", title="The law on the plant")
for noise, values in found.items():
    error = " / ".join(f"{f(values[:, 0]):.4f}" for f in (np.min, np.median, np.max))
    table.add_row(f"{noise:.0%} noise", error, f"{np.median(values[:, 1]):.4f}")
table.add_row("the paper, Table 3", f"{PAPER[0]}", f"{PAPER[1]}")
Console().print(table)

# %%
figure, (left, right) = plots.new_axes(1, 2, figsize=(11, 4.2))
volts = law.run(reference, m0=0.0)
output = plants.bouc_wen(volts)
shown = slice(2000, 4001)
left.plot(t[shown], volts[shown], color=plots.ORANGE, label="m [V], by branches")
left.plot(t[shown], reference[shown], color=plots.BLACK, ls=":", lw=1, label="reference taken as voltage")
left.set(xlabel="time [s]", ylabel="input [V]", ylim=(-55, 80))
right.plot(t[shown], np.abs(reference - plain)[shown], color=plots.BLACK, ls=":", lw=1, label="without compensation")
right.plot(t[shown], np.abs(reference - output)[shown], color=plots.ORANGE, label="with the law")
right.axhline(PAPER[0] * 0.8, color=plots.RED, ls="--", lw=1, label="the paper's mean error")
right.set(xlabel="time [s]", ylabel="|r - y| [um]", yscale="log", ylim=(1e-6, 2e3))
for ax in (left, right):
    ax.legend(loc="upper left", fontsize=8)
figure

# %%
assert [sp.simplify(branch.solution - e) for branch, e in zip(law.branches, expected, strict=True)] == [0, 0]
assert law.residual() == 0 and law.closed_form and law.check().good
assert np.median(found[0.0][:, 0]) <= 0.02 and np.median(found[0.01][:, 0]) <= 0.03
assert max(np.median(values[:, 1]) for values in found.values()) <= 1.15
