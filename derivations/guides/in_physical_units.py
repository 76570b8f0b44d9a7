# %% [markdown]
# # A model in newtons and seconds
# A fitted model is a difference equation, "y[k] = 1.98 y[k-1] - 0.98 y[k-2] + ..."; a data sheet gives mass, friction
# and dead time. For an input with a zero-order hold one follows from the other: a pole p of the difference equation
# is exp(s Ts) of the pole s of the differential equation, and a steady input u adds B(1) u, so an effect that adds z
# to the equation corresponds to the force z/B(1).

# %%
import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym.models.extend import Variant, extend, find

# %% [markdown]
# ## A slide with dry friction
# The slide has a mass of 12 kg, a drive with 8 N/V, viscous friction of 40 N s/m, and dry friction of 5 N, which is
# reached at 0.02 m/s. It is simulated by the Runge-Kutta method with ten steps per sample and 1 % noise.

# %%
mass, oil, dry, slow, drive, Ts = 12.0, 40.0, 5.0, 0.02, 8.0, 0.005
rng = np.random.default_rng(0)
volts = np.repeat(rng.uniform(-5, 5, 100), 40)
way, v, h = np.zeros(volts.size), 0.0, Ts / 10


def faster(v, u):
    return (drive * u - oil * v - dry * np.tanh(v / slow)) / mass


for i in range(1, volts.size):
    way[i] = way[i - 1]
    for _ in range(10):
        a = faster(v, volts[i - 1])
        b = faster(v + h / 2 * a, volts[i - 1])
        way[i] += h * (v + h / 2 * b)
        v += h * b
record = ns.Record.from_arrays(volts, way + 0.01 * way.std() * rng.standard_normal(way.size), Ts=Ts)

# %% [markdown]
# ## The recursion
# Two lags of the output, whose coefficients add up to 1 because the slide stays where it is, and smooth Coulomb friction.

# %%
base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], Ts=Ts)
a1, a2, *_ = base.symbols
base = base.replace(constraints=[sp.Eq(a1 + a2, 1)])
(form,) = (f for f in find("coulomb_friction")[0] if f.form == "smooth")
begin = extend(base, Variant(form, "inside", "y")).model.replace(theta=[1.98, -0.98, 1e-5, 1e-5, -1e-5, 1e-4], Ts=Ts)
model = begin.fit(record, method="free_run")
print(model.latex(numbers=True))

# %% [markdown]
# ## The differential equation
# `scale` gives the force per unit of the input. With `records` each quantity has a 95 % interval, from the covariance
# of the fit by the delta method, for white noise. With coloured errors or a wrong structure the true intervals are
# wider. On the command line: `narx-sym derive model.json --continuous --scale u=8N/V --data record.csv`.

# %%
found = model.continuous(scale="8 N/V", records=record, units={"u": "V", "y": "m"})
print(ns.latex(found))
print(found.text)
for note in found.notes:
    print(note)

# %% [markdown]
# Each quantity is an expression in the parameters and in p_1, the pole that is not at 1.

# %%
print(ns.latex(found["mass"].expression))

# %%
true = {"mass": mass, "viscous friction": oil, "Coulomb friction": dry}
assert found.exact
assert all(found[n].low - found[n].error < value < found[n].high + found[n].error for n, value in true.items())
assert all(abs(found[n].value / value - 1) < 0.02 for n, value in true.items())
