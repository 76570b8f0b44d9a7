"""All roots of one equation in one unknown: by subdivision, with bounds of values and slopes over whole intervals.

A cell whose bounds exclude zero has no root; one whose slope has one sign has one root at most, which Brent's method
finds; all others are divided. So no pair of roots is jumped over. (Moore, Kearfott & Cloud 2009, chapter 8.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np

Array = np.ndarray
ROUNDING = 16 * 2.2e-16  # of the sizes that are added up: a gap below it is none
FIRST, WIDER = 1e-3, 3.0  # the cells around the last value, and how much wider each next one is
PARTS, ROUNDS, MANY = 4, 40, 20_000  # of a cell that is divided, and how often; cells at most
NARROW = 1e-12  # relative: a cell that is not divided any more
EVEN = 1e-7  # relative: distances to two roots that differ less are even; where the gap is least is known no better
TOUCHES = 1e-9  # of a cell: a kink this near to its end lies at the end


class Span:
    """Bounds of an expression and of its slope in the unknown, over many cells at once.

    `at` is the value in the middle of the cell: it says on which side of a kink at the end of a cell the cell lies.
    """

    __slots__ = ("at", "dhi", "dlo", "hi", "lo")
    __array_ufunc__ = None  # NumPy leaves the operators to this class

    def __init__(self, at: Any, lo: Any, hi: Any, dlo: Any, dhi: Any):
        self.at, self.lo, self.hi, self.dlo, self.dhi = at, lo, hi, dlo, dhi

    @classmethod
    def of(cls, x: Any) -> Span:
        """Return a number as its own bounds."""
        return x if isinstance(x, Span) else cls(x, x, x, 0.0, 0.0)

    def __add__(self, other: Any) -> Span:
        o = Span.of(other)
        return Span(self.at + o.at, self.lo + o.lo, self.hi + o.hi, self.dlo + o.dlo, self.dhi + o.dhi)

    __radd__ = __add__

    def __neg__(self) -> Span:
        return Span(-self.at, -self.hi, -self.lo, -self.dhi, -self.dlo)

    def __sub__(self, other: Any) -> Span:
        return self + (-other)

    def __rsub__(self, other: Any) -> Span:
        return -self + other

    def __mul__(self, other: Any) -> Span:
        o = Span.of(other)
        one, two = _times(self.dlo, self.dhi, o.lo, o.hi), _times(self.lo, self.hi, o.dlo, o.dhi)
        return Span(self.at * o.at, *_times(self.lo, self.hi, o.lo, o.hi), one[0] + two[0], one[1] + two[1])

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Span:
        return self * (reciprocal(other) if isinstance(other, Span) else 1.0 / other)

    def __rtruediv__(self, other: Any) -> Span:
        return reciprocal(self) * other

    def __abs__(self) -> Span:
        return self * sign(self)

    def through(self, f: Callable[[Any], Any], lo: Any, hi: Any, dlo: Any, dhi: Any) -> Span:
        """Return f of this, given the bounds of f and of its slope over it."""
        return Span(f(self.at), lo, hi, *_times(self.dlo, self.dhi, dlo, dhi))


def _times(a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any]:
    """Return the bounds of a product; nothing times a bound that is infinite is nothing."""
    products = [np.where((p == 0) | (q == 0), 0.0, p * q) for p in (a, b) for q in (c, d)]
    return np.minimum.reduce(products), np.maximum.reduce(products)


def _side(x: Span) -> tuple[Any, Any]:
    """Return on which side of zero the cells lie, and where that is open."""
    rim = TOUCHES * (x.hi - x.lo)
    touching = np.where(np.asarray(x.at) >= 0, 1.0, -1.0)
    return np.where(x.lo > rim, 1.0, np.where(x.hi < -rim, -1.0, touching)), (x.lo < -rim) & (x.hi > rim)


def sign(x: Any) -> Any:
    """Return the sign; a jump inside a cell has every slope."""
    if not isinstance(x, Span):
        return (x > 0) - (x < 0) if x == x else x
    side, is_open = _side(x)
    steep = np.where(is_open, np.inf, 0.0)
    return Span(side, np.where(is_open, -1.0, side), np.where(is_open, 1.0, side), -steep, steep)


def step(x: Any) -> Any:
    """Return 1 where something is positive, else 0."""
    return (sign(x) + 1.0) * 0.5 if isinstance(x, Span) else 1.0 if x > 0 else 0.0


def absolute(x: Any) -> Any:
    """Return |x|."""
    if not isinstance(x, Span):
        return abs(x)
    side, is_open = _side(x)
    steep = np.maximum(np.abs(x.dlo), np.abs(x.dhi))
    lo = np.where(is_open, 0.0, np.where(side > 0, x.lo, -x.hi))
    hi = np.where(is_open, np.maximum(-x.lo, x.hi), np.where(side > 0, x.hi, -x.lo))
    dlo = np.where(is_open, -steep, np.where(side > 0, x.dlo, -x.dhi))
    return Span(abs(x.at), lo, hi, dlo, np.where(is_open, steep, np.where(side > 0, x.dhi, -x.dlo)))


def largest(*values: Any) -> Any:
    """Return the largest."""
    return reduce(_larger, values)


def smallest(*values: Any) -> Any:
    """Return the smallest."""
    return -largest(*(-v for v in values))


def _larger(a: Any, b: Any) -> Any:
    if not isinstance(a, Span) and not isinstance(b, Span):
        return math.nan if a != a or b != b else max(a, b)
    a, b = Span.of(a), Span.of(b)
    side, is_open = _side(a - b)

    def kept(p: Any, q: Any, joint: Any) -> Any:
        return np.where(is_open, joint(p, q), np.where(side > 0, p, q))

    return Span(
        np.maximum(a.at, b.at), kept(a.lo, b.lo, np.maximum), kept(a.hi, b.hi, np.maximum),
        kept(a.dlo, b.dlo, np.minimum), kept(a.dhi, b.dhi, np.maximum),
    )  # fmt: skip


def reciprocal(x: Span) -> Span:
    """Return 1/x; where x may be zero nothing is known."""
    through = (x.lo <= 0) & (x.hi >= 0)
    lo, hi = np.where(through, -np.inf, 1.0 / x.hi), np.where(through, np.inf, 1.0 / x.lo)
    ends = 1.0 / np.where(through, 1.0, x.lo) ** 2, 1.0 / np.where(through, 1.0, x.hi) ** 2
    steep = np.where(through, np.inf, np.maximum(*ends))
    return x.through(lambda v: 1.0 / v, lo, hi, -steep, np.where(through, np.inf, -np.minimum(*ends)))


def power(x: Any, n: Any) -> Any:
    """Return x to a number."""
    if not isinstance(x, Span):
        return math.pow(x, n)
    if n == int(n) and n >= 1:
        slope = power(x, n - 1) if n > 1 else Span(x.at * 0 + 1.0, 1.0, 1.0, 0.0, 0.0)
        ends = x.lo**n, x.hi**n
        lo, hi = np.minimum(*ends), np.maximum(*ends)
        if n % 2 == 0:
            lo = np.where((x.lo < 0) & (x.hi > 0), 0.0, lo)
        return x.through(lambda v: v**n, lo, hi, n * slope.lo, n * slope.hi)
    if n == int(n):
        return reciprocal(power(x, -n))
    return exp(log(x) * n)


def smooth(plain: Callable[[float], float], of: Callable[[Any], Any], bounds: Callable[[Span], Any]) -> Any:
    """Return a smooth function of a number, or of a Span, given the bounds of its values and of its slopes."""
    return lambda x: x.through(of, *bounds(x)) if isinstance(x, Span) else plain(x)


def _root(x: Span) -> tuple[Any, ...]:
    lo, hi = (np.sqrt(np.maximum(e, 0.0)) for e in (x.lo, x.hi))
    return lo, hi, 0.5 / hi, 0.5 / lo


def _logarithm(x: Span) -> tuple[Any, ...]:
    """Return the bounds of the logarithm; -oo at and below zero."""
    lo, hi = (np.where(e > 0, e, 0.0) for e in (x.lo, x.hi))
    return np.log(lo), np.log(hi), 1.0 / hi, 1.0 / lo


def _bell(x: Span, slope: Callable[[Any], Any]) -> tuple[Any, Any]:
    """Return the bounds of a slope that is largest at zero and falls on both sides."""
    ends = slope(x.lo), slope(x.hi)
    return np.minimum(*ends), np.where((x.lo < 0) & (x.hi > 0), 1.0, np.maximum(*ends))


def _wave(lo: Any, hi: Any) -> tuple[Any, Any]:
    """Return the bounds of the sine."""
    lo, hi = np.nan_to_num(lo), np.nan_to_num(hi)
    ends, turn = (np.sin(lo), np.sin(hi)), 2 * np.pi
    top = np.floor((hi - np.pi / 2) / turn) >= np.ceil((lo - np.pi / 2) / turn)
    bottom = np.floor((hi + np.pi / 2) / turn) >= np.ceil((lo + np.pi / 2) / turn)
    return np.where(bottom, -1.0, np.minimum(*ends)), np.where(top, 1.0, np.maximum(*ends))


def cos(x: Any) -> Any:
    """Return the cosine."""
    return sin(x + math.pi / 2) if isinstance(x, Span) else math.cos(x)


exp = smooth(math.exp, np.exp, lambda x: (np.exp(x.lo), np.exp(x.hi)) * 2)
log = smooth(math.log, np.log, _logarithm)
sqrt = smooth(math.sqrt, np.sqrt, _root)
tanh = smooth(math.tanh, np.tanh, lambda x: (np.tanh(x.lo), np.tanh(x.hi), *_bell(x, lambda v: 1.0 - np.tanh(v) ** 2)))
atan = smooth(
    math.atan, np.arctan, lambda x: (np.arctan(x.lo), np.arctan(x.hi), *_bell(x, lambda v: 1.0 / (1.0 + v**2)))
)
sin = smooth(math.sin, np.sin, lambda x: (*_wave(x.lo, x.hi), *_wave(x.lo + np.pi / 2, x.hi + np.pi / 2)))
NAMES = {
    "sign": sign, "Heaviside": step, "abs": absolute, "Max": largest, "Min": smallest, "pow": power, "exp": exp,
    "log": log, "sqrt": sqrt, "tanh": tanh, "atan": atan, "sin": sin, "cos": cos,
}  # fmt: skip


# -- the search ------------------------------------------------------------------------------------------------


def nearest(gap: Callable[[Any], Any], last: float, low: float, high: float, size: float, *kinks: float) -> float:
    """Return the root nearest to the last value, or else where the gap is least; of two at even distances the higher.

    Parameters
    ----------
    gap : function of a number or of a Span, made of the functions above
    last, low, high : the value before, and where a root is looked for
    size : of what is added up in the gap: the rounding that is no gap
    kinks : where the gap may have a kink or a jump
    """
    start, none = min(max(last, low), high), ROUNDING * size
    here = _value(gap, start)
    if here != here or abs(here) <= none:
        return math.nan if here != here else start
    inside = [x for x in kinks if low < x < high]
    best = min((x for x in inside if abs(_value(gap, x)) <= none), key=lambda x: abs(x - start), default=None)
    widths = FIRST * max(1.0, abs(start)) * WIDER ** np.arange(64)
    edges = np.concatenate([[low, high, start], inside, start - widths, start + widths])
    edges = np.unique(edges[(edges >= low) & (edges <= high)])
    with np.errstate(all="ignore"):
        found = _search(gap, start, edges[:-1], edges[1:], none, best)
    return _least(gap, start, edges, inside) if found is None else found


def _search(
    gap: Callable[[Any], Any], start: float, a: Array, b: Array, none: float, best: float | None
) -> float | None:
    """Divide the cells until each is decided; the nearest first."""
    at = (a + b) / 2  # a cell never leaves its side of the kinks
    for _ in range(ROUNDS):
        reach = math.inf if best is None else abs(best - start) * (1 + EVEN)
        near = np.maximum(np.maximum(a - start, start - b), 0.0)
        span = gap(Span(at, a, b, np.ones_like(a), np.ones_like(a)))
        lo, hi, dlo, dhi = (
            np.broadcast_to(np.where(np.isnan(e), unknown, e), a.shape)
            for e, unknown in zip((span.lo, span.hi, span.dlo, span.dhi), (-np.inf, np.inf) * 2, strict=True)
        )
        alive = (near < reach) & (lo <= none) & (hi >= -none)
        decided = (dlo > 0) | (dhi < 0) | (b - a <= NARROW * (1e-3 + np.abs(a) + np.abs(b)))
        for i in sorted(np.flatnonzero(alive & decided), key=lambda i: near[i]):
            if near[i] < reach and (x := _in_cell(gap, a[i], b[i], at[i], start, none)) is not None:
                if (
                    best is None
                    or abs(x - start) < abs(best - start) * (1 - EVEN)
                    or (x > best and abs(x - start) < reach)
                ):
                    best, reach = x, abs(x - start) * (1 + EVEN)
        kept = alive & ~decided & (near < reach)
        if not kept.any() or kept.sum() > MANY:
            return best
        cuts = np.linspace(a[kept], b[kept], PARTS + 1)
        a, b, at = cuts[:-1].ravel(), cuts[1:].ravel(), np.tile(at[kept], PARTS)
    return best


def _in_cell(gap: Callable[[Any], Any], a: float, b: float, at: float, start: float, none: float) -> float | None:
    """Return the root in a cell in which the gap rises or falls, or that is too narrow to be divided."""
    from scipy.optimize import brentq

    def value(x: float) -> float:
        """Take the gap from inside the cell: at its ends it may jump."""
        return float(np.asarray(gap(Span(at, x, x, 1.0, 1.0)).lo))

    ends = value(a), value(b)
    for x, gone in sorted(zip((a, b), ends, strict=True), key=lambda e: abs(e[0] - start)):
        if abs(gone) <= none and abs(_value(gap, x)) <= none:
            return float(x)
    if not ends[0] * ends[1] < 0:
        return None
    x = float(brentq(value, a, b, xtol=max(4.5e-16 * max(abs(a), abs(b)), 1e-300), rtol=8.9e-16, disp=False))
    # A jump changes the sign too: between its sides there is no root.
    jumps = b - a <= NARROW * (1e-3 + abs(a) + abs(b)) and abs(_value(gap, x)) > 0.1 * abs(ends[1] - ends[0])
    return None if jumps and abs(_value(gap, x)) > none else x


def _value(gap: Callable[[float], float], x: float) -> float:
    try:
        return float(gap(float(x)))
    except (OverflowError, ValueError, ZeroDivisionError):
        return math.nan


def _least(gap: Callable[[Any], Any], start: float, edges: Array, kinks: Sequence[float]) -> float:
    """Return where the gap is least: at a kink, beside it, or between the edges."""
    from scipy.optimize import minimize_scalar

    beside = [np.nextafter(x, side) for x in kinks for side in (-np.inf, np.inf)]
    listed = [(abs(g), abs(x - start), float(x)) for x in (*edges, *beside) if (g := _value(gap, x)) == g]
    best = min(listed)
    place = int(np.searchsorted(edges, best[2]))
    for a, b in ((max(place - 1, 0), place), (place, min(place + 1, edges.size - 1))):
        if a < b:
            found = minimize_scalar(
                lambda x: abs(_value(gap, x)), bounds=(edges[a], edges[b]), method="bounded", options={"xatol": 1e-12}
            )
            best = min(best, (float(found.fun), abs(found.x - start), float(found.x)))
    return best[2]
