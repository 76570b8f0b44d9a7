"""The first screen of the report, of the app's answer and of the notebook's widget: one JSON, fed to one script.

`told` makes the JSON, `templates/hero.js` shows it; there is no other drawing of a diagnosis on a page with scripts.

- models: a list, one switch each: the base, what was added, and what may be added instead. name, effect ("" for the
  base), errors {"train", "validation"} each {"rms", "nrmse"} of `evaluate`; `run`, its samples where the page cannot
  run it, else `start`, `inputs` (indices of `signals`, null for the time) and `parameters`, the sliders (see
  `sliders`); `skip`, samples at the beginning without an error
- chosen, add: which switch is on at first, and which one "Add" throws (null where nothing is named)
- floor, spread: noise and standard deviation of the output [unit of y]
- n, whole, t0, Ts, signals: samples that are shown and those there are, their times, the signals (see `packed`):
  output first, then the input
- stretch, worst, held, aside: [first, behind the last] of what is looked at first, of where the base is worst, and of
  the validation data; [low, high, role] of what is shaded over time
- rate: samples to either side of a rate of the output: the loop is then input over rate; 0 where it is output over
  input
- axes, units: labels of u, y, the error and the rate; units of u and y
- prefix: what an error is multiplied with, and the unit that it is then told in
- portrait: null or {axes, x, left, at, means, laws, band, high}: the missing force at the samples, by switch; means
  and laws at the centres of cells; half the width of what chance makes of the means; and how far the axis goes
- law: null or what the page needs to run the law (see `reference`)
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data.evidence.rate import working
from ..data.units import headed
from ..diagnosis.bases import spaced, words
from ..diagnosis.misfit import Portrait, portrait_of
from ..diagnosis.refit import Fitted
from ..errors import FitError, ModelError, NotInvertible
from ..fit.bases.integrating import integrates
from ..fit.simulate import centre
from ..inversion.analyses import Subject
from ..inversion.compensator import Compensator
from ..models.added import newer
from ..symbolic.numbers import prefixed
from ..symbolic.signals import r, t, y
from .comparison import Comparison, spans
from .figures import describe
from .parameters import called, parameters, shape_units
from .plots.portrait import chance, height, joined, labels, places
from .words import PARTS, has_floor

if TYPE_CHECKING:
    from .panels.registry import Material

FRAMED = ("verdict", "try_it")  # the parts that move
MOST_MODELS, MOST_SAMPLES, MOST_DOTS = 4, 200_000, 1500
LONGEST_WAY = MOST_MODELS - 2  # models with something added: there is room for one that may be
STEPS = 200  # of a slider to either side of its optimum
REACH = 12.0  # standard errors to either side, at least
LONGEST = 4000  # samples of a reference
PAGE, PICTURE, SCRIPT = (Path(__file__).parent / "templates" / f"{name}.js" for name in ("page", "picture", "hero"))


@dataclass(frozen=True, eq=False)
class Tried:
    """One switch: a model with the free-run errors of `evaluate` (see `Step.figures`), and its recursion as JavaScript.

    `effect` is what it adds; `source` is empty where the page cannot run it.
    """

    name: str
    effect: str
    fitted: Fitted
    errors: dict[str, float]
    source: str


def models(material: Material) -> list[Tried]:
    """Return the base, the model after each step, and what may be added instead: less error on the record than before.

    Where a user adds one effect after the other, each stands beside what is there already.
    """
    d, found, known = material.diagnosis, list[Tried](), set[str]()
    there = "" if material.lacking is d else " ".join(d.rungs[1:])

    def listed() -> Iterator[tuple[str, str, Fitted, dict[str, float]]]:
        yield "base", "", d.steps[0].base, d.ladder[0]
        chosen = [(step.added[0] if step.added else "", step.chosen) for step in d.steps if step.chosen is not None]
        way = [(" ".join(d.rungs[1 : i + 2]), *one, d.ladder[i + 1]) for i, one in enumerate(chosen)]
        yield from way[-LONGEST_WAY:]
        first = material.lacking.steps[0]
        least = d.ladder[-1 if there else 0]["train"]
        pair = [(first.pair.effect, first.pair.fitted)] if first.pair is not None else []
        alone = ((one.effect, fitted_of(one, first.base)) for one in first.candidates)  # fitted when it is their turn
        for effect, offered in chain(pair, alone):
            if offered is not None and (errors := first.figures(offered))["train"] < least:
                yield f"{there} + {effect}".strip(), effect, offered, errors

    for name, effect, fitted, errors in listed():
        if name not in known:  # effects of a pair are offered alone too
            source = ""
            with suppress(ModelError):  # it has a root finder
                source = fitted.model.export("js", f"model{len(found)}")
            found.append(Tried(spaced(name), effect, fitted, errors, source))
            known.add(name)
        if len(found) == MOST_MODELS:
            break
    return found


def fitted_of(candidate: Any, base: Fitted) -> Fitted | None:
    """Return a candidate's model over the record as it is; None where it cannot be fitted there."""
    own, shown = (list(map(len, one.split.records)) for one in (base, candidate.shown))
    try:  # a model of averaged samples, or of a part of a long record, has another record
        found: Fitted = candidate.fitted if candidate.likely or shown != own else candidate.shown
    except FitError:
        return None
    return found


def missing(material: Material) -> Portrait | None:
    """Return what the base lacks against what explains it, with the law of each switch by its name; None if unseen."""
    first = material.diagnosis.steps[0]
    if first.valves:
        return None
    i, factor = first.base.worst, working(first.trial.records)[1]
    after = {one.name: one.fitted.errors[i] for one in material.once(models)[1:]}
    found = portrait_of(first.base.model, first.base.split.records[i], first.base.errors[i], factor, after)
    return found if found.seen() else None


def width_of_rate(material: Material) -> int:
    """Return the samples to either side of a rate for an axis that integrates, 0 where none does."""
    first = material.diagnosis.steps[0]
    model, records = first.base.model, first.base.split.records
    axis = model.recursion.depth > 0 and not model.states and integrates(model, records)
    return max(1, working(first.trial.records)[1] // 2) if axis else 0


def start(fitted: Fitted, i: int) -> dict[str, list[float]]:
    """Return the first samples of each state along segment i, from which the figures of the report start."""
    shifted = fitted.problem.shifted(i, fitted.problem.along(fitted.unknowns, i)[1])
    return {name: np.ravel(values).tolist() for name, values in shifted.items()}


def packed(values: np.ndarray) -> dict[str, Any]:
    """Return samples as the page reads them: base64 of float32 around an offset; a far level costs no digits."""
    offset = centre(values)
    return {"offset": offset, "data": base64.b64encode((values - offset).astype("<f4").tobytes()).decode()}


def unpacked(one: dict[str, Any]) -> np.ndarray:
    """Return the samples that the page computes with, (N,) float64."""
    return np.asarray(one["offset"] + np.frombuffer(base64.b64decode(one["data"]), "<f4").astype(float))


def sliders(material: Material, tried: Tried) -> list[dict[str, Any]]:
    """Return the parameters in the model's order: what they are called, where they are best, and how far they reach."""
    diagnosis, units = material.diagnosis, material.units
    base, model = diagnosis.steps[0].base.model, tried.fitted.model
    rows = {row.name: row for row in parameters(base, model, units, shape_units(diagnosis, units, model))}
    brought = {str(s): (n, e.effect) for e in newer(model, base) for n, s in e.symbols.items()}
    names, found = called(model, units), []
    for symbol, value in zip(model.symbols, map(float, model.theta), strict=True):
        row = rows[str(symbol)]
        short, effect = brought.get(str(symbol), (row.term or str(symbol), ""))
        error = (row.after or (0.0, 0.0))[1]
        error = float(error) if np.isfinite(error) else 0.0
        half = max(abs(value) if effect or not error else 0.0, REACH * error) or 1.0
        low, high = tried.fitted.limits.get(symbol, (-np.inf, np.inf))
        found.append({
            "symbol": str(symbol), "name": names.get(str(symbol), short),
            "effect": words(effect), "unit": row.unit if row.unit != "1" else "", "value": value, "error": error,
            "half": half, "low": _finite(low), "high": _finite(high), "band": min(100.0, 100 * 2 * error / half),
        })  # fmt: skip
    return found


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def reference(law: Compensator, listed: Sequence[Tried], c: Comparison) -> dict[str, Any]:
    """Return what the page needs to run the law: where it starts, a first reference, and how far the input may go."""
    recursion, middle = law.exported(), float(np.mean(c.y))
    begin = law.start(middle, float(np.mean(c.u)))
    period = int(np.clip(c.worst.stop - c.worst.start, 20, LONGEST // 4))
    return {
        "model": next(i for i, one in enumerate(listed) if one.fitted.model is law.model),
        "start": [begin.get(b.name, 0.0) for b in recursion.states], "lead": max(1, recursion.depth),
        "n": 4 * period, "ahead": recursion.lead, "middle": middle, "amplitude": float(np.ptp(c.y)) / 4,
        "period": period, "limits": [float(c.u.min()), float(c.u.max())],
    }  # fmt: skip


def law_of(subject: Subject, listed: Sequence[Tried]) -> Compensator | None:
    """Return the law of the model to take away, where the page can run it from a reference alone."""
    if not any(one.fitted.model is subject.model and one.source for one in listed) or subject.model.input == y:
        return None
    try:
        law = subject.law
    except (ModelError, NotInvertible):
        return None
    return law if law.closed_form and law.exported().inputs == (r,) else None


def told(material: Material) -> dict[str, Any]:
    """Return the JSON; the names are those at the head of this file."""
    d, listed, c, units = material.diagnosis, material.once(models), material.compared, material.units
    base = d.steps[0].base
    i, output, driving = base.worst, base.problem.name, base.model.input.name
    record, n = base.split.records[i], min(base.problem.data[base.worst][output].size, MOST_SAMPLES)
    own = [one for one in listed if one.source]
    names = dict.fromkeys([output, driving])
    for tried in own:
        names |= dict.fromkeys(b.name for b in tried.fitted.model.recursion.inputs if b != t)
    every = {name: one for tried in (listed[0], *own) for name, one in tried.fitted.problem.data[i].items()}
    there = 1 if material.lacking is d else 1 + min(len(d.ladder) - 1, LONGEST_WAY)
    law, width = material.once(law_shown), material.once(width_of_rate)
    axis = {"error": "error", "rate": "rate of the output"}
    known = {driving: units.get(driving, ""), output: units.get(output, "")}
    known |= {"error": known[output], "rate": known[output] and f"{known[output]}/s"}
    return {
        "n": n, "t0": float(record.t[0]), "Ts": float(record.Ts), "steps": STEPS, "whole": len(record),
        "signals": [packed(np.asarray(every[name][:n])) for name in names],
        "models": [_switch(material, one, i, n, list(names)) for one in listed],
        "chosen": there - 1, "add": _first(material, listed, there),
        "spread": float(base.problem.spread), "floor": float(d.floor) if has_floor(d) else 0.0,
        "held": spans((base.split.test[i] & ~base.split.train[i])[:n]),
        "aside": [[a.low, a.high, a.role] for a in c.aside],
        "worst": [min(c.worst.start, n - 1), min(c.worst.stop, n)],
        "stretch": [min(c.periods.start, n - 1), min(c.periods.stop, n)], "rate": width,
        "axes": [headed(axis.get(name, name), known[name]) for name in known],
        "units": [known[driving], known[output]], "prefix": prefixed(known[output], d.ladder[0]["validation_rms"]),
        "portrait": _portrait(material, listed), "law": law and reference(law, listed, c),
    }  # fmt: skip


def law_shown(material: Material) -> Compensator | None:
    """Return the law that the page runs, where it can."""
    return law_of(material.subject, material.once(models))


def _switch(material: Material, one: Tried, i: int, n: int, names: list[str]) -> dict[str, Any]:
    """Return what the page needs of one model."""
    errors = {part: {"rms": one.errors[f"{part}_rms"], "nrmse": one.errors[part]} for part in PARTS}
    shown = {"name": one.name, "effect": one.effect, "errors": errors, "skip": one.fitted.problem.depth}
    if not one.source:
        measured = one.fitted.split.records[i].y
        return {**shown, "run": packed((measured - one.fitted.errors[i])[:n]), "parameters": []}
    first, recursion = start(one.fitted, i), one.fitted.model.recursion
    return {
        **shown, "run": None, "start": [first.get(b.name, 0) for b in recursion.states],
        "inputs": [None if b == t else names.index(b.name) for b in recursion.inputs],
        "parameters": sliders(material, one),
    }  # fmt: skip


def _first(material: Material, listed: Sequence[Tried], there: int) -> int | None:
    """Return which switch "Add" throws: that of the last model, else the first of what may be added."""
    first = material.lacking.steps[0]
    named = first.refused is None and (first.confusion_set or first.chosen is not None)
    last = min(len(material.diagnosis.ladder) - 1, LONGEST_WAY)
    return (last if last >= there else there) if named and len(listed) > there else None


def _portrait(material: Material, listed: Sequence[Tried]) -> dict[str, Any] | None:
    found = material.once(missing)
    if found is None:
        return None
    view, laws = found.view, [np.zeros_like(found.missing), *(found.laws[one.name] for one in listed[1:])]
    seen = [view, *(found.left(one.name) for one in listed[1:])]
    x, left = places(found), [found.missing - law for law in laws]
    some = slice(None, None, -(-x.size // MOST_DOTS))
    return {
        "axes": labels(found, material.units), "high": height(found),
        "x": _listed(x[some]), "left": [_listed((one - one.mean())[some]) for one in left],
        "at": _listed(joined(view, view.mean)[0]), "means": [_listed(joined(view, one.mean)[1]) for one in seen],
        "laws": [_listed(joined(view, found.of(one.name).mean)[1]) for one in listed[1:]],
        "band": [_listed(one) for one in chance(view)],
    }  # fmt: skip


def _listed(x: np.ndarray) -> list[float | None]:
    """Return numbers for JSON, with as many digits as a screen can show; null for a gap."""
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in x]


def script(material: Material) -> str:
    """Return the script of a page: the recursions as JavaScript, the looks, and what shows the JSON."""
    listed, found = material.once(models), material.once(law_shown)
    names = ", ".join(f"model{i}" if one.source else "null" for i, one in enumerate(listed))
    parts = [
        describe.script(), *(one.source for one in listed),
        found.export("js", "law", limits=None) if found else "const law = null;", f"const models = [{names}];",
        *(one.read_text(encoding="utf-8") for one in (PICTURE, SCRIPT)),
    ]  # fmt: skip
    own = "\n".join(parts)
    return f"{PAGE.read_text(encoding='utf-8')}(() => {{\n{own}}})();"


def data(material: Material) -> str:
    """Return the JSON as text that may stand in a page."""
    return json.dumps(material.once(told)).replace("<", "\\u003c")


def keys(material: Material) -> list[tuple[str, str, str]]:
    """Return the words of the pictures, each with its role and the CSS of its key."""
    found = {"measured": "measured", "before": "base"}
    found |= {"after": "with the selected effect"} if material.once(models)[1:] else {}
    found |= {area.role: area.name for area in material.compared.aside}
    return [(word, role, describe.key(role)) for role, word in found.items()]
