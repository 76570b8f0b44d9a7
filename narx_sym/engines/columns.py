"""Terms and sets to numbers: the regressors of a data set, quasi-static sets, roots of polynomials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp

from ..errors import ModelError
from ..models.quasi_static import phi1_, u_, ytilde
from ..symbolic.signals import expand_phi, lag, samples
from .numbers import floats
from .numpy import lambdify

Array = np.ndarray
ROUNDED = 1e-9  # of a root: an imaginary part that is rounding


class Columns:
    """The regressors of a data set, block by block: a product tree over shared factors.

    Parameters
    ----------
    terms : sequence of expressions in samples `x[k-i]`
    """

    def __init__(self, terms: Iterable[Any]):
        self.terms = [sp.sympify(t) for t in terms]
        self._factors: dict[Any, int] = {}
        tree: dict[tuple[int | None, int], int] = {}  # node = parent node times factor
        self._nodes: list[int | None] = []
        for term in self.terms:
            node = None
            for factor in self._split(term):
                node = tree.setdefault((node, factor), len(tree))
            self._nodes.append(node)
        self._tree = list(tree)
        written = [expand_phi(f) for f in self._factors]
        self._samples = sorted({s for f in written for s in samples(f)}, key=str)
        self.depth = max([0, *(lag(s) for s in self._samples)])
        self.lead = max([0, *(-lag(s) for s in self._samples)])
        plain = [sp.Symbol(f"s{i}", real=True) for i in range(len(self._samples))]
        renamed = [f.xreplace(dict(zip(self._samples, plain, strict=True))) for f in written]
        self._evaluate = lambdify(renamed, plain)

    def _split(self, term: Any) -> list[int]:
        found = []
        for factor in sp.Mul.make_args(term):
            base, exponent = factor.as_base_exp()
            whole = exponent.is_Integer and 0 < exponent <= 8
            for one in [base] * int(exponent) if whole else [factor]:
                found.append(self._factors.setdefault(one, len(self._factors)))
        return sorted(found)

    def block(self, data: Mapping[str, Array], start: int, stop: int) -> Array:
        """Return the (stop - start, n_terms) values, Fortran order, for start <= k < stop."""
        n = stop - start
        values = [data[s.base.name][start - lag(s) : stop - lag(s)] for s in self._samples]
        with np.errstate(all="ignore"):
            factors = [np.broadcast_to(np.asarray(f, dtype=float), n) for f in self._evaluate(*values)]
        products = np.empty((n, max(1, len(self._tree))), order="F")
        for node, (parent, factor) in enumerate(self._tree):
            if parent is None:
                products[:, node] = factors[factor]
            else:
                np.multiply(products[:, parent], factors[factor], out=products[:, node])
        if self._nodes == list(range(len(self._tree))):
            return products
        result = np.empty((n, len(self.terms)), order="F")
        for column, last in enumerate(self._nodes):
            result[:, column] = 1.0 if last is None else products[:, last]
        return result

    def __call__(self, data: Mapping[str, Array]) -> Array:
        """Return all rows for which every sample exists: (N - depth - lead, n_terms)."""
        n = min(len(data[s.base.name]) for s in self._samples) if self._samples else len(next(iter(data.values())))
        return self.block(data, self.depth, n - self.lead)


class StaticSets:
    """Quasi-static solutions along an input: numbers and masks.

    Attributes
    ----------
    u, phi1 : (N,) arrays
    ytilde : (N,) array, or (N, n) of up to n solutions
        The solution of the branch that each sample is on; NaN where the input rests, and where Sigma_y = 1 leaves none
        [unit of the output]. Of several the real ones, rising, and NaN behind them.
    loading : (N,) bool array
    attracting : bool array like `ytilde`
    spectral_radius : array like `ytilde`
        The largest |eigenvalue| of dF/dy; below 1 the set attracts.
    """

    def __init__(self, quasi_static: Any, u: Array, phi1: Array):
        model = quasi_static.model
        self.u, self.phi1 = u, phi1
        self.loading = phi1 > 0
        moving = phi1 != 0
        branches = zip((quasi_static.loading, quasi_static.unloading), quasi_static.branches, strict=True)
        solution, slopes = [], []
        with np.errstate(all="ignore"):
            for expression, derivatives in branches:
                taken = _at_turn(quasi_static, u, expression is quasi_static.loading)
                points = np.sort(_solutions(expression, model, model.values | taken, u, phi1), axis=1)
                numeric = [_known(e, model.values | taken) for e in derivatives]
                at = (u[:, None], phi1[:, None], points)
                found = lambdify(numeric, [u_, phi1_, ytilde])(*at) if derivatives else []
                solution.append(points)
                slopes.append([np.broadcast_to(np.asarray(f, dtype=float), points.shape) for f in found])
            chosen = [np.where(self.loading[:, None], a, b) for a, b in zip(*slopes, strict=True)]
            points = np.where(moving[:, None], np.where(self.loading[:, None], *solution), np.nan)
        radius = _spectral_radius([c.ravel() for c in chosen], points.size).reshape(points.shape)
        several = points.shape[1] > 1
        self.ytilde, self.spectral_radius = (points, radius) if several else (points[:, 0], radius[:, 0])
        self.moving = moving[:, None] if several else moving
        self.attracting = self.moving & (self.spectral_radius < 1)

    @property
    def repelling(self) -> Array:
        """Bool array like `ytilde`."""
        return self.moving & ~self.attracting


def _known(expression: Any, values: Mapping[Any, Any]) -> Any:
    """Put in values; refuse what depends on more than the input."""
    numeric = sp.sympify(expression).xreplace(values)
    if foreign := numeric.free_symbols - {u_, phi1_, ytilde}:
        raise ModelError(f"The sets depend on further signals ({', '.join(map(str, foreign))}).")
    return numeric


def _solutions(expression: Any, model: Any, values: Mapping[Any, Any], u: Array, phi1: Array) -> Array:
    """Return the solutions of a branch, (N, n); NaN where they are not real."""
    if isinstance(expression, sp.ConditionSet):
        polynomial = sp.Poly(_known(expression.condition.lhs, values), expression.sym)
        found = lambdify(polynomial.all_coeffs(), [u_, phi1_])(u, phi1)
        rows = np.column_stack([np.broadcast_to(np.asarray(c, dtype=float), u.shape) for c in found])
        points = np.full((u.size, polynomial.degree()), np.nan)
        for point, row in zip(points, rows, strict=True):
            roots = np.roots(row)
            real = roots.real[np.abs(roots.imag) <= ROUNDED * np.abs(roots)]
            point[: real.size] = real
        return points
    # 1 - Sigma_y = 0: every output, or none, is a solution
    listed = expression.args if isinstance(expression, sp.FiniteSet) else (expression,)
    numeric = [sp.nan if _vanishing(e, model) else _known(e, values) for e in listed]
    found = lambdify(numeric, [u_, phi1_])(u, phi1)
    return np.column_stack([np.broadcast_to(np.asarray(f, dtype=float), u.shape) for f in found])


def _at_turn(quasi_static: Any, u: Array, loading: bool) -> dict[Any, Any]:
    """Return where plays are when a branch of a cycle begins; what is never taken along is in the middle."""
    low, high = float(u.min()), float(u.max())
    found = {}
    for symbol, between in quasi_static.turns.items():
        least, most = (bound.xreplace(quasi_static.model.values) for bound in between)
        middle = (least + most).xreplace({u_: low}) / 4 + (least + most).xreplace({u_: high}) / 4
        begin = (most.xreplace({u_: low}), least.xreplace({u_: high}))
        found[symbol] = sp.Min(begin[0], middle) if loading else sp.Max(begin[1], middle)
    return found


def _vanishing(expression: Any, model: Any) -> bool:
    """Whether the denominator of a quasi-static solution is a number that is zero to rounding."""
    below = sp.fraction(sp.together(expression))[1].xreplace(model.values)
    parts = [abs(float(p)) for p in sp.Add.make_args(below)] if below.is_number else []
    return bool(parts) and abs(float(below)) <= 1e-12 * max(1.0, *parts)


def _spectral_radius(slopes: Sequence[Array], n: int) -> Array:
    if len(slopes) < 2:
        return np.abs(slopes[0]) if slopes else np.zeros(n)
    order = len(slopes)
    companion = np.zeros((n, order, order))
    companion[:, 0, :] = np.stack(slopes, axis=1)
    companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
    return np.abs(np.linalg.eigvals(companion)).max(axis=1)


def evaluate_quasi_static(quasi_static: Any, u: Any, phi1: Any = None) -> StaticSets:
    """Evaluate the quasi-static sets of a fitted model along an input.

    Parameters
    ----------
    u : (N,) array [unit of the model's input]
    phi1 : (N,) array or number, optional
        First difference of the input; that of `u` by default.
    """
    if not quasi_static.model.values:
        raise ModelError("The model has no parameter values: fit it or give theta.")
    try:
        source = np.atleast_1d(floats(u))
        step = np.diff(source, prepend=source[:1]) if phi1 is None else np.broadcast_to(floats(phi1), source.shape)
    except (TypeError, ValueError):
        raise ModelError("u must be numbers, (N,), and phi1 one number or as many.") from None
    if source.ndim != 1 or not (np.all(np.isfinite(source)) and np.all(np.isfinite(step))):
        raise ModelError("u and phi1 must be finite numbers, (N,); none may be missing.")
    return StaticSets(quasi_static, source, np.array(step))


@lru_cache(maxsize=256)  # a law is run over many references
def _coefficients(polynomial: Any, z: Any, names: tuple[Any, ...]) -> Any:
    """Return the negative coefficients below the leading one, scaled by it, as a function of some symbols."""
    lead, *rest = sp.Poly(polynomial, z).all_coeffs()
    return lambdify([-c / lead for c in rest], names)


def largest_root(polynomial: Any, z: Any, arguments: Mapping[Any, Array]) -> Array:
    """Return the largest |root| in z of a polynomial whose coefficients depend on arrays, (N,)."""
    n = max((np.size(v) for v in arguments.values()), default=1)
    found = _coefficients(polynomial, z, tuple(arguments))(*arguments.values())
    return _spectral_radius([np.broadcast_to(np.asarray(f, dtype=float), n) for f in found], n)


@lru_cache(maxsize=2048)
def reader(expressions: tuple[Any, ...], parameters: tuple[Any, ...] = ()) -> tuple[list[Any], Any]:
    """Return the samples in expressions, and a function of their values, then of parameters, that returns the list."""
    names = {s: sp.Dummy(real=True) for s in samples(sp.Tuple(*expressions))}
    return list(names), lambdify([e.xreplace(names) for e in expressions], [*names.values(), *parameters])
