# %% [markdown]
# # How do I ...?
# Fifteen short answers. They run on simulated machines: copy them, and use your own record. The links lead to more
# detail.

# %%
import tempfile
from pathlib import Path

import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import k, plants

folder = tempfile.TemporaryDirectory()
here = Path(folder.name)
rng = np.random.default_rng(0)


def motor(volts, dead=0, slack=0.0):
    """A simulated motor: a dead zone, a dead time in samples, a lag, and noise of 0.5 %."""
    pushed = np.sign(volts) * np.maximum(np.abs(volts) - slack, 0.0)
    speed = np.zeros(volts.size)
    for i in range(1 + dead, volts.size):
        speed[i] = 0.9 * speed[i - 1] + 0.3 * pushed[i - 1 - dead]
    return speed + 0.005 * speed.std() * rng.standard_normal(speed.size)


volts = plants.filtered_noise(N=1500, Ts=0.01, cutoff=3.0, peak=10.0, seed=1)
other = plants.filtered_noise(N=1000, Ts=0.01, cutoff=3.0, peak=10.0, seed=2)

# %% [markdown]
# ## 1. ... read my CSV, with its units?
# Units are read from the header, or given as `units=`. `notes` lists what was removed, filled or resampled.

# %%
table = np.column_stack([0.01 * np.arange(volts.size), volts, motor(volts)])
np.savetxt(here / "motor.csv", table, fmt="%.7g", delimiter=",", header="t,volts [V],speed [rad/s]", comments="")
record = ns.read(here / "motor.csv", u="volts", y="speed")
print(record, record.units, *record.notes, sep="\n")

# %% [markdown]
# Logs (MDF, TDMS, MATLAB) and Parquet are read in the same way: [](first_record.py).
#
# ## 2. ... identify with a known dead time?
# `delay` is in samples. Without it the dead time is estimated.

# %%
late = ns.Record.from_arrays(volts, motor(volts, dead=5), Ts=0.01, units={"u": "V", "y": "rad/s"})
known = ns.identify(late, base="linear", delay=6)  # 5 samples of dead time, and one of the lag
free = ns.identify(late, base="linear")
print(f"dead time and lag: {known.delay} samples given, {free.delay} found")
print(*known.lines(numbers=True))

# %% [markdown]
# ## 3. ... compare with a second record?
# `evaluate` gives the error of the free run over the whole record, from start states that are estimated on it. It is
# NRMSE: 0 is perfect, 1 is no better than the mean; MATLAB's fit is 100 (1 - NRMSE) %. [](what_the_figures_mean.py)

# %%
linear = ns.identify(record, base="linear")
second = ns.Record.from_arrays(other, motor(other), Ts=0.01, name="second day")
for one in (record, second):
    print(f"{one.name}: NRMSE {ns.evaluate(linear, one).free_run_nrmse:.4f}")

# %% [markdown]
# ## 4. ... find the missing effect, and add it?
# The motor below does not move below 2 V. With `validation` an effect is only added if the error also falls on that
# record, to which no model is fitted.

# %%
stiff = ns.Record.from_arrays(volts, motor(volts, slack=2.0), Ts=0.01, units={"u": "V", "y": "rad/s"})
check = ns.Record.from_arrays(other, motor(other, slack=2.0), Ts=0.01, units={"u": "V", "y": "rad/s"}, name="check")
base = ns.identify(stiff, base="linear")
found = ns.diagnose(base, stiff, machine="drive", validation=check)  # machine: the next answer
print(found.sentence(stiff.units))
better = base.add(found.best).fit(stiff)
errors = [ns.evaluate(model, check).free_run_nrmse for model in (base, better)]
print(f"NRMSE on the second record: {errors[0]:.3f} -> {errors[1]:.4f}")

# %% [markdown]
# An effect of your choice: `base.add("backlash").fit(record)`. What the verdicts mean: [](what_is_missing.py); all
# effects with their loops: {doc}`../reference/generated/effects`.
#
# ## 5. ... say which machine it is?
# Use `machine=`, as above, or `--machine drive`. It excludes impossible effects, adds effects that exist only there,
# and uses the names of that field. If the units show the kind of machine, it is not needed.

# %%
print(*ns.effects.MACHINES, sep=", ")
print(f"{found.machine.name}: not considered: {', '.join(found.excluded)}")

# %% [markdown]
# ## 6. ... say that a column is a disturbance?
# `roles` gives the meaning of further columns: setpoint, input, disturbance, derivative-of-y, integral-of-y or
# ignore. On the command line: `--role load=disturbance`. `diagnose` tries a disturbance automatically, as
# `channel:load`; `lags` makes it an input of a base model.

# %%
load = np.repeat(rng.uniform(-1, 1, 30), 50)
pushed = ns.Record.from_arrays(
    volts, motor(volts) + 3 * load, Ts=0.01, channels={"load": load}, roles={"load": "disturbance"}
)
beside = ns.identify(pushed, base="linear", lags={"load": 2})
print(pushed.roles, *beside.lines(numbers=True), sep="\n")

# %% [markdown]
# ## 7. ... get a compensator, and know whether it is safe?
# `residual` is 0 if the law is the exact inverse. `stability` says whether the law is stable (its own errors decay),
# and for which range the model is known. `commission` simulates the law on many models that fit the record, and says
# go or no go.

# %%
law = linear.compensator()
wanted = 6 * np.sin(2 * np.pi * np.arange(1000) / 400)
print("residual:", law.residual())
print(law.stability())
print(law.commission(wanted, record, limits=(-10, 10), draws=20).sentence())

# %% [markdown]
# The law of the motor with the dead zone jumps over the dead zone, faster than the input moved in the record:

# %%
law = better.compensator()
print("residual:", law.residual())
print(law.commission(wanted, stiff, limits=(-10, 10), draws=20).sentence())

# %% [markdown]
# ## 8. ... export to C, to a PLC, or as an FMU?
# All three respect the limits given here. [](law_on_a_plc.py)

# %%
(here / "law.c").write_text(law.export("c", limits=(-10, 10)))
(here / "law.st").write_text(law.export("st", limits=(-10, 10)))
(here / "motor.fmu").write_bytes(better.export("fmu", units={"u": "V", "y": "rad/s"}))
print(*(f"{path.name}: {path.stat().st_size} bytes" for path in sorted(here.glob("*.[csf]*"))), sep="\n")

# %% [markdown]
# ## 9. ... get physical quantities?
# `continuous` gives the differential equation of a model and its physical quantities, with 95 % intervals that are
# valid for white noise and the correct structure. `scale` gives the force per unit of the input:
# [](in_physical_units.py).

# %%
physical = linear.continuous(records=record, units=record.units)
print(physical.text)

# %% [markdown]
# ## 10. ... write an effect of my own?
# Write a function that returns its equation. `x` is the driving signal; `scan` gives the start values of `s`.
# [](effect_of_your_own.py)


# %%
@ns.effect("input", scan={"s": ns.Scan("amplitude", (0.2, 0.5, 1.0))}, source="our notebook, 2026")
def soft_start(x, s):
    """The amplifier gives less around zero."""
    return -x[k] * sp.exp(-((x[k] / s) ** 2))


print(ns.EFFECTS["soft_start"], "|", ns.EFFECTS.pop("soft_start")[0].written)

# %% [markdown]
# ## 11. ... use several records, with gaps?
# A list of records is one data set for one model. A gap in the time column splits a record; each piece has its own
# start states. Rows with missing values are refused unless `missing="drop"`.

# %%
holes = np.delete(table, np.s_[700:800], axis=0)
np.savetxt(here / "holes.csv", holes, fmt="%.7g", delimiter=",", header="t,u,y", comments="")
pieces = ns.read(here / "holes.csv")
both = ns.identify([pieces, second], base="linear")
print(*pieces.notes, f"a new piece begins at sample {pieces.breaks[0]}", sep="\n")
print(f"NRMSE on both records: {ns.evaluate(both, [pieces, second]).free_run_nrmse:.4f}")

# %% [markdown]
# ## 12. ... use a record from a closed loop?
# Record the setpoint, and give its role: `roles={"wanted": "setpoint"}`. Feedback is mostly detected without it too.
# Then the verdict is `closed_loop`, and no effect is named unless the setpoint causes nearly all movement of the
# input. A record in manual mode is better. If there was no controller, use `open_loop=True`.

# %%
wish = np.repeat(rng.uniform(-10, 10, 30), 50)
command, answer, total = np.zeros(1500), np.zeros(1500), 0.0
for i in range(1, 1500):
    answer[i] = 0.9 * answer[i - 1] + 0.3 * command[i - 1] + 0.05 * rng.standard_normal()
    total += 0.02 * (wish[i] - answer[i])
    command[i] = 0.5 * (wish[i] - answer[i]) + total
looped = ns.Record.from_arrays(command, answer, Ts=0.01, channels={"wish": wish}, roles={"wish": "setpoint"})
told = ns.diagnose(ns.identify(looped, base="linear"), looped)
print(told.verdict)

# %% [markdown]
# ## 13. ... make it fast?
# `simulate` runs machine code. `lambdify` makes a plain function of one step, for NumPy, machine code (`"native"`) or
# CasADi; call it in your own loop. Figures: [](../results/speed.md).

# %%
long = np.resize(volts, 100_000)
run = better.simulate(long, y0=0.0, u0=0.0, warn=False)
step = better.lambdify("native")
print(f"{run.size} samples; the step takes {step.arguments} and gives {step.returns}")

# %% [markdown]
# ## 14. ... get LaTeX of everything?
# `ns.latex` takes a model, a law, a condition, a list of these, or any expression. `latex(numbers=True)` shows
# numbers instead of symbols.

# %%
print(ns.latex(better))

# %%
print(better.latex(numbers=True))

# %%
print(ns.latex(law))

# %% [markdown]
# ## 15. ... put two models in series?
# Use `first >> second`; `first + second` connects in parallel, `first.feedback(second)` as a loop. The result is a
# normal model, with a law.

# %%
sensor = ns.NARX.from_terms(["y[k-1]", "u[k]"], [0.5, 0.5], Ts=0.01)
chain = better >> sensor
print(*chain.lines(), sep="\n")

# %%
folder.cleanup()
assert record.units == {"u": "V", "y": "rad/s"}
assert known.delay == 6
assert found.verdict == "named" and found.best.effect == "dead_zone"
assert errors[1] < errors[0] / 3
assert "sqrt_outflow" in found.excluded
assert "load[" in " ".join(beside.lines())
assert law.residual() == 0
assert pieces.breaks == (700,)
assert told.verdict == "closed_loop"
assert np.isfinite(run).all()
