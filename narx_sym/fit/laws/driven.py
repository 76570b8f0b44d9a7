"""One run of a law's recursion, from rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...engines.compile import Compiled
from ...inversion.compensator import Compensator
from ...symbolic.signals import t
from ..simulate import fitted, rest_states, vector

Array = np.ndarray


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
    given = _padded(law, compiled, target, channels)
    first = {name: float(c[0]) for name, c in given.items()}
    initial = rest_states(law.model, start, float(target[0]), first) if beside else {}
    initial |= {"m": start, str(law.model.output.label): float(target[0])}
    depth = compiled.recursion.depth
    runs = compiled(given, fitted(law.model), initial, start=depth, output="m", on_divergence=on_divergence)
    return {name: run[depth:] for name, run in (runs | given).items()}


def _padded(law: Compensator, compiled: Compiled, target: Array, channels: Mapping[str, Any]) -> dict[str, Array]:
    """Put the time before the start in front: everything rests at its first value; after the end at its last."""
    given = {"r": target, **{name: vector(c, f"channel {name}") for name, c in channels.items()}}
    depth, ahead, Ts = compiled.recursion.depth, 0, law.model.Ts or 1.0
    if t in compiled.recursion.inputs and "t" not in given:
        given["t"], ahead = np.arange(target.size) * Ts, compiled.recursion.lead
    padded = {n: np.concatenate([np.full(depth, c[0]), c, np.full(ahead, c[-1])]) for n, c in given.items()}
    if ahead:  # the law's own clock goes on
        padded["t"][depth + target.size :] += np.arange(1, ahead + 1) * Ts
    return padded
