"""A hypothesis of the table as users see it, an effect that may be missing; and what is asked once one of them wins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from ...errors import FitError
from ...models.effects import Catalogue
from ...models.extend import Variant
from ...models.model import Model
from ...symbolic import printing
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import passed
from ..bases import BASE
from ..refit import Fitted, Trial
from ..settings import ALIKE, DRAWS, LEFT, RIVALS, TOGETHER
from .finer import idle
from .row import Row
from .verdict import alike, cheapest, explained, probabilities, removes, verdict, winner

if TYPE_CHECKING:
    from .rounds import Table

TARGETS = {
    "first": "v_{k} - u_{k}", "input": r"v_{k} - \mathrm{passed}_{k}", "force": r"\mathrm{acting}_{k} - u_{k-d}",
    "friction": r"\mathrm{grip}_{k} - \mathrm{rub}_{k}",
    "inside": r"\Delta F", "motion": r"y_{k} - \mathrm{free}_{k}", "output": "y_{k} - x_{k}",
    "sensor": r"y_{k} - \mathrm{sensed}_{k}",
}  # fmt: skip


@dataclass(repr=False)
class Candidate:
    """One effect that may be missing; see `diagnose` for an example.

    Attributes
    ----------
    effect : str
        Name of the effect, a key of `EFFECTS`.
    variant : Variant
        Its form and place, at the sampling rate of `shown`.
    row : Row
        Its fit at the working rate.
    share : float
        Fraction of the removable error that it removes in cross-validation.
    interval : (low, high)
        95 % interval of `share`, by bootstrap over the blocks.
    p_value : float
        Corrected for the number of effects that were tried.
    probability : float
        Probability that this effect is the missing one, among the effects of the catalogue and none: see
        `verdict.probabilities`. None if two effects only explain the error together.
    nrmse : dict
        `cross_validated` and `base_cross_validated`: free-run errors with the effect and of the base model, in
        cross-validation at the working rate, over the standard deviation of the output. If the effect may be the
        missing one, also `train` and `validation`: errors of `evaluate` on the diagnosed records and on the validation
        records.
    shown : Fitted
        The fitted model, before redundant terms are deleted. At the sampling rate of the record if the effect may be
        the missing one, else at the working rate.
    averaged : int
        Number of samples that are averaged into one at the working rate.
    """

    effect: str
    variant: Variant
    row: Row
    p_value: float
    share: float
    interval: tuple[float, float]
    nrmse: dict[str, float]
    shown: Fitted
    averaged: int
    fit: Callable[[], Fitted] | None = field(compare=False)
    probability: float | None = None
    final: Fitted | None = None
    trial: Trial | None = None
    likely: bool = False
    meaning: str = ""  # what it is called in the machine that was measured

    @classmethod
    def of(cls, table: Table, row: Row, known: Row, p_value: float, lowest: float, likely: bool) -> Candidate:
        """Make a candidate of a row.

        `lowest` is the mean square of the noise, over the variance of y; a `likely` one is fitted at the own rate.
        """
        averaged = 1 if likely else table.factor
        variant = row.beyond(known)[0].finer(table.factor // averaged)
        drawn = np.random.default_rng(table.seed).integers(0, len(row.blocks), size=(DRAWS, len(row.blocks)))
        shares = explained((known.blocks - row.blocks)[drawn].mean(axis=1), known, lowest)
        interval = (float(np.quantile(shares, 0.025)), float(np.quantile(shares, 0.975)))
        errors = {
            "cross_validated": float(np.sqrt(row.held)),
            "base_cross_validated": float(np.sqrt(known.held)),
        }
        return cls(
            variant.id, variant, row, p_value, explained(known.held - row.held, known, lowest), interval, errors,
            table.own(row) if likely else table.fitted(row), averaged, lambda: table.own(row),
        )  # fmt: skip

    def __getstate__(self) -> dict[str, Any]:
        """Go to another process as what it is: with its fitted model, without the table that fits it."""
        state = {**self.__dict__, "fit": None}
        with suppress(FitError):
            state["fitted"] = self.fitted
        return state

    def __repr__(self) -> str:
        return f"Candidate({self.variant}, {100 * self.share:.0f} % of the removable error)"

    def judge(self, trial: Trial, likely: bool) -> None:
        """Take the final fit over the whole records; a `likely` one is fitted and judged at once."""
        self.trial, self.likely = trial, likely
        if likely:
            self.nrmse |= {name: e.free_run_nrmse for name, e in trial.errors(self.fitted).items()}

    @cached_property
    def fitted(self) -> Fitted:
        """The model that has it, fitted over the whole records at their own rate when it is first needed.

        Raises
        ------
        FitError
            Where it cannot be held there.
        """
        if self.final is not None:
            return self.final
        if self.fit is None:
            raise FitError(f"{self.variant} has no stable fit at the sampling rate of the record.")
        return self.fit() if self.trial is None else self.trial.final(self.fit())

    @property
    def model(self) -> Model:
        """The fitted model with the effect."""
        return self.fitted.model

    @property
    def written(self) -> Model:
        """The model whose numbers are shown, with every symbol of the effect: a whole one has the coefficient 1."""
        model = self.shown.model
        if not self.likely:
            return model
        whole = dict.fromkeys(model.effects[-1].coefficients.values(), 1.0)
        values = {**dict.fromkeys(model.symbols, 0.0), **whole, **self.model.values}
        return model.replace(theta=[float(values[s]) for s in model.symbols])

    @property
    def where(self) -> str:
        """The place where it acts."""
        return self.variant.where

    @property
    def parameters(self) -> dict[str, float]:
        """Coefficients c and shape parameters by their short names."""
        model = self.written
        return {n: float(model.values[s]) for n, s in model.effects[-1].symbols.items()}

    @property
    def latex(self) -> str:
        """LaTeX of the contribution with what it remembers."""
        model = self.written
        added, rights = model.effects[-1], [*(s.right for s in model.states), model.F]
        short = {s: sp.Symbol(n, real=True) for n, s in added.shape.items()}
        shown = [
            (sp.Float(f"{float(model.values[c]):.4g}"), derivative(right, c).xreplace(short))
            for c in added.coefficients.values()
            for right in rights
            if right.has(c)
        ]
        first = self.where == "input" and not any(s.left.base == passed for s in model.states)
        lines = [printing.latex_sum(sp.Symbol(TARGETS["first" if first else self.where]), shown)]
        own = (s for s in model.states if s.group == added.group)
        lines += [f"{printing.latex(s.left)} = {printing.latex(s.right.xreplace(short))}" for s in own]
        return r",\quad ".join(lines)

    @property
    def described(self) -> str:
        """What it is, in a sentence: in the words of the machine, where it has some."""
        return f"{self.meaning[0].upper()}{self.meaning[1:]}." if self.meaning else self.variant.effect.sentence

    @property
    def sentence(self) -> str:
        """What it is, and what adding it does, in plain words."""
        numbers = ", ".join(f"{n} = {v:.3g}" for n, v in self.parameters.items())
        return (
            f"{self.described} Adding {self.variant} with {numbers} removes {100 * self.share:.0f} % of "
            "the removable error in cross-validation."
        )


@dataclass(repr=False)
class Pair:
    """Two effects that only together explain the error; channels that all are inputs may be more.

    Attributes
    ----------
    effects : tuple of str
        Their ids.
    fitted : Fitted
        The model that has them.
    share : float
        Of the removable error, cross-validated.
    rivals : tuple of tuples of str
        What these data cannot tell from them, cheapest first: pairs, or effects that explain as much alone.
    all : bool
        Whether what they leave is noise, as far as can be told.
    probability : float
        That these are missing, among all sets of as many effects or fewer that were fitted.
    """

    effects: tuple[str, ...]
    fitted: Fitted
    share: float
    rivals: tuple[tuple[str, ...], ...] = ()
    all: bool = True
    probability: float | None = None

    @property
    def effect(self) -> str:
        """Their ids as one text."""
        return " + ".join(self.effects)

    @property
    def model(self) -> Model:
        """The fitted model with all of them."""
        return self.fitted.model

    @property
    def sure(self) -> tuple[str, ...]:
        """Those of them without which nothing explains as much."""
        return tuple(e for e in self.effects if all(e in rival for rival in self.rivals))

    @property
    def others(self) -> str:
        """What these data cannot tell from them, by ids; empty where there is none."""
        named = [" with ".join(rival) for rival in self.rivals[:RIVALS]]
        more = [f"one of {len(self.rivals) - RIVALS} more"] * (len(self.rivals) > RIVALS)
        return ", or ".join(named + more)

    @property
    def counted(self) -> str:
        """How many there are, in words."""
        return "Two effects" if len(self.effects) == 2 else f"{len(self.effects)} effects"

    def __repr__(self) -> str:
        return f"Pair({' + '.join(self.effects)}, {100 * self.share:.0f} % of the removable error)"


def new_effect(row: Row, known: Row) -> str:
    """Return the id of what a row adds."""
    return next((v.id for v in row.beyond(known)), BASE)


def won(rows: Sequence[Row], known: Row) -> tuple[Row, Row | None]:
    """Return the base and the winner with an effect; where what a core does itself wins, the base moves there.

    None wins that these data cannot tell from nothing: the rows without it are in the table too.
    """
    best = winner(rows, known)
    while best is not None and not best.beyond(known):
        rivals = [r for r in alike(rows, best) if r.beyond(known) and r.held <= np.exp(ALIKE) * best.held]
        if rivals:  # what a core explains, an effect explains as well
            best = rivals[0]
            break
        known = best
        best = winner(rows, known)
    if best is not None and not all(r.beyond(known) or r.more for r in alike(rows, best)):
        return known, None
    return known, best


def suffices(table: Table, alone: Row, known: Row) -> bool:
    """Whether one effect would be all that is missing; what pays for two may stand for two others."""
    left = table.left(alone, known)
    return alone.charged <= alone.count and verdict(removes(alone, known, left), left, 1) == "named"


def closer(table: Table, best: Row, base: Row) -> bool:
    """Fit the closer forms of an effect that wins alone and leaves something; return whether there are any."""
    (added, *more) = best.beyond(base)
    forms = [e for e in table.catalogue.get(added.id, []) if e.closer]
    if more or not forms or table.left(best, base) <= LEFT:
        return False
    bases = table.bases(base, best.hypothesis.core.given)
    return table.asked(Catalogue({added.id: forms}), bases, best, ", in closer forms", base.price, base)


def jointly(table: Table, known: Row) -> None:
    """Fit all channels at once, each a further input of every core if it is none, then fewer while that costs less.

    Of a machine with several inputs each alone may explain little.
    """
    search, forms = table.search, table.catalogue.get("channel", [])
    new = [n for n in table.channels if f"channel:{n}" not in known.ids and n not in dict(search.further)]
    inputs = [Variant(e, "inside", "channel", name) for e in forms if "inside" in e.places for name in new]
    rows = table.every_core(table.bases(known, given=False)) if len(inputs) > 1 else []

    def fitted(beside: Sequence[Row], added: Sequence[Variant]) -> list[Row]:
        for variant in added:
            search.limits[variant] = {}
            looks = search.look(beside, variant, [()]) if beside else []
            beside = search.one_more(beside, looks) if looks else []
            search.rest()
        return [search.finish(row) for row in beside[:1]]

    best = fitted(rows, inputs)
    while best and len(best[0].beyond(known)) > 2:
        kept = best[0].beyond(known)
        fewer = [row for out in kept for row in fitted(rows, [v for v in kept if v != out])]
        cheaper = [r for r in fewer if r.price < best[0].price]
        best = [min(cheaper, key=lambda r: r.price)] if cheaper else []


def candidates_of(table: Table, known: Row, best: Row, found: Sequence[Row], lowest: float) -> list[Candidate]:
    """Return the hypotheses with one effect more, the best of each: the confusion set first."""
    both = best.beyond(known)
    for row in table.beside(known) if len(both) > 1 else ():
        if [v.id for v in row.beyond(known)] in [[v.id] for v in both]:
            row.judged()  # by itself it need not be worth its price
    listed = [best if r.ids == best.ids else r for r in cheapest(table.beside(known))]
    listed = [r for r in listed if len(r.beyond(known)) == 1 and r.blocks.size]
    members = {new_effect(r, known) for r in found} | {v.id for v in both}
    own = {v.id for v in both} if len(both) > 1 else set()  # of a pair its own effects come first
    listed.sort(key=lambda r: (r is not best and new_effect(r, known) not in own, new_effect(r, known) not in members))
    scored = table.screened(known)
    probable = {} if len(both) > 1 else probabilities(table.beside(known), known)
    made: list[Candidate] = []
    for row in listed:
        variant = row.beyond(known)[0]
        if len(made) == max(TOGETHER, len(members)):
            break
        likely = variant.id in members
        worth = row.held < known.held or (likely and np.isfinite(row.held))
        if not worth or not (table.holds(row) if likely else table.settles(row) and not idle(row, table.search)):
            continue
        tests = [i for i, d in enumerate(scored.directions) if d.variant.id == variant.id]
        p = min((scored.scores.corrected(i) for i in tests), default=1.0)
        made.append(Candidate.of(table, row, known, p, lowest, likely))
        made[-1].probability = probable.get(tuple(sorted(row.ids)))
    return made
