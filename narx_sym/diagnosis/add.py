"""A named effect added to a model: the same search as the diagnosis, for one effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.optimize import least_squares as least_squares_fit

from ..data.record import Record
from ..engines.compile import compile
from ..errors import FitError, ModelError
from ..files.parallel import one_blas_thread
from ..fit import least_squares
from ..fit.constraints import Elimination, constraint_equations
from ..fit.freerun import FreeRun
from ..fit.identify import prepare
from ..fit.simulate import Records, arrays, initial_values
from ..models.effects import EFFECTS, Catalogue
from ..models.extend import Variant, find
from ..models.model import Model
from .refit import Fitted, Split, Trial, settle, whole
from .screening.scored import Scored, screen, shortlist
from .settings import BEST, HUGE, STEPS
from .table.candidates import Candidate, Pair
from .table.hypotheses import written
from .table.search import Search
from .table.verdict import price

Array = np.ndarray


def add(model: Model, effect: str | Candidate | Pair, where: str | None = None) -> Addition:
    """Add a physical effect, by name or as found by `diagnose`; `.fit(record)` returns the extended model.

    What was found carries its core, form, place and values: a fit begins there, and never ends with a larger error.
    """
    return Addition(model, effect, where)


class Addition:
    """A model about to get an effect: `fit` finds how it acts, and returns the extended model.

    Made by `Model.add`.
    """

    def __init__(
        self, model: Model, effect: str | Candidate | Pair, where: str | None = None, catalogue: Catalogue = EFFECTS
    ):
        self.model, self.effect, self.where = model, effect, where
        if isinstance(effect, str):
            self.forms, self.channel = find(effect, catalogue)
            places = sorted({p for f in self.forms for p in f.places})
            if where is not None and where not in places:
                raise ModelError(f"{effect} does not act at {where!r}: choose among {', '.join(places)}.")

    def fit(self, records: Records, seed: int = 0, progress: Callable[[str], Any] = lambda what: None) -> Model:
        """Fit the extended model in free run on all samples.

        Raises
        ------
        FitError
            Where no stable fit is found, or a refit of the model absorbs the effect.
        """
        listed = prepare(records, self.model.info.units)
        if self.model.theta is None:
            self.model = least_squares.fit(self.model, listed, method="auto")
        if isinstance(self.effect, (Candidate, Pair)):
            fitted = whole(Trial.of(listed, listed).final(self.effect.fitted))
        else:
            with one_blas_thread():
                fitted = self._search(Split.whole(listed), seed, progress)
        return least_squares.unfinished(Trial.of(listed, listed).final(fitted).model)

    def _search(self, split: Split, seed: int, progress: Callable[[str], Any]) -> Fitted:
        only = Catalogue({self.forms[0].id: self.forms})
        try:
            base = settle(self.model, split)
        except FitError as error:
            said = f"Without {self.effect} the model has no stable fit here: choose another base."
            raise FitError(f"{said} {error}") from None
        scored = screen(base, [self.channel] if self.channel else [], only, seed)
        search = Search(base.model, split.records, family="given")
        found = []
        tried = self._tried(scored)
        for variant, shapes in tried.items():
            progress(f"fitting {variant}")
            search.limits[variant] = scored.line.ranges(variant)
            bases = search.rows[:1] or search.bases([0])
            looks = search.look(bases, variant, shapes)
            found += search.one_more(bases, looks)[:1] if looks else []
        if not found:
            raise FitError(
                f"No stable fit with {self.effect} was found, or the parameters of the model can already reproduce it."
            )
        progress("fitting both together")
        fits = []
        for row in map(search.finish, found):
            model, at = written(row.hypothesis, base.model), row.frame.added[-1][1]
            theta = np.array(row.frame.theta(row.values, row.hypothesis.core))
            absent = np.concatenate([base.model.theta, np.zeros(theta.size - len(base.model.theta))])
            begins = [theta]
            for shape in tried[row.hypothesis.effects[-1]]:
                begins.append(absent.copy())
                begins[-1][at] = shape
            with suppress(FitError):
                fits.append(jointly_fitted(model, split, begins, row.frame.limits(model)))
        if not fits:
            raise FitError(f"No stable fit with {self.effect} was found.")
        return min(fits, key=lambda made: price(made.relative(split.train), len(made.model.symbols), 1))

    def _tried(self, scored: Scored) -> dict[Variant, list[tuple[float, ...]]]:
        """Return the variants that are fitted, with their shapes: every form in a place that is given."""
        if self.where is None:
            return shortlist(scored, "given")
        found: dict[Variant, list[tuple[float, ...]]] = {}
        for direction in scored.directions:
            if direction.variant.where == self.where:
                found.setdefault(direction.variant, []).append(direction.shape)
        return found


def jointly_fitted(model: Model, split: Split, begins: Sequence[Array], limits: Mapping[Any, Any]) -> Fitted:
    """Fit a model in free run from the first of some parameters, and from the joint one-step minima near all of them.

    What moves the output slowly hardly counts one step ahead: a base that was fitted without it is left behind, as a
    free run does not leave it. Of these minima the best ones are starts.

    Raises
    ------
    FitError
        Where no start leads to a stable fit.
    """
    near = sorted((one_step_fit(model, split.records, begin, limits) for begin in begins), key=lambda found: found[0])
    fits, problem = [], FitError("No stable fit was found.")
    for start in [begins[0], *(theta for _, theta in near[:BEST])]:
        try:
            fits.append(whole(settle(model, split, start, limits)))
        except FitError as error:
            problem = error
    if not fits:
        raise problem
    return min(fits, key=lambda made: made.mean_square(split.train))


def one_step_fit(
    model: Model, records: Sequence[Record], theta: Array, limits: Mapping[Any, Any]
) -> tuple[float, Array]:
    """Return the least one-step error (half the sum of squares), and its parameters, near given ones.

    The constraints of the model hold.

    Parameters
    ----------
    theta : (n_theta,) array
    limits : mapping of symbols to (low, high)
    """
    elimination = Elimination.of(constraint_equations(model, None), model.symbols)
    predictor, data = compile(model.predictor), [arrays(model, r) for r in records]
    depth, name = max(1, predictor.recursion.depth), model.output.name
    begins = [initial_values(model.replace(theta=theta.tolist()), d, depth) if model.states else {} for d in data]

    def gaps(z: Array) -> Array:
        runs = (
            predictor(d, elimination.t0 + elimination.Z @ z, b, on_divergence="nan")["prediction"][depth:]
            for d, b in zip(data, begins, strict=True)
        )
        found = np.concatenate([run - d[name][depth:] for run, d in zip(runs, data, strict=True)])
        return np.nan_to_num(found, nan=HUGE, posinf=HUGE, neginf=-HUGE)

    bounded = FreeRun(model, list(records), constraint_equations(model, None)).bounds(limits)
    low, high = (b[: elimination.Z.shape[1]] for b in bounded)
    z = np.clip(elimination.Z.T @ (theta - elimination.t0), low, high)
    with np.errstate(all="ignore"):
        found = least_squares_fit(gaps, z, bounds=(low, high), x_scale="jac", max_nfev=STEPS)
    return float(found.cost), np.asarray(elimination.t0 + elimination.Z @ found.x)
