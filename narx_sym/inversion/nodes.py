"""Equations in one unknown whose kinks change their order from sample to sample: a search over the kinks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp

from ..symbolic.functions import CLASSES, X, within
from ..symbolic.identities import added
from ..symbolic.printing import text
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import signal
from .shape import (
    DIGITS,
    FLAT,
    Piece,
    Undecided,
    bounds,
    breaks_of,
    nodes_of,
    parts_of,
    same,
    smooth_part,
    switching_of,
)
from .solution import Branch, Solution, number, resting, size_of


def _beside(G: Any, w: Any, side: int, values: Mapping[Any, Any], at: Any = None) -> Any:
    """Return the limit of an expression at any w from the left (-1) or the right (1): signs take that side at zero.

    `at` is where w is known to be, so that rounding does not decide.
    """
    taken: dict[Any, Any] = {}
    for node in (n for n in nodes_of(G, w) if isinstance(n, (sp.sign, sp.Heaviside))):
        for place, direction in switching_of(node, w, values):
            up = side * direction > 0
            low = sp.S.Zero if isinstance(node, sp.Heaviside) else sp.S.NegativeOne
            argument = node.args[0]
            condition = argument >= 0 if up else argument > 0
            if at is not None and same(place, at, values):
                taken[node] = sp.S.One if up else low
            else:
                taken.setdefault(node, sp.Piecewise((1, condition), (low, True)))
    return G.xreplace(taken)


def solve_nodes(G: Any, w: Any, target: Any, values: Mapping[Any, Any], made: dict[str, Any]) -> Solution | None:
    """Solve where the order of the kinks depends on samples: the map is a line between neighbouring kinks.

    The nearest kinks whose levels lie below and above the target are found first. (A sum of plays is inverted so;
    Krejci & Kuhnen 2001 sort the thresholds instead.)
    """
    if smooth_part(derivative(G, w)).has(w):
        return None
    try:
        breaks = breaks_of(G, w, values)
        ends = [_far(G, w, side, values) for side in (-1, 1)]
    except Undecided:
        return None
    slopes = [sp.expand(derivative(e, w)) for e in ends]
    sizes = [s for s in (number(e, values) for e in slopes) if s is not None]
    if len(sizes) < 2 or not any(sizes):
        return None
    flip = 1 if max(sizes, key=abs) > 0 else -1
    rising = _rising(flip * G, w, breaks, values)
    if rising is None:
        return None  # the levels must rise from kink to kink
    flat, jumps = rising
    T, index, name = flip * target, made["unknown"].indices[0], made["unknown"].base.name
    steps: list[tuple[str, Any]] = []

    def step(what: str, expr: Any) -> Any:
        steps.append((f"{name}_{what}", expr))
        return signal(f"{name}_{what}")[index]

    def level(what: str, side: int, place: Any, at: Any = None) -> Any:
        return step(what, flip * _beside(G, w, side, values, at).xreplace({w: place}))

    def best(what: str, start: Any, better: Any) -> Any:
        """Go through the kinks and keep the better one: Max of many arguments is slow in SymPy."""
        kept = start
        for i, (p, low, high) in enumerate(listed, 1):
            if p != kept:
                kept = step(f"{what}{i}", sp.Piecewise((p, better(p, low, high, kept)), (kept, True)))
        return kept

    listed = []
    for i, (b, jump) in enumerate(zip(breaks, jumps, strict=True), 1):
        p = step(f"kink{i}", b)
        low = level(f"level{i}", -1, p, b)
        listed.append((p, low, level(f"over{i}", 1, p, b) if jump else low))
    first = best("first", listed[0][0], lambda p, low, high, kept: p < kept)
    end = best("last", listed[0][0], lambda p, low, high, kept: p > kept)
    below = best("below", first, lambda p, low, high, kept: sp.And(high <= T, p > kept))
    above = best("above", end, lambda p, low, high, kept: sp.And(low >= T, p < kept))
    bottom, top = level("bottom", -1, first), level("top", 1, end)
    lower, upper = level("lower", 1, below), level("upper", -1, above)
    outside, limited = _outside(ends, slopes, (first, end), target, made["last"], w, values)
    branches = (
        *([resting(**made)] if any(jumps) or flat else []),
        Branch(T < bottom, outside[0]),
        Branch(T > top, outside[1]),
        *(Branch(sp.And(low <= T, high >= T), p) for p, low, high in listed if low != high),
        Branch(sp.Or(above <= below, upper <= lower), within(made["last"], above, below)),
        Branch(sp.true, below + (above - below) * (T - lower) / (upper - lower)),
    )
    held = text(made["unknown"])
    notes = [f"no {held} within a jump of the sign: it stays at the jump"] if any(jumps) else []
    if limited:
        notes.append("an end is flat: nothing is reached beyond its level")
    several = (f"many {held} may give one {text(target)}, where it is flat",) if flat else ()
    return Solution(how="nodes", branches=branches, steps=tuple(steps), notes=tuple(notes), flat=several, **made)


def _outside(
    ends: Sequence[Any],
    slopes: Sequence[Any],
    kinks: Sequence[Any],
    target: Any,
    last: Any,
    w: Any,
    values: Mapping[Any, Any],
) -> tuple[list[Any], bool]:
    """Return the solutions beyond the outermost kinks, and whether an end is flat: nothing is reached beyond it.

    On a flat end it is the value nearest to the last one.
    """
    sizes = [number(s, values) or 0.0 for s in slopes]
    steepest, found, limited = max(map(abs, sizes)), [], False
    for end, slope, size, at, inner in zip(ends, slopes, sizes, kinks, (sp.Min, sp.Max), strict=True):
        piece = Piece(end, slope, size, None, None, made_of=size_of(slope, values))
        flat = piece.flat(steepest)
        found.append(inner(last, at) if flat else piece.solve(target, w))
        limited |= flat
    return found, limited


def _rising(G: Any, w: Any, breaks: Sequence[Any], values: Mapping[Any, Any]) -> tuple[bool, list[float]] | None:
    """Return whether some slope may be zero, and the jumps at the kinks; None where one falls, or may."""
    slope = derivative(G, w)
    growth = bounds(slope, w, values)[0]
    sizes = [sorted(e for e in map(abs, part) if math.isfinite(e)) for part in parts_of(slope, w, values)]
    rounding = FLAT * added(part[0] for part in sizes) + DIGITS * added(part[-1] for part in sizes)
    try:
        jumps = [_jump(G, w, b, values) for b in breaks]
    except Undecided:
        return None
    return None if growth < -rounding or any(j < 0 for j in jumps) else (growth <= rounding, jumps)


def _jump(G: Any, w: Any, at: Any, values: Mapping[Any, Any]) -> float:
    """Return by how much an expression jumps where some of its signs turn.

    Raises
    ------
    Undecided
        Where that depends on samples, and for a step inside a step.
    """
    turned, jumping = {}, [n for n in nodes_of(G, w) if isinstance(n, (sp.sign, sp.Heaviside))]
    for node in jumping:
        for place, direction in switching_of(node, w, values):
            if same(place, at, values):
                turned[node] = direction if isinstance(node, sp.sign) else direction / 2
    if not turned:
        return 0.0
    if any(n != other and (n.has(other) or other.has(n)) for n in turned for other in jumping):
        raise Undecided
    held = {n: sp.Dummy(real=True) for n in turned}
    change = sp.expand(sum(derivative(G.xreplace(held), held[n]) * 2 * sp.Float(s) for n, s in turned.items()))
    size = None if change.has(w) else number(change, values)
    if size is None:
        raise Undecided
    return size


def _far(expr: Any, w: Any, side: int, values: Mapping[Any, Any]) -> Any:
    """Return the affine expression that one with kinks is far to the left (-1) or to the right (1)."""

    def sign_of(e: Any) -> float:
        slope = number(derivative(e, w), values)
        value = side * slope if slope else number(e, values)
        if slope is None or value is None:
            raise Undecided
        return value

    if expr == w or not expr.has(w):
        return expr
    arguments = [_far(a, w, side, values) for a in expr.args]
    row = CLASSES.get(type(expr))
    if row and row.sides:
        return row.sides[sign_of(arguments[0]) > 0].xreplace({X: arguments[0]})
    if row and row.extreme:
        best = arguments[0]
        for other in arguments[1:]:
            best = other if (sign_of(other - best) > 0) == (row.extreme == ">") else best
        return best
    return expr.func(*arguments)
