"""Least squares of cores: where the fit of an open core starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....data.record import Record
from ....engines.algebra import filtered, smallest
from ....fit.bases.integrating import poles
from ...settings import DEPENDENT, EDGE, MOVES, TURNS
from ..hypotheses import Core

Array = np.ndarray
Driven = tuple[Sequence[Array], int]  # an input, (N,) per record, and how many b it has


def arx_start(
    records: Sequence[Record], core: Core, a: Array | None = None, turns: int = TURNS, driven: Sequence[Driven] = (),
    counts: Sequence[Array] = (),
) -> Array:  # fmt: skip
    """Return a, b and the constant of a core by Steiglitz & McBride (1965): least squares, filtered by 1/A in turns.

    Records are measured from the operating point. The first filter has given coefficients a, if any. An integrating
    core is one of the steps of the output; driven by u alone it is not filtered.

    Parameters
    ----------
    driven : inputs instead of those of the core, which come later by its delays
        Each with the number of its b, which follow one another.
    counts : which samples do, (N,) bool per record
    """
    steps = core.integrating and core.n_y > 0
    n, turns = core.n_y - steps, 1 if steps and not driven else turns
    driven = driven or inputs(records, core)
    outputs = [np.diff(r.y, prepend=r.y[0]) if steps else r.y for r in records]
    first = max(core.n_y, *(taps for _, taps in driven)) + core.dead  # before, nobody knows what drives the output
    a = np.zeros(n) if a is None or steps else _inside(a)
    best, found = np.inf, np.zeros(n + sum(taps for _, taps in driven) + 1)
    for _ in range(turns):
        rows, targets = [], []
        for i, y in enumerate(outputs):
            f = filtered(polynomial(a), np.column_stack([y, *(x[i] for x, _ in driven), np.ones(y.size)])).T
            lag = [f[0, first - j : y.size - j] for j in range(1, n + 1)]
            lag += [x[first - j : y.size - j] for x, (_, taps) in zip(f[1:], driven, strict=False) for j in range(taps)]
            used = counts[i][first:] if counts else slice(None)
            rows.append(np.column_stack([*lag, f[-1, first:]])[used])
            targets.append(f[0, first:][used])
        solution = smallest(np.concatenate(rows), np.concatenate(targets), DEPENDENT)
        if not np.isfinite(solution).all():  # a filtered signal ran away: there is no such start
            return np.full(found.size + steps, np.nan)
        solution[:n] = _inside(solution[:n])
        if turns == 1:
            found = solution
            break
        a = solution[:n].copy()
        error = 0.0
        for i, y in enumerate(outputs):
            e, at = solution[-1] * np.ones(y.size) - np.convolve(polynomial(a), y)[: y.size], n
            for x, taps in driven:
                e, at = e + np.convolve(solution[at : at + taps], x[i])[: y.size], at + taps
            error += float(np.sum(filtered(polynomial(a), e)[core.dead :] ** 2))
        if error < best or not np.isfinite(best):
            best, found = error, solution.copy()
        if not n:
            break
    return np.concatenate([-np.convolve(polynomial(found[:n]), [1.0, -1.0])[1:], found[n:]]) if steps else found


def _inside(a: Array) -> Array:
    """Return coefficients of older outputs with the poles on and outside the unit circle reflected."""
    if not a.size or (size := np.abs(at := poles(a))).max() < EDGE:
        return a
    return -np.real(np.poly(np.where(size >= EDGE, at / size**2 * MOVES, at)))[1:]


def resampled(a: Array, factor: float) -> Array:
    """Return the coefficients of older outputs whose poles decay as much in `factor` samples as those of a in one."""
    at = poles(a)
    angles = np.where(np.isreal(at), 0.0, np.angle(at))  # nothing in between swings as a negative pole does
    return -np.atleast_1d(np.real(np.poly((np.abs(at) * np.exp(1j * angles)) ** (1 / factor))))[1:]


def zeroed(b: Array, factor: int) -> Array:
    """Return an input's coefficients, of the same sum, with zeros as `resampled` has poles."""
    made = np.eye(1, b.size)[0]
    with np.errstate(all="ignore"):
        more = -b[1:] / b[0]
    if np.isfinite(more).all() and more.sum() != 1.0:
        made[1:] = -resampled(more, factor)
    return np.asarray(made * b.sum() / made.sum())


def start_beside(
    records: Sequence[Record], core: Core, a: Array, driven: Sequence[Sequence[Array]] = ()
) -> tuple[Array, list[Array]]:
    """Return a, b and the constant of a core with given coefficients a of older outputs, and its errors, (N,) each.

    The rest is least squares of the free run, with where each record starts: poles near 1 make much of the noise of
    measured starts. NaN where its poles, or its inputs, run away.

    Parameters
    ----------
    driven : inputs instead of those of the core, one (N,) array per record each
        Each has a b of its own, one behind the other.
    """
    driven = driven or [x for x, _ in inputs(records, core)]
    n, width = core.n_y, core.n_u * len(driven) + 1
    rows = []
    for i, record in enumerate(records):
        columns = np.zeros((len(record), width + len(records) * n))
        columns[:, :width] = np.column_stack(
            [*(later(x[i], j) for x in driven for j in range(core.n_u)), np.ones(len(record))]
        )
        columns[:, width + i * n : width + (i + 1) * n] = np.eye(len(record), n)
        rows.append(filtered(polynomial(a), columns))
    runs = np.concatenate(rows)
    if not np.isfinite(runs).all():
        return np.full(n + width, np.nan), [np.full(len(r), np.nan) for r in records]
    arrived = np.concatenate([np.arange(len(r)) >= core.dead for r in records])
    measured = np.concatenate([r.y for r in records])
    found = smallest(runs[arrived], measured[arrived], DEPENDENT)
    return np.concatenate([a, found[:width]]), [run @ found - r.y for run, r in zip(rows, records, strict=True)]


def gains(
    records: Sequence[Record], core: Core, a: Array, driven: Sequence[Sequence[Array]],
    others: Sequence[Sequence[Array]] = (),
) -> Array:  # fmt: skip
    """Return c of the input x0 + c1 x1 + c2 x2 ... of a core with given a, (n,); NaN where there is none.

    Parameters
    ----------
    driven : x0, x1, ...
        One (N,) array per record each.
    others : its further inputs
    """
    found = start_beside(records, core, a, [*driven, *others])[0]
    return nearest_product(found[core.n_y :][: core.n_u * len(driven)], driven)


def nearest_product(b: Array, driven: Sequence[Sequence[Array]]) -> Array:
    """Return c of the nearest b times (1, c), where each input has b of its own (Bai 1998), (n,); NaN if there is none.

    They follow one another; each input counts in its own size.
    """
    b = b.reshape(len(driven), -1)
    with np.errstate(all="ignore"):
        size = np.array([float(np.std(np.concatenate(x))) or 1.0 for x in driven])
        if not np.isfinite(b * size[:, None]).all():
            return np.full(len(driven) - 1, np.nan)
        along = np.linalg.svd(b * size[:, None])[0][:, 0] / size
        return np.asarray(along[1:] / along[0])


def inputs(records: Sequence[Record], core: Core) -> list[Driven]:
    """Return the inputs of a core as late as they come, each with the number of its b."""
    return [([later(r.signals[name], delay) for r in records], core.n_u) for name, delay in core.inputs]


def later(x: Array, delay: int) -> Array:
    """Return a signal so many samples later; it rests before it begins."""
    return np.concatenate([np.full(delay, x[0]), x])[: x.size]


def polynomial(a: Array) -> Array:
    """Return A of A y = B u."""
    return np.concatenate([[1.0], -a])
