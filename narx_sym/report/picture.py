"""One picture, alone on its axes: what the report and the live page show, with the numbers behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..files.atomic import csv_text
from .figures.describe import Panel
from .figures.still import draw, new_axes
from .svg import svg

Array = np.ndarray
NARROW, WIDE = (3.9, 2.9), (8.8, 2.6)  # [inch]
POINTS = 1600  # of all lines of a picture together; extremes are kept


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture.

    Attributes
    ----------
    key : str
        Unique among the pictures of a diagnosis; letters, digits and "_".
    title, alt : str
        Heading, and what there is to see, in words and numbers.
    draw : panels, one above the other, or a function of matplotlib axes
    columns : mapping from a name to (N,) numbers or texts
        The numbers behind it, as drawn.
    size : (width, height) [inch]
    clickable : bool
        Whether `draw` returns places that the page can click, [(number, x, y), ...] in the coordinates of the data.
    """

    key: str
    title: str
    alt: str
    draw: Callable[[Any], Any] | Sequence[Panel]
    columns: Mapping[str, Any]
    size: tuple[float, float] = NARROW
    clickable: bool = False

    @cached_property
    def _drawn(self) -> tuple[str, dict[int, Array]]:
        """The `<svg>` element and the places in it: where they are is known once it is laid out."""
        figure, ax = new_axes(figsize=self.size)
        drawn = self.draw(ax) if callable(self.draw) else draw(ax, *self.draw, most=POINTS)
        places = drawn if self.clickable else ()
        text = svg(figure, self.key, self.alt)
        scale, up = np.array([100, -100]) / figure.bbox.size, np.array([0, 100])
        return text, {number: ax.transData.transform((x, y)) * scale + up for number, x, y in places}

    @property
    def svg(self) -> str:
        """The picture as an `<svg>` element with a text alternative; its colours follow the page."""
        return self._drawn[0]

    @property
    def places(self) -> dict[int, Array]:
        """From the number of a place to how far it is from the left and from the top, (2,) [% of the picture]."""
        return self._drawn[1]

    @property
    def csv(self) -> str:
        """The numbers as CSV."""
        return csv_text(self.columns)
