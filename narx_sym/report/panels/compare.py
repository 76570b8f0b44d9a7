"""Measured and simulated output over time and as loops, before and after, on the same axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...diagnosis.bases import words
from ..comparison import errors, loop, response
from ..figures.still import drawing
from ..picture import NARROW, WIDE, Picture
from .registry import WAY, Material, panel


def pictures(material: Material) -> list[Picture]:
    """Return time response, errors and loops, before and after, on the same axes."""
    c, units = material.compared, material.units
    rms = {n: float(np.sqrt(np.mean(e**2))) for n, e in c.errors.items()}
    sizes = ", ".join(f"{words(n)} {size:.2g}" for n, size in rms.items())
    relative = ", ".join(f"{words(n)} {size:.2g}" for n, size in c.nrmse.items())
    both, columns = len(c.runs) > 1, c.still.columns
    left = {"t": c.still.t, **{f"error of {n}": e for n, e in c.still.errors.items()}}
    listed = [
        ("time", "Time response", f"Measured output and free runs over time, {c.t[-1] - c.t[0]:.3g} s. The free-run "
         f"errors are, over the output's standard deviation: {relative}.", response, tuple(c.runs), columns, WIDE),
        ("errors", "Error before and after" if both else "Error", "Free-run error over time; rms "
         f"[{units.get('y') or 'unit of y'}]: {sizes}; noise floor {c.floor:.2g}.", errors, (), left, WIDE),
    ]  # fmt: skip
    for i, (run, when) in enumerate(zip(c.runs, (" before", " after") if both else ("",), strict=True)):
        alt = f"Loop of output against input, measured and free run of {words(run)}."
        listed.append((f"loop_{i}", f"Loop{when}", alt, loop, (run,), columns, NARROW))
    return [
        Picture(key, title, alt, drawing(of(c.still, units, *runs)), numbers, size, zoomable=of(c.zoomed, units, *runs))
        for key, title, alt, of, runs, numbers, size in listed
    ]


@panel("Measured and simulated", order=20, draws=pictures, about=WAY, live=50)
def compare(material: Material) -> dict[str, Any]:
    """Tell which segment is shown, and what of it is not fitted."""
    c = material.compared
    roles = {one.role for one in c.aside}
    return {"roles": roles, "name": c.name, "count": len(material.diagnosis.steps[0].base.split.records)}
