"""CasADi: the step as a `Function`, for optimisation and MPC; one lookup table and one walk over the expression."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from ..errors import ModelError
from ..inversion.solution import Root
from ..symbolic.functions import Elementary, X, Y, arguments_of, row_of
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k
from .plan import Plan

TABLE: dict[Any, Callable[..., Any]] = {
    sp.StrictLessThan: lambda a, b: a < b, sp.LessThan: lambda a, b: a <= b,
    sp.StrictGreaterThan: lambda a, b: a > b, sp.GreaterThan: lambda a, b: a >= b,
    sp.Equality: lambda a, b: a == b, sp.Unequality: lambda a, b: a != b,
    sp.Not: ca.logic_not,
}  # fmt: skip
FOLDS: dict[Any, Callable[..., Any]] = {
    sp.And: ca.logic_and, sp.Or: ca.logic_or,
    sp.Add: lambda a, b: a + b, sp.Mul: lambda a, b: a * b,
}  # fmt: skip


def convert(expr: Any, known: dict[Any, Any]) -> Any:
    """Turn a SymPy expression into CasADi; `known` maps symbols to CasADi expressions.

    Raises
    ------
    ModelError
        For a node without a rule; the message names its type.
    """
    if expr in known:
        return known[expr]
    if expr.is_Number or expr.is_NumberSymbol:
        return ca.SX(float(expr))
    if expr in (sp.true, sp.false):
        return ca.SX(int(expr == sp.true))
    row = row_of(expr)
    inside = () if isinstance(expr, (sp.Piecewise, Root)) else arguments_of(expr) if row else expr.args
    arguments = [convert(a, known) for a in inside]
    if row is not None:
        total = _elementary(row, arguments)
    elif type(expr) in FOLDS:
        total = arguments[0]
        for argument in arguments[1:]:
            total = FOLDS[type(expr)](total, argument)
    elif type(expr) in TABLE:
        total = TABLE[type(expr)](*arguments)
    elif expr.is_Pow and expr.exp.is_Integer:
        total = _integer_power(arguments[0], int(expr.exp))
    elif expr.is_Pow:
        total = arguments[0] ** arguments[1]
    elif isinstance(expr, sp.Piecewise):
        total = ca.SX(float("nan"))
        for value, condition in reversed(expr.args):
            chosen = convert(value, known)
            total = chosen if condition == sp.true else ca.if_else(convert(condition, known), chosen, total)
    else:
        raise ModelError(f"CasADi conversion has no rule for {type(expr).__name__} in {expr}.")
    known[expr] = total
    return total


def _elementary(row: Elementary, arguments: list[Any]) -> Any:
    """Compute an elementary function; of several arguments two by two."""
    if row.casadi:
        return getattr(ca, row.casadi)(*arguments)
    first, *others = arguments
    for other in others:
        first = convert(row.definition, {X: first, Y: other})
    return first if others else convert(row.definition, {X: first})


def _integer_power(base: Any, exponent: int) -> Any:
    total = ca.SX(1)
    for _ in range(abs(exponent)):
        total = total * base
    return total if exponent >= 0 else 1 / total


def step(plan: Plan) -> tuple[Any, list[tuple[int, int]], list[tuple[int, int]]]:
    """Return f(past states, inputs, theta, k) -> newest states, and the (signal, lag) order of its arguments."""
    states = range(len(plan.updates))
    past = [(s, i) for s in states for i in range(1, max([0, *(i for j, i in plan.sample if j == s)]) + 1)]
    used = sorted(key for key in plan.sample if key[0] not in states)
    x, v = ca.SX.sym("x", len(past)), ca.SX.sym("v", len(used))
    theta, time = ca.SX.sym("theta", len(plan.parameters)), ca.SX.sym("k")
    known: dict[Any, Any] = {plan.time: time}
    known.update({plan.sample[key]: x[i] for i, key in enumerate(past) if key in plan.sample})
    known.update({plan.sample[key]: v[i] for i, key in enumerate(used)})
    known.update({symbol: theta[i] for i, symbol in enumerate(plan.parameters)})
    newest = []
    for s, right in enumerate(plan.updates):
        value = convert(right, known)
        known[plan.sample[s, 0]] = value
        newest.append(value)
    following = [newest[s] if i == 1 else x[past.index((s, i - 1))] for s, i in past]
    function = ca.Function(
        "step",
        [x, v, theta, time],
        [ca.vertcat(*following), ca.vertcat(*newest)],
        ["past", "inputs", "theta", "k"],
        ["following", "newest"],
    )
    return function, past, used


def transition(recursion: Recursion, values: Mapping[Any, Any], name: str, *returned: Any) -> Any:
    """Return f(state, inputs) -> (next, outputs) with numbers, over `recursion.past` and `recursion.given`."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", name):
        raise ModelError(f"{name!r} cannot be the name of a CasADi function.")
    plan = Plan.of(recursion.subs(values))
    if any(right.has(Plan.time) for right in plan.updates):
        raise ModelError(
            "An equation with the time index itself has no state-space form; use compile(recursion, engine='casadi')."
        )
    state, inputs = ca.SX.sym("state", len(recursion.past)), ca.SX.sym("inputs", len(recursion.given))
    at = {s: state[i] for i, s in enumerate(recursion.past)} | {s: inputs[i] for i, s in enumerate(recursion.given)}
    known = {symbol: at.get(plan.signals[s][k - i]) for (s, i), symbol in plan.sample.items()}
    for s, right in enumerate(plan.updates):
        at[plan.signals[s][k]] = known[plan.sample[s, 0]] = convert(right, known)
    following = [at[s.base[s.indices[0] + 1]] for s in recursion.past]
    outputs = ca.vertcat(*(at[b[k]] for b in returned))
    return ca.Function(
        name, [state, inputs], [ca.vertcat(*following), outputs], ["state", "inputs"], ["next", "output"]
    )


def build(plan: Plan) -> Callable[..., int]:
    """Return run(arrays, theta, start, stop) for a plan."""
    function, past, used = step(plan)
    mapped: dict[int, Any] = {}

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        n = stop - start
        if n <= 0:
            return stop
        if n not in mapped:
            mapped.clear()
            mapped[n] = function.mapaccum(n)
        inputs = np.array([arrays[s][start - i : stop - i] for s, i in used]).reshape(len(used), n)
        x0 = np.array([arrays[s][start - i] for s, i in past])
        _, newest = mapped[n](x0, inputs, np.tile(theta[:, None], (1, n)), np.arange(start, stop)[None, :])
        newest = np.asarray(newest)
        bad = ~np.isfinite(newest).all(axis=0)
        reached = int(np.argmax(bad)) if bad.any() else n
        last = min(reached + 1, n)
        for s in range(len(plan.updates)):
            arrays[s][start : start + last] = newest[s, :last]
        return start + reached

    return run
