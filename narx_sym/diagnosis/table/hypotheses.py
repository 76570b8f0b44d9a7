"""What is compared: a core with a set of effects in their places, the empty set included."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp

from ...data.evidence.roles import INPUT
from ...engines.numpy import lambdify
from ...fit.identify import OPEN
from ...models.effects import Catalogue, Effect
from ...models.extend import Variant, equations, extend, variants
from ...models.info import Info
from ...models.model import NARX, Model
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import k, lag, samples, signal, y

Array = np.ndarray
Places = list[tuple[list[int], list[int]]]


@dataclass(frozen=True)
class Core:
    """The linear part of a hypothesis: orders, delay [samples], and whether it integrates; or the given model.

    y[k] = sum of n_y older outputs + n_u inputs from u[k-delay] on + a constant. Each `further` input, a name and its
    delay, has as many. An integrating core has a pole at 1.
    """

    n_y: int = 0
    n_u: int = 1
    delay: int = 0
    integrating: bool = False
    given: bool = False
    further: tuple[tuple[str, int], ...] = ()

    def __str__(self) -> str:
        if self.given:
            return "the given model"
        after = ", ".join(str(delay) for _, delay in self.inputs)
        return f"{'integrating ' if self.integrating else ''}linear part ({self.n_y}, {self.n_u}) after {after}"

    def holds(self, other: Core) -> bool:
        """Whether its orders are no smaller than those of another."""
        return self.n_y >= other.n_y and self.n_u >= other.n_u

    def next_to(self, other: Core, among: Iterable[Core]) -> bool:
        """Whether one holds the other, and no third one lies between them."""
        small, large = (self, other) if other.holds(self) else (other, self)
        between = (c for c in among if c not in (small, large) and large.holds(c) and c.holds(small))
        return large.holds(small) and self.given == other.given and not any(between)

    @property
    def inputs(self) -> tuple[tuple[str, int], ...]:
        """The names of its inputs, each with its delay."""
        return ("u", self.delay), *self.further

    @property
    def dead(self) -> int:
        """The longest of its delays [samples]."""
        return max(d for _, d in self.inputs)

    @property
    def b(self) -> int:
        """How many coefficients of inputs it has."""
        return self.n_u * len(self.inputs)

    def after(self, delays: Iterable[int]) -> Core:
        """Return it with other delays, one of each input."""
        first, *others = delays
        return replace(self, delay=first, further=tuple((n, d) for (n, _), d in zip(self.further, others, strict=True)))

    @property
    def at_once(self) -> Core:
        """It without delays."""
        return self.after(0 for _ in self.inputs)

    @property
    def remembers(self) -> bool:
        """Whether it takes more than the input at one instant."""
        return (self.n_y, self.n_u) != (0, 1)

    def terms(self) -> list[Any]:
        """Return the terms of the core."""
        inputs = [signal(name)[k - d - j] for name, d in self.inputs for j in range(self.n_u)]
        return [*(y[k - i] for i in range(1, self.n_y + 1)), *inputs, sp.S.One]


@dataclass(frozen=True)
class Hypothesis:
    """A core and the effects that act on it."""

    core: Core
    effects: tuple[Variant, ...] = ()

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids of the effects, in order."""
        return tuple(v.id for v in self.effects)

    def __str__(self) -> str:
        return " + ".join([str(self.core), *map(str, self.effects)])


def linear(core: Core, like: Model) -> NARX:
    """Return the linear model of a core, around the operating point of another model."""
    kept = Info(selection=like.info.selection, roles=like.info.roles)
    options: dict[str, Any] = {"operating_point": like.operating_point, "Ts": like.Ts, "info": kept}
    made = NARX(core.terms(), **options)
    if not core.integrating:
        return made
    return NARX(core.terms(), constraints=[sp.Eq(sp.Add(*made.symbols[: core.n_y]), 1)], **options)


def static(like: Model) -> Model:
    """Return a base without memory around the operating point of another model: small cores stand for it."""
    made = linear(Core(further=further(like)), like)
    return made.replace(info=replace(made.info, selection=replace(like.info.selection, base="static")))


def further(given: Model) -> tuple[tuple[str, int], ...]:
    """Return the names of a model's further inputs, and how late each comes."""
    names = (n for n in given.channels if given.info.roles.get(n) == INPUT)
    seen = {n: [lag(x) for x in samples(given.F, signal(n))] for n in names}
    return tuple((name, min(lags)) for name, lags in seen.items() if lags)


def later(variant: Variant, core: Core) -> Variant:
    """Return the variant beside a core with delays: what an input drives there comes later too."""
    moved = variant.driver in ("u", "uy") and variant.where != "input"
    return replace(variant, lag=dict(core.inputs)[variant.at or "u"] if moved else 0)


def written(hypothesis: Hypothesis, given: Model) -> Model:
    """Return the model that a hypothesis stands for, without parameter values."""
    core = hypothesis.core
    model: Model = given if core.given else linear(core, given)
    for variant in hypothesis.effects:
        model = extend(model, variant if core.given else later(variant, core)).model
    return model


def extended(model: Model, effects: Sequence[Variant]) -> tuple[Model, Places]:
    """Return a model with effects, and where the coefficients and the shapes of each stand among its parameters."""
    places: Places = []
    for variant in effects:
        made, at = extend(model, variant), len(model.symbols)
        model, n, s = made.model, len(made.coefficients), len(made.shape)
        places.append((list(range(at, at + n)), list(range(at + n, at + n + s))))
    return model, places


@lru_cache(maxsize=256)
def around(largest: Core, effects: tuple[Variant, ...], Ts: float | None) -> tuple[Model, Places]:
    """Return a core with effects, measured from its operating point, and where these stand: derived once."""
    return extended(NARX(largest.terms(), Ts=Ts), effects)


def linear_in_signals(model: Model, variant: Variant) -> bool:
    """Whether an effect only adds lags of the input and the output, or a constant: an open core has them itself."""
    form = equations(model, variant)
    seen = [x for z in form.z for x in samples(z)]
    own = {"u", "v", "x", "y", variant.at, f"v_{variant.at}"}
    if form.states or variant.shape or any(x.base.name not in own for x in seen):
        return False
    return all(not sp.diff(z.xreplace({x: sp.Symbol("s")}), sp.Symbol("s")).free_symbols for z in form.z for x in seen)


@lru_cache(maxsize=256)
def filters(effect: Effect) -> bool:
    """Whether an effect remembers and bends nothing: a core's own lags may stand for it."""
    form = effect.equations(**{p: int(s.values[0]) for p, s in effect.scan.items() if s.of == "steps"})
    said = [*form.z, *(s.right for s in form.states)]
    return bool(form.states) and not any(samples(derivative(z, x)) for z in said for x in samples(z))


def ways(
    model: Model, given: bool, channels: Sequence[str], catalogue: Catalogue, closer: bool = False, lags: bool = False
) -> list[Variant]:
    """Return every way in which a catalogue's effects may act; what an open core has itself is none.

    The model has the largest core: beside a smaller one, as without memory, some are none. `lags`: whether those of a
    given core were chosen, so that it has itself what only adds some.
    """
    listed = variants(model, channels, catalogue, closer)
    if given and not lags:
        return list(listed)
    ordered = listed if given else dict.fromkeys(replace(v, lag=0) for v in listed)
    return [v for v in ordered if not linear_in_signals(model, v)]


def ladder(family: str, integrating: bool, delays: Sequence[int]) -> list[Core]:
    """Return the cores that are compared, small ones first."""
    if family == "given":
        return [Core(given=True)]
    if family == "static":
        sizes = [(0, 1), (0, 2), (1, 1)]
    elif integrating:
        sizes = [(1, 1), (2, 1), (2, 2), (3, 3)]
    else:
        sizes = [(0, 1), (0, 2), (1, 1), (1, 2), (2, 1), (2, 2), (2, 3), (3, 3)]
    open_ones = [Core(a, b, d, integrating) for a, b in sizes for d in delays]
    # Terms of a polynomial base may only imitate what is missing: it competes with linear cores.
    return [Core(given=True), *open_ones] if family == "narx" else open_ones


def family_of(given: Model) -> str:
    """Return which cores may stand for a base: those of its kind, or only itself."""
    chosen = given.info.selection
    own = {given.input, given.output}
    own |= {signal(n) for n, _ in further(given)} if chosen.base in OPEN else set()
    if not isinstance(given, NARX) or any(x.base not in own for t in given.terms for x in samples(t)):
        return "given"
    if chosen.base == "static" and any(t.is_Pow for t in given.terms):
        return "given"
    return chosen.base or ("narx" if chosen.candidates else "given")


@lru_cache(maxsize=256)
def slopes(variant: Variant) -> list[list[Callable[..., Array]]]:
    """Return how far each contribution of an effect without memory follows its driver, for older and older samples.

    Functions of the driver, the channel and the shape parameters; of an effect that remembers there is none.
    """
    driver, names = signal("x"), [sp.Symbol(p, positive=True) for p in variant.shape]
    form = variant.effect.equations(**dict(variant.fixed))
    found: list[list[Callable[..., Array]]] = []
    for z in form.z if not form.states else ():
        read = sorted(samples(z, driver), key=lag)
        found.append([])
        for at in range(max(map(lag, read), default=-1) + 1):
            slope = derivative(z, driver[k - at])
            level, beside = sp.symbols("level beside", real=True)
            slope = slope.xreplace(dict.fromkeys(read, level) | dict.fromkeys(samples(z, signal("channel")), beside))
            found[-1].append(_array(lambdify([slope], [level, beside, *names])))
    return found


def _array(function: Callable[..., Any]) -> Callable[..., Array]:
    return lambda level, *shape: np.broadcast_to(np.asarray(function(level, *shape)[0], dtype=float), level.shape)
