"""What was found: the verdict in words, sizes in the user's units, and what to do next."""

from __future__ import annotations

from typing import Any

from .. import words
from .registry import Material, panel


@panel("What was found", order=10, live=10)
def verdict(material: Material) -> dict[str, Any]:
    """Tell the verdict."""
    d, units = material.diagnosis, material.units
    rows = [r for r in d.misfit.table(units) if max(r["share"], r["share_missing"] or 0) > 0.05]
    return {
        "sentence": d.sentence(units), "sizes": words.sizes(d, units), "next": words.what_next(d),
        "worst": rows[0] if rows else None, "steps": [s.sentence(units) for s in d.steps[1:]],
    }  # fmt: skip
