"""The `narx-sym` command. Every command is a few calls of the package; the mathematics lives there."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ..app import command as live
from ..errors import DataError, NarxError
from ..files.telling import Stderr
from . import commission, diagnose, effects, fleet, law, stop
from . import options as opt
from .printing import console, note, print_errors, print_fails, print_model, say_written, table, working
from .several import compare_system, derive_system, fit_system, refuse

app = typer.Typer(
    help="Hysteretic actuators as symbolic NARX models: identify, derive, compensate, compare, diagnose.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


# -- commands --------------------------------------------------------------------------------------------------


@app.command()
@opt.reads()
def fit(
    data: opt.DataFiles,
    out: Annotated[
        Path | None, typer.Option("--out", help="Where to write the model (default: it is only printed).")
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            help="Kind of model: narx, linear, static, play, bouc-wen, auto, or a file with equations (default: "
            "narx, or linear if there are several inputs or outputs)."
        ),
    ] = None,
    n_y: Annotated[int, typer.Option("--n-y", min=0, max=20, help="Largest lag of the output.")] = 1,
    n_u: Annotated[int, typer.Option("--n-u", min=0, max=200, help="Largest lag of the input.")] = 2,
    degree: Annotated[int, typer.Option(min=1, max=6, help="Largest degree of the polynomial terms.")] = 3,
    delay: Annotated[
        int | None, typer.Option(min=0, max=200, help="Delay of the input in samples (default: chosen from the data).")
    ] = None,
    for_compensation: Annotated[
        bool, typer.Option("--for-compensation", help="Use only terms for which a compensation law exists.")
    ] = False,
    validate: opt.Validate = None,
    creep: Annotated[
        bool, typer.Option("--creep", help="With --base play: also fit creep (a slow part of the motion).")
    ] = False,
    method: Annotated[str, typer.Option(help="auto, one_step, free_run or els.")] = "auto",
    steady_state: opt.SteadyState = None,
    weight: Annotated[
        float | None,
        typer.Option(
            "--weight", min=0, help="Weight of the --steady-state data relative to the dynamic data (default: 1)."
        ),
    ] = None,
    *,
    how: opt.Reading,
) -> None:
    """Identify a model: choose its terms and fit its parameters (with --base narx under Sigma_y = 1)."""
    from ..files.store import save
    from ..fit.identify import BASES, check_method, identify, with_steady_state
    from ..models.differential import from_equations
    from ..tasks.base import equations_in, fit_equations
    from ..tasks.compare import errors_of, validated

    opt.check_targets([out], *data, *(validate or []), steady_state)
    check_method(method)
    base = base or ("linear" if "," in how.u + how.y else "narx")
    method = opt.check_rest(steady_state, weight, method, base)
    own = equations_in(base)
    if base not in BASES and not own:
        raise DataError(f"Unknown base {base!r}: --base is one of {', '.join(BASES)}, or a file with equations.")
    if how.u == how.y:
        raise DataError(f"Input and output are the same column {how.u!r}; choose with --input and --output.")
    if how.several:
        refuse("--output with several columns", {"--steady-state": steady_state, "--base FILE": own, "--creep": creep})
    named = from_equations(own, 1.0).channels if own else ()
    measured = how.records(data, more=named)
    judging = how.validating(validate, measured, named)
    points = opt.rest_points(steady_state, how, measured[0].units) if steady_state else None
    if how.several:
        fit_system(
            measured, judging, out, base=base, n_y=n_y, n_u=n_u, degree=degree, delay=delay, method=method,
            for_compensation=for_compensation,
        )  # fmt: skip
        return
    with working(f"Identifying from {sum(len(r) for r in measured)} samples") as progress:
        model = fit_equations(own, measured) if own else identify(
            measured, base=base, n_y=n_y, n_u=n_u, degree=degree, delay=delay, for_compensation=for_compensation,
            method=method, creep=creep, report=progress,
        )  # fmt: skip
        if points is not None:
            model = with_steady_state(model, measured, points, 1.0 if weight is None else weight)
        pairs = [*errors_of(model, measured), *validated(model, judging)]
    if out:
        save(model, out)
    print_model(model)
    chosen = f"Terms: {model.info.selection.reason}" if model.info.selection.reason else f"Equations: {base}"
    console().print(f"{chosen}. Fit: {model.info.method}.")
    print_errors(pairs)
    say_written(("Model written to", out))


@app.command()
@opt.reads("channels", "role", "missing")
def derive(
    model_file: opt.ModelFile,
    latex: Annotated[Path | None, typer.Option("--latex", help="Write a LaTeX document.")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw the quasi-static sets.")] = None,
    continuous: Annotated[
        bool, typer.Option("--continuous", help="Derive the differential equation, in physical units, instead.")
    ] = False,
    scale: opt.Scale = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(
            "--data",
            help="With --continuous: a record used in the fit, to compute confidence intervals. May be repeated.",
        ),
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="With --continuous: write the quantities as JSON.")
    ] = None,
    *,
    how: opt.Reading,
) -> None:
    """Derive Sigma_y, the equilibria, the quasi-static sets and where they are attracting; check the assumptions.

    With --continuous: derive the differential equation, with mass, friction, time constants and dead time in physical
    units.
    """
    from ..files.atomic import write_text
    from ..files.store import load
    from ..inversion.analyses import document, summary
    from ..models.system import System

    opt.check_targets([latex, plot, json], model_file, *(data or []))
    if not continuous and (scale or data or json):
        raise DataError("--scale, --data and --json need derive --continuous.")
    box = how.black_box(model_file)
    model = box.model() if box else load(model_file)
    if isinstance(model, System):
        refuse(f"{model_file}, which has several outputs,", {"--continuous": continuous, "--plot": plot})
        derive_system(model, latex)
        return
    if continuous:
        if plot:
            raise DataError("--plot draws quasi-static sets: leave out --continuous.")
        listed = how.records(data, model, model.channels) if data else None
        _differential(model, model.continuous(scale, listed, opt.unit_names(how.units)), latex, json)
        return
    for heading, lines in summary(model):
        console().print(f"[bold]{heading}[/bold]")
        for line in lines:
            console().print("  " + line, markup=False)
    if latex:
        write_text(latex, document(model))
    if plot:
        from ..report.plots import plot_quasi_static

        try:
            figure = plot_quasi_static(model, units=opt.unit_names(how.units))
        except NarxError as error:  # what can be derived is told above
            note(f"no picture: {error}")
            plot = None
        else:
            opt.save_figure(figure, plot)
    say_written(("LaTeX written to", latex), ("Picture written to", plot))


def _differential(model: Any, found: Any, latex: Path | None, json: Path | None) -> None:
    """Print and write a differential equation in physical units."""
    from ..files.atomic import write_text
    from ..symbolic.printing import document_of, shown
    from ..tasks.result_file import write_plain

    console().print("[bold]Differential equation[/bold]")
    console().print(f"  {shown(found.equation.lhs)} = {shown(found.equation.rhs)}", markup=False)
    console().print("[bold]In physical units[/bold]")
    for symbol, line in found.rows:
        console().print(f"  {symbol}: {line}", markup=False)
    for said in found.notes:
        note(said)
    if latex:
        write_text(latex, document_of([("Model", [model.latex()]), ("Differential equation", [found.latex()])]))
    if json:
        write_plain(found.to_dict(), json)
    say_written(("LaTeX written to", latex), ("JSON written to", json))


@app.command()
@opt.reads()
def compare(
    model_file: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL.json", help="A model file written by narx-sym, or an FMU, whose native code runs."
        ),
    ],
    data: opt.DataFiles,
    plot: Annotated[Path | None, typer.Option("--plot", help="Picture of time response and loop.")] = Path(
        "compare.png"
    ),
    no_plot: Annotated[bool, typer.Option("--no-plot", help="No picture.")] = False,
    reference: Annotated[
        str | None, typer.Option("--reference", help="Column of the reference in a log of a compensated run.")
    ] = None,
    align: Annotated[
        bool,
        typer.Option("--align", help="Also estimate a constant offset of the sensor, in addition to the start states."),
    ] = False,
    validate: opt.Validate = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the errors as JSON.")] = None,
    *,
    how: opt.Reading,
) -> None:
    """Compare a model with measurements: one-step and free-run errors, time response, loop, and where the model fails.

    The free run covers the whole record at its sampling rate, from start states estimated on it.
    With --reference the data are the log of a compensated run (reference, input, output): prints MAPE and NSAVI.
    An FMU for co-simulation starts where it starts; running it runs its native code: name only one that you trust.
    """
    from ..data.units import said_first
    from ..files.store import load
    from ..models.system import System
    from ..tasks import compare as task

    target = None if no_plot else plot
    where = target and opt.where_beside(target)
    opt.check_targets([target, where, json], model_file, *data, *(validate or []))
    box = how.black_box(model_file)
    model = box.model() if box else load(model_file)
    if isinstance(model, System):
        refuse(f"{model_file}, which has several outputs,", {"--reference": reference, "--align": align})
        compare_system(model, how, data, validate, json)
        return
    named = [*filter(None, [reference]), *(() if box else model.channels)]
    measured = how.records(data, model, named)
    judging = how.validating(validate, measured, named)
    with working("Simulating"):
        if box:
            measured, judging = ([box.beside(r) for r in records] for records in (measured, judging))
        found = task.compare(model, measured, align)
        found.errors.extend(task.validated(model, judging, align))
    names = said_first(model.info.units, measured[0].units)
    for said in found.notes:
        note(said)
    print_errors(found.errors)
    if json:
        task.write_errors(found, json)
    if found.misfit is not None:
        print_fails(found.misfit, names)
    if reference:
        tracked = [task.tracking(r, reference) for r in measured]
        rows_of = [[one.name, one.mape, one.nsavi] for one in tracked]
        table("Tracking of the reference", ["record", "MAPE [% of range]", "NSAVI"], rows_of)
    if target:
        _pictures(model, measured, target, found.misfit, where, names)


def _pictures(model: Any, measured: list[Any], target: Path, misfit: Any, where: Path | None, units: Any) -> None:
    """Draw each record beside its free run, and where the model fails."""
    from ..report.plots import plot_comparison, where_it_fails

    for i, record in enumerate(measured):
        path = target if i == 0 else target.with_stem(f"{target.stem}_{i + 1}")
        name = f"{record.name}{' (longest segment)' if record.breaks else ''}"
        longest = replace(max(record.segments(), key=len), name=name)  # its error is not that of the record
        opt.save_figure(plot_comparison(model, longest, units=units), path)
        console().print(f"Picture of {name}: {path}")
    if misfit is not None and where is not None:
        opt.save_figure(where_it_fails(misfit, units=units), where)
        console().print(f"Picture of where the model fails: {where}")


for command in (
    diagnose.diagnose,
    fleet.fleet,
    effects.add,
    effects.effects,
    law.compensate,
    commission.commission,
    law.simulate,
):
    app.command()(command)


@app.command()
def demo(out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("narx_sym_demo")) -> None:
    """Show everything on simulated machines: identify, derive, compensate, compare, find a hidden effect, add it."""
    from .demo import run

    if not out.parent.is_dir() or out.is_file():
        raise DataError(f"{out}: cannot be a folder here; choose another with --out.")
    run(out)


app.command("app")(live.app)


@app.callback(invoke_without_command=True)
def root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Hysteretic actuators as symbolic NARX models: identify, derive, compensate, compare, diagnose."""
    if version:
        from importlib.metadata import version as installed

        print(installed("narx-sym"))
        raise typer.Exit


def _noted(message: str, kind: type[Warning]) -> None:
    """Print what the package warns of; how NumPy came to a value that is checked elsewhere is no news to a user."""
    if not issubclass(kind, RuntimeWarning):
        note(message)


def main() -> None:  # the entry point is `__main__.main`, which also catches Ctrl-C while this module is loaded
    """Run the command: exit 0 on success, 2 with one message on bad usage or input, never a traceback."""
    warnings.showwarning = lambda message, kind, *_, **__: _noted(str(message), kind)
    try:
        try:
            app()
        except SystemExit:
            sys.stdout.flush()  # a full disk behind the pipe is seen here
            raise
    except Exception as error:
        if stop.pressed:  # Ctrl-C may arrive as another error
            raise
        code, said = _ends(error)
        if said:
            print(f"narx-sym: {said}", file=Stderr())
        if isinstance(error, OSError):
            _close_output()
        sys.exit(code)


def _ends(error: Exception) -> tuple[int, str]:
    """Return the exit code of an error and what is said about it."""
    if isinstance(error, NarxError):
        return 2, str(error)
    if isinstance(error, BrokenPipeError):
        return 1, ""
    if isinstance(error, MemoryError):
        return 2, "not enough memory; use fewer rows (--rows A:B), lags or terms"
    if isinstance(error, OSError):
        place = error.filename or "standard output"
        return 2, f"{place}: {error.strerror or error}; check space and permissions there"
    if os.environ.get("NARX_SYM_DEBUG"):
        raise error
    return 1, (
        f"internal error, {type(error).__name__}: {error}. Please report it (NARX_SYM_DEBUG=1 shows the details)."
    )


def _close_output() -> None:
    """Drop what cannot be written: Python would try once more at its end, and fail with a traceback."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
