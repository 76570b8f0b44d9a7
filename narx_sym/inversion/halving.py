"""A root that is proved to be alone, in a fixed number of steps: for languages without a root finder.

With a slope that is never nearer to zero than `steep`, up or down, the root of a gap lies between the last value and
gap/steep from there, on the side to which the gap falls. Halving this stretch is one update per step, as an equation; a
step of Newton's method makes the last digits good.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import sympy as sp

from ..errors import NotInvertible
from ..symbolic.recursion import Recursion
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import k, signal
from .compensator import Compensator
from .monotone import bounds
from .solution import Root, Solution
from .stages import wanted

STEPS = 60  # halves: of the stretch 1e-18 is left, before Newton's step


def halved(law: Compensator, recursion: Recursion) -> Recursion:
    """Return what a law computes without root finders, for the present values of its parameters.

    Raises
    ------
    NotInvertible
        Where a stage may have several roots, or none.
    """
    rooted: dict[Any, Solution] = {}
    for stage in law.staged.stages if law.staged else ():
        if stage.closed_form:
            continue
        if stage.steep is None:
            raise NotInvertible(f"This law cannot be exported: {stage.proof}.")
        rooted |= {wanted(stage.unknown.base): stage, stage.unknown.base: stage}
    updates: list[tuple[Any, Any]] = []
    for left, right in recursion.subs(law.model.values).updates if rooted else ():
        for root in sorted(right.atoms(Root), key=sp.default_sort_key):
            steps, found = _steps(root, rooted[left.base], [str(b) for b in (*recursion.states, *recursion.inputs)])
            updates += steps
            right = right.xreplace({root: found})
        updates.append((left, right))
    return Recursion(tuple(updates), recursion.parameters) if rooted else recursion  # starts may need them


def _steps(root: Root, stage: Solution, taken: Sequence[str]) -> tuple[list[tuple[Any, Any]], Any]:
    """Return the updates that halve the stretch in which a root lies, and the root."""
    gap, w, last, *_ = root.args
    slope = derivative(gap, w)
    side = sp.Float(1.0 if bounds(slope, w, {})[0] > 0 else -1.0) / sp.Float(stage.steep)
    name = f"{stage.unknown.base}_half"
    while any(other.startswith(name) for other in taken):
        name += "_"
    at = [signal(f"{name}_{i}") for i in range(STEPS + 1)]
    size = signal(f"{name}_size")
    whole = side * gap.xreplace({w: last}) / 2
    steps = [(size[k], whole), (at[0][k], last - size[k])]
    for i, (before, after) in enumerate(pairwise(at), start=1):
        here = gap.xreplace({w: before[k]})
        move = sp.sign(here) * sp.sign(side) * sp.Abs(size[k]) * sp.Float(0.5) ** i
        steps.append((after[k], before[k] - move))
    end = {w: at[-1][k]}
    return steps, at[-1][k] - (gap / slope).xreplace(end)
