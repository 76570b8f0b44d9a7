"""One run of a law's recursion, from rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...engines.compile import Compiled
from ...inversion.compensator import Compensator
from ...symbolic.signals import t
from ..simulate import fitted, named, rest_states, vector

Array = np.ndarray
FREE = 1e300  # in the place of an input, or of a hint, that is not given: the law takes its own


@dataclass(frozen=True)
class Prepared:
    """A law's recursion, what it is given with the time before the start in front, and where it starts."""

    compiled: Compiled
    given: Mapping[str, Array]
    initial: Mapping[str, float]
    theta: Any

    @classmethod
    def of(
        cls,
        law: Compensator,
        compiled: Compiled,
        target: Array,
        start: float,
        channels: Mapping[str, Any],
        beside: bool = True,
    ) -> Prepared:
        """Prepare a run; parameters as for `driven`."""
        given = _padded(law, compiled, target, channels)
        first = {name: float(c[0]) for name, c in given.items()}
        initial = rest_states(law.model, start, float(target[0]), first) if beside else {}
        initial |= {"m": start, law.model.output.name: float(target[0])}
        return cls(compiled, given, initial, fitted(law.model))

    @property
    def depth(self) -> int:
        """How many samples before the start the recursion needs."""
        return self.compiled.recursion.depth

    def run(
        self, more: Mapping[str, tuple[Array, float]], before: Mapping[str, Array], begin: int, end: int
    ) -> dict[str, Array]:
        """Run from a sample to another, from what stands before the first; NaN from where it diverges.

        Parameters
        ----------
        more : further inputs by name: (N,) array, and the value before it
        before : what an earlier run returned; empty for the first one
        """
        start, total = self.depth + begin, self.given["r"].size
        padded = {
            name: np.concatenate([np.full(self.depth, first), c, np.full(total - self.depth - c.size, c[-1])])
            for name, (c, first) in more.items()
        }
        stop = min(self.depth + end + self.compiled.recursion.lead, total)
        given = {name: column[:stop] for name, column in {**self.given, **padded}.items()}
        initial = {name: column[:start] for name, column in before.items()} or self.initial
        return self.compiled(given, self.theta, initial, start=start, on_divergence="nan")

    def shown(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Return every sequence, computed and given, from the first sample of the reference on."""
        return {name: run[self.depth :] for name, run in {**values, **self.given}.items()}


def driven(
    law: Compensator,
    compiled: Compiled,
    target: Array,
    start: float,
    channels: Mapping[str, Any],
    beside: bool = True,
    on_divergence: str = "raise",
) -> dict[str, Array]:
    """Return every sequence of a law, computed and given, from the first sample of the reference on.

    Parameters
    ----------
    compiled : the law's recursion, or one that is made of it
    target : (N,) array, the reference [unit of y]
    start : number, the input before it, at rest [unit of u]
    beside : whether the model runs beside the law
    """
    made = Prepared.of(law, compiled, target, start, channels, beside)
    runs = compiled(made.given, made.theta, made.initial, start=made.depth, output="m", on_divergence=on_divergence)
    return made.shown(runs)


def _padded(law: Compensator, compiled: Compiled, target: Array, channels: Mapping[str, Any]) -> dict[str, Array]:
    """Put the time before the start in front: everything rests at its first value; after the end at its last."""
    given = {"r": target, **{name: vector(c, f"channel {name}") for name, c in named(channels).items()}}
    depth, ahead, Ts = compiled.recursion.depth, 0, law.model.Ts or 1.0
    if t in compiled.recursion.inputs and "t" not in given:
        given["t"], ahead = np.arange(target.size) * Ts, compiled.recursion.lead
    padded = {n: np.concatenate([np.full(depth, c[0]), c, np.full(ahead, c[-1])]) for n, c in given.items()}
    if ahead:  # the law's own clock goes on
        padded["t"][depth + target.size :] += np.arange(1, ahead + 1) * Ts
    return padded
