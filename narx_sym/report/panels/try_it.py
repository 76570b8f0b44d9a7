"""The models moved by hand: the page itself runs them over the record, with the parameters that its sliders say."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...data.units import headed
from ...diagnosis.bases import joined, words
from ...diagnosis.procedure import Diagnosis
from ...diagnosis.refit import Fitted
from ...errors import FitError, ModelError, NotInvertible
from ...fit.simulate import centre
from ...inversion.analyses import Subject
from ...inversion.compensator import Compensator
from ...models.added import newer
from ...symbolic.signals import r, t, y
from ..comparison import Comparison, Units, errors, spans
from ..figures import describe
from ..parameters import parameters, shape_units
from ..words import has_floor
from .registry import WAY, Material, panel

MOST_MODELS, MOST_SAMPLES = 5, 200_000
STEPS = 200  # of a slider to either side of its optimum
REACH = 12.0  # standard errors to either side, at least
LONGEST = 4000  # samples of a reference
PICTURE, SCRIPT = (Path(__file__).parent.parent / "templates" / name for name in ("picture.js", "try_it.js"))


@dataclass(frozen=True, eq=False)
class Tried:
    """One model of the switch."""

    name: str
    fitted: Fitted
    source: str  # its recursion as JavaScript


def models(diagnosis: Diagnosis) -> list[Tried]:
    """Return the base, the model after each step, and the other candidates, as far as the page can run them."""

    def listed() -> Iterator[tuple[str, Fitted]]:
        yield "Before", diagnosis.steps[0].base
        known: list[str] = []
        for step in diagnosis.steps:
            if step.chosen is not None:
                known = [n for n in known if n not in step.withdrawn] + step.added
                yield f"With {joined(map(words, known))}", step.chosen
        first = diagnosis.steps[0].added
        for candidate in diagnosis.candidates:
            if candidate.effect not in first:
                fitted = fitted_of(candidate)
                if fitted is not None:
                    yield f"With {words(candidate.effect)}", fitted

    found: list[Tried] = []
    for name, fitted in listed():
        with suppress(ModelError):  # it has a root finder
            found.append(Tried(name, fitted, fitted.model.export("js", f"model{len(found)}")))
        if len(found) == MOST_MODELS:
            break
    return found


def fitted_of(candidate: Any) -> Fitted | None:
    """Return a candidate's model over the record as it is; None where it cannot be fitted there."""
    try:  # a model of averaged samples has another record
        found: Fitted = candidate.fitted if candidate.likely or candidate.averaged > 1 else candidate.shown
    except FitError:
        return None
    return found


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


def sliders(diagnosis: Diagnosis, tried: Tried, units: Units) -> list[dict[str, Any]]:
    """Return the parameters in the model's order: what they are called, where they are best, and how far they reach."""
    base, model = diagnosis.steps[0].base.model, tried.fitted.model
    rows = {r.name: r for r in parameters(base, model, units, shape_units(diagnosis, units, model))}
    brought = {str(s): (short, e.effect) for e in newer(model, base) for short, s in e.symbols.items()}
    found = []
    for symbol, value in zip(model.symbols, map(float, model.theta), strict=True):
        row = rows[str(symbol)]
        short, effect = brought.get(str(symbol), (row.term or str(symbol), ""))
        error = (row.after or (0.0, 0.0))[1]
        error = float(error) if np.isfinite(error) else 0.0
        half = max(abs(value) if effect or not error else 0.0, REACH * error) or 1.0
        low, high = tried.fitted.limits.get(symbol, (-np.inf, np.inf))
        found.append({
            "symbol": str(symbol), "name": short, "effect": words(effect) if effect else "",
            "unit": row.unit if row.unit != "1" else "", "value": value, "error": error, "half": half,
            "low": _finite(low), "high": _finite(high), "band": min(100.0, 100 * 2 * error / half),
        })  # fmt: skip
    return found


def _finite(limit: float) -> float | None:
    return float(limit) if np.isfinite(limit) else None


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
    if not any(one.fitted.model is subject.model for one in listed) or subject.model.input == y:
        return None
    try:
        law = subject.law
    except (ModelError, NotInvertible):
        return None
    return law if law.closed_form and law.exported().inputs == (r,) else None


def content(diagnosis: Diagnosis, listed: Sequence[Tried], c: Comparison, units: Units) -> dict[str, Any]:
    """Return what the page's script reads."""
    base = listed[0].fitted
    i = diagnosis.steps[0].base.worst
    output, driving = base.problem.name, base.model.input.name
    record, data = base.split.records[i], base.problem.data[i]
    n = min(data[output].size, MOST_SAMPLES)
    names = dict.fromkeys([output, driving])
    for tried in listed:
        names |= dict.fromkeys(b.name for b in tried.fitted.model.recursion.inputs if b != t)
    every = {name: one for tried in listed for name, one in tried.fitted.problem.data[i].items()}
    told = []
    for tried in listed:
        first, recursion = start(tried.fitted, i), tried.fitted.model.recursion
        told.append({
            "start": [first.get(b.name, 0) for b in recursion.states], "skip": tried.fitted.problem.depth,
            "inputs": [None if b == t else list(names).index(b.name) for b in recursion.inputs],
            "parameters": sliders(diagnosis, tried, units),
        })  # fmt: skip
    return {
        "n": n, "t0": float(record.t[0]), "Ts": float(record.Ts), "steps": STEPS,
        "signals": [packed(np.asarray(every[name][:n])) for name in names], "models": told,
        "spread": float(diagnosis.steps[0].base.problem.spread),
        "floor": float(diagnosis.floor) if has_floor(diagnosis) else 0.0,
        "held": spans((base.split.test[i] & ~base.split.train[i])[:n]),
        "aside": [[a.low, a.high, a.role] for a in c.aside],
        "worst": [min(c.worst.start, n - 1), min(c.worst.stop, n)],
        "axes": [_axis(driving, units), _axis(output, units), _axis("error", {"error": units.get(output, "")})],
        "units": [units.get(driving, ""), units.get(output, "")], "whole": len(record),
    }  # fmt: skip


def _axis(name: str, units: Units) -> str:
    return headed(name, units.get(name))


@panel("Try it", order=15, about=WAY)
def try_it(material: Material) -> dict[str, Any] | None:
    """Tell the models with their sliders; nothing where no script may run, or no model can be run by one."""
    from markupsafe import Markup

    d = material.diagnosis
    listed = models(d) if material.scripts else []
    if not listed or listed[0].name != "Before":
        return None
    told, law = content(d, listed, material.compared, material.units), law_of(material.subject, listed)
    told["law"] = law and reference(law, listed, material.compared)
    sources = "\n".join(
        [
            describe.script(),
            *(one.source for one in listed),
            law.export("js", "law", limits=None) if law else "const law = null;",
        ]
    )
    marks = errors(material.compared, material.units).marks
    legend = {"measured": "measured"} | {mark.role: mark.name for mark in marks}
    legend |= dict.fromkeys(("before", "after"), "free run")
    names = ", ".join(f"model{i}" for i in range(len(listed)))
    script = "\n".join(
        [sources, f"const models = [{names}];", *(one.read_text(encoding="utf-8") for one in (PICTURE, SCRIPT))]
    )
    return {
        "told": told, "models": listed, "keys": [(word, role, describe.key(role)) for role, word in legend.items()],
        "chosen": next((i for i, one in enumerate(listed) if one.fitted.model is d.model), 0),
        "data": Markup(json.dumps(told).replace("<", "\\u003c")),
        "script": Markup(f"(() => {{\n{script}}})();"),
    }  # fmt: skip
