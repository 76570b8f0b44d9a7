"""One equation in one unknown: solved in closed form by branches where algebra can do it, else by a root finder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sympy as sp

from ..errors import NotInvertible
from ..symbolic.functions import CLASSES, KINKED, X
from ..symbolic.identities import expanded
from ..symbolic.printing import text
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import renamed, samples
from .breakpoints import breakpoints
from .monotone import steepness
from .piecewise import solve_kinked, solve_unordered
from .plays import solve_plays
from .solution import STILL, Branch, Root, Solution, number, summed

FAR, EVERYWHERE = 1e9, 1e300  # where a search for roots ends, and one for a root that is proved to be there
SEARCHED = (*KINKED, sp.tanh, sp.atan, sp.exp, sp.log, sp.sin, sp.cos)  # functions whose bounds are known
EDGE = sp.Float(1e-12)  # how near the limit of a bounded function is approached


def solve_for(
    expr: Any,
    unknown: Any,
    target: Any,
    last: Any,
    values: Mapping[Any, Any] | None = None,
    limits: tuple[float, float] = (-FAR, FAR),
    rest: Any = lambda e: e,
    together: Mapping[Any, Any] | None = None,
    beside: Any = sp.S.Zero,
) -> Solution:
    """Solve `expr` = `target` for one unknown sample.

    Parameters
    ----------
    expr : expression that contains `unknown`
    unknown, target, last : expressions
        `last` is the value that the solution is near to, where there is a choice: the sample before.
    values : mapping from each parameter to its number
        They decide the order of the kinks and the signs of slopes. Without them only linear equations are solved.
    limits : numbers
        Where a root finder looks.
    rest : function of an expression
        Puts a point of operation in the place of all samples: the direction of slopes that depend on them.
    together : mapping from states to what they start from, optional
        Plays that start together never lie further apart than their radii do.
    beside : expression
        The size of what was added up where the target was solved for.

    Raises
    ------
    NotInvertible
        Where the unknown does not matter, and where the values are needed and missing.
    """
    values = {s: sp.Float(v) for s, v in (values or {}).items()}
    w = sp.Dummy("w", real=True)
    G = expr.xreplace({unknown: w})
    slope = derivative(G, w)
    kinks = [n for n in G.atoms(*KINKED) if n.has(w)]
    made = {"unknown": unknown, "target": target, "expr": expr, "last": last}
    names = {s: sp.Dummy() for s in samples(G)}
    known = bool(values) or not renamed(G, names).free_symbols - {w, *names.values()}
    if not kinks and not slope.has(w) and (known or not samples(slope)):
        size = number(slope, values)
        if slope == 0 or size == 0 or (size is not None and abs(size) < 1e-300):
            raise NotInvertible(f"{text(unknown)} does not matter: its coefficient is zero.")
        gap = target - G.xreplace({w: sp.S.Zero})
        solved = Branch(sp.true, gap / slope, expr)
        if not samples(slope):
            return Solution(how="linear", branches=(solved,), **made)
        still = Branch(sp.Eq(slope, 0), last)  # where it does not act, it stays: nothing is divided by zero
        return Solution(how="linear", branches=(still, solved), needs=(sp.Ne(slope, 0),), **made)
    if not known:
        raise NotInvertible(f"{text(unknown)} is not alone in a linear term: a law needs the parameters' values.")
    if kinks:
        if slope == 0:
            raise NotInvertible(f"{text(unknown)} acts only through its sign: most targets cannot be reached.")
        found = (
            solve_plays(G, w, target, values, made, together or {})
            or solve_kinked(G, w, target, values, rest, made, beside)
            or solve_unordered(G, w, target, values, made)
        )
    else:
        found = _quadratic(G, w, target, values, made) or _inverse_function(G, w, target, values, made)
    return found or _searched(G, w, target, values, limits, made)


def _searched(
    G: Any, w: Any, target: Any, values: Mapping[Any, Any], limits: tuple[Any, Any], made: dict[str, Any]
) -> Solution:
    """Leave the equation to a root finder; to one that divides the line where it may have several roots."""
    gap, steep = G - target, steepness(G, w, values)
    if steep is not None:  # one root, wherever it is
        root = Root(gap, w, made["last"], sp.Float(-EVERYWHERE), sp.Float(EVERYWHERE))
        return Solution(how="root finder", branches=(Branch(sp.true, root),), steep=steep, **made)
    more: tuple[Any, ...] = ()
    if all(isinstance(n, SEARCHED) for n in gap.atoms(sp.Function, sp.Piecewise, sp.Max, sp.Min) if n.has(w)):
        size = summed(gap).xreplace({w: made["last"]})
        more = (size, *breakpoints(G, w, values, known=True))
    root = Root(gap, w, made["last"], *map(sp.sympify, limits), *more)
    return Solution(how="root finder", branches=(Branch(sp.true, root),), **made)


# -- smooth equations ------------------------------------------------------------------------------------------


def _quadratic(G: Any, w: Any, target: Any, values: Mapping[Any, Any], made: dict[str, Any]) -> Any:
    """Solve a quadratic equation: the root on the side of the vertex where the last value is, which is the nearest one.

    Source: arXiv 2011.12246 for inputs as roots of a polynomial; see `narx_sym.inversion.solution.Polynomial`.
    """
    a = derivative(derivative(G, w), w) / 2
    if a.has(w) or not G.is_polynomial(w) or number(a, values) == 0:
        return None
    b, gap = derivative(G, w).xreplace({w: sp.S.Zero}), target - G.xreplace({w: sp.S.Zero})
    size, last, square = number(a, values), made["last"], b**2 + 4 * a * gap
    # A double root is known to the root of the rounding only: so near to the vertex no last digit chooses a side.
    rounding = STILL * (summed(b) ** 2 + 4 * sp.Abs(a) * summed(gap))
    root = sp.sqrt(sp.Max(0, square))
    upper = 2 * a * last + b >= -sp.sqrt(rounding)  # where the slope is positive: 2 a w + b = root
    # Two ways to write the same value; each is exact where the other one cancels.
    cases = (
        (upper, b > 0, 2 * gap / (b + root)),
        (upper, b <= 0, (root - b) / (2 * a)),
        (sp.Not(upper), b < 0, 2 * gap / (b - root)),
        (sp.true, sp.true, -(root + b) / (2 * a)),
    )
    decided = {c: sp.true if _holds(c, values) else sp.false for _, c, _ in cases if _holds(c, values) is not None}
    form = made["expr"]
    listed = [
        Branch(square <= rounding, -b / (2 * a)),  # beyond the vertex nothing is reached
        *(Branch(sp.And(side, decided.get(c, c)), solution, form) for side, c, solution in cases),
    ]
    if size is None:  # a coefficient that samples turn: it may be zero, and which targets are reached hangs on its sign
        listed.insert(0, Branch(sp.And(sp.Eq(a, 0), sp.Eq(b, 0)), last))
    branches = tuple(x for x in listed if x.condition != sp.false)
    vertex = G.xreplace({w: -b / (2 * a)})
    reach = (-sp.oo, sp.oo)
    if size is not None:
        reach = (vertex, sp.oo) if size > 0 else (-sp.oo, vertex)
    note = (
        f"of two roots the one nearest to {text(last)}, which is on its side of the vertex; from the vertex the one "
        f"where {text(target)} rises with {text(made['unknown'])}"
    )
    return Solution(how="quadratic", branches=branches, reach=reach, notes=(note,), **made)


def _holds(condition: Any, values: Mapping[Any, Any]) -> bool | None:
    """Whether a relational holds, where numbers alone decide it."""
    if condition in (sp.true, sp.false):
        return bool(condition == sp.true)
    value = number(condition.lhs - condition.rhs, values)
    return None if value is None else bool(condition.func(sp.Float(value), 0))


def _inverse_function(G: Any, w: Any, target: Any, values: Mapping[Any, Any], made: dict[str, Any]) -> Any:
    """Solve A + B*f(C*w + D) = target by the inverse of f, within its values."""
    beside, rest = G.as_independent(w, as_Add=True)
    factor, core = rest.as_independent(w, as_Add=False)
    row = CLASSES.get(type(core))
    if row is None or row.inverse is None:
        # What numbers switch off does not count: a complete saturation is r*tanh(u/r) + (1 - c)*u with c = 1.
        exact = expanded(G.xreplace(dict(values)))
        return None if exact == G else _inverse_function(exact, w, target, {}, made)
    inner = core.args[0]
    scale = derivative(inner, w)
    size = number(factor, values)
    if scale.has(w) or size is None or size == 0 or number(scale, values) in (None, 0):
        return None
    low, high = row.values
    wanted = (target - beside) / factor
    if low != -sp.oo:
        wanted = sp.Max(low + EDGE, wanted)
    if high != sp.oo:
        wanted = sp.Min(high - EDGE, wanted)
    solution = (row.inverse.xreplace({X: wanted}) - inner.xreplace({w: sp.S.Zero})) / scale
    ends = [(e if size > 0 else -e) if sp.Abs(e) == sp.oo else beside + factor * e for e in (low, high)]
    reach = tuple(ends if size > 0 else ends[::-1])
    return Solution(how="inverse function", branches=(Branch(sp.true, solution),), reach=reach, **made)
