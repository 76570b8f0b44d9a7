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
    "Keyboard: Tab selects the next point, the arrow keys move it (with Shift: ten steps), Enter adds a point after "
    "it, Delete removes it, Ctrl+Z undoes the last change, Escape leaves the picture."
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
        "Draw in the picture: a drawn line replaces the points in its time range. A click adds a point; points can "
        f"be dragged. The reference is sampled every {record.Ts:.6g} s: linear between points, constant before the "
        "first and after the last."
    ).classes("hint")
    part(markup(json.dumps(told), headed("r", unit), rests))
    said(KEYS).classes("hint").props("id=drawing-keys")


def markup(told: str, label: str, rests: Sequence[float]) -> str:
    """Return the place of the picture; `told` is what the script reads, as JSON."""
    alt = f"Reference {label} over the time in seconds, with the range of the output in which the model was identified"
    legend = {"reference": "reference", "range": "identified range of the output"}
    legend |= {"limit": "steady state of the model at the input limits"} if rests else {}
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
        '<button type="button" data-do="back">Undo</button> '
        '<button type="button" data-do="again">Redo</button>'
        '</p></div><p class="drawing-warned"></p><ul class="legend" aria-label="Colours of the picture">'
        f"{''.join(keys)}</ul></div>"
    )
