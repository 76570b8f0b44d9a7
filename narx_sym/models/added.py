"""One effect that was added to a model: which, in which form, where, and what it brought."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import sympy as sp

from ..symbolic.sensitivity import derivative
from ..symbolic.signals import expand_phi, k, lag, samples, shift, u, v, x


@dataclass(frozen=True)
class AddedEffect:
    """An effect in a model; the model's symbols and states say the rest.

    Attributes
    ----------
    effect : id that users see, with its channel, such as "channel:temp"
    form : which of several forms, such as "Bouc-Wen"
    where : "input", "inside" or "output"
    driver : "u", "y", "uy", "t" or "channel"
    group : of the states that it remembers
    coefficients, shape : mappings from the effect's own names, such as "c" and "r", to the model's symbols
    fixed : mapping from shape parameters in whole samples to their values
    """

    effect: str
    form: str = ""
    where: str = ""
    driver: str = ""
    group: str = ""
    coefficients: Mapping[str, Any] = field(default_factory=dict)
    shape: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, int] = field(default_factory=dict)

    @property
    def symbols(self) -> dict[str, Any]:
        """All symbols that the effect brought, by its own names."""
        return {**self.coefficients, **self.shape}

    def among(self, symbols: Collection[Any]) -> AddedEffect:
        """Return what is left of the effect where only some symbols are left."""
        coefficients, shape = ({n: s for n, s in d.items() if s in symbols} for d in (self.coefficients, self.shape))
        return replace(self, coefficients=coefficients, shape=shape)


def starts(model: Any) -> dict[Any, Any]:
    """Return the start of each state, in samples of the inputs and outputs and in the model's shifted signals."""
    kept = {s.left.base for s in model.states if s.left.base != x and (s in model.recurrent or s.remembers)}
    first = {s.left.base: s.initial for s in model.states}
    found: dict[Any, Any] = {}

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
        driven = {model.output: x, u: v} if samples(state.right, x) else {u: v}
        driven = {a: b for a, b in driven.items() if samples(state.right, b)}
        meant = {s: driven[s.base][s.indices[0]] for s in samples(state.initial) if s.base in driven}
        found[state.left.base] = known(state.initial.xreplace(meant))
    if x not in first:
        return found
    inner = _inner(known(model.beside), model.output[k])
    found = {b: e.xreplace({s: shift(inner, -lag(s)) for s in samples(e, x)}) for b, e in found.items()}
    return found | {x: inner}


def _inner(beside: Any, output: Any) -> Any:
    """Solve y = x + beside(x) for x at one sample; its own past is as it is."""
    at = sp.Dummy("x", real=True)
    held = beside.xreplace(dict.fromkeys(samples(beside, x), at))
    slope = derivative(held, at)
    if slope.has(at):  # no effect of the catalogue is bent there
        return output - held.xreplace({at: output})
    rest = output - held.xreplace({at: sp.S.Zero})
    return rest if slope == 0 else rest / (1 + slope)
