"""A fair free run: what no model can know of a new record is estimated on its first part and judged on the rest.

That is where the states start, and by how much the sensor has drifted since the fit. Every model is treated alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from ..data.metrics import nrmse
from ..data.record import Record
from ..data.units import in_units
from ..errors import FitError, ModelError
from ..models.model import Model
from .freerun import FreeRun
from .least_squares import smallest
from .simulate import Records, arrays, fitted, segments

Array = np.ndarray
FIRST, LEAST = 1.0, 50  # seconds that are used for the estimate; samples, where a second has fewer
STEPS, SETTLED = 30, 1e-9
DEPENDENT = 1e-6  # directions that the first part does not show stay where they are
MOST = 0.5  # of the mean square that a constant must explain to be spoken of


@dataclass(frozen=True)
class Aligned:
    """Free-run errors of one model on the same samples: those after the first part of each segment.

    Attributes
    ----------
    raw : float
        NRMSE of the run from the measured first outputs.
    started : float
        With the start of each segment estimated on its first part.
    aligned : float
        With a constant offset of the sensor, and what memory starts from, estimated there.
    offsets : tuple of floats
        Of each segment [unit of the output].
    first : tuple of ints
        Samples of each segment that the estimate used.
    constant : float
        The share of the raw mean square there that one constant in each segment explains.
    size : float
        That constant, rms over the segments [unit of the output].
    """

    raw: float
    started: float
    aligned: float
    offsets: tuple[float, ...]
    first: tuple[int, ...]
    constant: float
    size: float

    @property
    def helps(self) -> bool:
        """Whether the offset of the first part lessens the error of the rest."""
        return self.aligned < min(self.raw, self.started)

    @property
    def offset_explains(self) -> bool:
        """Whether a constant explains most of the raw error, and the first part shows it."""
        return self.constant > MOST and self.helps

    def sentence(self, unit: str = "") -> str:
        """Say how much of the error a constant is; an empty text where it is not most of it."""
        if not self.offset_explains:
            return ""
        return f"{self._amount(unit)} of the error is an offset of the new record"

    def advice(self, asked: bool, unit: str = "") -> str:
        """Say what comes of an estimate of the offset, or came of one that was `asked` for; empty where that is plain.

        What the first part shows need not hold for the rest: it may be a transient from before the record.
        """
        if self.offset_explains:
            return "" if asked else f"{self.sentence(unit)}; --align estimates it"
        other = "leave that out with --rows A:, or estimate on more with --align-on SECONDS"
        if asked and self.aligned > min(self.raw, self.started):
            return (
                f"the offset of the first part makes the error of the rest larger ({self.aligned:.3g} instead of "
                f"{min(self.raw, self.started):.3g}): it begins with something else, such as a transient; {other}"
            )
        if self.constant > MOST:
            return (
                f"{self._amount(unit)} of the error is a constant that the first part does not show: it begins with "
                f"something else, such as a transient; {other}, and --align"
            )
        return ""

    def _amount(self, unit: str) -> str:
        return f"{self.size:.2g}{f' {unit}' if unit else ''}"


def aligned(model: Model, records: Records, first: float | None = None) -> Aligned:
    """Judge a model in free run with the start and the sensor's offset of each segment estimated on its first part.

    Parameters
    ----------
    first : float, optional
        What the estimate uses of each segment [s]; one second by default, or 50 samples where a second has fewer. At
        most half of it is used, and at least what the model looks back.

    Raises
    ------
    ModelError
        For a time that is not positive, or a model without values.
    FitError
        Where a segment is too short.
    """
    fitted(model)
    if first is not None and not 0 < first < math.inf:
        raise ModelError(f"The part to align on must be a positive time, not {first:g} s.")
    parts = in_units(segments(records), model.info.units)
    used = [_samples(model, part, first) for part in parts]
    fixed = [sp.Eq(s, value) for s, value in model.values.items()]
    masks = [np.arange(_length(model, part)) < n for part, n in zip(parts, used, strict=True)]
    problem = FreeRun(model, parts, fixed, masks)
    measured = [d[problem.name] for d in problem.data]
    errors: tuple[list[Array], ...] = ([], [], [])
    offsets = []
    for i, n in enumerate(used):
        plain = problem.simulate(problem.start(fitted(model)), i)
        free, _ = _estimated(problem, i, False)
        both, offset = _estimated(problem, i, True)
        offsets.append(offset)
        for listed, run in zip(errors, (plain, free, both + offset), strict=True):
            listed.append((measured[i] - run)[n:])
    target = np.concatenate([y[n:] for y, n in zip(measured, used, strict=True)])
    raw, started, moved = (_error(target, np.concatenate(e)) for e in errors)
    means = np.concatenate([np.full(e.size, e.mean()) for e in errors[0]])
    square = float(np.mean(np.concatenate(errors[0]) ** 2))
    share = float(np.mean(means**2)) / square if 0 < square < math.inf else 0.0
    size = float(np.sqrt(np.mean(means**2)))
    return Aligned(raw, started, moved, tuple(offsets), tuple(used), share, size)


def _length(model: Model, part: Record) -> int:
    return int(arrays(model, part)[model.output.name].size)


def _samples(model: Model, part: Record, first: float | None) -> int:
    """Return how many samples of a segment the estimate uses."""
    depth, n = max(1, model.recursion.depth), _length(model, part)
    if n < 4 * (depth + 1):
        raise FitError(f"{part.name}: {n} samples are too few to estimate a start and to judge it.")
    wanted = max(round(FIRST / part.Ts) + 1, LEAST) if first is None else round(first / part.Ts) + 1
    return max(depth + 1, min(wanted, n // 2))


def _error(target: Array, error: Array) -> float:
    return nrmse(target, target - error) if np.all(np.isfinite(error)) else math.inf


def _estimated(problem: FreeRun, i: int, offset: bool) -> tuple[Array, float]:
    """Return the run of segment i from its estimated start, and the offset, by Gauss-Newton on its first part.

    Beside an offset the first outputs stay as measured, and only what nobody measured, memory, is estimated: where
    Sigma_y = 1 the first part does not tell a start from an offset. The offset is the median of what is left: a
    transient from the time before the record is none.
    """
    z, constant = problem.start(fitted(problem.model)), 0.0
    rows, own = slice(problem.edges[i], problem.edges[i + 1]), problem.own(i)
    moves = np.array([s.back is None or not offset for s in problem.starts], dtype=float)
    best, kept, step = math.inf, (z, constant), np.zeros(moves.size + 1)
    for _ in range(STEPS):
        residuals, slopes = (x[rows] for x in problem.run(z))
        gap = residuals + constant / problem.spread
        columns = np.column_stack([slopes[:, own] * moves, np.full(gap.size, offset / problem.spread)])
        cost = float(gap @ gap) if np.all(np.isfinite(columns)) else math.nan
        if not cost < best:  # halve the way back to the best one
            step = step / 2
        else:
            settled = cost > (1 - SETTLED) * best
            best, kept = cost, (z.copy(), constant)
            if settled:
                break
            step = smallest(columns, -gap, DEPENDENT)
        z, constant = kept[0].copy(), kept[1] + float(step[-1])
        z[own] += step[:-1]
    run = problem.simulate(kept[0], i)
    first = problem.rows[i]
    return run, float(np.median((problem.data[i][problem.name] - run)[first])) if offset else 0.0


def described(found: Sequence[tuple[str, Aligned]]) -> list[dict[str, Any]]:
    """Return the errors as rows for a table or JSON."""
    return [
        {
            "record": name, "raw": a.raw, "start_estimated": a.started, "offset_estimated": a.aligned,
            "offsets": list(a.offsets), "first_samples": list(a.first), "share_of_a_constant": a.constant,
        }
        for name, a in found
    ]  # fmt: skip
