# %% [markdown]
# # P9: compensation of the bench test, Table 3
# Both laws drive the plant of P1 along r = 40 sin(2πt) um for 50 s. The plant is the differential equation, not
# the model.

# %%
import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plants, plots
from narx_sym.fit.bases import select as selection

PAPER = {"strategy 1": (0.322, 1.13), "strategy 2": (0.425, 1.14), "black box": (1.819, 1.15), "none": (6.536, 1.00)}
TERMS = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
INVERSE_TERMS = [
    "u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]",
    "phi2[k-1]*y[k-1]*u[k-1]", "phi2[k-1]*y[k-1]**2",
]  # fmt: skip
t = 1e-3 * np.arange(50_000)
reference = 40 * np.sin(2 * np.pi * t)


def compensate(model):
    """Run the law of a model on the plant: input, output, MAPE [%], NSAVI."""
    volts = model.compensator().run(reference, m0=0.0)
    output = plants.bouc_wen(volts)
    # Slip: NSAVI is printed as a sum of ratios; the table comes from the ratio of the sums, and so does this.
    return volts, output, ns.mape(reference, output), ns.nsavi(volts, reference)


def models(seed):
    noise = plants.filtered_noise(seed=seed, peak=75.0)
    record = ns.Record.from_arrays(noise, plants.bouc_wen(noise), Ts=1e-3)
    polynomials = ns.pool(n_y=1, n_u=2, degree=3, phi=False, rules=("A1(i)",))
    inverse = ns.NARX.from_terms(INVERSE_TERMS, input="y", output="u", lead=2)
    return {
        "strategy 1": ns.NARX.from_terms(TERMS).fit(record, constraints=["continuum"]),
        "strategy 2": inverse.fit(record, constraints=["continuum"]),
        "black box": selection.select(polynomials, record, continuum=False, n_terms=5).model,
    }


# %% [markdown]
# ## The published parameters

# %%
first = ns.NARX.from_terms(TERMS, theta=[1.00, 0.77, 1.44e-2, -9.60e-3, 3.15e-4, -2.47e-4])
second = ns.NARX.from_terms(
    INVERSE_TERMS, theta=[1.00, 1.27, -2.13e-2, 1.37e-2, -1.07e-5, 7.99e-6], input="y", output="u", lead=2
)
published = {"strategy 1": compensate(first), "strategy 2": compensate(second)}
print(first.compensator().latex(numbers=True))
print(second.compensator().latex(numbers=True))

# %% [markdown]
# ## Fitted: one realisation, and ten seeds beside it

# %%
runs = [{name: compensate(model) for name, model in models(seed).items()} for seed in range(10)]
plain = plants.bouc_wen(reference)
none = ns.mape(reference, plain)

table = Table(
    "compensation", "paper", "Table 1 values", "seed 0", "ten seeds: min / median / max", title="MAPE [%], NSAVI"
)
tracking, effort = {}, {}
for name in ("strategy 1", "strategy 2", "black box"):
    tracking[name], effort[name] = (np.array([run[name][i] for run in runs]) for i in (2, 3))
    spread = " / ".join(f"{f(tracking[name]):.2f}" for f in (np.min, np.median, np.max))
    shown = "{:.3f}, {:.3f}".format(*published[name][2:]) if name in published else ""
    table.add_row(
        name, "{:.3f}, {:.2f}".format(*PAPER[name]), shown, f"{tracking[name][0]:.3f}, {effort[name][0]:.3f}", spread
    )
table.add_row("none", "6.536, 1.00", "", f"{none:.3f}, 1.000", "deterministic")
Console().print(table)

# %%
figure, axes = plots.new_axes(2, 2, figsize=(11, 7))
(inputs, errors), (loops, spreads) = axes
shown = slice(2000, 4001)
# Starting from rest with a velocity, the first period is a transient: it counts in the table and is not drawn.
inputs.plot(t[shown], reference[shown], color=plots.BLACK, lw=1, ls=":", label="reference taken as voltage")
for name, colour, style in (
    ("strategy 1", plots.ORANGE, "-"),
    ("strategy 2", plots.BLUE, "--"),
    ("black box", plots.GREEN, "-."),
):
    volts, output, _, _ = runs[0][name]
    inputs.plot(t[shown], volts[shown], color=colour, ls=style, lw=1.4, label=name)
    errors.plot(t[shown], (reference - output)[shown], color=colour, ls=style, lw=1.4, label=name)
    loops.plot(reference[shown], output[shown], color=colour, ls=style, lw=1.4, label=name)
loops.plot(reference[shown], plain[shown], color=plots.BLACK, lw=1, ls=":", label="without compensation")
errors.plot(t[shown], (reference - plain)[shown], color=plots.BLACK, lw=1, ls=":", label="without compensation")
for place, name in enumerate(tracking):
    beside = place + np.linspace(-0.15, 0.15, 10)
    spreads.plot(beside, tracking[name], color=plots.SKY, mec=plots.BLUE, marker="o", ms=6, ls="none",
                 label="ten noise seeds, fitted" if place == 0 else None)  # fmt: skip
    if name in published:
        spreads.plot(place, published[name][2], color=plots.BLACK, marker="x", ms=9, mew=2, ls="none",
                     label="parameters of Table 1" if place == 0 else None)  # fmt: skip
    spreads.hlines(PAPER[name][0], place - 0.3, place + 0.3, color=plots.RED, lw=2,
                   label="Table 3 of the paper" if place == 0 else None)  # fmt: skip
spreads.axhline(none, color=plots.BLACK, ls=":", lw=1, label="without compensation")
spreads.set_yscale("log")
spreads.set_yticks([0.2, 0.5, 1, 2, 5, 10, 20], ["0.2", "0.5", "1", "2", "5", "10", "20"])
spreads.minorticks_off()
spreads.set_xticks(range(3), list(tracking))
spreads.set(ylabel="tracking MAPE [%]", ylim=(0.15, 60), xlim=(-0.6, 2.6))
inputs.set(xlabel="time [s]", ylabel="m [V]", ylim=(-55, 105))
errors.set(xlabel="time [s]", ylabel="r - y [um]", ylim=(-9, 20))
loops.set(xlabel="r [um]", ylabel="y [um]")
for ax in axes.flat:
    ax.legend(loc="upper left", fontsize=8)
figure

# %%
assert abs(none - 6.43) < 0.01
assert abs(published["strategy 1"][2] - 0.287) < 0.01 and abs(published["strategy 2"][2] - 0.509) < 0.01
assert abs(published["strategy 1"][3] - 1.131) < 0.002 and abs(published["strategy 2"][3] - 1.135) < 0.002
assert tracking["strategy 1"][0] < 1.31 and tracking["strategy 2"][0] < 1.16  # the measured ranges; 6.43 without
assert 1.105 < effort["strategy 1"][0] < 1.14 and 1.13 < effort["strategy 2"][0] < 1.166
# Strategy 2 stays above the printed 0.425 in every seed.
assert tracking["strategy 2"].min() > 0.425
assert max(np.median(tracking["strategy 1"]), np.median(tracking["strategy 2"])) < 0.5 * np.median(
    tracking["black box"]
)
