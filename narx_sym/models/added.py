"""One effect that was added to a model: which, in which form, where, and what it brought."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import sympy as sp

from ..symbolic.sensitivity import derivative
from ..symbolic.signals import (
    INNER_INPUTS,
    INNER_OUTPUTS,
    acting,
    expand_phi,
    k,
    lag,
    lags,
    passed,
    renamed,
    samples,
    sensed,
    shift,
    signal,
    v,
    x,
)


@dataclass(frozen=True)
class AddedEffect:
    """An effect in a model; the model's symbols and states say the rest.

    Attributes
    ----------
    effect : id that users see, with its channel, such as "channel:temp"
    form : which of several forms, such as "Bouc-Wen"
    where : one of `effects.PLACES`
    driver : "u", "y", "uy", "t" or "channel"
    group : of the states that it remembers
    coefficients, shape : mappings from the effect's own names, such as "c" and "r", to the model's symbols
    fixed : mapping from shape parameters in whole samples to their values
    full : bool
        Whether a coefficient of 1 is the whole effect, a smaller one a share of it; without a coefficient it is whole.
    """

    effect: str
    form: str = ""
    where: str = ""
    driver: str = ""
    group: str = ""
    coefficients: Mapping[str, Any] = field(default_factory=dict)
    shape: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, int] = field(default_factory=dict)
    full: bool = False

    @property
    def symbols(self) -> dict[str, Any]:
        """All symbols that the effect brought, by its own names."""
        return {**self.coefficients, **self.shape}

    def among(self, symbols: Collection[Any]) -> AddedEffect:
        """Return what is left of the effect where only some symbols are left."""
        coefficients, shape = ({n: s for n, s in d.items() if s in symbols} for d in (self.coefficients, self.shape))
        return replace(self, coefficients=coefficients, shape=shape)

    def relabelled(self, names: Mapping[Any, Any]) -> AddedEffect:
        """Return the effect with other symbols, and another channel, in the place of some."""
        own = ({n: names.get(s, s) for n, s in d.items()} for d in (self.coefficients, self.shape))
        coefficients, shape = own
        kind, colon, channel = self.effect.partition(":")
        new = getattr(names.get(signal(channel)), "name", channel) if channel else ""
        return replace(self, effect=f"{kind}{colon}{new}", coefficients=coefficients, shape=shape)


def own_group(name: str) -> str:
    """Return the group of a state of a model's own, which no effect brought."""
    return f"state {name}"


def own_states(model: Any) -> list[str]:
    """Return the names of the states of a physical model that are not its output: effects may act on them too."""
    return [s.left.base.name for s in model.states if s.group == own_group(s.left.base.name)]


def newer(model: Any, before: Any) -> list[AddedEffect]:
    """Return the effects of a model that an earlier one has not, by their groups."""
    known = {e.group for e in before.effects}
    return [e for e in model.effects if e.group not in known]


def starts(model: Any) -> dict[Any, Any]:
    """Return the start of each state, in samples of the inputs and outputs and in the model's shifted signals."""
    kept = {s.left.base for s in model.states if s.left.base != x and (s in model.recurrent or s.remembers)}
    first = {s.left.base: s.initial for s in model.states}
    found: dict[Any, Any] = {}
    makes = [(model.input, v), (model.input, passed), (model.output, x)]
    makes += [(signal(n), signal(f"{b.name}_{n}")) for n in model.channels for b in (v, passed)]

    def known(expr: Any) -> Any:
        """Put in what the states start from."""
        written = expand_phi(expr)
        read = [s for s in samples(written) if s.base in first and s.base != x]
        return written.xreplace({s: shift(found.get(s.base, first[s.base]), -lag(s)) for s in read})

    for state in model.states:
        if state.left.base == x:
            continue
        if state.left.base not in kept:
            found[state.left.base] = known(state.right)
            continue
        # Its initial value speaks of what drives it: that may be what the effects have made of the input or the output.
        driven = {plain: b for plain, b in makes if samples(state.right, b)}
        meant = {s: driven[s.base][s.indices[0]] for s in samples(state.initial) if s.base in driven}
        found[state.left.base] = known(state.initial.xreplace(meant))
    if x not in first:
        return found
    shown, added = model.output[k], model.beside
    if sensed in first:  # behind what the sensor shows is what effects add to x
        shown = _inner(model.F - sensed[k], sensed, shown)
        added = next(s.right for s in model.states if s.left.base == sensed) - x[k]
    inner = _inner(known(added), x, shown)
    found = {b: e.xreplace({s: shift(inner, -lag(s)) for s in samples(e, x)}) for b, e in found.items()}
    return found | {x: inner}


def outside(model: Any, expr: Any) -> Any:
    """Write an expression in the input and the output alone, as if no effect had been added: `acting` comes later."""
    beside = next((s.right for s in model.states if s.left.base == acting), sp.S.Zero)
    arrives = min((i for b in (model.input, v) for i in lags(beside, b)), default=0)
    plain = dict.fromkeys(INNER_OUTPUTS, model.output) | dict.fromkeys(INNER_INPUTS, model.input)
    late = {acting: arrives}
    meant = {s: plain[s.base][s.indices[0] - late.get(s.base, 0)] for s in samples(expr) if s.base in plain}
    return renamed(expr, meant)


def arrivals(model: Any, expr: Any, bases: Sequence[Any]) -> set[int]:
    """Return the lags at which some sequences enter an expression, through states that no effect brought too."""
    brought = {e.group for e in model.effects}
    ways = {s.left.base: s.right for s in model.states if not s.group or s.group not in brought}

    def found(expr: Any, passed: tuple[Any, ...]) -> set[int]:
        plain = outside(model, expr)
        through = (s for s in samples(plain) if s.base in ways and s.base not in passed)
        later = ({lag(s) + i for i in found(ways[s.base], (*passed, s.base))} for s in through)
        return {i for b in bases for i in lags(plain, b)}.union(*later)

    return found(expr, ())


def _inner(beside: Any, base: Any, output: Any) -> Any:
    """Solve y = x + beside(x) for x at one sample; its own past is as it is.

    What a sensor bends is solved piece by piece, first where it shows all. A piece that rises by less than half hides
    more of x than it tells (noise would be more than doubled): there, what the sensor shows is taken for x.
    """
    at = sp.Dummy("x", real=True)
    held = beside.xreplace(dict.fromkeys(samples(beside, base), at))
    found, hidden = [], output - held.xreplace({at: output})
    for piece, inside in _pieces(held, at):
        slope, shown = 1 + derivative(piece, at), output - piece.xreplace({at: sp.S.Zero})
        if slope.has(at):  # not linear: the first step of an iteration from x = y
            return hidden
        if not inside:
            return shown / slope
        inner = shown / sp.Max(slope, sp.S.Half)
        found.append((slope != 1, inner, sp.And(slope >= sp.S.Half, *(e.xreplace({at: inner}) >= 0 for e in inside))))
    solved = [(inner, taken) for _, inner, taken in sorted(found, key=lambda one: one[0])]
    return sp.Piecewise(*solved, (hidden, True))


def _pieces(expr: Any, at: Any) -> list[tuple[Any, list[Any]]]:
    """Return the linear pieces of an expression in `at`, each with what is not negative there."""
    bent = next(
        (e for e in sp.postorder_traversal(expr) if isinstance(e, sp.Abs | sp.Max | sp.Min) and e.has(at)), None
    )
    if bent is None:
        return [(expr, [])]
    chosen: list[tuple[Any, list[Any]]] = []
    if isinstance(bent, sp.Abs):
        (inner,) = bent.args
        chosen = [(inner, [inner]), (-inner, [-inner])]
    else:
        sign = 1 if isinstance(bent, sp.Max) else -1
        chosen = [(a, [sign * (a - b) for b in bent.args if b != a]) for a in bent.args]
    return [
        (piece, [*inside, *more])
        for value, inside in chosen
        for piece, more in _pieces(expr.xreplace({bent: value}), at)
    ]


def measured(model: Any, right: Any) -> Any:
    """Put y - (what the output adds) in the place of past `x`; what a sensor hides is as the core says."""
    seen = derivative(model.F, sensed[k]) if any(s.left.base == sensed for s in model.states) else sp.S.One
    # The slope of a sensor is +1 or -1 where it tells all, 0 where it tells nothing.
    taken = model.output[k] - model.beside if seen == 1 else x[k] + seen * (model.output[k] - model.F)
    return right.xreplace({s: shift(taken, -lag(s)) for s in samples(right, x) if lag(s)})


def flat(model: Any) -> Any:
    """Return F with `x` and states without memory eliminated, where algebra can do it."""
    states = {s.left.base: s for s in model.states}
    F = model.F
    if x in states and not any(samples(s.right, x) for b, s in states.items() if b != x):
        F = measured(model, states[x].right) + model.beside
    for base, state in reversed(states.items()):
        if state not in model.recurrent and not (base == x and state.remembers):
            F = F.xreplace({s: shift(state.right, -lag(s)) for s in samples(F, base)})
    return F
