"""What was found: the verdict in words, sizes in the user's units, and what to do next."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ...data.evidence.stiction import worst_valve
from ...diagnosis.misfit import Portrait
from ...errors import ModelError, NotInvertible
from ...models.added import newer
from ...models.continuous_time import Continuous
from ...tasks.compensate import caution
from ...tasks.physical import physical
from .. import hero, words
from ..comparison import Comparison, Units, stretch
from ..parameters import effect_parameters, shape_units
from ..picture import Picture
from ..plots.portrait import portrait_panels
from ..plots.valve import loop_panels
from .registry import Material, panel

if TYPE_CHECKING:
    from ...diagnosis.procedure import Diagnosis


SIZE, NARROW = (5.2, 4.2), (4.2, 4.2)  # [inch] of the pictures beside the verdict
NO_LAW = "No compensation law follows from this model."
GOOD, BAD = "The law is stable over the range of the data.", "Take care with the law: "


def run(c: Comparison, units: Units, width: int) -> Picture:
    """Return some periods of the record where the error is largest, measured, before and after."""
    part = c.at(c.periods)
    times = f"{words.number(part.t[0])} to {words.number(part.t[-1])} s"
    rms = {name: float((e**2).mean() ** 0.5) for name, e in part.errors.items()}
    falls = ", then ".join(f"{words.number(e)} {units.get('y', '')}".rstrip() for e in rms.values())
    alt = f"Measured and simulated output from {times}, where the error is largest: rms error {falls}."
    where = "".join(f" ({a.name})" for a in part.whole)
    title = f"{'Input over rate of the output' if width else 'Loop'}, {times}{where}"
    return Picture("stretch", title, alt, [stretch(c, units, width)], part.columns, NARROW)


def portrait(found: Portrait, units: Units) -> Picture:
    """Return what is missing against what explains it, and below it what is left once the last of `laws` was added."""
    name = found.view.label
    alt = f"Missing input against {name}, which explains {words.percent(found.view.share)} of its variance"
    alt += "".join(f"; with {n} {words.percent(found.left(n).share)} of the rest" for n in list(found.laws)[-1:])
    columns = {"from": found.view.low, "to": found.view.high, "mean": found.view.mean, "band": found.view.error}
    columns |= {f"law of {n}": found.of(n).mean for n in found.laws}
    return Picture("portrait", explains(found), f"{alt}.", portrait_panels(found, units), columns, SIZE)


def explains(found: Portrait) -> str:
    """Say what explains what is missing."""
    share, most = words.percent(found.view.share), words.number(found.bandwidth, 2)
    return f"Missing input: {found.view.label} explains {share}, up to {most} Hz. Shaded: possible by chance."


def pictures(material: Material) -> list[Picture]:
    """Return what was found for paper: the valve, where the record is of one, else where the error is largest."""
    valves = material.diagnosis.steps[0].valves
    if not valves:
        found, last = material.once(hero.missing), material.diagnosis.rungs
        drawn = [run(material.compared, material.units, material.once(hero.width_of_rate))]
        if found is None:
            return drawn
        name = words.spaced(" ".join(last[1:]))
        laws = {n.removeprefix("+ "): law for n, law in found.laws.items() if n == name}
        return [*drawn, portrait(replace(found, laws=laws), material.units)]
    valve = worst_valve(valves)
    record, said = valve.record, f"{valve.sentence}."
    columns = {"t": record.t, "OP": record.u, "PV": record.y}
    columns |= {"valve, as estimated": valve.position} if valve.band else {}
    *over_time, loop = loop_panels(valve, material.units)
    return [
        Picture("valve", "The loop over time", f"PV and OP over time: {said}", over_time, columns, SIZE),
        Picture("valve_loop", "PV over OP and over the estimated valve", f"PV over OP: {said}", [loop], columns, SIZE),
    ]


@panel("What was found", order=10, draws=pictures)
def verdict(material: Material) -> dict[str, Any]:
    """Tell the first screen: the same numbers as `hero.told` gives the page's script."""
    d, now, units = material.diagnosis, material.lacking, material.units
    known = physical(d, {name: unit for name, unit in units.items() if unit}, material.settings.get("scale"))
    found = material.once(hero.missing)
    return {
        "badge": words.badge(now), "fall": words.fall(d, units), "bars": bars(material),
        "physical": told(known, True), "linear": told(known, False), "added": added(d, units), "lamp": lamp(material),
        "next": words.what_next(now), "notes": [*(f.sentence for f in now.faults), *now.data_notes],
        "why": words.without_ids(now.sentence(units)), "told": material.once(hero.told),
        "explains": explains(found) if found else "", "valves": d.steps[0].valves,
        "steps": [words.without_ids(s.sentence(units)) for s in now.steps[1:]], "keys": hero.keys(material),
    }  # fmt: skip


def told(known: Continuous | str, effects: bool) -> str:
    """Return the quantities of the effects, or of the linear part, in physical units; "" where there are none."""
    if isinstance(known, str):
        return ""
    return "; ".join(q.text for q in known.quantities if str(q.symbol) in known.main and bool(q.effect) == effects)


def lamp(material: Material) -> tuple[str, str]:
    """Return the colour of the law of the model to take away, and what it says of stability and range."""
    try:
        said = caution(material.subject.law)
    except (ModelError, NotInvertible):
        return "none", NO_LAW
    return ("warn", BAD + said) if said else ("good", GOOD)


def bars(material: Material) -> list[dict[str, Any]]:
    """Return the errors of each switch on the record and on validation data, and the noise floor.

    Each is a size, a share of the output's standard deviation, and a length as a percentage of the longest.
    """
    d, unit = material.diagnosis, material.units.get("y") or "(unit of y)"
    rows = [
        (one["name"], "after" if i else "before", [(words.PARTS[n], *e.values()) for n, e in one["errors"].items()])
        for i, one in enumerate(material.once(hero.told)["models"])
    ]
    spread = d.steps[0].base.problem.spread
    rows += [(name.lower(), "floor", [("", size * spread, size)]) for name, size in words.floor(d).items()]
    longest = max(size for *_, parts in rows for *_, size in parts)
    return [
        {"name": name, "css": css,
         "parts": [(p, f"{words.number(rms)} {unit}", words.percent(s), 100 * s / longest) for p, rms, s in parts]}
        for name, css, parts in rows
    ]  # fmt: skip


def added(d: Diagnosis, units: Units) -> list[str]:
    """Return each effect of the last model with the values that it has there."""
    shapes = shape_units(d, units)
    return [
        f"{words.spaced(e.effect)}: {effect_parameters(d.model, e, units, shapes)}"
        for e in newer(d.model, d.steps[0].base.model)
    ]
