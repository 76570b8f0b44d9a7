"""A model plus an effect is a model: the effect's equations put at its input, inside, or at its output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic.recursion import State
from ..symbolic.signals import (
    INNER_INPUTS,
    RESERVED,
    acting,
    channel_name,
    differences,
    expand_phi,
    free,
    grip,
    k,
    passed,
    renamed,
    rub,
    samples,
    sensed,
    signal,
    t,
    v,
    x,
    y,
)
from .added import AddedEffect, outside, own_states
from .effects import EFFECTS, PLACES, Catalogue, Effect, Form
from .info import Info
from .model import Model
from .rewrite import called, relabelled, written_constraints

MANY = 20  # coefficients of one effect


@dataclass(frozen=True)
class Variant:
    """One way in which an effect may act on one model.

    Attributes
    ----------
    effect : Effect
    where : one of `effects.PLACES`
    driver : "u", "y", "uy", "t", "channel", "friction", or the name of a state of the model's own, which it then joins
    channel : str, optional
        What an effect that asks for another measured quantity reads; a driver "channel" moves it alone.
    lag : int
        Samples by which the driving input comes later.
    raw : bool
        Whether the input is measured from zero instead of the operating point.
    fixed : pairs of a shape parameter in whole samples and its value
    aside : names that its states leave to the channels of the records
    at : the further input at which it acts, which its driver `u` then means; "" for the model's own
    """

    effect: Effect
    where: str
    driver: str
    channel: str | None = None
    lag: int = 0
    raw: bool = False
    fixed: tuple[tuple[str, int], ...] = ()
    aside: tuple[str, ...] = ()
    at: str = ""

    @property
    def id(self) -> str:
        """The id that users see; a channel is part of it."""
        return f"{self.effect.id}:{self.channel}" if self.channel else self.effect.id

    @cached_property
    def shape(self) -> tuple[str, ...]:
        """The shape parameters that are refined."""
        return tuple(p for p in self.effect.shape if p not in dict(self.fixed))

    @property
    def counted(self) -> frozenset[str]:
        """The shape parameters that count samples of the record; lags of a core, as its orders, are of any rate."""
        return frozenset(p for p, _ in self.fixed if self.effect.unit.get(p) == "samples")

    def finer(self, factor: int) -> Variant:
        """Return the same effect where one sample is so many."""
        return replace(self, fixed=tuple((p, n * factor if p in self.counted else n) for p, n in self.fixed))

    def beside(self, n_y: int) -> bool:
        """Whether it is an effect of its own beside a model of so many older outputs.

        Without memory inside and output are one, a force has no way of its own, and what holds the motion is a play.
        """
        return bool(n_y) or not (self.where in ("motion", "force") or (self.where == "inside" and self.driver != "y"))

    def __str__(self) -> str:
        parts = [self.effect.form, PLACES[self.where]]
        driver = self.at or self.driver
        parts += [f"driven by {driver}"] if driver not in ("uy", "t", "channel", "friction") else []
        parts += [f"{n} = {i}" for n, i in self.fixed]
        parts += [f"{self.lag} samples later"] if self.lag else []
        parts += ["from zero"] if self.raw else []
        return f"{self.id} ({', '.join(p for p in parts if p)})"


def variants(
    model: Model, channels: Iterable[str] = (), catalogue: Catalogue = EFFECTS, closer: bool = False
) -> Iterator[Variant]:
    """Yield every way in which the catalogue's effects may act on a model, in their usual forms or in `closer` ones.

    What follows an input, or acts there, may do so at each; a further input is no channel but for the gain of another.
    """
    channels = tuple(channels)
    further = [n for n in model.channels if model.info.roles.get(n) == "input"]
    for made in _variants(model, channels, catalogue, closer):
        if not (made.channel in further and made.where != "input"):
            yield made
    for name in further:
        for made in _variants(exchanged(model, name), [n for n in channels if n != name], catalogue, closer):
            if made.where == "input" or made.driver in ("u", "uy"):
                yield replace(made, at=name, aside=channels)


@lru_cache(maxsize=64)
def exchanged(model: Model, name: str) -> Model:
    """Return a model whose input has changed places with a channel, with all that effects make of the two."""
    names = _exchange(model, name)
    plain = model.replace(
        F=expand_phi(model.F, model.input), symbols=model.symbols, theta=model.numbers,
        states=[s.map(lambda e: expand_phi(e, model.input)) for s in model.states],
    )  # fmt: skip
    point = {b: v for b, v in model.operating_point.items() if b != model.input}
    return relabelled(plain, names).replace(operating_point=point)


def _exchange(model: Model, name: str) -> dict[Any, Any]:
    pairs = {model.input: signal(name), **{b: signal(f"{b.name}_{name}") for b in INNER_INPUTS}}
    return pairs | {b: a for a, b in pairs.items()}


def _variants(model: Model, named: Sequence[str], catalogue: Catalogue, closer: bool) -> Iterator[Variant]:
    named, forced, own = tuple(named), _forced(model), own_states(model)
    for one in (e for e in catalogue.all() if e.closer == closer):
        stepped = [[(p, i) for i in map(int, s.values)] for p, s in one.scan.items() if s.of == "steps"]
        choices: list[tuple[tuple[str, int], ...]] = [()]
        for options in stepped:
            choices = [(*c, o) for c in choices for o in options]
        for where, drivers in one.places.items():
            if (where == "force" and not forced) or (where == "friction" and not rubs(model)):
                continue
            for driver in drivers:
                # A sensor and a speed have one zero; what acts on the machine may be centred where it works.
                about = (True,) if where == "sensor" or one.standing else (False, True)
                centred = (one.centred or one.standing) and origin(model, driver) != 0
                moved = driver in ("u", "uy") and where != "input" and model.delay
                for lag in {0, model.delay} if moved else {0}:
                    for raw in about if centred else (False,):
                        for fixed in choices:
                            for name in named if "channel" in one.arguments else (None,):
                                made = Variant(one, where, driver, name, lag, raw, fixed, named)
                                if made.beside(model.n_y):
                                    yield made
                                    joins = where in ("inside", "motion") and driver == "y" and not (raw or stepped)
                                    yield from (
                                        replace(made, driver=n) for n in own if joins and not one.equations().states
                                    )


def _forced(model: Model) -> bool:
    """Whether a force beside the input is an effect of its own: without zeros it is one inside.

    A core that asks for the sign of the input's step would ask for that of a force that hardly changes.
    """
    steps = any(samples(model.core, d) for d in differences(model.input))
    return model.n_u > model.delay and not steps


def rubs(model: Model) -> bool:
    """Whether it has a friction that says which share of it is reached."""
    return any(s.left.base == rub for s in model.states)


def _moving(model: Model, driver: str) -> tuple[Any, Any]:
    """Return the sequence that an effect on the motion acts on, and what it would be without."""
    if driver in own_states(model):
        return signal(driver), signal(f"{driver}_free")
    return model.inner, free


def origin(model: Model, driver: str) -> float:
    """Return where the operating point of what drives an effect is."""
    if driver in own_states(model):
        return 0.0
    return model.operating_point.get(model.output if driver == "y" else model.input, 0.0)


def sequences(model: Model, variant: Variant) -> dict[str, Any]:
    """Return what each placeholder of an effect's equations means in a model: a function of the time index."""
    offset = origin(model, variant.driver) if variant.raw else 0.0
    later = 1 if variant.where in ("inside", "force") else 0
    # Behind an effect at the input everything sees what passes it: friction behind a slack is friction of what moves.
    named = {s.left.base for s in model.states}
    before = (passed if variant.where == "input" else v) if v in named else model.input

    moving, going = _moving(model, variant.driver)

    def source(i: Any) -> Any:
        return before[i - variant.lag] + offset

    def inner(i: Any) -> Any:
        if variant.where == "motion":  # the step that the core would make
            return going[i] - moving[i - 1]
        if moving != model.inner:
            return moving[i - 1]
        if variant.where == "friction":
            return rub[i]
        return {"output": x, "sensor": sensed}.get(variant.where, model.inner)[i - later] + offset

    meant = {"u": source, "y": lambda i: moving[i] + offset, "t": lambda i: t[i]}
    meant["x"] = inner if variant.driver in ("y", "friction", *own_states(model)) else source
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
    if model.output != y:
        raise ModelError("Effects are added to a model whose output is y; this is an inverse model.")
    if variant.at:
        exchange = _exchange(model, variant.at)
        moved = [exchange.get(b, b) for b in taken]
        form = equations(exchanged(model, variant.at), replace(variant, at=""), suffix, moved)
        states = tuple(s.map(lambda e: called(e, exchange)) for s in form.states)
        return Form(tuple(called(z, exchange) for z in form.z), states)
    _check_channels(model, variant)
    values: dict[str, Any] = {p: sp.Symbol(f"{p}_{suffix}" if suffix else p, real=True) for p in variant.shape}
    form = variant.effect.equations(Ts=model.Ts or 1.0, **values, **dict(variant.fixed))
    used = {b.name for b in taken} | {*model.channels, variant.channel or ""} | {str(s) for s in model.symbols}
    used |= RESERVED | _new_names(variant, suffix) | set(variant.aside)
    own = {}
    for state in form.states:
        name = plain = state.left.base.name
        number = 1
        while name in used:
            number += 1
            name = f"{plain}_{number}"
        used.add(name)
        own[state.left.base] = signal(name)
    meant = sequences(model, variant)

    def written(expr: Any) -> Any:
        changed = {}
        for s in samples(expr):
            if s.base in own:
                changed[s] = own[s.base][s.indices[0]]
            elif s.base.name in meant:
                changed[s] = meant[s.base.name](s.indices[0])
        return renamed(expr, changed)

    # Before the start the inner outputs are taken as measured, and the input as it is.
    states = tuple(
        State(st.left, st.right, outside(model, st.initial), suffix or "effect")
        for st in (s.map(written) for s in form.states)
    )
    return Form(tuple(written(sp.sympify(z)) for z in form.z), states)


def _new_names(variant: Variant, suffix: str) -> set[str]:
    """Return the names that the symbols of an extension may get."""
    plain = ["c", *(f"c{i}" for i in range(1, MANY + 1)), *variant.shape]
    return {f"{n}_{suffix}" if suffix else n for n in plain}


def _check_channels(model: Model, variant: Variant) -> None:
    """Refuse channels whose names mean something else in an extended model."""
    used = {s.left.base.name for s in model.states} | {str(s) for s in model.symbols}
    own = [variant.channel] if variant.channel else []
    for name in (*own, *model.channels):
        if name in RESERVED or name in used:
            raise ModelError(
                f"The channel {name!r} has a name that means something else in the model: rename the column."
            )


@dataclass(frozen=True)
class Extended:
    """A model with an effect added, not fitted yet, and which symbols the effect brought."""

    model: Model
    coefficients: tuple[sp.Symbol, ...]
    shape: tuple[sp.Symbol, ...]
    z: tuple[Any, ...]


def extend(model: Model, variant: Variant) -> Extended:
    """Put an effect into a model.

    Input effects act on u: the core sees v[k] = u[k] + c z[k]. A second one acts on what the first one lets through, as
    a slack behind an amplifier that saturates: v[k] = passed[k] + c z[k]; further ones act beside it. A force acts
    where the input does, once that has arrived, as friction of the mass that is driven: acting[k] = u[k-d] + c z[k]
    takes the way of the input, with all its zeros, and is not delayed. Inside, c z[k] joins the core's terms. On the
    motion it is driven by the step that the core would make, free[k] - y[k-1]: y[k] = free[k] + c z[k]. In a friction
    that reaches a share of its force, it changes which is passed on: grip[k] = rub[k] + c z[k]. Output effects
    add to the core's output x: y[k] = x[k] + c z[k]. The sensor shows y[k] = sensed[k] + c z[k] of all that.

    Raises
    ------
    ModelError
        For an inverse model, a channel whose name means something else, a shape parameter called like a coefficient,
        and a place that the model does not have.
    """
    if variant.at:
        new, exchange = extend(exchanged(model, variant.at), replace(variant, at="")), _exchange(model, variant.at)
        back = exchanged(new.model, variant.at).replace(operating_point=model.operating_point)
        effects = (*model.effects, replace(new.model.effects[-1], driver=variant.at))
        return replace(new, model=back.replace(effects=effects), z=tuple(called(z, exchange) for z in new.z))
    if variant.where == "friction" and not rubs(model):
        raise ModelError(f"{variant} needs an elastic friction, and the model has none: add that first.")
    name = variant.id.replace(":", "_")
    names = {str(s) for s in model.symbols}
    signals = {*model.channels, variant.channel, *(s.left.base.name for s in model.states)}
    groups = {e.group for e in model.effects}
    suffix, count = name, 1
    while suffix in groups or any(n.endswith(f"_{suffix}") for n in names) or signals & _new_names(variant, suffix):
        count += 1
        suffix = f"{name}{count}"
    form = equations(model, variant, suffix, [s.left.base for s in model.states])
    many = len(form.z) > 1
    cs = tuple(sp.Symbol(f"c{i + 1 if many else ''}_{suffix}", real=True) for i in range(len(form.z)))
    shapes = tuple(sp.Symbol(f"{p}_{suffix}", real=True) for p in variant.shape)
    if set(cs) & set(shapes):
        raise ModelError(f"The effect {variant.effect.id} has a shape parameter called like a coefficient: rename it.")
    total = sp.Add(*(c * z for c, z in zip(cs, form.z, strict=True)))

    states, F = _placed(model, variant, form.states, total)
    own = [f"c{i + 1 if many else ''}" for i in range(len(cs))]
    added = AddedEffect(
        variant.id, variant.effect.form, variant.where, variant.driver, suffix, dict(zip(own, cs, strict=True)),
        dict(zip(variant.shape, shapes, strict=True)), dict(variant.fixed), variant.effect.full,
    )  # fmt: skip
    made = model.replace(
        F=F, symbols=(*model.symbols, *cs, *shapes), states=states, constraints=written_constraints(model),
        theta=None, info=Info(units=model.info.units, roles=model.info.roles), effects=(*model.effects, added),
    )  # fmt: skip
    return Extended(made, cs, shapes, form.z)


def _placed(model: Model, variant: Variant, own: Sequence[State], total: Any) -> tuple[list[State], Any]:
    """Return the states and F of a model with what an effect adds, after the states that the effect brought."""
    chain, moving = _split(model, variant.where, variant.driver), _moving(model, variant.driver)[0]
    named = {s.left.base for s in chain}
    inner = x if x in named else model.output
    target = {
        "input": v,
        "force": acting,
        "inside": free if free in named else inner,
        "motion": inner,
        "friction": grip,
        "output": sensed if sensed in named else model.output,
        "sensor": model.output,
    }[variant.where]
    target = moving if moving != model.inner else target
    # What u drives stands before x, what x drives after it.
    before = x if variant.where == "output" and variant.driver != "y" else target
    at, to = (next(i for i, s in enumerate(chain) if s.left.base == b) for b in (before, target))
    chain[to] = State(chain[to].left, chain[to].right + total, chain[to].initial, chain[to].group)
    chain[at:at] = own
    return chain[:-1], chain[-1].right


def _split(model: Model, where: str, driver: str) -> list[State]:
    """Return a model's equations, the output's last, in which the sequence that a place acts on has a name."""
    output = model.output
    chain = [*model.states, State(output[k], model.F, output[k])]
    named = {s.left.base for s in chain}

    def moved(expr: Any, old: Any, new: Any) -> Any:
        written = expand_phi(expr, model.input)
        return renamed(written, {s: new[s.indices[0]] for s in samples(written, old)})

    def between(target: Any, name: Any) -> None:
        """Give what an equation has on its right a name of its own."""
        at = next(i for i, s in enumerate(chain) if s.left.base == target)
        begins = chain[at].initial
        chain[at : at + 1] = [
            State(name[k], chain[at].right, begins), State(target[k], name[k], begins, chain[at].group)
        ]  # fmt: skip

    def behind(at: int, old: Any, new: Any, begins: Any) -> None:
        """Let all equations from one on read what an effect will make of a sequence."""
        read = [State(s.left, moved(s.right, old, new), s.initial, s.group) for s in chain[at:]]
        chain[at:] = [State(new[k], old[k], begins), *read]

    if where == "input" and v not in named:
        behind(0, model.input, v, model.input[k])
    elif where == "input" and passed not in named:
        between(v, passed)
    if where == "force" and acting not in named:
        source = v if v in named else model.input
        at = next(i for i, s in enumerate(chain) if s.left.base == model.driven)
        core, delay = expand_phi(chain[at].right, model.input), model.delay
        arrived = {s: acting[s.indices[0] + delay] for s in samples(core, source) if k - s.indices[0] >= delay}
        chain[at] = State(chain[at].left, renamed(core, arrived), chain[at].initial, chain[at].group)
        chain.insert(at, State(acting[k], source[k - delay], model.input[k]))
    moving, going = _moving(model, driver)
    if where == "motion" and going not in named:
        between(moving, going)
    if where == "friction" and grip not in named:
        at = next(i for i, s in enumerate(chain) if s.left.base == rub)
        behind(at + 1, rub, grip, chain[at].initial)
    if where in ("output", "sensor") and x not in named:
        states = [State(s.left, moved(s.right, output, x), s.initial, s.group) for s in chain[:-1]]
        chain = [*states, State(x[k], moved(chain[-1].right, output, x), output[k]), State(output[k], x[k], output[k])]
    if where == "sensor" and sensed not in named:
        between(output, sensed)
    return chain


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
    return catalogue[name], channel_name(channel) if channel else None


def form_of(added: AddedEffect) -> Effect | None:
    """Return the catalogue's form of an added effect; None for one that is not in it."""
    try:
        forms, _ = find(added.effect)
    except ModelError:
        return None
    return next((f for f in forms if f.form == added.form), None)
