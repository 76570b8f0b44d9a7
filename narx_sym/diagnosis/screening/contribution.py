"""What an effect adds along given sequences."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp

from ...engines.compile import Compiled, compile
from ...models.effects import Form
from ...symbolic.recursion import Recursion
from ...symbolic.signals import k, samples, signal

Array = np.ndarray


@lru_cache(maxsize=512)
def _reading(form: Form, parameters: tuple[Any, ...]) -> tuple[Recursion, Compiled, list[str]]:
    """Return the equations of an effect alone, compiled, and the names of its contributions."""
    outputs = [signal(f"z{i}") for i in range(len(form.z))]
    updates = (
        *((s.left, s.right) for s in form.states),
        *((o[k], e) for o, e in zip(outputs, form.z, strict=True)),
    )
    read = Recursion(updates, parameters)
    return read, compile(read), [o.name for o in outputs]


def contribution(form: Form, values: Mapping[Any, float], seen: Mapping[str, Array]) -> Array:
    """Return z of an effect along sequences of N samples, (N, coefficients); before all are there it rests.

    Parameters
    ----------
    form : Form
        The equations in the sequences' names.
    values : of its parameters
    """
    read, compiled, outputs = _reading(form, tuple(values))
    n = len(next(iter(seen.values())))
    if not read.inputs and not form.states:
        return np.tile([float(e.xreplace(dict(values))) for _, e in read.updates], (n, 1))
    depth = read.depth
    if n <= depth:
        return np.zeros((n, len(outputs)))  # it looks further back than the sequences are long
    initial = {}
    for state in form.states:
        at = {s: float(seen[s.base.name][max(0, depth - 1)]) for s in samples(state.initial)}
        initial[state.left.base.name] = float(sp.sympify(state.initial).xreplace(at))
    run = compiled(seen, list(values.values()), initial, on_divergence="nan")
    columns = np.column_stack([run[name] for name in outputs])
    columns[:depth] = columns[depth]
    return columns
