"""The picture in which a reference is drawn: what the page's script reads and fills."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

from ...data.units import headed, said_first
from ...report.figures import describe
from ...report.hero import PICTURE
from ..workbench import Workbench
from .widgets import part, said

SCRIPTS = (PICTURE, Path(__file__).with_name("drawn.js"))
KEYS = (
    "With keys: Tab goes from point to point, the arrows move one (with Shift by ten steps), Enter sets one behind it, "
    "Delete takes it away, Ctrl+Z takes back, Escape leaves the picture."
)


def script() -> str:
    """Return the module that fills the picture: looks and script of the report's pictures, and what is drawn."""
    return "\n".join([describe.script(), *(one.read_text(encoding="utf-8") for one in SCRIPTS)])


def drawing(bench: Workbench) -> None:
    """Show the picture, with the identified range and, where the law knows them, the levels that its limits hold."""
    current, record, law = bench.current, bench.record, bench.law
    if current is None or record is None:
        return
    model, unit = current.base.model, said_first(record.units, bench.choice.units).get("y", "")
    low, high = model.info.ranges.get(model.output.name, (float(record.y.min()), float(record.y.max())))
    rests = law.rests if law is not None and law.rests else ()
    told = {"y": [low, high], "rests": rests, "label": headed("r", unit), "unit": unit}
    said(
        "Draw in the picture: a line takes the place of the points in its time. A click sets a point; points can be "
        f"dragged. Sampled every {record.Ts:.6g} s: straight between points, level before the first and after the last."
    ).classes("hint")
    part(markup(json.dumps(told), headed("r", unit), rests))
    said(KEYS).classes("hint").props("id=drawing-keys")


def markup(told: str, label: str, rests: Sequence[float]) -> str:
    """Return the place of the picture; `told` is what the script reads, as JSON."""
    alt = f"Reference {label} over the time in seconds, with the range of the output in which the model was identified"
    legend = {"reference": "reference", "range": "identified range of the output"}
    legend |= {"limit": "where the law's limits of the input let the model rest"} if rests else {}
    keys = (
        f'<li><span class="key" style="{describe.key(role)}"></span>{escape(word)}</li>'
        for role, word in legend.items()
    )
    return (
        f'<div class="drawing" data-drawn="{escape(told)}"><div class="drawing-picture">'
        f'<canvas role="img" aria-label="{escape(alt)}"></canvas>'
        '<div class="drawing-points" role="group" aria-label="Points of the reference" aria-describedby="drawing-keys">'
        "</div></div>"
        '<div class="drawing-foot"><p class="drawing-said"></p><p class="drawing-buttons">'
        '<button type="button" data-do="back">Take back</button> '
        '<button type="button" data-do="again">Do again</button>'
        '</p></div><p class="drawing-warned"></p><ul class="legend" aria-label="Colours of the picture">'
        f"{''.join(keys)}</ul></div>"
    )
