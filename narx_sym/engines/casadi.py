"""CasADi: the step as a `Function`, for optimisation and MPC; one lookup table and one walk over the expression."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from ..errors import ModelError
from ..inversion.solution import Root
from ..symbolic.functions import Elementary, X, Y, arguments_of, row_of
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, lag
from .plan import Plan

TABLE: dict[Any, Callable[..., Any]] = {
    sp.StrictLessThan: operator.lt, sp.LessThan: operator.le, sp.StrictGreaterThan: operator.gt,
    sp.GreaterThan: operator.ge, sp.Equality: operator.eq, sp.Unequality: operator.ne, sp.Not: ca.logic_not,
}  # fmt: skip
FOLDS: dict[Any, Callable[..., Any]] = {
    sp.And: ca.logic_and, sp.Or: ca.logic_or, sp.Add: operator.add, sp.Mul: operator.mul,
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
        total = reduce(FOLDS[type(expr)], arguments)
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
    total = reduce(operator.mul, [base] * abs(exponent), ca.SX(1))
    return total if exponent >= 0 else 1 / total


def _step(plan: Plan) -> tuple[list[Any], Any, dict[Any, Any]]:
    """Return [state, inputs, theta, k], the next state, and every sample of one step, all as CasADi expressions.

    State and inputs are `recursion.past` and `recursion.given`.
    """
    past, used = plan.recursion.past, plan.recursion.given
    state, inputs = ca.SX.sym("state", len(past)), ca.SX.sym("inputs", len(used))
    theta, time = ca.SX.sym("theta", len(plan.parameters)), ca.SX.sym("k")
    at = {s: state[i] for i, s in enumerate(past)} | {s: inputs[i] for i, s in enumerate(used)}
    known = {symbol: at.get(plan.signals[s][k - i]) for (s, i), symbol in plan.sample.items()}
    known |= {plan.time: time} | {symbol: theta[i] for i, symbol in enumerate(plan.parameters)}
    for s, right in enumerate(plan.updates):
        at[plan.signals[s][k]] = known[plan.sample[s, 0]] = convert(right, known)
    return [state, inputs, theta, time], ca.vertcat(*(at[s.base[s.indices[0] + 1]] for s in past)), at


def transition(recursion: Recursion, values: Mapping[Any, Any], name: str, *returned: Any) -> Any:
    """Return f(state, inputs) -> (next, outputs) with numbers, over `recursion.past` and `recursion.given`."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", name):
        raise ModelError(f"{name!r} cannot be the name of a CasADi function.")
    plan = Plan.of(recursion.subs(values))
    if any(right.has(Plan.time) for right in plan.updates):
        raise ModelError(
            "An equation with the time index itself has no state-space form; use compile(recursion, engine='casadi')."
        )
    arguments, following, at = _step(plan)
    results = [following, ca.vertcat(*(at[b[k]] for b in returned))]
    return ca.Function(name, arguments[:2], results, ["state", "inputs"], ["next", "output"])


def build(plan: Plan) -> Callable[..., int]:
    """Return run(arrays, theta, start, stop) for a plan."""
    arguments, following, at = _step(plan)
    states = [at[base[k]] for base in plan.recursion.states]
    function = ca.Function("step", arguments, [following, ca.vertcat(*states)])
    place = {base: i for i, base in enumerate(plan.signals)}
    past, used = ([(place[s.base], lag(s)) for s in of] for of in (plan.recursion.past, plan.recursion.given))

    @lru_cache(maxsize=1)
    def mapped(n: int) -> Any:
        return function.mapaccum(n)

    def run(arrays: list[np.ndarray], theta: np.ndarray, start: int, stop: int) -> int:
        n = stop - start
        if n <= 0:
            return stop
        inputs = np.array([arrays[s][start - i : stop - i] for s, i in used]).reshape(len(used), n)
        x0 = np.array([arrays[s][start - i] for s, i in past])
        _, newest = mapped(n)(x0, inputs, np.tile(theta[:, None], (1, n)), np.arange(start, stop)[None, :])
        newest = np.asarray(newest)
        bad = ~np.isfinite(newest).all(axis=0)
        reached = int(np.argmax(bad)) if bad.any() else n
        last = min(reached + 1, n)
        for s, row in enumerate(newest):
            arrays[s][start : start + last] = row[:last]
        return start + reached

    return run
