"""A model plus an effect is a model: the effect's equations put at its input, inside, or at its output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic.graph import Graph
from ..symbolic.recursion import State
from ..symbolic.signals import (
    breve_phi1,
    breve_phi2,
    expand_phi,
    k,
    m,
    phi1,
    phi2,
    plain_name,
    r,
    samples,
    signal,
    t,
    u,
    v,
    x,
    y,
)
from .added import AddedEffect
from .effects import EFFECTS, Catalogue, Effect, Form
from .equilibria import continuum_conditions
from .info import Info
from .model import Model

MANY = 20  # coefficients of one effect
# Names that no channel and no state of an effect may have.
RESERVED = {str(b.label) for b in (u, y, t, x, v, r, m, phi1, phi2, breve_phi1, breve_phi2)} | {"k", "prediction"}


@dataclass(frozen=True)
class Variant:
    """One way in which an effect may act on one model.

    Attributes
    ----------
    effect : Effect
    where : "input", "inside" or "output"
    driver : "u", "y", "uy", "t" or "channel"
    channel : str, optional
    lag : int
        Samples by which the driving input comes later.
    raw : bool
        Whether the input is measured from zero instead of the operating point.
    fixed : pairs of a shape parameter in whole samples and its value
    """

    effect: Effect
    where: str
    driver: str
    channel: str | None = None
    lag: int = 0
    raw: bool = False
    fixed: tuple[tuple[str, int], ...] = ()

    @property
    def id(self) -> str:
        """The id that users see; a channel is part of it."""
        return f"{self.effect.id}:{self.channel}" if self.channel else self.effect.id

    @cached_property
    def shape(self) -> tuple[str, ...]:
        """The shape parameters that are refined."""
        return tuple(p for p in self.effect.shape if p not in dict(self.fixed))

    def __str__(self) -> str:
        parts = [self.effect.form, f"at the {self.where}" if self.where != "inside" else "inside"]
        parts += [f"driven by {self.driver}"] if self.driver in ("u", "y") else []
        parts += [f"{n} = {i}" for n, i in self.fixed]
        parts += [f"{self.lag} samples later"] if self.lag else []
        parts += ["from zero"] if self.raw else []
        return f"{self.id} ({', '.join(p for p in parts if p)})"


def variants(model: Model, channels: Iterable[str] = (), catalogue: Catalogue = EFFECTS) -> Iterator[Variant]:
    """Yield every way in which the catalogue's effects may act on a model."""
    named = tuple(channels)
    offset = model.operating_point.get(model.input, 0.0) != 0
    for one in catalogue.all():
        stepped = [[(p, i) for i in map(int, s.values)] for p, s in one.scan.items() if s.of == "steps"]
        choices: list[tuple[tuple[str, int], ...]] = [()]
        for options in stepped:
            choices = [(*c, o) for c in choices for o in options]
        for where, drivers in one.places.items():
            for driver in drivers:
                if where == "inside" and driver != "y" and not model.n_y:
                    continue  # without memory inside and output are one
                moved = "u" in driver and where != "input" and model.delay
                for lag in {0, model.delay} if moved else {0}:
                    for raw in (False, True) if one.centred and offset else (False,):
                        for fixed in choices:
                            for name in named if driver == "channel" else (None,):
                                yield Variant(one, where, driver, name, lag, raw, fixed)


def sequences(model: Model, variant: Variant) -> dict[str, Any]:
    """Return what each placeholder of an effect's equations means in a model: a function of the time index."""
    offset = model.operating_point.get(model.input, 0.0) if variant.raw else 0.0
    later = 1 if variant.where == "inside" else 0
    # What stands inside the core sees the input as the core does.
    acting = v if variant.where == "inside" and any(s.left.base == v for s in model.states) else u

    def source(i: Any) -> Any:
        return acting[i - variant.lag] + offset

    def inner(i: Any) -> Any:
        return (x if variant.where == "output" else model.inner)[i - later]

    meant = {"u": source, "y": lambda i: model.inner[i], "t": lambda i: t[i]}
    meant["x"] = inner if variant.driver == "y" else source
    if variant.channel:
        meant["channel"] = lambda i: signal(variant.channel or "")[i]
    return meant


def equations(model: Model, variant: Variant, suffix: str = "", taken: Iterable[Any] = ()) -> Form:
    """Return the effect's equations in a model's own sequences; names that are taken get a number.

    Raises
    ------
    ModelError
        For an inverse model, and for a channel whose name means something else.
    """
    if model.input != u or model.output != y:
        raise ModelError("Effects are added to a model from u to y; this is an inverse model.")
    _check_channels(model, variant)
    values: dict[str, Any] = {p: sp.Symbol(f"{p}_{suffix}" if suffix else p, real=True) for p in variant.shape}
    form = variant.effect.equations(Ts=model.Ts or 1.0, **values, **dict(variant.fixed))
    used = {str(b.label) for b in taken} | {*model.channels, variant.channel or ""} | {str(s) for s in model.symbols}
    used |= RESERVED | _new_names(variant, suffix)
    renamed = {}
    for state in form.states:
        name = plain = str(state.left.base.label)
        number = 1
        while name in used:
            number += 1
            name = f"{plain}_{number}"
        used.add(name)
        renamed[state.left.base] = signal(name)
    meant = sequences(model, variant)

    def written(expr: Any) -> Any:
        changed = {}
        for s in samples(expr):
            if s.base in renamed:
                changed[s] = renamed[s.base][s.indices[0]]
            elif str(s.base.label) in meant:
                changed[s] = meant[str(s.base.label)](s.indices[0])
        return expr.xreplace(changed)

    states = tuple(
        State(st.left, st.right, _measured(model, st.initial), suffix or "effect")
        for st in (s.map(written) for s in form.states)
    )
    return Form(tuple(written(sp.sympify(z)) for z in form.z), states)


def _new_names(variant: Variant, suffix: str) -> set[str]:
    """Return the names that the symbols of an extension may get."""
    plain = ["c", *(f"c{i}" for i in range(1, MANY + 1)), *variant.shape]
    return {f"{n}_{suffix}" if suffix else n for n in plain}


def _check_channels(model: Model, variant: Variant) -> None:
    """Refuse channels whose names mean something else in an extended model."""
    used = {str(s.left.base.label) for s in model.states} | {str(s) for s in model.symbols}
    own = [variant.channel] if variant.channel else []
    for name in (*own, *model.channels):
        if name in RESERVED or name in used:
            raise ModelError(
                f"The channel {name!r} has a name that means something else in the model: rename the column."
            )


def _measured(model: Model, initial: Any) -> Any:
    """Before the start the inner output is taken as measured, and the input as it is."""
    meant = {x: model.output, v: u}
    return initial.xreplace({s: meant[b][s.indices[0]] for b in meant for s in samples(initial, b)})


@dataclass(frozen=True)
class Extended:
    """A model with an effect added, not fitted yet, and which symbols the effect brought."""

    model: Model
    coefficients: tuple[sp.Symbol, ...]
    shape: tuple[sp.Symbol, ...]
    z: tuple[Any, ...]


def extend(model: Model, variant: Variant) -> Extended:
    """Put an effect into a model.

    Input effects act on u: the core sees v[k] = u[k] + c z[k]. Output effects add to the core's output x:
    y[k] = x[k] + c z[k]. Inside, c z[k] joins the core's terms.

    Raises
    ------
    ModelError
        For an inverse model, a channel whose name means something else, and a shape parameter called like a
        coefficient.
    """
    name = variant.id.replace(":", "_")
    names = {str(s) for s in model.symbols}
    signals = {*model.channels, variant.channel, *(str(s.left.base.label) for s in model.states)}
    suffix, count = name, 1
    while any(n.endswith(f"_{suffix}") for n in names) or signals & _new_names(variant, suffix):
        count += 1
        suffix = f"{name}{count}"
    form = equations(model, variant, suffix, [s.left.base for s in model.states])
    many = len(form.z) > 1
    cs = tuple(sp.Symbol(f"c{i + 1 if many else ''}_{suffix}", real=True) for i in range(len(form.z)))
    shapes = tuple(sp.Symbol(f"{p}_{suffix}", real=True) for p in variant.shape)
    if set(cs) & set(shapes):
        raise ModelError(f"The effect {variant.effect.id} has a shape parameter called like a coefficient: rename it.")
    total = sp.Add(*(c * z for c, z in zip(cs, form.z, strict=True)))

    states, F = list(model.states), model.F
    if variant.where == "input":
        at = next((i for i, s in enumerate(states) if s.left.base == v), None)
        if at is None:
            states = [s.map(_acted_on) if s.left.base == x else s for s in states]
            F = F if model.inner == x else _acted_on(F)
            states = [*form.states, State(v[k], u[k] + total, u[k]), *states]
        else:
            seen = states[at]
            states[at : at + 1] = [*form.states, State(v[k], seen.right + total, u[k])]
    elif variant.where == "output":
        if model.inner != x:
            states = [State(s.left, _renamed(s.right, model.output), s.initial, s.group) for s in states]
            states.append(State(x[k], _renamed(F, model.output), model.output[k]))
            F = x[k]
        # What u drives stands before x, what x drives after it.
        at = len(states) if variant.driver == "y" else next(i for i, s in enumerate(states) if s.left.base == x)
        states[at:at] = form.states
        F = F + total
    elif model.inner == x:
        at = next(i for i, s in enumerate(states) if s.left.base == x)
        states[at] = State(x[k], states[at].right + total, states[at].initial)
        states[at:at] = form.states
    else:
        states, F = [*states, *form.states], F + total
    own = [f"c{i + 1 if many else ''}" for i in range(len(cs))]
    added = AddedEffect(
        variant.id, variant.effect.form, variant.where, variant.driver, suffix, dict(zip(own, cs, strict=True)),
        dict(zip(variant.shape, shapes, strict=True)), dict(variant.fixed),
    )  # fmt: skip
    made = model.replace(
        F=F, symbols=(*model.symbols, *cs, *shapes), states=states, constraints=written_constraints(model),
        theta=None, info=Info(), effects=(*model.effects, added),
    )  # fmt: skip
    return Extended(made, cs, shapes, form.z)


def written_constraints(model: Model) -> list[Any]:
    """Return a model's constraints as equations: those of the continuum are the core's, whatever is added to it."""
    return [e for c in model.constraints for e in (continuum_conditions(model) if c == "continuum" else [c])]


def _acted_on(F: Any) -> Any:
    """Let the core see v in the place of u."""
    written = expand_phi(F)
    return written.xreplace({s: v[s.indices[0]] for s in samples(written, u)})


def _renamed(F: Any, output: Any) -> Any:
    written = expand_phi(F)
    return written.xreplace({s: x[s.indices[0]] for s in samples(written, output)})


def without(model: Model, symbols: Iterable[Any]) -> Model:
    """Return a model that lacks some terms: their coefficients are zero and gone; so is what only they needed."""
    gone = dict.fromkeys(symbols, sp.S.Zero)
    states = [s.map(lambda e: e.xreplace(gone)) for s in model.states]
    F = model.F.xreplace(gone)
    needed = Graph.of([*((s.left, s.right) for s in states), (model.output[k], F)]).reached(model.output)
    states = [s for s in states if s.left.base in needed]
    left = set().union(F.free_symbols, *(s.right.free_symbols for s in states))
    kept = tuple(s for s in model.symbols if s in left)
    constraints = [
        c if isinstance(c, str) else sp.Eq(c.lhs.xreplace(gone), c.rhs.xreplace(gone)) for c in model.constraints
    ]
    values = dict(zip(model.symbols, model.numbers or (), strict=bool(model.numbers)))
    effects = [part for e in model.effects if (part := e.among(kept)).coefficients]
    return model.replace(
        F=F, symbols=kept, states=states, constraints=[c for c in constraints if c != sp.true],
        theta=[values[s] for s in kept] if values else None, info=Info(), effects=effects,
    )  # fmt: skip


def newer(model: Model, before: Model) -> list[AddedEffect]:
    """Return the effects of a model that an earlier one has not, by their coefficients."""
    known = {c for e in before.effects for c in e.coefficients.values()}
    return [e for e in model.effects if not known & set(e.coefficients.values())]


def find(effect_id: str, catalogue: Catalogue = EFFECTS) -> tuple[list[Effect], str | None]:
    """Return the forms of an effect and the channel in its id.

    Raises
    ------
    ModelError
        For an id that the catalogue does not have.
    """
    name, _, channel = effect_id.partition(":")
    if name not in catalogue:
        raise ModelError(f"Unknown effect {effect_id!r}; there are {', '.join(sorted(catalogue))}.")
    needs = any("channel" in f.arguments for f in catalogue[name])
    if needs != bool(channel):
        raise ModelError(
            f"Name the channel: {name}:temperature." if needs else f"The effect {name} does not use a channel."
        )
    return catalogue[name], plain_name(channel) if channel else None
