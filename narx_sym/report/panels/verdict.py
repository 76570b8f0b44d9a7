"""What was found: the verdict in words, sizes in the user's units, and what to do next."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...data.evidence.stiction import worst_valve
from ...models.added import newer
from .. import words
from ..comparison import Comparison, Units, worst
from ..parameters import effect_parameters, shape_units
from ..picture import Picture
from ..plots.valve import loop_panels
from .registry import Material, panel

if TYPE_CHECKING:
    from ...diagnosis.procedure import Diagnosis


SIZE = (5.2, 4.1)  # [inch] of the picture beside the verdict


def picture(c: Comparison, units: Units) -> Picture:
    """Return where the error of the base is largest, zoomed, before and after."""
    part = c.at(c.worst)
    times = f"{words.number(part.t[0])} to {words.number(part.t[-1])} s"
    rms = {name: float((e**2).mean() ** 0.5) for name, e in part.errors.items()}
    falls = ", then ".join(f"{words.number(e)} {units.get('y', '')}".rstrip() for e in rms.values())
    alt = f"Measured and simulated output from {times}, where the error is largest: rms error {falls}."
    where = "".join(f" ({a.name})" for a in part.whole)
    return Picture("worst", f"Where the error is largest{where}", alt, worst(c, units), part.columns, SIZE)


def pictures(material: Material) -> list[Picture]:
    """Return what was found as a picture: the valve, where the record is of one, else where the error is largest."""
    valves = material.diagnosis.steps[0].valves
    if not valves:
        return [picture(material.compared, material.units)]
    valve = worst_valve(valves)
    record, said = valve.record, f"{valve.sentence}."
    columns = {"t": record.t, "OP": record.u, "PV": record.y}
    columns |= {"valve, as estimated": valve.position} if valve.band else {}
    *over_time, loop = loop_panels(valve, material.units)
    return [
        Picture("valve", "The loop over time", f"PV and OP over time: {said}", over_time, columns, SIZE),
        Picture("valve_loop", "PV over OP and over the estimated valve", f"PV over OP: {said}", [loop], columns, SIZE),
    ]


@panel("What was found", order=10, live=10, draws=pictures)
def verdict(material: Material) -> dict[str, Any]:
    """Tell the verdict."""
    d, units = material.diagnosis, material.units
    rows = [] if d.verdict == "nothing_detectable" else d.misfit.table(units)
    rows = [r for r in rows if r["share"] > 0.05]
    named = {p.name: p.label for p in d.misfit.panels}
    return {
        "badge": words.BADGES[d.steps[0].finding], "fall": words.fall(d, units), "bars": bars(d, units),
        "added": added(d, units),
        "sentence": words.without_ids(d.sentence(units)), "next": words.what_next(d), "notes": d.data_notes,
        "worst": {**rows[0], "label": named[rows[0]["panel"]]} if rows else None,
        "steps": [words.without_ids(s.sentence(units)) for s in d.steps[1:]],
    }  # fmt: skip


def bars(d: Diagnosis, units: Units) -> list[tuple[Any, ...]]:
    """Return the errors that matter: class, what, size, share, and the length as a percentage of the longest."""
    rows = words.sizes(d, units)
    classes = [*["b0", "b1"][: len(d.ladder)], "bfloor"]
    longest = max(size for *_, size in rows)
    return [(css, *said, 100 * size / longest) for css, (*said, size) in zip(classes, rows, strict=False)]


def added(d: Diagnosis, units: Units) -> list[str]:
    """Return each effect of the last model with the values that it has there."""
    shapes = shape_units(d, units)
    return [
        f"{words.spaced(e.effect)}: {effect_parameters(d.model, e, units, shapes)}"
        for e in newer(d.model, d.steps[0].base.model)
    ]
