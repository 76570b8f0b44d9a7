"""One step of the procedure: a base, what may be missing from it, and a verdict read off the table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..data.evidence.feedback import Feedback
from ..data.evidence.noise import unexplained
from ..data.evidence.stiction import Sticking
from ..errors import FitError, NarxError
from ..fit.evaluate import Errors
from ..fit.laws.stability import stability, strays
from ..inversion.compensator import compensator
from ..models.added import newer
from ..models.model import NARX, Model
from ..symbolic import printing
from ..symbolic.identities import added as total
from ..symbolic.numbers import few, prefixed, sized
from .bases import BASE, joined, percent_of, words
from .experiment import Experiment, propose, wider_file
from .progress import JUDGE, WAYS
from .refit import NO_TRIAL, Fitted, Trial, alike_up_to, prune
from .screening import gate
from .screening.promise import detectable
from .screening.scored import absorbed
from .settings import ALIKE, HELPS, LARGE, LEFT, RIVALS, ROUNDING, SAME
from .table.candidates import (
    Candidate,
    Pair,
    candidates_of,
    closer,
    jointly,
    new_effect,
    suffices,
    won,
)
from .table.exchange import exchanged, instead
from .table.rounds import Table
from .table.row import Row
from .table.verdict import alike, nothing_named, probabilities, removes, verdict

PARTS = ("train", "validation")  # the diagnosed records, and those that no model is fitted to
ONE_STEP = (
    "The input is a single step, and every output is also the response of some linear system to it, so no "
    "effect can be named."
)
REPEATED, ESTIMATE, NO_FLOOR = "repeated periods", "estimate", "not estimated"  # kinds of floors: sure, not, in loops


@dataclass
class Step:
    """One round of the procedure: a base, what may be missing from it, and a verdict.

    Attributes
    ----------
    base : Fitted
    floor : float
        rms of what no model could remove [unit of y].
    withdrawn : list of str
        Effects added before that this step made superfluous, or replaced.
    pair : Pair
        Two effects that only together explain the error, where there are.
    loop : Feedback
        Where the input answers the output: then only that is named which removes nearly all of the error.
    valves : list of Sticking
        Of each record with a setpoint, and of others where a valve seems to stick: whether it does.
    nearest : list of str
        Where something is left that no effect explains well enough to be named: those that come nearest, best first. Of
        what the catalogue does not know: the one effect, or the two, that cost least.
    nearest_share : float
        How much of the squared error the first of them removes, in held-out blocks.
    meanings : dict of str
        What effects are called in the machine that was measured, by id, where that is another name.
    same : dict of lists of str
        By a member of the confusion set: further ids that mean the same there.
    sensor : float
        Standard deviation of the sensor's noise [unit of y]; 0 where it is not known. What is above it is not noise.
    """

    base: Fitted
    verdict: str
    candidates: list[Candidate]
    confusion_set: list[str]
    floor: float
    floor_kind: str
    p_value: float
    smallest_detectable: dict[str, float]
    absorbed: list[str]
    experiment: Experiment | None = None
    chosen: Fitted | None = None
    withdrawn: list[str] = field(default_factory=list)
    pair: Pair | None = None
    loop: Feedback | None = None
    valves: list[Sticking] = field(default_factory=list)
    nearest: list[str] = field(default_factory=list)
    nearest_share: float = 0.0
    sensor: float = 0.0
    one_step: bool = False  # is all that the input does: nothing is named from it
    trial: Trial = NO_TRIAL  # what its models are fitted to in the end, and judged on; see `finish`
    refused: Fitted | None = None  # what was found, but does not lessen the error on the record and on validation data
    meanings: Mapping[str, str] = field(default_factory=dict)
    same: dict[str, list[str]] = field(default_factory=dict)
    half: Row | None = None  # where one of two effects is added, as both together do not help
    others: Callable[[bool], Iterable[Candidate]] | None = None  # in place of the first candidate, until it is judged
    linear: float = 0.0  # rms that a linear base leaves by itself, where one speed cannot tell [unit of y]

    def hear(self, sensor: float) -> None:
        """Take in the sensor's noise [unit of y]: no model removes it, and none leaves less than the last one did."""
        self.sensor, left = sensor, float(np.sqrt(self.last.mean_square(self.base.split.held)))
        if self.floor_kind == REPEATED and left**2 < np.exp(-ALIKE) * self.floor**2:
            self.floor_kind = ESTIMATE  # what a model tells is no noise, though it does not repeat
        if self.floor_kind != REPEATED:
            self.floor = min(max(self.floor, sensor), left)

    def finish(self, trial: Trial, before: Fitted) -> None:
        """Fit what is shown once more over the whole records, and add it only where the error falls.

        Parameters
        ----------
        before : Fitted
            The model that the step begins with: the baseline, or what the step before it added.
        """
        self.trial, self.base = trial, before
        if self.chosen is not None:
            self.chosen = trial.final(self.chosen)
            if self.pair is not None:
                self.pair.fitted = self.chosen
            else:
                self.candidates[0].final = self.chosen
        for c in self.candidates:
            c.judge(trial, c.effect in self.confusion_set)
        if self.pair is not None and self.chosen is not None and not self.falls(self.chosen):
            self._halve(self.pair)
        if self.chosen is not None and not self.falls(self.chosen):
            self.replace(next((c for c in self._others(False) if self.falls(c.fitted)), None))
            if not self.falls(self.chosen):
                self.refused, self.chosen, self.verdict = self.chosen, None, "helps_but_incomplete"
        elif self.chosen is not None and self.pair is None:
            self.replace(self.better_law(self.chosen))
        self.others = None

    def _halve(self, pair: Pair) -> None:
        """Take that one of two effects which lessens the error by itself, where both together do not everywhere."""
        for one in (c for c in self.candidates if c.effect in pair.effects):
            with suppress(FitError):
                if self.falls(one.fitted):
                    others = [c for c in self.candidates if c is not one]
                    self.pair, self.candidates, self.half = None, [one, *others], one.row
                    self.chosen, self.confusion_set = one.fitted, [one.effect]
                    return

    def replace(self, other: Candidate | None) -> None:
        """Take the same effect with another core, or in another form, where there is one."""
        if other is not None:
            self.candidates[0], self.chosen = other, other.fitted

    def falls(self, fitted: Fitted) -> bool:
        """Whether a model leaves less than the base on the diagnosed records, and no more on the validation records."""
        before, after = (self.trial.errors(f) for f in (self.base, fitted))
        rise = ALIKE if self.trial.tail else 0.0  # a short last part tells no smaller difference
        return (
            after["train"].free_run_rms < before["train"].free_run_rms
            and after["validation"].free_run_rms < np.exp(rise / 2) * before["validation"].free_run_rms
        )

    def _others(self, alike: bool) -> Iterator[Candidate]:
        """Give what may stand in place of the first candidate: all, or what explains alike."""
        return iter(self.others(alike) if self.others is not None else ())

    def better_law(self, chosen: Fitted) -> Candidate | None:
        """Return what explains as much with the best law, where that of a chosen model is not as good."""
        worth, best, others = law_worth(chosen.model), None, self._others(True)
        while worth < 2 and (one := next(others, None)) is not None:
            if (other := law_worth(one.fitted.model)) > worth and self.stands_for(chosen, one.fitted):
                worth, best = other, one
        return best

    def stands_for(self, one: Fitted, other: Fitted) -> bool:
        """Whether another model explains as much."""
        before, now, after = (self.trial.errors(f) for f in (self.base, one, other))
        return all(
            after[part].free_run_rms ** 2 <= alike_up_to(now[part].free_run_rms ** 2, before[part].free_run_rms ** 2)
            for part in PARTS
        )

    def decide(self, base: Model | None, seed: int, limits: tuple[float, float] | None) -> None:
        """Propose the input that tells the confusion set apart; a `base` in it has a model of its own."""
        models = {c.effect: c.model for c in self.candidates if c.effect in self.confusion_set}
        if base is not None:
            models[BASE] = base
        self.experiment = propose(models, list(self.base.split.records), self.floor, seed, limits=limits)

    @property
    def last(self) -> Fitted:
        """The model that the step ends at."""
        return self.chosen or self.base

    @property
    def added(self) -> list[str]:
        """The effects that this step added."""
        return [e.effect for e in newer(self.chosen.model, self.base.model)] if self.chosen is not None else []

    def errors(self, fitted: Fitted) -> dict[str, Errors]:
        """Return the errors of a model on the diagnosed records (`train`) and on the validation records."""
        return self.trial.errors(fitted)

    def nrmse(self, fitted: Fitted) -> dict[str, float]:
        """Return the free-run errors of `evaluate`, over the standard deviation of the output of these records."""
        return {name: e.free_run_nrmse for name, e in self.errors(fitted).items()}

    def figures(self, fitted: Fitted) -> dict[str, float]:
        """Return these errors, and with the ending `_rms` those in the unit of y."""
        found = self.errors(fitted)
        return self.nrmse(fitted) | {f"{name}_rms": e.free_run_rms for name, e in found.items()}

    def near(self, known: Row, *rows: Row) -> Step:
        """Take the rows that lessen the error by more than `SAME` for what comes nearest, and return the step."""
        less = [r for r in rows if r.held < (1 - SAME) * known.held]
        self.nearest = [" with ".join(v.id for v in r.beyond(known)) for r in less]
        self.nearest_share = 1 - less[0].held / known.held if less else 0.0
        return self

    def told(self, *names: str) -> list[str]:
        """Return effects as people call them in the machine: its words, where it has some, with the ids beside them."""
        found: dict[str, list[str]] = {}
        for name in names:
            found.setdefault(meaning(name, self.meanings), []).append(name)
        alone = {words: ids[0] for words, ids in found.items() if len(ids) == 1 and ids[0].endswith(words)}
        return [alone.get(words) or f"{words} ({joined(ids)})" for words, ids in found.items()]

    @property
    def synonyms(self) -> str:
        """Say which ids mean the same as members of the confusion set, in the machine that was measured."""
        said = [
            f"{joined(ids)} {'are' if ids[1:] else 'is'} the same thing as {n} here" for n, ids in self.same.items()
        ]
        return "".join(f" {text}." for text in said)

    @property
    def unseen(self) -> list[tuple[str, float]]:
        """Effects not found, that no refit absorbs, with the rms that would show, below that of y; smallest first."""
        hidden, most = {*self.absorbed, *self.confusion_set}, self.base.problem.spread
        sizes = self.smallest_detectable.items()
        return sorted(((n, size) for n, size in sizes if n not in hidden and size < most), key=lambda one: one[::-1])

    @property
    def unexplained(self) -> str:
        """What of the last error on samples that were not fitted the sensor cannot make; an empty text where it can."""
        held, sealed = (self.last.error(m) for m in (self.last.split.held, self.last.split.test))
        noise = self.sensor and max(self.sensor, ROUNDING * self.base.problem.spread)
        late = bool(sealed @ sealed > held @ held)
        said = unexplained(np.concatenate([held, sealed]) if late else held, noise, self.last.split.records[0].Ts)
        return f"{said}, most of it in the last samples" if said and late else said

    @property
    def trace(self) -> str:
        """What is left though nothing is named, in words; an empty text where no effect of the catalogue lessens it."""
        if not self.nearest or self.verdict != "nothing_detectable":
            return ""
        much = "but no effect explains enough of it" if self.unexplained else "but it is too small in these data"
        nearest = " or ".join(self.told(*self.nearest))
        return (
            f"A part of the error is unexplained (p = {self.p_value:.2g}), {much} to be named; {nearest} comes closest."
        )

    @property
    def follows_nothing(self) -> bool:
        """Whether nothing is named, and the free run of the base is no better than a constant."""
        return self.verdict == "nothing_detectable" and 2 * np.log(self.nrmse(self.base)["train"]) > -ALIKE

    @property
    def finding(self) -> str:
        """Return the verdict, or what it is in a case that is told in other words."""
        if self.verdict == "nothing_detectable":
            cases = ("follows_nothing", "one_step", "unexplained", "trace")
            return next((name for name in cases if getattr(self, name)), self.verdict)
        if self.refused is not None:
            return "refused"
        if self.verdict == "closed_loop" and self.valves:
            return "valve"
        if self.verdict == "closed_loop" and self.loop is not None and not self.loop.given:
            return "perhaps_closed_loop" if self.loop.unseen else "probably_closed_loop"
        return "two_effects" if self.pair is not None else self.verdict

    def sentence(self, units: Mapping[str, str]) -> str:  # noqa: C901, PLR0911, PLR0912
        """Return the verdict in plain words."""
        error = self.errors(self.base)["validation"]
        told = partial(sized, unit=units.get("y", ""), beside=error.free_run_rms)
        percent = float(f"{100 * error.free_run_nrmse:.3g}")
        sizes = f"The error on {self.trial.described} is {told(error.free_run_rms)} rms "
        sizes += f"({percent:g} % of the standard deviation of the output)"
        if self.verdict == "nothing_detectable":
            if self.follows_nothing:
                return f"The base model does not follow the output, so it cannot show which effect is missing. {sizes}."
            if self.one_step:
                return f"{ONE_STEP} {sizes}."
            shown = ", ".join(f"{words(name)} {told(size, digits=2)}" for name, size in self.unseen[:3])
            would = f"; the smallest detectable effects are {shown} rms" if shown else ""
            if self.unexplained:
                sizes += f"; the sensor's noise, if white, is about {told(self.sensor)}, {self.unexplained}"
            if self.trace or self.unexplained:
                return f"{self.trace or 'No effect of the catalogue explains the remaining error.'} {sizes}{would}."
            return f"No missing effect can be detected in these data. {sizes}{would}."
        if self.loop is not None and self.verdict == "closed_loop":
            said = [*(f"{v.record.name}: {v.sentence}." for v in self.valves), f"{self.loop.sentence}. {sizes}."]
            if self.loop.given and not self.valves:
                said += ["Valve stiction is only checked for an input in percent of its span, as a fraction, or in mA."]
            return " ".join(said)
        more = self.verdict in ("outside_library", "helps_but_incomplete") and self.floor_kind != REPEATED
        sizes += f"; the noise floor is {'at most' if more else 'about'} {told(self.floor)}"
        if self.sensor and self.sensor <= self.floor:  # what is more than a model leaves is no noise
            alone = f"sensor noise alone {told(self.sensor)}"
            sizes += f" ({alone if self.sensor < self.floor else 'all of it sensor noise'})"
        if self.refused is not None:
            return f"{self.refusal(units)} {sizes}."
        if self.verdict == "outside_library":
            removes = f"comes closest, and removes {100 * self.nearest_share:.0f} % of the squared error"
            near = (
                f" Of its effects, {self.told(self.nearest[0])[0]} {removes}: too little to be named."
                if self.nearest
                else ""
            )
            look = "Look at where the model fails, and at the equivalent missing input."
            return f"An effect is missing that is not in the catalogue. {sizes}.{near} {look}"
        if self.pair is not None:
            effects = self.told(*self.pair.effects)
            missing = f"{self.pair.counted} are probably missing" if len(effects) > 1 else "Probably missing"
            return (
                f"{missing}: {joined(effects)}. {sizes}. Together they "
                f"remove {100 * self.pair.share:.0f} % of the removable error in cross-validation"
                f"{'' if self.pair.all else ', but something else is missing too'}.{_instead(self.pair)}"
            )
        best = self.candidates[0]
        share = f"{100 * best.share:.0f} % of the removable error in cross-validation"
        what, name = f"{best.described.rstrip('.')} ({best.effect})", self.told(best.effect)[0]
        others = ", ".join(self.told(*(e for e in self.confusion_set if e not in (best.effect, BASE))))
        if self.verdict == "helps_but_incomplete":
            text = f"{what} explains {share}, but something else is missing too. {sizes}.{self.synonyms}"
            text += f" It could also be {others}." if others else ""
            return f"{text} {self.experiment.sentence}" if self.experiment else text
        if self.verdict == "confused":
            text = "One of these is probably missing, but these data cannot decide which: "
            text += f"{name}, {others}. {sizes}. "
            if BASE in self.confusion_set:
                names = f"{name} or {others}" if others else name
                sizes += f"; a linear base model alone leaves {told(self.linear)}" if self.linear else ""
                text = (
                    f"Perhaps missing: {names}; at one speed it cannot be distinguished from the dynamics of a "
                    f"linear base model. {sizes}. "
                )
            text += f"Adding {best.effect} removes {share}.{self.synonyms}"
            return f"{text} {self.experiment.sentence}" if self.experiment else text
        sure = f" ({self.how_sure})" if self.how_sure else ""
        what = f"{name}{sure}" if best.meaning else f"{name}{sure}. {what}"
        return f"Probably missing: {what}. {sizes}. Adding it removes {share}.{self.synonyms}"

    @property
    def how_sure(self) -> str:
        """The probability of what is named, with what means the same, in percent; "" where there is none."""
        if self.pair is not None:
            return "" if self.pair.probability is None else percent_of(self.pair.probability)
        best = next(iter(self.candidates), None)
        if best is None or best.probability is None:
            return ""
        alike = (best.effect, *self.same.get(best.effect, []))
        return percent_of(total(c.probability or 0.0 for c in self.candidates if c.effect in alike))

    def refusal(self, units: Mapping[str, str]) -> str:
        """Say why what was found is not added: its error on the record and on validation data, before and after."""
        if self.refused is None:
            return ""
        (one, before), (two, after) = self.moves(self.refused, units)
        names = joined(e.effect for e in newer(self.refused.model, self.base.model))
        on = f"and on {self.trial.described} it {two} {after}, so nothing is added."
        return f"With {names} the error on the record {one} {before}, {on}"

    def moves(self, fitted: Fitted, units: Mapping[str, str]) -> list[tuple[str, str]]:
        """Return how the error of a model moves from that of the base: on the record, then on validation data."""
        pairs = [(self.errors(self.base)[p].free_run_rms, self.errors(fitted)[p].free_run_rms) for p in PARTS]
        factor, unit = prefixed(units.get("y", ""), pairs[1][0])
        told = []
        for a, b in pairs:
            digits = 3 if few(a) != few(b) else 5
            sizes = f"from {few(factor * a, digits)} to {few(factor * b, digits)} {unit}".rstrip()
            told.append(("falls" if b < a else "rises", sizes))
        return told

    def to_dict(self, experiment_file: str | None) -> dict[str, Any]:
        """Return the step as plain data."""
        base, spread = self.base.model, self.base.problem.spread
        terms = [printing.text(t) for t in base.terms] if isinstance(base, NARX) else [printing.text(base.F)]
        return {
            "verdict": self.verdict, "finding": self.finding, "sentence": self.sentence({}),
            "refused": self.refusal({}),
            "confusion_set": self.confusion_set, "same_thing": self.same,
            "nearest": self.nearest, "nearest_share": self.nearest_share,
            "p_value": self.p_value,
            "base": {
                "latex": base.latex(), "terms": terms, "theta": [float(v) for v in base.theta],
                "nrmse": {
                    **self.nrmse(self.base), "noise_floor": float(self.floor / spread),
                    "noise_floor_from": self.floor_kind, "sensor_noise": float(min(self.sensor, self.floor) / spread),
                },
            },
            "candidates": [
                {
                    "effect": c.effect, "where": c.where, "form": str(c.variant), "parameters": c.parameters,
                    "latex": c.latex, "share_of_removable_error": c.share, "interval": list(c.interval),
                    "p_value": c.p_value, "probability": c.probability, "called": c.meaning,
                    "sentence": c.sentence, "samples_averaged": c.averaged,
                    "nrmse": dict.fromkeys(PARTS) | c.nrmse,
                }
                for c in self.candidates
            ],
            "smallest_detectable": self.smallest_detectable,
            "absorbed_by_a_refit": self.absorbed,
            "where_it_fails": [],
            "withdrawn": self.withdrawn,
            "valves": [v.to_dict() for v in self.valves],
            "together": self.pair and {
                "effects": list(self.pair.effects), "share": self.pair.share,
                "rivals": [list(rival) for rival in self.pair.rivals], "probability": self.pair.probability,
            },
            "experiment": self.experiment and {
                "separates": list(self.experiment.separates), "file": experiment_file,
                "sentence": self.experiment.sentence,
                "wider": self.experiment.wider and {
                    "limits": list(self.experiment.wider.limits), "separation": self.experiment.wider.separation,
                    "file": experiment_file and str(wider_file(experiment_file)),
                },
            },
        }  # fmt: skip


def _instead(pair: Pair) -> str:
    """Say what else explains as much as a pair, and which of the two is in all of it."""
    every = f"; {pair.sure[0]} is in all of them" if pair.sure else ""
    return f" It could also be {pair.others}{every}." if pair.rivals else ""


def meaning(name: str, meanings: Mapping[str, str]) -> str:
    """Return what an effect is called, by the meanings of ids; a channel is no part of them."""
    return meanings.get(name.partition(":")[0], name)


def as_one(names: Iterable[str], meanings: Mapping[str, str]) -> tuple[list[str], dict[str, list[str]]]:
    """Return the first effect of each meaning, and by it those that mean the same."""
    first: dict[str, str] = {}
    same: dict[str, list[str]] = {}
    for name in names:
        head = first.setdefault(meaning(name, meanings), name)
        if head != name:
            same.setdefault(head, []).append(name)
    return list(first.values()), same


def looped(base: Fitted, loop: Feedback | None, valves: Sequence[Sticking] = ()) -> Step:
    """Return what is said where the input answers the output."""
    error = float(np.sqrt(base.mean_square(base.split.held)))
    return Step(base, "closed_loop", [], [], error, NO_FLOOR, 1.0, {}, [], loop=loop, valves=list(valves))


def step(
    table: Table,
    known: Row,
    limits: tuple[float, float] | None = None,
    loop: Feedback | None = None,
) -> tuple[Step, Row]:
    """Run one round: what may be missing beside the effects of a row, and a verdict; also the row that it ends at.

    Two effects that only together explain the error are added together. `limits` is how far the input of the next
    experiment may go. In a `loop` an effect is named where it alone removes nearly all of the error: what a disturbance
    makes of the input imitates effects too, but in no healthy loop that the setpoint moves did one do so
    (tests/bench/evidence.py --part imitated).
    """
    known, best = _filled(table, known)
    table.course.reach(JUDGE)
    base, scored = table.own(known), table.screened(known)
    if loop is not None and (best is None or len(best.beyond(known)) > 1 or best.held > LEFT * known.held):
        return looped(base, loop), known
    repeats = base.split.noise
    floor = float(np.mean(np.concatenate(repeats) ** 2)) if repeats else base.mean_square(base.split.held)
    made = Step(
        base, "", [], [], float(np.sqrt(floor * (1 if repeats else 1 - scored.structure))),
        REPEATED if repeats else ESTIMATE, scored.scores.p_value, {} if table.one_step else detectable(scored),
        absorbed(scored), loop=loop, one_step=table.one_step, meanings=table.catalogue.meanings,
    )  # fmt: skip
    at, best, gone = instead(table, best, known)
    if best is None or (made.p_value > gate.LEVEL and best.held >= (1 - LARGE) * known.held):
        return _unnamed(made, table, known), known
    known, made.withdrawn = at, gone
    whole = table.complete(best, known)
    left = table.left(whole, known)
    # Two effects are no rival of one, though it be priced as two: it would be shown as if its first were enough.
    enough = [r for r in table.beside(known) if len(r.beyond(known)) <= len(best.beyond(known))]
    found = table.unsure(alike(enough, best, left), enough)
    best = found[0] = whole
    lowest = best.held * (1 - left)
    share = removes(best, known, left)
    made.candidates = candidates_of(table, known, best, found, lowest)
    for c in made.candidates:
        words = meaning(c.effect, made.meanings)
        c.meaning = "" if words == c.effect else words
    shown = {c.effect for c in made.candidates} | {BASE}  # a rival that cannot be held is none
    distinct = (name for name in dict.fromkeys(new_effect(r, known) for r in found) if name in shown)
    names, same = as_one(distinct, made.meanings)
    made.verdict = verdict(share, left, len(names))
    chosen = table.own(best)
    if not repeats:
        made.floor = float(np.sqrt(min(chosen.mean_square(base.split.held) * (1 - left), floor)))
    if made.verdict == "outside_library":
        return made.near(known, best), known
    both = [v.id for v in best.beyond(known)]
    pair = len(both) > 1
    made.confusion_set, made.same = (both, {}) if pair else (names, same)
    if pair:
        made.verdict = "helps_but_incomplete"
        rivals = tuple(ids for ids in (tuple(v.id for v in r.beyond(known)) for r in found[1:]) if ids)
        own = {meaning(name, made.meanings) for name in both}
        rivals = tuple(ids for ids in rivals if {meaning(name, made.meanings) for name in ids} != own)
        complete = verdict(share, left, 1) != "helps_but_incomplete"
        made.pair = Pair(tuple(both), chosen, share, rivals, complete, _probability(table, best, known, made.meanings))
    if len(made.confusion_set) > 1 and not pair:
        table.course.say(": looking for an experiment that separates them")
        bare = next((table.own(r).model for r in found if not r.beyond(known) and table.holds(r)), None)
        made.decide(bare, table.seed, limits)
    made.others = partial(_others, table, best, base, known, made.candidates[0].p_value, lowest, made)
    table.course.say(": deleting redundant terms")
    made.chosen = prune(chosen, base)
    return made, best


def _probability(table: Table, best: Row, known: Row, meanings: Mapping[str, str]) -> float:
    """Return how probable a set of effects is, with those sets that mean the same."""
    own = {meaning(name, meanings) for name in best.ids}
    found = probabilities(table.beside(known), known, len(best.beyond(known)))
    return total(p for ids, p in found.items() if {meaning(name, meanings) for name in ids} == own)


def law_worth(model: Model) -> int:
    """Return what the law of a model is worth: 0 none or an unstable one, 1 one that strays, 2 one that does not."""
    try:
        law = compensator(model, force=True)
        return 0 if stability(law).stable is False else 2 - int(strays(law))
    except NarxError:
        return 0


def _others(
    table: Table, best: Row, base: Fitted, known: Row, p_value: float, lowest: float, made: Step, alike: bool
) -> Iterator[Candidate]:
    """Give the effect of a winner with other cores and in other forms, the cheapest first; or what explains alike.

    `base` is that of the table, on the pieces that its rows are fitted on; what is shown of it is not.
    """
    most = alike_up_to(best.held, known.held) if alike else np.inf
    rows = [r for r in table.beside(known) if r.ids == best.ids and r is not best and r.held <= most]
    rows.sort(key=lambda r: r.price)
    for row in filter(table.holds, (r for r in rows[:RIVALS] if len(r.beyond(known)) == 1 and np.isfinite(r.price))):
        one = Candidate.of(table, row, known, p_value, lowest, likely=True)
        one.final = made.trial.final(prune(one.shown, base))
        one.probability, one.meaning = made.candidates[0].probability, made.candidates[0].meaning
        one.judge(made.trial, likely=True)
        yield one


def _unnamed(made: Step, table: Table, known: Row) -> Step:
    """Return a step in which no effect is worth its price: with what is left, if there is, and what comes nearest."""
    scored = table.checked(known)
    made.p_value = scored.scores.p_value
    listed = table.nearest(known, 1, RIVALS)
    removed = max((1 - r.held / known.held for r in listed), default=0.0)
    told = not (table.exact(known) or table.one_step)
    made.verdict = nothing_named(scored.structure if told else 0.0, removed)
    if made.verdict == "outside_library":
        return made.near(known, min(listed + table.nearest(known, 2, RIVALS), key=lambda r: r.price, default=known))
    return made.near(known, *(listed if made.p_value <= gate.LEVEL else ()))


def _filled(table: Table, known: Row) -> tuple[Row, Row | None]:
    """Fill the table beside a row; return the base, and the hypothesis that wins over it."""
    table.course.reach(WAYS)
    scored = table.screened(known)
    if table.exact(known) or table.one_step:
        return known, None
    seen = scored.scores.p_value <= gate.LEVEL or float(scored.scores.share.max()) >= LARGE
    if seen or scored.structure > HELPS:
        table.singles(known)
        jointly(table, known)
    at, alone = table.held(lambda: won([r for r in table.beside(known) if len(r.beyond(known)) <= 1], known))
    told = 0.0 if alone is None else 1 - alone.held / at.held  # what one effect removes follows from the signals
    if max(told, table.screened(at).structure) > HELPS and (alone is None or not suffices(table, alone, at)):
        table.pairs(known)  # two effects may hide each other
        exchanged(table, known)
    at, best = table.held(lambda: won(table.beside(known), known))
    if best is not None and closer(table, best, at):
        at, best = table.held(lambda: won(table.beside(known), known))
    return at, best
