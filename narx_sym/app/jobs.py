"""The long pieces of work: each makes a rung, a model with the diagnosis of what it still lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..data.record import Record
from ..diagnosis.add import Addition
from ..diagnosis.procedure import Diagnosis, diagnose
from ..diagnosis.refit import Fitted, prune
from ..errors import FitError, ModelError, NarxError, NotInvertible
from ..fit.excursions import operating_range
from ..fit.identify import identify
from ..fit.least_squares import describe, fit
from ..inversion.compensator import compensator
from ..models.effects import EFFECTS
from ..models.model import Model
from ..symbolic.mathml import from_latex
from .story import Told, told

Report = Callable[[str], Any]


@dataclass(frozen=True, eq=False)
class Rung:
    """One state of the model.

    Attributes
    ----------
    name : str
        What was done to get here.
    found : Diagnosis
        Of this model: `found.steps[0].base` is the model as fitted on the training samples.
    model : Model
        Fitted on all samples: the one to take away.
    effect : str
        The effect that was added; "" for a base or an edited term.
    notes : tuple of str
    shown : Told
        The parts of the report, up to here.
    """

    name: str
    found: Diagnosis
    model: Model
    effect: str = ""
    notes: tuple[str, ...] = ()
    shown: Told | None = None

    @property
    def base(self) -> Fitted:
        """The model as fitted on the training samples."""
        return self.found.steps[0].base

    @property
    def errors(self) -> dict[str, float]:
        """Free-run NRMSE on training and on held-out samples."""
        return self.found.steps[0].nrmse(self.base)


@dataclass(frozen=True)
class Law:
    """A compensation law as text, or why there is none.

    Attributes
    ----------
    lines, latex, html : the law with numbers
    notes : what a user should know before it runs
    code : C99 source, "" where the law has none
    why_not : str
        "" where there is a law.
    """

    lines: tuple[str, ...] = ()
    latex: str = ""
    html: str = ""
    notes: tuple[str, ...] = ()
    code: str = ""
    why_not: str = ""


@dataclass(frozen=True)
class Way:
    """What every step needs: the measurements, their units, and the rungs before it."""

    records: tuple[Record, ...]
    units: Mapping[str, str]
    rungs: tuple[Rung, ...] = ()


def first(base: str | Model, way: Way, report: Report) -> Rung:
    """Identify a base, unless it is a model already, and diagnose it."""
    if isinstance(base, Model):
        return climbed("model file", base, way, report)
    report(f"identifying a {base} base from {sum(map(len, way.records))} samples")
    return climbed(f"{base} base", identify(way.records, base=base), way, report)


def added(effect: str, way: Way, report: Report) -> Rung:
    """Add an effect: a candidate of the diagnosis as it was fitted there, or any other of the catalogue."""
    rung = way.rungs[-1]
    step = rung.found.steps[0]
    candidate = next((c for c in step.candidates if c.effect == effect), None)
    if candidate is None:
        model = Addition(rung.base.model, effect, None, EFFECTS).fit(way.records, report=report)
    elif step.chosen is not None and candidate is step.candidates[0]:
        model = step.chosen.model
    else:
        report("deleting what became redundant")
        model = prune(candidate.fitted, rung.base).model
    return climbed(f"+ {effect}", model, way, report, effect)


def edited(model: Model, name: str, what: str, way: Way, report: Report) -> Rung:
    """Fit a model whose term with the parameter `name` is new."""
    starts = [model.theta]
    if model.theta is not None and name:  # the old value may be a bad one for the new term
        starts.append([0.0 if str(s) == name else v for s, v in zip(model.symbols, model.theta, strict=True)])
    for start in starts[:-1]:
        model.theta = start
        try:
            return climbed(what, model, way, report)
        except FitError:
            continue
    model.theta = starts[-1]
    return climbed(what, model, way, report)


def climbed(name: str, model: Model, way: Way, report: Report, effect: str = "") -> Rung:
    """Diagnose a model, fit it on all samples, and draw."""
    found = diagnose(model, way.records, report=report)
    report("fitting on all samples")
    final = found.steps[0].base.model.copy()
    notes: tuple[str, ...] = ()
    try:
        fit(final, way.records, method="free_run")
    except FitError as error:
        notes = (f"The fit on all samples failed ({error}); the one on the training blocks is kept.",)
        describe(final, way.records, "free_run", True)
    report("drawing")
    made = Rung(name, found, final, effect, notes)
    return replace(made, shown=told([*way.rungs, made], way.units))


def law_of(model: Model, limits: tuple[float, float] | None, rate: float | None, report: Report) -> Law:
    """Derive the compensation law of a model, with its source."""
    report("deriving the compensation law")
    try:
        law = compensator(model)
    except (NotInvertible, ModelError) as error:
        return Law(why_not=str(error))
    notes = [f"It looks {law.preview} sample{'' if law.preview == 1 else 's'} ahead in the reference."]
    ranges = [f"{name} from {low:.4g} to {high:.4g}" for name, (low, high) in model.info.get("ranges", {}).items()]
    if ranges:
        notes.append(f"It was identified for {' and '.join(ranges)}: beyond that nothing was measured.")
    if law.staged:
        report("counting the solutions of each stage")
        notes.append(f"Checked: {law.checked}.")
    if (repels := operating_range(law)) is not None and repels.sentence:
        notes.append(repels.sentence)
    try:
        code = law.to_c(limits=limits, rate=rate)
    except NarxError as error:
        code = ""
        notes.append(f"There is no C source: {error}")
    latex = law.latex(numbers=True)
    html = f'<div class="equation" tabindex="0" role="group" aria-label="Compensation law">{from_latex(latex)}</div>'
    return Law(tuple(law.lines(numbers=True)), latex, html, tuple(notes), code)
