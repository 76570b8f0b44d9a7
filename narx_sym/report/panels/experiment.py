"""The next experiment: its input, and what each candidate says will be measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...diagnosis.bases import words
from ...files.atomic import csv_text
from .. import interactive
from ..comparison import POINTS, Array, Units
from ..picture import WIDE, Picture, drawing
from ..plots import BLACK, BLUE, GREEN, ORANGE, PINK, RED, label, thin
from .registry import Material, panel


def draw_input(ax: Any, t: Array, u: Array, units: Units) -> None:
    """Draw the input of an experiment."""
    keep = thin(u, POINTS)
    ax.plot(t[keep], u[keep], color=BLUE, lw=1.2)
    ax.set(xlabel="time [s]", ylabel=label("u", units.get("u", "")))
    ax.margins(x=0)


def draw_outputs(ax: Any, t: Array, outputs: Mapping[str, Array], units: Units) -> None:
    """Draw by how much the candidates' outputs differ from their mean."""
    mean = np.mean(list(outputs.values()), axis=0)
    looks = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (PINK, ":"), (BLACK, "-"), (RED, "--"))
    for (name, y), (colour, style) in zip(outputs.items(), looks, strict=False):
        keep = thin(y - mean, POINTS)
        ax.plot(t[keep], (y - mean)[keep], color=colour, ls=style, lw=1.0, label=words(name))
    ax.set(xlabel="time [s]", ylabel=label("y - mean of all", units.get("y", "")))
    ax.margins(x=0)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=9, frameon=False, borderaxespad=0.2)


def pictures(material: Material) -> list[Picture]:
    """Return the input to run next, and what each candidate says will be measured."""
    e, units = material.diagnosis.experiment, material.units
    if e is None:
        return []
    alt = f"Input over {e.duration:.3g} s: {e.name}."
    first = Picture("next_input", "Input", alt, drawing(draw_input, e.t, e.u, units), {"t": e.t, "u": e.u}, WIDE)
    alt = f"What the candidates say differs by {e.separation:.2g} {units.get('y', '')} rms or more after a refit."
    keep = np.unique(np.concatenate([thin(y, POINTS // 2) for y in e.outputs.values()]))
    columns = {"t": e.t[keep], **{n: y[keep] for n, y in e.outputs.items()}}
    draw = drawing(draw_outputs, e.t, e.outputs, units)
    return [first, Picture("next_outputs", "What the candidates say", alt, draw, columns, WIDE)]


@panel("The next experiment", order=80, draws=pictures, live=40, live_title="")
def experiment(material: Material) -> dict[str, Any] | None:
    """Tell what to run, and what it will show; nothing where no experiment is needed."""
    from markupsafe import Markup

    e = material.diagnosis.experiment
    if e is None:
        return None
    script, elements = interactive.experiment(e, material.units) if material.scripts else ("", {})
    drawn = material.pictures("experiment")
    live = [(name, p, Markup(part)) for (name, part), p in zip(elements.items(), drawn, strict=False)]
    looks = zip(map(words, e.outputs), interactive.LOOKS, interactive.DASHES, strict=False)
    files = {one: csv_text({"t": of.t, "u": of.u}) for one, of in {"next": e, "next_wider": e.wider}.items() if of}
    return {"e": e, "files": files, "script": Markup(script), "live": live, "looks": list(looks)}
