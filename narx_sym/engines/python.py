"""A generated whole-loop Python function: what laws run by that need a root finder."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..inversion.solution import Root
from ..symbolic.functions import Elementary
from . import roots
from .plan import Plan
from .writer import CALL, Writer, indented

WIDENED = 100  # steps of a root finder, each twice as wide
SPANS, PLAIN = "of_", 3  # the prefix of functions that take bounds too; arguments of a root that is the only one


class _Python(Writer):
    """The words of Python."""

    language, words = "The python engine", "python"
    joints, truth = ("and", "or", "not "), ("False", "True")
    assigning, choosing = "{name} = {shown}", ("if {condition}:", "else:")
    spans = False  # whether an equation is written for numbers and for bounds alike

    def applied(self, row: Elementary, *arguments: tuple[str, int]) -> str:
        if self.spans:
            return self.call(f"{SPANS}{row.name}", *(shown for shown, _ in arguments))
        return super().applied(row, *arguments)

    def raised(self, base: Any, exponent: Any) -> tuple[str, int]:
        # Bounds of w*w would not know that both factors are the same.
        if self.spans and exponent.is_Integer and exponent > 1:
            return self.call(f"{SPANS}pow", self(base), self(exponent)), CALL
        return super().raised(base, exponent)

    def walk(self, e: Any) -> tuple[str, int]:
        if not isinstance(e, Root):
            return super().walk(e)
        gap, unknown, *given = e.args
        name, many = self.fresh(), len(given) > PLAIN
        self.names[unknown] = f"{name}_w"
        shown = [self(g) for g in given]
        self.spans = many
        self.lines += [f"def {name}({name}_w):", *self.block(lambda: self.lines.append(f"return {self(gap)}"))]
        self.spans = False
        return self.call("nearest" if many else "root", name, *shown), CALL


def source(plan: Plan) -> str:
    """Return the text of the loop; its names are generated, none comes from a model file."""
    states = range(len(plan.updates))
    parameters = {symbol: f"parameter_{i}" for i, symbol in enumerate(plan.parameters)}
    past = {key: symbol.name for key, symbol in plan.sample.items() if key[0] not in states or key[1]}
    writer = _Python({Plan.time: "k", **parameters, **{x: x.name for x in plan.sample.values()}})

    def done(s: int, shown: str) -> None:
        name = plan.sample[s, 0].name
        writer.lines += [f"{name} = a{s}[k] = {shown}", f"if not isfinite({name}): return k"]

    writer.updates(plan, done)
    body = [*(f"{name} = a{s}[k - {i}]" for (s, i), name in past.items()), *writer.lines]
    arguments = ", ".join([f"a{i}" for i in range(len(plan.signals))] + ["theta", "start", "stop"])
    lines = [
        f"def run({arguments}):",
        *(f"    {name} = theta[{i}]" for i, name in enumerate(parameters.values())),
        "    k = start",
        "    try:",
        "        for k in range(start, stop):",
        *indented(indented(indented(body))),
        "    except (OverflowError, ZeroDivisionError, ValueError):",
        "        return k",
        "    return stop",
    ]
    return "\n".join(lines)


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
    names: dict[str, Any] = {n: getattr(math, n) for n in dir(math) if not n.startswith("_")}
    names["root"], names["nearest"] = root, roots.nearest
    names |= {f"{SPANS}{name}": function for name, function in roots.NAMES.items()}
    exec(compile(source(plan), "<recursion>", "exec"), names)
    loop = names["run"]

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        lists = [a.tolist() for a in arrays]  # Python floats are three times faster than NumPy scalars
        reached = loop(*lists, theta.tolist(), start, stop)
        for array, values in zip(arrays[: len(plan.updates)], lists, strict=False):
            array[:] = values
        return int(reached)

    return run
