"""What is known about the solutions of a law's stages: by proof, else by counting along a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from ...engines.columns import lambdify
from ...errors import NarxError
from ...inversion.compensator import Compensator
from ...inversion.solution import Solution
from ...symbolic.signals import lag, r, samples
from ..simulate import vector
from .damping import damping
from .run import Following, follow

Array = np.ndarray
POINTS, GRID, TRIAL = 200, 801, 400  # where solutions are counted, on how fine a grid, along a sine of this length


@dataclass(frozen=True)
class Check:
    """What is known about the solutions of a law's stages.

    Attributes
    ----------
    proofs : texts
        What algebra says about each stage.
    proved : bool
        Whether algebra leaves nothing open: exactly one solution, wherever the machine is.
    points : int
        Where solutions were counted, along a run; 0 where that was not needed or not possible.
    none, several : float
        The share of the points without a solution, and with more than one within the range of the run, widened by half.
    first : mapping of "none" and "several" to the reference at the first such point [unit of y]
    """

    proofs: tuple[str, ...]
    proved: bool = False
    points: int = 0
    none: float = 0.0
    several: float = 0.0
    first: Mapping[str, float] | None = None

    @property
    def good(self) -> bool:
        """Whether nothing speaks against exactly one solution."""
        return not self.none and not self.several and (self.proved or self.points > 0)

    def __str__(self) -> str:
        said = "; ".join(self.proofs)
        if not self.points:
            return said if self.proved else f"{said}. Not counted: give a reference to check(reference)"
        counted = f"{said}. Counted at {self.points} points of a run: "
        if self.good:
            return counted + "exactly one solution at each"
        parts = [
            f"{name} at {share:.1%} (first at r = {(self.first or {})[name]:.4g})"
            for name, share in (("none", self.none), ("several", self.several))
            if share
        ]
        return f"{counted}one at {1 - self.none - self.several:.1%}, {', '.join(parts)}"


def check(law: Compensator, reference: Any = None, m0: Any = None, channels: Mapping[str, Any] | None = None) -> Check:
    """Say whether each stage of a law has exactly one solution: by proof, else by counting along a run.

    Parameters
    ----------
    reference : (N,) array, optional [unit of y]
        By default a slow sine through nine tenths of the identified outputs, where algebra leaves something open;
        further channels are zero then.
    """
    stages = law.staged.stages if law.staged else ()
    note = (law.staged.note,) if law.staged and law.staged.note else ()
    proofs = (*(s.proof for s in stages), *note) or ("m[k] enters linearly: exactly one for every reference",)
    is_open = any(s.needs or not s.proved for s in stages)
    low, high = law.model.info.ranges.get("y", (0.0, 0.0))
    if not stages or not law.model.values or (reference is None and not (is_open and high > low)):
        return Check(proofs, not is_open)
    if reference is None:
        wave = np.sin(2 * np.pi * np.arange(TRIAL) / (TRIAL / 2))
        reference = (low + high) / 2 + 0.45 * (high - low) * wave
        channels = {name: np.zeros(TRIAL) for name in law.model.channels} | dict(channels or {})
    if damping(law).rings:
        return Check((*proofs, "the law rings, so nothing is counted along a run"), not is_open)
    target = vector(reference, "reference", least=2)
    try:
        found = follow(law, target, m0, channels, share=None)
    except NarxError as error:
        return Check((*proofs, f"it does not run: {error}"), not is_open)
    ahead, n = law.preview, target.size
    chosen = np.unique(np.linspace(2, n - ahead - 1, min(POINTS, n - ahead - 2)).astype(int))
    several = np.zeros(chosen.size, dtype=bool)
    for stage in stages:
        several |= _count(law, stage, found, target, chosen) > 1
    none = found.missed[chosen + ahead]
    several &= ~none
    first = {
        name: float(target[chosen + ahead][mask][0])
        for name, mask in (("none", none), ("several", several))
        if mask.any()
    }
    return Check(proofs, not is_open, int(chosen.size), float(none.mean()), float(several.mean()), first)


def _count(law: Compensator, stage: Solution, found: Following, target: Array, at: Array) -> Array:
    """Count the solutions of one stage at some samples of a run: the changes of sign on a grid."""
    assert law.staged is not None
    leads = {left.base: -lag(left) for left, _ in law.beside()}
    delay, names = law.staged.delay, [s for s in samples(stage.expr - stage.target) if s != stage.unknown]
    held = np.concatenate([target, np.full(delay + 1, target[-1])])

    def along(s: Any) -> Array:
        """Return a sample at every chosen k."""
        if s.base == r:  # the law's own past is the model's
            past = np.concatenate([np.full(delay, target[0]), found.values["y"]])
            return held[at + delay] if -lag(s) == delay else past[np.maximum(at - lag(s), 0)]
        if s == stage.target:
            return found.values[f"{s.base.label}_wanted"][at]
        column = found.values[str(s.base.label)]
        place = at - lag(s) - leads.get(s.base, 0)
        return column[np.clip(place, 0, column.size - 1)]

    base = stage.unknown.base
    reached = found.values[str(base.label)][: target.size]
    low, high = float(reached.min()), float(reached.max())
    wide = 0.5 * (high - low) or 1.0
    grid = np.linspace(low - wide, high + wide, GRID)
    plain = [sp.Symbol(f"s{i}", real=True) for i in range(len(names) + 1)]
    gap = (stage.expr - stage.target).xreplace(law.model.values)
    gap = gap.xreplace(dict(zip([*names, stage.unknown], plain, strict=True)))
    columns = [along(s)[:, None] for s in names]
    found_gap = lambdify([gap], plain)(*columns, grid[None, :])[0]
    side = np.broadcast_to(found_gap, (at.size, GRID)) > 0
    return np.asarray((side[:, 1:] != side[:, :-1]).sum(axis=1))
