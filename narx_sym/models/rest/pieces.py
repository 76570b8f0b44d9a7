"""What an equation is on either side of its kinks, and whether the pieces together settle (joint spectral radius)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

import sympy as sp

from ...symbolic.identities import added
from ...symbolic.signals import rewritten

Vector = tuple[float, ...]
Matrix = list[list[float]]
STAYS = 1.0 - 1e-6  # between it and its inverse an eigenvalue says nothing: what is not linear decides, or rounding
MOST = 64  # pieces
PRODUCTS = 3000  # of matrices that are looked at
STARTS, STEPS, FAR = 16, 4000, math.log(1e12)  # runs of the pieces, and what is called growth without end


@dataclass(frozen=True)
class Piece:
    """An equation where each of some expressions has one sign.

    Attributes
    ----------
    right : expression without the kinks
    sides : tuple of (expression, 1 or -1)
    """

    right: Any
    sides: tuple[tuple[Any, int], ...]


def pieces(right: Any, active: Callable[[Any], bool]) -> list[Piece] | None:
    """Return the equation on every side of the kinks whose arguments are `active`; None where there are too many."""
    found: list[Piece] = []
    waiting: list[tuple[Any, dict[Any, int]]] = [(right, {})]
    while waiting:
        expr, sides = waiting.pop()
        argument = next((a for a in map(_normal, _arguments(expr)) if active(a[0])), None)
        if argument is None:
            found.append(Piece(expr, tuple(sides.items())))
            continue
        at = argument[0]
        for sign in [sides[at]] if at in sides else [1, -1]:
            waiting.append((_taken(expr, at, sign), {**sides, at: sign}))
        if len(found) + len(waiting) > MOST:
            return None
    return found


def _arguments(expr: Any) -> Iterator[Any]:
    """Return what kinks and jumps ask the sign of, the innermost first."""
    for node in sp.postorder_traversal(expr):
        if isinstance(node, (sp.Abs, sp.sign, sp.Heaviside)):
            yield node.args[0]
        elif isinstance(node, sp.core.relational.Relational):
            yield node.lhs - node.rhs
        elif isinstance(node, (sp.Max, sp.Min)):
            yield from (a - b for i, a in enumerate(node.args) for b in node.args[i + 1 :])


def _normal(argument: Any) -> tuple[Any, int]:
    """Return an expression up to a factor, and the sign of the factor."""
    expanded = sp.expand(argument)
    terms = [term.as_coeff_Mul() for term in sp.Add.make_args(expanded)]
    lead = min(terms, key=lambda term: sp.default_sort_key(term[1]))[0]
    return (sp.expand(expanded / lead), 1 if lead > 0 else -1) if lead else (sp.S.Zero, 1)


def _taken(expr: Any, at: Any, sign: int) -> Any:
    """Return the expression where `at` has a sign."""

    def side(argument: Any) -> int:
        normal, factor = _normal(argument)
        return factor * sign if normal == at else 0

    def change(node: Any) -> Any:
        if isinstance(node, (sp.Abs, sp.sign, sp.Heaviside)) and (s := side(node.args[0])):
            return s * node.args[0] if isinstance(node, sp.Abs) else s if isinstance(node, sp.sign) else (1 + s) // 2
        if isinstance(node, sp.core.relational.Relational) and (s := side(node.lhs - node.rhs)):
            above = {sp.Gt: s > 0, sp.Ge: s > 0, sp.Lt: s < 0, sp.Le: s < 0, sp.Eq: False, sp.Ne: True}
            return sp.true if above[node.func] else sp.false
        if isinstance(node, (sp.Max, sp.Min)):
            wins = 1 if isinstance(node, sp.Max) else -1
            lost = {
                b if s == wins else a for i, a in enumerate(node.args) for b in node.args[i + 1 :] if (s := side(a - b))
            }
            kept = [a for a in node.args if a not in lost]
            if lost:
                return kept[0] if len(kept) == 1 else node.func(*kept, evaluate=False)
        return None

    return rewritten(expr, lambda node: None if (new := change(node)) is None else sp.sympify(new))


# -- the pieces in numbers -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Linear:
    """A piece around a point: x[k] = slopes x, where every gradient x has its sign; None for one that is not known."""

    slopes: Vector
    sides: tuple[tuple[Vector | None, int], ...] = ()

    def holds(self, x: Sequence[float]) -> bool:
        """Whether a point surely lies in it."""
        return all(g is not None and sign * _dot(g, x) > 0 for g, sign in self.sides)

    @property
    def differences(self) -> Linear | None:
        """The piece in x[k-i] - x[k-i-1], where a constant stays what it is; None where it does not."""
        if abs(added(self.slopes) - 1) > 1e-6 * (1 + added(map(abs, self.slopes))):
            return None
        sides = []
        for gradient, sign in self.sides:
            level = gradient is not None and abs(added(gradient)) <= 1e-6 * added(map(abs, gradient))
            sides.append((_sums(gradient) if gradient is not None and level else None, sign))
        return Linear(tuple(-added(self.slopes[i:]) for i in range(1, len(self.slopes))), tuple(sides))


def settles(found: Sequence[Linear]) -> bool | None:
    """Return whether pieces that meet at zero go there, from everywhere; None where that is not decided.

    One piece by its eigenvalues, pieces of one lag by their slopes. Several: they settle where long products contract,
    in whatever order; they do not where a run grows without end.
    """
    distinct = list(dict.fromkeys(one.slopes for one in found))
    if not all(math.isfinite(a) for slopes in distinct for a in slopes):
        return None
    if len(distinct) == 1:
        return True if _inside(distinct[0], STAYS) else None if _inside(distinct[0], 1 / STAYS) else False
    if len(distinct[0]) == 1:
        return _one_lag(found)
    if _contract([[list(slopes), *_shift(len(slopes))] for slopes in distinct]):
        return True
    return False if _grow(found) else None


def _inside(slopes: Vector, radius: float) -> bool:
    """Whether all eigenvalues lie inside a circle (Jury's table in numbers)."""
    row = [1.0, *(-a / radius ** (i + 1) for i, a in enumerate(slopes))]
    while len(row) > 1:
        last = row[-1]
        if not abs(last) < 1:
            return False
        row = [(a - last * b) / (1 - last * last) for a, b in zip(row[:-1], row[:0:-1], strict=True)]
    return True


def _one_lag(found: Sequence[Linear]) -> bool | None:
    sides = [{p.slopes[0] for p in found if all(g is None or s * d * g[0] >= 0 for g, s in p.sides)} for d in (1, -1)]
    if any(len(side) != 1 for side in sides):
        return None
    (right,), (left,) = sides
    back = right < 0 and left < 0  # to the other side and back; else, once where it stays, it contracts or not
    size = right * left if back else max(right, left)
    return True if size < STAYS else None if size <= 1 / STAYS else False


def _contract(matrices: list[Matrix]) -> bool:
    """Whether every product, continued far enough, is smaller than one in a norm: then all of them vanish."""
    n = len(matrices[0])
    mean = [[added(m[i][j] for m in matrices) / len(matrices) for j in range(n)] for i in range(n)]
    root = _norm_of(mean)
    if root is None:
        return False
    turned = [_times(_times(root[0], m), root[1]) for m in matrices]
    waiting, looked = list(turned), 0
    while waiting:
        product, looked = waiting.pop(), looked + 1
        if looked > PRODUCTS:
            return False
        if not _size(product) < STAYS:
            waiting += [_times(m, product) for m in turned]
    return True


def _norm_of(mean: Matrix) -> tuple[Matrix, Matrix] | None:
    """Return T and its inverse, so that |T x| falls along the mean of the pieces; None where that does not settle."""
    if not _inside(tuple(mean[0]), STAYS):
        return None
    n = len(mean)
    total, power = sp.eye(n), sp.Matrix(mean)
    for _ in range(40):  # the sum of (A^j)' A^j, doubling
        total, power = total + power.T * total * power, power * power
        if max(map(abs, power)) < 1e-9:
            break
    lower = ((total + total.T) / 2).cholesky(hermitian=False)
    return lower.T.tolist(), lower.T.inv().tolist()


def _grow(found: Sequence[Linear]) -> bool:
    """Whether a run of the pieces grows without end."""
    random, n = Random(0), len(found[0].slopes)
    for _ in range(STARTS):
        x, grown = [random.gauss(0, 1) for _ in range(n)], 0.0
        for _ in range(STEPS):
            here = list({p.slopes for p in found if p.holds(x)})
            size = max(map(abs, x))
            if len(here) != 1 or not abs(grown) < FAR or not 0 < size < math.inf:
                break
            x = [_dot(here[0], x) / size, *(a / size for a in x[:-1])]
            grown += math.log(size)
        if grown >= FAR:
            return True
    return False


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return added(p * q for p, q in zip(a, b, strict=True))


def _sums(gradient: Vector) -> Vector:
    return tuple(added(gradient[: i + 1]) for i in range(len(gradient) - 1))


def _times(a: Matrix, b: Matrix) -> Matrix:
    columns = list(zip(*b, strict=True))
    return [[float(_dot(row, column)) for column in columns] for row in a]


def _size(a: Matrix) -> float:
    return math.sqrt(added(x * x for row in a for x in row))


def _shift(n: int) -> Matrix:
    return [[float(i == j) for j in range(n)] for i in range(n - 1)]
