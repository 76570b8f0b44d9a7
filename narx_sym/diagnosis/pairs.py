"""Two effects that hide each other: where no effect alone explains the error, the best pairs are fitted together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from ..errors import FitError
from ..models.extend import without
from . import gate
from .bases import integrates
from .candidates import CLOSE, LARGE, Candidate, Scored
from .refit import Fitted, settle

Array = np.ndarray
FIRST, POINTS = 8, 3  # effects that may be the stronger one of a pair, and grid points of each of its forms
FITTED = 8  # pairs that are fitted
RIDGE = 1e-8


@dataclass(repr=False)
class Pair:
    """Two effects fitted together.

    Attributes
    ----------
    effects : (str, str)
        Their ids.
    places : (int, int)
        Their directions.
    fitted : Fitted
        The model that has both.
    mean_square : float
        Held-out free-run error [unit of y squared].
    share : float
        Of the removable error on held-out data.
    """

    effects: tuple[str, str]
    places: tuple[int, int]
    fitted: Fitted
    mean_square: float
    share: float = 0.0

    def __repr__(self) -> str:
        return f"Pair({' + '.join(self.effects)}, {100 * self.share:.0f} % of the removable error)"


def joint(scored: Scored) -> list[tuple[int, int]]:
    """Return the best pairs of directions, one for each two effects, by what both explain of the residual together.

    Linearised at the base, in level space, without what a refit of the base absorbs. Signs that mean another effect
    are left out.
    """
    e, D = scored.residual, scored.matrix[scored.rows]
    size = np.linalg.norm(D, axis=0)
    Q = gate.orthonormal(scored.line.own[scored.rows])
    e, D = e - Q @ (Q.T @ e), D - Q @ (Q.T @ D)
    left = np.linalg.norm(D, axis=0)
    seen = left > np.sqrt(gate.TINY) * size
    D = D / np.where(seen, left, 1.0)
    K, b = D.T @ D, D.T @ e
    columns = [np.arange(D.shape[1])[d.columns] for d in scored.directions]
    usable = [i for i, own in enumerate(columns) if np.all(seen[own])]
    ids = [d.variant.id for d in scored.directions]
    signs = [d.variant.effect.sign for d in scored.directions]
    best: dict[frozenset[str], tuple[float, tuple[int, int]]] = {}
    for i, j in product(_stronger(scored, usable), usable):
        if ids[i] == ids[j]:
            continue
        both = np.concatenate([columns[i], columns[j]])
        c = np.linalg.solve(K[np.ix_(both, both)] + RIDGE * np.eye(both.size), b[both])
        if signs[i] * c[0] < 0 or signs[j] * c[columns[i].size] < 0:
            continue
        explained = float(c @ b[both])
        name = frozenset((ids[i], ids[j]))
        if name not in best or explained > best[name][0]:
            best[name] = explained, (i, j)
    return [pair for _, pair in sorted(best.values(), key=lambda found: -found[0])]


def _stronger(scored: Scored, usable: Sequence[int]) -> list[int]:
    """Return the directions that explain most alone: the best grid points of every form of the best effects."""
    listed: dict[str, dict[str, list[int]]] = {}
    for i in sorted(usable, key=lambda i: -scored.scores.share[i]):
        variant = scored.directions[i].variant
        listed.setdefault(variant.id, {}).setdefault(str(variant), []).append(i)
    return [i for forms in list(listed.values())[:FIRST] for points in forms.values() for i in points[:POINTS]]


def best_pair(scored: Scored, candidates: Sequence[Candidate], report: Callable[[str], Any]) -> Pair | None:
    """Fit the best pairs; None where none removes clearly more than the best single effect."""
    base = scored.fitted
    found: list[Pair] = []
    for i, j in joint(scored)[:FITTED]:
        first, second = (scored.directions[n].variant for n in (i, j))
        report(f"fitting {first.id} and {second.id} together")
        made = scored.extended(i, j)
        if made is not None and not integrates(made, base.model):
            found.append(Pair((first.id, second.id), (i, j), made, made.mean_square(base.split.held)))
    best = min(found, key=lambda p: p.mean_square, default=None)
    alone = min((c.mean_square for c in candidates), default=base.mean_square(base.split.held))
    return best if best is not None and best.mean_square < (1 - LARGE) * alone else None


def single(pair: Pair, scored: Scored) -> Candidate | None:
    """Return one effect of a pair as a candidate of its own, where the other explains nothing.

    Its own fit had ended in a local minimum, then.
    """
    base, model = scored.fitted, pair.fitted.model
    listed = model.effects[-2:]
    for place, other in zip(pair.places, reversed(listed), strict=True):
        try:
            made = settle(without(model, other.coefficients.values()), base.split, limits=pair.fitted.limits)
        except FitError:
            continue
        error = made.mean_square(base.split.held)
        if error < CLOSE**2 * pair.mean_square:
            variant, before = scored.directions[place].variant, base.mean_square(base.split.held)
            return Candidate(variant.id, variant, made, scored.scores.corrected(place), error, before)
    return None
