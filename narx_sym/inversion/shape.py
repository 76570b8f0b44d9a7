"""What an expression is along the whole line of one unknown: its pieces between kinks, and bounds of its slope."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import sympy as sp

from ..symbolic.functions import CLASSES, KINKED, X
from ..symbolic.identities import added
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import samples
from .solution import ROUNDED, apart, number, size_of

Bounds = tuple[float, float]
WHOLE: Bounds = (-math.inf, math.inf)
JUMPS = (sp.sign, sp.Heaviside, sp.Piecewise)
CONTINUOUS = (sp.tanh, sp.atan, sp.exp, sp.sin, sp.cos, sp.sinh, sp.asinh, sp.Abs, sp.Max, sp.Min)
MANY = 64  # shapes that nested kinks may take
FLAT = 1e-9  # a slope this much smaller than what is added up in it counts as flat
DIGITS = 4e-15  # of the steepest slope: one below it is of rounding, where numbers were added up before


# -- pieces between kinks --------------------------------------------------------------------------------------


class Undecided(Exception):  # noqa: N818
    """The order of two kinks, or the side of one, depends on samples."""


def _forms(expr: Any, w: Any) -> list[Any]:
    """Return every smooth expression that one with kinks may be."""
    if not any(n.has(w) for n in expr.atoms(*KINKED)):
        return [expr]
    row = CLASSES.get(type(expr))
    if row and row.sides:
        below, above = row.sides
        return [side.xreplace({X: f}) for f in _forms(expr.args[0], w) for side in (above, below)]
    if row and row.extreme:
        return [f for a in expr.args for f in _forms(a, w)]
    combined: list[tuple[Any, ...]] = [()]
    for a in expr.args:
        combined = [(*c, f) for c in combined for f in _forms(a, w)]
        if len(combined) > MANY:
            raise Undecided
    return [expr.func(*c) for c in combined]


def nodes_of(G: Any, w: Any) -> list[Any]:
    """Return what has kinks in w, in a fixed order."""
    return sorted((n for n in G.atoms(*KINKED) if n.has(w)), key=sp.default_sort_key)


def switching_of(node: Any, w: Any, values: Mapping[Any, Any]) -> list[tuple[Any, float]]:
    """Return where a node may have a kink, and the sign of the slope of what it looks at."""
    if CLASSES[type(node)].extreme:
        sides = [_forms(a, w) for a in node.args]
        forms = [f - g for i, one in enumerate(sides) for other in sides[i + 1 :] for f in one for g in other]
    else:
        forms = _forms(node.args[0], w)
    found = []
    for f in forms:
        slope = sp.expand(derivative(f, w))
        size = None if slope.has(w) else number(slope, values)
        if slope != 0 and size is None:
            raise Undecided
        if size:
            found.append((sp.expand(-sp.expand(f).xreplace({w: sp.S.Zero}) / slope), 1.0 if size > 0 else -1.0))
    return found


def same(one: Any, other: Any, values: Mapping[Any, Any]) -> bool:
    """Whether two places are one."""
    return apart(one, other, values) == 0


def breaks_of(G: Any, w: Any, values: Mapping[Any, Any]) -> list[Any]:
    """Return where a piecewise affine expression may have kinks."""
    found: list[Any] = []
    for node in nodes_of(G, w):
        for at, _ in switching_of(node, w, values):
            if not any(same(at, b, values) for b in found):
                found.append(at)
    return found


def places(G: Any, w: Any, values: Mapping[Any, Any]) -> list[Any]:
    """Return the kinks of any expression whose place is known: those that look at something affine in w."""
    found: list[Any] = []
    for node in nodes_of(G, w):
        try:
            found += [at for at, _ in switching_of(node, w, values) if not any(same(at, b, values) for b in found)]
        except Undecided:
            continue
    return found


def ordered(breaks: Sequence[Any], values: Mapping[Any, Any]) -> list[Any]:
    """Return the kinks from left to right."""
    places = []
    for b in breaks:
        place = number(b - breaks[0], values)
        if place is None:
            raise Undecided
        places.append(place)
    return [b for _, b in sorted(zip(places, breaks, strict=True), key=lambda p: p[0])]


def at_point(expr: Any, w: Any, point: Any, values: Mapping[Any, Any]) -> Any:
    """Return the smooth expression that one with kinks is at a point; at a kink itself a sign is zero."""
    if expr == w or not expr.has(w):
        return expr
    row = CLASSES.get(type(expr))
    if row and row.sides:
        inner = at_point(expr.args[0], w, point, values)
        value = apart(inner.xreplace({w: point}), sp.S.Zero, values)
        if value is None:
            raise Undecided
        size = added(size_of(part.xreplace({w: point}), values) for part in sp.Add.make_args(inner))
        return row.sides[value > 0].xreplace({X: inner}) if abs(value) > ROUNDED * size else sp.S.Zero
    arguments = [at_point(a, w, point, values) for a in expr.args]
    if row and row.extreme:
        best = arguments[0]
        for other in arguments[1:]:
            value = number((other - best).xreplace({w: point}), values)
            if value is None:
                raise Undecided
            if (value > 0) == (row.extreme == ">"):
                best = other
        return best
    return expr.func(*arguments)


@dataclass(frozen=True)
class Piece:
    """A piece between two kinks (None at the ends): affine, with its slope and the number of it (None where unknown).

    A quadratic piece has the curve too, half its second derivative, and the slopes at its kinks. What is added up in
    the slope has the size `made_of`.
    """

    expr: Any
    slope: Any
    size: float | None
    left: Any
    right: Any
    curve: Any = sp.S.Zero
    made_of: float = 0.0

    def flat(self, steepest: float, least: float = FLAT) -> bool:
        """Whether the slope is zero, or nearly so against what it is made of."""
        return self.size is not None and abs(self.size) <= max(least * self.made_of, DIGITS * steepest)

    def slopes(self, w: Any) -> list[Any]:
        """Return the slope, or that at each kink."""
        ends = [at for at in (self.left, self.right) if at is not None] if self.curve != 0 else []
        return [self.slope.xreplace({w: at}) for at in ends or [sp.S.Zero]]

    def rise(self, w: Any) -> Any:
        """Return a slope that has its direction: that at a kink, or a step inside where a curve begins flat."""
        slope = self.slopes(w)[0]
        at, inside = (self.right, -1) if self.left is None else (self.left, 1)
        return slope if slope != 0 or at is None else self.slope.xreplace({w: at + inside})

    def solve(self, target: Any, w: Any, side: int = 1) -> Any:
        """Return where the piece equals the target, written as short as it can be.

        A quadratic piece is solved from a kink, with the root next to it; `side` is the sign of the slope.
        """
        if self.curve != 0:
            at = self.right if self.left is None else self.left
            rise, slope = target - sp.expand(self.expr.xreplace({w: at})), sp.expand(self.slope.xreplace({w: at}))
            if slope == 0:  # a vertex: the form below would be 0/0 there
                return at + (1 if at == self.left else -1) * sp.sqrt(sp.Max(0, rise / self.curve))
            return at + 2 * rise / (slope + side * sp.sqrt(sp.Max(0, slope**2 + 4 * self.curve * rise)))
        zero = self.expr.xreplace({w: sp.S.Zero})
        forms = [sp.expand(target - zero) / self.slope if self.slope != 1 else sp.expand(target - zero)]
        for at in (self.left, self.right):
            if at is not None:
                rise = target - sp.expand(self.expr.xreplace({w: at}))
                forms.append(at + rise / self.slope)
        return min(forms, key=lambda f: (f.count_ops(), str(f)))


def pieces_of(G: Any, w: Any, breaks: Sequence[Any], values: Mapping[Any, Any]) -> list[Piece]:
    """Return the pieces from left to right; neighbours become one that are the same, and so at the kink itself."""
    pieces: list[Piece] = []
    for left, right in pairwise([None, *breaks, None]):
        if left is None and right is None:
            point: Any = sp.S.Zero
        elif left is None or right is None:
            point = right - 1 if left is None else left + 1
        else:
            point = (left + right) / 2
        expr = at_point(G, w, point, values)
        slope = derivative(expr, w)  # brackets are kept: they are the model's own
        slope = sp.expand(slope) if slope.has(w) else slope
        curve = derivative(slope, w) / 2
        if curve.has(w):
            raise Undecided
        if pieces and sp.expand(expr - pieces[-1].expr) == 0:
            here = at_point(G, w, left, values)
            if same(here.xreplace({w: left}), expr.xreplace({w: left}), values):
                left = pieces.pop().left
        pieces.append(Piece(expr, slope, None, left, right, curve))
    if len(pieces) == 1 and pieces[0].curve != 0:
        raise Undecided  # a curve without a kink has two sides
    return [replace(p, size=_size(p, w, values), made_of=max(size_of(s, values) for s in p.slopes(w))) for p in pieces]


def _size(piece: Piece, w: Any, values: Mapping[Any, Any]) -> float | None:
    """Return the number of a slope: of a curve the steepest one at its ends.

    Raises
    ------
    Undecided
        Where a curve turns back between two kinks.
    """
    found = [number(s, values) for s in piece.slopes(w)]
    known = [s for s in found if s is not None]
    if len(known) < len(found):
        return None
    if min(known) < 0 < max(known):
        raise Undecided
    return max(known, key=abs) if any(known) else number(piece.rise(w), values)


def smooth_part(expr: Any) -> Any:
    """Return an expression with constants in the place of its kinks."""
    return expr.replace(lambda e: isinstance(e, KINKED), lambda e: sp.Dummy(real=True))


# -- bounds of the slope ---------------------------------------------------------------------------------------


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


def parts_of(expr: Any, w: Any, values: Mapping[Any, Any]) -> list[Bounds]:
    """Return the finite bounds of what is added up in an expression."""
    found = [bounds(part, w, values) for part in sp.Add.make_args(sp.expand(expr))]
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
    if not e.has(w):
        value = number(e, values)
        if value is not None:
            return value, value
        return _function(e, [bounds(a, w, values) for a in e.args]) if isinstance(e, sp.Function) else WHOLE
    parts = [bounds(a, w, values) for a in e.args] if not isinstance(e, sp.Piecewise) else []
    if e.is_Add:
        return added(p[0] for p in parts), added(p[1] for p in parts)
    if e.is_Mul:
        return _product(parts)
    if e.is_Pow:
        return _power(parts[0], e.exp)
    if isinstance(e, sp.Piecewise):
        cases = [bounds(c.expr, w, values) for c in e.args]
        return min(c[0] for c in cases), max(c[1] for c in cases)
    return _function(e, parts)


def _product(parts: list[Bounds]) -> Bounds:
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


def keeps_sign(slope: Any, values: Mapping[Any, Any]) -> bool:
    """Whether a slope has the same sign for all samples: where it is made of one quantity, piece by piece."""
    z = sp.Dummy(real=True)
    looked_at = [n.args[0] for n in slope.atoms(sp.Abs) if samples(n.args[0])]
    if not looked_at:
        return False
    s = samples(looked_at[0])[0]
    rest = looked_at[0].xreplace({s: sp.S.Zero})
    alone = sp.expand(slope.xreplace({s: (z - rest) / derivative(looked_at[0], s)}))
    if samples(alone) or smooth_part(derivative(alone, z)).has(z):
        return False
    try:
        pieces = pieces_of(alone, z, ordered(breaks_of(alone, z, values), values), values)
    except Undecided:
        return False
    levels = [number(p.expr.xreplace({z: at}), values) for p in pieces for at in (p.left, p.right) if at is not None]
    outwards = [number(side * p.slope, values) for side, p in ((-1, pieces[0]), (1, pieces[-1]))]
    known = [e for e in (*levels, *outwards) if e is not None]
    if len(known) < len(levels) + 2 or 0 in levels:
        return False
    return min(known) >= 0 or max(known) <= 0
