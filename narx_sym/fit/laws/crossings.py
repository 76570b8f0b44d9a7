"""Where a stage of a law has solutions, along a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import sympy as sp

from ...engines.columns import lambdify
from ...inversion.compensator import Compensator
from ...inversion.solution import Solution
from ...symbolic.signals import lag, r, samples

Array = np.ndarray
GRID = 801  # points of a grid
HALVES = 60  # of a cell of the grid
STILL = 1e-9  # of its size: what moves less rests
FAR, OUTSIDE = 100.0, 100  # of a grid's width, how far a search goes on to each side, and its points there


def around(reached: Array, more: float = 0.5) -> Array:
    """Return a grid over what was reached and this part of it more to each side."""
    low, high = float(reached.min()), float(reached.max())
    size = max(abs(low), abs(high)) or 1.0
    wide = more * (high - low) if high - low > STILL * size else size
    return np.linspace(low - wide, high + wide, GRID)


def beyond(grid: Array) -> Array:
    """Return a grid that goes on to both sides, in steps that grow as it does, to FAR times its width."""
    steps = np.geomspace(grid[1] - grid[0], FAR * np.ptp(grid), OUTSIDE)
    return np.concatenate([grid[0] - steps[::-1], grid, grid[-1] + steps])


def crossings(gap: Array) -> Array:
    """Return between which points of a grid a stage has solutions, (K, G - 1) bool, by its gap there."""
    side = gap > 0
    return side[:, 1:] != side[:, :-1]


def bisected(gap: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Return where a gap changes its sign between two ends, (K,), to the last digit."""
    ends = np.stack([low, high])
    above = gap(ends[0][:, None])[:, 0] > 0
    for _ in range(HALVES):
        middle = ends.mean(axis=0)
        first = (gap(middle[:, None])[:, 0] > 0) == above
        ends = np.where([first, ~first], middle, ends)
    return np.asarray(ends.mean(axis=0))


def gap_along(
    law: Compensator, stage: Solution, values: Mapping[str, Array], target: Array, at: Array, front: int = 0
) -> Callable[[Array], Array]:
    """Return what is left of a stage's equation as a function of values of its unknown.

    Parameters
    ----------
    values : what a run has computed, with `front` samples before the first one
    at : (K,) array of samples

    Returns
    -------
    function of a (1 or K, G) array that returns a (K, G) array
    """
    assert law.staged is not None
    leads = {left.base: -lag(left) for left, _ in law.beside()}
    delay, names = law.staged.delay, [s for s in samples(stage.expr - stage.target) if s != stage.unknown]
    held = np.concatenate([target, np.full(delay + 1, target[-1])])

    def along(s: sp.Indexed) -> Array:
        """Return a sample at every chosen k."""
        if s.base == r:  # the law's own past is the model's
            past = np.concatenate([np.full(delay, target[0]), values["y"][front:]])
            return held[at + delay] if -lag(s) == delay else past[np.maximum(at - lag(s), 0)]
        if s == stage.target:
            return values[f"{s.base.name}_wanted"][at + front]
        column = values[s.base.name]
        return column[np.clip(at + front - lag(s) - leads.get(s.base, 0), 0, column.size - 1)]

    plain = [sp.Symbol(f"s{i}", real=True) for i in range(len(names) + 1)]
    gap = (stage.expr - stage.target).xreplace(law.model.values)
    function = lambdify([gap.xreplace(dict(zip([*names, stage.unknown], plain, strict=True)))], plain)
    columns = [along(s)[:, None] for s in names]
    return lambda points: np.broadcast_to(function(*columns, points)[0], (at.size, points.shape[1]))
