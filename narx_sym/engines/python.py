"""A generated whole-loop Python function: the fallback where LLVM cannot be installed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import sympy as sp
from sympy.printing.codeprinter import PrintMethodNotImplementedError
from sympy.printing.pycode import PythonCodePrinter

from ..errors import ModelError
from .plan import Plan

WIDENED = 100  # steps of a root finder, each twice as wide


class _Printer(PythonCodePrinter):
    def _print_Dummy(self, e: Any) -> str:
        return str(e)  # without the running number of dummies

    def _print_sign(self, e: Any) -> str:
        return f"sign({self._print(e.args[0])})"

    def _print_Heaviside(self, e: Any) -> str:
        return f"(1.0 if {self._print(e.args[0])} > 0 else 0.0)"

    def _print_Root(self, e: Any) -> str:
        gap, w, *given = map(self._print, e.args)
        return f"root(lambda {w}: {gap}, {', '.join(given)})"


def source(plan: Plan) -> str:
    """Return the text of the loop; its names are generated, none comes from a model file."""
    printer = _Printer({"fully_qualified_modules": False, "allow_unknown_functions": False})
    states = range(len(plan.updates))
    body = [f"{plan.time} = k"]
    body += [f"{symbol} = a{s}[k - {i}]" for (s, i), symbol in plan.sample.items() if s not in states or i]
    common, rows = plan.shared
    waiting = dict(common)

    for s in states:
        for c in rows[s]:
            body += [f"{printer.doprint(x)} = {printer.doprint(e)}" for x, e in plan.needed(c, waiting)]
        shown = printer.doprint(rows[s][-1])
        for c in reversed(rows[s][:-1]):
            shown = f"{printer.doprint(c)} + ({shown})*{plan.sample[s, 1]}"
        current = plan.sample[s, 0]
        body += [f"{current} = a{s}[k] = {shown}", f"if not isfinite({current}): return k"]
    arguments = ", ".join([f"a{i}" for i in range(len(plan.signals))] + ["theta", "start", "stop"])
    lines = [
        f"def run({arguments}):",
        *(f"    {symbol} = theta[{i}]" for i, symbol in enumerate(plan.parameters)),
        "    k = start",
        "    try:",
        "        for k in range(start, stop):",
        *(f"            {line}" for line in body),
        "    except (OverflowError, ZeroDivisionError, ValueError):",
        "        return k",
        "    return stop",
    ]
    return "\n".join(lines)


def _keeping_nan(choose: Callable[..., float]) -> Callable[..., float]:
    return lambda *values: math.nan if any(x != x for x in values) else choose(values)


def root(gap: Callable[[float], float], last: float, low: float, high: float) -> float:
    """Return the root nearest to the last value by widening steps and Brent's method; else where the gap is least.

    Source: Brent 1973, by SciPy.
    """
    from scipy.optimize import brentq

    def value(x: float) -> float:
        try:
            return gap(x)
        except OverflowError:
            return math.nan

    start = min(max(last, low), high)
    here = value(start)
    if not here or here != here:
        return start if not here else math.nan
    ends, step, best = (
        {-1: (start, here), 1: (start, here)},
        max(abs(here), 1e-9 * abs(start), 1e-12),
        (abs(here), start),
    )
    for _ in range(WIDENED):
        for side, (before, known) in list(ends.items()):
            at = min(max(start + side * step, low), high)
            while (there := value(at)) != there and abs(at - before) > 1e-9 * abs(at):
                at = (before + at) / 2  # beyond where the function has values
            if at == before or there != there:
                del ends[side]
            elif (there > 0) != (known > 0) or not there:
                near = max(4.5e-16 * max(abs(before), abs(at)), 1e-300)
                return float(brentq(gap, before, at, xtol=near, rtol=8.9e-16, maxiter=300, disp=False))
            else:
                ends[side], best = (at, there), min(best, (abs(there), at))
        step *= 2
    return best[1]


def build(plan: Plan) -> Callable[..., int]:
    """Return run(arrays, theta, start, stop) for a plan."""
    safe = {p: sp.Symbol(f"parameter_{i}", real=True) for i, p in enumerate(plan.parameters)}
    names: dict[str, Any] = {n: getattr(math, n) for n in dir(math) if not n.startswith("_")}
    names["sign"] = lambda x: (x > 0) - (x < 0) if x == x else x  # a NaN is kept, not hidden
    names["root"] = root
    names["max"], names["min"] = (_keeping_nan(choose) for choose in (max, min))
    try:
        text = source(Plan.of(plan.recursion.rename(safe)))
    except PrintMethodNotImplementedError as error:
        raise ModelError(f"The python engine has no rule: {str(error).splitlines()[0]}.") from None
    exec(compile(text, "<recursion>", "exec"), names)
    loop = names["run"]

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        lists = [a.tolist() for a in arrays]  # Python floats are three times faster than NumPy scalars
        reached = loop(*lists, theta.tolist(), start, stop)
        for array, values in zip(arrays[: len(plan.updates)], lists, strict=False):
            array[:] = values
        return int(reached)

    return run
