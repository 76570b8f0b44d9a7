# %% [markdown]
# # Equations of your own: what is missing?
# If you know the physics of a machine, write down its equations, and find what is missing from *them*. Use one line
# per equation, parameter or name. The text is parsed by a grammar and never executed.

# %%
import numpy as np

import narx_sym as ns

PENDULUM = """
# a pendulum with a motor at its joint; what rubs there is forgotten
phi'' = -w*sin(phi) - d*phi' + b*u
y = phi
w ~ 8 in 1 ... 100        # g over the length [1/s^2]: a first value, and bounds where there are some
d ~ 0.5 in 0.001 ... 10   # [1/s]
b ~ 1.2
"""

# %% [markdown]
# ## The machine
# Simulated in continuous time, with dry friction in the joint and 0.5 % noise.

# %%
Ts, N = 0.02, 2000
t = np.arange(N) * Ts
torque = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in ((2, 0.3, 0), (2, 0.11, 1), (1, 0.7, 2)))


def slope(x, u):
    return np.array([x[1], -9 * np.sin(x[0]) + u - 0.3 * x[1] - 0.5 * np.tanh(x[1] / 0.01)])


x, angle = np.zeros(2), []
for u in torque:
    angle.append(x[0])
    for _ in range(10):
        half = x + Ts / 20 * slope(x, u)
        x = x + Ts / 10 * slope(half, u)
noise = 0.005 * np.std(angle) * np.random.default_rng(1).standard_normal(N)
record = ns.Record.from_arrays(torque, angle + noise, Ts=Ts)

# %% [markdown]
# ## The equations as a model
# At the sampling time of the record the equations become a difference equation: here the linear part is exact, and
# gravity is evaluated at the middle of three samples.

# %%
own = ns.from_equations(PENDULUM, record.Ts)
print(own.latex())
fitted = own.fit(record, method="free_run")
print(fitted.table())
print(f"free-run NRMSE {ns.evaluate(fitted, record).free_run_nrmse:.4f}")

# %% [markdown]
# ## What is missing

# %%
found = ns.diagnose(fitted, record)
print(found.sentence({"y": "rad"}))
print({str(s): round(float(v), 6) for s, v in found.model.values.items()})

# %% [markdown]
# The friction is found, and with it the correct constants of the machine: 9 and 0.3 were simulated. Without it the
# damping had to replace the friction.
#
# ## The same at the command line
#
# ```console
# narx-sym fit swing.csv --base pendulum.txt --out pendulum.json
# narx-sym diagnose swing.csv --base pendulum.txt --report found.html
# ```
#
# A measured axis (EMPS) with the four lines `x'' = (35.15*u - d*x' + o)/m`, `y = x`, `m ~ 90 in 10 ... 500` and so on is
# told friction, and with `model.add("coulomb_friction", "force")` its mass is 96.4 kg, its friction 19.0 N, its error
# 2.4 mm on the record and 4.9 mm on the test record.
#
# ## Several states
# Levels and speeds that are not measured start from given values, or their start values are estimated; effects may
# act on them. For two tanks with an overflow of the upper one the result is: "end stop, on the motion of h1".
#
#     q = b*sign(h1)*sqrt(Abs(h1))
#     h1' = a*u - q
#     h2' = q - e*sign(h2)*sqrt(Abs(h2))
#     y = h2
#     h1(0) = y
#
# ## A model without equations: an FMU
#
# An FMU for co-simulation (FMI 2.0 or 3.0; `pip install "narx-sym[fmu]"`) is seen at its input and output only. **It holds
# native code, which runs with all your rights**: name only one that you trust.
#
# ```console
# narx-sym compare plant.fmu swing.csv --input volts --output angle
# narx-sym diagnose swing.csv --base plant.fmu --input volts --output angle
# ```
#
# In Python: `plant = ns.from_fmu("plant.fmu")`, `record = plant.beside(ns.read("swing.csv"))`,
# `found = ns.diagnose(plant.model([record]), record)`. Its own run along the record is a channel; what differs from it goes
# through a linear model that is identified from that run. What is named at the input is tried once more with the FMU
# itself, along what the effect lets through: `plant.again(found, [record])` is its error then. Where no linear model
# follows the FMU to 10 %, only its output is diagnosed. It cannot be saved as a model, and it has no law.

# %%
values = {str(s): float(v) for s, v in found.model.values.items()}
assert found.best.effect in ("coulomb_friction", "stribeck_friction")
assert abs(values["w"] / 9 - 1) < 0.03 and abs(values["d"] / 0.3 - 1) < 0.1
