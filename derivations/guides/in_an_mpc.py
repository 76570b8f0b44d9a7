# %% [markdown]
# # A completed model in an MPC
# A model predictive controller needs one step of a model that can be differentiated. `model.export("casadi")` is this
# step, with all added effects. Here a positioner with a lag and a slack of ±0.25 (backlash) follows a sine, driven
# once by the closed-form law and once by an MPC in plain CasADi.
#
# The machine is simulated independently; the backlash is found from a record of it ([](what_is_missing.py)).

# %%
import time

import casadi as ca
import numpy as np
import sympy as sp
from matplotlib.figure import Figure

import narx_sym as ns

SLACK, POLE, TS = 0.25, 0.85, 0.01
rng = np.random.default_rng(4)


class Machine:
    """A slack, then a lag; at rest in the middle of the slack."""

    def __init__(self):
        self.y = self.z = 0.0

    def step(self, u):
        """Move with an input; the output shows it one sample later."""
        self.z = min(max(self.z, u - SLACK), u + SLACK)
        self.y = POLE * self.y + (1 - POLE) * self.z

    def run(self, inputs):
        outputs = []
        for u in inputs:
            outputs.append(self.y)
            self.step(u)
        return np.array(outputs)


volts = np.interp(np.arange(2000), np.arange(80) * 25, rng.uniform(-2, 2, 80))
record = ns.Record.from_arrays(volts, Machine().run(volts) + 0.003 * rng.standard_normal(volts.size), Ts=TS)
base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], Ts=TS).fit(record)
found = ns.diagnose(base, record)
model = found.model
print(found.sentence())
print(*model.lines(numbers=True), sep="\n")

# %% [markdown]
# ## The switching, smoothed
# After a reversal of the input the derivative of the next outputs is zero until the slack is taken up, so a
# gradient-based solver cannot improve there. Only in the controller we use
#
# $$\max(a, b) \approx \tfrac12\left(a + b + \sqrt{(a - b)^2 + \varepsilon^2}\right), \qquad \varepsilon = 0.02,$$
#
# with an error of at most $\varepsilon/2$, at $a = b$; inside the slack the error adds up from sample to sample. The
# rest of the model is unchanged: this is only a substitution.

# %%
EPSILON = sp.Rational(2, 100)


def soft(expr):
    def larger(a, b):
        return (a + b + sp.sqrt((a - b) ** 2 + EPSILON**2)) / 2

    expr = expr.replace(sp.Max, larger)
    return expr.replace(sp.Min, lambda a, b: -larger(-a, -b))


smooth = model.replace(states=[state.map(soft) for state in model.states])
loop = np.sin(np.arange(600) / 40)
apart = np.abs(smooth.simulate(loop, 0.0, warn=False) - model.simulate(loop, 0.0, warn=False)).max()
print(f"the smoothed model is {apart:.3f} off at most, over an output from -1 to 1")

# %% [markdown]
# ## The controller
# The controller looks twelve samples ahead and uses single shooting and IPOPT, with the last plan as first guess. The
# exact model computes the internal states of effects from the inputs that were sent; the outputs in the state are the
# measured ones.

# %%
AHEAD, EFFORT = 12, 1e-4


def controller(rate):
    step = smooth.export("casadi", "step")
    start, before = ca.MX.sym("start", step.size1_in(0)), ca.MX.sym("before")
    plan, wanted = ca.MX.sym("plan", AHEAD), ca.MX.sym("wanted", AHEAD)
    _, outputs = step.mapaccum(AHEAD)(start, plan.T)
    moves = plan - ca.vertcat(before, plan[:-1])
    cost = ca.sumsqr(outputs.T - wanted) + EFFORT * ca.sumsqr(moves)
    problem = {"x": plan, "p": ca.vertcat(start, before, wanted), "f": cost, "g": moves}
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 60, "tol": 1e-6}}
    solve = ca.nlpsol("solve", "ipopt", problem, quiet)

    def decide(state, last, sight, guess):
        found = solve(x0=guess, p=np.concatenate([state, [last], sight]), lbg=-rate, ubg=rate)
        return np.array(found["x"]).ravel()

    return decide


def driven_by_mpc(sight, rate):
    decide, follow, machine = controller(rate), model.export("casadi", "follow"), Machine()
    measured = [i for i, sample in enumerate(model.recursion.past) if sample == ns.y[ns.k - 1]]
    state, last, plan = model.rest_state(u=0.0, y=0.0), 0.0, np.zeros(AHEAD)
    inputs, outputs, seconds = [], [], []
    for i in range(len(sight) - AHEAD):
        begin = time.perf_counter()
        plan = decide(state, last, sight[i : i + AHEAD], plan)
        seconds.append(time.perf_counter() - begin)
        last = float(np.clip(plan[0], last - rate, last + rate))
        outputs.append(machine.y)
        machine.step(last)
        state = np.array(follow(state, [last])[0]).ravel()
        state[measured] = outputs[-1]
        plan = np.append(plan[1:], plan[-1])
        inputs.append(last)
    return np.array(inputs), np.array(outputs), float(np.median(seconds))


# %% [markdown]
# ## The law
# The same model solved for its input; see [](law_on_a_plc.py). It uses no measurements. It knows one reference sample
# ahead and the limit of the input's change, but not the later reference.

# %%
law = model.compensator()


def driven_by_law(reference, rate):
    limit = rate if np.isfinite(rate) else None
    law.follow(reference, 0.0, rate=limit)  # compiled once
    begin = time.perf_counter()
    found = law.follow(reference, 0.0, rate=limit)
    seconds = (time.perf_counter() - begin) / len(reference)
    return found.m, Machine().run(found.m), seconds


# %% [markdown]
# ## Both, side by side
# First the input may change freely, then by at most 0.05 per sample: then it takes ten samples to cross the slack of
# 0.5.

# %%
PERIOD, RATE = 150, 0.05
sight = np.sin(2 * np.pi * np.arange(3 * PERIOD + AHEAD) / PERIOD)
reference = sight[: 3 * PERIOD]
runs, errors, paces = {}, {}, {}
for rate in (np.inf, RATE):
    for name, drive, known in (("law", driven_by_law, reference), ("MPC", driven_by_mpc, sight)):
        inputs, outputs, pace = drive(known, rate)
        off = (outputs - reference)[PERIOD:]  # without the start from the middle of the slack
        runs[name, rate], paces[name, rate] = (inputs, outputs), pace
        errors[name, rate] = 100 * float(np.sqrt(np.mean(off**2))) / np.ptp(reference)
        moves = "free" if np.isinf(rate) else f"{rate:g} per sample"
        print(f"{name}, moves {moves}: {errors[name, rate]:.3f} % rms of the range, {1e3 * pace:.3g} ms per step")

# %%
figure = Figure(figsize=(8, 7), layout="constrained")
top, middle, bottom = figure.subplots(3, 1, sharex=True)
t = TS * np.arange(len(reference))
top.plot(t, reference, color="0.6", linewidth=3, label="reference")
for name, style in (("law", "-"), ("MPC", "--")):
    inputs, outputs = runs[name, RATE]
    top.plot(t, outputs, style, label=name)
    middle.plot(t, outputs - reference, style, label=name)
    bottom.step(t, inputs, style, where="post", label=name)
top.set(ylabel="output", title=f"Moves of {RATE} per sample at most")
middle.set(ylabel="error")
bottom.set(ylabel="input", xlabel="time [s]")
top.legend()
figure

# %% [markdown]
# **The law** is better if the input may jump: it inverts the exact model in microseconds, and can be exported as a
# block for a PLC. **The MPC** is better if limits are active and the reference is known in advance: it reverses
# before the reference does, so that the slack is crossed in time, but it needs a solver and milliseconds. Where no
# limit is active, the smoothing makes it less accurate.

# %%
free, bound = np.inf, RATE
assert errors["law", free] < errors["MPC", free] < 0.2
assert errors["MPC", bound] < 0.5 * errors["law", bound]
assert all(paces["law", rate] < paces["MPC", rate] for rate in (free, bound))
assert all(np.abs(np.diff(runs[name, bound][0])).max() <= bound + 1e-9 for name in ("law", "MPC"))
