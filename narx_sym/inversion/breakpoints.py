"""The pieces of an expression in one unknown, between the breakpoints that its kinks and jumps make."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import sympy as sp

from ..symbolic.functions import CLASSES, KINKED, X
from ..symbolic.identities import added, expanded
from ..symbolic.sensitivity import derivative
from .solution import ROUNDED, apart, number, size_of

JUMPS = (sp.sign, sp.Heaviside, sp.Piecewise)
MANY = 64  # shapes that nested kinks may take
FLAT = 1e-9  # a slope this much smaller than what is added up in it counts as flat
DIGITS = 4e-15  # of the steepest slope: one below it is of rounding, where numbers were added up before


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


def switching_of(node: Any, w: Any, values: Mapping[Any, Any]) -> list[Any]:
    """Return where a node may have a kink."""
    if CLASSES[type(node)].extreme:
        sides = [_forms(a, w) for a in node.args]
        forms = [f - g for i, one in enumerate(sides) for other in sides[i + 1 :] for f in one for g in other]
    else:
        forms = _forms(node.args[0], w)
    found = []
    for f in forms:
        slope = expanded(derivative(f, w))
        size = None if slope.has(w) else number(slope, values)
        if slope != 0 and size is None:
            raise Undecided
        if size:
            found.append(expanded(-expanded(f).xreplace({w: sp.S.Zero}) / slope))
    return found


def same(one: Any, other: Any, values: Mapping[Any, Any]) -> bool:
    """Whether two places are one."""
    return apart(one, other, values) == 0


def breakpoints(G: Any, w: Any, values: Mapping[Any, Any], known: bool = False) -> list[Any]:
    """Return where an expression may have kinks; `known` leaves those out that are no affine function's zero.

    Raises
    ------
    Undecided
        Where there is such a one.
    """
    found: list[Any] = []
    for node in nodes_of(G, w):
        try:
            found += [at for at in switching_of(node, w, values) if not any(same(at, b, values) for b in found)]
        except Undecided:
            if not known:
                raise
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


def smooth_form(expr: Any, w: Any, side_of: Callable[[Any], float]) -> Any:
    """Return the smooth expression that one with kinks is where a function says the sign of what each looks at."""
    if expr == w or not expr.has(w):
        return expr
    arguments, row = [smooth_form(a, w, side_of) for a in expr.args], CLASSES.get(type(expr))
    if row and row.sides:
        side = side_of(arguments[0])
        return row.sides[side > 0].xreplace({X: arguments[0]}) if side else sp.S.Zero
    if row and row.extreme:
        best = arguments[0]
        for other in arguments[1:]:
            best = other if (side_of(other - best) > 0) == (row.extreme == ">") else best
        return best
    return expr.func(*arguments)


def at_point(expr: Any, w: Any, point: Any, values: Mapping[Any, Any]) -> Any:
    """Return the smooth expression that one with kinks is at a point; at a kink itself a sign is zero."""

    def side_of(e: Any) -> float:
        value = apart(e.xreplace({w: point}), sp.S.Zero, values)
        if value is None:
            raise Undecided
        size = added(size_of(part.xreplace({w: point}), values) for part in sp.Add.make_args(e))
        return value if abs(value) > ROUNDED * size else 0.0

    return smooth_form(expr, w, side_of)


def far_out(expr: Any, w: Any, side: int, values: Mapping[Any, Any]) -> Piece:
    """Return the affine piece that an expression with kinks is far to the left (-1) or to the right (1)."""

    def side_of(e: Any) -> float:
        slope = number(derivative(e, w), values)
        value = side * slope if slope else number(e, values)
        if slope is None or value is None:
            raise Undecided
        return value

    form = smooth_form(expr, w, side_of)
    slope = expanded(derivative(form, w))
    return Piece(form, slope, number(slope, values), None, None, made_of=size_of(slope, values))


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
            rise, slope = target - expanded(self.expr.xreplace({w: at})), expanded(self.slope.xreplace({w: at}))
            if slope == 0:  # a vertex: the form below would be 0/0 there
                return at + (1 if at == self.left else -1) * sp.sqrt(sp.Max(0, rise / self.curve))
            return at + 2 * rise / (slope + side * sp.sqrt(sp.Max(0, slope**2 + 4 * self.curve * rise)))
        zero = self.expr.xreplace({w: sp.S.Zero})
        forms = [expanded(target - zero) / self.slope if self.slope != 1 else expanded(target - zero)]
        for at in (self.left, self.right):
            if at is not None:
                rise = target - expanded(self.expr.xreplace({w: at}))
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
        slope = expanded(slope) if slope.has(w) else slope
        curve = derivative(slope, w) / 2
        if curve.has(w):
            raise Undecided
        if pieces and expanded(expr - pieces[-1].expr) == 0:
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
