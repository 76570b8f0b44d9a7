"""NumPy: expressions over whole columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np
import sympy as sp
from sympy.printing.numpy import NumPyPrinter

from ..symbolic.functions import arguments_of, row_of


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


def lambdify(
    expressions: Sequence[Any], arguments: Sequence[Any], steps: Sequence[tuple[Any, Any]] = ()
) -> Callable[..., Any]:
    """Return a NumPy function of plain symbols; what is not finite is looked for where it matters.

    `steps` are pairs of a symbol and its expression that are computed before, in this order.
    """
    shared: Any = (lambda exprs: (list(steps), exprs)) if steps else True
    function = sp.lambdify(list(arguments), list(expressions), "numpy", _Printer(), cse=shared, dummify=True)

    def quiet(*values: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*values)

    return quiet
