# %% [markdown]
# # Several inputs and outputs
# A model with several outputs is a recursion with several output equations. Each output has its own model, in which
# the other outputs are channels. A `System` connects these models: it is simulated, has steady states, and is
# inverted as a whole.

# %%
import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp

import narx_sym as ns

# %% [markdown]
# ## A two-input bilinear system
# The equilibrium, the sensitivities and the law are derived. For the law each output is replaced by its reference,
# each input by m, and the equations are solved for all m[k] together (the decoupling matrix: Isidori 1995).

# %%
first = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u2[k-1]*y[k-1]"], [0.8, 0.5, 0.1], channels=["u2"])
second = ns.NARX.from_terms(["y[k-1]", "u2[k-2]", "y1[k-1]"], [0.7, 0.4, 0.2], channels=["u2", "y1"])
bilinear = ns.System({"y1": first, "y2": second})
print(bilinear.latex())
for name, value in bilinear.equilibria(numbers=False)[0].items():
    print(name, "=", sp.factor(value))
law = bilinear.compensator()
print(law.latex())

t = np.arange(300) / 30
wanted = {"y1": 0.5 + 0.3 * np.sin(t), "y2": 0.4 + 0.2 * np.cos(0.7 * t)}
runs = bilinear.simulate(law.run(wanted), {n: r[:2] for n, r in wanted.items()})
missed = max(np.abs(runs[n][5:-3] - wanted[n][5:-3]).max() for n in wanted)
print(f"residual {law.residual()}, both outputs follow to {missed:.1e}")

# %% [markdown]
# ## Two coupled tanks, and a two-mass drive, from their equations
# The equations of each output are written separately (`from_equations`); a channel with the name of another output is
# connected to it. There the other output is constant during a sample, so the sampling time must be short. The
# reference solution comes from an ODE solver.

# %%
upper = ns.from_equations("y' = a*u - b*sqrt(y)\na ~ 0.06\nb ~ 0.045", 0.5)
lower = ns.from_equations("y' = b*sqrt(h1) - e*sqrt(y)\nh1 = channel\nb ~ 0.045\ne ~ 0.05", 0.5)
tanks = ns.System({"h1": upper, "h2": lower})
clock = np.arange(2000) * 0.5
pump = 1.5 + 0.5 * np.sin(0.01 * clock)
flow = solve_ivp(
    lambda s, h: [
        0.06 * (1.5 + 0.5 * np.sin(0.01 * s)) - 0.045 * np.sqrt(h[0]),
        0.045 * np.sqrt(h[0]) - 0.05 * np.sqrt(h[1]),
    ],
    (0, clock[-1]), [2.0, 3.0], t_eval=clock, rtol=1e-9,
).y  # fmt: skip
levels = tanks.simulate({"u": pump}, {"h1": 2.0, "h2": 3.0})
off = max(np.abs(levels[n] - truth).max() / np.ptp(truth) for n, truth in zip(("h1", "h2"), flow, strict=True))
print(f"tanks: within {100 * off:.2f} % of the range of the differential equation")

# %%
motor = "v1' = (u - s*(x1 - x2) - d*v1)/0.5\nx1' = v1\ny = x1\nx2 = channel\ns ~ 4\nd ~ 0.6"
load = "x2'' = s*(x1 - x2) - d*x2'\ny = x2\nx1 = channel\ns ~ 4\nd ~ 0.4"
drive = ns.System({"x1": ns.from_equations(motor, 0.002), "x2": ns.from_equations(load, 0.002)})
clock = np.arange(4000) * 0.002
truth = solve_ivp(
    lambda s, z: [
        z[1], (np.sin(2 * s) - 4 * (z[0] - z[2]) - 0.6 * z[1]) / 0.5, z[3], 4 * (z[0] - z[2]) - 0.4 * z[3]
    ],
    (0, clock[-1]), np.zeros(4), t_eval=clock, rtol=1e-9, atol=1e-10,
).y  # fmt: skip
turned = drive.simulate({"u": np.sin(2 * clock)})
swung = max(np.abs(turned[n] - truth[i]).max() / np.ptp(truth[i]) for n, i in (("x1", 0), ("x2", 2)))
print(f"drive: within {100 * swung:.2f} %")

# %% [markdown]
# ## From measurements
# `ns.read("plant.csv", u=["valve1", "valve2"], y=["level1", "level2"])` reads a record like this one. Each input gets
# its own number of lags and dead time, and the outputs are coupled if this improves the free run of the whole system.
# On the command line: `narx-sym fit plant.csv --input valve1,valve2 --output level1,level2 --out plant.json`.

# %%
rng = np.random.default_rng(0)
u, u2 = (np.repeat(rng.standard_normal(200), hold)[:2000] for hold in (12, 17))
late = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u2[k-3]"], [0.8, 0.5, 0.1], channels=["u2"])
runs = ns.System({"y1": late, "y2": second}).simulate({"u": u, "u2": u2})
y1, y2 = (runs[n] + 0.01 * np.std(runs[n]) * rng.standard_normal(2000) for n in ("y1", "y2"))
roles = {"u2": "input", "y1": "output", "y2": "output"}
record = ns.Record.from_arrays(u, y1, Ts=0.1, channels={"u2": u2, "y1": y1, "y2": y2}, roles=roles)
found = ns.identify_outputs(record)
print(found.equilibria())
print({name: round(errors.free_run_nrmse, 4) for name, errors in found.evaluate(record).items()})

# %% [markdown]
# Each part is a normal model, for `ns.diagnose` and `compensator` too. A law can use some of the inputs,
# `compensator(inputs=("u",))`; the others are measured. A diagnosis offers every effect at each input, and
# `found.export("c")` steps all outputs.

# %%
assert law.residual() == 0 and missed < 1e-9
assert off < 0.01 and swung < 0.01
assert all(errors.free_run_nrmse < 0.011 for errors in found.evaluate(record).values())
