"""Pictures: time response and loop, quasi-static sets with their regions, where a model fails, what a diagnosis found.

Every function takes matplotlib axes or makes them, labels them with units, and returns the figure.
"""

from __future__ import annotations

import itertools
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from ..data.record import Record
from ..diagnosis.misfit import Misfit, Panel
from ..engines.compile import evaluate_quasi_static
from ..errors import NarxError
from ..files.atomic import write_figure
from ..fit.excursions import radius
from ..fit.simulate import arrays, free_run, simulate
from ..inversion.compensator import Compensator
from ..inversion.stability import direction
from ..models.model import Model

# Okabe & Ito (2008): distinguishable without colour vision.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PINK = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip


def new_axes(rows: int = 1, columns: int = 1, **options: Any) -> tuple[Any, Any]:
    """Make a figure without a display (no window is opened, also not in scripts)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained", **options)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns)


def label(name: str, unit: str = "") -> str:
    """Axis label with its unit, where one is known."""
    # A dollar sign would start a formula.
    return (f"{name} [{unit}]" if unit else name).replace("$", r"\$")


def thin(x: np.ndarray, most: int = 4000) -> np.ndarray:
    """Return indices that keep the extremes of each bin: enough points to draw, none that matters lost."""
    if x.size <= 2 * most:
        return np.arange(x.size)
    edges = np.linspace(0, x.size, most // 2 + 1).astype(int)
    picks = [i for a, b in itertools.pairwise(edges) for i in (a + np.argmin(x[a:b]), a + np.argmax(x[a:b]))]
    return np.unique([0, *picks, x.size - 1])


def plot_comparison(model: Model, record: Record, axes: Any = None, units: dict[str, str] | None = None) -> Any:
    """Draw measured and simulated output over time, the error, and both loops.

    Parameters
    ----------
    axes : three matplotlib axes (time, error, loop), optional
    units : mapping such as {"u": "V", "y": "um"}
    """
    units = units or {}
    if axes is None:
        figure, _ = new_axes(figsize=(11, 5))
        figure.clear()
        grid = figure.add_gridspec(2, 2, width_ratios=(3, 2), height_ratios=(3, 1))
        top = figure.add_subplot(grid[0, 0])
        axes = [top, figure.add_subplot(grid[1, 0], sharex=top), figure.add_subplot(grid[:, 1])]
    parts = record.segments()
    listed = [arrays(model, part) for part in parts]
    source, output = str(model.input.label), str(model.output.label)
    simulated = np.concatenate([free_run(model, part) for part in parts])
    measured, driver = (np.concatenate([d[name] for d in listed]) for name in (output, source))
    time = np.concatenate([part.t[: d[output].size] for part, d in zip(parts, listed, strict=True)])
    keep = np.union1d(thin(measured), thin(measured - simulated))
    name = label(output, units.get(output, ""))
    axes[0].plot(time[keep], measured[keep], color=BLACK, lw=1.6, label="measured")
    axes[0].plot(time[keep], simulated[keep], color=ORANGE, lw=1.2, ls="--", label="free run")
    axes[0].set_ylabel(name)
    share = float(np.sqrt(np.mean((measured - simulated) ** 2)) / (np.std(measured) or 1.0))
    axes[0].set_title(f"{record.name}: free-run NRMSE {share:.3g}", loc="left", fontsize=10)
    axes[1].plot(time[keep], (measured - simulated)[keep], color=BLUE, lw=0.8)
    axes[1].axhline(0, color=BLACK, lw=0.5)
    axes[1].set(xlabel="time [s]", ylabel=f"error of {name}")
    axes[2].plot(driver[keep], measured[keep], color=BLACK, lw=1.2, label="measured")
    axes[2].plot(driver[keep], simulated[keep], color=ORANGE, lw=1.0, ls="--", label="free run")
    axes[2].set(xlabel=label(source, units.get(source, "")), ylabel=name)
    axes[2].legend(loc="upper left")
    return axes[0].figure


def plot_quasi_static(
    model: Model,
    u: Any = None,
    y0: Any = None,
    ax: Any = None,
    units: dict[str, str] | None = None,
    window: float | None = None,
) -> Any:
    """Draw the attracting and repelling quasi-static sets with the model's loop and its orientation.

    Parameters
    ----------
    u : (N,) array, optional
        One loading-unloading cycle; a sine over the identified range by default (1000 samples).
    y0 : number, optional
        Where the first of three cycles starts; the last one is drawn.
    window : float, optional
        The vertical range shown, in ranges of the loop. The sets run to infinity where dF/dy crosses 1; by
        default three quarters of the points of each set that matters are inside.
    """
    units = units or {}
    source, output = str(model.input.label), str(model.output.label)
    if u is None:
        low, high = model.info.get("ranges", {}).get(source, (-1.0, 1.0))
        u = (low + high) / 2 + (high - low) / 2 * np.sin(2 * np.pi * np.arange(1000) / 1000)
    u = np.asarray(u, dtype=float)
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
            shown = np.where(branch & mask & (distance <= half), sets.ytilde, np.nan)
            if np.isfinite(shown).any():  # in the order of time: nothing joins separate pieces
                symbol = rf"$\tilde{{{output}}}_\mathrm{{{name}}}^\mathrm{{{kind[0]}}}$"
                drawn += ax.plot(
                    u, shown, color=colour, ls=style, lw=1.6, marker=marker, markevery=0.12, ms=6, mfc=fill,
                    label=f"{symbol} {word}, {kind}",
                )  # fmt: skip
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


def plot_compensation(t: Any, r: Any, m: Any, outputs: dict[str, Any], units: dict[str, str] | None = None) -> Any:
    """Draw the compensated input, the responses, the tracking errors and the loops r against y.

    Parameters
    ----------
    outputs : mapping from a name ("compensated", "without") to the (N,) plant output
    """
    units = units or {}
    figure, axes = new_axes(2, 2, figsize=(11, 7))
    colours = (ORANGE, SKY, GREEN)
    r, m = np.asarray(r, dtype=float), np.asarray(m, dtype=float)
    keep = thin(r)
    axes[0, 0].plot(np.asarray(t)[keep], m[keep], color=BLUE, lw=1.2, label="compensated input m")
    axes[0, 0].set(xlabel="time [s]", ylabel=label("m", units.get("u", "")))
    axes[0, 1].plot(np.asarray(t)[keep], r[keep], color=BLACK, lw=1.6, label="reference r")
    for (name, values), colour in zip(outputs.items(), colours, strict=False):
        axes[0, 1].plot(np.asarray(t)[keep], values[keep], color=colour, lw=1.1, ls="--", label=name)
        axes[1, 0].plot(np.asarray(t)[keep], (r - values)[keep], color=colour, lw=1.0, label=name)
        axes[1, 1].plot(r[keep], values[keep], color=colour, lw=1.1, label=name)
    axes[0, 1].set(xlabel="time [s]", ylabel=label("y", units.get("y", "")))
    axes[1, 0].set(xlabel="time [s]", ylabel=label("r - y", units.get("y", "")))
    axes[1, 1].set(xlabel=label("r", units.get("y", "")), ylabel=label("y", units.get("y", "")))
    for ax in axes.flat:
        ax.legend(loc="best", fontsize=8)
    return figure


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

    units, known = units or {}, law.model.info.get("ranges", {})
    spans: dict[str, Any] = {}
    for name, run, key in (("m", m, "u"), ("r", r, "y")):
        ends = np.concatenate([np.ravel(known.get(key, [])), np.ravel([] if run is None else run)])
        if name not in (ranges or {}) and not ends.size:
            raise NarxError(f"The range of {name} is not known: give ranges, or a run of the law.")
        spans[name] = (ranges or {}).get(name, (ends.min(), ends.max()) if ends.size else ())
    across, up = np.meshgrid(*(np.linspace(spans[name][0], spans[name][1], 161) for name in ("r", "m")))
    figure, axes = new_axes(1, 2, figsize=(11, 4.8))
    maps, turns = [radius(law.internal, up, across, s) for s in (1, -1)], law.internal.turns
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


def where_it_fails(misfit: Misfit, path: str | Path | None = None, units: dict[str, str] | None = None) -> Any:
    """Draw the free-run error, and the equivalent missing input where it is known, in the four panels that tell most.

    Parameters
    ----------
    misfit : Misfit, from `misfit.where_it_fails`
        Its noise floor is that of the error. The missing input is smoothed: there, the error bars show what is sure.
    path : str or Path, optional
        Where the picture is saved; its ending chooses the format.
    units : mapping such as {"u": "V", "y": "um"}, and of channels
    """
    units = units or {}
    columns = [("free-run error", misfit.panels), ("equivalent missing input", misfit.panels_missing)]
    columns = [(word, panels) for word, panels in columns if panels]
    best: dict[str, float] = {}
    for _, panels in columns:
        for rank, panel in enumerate(panels):
            best[panel.name] = max(best.get(panel.name, 0.0), panel.share - 1e-6 * rank)
    names = sorted(best, key=lambda name: -best[name])[:4]
    if not names:
        raise NarxError("Nothing varies in these data, so there is no panel to draw.")
    figure, _ = new_axes(figsize=(1 + 5 * len(columns), 1 + 2.4 * len(names)))
    figure.clear()
    axes = figure.subplots(len(names), len(columns), sharex="row", squeeze=False)
    for column, (word, panels) in enumerate(columns):
        found = {panel.name: panel for panel in panels}
        floor = misfit.floor if panels is misfit.panels else None
        for row, name in enumerate(names):
            draw_panel(axes[row, column], found[name], floor, units)
            what = "rms error in a bin" if name == "spectrum" else "mean error"
            what = what.replace("error", "missing input") if panels is misfit.panels_missing else what
            axes[row, column].set_ylabel(label(what, units.get("y", "")))
        axes[0, column].annotate(
            word, (0.5, 1), (0, 24), "axes fraction", "offset points", ha="center", fontsize=12, weight="bold"
        )
        # Only the spectrum has another quantity, and so its own range.
        top = reach([found[name] for name in names if name != "spectrum"])
        for row, name in enumerate(names):
            axes[row, column].set_ylim(*((0, None) if name == "spectrum" else (-top, top)))
    marks: dict[str, Any] = {}
    for ax in axes.flat:
        for handle, text in zip(*ax.get_legend_handles_labels(), strict=True):
            if not text.endswith("\u2009"):
                marks.setdefault(text, handle)
    figure.legend(
        marks.values(), marks.keys(), loc="outside lower center", ncols=2 * len(columns) + 1, fontsize=8, frameon=False
    )
    if path is not None:
        write_figure(figure, path)
    return figure


def reach(panels: list[Panel]) -> float:
    """Return the half range for all means with two standard errors; a single unsure cell does not decide."""
    known = [p for p in panels if np.isfinite(p.mean).any()]
    tops = [np.abs(p.mean) + 2 * np.minimum(p.error, np.nanmedian(p.error)) for p in known]
    return 1.15 * max((float(np.nanmax(t)) for t in tops), default=0.0) or 1.0


def draw_panel(ax: Any, panel: Panel, floor: float | None, units: dict[str, str]) -> None:
    """Draw one panel: means with two standard errors over the width of their cells."""
    ax.axhline(0, color=BLACK, lw=0.6, zorder=1)
    title = {"spectrum": "strongest line in the rest"}.get(panel.name, panel.label.replace(", ", " and "))
    ax.set_title(f"{title}: {100 * panel.share:.0f} % of the variance", loc="left", fontsize=10)
    floor_label = "noise floor (± rms)"
    if panel.name == "spectrum":
        middle = panel.low + panel.high
        ax.plot(middle / 2, panel.mean, color=BLUE, lw=1.0)
        if floor:  # white noise shares its power among the bins
            ax.axhspan(0, floor / np.sqrt(panel.mean.size), color=YELLOW, alpha=0.35, lw=0, label=floor_label)
        if panel.worst is not None and panel.share > 0:
            top = panel.centres[panel.worst]
            ax.plot(top, panel.mean[panel.worst], color=BLUE, marker="o", ms=5)
            side = "right" if top > 0.5 * panel.high[-1] else "left"
            shift = (-8 if side == "right" else 8, -3)
            ax.annotate(
                f"{top:.3g} Hz", (top, panel.mean[panel.worst]), shift, textcoords="offset points", ha=side, fontsize=9
            )
        ax.set_xlabel(label(panel.label, "Hz"))
        return
    if floor:
        ax.axhspan(-floor, floor, color=YELLOW, alpha=0.35, lw=0, zorder=0, label=floor_label)
    if panel.low.ndim == 2:
        _draw_grid(ax, panel, units)
        return
    middle, half, grey = panel.centres, (panel.high - panel.low) / 2, np.isnan(panel.mean)
    groups = [(np.full(middle.size, True), BLUE, "o", "mean ± 2 standard errors")]
    unit = panel.unit(units)
    name = panel.label
    if panel.name.endswith("_since_reversal"):
        up = middle > 0
        groups = [(up, BLUE, ">", "while u rises"), (~up, RED, "<", "while u falls")]
        middle = np.abs(middle)
    if panel.name == "direction":
        ax.set_xticks(middle, ["falling", "resting", "rising"])
        half = half * 0.7
    for chosen, colour, marker, word in groups:
        some = chosen & ~grey
        ax.errorbar(
            middle[some], panel.mean[some], 2 * panel.error[some], half[some], color=colour, marker=marker, ms=6,
            ls="none", lw=1.2, capsize=0, label=word,
        )  # fmt: skip
    for left, right in {(m - h, m + h) for m, h in zip(middle[grey], half[grey], strict=True)}:
        ax.axvspan(left, right, color="0.85", lw=0, zorder=0, label="too few samples")
    ax.set_xlabel(label(name, unit))


def _draw_grid(ax: Any, panel: Panel, units: dict[str, str]) -> None:
    """Draw joint cells of amplitude and frequency: one of them along the axis, the other by colour."""
    along = 0 if np.unique(panel.low[:, 0]).size > 1 else 1
    other = 1 - along
    names, kinds = panel.label.split(", "), [units.get("u", ""), "Hz"]
    classes, colours = np.unique(panel.low[:, other]), (BLUE, RED, GREEN, PINK)
    places, inverse = np.unique(panel.low[:, along], return_inverse=True)
    for i, (low, colour, marker) in enumerate(zip(classes, colours, "osD^", strict=False)):
        chosen = (panel.low[:, other] == low) & ~np.isnan(panel.mean)
        high = panel.high[panel.low[:, other] == low, other][0]
        shift = 0.22 * (i - (classes.size - 1) / 2)
        ax.errorbar(
            inverse[chosen] + shift, panel.mean[chosen], 2 * panel.error[chosen], color=colour, marker=marker, ms=6,
            ls="none", lw=1.2, label=f"{low:.3g} to {high:.3g} {kinds[other]}\u2009",
        )  # fmt: skip
        for k in inverse[(panel.low[:, other] == low) & np.isnan(panel.mean)]:
            ax.axvspan(k + shift - 0.1, k + shift + 0.1, color="0.85", lw=0, zorder=0, label="too few samples")
    edges = [panel.high[panel.low[:, along] == p, along][0] for p in places]
    ax.set_xticks(range(places.size), [f"{a:.3g} to\n{b:.3g}" for a, b in zip(places, edges, strict=True)])
    ax.set_xlabel(label(f"{names[along]} of a swing", kinds[along]))
    own = [(h, t) for h, t in zip(*ax.get_legend_handles_labels(), strict=True) if t.endswith("\u2009")]
    if len(own) > 1:
        ax.legend(
            *zip(*own, strict=True), fontsize=7, title=names[other], title_fontsize=7, ncols=len(own), framealpha=0.7
        )


def plot_diagnosis(diagnosis: Any, path: str | Path | None = None, units: dict[str, str] | None = None) -> Any:
    """Draw the candidates and the error ladder of a diagnosis side by side."""
    if not diagnosis.candidates:
        return plot_ladder(diagnosis, path, units)
    figure, _ = new_axes(figsize=(12.5, _height(diagnosis)))
    figure.clear()
    axes = figure.subplots(1, 2, width_ratios=(3, 2))
    plot_candidates(diagnosis, ax=axes[0])
    plot_ladder(diagnosis, units=units, ax=axes[1])
    if path is not None:
        write_figure(figure, path)
    return figure


def _height(diagnosis: Any) -> float:
    return max(4.2, 1.8 + 0.55 * len(diagnosis.candidates))


def plot_ladder(
    diagnosis: Any, path: str | Path | None = None, units: dict[str, str] | None = None, ax: Any = None
) -> Any:
    """Draw the free-run error after each added effect, down to the noise floor.

    Parameters
    ----------
    diagnosis : Diagnosis
    path : str or Path, optional
        Where the picture is saved; its ending chooses the format.
    units : mapping with the unit of "y", for a second axis in that unit
    """
    units = units or {}
    rungs = diagnosis.ladder
    step = diagnosis.steps[0]
    spread = step.base.problem.spread
    floor = diagnosis.floor / spread
    if ax is None:
        _, ax = new_axes(figsize=(max(5.0, 2.6 + 1.3 * len(rungs)), 4.2))
    for key, colour, marker, style, word in (
        ("train", SKY, "o", "--", "training samples"), ("validation", BLUE, "s", "-", "samples never used for fitting"),
    ):  # fmt: skip
        values = np.array([r[key] for r in rungs])
        ax.hlines(values, np.arange(len(rungs)) - 0.32, np.arange(len(rungs)) + 0.32, color=colour, lw=3, ls=style)
        joined = ":" if key == "validation" else "none"
        ax.plot(values, color=colour, ls=joined, lw=1.0, marker=marker, ms=6, label=word)
    for i, rung in enumerate(rungs):
        top = max(rung["validation"], rung["train"])
        ax.annotate(f"{rung['validation']:.2g}", (i, top), (9, 6), textcoords="offset points", fontsize=9)
    kind = {"estimate": "estimated"}.get(step.floor_kind, f"from {step.floor_kind}")
    ax.axhline(floor, color=BLACK, lw=1.2, ls="-.", label=f"noise floor, {kind}")
    every = [floor, *(r[key] for r in rungs for key in ("train", "validation"))]
    ax.set_yscale("log")
    room = max(1.6, np.sqrt(10 / max(max(every) / max(min(every), 1e-300), 1e-300)))  # at least a decade is shown
    ax.set_ylim(min(every) / room, max(every) * room)
    _plain_numbers(ax.yaxis)
    ax.set_xlim(-0.6, len(rungs) - 0.4)
    names = [textwrap.fill(name.replace("_", " "), 18).replace("$", r"\$") for name in diagnosis.rungs]
    ax.set_xticks(range(len(rungs)), names)
    ax.set_ylabel("free-run error / std of the output")
    if units.get("y"):
        other = ax.secondary_yaxis("right", functions=(lambda x: x * spread, lambda x: x / spread))
        other.set_ylabel(label("rms error", units["y"]))
        _plain_numbers(other.yaxis)
    ax.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(-0.1, 1))
    if path is not None:
        write_figure(ax.figure, path)
    return ax.figure


def _plain_numbers(axis: Any) -> None:
    """Write 0.02 instead of 2 x 10^-2 along a logarithmic axis, at 1, 2 and 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:.3g}"))


def plot_candidates(
    diagnosis: Any, path: str | Path | None = None, units: dict[str, str] | None = None, ax: Any = None
) -> Any:
    """Draw the share of the removable error that each candidate removes, with its 95 % interval.

    Parameters
    ----------
    diagnosis : Diagnosis
    path : str or Path, optional
        Where the picture is saved; its ending chooses the format.
    units : not used; as in the other pictures
    """
    rows = diagnosis.table()
    if not rows:
        raise NarxError(f"There is no candidate to draw: the verdict is {diagnosis.verdict}.")
    if ax is None:
        _, ax = new_axes(figsize=(8, _height(diagnosis)))
    low = max(-0.5, min(0.0, 1.1 * min(r["low"] for r in rows)))
    high = max(1.0, min(1.2, max(r["high"] for r in rows)))
    best = "these data cannot tell them apart" if len(diagnosis.confusion_set) > 1 else "the best"
    for inside, colour, hatch, word in (
        (True, ORANGE, "", best),
        (False, SKY, "//", "others: less, or with more parameters"),
    ):  # fmt: skip
        chosen = [i for i, r in enumerate(rows) if r["in_confusion_set"] == inside]
        if chosen:
            shares = np.clip([rows[i]["share"] for i in chosen], low, high)
            ax.barh(chosen, shares, 0.6, color=colour, hatch=hatch, edgecolor="white", lw=0, label=word)
    for i, row in enumerate(rows):
        a, b = np.clip([row["low"], row["high"]], low, high)
        first = "95 % interval" if i == 0 else None
        ax.plot([a, b], [i, i], color=BLACK, lw=1.3, marker="|", ms=9, solid_capstyle="butt", label=first)
        ax.annotate(
            f"NRMSE {row['nrmse']:.2g}", (1.01, i), xycoords=("axes fraction", "data"), va="center", fontsize=9,
            annotation_clip=False,
        )  # fmt: skip
    ax.axvline(0, color=BLACK, lw=0.6)
    ax.set_xlim(low, high + 0.03)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_yticks(
        range(len(rows)),
        [
            textwrap.fill(
                f"{'* ' if r['in_confusion_set'] else ''}{r['effect'].replace('_', ' ')}, {r['where']}", 26
            ).replace("$", r"\$")
            for r in rows
        ],
    )
    ax.set_xlabel("share of the removable error, held-out samples")
    place = {"loc": "lower left", "bbox_to_anchor": (-0.3, 1)}
    ax.legend(fontsize=8, frameon=False, **place)
    if path is not None:
        write_figure(ax.figure, path)
    return ax.figure
