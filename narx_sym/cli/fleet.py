"""The command for many records."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import DataError
from . import options as opt
from .printing import console, note, table

SHOWN = 10
EXPLAINED = "explained, fraction of std(y)"


@opt.reads("rows")
def fleet(
    source: Annotated[str, typer.Argument(help="A folder, a pattern, or a CSV with a column `file`.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", help="HTML page to write; its table is also written as CSV (and Parquet) in the same folder."
        ),
    ],
    base: Annotated[str, typer.Option(help="linear, static, narx, bouc-wen or auto.")] = "linear",
    group: Annotated[
        str,
        typer.Option(
            "--group",
            help="How to find the name of the machine: a column of the list, or a regular expression for the path.",
        ),
    ] = "",
    validate: Annotated[
        str,
        typer.Option(
            "--validate", help="Regular expression: files that match are validation records of their machine."
        ),
    ] = "",
    max_effects: opt.MaxEffects = 1,
    seed: opt.Seed = 0,
    budget: Annotated[float, typer.Option(min=0.0, help="Time limit per record in s; 0: no limit.")] = 0.0,
    jobs: Annotated[int, typer.Option(help="Number of processes; -1: all cores.")] = -1,
    dask: Annotated[str, typer.Option("--dask", help="Address of a Dask scheduler that is already running.")] = "",
    reports: Annotated[Path | None, typer.Option("--reports", help="A folder for one report per record.")] = None,
    resume: opt.Resume = None,
    machine: opt.Machine = "",
    *,
    how: opt.Reading,
) -> None:
    """Diagnose many records in parallel; write one page with the worst records, effects per machine, and trends.

    "Explained" is (error before - error after) / std(y). It is not the fraction of the removable error that `diagnose`
    reports for one record.
    """
    from ..data.evidence.roles import roles_of
    from ..files.journal import resuming
    from ..report.fleet import beside, nothing, write_fleet
    from ..tasks.fleet import Settings, entries
    from ..tasks.fleet import fleet as run

    listed = entries(source, group, {"u": how.u, "y": how.y, "t": how.t}, validate)
    opt.check_targets([out, *beside(out), resume], *(e.file for e in listed))
    if reports is not None:
        reports.mkdir(parents=True, exist_ok=True)
    reading: dict[str, Any] = {"Ts": how.ts, "channels": how.channels, "missing": how.missing}
    reading |= {"units": opt.unit_names(how.units), "roles": roles_of(how.role)}
    settings = Settings(base, max_effects, seed, budget, reports and reports.resolve(), machine, reading)
    done: list[int] = []
    with ExitStack() as stack:
        journal = stack.enter_context(resuming(resume)) if resume else None
        kept = 0 if journal is None else len(journal)
        if dask:
            stack.enter_context(_cluster(dask))
        rows = run(listed, settings, None if dask else jobs, done.append)
    if kept:
        note(f"{resume}: {done[0]} of {len(rows)} records were done already")
    seen_from_page = "" if reports is None else f"{Path(os.path.relpath(reports, out.parent)).as_posix()}/"
    written = write_fleet(rows, out, seen_from_page)
    shown = [
        [
            r["tag"],
            Path(r["file"]).name,
            r["problem"] or ", ".join(r["missing"]) or nothing(r),
            f"{100 * r['explained']:.0f} %",
        ]
        for r in rows[:SHOWN]
    ]
    table(f"The worst of {len(rows)} records", ["machine", "record", "may be missing", EXPLAINED], shown)
    problems = sum(bool(r["problem"]) for r in rows)
    if problems:
        note(f"{problems} of {len(rows)} records could not be diagnosed: the page says why")
    console().print(f"Written: {', '.join(map(str, written))}", markup=False)


def _cluster(address: str) -> Any:
    """Return a context in which the work goes to a Dask cluster."""
    import joblib

    try:
        from distributed import Client
    except ImportError:
        raise DataError("--dask needs the package distributed: pip install distributed.") from None
    try:
        Client(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise DataError(f"--dask {address}: no scheduler answers there ({error}).") from None
    return joblib.parallel_config("dask")
