# %% [markdown]
# # V1: the pneumatic valve, published models and their laws
# Section 6 prints both models with numbers, 10 ms. Wanted: both laws, symbol by symbol.

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import plots
from narx_sym.inversion.stability import direction, mbar, rbar

k, m, r = ns.k, ns.m, ns.r
NUMBERS = [sp.Rational(x) for x in ("1", "-19.76", "19.32", "9.44", "-12.61")]
INVERSE_NUMBERS = [sp.Rational(x) for x in ("1", "86.67", "-85.02", "-0.98", "1.72", "-1.13")]
model = ns.NARX.from_terms(
    ["y[k-1]", "phi1[k-2]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"],
    theta=[float(x) for x in NUMBERS],
    Ts=0.01,
)
inverse = ns.NARX.from_terms(
    [
        "u[k-1]", "phi1[k-1]", "phi1[k-2]", "phi1[k-1]*y[k-2]",
        "phi2[k-2]*phi1[k-2]*y[k-2]", "phi2[k-2]*phi1[k-2]*u[k-1]",
    ],
    theta=[float(x) for x in INVERSE_NUMBERS],
    input="y", output="u", lead=2,
)  # fmt: skip
print(model.latex(numbers=True))
print(inverse.latex(numbers=True))

# %% [markdown]
# ## The laws

# %%
law, second = model.compensator(), inverse.compensator()
print(law.latex(numbers=True))
print(second.latex(numbers=True))

# %% [markdown]
# ## The law has dynamics of its own
# With r at rest, $m_k - m_{k-1}$ is the last increment times a factor. Above 1 the law runs away from a rest:
# at $m = r = 3$ it does so while rising and does not while falling. The condition of section 3, applied to the law,
# says so before anyone wires it to a valve. The law's other eigenvalue is exactly 1: it integrates.

# %%
internal = law.internal
print(ns.latex(internal.eigenvalue))
print("repelling where", ns.latex(internal.region))
exact = law.law.xreplace(dict(zip(model.symbols, NUMBERS, strict=True)))
level, goal, dm = sp.symbols("m r dm", positive=True)
factors = {}
for name, s in (("rising", 1), ("falling", -1)):
    new = exact.xreplace({m[k - 1]: level, m[k - 2]: level - s * dm, r[k]: goal, r[k + 1]: goal})
    factors[name] = sp.simplify((new - level) / (s * dm))
    number = float(factors[name].subs({level: 3, goal: 3}))
    print(f"while m is {name} the factor at m = r = 3 is {number:.3f}:", ns.latex(factors[name]))

# %% [markdown]
# ## Both laws at work
# r = 0.56 sin(0.2πt) + 3 V, from rest at m = r = 3. The first law leaves at once for 5 V, as its factor of 1.515 says,
# then stays around 4 V, where the factor is about 1; its model follows exactly all the while.
# The printed law of the inverse moves m against r: its direct gain 86.67 - 85.02 - 0.98 r is negative at r = 3.

# %%
t = 0.01 * np.arange(6005)
reference = 0.56 * np.sin(0.2 * np.pi * np.maximum(t - 0.05, 0)) + 3
volts, second_volts = law.run(reference, m0=3.0), second.run(reference, m0=3.0)
visit = internal.along(volts, reference, m0=3.0)
print(visit.sentence(model.Ts))
followed = model.simulate(volts, y0=3.0)
error = np.abs(followed - reference).max()
print(f"largest error of the model under its own law: {error:.1e} V")

figure, (left, middle, right) = plots.new_axes(1, 3, figsize=(14, 4.2))
for x, colour, style, name in (
    (volts, plots.ORANGE, "-", "law of M"),
    (second_volts, plots.BLUE, "--", "law of the inverse"),
):
    # The last samples, where the reference is held beyond its end, are not drawn.
    left.plot(t[:-3], x[:-3], color=colour, ls=style, lw=1.4, label=name)
    middle.plot(reference[5000:-3], x[5000:-3], color=colour, ls=style, lw=1.4, label=name)
left.plot(t, reference, color=plots.BLACK, lw=1, ls=":", label="reference")
left.set(xlabel="time [s]", ylabel="m, r [V]", ylim=(2.2, 6.9))
middle.set(xlabel="r [V]", ylabel="m [V]", title="last period", ylim=(2.8, 5.8))
levels = np.linspace(2.4, 5.2, 50)
for (name, factor), colour, style in zip(factors.items(), (plots.BLUE, plots.RED), ("-", "--"), strict=True):
    right.plot(levels, sp.lambdify(level, factor.subs(goal, 3))(levels), color=colour, ls=style, label=f"m {name}")
right.axhline(1, color=plots.BLACK, lw=1, ls=":", label="limit")
right.set(xlabel="m [V], at r = 3 V", ylabel="factor on the last increment of m")
left.legend(loc="upper left", fontsize=9)
middle.legend(loc="upper left", fontsize=9)
right.legend(loc="upper center", fontsize=9)
figure

# %%
plots.plot_internal(law, volts[:-3], reference[:-3], units={"u": "V", "y": "V"})

# %%
sign = sp.sign
a, b, c, d = (sp.Rational(x) for x in ("19.76", "19.32", "9.44", "12.61"))
turn = m[k - 1] - m[k - 2]
paper = (
    r[k + 1] - r[k] + b * m[k - 1] + a * turn - c * sign(turn) * turn * m[k - 1] + d * sign(turn) * turn * r[k]
) / b
assert sp.simplify(sp.expand(exact - paper)) == 0 and law.residual() == 0
a2, b2, c2, d2, e2 = (sp.Rational(x) for x in ("86.67", "85.02", "0.98", "1.72", "1.13"))
new, old = r[k + 1] - r[k], r[k] - r[k - 1]
second_paper = (
    m[k - 1] + a2 * new - b2 * old - c2 * new * r[k] + d2 * sign(old) * old * r[k] - e2 * sign(old) * old * m[k - 1]
)
second_exact = second.law.xreplace(dict(zip(inverse.symbols, INVERSE_NUMBERS, strict=True)))
assert sp.simplify(sp.expand(second_exact - second_paper)) == 0
assert sp.simplify(factors["rising"] - (a - c * level + d * goal) / b) == 0
assert sp.simplify(factors["falling"] - (a + c * level - d * goal) / b) == 0
at_three = [float(f.subs({level: 3, goal: 3})) for f in factors.values()]
assert np.allclose(at_three, [1.515, 0.531], atol=1e-3)
by_analysis = {s: internal.eigenvalue.subs({direction: s, mbar: level, rbar: goal}) for s in (1, -1)}
assert all(abs(float(c)) < 1e-9 for c in sp.Poly(by_analysis[1] - factors["rising"], level, goal).coeffs())
assert all(abs(float(c)) < 1e-9 for c in sp.Poly(by_analysis[-1] - factors["falling"], level, goal).coeffs())
assert internal.integrates and internal.repelling(3, 3, 1) and not internal.repelling(3, 3, -1)
# The reference enters the region on its first steps and leaves it again: flagged, and no divergence.
assert visit.noteworthy and visit.first < 20 and visit.largest > 1.5 and visit.rate < 1
assert ns.analysis.continuum(model) and ns.analysis.continuum(inverse)
assert error < 1e-9
assert volts[:100].max() > 5 and abs(volts[3000:-3].mean() - 4) < 0.2
assert np.corrcoef(reference[3000:-3], second_volts[3000:-3])[0, 1] < -0.5
