"""All that is derived from one model, as text and as a LaTeX document."""

from __future__ import annotations

from typing import Any

from . import analysis
from .errors import ModelError, NotInvertible
from .invert import compensator
from .model import Model
from .printing import latex, text


def summary(model: Model) -> list[tuple[str, list[str]]]:
    """Return headings and lines of plain text: what a user reads on the terminal."""
    state = analysis.steady_state(model)
    sections = [
        ("Model", [f"{model.output.label}[k] = {text(model.F)}", *_values(model)]),
        ("In your units", [f"{model.output.label}[k] = {text(model.expand(numbers=True).rhs)}"]),
        ("Sigma_y", [_valued(analysis.sigma_y(model), model)]),
        (
            "Steady state",
            [
                f"{state.equation.lhs} = {state.equation.rhs}",
                "continuum of equilibria (Lemma 1) if "
                + (" and ".join(f"{c.lhs} = {c.rhs}" for c in state.conditions) or "always"),
            ],
        ),
    ]
    if model.values:
        verdict = analysis.property_1(model)
        sections.append(("Property 1", [f"{'holds' if verdict.holds else 'fails'}: {verdict.reason}"]))
    try:
        sets = analysis.quasi_static(model)
        sections.append(
            (
                "Quasi-static solutions",
                [
                    f"loading:   {sets.loading}",
                    f"unloading: {sets.unloading}",
                    f"attracting where {sets.attracting}",
                ],
            )
        )
    except ModelError as error:
        sections.append(("Quasi-static solutions", [str(error)]))
    found = analysis.check(model)
    sections.append(("Assumptions", [str(v) for v in found] or ["none is violated"]))
    try:
        sections.append(("Compensation law", [f"m[k] = {text(compensator(model).law)}"]))
    except NotInvertible as error:
        sections.append(("Compensation law", [str(error)]))
    return sections


def _values(model: Model) -> list[str]:
    return [f"{s} = {v:.6g}" for s, v in zip(model.symbols, [] if model.theta is None else model.theta, strict=False)]


def _valued(expr: Any, model: Model) -> str:
    number = expr.xreplace(model.values)
    return f"{expr} = {float(number):.12g}" if model.values and number.is_number else str(expr)


def document(model: Model) -> str:
    """Return a LaTeX document with every derived equation; it compiles with amsmath alone."""
    state = analysis.steady_state(model)
    parts: list[tuple[str, list[str]]] = [("Model", [model.latex()])]
    if model.values:
        parts[0][1].append(model.latex(numbers=True))
    parts.append((r"Sum of the linear output parameters", [rf"\Sigma_y = {latex(analysis.sigma_y(model))}"]))
    parts.append(("Steady state", [latex(state.equation)]))
    conditions = [latex(c) for c in state.conditions]
    parts.append(("Continuum of equilibrium points", conditions or [r"\text{always}"]))
    try:
        sets = analysis.quasi_static(model)
        parts.append(("Quasi-static sets and attracting condition", sets.latex().split(r" \\ ", 1)))
    except ModelError:
        pass
    try:
        law = compensator(model)
        parts.append(("Compensation law", [law.latex()]))
        if law.A is not None:
            parts.append((r"Grouping $A(q)\,y_k = B(q)\,u_k + f(\cdot)$", law.latex_grouping()))
    except NotInvertible as error:
        parts.append(("Compensation law", [rf"\parbox{{0.9\linewidth}}{{{_escape(str(error))}}}"]))
    body = "\n\n".join(
        rf"\section*{{{heading}}}" + "\n" + "\n".join(f"\\[\n{e}\n\\]" for e in equations)
        for heading, equations in parts
    )
    return (
        "\\documentclass{article}\n\\usepackage{amsmath}\n\\usepackage[margin=2cm]{geometry}\n"
        f"\\begin{{document}}\n{body}\n\\end{{document}}\n"
    )


def _escape(message: str) -> str:
    for special in "_^&%#$":
        message = message.replace(special, "\\" + special if special != "^" else r"\textasciicircum{}")
    return message
