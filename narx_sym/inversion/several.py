"""The law of a system with as many inputs as outputs: all inputs of one sample, so that every output follows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp

from ..errors import NotInvertible
from ..models.system import System
from ..symbolic.identities import vanishes
from ..symbolic.printing import InLatex, shown
from ..symbolic.recursion import Recursion
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import k, lag, samples, shift, signal, swap
from .doors import SystemLawDoors


@dataclass(frozen=True, eq=False)
class SystemLaw(SystemLawDoors, InLatex):
    """m_j[k] = ... for every input, from references r_i of the outputs.

    Attributes
    ----------
    system : System
    delays : mapping from each output to how many samples after an input it answers
    updates : pairs of m_j[k] and its right-hand side
    """

    system: System
    delays: dict[str, int]
    updates: tuple[tuple[Any, Any], ...]
    asked: tuple[Any, ...]  # r_i[k+d_i] - F_i, which must vanish

    @cached_property
    def recursion(self) -> Recursion:
        """The law as update equations; its inputs are the references and what else is measured."""
        return Recursion(self.updates, self.system.symbols)

    @property
    def preview(self) -> int:
        """How many samples of the references ahead of k it needs."""
        return self.recursion.lead

    def residual(self) -> Any:
        """Put the law into the system and subtract the references: 0 where the inversion is exact."""
        law = dict(self.updates)
        gaps = (sp.expand(gap.xreplace(law)) for gap in self.asked)
        return next((gap for gap in gaps if gap != 0 and not vanishes(gap)), sp.S.Zero)

    def latex(self, numbers: bool = False) -> str:
        """LaTeX of the law, with symbols or with numbers."""
        return (self.recursion.subs(self.system.values) if numbers else self.recursion).latex()

    def lines(self, numbers: bool = False) -> list[str]:
        """Return each equation as text, with symbols or with numbers."""
        values = self.system.values if numbers else {}
        return [f"{shown(left)} = {shown(right.xreplace(values))}" for left, right in self.updates]

    def __repr__(self) -> str:
        return f"SystemLaw({'; '.join([str(self.stability()).rstrip('.'), *self.lines(numbers=True)])})"


def compensators(system: System, inputs: tuple[str, ...] = ()) -> SystemLaw:
    """Derive the law of a system with as many inputs as outputs.

    Each y_i becomes r_i and each u_j becomes m_j. Each output reacts to the inputs after its delay d_i, so
    r_i[k+d_i] = F_i is one equation in all m_j[k]; these equations are solved together (Isidori, Nonlinear Control
    Systems, 1995, section 5.1: the decoupling matrix).

    Parameters
    ----------
    inputs : names of the inputs that are solved for
        Default: all. The other inputs are measured. There must be as many names as outputs.

    Raises
    ------
    NotInvertible
        Where there are not as many inputs as outputs, an output remembers more than inputs and outputs, an equation is
        not linear in the newest inputs, or these do not reach the outputs independently.
    """
    chosen = inputs or system.inputs
    if len(chosen) != len(system.outputs) or not set(chosen) <= set(system.inputs):
        raise NotInvertible(
            f"The outputs are {', '.join(system.outputs)}, the inputs {', '.join(chosen)}: a law needs as many; "
            f"name some of {', '.join(system.inputs)}."
        )
    if extra := [b.name for b in system.recursion.states if b.name not in system.outputs]:
        raise NotInvertible(
            f"The state {extra[0]} is not measured: a law for several outputs needs models without states."
        )
    moves = {signal(name): signal(f"m_{name}") for name in chosen}
    meant = moves | {signal(name): signal(f"r_{name}") for name in system.outputs}
    asked, delays = [], {}
    for left, right in system.recursion.updates:
        late = [lag(s) for s in samples(right) if s.base in moves]
        if not late:
            raise NotInvertible(f"No input acts on {left.base.name} directly.")
        delays[left.base.name] = min(late)
        asked.append(shift(swap(left - right, meant), min(late)))
    newest = [base[k] for base in moves.values()]
    gains = sp.Matrix([[-derivative(gap, m) for m in newest] for gap in asked])
    if any(samples(gain, m.base) and m in samples(gain) for gain in gains for m in newest):
        raise NotInvertible("An equation is not linear in the newest inputs.")
    determinant = sp.simplify(gains.det())
    value = determinant.xreplace(system.values)
    if determinant == 0 or (value.is_number and abs(float(value)) < 1e-300):
        raise NotInvertible("The newest inputs do not reach the outputs independently: their gains have determinant 0.")
    rest = sp.Matrix([gap.xreplace(dict.fromkeys(newest, sp.S.Zero)) for gap in asked])
    solved = gains.adjugate() * rest / determinant
    updates = tuple((m, sp.expand(e)) for m, e in zip(newest, solved, strict=True))
    return SystemLaw(system, delays, updates, tuple(asked))
