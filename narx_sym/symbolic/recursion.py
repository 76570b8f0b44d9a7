"""The waist of the package: an ordered list of update equations over indexed signals.

A model, its sensitivities, its inverse and a compensator are all recursions. Algebra turns one into another;
`compile` turns any of them into a function over arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import sympy as sp

from ..errors import ModelError
from .doors import RecursionDoors
from .graph import Graph
from .printing import InLatex, latex_law, shown
from .signals import expand_phi, k, lag, samples


@dataclass(frozen=True)
class State(InLatex):
    """One further update equation of a model, evaluated before its output.

    Attributes
    ----------
    left : Indexed
        The state at time k, such as `p[k]`.
    right : expression
        Its update.
    initial : expression
        Its value before the first computed sample, in samples of the inputs and outputs at that time.
    """

    left: sp.Indexed
    right: Any
    initial: Any = sp.S.Zero
    group: str = ""  # states of one group start together: their unknown past is one unknown

    def map(self, change: Callable[[Any], Any]) -> State:
        """Return the state with all three expressions changed alike."""
        left, right, initial = (change(sp.sympify(e)) for e in (self.left, self.right, self.initial))
        return State(left, right, initial, self.group)

    def latex(self) -> str:
        """LaTeX of the update."""
        return latex_law([(self.left, self.right)])

    @property
    def remembers(self) -> bool:
        """Whether the state uses its own past."""
        return bool(samples(self.right, self.left.base))


@dataclass(frozen=True)
class Recursion(RecursionDoors, InLatex):
    """`x[k] = f(x[k-1], ..., inputs, parameters)`, one equation per state, evaluated in order.

    Parameters
    ----------
    updates : sequence of (x[k], expression)
        A state may use itself and later states at lags >= 1, earlier states also at lag 0, and inputs at any lag
        or lead (a lead is a preview).
    parameters : sequence of Symbol
        The order in which values are passed when the recursion runs.

    Raises
    ------
    ModelError
        Where an equation needs a value that is not known yet, or an unknown symbol appears.
    """

    updates: tuple[tuple[sp.Indexed, sp.Expr], ...]
    parameters: tuple[sp.Symbol, ...] = field(default=())

    def __post_init__(self) -> None:
        updates = tuple((left, expand_phi(sp.sympify(right))) for left, right in self.updates)
        object.__setattr__(self, "updates", updates)
        object.__setattr__(self, "parameters", tuple(self.parameters))
        places = {left.base: position for position, (left, _) in enumerate(updates)}
        if len(places) < len(updates) or any(lag(left) for left, _ in updates):
            raise ModelError("Each update defines one sequence at time k, once.")
        for position, (left, right) in enumerate(updates):
            for s in samples(right):
                defined = places.get(s.base)
                if defined is not None and lag(s) < (0 if defined < position else 1):
                    raise ModelError(f"{left} needs {s}, which is not known yet at that point.")
            unknown = right.free_symbols - set(self.parameters) - {k} - {b.label for b in _bases(right)}
            unknown = {s for s in unknown if not isinstance(s, (sp.Indexed, sp.IndexedBase))}
            if unknown:
                raise ModelError(f"{left} contains {unknown}, which are neither signals nor parameters.")

    @cached_property
    def states(self) -> tuple[sp.IndexedBase, ...]:
        """The sequences that the recursion computes, in order."""
        return tuple(left.base for left, _ in self.updates)

    @cached_property
    def inputs(self) -> tuple[sp.IndexedBase, ...]:
        """The sequences that it reads only, by name."""
        found = {s.base for _, right in self.updates for s in samples(right)} - set(self.states)
        return tuple(sorted(found, key=str))

    @cached_property
    def graph(self) -> Graph:
        """Which state reads which sequence, at which lags."""
        return Graph.of(self.updates)

    @cached_property
    def depth(self) -> int:
        """The number of past samples that must be known before the first update (the largest lag)."""
        return max([0, *(lag(s) for _, right in self.updates for s in samples(right))])

    @cached_property
    def lead(self) -> int:
        """The preview: how many future samples of the inputs an update needs."""
        return max([0, *(-lag(s) for _, right in self.updates for s in samples(right))])

    @cached_property
    def past(self) -> tuple[sp.Indexed, ...]:
        """What a step must remember: the samples `y[k-1]`, `y[k-2]`, ..., states first, each from the newest on.

        With `given` it is the state-space form of the recursion: the state, and the inputs at time k.
        """
        oldest = {base: 0 for base in self.states} | {s.base: lag(s) for s in self.given}
        newest = {base: 1 for base in self.states} | {s.base: lag(s) + 1 for s in self.given}
        for _, right in self.updates:
            for s in samples(right):
                oldest[s.base] = max(oldest[s.base], lag(s))
        return tuple(base[k - i] for base in oldest for i in range(newest[base], oldest[base] + 1))

    @cached_property
    def given(self) -> tuple[sp.Indexed, ...]:
        """What a step is given: each input at time k, or the last sample of its preview."""
        read = {s for _, right in self.updates for s in samples(right)}
        return tuple(base[k - min(0, *(lag(s) for s in read if s.base == base))] for base in self.inputs)

    def latex(self) -> str:
        """LaTeX of the equations in order."""
        return latex_law(list(self.updates))

    def __repr__(self) -> str:
        return f"Recursion({'; '.join(f'{shown(left)} = {shown(right)}' for left, right in self.updates)})"

    def subs(self, values: Mapping[Any, Any]) -> Recursion:
        """Put values or expressions in the place of parameters."""
        left = tuple(p for p in self.parameters if p not in values)
        return Recursion(tuple((a, b.xreplace(dict(values))) for a, b in self.updates), left)

    def extend(self, updates: Sequence[tuple[Any, Any]], parameters: Sequence[Any] = ()) -> Recursion:
        """Append further equations."""
        return Recursion((*self.updates, *updates), (*self.parameters, *parameters))


def written_out(expr: Any, states: Sequence[State]) -> int:
    """Return how many nodes an expression has when states without memory are put in, each where it occurs."""
    recurrent = Graph.of((s.left, s.right) for s in states).recurrent
    sizes: dict[Any, int] = {}

    def size(e: Any) -> int:
        return sizes.get(e.base, 1) if isinstance(e, sp.Indexed) else 1 + sum(map(size, e.args))

    for state in states:
        sizes[state.left.base] = 1 if state.left.base in recurrent else size(state.right)
    return size(expr)


def _bases(expr: sp.Expr) -> set[sp.IndexedBase]:
    return {s.base for s in samples(expr)}
