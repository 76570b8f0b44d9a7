"""The command that names what is missing."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import DataError
from .options import (
    Channels,
    DataFiles,
    EffectFiles,
    Input,
    Limits,
    Machine,
    MaxEffects,
    Missing,
    OpenLoop,
    Output,
    Resume,
    Roles,
    Rows,
    Scale,
    Seed,
    Time,
    Ts,
    Units,
    Validate,
    again,
    check_format,
    check_targets,
    records,
    save_figure,
    say_resumed,
    validating,
    where_beside,
    with_columns,
    with_own,
)
from .printing import console, note, print_equations, print_found, print_headline, print_tables, working

if TYPE_CHECKING:
    from ..data.record import Record
    from ..diagnosis.procedure import Diagnosis
    from ..models.model import Model


RESULTS = ("json_file", "save", "plot", "experiment", "report", "verbose", "quiet")  # what is written and printed


def diagnose(
    context: typer.Context,
    data: DataFiles,
    base: Annotated[
        str, typer.Option(help="narx, linear, static, play, bouc-wen, auto, a model file, or a file with equations.")
    ] = "linear",
    delay: Annotated[
        int | None, typer.Option(min=0, max=10_000, help="Dead time in samples; found by default.")
    ] = None,
    validate: Validate = None,
    max_effects: MaxEffects = 1,
    open_loop: OpenLoop = False,
    seed: Seed = 0,
    limits: Limits = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write everything as JSON.")] = None,
    save: Annotated[Path | None, typer.Option("--save", help="Write the model with its effects.")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Picture; where it fails beside it (_where).")] = None,
    experiment: Annotated[
        Path | None, typer.Option("--experiment", help="CSV for the next input (default: next.csv beside --json).")
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write one HTML page that shows everything.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print tables: candidates, errors, limits.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print one line.")] = False,
    effects: EffectFiles = None,
    units: Units = "",
    scale: Scale = None,
    u: Input = "u",
    y: Output = "y",
    t: Time = "t",
    ts: Ts = None,
    channels: Channels = "",
    role: Roles = "",
    machine: Machine = "",
    rows: Rows = None,
    missing: Missing = "refuse",
    resume: Resume = None,
) -> None:
    """Compare a model with measurements and name the physical effect that is missing.

    Without a model file the base is identified first. An effect is only added where the error falls on the data and on
    validation data: those of --validate, else the last part of each record, which no model is fitted to. Errors are of
    the free run over the whole record from start states estimated on it, as `narx-sym compare` gives them.
    The same data and seed give the same JSON; only its last field, `seconds`, differs.
    """
    from ..diagnosis.experiment import check_limits
    from ..diagnosis.machine import check_machine
    from ..diagnosis.procedure import diagnose as run
    from ..files.journal import resuming
    from ..fit.continuous import check_scale
    from ..models.differential import from_equations
    from ..tasks.base import equations_in, fit_equations

    check_limits(limits)
    check_scale(scale)
    check_machine(machine)
    typed = again(context, RESULTS)
    targets = Targets(json_file, save, plot, experiment, report, -1 if quiet else int(verbose), typed, scale)
    own = equations_in(base)
    file = Path(base) if base.lower().endswith(".json") or (Path(base).is_file() and not own) else None
    check_targets([*targets.paths, resume], *data, *(validate or []), *(effects or []), file)
    check_format(plot)
    catalogue = with_own(effects or [])
    model = _read(file, delay) if file else None
    asked = from_equations(own, 1.0) if own else model
    named = with_columns(channels, asked.channels if asked else ())
    measured = records(data, u, y, t, ts, named, rows, missing, units, model, roles=role)
    judging = validating(validate, measured, u, y, t, ts, named, missing, units, role)
    with resuming(resume) if resume else nullcontext() as journal:
        if own:
            with working(f"Fitting the equations of {base} to {sum(len(r) for r in measured)} samples"):
                model = fit_equations(own, measured)
        start = _begin(model or base, measured, delay)
        with working("Diagnosing") as progress:
            found = run(
                start, measured, max_effects=max_effects, catalogue=catalogue, seed=seed, limits=limits, delay=delay,
                open_loop=open_loop, validation=judging, machine=machine, report=progress,
            )  # fmt: skip
    say_resumed(journal, resume)
    _say_done(found, measured)
    settings = {
        "base": base, "validation": ", ".join(map(str, validate or [])) or "last part",
        "delay": "found" if delay is None else delay, "max_effects": max_effects,
        "channels": channels or "none", "role": role or "found", "machine": found.machine.name or "not known",
        "rows": rows or "all", "open_loop": open_loop, **({"scale": scale} if scale else {}),
    }  # fmt: skip
    targets.write(found, measured, found.units, data, settings)


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
            f"{file}: the model has its own delay ({model.delay}); --delay is for a base that is identified."
        )
    return model


def _begin(base: Model | str, measured: list[Record], delay: int | None) -> Model:
    """Return the model to begin with: the one given, or one that is identified."""
    from ..tasks.base import check_kind, identify_base

    if isinstance(base, str):
        with working(f"Identifying a base ({check_kind(base)}) from {sum(len(r) for r in measured)} samples"):
            return identify_base(base, measured, delay)
    return base


@dataclass(frozen=True)
class Targets:
    """The files that a diagnosis may write, how much it prints, and the other options of the command."""

    json_file: Path | None
    save: Path | None
    plot: Path | None
    experiment: Path | None
    report: Path | None
    loud: int = 0  # -1: one line; 1: tables too
    typed: Mapping[str, list[str]] = field(default_factory=dict)
    scale: str | None = None

    @property
    def where(self) -> Path | None:
        """Where the picture of where it fails goes."""
        return where_beside(self.plot)

    @property
    def next_input(self) -> Path | None:
        """Where the next input goes, if there is one."""
        return self.experiment or (self.json_file.parent / "next.csv" if self.json_file else None)

    @property
    def paths(self) -> list[Path | None]:
        """All that may be written."""
        from ..diagnosis.experiment import wider_file

        wider = self.next_input and wider_file(self.next_input)
        return [self.json_file, self.save, self.plot, self.where, self.next_input, wider, self.report]

    def write(
        self,
        found: Diagnosis,
        measured: list[Record],
        units: dict[str, str],
        data: list[Path],
        settings: dict[str, Any],
    ) -> None:
        """Write all files, and then print what was found: a closed pipe loses none.

        Results are written first, and printed whatever comes of the pictures and the report.
        """
        from ..report.words import with_units
        from ..tasks.physical import physical

        found = with_units(found, units)
        wanted = self.loud >= 0 or self.json_file is not None
        quantities = physical(found, units, self.scale) if wanted else ""
        self._write_next(found, units, quantities)
        if self.save is not None:
            from ..files.store import save

            save(found.model, self.save)
            if len(found.rungs) == 1:
                note("nothing was added: the model written is the base")
        try:
            self._draw(found, units, data, settings)
        finally:
            self._print(found, units, _command(found, data, str(settings["base"]), self), quantities)

    def _draw(self, found: Diagnosis, units: dict[str, str], data: list[Path], settings: dict[str, Any]) -> None:
        """Write the pictures and the report."""
        if self.plot is not None and self.where is not None:
            from ..report.plots import plot_diagnosis, where_it_fails

            save_figure(plot_diagnosis(found, units=units), self.plot)
            save_figure(where_it_fails(found.misfit, units=units), self.where)
        if self.report is not None:
            with working("Writing the report"):
                found.report(self.report, units, data, settings)

    def _print(self, found: Diagnosis, units: dict[str, str], command: str, quantities: Any) -> None:
        """Print what was found, and what was written."""
        if self.loud < 0:
            print_headline(found)
            return
        print_found(found, units, command, quantities)
        if self.loud > 0:
            print_tables(found, units)
        else:
            console().print("Candidates, errors and limits as tables: --verbose")
        if found.steps[0].experiment is not None:
            named = f"The input of the next experiment: {self.next_input}"
            console().print(
                named if self.next_input else "To write the input of the next experiment: --experiment next.csv"
            )
        if self.save is not None:
            print_equations(found.model)
        for path, what in (
            (self.save, "Model written to"), (self.plot and f"{self.plot}, {self.where}", "Pictures:"),
            (self.report, "Report:"), (self.json_file, "JSON written to"),
        ):  # fmt: skip
            if path is not None:
                console().print(f"{what} {path}")

    def _write_next(self, found: Diagnosis, units: dict[str, str], quantities: Any) -> None:
        """Write the input of the next experiment, and everything as JSON."""
        from ..tasks.result_file import write_json

        step, path, written = found.steps[0], self.next_input, None
        if step.experiment is not None:
            if path is not None:
                step.experiment.save(path)
                beside = self.json_file is None or path.resolve().parent == self.json_file.resolve().parent
                written = path.name if beside else str(path)
            step.experiment = replace(step.experiment, units=units, file=written or "")
        if self.json_file is not None:
            write_json(found, self.json_file, written, quantities)


def _command(found: Diagnosis, data: list[Path], base: str, targets: Targets) -> str:
    """Return the command to go on with, if there is one: with every option that says what is read, and how."""
    files, options = [*map(str, data)], {"--base": ["--base", base], **targets.typed}
    if {f.effect for f in found.faults} & {"frozen_sensor", "spikes"}:
        options["--missing"] = ["--missing", "drop"]
    elif found.verdict == "confused":
        files.append("NEW_RECORD.csv")
    elif found.verdict == "helps_but_incomplete" and not found.exhausted:
        options["--max-effects"] = ["--max-effects", str(1 + sum(len(s.added) for s in found.steps))]
    elif found.rungs[1:] and targets.save is None:
        options["--save"] = ["--save", "model.json"]
    elif targets.report is None:
        options["--report"] = ["--report", "report.html"]
    else:
        return ""
    return shlex.join(["narx-sym", "diagnose", *files, *(word for words in options.values() for word in words)])
