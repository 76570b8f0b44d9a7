"""Which physical effect is missing: the table is filled, the verdict is read off it, and what is named is added."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from ..data.evidence.feedback import Feedback, closed_loop, setpoint
from ..data.evidence.levels import at_levels, one_speed, one_way
from ..data.evidence.noise import repeated, sensor_noise
from ..data.evidence.rate import left_out, working
from ..data.evidence.roles import acting, with_roles
from ..data.evidence.several import told_once
from ..data.evidence.stiction import Sticking, span_of, sticking
from ..data.record import Record
from ..data.sensor import Fault, quantum, sensor_faults
from ..data.units import in_units, said_first
from ..data.units import listed as each
from ..errors import FitError, ModelError
from ..files.parallel import one_blas_thread
from ..fit.evaluate import PROTOCOL, evaluate
from ..fit.identify import prepare
from ..fit.simulate import Records, segments
from ..models.effects import EFFECTS, MACHINES, Catalogue
from ..models.extend import find
from ..models.info import whole
from ..models.model import Model
from ..symbolic.numbers import few
from .bases import BASE as MEMORY
from .bases import joined, words
from .doors import DiagnosisDoors
from .experiment import Experiment, check_limits
from .machine import Machine, check_machine, machine_of
from .misfit import Misfit, Portrait, misfit_of, portrait_of
from .progress import BASE, ROUND, Course, inside
from .refit import Fitted, Trial
from .settings import ALIKE, FEWEST
from .steps import PARTS, Step, looped, step
from .table.candidates import Candidate, Pair
from .table.hypotheses import family_of, static
from .table.offsets import without_offsets
from .table.rounds import Table
from .table.row import Row
from .table.verdict import VERDICTS, price

__all__ = ["VERDICTS", "Diagnosis", "Step", "diagnose"]
NO_TURN = {"static", "sensor", "disturbance", "dynamics"}  # families of effects that do not show where the input turns
UNNAMED = ("nothing_detectable", "outside_library")
ONE_SPEED = (
    "The input moves at one speed: there the dynamics of a linear base model can imitate friction, slack and "
    "hysteresis. A static base model shows them; a second speed or stroke decides."
)
EITHER = (
    " A static base model with {names} leaves {effect} of the output's standard deviation, the linear base model "
    "alone {memory}: these data cannot distinguish the two."
)


@dataclass
class Diagnosis(DiagnosisDoors):
    """What `diagnose` found, and the model with the added effects; see `diagnose` for an example.

    `sentence()` says it in words, `verdict` is one of `VERDICTS`, `best` the best candidate, `confusion_set` the
    effects that these data cannot distinguish, `model` the model with the added effects, and `errors` its errors
    before and after. `report(path)` writes one HTML page, `to_dict()` gives plain data for JSON.
    """

    steps: list[Step]
    misfit: Misfit
    seconds: float
    seed: int
    faults: list[Fault] = field(default_factory=list)
    data_notes: list[str] = field(default_factory=list)  # what was dropped, resampled or split, and what to know
    hypotheses: list[Row] = field(default_factory=list)  # the table, at the working rate
    judged: list[Record] = field(default_factory=list)  # the records where something was taken off, or resampled
    max_effects: int = 1
    machine: Machine = field(default_factory=Machine)  # what kind of machine was measured
    excluded: tuple[str, ...] = ()  # effects that were not considered, as it would take another machine
    one_speed: bool = False  # whether the input moves at one speed, where the memory of a linear base hides effects

    @property
    def verdict(self) -> str:
        """The verdict of the first step: one of `VERDICTS`."""
        return self.steps[0].verdict

    @property
    def candidates(self) -> list[Candidate]:
        """The candidates of the first step, best first."""
        return self.steps[0].candidates

    @property
    def exhausted(self) -> bool:
        """Whether no further effect was found after those that were added."""
        last = self.steps[-1]
        if last.pair is not None and last.pair.all and len(last.added) > 1:
            return True
        return len(self.steps) > 1 and last.chosen is None

    @property
    def aside(self) -> tuple[str, ...]:
        """Names of the signals in the first record's file that were not used."""
        return self.steps[0].base.split.records[0].aside

    @property
    def confusion_set(self) -> list[str]:
        """The effects of the first step that these data cannot distinguish."""
        return self.steps[0].confusion_set

    @property
    def experiment(self) -> Experiment | None:
        """The experiment that distinguishes the effects of `confusion_set`."""
        return self.steps[0].experiment

    @property
    def best(self) -> Candidate | Pair:
        """The best candidate: one effect, or two that only explain the error together.

        Raises
        ------
        ModelError
            Where there is no candidate: see the verdict.
        """
        if not self.candidates:
            raise ModelError(f"There is no candidate: the verdict is {self.verdict}.")
        return self.steps[0].pair or self.candidates[0]

    @property
    def model(self) -> Model:
        """The model with all added effects; without any, the base model as fitted here."""
        return (self.last or self.steps[0].base).model

    @property
    def last(self) -> Fitted | None:
        """The fit of the last step that added an effect, on the training samples."""
        return next((s.chosen for s in reversed(self.steps) if s.chosen is not None), None)

    @property
    def units(self) -> dict[str, str]:
        """The units of the signals, as the records say them."""
        return dict(self.steps[0].base.split.records[0].units)

    @property
    def floor(self) -> float:
        """The noise floor: rms of the noise, the lowest estimate of all steps [unit of y]."""
        return min(s.floor for s in self.steps)

    @cached_property
    def portrait(self) -> Portrait:
        """The missing input against the variable that explains most of it, with the added effects.

        It is of the segment with the most of the squared error, at the working rate.
        """
        base = self.steps[0].base
        after, known = {}, list[str]()
        for one in self.steps:
            if one.chosen is not None:
                known = [n for n in known if n not in one.withdrawn] + one.added
                after[joined(map(words, known))] = one.chosen.errors[base.worst]
        factor = working(self.steps[0].trial.records)[1]
        return portrait_of(base.model, base.split.records[base.worst], base.errors[base.worst], factor, after)

    @property
    def ladder(self) -> list[dict[str, Any]]:
        """The errors after each addition, those of `evaluate`: on the records (`train`) and on validation data.

        NRMSE, and with the ending `_rms` in the unit of y.
        """
        rungs: list[dict[str, Any]] = [{"added": "base", **self.steps[0].figures(self.steps[0].base)}]
        for one in self.steps:
            if one.chosen is not None:
                rungs.append({"added": " + ".join(one.added), **one.figures(one.chosen)})
                if one.withdrawn:
                    rungs[-1]["withdrawn"] = one.withdrawn
        return rungs

    @property
    def base(self) -> Model:
        """The base model: the given one, or a linear model with other orders if it fits the records better."""
        return self.steps[0].base.model

    @property
    def errors(self) -> dict[str, Any]:
        """What `evaluate` gives for `base` and `model`: on the diagnosed records, and on the validation records."""
        first, found = self.steps[0], dict[str, Any](protocol=PROTOCOL)
        for name, fitted in (("baseline", first.base), ("completed", self.last)):
            if fitted is not None:
                pairs = zip(("estimation", "validation"), first.errors(fitted).values(), strict=True)
                found[name] = {part: e.free_run_nrmse for part, e in pairs}
        return found

    @property
    def validation(self) -> str:
        """Which data are used for validation, in words."""
        return self.steps[0].trial.described

    @property
    def rungs(self) -> list[str]:
        """The effects that each step of `ladder` added, in words."""
        found: list[str] = []
        for rung in self.ladder:
            gone = f" instead of {', '.join(rung['withdrawn'])}" if "withdrawn" in rung else ""
            found.append(f"{'+ ' if found else ''}{rung['added']}{gone}")
        return found

    def sentence(self, units: Mapping[str, str] | None = None) -> str:
        """Return the result in words, with problems of the sensor; by default in the units of the records."""
        return self._verdict(said_first(self.units, units))

    def _verdict(self, units: Mapping[str, str]) -> str:
        first = self.steps[0]
        loop = [f"{first.loop.outweighed}."] if first.loop is not None and first.candidates else []
        return " ".join([first.sentence(units), *loop, *(fault.sentence for fault in self.faults)])

    def table(self) -> list[dict[str, Any]]:
        """One row per candidate of the first step."""
        return [
            {
                "effect": c.effect, "where": c.where, "share": c.share, "low": c.interval[0], "high": c.interval[1],
                "probability": c.probability, "before": c.nrmse["base_cross_validated"],
                "nrmse": c.nrmse["cross_validated"], "p_value": c.p_value,
                "in_confusion_set": c.effect in self.confusion_set,
                "parameters": ", ".join(f"{n} = {v:.4g}" for n, v in c.parameters.items()),
            }
            for c in self.candidates
        ]  # fmt: skip

    def to_dict(self, experiment_file: str | None = None) -> dict[str, Any]:
        """Return everything as plain data, in the published schema.

        `units` has those of the input, the output and every channel; an empty text where one is not known.
        """
        first = self.steps[0].to_dict(experiment_file)
        first["where_it_fails"] = [
            {"panel": row["panel"], "share": round(float(row["share"]), 6), "worst": row["worst"]}
            for row in self.misfit.table()
        ]
        first["portrait"] = self.portrait.to_dict()
        first |= {"schema": 1, "seed": self.seed, "seconds": round(self.seconds, 3), "ladder": self.ladder}
        first |= {"errors": self.errors, "validation_data": self.validation}
        first["sensor"] = [{"effect": f.effect, "size": f.size, "share": f.share} for f in self.faults]
        first["data_notes"] = self.data_notes
        first["sentence"] = self._verdict({})  # the same whatever the units are called
        if max(self.max_effects, len(self.steps)) > 1:
            rest = [s.to_dict(None) for s in self.steps[1:]]
            first["steps"] = [{n: v for n, v in first.items() if n not in ("schema", "seconds", "seed")}, *rest]
        about = self.machine.name and {
            "name": self.machine.name, "guessed": self.machine.guessed, "excluded": list(self.excluded),
        }  # fmt: skip
        reasons = {name: f"impossible for {MACHINES[self.machine.name]}" for name in self.excluded}
        first |= {"machine": about or None, "excluded": reasons}
        named = dict.fromkeys(("u", "y", *self.steps[0].base.split.records[0].channels), "")
        return first | {"units": named | self.units, "roles": dict(self.steps[0].base.split.records[0].roles)}

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
    limits: tuple[float, float] | None = None,
    delay: int | None = None,
    open_loop: bool = False,
    validation: Records = (),
    roles: Mapping[str, str] | None = None,
    machine: str = "",
    report: Callable[[str], Any] = lambda what: None,
) -> Diagnosis:
    r"""Find the physical effect that a model is missing, and add it to the model.

    The model is compared with the measurements in free run. Each effect of the catalogue (friction, backlash, creep,
    saturation, ...) is then added and fitted. An effect is only accepted if the error falls on the records and on
    validation data.

    Parameters
    ----------
    model : Model
        The base model, from the input u to the output y. Its parameters are fitted again in free run.
    records : Record or list of Record
        The measurements: u and y are (N,) arrays in the user's units, with at least 100 samples in all.
    max_effects : int
        Largest number of effects to add, one after the other. If only two effects together explain the error, both are
        added in one step.
    channels : list of str, or "all"
        Further measured signals that may act on the machine, by name.
    catalogue : Catalogue
        The effects to try.
    seed : int
        Seed of all random numbers: the same data and seed give the same result.
    limits : (low, high), optional
        Smallest and largest input of the proposed experiment [unit of u]. Default: the range of the records.
    delay : int, optional
        Delay of the input of a linear base model [samples]. Default: chosen from the data.
    open_loop : bool
        True if there was no controller: the record is then not checked for feedback. Use it if a machine that reacts
        within one sample is mistaken for a controller.
    validation : Record or list of Record
        Records that no model is fitted to. Default: the last part of each record is used instead.
    roles : mapping such as {"cmd": "setpoint"}, optional
        Roles of channels, in place of those in the records (`Record.roles`).
    machine : str
        Kind of machine, one of `effects.MACHINES`: effects that are impossible there are not considered, and the others
        have the names of that field. Default: that of the model (`Info.machine`), else guessed from the units; "none"
        if it is unknown.
    report : callable
        Receives a text after each piece of work (`diagnosis.progress.Told`). An exception in it stops the diagnosis;
        where it returns True, the search ends with what was found by then.

    Returns
    -------
    Diagnosis

    Raises
    ------
    FitError
        If the base model cannot follow the data at all, or if there are fewer than 100 samples.
    ModelError
        For an invalid model, invalid limits, an unknown channel or machine, or `max_effects` below 1.

    Examples
    --------
    >>> import numpy as np
    >>> import narx_sym as ns
    >>> volts = ns.plants.filtered_noise(N=400, Ts=0.01, cutoff=2.0, peak=5.0, seed=1)
    >>> acting = np.sign(volts) * np.maximum(abs(volts) - 1.0, 0.0)  # a dead zone of 1 V
    >>> lag = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2])
    >>> measured = lag.simulate(acting, y0=0.0, u0=0.0) + 0.005 * np.random.default_rng(0).standard_normal(400)
    >>> record = ns.Record.from_arrays(volts, measured, Ts=0.01, units={"u": "V", "y": "mm"})
    >>> found = ns.diagnose(lag.fit(record), record)
    >>> found.verdict, found.best.effect
    ('named', 'dead_zone')
    >>> print(*found.model.lines(), sep="\n")
    v[k] = u[k] - Max(-r_dead_zone, Min(r_dead_zone, u[k]))
    y[k] = theta_1*y[k-1] + theta_2*v[k-1]
    """
    begin = time.perf_counter()
    _check(model, limits, max_effects, machine, seed=seed, delay=delay)
    listed = prepare([with_roles(r, roles) for r in each(records)], model.info.units)
    measured = [n for n in listed[0].channels if all(n in r.channels for r in listed)]
    if unknown := [] if channels == "all" else [n for n in channels if n not in measured]:
        there = ", ".join(measured) or "none"
        raise ModelError(f"There is no channel {unknown[0]!r} in every record; there are {there}.")
    if (count := sum(len(r) for r in listed)) < FEWEST:
        raise FitError(f"{count} samples are too few to judge what is missing: at least {FEWEST} are needed.")
    named = [n for n in (measured if channels == "all" else channels) if all(n in acting(r) for r in listed)]
    start = model.fit(listed) if model.theta is None else model
    kind_of = machine_of(machine or model.info.machine, listed[0].units)
    catalogue = catalogue.of(kind_of.name)
    listed, held = at_levels(listed, lambda seen: evaluate(start, seen).free_run_nrmse)
    converter = quantum(np.concatenate([r.y for r in listed]))  # as measured: offsets that are taken off hide it

    kept = in_units(segments(validation), model.info.units) if validation else []
    search = partial(
        _searched, validation=kept, channels=named, catalogue=catalogue, seed=seed, limits=limits, delay=delay,
        quantum=converter, most=max_effects, open_loop=open_loop,
    )  # fmt: skip
    same_speed = family_of(start) == "linear" and one_speed(listed)
    stages = [BASE, *ROUND * max_effects]
    tell = inside(report, 0, len(stages)) if same_speed else report  # a second base may be asked
    speed = [ONE_SPEED] if same_speed else []
    with one_blas_thread():
        found = search(start, listed, Course(tell, stages))
        moved = _levelled(listed, found.steps[0])
        if moved is not None:
            listed, held = moved[0], [*held, *moved[1]]
            found = search(start, listed, Course(tell, stages))
        first, core = found.rounds[0]
        if same_speed and first.verdict in UNNAMED and not found.table.exact(core):
            bare = search(static(start), listed, Course(inside(report, len(stages)), stages))
            found, speed = _memory_or_effect(found, bare, limits) or (found, speed)
    table, steps = found.table, found.steps
    sensor = sensor_noise(listed, repeated(listed[0]))
    for one in steps:
        one.hear(sensor)
    failed = _misfit(steps[0].base, steps[0].floor)
    faults = sensor_faults(listed, min(s.floor for s in steps), converter)
    of_machine = kind_of.notes(catalogue, listed[0].units)
    ended = ["The search was ended before every effect was tried."] * table.course.enough
    said = [*_noted(listed, table), *ended, *of_machine, *_loads(steps), *speed, *held]
    if machine:
        _remember(steps, machine)
    seconds = time.perf_counter() - begin
    judged = listed if held or any(a.Ts != b.Ts for a, b in zip(each(records), listed, strict=True)) else []
    return Diagnosis(
        steps, failed, seconds, seed, faults, said, table.rows, judged, max_effects, kind_of, catalogue.excluded,
        same_speed,
    )  # fmt: skip


@dataclass
class _Searched:
    """A table that was filled, and its steps, each with the row that it ends at."""

    table: Table
    rounds: list[tuple[Step, Row]]

    @property
    def steps(self) -> list[Step]:
        """The steps alone."""
        return [made for made, _ in self.rounds]


def _searched(
    start: Model, seen: list[Record], course: Course, *, validation: list[Record], channels: Sequence[str],
    catalogue: Catalogue, seed: int,
    limits: tuple[float, float] | None, delay: int | None, quantum: float, most: int, open_loop: bool,
) -> _Searched:  # fmt: skip
    """Fill a table beside one base, step by step, until nothing more is added."""
    table = Table(start, seen, channels, catalogue, seed, course, delay, quantum)
    rounds: list[tuple[Step, Row]] = []
    known, loop = table.base, None if open_loop else closed_loop(seen)
    valves = _valves(seen, loop)
    if loop is not None and (valves or not loop.moved_by_setpoint):  # of a valve it is judged whether it sticks
        rounds.append((looped(table.own(known), loop, valves), known))
    trial = Trial.of(seen, validation)
    course.say(look=partial(_looked, table, trial, start))
    for made, _ in rounds:
        made.finish(trial, _baseline(trial, start, made.base))
    while not rounds or (rounds[-1][0].chosen is not None and len(known.hypothesis.effects) < most):
        before = rounds[-1][0].last if rounds else None
        made, known = step(table, known, limits, loop)
        made.finish(trial, before or _baseline(trial, start, made.base))
        known = made.half or known
        rounds.append((made, known))
    return _Searched(table, rounds)


def _looked(table: Table, trial: Trial, start: Model) -> Diagnosis:
    """Return what is known where the base is fitted: what it leaves."""
    base = _baseline(trial, start, table.own(table.base))
    first = replace(looped(base, None), verdict="nothing_detectable", trial=trial)
    return Diagnosis([first], _misfit(base, first.floor), 0.0, table.seed)


def _baseline(trial: Trial, given: Model, found: Fitted) -> Fitted:
    """Return the better of the given model as it is and the base of the search, by their errors on the records."""
    pair = [trial.final(found), *([trial.as_given(given)] if given.theta is not None else [])]
    return min(pair, key=lambda one: trial.errors(one)["train"].free_run_rms)


def _memory_or_effect(
    linear: _Searched, bare: _Searched, limits: tuple[float, float] | None
) -> tuple[_Searched, list[str]] | None:
    """Return the steps from a static base and what is to be said, where it explains what a linear base does.

    Nothing is named then: records of one speed cannot tell an effect from the memory of the base, which costs what an
    effect does, as beside a static base. None where the linear base explains them better.
    """
    averaged = linear.table.finer.averaged
    (_, core), (first, row) = linear.rounds[0], bare.rounds[0]
    memory, effect = linear.table.own(core), bare.table.own(row)
    if first.chosen is None or first.pair is not None:
        return None
    forms = [find(name, linear.table.catalogue)[0] for name in first.confusion_set if name != MEMORY]
    families = [effects[0].family for effects in forms]
    if families[0] == "dynamics" or set(families) <= NO_TURN:  # the memory of a base itself, or nothing like it
        return None
    like_one = int(core.hypothesis.core.remembers)
    paid = price(averaged(memory), core.paid, core.charged + like_one)
    if price(averaged(effect), row.paid, row.charged) > paid + ALIKE:
        return None
    names = [*(c.effect for c in first.candidates if c.effect in first.confusion_set), MEMORY]
    alone = float(np.sqrt(memory.mean_square(memory.split.held)))
    both = replace(first, verdict="confused", confusion_set=names, linear=alone)
    both.decide(memory.model, linear.table.seed, limits)
    said = EITHER.format(
        names=first.candidates[0].effect,
        effect=few(first.nrmse(first.last)["validation"]),
        memory=few(alone / memory.problem.spread),
    )
    return replace(bare, rounds=[(both, row), *bare.rounds[1:]]), [f"{ONE_SPEED}{said}"]


def _noted(records: Sequence[Record], table: Table) -> list[str]:
    """Return what is to know of records and of how they were compared, as sentences."""
    of = len(records) if not table.same_rate else 0
    names = told_once(records, lambda r: [*r.notes, *r.remarks(records), *one_way(r), *left_out(r, of)])
    said = [f"{joined(of)}: {text}" for text, of in names.items()]
    if table.factor > 1:
        said.append(f"The candidate effects were compared on averages of {table.factor} samples.")
    if table.search.integrating:
        said.append(
            f"The model is an integrator: the effects are compared on {len(table.search.cut)} pieces of the "
            "record, each with its own start."
        )
    return said


def _loads(steps: Sequence[Step]) -> list[str]:
    """Say that the load of an axis that integrates is estimated on each record, and the error without that."""
    last = next((s for s in reversed(steps) if s.chosen is not None), steps[0])
    own = {part: e.own_load_nrmse for part, e in last.errors(last.last).items() if e.own_load_nrmse is not None}
    if not own:
        return []
    shown = ", ".join(
        f"{few(own[p])} on {where}" for p, where in zip(PARTS, ("the record", "validation data"), strict=True)
    )
    return [
        "The model is an integrator (a pole fixed at 1), so an unknown constant load is estimated for each record, "
        f"like a start state. With the load of the model instead, the free-run NRMSE is {shown}."
    ]


def _remember(steps: Sequence[Step], machine: str) -> None:
    """Put what the user said of the machine into the models that a diagnosis shows, and so into their files."""
    for fitted in (f for one in steps for f in (one.base, one.chosen) if f is not None):
        fitted.model = fitted.model.replace(info=replace(fitted.model.info, machine=machine))


def _levelled(records: list[Record], first: Step) -> tuple[list[Record], list[str]] | None:
    """Return records without the offsets between them, where these explain more than what would be named."""
    if first.pair is not None:
        return without_offsets(records, first.base, first.pair.fitted, len(first.pair.effects))
    if not first.candidates:
        return None
    return without_offsets(records, first.base, first.candidates[0].fitted, 1)


def _valves(records: Sequence[Record], loop: Feedback | None) -> list[Sticking]:
    """Ask of each record of a loop whether its valve sticks.

    Without a setpoint nothing says that a valve is in it: then only what looks so is told.
    """
    found = [(r, sticking(r)) for r in records if loop is not None and span_of(r)]
    return [one for r, one in found if one.perhaps or setpoint(r) is not None]


def _misfit(fitted: Fitted, floor: float | None) -> Misfit:
    """Where a fitted model fails, along the segment with the most of its squared error."""
    i = fitted.worst
    return misfit_of(fitted.model, fitted.split.records[i], fitted.errors[i], floor)


def _check(model: Any, limits: Any, max_effects: Any, machine: str, **numbers: Any) -> None:
    """Refuse what a diagnosis cannot begin with."""
    if not isinstance(model, Model):
        raise ModelError(f"Give a model (ns.identify, ns.load), then its records, not {type(model).__name__}.")
    whole(max_effects=max_effects, **numbers)
    if max_effects < 1:
        raise ModelError("max_effects must be at least 1.")
    check_limits(limits)
    check_machine(machine)
