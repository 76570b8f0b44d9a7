# %% [markdown]
# # B3: the input as a root of a polynomial
# Where the newest input stands in a power, section 4 gives no law: $m_k$ cannot be isolated by a division. A later paper
# of the same group (arXiv 2011.12246; Nonlinear Dynamics, 2021) writes the model as a polynomial whose roots are the
# inputs that may compensate, and puts forward a procedure that chooses among them. Only its abstract could be read here:
# nothing of its examples is reproduced, and the choice below is our own.

# %%
from itertools import pairwise

import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plots

TS = 1.0
rng = np.random.default_rng(4)


def heated(source):
    """A body that is heated by the square of what is asked for, and a part in proportion: rise of temperature [K]."""
    rise = np.zeros(len(source))
    for i in range(1, len(rise)):
        rise[i] = 0.92 * rise[i - 1] + 0.3 * source[i - 1] + 0.5 * source[i - 1] ** 2
    return rise


asked = np.repeat(rng.uniform(0, 4, 150), 20)
record = ns.Record.from_arrays(asked, heated(asked) + 0.2 * rng.standard_normal(asked.size), Ts=TS)
model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2"]).fit(record, method="free_run")
print(ns.latex(model))

# %% [markdown]
# ## The polynomial
# One step ahead, y becomes r and u becomes m. What is known stands in the coefficients.

# %%
law = model.compensator()
print(*law.latex_polynomials())
print(*law.latex_polynomials(numbers=True))

# %% [markdown]
# ## The choice of the root
# The real root nearest to $m_{k-1}$ is taken: the input moves as little as it can. Two roots lie even to both sides of the
# vertex, so that the nearest one is that on the side of $m_{k-1}$; it is written such that nothing cancels. A reference
# that no input reaches is answered with the vertex, and said.

# %%
print(law.latex())
print(*law.lines(numbers=True), sep="\n")

# %% [markdown]
# ## On the machine
# Beside the law of the best linear model of the same record.

# %%
goal = 45 + 35 * np.sin(2 * np.pi * np.arange(600) / 200)
volts = law.run(goal, m0=2.0)
reached = heated(volts)
plain = heated(ns.identify(record, base="linear").compensator().run(goal, m0=2.0))
settled = slice(100, None)
errors = {"by the linear law": ns.mape(goal[settled], plain[settled]),
          "by the root": ns.mape(goal[settled], reached[settled])}  # fmt: skip
table = Table("m", "tracking MAPE [%]", title="A heated body")
for name, error in errors.items():
    table.add_row(name, f"{error:.3f}")
Console().print(table)

# %%
(polynomial,) = law.polynomials
c2, c1, c0 = (
    [float(c.xreplace({ns.r[ns.k]: a, ns.r[ns.k + 1]: b})) for a, b in pairwise(goal)]
    for c in polynomial.held(model.values).coefficients
)
both = np.array([np.sort(np.roots(row).real) for row in zip(c2, c1, c0, strict=True)])
figure, (left, right) = plots.new_axes(1, 2, figsize=(11, 4.2))
t = TS * np.arange(both.shape[0])
left.plot(t, both[:, 1], color=plots.ORANGE, label="the upper root")
left.plot(t, both[:, 0], color=plots.BLUE, ls="--", label="the lower root")
left.plot(t[::15], volts[: t.size : 15], "o", color=plots.BLACK, ms=3, label="m")
left.set(xlabel="time [s]", ylabel="input [V]", ylim=(-4.5, 6.5))
right.plot(t, goal[:-1], color=plots.BLACK, ls=":", label="reference")
right.plot(t, reached[:-1], color=plots.ORANGE, label="by the root")
right.plot(t, plain[:-1], color=plots.BLUE, ls="--", label="by the linear law")
right.set(xlabel="time [s]", ylabel="rise [K]", ylim=(-5, 120))
for ax in (left, right):
    ax.legend(loc="upper right", fontsize=8)
figure

# %% [markdown]
# ## Higher degrees
# Of degree 3 and more the polynomial is derived in the same way. Its nearest root is found by a root finder that loses
# none (bounds over intervals), in Python only: such a law is not exported to C or Structured Text, unless the slope is proved
# never to be zero. Then the root is alone, and sources halve the stretch in which it lies a fixed number of times.

# %%
cubic = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3", "u[k-2]*u[k-1]**2"], [0.9, 0.4, 0.3, -0.1]).compensator()
print(*cubic.latex_polynomials())
print(cubic.lines()[-1])
print(cubic.checked)

# %%
assert law.residual() == 0 and law.closed_form and polynomial.degree == 2
assert np.abs(both[2:, 1] - volts[2 : t.size]).max() < 1e-9  # it never changes the side
assert errors["by the root"] < 0.3 and errors["by the linear law"] > 10 * errors["by the root"]
assert cubic.polynomials[0].degree == 3 and not cubic.closed_form and cubic.residual() == 0
