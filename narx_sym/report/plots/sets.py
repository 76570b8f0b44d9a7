"""Quasi-static sets with the loop of the model and its orientation."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...data.record import Record
from ...data.units import said_first
from ...engines.columns import evaluate_quasi_static
from ...errors import NarxError
from ...fit.simulate import arrays, simulate
from ...models.model import Model
from ..figures.still import BLACK, BLUE, PINK, RED, label, new_axes


def plot_quasi_static(
    model: Model,
    u: Any = None,
    y0: Any = None,
    ax: Any = None,
    units: dict[str, str] | None = None,
    window: float | None = None,
    record: Record | None = None,
) -> Any:
    """Draw the attracting and repelling quasi-static sets with the model's loop and its orientation.

    Parameters
    ----------
    u : (N,) array, optional
        One loading-unloading cycle; a sine over the identified range by default, or over that of `record` (1000
        samples).
    y0 : number, optional
        Where the first of three cycles starts; the last one is drawn. By default where the record is at that input.
    window : float, optional
        The vertical range shown, in ranges of the loop. The sets run to infinity where dF/dy crosses 1; by
        default three quarters of the points of each set that matters are inside.
    record : Record, optional
        Where the model is used, if it was not fitted.

    Raises
    ------
    NarxError
        Where nobody says over which inputs, and for what is not derived.
    """
    units = said_first(model.info.units, units)
    source, output = model.input.name, model.output.name
    if u is None:
        low, high = input_range(model, record)
        u = (low + high) / 2 + (high - low) / 2 * np.sin(2 * np.pi * np.arange(1000) / 1000)
    u = np.asarray(u, dtype=float)
    if y0 is None and record is not None and model.info.line is None:
        measured = arrays(model, record)
        y0 = measured[output][np.argmin(np.abs(measured[source] - u[0]))]
    if ax is None:
        _, ax = new_axes(figsize=(6.5, 5.8))
    # The cycle is closed, so that its first sample has a difference too.
    sets = evaluate_quasi_static(model.quasi_static(), u, u - np.roll(u, 1))
    loop = simulate(model, np.tile(u, 3), y0, warn=False)[-u.size :]
    middle = (loop.max() + loop.min()) / 2
    distance = np.abs(sets.ytilde - middle)
    half = _half_window(sets, distance, max(np.ptp(loop), 1e-12) / 2, window)
    drawn: list[Any] = []
    # Triangles point where the input goes: the branches differ without colour, and so do the line styles.
    for branch, name, colour, marker, word in (
        (sets.phi1 > 0, "L", BLUE, ">", "loading"), (sets.phi1 < 0, "U", RED, "<", "unloading"),
    ):  # fmt: skip
        for mask, style, kind, fill in (
            (sets.attracting, "-", "attracting", colour), (sets.repelling, "-.", "repelling", "white"),
        ):  # fmt: skip
            here = branch if mask.ndim == 1 else branch[:, None]
            shown = np.where(here & mask & (distance <= half), sets.ytilde, np.nan)
            if np.isfinite(shown).any():  # in the order of time: nothing joins separate pieces
                symbol = rf"$\tilde{{{output}}}_\mathrm{{{name}}}^\mathrm{{{kind[0]}}}$"
                lines = ax.plot(
                    u, shown, color=colour, ls=style, lw=1.6, marker=marker, markevery=0.12, ms=6, mfc=fill,
                    label=f"{symbol} {word}, {kind}",
                )  # fmt: skip
                drawn.append(lines[0])
    closed = [np.append(x, x[0]) for x in (u, loop)]
    own = ax.plot(*closed, color=BLACK, ls=":", lw=1.8, label="loop of the model")[0]
    drawn.insert(sum(h.get_marker() == ">" for h in drawn), own)  # a legend column for each branch
    _arrows(ax, u, loop, sets.phi1)
    ax.set(xlabel=label(source, units.get(source, "")), ylabel=label(output, units.get(output, "")))
    ax.set_ylim(middle - half, middle + half)
    ax.set_title(f"{orientation(u, loop)} loop", fontsize=10)
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.13), "ncols": 2}
    ax.legend(handles=drawn, fontsize=9, frameon=False, **below)
    return ax.figure


def input_range(model: Model, record: Record | None = None) -> tuple[float, float]:
    """Return the lowest and the highest input on the records that a model was fitted on, else on a record.

    Raises
    ------
    NarxError
        Where there is neither.
    """
    name = model.input.name
    if record is not None and name not in model.info.ranges:
        measured = arrays(model, record)[name]
        return float(measured.min()), float(measured.max())
    if name not in model.info.ranges:
        raise NarxError(
            f"The range of {name} is not known: the model was not fitted on a record. Give {name}, or record."
        )
    low, high = model.info.ranges[name]
    return low, high


def _half_window(sets: Any, distance: np.ndarray, loop: float, window: float | None) -> float:
    """Half of the vertical range: the loop, and most of each set, but not its way to infinity."""
    if window is not None:
        return loop * window
    reach = [np.nanquantile(distance[s], 0.75) for s in (sets.attracting, sets.repelling) if s.mean() > 0.1]
    return float(np.clip(1.15 * max([loop, *reach]), 1.15 * loop, 5 * loop))


def _arrows(ax: Any, u: np.ndarray, loop: np.ndarray, phi1: np.ndarray) -> None:
    """Show the orientation of a loop: one arrow where loading, one where unloading passes the middle."""
    step = max(1, u.size // 40)
    for branch in (phi1 > 0, phi1 < 0):
        if branch.any():
            near = np.where(branch, np.abs(u - (u.max() + u.min()) / 2), np.inf)
            tip = (int(np.argmin(near)) + np.array([-step, step])) % u.size
            style = {"arrowstyle": "-|>", "color": PINK, "lw": 2, "mutation_scale": 18}
            tail, head = zip(u[tip], loop[tip], strict=True)
            ax.annotate("", xy=head, xytext=tail, arrowprops=style)


def orientation(u: np.ndarray, loop: np.ndarray) -> str:
    """Return "counter-clockwise" or "clockwise", from the sign of the enclosed area, or "no"."""
    area = np.sum(u * np.roll(loop, -1) - np.roll(u, -1) * loop)
    if abs(area) < 1e-6 * np.ptp(u) * np.ptp(loop) * 2:
        return "no"
    return "counter-clockwise" if area > 0 else "clockwise"
