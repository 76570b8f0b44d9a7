"""A named effect added to a model: the same search as the diagnosis, for one effect."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import FitError, ModelError
from ..files.parallel import one_blas_thread
from ..fit import least_squares
from ..fit.identify import prepare
from ..fit.simulate import Records
from ..models.effects import EFFECTS, Catalogue
from ..models.extend import find
from ..models.model import Model
from .refit import Fitted, Split, Trial, settle, whole
from .screening.scored import screen, shortlist
from .table.candidates import Candidate, Pair
from .table.hypotheses import written
from .table.search import Search


def add(model: Model, effect: str | Candidate | Pair, where: str | None = None) -> Addition:
    """Add a physical effect by id, or what a diagnosis found; `.fit(record)` returns the extended model.

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
        base = settle(self.model, split)
        scored = screen(base, [self.channel] if self.channel else [], only, seed)
        search = Search(base.model, split.records, family="given")
        found = []
        for variant, shapes in shortlist(scored, "given").items():
            if self.where not in (None, variant.where):
                continue
            progress(f"fitting {variant}")
            search.limits[variant] = scored.line.ranges(variant)
            bases = search.rows[:1] or search.bases([0])
            looks = search.look(bases, variant, shapes)
            found += search.one_more(bases, looks)[:1] if looks else []
        if not found:
            raise FitError(f"No stable fit with {self.effect} was found, or a refit of the model absorbs it.")
        best = min(map(search.finish, found), key=lambda row: row.price)
        model = written(best.hypothesis, base.model)
        theta = np.array(best.frame.theta(best.values, best.hypothesis.core))
        return whole(settle(model, split, theta, best.frame.limits(model)))
