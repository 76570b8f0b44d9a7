"""What every engine starts from: the update equations over plain symbols, collected in the newest output."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import count
from typing import Any, ClassVar

import sympy as sp

from ..inversion.solution import Root
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, lag, renamed, samples

MAX_HORNER = 4
TIME = sp.Dummy("time_index", real=True)


@lru_cache(maxsize=10_000)
def _plain(signal: int, lag: int) -> sp.Dummy:
    """Return the symbol of a sample, the same in every plan: what SymPy knows of it is asked once."""
    return sp.Dummy(f"x{signal}_{f'm{-lag}' if lag < 0 else lag}", real=True)


@lru_cache(maxsize=10_000)
def _shared(i: int) -> sp.Dummy:
    """Return the symbol of what several expressions share, the same in every plan."""
    return sp.Dummy(f"shared_{i}")


@dataclass(frozen=True)
class Plan:
    """A recursion with each sample `x[k-i]` replaced by a plain real symbol (SymPy differentiates these fast).

    The symbols are dummies: whatever a parameter is called, it is another symbol.

    `signals` is the order of the arrays (states, then inputs), `sample` maps (signal index, lag) to the symbol,
    `updates` holds one expression per state, `parameters` the parameter symbols, `others` further expressions in the
    same samples.
    """

    recursion: Recursion
    signals: tuple[Any, ...]
    sample: dict[tuple[int, int], sp.Symbol]
    updates: tuple[sp.Expr, ...]
    others: tuple[sp.Expr, ...] = ()
    time: ClassVar[sp.Symbol] = TIME

    @classmethod
    def of(cls, recursion: Recursion, others: tuple[sp.Expr, ...] = ()) -> Plan:
        """Make the plan of a recursion, and of further expressions in its samples."""
        signals = (*recursion.states, *recursion.inputs)
        position = {base: i for i, base in enumerate(signals)}
        names: dict[Any, Any] = {}
        sample = {}
        for left, right in recursion.updates:
            for s in [left, *samples(right)]:
                key = (position[s.base], lag(s))
                names[s] = sample[key] = _plain(*key)
        names[k] = cls.time
        updates = tuple(renamed(right, names) for _, right in recursion.updates)
        return cls(recursion, signals, sample, updates, tuple(renamed(e, names) for e in others))

    @property
    def parameters(self) -> tuple[sp.Symbol, ...]:
        """The parameter symbols, in the order of `theta`."""
        return self.recursion.parameters

    @cached_property
    def collected(self) -> tuple[tuple[sp.Expr, ...], ...]:
        """Per state the coefficients c0, c1, ... of its own newest value, so that c0 + x*(c1 + ...) is the update.

        The loop-carried dependency is then one product and one sum for every model affine in y[k-1].
        """
        return tuple(
            horner(right, self.sample[i, 1]) if (i, 1) in self.sample else (right,)
            for i, right in enumerate(self.updates)
        )

    def needed(self, expr: sp.Expr, waiting: dict[Any, Any]) -> Iterator[tuple[sp.Symbol, sp.Expr]]:
        """Yield the shared parts still `waiting` that an expression needs, each after what it needs itself.

        They are taken when first needed: a later state may use an earlier one at lag 0.
        """
        for symbol in sorted(expr.free_symbols & waiting.keys(), key=str):
            if symbol in waiting:  # an inner part may have needed it already
                inner = waiting.pop(symbol)
                yield from self.needed(inner, waiting)
                yield symbol, inner

    @cached_property
    def _parts(self) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[tuple[sp.Expr, ...]]]:
        """Common subexpressions, and the rows of coefficients without them; the other expressions are the last row."""
        flat = [c for row in (*self.collected, self.others) for c in row]
        if any(c.has(Root) for c in flat):  # the unknown of a root has no value outside it
            return [], [*self.collected, self.others]
        common, reduced = sp.cse(flat, symbols=map(_shared, count()), order="none")
        rows, at = [], 0
        for row in (*self.collected, self.others):
            rows.append(tuple(reduced[at : at + len(row)]))
            at += len(row)
        return common, rows

    @property
    def shared(self) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[tuple[sp.Expr, ...]]]:
        """The coefficients with their common subexpressions taken out."""
        return self._parts[0], self._parts[1][:-1]

    @property
    def further(self) -> tuple[sp.Expr, ...]:
        """The other expressions, written with the same common subexpressions."""
        return self._parts[1][-1]


def horner(expr: sp.Expr, x: sp.Symbol) -> tuple[sp.Expr, ...]:
    """Return the coefficients of a polynomial in x by differentiation (`Poly` would expand), or (expr,)."""
    if any(f.has(x) for f in expr.atoms(sp.Function, sp.Piecewise, sp.Max, sp.Min)):
        return (expr,)
    if any((p.base.has(x) and not p.exp.is_nonnegative) or p.exp.has(x) for p in expr.atoms(sp.Pow)):
        return (expr,)
    coefficients, derivative = [], expr
    for order in range(MAX_HORNER + 1):
        coefficients.append(derivative.xreplace({x: sp.S.Zero}) / sp.factorial(order))
        derivative = sp.diff(derivative, x)
        if derivative == 0:
            return tuple(coefficients)
    return (expr,)
