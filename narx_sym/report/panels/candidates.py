"""What may be missing: the candidates with their equations, and what could not have been seen."""

from __future__ import annotations

from typing import Any

from ...diagnosis.bases import percent_of
from ...diagnosis.bases import words as words_of
from ...diagnosis.procedure import Diagnosis
from ...models.extend import Variant
from .. import parameters, words
from ..picture import Picture
from ..plots import plot_candidates
from .registry import Material, panel


def picture(diagnosis: Diagnosis) -> Picture:
    """Return the share of the removable error that each candidate removes."""
    rows = diagnosis.table()
    listed = "; ".join("{} {} ({})".format(words_of(r["effect"]), *words.removed(r)) for r in rows)
    alt = f"Fraction of the removable error that each candidate removes, with 95 % intervals: {listed}."
    keys = ("effect", "where", "share", "low", "high", "nrmse", "in_confusion_set", "parameters")
    columns = {key: [r[key] for r in rows] for key in keys}
    size = (4.6, max(2.8, 1.7 + 0.42 * len(rows)))
    return Picture("candidates", "Candidates", alt, lambda ax: plot_candidates(diagnosis, ax=ax), columns, size)


def pictures(material: Material) -> list[Picture]:
    """Return the picture, where there is a candidate."""
    return [picture(material.lacking)] if material.lacking.candidates else []


@panel("What may be missing", order=50, draws=pictures)
def candidates(material: Material) -> dict[str, Any]:
    """Tell of each candidate, and of the steps after the first."""
    d, units = material.lacking, material.units
    rows = [
        row
        | {
            "removed": words.removed(row),
            "probable": "" if c.probability is None else percent_of(c.probability),
            "latex": c.latex.split(r",\quad "),
            "sentence": c.described,
            "form": _form(c.variant),
            "parameters": parameters.candidate_parameters(c, units, letters=True),
        }
        for row, c in zip(d.table(), d.candidates, strict=True)
    ]
    small = words.detectable(d.steps[0], units)
    return {"rows": rows, "step": d.steps[0], "small": small, "later": list(enumerate(d.steps[1:], 2))}


def _form(variant: Variant) -> str:
    return str(variant).removeprefix(variant.id).strip()[1:-1]
