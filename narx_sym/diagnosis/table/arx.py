"""Where the fit of an open core starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import lfilter

from ...data.record import Record
from .hypotheses import Core

Array = np.ndarray


def arx_start(records: Sequence[Record], core: Core, point: Mapping[str, float]) -> Array:
    """Return a, b and the constant of a core by Steiglitz & McBride (1965): least squares, filtered by 1/A in turns."""
    a = np.zeros(core.n_y)
    best, found = np.inf, np.zeros(core.n_y + core.n_u + 1)
    for _ in range(6):
        rows, targets = [], []
        for record in records:
            ys, us = _around(record, point)
            us = _later(us, core.delay)
            A = np.concatenate([[1.0], -a])
            f = [lfilter([1.0], A, x) for x in (ys, us, np.ones(len(ys)))]
            d = max(core.n_y, core.n_u)
            lag = [f[0][d - i : len(ys) - i] for i in range(1, core.n_y + 1)]
            lag += [f[1][d - j : len(ys) - j] for j in range(core.n_u)] + [f[2][d:]]
            target = f[0][d:]
            if core.integrating and core.n_y:
                target = target - lag[0]
                lag = [lag[i] - lag[0] for i in range(1, core.n_y)] + lag[core.n_y :]
            rows.append(np.column_stack(lag))
            targets.append(target)
        solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=1e-10)[0]
        if core.integrating and core.n_y:
            more = solution[: core.n_y - 1]
            solution = np.concatenate([[1 - more.sum()], more, solution[core.n_y - 1 :]])
        a = solution[: core.n_y].copy()
        if core.n_y and not core.integrating:
            poles = np.roots(np.concatenate([[1.0], -a]))
            size = np.abs(poles)
            if size.max() >= 0.9995:  # reflected into the circle
                poles = np.where(size >= 0.9995, poles / size**2 * 0.999, poles)
                a = -np.real(np.poly(poles))[1:]
                solution[: core.n_y] = a
        error = 0.0
        for record in records:
            ys, us = _around(record, point)
            us = _later(us, core.delay)
            e = lfilter(solution[core.n_y : -1], np.concatenate([[1.0], -a]), us)
            e = e + lfilter([solution[-1]], np.concatenate([[1.0], -a]), np.ones(len(us))) - ys
            error += float(np.sum(e**2))
        if error < best or not np.isfinite(best):
            best, found = error, solution.copy()
        if not core.n_y or core.integrating:
            break
    return found


def resampled(a: Array, factor: int) -> Array:
    """Return the coefficients of older outputs whose poles decay as much in `factor` samples as those of a in one."""
    poles = np.roots(np.concatenate([[1.0], -np.asarray(a)]))
    angles = np.where(np.isreal(poles), 0.0, np.angle(poles))  # nothing in between swings as a negative pole does
    return -np.atleast_1d(np.real(np.poly((np.abs(poles) * np.exp(1j * angles)) ** (1 / factor))))[1:]


def start_beside(records: Sequence[Record], core: Core, point: Mapping[str, float], a: Array) -> Array:
    """Return a, b and the constant of a core with given coefficients a of older outputs.

    The rest is least squares of the free run; where each record starts is unknown.
    """
    A, width = np.concatenate([[1.0], -a]), core.n_u + 1
    rows, targets = [], []
    for i, record in enumerate(records):
        ys, us = _around(record, point)
        driven = [_later(us, d) for d in range(core.delay, core.delay + core.n_u)]
        own = [np.eye(1, len(us), k)[0] for k in range(core.n_y)]
        columns = np.zeros((len(us), width + len(records) * core.n_y))
        columns[:, :width] = np.column_stack([lfilter([1.0], A, x) for x in (*driven, np.ones(len(us)))])
        for j, x in enumerate(own, width + i * core.n_y):
            columns[:, j] = lfilter([1.0], A, x)
        rows.append(columns)
        targets.append(ys)
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=1e-10)[0]
    return np.concatenate([a, found[:width]])


def _around(record: Record, point: Mapping[str, float]) -> tuple[Array, Array]:
    """Return output and input measured from an operating point."""
    return record.y - point.get("y", 0.0), record.u - point.get("u", 0.0)


def _later(x: Array, delay: int) -> Array:
    """Return a signal so many samples later; it rests before it begins."""
    return np.concatenate([np.full(delay, x[0]), x])[: x.size]
