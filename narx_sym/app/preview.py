"""A picture of what was read."""

from __future__ import annotations

from collections.abc import Mapping

from ..data.record import Record
from ..report.plots import BLUE, GREEN, label, new_axes, thin
from ..report.svg import svg


def signals_svg(record: Record, units: Mapping[str, str]) -> str:
    """Return input and output over time as an `<svg>` element."""
    figure, axes = new_axes(2, figsize=(8.8, 3.4))
    for ax, name, values, colour in zip(axes, "uy", (record.u, record.y), (GREEN, BLUE), strict=True):
        keep = thin(values)
        ax.plot(record.t[keep], values[keep], color=colour, lw=0.9)
        ax.set_ylabel(label(name, units.get(name, "")))
        ax.margins(x=0)
    axes[1].set_xlabel("time [s]")
    alt = f"Input from {record.u.min():.4g} to {record.u.max():.4g} and output from {record.y.min():.4g} to "
    return svg(figure, "preview", f"{alt}{record.y.max():.4g} over {record.t[-1] - record.t[0]:.4g} s.")
