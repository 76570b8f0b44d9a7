"""Which physical effect is missing: gate, score, refit, verify, verdict; the functions below, in order."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..data.evidence.feedback import SETPOINTS, Feedback, closed_loop
from ..data.sensor import Fault, sensor_faults
from ..errors import FitError, ModelError
from ..files.parallel import one_blas_thread
from ..fit.identify import prepare
from ..fit.simulate import Records
from ..models.added import AddedEffect
from ..models.effects import EFFECTS, Catalogue
from ..models.extend import newer, without
from ..models.model import NARX, Model
from ..symbolic import printing
from . import gate
from .bases import BASE, fit_base, one_speed, settled_again, simpler
from .candidates import (
    CLOSE,
    LARGE,
    Candidate,
    absorbed,
    chance,
    confusion_set,
    detectable,
    imitated,
    large,
    ranked,
    refit,
    score,
    shares,
)
from .doors import DiagnosisDoors
from .experiment import Experiment, propose
from .misfit import Misfit, misfit_of
from .pairs import Pair, best_pair, single
from .refit import Fitted, Split, prune, settle

Array = np.ndarray
EXPLAINED, NEARLY_ALL, HELPS = 0.85, 0.995, 0.3  # shares of the removable error
INCOMPLETE = 0.1  # share of the error that is left: more structure than this, and something else is missing too
NEAR = 0.2  # of a noise floor from repeated periods
FEWEST = 100  # samples: with less the noise cannot be told from an effect
VERDICTS = ("nothing_detectable", "named", "confused", "helps_but_incomplete", "outside_library", "closed_loop")


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
        Where the input answers the output: then nothing is named.
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

    @property
    def added(self) -> list[str]:
        """The effects that this step added."""
        return [e.effect for e in newer(self.chosen.model, self.base.model)] if self.chosen is not None else []

    def nrmse(self, fitted: Fitted) -> dict[str, float]:
        """Return the free-run errors of a model over the standard deviation of the output."""
        spread, split = fitted.problem.spread, self.base.split
        return {
            "train": float(np.sqrt(fitted.mean_square(split.train)) / spread),
            "validation": float(np.sqrt(fitted.mean_square(split.held)) / spread),
        }

    def sentence(self, units: Mapping[str, str]) -> str:
        """Return the verdict in plain words."""
        unit = f" {units['y']}" if units.get("y") else ""
        error = np.sqrt(self.base.mean_square(self.base.split.held))
        spread = self.base.problem.spread
        percent = float(f"{100 * error / spread:.2g}")
        sizes = f"The error is {error:.3g}{unit} rms ({percent:g} % of the output's standard deviation)"
        if self.verdict == "nothing_detectable":
            seen = sorted(self.smallest_detectable.items(), key=lambda p: p[1])
            shown = ", ".join(f"{name} above {size:.2g}{unit}" for name, size in seen[:3])
            return f"Nothing is missing that these data can show. {sizes}; seen would have been {shown} rms."
        if self.loop is not None:
            return f"{self.loop.sentence}. {sizes}."
        sizes += f"; the noise floor is about {self.floor:.3g}{unit}"
        if self.verdict == "outside_library":
            return (
                f"Something is missing that the catalogue does not know. {sizes}. Look at where the model fails, and "
                "at the equivalent missing input."
            )
        if self.pair is not None:
            return (
                f"Two effects are probably missing: {' and '.join(self.pair.effects)}. {sizes}. Together they remove "
                f"{100 * self.pair.share:.0f} % of the removable error on data never used for fitting."
            )
        best = self.candidates[0]
        share = f"{100 * best.share:.0f} % of the removable error on data never used for fitting"
        what = f"{best.variant.effect.sentence.rstrip('.')} ({best.effect})"
        if self.verdict == "helps_but_incomplete":
            return f"{what} explains {share}, but not all that is missing. {sizes}."
        if self.verdict == "confused":
            others = ", ".join(e for e in self.confusion_set if e not in (best.effect, BASE))
            text = f"One of several effects is missing: {best.effect}, or as well {others}. {sizes}. "
            if BASE in self.confusion_set:
                names = f"{best.effect}, or as well {others}," if others else best.effect
                text = f"{names} may be missing: at one speed it and the base's velocity term are one signal. {sizes}. "
            text += f"{best.effect} removes {share}."
            return f"{text} {self.experiment.sentence}" if self.experiment else text
        return f"{best.effect} is probably missing. {what}. {sizes}. Adding it removes {share}."

    def to_dict(self, experiment_file: str | None) -> dict[str, Any]:
        """Return the step as plain data."""
        base = self.base.model
        terms = [printing.text(t) for t in base.terms] if isinstance(base, NARX) else [printing.text(base.F)]
        return {
            "verdict": self.verdict,
            "sentence": self.sentence({}),
            "confusion_set": self.confusion_set,
            "p_value": self.p_value,
            "base": {
                "latex": base.latex(), "terms": terms, "theta": [float(v) for v in base.theta],
                "nrmse": {
                    **self.nrmse(self.base), "noise_floor": float(self.floor / self.base.problem.spread),
                    "noise_floor_from": self.floor_kind,
                },
            },
            "candidates": [
                {
                    "effect": c.effect, "where": c.where, "form": str(c.variant), "parameters": c.parameters,
                    "latex": c.latex, "share_of_removable_error": c.share, "interval": list(c.interval),
                    "p_value": c.p_value, "sentence": c.sentence, "nrmse": self.nrmse(c.fitted),
                }
                for c in self.candidates
            ],
            "smallest_detectable": self.smallest_detectable,
            "absorbed_by_a_refit": self.absorbed,
            "where_it_fails": [],
            "withdrawn": self.withdrawn,
            "together": self.pair and {"effects": list(self.pair.effects), "share": self.pair.share},
            "experiment": self.experiment and {
                "separates": list(self.experiment.separates), "file": experiment_file,
                "sentence": self.experiment.sentence,
            },
        }  # fmt: skip


def step(
    base: Fitted,
    channels: Sequence[str] = (),
    catalogue: Catalogue = EFFECTS,
    seed: int = 0,
    report: Callable[[str], Any] = lambda what: None,
    room: int = 1,
) -> Step:
    """Run one round of the procedure at a fitted base; `room` is how many effects may be added."""
    split = base.split
    report("deriving the directions of all effects")
    scored = score(base, channels, catalogue, seed)
    scores = scored.scores
    v0, repeats = base.mean_square(split.held), split.noise
    kind = "repeated periods" if repeats else "estimate"
    floor = float(np.mean(np.concatenate(repeats) ** 2)) if repeats else v0
    made = Step(
        base,
        "nothing_detectable",
        [],
        [],
        float(np.sqrt(floor)),
        kind,
        scores.p_value,
        detectable(scored),
        absorbed(scored),
    )
    unexplained = "outside_library" if scored.structure > HELPS else "nothing_detectable"
    if scores.p_value > gate.LEVEL and scores.share.max() < LARGE and scored.structure <= HELPS:
        return made
    found = refit(scored, report)
    again = settled_again(base, [c.fitted for c in found]) if found else None
    if again is not None:
        report("fitting the base from a better start")
        return step(again, channels, catalogue, seed, report, room)
    for other in simpler(base) if imitated(catalogue) else []:
        report("trying the effects in the place of base terms")
        found += refit(score(other, channels, imitated(catalogue), seed), report, instead_of=base)
    candidates = ranked(found, base.independent())
    if not repeats:
        made.floor = float(np.sqrt(v0 * (1 - scored.structure)))
    report("estimating the noise floor")
    floor, complete = _floor(made, candidates, channels, catalogue, seed)
    if not (complete or (candidates and candidates[0].replaces)) and scored.structure > HELPS:
        made.pair = best_pair(scored, candidates, report)
        enough = single(made.pair, scored) if made.pair is not None else None
        if enough is not None:
            made.pair, candidates = None, ranked([*found, enough], base.independent())
            floor, complete = _floor(made, candidates, channels, catalogue, seed)
    if not candidates:
        made.verdict, made.pair = "outside_library", None
        return made
    if made.pair is not None:
        floor, members = floor if repeats else min(floor, made.pair.mean_square), made.pair.effects
        if candidates[0].effect not in members:
            candidates.sort(key=lambda c: c.effect not in members)
    confused = confusion_set(candidates)
    candidates.sort(key=lambda c: c.effect not in confused)
    best = candidates[0]
    strongest = min(candidates, key=lambda c: c.mean_square)
    most = made.pair.fitted if made.pair is not None else strongest.fitted
    made.p_value = max(made.p_value, chance(base, most, scored, seed))
    no_accident, base_error = large(base, most, seed), (1 - LARGE) * v0
    if no_accident is not None:
        # No noise does this, whatever its colour; a periodic error that the noise model takes for noise passes here.
        made.p_value = min(made.p_value, no_accident)
        for c in candidates:
            c.p_value = made.p_value if c.p_value > gate.LEVEL and c.mean_square < base_error else c.p_value
    if made.p_value > gate.LEVEL:
        made.verdict, made.pair = unexplained, None
        return made
    made.floor = float(np.sqrt(floor))
    shares(base, candidates, floor, seed)
    made.candidates = candidates
    # The sealed samples are opened here, once: what is real helps at the end of the record too.
    worse = most.mean_square(split.test) > base.mean_square(split.test)
    if no_accident is None and (worse or strongest.interval[0] <= 0):
        made.candidates, made.verdict, made.pair = [], unexplained, None
        return made
    made.confusion_set = confused
    if made.pair is not None:
        made.pair.share = (v0 - made.pair.mean_square) / (v0 - floor)
    made.verdict = _verdict(made, complete)
    friction = best.variant.effect.family == "friction"
    if friction and one_speed(base, best.variant.driver) and made.verdict in ("named", "helps_but_incomplete"):
        made.verdict, made.pair = "confused", None
        made.confusion_set.append(BASE)
    if made.verdict == "confused":
        report("looking for an experiment that separates them")
        models = {c.effect: c.model for c in candidates if c.effect in made.confusion_set}
        models |= {BASE: base.model} if BASE in made.confusion_set else {}
        made.experiment = propose(models, list(split.records), made.floor, seed)
    if made.verdict != "outside_library":
        report("deleting what became redundant")
        chosen = made.pair.fitted if made.pair is not None and room > 1 else best.fitted
        made.chosen = prune(chosen, base)
    return made


def _verdict(made: Step, complete: bool) -> str:
    """Return what the shares of the candidates, and of a pair, say; `complete` if the best comes down to the floor."""
    pair = made.pair.share if made.pair is not None else 0.0
    if max(pair, *(c.share for c in made.candidates)) < HELPS:
        return "outside_library"
    if made.candidates[0].share < EXPLAINED or not complete:
        return "helps_but_incomplete"
    return "confused" if len(made.confusion_set) > 1 else "named"


def _floor(
    made: Step, candidates: Sequence[Candidate], channels: Sequence[str], catalogue: Catalogue, seed: int
) -> tuple[float, bool]:
    """Return the squared noise floor, and whether the best candidate comes down to it."""
    floor, split = made.floor**2, made.base.split
    if not candidates:
        return floor, False
    best = candidates[0]
    if split.noise:
        complete = best.mean_square <= (1 + NEAR) ** 2 * floor
    else:
        left = score(best.fitted, channels, catalogue, seed).missing
        floor = min(best.mean_square * (1 - left), floor, *(c.mean_square for c in candidates))
        complete = left < INCOMPLETE
    return floor, complete or best.mean_square < (1 - NEARLY_ALL) * made.base.mean_square(split.held)


def reconsider(
    steps: Sequence[Step],
    channels: Sequence[str],
    catalogue: Catalogue,
    seed: int,
    report: Callable[[str], Any],
) -> Step | None:
    """Ask whether the effects added before are still the right ones (floating search, Pudil et al. 1994).

    One that is no longer needed goes, which is noted in the last step. Where another effect does better in the place of
    one, the step that says so is returned.
    """
    made = steps[-1]
    now = made.chosen
    if now is None:
        return None
    given = len(steps[0].base.model.effects)
    for one in now.model.effects[given : -len(made.added)]:
        report(f"asking whether {one.effect} is still the right effect")
        others = [e.effect for e in now.model.effects[given:] if e is not one]
        smaller = _without(now, one, steps[0].base, others, channels, catalogue, seed)
        if smaller is None:
            continue
        error = now.mean_square(now.split.held)
        if smaller.mean_square(now.split.held) < CLOSE**2 * error:
            made.withdrawn.append(one.effect)
            made.chosen = now = smaller
            continue
        trial = step(smaller, channels, catalogue, seed, report)
        if trial.chosen is None or trial.candidates[0].effect == one.effect:
            continue
        if CLOSE**2 * trial.chosen.mean_square(now.split.held) < error:
            trial.withdrawn.append(one.effect)
            return trial
    return None


def _without(
    now: Fitted,
    one: AddedEffect,
    base: Fitted,
    others: Sequence[str],
    channels: Sequence[str],
    catalogue: Catalogue,
    seed: int,
) -> Fitted | None:
    """Return the better of two fits without one effect: what is left of the model, and the base with the others."""
    found = []
    try:
        found.append(settle(without(now.model, one.coefficients.values()), now.split, limits=now.limits))
    except FitError:
        pass
    rebuilt: Fitted | None = base
    for effect in others:
        if rebuilt is not None:
            name = effect.partition(":")[0]
            scored = score(rebuilt, channels, Catalogue({name: catalogue[name]}), seed)
            fits = [c for c in refit(scored, lambda what: None) if c.effect == effect]
            rebuilt = min(fits, key=lambda c: c.mean_square).fitted if fits else None
    found += [rebuilt] if rebuilt is not None else []
    return min(found, key=lambda f: f.mean_square(now.split.train), default=None)


@dataclass
class Diagnosis(DiagnosisDoors):
    """What is missing from a model, step by step."""

    steps: list[Step]
    misfit: Misfit
    seconds: float
    seed: int
    faults: list[Fault] = field(default_factory=list)
    data_notes: list[str] = field(default_factory=list)  # what was dropped, resampled or split, and what to know

    @property
    def verdict(self) -> str:
        """The verdict of the first step: one of `VERDICTS`."""
        return self.steps[0].verdict

    @property
    def candidates(self) -> list[Candidate]:
        """The candidates of the first step, best first."""
        return self.steps[0].candidates

    @property
    def confusion_set(self) -> list[str]:
        """The effects of the first step that these data cannot tell apart."""
        return self.steps[0].confusion_set

    @property
    def experiment(self) -> Experiment | None:
        """The experiment that separates the confusion set of the first step."""
        return self.steps[0].experiment

    @property
    def best(self) -> Candidate:
        """The best candidate."""
        if not self.candidates:
            raise ModelError(f"There is no candidate: the verdict is {self.verdict}.")
        return self.candidates[0]

    @property
    def model(self) -> Model:
        """The model after the last step that added something, else the base as fitted here."""
        return (self.last or self.steps[0].base).model

    @property
    def last(self) -> Fitted | None:
        """What the last step that added something made, on the training samples."""
        return next((s.chosen for s in reversed(self.steps) if s.chosen is not None), None)

    @property
    def floor(self) -> float:
        """Rms of the noise: the lowest that any step tells [unit of y]."""
        return min(s.floor for s in self.steps)

    @property
    def ladder(self) -> list[dict[str, Any]]:
        """The errors after each addition, down to the noise floor: name, NRMSE on training and held-out samples."""
        rungs = [{"added": "base", **self.steps[0].nrmse(self.steps[0].base)}]
        for one in self.steps:
            if one.chosen is not None:
                rungs.append({"added": " + ".join(one.added), **one.nrmse(one.chosen)})
                if one.withdrawn:
                    rungs[-1]["withdrawn"] = one.withdrawn
        return rungs

    @property
    def rungs(self) -> list[str]:
        """What each step of the ladder did, in words."""
        found: list[str] = []
        for rung in self.ladder:
            gone = f" instead of {', '.join(rung['withdrawn'])}" if "withdrawn" in rung else ""
            found.append(f"{'+ ' if found else ''}{rung['added']}{gone}")
        return found

    def sentence(self, units: Mapping[str, str] | None = None) -> str:
        """Return the verdict in plain words, and what the sensor does."""
        return " ".join([self.steps[0].sentence(units or {}), *(fault.sentence for fault in self.faults)])

    def table(self) -> list[dict[str, Any]]:
        """One row per candidate of the first step."""
        return [
            {
                "effect": c.effect, "where": c.where, "share": c.share, "low": c.interval[0], "high": c.interval[1],
                "nrmse": self.steps[0].nrmse(c.fitted)["validation"], "p_value": c.p_value,
                "in_confusion_set": c.effect in self.confusion_set,
                "parameters": ", ".join(f"{n} = {v:.4g}" for n, v in c.parameters.items()),
            }
            for c in self.candidates
        ]  # fmt: skip

    def to_dict(self, experiment_file: str | None = None) -> dict[str, Any]:
        """Return everything as plain data, in the published schema."""
        first = self.steps[0].to_dict(experiment_file)
        first["where_it_fails"] = [
            {"panel": row["panel"], "share": round(float(row["share"]), 6), "worst": row["worst"]}
            for row in self.misfit.table()
        ]
        first |= {"schema": 1, "seed": self.seed, "seconds": round(self.seconds, 3), "ladder": self.ladder}
        first["sensor"] = [{"effect": f.effect, "size": f.size, "share": f.share} for f in self.faults]
        first["data_notes"] = self.data_notes
        first["sentence"] = self.sentence()
        if len(self.steps) > 1:
            rest = [s.to_dict(None) for s in self.steps[1:]]
            first["steps"] = [{n: v for n, v in first.items() if n not in ("schema", "seconds", "seed")}, *rest]
        return first

    def __repr__(self) -> str:
        return f"Diagnosis({self.sentence()})"


def diagnose(
    model: Model,
    records: Records,
    *,
    max_effects: int = 1,
    channels: Sequence[str] | str = "all",
    catalogue: Catalogue = EFFECTS,
    seed: int = 0,
    report: Callable[[str], Any] = lambda what: None,
) -> Diagnosis:
    """Compare a model with measurements and name the physical effect that is missing.

    Parameters
    ----------
    model : Model
        The base. Its parameters are refitted in free run: what a refit absorbs is not missing.
    records : Record or list of Record
        Every record is split in blocks: for fitting, for judging, and a sealed end.
    max_effects : int
        How many effects are added, one after the other.
    channels : names or "all"
        Which further measured signals may act.
    catalogue : Catalogue
        The effects that are tried.
    report : callable
        Told what is going on.

    Returns
    -------
    Diagnosis

    Raises
    ------
    FitError
        Where the base cannot follow the data at all.
    """
    begin = time.perf_counter()
    if max_effects < 1:
        raise ModelError("max_effects must be at least 1.")
    listed = prepare(records)
    measured = [n for n in listed[0].channels if all(n in r.channels for r in listed)]
    unknown = [] if channels == "all" else [n for n in channels if n not in measured]
    if unknown:
        raise ModelError(
            f"There is no channel {unknown[0]!r} in every record; there are {', '.join(measured) or 'none'}."
        )
    count = sum(len(r) for r in listed)
    if count < FEWEST:
        raise FitError(f"{count} samples are too few to judge what is missing: at least {FEWEST} are needed.")
    named = [n for n in (measured if channels == "all" else channels) if n not in SETPOINTS]
    split = Split.of(listed)
    report("fitting the base in free run")
    base = fit_base(model, split)
    given = len(base.model.effects)
    steps: list[Step] = []
    failed: Misfit | None = None
    loop = closed_loop(listed)
    if loop is not None:
        error = float(np.sqrt(base.mean_square(split.held)))
        steps.append(Step(base, "closed_loop", [], [], error, "not estimated", 1.0, {}, [], loop=loop))
    with one_blas_thread():
        while loop is None:
            room = max_effects - len(base.model.effects) + given
            made = step(base, named, catalogue, seed, report, room)
            steps.append(made)
            failed = failed or _misfit(made.base, made.floor)
            if made.chosen is None:
                break
            again = reconsider(steps, named, catalogue, seed, report) if len(steps) < 2 * max_effects else None
            steps += [again] if again else []
            base = steps[-1].chosen or base
            if len(base.model.effects) - given >= max_effects:
                break
    faults = sensor_faults(listed, min(s.floor for s in steps))
    said = [f"{r.name}: {text}" for r in listed for text in (*r.notes, *r.remarks())]
    return Diagnosis(steps, failed or _misfit(base, None), time.perf_counter() - begin, seed, faults, said)


def _misfit(fitted: Fitted, floor: float | None) -> Misfit:
    """Where a fitted model fails along the longest segment."""
    i = int(np.argmax([len(r) for r in fitted.split.records]))
    return misfit_of(fitted.model, fitted.split.records[i], fitted.errors[i], floor)
