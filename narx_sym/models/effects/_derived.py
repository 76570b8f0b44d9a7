"""What follows from an effect's equations: what it is at a limit of its shape, and how it shows.

Equations are compared in numbers, at points at which every sample has a value of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import takewhile
from math import inf, nan
from random import Random
from typing import Any

import sympy as sp

from ...symbolic.signals import k, lag, samples, signal

POINTS, EXACT = 12, 1e-9  # where equations are compared; what is no difference there
FAR = {0.0: 1e-12, inf: 1e9}  # in the place of a limit
WITHIN, BEYOND = 0.3, 3.0  # of a limit
MIDDLE = 0.7  # a shape parameter
X = sp.Symbol("x", real=True)  # the present sample of what drives an effect


def at_limit(one: Any, others: Iterable[Any]) -> tuple[str, float, str] | tuple[()]:
    """Return at which value of a shape parameter, 0 or infinite, an effect is another one: (parameter, value, id)."""
    for other in others:
        gone = [p for p in one.shape if p not in other.shape]
        alike = other.id != one.id and other.standing == one.standing and {*other.places} & {*one.places}
        if len(gone) != 1 or not alike or tuple(p for p in one.shape if p != gone[0]) != other.shape:
            continue
        for value, near in FAR.items():
            same = list(takewhile(_equal, zip(_values(one, {gone[0]: near}), _values(other, {}), strict=True)))
            if len(same) == POINTS and any(abs(value) > EXACT for _, wanted in same for value in wanted):
                return gone[0], value, other.id
    return ()


def taylor(one: Any, others: Iterable[Any]) -> tuple[int, str] | tuple[()]:
    """Return the degree n of an effect x[k]^n, and which other one begins with minus that in its Taylor series."""
    z = _alone(one)
    if z is None or not (z.is_Pow and z.base == X and z.exp > 1):
        return ()
    for other in others:
        series = _alone(other) if other.id != one.id and {*other.places} & {*one.places} else None
        if series is None or series.is_Pow:
            continue
        orders = (series.diff(X, n).xreplace({X: sp.S.Zero}) for n in range(1, int(z.exp) + 1))
        first = next(((n, c) for n, c in enumerate(orders, 1) if c != 0), (0, sp.S.Zero))
        if first[0] == z.exp and first[1].is_negative:
            return int(z.exp), other.id
    return ()


def ends(one: Any) -> bool:
    """Whether it is the end of a way: held at a place it is nothing there, and acts only beyond a limit."""
    if {"input", "friction"} & {*one.places} or not one.shape or "channel" in one.arguments or "t" in one.arguments:
        return False
    form = one.equations(**_shape(one, {}))
    moves = 0.0 if "motion" in one.places else 1.0

    def held(level: float) -> bool:
        return any(abs(_number(z, {"x": moves * level}, level)) > EXACT for z in form.z)

    return not form.states and not held(WITHIN) and not held(-WITHIN) and (held(BEYOND) or held(-BEYOND))


def alike(form: Any) -> bool:
    """Whether its contributions are the same equation of one state each."""
    states = {s.left: signal(f"state{i}")[k] for i, s in enumerate(form.states)}
    own = [[s for s in states if z.has(s)] for z in form.z]
    if len(form.z) < 2 or any(len(one) != 1 for one in own):
        return False
    common = signal("common")[k]
    return len({z.xreplace({one[0]: common}) for z, one in zip(form.z, own, strict=True)}) == 1 and len(
        {one[0] for one in own}
    ) == len(own)


@lru_cache(maxsize=512)
def _alone(one: Any) -> Any:
    """Return a power or a smooth function of the present sample alone that an effect contributes; None else."""
    if "steps" in {s.of for s in one.scan.values()}:
        return None
    form, now = one.equations(Ts=sp.Float(0.01)), signal("x")[k]
    z = form.z[0]
    smooth = z.is_Pow or (z.has(sp.tanh, sp.sin) and not z.has(sp.Abs, sp.Max, sp.Min, sp.sign))
    return z.xreplace({now: X}) if smooth and len(form.z) == 1 and not form.states and samples(z) == [now] else None


def _shape(one: Any, given: Mapping[str, float]) -> dict[str, Any]:
    """Return numbers for the shape parameters, and for the sampling time."""
    numbers = {p: 2 if s.of == "steps" else sp.Float(given.get(p, MIDDLE)) for p, s in one.scan.items()}
    return {"Ts": sp.Float(0.01), **numbers}


@lru_cache(maxsize=512)
def _seen(name: str, back: int, point: int) -> float:
    """Return what a sample is at a point: between -3 and 3, another number for each."""
    return Random(f"{name} {back} {point}").uniform(-3.0, 3.0)


def _number(expr: Any, known: Mapping[str, float], level: float | None = None, point: int = 0) -> float:
    """Return the value of an expression where every sample has one: that of `known`, a level, or that of a point."""
    held = {
        s: sp.Float(known[str(s.base)] if str(s.base) in known and not lag(s) else value)
        for s in samples(expr)
        for value in [_seen(str(s.base), lag(s), point) if level is None else level]
    }
    value = sp.sympify(expr).xreplace(held)
    return float(value) if value.is_number and value.is_extended_real else nan


def _values(one: Any, given: Mapping[str, float]) -> Iterator[list[float]]:
    """Give what an effect contributes at each point."""
    form = one.equations(**_shape(one, given))
    for point in range(POINTS):
        known: dict[str, float] = {}
        for state in form.states:
            known[str(state.left.base)] = _number(state.right, known, None, point)
        yield [_number(z, known, None, point) for z in form.z]


def _equal(pair: tuple[list[float], list[float]]) -> bool:
    """Whether two effects contribute the same at a point."""
    found, wanted = pair
    return len(found) == len(wanted) and all(abs(a - b) < EXACT for a, b in zip(found, wanted, strict=True))
