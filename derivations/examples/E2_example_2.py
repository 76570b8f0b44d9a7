# %% [markdown]
# # E2: Example 2, the algebraic inversion
# Example 1 cannot be inverted: there $u_{k-1}$ also enters in products and inside a sign (Assumption A1(i)).
# Example 2 delays those terms (Eq. 190919c). Wanted: $A(q)$, $B(q)$, $f$ and the law $m_k$ (Eqs. 200919b-g).

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import plots
from narx_sym.inversion.compensator import q

k, m, r, u, y = ns.k, ns.m, ns.r, ns.u, ns.y

example_1 = ns.NARX.from_terms(["y[k-1]", "phi2[k-1]", "phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]", "phi1[k-1]"])
try:
    example_1.compensator()
    refused = ""
except ns.NotInvertible as error:
    refused = str(error)
print(refused)

# %%
model = ns.NARX.from_terms(["y[k-1]", "phi2[k-2]", "phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]", "phi1[k-1]"])
print(ns.latex(model))
print(ns.latex(model.expand()))

# %% [markdown]
# ## Grouping and law
# The linear regressors go to $A$ and $B$, all else to $f$. Then $y \to r$, $u \to m$, one step ahead.

# %%
law = model.compensator()
for name, part in (("A(q)", law.A), ("B(q)", law.B), ("f", law.f)):
    print(f"{name} = {ns.latex(part)}")
print(ns.latex(law))

# %% [markdown]
# ## The law in its own model
# Put back into the model, the law gives the reference: by algebra, and in numbers. The run starts at rest.
# The law has an eigenvalue that is exactly 1: an offset of m does not decay.

# %%
model = model.replace(theta=[1.0, 0.005, 0.0005, -0.01, 0.7])
t = 1e-3 * np.arange(3261)
reference = 15 * np.sin(2 * np.pi * np.maximum(t - 0.01, 0))
law = model.compensator()
volts = law.run(reference, m0=0.0)
output = model.simulate(volts, y0=0.0)
error = np.abs(output - reference).max()
print(f"largest tracking error of the model: {error:.1e} um")

figure, (time, loop) = plots.new_axes(1, 2, figsize=(10, 4))
first, last = slice(0, 3000), slice(-1001, -1)
time.plot(t[first], reference[first], color=plots.BLACK, lw=2.5, label="reference r [um]")
time.plot(t[first], output[first], color=plots.ORANGE, ls="--", lw=1.4, label="model output under the law [um]")
time.plot(t[first], volts[first], color=plots.BLUE, ls=":", lw=1.8, label="input m from the law [V]")
time.set(xlabel="time [s]", ylabel="r, y [um], m [V]", ylim=(-24, 34))
time.legend(loc="upper right", fontsize=8)
loop.plot(reference[last], volts[last], color=plots.BLUE, label="m against r: the inverse loop")
loop.plot(reference[last], output[last], color=plots.ORANGE, ls="--", label="y against r: a line")
loop.set(title="one period, from turning point to turning point", xlabel="r [um]", ylabel="m [V], y [um]")
loop.legend(loc="upper left", fontsize=8)
figure

# %%
a, b, c, d, e = model.symbols
step, turn = u[k - 2] - u[k - 3], m[k - 1] - m[k - 2]
f = b * sp.sign(step) + c * step * u[k - 2] + d * sp.sign(step) * step * y[k - 1]
paper = r[k + 1] - a * r[k] + e * m[k - 1] - b * sp.sign(turn) - c * turn * m[k - 1] - d * sp.sign(turn) * turn * r[k]
assert "phi2[k-1]" in refused and "A1(i)" in refused
assert sp.simplify(law.A - (1 - a / q)) == 0
assert sp.simplify(law.B - (e / q - e / q**2)) == 0
assert sp.simplify(sp.expand(law.f - f)) == 0
assert sp.simplify(sp.expand(law.equation.rhs - paper / e)) == 0
assert law.residual() == 0
assert error < 1e-9
