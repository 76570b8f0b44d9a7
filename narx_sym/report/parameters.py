"""The parameters of a model before and after, with their units, and which of them moved."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..codegen.units import coefficient_units
from ..diagnosis.procedure import Diagnosis
from ..diagnosis.table.candidates import Candidate
from ..errors import NarxError
from ..fit.continuous import continuous
from ..models.added import AddedEffect, newer, outside
from ..models.continuous_time import Continuous, Quantity
from ..models.extend import form_of
from ..models.model import Model
from ..symbolic.numbers import sized
from ..symbolic.signals import expand_phi
from .words import Row, Units, begun, number, spaced

MOVED = 3.0  # standard errors
LETTERS = {  # what the catalogue calls by a letter alone
    "hysteresis c": "size of the loop", "hysteresis b": "curvature after a reversal", "hysteresis g": "gamma over beta",
    "hysteresis r": "widest play", "hysteresis d": "slope of the centre line", "hysteresis h0": "offset of the "
    "centre line",
    "hysteresis c1": "slope after a reversal", "hysteresis c2": "curvature against the motion",
    "hysteresis c3": "curvature along the motion", "hysteresis a": "pole of the lag",
    "stiction c": "size of the effect", "stiction r": "sliding band",
    "stiction e": "additional breakaway band", "backlash c": "share", "backlash w": "half-width",
    "backlash r": "half-width", "dead_zone r": "half-width", "saturation r": "limit",
    "creep tau": "shortest time constant",
}  # fmt: skip


@dataclass(frozen=True)
class Parameter:
    """One parameter before and after; None where a model does not have it."""

    name: str
    term: str
    unit: str
    before: tuple[float, float] | None
    after: tuple[float, float] | None

    @property
    def status(self) -> str:
        """One of "new", "deleted", "moved", or an empty text."""
        if self.before is None or self.after is None:
            return "new" if self.before is None else "deleted"
        return "moved" if abs(self.after[0] - self.before[0]) > MOVED * self._sure() else ""

    def _sure(self) -> float:
        """Return the standard error of the difference; both fits see the same samples, so the larger one is taken."""
        errors = [p[1] for p in (self.before, self.after) if p is not None and np.isfinite(p[1])]
        return max(errors, default=0.0)


def parameters(before: Model, after: Model, units: Units, shapes: Mapping[str, str]) -> list[Parameter]:
    """Return all parameters of two models, those of the base first.

    Parameters
    ----------
    shapes : mapping from a name to the unit of a shape parameter
    """
    rows = [{_meaning(model, r): r for r in model.table()} for model in (before, after)]
    known = [coefficient_units(model, units, shapes) for model in (before, after)]  # theta_4 may be another one in each
    taken = {r["symbol"] for r in rows[1].values()}
    found = []
    for key in [*rows[0], *(n for n in rows[1] if n not in rows[0])]:
        values = [None if key not in r else (r[key]["theta"], r[key]["standard_error"] or 0.0) for r in rows]
        row, own = next((r[key], of) for r, of in zip(reversed(rows), reversed(known), strict=True) if key in r)
        name = row["symbol"] if key in rows[1] or row["symbol"] not in taken else f"{row['symbol']} of the base"
        found.append(Parameter(name, row["term"], own.get(row["symbol"], ""), *values))
    return found


def _meaning(model: Model, row: Row) -> str:
    """Return what a parameter multiplies, by which it is known again; else its name."""
    term = next((e for _, listed in model.system() for c, e in listed if str(c) == row["symbol"]), None)
    if term is None or not row["symbol"].startswith("theta"):
        return str(row["symbol"])
    return str(outside(model, expand_phi(term)))


def shape_units(diagnosis: Diagnosis, units: Units, model: Model | None = None) -> dict[str, str]:
    """Return the units of the shape parameters of all effects that were added; of another model's where it is given."""
    known = {(c.effect, c.variant.effect.form): c.variant.effect.unit for s in diagnosis.steps for c in s.candidates}
    found = {}
    for one in (model or diagnosis.model).effects:
        form = form_of(one)
        given = form.unit if form is not None else known.get((one.effect, one.form), {})
        for name, symbol in one.shape.items():
            found[str(symbol)] = shape_unit(given.get(name, ""), one, units)
    return found


def shape_unit(said: str, added: AddedEffect, units: Units) -> str:
    """Put the units of u, y and the channel into what the catalogue says about a shape parameter of an effect."""
    channel = added.effect.partition(":")[2]
    said = said.replace("unit of the driver", f"unit of {added.driver}")
    said = said.replace("unit of the channel", f"unit of {channel}")
    for signal in filter(None, ("u", "y", channel)):
        said = said.replace(f"unit of {signal}", units.get(signal) or f"unit of {signal}")
    return "" if said == "1" else said.replace(" / ", "/")


def candidate_parameters(candidate: Candidate, units: Units, letters: bool = False) -> str:
    """Return what a candidate is in physical units; or the parameters by the `letters` of its equation."""
    model, own = candidate.written, candidate.variant.effect
    added = model.effects[-1]
    shapes = {str(s): shape_unit(own.unit.get(n, ""), added, units) for n, s in added.shape.items()}
    return (by_letters if letters else effect_parameters)(model, added, units, shapes)


def added_sizes(diagnosis: Diagnosis, units: Units, known: Continuous | str | None = None) -> list[str]:
    """Return a line with the parameters and units of each effect that was added, kept and not told by `known`."""
    already = {q.effect for q in known.told} if isinstance(known, Continuous) else ()
    model, shapes = diagnosis.model, shape_units(diagnosis, units)
    return [
        f"{begun(spaced(one.effect))}{f' ({one.form})' if one.form else ''}: "
        f"{effect_parameters(model, one, units, shapes)}."
        for one in newer(model, diagnosis.steps[0].base.model)
        if one.effect not in already
    ]


def shape_sizes(diagnosis: Diagnosis, units: Units, told: Collection[str]) -> tuple[list[str], bool]:
    """Return the lengths, times and levels of the added effects but those `told`, and whether some effect has none.

    A shape parameter has the unit of a signal; what a coefficient means depends on the rest of the model.
    """
    model, shapes = diagnosis.model, shape_units(diagnosis, units)
    errors = {str(r["symbol"]): r["standard_error"] or 0.0 for r in model.table()}
    new = [e for e in newer(model, diagnosis.steps[0].base.model) if e.effect not in told]
    lines = []
    for one in new:
        for n, s in one.shape.items():
            word, unit = LETTERS.get(f"{one.effect} {n}", n), shapes.get(str(s), "")
            size = Quantity(f"{word} of the {spaced(one.effect)}", s, s, float(model.values[s]), errors[str(s)], unit)
            lines.append(size.text)
    return lines, not all(one.shape for one in new)


def called(model: Model, units: Units) -> dict[str, str]:
    """Return what the parameters of effects are called, by their symbols: as a physical quantity, else by `LETTERS`."""
    own = {
        str(s): f"{one.effect} {n}"
        for one in model.effects
        for n, s in one.symbols.items()
        if one.form != "play superposition" or n in one.shape  # its coefficients are the weights of plays
    }
    names = {str(s) for s in model.symbols}
    if names >= {"c1", "c2", "c3", "d", "h0"}:  # a base of Bouc and Wen
        own |= {n: f"hysteresis {n}" for n in names}
    found = {symbol: LETTERS[key] for symbol, key in own.items() if key in LETTERS}
    return found | {str(q.expression): q.name for q in of_effects(model, units)}


def of_effects(model: Model, units: Units) -> list[Quantity]:
    """Return what matters of a model's effects in physical units, by its linearisation; nothing where it has none."""
    with suppress(NarxError):
        known = continuous(model, units={name: unit for name, unit in units.items() if unit})
        return [q for q in known.told if q.effect]
    return []


def effect_parameters(model: Model, effect: AddedEffect, units: Units, shapes: Mapping[str, str]) -> str:
    """Return what matters of an effect of a model in physical units; where nothing does, its parameters by letters."""
    if own := [q for q in of_effects(model, units) if q.effect == effect.effect]:
        return ", ".join(f"{q.name} {sized(q.value, q.unit)}" for q in own)
    return by_letters(model, effect, units, shapes)


def by_letters(model: Model, effect: AddedEffect, units: Units, shapes: Mapping[str, str]) -> str:
    """Return the parameters of an effect of a model by their letters, with their units as far as these follow."""
    known = {n: "" if unit == "1" else unit for n, unit in coefficient_units(model, units, shapes).items()}
    names = called(model, units)
    return ", ".join(
        f"{names.get(str(s), '')} {n} = {number(float(model.values[s]), 4)} {known.get(str(s), '')}".strip()
        for n, s in effect.symbols.items()
    )


def moved(rows: Iterable[Parameter]) -> str:
    """Say which base parameters moved."""
    changed = [
        f"{r.name} from {number(r.before[0])} to {number(r.after[0])}"
        for r in rows
        if r.status == "moved" and r.before and r.after
    ]
    gone = ["the constant" if r.term == "1" else r.term or r.name for r in rows if r.status == "deleted"]
    said = f"Moved by more than {MOVED:.0f} standard errors: {', '.join(changed)}. " if changed else ""
    who = "It" if len(changed) == 1 else "They"
    said += f"{who} had compensated for the missing effect. " if changed else ""
    why = "Deleted, because the effect and its orders make them redundant"
    return said + (f"{why}: {', '.join(gone)}." if gone else "")
