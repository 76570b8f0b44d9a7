"""The README's picture: the loop of a piezo actuator, and what is left of it under the derived law.

python derivations/figures/before_after.py    # writes before_after.svg beside this file
"""

from pathlib import Path
from typing import Any

import numpy as np

import narx_sym as ns
from narx_sym import plants, plots


def run() -> tuple[Any, Any, Any]:
    """Return the reference, and the simulated actuator's answer to it without and with the law [um]."""
    u = plants.filtered_noise(seed=0, peak=75.0)
    model = ns.identify(ns.Record.from_arrays(u, plants.bouc_wen(u), Ts=1e-3), base="narx", for_compensation=True)
    reference = 40 * np.sin(2 * np.pi * 1e-3 * np.arange(50_000))
    m = model.compensator().run(reference, m0=0.0)
    return reference, plants.bouc_wen(reference), plants.bouc_wen(m)


def draw() -> tuple[Any, float, float]:
    """Return the picture, and the mean absolute errors over the range before and after [%]."""
    reference, before, after = run()
    errors = ns.mape(reference, before), ns.mape(reference, after)
    figure, axes = plots.new_axes(1, 2, figsize=(8, 3.6))
    titles = ("before: the reference as voltage", "after: through the derived law")
    shown = slice(48_000, 49_001)  # one period, long after the start
    for ax, y, error, colour, title in zip(axes, (before, after), errors, (plots.RED, plots.BLUE), titles, strict=True):
        ax.axline((0, 0), slope=1, color="0.6", lw=1, ls="--")
        ax.plot(reference[shown], y[shown], color=colour, lw=2)
        ax.set(xlabel="wanted position [µm]", title=title, xlim=(-45, 45), ylim=(-45, 45))
        ax.text(0.04, 0.9, f"mean error {error:.2g} % of the range", transform=ax.transAxes)
    axes[0].set_ylabel("position [µm]")
    return figure, *errors


if __name__ == "__main__":
    import matplotlib

    matplotlib.rcParams.update({"svg.hashsalt": "narx_sym", "svg.fonttype": "path"})
    target = Path(__file__).with_suffix(".svg")
    figure, before, after = draw()
    figure.patch.set_facecolor("white")
    figure.savefig(target, metadata={"Date": None})
    print(f"{target}: {before:.2f} -> {after:.2f} %")
