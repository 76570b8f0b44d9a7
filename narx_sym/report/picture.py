"""One picture, alone on its axes: what the report and the live page show, with the numbers behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..files.atomic import csv_text
from .plots import new_axes
from .svg import svg

NARROW, WIDE = (3.9, 2.9), (8.8, 2.6)  # [inch]


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture.

    Attributes
    ----------
    key : str
        Unique among the pictures of a diagnosis; letters, digits and "_".
    title, alt : str
        Heading, and what there is to see, in words and numbers.
    draw : function of matplotlib axes
    columns : mapping from a name to (N,) numbers or texts
        The numbers behind it, as drawn.
    size : (width, height) [inch]
    """

    key: str
    title: str
    alt: str
    draw: Callable[[Any], Any]
    columns: Mapping[str, Any]
    size: tuple[float, float] = NARROW

    def figure(self) -> Any:
        """Return a new matplotlib figure."""
        figure, ax = new_axes(figsize=self.size)
        self.draw(ax)
        return figure

    @cached_property
    def svg(self) -> str:
        """The picture as an `<svg>` element with a text alternative; its colours follow the page (`svg.stylesheet`)."""
        return svg(self.figure(), self.key, self.alt)

    @property
    def csv(self) -> str:
        """The numbers as CSV."""
        return csv_text(self.columns)


def drawing(draw: Callable[..., None], *more: Any) -> Callable[[Any], None]:
    """Return a function of axes alone: `draw` with all that it needs besides."""
    return lambda ax: draw(ax, *more)
