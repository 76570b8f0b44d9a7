"""The `narx-sym` command. Every command is a few calls of the package; the mathematics lives there."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from ..app import command as live
from ..errors import INTERRUPTED, DataError, NarxError
from . import diagnose as cli_diagnose
from .options import (
    Channels,
    DataFiles,
    Input,
    Missing,
    ModelFile,
    Output,
    Rows,
    Time,
    Ts,
    Units,
    check_targets,
    console,
    note,
    print_errors,
    print_fails,
    print_model,
    records,
    save_figure,
    table,
    unit_names,
    working,
)

app = typer.Typer(
    help="Hysteretic actuators as symbolic NARX models: identify, derive, compensate, compare, diagnose.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


# -- commands --------------------------------------------------------------------------------------------------


@app.command()
def fit(
    data: DataFiles,
    out: Annotated[Path, typer.Option("--out", help="Where to write the model.")],
    base: Annotated[str, typer.Option(help="narx, linear or static.")] = "narx",
    n_y: Annotated[int, typer.Option("--n-y", min=0, max=20, help="Largest lag of the output.")] = 1,
    n_u: Annotated[int, typer.Option("--n-u", min=0, max=200, help="Largest lag of the input.")] = 2,
    degree: Annotated[int, typer.Option(min=1, max=6, help="Degree of the products.")] = 3,
    delay: Annotated[int | None, typer.Option(min=0, max=200, help="Pure delay in samples.")] = None,
    for_compensation: Annotated[bool, typer.Option("--for-compensation", help="Keep the model invertible.")] = False,
    method: Annotated[str, typer.Option(help="auto, one_step or free_run.")] = "auto",
    u: Input = "u",
    y: Output = "y",
    t: Time = "t",
    ts: Ts = None,
    channels: Channels = "",
    rows: Rows = None,
    missing: Missing = "refuse",
) -> None:
    """Select the structure and fit the parameters under Sigma_y = 1."""
    from ..files.store import save
    from ..fit.identify import identify
    from ..fit.simulate import evaluate

    check_targets([out], *data)
    if u == y:
        raise DataError(f"Input and output are the same column {u!r}; choose with --input and --output.")
    measured = records(data, u, y, t, ts, channels, rows, missing)
    with working(f"Identifying from {sum(len(r) for r in measured)} samples"):
        model = identify(
            measured, base=base, n_y=n_y, n_u=n_u, degree=degree, delay=delay, for_compensation=for_compensation,
            method=method,
        )  # fmt: skip
        pairs = [(r.name, evaluate(model, r)) for r in measured]
    save(model, out)
    print_model(model)
    console().print(f"Terms: {model.info['selection']['reason']}. Fit: {model.info['method']}.")
    print_errors(pairs)
    console().print(f"Model written to {out}")


@app.command()
def derive(
    model_file: ModelFile,
    latex: Annotated[Path | None, typer.Option("--latex", help="Write a LaTeX document.")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw the quasi-static sets.")] = None,
    units: Units = "",
) -> None:
    """Derive Sigma_y, the equilibria, the quasi-static sets, where they attract, and check the assumptions."""
    from ..files.atomic import write_text
    from ..files.store import load
    from ..inversion.summary import document, summary

    check_targets([latex, plot], model_file)
    model = load(model_file)
    for heading, lines in summary(model):
        console().print(f"[bold]{heading}[/bold]")
        for line in lines:
            console().print("  " + line, markup=False)
    if latex:
        write_text(latex, document(model))
        console().print(f"LaTeX written to {latex}")
    if plot:
        from ..report.plots import plot_quasi_static

        save_figure(plot_quasi_static(model, units=unit_names(units)), plot)
        console().print(f"Picture written to {plot}")


@app.command()
def compare(
    model_file: ModelFile,
    data: DataFiles,
    plot: Annotated[Path | None, typer.Option("--plot", help="Picture of time response and loop.")] = Path(
        "compare.png"
    ),
    no_plot: Annotated[bool, typer.Option("--no-plot", help="No picture.")] = False,
    reference: Annotated[
        str | None, typer.Option("--reference", help="Column of the reference in a log of a compensated run.")
    ] = None,
    units: Units = "",
    u: Input = "u",
    y: Output = "y",
    t: Time = "t",
    ts: Ts = None,
    channels: Channels = "",
    rows: Rows = None,
    missing: Missing = "refuse",
) -> None:
    """Compare a model with measurements: one-step and free-run errors, time response and loop, where it fails.

    With --reference the data are a log of reference, compensated input and measured output: tracking MAPE and NSAVI.
    """
    from ..data.metrics import mape, nsavi
    from ..files.store import load
    from ..fit.simulate import arrays, evaluate, extrapolates

    target = None if no_plot else plot
    where = cli_diagnose.beside(target)
    check_targets([target, where], model_file, *data)
    model = load(model_file)
    named = ",".join(filter(None, [channels, reference, *model.channels])) if channels != "all" else "all"
    measured = records(data, u, y, t, ts, named, rows, missing)
    with working("Simulating"):
        pairs = [(r.name, evaluate(model, r)) for r in measured]
    for record in measured:
        for said in extrapolates(model, [arrays(model, s)[str(model.input.label)] for s in record.segments()]):
            note(f"{record.name}: {said}")
    print_errors(pairs)
    names = unit_names(units)
    failed = cli_diagnose.fails(model, measured)
    if failed is not None:
        print_fails(failed, names)
    if reference:
        tracked = [[r.name, mape(r.channels[reference], r.y), nsavi(r.u, r.channels[reference])] for r in measured]
        table("Tracking of the reference", ["record", "MAPE [% of range]", "NSAVI"], tracked)
    if target:
        from ..report.plots import plot_comparison, where_it_fails

        for i, record in enumerate(measured):
            path = target if i == 0 else target.with_stem(f"{target.stem}_{i + 1}")
            longest = max(record.segments(), key=len)
            save_figure(plot_comparison(model, longest, units=names), path)
            console().print(f"Picture of {record.name}{' (longest segment)' if record.breaks else ''}: {path}")
        if failed is not None and where is not None:
            save_figure(where_it_fails(failed, units=names), where)
            console().print(f"Picture of where it fails: {where}")


app.command()(cli_diagnose.diagnose)
app.command()(cli_diagnose.add)
app.command()(cli_diagnose.effects)


@app.command()
def compensate(
    model_file: ModelFile,
    latex: Annotated[Path | None, typer.Option("--latex", help="Write the law as LaTeX.")] = None,
    c: Annotated[Path | None, typer.Option("--c", help="Write the law as C99 source.")] = None,
    st: Annotated[Path | None, typer.Option("--st", help="Write the law as Structured Text (IEC 61131-3).")] = None,
    reference: Annotated[Path | None, typer.Option("--reference", help="CSV with the wanted output.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="CSV for the compensated input.")] = None,
    column: Annotated[
        str | None, typer.Option("--column", help="Column of the reference (default: the only one).")
    ] = None,
    m0: Annotated[float | None, typer.Option("--m0", help="Input before the start.")] = None,
    limits: Annotated[
        tuple[float, float] | None, typer.Option("--limits", metavar="LO HI", help="Range of the actuator's input.")
    ] = None,
    rate: Annotated[float | None, typer.Option("--rate", help="Largest change of the input per sample.")] = None,
    clip: Annotated[
        bool, typer.Option("--clip", help="Come as near as possible where the reference cannot be reached.")
    ] = False,
    t: Time = "t",
    ts: Ts = None,
    rows: Rows = None,
) -> None:
    """Derive the compensation law, print it, export it as LaTeX or source, and run it over a reference."""
    from ..data.metrics import nsavi
    from ..data.record import read_signal
    from ..files.atomic import write_csv, write_text
    from ..files.store import load
    from ..fit.excursions import operating_range

    check_targets([latex, c, st, out], model_file, reference)
    if (reference is None) != (out is None):
        raise DataError("--reference and --out belong together: the reference read, the compensated input written.")
    model = load(model_file)
    law = model.compensator()
    console().print("[bold]Compensation law[/bold] (in your units)")
    for line in law.lines(numbers=True):
        console().print(f"  {line}", markup=False)
    console().print(f"It looks {law.preview} sample(s) ahead in the reference.")
    if law.staged:
        with working("Counting the solutions of each stage"):
            console().print(f"Checked: {law.checked}.", markup=False)
    if (found := operating_range(law)) is not None and found.sentence:
        console().print(found.sentence)
    if latex:
        write_text(latex, f"\\[\n{law.latex(numbers=True)}\n\\]\n")
        console().print(f"LaTeX written to {latex}")
    if c:
        write_text(c, law.to_c(limits=limits, rate=rate))
        console().print(f"C99 source written to {c}")
    if st:
        write_text(st, law.to_st(limits=limits, rate=rate))
        console().print(f"Structured Text written to {st}")
    if reference and out:
        r, step, stamps = read_signal(reference, column, Ts=ts, t=t, rows=rows, option="--column", prefer="r")
        step_differs = step is not None and model.Ts and abs(step - model.Ts) > 1e-6 * model.Ts
        if step_differs:
            note(f"the reference has Ts = {step:g} s, the model was identified at {model.Ts:g} s")
        if model.channels:
            raise DataError(f"{model_file}: the law needs the channel {model.channels[0]!r}; use Python for this one.")
        start = law.rest_input(r[0]) if m0 is None else m0
        m = law.run(r, start, limits=limits, rate=rate, clip=clip)
        write_csv(out, {"t": stamps, "r": r, "m": m})
        console().print(f"Compensated input: {len(m)} samples, m in [{m.min():.4g}, {m.max():.4g}]")
        console().print(
            f"It starts from rest at m = {start:.6g} with the output at {r[0]:.6g}. To see what the model expects:"
        )
        console().print(
            f"  narx-sym simulate {model_file} {out} --input m --u0 {start:.10g} --y0 {r[0]:.10g} --out expected.csv"
        )
        if abs(r - r[0]).max() > 0:
            console().print(f"NSAVI (effort against the reference's): {nsavi(m, r):.4g}")
        console().print(f"Written to {out}")


@app.command()
def simulate(
    model_file: ModelFile,
    input_file: Annotated[Path, typer.Argument(metavar="INPUT.csv", help="CSV with the input.")],
    out: Annotated[Path, typer.Option("--out", help="CSV for the simulated output.")],
    u: Annotated[str | None, typer.Option("--input", help="Column of the input (default: u, or the only one).")] = None,
    y0: Annotated[float | None, typer.Option("--y0", help="Output at the start.")] = None,
    u0: Annotated[float | None, typer.Option("--u0", help="Input before the start, at rest with the output.")] = None,
    t: Time = "t",
    ts: Ts = None,
    rows: Rows = None,
) -> None:
    """Free run over an input."""
    from ..data.record import read_signal
    from ..files.atomic import write_csv
    from ..files.store import load

    check_targets([out], model_file, input_file)
    model = load(model_file)
    if model.channels:
        raise DataError(f"{model_file}: the model needs the channel {model.channels[0]!r}; use Python for this one.")
    values, step, stamps = read_signal(input_file, u, Ts=ts, t=t, rows=rows, prefer=str(model.input.label))
    if step is not None and model.Ts and abs(step - model.Ts) > 1e-6 * model.Ts:
        note(f"the input has Ts = {step:g} s, the model was identified at {model.Ts:g} s")
    name = str(model.output.label)
    simulated = model.simulate(values, y0, u0=u0)
    write_csv(out, {"t": stamps, str(model.input.label): values, name: simulated})
    low, high = float(simulated.min()), float(simulated.max())
    console().print(f"{len(values)} samples, {name} in [{low:.4g}, {high:.4g}], written to {out}")


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("narx_sym_demo"),
) -> None:
    """Run the main job on simulated machines: identify, derive, compensate, compare, find a hidden effect, add it."""
    from .demo import run

    if not out.parent.is_dir() or out.is_file():
        raise DataError(f"{out}: cannot be a folder here; choose another with --out.")
    run(out, working, table, console(), save_figure)


app.command("app")(live.app)


@app.callback(invoke_without_command=True)
def root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Hysteretic actuators as symbolic NARX models: identify, derive, compensate, compare, diagnose."""
    if version:
        from importlib.metadata import version as installed

        print(installed("narx-sym"))
        raise typer.Exit


def main() -> None:  # the entry point is `__main__.main`, which also catches Ctrl-C while this module is loaded
    """Run the command: exit 0 on success, 2 with one message on bad usage or input, never a traceback."""
    warnings.showwarning = lambda message, *_, **__: note(str(message))
    try:
        try:
            app()
        except SystemExit as stop:
            if stop.code == 130:  # typer has turned Ctrl-C into this
                print(INTERRUPTED, file=sys.stderr)
            sys.stdout.flush()  # a full disk behind the pipe is seen here
            raise
    except NarxError as error:
        print(f"narx-sym: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        _close_output()
        sys.exit(1)
    except MemoryError:
        print("narx-sym: not enough memory; use fewer rows (--rows A:B), lags or terms", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        place = error.filename or "standard output"
        print(f"narx-sym: {place}: {error.strerror or error}; check space and permissions there", file=sys.stderr)
        _close_output()
        sys.exit(2)
    except Exception as error:
        if os.environ.get("NARX_SYM_DEBUG"):
            raise
        print(
            f"narx-sym: internal error, {type(error).__name__}: {error}. Please report it "
            "(NARX_SYM_DEBUG=1 shows the details).",
            file=sys.stderr,
        )
        sys.exit(1)


def _close_output() -> None:
    """Drop what cannot be written: Python would try once more at its end, and fail with a traceback."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
