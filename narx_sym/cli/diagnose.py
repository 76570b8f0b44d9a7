"""The command that names what is missing."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import DataError
from . import options as opt
from .options import with_own
from .printing import console, note, print_equations, print_found, print_headline, print_tables, say_written, working

if TYPE_CHECKING:
    from ..data.record import Record
    from ..diagnosis.procedure import Diagnosis
    from ..models.model import Model
    from ..tasks.black_box import BlackBox


RESULTS = ("json_file", "save", "plot", "experiment", "report", "verbose", "quiet")  # what is written and printed


@opt.reads()
def diagnose(
    context: typer.Context,
    data: opt.DataFiles,
    base: Annotated[
        str,
        typer.Option(
            help="Base model: narx, linear, static, play, bouc-wen, auto, a model file, a file with equations, or an "
            "FMU, whose native code runs."
        ),
    ] = "linear",
    delay: Annotated[
        int | None, typer.Option(min=0, max=10_000, help="Dead time in samples (default: estimated).")
    ] = None,
    validate: opt.Validate = None,
    max_effects: opt.MaxEffects = 1,
    open_loop: opt.OpenLoop = False,
    seed: opt.Seed = 0,
    limits: opt.Limits = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write everything as JSON.")] = None,
    save: Annotated[Path | None, typer.Option("--save", help="Write the model with its effects.")] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Write a picture; a second one (_where) shows where the model fails.")
    ] = None,
    experiment: Annotated[
        Path | None,
        typer.Option(
            "--experiment",
            help="Write the input of the proposed experiment as CSV (default: next.csv in the folder of --json).",
        ),
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write one HTML page that shows everything.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print tables: candidates, errors, limits.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print one line.")] = False,
    effects: opt.EffectFiles = None,
    scale: opt.Scale = None,
    machine: opt.Machine = "",
    resume: opt.Resume = None,
    *,
    how: opt.Reading,
) -> None:
    """Find the physical effect that is missing from a model, and add it.

    Without a model file a base model is identified first. An effect is only added if the error falls on the data and on
    validation data (those of --validate, else the last part of each record, to which no model is fitted). All errors
    are free-run errors over the whole record, with estimated start states, as in `narx-sym compare`.
    The same data and seed give the same JSON, except for its last field, `seconds`.
    An FMU for co-simulation is diagnosed from its own run and a linear model of it; what is named at its input is tried
    with the FMU itself. Running it runs its native code: name only one that you trust.
    """
    from ..diagnosis.experiment import check_limits, wider_file
    from ..diagnosis.machine import check_machine
    from ..diagnosis.procedure import diagnose as run
    from ..files import store
    from ..files.journal import resuming
    from ..fit.continuous import check_scale
    from ..report.words import with_units
    from ..tasks.physical import physical

    check_limits(limits)
    check_scale(scale)
    check_machine(machine)
    following = experiment or (json_file and json_file.with_name("next.csv"))
    written = [
        json_file,
        save,
        plot,
        plot and opt.where_beside(plot),
        following,
        following and wider_file(following),
        report,
        resume,
    ]
    file = Path(base) if base.lower().endswith(".json") or Path(base).is_file() else None
    opt.check_targets(written, *data, *(validate or []), *(effects or []), file)
    opt.check_format(plot, experiment)
    catalogue = with_own(effects or [])
    begin, measured, judging, box = _given(how, base, file, data, validate or [], {"--delay": delay, "--save": save})
    with resuming(resume) if resume else nullcontext() as journal:
        start = begin()
        with working("Diagnosing") as progress:
            found = run(
                start, measured, max_effects=max_effects, catalogue=catalogue, seed=seed, limits=limits, delay=delay,
                open_loop=open_loop, validation=judging, machine=machine, report=progress,
            )  # fmt: skip
    if journal is not None and journal.found:
        note(f"{journal.found} results were taken from {resume}")
    _say_done(found, measured)
    if box and (again := box.again(found, measured)) is not None:
        note(f"{base}: run along what the effects at its input let through, it has an NRMSE of {again:.3g}")
    # Results are written first, then printed whatever comes of the pictures and the report: a closed pipe loses none.
    found = with_units(found, found.units)
    quantities = physical(found, found.units, scale) if json_file or not quiet else ""
    _write_next(found, following, json_file, quantities)
    if save:
        store.save(found.model, save)
        if len(found.rungs) == 1:
            note("no effect was added: the written model is the base model")
    settings = {
        "base": base, "validation": ", ".join(map(str, validate or [])) or "last part",
        "delay": "found" if delay is None else delay, "max_effects": max_effects,
        "channels": how.channels or "none", "role": how.role or "found", "machine": found.machine.name or "not known",
        "rows": how.rows or "all", "open_loop": open_loop, **({"scale": scale} if scale else {}),
    }  # fmt: skip
    try:
        _draw(found, plot, report, data, settings)
    finally:
        if quiet:
            print_headline(found)
        else:
            typed = {"--base": ["--base", base], **opt.again(context, RESULTS)}
            print_found(
                found, found.units, _command(found, data, typed, save or (file if box else None), report), quantities
            )
            _print_more(found, verbose, following, save)
            pictures = plot and f"{plot}, {opt.where_beside(plot)}"
            say_written(("Model written to", save), ("Pictures:", pictures), ("Report:", report))
            say_written(("JSON written to", json_file))


def _draw(found: Diagnosis, plot: Path | None, report: Path | None, data: list[Path], settings: dict[str, Any]) -> None:
    """Write the pictures and the report."""
    from ..report.plots import plot_diagnosis, where_it_fails

    if plot:
        opt.save_figure(plot_diagnosis(found, units=found.units), plot)
        opt.save_figure(where_it_fails(found.misfit, units=found.units), opt.where_beside(plot))
    if report:
        with working("Writing the report"):
            found.report(report, found.units, data, settings)


def _say_done(found: Diagnosis, measured: list[Record]) -> None:
    """Print what was done with the data, and what to know of them, that was not printed when they were read."""
    from ..tasks.base import what_to_print

    known = set(what_to_print(measured))
    for said in found.data_notes:
        if said not in known:
            note(said)


def _read(file: Path, delay: int | None) -> Model:
    from ..tasks.base import read_base

    model = read_base(file)
    if delay is not None:
        raise DataError(
            f"{file}: this model already has a delay ({model.delay}); --delay is only for a base model that is "
            "identified here."
        )
    return model


def _given(
    how: opt.Reading, base: str, file: Path | None, data: list[Path], validate: list[Path], options: dict[str, Any]
) -> tuple[Callable[[], Model], list[Record], list[Record], BlackBox | None]:
    """Read base and records; return what makes the model to begin with, the records, and what an FMU is."""
    from ..tasks.base import equations_in

    if box := how.black_box(base):
        for name, value in options.items():
            if value is not None:
                raise DataError(f"{name} needs a base that is an equation: leave it out with an FMU.")
        measured = how.records(data)
        with working(f"Running {base}"):
            measured, judging = (
                [box.beside(r) for r in listed] for listed in (measured, how.validating(validate, measured))
            )
        return partial(_linearised, box, measured), measured, judging, box
    own, delay = equations_in(base), options["--delay"]
    model = _read(file, delay) if file and not own else None
    measured = how.records(data, model, named := _channels(own, model))
    return (
        partial(_begin, model or base, own, measured, delay),
        measured,
        how.validating(validate, measured, named),
        None,
    )


def _linearised(box: BlackBox, measured: list[Record]) -> Model:
    """Return what stands for an FMU."""
    with working(f"Identifying a linear model of {box.path}"):
        model = box.model(measured)
    if "u" not in {base.name for base in model.recursion.inputs}:
        note(f"{box.path}: no linear model follows it, so only its output is diagnosed")
    return model


def _channels(own: str, model: Model | None) -> tuple[str, ...]:
    """Return the names of the channels of a text of equations, or of a model."""
    from ..models.differential import from_equations

    asked = from_equations(own, 1.0) if own else model
    return asked.channels if asked else ()


def _begin(base: Model | str, own: str, measured: list[Record], delay: int | None) -> Model:
    """Return the model to begin with: the one given, that of equations of one's own, or one that is identified."""
    from ..tasks.base import check_kind, fit_equations, identify_base

    if own:
        with working(f"Fitting the equations of {base} to {sum(len(r) for r in measured)} samples"):
            return fit_equations(own, measured)
    if isinstance(base, str):
        with working(f"Identifying a base ({check_kind(base)}) from {sum(len(r) for r in measured)} samples"):
            return identify_base(base, measured, delay)
    return base


def _print_more(found: Diagnosis, verbose: bool, following: Path | None, save: Path | None) -> None:
    """Print tables, or how to see them, where the input of the next experiment is, and the model that is saved."""
    if verbose:
        print_tables(found, found.units)
    else:
        console().print("Candidates, errors and limits as tables: --verbose")
    if found.steps[0].experiment is not None:
        named = f"The input of the next experiment: {following}"
        console().print(named if following else "To write the input of the next experiment: --experiment next.csv")
    if save is not None:
        print_equations(found.model)


def _write_next(found: Diagnosis, path: Path | None, json_file: Path | None, quantities: Any) -> None:
    """Write the input of the next experiment, and everything as JSON."""
    from ..tasks.result_file import write_json

    step, written = found.steps[0], None
    if step.experiment is not None:
        if path is not None:
            step.experiment.save(path)
            beside = json_file is None or path.resolve().parent == json_file.resolve().parent
            written = path.name if beside else str(path)
        step.experiment = replace(step.experiment, units=found.units, file=written or "")
    if json_file is not None:
        write_json(found, json_file, written, quantities)


def _command(
    found: Diagnosis, data: list[Path], options: dict[str, list[str]], save: Path | None, report: Path | None
) -> str:
    """Return the command to go on with, if there is one: with every option that says what is read, and how."""
    files = [*map(str, data)]
    if {f.effect for f in found.faults} & {"frozen_sensor", "spikes"}:
        options["--missing"] = ["--missing", "drop"]
    elif found.verdict == "confused":
        files.append("NEW_RECORD.csv")
    elif found.verdict == "helps_but_incomplete" and not found.exhausted:
        options["--max-effects"] = ["--max-effects", str(1 + sum(len(s.added) for s in found.steps))]
    elif found.rungs[1:] and save is None:
        options["--save"] = ["--save", "model.json"]
    elif report is None:
        options["--report"] = ["--report", "report.html"]
    else:
        return ""
    return shlex.join(["narx-sym", "diagnose", *files, *(word for words in options.values() for word in words)])
