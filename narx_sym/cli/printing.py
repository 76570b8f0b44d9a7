"""What the commands print: results on stdout, progress and notes on stderr."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any, cast

from ..files.telling import Stderr, fenced

# Heavy modules are imported inside the functions: `narx-sym --help` answers at once.
if TYPE_CHECKING:
    from ..diagnosis.procedure import Diagnosis
    from ..models.model import Model

PACE = 2.0  # seconds between lines of progress where there is no terminal
FEW = 3  # effects shown from either end of the sizes that would have been seen
MARK = "*"


def console(stderr: bool = False) -> Any:
    """Return a rich console; results go to stdout, progress and notes to stderr."""
    from rich.console import Console

    file = cast(IO[str], Stderr()) if stderr else None
    shown = Console(file=file, highlight=False)
    # In a terminal lines end between words; in a pipe or a log nothing is cut off.
    return shown if shown.is_terminal else Console(file=file, highlight=False, soft_wrap=True, width=140)


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show on stderr that something longer is going on; the function it yields tells what exactly."""
    shown = console(stderr=True)
    if shown.is_terminal:
        with _bar(shown, what) as tell:
            yield tell
        return
    print(f"{what} ...", file=Stderr(), flush=True)
    begin = said = time.monotonic()

    def progress(now: str) -> None:
        nonlocal said
        if time.monotonic() - said > PACE:
            said = time.monotonic()
            print(f"{what}, {said - begin:.0f} s: {now} ...", file=Stderr(), flush=True)

    yield progress


@contextmanager
def _bar(shown: Any, what: str) -> Iterator[Callable[[str], None]]:
    """Show one line with the time and, where the stages are known, a bar."""
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    text = TextColumn("{task.description}", table_column=Column(ratio=1))
    columns = (SpinnerColumn(), BarColumn(bar_width=16), TimeElapsedColumn(), text)
    with Progress(*columns, console=shown, transient=True, expand=True) as bars:
        one = bars.add_task(escape(what), total=None)

        def tell(now: str) -> None:
            with fenced("The bar"):
                fraction = getattr(now, "fraction", None)  # of work whose stages are known
                total = None if fraction is None else 1.0
                bars.update(one, description=escape(f"{what}: {now}"), total=total, completed=fraction or 0.0)

        yield tell


def note(message: str) -> None:
    """Print a note on stderr."""
    print(f"note: {message}", file=Stderr())


def say_written(*files: tuple[str, Any]) -> None:
    """Print a line on stdout for each file that was written: what it is, and where."""
    for what, path in files:
        if path is not None:
            console().print(f"{what} {path}")


def table(title: str, columns: list[str], rows: list[list[Any]]) -> None:
    """Print a table on stdout; one line for each row where the terminal would cut numbers or words."""
    from rich.markup import escape  # "y[k-1]" is not a style
    from rich.table import Table

    shown = Table(title=title, title_justify="left")
    for i, name in enumerate(columns):
        shown.add_column(name, justify="left" if i == 0 else "right")
    said = [[f"{v:.4g}" if isinstance(v, float) else escape(str(v)) for v in row] for row in rows]
    for row in said:
        shown.add_row(*row)
    out = console()
    with out.capture() as drawn:
        out.print(shown)
    if "…" not in drawn.get():  # no word is cut
        out.file.write(drawn.get())
        return
    out.print(f"[italic]{escape(title)}[/italic]")
    for first, *rest in said:
        out.print(f"  {first}: " + "; ".join(f"{escape(n)} {v}" for n, v in zip(columns[1:], rest, strict=True) if v))


def print_model(model: Model) -> None:
    """Print terms, parameters, with their units where those of the signals are known, and both errors."""
    from ..codegen.units import coefficient_units

    rows, known = [], model.info.units
    units = coefficient_units(model, known) if known else {}
    for row in model.table():
        error = f"{row['standard_error']:.2g}" if row["standard_error"] else "fixed"
        rows.append(
            [row["symbol"], row["term"], f"{row['theta']:.6g}", error, *[units.get(row["symbol"], "")] * bool(known)]
        )
    table("Model", ["parameter", "term", "value", "standard error", *["unit"] * bool(known)], rows)
    _print_point(model)


def print_errors(rows: list[tuple[str, Any]]) -> None:
    """Print the pairs of errors, and the fit of the free run in per cent."""
    from ..fit.evaluate import PROTOCOL

    table(
        "Errors one step ahead and in free run (NRMSE = rms error / std of the output; fit = 100 (1 - NRMSE))",
        ["record", "one-step NRMSE", "free-run NRMSE", "fit [%]", "one-step MAPE", "free-run MAPE"],
        [[n, e.one_step_nrmse, e.free_run_nrmse, e.fit, e.one_step_mape, e.free_run_mape] for n, e in rows],
    )
    console().print(f"Free run: {PROTOCOL.partition(': ')[2] or PROTOCOL}. MAPE in % of the range of the output.")


def print_equations(model: Model) -> None:
    """Print all equations of a model with numbers: what its effects remember, then the output."""
    for line in model.lines(numbers=True):
        console().print(f"  {line}", markup=False, soft_wrap=True)
    _print_point(model)


def _print_point(model: Model) -> None:
    from ..models.info import acts

    console().print(acts(model.delay, model.Ts), markup=False)
    if model.operating_point:
        around = ", ".join(f"{b.label} - ({v:g})" for b, v in model.operating_point.items())
        console().print(f"Terms are in the signals measured from the operating point: {around}.", markup=False)


def print_fails(misfit: Any, units: dict[str, str], most: int = 5) -> None:
    """Print where a model fails: the panels that explain most of its error, each with its worst region."""
    from ..diagnosis.bases import words

    rows = [
        [words(row["panel"]), f"{100 * row['share']:.0f} %", _percent(row["share_missing"]), row["worst"]]
        for row in misfit.table(units)[:most]
    ]
    table(
        "Where the model fails (percentage of the variance that each panel explains)",
        ["panel", "of the error", "of the missing input", "worst"],
        rows,
    )


def _percent(share: float) -> str:
    return "" if share != share else f"{100 * share:.0f} %"


# -- a diagnosis -----------------------------------------------------------------------------------------------


def print_found(found: Diagnosis, units: dict[str, str], command: str, quantities: Any = None) -> None:
    """Print in a few lines what was found, how far the error falls, why, and what to do next.

    Parameters
    ----------
    quantities : what `tasks.physical` returned, where it is known
    """
    from ..models.info import acts
    from ..report.parameters import added_sizes
    from ..report.words import fall, what_next, without_ids

    print_headline(found)
    acting = "" if found.steps[0].follows_nothing else acts(found.model.delay, found.model.Ts)
    told = f"In physical units: {quantities.text}." if getattr(quantities, "text", "") else ""
    lines = [
        fall(found, units),
        *added_sizes(found, units, quantities),
        without_ids(found.sentence(units)),
        f"{told} {acting}".strip(),
    ]
    lines += [f"Step {i}: {without_ids(later.sentence(units))}" for i, later in enumerate(found.steps[1:], 2)]
    lines += [f"Next: {what_next(found)}", command and f"  {command}"]
    for line in filter(None, lines):
        console().print(line, markup=False, soft_wrap=line.startswith("  ") or None)  # a command is copied whole


def print_headline(found: Diagnosis) -> None:
    """Print one line: what was found, and how sure it is."""
    from rich.markup import escape

    from ..report.words import badge, headline

    console().print(f"[bold]{escape(headline(found))}[/bold] ({escape(badge(found))})")


def print_tables(found: Diagnosis, units: dict[str, str]) -> None:
    """Print candidates, errors, where the base fails, and what could not have been seen."""
    from ..diagnosis.bases import percent_of
    from ..report.parameters import candidate_parameters
    from ..report.words import PARTS, removed, spaced

    step = found.steps[0]
    rows = [
        [
            f"{spaced(row['effect'])}{' ' + MARK if row['in_confusion_set'] else ''}", row["where"],
            "" if one.probability is None else percent_of(one.probability), *removed(row), row["before"],
            row["nrmse"], candidate_parameters(one, units),
        ]
        for one, row in zip(found.candidates, found.table(), strict=True)
    ]  # fmt: skip
    if rows:
        meant = "both together are probably missing" if step.pair else "these data cannot distinguish them"
        table(
            f"Candidates (percentage of the removable error that each removes, with its 95 % interval; {MARK} {meant})",
            [
                "effect",
                "where",
                "probability",
                "removes",
                "interval",
                "cross-validated NRMSE before",
                "after",
                "parameters",
            ],
            rows,
        )
    floor = found.floor / step.base.problem.spread
    ladder = [
        [spaced(name), *(f(r[part]) for part in PARTS for f in (lambda e: e, lambda e: 100 * (1 - e)))]
        for name, r in zip(found.rungs, found.ladder, strict=True)
    ]
    ladder.append([f"noise floor ({step.floor_kind})", floor, "", "", ""])
    if step.sensor:
        ladder.append(["noise of the sensor alone", step.sensor / step.base.problem.spread, "", "", ""])
    columns = [f"{what}{of}" for of in PARTS.values() for what in ("NRMSE, ", "fit [%], ")]
    table(f"Free-run errors, step by step; validation data: {found.validation}", ["model", *columns], ladder)
    print_fails(found.misfit, units)
    print_detectable(step, units)


def print_detectable(step: Any, units: dict[str, str]) -> None:
    """Print which effects these data would have shown, and which a refit hides."""
    from ..diagnosis.bases import words
    from ..symbolic.numbers import sized

    sizes = step.unseen
    shown = sizes if len(sizes) <= 2 * FEW else [*sizes[:FEW], ("...", None), *sizes[-FEW:]]
    spread, beside = step.base.problem.spread, step.errors(step.base)["validation"].free_run_rms
    rows = [
        [words(n), "", "" if v is None else "> 100 %"]
        if v is None or v >= spread
        else [words(n), sized(v, units.get("y", ""), beside=beside), f"{100 * v / spread:.2g} %"]
        for n, v in shown
    ]
    if rows:
        table(
            "Detection limits: an effect that moves the output by less than this could not have been detected",
            ["effect", "rms", "of the output's standard deviation"],
            rows,
        )
    if step.absorbed:
        console().print(
            "Not detectable, because the parameters of the base model can reproduce it: "
            f"{', '.join(map(words, step.absorbed))}.",
            markup=False,
        )
