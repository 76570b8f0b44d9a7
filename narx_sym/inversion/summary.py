"""All that is derived from one model, as text and as a LaTeX document."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import sympy as sp

from ..errors import ModelError, NotInvertible
from ..models import analysis
from ..models.model import Model
from ..symbolic.printing import latex, text
from .compensator import compensator


def summary(model: Model) -> list[tuple[str, list[str]]]:
    """Return headings and lines of plain text: what a user reads on the terminal.

    Where something is not derived, its lines say why.
    """

    def steady() -> list[str]:
        state = analysis.steady_state(model)
        conditions = " and ".join(f"{c.lhs} = {c.rhs}" for c in state.conditions) or "always"
        return [f"{state.equation.lhs} = {state.equation.rhs}", f"continuum of equilibria (Lemma 1) if {conditions}"]

    def property_1() -> list[str]:
        verdict = analysis.property_1(model)
        return [f"{'holds' if verdict.holds else 'fails'}: {verdict.reason}"]

    def quasi_static() -> list[str]:
        sets = analysis.quasi_static(model)
        found = (f"loading:   {sets.loading}", f"unloading: {sets.unloading}", f"attracting where {sets.attracting}")
        return list(found)

    def dynamics() -> list[str]:
        internal = compensator(model).internal
        said = [f"attracting where {internal.condition}"]
        if model.values:
            region = internal.region
            said.append("repelling nowhere" if region is sp.false else f"repelling where {region}")
        return [*said, *(f"{d} = {text(turn)}" for d, turn in internal.turns.items())]

    wanted: list[tuple[str, Callable[[], list[str]]]] = [
        ("Model", lambda: [*model.lines(), *_values(model)]),
        ("In your units", lambda: _expanded(model)),
        ("Sigma_y", lambda: [_valued(analysis.sigma_y(model), model)]),
        ("Steady state", steady),
        *([("Property 1", property_1)] if model.values else []),
        ("Quasi-static solutions", quasi_static),
        ("Assumptions", lambda: [str(v) for v in analysis.check(model)] or ["none is violated"]),
        ("Compensation law", lambda: compensator(model).lines()),
        ("The law's own dynamics", dynamics),
    ]
    return [(heading, _tried(lines)) for heading, lines in wanted]


def _tried(lines: Callable[[], list[str]]) -> list[str]:
    """Return what can be derived, or the reason why it cannot."""
    try:
        return lines()
    except (ModelError, NotInvertible) as error:
        return [str(error)]


def _expanded(model: Model) -> list[str]:
    """Return the equation in the user's units, or all of them where states remain."""
    updates = model.recursion.updates if model.hidden else [model.expand(numbers=True).args]
    return [f"{text(left)} = {text(right.xreplace(model.values))}" for left, right in updates]


def _values(model: Model) -> list[str]:
    return [f"{s} = {v:.6g}" for s, v in zip(model.symbols, [] if model.theta is None else model.theta, strict=False)]


def _valued(expr: Any, model: Model) -> str:
    number = expr.xreplace(model.values)
    return f"{expr} = {float(number):.12g}" if model.values and number.is_number else str(expr)


@dataclass(frozen=True)
class Derived:
    """One thing that is derived from a model: LaTeX of its equations, or the reason why there are none."""

    heading: str
    latex: list[str] = field(default_factory=list)
    reason: str = ""


def derived(model: Model) -> list[Derived]:
    """Return what is derived from a model, in the order of the paper; what cannot be derived has its reason."""

    def conditions() -> list[str]:
        return [latex(c) for c in analysis.steady_state(model).conditions] or [r"\text{always}"]

    def sigma_y() -> list[str]:
        found = analysis.sigma_y(model)
        number = found.xreplace(model.values)
        valued = rf" = {latex(sp.Float(number))}" if found.free_symbols and number.is_number else ""
        return [rf"\Sigma_y = {latex(found)}{valued}"]

    def tried(heading: str, equations: Callable[[], list[str]]) -> Derived:
        try:
            return Derived(heading, equations())
        except (ModelError, NotInvertible) as error:
            return Derived(heading, reason=str(error))

    found = [
        tried("Sum of the linear output parameters", sigma_y),
        tried("Steady state", lambda: [latex(analysis.steady_state(model).equation)]),
        tried("Continuum of equilibrium points, where", conditions),
        tried(
            "Quasi-static sets and attracting condition",
            lambda: analysis.quasi_static(model).latex().split(r" \\ ", 1),
        ),
    ]
    try:
        law = compensator(model)
    except NotInvertible as error:
        return [*found, Derived("Compensation law", reason=str(error))]
    found.append(Derived("Compensation law", [law.latex()]))
    if law.A is not None:
        found.append(Derived(r"Grouping $A(q)\,y_k = B(q)\,u_k + f(\cdot)$", law.latex_grouping()))
    if not law.staged:
        found.append(tried("The law's own dynamics: attracting condition", lambda: [latex(law.internal.condition)]))
    return found


def document(model: Model) -> str:
    """Return a LaTeX document with every derived equation; it compiles with amsmath alone."""
    parts: list[tuple[str, list[str]]] = [("Model", [model.latex()])]
    if model.values:
        parts[0][1].append(model.latex(numbers=True))
    left_out = ("Continuum", "Quasi-static")  # the reason stands at the steady state
    parts += [
        (one.heading, one.latex or [_boxed(one.reason)])
        for one in derived(model)
        if one.latex or not one.heading.startswith(left_out)
    ]
    body = "\n\n".join(
        rf"\section*{{{heading}}}" + "\n" + "\n".join(f"\\[\n{e}\n\\]" for e in equations)
        for heading, equations in parts
    )
    return (
        "\\documentclass{article}\n\\usepackage{amsmath}\n\\usepackage[margin=2cm]{geometry}\n"
        f"\\begin{{document}}\n{body}\n\\end{{document}}\n"
    )


def _boxed(message: str) -> str:
    return rf"\parbox{{0.9\linewidth}}{{{_escape(message)}}}"


def _escape(message: str) -> str:
    for special in "_^&%#$":
        message = message.replace(special, "\\" + special if special != "^" else r"\textasciicircum{}")
    return message
