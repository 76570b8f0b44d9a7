"""All that is derived from one model: what the terminal says, what a LaTeX document and the report show.

Each analysis is one function with `@analysis`; the order and both headings stand at its top, and nothing else lists it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import sympy as sp

from ..errors import ModelError, NotInvertible
from ..models import analysis as derive
from ..models.model import Model
from ..models.rest_map import plays
from ..symbolic.printing import document_of, latex, latex_text, shown
from ..symbolic.signals import definitions
from .compensator import Compensator, compensator
from .stability import InternalRecursion


@dataclass(frozen=True)
class Finding:
    """What an analysis found: lines of plain text, equations in LaTeX, a sentence before them, or why there is nothing.

    Each may be missing.
    """

    lines: list[str] = field(default_factory=list)
    equations: list[str] = field(default_factory=list)
    first: str = ""
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Subject:
    """What the analyses look at: a model, and its law, which is derived once."""

    model: Model

    @cached_property
    def law(self) -> Compensator:
        """The compensation law.

        Raises
        ------
        NotInvertible
            Where the model has none.
        """
        return compensator(self.model)


@dataclass(frozen=True)
class Analysis:
    """One thing that is derived from a model.

    Attributes
    ----------
    find : function from a Subject to a Finding
        A ModelError or NotInvertible that it raises is the reason why there is nothing.
    order : float
        Its place among the others.
    heading, title : str
        Above its lines on the terminal, and above its equations in documents; "" where it is not told there.
    """

    find: Callable[[Subject], Finding]
    order: float
    heading: str = ""
    title: str = ""


ANALYSES: dict[str, Analysis] = {}


def analysis(
    order: float, heading: str = "", title: str = ""
) -> Callable[[Callable[[Subject], Finding]], Callable[[Subject], Finding]]:
    """Register an analysis under the name of its function; see `Analysis`."""

    def register(find: Callable[[Subject], Finding]) -> Callable[[Subject], Finding]:
        ANALYSES[find.__name__] = Analysis(find, order, heading, title)
        return find

    return register


# -- what is told ----------------------------------------------------------------------------------------------


# Conditions that are one word.
SAID = {r"\text{True}": r"\text{attracting everywhere}", r"\text{False}": r"\text{attracting nowhere}"}


@dataclass(frozen=True)
class Derived:
    """One thing that is derived from a model: LaTeX of its equations, and what stands before or instead of them."""

    title: str
    latex: list[str] = field(default_factory=list)
    reason: str = ""


def _told(subject: Subject, where: str) -> Iterator[tuple[str, Finding]]:
    """Go through what is told under a heading or a title, in order; a reason why there is nothing is a line, too."""
    for one in sorted(ANALYSES.values(), key=lambda one: one.order):
        if head := getattr(one, where):
            try:
                yield head, one.find(subject)
            except (ModelError, NotInvertible) as error:
                yield head, Finding([str(error)], reason=str(error))


def summary(model: Model) -> list[tuple[str, list[str]]]:
    """Return headings and lines of plain text: what a user reads on the terminal.

    Where something is not derived, its lines say why.
    """
    return [(heading, found.lines) for heading, found in _told(Subject(model), "heading") if found.lines]


def derived(subject: Subject) -> list[Derived]:
    """Return what is derived from a model, in the order of the paper; what cannot be derived has its reason, once."""
    listed: list[Derived] = []
    for title, found in _told(subject, "title"):
        if found.equations:
            listed.append(Derived(title, [SAID.get(e, e) for e in found.equations], found.first))
        elif found.reason and found.reason not in [other.reason for other in listed]:
            listed.append(Derived(title, reason=found.reason))
    return listed


def document(model: Model) -> str:
    """Return a LaTeX document with every derived equation; it compiles with amsmath alone."""
    named = [latex(sp.Eq(*pair, evaluate=False)) for pair in definitions(model.right)]
    parts = [("Model", [model.latex(), *named, *([model.latex(numbers=True)] if model.values else [])])]
    for one in derived(Subject(model)):
        parts.append((one.title, [*([latex_text(one.reason)] if one.reason else []), *one.latex]))
    return document_of(parts)


# -- the analyses ----------------------------------------------------------------------------------------------


@analysis(10, "Model")
def equation(subject: Subject) -> Finding:
    """Show the equation as it is, and the values of its parameters, with units where those of the signals are known."""
    model = subject.model
    numbers = [] if model.theta is None else model.theta
    units = model.coefficient_units() if model.info.units else {}
    said = [f" {unit}" if (unit := units.get(str(s), "1")) != "1" else "" for s in model.symbols]
    listed = zip(model.symbols, numbers, said, strict=False)
    named = [f"{shown(left)} = {shown(right)}" for left, right in definitions(model.right)]
    return Finding([*model.lines(), *named, *(f"{s} = {v:.6g}{unit}".rstrip() for s, v, unit in listed)])


@analysis(20, "In your units")
def in_units(subject: Subject) -> Finding:
    """Show the equation in the user's units, or all of them where states remain."""
    model = subject.model
    updates = model.recursion.updates if model.hidden else [model.expand(numbers=True).args]
    return Finding([f"{shown(left)} = {shown(right.xreplace(model.values))}" for left, right in updates])


@analysis(30, "Sigma_y", "Sum of the linear output parameters")
def sigma_y(subject: Subject) -> Finding:
    """Sum up the parameters of the linear output terms."""
    values = subject.model.values
    found = derive.sigma_y(subject.model)
    number = found.xreplace(values)
    valued = rf" = {latex(sp.Float(number))}" if found.free_symbols and number.is_number else ""
    line = f"{shown(found)} = {float(number):.12g}" if values and number.is_number else shown(found)
    return Finding([line], [rf"\Sigma_y = {latex(found)}{valued}"])


@analysis(40, "Steady state", "Steady state")
def steady_state(subject: Subject) -> Finding:
    """Tell where the output rests under a constant input."""
    state = derive.steady_state(subject.model)
    lines = [f"{shown(state.equation.lhs)} = {shown(state.equation.rhs)}"]
    if state.held:
        lines += ["continuum of equilibria: plays rest anywhere in", *state.ranges(shown)]
        return Finding(lines, [latex(state.equation), *state.ranges(latex, r"\leq")])
    conditions = " and ".join(f"{shown(c.lhs)} = {shown(c.rhs)}" for c in state.conditions) or "always"
    return Finding([*lines, f"continuum of equilibria (Lemma 1) if {conditions}"], [latex(state.equation)])


@analysis(50, title="Continuum of equilibrium points, where")
def continuum(subject: Subject) -> Finding:
    """Derive the conditions of Lemma 1; what plays hold is told with the steady state."""
    if plays(subject.model):
        return Finding()
    conditions = derive.continuum_conditions(subject.model)
    if any(not c.free_symbols and c.lhs != c.rhs for c in conditions):
        return Finding(equations=[r"\text{nowhere, whatever the parameters}"])
    return Finding(equations=[latex(c) for c in conditions] or [r"\text{always}"])


@analysis(60, "Property 1")
def property_1(subject: Subject) -> Finding:
    """Tell whether the output keeps still under a constant input: a verdict on numbers."""
    if not subject.model.values:
        return Finding()
    verdict = derive.property_1(subject.model)
    said = {True: "holds", False: "fails", None: "not decided"}[verdict.holds]
    return Finding([f"{said}: {verdict.reason}"])


@analysis(70, "Quasi-static solutions", "Quasi-static sets and attracting condition")
def quasi_static(subject: Subject) -> Finding:
    """Tell where the output settles while the input moves slowly."""
    sets = derive.quasi_static(subject.model)
    lines = [f"loading:   {shown(sets.loading)}", f"unloading: {shown(sets.unloading)}"]
    lines.append(f"attracting where {shown(sets.attracting)}")
    if sets.turns:
        named = ", ".join(map(shown, sets.turns))
        lines.append(f"with the positions of the plays at the last reversal of the input: {named}")
    return Finding(lines, sets.latex().split(r" \\ ", 1))


@analysis(80, "Assumptions")
def assumptions(subject: Subject) -> Finding:
    """Tell which assumptions of the paper the model violates."""
    return Finding([str(v) for v in derive.check(subject.model)] or ["none is violated"])


@analysis(90, "Compensation law", "Compensation law")
def law(subject: Subject) -> Finding:
    """Derive the law, after whether it is stable and the polynomials whose roots it takes where there are any."""
    first = "" if subject.model.theta is None else str(subject.law.stability())
    lines = [*filter(None, [first]), *(f"{shown(left)} = {shown(right)}" for left, right in subject.law.updates)]
    lines += [p.sentence for p in subject.law.polynomials]
    return Finding(lines, [*subject.law.latex_polynomials(), subject.law.latex()], first)


@analysis(100, title="Grouping into A(q), B(q) and f")
def grouping(subject: Subject) -> Finding:
    """Separate the linear parts of the model, where it has them."""
    return Finding(equations=[] if subject.law.A is None else subject.law.latex_grouping())


@analysis(110, "The law's own dynamics")
def dynamics(subject: Subject) -> Finding:
    """Tell where the law forgets its own errors."""
    internal = subject.law.internal
    if isinstance(internal, InternalRecursion):
        return Finding([f"{shown(left)} = {shown(right)}" for left, right in internal.updates])
    lines = [f"attracting where {shown(internal.condition)}"]
    if subject.model.values:
        region = internal.region
        everywhere = {sp.false: "repelling nowhere", sp.true: "repelling everywhere"}
        lines.append(everywhere.get(region) or f"repelling where {shown(region)}")
    return Finding([*lines, *(f"{d} = {shown(turn)}" for d, turn in internal.turns.items())])


@analysis(120, title="The law's own dynamics: attracting condition")
def attracting(subject: Subject) -> Finding:
    """Derive the condition of `dynamics` for documents, where it is short enough for one."""
    internal = subject.law.internal
    return Finding(equations=[] if isinstance(internal, InternalRecursion) else [latex(internal.condition)])
