"""NumPy: coefficients evaluated for all k at once and one banded solve per state, where the equations allow it.

An update that is affine in its own past, with coefficients free of itself, is a lower banded system; the states are
solved in order. Every other recursion is run step by step through `lambdify`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np
import sympy as sp
from scipy.linalg.lapack import dtbtrs
from sympy.printing.numpy import NumPyPrinter

from ..errors import ModelError
from ..symbolic.functions import arguments_of, row_of
from .plan import Plan

CHUNK = 8192
MAX_BAND = 64  # the band matrix holds CHUNK numbers for each lag up to the largest


class _Printer(NumPyPrinter):
    """SymPy's printer, with the elementary functions as they stand in the table."""

    def __init__(self) -> None:
        super().__init__({"fully_qualified_modules": False, "inline": True, "allow_unknown_functions": True})

    def _print(self, expr: Any, **settings: Any) -> str:
        row = row_of(expr) if isinstance(expr, sp.Expr) else None
        if row is None:
            return str(super()._print(expr, **settings))
        first, *others = (self._print(a) for a in arguments_of(expr))
        joined = reduce(lambda x, y: row.numpy.format(x=x, y=y), others, first)
        return joined if others else row.numpy.format(x=first)

    def _print_And(self, expr: Any) -> str:  # SymPy's own refuses conditions of which some are one number
        return reduce("logical_and({}, {})".format, map(self._print, expr.args))

    def _print_Or(self, expr: Any) -> str:
        return reduce("logical_or({}, {})".format, map(self._print, expr.args))


def lambdify(expressions: Sequence[Any], arguments: Sequence[Any]) -> Callable[..., Any]:
    """Return a NumPy function of plain symbols; what is not finite is looked for where it matters."""
    function = sp.lambdify(list(arguments), list(expressions), "numpy", _Printer(), cse=True, dummify=True)

    def quiet(*values: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*values)

    return quiet


def affine_rows(plan: Plan) -> list[tuple[list[int], list[sp.Expr]]] | None:
    """Return per state its own lags and [constant, coefficient per lag], or None where a state is not affine."""
    rows = []
    for s, right in enumerate(plan.updates):
        own = {i: symbol for (j, i), symbol in plan.sample.items() if j == s and i >= 1}
        later = [symbol for (j, _), symbol in plan.sample.items() if s < j < len(plan.updates)]
        lags = sorted(i for i, symbol in own.items() if right.has(symbol))
        if any(right.has(x) for x in later) or any(
            f.has(own[i]) for i in lags for f in right.atoms(sp.Function, sp.Piecewise)
        ):
            return None
        slopes = [sp.diff(right, own[i]) for i in lags]
        if any(c.has(own[i]) for c in slopes for i in lags):
            return None
        rows.append((lags, [right.xreplace({own[i]: sp.S.Zero for i in lags}), *slopes]))
    return rows


def build(plan: Plan) -> Callable[..., int]:
    """Return run(arrays, theta, start, stop) for a plan."""
    rows = affine_rows(plan)
    narrow = rows is not None and all(lag <= MAX_BAND for lags, _ in rows for lag in lags)
    solve = _banded(plan, rows) if rows is not None and narrow else _stepwise(plan)

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        try:
            return solve(arrays, theta, start, stop)
        except NameError as error:  # lambdify prints the name of any function
            raise ModelError(f"The numpy engine has no rule for {error.name}.") from None

    return run


def _lambdify(plan: Plan, expressions: list[sp.Expr], keys: list[tuple[int, int]]) -> Callable[..., Any]:
    arguments = [plan.sample[key] for key in keys] + list(plan.parameters) + [plan.time]
    return lambdify(expressions, arguments)


def _banded(plan: Plan, rows: list[tuple[list[int], list[sp.Expr]]]) -> Callable[..., int]:
    keys = list(plan.sample)
    functions = [_lambdify(plan, expressions, keys) for _, expressions in rows]

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        for a in range(start, stop, CHUNK):
            z = min(a + CHUNK, stop)
            for s, ((lags, _), function) in enumerate(zip(rows, functions, strict=True)):
                own = {(s, i) for i in range(max(lags, default=0) + 1)}
                values = [
                    np.zeros(z - a)
                    if key in own or (key[0] < len(rows) and key[0] > s)
                    else arrays[key[0]][a - key[1] : z - key[1]]
                    for key in keys
                ]
                with np.errstate(all="ignore"):
                    constant, *slopes = function(*values, *theta, np.arange(a, z, dtype=float))
                arrays[s][a:z] = _solve(arrays[s], a, z, lags, np.broadcast_to(constant, z - a).astype(float), slopes)
            block = np.array([arrays[s][a:z] for s in range(len(rows))])
            bad = ~np.isfinite(block).all(axis=0)
            if bad.any():
                return int(a + np.argmax(bad))
        return stop

    return run


def _solve(x: np.ndarray, a: int, z: int, lags: list[int], right: np.ndarray, slopes: list[Any]) -> np.ndarray:
    """Solve x[k] - sum_i c_i[k] x[k-i] = right[k] for a <= k < z; what is known of x moves to the right."""
    if not lags:
        return right
    columns = [np.broadcast_to(np.asarray(c, dtype=float), z - a) for c in slopes]
    for i, c in zip(lags, columns, strict=True):
        past = min(i, z - a)
        with np.errstate(all="ignore"):
            right[:past] += c[:past] * x[a - i : a - i + past]
    return banded(lags, columns, right[:, None])[:, 0]


def banded(lags: Sequence[int], slopes: Sequence[np.ndarray], right: np.ndarray) -> np.ndarray:
    """Solve x[k] - sum_i c_i[k] x[k-i] = right[k] for all k at once, where everything before the first k is zero.

    It is how a recursion that is affine in its own past runs, and how a change of it goes on along a run.

    Parameters
    ----------
    lags : numbers i, at least one
    slopes : (n,) arrays c_i
    right : (n, m) array
        Several right-hand sides at once.

    Returns
    -------
    (n, m) array
    """
    n = len(right)
    band = np.zeros((max(lags) + 1, n), order="F")
    band[0] = 1.0
    for i, c in zip(lags, slopes, strict=True):
        band[i, : max(0, n - i)] = -c[i:]
    solved, info = dtbtrs(band, right, uplo="L", diag="U")
    if info:
        raise ModelError(f"LAPACK dtbtrs failed with code {info}.")
    return np.asarray(solved)


def _stepwise(plan: Plan) -> Callable[..., int]:
    # State by state: earlier ones put into later ones would nest their branches, which SymPy multiplies out.
    read = [[key for key, symbol in plan.sample.items() if right.has(symbol)] for right in plan.updates]
    steps = [_lambdify(plan, [right], keys) for right, keys in zip(plan.updates, read, strict=True)]

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        with np.errstate(all="ignore"):
            for k in range(start, stop):
                for state, step, keys in zip(arrays[: len(steps)], steps, read, strict=True):
                    (state[k],) = step(*[arrays[s][k - i] for s, i in keys], *theta, float(k))
                if not all(np.isfinite(state[k]) for state in arrays[: len(steps)]):
                    return k
        return stop

    return run
