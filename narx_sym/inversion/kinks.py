"""Equations with kinks (sign, abs, Max, Min of the unknown): each piece, affine or quadratic, is solved by itself.

An increasing map passes its kinks in order, so that the target says which piece holds. A flat piece or a jump leaves a
choice, and an end piece that is flat leaves targets that no value reaches; both are said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import sympy as sp

from ..symbolic.functions import CLASSES, KINKED, X, within
from ..symbolic.printing import text
from ..symbolic.sensitivity import derivative
from .solution import Branch, Solution, number, tidy

MANY = 64  # shapes that nested kinks may take
# A flat piece reaches one target only: rounding, or this part of its width, does not make the unknown jump over it.
DEAD_BAND = sp.Float(1e-10)
LEVEL = 1e-12  # a slope this much below zero is one of rounding
FLAT = 1e-9  # a slope this much smaller than the steepest one counts as flat


FALLING = "pieces on which the map runs the other way reach some targets again: they are not used"


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
    return bool(tidy(one - other) == 0 or number(one - other, values) == 0)


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


def _ordered(breaks: Sequence[Any], values: Mapping[Any, Any]) -> list[Any]:
    """Return the kinks from left to right."""
    places = []
    for b in breaks:
        place = number(b - breaks[0], values)
        if place is None:
            raise Undecided
        places.append(place)
    return [b for _, b in sorted(zip(places, breaks, strict=True), key=lambda p: p[0])]


def _at(expr: Any, w: Any, point: Any, values: Mapping[Any, Any]) -> Any:
    """Return the affine expression that one with kinks is at a point between them."""
    if expr == w or not expr.has(w):
        return expr
    row = CLASSES.get(type(expr))
    if row and row.sides:
        inner = _at(expr.args[0], w, point, values)
        value = number(inner.xreplace({w: point}), values)
        if value is None:
            raise Undecided
        return row.sides[value > 0].xreplace({X: inner})
    arguments = [_at(a, w, point, values) for a in expr.args]
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

    A quadratic piece has the curve too, half its second derivative, and the slopes at its kinks.
    """

    expr: Any
    slope: Any
    size: float | None
    left: Any
    right: Any
    curve: Any = sp.S.Zero

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


def solve_kinked(
    G: Any, w: Any, target: Any, values: Mapping[Any, Any], rest: Any, made: dict[str, Any]
) -> Solution | None:
    """Solve an equation in w whose pieces are affine or quadratic, or return None where they are not.

    `made` holds what every solution says: the unknown, the target, the expression and the last value.
    """
    slope = derivative(G, w)
    if smooth_part(derivative(slope, w)).has(w):
        return None
    try:
        breaks = breaks_of(G, w, values)
    except Undecided:
        return None
    try:
        pieces = _pieces(G, w, _ordered(breaks, values), values)
    except Undecided:
        return None  # see `nodes`
    # A decreasing map is an increasing one seen from below.
    known = [p.size for p in pieces if p.size is not None]
    steepest = max((abs(s) for s in known), default=0.0)
    rising = sum(_direction(p.rise(w), rest, values) for p in pieces if p.size is None)
    # Of a side that rises and one that falls alike, as of an absolute value, the rising one is used.
    flip = -1 if (max(known, key=lambda s: (abs(s), s)) if steepest else rising) < 0 else 1
    kept = [p for p in pieces if p.size is None or flip * p.size > FLAT * steepest]
    if not kept:
        return None
    chain = _Chain(w, target, values, made, flip, steepest)
    branches, notes, reach = chain.solved(kept)
    branches = [*chain.resting(G, kept), *branches]
    # A curve may begin flat at a kink: it still rises beyond.
    slopes = [s for p in kept if p.size is None for s in p.slopes(w) if not (s == 0 and p.curve != 0)]
    needs = dict.fromkeys(sp.Gt(flip * s, 0) for s in slopes)
    for end, bend in ((kept[0], -flip), (kept[-1], flip)):  # a curve without an end must not turn back
        bent = number(bend * end.curve, values) if None in (end.left, end.right) else 0.0
        if bent is None:
            needs[sp.Ge(bend * end.curve, 0)] = None
        elif bent < 0:
            notes.append("the outermost piece turns back far away: further solutions there are not used")
    if any(p.size is not None and flip * p.size < -FLAT * steepest for p in pieces):
        notes.append(FALLING)
    return Solution(
        how="branches", branches=tuple(branches), reach=tuple(flip * e for e in reach[::flip]), needs=tuple(needs),
        notes=tuple(dict.fromkeys(notes)), **made,
    )  # fmt: skip


@dataclass(frozen=True)
class _Chain:
    """Increasing pieces from left to right, or decreasing ones seen from below: `flip` is -1 then."""

    w: Any
    target: Any
    values: Mapping[Any, Any]
    made: Mapping[str, Any]
    flip: int
    steepest: float

    @property
    def T(self) -> Any:
        """The target, from the side from which the map increases."""
        return self.flip * self.target

    def edge(self, piece: Piece, at: Any) -> Any:
        # A product: SymPy turns two conditions on sums of opposite signs to and fro for ever.
        return sp.factor_terms(tidy(self.flip * piece.expr.xreplace({self.w: at})))

    def branch(self, condition: Any, piece: Piece) -> Branch:
        solution = piece.solve(self.target, self.w, self.flip)
        return Branch(condition, solution, piece.expr.xreplace({self.w: self.made["unknown"]}))

    def solved(self, kept: Sequence[Piece]) -> tuple[list[Branch], list[str], list[Any]]:
        """Return the branches in order, what is chosen where there is a choice, and what is reached."""
        branches: list[Branch] = []
        notes: list[str] = []
        reach = [-sp.oo, sp.oo]
        if kept[0].left is not None:  # nothing lies below
            reach[0] = self.edge(kept[0], kept[0].left)
            branches.append(Branch(self.T < reach[0], kept[0].left))
        for lower, upper in pairwise(kept):
            more, said = self.joint(lower, upper)
            branches, notes = [*branches, *more], [*notes, *said]
        if kept[-1].right is None:
            branches.append(self.branch(sp.true, kept[-1]))
        else:
            reach[1] = self.edge(kept[-1], kept[-1].right)
            branches += [self.branch(self.T <= reach[1], kept[-1]), Branch(sp.true, kept[-1].right)]
        return branches, notes, reach

    def resting(self, G: Any, kept: Sequence[Piece]) -> list[Branch]:
        """Return what holds at the jumps of a sign: it is zero there itself, so that what rests goes on resting."""
        found = []
        for lower, upper in pairwise(kept):
            size = sp.expand(self.edge(upper, lower.right) - self.edge(lower, lower.right))
            known = number(size, self.values)
            if lower.right == upper.left and size != 0 and (known is None or abs(known) > FLAT * self.steepest):
                at_it = self.flip * G.xreplace({self.w: lower.right})
                found.append(Branch(sp.Abs(self.T - at_it) <= DEAD_BAND * sp.Abs(size), lower.right))
        return found

    def joint(self, lower: Piece, upper: Piece) -> tuple[list[Branch], list[str]]:
        """Return the branches up to the second of two neighbours: they meet, or a flat piece or a jump is between."""
        T, last, a, b = self.T, self.made["last"], lower.right, upper.left
        top, bottom = self.edge(lower, a), self.edge(upper, b)
        jump = number(bottom - top, self.values)
        flat = jump is not None and abs(jump) <= FLAT * self.steepest * max(number(b - a, self.values) or 0.0, 1.0)
        between = a if a == b else within(last, a, b)
        if a == b and (flat or sp.expand(bottom - top) == 0):
            return [self.branch(T < top, lower)], []
        if flat:
            band = DEAD_BAND * (b - a)
            said = f"where it is flat {text(self.made['unknown'])} stays as near as it can to its last value"
            return [self.branch(T - top < -band, lower), Branch(T - bottom <= band, between)], [said]
        nearer, after, notes = sp.true, [], []
        if jump is None or jump < 0:  # both sides reach some targets
            down, up = (piece.solve(self.target, self.w, self.flip) for piece in (lower, upper))
            nearer = sp.Or(T < bottom, (down - last) ** 2 <= (up - last) ** 2)
            notes.append(f"two solutions while {text(bottom)} <= {text(T)} <= {text(top)}: the nearer one is taken")
        if jump is None or jump > 0:  # neither side does
            after.append(Branch(T < bottom, between))
            notes.append(f"no solution while {text(top)} < {text(T)} < {text(bottom)}: it stays at the jump")
        return [self.branch(sp.And(T <= top, nearer), lower), *after], notes


def _pieces(G: Any, w: Any, breaks: Sequence[Any], values: Mapping[Any, Any]) -> list[Piece]:
    """Return the pieces from left to right; neighbours that are the same become one."""
    ends = [None, *breaks, None]
    pieces: list[Piece] = []
    for left, right in pairwise(ends):
        if left is None and right is None:
            point: Any = sp.S.Zero
        elif left is None or right is None:
            point = right - 1 if left is None else left + 1
        else:
            point = (left + right) / 2
        expr = _at(G, w, point, values)
        slope = derivative(expr, w)  # brackets are kept: they are the model's own
        slope = sp.expand(slope) if slope.has(w) else slope
        curve = derivative(slope, w) / 2
        if curve.has(w) or (curve != 0 and len(ends) == 2):
            raise Undecided
        if pieces and sp.expand(expr - pieces[-1].expr) == 0:
            left = pieces.pop().left
        pieces.append(Piece(expr, slope, None if curve != 0 else number(slope, values), left, right, curve))
    return pieces


def smooth_part(expr: Any) -> Any:
    """Return an expression with constants in the place of its kinks."""
    return expr.replace(lambda e: isinstance(e, KINKED), lambda e: sp.Dummy(real=True))


def _direction(slope: Any, rest: Any, values: Mapping[Any, Any]) -> int:
    """Return the sign of a slope at rest."""
    value = number(rest(slope), values)
    return 0 if not value else 1 if value > 0 else -1
