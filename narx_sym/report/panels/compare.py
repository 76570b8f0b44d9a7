"""Measured and simulated output over time and as loops, before and after, on the same axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...diagnosis.bases import words
from .. import interactive
from ..comparison import draw_errors, draw_loop, draw_time
from ..picture import WIDE, Picture, drawing
from .registry import WAY, Material, panel


def pictures(material: Material) -> list[Picture]:
    """Return time responses, errors and loops, before and after, on the same axes."""
    c, units = material.compared, material.units
    found = []
    for i, run in enumerate(c.runs):
        when = ("before", "after")[i] if len(c.runs) > 1 else ""
        alt = f"Measured output and free run of {words(run)} over time, {c.t[-1] - c.t[0]:.3g} s. "
        alt += f"The free-run error is {c.nrmse[run]:.2g} of the output's standard deviation."
        found.append(
            Picture(
                f"time_{i}", f"Time response {when}".rstrip(), alt, drawing(draw_time, c, run, units), c.drawn, WIDE
            )
        )
    rms = {n: float(np.sqrt(np.mean(e**2))) for n, e in c.errors.items()}
    sizes = ", ".join(f"{words(n)} {size:.2g}" for n, size in rms.items())
    alt = f"Free-run error over time; rms [{units.get('y') or 'unit of y'}]: {sizes}; noise floor {c.floor:.2g}."
    drawn = {"t": c.drawn["t"], **{f"error of {n}": e[c.keep] for n, e in c.errors.items()}}
    found.append(
        Picture(
            "errors",
            "Error before and after" if len(c.runs) > 1 else "Error",
            alt,
            drawing(draw_errors, c, units),
            drawn,
            WIDE,
        )
    )
    for i, run in enumerate(c.runs):
        when = ("before", "after")[i] if len(c.runs) > 1 else ""
        alt = f"Loop of output against input, measured and free run of {words(run)}."
        found.append(Picture(f"loop_{i}", f"Loop {when}".rstrip(), alt, drawing(draw_loop, c, run, units), c.drawn))
    return found


@panel("Measured and simulated", order=20, draws=pictures, about=WAY, live=50)
def compare(material: Material) -> dict[str, Any]:
    """Tell which run is which, with pictures that can be zoomed."""
    from markupsafe import Markup

    c = material.compared
    script, elements = interactive.comparison(c, material.units) if material.scripts else ("", {})
    static = {p.key: p for p in material.pictures("compare")}
    same = {"time": "time_0", "errors": "errors", "loop0": "loop_0", "loop1": "loop_1"}
    live = [(name, static[same[name]], Markup(element)) for name, element in elements.items()]
    count = len(material.diagnosis.steps[0].base.split.records)
    return {"script": Markup(script), "live": live, "runs": list(c.runs), "name": c.name, "count": count}
