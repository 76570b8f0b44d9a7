"""The smallest size of each effect that would be seen: what is promised of a record in which nothing was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import pinv

from ..table.frame import BLOCKS, FOLDS, UNSEEN
from ..table.verdict import ALIKE, price
from .products import bases, orthonormal, told
from .scored import Scored

Array = np.ndarray


def detectable(scored: Scored) -> dict[str, float]:
    """Return per effect the rms by which it moves the output where about 80 % of such records show it [unit of y].

    It is seen as itself or as any other effect that passes its test and is worth its price. Its forms and shapes count
    by their median; of the places where it may act, the one where it shows least. Where most of them never show, as a
    dead zone under two levels, nothing is promised.
    """
    groups = [d.columns for d in scored.directions]
    unknowns = [d.columns.stop - d.columns.start + len(d.variant.shape) for d in scored.directions]
    costs = [price(1.0, n, 1) + ALIKE for n in unknowns]  # what costs as much as nothing is not seen
    residual, own, matrix = scored.line.residual, scored.line.own, scored.matrix
    folds = np.arange(residual.size) * BLOCKS // residual.size % FOLDS
    left = left_out(own, matrix, folds)
    worth = paid(groups, left.T @ left, float(residual @ residual), costs)
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


def left_out(own: Array, directions: Array, folds: Array) -> Array:
    """Return what a refit leaves of each direction in each fold if that fold is not fitted.

    What the others do not determine, the start of a record, is fitted in the fold itself.
    """
    left = np.empty_like(directions)
    energy = np.einsum("ij,ij->j", own, own)
    own = own / np.sqrt(np.where(energy > 0, energy, 1.0))  # whatever the units
    for fold in np.unique(folds):
        of = folds == fold
        seen = np.einsum("ij,ij->j", own[~of], own[~of]) > UNSEEN**2
        fitted, starts = own[:, seen], orthonormal(own[of][:, ~seen])
        left[of] = directions[of] - fitted[of] @ (pinv(np.where(of[:, None], 0.0, fitted)) @ directions)
        left[of] -= starts @ (starts.T @ left[of])
    return left


def paid(groups: Sequence[slice], products: Array, error: float, costs: Sequence[float]) -> Array:
    """Return by how much the energy of a group's columns (row) is to grow until a group (column) is worth its price.

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
