"""Where a model fails: the error and the missing input against the variables that tell most."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...diagnosis.misfit import Misfit, Panel
from ...errors import NarxError
from ...files.atomic import write_figure
from ..figures.still import BLACK, BLUE, GREEN, PINK, RED, YELLOW, label, named, new_axes, plain


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
    size = (1 + 5 * len(columns), 1 + 2.4 * len(names))
    figure, axes = new_axes(len(names), len(columns), size, sharex="row", squeeze=False)
    for column, (word, panels) in enumerate(columns):
        found = {panel.name: panel for panel in panels}
        floor = misfit.floor if panels is misfit.panels else None
        top = reach([found[name] for name in names if name != "spectrum"])
        what = "error" if panels is misfit.panels else "missing input"
        for row, name in enumerate(names):
            draw_panel(axes[row, column], found[name], floor, units, what, top)
        axes[0, column].annotate(
            word, (0.5, 1), (0, 24), "axes fraction", "offset points", ha="center", fontsize=12, weight="bold"
        )
    marks = {word: handle for word, handle in named(*axes.flat).items() if not word.endswith("\u2009")}
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


def draw_panel(
    ax: Any, panel: Panel, floor: float | None, units: dict[str, str], what: str = "error", top: float | None = None
) -> list[tuple[int, float]]:
    """Draw one panel: means with two standard errors over the width of their cells.

    Parameters
    ----------
    what : what the means are of
    top : half the range of means

    Returns
    -------
    list of (cell, its place along the axis), of those whose mean is drawn at one place
    """
    ax.axhline(0, color=BLACK, lw=0.6, zorder=1)
    spectrum = panel.name == "spectrum"
    ax.set_ylabel(label(f"rms {what} in a bin" if spectrum else f"mean {what}", units.get("y", "")))
    if top and not spectrum:  # which has another quantity
        ax.set_ylim(-top, top)
    plain(ax.yaxis)
    title = {"spectrum": "strongest line in the rest"}.get(panel.name, panel.label.replace(", ", " and "))
    ax.set_title(f"{title}: {100 * panel.share:.0f} % of the variance", loc="left", fontsize=10)
    floor_label = "noise floor (± rms)"
    if spectrum:
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
        ax.set(xlabel=label(panel.label, "Hz"), ylim=(0, None))
        return []
    if floor:
        ax.axhspan(-floor, floor, color=YELLOW, alpha=0.35, lw=0, zorder=0, label=floor_label)
    if panel.low.ndim == 2:
        return _draw_grid(ax, panel, units)
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
    return [(int(i), float(middle[i])) for i in np.flatnonzero(~grey)]


def _draw_grid(ax: Any, panel: Panel, units: dict[str, str]) -> list[tuple[int, float]]:
    """Draw joint cells of amplitude and frequency: one of them along the axis, the other by colour."""
    drawn: list[tuple[int, float]] = []
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
        drawn += [(int(k), float(inverse[k] + shift)) for k in np.flatnonzero(chosen)]
        for k in inverse[(panel.low[:, other] == low) & np.isnan(panel.mean)]:
            ax.axvspan(k + shift - 0.1, k + shift + 0.1, color="0.85", lw=0, zorder=0, label="too few samples")
    edges = [panel.high[panel.low[:, along] == p, along][0] for p in places]
    ax.set_xticks(range(places.size), [f"{a:.3g} to\n{b:.3g}" for a, b in zip(places, edges, strict=True)])
    ax.set_xlabel(label(f"{names[along]} of a swing", kinds[along]))
    own = [(h, t) for h, t in zip(*ax.get_legend_handles_labels(), strict=True) if t.endswith("\u2009")]
    if len(own) > 1:
        columns = len(own) if sum(len(t) for _, t in own) < 48 else 1  # as many as there is room for
        ax.legend(
            *zip(*own, strict=True), fontsize=7, title=names[other], title_fontsize=7, ncols=columns, frameon=False,
            loc="lower left", bbox_to_anchor=(-0.1, 1), borderaxespad=0.2, alignment="left", columnspacing=1.0,
            handletextpad=0.2,
        )  # fmt: skip
    return drawn
