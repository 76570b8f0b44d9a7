"""Derivatives of the free run by symbolic differentiation: one further update equation per direction.

For y[k] = F(y[k-1], ...; theta) the direction S = dy/dtheta obeys
S[k] = sum_i dF/dy[k-i] S[k-i] + dF/dtheta (chain rule along the trajectory).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import sympy as sp

from .recursion import Recursion
from .signals import breve_phi1, k, lag, phi1, renamed, rewritten, samples, signal, u, y

DRIVEN = {u: phi1, y: breve_phi1}  # the first difference of a sequence, where it has a name


def derivative(expr: Any, variable: Any) -> Any:
    """Differentiate by a sample or a parameter, with the kinks of sign, abs, Max and Min as they are away from them.

    phi1[k-i] moves with u[k-i] and against u[k-i-1], phi2 with neither; the breve pair does with y. (`sympy.diff` does
    not see u in phi1, and makes a DiracDelta of a sign.)

    Where two arguments of Max or Min are equal, it moves with one of them, as a play does whose input rests. Sums go
    term by term, each once: models share their terms, and SymPy takes longer over the whole.

    Examples
    --------
    >>> import narx_sym as ns
    >>> from narx_sym import k, phi1, phi2, u, y
    >>> ns.derivative(3 * phi2[k - 1] * phi1[k - 1] * y[k - 1], u[k - 2])
    -3*phi2[k - 1]*y[k - 1]
    """
    expr = sp.sympify(expr)
    inner = DRIVEN.get(variable.base) if isinstance(variable, sp.Indexed) else None
    if inner is not None:
        i = variable.indices[0]
        now, before = (derivative(expr, inner[j]) for j in (i, i + 1))
        if now != 0 or before != 0:
            return _direct(expr, variable) + now - before
    return _direct(expr, variable)


@lru_cache(maxsize=20_000)
def _direct(expr: Any, variable: Any) -> Any:
    """Differentiate where phi1 and phi2 are samples of their own."""
    if not expr.has(variable):
        return sp.S.Zero
    if expr.is_Add:
        return sp.Add(*(_direct(term, variable) for term in expr.args))
    if expr.is_Mul:
        moving = [factor for factor in expr.args if factor.has(variable)]
        if len(moving) == 1:
            return sp.Mul(_direct(moving[0], variable), *(f for f in expr.args if f is not moving[0]))
    plain, names = _plain(expr)
    in_pairs, extremes = _in_pairs(plain)
    result = sp.diff(in_pairs, _stand_in(variable) if isinstance(variable, sp.Indexed) else variable)
    if result.has(sp.DiracDelta):
        result = result.replace(sp.DiracDelta, lambda *_: sp.S.Zero)
    return renamed(renamed(result, extremes), names)


class _Larger(sp.Function):
    """The larger of two; of equal ones the second. SymPy's Max moves with neither where they are equal."""

    nargs = 2
    is_real = True
    sign = 1

    def fdiff(self, argindex: int = 1) -> Any:
        """Return 1 for the argument that it is, 0 for the other."""
        first = sp.Heaviside(self.sign * (self.args[0] - self.args[1]))
        return first if argindex == 1 else 1 - first


class _Smaller(_Larger):
    """The smaller of two; of equal ones the second."""

    sign = -1


def _in_pairs(expr: Any) -> tuple[Any, dict[Any, Any]]:
    """Return an expression with extremes of two arguments each, and what these stand for."""
    known: dict[Any, Any] = {}

    def paired(node: Any) -> Any:
        if not isinstance(node, (sp.Max, sp.Min)):
            return None
        *others, last = node.args
        kind, found, whole = (_Larger if isinstance(node, sp.Max) else _Smaller), rewritten(last, paired), last
        for argument in reversed(others):
            found = kind(rewritten(argument, paired), found)
            whole = node.func(argument, whole, evaluate=False) if argument is not node.args[0] else node
            known[found] = whole
        return found

    return rewritten(expr, paired), known


@lru_cache(maxsize=10_000)
def _stand_in(sample: sp.Indexed) -> sp.Dummy:
    """Return a plain symbol for a sample: SymPy differentiates by these fast."""
    return sp.Dummy(str(sample), real=True)


@lru_cache(maxsize=10_000)
def _plain(expr: Any) -> tuple[Any, dict[Any, Any]]:
    """Return an expression in plain symbols, and the samples that they stand for."""
    names = {s: _stand_in(s) for s in samples(expr)}
    return renamed(expr, names), {plain: s for s, plain in names.items()}


@dataclass(frozen=True)
class Tangent:
    """The local derivatives of a recursion: dx_i[k] = sum of slopes times dx_j[k-l], plus what parameters force.

    Attributes
    ----------
    slopes : per state a tuple of (x_j[k-l], dF_i/dx_j[k-l])
    forced : per state a tuple of dF_i/dtheta_p, one per parameter
    """

    slopes: tuple[tuple[tuple[Any, Any], ...], ...]
    forced: tuple[tuple[Any, ...], ...]

    @classmethod
    def of(cls, recursion: Recursion, parameters: Sequence[Any]) -> Tangent:
        """Derive the local derivatives of every update."""
        known, rights = set(recursion.states), [right for _, right in recursion.updates]
        return cls(
            tuple(tuple((s, derivative(right, s)) for s in samples(right) if s.base in known) for right in rights),
            tuple(tuple(derivative(right, p) for p in parameters) for right in rights),
        )


def sensitivities(
    recursion: Any, parameters: Sequence[Any] | None = None, initial: bool | Sequence[Sequence[Any]] = False
) -> tuple[Recursion, list[dict[Any, Any]]]:
    """Append the derivatives of every state to a recursion.

    Parameters
    ----------
    recursion : Recursion, or what has one, such as a model
    parameters : sequence of Symbol, optional
        With respect to which; all of the recursion's by default.
    initial : groups of states, or True for the first state alone
        Also the direction in which a common shift of the initial values of a group moves the run. Its states start
        from 1, every other direction from 0.

    Returns
    -------
    extended : Recursion
    directions : list of dict from a state of the recursion to the sequence of its derivative, one per direction
        States that a direction does not move are left out.

    Examples
    --------
    >>> import narx_sym as ns
    >>> model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.5, 2.0])
    >>> extended, (by_first, by_second) = model.sensitivities()
    >>> dict(extended.updates)[by_second[ns.y][ns.k]]
    theta_1*dy_1[k - 1] + u[k - 1]
    """
    recursion = getattr(recursion, "recursion", recursion)
    chosen: list[Any] = list(recursion.parameters if parameters is None else parameters)
    groups = [recursion.states[:1]] if initial is True else [tuple(g) for g in initial or ()]
    updates: list[tuple[Any, Any]] = []
    directions: list[dict[Any, Any]] = []
    tangent, taken = Tangent.of(recursion, chosen), {b.name for b in (*recursion.states, *recursion.inputs)}
    local = dict(zip(recursion.states, tangent.slopes, strict=True))
    for position, cause in enumerate([*chosen, *groups]):
        forced = {}
        if position < len(chosen):
            forced = {state: row[position] for state, row in zip(recursion.states, tangent.forced, strict=True)}
        reached = set(cause) if isinstance(cause, tuple) else {state for state, slope in forced.items() if slope != 0}
        grown = True
        while grown:
            more = {state for state, slopes in local.items() if any(s.base in reached for s, _ in slopes)} - reached
            reached |= more
            grown = bool(more)
        moved = {s: signal(_free(f"d{s.name}_{position}", taken)) for s in recursion.states if s in reached}
        for state in moved:
            through = (slope * moved[s.base][k - lag(s)] for s, slope in local[state] if s.base in moved)
            updates.append((moved[state][k], sp.Add(forced.get(state, sp.S.Zero), *through)))
        directions.append(moved)
    return recursion.extend(updates), directions


def _free(name: str, taken: set[str]) -> str:
    """Return the name, with as many strokes behind it as leave the names that are taken."""
    while name in taken:
        name += "_"
    return name
