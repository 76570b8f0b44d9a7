"""Panels that can be zoomed and read with the pointer: Bokeh's own output.

Bokeh's script stands inside the page (1.3 MB; plotly.js would be 4.8 MB), nothing is fetched. Colours that depend on a
light or dark page are set by the page's style sheet (Bokeh's `--bk-...` variables).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from .describe import COLOURS, LOOKS, Area, Array, Line, Panel, span, thinned

USUAL, TOOLS = 280, "pan,box_zoom,wheel_zoom,reset,save"  # height [px]
FRAME = COLOURS["black"][2]
MOST = 60_000  # samples: up to here there are all of them, each signal in four bytes a sample


def bundle() -> str:
    """Return Bokeh's script, to stand inside the page once."""
    from bokeh.resources import Resources

    return str(Resources(mode="inline", components=["bokeh"]).render_js())


def zoomed(panels: Mapping[str, Panel]) -> tuple[str, dict[str, str]]:
    """Return the script and the elements of panels, by name; axes of the same words move together."""
    from bokeh.embed import components

    if not panels:
        return "", {}
    shared, less = _Shared(), thinned(MOST, *panels.values())
    made = {name: shared.figure(panel) for name, panel in zip(panels, less, strict=True)}
    script, elements = components(made, wrap_script=True)
    return str(script), dict(elements)


class _Shared:
    """What panels share: each array is sent once, each axis has one range."""

    def __init__(self) -> None:
        from bokeh.models import ColumnDataSource

        self.sources: Any = defaultdict(ColumnDataSource)  # by the number of samples
        self.columns: dict[int, str] = {}  # by the array's id; the panels keep the arrays
        self.ranges: dict[str, Any] = {}

    def column(self, x: Array) -> str:
        if id(x) not in self.columns:
            self.columns[id(x)] = self.sources[x.size].add(np.asarray(x, dtype=np.float32), f"x{len(self.columns)}")
        return self.columns[id(x)]

    def figure(self, panel: Panel) -> Any:
        from bokeh.models import DataRange1d, HoverTool, PlainText, Range1d
        from bokeh.plotting import figure

        lines = [mark for mark in panel.marks if isinstance(mark, Line)]
        ends = (lines[0].x[0], lines[0].x[-1]) if panel.along else span(*(line.x for line in lines))
        across = self.ranges.setdefault(panel.x, Range1d(*ends, bounds="auto" if panel.along else None))
        up = self.ranges.setdefault(panel.y, Range1d(*panel.y_range) if panel.y_range else DataRange1d())
        made = figure(
            height=round(USUAL * panel.height), sizing_mode="stretch_width", x_range=across, y_range=up, tools=TOOLS,
            active_drag=None, toolbar_location="above", background_fill_color=None, border_fill_color=None,
            outline_line_color=FRAME,
        )  # fmt: skip
        made.toolbar.logo = None
        for axis, name in ((made.xaxis, panel.x), (made.yaxis, panel.y)):
            axis.axis_label = PlainText(text=name)  # never a formula
            axis.axis_label_text_font_style = "normal"
            axis.axis_line_color = axis.major_tick_line_color = FRAME
            axis.minor_tick_line_color = None
        made.grid.grid_line_color, made.grid.grid_line_alpha = FRAME, 0.2
        drawn = {id(mark): self.mark(made, mark) for mark in panel.marks}
        x = lines[0].x
        read = {panel.x: x, **panel.also, **{line.name or panel.y: line.y for line in lines if line.x is x}}
        columns = {word: f"@{self.column(values)}" for word, values in read.items()}
        hover = HoverTool(
            tooltips=[(word, f"{column}{{%.5g}}") for word, column in columns.items()],  # whatever their size
            formatters=dict.fromkeys(columns.values(), "printf"), renderers=[drawn[id(lines[0])]],
            mode="vline" if panel.along else "mouse", point_policy="snap_to_data",
        )  # fmt: skip
        made.add_tools(hover)
        return made

    def mark(self, made: Any, mark: Line | Area) -> Any:
        from bokeh.models import BoxAnnotation, Span

        look = LOOKS[mark.role]
        colour, width, dash, alpha = look.on_page.values()
        line = {"line_color": colour, "line_width": width, "line_dash": dash}
        if isinstance(mark, Line):
            x, y, more = self.column(mark.x), self.column(mark.y), {"source": self.sources[mark.x.size]}
            if look.dot:
                return made.scatter(x, y, size=look.dot, color=colour, **more)
            return made.line(x, y, **line, **more) if width else made.patch(x, y, color=colour, alpha=alpha, **more)
        if width:
            return made.add_layout(Span(location=mark.low, dimension="height" if mark.upright else "width", **line))
        sides = ("left", "right") if mark.upright else ("bottom", "top")
        box = BoxAnnotation(fill_color=colour, fill_alpha=alpha, line_alpha=0, level="underlay")
        box.update(**dict(zip(sides, (mark.low, mark.high), strict=True)))
        return made.add_layout(box)
