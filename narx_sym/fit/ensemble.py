"""One model, many parameter sets: costs, bands or trajectories of all of them in one compiled pass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..data.record import Record
from ..engines.plan import Plan
from ..errors import ModelError
from ..models.model import Model
from ..symbolic.recursion import Recursion
from .simulate import Records, arrays, initial_values, segments

Array = np.ndarray
STRETCH, TINY = 4096, 1e-290  # values about to become denormal are put to zero after so many steps: they are slow


@lru_cache(maxsize=32)
def _built(recursion: Recursion, keep: bool, output: int) -> tuple[Plan, Any, list[tuple[int, int]], int]:
    from ..engines.machine import ensemble  # needs llvmlite

    plan = Plan.of(recursion)
    return plan, ensemble.build(plan, keep, output), ensemble.past(plan), ensemble.SETS


def _checked(model: Model, thetas: Any) -> Array:
    thetas = np.atleast_2d(np.asarray(thetas, dtype=float))
    if thetas.ndim != 2 or thetas.shape[1] != len(model.symbols):
        raise ModelError(f"Parameter sets have the shape (sets, {len(model.symbols)}), not {thetas.shape}.")
    return thetas


def _run(model: Model, thetas: Array, record: Record, keep: bool) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield per group of sets: their slice, sums of squares, kept runs (N, sets) and the measured output."""
    states = model.recursion.states
    plan, run, keys, sets = _built(model.recursion, keep, states.index(model.output))
    data = arrays(model, record)
    measured = np.ascontiguousarray(data[model.output.name])
    inputs = [np.ascontiguousarray(data[base.name]) for base in plan.recursion.inputs]
    n, depth = measured.size, max(1, plan.recursion.depth)
    if n <= depth:
        raise ModelError(f"The record {record.name!r} is shorter than the largest lag ({depth} samples).")

    def begin_of(theta: Array) -> list[float]:
        """Return what one set remembers before the first computed sample: what its effects start from is its own."""
        initial = initial_values(model.replace(theta=theta), data, depth)
        return [initial[states[s].name][depth - i] for s, i in keys]

    sets_of = thetas if model.states else thetas[:1]
    begins = np.array([begin_of(theta) for theta in sets_of]).T
    kept = np.empty((n if keep else 1, sets))
    for first in range(0, len(thetas), sets):
        part = slice(first, min(first + sets, len(thetas)))
        used = part.stop - part.start
        # The last group is filled up with copies of its last set.
        chosen = np.minimum(np.arange(first, first + sets), len(thetas) - 1)
        theta = np.ascontiguousarray(thetas[chosen].T)
        past = np.ascontiguousarray(begins[:, np.minimum(chosen, begins.shape[1] - 1)])
        cost = np.zeros(sets)
        if keep:
            kept[:depth] = measured[:depth, None]
        for begin in range(depth, n, STRETCH):
            run(inputs, measured, past, theta, cost, kept, begin, min(begin + STRETCH, n))
            past[np.abs(past) < TINY] = 0.0
        yield part, cost[:used], kept[:, :used], measured


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
    thetas = _checked(model, thetas)
    total, count = np.zeros(len(thetas)), 0
    for record in segments(records):
        for part, cost, _, _ in _run(model, thetas, record, keep=False):
            total[part] += cost
        count += len(record) - max(model.lead, 0) - max(1, model.recursion.depth)
    with np.errstate(all="ignore"):
        return np.where(np.isfinite(total), total / max(count, 1), np.inf)


def trajectories(model: Model, thetas: Any, record: Record) -> Array:
    """Return the free run of each parameter set along a record, (sets, N) [unit of the output]."""
    thetas = _checked(model, thetas)
    return np.concatenate([kept.T.copy() for _, _, kept, _ in _run(model, thetas, record, keep=True)])


@dataclass(frozen=True)
class Bands:
    """Per sample over the parameter sets: mean, lowest and highest free run, (N,) arrays [unit of the output]."""

    mean: Array
    low: Array
    high: Array


def bands(model: Model, thetas: Any, record: Record) -> Bands:
    """Summarise the free runs of many parameter sets; memory does not grow with their number."""
    thetas = _checked(model, thetas)
    total, low, high = 0.0, np.inf, -np.inf
    for _, _, kept, _ in _run(model, thetas, record, keep=True):
        total = total + kept.sum(axis=1)
        low, high = np.minimum(low, kept.min(axis=1)), np.maximum(high, kept.max(axis=1))
    return Bands(np.asarray(total) / len(thetas), np.asarray(low), np.asarray(high))
