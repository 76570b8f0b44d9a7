"""A recursion for other places: C99 source, Structured Text, JavaScript, a CasADi function, and what else registers.

Each target is one file beside this one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy as sp

from ..engines.compile import compile
from ..errors import ModelError
from ..inversion.solve import EDGE
from ..symbolic.functions import TABLE
from ..symbolic.recursion import Recursion
from ..symbolic.signals import samples
from .layout import newest, plain
from .registry import ROUNDINGS, Coefficients, Example, Request, target

CHECKED, LONGEST_CHECK = 48, 200  # samples of a self-test; a long delay adds its own
TELLING = 1e-3  # a self-test that rounding may move by more than this says nothing
DRAWN = 16  # runs with other last bits


def written(
    to: str,
    recursion: Recursion,
    values: Mapping[Any, float],
    name: str = "narx",
    single: bool = False,
    output: Any = None,
    initial: Mapping[Any, Any] | None = None,
    ranges: Mapping[str, Sequence[float]] | None = None,
    Ts: float | None = None,
    rest: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    coefficients: Coefficients = lambda equations: (),
    notes: Sequence[str] = (),
) -> Any:
    """Return a recursion for another place.

    Parameters
    ----------
    to : "c", "st" or another target of `narx_sym.codegen.registry`
    values : mapping from each parameter to its number
    name : str
        Of what is written: of a block, of a constant, the prefix of a type and its functions.
    single : bool
        Single precision instead of double.
    output : IndexedBase or its name, optional
        The state that a step returns; the last by default. (Sensitivities stand behind a model's output: name it.) Of
        several in a tuple, which CasADi returns together, it is the first.
    initial : mapping from states to expressions, optional
        What a state is at rest, in samples of other sequences; the rest values of all other states are arguments.
    ranges : mapping from names to (low, high), optional
        Where the self-test moves each input, and starts each state; by default around 0.
    Ts : float, optional
        Sampling time [s].
    rest : mapping from names to their usual values at rest
    units : mapping such as {"u": "V", "y": "um"}
    coefficients : function from equations to rows (coefficients as a text, their unit), for the comment on top
    notes : further sentences for the comment on top; the first of them stands above the equations

    Raises
    ------
    ModelError
        For a target that there is not, a name that cannot be one there, a missing value, a function that the target
        does not have, or an output that the recursion does not compute.
    """
    one = target(to)
    recursion = _in_single(recursion) if single else recursion
    missing = [p for p in recursion.parameters if p not in values]
    if missing:
        raise ModelError(f"No value was given for {', '.join(map(str, missing))}.")
    numbers = {p: sp.Float(values[p]) for p in recursion.parameters}
    outputs = tuple(_returned(recursion, one) for one in (output if isinstance(output, tuple) else (output,)))
    returned, starts = outputs[0], _starts(recursion, initial or {})
    return one.write(
        Request(
            recursion, numbers, name, single, returned, starts,
            [*_notes(recursion, returned, Ts, units or {}), *notes[1:]],
            lambda sampled: _example(recursion, numbers, returned, starts, ranges or {}, single, sampled),
            False, Ts, ranges or {}, rest or {}, units or {}, coefficients,
            notes[0] if notes else "", outputs,
        )
    )  # fmt: skip


def _returned(recursion: Recursion, output: Any) -> Any:
    wanted = str(getattr(output, "label", recursion.states[-1].label if output is None else output))
    returned = next((base for base in recursion.states if base.name == wanted), None)
    if returned is None:
        raise ModelError(f"The recursion does not compute {wanted}; it has {', '.join(map(str, recursion.states))}.")
    return returned


def _in_single(recursion: Recursion) -> Recursion:
    """Keep in single precision what stands just inside a limit of a bounded function: on it there is no inverse.

    For a tanh it would be rounded to 1, for an atan beyond pi/2.
    """
    limits = {abs(float(v)) for row in TABLE if row.inverse is not None for v in row.values}
    inside = {}
    for one in (n for _, e in recursion.updates for n in e.atoms(sp.Float, sp.Add) if n.is_number):
        for limit in limits:
            if 0 < limit - abs(float(one)) < 2 * EDGE:
                inside[one] = sp.sign(one) * sp.Float(float(np.nextafter(np.float32(limit), np.float32(0))))
    return Recursion(tuple((left, e.xreplace(inside)) for left, e in recursion.updates), recursion.parameters)


def _starts(recursion: Recursion, initial: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return what the states are at rest."""
    found = {base: sp.sympify(initial[base]) for base in recursion.states if base in initial}
    for base, e in found.items():
        if e.free_symbols - {symbol for s in samples(e) for symbol in s.free_symbols} - set(recursion.parameters):
            raise ModelError(f"The initial value of {base.label} must contain signals and numbers only.")
    return found


def _notes(recursion: Recursion, returned: Any, Ts: float | None, units: Mapping[str, str]) -> list[str]:
    """Return what the comment on top says: the sampling time, and units of what is taken and returned."""
    said = [
        f"{plain(base)} in {plain(units[base.name])}" for base in (*recursion.inputs, returned) if units.get(base.name)
    ]
    return [
        *([] if Ts is None else [f"Sampling time: {Ts:.10g} s."]),
        *([f"Units: {', '.join(said)}."] if said else []),
    ]


def _example(
    recursion: Recursion,
    numbers: Mapping[Any, Any],
    output: Any,
    initial: Mapping[Any, Any],
    ranges: Mapping[str, Sequence[float]],
    single: bool,
    sampled: bool,
) -> Example | None:
    """Run a recursion from rest, every input along its own wave; smaller waves where that diverges.

    A wave along which the last bits decide (a sign of what should be zero, an unstable run) is no test of the code.
    """
    theta = np.array([float(v) for v in numbers.values()])
    depth, still = recursion.depth, recursion.depth + recursion.lead + 1
    n = CHECKED + min(depth, LONGEST_CHECK)
    phases = np.maximum(np.arange(n + still + recursion.lead) - still, 0) / 3
    compiled = compile(recursion)  # not by the python engine: it is written by the same walk
    for size in (1.0, 0.1, 0.01):
        waves, rest = {}, {}
        for i, base in enumerate((*recursion.inputs, *recursion.states)):
            low, high = ranges.get(base.name, (-1.0, 1.0))
            waves[base] = (low + high) / 2 + size * (high - low) / 2 * np.sin((1 + i / 7) * phases + 0.7 * i + 0.3)
            rest[base] = float(waves[base][0])
        start = {b: rest[b] for b in recursion.states}
        for base, e in initial.items():
            known = {s: sp.Float(rest.setdefault(s.base, 0.0)) for s in samples(e)}
            start[base] = float(e.xreplace({**numbers, **known}))
        inputs = {b: waves[b] for b in recursion.inputs}

        def run(bits: Any, given: Any = inputs, begin: Any = start) -> Any:
            # One factor for each wave: what rests goes on resting.
            waved, begun = ({b: x * bits(1)[0] for b, x in of.items()} for of in (given, begin))
            moved = compiled(waved, theta * bits(theta.size), begun, length=phases.size, on_divergence="nan")
            return moved[output.name][depth : depth + n]

        expected, rounding = run(np.ones), 0.0
        rng, eps = np.random.default_rng(0), float(np.finfo("f" if single else "d").eps)
        for _ in range(DRAWN if np.all(np.isfinite(expected)) else 0):
            other = run(lambda size, rng=rng, eps=eps: 1.0 + eps * rng.uniform(-1, 1, size))
            with np.errstate(all="ignore"):
                rounding = max(rounding, float(np.abs((other - expected) / (1.0 + np.abs(expected))).max()))
        if np.all(np.isfinite(expected)) and rounding * ROUNDINGS < TELLING:
            taken = newest(recursion, sampled)
            return Example({b: waves[b][depth - i :][:n] for b, i in taken.items()}, rest, expected, rounding)
    return None
