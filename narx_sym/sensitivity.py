"""Derivatives of the free run by symbolic differentiation: one further update equation per direction.

For y[k] = F(y[k-1], ...; theta) the direction S = dy/dtheta obeys
S[k] = sum_i dF/dy[k-i] S[k-i] + dF/dtheta (chain rule along the trajectory).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp

from .recursion import Recursion
from .signals import k, lag, samples, signal


def derivative(expr: Any, variable: Any) -> Any:
    """Differentiate with the kinks of sign, abs, Max and Min taken as they are away from them."""
    name = sp.Dummy("x", real=True)
    result = sp.diff(expr.xreplace({variable: name}), name)
    result = result.replace(sp.DiracDelta, lambda *_: sp.S.Zero)
    return result.xreplace({name: variable})


def sensitivities(
    recursion: Recursion, parameters: Sequence[Any] | None = None, initial: bool = False
) -> tuple[Recursion, list[dict[Any, Any]]]:
    """Append the derivatives of every state to a recursion.

    Parameters
    ----------
    parameters : sequence of Symbol, optional
        With respect to which; all of the recursion's by default.
    initial : bool
        Also the direction in which a common shift of the initial values of the first state moves the run. It starts
        from 1, every other direction from 0.

    Returns
    -------
    extended : Recursion
    directions : list of dict from a state of the recursion to the sequence of its derivative, one per direction
    """
    chosen: list[Any] = list(recursion.parameters if parameters is None else parameters)
    columns: list[Any] = [*chosen, *([None] if initial else [])]
    updates: list[tuple[Any, Any]] = []
    directions: list[dict[Any, Any]] = []
    local = {
        (state, s): derivative(right, s)
        for state, (_, right) in zip(recursion.states, recursion.updates, strict=True)
        for s in samples(right)
        if s.base in recursion.states
    }
    for position, parameter in enumerate(columns):
        moved = {state: signal(f"d{state.label}_{position}") for state in recursion.states}
        for state, (_, right) in zip(recursion.states, recursion.updates, strict=True):
            total = derivative(right, parameter) if parameter is not None else sp.S.Zero
            for (owner, s), slope in local.items():
                if owner == state:
                    total += slope * moved[s.base][k - lag(s)]
            updates.append((moved[state][k], total))
        directions.append(moved)
    return recursion.extend(updates), directions
