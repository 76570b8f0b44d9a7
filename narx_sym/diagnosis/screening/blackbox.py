"""How much of an error follows from the signals at all: a black box that knows no physics, judged on held-out data.

Structure that no effect of the catalogue explains shows here. Noise, of whatever colour, knows nothing of the signals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh, lstsq

from ...engines.algebra import smoothed
from ..refit import Split
from ..settings import BLOCKS, BUMPS, DEPENDENT, FEATURES, FEW, FOLDS, PENALTIES, POLES, ROWS, SOME
from .directions import Direction, Linearised

Array = np.ndarray


def features(line: Linearised, channels: Sequence[str] = ()) -> Array:
    """Return directions of random smooth functions of the signals, (rows, columns) (Rahimi & Recht 2007)."""
    rng = np.random.default_rng(0)
    weights = phases = None
    made = []
    for seen in line.seen:
        driving = [seen[b.name] for b in (line.model.input, line.model.inner)]
        base = np.column_stack([part for x in driving for part in _versions(x)] + [seen[c] for c in channels])
        spread = base.std(axis=0)
        base = (base - base.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
        if weights is None:
            shape = (base.shape[1], FEATURES)
            weights = BUMPS * rng.standard_normal(shape) * (rng.uniform(size=shape) < SOME)
            phases = rng.uniform(0, 2 * np.pi, FEATURES)
        # Gains may depend on time and on what else was measured.
        changing = [np.linspace(-1, 1, len(base)), *base[:, base.shape[1] - len(channels) :].T]
        scaled = [by[:, None] * base for by in changing]
        made.append(np.column_stack([np.cos(base @ weights + phases), base, *scaled]))
    return np.concatenate([line.moved(place, made) for place in ("output", "input")], axis=1)


def _versions(x: Array) -> list[Array]:
    step = np.diff(x, prepend=x[0])
    slow = [smoothed(a, x) for a in POLES]
    return [x, *slow, step, np.sign(step), np.sign(step) * np.abs(x)]


def predictable(
    line: Linearised, split: Split, directions: Sequence[Direction], matrix: Array, channels: Sequence[str] = ()
) -> float:
    """Return the share of the held-out squared error that follows from the signals, at least 0.

    Ridge regression on random features and on the directions of the catalogue (those of time alone left out: they
    follow a wandering noise), fitted on the training samples; the penalty is chosen among blocks of these.
    """
    keep = [matrix[:, d.columns] for d in directions if d.variant.driver != "t"]
    X = np.column_stack([*keep, features(line, channels), line.tone()])
    e, depth = line.residual, line.problem.depth
    train, held = (np.flatnonzero(np.concatenate([m[depth:] for m in masks])) for masks in (split.train, split.held))
    train, held = (rows[:: max(1, rows.size // ROWS)] for rows in (train, held))
    if not e[held].any():
        return 0.0  # nothing is left that could follow from anything
    own = line.own[train]
    solution = lstsq(own, np.column_stack([e[train], X[train]]))[0]
    fitted = [np.column_stack([e[rows], X[rows]]) - line.own[rows] @ solution for rows in (train, held)]
    (e_t, X_t), (e_h, X_h) = ((f[:, 0], f[:, 1:]) for f in fitted)
    with np.errstate(over="ignore"):  # what is as large as that is not used
        power = np.mean(X_t**2, axis=0)  # what the model's own directions leave of it
        size, used = np.sqrt(power), power > DEPENDENT * np.mean(X[train] ** 2, axis=0)
    if not used.any():
        return 0.0  # the model's own directions leave nothing to judge by
    X_t, X_h = X_t[:, used] / size[used], X_h[:, used] / size[used]
    fold = np.arange(train.size) * (2 * BLOCKS) // train.size % FOLDS
    best = 0.0
    for solve in (_ridge, _sparse):  # many small contributions, or few large ones
        missed = 0.0
        for i in range(FOLDS):
            out = X_t[fold == i] @ solve(X_t[fold != i], e_t[fold != i])
            missed = missed + np.sum((e_t[fold == i][:, None] - out) ** 2, axis=0)
        chosen = solve(X_t, e_t)[:, int(np.argmin(missed))]
        best = max(best, 1 - float(np.sum((e_h - X_h @ chosen) ** 2) / np.sum(e[held] ** 2)))
    return best


def _ridge(X: Array, e: Array) -> Array:
    """Return the ridge solutions for all penalties, (columns, penalties); of few rows in the space of the rows."""
    few = len(X) < X.shape[1]
    values, vectors = eigh(X @ X.T if few else X.T @ X, driver="evd")
    seen = vectors.T @ (e if few else X.T @ e)
    found = vectors @ (seen[:, None] / (np.maximum(values, 0.0)[:, None] + PENALTIES * values[-1]))
    return np.asarray(X.T @ found if few else found)


def _sparse(X: Array, e: Array) -> Array:
    """Return the solutions with 0, 1, 2, ... columns by orthogonal matching pursuit (Pati et al. 1993)."""
    found, picked, left = np.zeros((X.shape[1], FEW + 1)), [], e
    for count in range(1, FEW + 1):
        picked.append(int(np.argmax(np.abs(X.T @ left))))
        solution = lstsq(X[:, picked], e)[0]
        left = e - X[:, picked] @ solution
        found[picked, count] = solution
    return found
