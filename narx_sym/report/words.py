"""The words of a diagnosis: verdict, what to do next, sizes, numbers with few digits."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..data.coverage import one_sine
from ..data.evidence.stiction import worst_valve
from ..diagnosis.bases import BASE, joined, spaced
from ..diagnosis.experiment import Experiment
from ..diagnosis.procedure import UNNAMED, Diagnosis
from ..diagnosis.steps import NO_FLOOR, Step
from ..models.added import newer
from ..symbolic.numbers import number, sized

Units = Mapping[str, str]
Row = dict[str, Any]
DIGITS = 4  # of the numbers in equations
NEXT = {
    "nothing_detectable": "Keep the model. To detect smaller effects, record with less noise, for longer, or with a "
    "wider input: the detection limits below say how small.",
    "named": "Use the model with {best}, and confirm it on a record of another day.",
    "one_sine": "Record a second frequency or amplitude, and diagnose both records together: with a single sine, "
    "effects of speed and effects with memory draw similar loops.",
    "confused": "Run the proposed experiment, and diagnose both records together.",
    "helps_but_incomplete": "Add {best} as a first step, look at where the model fails, and diagnose again with more "
    "effects.",
    "closed_loop": "Record again with the controller in manual mode, with steps or a slow triangle as input; a test "
    "signal added to the controller's output helps too.",
    "outside_library": "Look at where the model fails, and at the equivalent missing input there. You can add an "
    "effect of your own as one equation.",
}


BADGES = {  # by `Step.finding`: what the headline says, in a few words
    "nothing_detectable": "nothing found",
    "follows_nothing": "the base model does not follow",
    "one_step": "a single step is not enough",
    "trace": "a small unexplained error",
    "unexplained": "more error than noise",
    "two_effects": "best explanation",
    "refused": "not confirmed by validation data",
    "valve": "checked as a valve",
    "perhaps_closed_loop": "perhaps in closed loop",
    "probably_closed_loop": "probably in closed loop",
    "named": "one explanation fits",
    "confused": "several explanations fit",
    "helps_but_incomplete": "helps, but is not all",
    "outside_library": "more is missing than the catalogue explains",
    "closed_loop": "taken in closed loop",
}
PROBABLE = ("named", "confused", "two_effects", "helps_but_incomplete")  # findings with a probability
PARTS = {"train": "record", "validation": "validation"}  # data, as a ladder has them
NAMED = 5  # columns in a sentence
AT_FLOOR = 1.1  # times the noise floor: an error up to here is called at the floor


def badge(diagnosis: Diagnosis) -> str:
    """Return the headline in a few words, and how sure it is where effects are named."""
    first = diagnosis.steps[0]
    sure = f"{first.how_sure}: " if first.finding in PROBABLE and first.how_sure else ""
    said = [sure + BADGES[first.finding]]
    if (pair := first.pair) is not None and first.finding == "two_effects":
        if pair.rivals:
            said = [f"{sure}the most probable; also possible: {without_ids(pair.others)}"]
        said += ["something else is missing too"] * incomplete(diagnosis)
    if first.finding == "valve" and (valve := worst_valve(first.valves)).band:
        said += [f"which explains {percent(1 - valve.left)} of the squared error"]
    if first.finding == "helps_but_incomplete":
        said += ["uncertain because the input is a single sine"] * _one_sine(first)
    return "; ".join(filter(None, said))


def incomplete(diagnosis: Diagnosis) -> bool:
    """Whether more is missing than what was found."""
    first = diagnosis.steps[0]
    missing = ("helps_but_incomplete", "outside_library", "unexplained", "follows_nothing", "refused")
    return first.finding in missing or (first.pair is not None and not first.pair.all)


def doubt(diagnosis: Diagnosis) -> str:
    """Say why the model is not to be relied on yet; an empty text where nothing speaks against it."""
    first = diagnosis.steps[0]
    if incomplete(diagnosis):
        return "something is still missing from its model"
    if first.verdict == "closed_loop":
        return "its model is from a record in closed loop"
    if first.verdict == "confused" or (first.pair is not None and first.pair.rivals):
        return "these data do not decide what its model needs"
    return "its model is from a single sine" if _one_sine(first) else ""


def _one_sine(step: Step) -> bool:
    return all(one_sine(r.u, r.Ts) for r in step.base.split.records)


def begun(text: str) -> str:
    """Return a text as the beginning of a sentence."""
    return text[:1].upper() + text[1:]


def without_ids(text: str) -> str:
    """Return a sentence with the ids of effects as words."""
    return re.sub(r"\b[a-z]+(_[a-z]+)+\b", lambda found: spaced(found[0]), text)


def plus_minus(value: tuple[float, float]) -> str:
    """Return the standard error of a value; a parameter that the data do not fix has none."""
    return f" ± {number(value[1], 2)}" if np.isfinite(value[1]) else " (not fixed by the data)"


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{number(100 * share, 2)} %" if abs(share) < 0.1 else f"{100 * share:.0f} %"


def removed(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return the share of the removable error that a candidate removes, and its 95 % interval."""
    low, high = (100 * min(max(row[end], 0.0), 1.0) for end in ("low", "high"))  # a share is no more than all
    return f"{100 * row['share']:.0f} %", f"{low:.0f} to {high:.0f} %"


# -- the verdict -----------------------------------------------------------------------------------------------


def with_units(diagnosis: Diagnosis, units: Units) -> Diagnosis:
    """Return the diagnosis with units in the sentence of its experiment."""
    steps = [replace(s, experiment=s.experiment and _with_units(s.experiment, units)) for s in diagnosis.steps]
    return replace(diagnosis, steps=steps)


def _with_units(e: Experiment, units: Units) -> Experiment:
    """Put the unit of u behind the numbers in the name of an experiment that was proposed without units."""
    name, unit = e.name, units.get("u")
    if unit:
        bare = rf"((?:amplitude|steps of|rest at) -?\d[\d.e+-]*)(?![\d.e+-]| {re.escape(unit)})"
        name = re.sub(bare, lambda found: f"{found[1]} {unit}", name).replace(" per s", f" {unit}/s")
    return replace(e, name=name, units=dict(units))


def headline(diagnosis: Diagnosis) -> str:  # noqa: C901, PLR0911, PLR0912
    """Say in a few words what was found."""
    first = diagnosis.steps[0]
    if first.verdict == "nothing_detectable":
        if first.follows_nothing:
            return "The base model does not follow the output, so it cannot show which effect is missing."
        if first.one_step:
            return "No effect can be named from a single step of the input."
        if first.unexplained:
            return (
                "The remaining error is larger than the sensor noise, but no effect of the catalogue explains "
                "enough of it."
            )
        if first.trace:
            return "A small part of the error is unexplained, but too small in these data to name an effect."
        return "No missing effect can be detected in these data."
    if first.verdict == "outside_library":
        return "An effect is missing that is not in the catalogue."
    if first.verdict == "closed_loop":
        if first.valves:
            valve = worst_valve(first.valves)
            none = "This record was taken in closed loop: no effect is named, and no valve is found to stick."
            return f"{begun(valve.verdict)}." if valve.found or valve.perhaps else none
        if first.loop is not None and first.loop.unseen:
            return "Perhaps this record was taken in closed loop: no effect is named."
        known = first.loop is not None and first.loop.given
        return f"This record was {'' if known else 'probably '}taken in closed loop: no effect is named."
    if first.refused is not None:
        moved = [e.effect for e in newer(first.refused.model, first.base.model)]
        record, validation = (verb for verb, _ in first.moves(first.refused, {}))
        return begun(
            f"with {joined(map(spaced, moved))} the error {record} on the record and {validation} on validation "
            "data, so nothing is added."
        )
    sine = "; a single sine cannot distinguish similar effects" if _one_sine(first) else ""
    if first.pair is not None:
        names = list(map(spaced, first.told(*first.pair.effects)))
        sure = "may be" if first.pair.rivals else "are probably"
        missing = f"{first.pair.counted} {sure} missing" if len(names) > 1 else "Probably missing"
        return f"{missing}: {joined(names)}{sine}."
    names = list(map(spaced, first.told(*first.confusion_set)))
    if first.verdict == "helps_but_incomplete":
        listed = [n for n in names if n != BASE] or [spaced(first.told(first.candidates[0].effect)[0])]
        return begun(f"{' or '.join(listed)} helps, but something else is missing too.")
    if BASE in names:
        found = f"{' or '.join(n for n in names if n != BASE)} may be missing; a record at one speed cannot decide."
        return begun(found)
    if first.verdict == "confused":
        return begun(f"{', '.join(names[:-1])} or {names[-1]} is probably missing; these data cannot decide which.")
    return f"{begun(names[0])} is probably missing{sine}."


def headline_with(added: Diagnosis, now: Diagnosis) -> str:
    """Say what was found, where a user adds one effect after the other also what is there already."""
    said, names = headline(now), [spaced(name.removeprefix("+ ")) for name in added.rungs[1:]]
    if now is added or not names:
        return said
    return f"{begun(joined(names))} added. {said.replace('No missing effect', 'No further effect')}"


def has_floor(diagnosis: Diagnosis) -> bool:
    """Whether the noise floor is known: in closed loop it is not estimated."""
    return diagnosis.steps[0].floor_kind != NO_FLOOR


def what_next(diagnosis: Diagnosis) -> str:
    """Say what to do next, after the last step; where something is left, also which signals took no part."""
    aside = diagnosis.aside
    if diagnosis.steps[0].finding in ("named", "nothing_detectable") or not aside:
        return _next(diagnosis)
    listed = ", ".join(aside[:NAMED]) + (f" and {len(aside) - NAMED} more" if len(aside) > NAMED else "")
    return (
        f"{_next(diagnosis)} Columns that were not used: {listed}. If a column acts on the machine, use it as a "
        "channel: "
        f"--channels {aside[0]}."
    )


def _next(diagnosis: Diagnosis) -> str:  # noqa: PLR0911
    last = next((s for s in reversed(diagnosis.steps) if s.chosen is not None), diagnosis.steps[0])
    chosen = diagnosis.steps[0] if diagnosis.steps[0].verdict == "confused" else last
    faults = {f.effect: f for f in diagnosis.faults}
    if frozen := faults.get("frozen_sensor"):
        rows = "{}:{}".format(*frozen.rows)
        return (
            f"Delete the output values in the rows {rows} of '{frozen.record}', where they stay constant, and diagnose "
            "again with --missing drop."
        )
    if "spikes" in faults:
        return "Delete the values of the outliers, and diagnose again with --missing drop."
    if chosen.follows_nothing:
        return (
            "Choose another base model, or record with an input that moves the output: this model is no better than "
            "a constant."
        )
    if chosen.one_step:
        return "Record steps of several sizes, up and down."
    if diagnosis.one_speed and chosen.verdict in UNNAMED:
        return (
            "Record at a second speed or stroke: at one speed a linear base model can imitate friction, slack or "
            "hysteresis."
        )
    if chosen.verdict == "nothing_detectable" and chosen.unexplained:
        return (
            "Look at where the model fails, and search for a disturbance of the machine or a signal that was not "
            "recorded: the remaining error is not sensor noise, and no effect of the catalogue explains it."
        )
    if chosen.trace:
        return "Keep the model for now. A longer record, less noise or a wider input would show what it is."
    if any(v.found or v.perhaps for v in chosen.valves):
        return (
            "Put the controller in manual mode and move its output up and down in small steps: the stiction band is "
            "how far it moves before PV follows."
        )
    if chosen.refused is not None:
        return "Record more, over the range of both records, and diagnose all records together."
    if chosen.verdict == "confused" and not (chosen.experiment and chosen.experiment.clear):
        return (
            "Record with a wider range or faster moves, and diagnose both records together: no tested input "
            "within this range decides."
        )
    verdict = chosen.verdict
    if verdict == "helps_but_incomplete" and diagnosis.exhausted:
        verdict = "outside_library" if diagnosis.steps[-1].verdict == "outside_library" else "named"
    verdict = "one_sine" if verdict == "named" and _one_sine(chosen) else verdict
    return NEXT[verdict].format(best=_added(diagnosis) if "{best}" in NEXT[verdict] else "")


def _added(diagnosis: Diagnosis) -> str:
    """Return what was added; before anything is, what is to be."""
    rungs = diagnosis.rungs[1:] or [diagnosis.best.effect]
    return joined(spaced(rung.removeprefix("+ ")) for rung in rungs)


def floor(diagnosis: Diagnosis) -> dict[str, float]:
    """Return the noise floor over the output's standard deviation by its name, nothing where it is not known.

    Where more is left than the sensor's noise and no effect explains it, the noise of the sensor is said.
    """
    first = diagnosis.steps[0]
    if not has_floor(diagnosis):
        return {}
    left = first.verdict == "nothing_detectable" and first.unexplained
    named = {"Sensor noise": first.sensor} if left else {"Noise floor": diagnosis.floor}
    return {what: size / first.base.problem.spread for what, size in named.items()}


def fall(diagnosis: Diagnosis, units: Units, whole: bool = True) -> str:
    """Say how far the error falls with what was added, or why nothing was; an empty text where nothing was found.

    Each number is one of `evaluate`; the validation data stand first, then the `whole` record.
    """
    first, last = diagnosis.steps[0], diagnosis.last
    if first.refused is not None:
        return without_ids(first.refusal(units))
    if last is None:
        return ""
    (one, before), (two, after) = first.moves(last, units)
    before_all, after_all = (diagnosis.ladder[i]["validation_rms"] for i in (0, -1))
    floor = sized(diagnosis.floor, units.get("y", ""), beside=before_all)
    floor = f", at the noise floor of {floor}" if _at_floor(diagnosis) else ""
    share = abs(1 - after_all / before_all)
    size = f" ({percent(share)} {'less' if two == 'falls' else 'more'})"
    rest = f"; on the whole record it {one} {before}" if whole else ""
    return f"The error on {diagnosis.validation} {two} {after}{size}{floor}{rest}."


def _at_floor(diagnosis: Diagnosis) -> bool:
    """Whether what was added leaves only noise."""
    left = max(diagnosis.ladder[-1]["train_rms"], diagnosis.ladder[-1]["validation_rms"])
    return diagnosis.steps[0].verdict != "helps_but_incomplete" and left <= AT_FLOOR * diagnosis.floor


def detectable(step: Step, units: Units) -> list[Row]:
    """Return the rows of what could not have been seen, smallest first.

    What was found is none of them, and beyond the whole output no size is said.
    """
    spread, beside = step.base.problem.spread, step.errors(step.base)["validation"].free_run_rms
    said = [
        (n, sized(s, units.get("y", ""), 2, beside), percent(s / spread)) if s < spread else (n, "", "> 100 %")
        for n, s in step.unseen
    ]
    return [{"effect": spaced(n), "size": size, "share": share} for n, size, share in said]
