"""The `narx-sym` command. Every command is a few calls of the package; the mathematics lives there."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .errors import DataError, NarxError

# Heavy modules are imported inside the commands: `narx-sym --help` answers at once.
if TYPE_CHECKING:
    from .data import Record
    from .model import Model

app = typer.Typer(
    help="Hysteretic actuators as symbolic NARX models: identify, derive, compensate, compare.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

DataFiles = Annotated[
    list[Path], typer.Argument(metavar="DATA...", help="CSV (or .npz, .mat, .parquet) with a header.")
]
ModelFile = Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model file.")]
Input = Annotated[str, typer.Option("--input", help="Column of the input.")]
Output = Annotated[str, typer.Option("--output", help="Column of the output.")]
Time = Annotated[str, typer.Option("--time", help="Column of the time [s].")]
Ts = Annotated[float | None, typer.Option("--ts", help="Sampling time [s]; overrides the time column.")]
Channels = Annotated[str, typer.Option("--channels", help="Further columns: names with commas, or all.")]
Rows = Annotated[str | None, typer.Option("--rows", help="Data rows A:B, counted from 0.")]
Units = Annotated[str, typer.Option("--units", help="Units of input and output for the pictures, as V,um.")]


# -- helpers ---------------------------------------------------------------------------------------------------


def console(stderr: bool = False) -> Any:
    """Return a rich console; results go to stdout, progress and notes to stderr."""
    from rich.console import Console

    shown = Console(stderr=stderr, highlight=False, soft_wrap=True)
    # In a pipe or a log nothing is cut off.
    return shown if shown.is_terminal else Console(stderr=stderr, highlight=False, soft_wrap=True, width=140)


@contextmanager
def working(what: str) -> Any:
    """Show on stderr that something longer is going on."""
    shown = console(stderr=True)
    if shown.is_terminal:
        with shown.status(what):
            yield
    else:
        print(f"{what} ...", file=sys.stderr, flush=True)
        yield


def note(message: str) -> None:
    """Print a note on stderr."""
    print(f"note: {message}", file=sys.stderr)


def records(
    files: list[Path], u: str, y: str, t: str, Ts: float | None, channels: str, rows: str | None
) -> list[Record]:
    """Read the data files and say what was changed in them."""
    from .data import read

    listed = []
    for file in files:
        record = read(file, u=u, y=y, t=t, Ts=Ts, rows=rows, channels=channels)
        for text in record.notes:
            note(f"{file.name}: {text}")
        listed.append(record)
    return listed


def unit_names(units: str) -> dict[str, str]:
    """Turn "V,um" into units of u and y."""
    first, _, second = units.partition(",")
    return {"u": first.strip(), "y": second.strip()}


def save_figure(figure: Any, path: Path) -> None:
    """Write a picture; the format follows the suffix. It appears whole or not at all."""
    supported = set(figure.canvas.get_supported_filetypes())
    suffix = path.suffix.lstrip(".").lower()
    if suffix not in supported:
        raise DataError(f"{path}: pictures end in one of {', '.join(sorted('.' + s for s in supported))}.")
    if not path.parent.is_dir():
        raise DataError(f"{path}: the folder {path.parent} does not exist; make it first.")
    part = path.with_name(f".{path.stem}.{os.getpid()}.part.{suffix}")
    try:
        figure.savefig(part, dpi=130)
        os.replace(part, path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror or error}).") from None
    finally:
        part.unlink(missing_ok=True)


def check_target(path: Path | None, *read: Path | None) -> None:
    """Refuse an output path that cannot be written, or that is read, before any work is done."""
    if path is not None and any(p is not None and p.resolve() == path.resolve() for p in read):
        raise DataError(f"{path}: is read by this command; write to another file.")
    if path is not None and not path.parent.is_dir():
        raise DataError(f"{path}: the folder {path.parent} does not exist; make it first.")
    if path is not None and path.is_dir():
        raise DataError(f"{path}: is a folder; give a file name.")


def table(title: str, columns: list[str], rows: list[list[Any]]) -> None:
    """Print a table on stdout."""
    from rich.markup import escape  # "y[k-1]" is not a style
    from rich.table import Table

    shown = Table(title=title, title_justify="left")
    for i, name in enumerate(columns):
        shown.add_column(name, justify="left" if i == 0 else "right")
    for row in rows:
        shown.add_row(*(f"{v:.4g}" if isinstance(v, float) else escape(str(v)) for v in row))
    console().print(shown)


def print_model(model: Model) -> None:
    """Print terms, parameters and both errors."""
    rows = [
        [r["symbol"], r["term"], f"{r['theta']:.6g}", f"{r['std']:.2g}" if r["std"] else "fixed"] for r in model.table()
    ]
    table("Model", ["parameter", "term", "value", "standard error"], rows)
    if model.operating_point:
        around = ", ".join(f"{b.label} - ({v:g})" for b, v in model.operating_point.items())
        console().print(f"Terms are in the signals measured from the operating point: {around}.")


def print_errors(rows: list[tuple[str, Any]]) -> None:
    """Print the pairs of errors."""
    table(
        "Errors, always in pairs (NRMSE = rms error / std of the output; MAPE in % of its range)",
        ["record", "one-step NRMSE", "free-run NRMSE", "one-step MAPE", "free-run MAPE"],
        [[n, e.one_step_nrmse, e.free_run_nrmse, e.one_step_mape, e.free_run_mape] for n, e in rows],
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
) -> None:
    """Select the structure and fit the parameters under Sigma_y = 1."""
    from .identification import identify
    from .simulation import evaluate
    from .store import save

    check_target(out, *data)
    if u == y:
        raise DataError(f"Input and output are the same column {u!r}; choose with --input and --output.")
    measured = records(data, u, y, t, ts, channels, rows)
    with working(f"Identifying from {sum(len(r) for r in measured)} samples"):
        model = identify(
            measured, base=base, n_y=n_y, n_u=n_u, degree=degree, delay=delay, for_compensation=for_compensation,
            method=method,
        )  # fmt: skip
        pairs = [(r.name, evaluate(model, r)) for r in measured]
    save(model, out)
    print_model(model)
    console().print(f"Terms: {model.info['selection']['reason']}. Fit: {model.info['method']}.")
    if not model.info["converged"]:
        note("the fit stopped before it converged; the best parameters found are kept")
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
    from .derive import document, summary
    from .files import write_text
    from .store import load

    for path in (latex, plot):
        check_target(path, model_file)
    model = load(model_file)
    for heading, lines in summary(model):
        console().print(f"[bold]{heading}[/bold]")
        for line in lines:
            console().print("  " + line, markup=False)
    if latex:
        write_text(latex, document(model))
        console().print(f"LaTeX written to {latex}")
    if plot:
        from .plots import plot_quasi_static

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
) -> None:
    """Compare a model with measurements: one-step and free-run errors, time response and loop.

    With --reference the data are a log of reference, compensated input and measured output: tracking MAPE and NSAVI.
    """
    from .metrics import mape, nsavi
    from .simulation import evaluate
    from .store import load

    target = None if no_plot else plot
    check_target(target, model_file, *data)
    model = load(model_file)
    named = ",".join(filter(None, [channels, reference, *model.channels])) if channels != "all" else "all"
    measured = records(data, u, y, t, ts, named, rows)
    with working("Simulating"):
        pairs = [(r.name, evaluate(model, r)) for r in measured]
    print_errors(pairs)
    if reference:
        tracked = [[r.name, mape(r.channels[reference], r.y), nsavi(r.u, r.channels[reference])] for r in measured]
        table("Tracking of the reference", ["record", "MAPE [% of range]", "NSAVI"], tracked)
    if target:
        from .plots import plot_comparison

        for i, record in enumerate(measured):
            path = target if i == 0 else target.with_stem(f"{target.stem}_{i + 1}")
            longest = max(record.segments(), key=len)
            save_figure(plot_comparison(model, longest, units=unit_names(units)), path)
            console().print(f"Picture of {record.name}{' (longest segment)' if record.breaks else ''}: {path}")


@app.command()
def compensate(
    model_file: ModelFile,
    latex: Annotated[Path | None, typer.Option("--latex", help="Write the law as LaTeX.")] = None,
    c: Annotated[Path | None, typer.Option("--c", help="Write the law as C99 source.")] = None,
    reference: Annotated[Path | None, typer.Option("--reference", help="CSV with the wanted output.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="CSV for the compensated input.")] = None,
    column: Annotated[
        str | None, typer.Option("--column", help="Column of the reference (default: the only one).")
    ] = None,
    m0: Annotated[float | None, typer.Option("--m0", help="Input before the start.")] = None,
    t: Time = "t",
    ts: Ts = None,
    rows: Rows = None,
) -> None:
    """Derive the compensation law, print it, and run it over a reference."""
    from .data import read_signal
    from .files import write_csv, write_text
    from .metrics import nsavi
    from .printing import text
    from .store import load

    for path in (latex, c, out):
        check_target(path, model_file, reference)
    if (reference is None) != (out is None):
        raise DataError("--reference and --out belong together: the reference read, the compensated input written.")
    model = load(model_file)
    law = model.compensator()
    console().print("[bold]Compensation law[/bold] (in your units)")
    console().print(f"  m[k] = {text(law.expand().rhs)}", markup=False)
    console().print(f"It looks {law.preview} sample(s) ahead in the reference.")
    if latex:
        write_text(latex, f"\\[\n{law.latex(numbers=True)}\n\\]\n")
        console().print(f"LaTeX written to {latex}")
    if c:
        write_text(c, law.to_c())
        console().print(f"C99 source written to {c}")
    if reference and out:
        r, step, stamps = read_signal(reference, column, Ts=ts, t=t, rows=rows, option="--column", prefer="r")
        step_differs = step is not None and model.Ts and abs(step - model.Ts) > 1e-6 * model.Ts
        if step_differs:
            note(f"the reference has Ts = {step:g} s, the model was identified at {model.Ts:g} s")
        start = law.rest_input(r[0]) if m0 is None else m0
        m = law.run(r, start)
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
    from .data import read_signal
    from .files import write_csv
    from .store import load

    check_target(out, model_file, input_file)
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
    """Run the main job on the paper's bench test: identify, derive, compensate, draw."""
    from .demo import run

    if not out.parent.is_dir() or out.is_file():
        raise DataError(f"{out}: cannot be a folder here; choose another with --out.")
    run(out, working, table, console(), save_figure)


@app.callback(invoke_without_command=True)
def root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Hysteretic actuators as symbolic NARX models: identify, derive, compensate, compare."""
    if version:
        from importlib.metadata import version as installed

        print(installed("narx-sym"))
        raise typer.Exit


def main() -> None:
    """Run the command: exit 0 on success, 2 with one message on bad usage or input, never a traceback."""
    warnings.showwarning = lambda message, *_, **__: note(str(message))
    try:
        app()
    except SystemExit as stop:
        if stop.code == 130:  # typer has turned Ctrl-C into this
            print("narx-sym: interrupted; files are either whole or as they were", file=sys.stderr)
        raise
    except NarxError as error:
        print(f"narx-sym: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        if os.environ.get("NARX_SYM_DEBUG"):
            raise
        print(
            f"narx-sym: internal error, {type(error).__name__}: {error}. Please report it "
            "(NARX_SYM_DEBUG=1 shows the details).",
            file=sys.stderr,
        )
        sys.exit(1)
