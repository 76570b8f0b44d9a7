"""Models with other names, fewer terms, or smooth signs."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

import sympy as sp

from ..symbolic.graph import Graph
from ..symbolic.signals import k, renamed, samples, signal
from ..symbolic.smoothing import smoothed, widths
from .info import Info
from .model import NARX, Model
from .rest.equilibria import continuum_conditions


def written_constraints(model: Model) -> list[Any]:
    """Return a model's constraints as equations: those of the continuum are the core's, whatever is added to it."""
    return [e for c in model.constraints for e in (continuum_conditions(model) if c == "continuum" else [c])]


def called(expr: Any, names: Mapping[Any, Any]) -> Any:
    """Put other sequences and symbols for some in an expression."""
    moved = {s: names[s.base][s.indices[0]] for s in samples(expr) if s.base in names}
    return renamed(expr, moved | {s: new for s, new in names.items() if isinstance(s, sp.Symbol)})


def relabelled(model: Model, names: Mapping[Any, Any]) -> Model:
    """Return a model in which some sequences and parameters have other names; its input and output keep theirs.

    Parameters
    ----------
    names : mapping from channels, states and symbols to others
    """

    def change(expr: Any) -> Any:
        return called(expr, names)

    def named(of: Mapping[str, Any]) -> dict[str, Any]:
        known = {base.name: new.name for base, new in names.items() if not isinstance(base, sp.Symbol)}
        return {known.get(name, name): value for name, value in of.items()}

    known: dict[str, Any] = {
        n: named(getattr(model.info, n)) for n in ("ranges", "rates", "frequencies", "steps", "units")
    }
    info = replace(model.info, **known)
    symbols = tuple(names.get(s, s) for s in model.symbols)
    own: dict[str, Any] = {"F": change(model.F), "symbols": symbols}
    if isinstance(model, NARX) and symbols == model.symbols:
        own = {"terms": [change(t) for t in model.terms]}
    return model.replace(
        **own, states=[s.map(change) for s in model.states], info=info,
        constraints=[c if isinstance(c, str) else change(c) for c in model.constraints],
        effects=[e.relabelled(names) for e in model.effects], standard_errors=model.standard_errors,
        theta=model.numbers,
    )  # fmt: skip


def set_apart(model: Model, taken: Collection[str]) -> tuple[Model, dict[str, str]]:
    """Return a model whose channels and states leave some names to others, and the new names of those that do."""
    own = own_names(model)
    used, names = {*own, *taken}, {}
    for name in [n for n in own if n in taken]:
        names[name] = f"model_{name}"
        while names[name] in used:
            names[name] = f"model_{names[name]}"
        used.add(names[name])
    return (relabelled(model, {signal(a): signal(b) for a, b in names.items()}) if names else model), names


def own_names(model: Model) -> list[str]:
    """Return the names of a model's channels and states."""
    return [*model.channels, *(s.left.base.name for s in model.states)]


def smooth(model: Model, eps: Any = None, form: Any = "tanh") -> Any:
    """Replace sign(phi1) by a smooth function, before or after identification.

    Parameters
    ----------
    eps : number or mapping from "u" and "y" to numbers, optional
        The width of the change from -1 to 1 [unit of u, of y]. By default 0.3 median steps of the
        record that the model was fitted on.
    form : "tanh", "root", "atan" or a function
        See `narx_sym.symbolic.smoothing.smoothed`.

    Returns
    -------
    A model of the same parameters and values; `.fit(record)` fits it anew.
    """
    eps = widths(eps, {b: b.name for b in (model.output, model.input)}, model.info.steps)

    def change(expr: Any) -> Any:
        return smoothed(expr, eps, form)

    states = [s.map(change) for s in model.states]
    core = {"terms": [change(t) for t in model.terms]} if isinstance(model, NARX) else {"F": change(model.F)}
    return model.replace(**core, states=states, info=model.info.of_records, standard_errors=None)


def without(model: Model, symbols: Iterable[Any]) -> Model:
    """Return a model that lacks some terms: their coefficients are zero and gone; so is what only they needed."""
    return held(model, dict.fromkeys(symbols, sp.S.Zero))


def held(model: Model, known: Mapping[Any, Any]) -> Model:
    """Return a model in which some parameters are numbers, and gone; so is what only they needed.

    An effect is gone where none of its coefficients is left or a number other than zero.
    """
    states = [s.map(lambda e: e.xreplace(known)) for s in model.states]
    F = model.F.xreplace(known)
    needed = Graph.of([*((s.left, s.right) for s in states), (model.output[k], F)]).reached(model.output)
    states = [s for s in states if s.left.base in needed]
    left = set().union(F.free_symbols, *(s.right.free_symbols for s in states))
    kept = tuple(s for s in model.symbols if s in left)
    constraints = [
        c if isinstance(c, str) else sp.Eq(c.lhs.xreplace(known), c.rhs.xreplace(known)) for c in model.constraints
    ]
    values = dict(zip(model.symbols, model.numbers or (), strict=bool(model.numbers)))
    acting = {*kept, *(s for s, number in known.items() if not sp.sympify(number).is_zero)}
    effects = [e.among(kept) for e in model.effects if not e.coefficients or acting & set(e.coefficients.values())]
    return model.replace(
        F=F, symbols=kept, states=states, constraints=[c for c in constraints if c != sp.true],
        theta=[values[s] for s in kept] if values else None, info=Info(units=model.info.units), effects=effects,
    )  # fmt: skip
