"""The model before and after, with its parameters, and how it is taken away."""

from __future__ import annotations

from typing import Any

from ...errors import ModelError
from ...files.store import to_text
from ...models.info import acts
from ...models.model import Model
from ...symbolic.mathml import marked
from ...symbolic.signals import INNER_INPUTS, INNER_OUTPUTS
from ..parameters import called, moved, parameters, shape_units
from .registry import Material, panel


@panel("The model before and after", order=60)
def model(material: Material) -> dict[str, Any]:
    """Tell the equations, what is new in them, and what moved."""
    from markupsafe import Markup

    d, units = material.diagnosis, material.units
    before, after = d.steps[0].base.model, d.model
    # Of the base's own equation, and of the input that it sees, only what was added is new.
    named = {*INNER_INPUTS, *INNER_OUTPUTS}
    states = {s.left.base for s in after.states} - {s.left.base for s in before.states} - named
    new = (set(after.symbols) - set(before.symbols)) | states
    rows = parameters(before, after, units, shape_units(d, units))
    try:
        file = to_text(after)
    except ModelError:  # a channel's name that a model file does not take
        file = ""
    return {
        "before": [Markup(marked(before, values=v)) for v in (False, True)],
        "after": [Markup(marked(after, new, numbers)) for numbers in (False, True)] if after is not before else [],
        "rows": rows, "names": called(before, units) | called(after, units), "moved": moved(rows),
        "point": after.operating_point, "acts": acts(after.delay, after.Ts),
        "latex": after.latex(),
        "python": python(after, d.ladder[-1]["train"]), "file": file,
        **({"title": "The model"} if len(d.ladder) == 1 else {}),
    }  # fmt: skip


def python(model: Model, error: float, file: str = "model.json") -> str:
    """Return Python code that runs a model from its file, and gives the error that the page shows."""
    lines = ["import narx_sym as ns", "", *(f"# {line}" for line in model.lines(numbers=True))]
    given = f", channels={list(model.channels)}" if model.channels else ""
    lines += [f'model = ns.load("{file}")', f'record = ns.read("data.csv", u="u", y="y"{given})']
    lines += ["simulated = ns.free_run(model, record)", f"ns.evaluate(model, record).free_run_nrmse  # {error:.6g}"]
    return "\n".join(lines) + "\n"
