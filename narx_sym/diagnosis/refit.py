"""Fits of extended models on one part of the data, judged in free run on another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from ..data.evidence.noise import period_noise
from ..data.record import Record
from ..errors import Diverged, FitError
from ..files.journal import remembered
from ..fit.constraints import constraint_equations
from ..fit.evaluate import Errors, estimated, evaluate, free_run
from ..fit.freerun import FreeRun
from ..fit.least_squares import describe, described
from ..fit.simulate import segments
from ..models.added import newer
from ..models.model import Model
from ..models.rewrite import held, without
from .bases import joined
from .settings import BLOCKS, FINAL, FOLDS, REFUSALS, RETURNED, SEALED, SLACK, STEPS, TOLERANCE

Array = np.ndarray


@dataclass(frozen=True)
class Split:
    """Which samples of each segment are for fitting, for judging, and sealed until the end.

    Blocks alternate, so that a staircase or a slow change is seen by both; the last blocks are sealed.
    """

    records: tuple[Record, ...]
    train: tuple[Array, ...]
    held: tuple[Array, ...]
    test: tuple[Array, ...]

    @classmethod
    def of(cls, records: Any) -> Split:
        """Split records."""
        parts = segments(records)
        blocks = [np.arange(len(part)) * 2 * BLOCKS // len(part) for part in parts]
        sealed = tuple(block >= 2 * BLOCKS - SEALED for block in blocks)
        held = tuple(~s & (block % FOLDS == FOLDS // 2) for s, block in zip(sealed, blocks, strict=True))
        return cls(tuple(parts), tuple(~(s | h) for s, h in zip(sealed, held, strict=True)), held, sealed)

    @cached_property
    def noise(self) -> list[Array]:
        """What differs between repeated periods: pieces of the noise, where there are any."""
        return period_noise(self.records)

    @classmethod
    def whole(cls, records: Any) -> Split:
        """Use every sample for everything: the final fit."""
        parts = segments(records)
        every = tuple(np.ones(len(p), dtype=bool) for p in parts)
        return cls(tuple(parts), every, every, every)


@dataclass(eq=False)
class Fitted:
    """A model fitted on the training samples, with its free run everywhere.

    Attributes
    ----------
    model : Model, with theta
    unknowns : parameters and initial shifts
    limits : of some parameters
    judged : bool
        Whether its errors are those of `evaluate`: from start states estimated on each whole record.
    """

    model: Model
    split: Split
    problem: FreeRun
    unknowns: Array
    converged: bool
    limits: Mapping[Any, Any]
    judged: bool = False

    @cached_property
    def errors(self) -> list[Array]:
        """Measured minus simulated along each segment, (N,) [unit of y]; zero before the first computed sample."""
        found = []
        if self.judged:
            return [r.y - free_run(self.model, r) for r in self.split.records]
        for i, data in enumerate(self.problem.data):
            e = data[self.problem.name] - self.problem.simulate(self.unknowns, i)
            e[: self.problem.depth] = 0.0
            found.append(e)
        return found

    @cached_property
    def worst(self) -> int:
        """The segment with the most of the squared error: of several, that which is looked at."""
        return int(np.argmax([e @ e for e in self.errors]))

    def error(self, masks: Sequence[Array]) -> Array:
        """Return the errors on chosen samples, one array."""
        return np.concatenate([e[m] for e, m in zip(self.errors, masks, strict=True)])

    def mean_square(self, masks: Sequence[Array]) -> float:
        """Return the mean squared free-run error on chosen samples [unit of y squared]; infinite where it diverges."""
        try:
            with np.errstate(over="ignore"):
                value = float(np.mean(self.error(masks) ** 2))
        except Diverged:  # only where it is judged: a fit goes on with what is not finite
            return float("inf")
        return value if np.isfinite(value) else float("inf")

    def relative(self, masks: Sequence[Array]) -> float:
        """Return the mean squared free-run error on chosen samples over the variance of y."""
        return self.mean_square(masks) / self.problem.spread**2


@dataclass(frozen=True, eq=False)
class Trial:
    """What the models of a diagnosis are fitted to in the end, and judged on; each number is one of `evaluate`.

    Attributes
    ----------
    records : tuple of Record
        As they were diagnosed.
    validation : tuple of Record
        Records that no model is fitted to: those given, else the last part of each contiguous record.
    given : bool
        Whether the validation records were given.
    split : Split
        The samples of the final fit: all where validation records were given, else all but the last part.
    """

    records: tuple[Record, ...]
    validation: tuple[Record, ...]
    given: bool
    split: Split
    _errors: dict[int, tuple[Fitted, dict[str, Errors]]] = field(default_factory=dict)

    @classmethod
    def of(cls, records: Sequence[Record], validation: Sequence[Record] = ()) -> Trial:
        """Prepare a trial."""
        whole = Split.whole(records)
        if validation:
            return cls(tuple(records), tuple(validation), True, whole)
        longest = max(map(len, whole.records))  # a stretch that is much shorter judges nothing
        tails = [int(np.count_nonzero(m)) * (10 * m.size >= longest) for m in Split.of(records).test]
        at = [len(s) - n for s, n in zip(whole.records, tails, strict=True)]
        last = [s[a:] for s, a in zip(whole.records, at, strict=True) if len(s) - a > 1]
        if not any(np.ptp(s.y) for s in last):  # what rests judges nothing
            return cls(tuple(records), tuple(records), False, whole)
        train = tuple(np.arange(len(s)) < a for s, a in zip(whole.records, at, strict=True))
        return cls(tuple(records), tuple(last), False, Split(whole.records, train, train, tuple(~m for m in train)))

    @property
    def tail(self) -> bool:
        """Whether the last part of each record is what judges."""
        return not self.given and self.validation != self.records

    @property
    def described(self) -> str:
        """Which data are used for validation, in words."""
        if self.given:
            return joined(dict.fromkeys(r.name for r in self.validation))
        if not self.tail:
            return "the record itself, because its last part does not move"
        (row, *others) = [int(np.count_nonzero(m)) for m in self.split.train]
        return "the last part of each record" if others else f"the last part of the record (from row {row})"

    def errors(self, fitted: Fitted) -> dict[str, Errors]:
        """Return the errors on the diagnosed records (`train`) and on the validation records."""
        if id(fitted) not in self._errors:
            found = {
                "train": evaluate(fitted.model, self.records),
                "validation": evaluate(fitted.model, self.validation),
            }
            self._errors[id(fitted)] = fitted, found
        return self._errors[id(fitted)][1]

    def as_given(self, model: Model, converged: bool = True, limits: Mapping[Any, Any] | None = None) -> Fitted:
        """Return a model as it is, judged here: its unknowns are the start states estimated on the whole records."""
        problem = FreeRun(model, list(self.split.records), None, loads=True)
        unknowns = estimated(problem, problem.start(model.theta))[0]
        return Fitted(model, self.split, problem, unknowns, converged, limits or {}, judged=True)

    def final(self, fitted: Fitted) -> Fitted:
        """Fit a model once more, in free run over the whole records from estimated start states.

        Where that fails, or leaves more by `evaluate` on the samples of the fit, the parameters stay.
        """
        model, records, use = fitted.model, list(self.split.records), self.split.train
        limits = {s: pair for s, pair in fitted.limits.items() if s in model.symbols}
        part = [r[: int(np.count_nonzero(m))] for r, m in zip(records, use, strict=True)]
        begins = FreeRun(model, records, None, use, loads=True)
        problem = FreeRun(model, records, constraint_equations(model, None), use, loads=True)
        begin = problem.start(model.theta)
        begin[problem.free :] = estimated(begins, begins.start(model.theta))[0]
        made, ended = model, fitted.converged
        with suppress(FitError):
            unknowns, std, converged = remembered(_minimum, problem, begin, FINAL, limits)
            found = model.replace(theta=problem.theta(unknowns).tolist(), standard_errors=std)
            if evaluate(found, part).free_run_nrmse <= evaluate(model, part).free_run_nrmse:
                made, ended = found, converged
        made = described(describe(made, self.records, "free_run", ended), self.records)
        return self.as_given(made, ended, limits)


NO_TRIAL: Trial = Trial((), (), False, Split((), (), (), ()))


def settle(
    model: Model,
    split: Split,
    start: Array | None = None,
    limits: Mapping[Any, Any] | None = None,
    steps: int = STEPS,
    errors: Sequence[Array] | None = None,
    unknowns: Array | None = None,
) -> Fitted:
    """Fit a model in free run on the training samples.

    It starts from the measured initial outputs, or from what is nearer: those of free runs, of which the `errors` are
    given per segment, simulated minus measured, (N,); or all `unknowns` of a fit before.

    Raises
    ------
    FitError
        Where the free run diverges from the start, or ends unstable.
    """
    limits = {s: pair for s, pair in (limits or {}).items() if s in model.symbols}
    equations = constraint_equations(model, None)
    problem = FreeRun(model, list(split.records), equations, split.train)
    begins = [problem.start(model.theta if start is None else start)]
    begins += [problem.begun(begins[0], errors)] if errors is not None else []
    begins += [unknowns] if unknowns is not None else []
    begin = min(begins, key=lambda z: _error(problem, z)) if begins[1:] else begins[0]
    unknowns, std, converged = remembered(_minimum, problem, begin, steps, limits)
    problem.model = model.replace(theta=problem.theta(unknowns).tolist(), standard_errors=std)
    made = Fitted(problem.model, split, problem, unknowns, converged, limits)
    if not all(np.all(np.isfinite(e)) for e in made.errors) or not problem.determined(unknowns):
        raise FitError("The fitted model is unstable.")
    return made


def _error(problem: FreeRun, z: Array) -> float:
    with np.errstate(all="ignore"):
        error = float(np.sum(problem.run(z)[0] ** 2))
    return error if np.isfinite(error) else np.inf


def _minimum(problem: FreeRun, begin: Array, steps: int, limits: Mapping[Any, Any]) -> tuple[Array, Array, bool]:
    """Return the unknowns at the minimum, the standard errors of the parameters, and whether it converged."""
    if not all(np.all(np.isfinite(part)) for part in problem.run(begin)):
        raise FitError("The free run of the start values diverges.")
    found = problem.minimise(begin, steps, TOLERANCE, limits)
    return found.x, problem.errors(found), bool(found.status > 0)


def alike_up_to(now: float, before: float) -> float:
    """Return up to which error a model explains as much: 1 % more, or 0.1 % of what was removed comes back.

    Mean squares, of the model and of that without the effects.
    """
    return max(SLACK * now, now + RETURNED * max(0.0, before - now))


def prune(fitted: Fitted, before: Fitted) -> Fitted:
    """Let effects be whole, and delete backwards the terms that they made redundant, the least certain first.

    A term goes while the free-run error on the training and on the held-out samples stays alike; see `alike_up_to`.

    Parameters
    ----------
    before : the model without the effects
    """
    masks = (fitted.split.train, fitted.split.held)
    limits = []
    for mask in masks:
        limits.append(alike_up_to(fitted.mean_square(mask), before.mean_square(mask)))
    fitted = whole(fitted)
    keep = {str(s) for e in newer(fitted.model, before.model) for s in e.symbols.values()}
    refused = set(keep)
    while len(refused) < len(keep) + REFUSALS:
        model = fitted.model
        scored = [
            (abs(v) / s if s > 0 and np.isfinite(s) else np.inf, str(symbol), symbol)
            for symbol, v, s in zip(model.symbols, model.theta, model.standard_errors or (), strict=True)
            if str(symbol) not in refused and _removable(model, symbol)
        ]
        if not scored:
            break
        _, name, symbol = min(scored, key=lambda p: p[:2])
        refused.add(name)
        smaller = _simpler(fitted, {symbol: sp.S.Zero}, limits)
        if smaller is not None:
            fitted = smaller
            refused.discard(name)
    return fitted


def whole(fitted: Fitted) -> Fitted:
    """Let effects be whole where that costs hardly anything: their coefficients become 1.

    A share of 0.998 is a whole slack with the error of its fit; a law would invert the 0.2 % that pass beside it too.
    """
    limits = [SLACK * fitted.mean_square(mask) for mask in (fitted.split.train, fitted.split.held)]
    for symbol in (c for e in fitted.model.effects if e.full for c in e.coefficients.values()):
        fitted = _simpler(fitted, {symbol: sp.S.One}, limits) or fitted
    return fitted


def _simpler(fitted: Fitted, known: Mapping[Any, Any], limits: Sequence[float]) -> Fitted | None:
    """Fit a model in which some parameters are numbers; None where it cannot be held, or leaves more than `limits`.

    These are mean squared errors on the training and on the held-out samples [unit of y squared].
    """
    model, split = fitted.model, fitted.split
    try:
        made = settle(held(model, known).replace(info=model.info), split, limits=fitted.limits)
    except FitError:
        return None
    masks = (split.train, split.held)
    return made if all(made.mean_square(mask) <= most for mask, most in zip(masks, limits, strict=True)) else None


def _removable(model: Model, symbol: Any) -> bool:
    """Whether a parameter multiplies a term of the core, and the model has an input without it."""
    terms = (part.as_independent(sp.Indexed, as_Add=False) for part in sp.Add.make_args(model.core))
    if not any(c == symbol for c, _ in terms):
        return False
    if any(symbol in c.free_symbols for c in model.constraints if not isinstance(c, str)):
        return False
    return model.input in without(model, [symbol]).recursion.inputs
