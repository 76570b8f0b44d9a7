"""Terms of a model given anew: as text (replaced, put in, or left out), or with smooth signs."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.grammar import parse
from ..symbolic.graph import Graph
from ..symbolic.recursion import State
from ..symbolic.signals import k, pairs, renamed, samples, signal
from ..symbolic.smoothing import smoothed, widths
from .added import outside
from .info import Info
from .model import NARX, Model
from .rest.equilibria import continuum_conditions


def written_constraints(model: Model) -> list[Any]:
    """Return a model's constraints as equations: those of the continuum are the core's, whatever is added to it."""
    return [e for c in model.constraints for e in (continuum_conditions(model) if c == "continuum" else [c])]


def written_terms(model: Model) -> dict[str, str]:
    """Return the terms of the core that one parameter multiplies, as text by the parameter's name."""
    terms = dict(pairs(model.core))
    return {str(s): printing.text(terms[s]) for s in model.symbols if s in terms}


def rewritten(model: Model, name: str, text: str, channels: Iterable[str] = ()) -> Model:
    """Return a model with one term of its core given as text, to be fitted anew.

    A base has no values then: its fit starts one step ahead. A model with effects keeps its values.

    Parameters
    ----------
    name : str
        The parameter of the term, as `written_terms` lists it; "" puts in a term with a new parameter.
    text : str
        In the grammar of `narx_sym.symbolic.grammar`, in the signals of the core; "" takes the term out.
    channels : names of further measured signals

    Raises
    ------
    ParseError
        For a text that is no term; ModelError for an unknown parameter, a term that is there already, or one that a
        constraint other than that of the continuum speaks of.
    """
    known = written_terms(model)
    if name and name not in known:
        raise ModelError(f"There is no term with the parameter {name[:40]!r}; there are {', '.join(known) or 'none'}.")
    if not text.strip():
        if len(known) < 2:
            raise ModelError("The last term cannot be removed.")
        if not name:
            raise ModelError("Write a term, such as u[k-2].")
        return _constrained(model, _less(model, _symbol(model, name)), name)
    signals = dict.fromkeys([*channels, *model.channels, "t", *(s.left.base.name for s in model.states)])
    term = parse(text, signals=signals, symbols=model.symbols)
    if printing.text(term) in known.values():
        raise ModelError(f"The term {printing.text(term)} is in the model already.")
    ahead = [s for s in samples(term, model.inner) if (s.indices[0] - k).is_integer and s.indices[0] - k >= 0]
    if ahead or (model.inner != model.output and samples(term, model.output)):
        inner = model.inner.label
        raise ModelError(f"A term may contain past values of {inner} only, such as {inner}[k-1]: not {text.strip()}.")
    return _constrained(model, _more(model, name, term), name)


def _symbol(model: Model, name: str) -> Any:
    """Return the parameter of a name, with what is assumed of it; a new one is real."""
    return next((s for s in model.symbols if str(s) == name), sp.Symbol(name, real=True))


def _less(model: Model, symbol: Any) -> Model:
    if isinstance(model, NARX):
        return _narx(model, [t for s, t in model.parts() if s != symbol])
    return without(model, [symbol])


def _more(model: Model, name: str, term: Any) -> Model:
    if isinstance(model, NARX):
        terms = [term if str(s) == name else t for s, t in model.parts()]
        return _narx(model, terms if name else [*terms, term])
    taken = set(map(str, model.symbols))
    symbol = _symbol(model, name or next(f"theta_{i}" for i in count(1) if f"theta_{i}" not in taken))
    core = sp.Add(*(c * t for c, t in pairs(model.core) if c != symbol), symbol * term)
    states = [State(s.left, core, s.initial, s.group) if s.left.base == model.driven else s for s in model.states]
    symbols = model.symbols if name else (*model.symbols, symbol)
    values = dict(zip(model.symbols, model.numbers or (), strict=bool(model.numbers)))
    return model.replace(
        F=core if model.driven == model.output else model.F, symbols=symbols, states=states,
        theta=[values.get(s, 0.0) for s in symbols] if values else None,
        info=Info(units=model.info.units),
    )  # fmt: skip


def _narx(model: NARX, terms: Sequence[Any]) -> Model:
    return model.replace(terms=terms, theta=None, constraints=(), info=Info(units=model.info.units))


def _constrained(old: Model, made: Model, name: str) -> Model:
    """Give the new model the constraint of the continuum where the old one had it; keep others."""
    before = written_constraints(old)
    if before and set(before) == set(_conditions(old)):
        conditions = _conditions(made)
        if any(e.rhs == 0 and e.lhs in made.symbols for e in conditions):
            raise ModelError("The constraint of the continuum (Sigma_y = 1) forces the parameter of this term to zero.")
        return made.replace(constraints=conditions)
    if any(str(s) == name for e in before for s in e.free_symbols):
        raise ModelError(f"A constraint of this model contains {name}, so its term cannot be changed.")
    return made.replace(constraints=before)


def _conditions(model: Model) -> list[Any]:
    """Conditions of the continuum on the core, as if no effect had been added."""
    core = outside(model, model.core)
    return continuum_conditions(Model(core, model.symbols, output=model.output, input=model.input))


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
