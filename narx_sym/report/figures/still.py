"""Panels on matplotlib axes: for files, and as SVG in pages."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from ...data.units import headed
from .describe import COLOURS, LOOKS, Area, Line, Panel, thinned

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PINK = (
    COLOURS[name][0] for name in ("black", "orange", "sky", "green", "yellow", "blue", "red", "pink")
)


def new_axes(rows: int = 1, columns: int = 1, figsize: Any = None, **options: Any) -> tuple[Any, Any]:
    """Make a figure without a display (no window is opened, also not in scripts)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=figsize, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **options)


def label(name: str, unit: str = "") -> str:
    """Return a name with its unit, where one is known."""
    # A dollar sign would start a formula.
    return headed(name, unit).replace("$", r"\$")


def plain(axis: Any) -> None:
    """Write whole numbers along an axis: a power of ten would stand where the legend is."""
    from matplotlib.ticker import FuncFormatter

    low, high = axis.get_view_interval()
    if not 1e-3 < max(abs(low), abs(high)) < 1e5:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))


def split(ax: Any, heights: Sequence[float]) -> list[Any]:
    """Return axes one above the other in the place of `ax`, which is the first, over the same x."""
    if not heights[1:]:
        return [ax]
    grid = ax.get_subplotspec().subgridspec(len(heights), 1, height_ratios=heights, hspace=0.05)
    ax.set_subplotspec(grid[0])
    axes = [ax, *(ax.figure.add_subplot(grid[i], sharex=ax) for i in range(1, len(heights)))]
    for one in axes[:-1]:
        one.tick_params(labelbottom=False)
        one.xaxis.label.set_visible(False)
    return axes


def draw(ax: Any, *panels: Panel, most: int = 12_000) -> Any:
    """Draw a panel, or several one above the other, and return the figure; see `thinned`."""
    axes = split(ax, [panel.height for panel in panels])
    for i, (one, panel) in enumerate(zip(axes, thinned(most, *panels), strict=True)):
        for mark in panel.marks:
            _mark(one, mark)
        one.set(xlabel=label(panel.x), ylabel=label(panel.y))
        if panel.y_range:
            one.set_ylim(*panel.y_range)
        one.margins(x=0 if panel.along else None)
        plain(one.yaxis)
        rows = legend(one, named(*axes[:i]))
        if panel.title:
            one.set_title(label(panel.title), loc="left", fontsize=10, pad=8 + 15 * rows)
    return ax.figure


def _mark(ax: Any, mark: Line | Area) -> None:
    look = LOOKS[mark.role]
    said: dict[str, Any] = {"color": COLOURS[look.colour][0], "label": label(mark.name) or None}
    line = said | {"lw": look.width, "ls": (0, look.dash) if look.dash else "-"}
    area = said | {"lw": 0, "alpha": look.alpha, "zorder": 0.5}
    if isinstance(mark, Area):
        if look.width:
            (ax.axvline if mark.upright else ax.axhline)(mark.low, **line)
        else:
            (ax.axvspan if mark.upright else ax.axhspan)(mark.low, mark.high, **area)
    elif look.dot:
        ax.plot(mark.x, mark.y, marker=".", ms=look.dot, ls="none", **said)
    elif look.width:
        ax.plot(mark.x, mark.y, **line)
    else:
        ax.fill(mark.x, mark.y, **area)


def named(*axes: Any) -> dict[str, Any]:
    """Return the words of axes, each with the first thing that has it."""
    found: dict[str, Any] = {}
    for ax in axes:
        for handle, word in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(word, handle)
    return found


def legend(ax: Any, said: Collection[str] = (), size: float = 9) -> int:
    """Put words above the axes that were not said yet, as many in a row as there is room for; return how many rows."""
    keys = {word: handle for word, handle in named(ax).items() if word not in said}
    if not keys:
        return 0
    widths = 0.055 * size + 0.0072 * size * np.array([len(word) for word in keys])
    # Of the axes before they are laid out [inch].
    room = 1.25 * ax.get_position().width * ax.figure.get_figwidth() - 0.5
    fits = (n for n in range(len(keys), 1, -1) if sum(max(w) for w in np.array_split(widths, n)) < room)
    columns = next(fits, 1)
    ax.legend(
        keys.values(), keys.keys(), loc="lower left", bbox_to_anchor=(0, 1), ncols=columns, fontsize=size,
        frameon=False, borderaxespad=0.2,
    )  # fmt: skip
    return -(-len(keys) // columns)
