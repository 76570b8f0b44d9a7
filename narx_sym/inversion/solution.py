"""The solution of one equation in one unknown: its branches, what they need, what they reach, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sympy as sp

from ..symbolic.identities import vanishes
from ..symbolic.printing import text
from ..symbolic.sensitivity import derivative


class Root(sp.Function):
    """The w nearest to `last` with `gap` = 0, between two limits: Root(gap, w, last, low, high).

    A node for the equations that have no closed form; only the Python engine computes it.
    """

    nargs = 5

    @property
    def free_symbols(self) -> set[Any]:
        """All but the unknown, which is bound."""
        return set().union(*(a.free_symbols for a in self.args)) - {self.args[1]}

    def _eval_is_extended_real(self) -> bool:
        return True

    def _eval_derivative(self, s: Any) -> Any:
        gap, w, *_ = self.args
        return (-derivative(gap, s) / derivative(gap, w)).xreplace({w: self})  # the implicit function theorem


@dataclass(frozen=True)
class Branch:
    """One case of a solution: where `condition` holds, and no earlier one does, the unknown is `solution`.

    `form` is the smooth expression in the unknown that equals the target there; None where a limit or a jump holds it.
    """

    condition: Any
    solution: Any
    form: Any = None


@dataclass(frozen=True)
class Solution:
    """The value of an unknown that makes an expression equal a target.

    Attributes
    ----------
    unknown, target, expr, last : expressions
        `expr` is what must equal `target`; it contains the unknown, whose value before is `last`.
    how : "linear", "branches", "nodes", "quadratic", "inverse function" or "root finder"
    branches : tuple of Branch, in order
    steps : pairs (name of a further sequence, expression), needed before the branches
    needs : relationals under which there is exactly one solution; those that numbers alone decide are not in it
    reach : (lowest, highest) target that is reached, -oo and oo where there is no limit
    notes : texts
        What is chosen where there is a choice.
    """

    unknown: Any
    target: Any
    expr: Any
    last: Any
    how: str
    branches: tuple[Branch, ...]
    steps: tuple[tuple[str, Any], ...] = ()
    needs: tuple[Any, ...] = ()
    reach: tuple[Any, Any] = (-sp.oo, sp.oo)
    notes: tuple[str, ...] = ()

    @property
    def value(self) -> Any:
        """The solution as one expression."""
        if len(self.branches) == 1:
            return self.branches[0].solution
        return sp.Piecewise(*((b.solution, b.condition) for b in self.branches))

    def residual(self) -> Any:
        """Put each branch back where it is meant and subtract the target: 0 where the algebra is exact."""
        for branch in self.branches:
            if branch.form is not None:
                gap = branch.form.xreplace({self.unknown: branch.solution}) - self.target
                while limits := [f for f in gap.atoms(sp.Max, sp.Min) if f.has(self.target)]:
                    reached = {f: next(e for e in f.args if e.has(self.target)) for f in limits}
                    gap = gap.xreplace(reached)  # the discriminant where there is a solution
                if not vanishes(gap):
                    return gap
        return sp.S.Zero

    @property
    def closed_form(self) -> bool:
        """Whether no root finder is needed."""
        return self.how != "root finder"

    @property
    def proof(self) -> str:
        """Say, in words, why there is one solution, or what it takes."""
        x, of = text(self.unknown), text(self.target)
        if not self.closed_form:
            said = f"{x} has no closed form: the root nearest to its last value is found by bracketing"
        elif self.needs:
            said = f"exactly one {x} for every {of} where {' and '.join(map(text, self.needs))}"
        else:
            said = f"{'one' if self.notes else 'exactly one'} {x} for every {of}"
        low, high = map(text, self.reach)
        if self.reach != (-sp.oo, sp.oo):
            ends = f"above {low}" if self.reach[1] == sp.oo else f"below {high}"
            said += f" {ends if sp.oo in map(abs, self.reach) else f'from {low} to {high}'}; nothing else is reached"
        return "; ".join([said, *self.notes])


def number(expr: Any, values: Mapping[Any, Any]) -> float | None:
    """Return the value of an expression in which all samples cancel, or None."""
    held = sp.sympify(expr).xreplace(dict(values))
    if held.free_symbols:
        held = sp.expand(held)
    return float(held) if held.is_number and held.is_extended_real else None
