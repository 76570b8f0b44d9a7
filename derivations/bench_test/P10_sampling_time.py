# %% [markdown]
# # P10: the sampling time
# The bench test sampled at 1 ... 30 ms: accuracy of the models and of the tracking, both strategies. The plant is
# integrated at 1 ms throughout. A model with $\phi_{1,k-1}$ answers one sample late, the plant does not: an error of
# $T_s |\dot{r}|$ on average, 0.2 % per ms for 40 sin(2πt). "First differences of the input" are sensitive to $T_s$.
# The inverse's $\theta_5$ and $\theta_6$ act per sample: its law's eigenvalue $\theta_1 + s_r\theta_5 r$ moves away
# from 1 with $T_s$. Up to 30 ms an error of the law hardly grows along this run; from 40 ms on the law runs away on some
# seeds (tests/bench/sweeps.py).

# %%
import warnings

import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plants, plots
from narx_sym.files.parallel import sweep

TERMS = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
INVERSE_TERMS = [
    "u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]",
    "phi2[k-1]*y[k-1]*u[k-1]", "phi2[k-1]*y[k-1]**2",
]  # fmt: skip
STEPS, SEEDS = (1, 2, 5, 10, 15, 20, 25, 30), range(2)  # [ms]


def study(volts, microns, step):
    """(model MAPE, tracking MAPE) of strategies 1 and 2, MAPE without compensation, growth inside law 2, at step ms."""
    Ts = 1e-3 * step
    record = ns.Record.from_arrays(volts[::step], microns[::step], Ts=Ts)
    r = 40 * np.sin(2 * np.pi * Ts * np.arange(50_000 // step))
    plain = plants.bouc_wen(r, Ts, substeps=step)
    validation = ns.Record.from_arrays(r, plain, Ts=Ts)
    found, growth = [], 0.0
    for unfitted in (ns.NARX.from_terms(TERMS), ns.NARX.from_terms(INVERSE_TERMS, input="y", output="u", lead=2)):
        one = unfitted.fit(record, constraints=["continuum"])
        law = one.compensator()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what it says is in the last column of the table
            m = law.run(r, m0=0.0)
        growth = law.internal.along(m, r, m0=0.0).growth
        found += [ns.evaluate(one, validation).free_run_mape, ns.mape(r, plants.bouc_wen(m, Ts, substeps=step))]
    return [*found, ns.mape(r, plain), growth]


# %%
print(ns.latex(ns.NARX.from_terms(TERMS)))
noise = [plants.filtered_noise(seed=seed, peak=75.0) for seed in SEEDS]
calls = [(volts, plants.bouc_wen(volts), step) for volts in noise for step in STEPS]
errors = np.array(sweep(study, calls, what="sampling times")).reshape(len(SEEDS), len(STEPS), 6)
middle = np.mean(errors, axis=0)
names = ("model M", "tracking 1", "inverse model", "tracking 2", "uncompensated", "growth in law 2")
table = Table("T_s [ms]", *names, title=f"MAPE [%], mean of {len(SEEDS)} noise seeds; growth of a disturbance")
for step, row in zip(STEPS, middle, strict=True):
    table.add_row(str(step), *(f"{x:.2f}" for x in row))
Console().print(table)

# %%
figure, axes = plots.new_axes(1, 2, figsize=(11, 4.5))
for ax, first, title in zip(axes, (0, 2), ("(a) strategy 1", "(b) strategy 2"), strict=True):
    for column, name, colour, marker, fill in (
        (first, "model", plots.BLUE, "o", "white"),
        (first + 1, "tracking", plots.RED, "s", plots.RED),
    ):
        ax.plot(STEPS, middle[:, column], color=colour, marker=marker, mfc=fill, label=name)
        ax.plot(STEPS, errors[:, :, column].T, color=colour, marker=".", ms=4, ls="none")
    ax.plot(STEPS, middle[:, 4], color=plots.GREEN, marker="^", label="uncompensated")
    ax.plot(STEPS, 0.2 * np.array(STEPS), color=plots.BLACK, ls=":", lw=1, label="one sample late")
    ax.set(xlabel="sampling time [ms]", ylabel="MAPE [%]", title=title, ylim=(0, 9.4))
    ax.legend(loc="upper left", fontsize=9, title="mean; dots: each noise seed", title_fontsize=8)
figure

# %%
assert np.all(errors[:, :, [1, 3]] < errors[:, :, 4:5])  # compensated below uncompensated at each sampling time
assert np.all(np.diff(middle[:, :4], axis=0) > 0)  # accuracy deteriorates with T_s ...
correlation = [np.corrcoef(middle[:, i], middle[:, i + 1])[0, 1] for i in (0, 2)]
assert min(correlation) > 0.99  # ... and tracking follows the model
assert np.all(middle[-1, :4] < 0.2 * STEPS[-1])
assert (
    middle[:, 5].max() < 1.1
)  # along the run law 2 forgets its own errors: it moves, its eigenvalue is for slow motion
# The paper: strategy 1 is somewhat less sensitive to the model's accuracy.
assert np.mean(middle[:, 1] / middle[:, 0]) < np.mean(middle[:, 3] / middle[:, 2])
