"""What the commands share: options, reading, and printing. Results go to stdout, progress and notes to stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import DataError

# Heavy modules are imported inside the functions: `narx-sym --help` answers at once.
if TYPE_CHECKING:
    from ..data.record import Record
    from ..models.model import Model

PACE = 2.0  # seconds between lines of progress where there is no terminal

DataFiles = Annotated[
    list[Path], typer.Argument(metavar="DATA...", help="CSV (or .npz, .mat, .parquet) with a header.")
]
ModelFile = Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model file.")]
Input = Annotated[str, typer.Option("--input", help="Column of the input.")]
Output = Annotated[str, typer.Option("--output", help="Column of the output.")]
Time = Annotated[str, typer.Option("--time", help="Column of the time, in s.")]
Ts = Annotated[float | None, typer.Option("--ts", help="Sampling time in s; overrides the time column.")]
Channels = Annotated[str, typer.Option("--channels", help="Further columns: names with commas, or all.")]
Rows = Annotated[str | None, typer.Option("--rows", help="Data rows A:B, counted from 0.")]
Missing = Annotated[str, typer.Option("--missing", help="Rows with missing values: refuse, or drop and say so.")]
Units = Annotated[str, typer.Option("--units", help="Units of input and output, as V,um.")]


def console(stderr: bool = False) -> Any:
    """Return a rich console; results go to stdout, progress and notes to stderr."""
    from rich.console import Console

    shown = Console(stderr=stderr, highlight=False, soft_wrap=True)
    # In a pipe or a log nothing is cut off.
    return shown if shown.is_terminal else Console(stderr=stderr, highlight=False, soft_wrap=True, width=140)


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show on stderr that something longer is going on; the function it yields tells what exactly."""
    shown = console(stderr=True)
    if shown.is_terminal:
        from rich.markup import escape

        with shown.status(escape(what)) as status:
            yield lambda now: status.update(escape(f"{what}: {now}"))
        return
    print(f"{what} ...", file=sys.stderr, flush=True)
    said = time.monotonic()

    def report(now: str) -> None:
        nonlocal said
        if time.monotonic() - said > PACE:
            print(f"{what}: {now} ...", file=sys.stderr, flush=True)
            said = time.monotonic()

    yield report


def note(message: str) -> None:
    """Print a note on stderr."""
    print(f"note: {message}", file=sys.stderr)


def records(
    files: list[Path],
    u: str,
    y: str,
    t: str,
    Ts: float | None,
    channels: str,
    rows: str | None,
    missing: str = "refuse",
) -> list[Record]:
    """Read the data files, and say what was changed in them and what to know about them."""
    from ..data.record import read
    from ..data.sensor import sensor_faults

    listed = []
    for file in files:
        record = read(file, u=u, y=y, t=t, Ts=Ts, rows=rows, channels=channels, missing=missing)
        for text in (*record.notes, *record.remarks(), *(f.sentence for f in sensor_faults([record], 0.0))):
            note(f"{file.name}: {text}")
        listed.append(record)
    return listed


def unit_names(units: str) -> dict[str, str]:
    """Turn "V,um" into units of u and y."""
    first, _, second = units.partition(",")
    return {"u": first.strip(), "y": second.strip()}


def check_format(path: Path | None) -> None:
    """Refuse a picture that cannot be written, before any work is done."""
    if path is None:
        return
    from matplotlib.backend_bases import FigureCanvasBase

    supported = FigureCanvasBase.get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in supported:
        raise DataError(f"{path}: pictures end in one of {', '.join(sorted('.' + s for s in supported))}.")


def save_figure(figure: Any, path: Path) -> None:
    """Write a picture; the format follows the suffix. It appears whole or not at all."""
    from ..files.atomic import write_figure

    check_format(path)
    write_figure(figure, path, dpi=130)


def check_targets(targets: Sequence[Path | None], *read: Path | None) -> None:
    """Refuse output paths that cannot be written, that are read, or that are the same, before any work is done."""
    from ..files.atomic import check_path

    sources = {p.resolve() for p in read if p is not None}
    given: set[Path] = set()
    for path in targets:
        if path is None:
            continue
        where = check_path(path)
        if where in sources:
            raise DataError(f"{path}: is read by this command; write to another file.")
        if where in given and where.is_file() == where.exists():
            raise DataError(f"{path}: two results would go to the same file; choose different names.")
        given.add(where)


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
    _print_point(model)


def print_errors(rows: list[tuple[str, Any]]) -> None:
    """Print the pairs of errors."""
    table(
        "Errors, always in pairs (NRMSE = rms error / std of the output; MAPE in % of its range)",
        ["record", "one-step NRMSE", "free-run NRMSE", "one-step MAPE", "free-run MAPE"],
        [[n, e.one_step_nrmse, e.free_run_nrmse, e.one_step_mape, e.free_run_mape] for n, e in rows],
    )


def print_equations(model: Model) -> None:
    """Print all equations of a model with numbers: what its effects remember, then the output."""
    from ..symbolic.printing import text
    from ..symbolic.recursion import State
    from ..symbolic.signals import k

    def digits(expression: Any) -> str:
        import sympy as sp

        known = sp.sympify(expression).xreplace(model.values)
        return text(known.xreplace({f: sp.Float(f"{float(f):.6g}") for f in known.atoms(sp.Float)}))

    for equation in [*model.states, State(model.output[k], model.F)]:
        console().print(f"  {equation.left.base.label}[k] = {digits(equation.right)}", markup=False)
    _print_point(model)


def _print_point(model: Model) -> None:
    if model.operating_point:
        around = ", ".join(f"{b.label} - ({v:g})" for b, v in model.operating_point.items())
        console().print(f"Terms are in the signals measured from the operating point: {around}.", markup=False)


def print_fails(misfit: Any, units: dict[str, str], most: int = 5) -> None:
    """Print where a model fails: the panels that explain most of its error, each with its worst region."""
    rows = [
        [row["panel"], f"{100 * row['share']:.0f} %", _percent(row["share_missing"]), row["worst"]]
        for row in misfit.table(units)[:most]
    ]
    table(
        "Where it fails (share of the variance that a panel explains)",
        ["panel", "of the error", "of the missing input", "worst"],
        rows,
    )


def _percent(share: float) -> str:
    return "" if share != share else f"{100 * share:.0f} %"
