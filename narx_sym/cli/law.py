"""The commands that run: the compensation law over a reference, a model over an input."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import DataError
from . import options as opt
from .printing import console, table, working
from .several import refuse

if TYPE_CHECKING:
    from ..inversion.compensator import Compensator
    from ..models.model import Model
    from ..models.system import System


def compensate(
    model_file: opt.ModelFile,
    latex: Annotated[Path | None, typer.Option("--latex", help="Write the law as LaTeX.")] = None,
    c: Annotated[Path | None, typer.Option("--c", help="Write the law as C99 source.")] = None,
    st: Annotated[Path | None, typer.Option("--st", help="Write the law as Structured Text (IEC 61131-3).")] = None,
    fmu: Annotated[
        Path | None, typer.Option("--fmu", help="Write the law as an FMU for co-simulation (FMI 3.0).")
    ] = None,
    fmu2: Annotated[Path | None, typer.Option("--fmu2", help="The same for FMI 2.0.")] = None,
    export: Annotated[
        list[Path] | None,
        typer.Option(
            "--export", help="Write the law as source code; the file extension selects the language. May be repeated."
        ),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option("--reference", help="CSV with the reference (the desired output).")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="CSV file to write the compensated input to.")] = None,
    column: opt.Column = None,
    m0: Annotated[float | None, typer.Option("--m0", help="Input before the first sample.")] = None,
    limits: opt.Limits = None,
    rate: opt.Rate = None,
    share: opt.Share = "auto",
    no_limits: Annotated[
        bool,
        typer.Option("--no-limits", help="Export the law without input limits (default: the input range of the fit)."),
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Continue even if the law is unstable or the model is too poor.")
    ] = False,
    clip: Annotated[
        bool,
        typer.Option(
            "--clip", help="If the reference cannot be reached, come as close as possible instead of stopping."
        ),
    ] = False,
    units: opt.Units = "",
    t: opt.Time = "t",
    ts: opt.Ts = None,
    rows: opt.Rows = None,
) -> None:
    """Derive the compensation law, print it, export it as LaTeX or source code, and run it along a reference."""
    from ..codegen.registry import exports, target_of
    from ..codegen.units import coefficients_latex
    from ..data.units import said_first
    from ..files.atomic import check_columns, write_bytes, write_text
    from ..files.store import load_model
    from ..inversion.compensator import allowed
    from ..symbolic.printing import boxed

    allowed(limits, rate)
    if limits and no_limits:
        raise DataError("--limits and --no-limits exclude each other.")
    own = [(name, path) for name, path in (("c", c), ("st", st), ("fmu", fmu), ("fmu2", fmu2)) if path]
    sources = [*((target_of(path), path) for path in export or []), *own]
    opt.check_targets([latex, *(path for _, path in sources), out], model_file, reference)
    check_columns(out)
    _check_run(reference, out, {"column": column, "m0": m0, "clip": clip or None, "ts": ts, "rows": rows})
    model = load_model(model_file)
    names = said_first(model.info.units, opt.unit_names(units))
    goal, how = None, {"Ts": ts, "t": t, "rows": rows}
    if reference:
        r, stamps = _signal(
            model, reference, column, "reference", prefer="r", option="--column", unit=names.get("y", ""), **how
        )
        goal = r, stamps, _channels(model, reference, "--reference", **how)
    law = model.compensator(force)
    part = None if share == "none" else law.share(share)
    # Not every law has a source: that is known before anything is written.
    held: Any = limits or (None if no_limits else "known")
    made = [law.export(name, limits=held, rate=rate, units=names, share=part, force=force) for name, _ in sources]
    _tell(law, "auto" if share == "auto" else part, names)
    if latex:
        listed = coefficients_latex(law.coefficients(names, latex=True))
        shown = [boxed(law.latex_stability()), law.latex(numbers=True), *[listed] * bool(listed)]
        write_text(latex, "".join(f"\\[\n{one}\n\\]\n" for one in shown))
        console().print(f"LaTeX written to {latex}")
    for (name, path), source in zip(sources, made, strict=True):
        write_bytes(path, source if isinstance(source, bytes) else source.encode("utf-8"))
        console().print(f"{exports()[name].title} written to {path}")
    if goal and out:
        _follow(law, goal, out, model_file, m0, limits=limits, rate=rate, share=part, clip=clip)


def _check_run(reference: Path | None, out: Path | None, options: dict[str, Any]) -> None:
    """Refuse half a run of a law, and options of a run where there is none."""
    if (reference is None) != (out is None):
        raise DataError(
            "Give --reference and --out together: the reference is read from one, the compensated input "
            "is written to the other."
        )
    unused = [name for name, value in options.items() if value is not None]
    if reference is None and unused:
        raise DataError(f"--{unused[0]} needs a run of the law: give --reference and --out too.")


def _tell(law: Compensator, share: Any, known: dict[str, str]) -> None:
    """Print a law, and what to know before it runs."""
    from ..codegen.units import by_unit
    from ..tasks.compensate import ahead, caution

    units = {name: known[own] for name, own in (("m", "u"), ("r", "y")) if own in known}
    console().print(str(law.stability()), markup=False)
    console().print("[bold]Compensation law[/bold] (in your units)")
    for line in law.lines(numbers=True):
        console().print(f"  {line}", markup=False)
    if units:
        console().print(f"  with {', '.join(f'{name} in {label}' for name, label in units.items())}", markup=False)
    if listed := by_unit(law.coefficients(known)):
        table("Units of its coefficients", ["coefficients", "unit"], [list(row) for row in listed])
    console().print(ahead(law))
    if law.staged:
        with working("Counting the solutions of each stage"):
            console().print(f"Checked: {law.checked}.", markup=False)
    if said := caution(law, share):
        console().print(said, markup=False)


def _follow(
    law: Compensator, goal: tuple[Any, Any, Any], out: Path, model_file: Path, m0: float | None, **options: Any
) -> None:
    """Run a law over a reference: samples, time stamps and channels; say what came of it."""
    from ..files.atomic import write_csv
    from ..tasks.compensate import follow

    r, stamps, beside = goal
    run = follow(law, r, m0, beside, **options)
    m = run.m
    write_csv(out, {"t": stamps, "r": r, "m": m, **beside})
    say = console().print
    say(f"Compensated input: {len(m)} samples, m in [{m.min():.4g}, {m.max():.4g}]")
    how = "starts from rest" if run.rests else "does not start from rest; it starts"
    first = run.start if abs(run.start) > 1e-12 * abs(m).max() else 0.0
    say(f"It {how} at m = {first:.6g} with the output at {r[0]:.6g}. To see what the model expects:")
    files = shlex.join([str(model_file), str(out)])
    say(
        f"  narx-sym simulate {files} --input m --u0 {first:.10g} --y0 {r[0] + 0.0:.10g} --out expected.csv",
        markup=False,
    )
    if run.effort is not None:
        say(f"NSAVI (movement of the input relative to the reference): {run.effort:.4g}")
    say(f"Written to {out}")


def _signal(model: Model | System, file: Path, column: str | None, what: str, **how: Any) -> tuple[Any, Any]:
    """Read samples and time stamps [s] of a signal; where it has no time, it is at the rate of the model."""
    from ..data.record import read_signal
    from ..tasks.base import check_pace

    values, step, stamps = read_signal(file, column, offers=("--rows", "--ts"), **how)
    check_pace(model, step, f"{file}: the {what} has")
    return values, stamps if step or not model.Ts else stamps * model.Ts


def _channels(model: Model, file: Path, option: str, **how: Any) -> dict[str, Any]:
    """Read the channels that a model needs, (N,) arrays by name, from the columns of these names."""
    found = {}
    for name in model.channels:
        try:
            unit = model.info.units.get(name, "")
            found[name], _ = _signal(model, file, name, "channel", option=option, unit=unit, **how)
        except DataError as error:
            raise DataError(f"The model needs the channel {name!r}: {error}") from None
    return found


def simulate(
    model_file: opt.ModelFile,
    input_file: Annotated[Path, typer.Argument(metavar="INPUT.csv", help="CSV with the input.")],
    out: Annotated[Path, typer.Option("--out", help="CSV for the simulated output.")],
    u: Annotated[
        str | None,
        typer.Option(
            "--input", help="Column of the input (default: u, or the only one); of several, separated by commas."
        ),
    ] = None,
    y0: Annotated[
        str | None, typer.Option("--y0", help="Output at the start; of several, separated by commas.")
    ] = None,
    u0: Annotated[float | None, typer.Option("--u0", help="Input before the start, at rest with the output.")] = None,
    t: opt.Time = "t",
    ts: opt.Ts = None,
    rows: opt.Rows = None,
) -> None:
    """Simulate a model: its free run for an input from a file."""
    from ..files.atomic import check_columns, write_csv
    from ..files.store import load
    from ..models.system import System

    opt.check_targets([out], model_file, input_file)
    check_columns(out)
    model = load(model_file)
    how = {"Ts": ts, "t": t, "rows": rows}
    begin = _numbers(y0, "--y0")
    if isinstance(model, System):
        refuse(f"{model_file}, which has several outputs,", {"--u0": u0})
        _simulate_system(model, input_file, u, begin, out, how)
        return
    if len(begin or ()) > 1:
        raise DataError(f"--y0 {y0}: the model has one output.")
    own = model.input.name
    values, stamps = _signal(model, input_file, u, "input", prefer=own, unit=model.info.units.get(own, ""), **how)
    beside = _channels(model, input_file, "INPUT.csv", **how)
    name = model.output.name
    simulated = model.simulate(values, begin and begin[0], beside, u0=u0)
    write_csv(out, {"t": stamps, own: values, name: simulated, **beside})
    low, high = float(simulated.min()), float(simulated.max())
    console().print(f"{len(values)} samples, {name} in [{low:.4g}, {high:.4g}], written to {out}")


def _numbers(text: str | None, option: str) -> list[float] | None:
    """Return numbers that are separated by commas."""
    try:
        return None if text is None else [float(part) for part in text.split(",")]
    except ValueError:
        raise DataError(f"{option} {text}: give a number, or one of each output, separated by commas.") from None


def _simulate_system(
    system: System, file: Path, columns: str | None, y0: list[float] | None, out: Path, how: dict[str, Any]
) -> None:
    """Simulate all outputs for inputs from a file."""
    from ..files.atomic import write_csv

    named = columns.split(",") if columns else list(system.inputs)
    begin = y0 or [0.0] * len(system.outputs)
    for option, found, wanted in (("--input", named, system.inputs), ("--y0", begin, system.outputs)):
        if len(found) != len(wanted):
            raise DataError(f"{option}: give one for each of {', '.join(wanted)}, separated by commas.")
    read = [
        _signal(system, file, column, "input", unit=system.units.get(name, ""), **how)
        for name, column in zip(system.inputs, named, strict=True)
    ]
    inputs = {name: x for name, (x, _) in zip(system.inputs, read, strict=True)}
    runs = system.simulate(inputs, dict(zip(system.outputs, begin, strict=True)))
    write_csv(out, {"t": read[0][1], **inputs, **runs})
    ranges = "; ".join(f"{name} in [{x.min():.4g}, {x.max():.4g}]" for name, x in runs.items())
    console().print(f"{read[0][0].size} samples, {ranges}, written to {out}")
