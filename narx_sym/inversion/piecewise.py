"""Equations with kinks (sign, abs, Max, Min of the unknown): each piece, affine or quadratic, is solved by itself.

An increasing map passes its kinks in order, so that the target says which piece holds. A flat piece or a jump leaves a
choice, and an end piece that is flat leaves targets that no value reaches; both are said.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import sympy as sp

from ..symbolic.functions import within
from ..symbolic.identities import added, expanded
from ..symbolic.printing import text
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import signal
from .breakpoints import (
    DIGITS,
    FLAT,
    Piece,
    Undecided,
    at_point,
    breakpoints,
    far_out,
    ordered,
    pieces_of,
    smooth_part,
)
from .monotone import keeps_sign, rising
from .solution import ROUNDED, Branch, FlatEnd, Solution, apart, number, resting, rounding, tidy

# A flat piece reaches one target only: this part of what a piece of its width beside it reaches does not make the
# unknown jump over it.
DEAD_BAND = sp.Float(1e-10)
Said = tuple[list[Branch], list[str], list[str]]  # branches, what is chosen, and which targets are flat
FALLING = "pieces with the opposite slope reach some targets a second time: they are not used"
FURTHER = "pieces that are not used reach further targets"
TURNING = "the outermost piece reverses far away: further solutions there are not used"


def solve_kinked(
    G: Any, w: Any, target: Any, values: Mapping[Any, Any], rest: Any, made: dict[str, Any], beside: Any
) -> Solution | None:
    """Solve an equation in w whose pieces are affine or quadratic, or return None where they are not.

    `made` holds what every solution says: the unknown, the target, the expression and the last value. `beside` is the
    size of what was added up where the target was solved for.
    """
    slope = derivative(G, w)
    if smooth_part(derivative(slope, w)).has(w):
        return None
    try:
        pieces = pieces_of(G, w, ordered(breakpoints(G, w, values), values), values)
    except Undecided:
        return None  # see `solve_unordered`
    steepest = max((abs(p.size) for p in pieces if p.size is not None), default=0.0)
    known = [p for p in pieces if p.size is not None and not p.flat(steepest)]
    # A decreasing map is an increasing one seen from below.
    up = _upwards(known) or sum(_direction(p.rise(w), rest, values) for p in pieces if p.size is None)
    for flip in (1, -1) if up >= 0 else (-1, 1):
        kept = [p for p in pieces if p.size is None or (flip * p.size > 0 and not p.flat(steepest))]
        if not kept:
            continue
        slopes = [flip * p.rise(w) for p in kept]
        turns = not known and not any(keeps_sign(s, values) for s in slopes)
        seen = flip * sp.sign(sp.Max(*slopes)) if turns else flip  # from the other side where all of them turn
        chain = _Chain(w, target, values, made, seen, pieces, steepest, beside)
        if not chain.hidden(kept):
            return _joined(chain, G, kept, flip)
    return None


def _upwards(known: Sequence[Piece]) -> float:
    """Return a slope with the direction that is used; 0 where only samples say it.

    It is that of both ends, which reach every target, unless they are less certain than the steepest piece: small
    differences of what is added up in them. Of an absolute value it is the side that rises.
    """
    sizes = [p.size or 0.0 for p in known]
    sure = [abs(size) / p.made_of if p.made_of else 1.0 for size, p in zip(sizes, known, strict=True)]
    steepest = max(range(len(known)), key=lambda i: (abs(sizes[i]), sizes[i]), default=None)
    ends = [i for i, p in enumerate(known) if None in (p.left, p.right)]
    if steepest is None:
        return 0.0
    through = len(ends) == 2 and sizes[ends[0]] * sizes[ends[1]] > 0
    return sizes[ends[0] if through and min(sure[i] for i in ends) >= sure[steepest] else steepest]


def _joined(chain: _Chain, G: Any, kept: Sequence[Piece], flip: int) -> Solution:
    """Return the solution that a chain of pieces makes, with the direction that they have at rest."""
    w, values, steepest, pieces = chain.w, chain.values, chain.steepest, chain.pieces
    alone, said = chain.resting(G)
    ends = (kept[0], kept[0].left, -1), (kept[-1], kept[-1].right, 1)
    reach = [side * flip * sp.oo if at is None else chain.level(piece, at) for piece, at, side in ends][::flip]
    beyond = [chain.end(*end) for end in ends]
    joints = [chain.joint(lower, upper) for lower, upper in pairwise(kept)]
    # A curve may begin flat at a kink: it still rises beyond.
    slopes = [s for p in kept if p.size is None for s in p.slopes(w) if not (s == 0 and p.curve != 0)]
    needs = dict.fromkeys(sp.Gt(flip * s, 0) for s in slopes if not (number(s, values) or 0.0) * flip > 0)
    for end, _, side in ends:  # a curve without an end must not turn back
        bent = number(side * flip * end.curve, values) if None in (end.left, end.right) else 0.0
        if bent is None:
            needs[sp.Ge(side * flip * end.curve, 0)] = None
        elif bent < 0:
            said.append(TURNING)
    outer = zip(ends, (pieces[: pieces.index(kept[0])], pieces[pieces.index(kept[-1]) + 1 :]), strict=True)
    if any(p.size is not None and p not in kept and not p.flat(steepest) for p in pieces):
        said.append(FALLING)
    elif any(p.flat(steepest) and p not in chain.plateau(*end) for end, beside in outer for p in beside):
        said.append("a flat piece next to a jump reaches one more target, or one target twice")
    if chain.beyond(kept, pieces):
        said.append(FURTHER)
    if any(p.size and p.flat(steepest) and not p.flat(steepest, DIGITS) for p in pieces):
        said.append(f"a slope of less than {FLAT:.0e} of what is added up in it counts as flat")
    found = (*beyond, *joints)
    branches = (*alone, *(b for one in found for b in one[0]), chain.branch(sp.true, kept[-1]))
    notes, flat = dict.fromkeys([*(n for one in found for n in one[1]), *said]), (f for one in found for f in one[2])
    return Solution(
        how="branches", branches=branches, reach=tuple(reach), needs=tuple(needs), notes=tuple(notes), flat=tuple(flat),
        **chain.made,
    )  # fmt: skip


@dataclass(frozen=True)
class _Chain:
    """Increasing pieces from left to right, or decreasing ones seen from below: `flip` is -1 then.

    Where only samples say whether they rise, `flip` is the sign of the slopes.
    """

    w: Any
    target: Any
    values: Mapping[Any, Any]
    made: Mapping[str, Any]
    flip: Any
    pieces: list[Piece]
    steepest: float
    beside: Any

    @property
    def T(self) -> Any:
        """The target, from the side from which the map increases."""
        return self.flip * self.target

    def level(self, piece: Piece, at: Any) -> Any:
        return tidy(piece.expr.xreplace({self.w: at}))

    def edge(self, piece: Piece, at: Any) -> Any:
        # A product: SymPy turns two conditions on sums of opposite signs to and fro for ever.
        return sp.factor_terms(self.flip * self.level(piece, at))

    def branch(self, condition: Any, piece: Piece) -> Branch:
        solution = piece.solve(self.target, self.w, self.flip)
        return Branch(condition, solution, piece.expr.xreplace({self.w: self.made["unknown"]}))

    def end(self, piece: Piece, at: Any, side: int) -> Said:
        """Return what holds beyond an end of the chain, and which targets flat pieces there give for many values.

        Such a target, and what lies beyond it, takes the value on the pieces that is nearest to the last one.
        """
        if at is None:
            return [], [], []
        edge, last, flat = self.edge(piece, at), self.made["last"], self.plateau(piece, at, side)
        if not flat:
            return [Branch(self.T < edge if side < 0 else self.T > edge, at)], [], []
        level, away = self.level(piece, at), flat[-1].left if side < 0 else flat[-1].right
        if away is None:
            nearest = sp.Min(last, at) if side < 0 else sp.Max(last, at)
            where = f"up to {text(at)}" if side < 0 else f"from {text(at)} on"
        else:
            low, high = (away, at) if side < 0 else (at, away)
            nearest, where = within(last, low, high), f"from {text(low)} to {text(high)}"
        band, gap = rounding(self.target - level, self.beside), self.T - edge
        found = FlatEnd(side, at, level, -side * gap, None if away is None else side * (away - at))
        branch = Branch(gap <= band if side < 0 else gap >= -band, nearest, flat=found)
        return [branch], [], [self.given(where, level)]

    def plateau(self, piece: Piece, at: Any, side: int) -> list[Piece]:
        """Return the flat pieces that go on outwards from an end of the chain, on its level."""
        found, outwards = [], self.pieces[::side]
        for one in outwards[outwards.index(piece) + 1 :]:
            near = one.left if side > 0 else one.right
            if not one.flat(self.steepest) or apart(self.level(one, near), self.level(piece, at), self.values) != 0:
                break
            found.append(one)
        return found

    def resting(self, G: Any) -> tuple[list[Branch], list[str]]:
        """Return what holds at the jumps of a sign: it is zero there itself, so that what rests goes on resting.

        A sign that enters evenly leaves a value that the map has there alone.
        """
        found, notes, w = [], [], self.w
        jumps = any(n.has(w) for n in G.atoms(sp.sign, sp.Heaviside))
        for lower, upper in pairwise(self.pieces) if jumps else ():
            at = upper.left
            below, above = self.level(lower, at), self.level(upper, at)
            here = tidy(at_point(G, w, at, self.values).xreplace({w: at}))
            first, second = apart(here, below, self.values), apart(above, here, self.values)
            if first == 0 and second == 0:
                continue
            size = sp.Abs(expanded(above - below))
            within_jump = first is not None and second is not None and first * second >= 0
            if not within_jump and tidy(above + below - 2 * here) != 0:
                size = sp.Abs(expanded(here - below)) + sp.Abs(expanded(above - here))
                x = text(self.made["unknown"])
                notes.append(f"{x} = {text(at)} gives {text(here)}: it is taken, even if other values give that too")
            found.append(Branch(sp.Abs(self.target - here) <= DEAD_BAND * size, at))
        return found, notes

    def joint(self, lower: Piece, upper: Piece) -> Said:
        """Return the branches up to the second of two neighbours: they meet, or a flat piece or a jump is between."""
        T, last, a, b = self.T, self.made["last"], lower.right, upper.left
        top, bottom = self.edge(lower, a), self.edge(upper, b)
        jump = apart(self.level(upper, b), self.level(lower, a), self.values)
        flat = jump is not None and abs(jump) <= self.slack(lower, upper)
        between = a if a == b else within(last, a, b)
        if a == b and flat:
            return [self.branch(T < top, lower)], [], []
        if flat:
            band = DEAD_BAND * (b - a) * sp.Abs(upper.rise(self.w))
            said = self.given(f"from {text(a)} to {text(b)}", self.level(lower, a))
            return [self.branch(T - top < -band, lower), Branch(T - bottom <= band, between)], [], [said]
        size = None if jump is None or self.flip not in (1, -1) else self.flip * jump
        nearer, after, notes = sp.true, [], []
        below, above = self.digits_at(lower, 1), self.digits_at(upper, -1)
        if size is None or size < 0:  # both sides reach some targets
            down, up = (piece.solve(self.target, self.w, self.flip) for piece in (lower, upper))
            # At even distances rounding does not choose: the one below is taken.
            closer = (down - last) ** 2 <= (1 + DEAD_BAND) * (up - last) ** 2
            nearer = sp.Or(T < bottom + above, sp.And(T < top - below, closer) if below != 0 else closer)
            notes.append(f"two solutions while {text(bottom)} <= {text(T)} <= {text(top)}: the nearer one is taken")
        if size is None or size > 0:  # neither side does
            said = "it stays at the jump"
            if a != b and not any(p.flat(self.steepest) for p in self.between(lower, upper)):
                after = [Branch(sp.And(T < bottom, 2 * T <= top + bottom), a)]
                between, said = b, "the nearer end is taken"
            after.append(Branch(T < bottom, between))
            notes.append(f"no solution while {text(top)} < {text(T)} < {text(bottom)}: {said}")
        return [self.branch(sp.And(T <= top, nearer), lower), *after], notes, []

    def digits_at(self, piece: Piece, side: int) -> Any:
        """Return how near the target at an end of a piece rounding may take its solution past a jump; else 0."""
        beside, at = self.pieces[self.pieces.index(piece) + side], piece.left if side < 0 else piece.right
        jumps = apart(self.level(piece, at), self.level(beside, at), self.values) != 0
        return rounding(self.target - self.level(piece, at), self.beside) if jumps else sp.S.Zero

    def given(self, where: str, level: Any) -> str:
        """Say that a flat piece gives one target."""
        return f"every {text(self.made['unknown'])} {where} gives {text(self.target)} = {text(level)}"

    def slack(self, lower: Piece, upper: Piece) -> float:
        """Return by how much the flat pieces between two others may rise, or fall."""
        return added(
            (FLAT * p.made_of + DIGITS * self.steepest) * abs(number(p.right - p.left, self.values) or 0.0)
            for p in self.between(lower, upper)
            if p.flat(self.steepest)
        )

    def between(self, lower: Piece, upper: Piece) -> list[Piece]:
        return self.pieces[self.pieces.index(lower) + 1 : self.pieces.index(upper)]

    def hidden(self, kept: Sequence[Piece]) -> bool:
        """Whether a piece reaches a target that the chain of those that are kept leaves out between its ends."""
        spans, digits = self.spans, self.digits
        for lower, upper in pairwise(kept) if spans else ():
            top, bottom, room = spans[id(lower)][1], spans[id(upper)][0], self.slack(lower, upper) + digits
            within_gap = (s[0] < bottom - digits and s[1] > top + digits for s in spans.values())
            flat = [e for p in self.between(lower, upper) if p.flat(self.steepest) for e in spans[id(p)]]
            apart = any(not min(top, bottom) - room <= e <= max(top, bottom) + room for e in flat)
            if apart or (top + room < bottom and any(within_gap)):
                return True
        return self.beyond(kept, kept)

    def beyond(self, kept: Sequence[Piece], others: Sequence[Piece]) -> bool:
        """Whether one of other pieces reaches targets below or above the chain of those that are kept."""
        if not self.spans:
            return False
        low, high = self.spans[id(kept[0])][0] - self.digits, self.spans[id(kept[-1])][1] + self.digits
        return any(self.spans[id(p)][0] < low or self.spans[id(p)][1] > high for p in others)

    @cached_property
    def spans(self) -> dict[int, tuple[float, float]]:
        """The least and the highest level of each piece by its id; none where samples say them."""
        found = {id(p): span for p in self.pieces if (span := self.span(p)) is not None}
        return found if len(found) == len(self.pieces) else {}

    @property
    def digits(self) -> float:
        """Levels that differ by less are one."""
        return ROUNDED * max((abs(e) for span in self.spans.values() for e in span if math.isfinite(e)), default=0.0)

    def span(self, piece: Piece) -> tuple[float, float] | None:
        """Return the least and the highest level of a piece, over that of the first kink; None where samples say it.

        Of a curve without an end it is the part up to where it turns back.
        """
        ends = [at for at in (piece.left, piece.right) if at is not None]
        if piece.size is None or self.flip not in (1, -1):
            return None
        zero = self.level(self.pieces[0], self.pieces[0].right) if ends else sp.S.Zero
        heights = [apart(self.level(piece, at), zero, self.values) for at in ends]
        found = [self.flip * h for h in heights if h is not None]
        if len(found) < len(ends):
            return None
        for side in (s for s, at in ((-1, piece.left), (1, piece.right)) if at is None):
            curve = self.flip * (number(piece.curve, self.values) or 0.0)
            outwards = self.flip * side * (number(piece.slopes(self.w)[0], self.values) or 0.0)
            if outwards * curve < 0:  # it turns back there
                found.append(found[0] - outwards**2 / (4 * curve))
            elif curve or not piece.flat(self.steepest):
                found.append(math.copysign(math.inf, curve or outwards))
        return (min(found), max(found)) if found else (-math.inf, math.inf)


def _direction(slope: Any, rest: Any, values: Mapping[Any, Any]) -> int:
    """Return the sign of a slope at rest."""
    value = number(rest(slope), values)
    return 0 if not value else 1 if value > 0 else -1


# -- breakpoints whose order depends on samples ----------------------------------------------------------------


def solve_unordered(G: Any, w: Any, target: Any, values: Mapping[Any, Any], made: dict[str, Any]) -> Solution | None:
    """Solve an equation that rises, or falls, whatever the order of its breakpoints: a line between the nearest two.

    Their levels lie below and above the target; the line is that through two points between them. A jump at one of them
    is met where the line leaves the stretch. (A sum of plays is inverted so; Krejci & Kuhnen 2001 sort the thresholds
    instead.)
    """
    if smooth_part(derivative(G, w)).has(w):
        return None
    try:
        breaks, outer = breakpoints(G, w, values), [far_out(G, w, side, values) for side in (-1, 1)]
    except Undecided:
        return None
    sizes = [p.size for p in outer if p.size is not None]
    if len(sizes) < 2 or not any(sizes):
        return None
    flip = 1 if max(sizes, key=abs) > 0 else -1
    known = rising(flip * G, w, values)
    if known is None:
        return None
    flat, jumps = known
    T, last, index, name = flip * target, made["last"], made["unknown"].indices[0], made["unknown"].base.name
    steps: list[tuple[str, Any]] = []

    def step(what: str, expr: Any) -> Any:
        steps.append((f"{name}_{what}", expr))
        return signal(f"{name}_{what}")[index]

    def level(what: str, at: Any) -> Any:
        return step(what, flip * G.xreplace({w: at}))

    def best(what: str, start: Any, better: Any) -> Any:
        """Go through the breakpoints and keep the better one: Max of many arguments is slow in SymPy."""
        kept = start
        for i, (p, at) in enumerate(listed, 1):
            if p != kept:
                kept = step(f"{what}{i}", sp.Piecewise((p, better(p, at, kept)), (kept, True)))
        return kept

    listed = [(p := step(f"kink{i}", b), level(f"level{i}", p)) for i, b in enumerate(breaks, 1)]
    first = best("first", listed[0][0], lambda p, at, kept: p < kept)
    end = best("last", listed[0][0], lambda p, at, kept: p > kept)
    below = best("below", first, lambda p, at, kept: sp.And(at <= T, p > kept))
    above = best("above", end, lambda p, at, kept: sp.And(at >= T, p < kept))
    one, other = (step(what, (2 * a + b) / 3) for what, a, b in (("one", below, above), ("other", above, below)))
    low, high = level("lower", one), level("upper", other)
    steepest, beyond = max(map(abs, sizes)), []
    for piece, at, limit in zip(outer, (first, end), (sp.Min, sp.Max), strict=True):
        beyond.append(limit(last if piece.flat(steepest) else piece.solve(target, w), at))  # no end, or a jump there
    branches = (
        *([resting(**made)] if jumps or flat else []),
        Branch(T < level("bottom", first), beyond[0]),
        Branch(T > level("top", end), beyond[1]),
        Branch(sp.Or(above <= below, high <= low), within(last, below, above)),
        Branch(sp.true, within(one + (other - one) * (T - low) / (high - low), below, above)),
    )
    x = text(made["unknown"])
    notes = [f"no {x} within a jump of the sign: it stays at the jump"] if jumps else []
    notes += ["an end is flat: nothing is reached beyond its level"] * any(p.flat(steepest) for p in outer)
    several = (f"many {x} may give one {text(target)}, where it is flat",) if flat else ()
    return Solution(how="nodes", branches=branches, steps=tuple(steps), notes=tuple(notes), flat=several, **made)
