"""Where the own dynamics of a law attract and repel."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...data.units import said_first
from ...errors import NarxError
from ...fit.laws.internal import dynamics, radius
from ...inversion.compensator import Compensator
from ...inversion.stability import direction
from ..figures.still import RED, label, new_axes


def plot_internal(
    law: Compensator,
    m: Any = None,
    r: Any = None,
    ranges: dict[str, Any] | None = None,
    units: dict[str, str] | None = None,
) -> Any:
    """Draw the internal eigenvalue of a law over reference and input, while both rise and while both fall.

    Where it is beyond 1 (hatched) the law's own dynamics repel: a disturbance of m grows there.

    Parameters
    ----------
    m, r : (N,) arrays, optional
        A run of the law and its reference, drawn in the panel of the direction in which m moves.
    ranges : mapping from "m" and "r" to (low, high), optional
        By default those of the identification and of the run.
    units : mapping such as {"u": "V", "y": "um"}
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    units, known = said_first(law.model.info.units, units), law.model.info.ranges
    spans: dict[str, Any] = {}
    for name, run, key in (("m", m, "u"), ("r", r, "y")):
        ends = np.concatenate([np.ravel(known.get(key, [])), np.ravel([] if run is None else run)])
        if name not in (ranges or {}) and not ends.size:
            raise NarxError(f"The range of {name} is not known: give ranges, or a run of the law.")
        spans[name] = (ranges or {}).get(name, (ends.min(), ends.max()) if ends.size else ())
    across, up = np.meshgrid(*(np.linspace(spans[name][0], spans[name][1], 161) for name in ("r", "m")))
    figure, axes = new_axes(1, 2, figsize=(11, 4.8))
    internal = dynamics(law)
    maps, turns = [radius(internal, up, across, s) for s in (1, -1)], internal.turns
    largest = float(np.clip(np.ceil(5 * np.max(maps)) / 5, 1.2, 2.0))  # beyond it one colour
    for ax, values, s, word in zip(axes, maps, (1, -1), ("rises", "falls"), strict=True):
        filled = ax.contourf(
            across, up, values, levels=np.arange(0, largest + 0.01, 0.05), cmap="cividis", extend="max"
        )
        if values.max() > 1:
            ax.contourf(across, up, values, levels=[1, np.inf], colors="none", hatches=["/"])
            ax.contour(across, up, values, levels=[1], colors="white", linewidths=1.8)
        if m is not None and r is not None:
            path, goal = np.asarray(m, dtype=float), np.asarray(r, dtype=float)
            way = np.diff(path if direction in turns else goal, prepend=np.nan)
            shown = np.where(s * way > 0, path, np.nan)
            ax.plot(goal, shown, color=RED, lw=1.6)
        ax.set_title(f"while {'m' if direction in turns else 'r'} {word}", fontsize=10)
        ax.set_xlabel(label("r", units.get("y", "")))
    axes[0].set_ylabel(label("m", units.get("u", "")))
    bar = figure.colorbar(
        filled, ax=axes, label="|internal eigenvalue|, stable below 1", ticks=np.arange(0, largest + 0.01, 0.2)
    )
    bar.ax.axhline(1, color="white", lw=1.8)
    handles: list[Any] = [Patch(fc="0.75", ec="black", hatch="//", label="repelling: a disturbance of m grows")]
    if m is not None:
        handles.append(Line2D([], [], color=RED, lw=1.6, label="run of the law"))
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return figure
