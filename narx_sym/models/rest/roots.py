"""The real roots of an expression in one unknown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import sympy as sp

from ...errors import ModelError
from ...symbolic.identities import added
from .pieces import pieces

WIDTH = sp.Rational(1, 10**15)  # of the interval that isolates a root
TOUCH = 1e-11  # relative to the largest term: a minimum as low as that touches zero
SAME = 1e-6  # relative: roots nearer to each other are one that rounding has split
JUMPS = sp.sign, sp.Heaviside, sp.Piecewise, sp.core.relational.Relational
GRID, RANGES = 2001, 1e6  # where a bracket is looked for, and how many ranges away


@dataclass(frozen=True)
class Equilibria:
    """The outputs that stay where they are under one constant input.

    Attributes
    ----------
    points : tuple of numbers, rising
    complete : bool
        Whether these are all: isolated by algebra. Else there may be more, and none found means not known.
    """

    points: tuple[float, ...]
    complete: bool

    def __str__(self) -> str:
        n = len(self.points)
        if not self.complete:
            return f"at least {counted(n)}" if n else "whether there is an equilibrium is not known"
        return counted(n) if n else "no equilibrium"


def counted(n: int) -> str:
    """Return "one equilibrium", "2 equilibria"."""
    return "one equilibrium" if n == 1 else f"{n} equilibria"


def resting_points(excess: Any, unknown: Any, scale: float = 1.0) -> Equilibria:
    """Find the real roots of an expression in one unknown with numbers.

    Polynomials, and those that meet at kinks, by Sturm's theorem over the rationals that the decimals stand for, so
    that none is missed and none is invented; all else by changes of sign, from within a small part of `scale` to a
    million times it.

    Raises
    ------
    ModelError
        Where the expression contains more than the unknown.
    """
    if foreign := excess.free_symbols - {unknown}:
        raise ModelError(f"The equilibria depend on further signals ({', '.join(map(str, foreign))}).")
    exact = sp.expand(excess)
    if exact.is_polynomial(unknown):
        return Equilibria(_isolated(_polynomial(exact, unknown)), True)
    if (found := _between_kinks(exact, unknown, scale)) is not None:
        return Equilibria(found, True)
    return Equilibria(_bracketed(sp.lambdify([unknown], excess, modules="math"), scale), False)


def _polynomial(expr: Any, unknown: Any) -> Any:
    return sp.Poly(sp.nsimplify(expr, rational=True), unknown, domain="QQ")


def _between_kinks(expr: Any, unknown: Any, scale: float) -> tuple[float, ...] | None:
    """Return the roots of polynomials that meet at kinks; None for all else, as where one of them is zero all along."""
    parts = None if expr.has(*JUMPS) else pieces(expr, lambda argument: True)
    found: list[float] = []
    for part in parts or ():
        if not all(sp.expand(e).is_polynomial(unknown) for e in (part.right, *(at for at, _ in part.sides))):
            return None
        right, sides = _polynomial(part.right, unknown), [(_polynomial(at, unknown), sign) for at, sign in part.sides]
        if right.is_zero:
            return None
        found += [x for x in _isolated(right) if all(sign * p(x) >= 0 or _touches(p, x) for p, sign in sides)]
    return None if parts is None else _apart(sorted(found), scale)


def _isolated(polynomial: Any) -> tuple[float, ...]:
    """Isolate the real roots, each once: a double root that rounding has split, or lifted from the axis, is one."""
    turning = [(x, _touches(polynomial, x)) for x in _real_roots(polynomial.diff())]
    marks = sorted([(x, 0) for x in _real_roots(polynomial)] + [(x, 1 if touches else 2) for x, touches in turning])
    found: list[float] = []
    # Between two turning points the polynomial is monotone: from one that touches zero to a root beside it, all is.
    for apart, near in groupby(marks, lambda mark: mark[1] == 2):
        at = [] if apart else list(near)
        found += [x for x, touches in at if touches][:1] or [x for x, _ in at]
    return tuple(found)


def _touches(polynomial: Any, x: float) -> bool:
    """Whether it is zero there but for rounding of its terms."""
    terms = [float(c) * x**n for (n,), c in polynomial.terms()]
    return abs(added(terms)) <= TOUCH * max(map(abs, terms))


def _real_roots(polynomial: Any) -> list[float]:
    """Return the real roots by Sturm's theorem, to 15 digits of the smallest that is not zero."""
    if polynomial.degree() < 1:
        return []
    part = polynomial.sqf_part()
    sizes = [(n, math.log2(abs(c.p)) - math.log2(c.q)) for (n,), c in part.terms()]
    least, size = min(sizes)
    lowest = -max((other - size) / (n - least) for n, other in sizes if n > least) if len(sizes) > 1 else 0.0
    width = WIDTH * sp.Integer(2) ** (math.floor(lowest) - 1)  # Fujiwara's bound, of the reversed polynomial
    return [float((a + b) / 2) for a, b in part.intervals(eps=width, sqf=True)]


def _bracketed(gap: Any, scale: float) -> tuple[float, ...]:
    def value(x: float) -> float:
        try:
            return float(gap(x))
        except (OverflowError, ValueError, ZeroDivisionError, TypeError):
            return math.nan

    top = math.asinh(RANGES)
    grid = [scale * math.sinh(top * (2 * i / (GRID - 1) - 1)) for i in range(GRID)]
    points = [(x, value(x)) for x in grid]
    found: list[float] = []
    for (_, far), before, here in zip([(0.0, 0.0), *points], points, points[1:], strict=False):
        if before[1] == 0 and far * here[1] != 0:  # a zero alone; many in a row are a function that fades away
            found.append(before[0])
        elif before[1] * here[1] < 0 and (root := _bisected(value, before, here)) is not None:
            found.append(root)
    return _apart(found, scale)


def _apart(found: list[float], scale: float) -> tuple[float, ...]:
    """Return roots, each once."""
    return tuple(x for i, x in enumerate(found) if not i or x - found[i - 1] > SAME * (1e-3 * scale + abs(x)))


def _bisected(value: Any, low: tuple[float, float], high: tuple[float, float]) -> float | None:
    """Return the root between two points of different sign; None where it is a jump."""
    edges = abs(low[1]) + abs(high[1])
    for _ in range(200):
        middle = (low[0] + high[0]) / 2
        if middle in (low[0], high[0]):
            break
        here = (middle, value(middle))
        if here[1] == 0:
            return middle
        low, high = (here, high) if (here[1] > 0) == (low[1] > 0) else (low, here)
    return low[0] if abs(low[1]) + abs(high[1]) < 1e-6 * edges else None
