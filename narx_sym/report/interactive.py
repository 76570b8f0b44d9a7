"""Time response, errors and loops that can be zoomed and read with the pointer: Bokeh's own output.

Bokeh's script stands inside the page (1.3 MB; plotly.js would be 4.8 MB), nothing is fetched. Colours that depend on a
light or dark page are set by the page's style sheet (Bokeh's `--bk-...` variables).
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ..diagnosis.bases import words
from ..diagnosis.experiment import Experiment
from .comparison import POINTS, Comparison, Units
from .plots import YELLOW, label, thin

# They stand out from light and from dark paper.
MEASURED, BEFORE, AFTER = "#767676", "#C47F00", "#1F83C0"
LOOKS = (AFTER, BEFORE, "#0E9A72", "#B8618F", MEASURED, "#D55E00")  # of several candidates
DASHES = ("solid", "dashed", "dotdash", "dotted", "solid", "dashed")
HEIGHT, LOW, TOOLS = 280, 220, "pan,box_zoom,wheel_zoom,reset,save"


def bundle() -> str:
    """Return Bokeh's script, to stand inside the page once."""
    from bokeh.resources import Resources

    return str(Resources(mode="inline", components=["bokeh"]).render_js())


def comparison(c: Comparison, units: Units) -> tuple[str, dict[str, str]]:
    """Return the script and the elements of the interactive pictures, by name: "time", "errors", "loop0", "loop1".

    Parameters
    ----------
    c : Comparison
    units : mapping such as {"u": "V", "y": "um"}
    """
    from bokeh.embed import components
    from bokeh.models import BoxAnnotation, ColumnDataSource, DataRange1d, Range1d

    names = [f"run{i}" for i in range(len(c.runs))]
    runs = dict(zip(names, c.runs, strict=True))
    data = {"t": c.t, "u": c.u, "measured": c.y} | {n: c.runs[run] for n, run in runs.items()}
    data |= {f"error{i}": e for i, e in enumerate(c.errors.values())}
    source = ColumnDataSource({n: np.asarray(x[c.zoomed], dtype=np.float32) for n, x in data.items()})
    y_name, u_name = label("y", units.get("y", "")), label("u", units.get("u", ""))
    said = {n: f"free run of {words(run)}" for n, run in runs.items()}
    looks = dict(zip(names, (BEFORE, AFTER), strict=False))
    values = [("time", "@t s"), (u_name, "@u"), ("measured", "@measured"), *((said[n], f"@{n}") for n in names)]

    time = _figure("time [s]", y_name, HEIGHT, Range1d(c.t[0], c.t[-1], bounds="auto"), Range1d(*c.span))
    line = time.line("t", "measured", source=source, color=MEASURED, width=2)
    for n in names:
        time.line("t", n, source=source, color=looks[n], width=1.5)
    _hover(time, values, [line])
    errors = _figure("time [s]", label("error", units.get("y", "")), LOW, time.x_range, DataRange1d())
    errors.add_layout(BoxAnnotation(bottom=-c.floor, top=c.floor, fill_color=YELLOW, fill_alpha=0.35, line_alpha=0))
    drawn = [errors.line("t", f"error{i}", source=source, color=looks[n], width=1.2) for i, n in enumerate(names)]
    read = [("time", "@t s"), *((f"error of {words(r)}", f"@error{i}") for i, r in enumerate(c.runs))]
    _hover(errors, read, drawn[:1])
    loops: list[Any] = []
    across = Range1d(*_room(c.u))
    for n in names:
        loop = _figure(u_name, y_name, HEIGHT + 40, across, time.y_range)
        line = loop.line("u", "measured", source=source, color=MEASURED, width=2)
        loop.line("u", n, source=source, color=looks[n], width=1.3)
        _hover(loop, values, [line], mode="mouse")
        loops.append(loop)
    script, elements = components(
        {"time": time, "errors": errors, **{f"loop{i}": loop for i, loop in enumerate(loops)}}, wrap_script=True
    )
    return str(script), dict(elements)


def experiment(e: Experiment, units: Units) -> tuple[str, dict[str, str]]:
    """Return the script and the elements of the next experiment, by name: "input", "outputs"."""
    from bokeh.embed import components
    from bokeh.models import DataRange1d, Range1d

    first = _figure(
        "time [s]", label("u", units.get("u", "")), LOW, Range1d(e.t[0], e.t[-1], bounds="auto"), DataRange1d()
    )
    keep = thin(e.u, POINTS)
    _hover(first, [("time", "@x s"), ("u", "@y")], [first.line(e.t[keep], e.u[keep], color=AFTER, width=1.5)])
    second = _figure("time [s]", label("y - mean of all", units.get("y", "")), LOW, first.x_range, DataRange1d())
    mean = np.mean(list(e.outputs.values()), axis=0)
    for (name, y), colour, dash in zip(e.outputs.items(), LOOKS, DASHES, strict=False):
        keep = thin(y - mean, POINTS)
        line = second.line(e.t[keep], (y - mean)[keep], color=colour, line_dash=dash, width=1.5)
        _hover(second, [(words(name), "@y"), ("time", "@x s")], [line], mode="mouse")
    script, elements = components({"input": first, "outputs": second}, wrap_script=True)
    return str(script), dict(elements)


def _figure(x: str, y: str, height: int, x_range: Any, y_range: Any) -> Any:
    from bokeh.plotting import figure

    made = figure(
        height=height, sizing_mode="stretch_width", x_range=x_range, y_range=y_range, tools=TOOLS,
        active_drag=None, toolbar_location="above", background_fill_color=None, border_fill_color=None,
        outline_line_color=MEASURED,
    )  # fmt: skip
    made.toolbar.logo = None
    for axis, name in ((made.xaxis, x), (made.yaxis, y)):
        axis.axis_label = name
        axis.axis_label_text_font_style = "normal"
        axis.axis_line_color = axis.major_tick_line_color = MEASURED
        axis.minor_tick_line_color = None
    made.grid.grid_line_alpha = 0.25
    return made


def _hover(made: Any, values: list[tuple[str, str]], lines: list[Any], mode: str = "vline") -> None:
    """Show values to five digits, whatever their size."""
    from bokeh.models import HoverTool

    read = [(name, re.sub(r"(@\w+)", r"\1{%.5g}", value)) for name, value in values]
    formats = {column: "printf" for _, value in values for column in re.findall(r"@\w+", value)}
    made.add_tools(
        HoverTool(tooltips=read, formatters=formats, renderers=lines, mode=mode, point_policy="snap_to_data")
    )


def _room(x: np.ndarray) -> tuple[float, float]:
    room = 0.05 * float(np.ptp(x)) or 1.0
    return float(x.min()) - room, float(x.max()) + room
