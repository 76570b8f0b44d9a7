"""The next experiment: its input, and what each candidate says will be measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...data.units import headed
from ...diagnosis.bases import words
from ...files.atomic import csv_text
from ...symbolic.numbers import sized
from ..figures.describe import SEVERAL, TIME, thin, traces
from ..picture import POINTS, WIDE, Picture
from .registry import Material, panel


def pictures(material: Material) -> list[Picture]:
    """Return the input to run next, and by how much what the candidates say differs from its mean."""
    e, units = material.lacking.experiment, material.units
    if e is None:
        return []
    mean = np.mean(list(e.outputs.values()), axis=0)
    told = {words(n): (role, y - mean) for role, (n, y) in zip(SEVERAL, e.outputs.items(), strict=False)}
    u_name, y_name = headed("u", units.get("u")), headed("y - mean of all", units.get("y"))
    first = traces(TIME, e.t, u_name, {"": ("input", e.u)}, height=0.8)
    second = traces(TIME, e.t, y_name, told, height=0.8)
    alt = f"Input over {e.duration:.3g} s: {e.name}."
    apart = sized(e.separation, units.get("y", ""), 2)
    said = f"The predictions of the candidates differ by {apart} rms or more after a refit."
    keep = np.unique(np.concatenate([thin(y, POINTS // 2) for y in e.outputs.values()]))
    columns = {"t": e.t[keep], **{n: y[keep] for n, y in e.outputs.items()}}
    return [
        Picture("next_input", "Input", alt, [first], {"t": e.t, "u": e.u}, WIDE),
        Picture("next_outputs", "Predictions of the candidates", said, [second], columns, WIDE),
    ]


@panel("The next experiment", order=80, draws=pictures)
def experiment(material: Material) -> dict[str, Any] | None:
    """Tell what to run, and what it will show; nothing where no experiment is needed."""
    e = material.lacking.experiment
    if e is None:
        return None
    files = {one: csv_text({"t": of.t, "u": of.u}) for one, of in {"next": e, "next_wider": e.wider}.items() if of}
    return {"e": e, "files": files}
