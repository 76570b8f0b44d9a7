"""The words and tables of a diagnosis: verdict, what to do next, parameters with units, what moved, provenance."""

from __future__ import annotations

import hashlib
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from ..data.record import Record
from ..diagnosis.bases import BASE
from ..diagnosis.candidates import Candidate
from ..diagnosis.experiment import Experiment
from ..diagnosis.procedure import Diagnosis, Step
from ..models.model import Model
from ..symbolic.signals import expand_phi, phi1, phi2, samples, u, v, x, y

Units = Mapping[str, str]
Row = dict[str, Any]
MOVED = 3.0  # standard errors
PACKAGES = ("narx-sym", "numpy", "scipy", "sympy", "matplotlib", "bokeh")
NEXT = {
    "nothing_detectable": "Keep the model. Smaller effects show with less noise, a longer record or a wider input: "
    "the sizes below say how small.",
    "named": "Take the model with {best}, and compare it with a record that was not used here.",
    "confused": "Run the experiment at the end of this page, and diagnose both records together.",
    "helps_but_incomplete": "Take {best} as a first step, look at where the model fails, and diagnose again with more "
    "effects (--max-effects).",
    "outside_library": "Look at where the model fails, and at the equivalent missing input there. An effect of "
    "your own is one equation (--effects).",
}


def plain(name: str) -> str:
    """Return the id of an effect as words."""
    return name.replace("_", " ")


def number(value: float, digits: int = 3) -> str:
    """Return a number with a few significant digits, without an exponent where it is of usual size."""
    if value == 0 or not np.isfinite(value):
        return "0" if value == 0 else "-"
    if 1e-3 <= abs(value) < 1e5:
        rounded = float(f"{value:.{digits - 1}e}")
        return f"{value:.{max(0, digits - 1 - int(np.floor(np.log10(abs(rounded)))))}f}"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def plus_minus(value: tuple[float, float]) -> str:
    """Return the standard error of a value; a parameter that the data do not fix has none."""
    return f" ± {number(value[1], 2)}" if np.isfinite(value[1]) else " (not fixed by the data)"


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{number(100 * share, 2)} %" if abs(share) < 0.1 else f"{100 * share:.0f} %"


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


def headline(diagnosis: Diagnosis) -> str:
    """Say in a few words what was found."""
    first = diagnosis.steps[0]
    names = [plain(e) for e in first.confusion_set]
    if first.verdict == "nothing_detectable":
        return "Nothing is missing that these data can show."
    if first.verdict == "outside_library":
        return "Something is missing that the catalogue does not know."
    if first.pair is not None:
        return f"Two effects are probably missing: {' and '.join(map(plain, first.pair.effects))}."
    if first.verdict == "helps_but_incomplete":
        return f"{plain(first.candidates[0].effect).capitalize()} helps, but something else is missing too."
    if BASE in names:
        found = f"{' or '.join(n for n in names if n != BASE)} may be missing: one speed cannot tell."
        return found[0].upper() + found[1:]
    if first.verdict == "confused":
        return f"{', '.join(names[:-1])} or {names[-1]} is missing; these data cannot tell which.".capitalize()
    return f"{names[0].capitalize()} is probably missing."


def what_next(diagnosis: Diagnosis) -> str:
    """Say what to do next, after the last step."""
    last = next((s for s in reversed(diagnosis.steps) if s.chosen is not None), diagnosis.steps[0])
    best = " and ".join(plain(rung.removeprefix("+ ")) for rung in diagnosis.rungs[1:])
    chosen = diagnosis.steps[0] if diagnosis.steps[0].verdict == "confused" else last
    return NEXT[chosen.verdict].format(best=best)


def sizes(diagnosis: Diagnosis, units: Units) -> list[tuple[str, str, str]]:
    """Return the figures that matter: what, in the unit of y, and relative to the output's standard deviation."""
    first = diagnosis.steps[0]
    spread, unit = first.base.problem.spread, units.get("y") or "(unit of y)"
    rungs = diagnosis.ladder
    found = [("Error of the base", rungs[0]["validation"])]
    found += [(f"Error {' '.join(map(plain, diagnosis.rungs[1:]))}", rungs[-1]["validation"])] if rungs[1:] else []
    found.append(("Noise floor", diagnosis.floor / spread))
    return [(what, f"{number(size * spread)} {unit}", percent(size)) for what, size in found]


def detectable(step: Step, units: Units) -> list[Row]:
    """Return the rows of what could not have been seen, smallest first."""
    spread = step.base.problem.spread
    seen = sorted((size, name) for name, size in step.smallest_detectable.items() if name not in step.absorbed)
    return [{"effect": plain(n), "size": f"{number(s, 2)} {units.get('y', '')}", "share": percent(s / spread)}
            for s, n in seen]  # fmt: skip


# -- parameters ------------------------------------------------------------------------------------------------


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
    terms = {str(c): (left, e) for model in (after, before) for left, listed in model.system() for c, e in listed}
    found = []
    for key in [*rows[0], *(n for n in rows[1] if n not in rows[0])]:
        values = [None if key not in r else (r[key]["theta"], r[key]["std"] or 0.0) for r in rows]
        row = next(r[key] for r in reversed(rows) if key in r)
        name = row["symbol"]
        unit = shapes.get(name, "") if name not in terms else unit_of(*terms[name], units)
        found.append(Parameter(name, row["term"], unit, *values))
    return found


def _meaning(model: Model, row: Row) -> str:
    """Return what a parameter multiplies, by which it is known again; else its name."""
    term = next((e for _, listed in model.system() for c, e in listed if str(c) == row["symbol"]), None)
    if term is None or not row["symbol"].startswith("theta"):
        return str(row["symbol"])
    written = expand_phi(term)
    return str(written.xreplace({s: {v: u, x: y}.get(s.base, s.base)[s.indices[0]] for s in samples(written)}))


def unit_of(left: Any, term: Any, units: Units) -> str:
    """Return the unit of a coefficient of a term in an equation for `left`; an empty text where it is not known."""
    whole, part = _dimension(left), _dimension(term)
    if whole is None or part is None:
        return ""
    powers = {name: whole[i] - part[i] for i, name in enumerate("yu")}
    if any(p and not units.get(n) for n, p in powers.items()):
        return ""
    over = [_power(units[n], p) for n, p in powers.items() if p > 0]
    under = [_power(units[n], -p) for n, p in powers.items() if p < 0]
    return f"{' '.join(over) or '1'}{'/' if under else ''}{'/'.join(under)}"


def _power(unit: str, power: int) -> str:
    return unit if power == 1 else unit + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(d)] for d in str(power))


def _dimension(expr: Any) -> tuple[int, int] | None:
    """Return the powers of the units of y and u; None where they are not known."""
    if isinstance(expr, sp.Indexed):
        return {y: (1, 0), x: (1, 0), u: (0, 1), v: (0, 1), phi1: (0, 1), phi2: (0, 0)}.get(expr.base)
    if expr.is_number or expr.func in (sp.sign, sp.tanh, sp.exp, sp.sin, sp.cos):
        return (0, 0)
    if isinstance(expr, sp.Mul):
        parts = [_dimension(a) for a in expr.args]
        known = [p for p in parts if p is not None]
        return (sum(p[0] for p in known), sum(p[1] for p in known)) if len(known) == len(parts) else None
    if isinstance(expr, sp.Pow) and expr.exp.is_Integer:
        part, n = _dimension(expr.base), int(expr.exp)
        return None if part is None else (n * part[0], n * part[1])
    if isinstance(expr, (sp.Add, sp.Max, sp.Min, sp.Abs)):
        return next((d for a in expr.args if not a.is_number and (d := _dimension(a)) is not None), None)
    return None


def shape_units(diagnosis: Diagnosis, units: Units) -> dict[str, str]:
    """Return the units of the shape parameters of all effects that were added."""
    known = {(c.effect, c.variant.effect.form): c.variant.effect.unit for s in diagnosis.steps for c in s.candidates}
    found = {}
    for one in diagnosis.model.info.get("effects", []):
        given = known.get((one["effect"], one["form"]), {})
        for name in one["shape"]:
            found[name] = shape_unit(given.get(name.split("_")[0], ""), one["driver"], units)
    return found


def shape_unit(said: str, driver: str, units: Units) -> str:
    """Put the units of u and y into what the catalogue says about a shape parameter."""
    said = said.replace("unit of the driver", f"unit of {driver}")
    for signal in "uy":
        said = said.replace(f"unit of {signal}", units.get(signal) or f"unit of {signal}")
    return "" if said == "1" else said.replace(" / ", "/")


def candidate_parameters(candidate: Candidate, units: Units) -> str:
    """Return the parameters of a candidate with their units."""
    effect, driver = candidate.variant.effect, candidate.variant.driver
    return ", ".join(
        f"{n} = {number(v, 4)} {shape_unit(effect.unit.get(n, ''), driver, units)}".rstrip()
        for n, v in candidate.parameters.items()
    )


def moved(rows: Iterable[Parameter]) -> str:
    """Say which base parameters moved."""
    told = [
        f"{r.name} from {number(r.before[0])} to {number(r.after[0])}"
        for r in rows
        if r.status == "moved" and r.before and r.after
    ]
    gone = [r.name for r in rows if r.status == "deleted"]
    said = f"Moved by more than {MOVED:.0f} standard errors: {', '.join(told)}. " if told else ""
    said += "They had been compensating for what was missing. " if told else ""
    return said + (f"Deleted, because the effect made them redundant: {', '.join(gone)}." if gone else "")


def python(model: Model, file: str = "model.json") -> str:
    """Return Python code that runs a model from its file."""
    lines = ["import narx_sym as ns", "", *(f"# {line}" for line in model.lines(numbers=True))]
    lines += [f'model = ns.load("{file}")', 'record = ns.read("data.csv", u="u", y="y")']
    given = ", channels=record.channels" if model.channels else ""
    lines.append(f"simulated = model.simulate(record.u, y0=record.y[0]{given})")
    return "\n".join(lines) + "\n"


# -- provenance ------------------------------------------------------------------------------------------------


def sources(records: Sequence[Record], files: Sequence[Any]) -> list[Row]:
    """Return name and SHA-256 of each data file, or of the arrays of records that come from none."""
    if files:
        return [{"name": Path(f).name, "sha256": hashlib.sha256(Path(f).read_bytes()).hexdigest()} for f in files]
    return [
        {"name": f"{r.name} (arrays u, y, t)", "sha256": hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes()
                                                                               for a in (r.u, r.y, r.t))).hexdigest()}
        for r in records
    ]  # fmt: skip


def versions() -> list[tuple[str, str]]:
    """Return the versions of what computed the figures."""
    found = [("Python", platform.python_version())]
    for name in PACKAGES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:  # run from a folder
            continue
    return found


def record_lines(records: Sequence[Record]) -> list[str]:
    """Say how long each segment is."""
    return [f"{r.name}: {len(r)} samples, Ts = {r.Ts:.6g} s" for r in records]
