# %% [markdown]
# # B4: three systems, at most five terms
# A report of the same group (Tavares, Abreu, Aguirre, arXiv 2011.10109) identifies NARX models for compensation: of a heater
# (a Hammerstein model), of a piezo actuator (Bouc-Wen) and of a pneumatic valve. Its method: regressors ordered by ERR,
# their number by AIC, parameters by extended least squares (ELS); its result: no more than five terms each. Only its
# abstract could be read here. The method is theirs, while equations and numbers of the three systems are our own, and
# none of their figures is reproduced.

# %%
import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import assumptions, plants, plots
from narx_sym.fit.bases import select as selection

MOST = 5  # terms


def heated(source):
    """The power is a polynomial of the input, and what is heated has two poles: rise of temperature [K]."""
    rise, power = np.zeros(len(source)), 0.4 * source + 0.5 * source**2
    for i in range(2, len(rise)):
        rise[i] = 1.2 * rise[i - 1] - 0.27 * rise[i - 2] + 0.07 * power[i - 1]
    return rise


# %% [markdown]
# ## Excitation
# It holds the frequencies of interest and brings each system to many points of operation: levels for the heater,
# low-pass noise for both that hysteresis makes remember. A second record of each is for judging alone.


# %%
def heater(seed):
    random = np.random.default_rng(seed)
    levels = np.repeat(random.uniform(0.0, 3.0, 120), 25)
    return ns.Record.from_arrays(
        levels, heated(levels) + 0.1 * random.standard_normal(levels.size), Ts=1.0, name="heater"
    )


def piezo(seed):
    volts = plants.filtered_noise(20_000, seed=seed)
    return ns.Record.from_arrays(volts, plants.bouc_wen(volts), Ts=1e-3, name="piezo actuator")


def valve(seed):
    volts = 3 + plants.filtered_noise(20_000, 0.01, cutoff=0.1, peak=1.0, seed=seed)
    noise = 0.003 * np.random.default_rng(seed).standard_normal(volts.size)
    return ns.Record.from_arrays(volts, plants.valve(volts) + noise, Ts=0.01, name="valve")


# %% [markdown]
# ## Structure and parameters
# The heater rests at one output for each input: every product of second degree is a candidate. The other two hold any
# output: Assumption 1 and $\Sigma_y = 1$, which is one of the five terms.

# %%
hysteretic = ns.pool(n_y=1, n_u=2, degree=3, rules=assumptions.CONTINUUM + assumptions.COMPENSATION)
plain = ns.pool(n_y=2, n_u=2, degree=2, phi=False)
at = {"heater": {}, "piezo actuator": {}, "valve": {ns.u: 3.0, ns.y: 3.0}}
table = Table("system", "terms by AIC", "taken", "one step", "ELS", title="Free-run NRMSE on the second record")
models, errors = {}, {}
for source, candidates in ((heater, plain), (piezo, hysteretic), (valve, hysteretic)):
    record, second = source(0), source(1)
    rests = candidates is plain
    frame = ns.NARX([ns.y[ns.k - 1]], operating_point=at[record.name])
    most = MOST if rests else MOST - 1  # beside y[k-1]
    found = {
        how: selection.select(
            candidates, record, continuum=not rests, criterion="aic", max_terms=most, method=how, frame=frame
        )
        for how in ("one_step", "els")
    }  # fmt: skip
    models[record.name] = found["els"].model
    judged = {how: ns.evaluate(one.model, second).free_run_nrmse for how, one in found.items()}
    errors[record.name] = judged
    print(ns.latex(found["els"].model))
    picks, shares = found["els"].picks, found["els"].path.err
    print(", ".join(f"{ns.text(term)}: ERR {err:.1e}" for term, err in zip(picks, shares, strict=False)))
    aic = selection.select(candidates, record, continuum=not rests, criterion="aic", max_terms=12, frame=frame).chosen
    shown = [f"{error:.4f}" for error in judged.values()]
    table.add_row(record.name, str(aic), str(len(models[record.name].terms)), *shown)
Console().print(table)

# %% [markdown]
# ## Free runs
# Past outputs are regressors, so noise of a sensor biases least squares one step ahead. ELS has past residuals beside
# them, the noise of an ARMAX model. Where the structure is what limits a model it does not help, as the table says. AIC
# asks for more terms than five where the data are free of noise, or the machine is none of the pool: five are taken.

# %%
figure, axes = plots.new_axes(1, 3, figsize=(13, 3.8))
for ax, (name, model), source in zip(axes, models.items(), (heater, piezo, valve), strict=True):
    second = source(1)
    shown = slice(1000, 1500) if name == "heater" else slice(0, 6000)
    ax.plot(second.t[shown], second.y[shown], color=plots.BLACK, ls=":", label="second record")
    ax.plot(second.t[shown], ns.free_run(model, second)[shown], color=plots.ORANGE, label="free run")
    ax.set(title=name, xlabel="time [s]")
    ax.legend(loc="upper right", fontsize=8)
figure

# %% [markdown]
# ## What their laws would do
# To compensate is what such models are for. A good free run promises no law: that of the valve, which sticks, runs away.

# %%
for name, model in models.items():
    print(f"{name}: {model.compensator().stability()}")
print(ns.latex(models["piezo actuator"].compensator()))

# %%
assert all(len(model.terms) == MOST for model in models.values())
assert errors["piezo actuator"]["els"] < 0.04 and errors["heater"]["els"] < 0.1 and errors["valve"]["els"] < 0.2
stable = {name: model.compensator().stability().stable for name, model in models.items()}
assert stable == {"heater": True, "piezo actuator": True, "valve": False}
