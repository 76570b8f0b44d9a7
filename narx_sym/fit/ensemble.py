"""One model, many parameter sets: their errors, their free runs, or the band of these."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data.record import Record
from ..engines.compile import compile
from ..errors import ModelError
from ..models.model import Model
from .simulate import Records, arrays, initial_values, segments

Array = np.ndarray


def _runs(model: Model, thetas: Any, record: Record) -> Iterator[tuple[Array, Array]]:
    """Yield the error of the free run of each parameter set and the run itself, (N,); NaN from where it diverges."""
    thetas = np.atleast_2d(np.asarray(thetas, dtype=float))
    if thetas.ndim != 2 or thetas.shape[1] != len(model.symbols):
        raise ModelError(f"Parameter sets have the shape (sets, {len(model.symbols)}), not {thetas.shape}.")
    run, data, depth = compile(model.recursion), arrays(model, record), max(1, model.recursion.depth)
    measured = data[model.output.name]
    if measured.size <= depth:
        raise ModelError(f"The record {record.name!r} is shorter than the largest lag ({depth} samples).")
    for theta in thetas:
        # What effects start from is that of their own parameters.
        begin = initial_values(model.replace(theta=theta) if model.states else model, data, depth)
        y = run(data, theta, begin, start=depth, on_divergence="nan")[model.output.name]
        yield y - measured, y


def costs(model: Model, thetas: Any, records: Records) -> Array:
    """Return the mean squared free-run error of each parameter set.

    Parameters
    ----------
    thetas : (sets, n_theta) array
    records : Record or list of Record

    Returns
    -------
    (sets,) array [unit of the output squared]; infinite where the run diverges
    """
    depth = max(1, model.recursion.depth)
    with np.errstate(all="ignore"):
        parts = [
            [(e[depth:] @ e[depth:], e.size - depth) for e, _ in _runs(model, thetas, r)] for r in segments(records)
        ]
        squares, counts = np.sum(parts, axis=0).T
        return np.where(np.isfinite(squares), squares / counts, np.inf)


def trajectories(model: Model, thetas: Any, record: Record) -> Array:
    """Return the free run of each parameter set along a record, (sets, N) [unit of the output]."""
    return np.stack([y for _, y in _runs(model, thetas, record)])


@dataclass(frozen=True)
class Bands:
    """Per sample over the parameter sets: mean, lowest and highest free run, (N,) arrays [unit of the output]."""

    mean: Array
    low: Array
    high: Array


def bands(model: Model, thetas: Any, record: Record) -> Bands:
    """Summarise the free runs of many parameter sets; memory does not grow with their number."""
    mean, low, high = np.zeros(1), np.asarray(np.inf), np.asarray(-np.inf)
    for count, (_, y) in enumerate(_runs(model, thetas, record), 1):
        mean, low, high = mean + (y - mean) / count, np.minimum(low, y), np.maximum(high, y)
    return Bands(mean, low, high)
