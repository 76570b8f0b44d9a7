"""Whether an expression rises or falls along the whole line of one unknown: bounds of its slope, by its tree."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import sympy as sp

from ..symbolic.sensitivity import derivative
from .solution import number

Bounds = tuple[float, float]
WHOLE: Bounds = (-math.inf, math.inf)
JUMPS = (sp.sign, sp.Heaviside, sp.Piecewise)
CONTINUOUS = (sp.tanh, sp.atan, sp.exp, sp.sin, sp.cos, sp.sinh, sp.asinh, sp.Abs, sp.Max, sp.Min)
SURE = 1e-9  # relative: a slope nearer to zero than this may be one of rounding


def steepness(G: Any, w: Any, values: Mapping[Any, Any]) -> float | None:
    """Return a number that the slope of G in w is never nearer to zero than, or None where there is none to be proved.

    With such a number a continuous G reaches every target exactly once: it rises, or falls, without bound.
    """
    if not _continuous(G, w, values):
        return None
    low, high = bounds(derivative(G, w), w, values)
    least = max(low, -high)
    return least if least > SURE * max(1.0, min(abs(low), abs(high))) else None


def _continuous(G: Any, w: Any, values: Mapping[Any, Any]) -> bool:
    """Whether nothing in G can jump or have a pole along the whole line of w."""
    for n in G.atoms(sp.Function, sp.Piecewise, sp.Pow, sp.Max, sp.Min):
        if not n.has(w):
            continue
        if isinstance(n, sp.Pow):
            low, high = bounds(n.base, w, values) if n.base.has(w) else (1.0, 1.0)
            whole = n.exp.is_Integer and n.exp >= 1
            if n.exp.has(w) or not (whole or low > 0 or (n.exp.is_Integer and high < 0)):
                return False
        elif type(n) not in CONTINUOUS:
            return False
    return True


def bounds(e: Any, w: Any, values: Mapping[Any, Any]) -> Bounds:
    """Return bounds of an expression over all real w; infinite where they depend on samples."""
    if e == w:
        return WHOLE
    if not e.has(w):
        value = number(e, values)
        if value is not None:
            return value, value
        return _function(e, [bounds(a, w, values) for a in e.args]) if isinstance(e, sp.Function) else WHOLE
    parts = [bounds(a, w, values) for a in e.args] if not isinstance(e, sp.Piecewise) else []
    if e.is_Add:
        return sum(p[0] for p in parts), sum(p[1] for p in parts)
    if e.is_Mul:
        return _product(e, parts)
    if e.is_Pow:
        return _power(parts[0], e.exp)
    if isinstance(e, sp.Piecewise):
        cases = [bounds(c.expr, w, values) for c in e.args]
        return min(c[0] for c in cases), max(c[1] for c in cases)
    return _function(e, parts)


def _product(e: Any, parts: list[Bounds]) -> Bounds:
    low, high = 1.0, 1.0
    for one in parts:
        ends = [0.0 if a == 0 or b == 0 else a * b for a in (low, high) for b in one]
        low, high = min(ends), max(ends)
    return low, high


def _power(base: Bounds, exponent: Any) -> Bounds:
    if not exponent.is_Integer or exponent < 1:
        return (0.0, math.inf) if base[0] >= 0 else WHOLE
    n = int(exponent)
    ends = sorted(_raised(b, n) for b in base)
    if n % 2 == 0 and base[0] < 0 < base[1]:
        ends[0] = 0.0
    return ends[0], ends[1]


def _raised(x: float, n: int) -> float:
    try:
        return x**n
    except OverflowError:
        return math.inf if x > 0 or n % 2 == 0 else -math.inf


RISING: dict[Any, Any] = {
    sp.tanh: math.tanh, sp.atan: math.atan, sp.exp: lambda x: math.inf if x > 700 else math.exp(x),
    sp.sign: lambda x: math.copysign(1.0, x) if x else 0.0, sp.Heaviside: lambda x: float(x > 0),
}  # fmt: skip


def _function(e: Any, parts: list[Bounds]) -> Bounds:
    if type(e) in RISING:
        low, high = (RISING[type(e)](p) for p in parts[0])
        return low, high
    if isinstance(e, sp.Abs):
        low, high = parts[0]
        return (0.0 if low < 0 < high else min(abs(low), abs(high))), max(abs(low), abs(high))
    if isinstance(e, (sp.Max, sp.Min)):
        best = max if isinstance(e, sp.Max) else min
        return best(p[0] for p in parts), best(p[1] for p in parts)
    return (-1.0, 1.0) if isinstance(e, (sp.sin, sp.cos)) else WHOLE
