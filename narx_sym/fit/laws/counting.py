"""What is known about the solutions of a law's stages: by proof, else by counting along a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import NarxError
from ...inversion.compensator import Compensator
from ..simulate import vector
from .crossings import around, crossings, gap_along
from .damping import damping
from .run import follow

POINTS, TRIAL = 200, 400  # where solutions are counted, along a sine of this length


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
            return said if self.proved else f"{said}. Not counted: no reference was given"
        counted = f"{said}. Counted at {self.points} points of a run: "
        if self.good:
            return counted + "exactly one solution at each, within the range of the run widened by half"
        parts = [
            f"{name} at {share:.1%} (first at r = {(self.first or {})[name]:.4g})"
            for name, share in (("none", self.none), ("several", self.several))
            if share
        ]
        return f"{counted}one at {1 - self.none - self.several:.1%}, {', '.join(parts)}"


def check(law: Compensator, reference: Any = None, m0: Any = None, channels: Mapping[str, Any] | None = None) -> Check:
    """Check whether each stage of a law has exactly one solution: by proof, else by counting along a run.

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
        channels = {name: np.zeros(TRIAL) for name in law.model.channels} | law.named(channels)
    if damping(law).rings:
        return Check((*proofs, "the law rings, so nothing is counted along a run"), not is_open)
    target = vector(reference, "reference", least=2)
    try:
        found = follow(law, target, m0, channels, share=None, back=False)
    except NarxError as error:
        return Check((*proofs, f"it does not run: {error}"), not is_open)
    ahead, n = law.preview, target.size
    chosen = np.unique(np.linspace(2, n - ahead - 1, min(POINTS, n - ahead - 2)).astype(int))
    several = np.zeros(chosen.size, dtype=bool)
    for stage in stages:
        reached = found.values[stage.unknown.base.name][:n]
        gap = gap_along(law, stage, found.values, target, chosen)
        several |= crossings(gap(around(reached)[None, :])).sum(axis=1) > 1
    none = found.unreached[chosen + ahead]
    several &= ~none
    first = {
        name: float(target[chosen + ahead][mask][0])
        for name, mask in (("none", none), ("several", several))
        if mask.any()
    }
    return Check(proofs, not is_open, int(chosen.size), float(none.mean()), float(several.mean()), first)
