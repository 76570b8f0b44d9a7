"""What the directions say at a fitted base: is anything missing, and which effects are worth a fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...files.journal import remembered
from ...fit.constraints import constraint_equations
from ...fit.freerun import FreeRun
from ...models.effects import Catalogue
from ...models.extend import Variant
from ..refit import Fitted
from ..settings import FORMS_TRIED, HALF, TRIED
from . import gate
from .blackbox import predictable
from .directions import Direction, Linearised
from .products import Left

Array = np.ndarray


@dataclass
class Scored:
    """Directions of everything in the catalogue at a fitted model, and their scores when they are asked for."""

    fitted: Fitted
    line: Linearised
    channels: tuple[str, ...]
    directions: list[Direction]
    matrix: Array
    seed: int

    @cached_property
    def _rows(self) -> Array:
        """Which samples count."""
        return np.concatenate([m[self.line.problem.depth :] for m in self.fitted.split.train])

    @cached_property
    def _plain(self) -> Left:
        """What a refit of the model leaves of the residual and of the directions, not whitened."""
        line = self.line
        return Left.of(line.own, line.residual, self.matrix, line.problem.edges, self._rows)

    @cached_property
    def shares(self) -> Array:
        """What each direction explains of the squared error, beside a refit of the model: `scores` have it too."""
        return self._plain.shares([d.columns for d in self.directions])[0]

    @cached_property
    def scores(self) -> gate.Scores:
        """All scores, grid-corrected and whitened."""
        line, groups = self.line, [d.columns for d in self.directions]
        return gate.score(
            self._plain, line.residual, line.own, self.matrix, groups, [d.searched for d in self.directions],
            line.problem.edges, self._rows, self.seed, [d.columns for d in self.directions if d.line],
            self.fitted.split.noise,
        )  # fmt: skip

    @cached_property
    def structure(self) -> float:
        """Share of the held-out squared error that follows from the signals, as far as a black box can tell."""
        line, split, names = self.line, self.fitted.split, [str(d.variant) for d in self.directions]
        depends = (line.problem, line.residual, line.own, self.matrix, names, split.train, split.held, self.channels)
        given = (line, split, self.directions, self.matrix, self.channels)
        return float(remembered(predictable, *given, on=depends))

    @property
    def missing(self) -> float:
        """Share of the squared error that is no noise: what the black box tells, or a significant effect."""
        significant = self.scores.p_value <= gate.LEVEL
        return max(self.structure, float(self.scores.share.max()) if significant else 0.0)


def linearised(fitted: Fitted) -> Linearised:
    """Return a fitted model linearised along its free run over all samples, the held-out ones too."""
    problem = FreeRun(fitted.model, list(fitted.split.records), constraint_equations(fitted.model, None))
    problem.initial = fitted.problem.initial  # from which its starts are counted, whatever is known since
    return Linearised(problem, fitted.unknowns)


def screen(fitted: Fitted, channels: Iterable[str], catalogue: Catalogue, seed: int) -> Scored:
    """Derive all directions at a fitted model: their scores are computed where they are read."""
    line = linearised(fitted)
    directions, matrix = line.directions(channels, catalogue)
    return Scored(fitted, line, tuple(channels), directions, matrix, seed)


def shortlist(scored: Scored, family: str) -> dict[Variant, list[tuple[float, ...]]]:
    """Return the variants that are worth a fit, each with its shapes, the most promising ones first.

    Both views count: energy in the output, and likelihood after whitening. The delay of an open
    core is the core's alone; beside a static one the output's own memory is that of the input.
    """
    shapes: dict[Variant, dict[tuple[float, ...], float]] = {}
    best: dict[Variant, Array] = {}
    for i, direction in enumerate(scored.directions):
        variant = direction.variant if family == "given" else replace(direction.variant, lag=0)
        driven = {d for by in variant.effect.places.values() for d in by}
        if family == "static" and variant.where == "output" and variant.driver == "y" and "u" in driven:
            continue
        measures = np.array([scored.scores.share[i], scored.scores.gain[i]])
        best[variant] = np.maximum(best.get(variant, np.zeros(2)), measures)
        point = shapes.setdefault(variant, {})
        point[direction.shape] = max(point.get(direction.shape, 0.0), measures[0])
    picked: list[Variant] = []
    for measure, effects, forms in ((0, TRIED, FORMS_TRIED), (1, TRIED // 2, 1)):
        by_id: dict[str, list[Variant]] = {}
        for variant in sorted(best, key=lambda v: -best[v][measure]):
            if best[variant][measure] > 0:
                by_id.setdefault(variant.id, []).append(variant)
        names = list(dict.fromkeys(name.partition(":")[0] for name in by_id))[:effects]
        for listed in (of for name, of in by_id.items() if name.partition(":")[0] in names):
            least = HALF * best[listed[0]][measure]
            picked += [v for v in listed[:forms] if v not in picked and best[v][measure] >= least]
    return {v: sorted(shapes[v], key=lambda s: -shapes[v][s]) for v in picked}


def absorbed(scored: Scored) -> list[str]:
    """Return the effects whose every direction a refit of the base absorbs."""
    seen: dict[str, bool] = {}
    for direction, part in zip(scored.directions, scored.scores.absorbed, strict=True):
        seen[direction.variant.id] = seen.get(direction.variant.id, True) and bool(part > 0.999)
    return sorted(name for name, gone in seen.items() if gone)
