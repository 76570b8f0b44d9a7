"""What all pictures share: colours, axes without a display, labels with units, and few enough points."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from ...data.units import headed

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
    return headed(name, unit).replace("$", r"\$")


def thin(x: np.ndarray, most: int = 4000) -> np.ndarray:
    """Return indices that keep the extremes of each bin: enough points to draw, none that matters lost."""
    if x.size <= 2 * most:
        return np.arange(x.size)
    edges = np.linspace(0, x.size, most // 2 + 1).astype(int)
    picks = [i for a, b in itertools.pairwise(edges) for i in (a + np.argmin(x[a:b]), a + np.argmax(x[a:b]))]
    return np.unique([0, *picks, x.size - 1])
