"""What was found: the verdict in words, sizes in the user's units, and what to do next."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ...data.evidence.stiction import worst_valve
from ...diagnosis.misfit import Portrait
from ...errors import ModelError, NarxError, NotInvertible
from ...models.continuous_time import Continuous
from ...symbolic.numbers import sized
from ...tasks.compensate import caution, track
from ...tasks.physical import physical
from ...tasks.reference import measured
from .. import hero, words
from ..comparison import Comparison, Units, stretch
from ..parameters import candidate_parameters, of_effects, shape_sizes
from ..picture import Picture
from ..plots.portrait import portrait_panels
from ..plots.valve import loop_panels
from .registry import Material, panel

if TYPE_CHECKING:
    from ...diagnosis.procedure import Diagnosis
    from ...diagnosis.refit import Fitted


SIZE, NARROW = (5.2, 4.2), (4.2, 4.2)  # [inch] of the pictures beside the verdict
SURE = "An effect above its detection limit would have been found in 80 % of such records"
NO_LAW = "no compensation law follows from this model."


def run(c: Comparison, units: Units, width: int) -> Picture:
    """Return some periods of the record where the error is largest, measured, before and after."""
    part = c.at(c.periods)
    times = f"{words.number(part.t[0])} to {words.number(part.t[-1])} s"
    rms = {name: float((e**2).mean() ** 0.5) for name, e in part.errors.items()}
    falls = ", then ".join(sized(e, units.get("y", "")) for e in rms.values())
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
    by = found.view.label.partition(", by ")[2]
    return (
        f"What the base lacks, as an additional input (up to {most} Hz): {found.view.label} explains {share} of it. "
        f"Squares: means{f', for each range of {by}' if by else ''}. Shaded: possible by chance."
    )


def pictures(material: Material) -> list[Picture]:
    """Return what was found for paper: the valve, where the record is of one, else where the error is largest."""
    if material.searching:
        return []
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
    found = material.once(hero.missing)
    seen = {
        "searching": material.searching, "told": material.once(hero.told), "bars": bars(material),
        "explains": explains(found) if found else "", "valves": d.steps[0].valves, "keys": hero.keys(material),
    }  # fmt: skip
    if material.searching:
        return seen
    shown = now if now.last is not None or d.last is None else d  # what may be added, else what was
    known = physical(shown, {name: unit for name, unit in units.items() if unit}, material.settings.get("scale"))
    linear = [] if isinstance(known, str) else [q.text for q in known.told if not q.effect]
    return seen | {
        "badge": SURE if now.steps[0].finding == "nothing_detectable" else words.badge(now),
        "sizes": sizes(shown, units, known), "fall": words.fall(shown, units, whole=False) or left(shown, units),
        "linear": "; ".join(map(interval, linear)), "lamp": lamp(material),
        "next": words.what_next(now), "notes": [*(f.sentence for f in now.faults), *now.data_notes],
        "why": words.without_ids(now.sentence(units)),
        "steps": [words.without_ids(s.sentence(units)) for s in now.steps[1:]],
    }  # fmt: skip


def interval(text: str) -> str:
    """Return a size with its interval in brackets; one that includes zero says that the data do not fix the size."""
    text = re.sub(r", 95 % (-\S+ \.\.\. [^-\s])", r": not fixed by the data, 95 % \1", text)
    return re.sub(r", 95 % (\S+) \.\.\. (\S+)", " (95\u00a0%: \\1 to \\2)", text)


def sizes(d: Diagnosis, units: Units, known: Continuous | str) -> list[str]:
    """Say how large each effect is: of those added, else of those that may be, else what could have been seen."""
    first, unit = d.steps[0], units.get("y", "")
    if first.valves:
        band = "stiction band {} of the span of OP"
        return [
            band.format(words.percent(v.band / v.span)) if v.band else "no stiction band found" for v in first.valves
        ]
    if d.last is not None:
        if isinstance(known, str):  # of a nonlinear base: forces as they stand beside the input
            own = [] if d.model.info.useless else of_effects(d.model, units)
        else:
            own = [q for q in known.told if q.effect]
        shapes, more = shape_sizes(d, units, {q.effect for q in own})
        return [*map(interval, [q.text for q in own] + shapes), *[moved(d, d.last, unit)] * more]
    fitting = [c for c in first.candidates if c.effect in first.confusion_set]
    if fitting or first.finding != "nothing_detectable" or not first.unseen:
        told = [f"{words.spaced(c.effect)}: {candidate_parameters(c, units)}" for c in fitting if first.refused is None]
        return told or ["not known: no effect is confirmed"]
    rms = partial(sized, unit=unit, digits=2, beside=d.ladder[0]["validation_rms"])
    ends = [f"{rms(size)} rms ({words.spaced(n)})" for n, size in first.unseen]
    return [f"smaller than its detection limit: {ends[0]} to {ends[-1]}"]


def moved(d: Diagnosis, last: Fitted, unit: str) -> str:
    """Say how far what was added moves the free run: what there is to say of an effect without a size of its own."""
    pairs = zip(d.steps[0].base.errors, last.errors, strict=True)
    change = np.abs(np.concatenate([before - after for before, after in pairs]))
    rms, most = (sized(x, unit) for x in (np.sqrt(np.mean(change**2)), np.quantile(change, 0.95)))
    return f"Change of the simulated output {rms} rms (95\u00a0% of the samples: below {most})"


def left(d: Diagnosis, units: Units) -> str:
    """Say how large the error is where nothing was added."""
    sizes = [one["validation_rms"] for one in d.ladder]
    return f"{sized(sizes[-1], units.get('y', ''), beside=sizes[0])} rms; nothing was added."


def lamp(material: Material) -> tuple[str, str, str]:
    """Return the colour of the law of the model to take away, whether it may run, and why: stability, range, accuracy.

    A law is no better than its model: where that is in doubt, the colour is no green.
    """
    try:
        said = caution(material.subject.law)
    except (ModelError, NotInvertible):
        return "none", "There is none:", NO_LAW
    errors = [one["validation_rms"] for one in material.diagnosis.ladder]
    off = f"The model is off by {sized(errors[-1], material.units.get('y', ''), beside=errors[0])} rms."
    if said:
        return "warn", "Only with care.", f"{said} {off}"
    adds = material.later is not None and material.once(hero.told)["add"] is not None
    if why := "first add what is missing" if adds else words.doubt(material.lacking):
        return "warn", "Not yet:", f"{why}. {off}"
    if why := strays(material):
        return "warn", "Not yet:", f"{why}. {off}"
    loop = ", beside a position controller (the machine integrates)" if material.once(hero.width_of_rate) else ""
    return "good", "Yes,", f"within the range of the data{loop}: the law is stable there. {off}"


def strays(material: Material) -> str:
    """Say why a law is not to be relied on where it is tried: along the measured output, in the range of the input."""
    base = material.diagnosis.steps[0].base
    record = base.split.records[base.worst]
    try:
        run = track(material.subject.law, measured(record), (float(record.u.min()), float(record.u.max())))
    except NarxError:
        return "the law cannot be tried along the measured output"
    (own, _), (plain, _) = run.errors.values()
    return "" if own <= plain else "on the model the law follows the measured output worse than a constant gain"


def bars(material: Material) -> list[dict[str, Any]]:
    """Return the errors of each switch on the record and on validation data, and the noise floor.

    Each is a size, a share of the output's standard deviation, a length in percent, of the longest but of no more than
    twice that of the base, and whether it is cut there.
    """
    d = material.diagnosis
    rows = [
        (one["name"], "after" if i else "before", [(words.PARTS[n], *e.values()) for n, e in one["errors"].items()])
        for i, one in enumerate(material.once(hero.told)["models"])
    ]
    spread = d.steps[0].base.problem.spread
    rows += [(name.lower(), "floor", [("", size * spread, size)]) for name, size in words.floor(d).items()]
    most = min(max(s for *_, parts in rows for *_, s in parts), 2 * max(s for *_, s in rows[0][2]))
    factor, unit = material.once(hero.told)["prefix"]
    return [
        {"name": name, "css": css, "parts": [
            (part, f"{words.number(factor * rms)} {unit}", words.percent(s), 100 * min(1, s / most), s > most)
            for part, rms, s in parts
        ]}
        for name, css, parts in rows
    ]  # fmt: skip
