# %% [markdown]
# # B6: a static function that is known becomes constraints
# A survey of the same group (Aguirre, *A Bird's Eye View of Identification*, arXiv 1907.06803) says in its abstract that
# grey-box methods use auxiliary information, such as the steady-state data of the system, and lists "I is the static
# function" and "Constraining parameters" in its contents. Only these could be read here. The equations are derived here;
# machine and numbers are our own.

# %%
import numpy as np
import sympy as sp
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plots

TS, SENSOR, LONG = 1.0, 0.05, 100  # sampling time [s], noise of the sensor [K], samples of a short record

# %% [markdown]
# ## What is known
# A heater whose rise of temperature at rest, $\bar y = f(\bar u)$, is known from its power: 0.4 K/V and 0.5 K/V². Of its
# motion nothing is known but that its order is two: five of the nine terms are not in it.

# %%
ubar, ybar = sp.symbols(r"\bar{u} \bar{y}", real=True)
f = sp.Rational(2, 5) * ubar + ubar**2 / 2
model = ns.NARX.from_terms([
    "y[k-1]", "y[k-2]", "1", "u[k-1]", "u[k-2]", "u[k-1]**2", "u[k-1]*u[k-2]", "u[k-1]**3", "y[k-1]*u[k-1]",
])  # fmt: skip
print(ns.latex(model))
print(sp.latex(sp.Eq(ybar, f)))

# %% [markdown]
# ## The constraints
# At rest all lags of y are $\bar y$ and all lags of u are $\bar u$: $\bar y = G(\bar y, \bar u; \theta)$. The model rests at
# $f(\bar u)$ for every input exactly where $G(f(\bar u), \bar u; \theta) - f(\bar u)$ vanishes as a polynomial in $\bar u$.
# Each coefficient is an equation, and G is linear in $\theta$, so each equation is too.


# %%
def at_rest(output):
    still = {ns.y: output, ns.u: ubar}
    return model.F.xreplace({s: still[s.base] for s in model.F.atoms(sp.Indexed)})


balance = sp.Poly(sp.expand(at_rest(f) - f), ubar)
constraints = [sp.Eq(coefficient, 0) for coefficient in balance.all_coeffs()]
print(*map(sp.latex, constraints), sep="\n")
S, c = sp.linear_eq_to_matrix(constraints, model.symbols)
print("S =", sp.latex(S), r"\quad c =", sp.latex(c))
assert S.rank() == len(constraints) == 4

# %% [markdown]
# Four equations leave five of the nine parameters free. Put into the model's fixed point they leave f alone.

# %%
fixed_point = sp.solve(sp.Eq(ybar, at_rest(ybar)), ybar)[0]
print(sp.latex(sp.Eq(ybar, fixed_point)))
solved = sp.solve(constraints, model.symbols[2], *model.symbols[4:6], model.symbols[8], dict=True)[0]
print(*(sp.latex(sp.Eq(*pair)) for pair in solved.items()), sep="\n")
assert sp.simplify(fixed_point.xreplace(solved) - f) == 0

# %% [markdown]
# ## Short and noisy records
# Ten steps of 10 s each, fitted one step ahead with and without the constraints; judged in free run on a long record
# without noise. Ten such records are drawn.


# %%
def heated(volts):
    """Rise of temperature [K]: two poles behind a power that is f of the input."""
    power = 0.4 * volts + 0.5 * volts**2
    rise = np.full(volts.size, power[0])
    for i in range(2, volts.size):
        rise[i] = 1.2 * rise[i - 1] - 0.27 * rise[i - 2] + 0.07 * power[i - 1]
    return rise


def measured(seed, n=LONG, noise=SENSOR):
    random = np.random.default_rng(seed)
    volts = np.repeat(random.uniform(0, 3, n // 10), 10)
    rise = heated(volts) + noise * random.standard_normal(n)
    return ns.Record.from_arrays(volts, rise, Ts=TS, units={"u": "V", "y": "K"})


second = measured(100, 1000, noise=0.0)
static = sp.lambdify([ubar, model.symbols], fixed_point)
volts = np.linspace(0.1, 3, 200)
exact = sp.lambdify(ubar, f)(volts)
table = Table("record", "free run, without", "free run, constrained", "static curve, without [K]", "constrained [K]")
runs, curves, fits = [], [], []
for seed in range(10):
    record = measured(seed)
    pair = [model.fit(record), model.fit(record, constraints=constraints)]
    fits.append(pair)
    runs.append([ns.evaluate(one, second).free_run_nrmse for one in pair])
    curves.append([float(np.abs(static(volts, list(one.theta)) - exact).max()) for one in pair])
    table.add_row(str(seed), *(f"{e:.3f}" for e in runs[-1]), *(f"{e:.1e}" for e in curves[-1]))
Console().print(table)

# %% [markdown]
# ## The picture
# Of the record that lies in the middle without constraints.

# %%
runs, curves = np.array(runs), np.array(curves)
typical = int(np.argsort(runs[:, 0])[len(runs) // 2])
figure, axes = plots.new_axes(1, 2, figsize=(12, 3.8))
shown = slice(0, 250)
axes[0].plot(second.t[shown], second.y[shown], color=plots.BLACK, ls=":", label="second record")
axes[1].plot(volts, exact, color=plots.BLACK, ls=":", label="f, which is known")
for one, color, name in zip(fits[typical], (plots.BLUE, plots.ORANGE), ("without", "constrained"), strict=True):
    axes[0].plot(second.t[shown], ns.free_run(one, second)[shown], color=color, lw=1, label=name)
    axes[1].plot(volts, static(volts, list(one.theta)), color=color, lw=1, label=name)
axes[0].set(title="free run", xlabel="time [s]", ylabel="rise of temperature [K]")
axes[1].set(title="static curve", xlabel="input at rest [V]", ylabel="rise at rest [K]")
for ax in axes:
    ax.legend(fontsize=8)
figure

# %% [markdown]
# The static curve is exact to rounding on every record, and the free run is better on every record. Where not f but
# points of it are known, they enter the fit with a weight: [](B5_steady_state.py).

# %%
medians = np.median(runs, axis=0)
print(f"Free-run NRMSE, median of ten: {medians[0]:.3f} without, {medians[1]:.3f} constrained.")
assert curves[:, 1].max() < 1e-9 < 1e-2 < curves[:, 0].min()
assert (runs[:, 1] < runs[:, 0]).all() and medians[1] < medians[0] / 1.5
