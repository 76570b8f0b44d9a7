"""Bounds of a slope along the whole line of one unknown: they prove that an expression rises, or falls."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import reduce
from typing import Any

import sympy as sp

from ..symbolic.identities import added, expanded
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import samples
from .breakpoints import DIGITS, FLAT, JUMPS, Undecided, breakpoints, nodes_of, ordered, pieces_of, smooth_part
from .solution import number

Bounds = tuple[float, float]
WHOLE: Bounds = (-math.inf, math.inf)
CONTINUOUS = (sp.tanh, sp.atan, sp.exp, sp.sin, sp.cos, sp.sinh, sp.asinh, sp.Abs, sp.Max, sp.Min)


def steepness(G: Any, w: Any, values: Mapping[Any, Any]) -> float | None:
    """Return a number that the slope of G in w is never nearer to zero than, or None where there is none to be proved.

    With such a number a continuous G reaches every target exactly once: it rises, or falls, without bound.
    """
    if not _continuous(G, w, values):
        return None
    slope = derivative(G, w)
    low, high = bounds(slope, w, values)
    least = max(low, -high)
    return least if least > FLAT * added(min(map(abs, part)) for part in parts_of(slope, w, values)) else None


def rising(G: Any, w: Any, values: Mapping[Any, Any]) -> tuple[bool, bool] | None:
    """Return whether some slope may be zero, and whether there are jumps; None where G may fall, or jump down."""
    slope, jumping = derivative(G, w), [n for n in nodes_of(G, w) if isinstance(n, JUMPS)]
    sizes = [sorted(e for e in map(abs, part) if math.isfinite(e)) for part in parts_of(slope, w, values)]
    rounding = FLAT * added(part[0] for part in sizes) + DIGITS * added(part[-1] for part in sizes)
    least = bounds(slope, w, values)[0]
    for node in jumping:
        held = sp.Dummy(real=True)
        up = derivative(G.xreplace({node: held}), held) * derivative(node.args[0], w)
        if any(n != node and n.has(node) for n in jumping) or bounds(up, w, values)[0] < 0:
            return None
    return None if least < -rounding else (least <= rounding, bool(jumping))


def parts_of(expr: Any, w: Any, values: Mapping[Any, Any]) -> list[Bounds]:
    """Return the finite bounds of what is added up in an expression."""
    found = [bounds(part, w, values) for part in sp.Add.make_args(expanded(expr))]
    return [part for part in found if math.isfinite(min(map(abs, part)))]


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
    if not e.has(w) and (value := number(e, values)) is not None:
        return value, value
    if isinstance(e, sp.Piecewise) and e.has(w):
        cases = [bounds(c.expr, w, values) for c in e.args]
        return min(c[0] for c in cases), max(c[1] for c in cases)
    if not e.has(w) and not isinstance(e, sp.Function):
        return WHOLE
    parts = [bounds(a, w, values) for a in e.args]
    if e.is_Add:
        return added(p[0] for p in parts), added(p[1] for p in parts)
    if e.is_Mul:
        return reduce(_product, parts)
    return _power(*parts[0], e.exp) if e.is_Pow else _function(e, parts)


def _function(e: Any, parts: list[Bounds]) -> Bounds:
    low, high = parts[0]
    if type(e) in RISING:
        return float(RISING[type(e)](low)), float(RISING[type(e)](high))
    if isinstance(e, sp.Abs):
        return (0.0 if low < 0 < high else min(abs(low), abs(high))), max(abs(low), abs(high))
    if isinstance(e, (sp.Max, sp.Min)):
        best = max if isinstance(e, sp.Max) else min
        return best(p[0] for p in parts), best(p[1] for p in parts)
    return (-1.0, 1.0) if isinstance(e, (sp.sin, sp.cos)) else WHOLE


def _product(one: Bounds, other: Bounds) -> Bounds:
    ends = [0.0 if a == 0 or b == 0 else a * b for a in one for b in other]
    return min(ends), max(ends)


def _power(low: float, high: float, exponent: Any) -> Bounds:
    if not exponent.is_Integer or exponent < 1:
        return (0.0, math.inf) if low >= 0 else WHOLE
    even = exponent % 2 == 0
    try:
        ends = sorted(b ** int(exponent) for b in (low, high))
    except OverflowError:
        return (0.0, math.inf) if even or low >= 0 else WHOLE
    return (0.0 if even and low < 0 < high else ends[0]), ends[1]


RISING: dict[Any, Any] = {
    sp.tanh: math.tanh, sp.atan: math.atan, sp.exp: lambda x: math.inf if x > 700 else math.exp(x),
    sp.sign: lambda x: math.copysign(1.0, x) if x else 0.0, sp.Heaviside: lambda x: x > 0,
}  # fmt: skip


def keeps_sign(slope: Any, values: Mapping[Any, Any]) -> bool:
    """Whether a slope has the same sign for all samples: where it is made of one quantity, piece by piece."""
    z = sp.Dummy(real=True)
    looked_at = [n.args[0] for n in slope.atoms(sp.Abs) if samples(n.args[0])]
    if not looked_at:
        return False
    s = samples(looked_at[0])[0]
    rest = looked_at[0].xreplace({s: sp.S.Zero})
    alone = expanded(slope.xreplace({s: (z - rest) / derivative(looked_at[0], s)}))
    if samples(alone) or smooth_part(derivative(alone, z)).has(z):
        return False
    try:
        pieces = pieces_of(alone, z, ordered(breakpoints(alone, z, values), values), values)
    except Undecided:
        return False
    levels = [number(p.expr.xreplace({z: at}), values) for p in pieces for at in (p.left, p.right) if at is not None]
    outwards = [number(side * p.slope, values) for side, p in ((-1, pieces[0]), (1, pieces[-1]))]
    known = [e for e in (*levels, *outwards) if e is not None]
    if len(known) < len(levels) + 2 or 0 in levels:
        return False
    return min(known) >= 0 or max(known) <= 0
