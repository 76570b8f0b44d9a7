"""A recursion that carries its derivatives along: derived once, and kept between processes with its machine code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..symbolic.recursion import Recursion
from ..symbolic.sensitivity import Tangent, sensitivities
from .compile import Compiled, Layout, compile, kept, written
from .numbers import lifted

Array = np.ndarray
LONGEST = 12  # lag of a carried tangent, of every core that is tried: older ones would have to be read from memory
Begin = Sequence[tuple[Sequence[str], Array]]


@dataclass(frozen=True)
class Walk:
    """A run over arrays that stay where they are.

    Attributes
    ----------
    states : dict of (N,) arrays
        Their first samples are the start; the run fills the rest.
    columns : (N, directions + 1) array
        The derivatives of the output, and a column to spare: what is put there has its products with them at once.
    run : callable
        run(theta) fills both; NaN from where it diverges.
    """

    states: dict[str, Array]
    columns: Array
    run: Callable[[Array], None]

    @property
    def slopes(self) -> Array:
        """The derivatives of the output, (N, directions)."""
        return self.columns[:, :-1]


class Tangents:
    """Machine code of a recursion with its tangents, one lane per direction.

    Attributes
    ----------
    keys : (state, lag) of each tangent that is carried
    width, directions : int
    """

    def __init__(self, told: Any, code: Any, directions: int, numbers: Array):
        from .machine.native import bound

        layout, self.keys, self.width = told
        self.layout, self.directions = Layout(*layout), directions
        count = len(self.layout.states) + len(self.layout.inputs)
        self.compiled = Compiled(self.layout, bound(code, count + 2, numbers), "native")

    def over(self, inputs: Mapping[str, Array], initial: Mapping[str, Any], begin: Begin) -> Walk:
        """Return the run over some samples.

        Parameters
        ----------
        begin : (names, (depth,) array) of each direction that is a start
            The states that it shifts, and where.
        """
        n = len(next(iter(inputs.values())))
        slopes, carried = np.zeros((n, self.width)), np.zeros((len(self.keys), self.width))
        for lane, (names, shape) in enumerate(begin, self.directions - len(begin)):
            for row, (state, back) in enumerate(self.keys):
                if self.layout.states[state] in names:
                    carried[row, lane] = shape[self.layout.depth - back]
        states = {name: np.empty(n) for name in self.layout.states}
        move = self.compiled.over(inputs, initial, states, (slopes, carried))
        return Walk(states, slopes[:, : self.directions + 1], move)


class Extended:
    """The same where tangents of long lags would be carried: the derivatives are further states of the recursion."""

    def __init__(self, recursion: Recursion, parameters: Sequence[Any], groups: Any, output: Any):
        made, moved = sensitivities(recursion, parameters, groups)
        self.compiled, self.moved, self.output = compile(made), moved, output

    def over(self, inputs: Mapping[str, Array], initial: Mapping[str, Any], begin: Begin) -> Walk:
        """Return the run over some samples."""
        n = len(next(iter(inputs.values())))
        start: dict[str, Any] = dict.fromkeys((s.name for d in self.moved for s in d.values()), 0.0)
        for (names, shape), direction in zip(begin, self.moved[len(self.moved) - len(begin) :], strict=True):
            start |= {moved.name: shape for state, moved in direction.items() if state.name in names}
        states = {name: np.empty(n) for name in self.compiled.layout.states}
        move = self.compiled.over(inputs, {**initial, **start}, states)
        columns = [(j, states[d[self.output].name]) for j, d in enumerate(self.moved) if self.output in d]
        slopes = np.zeros((n, len(self.moved) + 1))

        def run(theta: Array) -> None:
            move(theta)
            for j, column in columns:
                slopes[:, j] = column

        return Walk(states, slopes, run)


@lru_cache(maxsize=512)
def with_slopes(recursion: Recursion, groups: tuple[tuple[Any, ...], ...], output: Any) -> Tangents | Extended:
    """Return a compiled recursion with the derivatives of one of its states.

    Parameters
    ----------
    groups : tuples of states
        The starts of each move together, in one more direction behind those of the parameters.
    output : the state that is looked at
    """
    parameters = list(recursion.parameters)
    reads = recursion.graph.reads.values()
    longest = max((lags[-1] for read in reads for base, lags in read.items() if base in recursion.states), default=0)
    if longest > LONGEST:
        return Extended(recursion, parameters, groups, output)
    directions = len(parameters) + len(groups)
    plain, numbers = lifted(recursion)

    def make() -> tuple[Any, bytes]:
        from .machine.lanes import Lanes
        from .machine.native import coded

        at = recursion.states.index(output)
        lanes = Lanes.of(plain, Tangent.of(plain, parameters), groups, at)
        return (astuple(Layout.of(lanes.plan)), lanes.keys, lanes.width), coded(lanes.plan, lanes)

    found = kept(f"with slopes of {output.name} {len(groups)} {written(plain)}", make)
    return Tangents(*found, directions, numbers)
