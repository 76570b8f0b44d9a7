"""The error after each added effect, down to the noise floor."""

from __future__ import annotations

from typing import Any

from ...diagnosis.bases import words
from ...diagnosis.procedure import Diagnosis
from ...fit.evaluate import PROTOCOL
from ...symbolic.numbers import prefixed
from ..comparison import Units
from ..picture import Picture
from ..plots import plot_ladder
from ..words import PARTS, has_floor
from .registry import Material, panel


def picture(diagnosis: Diagnosis, units: Units) -> Picture:
    """Return the error after each added effect, down to the floor."""
    rungs = diagnosis.ladder
    floor = diagnosis.floor / diagnosis.steps[0].base.problem.spread
    falls = ", then ".join(f"{r['validation']:.2g} {_after(n)}" for n, r in zip(diagnosis.rungs, rungs, strict=True))
    alt = f"Free-run error on validation data, over the standard deviation of the output: {falls}; "
    known = has_floor(diagnosis)
    columns = {
        "model": [*diagnosis.rungs, *(["noise floor"] if known else [])],
        **{what: [*(r[part] for r in rungs), *([floor] if known else [])] for part, what in PARTS.items()},
    }

    def draw(ax: Any) -> None:
        plot_ladder(diagnosis, units=dict(units), ax=ax)

    alt += f"the noise floor is {floor:.2g}." if known else "the noise floor is not estimated."
    return Picture("ladder", "Error ladder", alt, draw, columns, (max(4.0, 1.8 + 1.1 * len(rungs)), 3.5))


def _after(rung: str) -> str:
    return "for the base" if rung == "base" else f"with {words(rung)}"


@panel("The error, step by step", order=30)
def ladder(material: Material) -> dict[str, Any]:
    """Tell the errors as a table."""
    d = material.diagnosis
    spread = d.steps[0].base.problem.spread
    rows = [{"name": n, **r} for n, r in zip(d.rungs, d.ladder, strict=True)]
    if has_floor(d):
        rows.append({"name": "noise floor", "train": None, "validation": d.floor / spread, "validation_rms": d.floor})
    factor, unit = prefixed(material.units.get("y", ""), d.ladder[0]["validation_rms"])
    return {
        "rungs": rows, "factor": factor, "unit": unit, "kind": d.steps[0].floor_kind, "protocol": PROTOCOL,
        "validation": d.validation, "csv": picture(d, material.units).csv,
    }  # fmt: skip
