"""What follows from the model by algebra, its quasi-static sets, and its compensation law."""

from __future__ import annotations

from typing import Any

from ...codegen.units import by_unit
from ...data.record import Record
from ...errors import ModelError, NarxError, NotInvertible
from ...inversion.analyses import derived as every
from ...models.model import Model
from ...symbolic.signals import differences, samples
from ...tasks.compensate import ahead, caution
from ..comparison import Units
from ..picture import Picture
from ..plots import new_axes, plot_quasi_static
from ..words import DIGITS
from .registry import Material, panel


def quasi_static(model: Model, units: Units, of: str = "", record: Record | None = None) -> Picture | None:
    """Return the quasi-static sets, None where they are not derived or where the model does not stay finite."""

    def draw(ax: Any) -> None:
        plot_quasi_static(model, ax=ax, units=dict(units), record=record)

    try:
        draw(new_axes(figsize=(5.2, 5.0))[1])
    except NarxError:
        return None
    alt = "Quasi-static sets over the input: attracting and repelling parts, and the model's own loop."
    return Picture("quasi_static", f"Quasi-static sets{of}", alt, draw, {}, (5.2, 5.0))


def pictures(material: Material) -> list[Picture]:
    """Return the sets of the model, of the base where those of the model are not derived; none where neither is."""
    step, model = material.diagnosis.steps[0], material.diagnosis.model
    base, record = step.base.model, step.base.split.records[0]
    sets = quasi_static(model, material.units, record=record)
    if sets is None and any(samples(base.F, b) for b in differences(base.input)):
        sets = quasi_static(base, material.units, " of the base", record)
    return [] if sets is None else [sets]


@panel("Derived from the model", order=70, draws=pictures)
def derived(material: Material) -> dict[str, Any]:
    """Tell every analysis, and the law with numbers and their units."""
    parts = every(material.subject)
    try:
        law = material.subject.law
    except (ModelError, NotInvertible):  # the reason stands among the parts
        return {"derived": parts, "law": None}
    shown = {
        "latex": law.latex(), "numbers": law.latex(numbers=True),
        "lines": [str(law.stability()), *law.lines(numbers=True)],
        "units": by_unit(law.coefficients(material.units, latex=True), f"{{:.{DIGITS}g}}".format),
        "ahead": ahead(law), "checked": law.checked, "caution": caution(law),
    }  # fmt: skip
    return {"derived": parts, "law": shown}
