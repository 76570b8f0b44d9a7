"""Measured and simulated output over time and as loops, before and after, on the same axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...diagnosis.bases import words
from ...symbolic.numbers import sized
from ..comparison import errors, loop, response
from ..picture import WIDE, Picture
from .registry import Material, panel


def pictures(material: Material) -> list[Picture]:
    """Return time response, errors and loops, before and after, on the same axes."""
    c, units = material.compared, material.units
    relative = ", ".join(f"{words(n)} {size:.2g}" for n, size in c.nrmse.items())
    unit = units.get("y", "")
    sizes = ", ".join(f"{words(n)} {sized(np.sqrt(np.mean(e**2)), unit, 2)}" for n, e in c.errors.items())
    told = f"Measured output and free runs over time, {c.t[-1] - c.t[0]:.3g} s. "
    told += f"The free-run errors are, over the output's standard deviation: {relative}."
    left = f"Free-run error over time; rms: {sizes}"
    left += f"; noise floor {sized(c.floor, unit, 2)}." if c.band else "."
    numbers = {"t": c.t[c.keep], **{f"error of {n}": e[c.keep] for n, e in c.errors.items()}}
    title, whens = ("Error before and after", (" before", " after")) if len(c.runs) > 1 else ("Error", ("",))
    return [
        Picture("time", "Time response", told, [response(c, units, *c.runs)], c.columns, WIDE),
        Picture("errors", title, left, [errors(c, units)], numbers, WIDE),
        *(Picture(f"loop_{i}", f"Loop{when}", f"Loop of output against input, measured and free run of {words(run)}.",
                  [loop(c, units, run)], c.columns)
          for i, (run, when) in enumerate(zip(c.runs, whens, strict=True))),
    ]  # fmt: skip


@panel("Measured and simulated", order=20, draws=pictures)
def compare(material: Material) -> dict[str, Any]:
    """Tell which segment is shown, and what of it is not fitted."""
    c = material.compared
    roles = {one.role for one in c.aside}
    return {"roles": roles, "name": c.name, "count": len(material.diagnosis.steps[0].base.split.records)}
