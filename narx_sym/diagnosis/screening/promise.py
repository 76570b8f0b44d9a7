"""The smallest size of each effect that would be seen: what is promised of a record in which nothing was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import pinv

from ..settings import ALIKE, BLOCKS, FOLDS, POWER, TURNS
from ..table.verdict import price
from .products import bases, orthonormal, told
from .scored import Scored

Array = np.ndarray


def detectable(scored: Scored) -> dict[str, float]:
    """Return per effect the rms by which it moves the output where 80 % of such records would show it [unit of y].

    So far as its direction tells what it does: tests/bench/power.py counts.

    It is seen as itself or as any other effect that passes its test and is worth its price. Its forms and shapes count
    by their median; of the places where it may act, the one where it shows least. Where most of them never show, as a
    dead zone under two levels, nothing is promised.
    """
    groups = [d.columns for d in scored.directions]
    # Its own, and one of the core, which is chosen again: what the base leaves to noise pays for itself beside it.
    unknowns = [d.columns.stop - d.columns.start + len(d.variant.shape) + 1 for d in scored.directions]
    costs = np.array([price(1.0, n, 1) for n in unknowns])
    line, residual, matrix = scored.line, scored.line.residual, scored.matrix
    own, starts = line.own[:, : line.problem.free], line.own[:, line.problem.free :]
    folds = np.arange(residual.size) * BLOCKS // residual.size % FOLDS
    left = left_out(own, starts, matrix, folds)
    begins = np.arange(BLOCKS) * residual.size // BLOCKS
    noise = np.maximum(np.add.reduceat(residual**2, begins), np.finfo(float).tiny)
    parts = np.array([np.add.reduceat((left[:, c] ** 2).sum(axis=1), begins) for c in groups])
    products, error = left.T @ left, float(residual @ residual)
    worth = paid(groups, products, error, costs + ALIKE)
    for _ in range(TURNS):
        margin = doubt(parts, noise, residual.size, costs, worth.min(axis=1))
        worth = paid(groups, products, error, costs + margin[:, None])
    energy = np.array([np.einsum("ij,ij->", matrix[:, c], matrix[:, c]) for c in groups]) / residual.size
    shows = np.min(np.maximum(scored.scores.passes, worth), axis=1)
    moves = energy > 0  # what moves nothing never shows
    sizes = np.sqrt(np.where(moves, shows, np.inf) * np.where(moves, energy, 1.0))
    found: dict[str, dict[str, list[float]]] = {}
    for direction, size in zip(scored.directions, sizes, strict=True):
        variant = direction.variant
        found.setdefault(variant.id, {}).setdefault(variant.where, []).append(float(size))
    least = {name: max(map(float, map(np.median, places.values()))) for name, places in sorted(found.items())}
    return {name: size for name, size in least.items() if np.isfinite(size)}


def doubt(energy: Array, noise: Array, count: int, costs: Array, grown: Array) -> Array:
    """Return by how much each effect, its energy grown so often, is to be worth more than its price, (groups,).

    What costs as much as nothing, as far as the blocks scatter, is not seen (`verdict.alike`); in 80 % of records it is
    with so much more as noise adds or takes. `energy`, (groups, BLOCKS), is what a refit leaves of each in the blocks,
    `noise` that of the residual there, of so many samples.
    """
    more = energy * np.where(np.isfinite(grown), grown, 0.0)[:, None]  # of what is never worth it nothing is asked
    gap, whole = np.log1p(more / noise), more.sum(axis=1) / noise.sum()
    scatter = np.maximum(ALIKE, gap.std(axis=1) / np.sqrt(BLOCKS))
    chance = 2 * POWER * np.sqrt(whole / count) / (1 + whole)
    return np.asarray(scatter + chance + np.maximum(0.0, np.log1p(whole) - costs - gap.mean(axis=1)))


def left_out(own: Array, starts: Array, directions: Array, folds: Array) -> Array:
    """Return what a refit leaves of each direction in each fold if that fold is not fitted.

    The `own` directions of the parameters are fitted beside those of the starts, and then the starts on all samples, as
    the table's rows are judged.
    """
    left, shifts = np.empty_like(directions), orthonormal(starts)
    energy = np.einsum("ij,ij->j", own, own)
    own = own / np.sqrt(np.where(energy > 0, energy, 1.0))  # whatever the units
    beside = np.column_stack([own, shifts])
    for fold in np.unique(folds):
        of = folds == fold
        fitted = pinv(np.where(of[:, None], 0.0, beside))[: own.shape[1]] @ directions
        errors = directions - own @ fitted
        left[of] = (errors - shifts @ (shifts.T @ errors))[of]
    return left


def paid(groups: Sequence[slice], products: Array, error: float, costs: Array) -> Array:
    """Return by how much the energy of a group's columns (row) is to grow until a group (column) is worth its `costs`.

    Grown by s, an effect makes of the squared `error` e the sum e + s E; a group explains its own columns' part of s E,
    and is to lower the logarithm of that sum by its cost. `products`, (M, M), are those of the columns.
    """
    whole = products.diagonal()
    basis, owner = bases(products, whole, groups)
    explained = told(groups, products, basis, owner)
    energy = np.array([whole[columns].sum() for columns in groups])[:, None]
    share, prices = explained / np.where(energy > 0, energy, 1.0), np.expm1(costs)
    worth = share - prices * np.maximum(1 - share, 0.0)
    usable = (worth > 0) & (energy > 0)
    return np.where(usable, error * prices / np.where(usable, worth * energy, 1.0), np.inf)
