"""Many records, each diagnosed by itself: what is missing where, how much, and whether it grows.

One bad file never stops the rest: what is wrong with it becomes its row. So does an error of this package or of the
machine, but that row says so, and a resumed run tries again.
"""

from __future__ import annotations

import hashlib
import re
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..data.evidence.stiction import worst_valve
from ..data.record import Record, read
from ..diagnosis.machine import check_machine
from ..diagnosis.procedure import Diagnosis, diagnose
from ..errors import DataError, NarxError
from ..files.journal import Passing
from ..files.parallel import sweep
from .base import check_kind, identify_base

Row = dict[str, Any]
SUFFIXES = (".csv", ".npz", ".mat", ".parquet", ".mf4", ".mdf", ".tdms")
LIST = "file"  # the column that makes a CSV a list of records
COLUMNS = {"u": "u", "y": "y", "t": "t"}
STICKING, BAND = "sticking valve", "band of the valve in % of span"
UNKNOWN = "unknown"  # the machine of a record whose path does not tell it


@dataclass(frozen=True)
class Entry:
    """One record of a fleet: its file, machine, columns, a digest of its content, and the records that judge it."""

    file: Path
    tag: str
    columns: Mapping[str, Any] = field(default_factory=COLUMNS.copy)
    content: str = ""
    validation: tuple[Entry, ...] = ()


@dataclass(frozen=True)
class Settings:
    """How each record is diagnosed.

    Attributes
    ----------
    budget : float
        Seconds for one record, checked between hypotheses; 0 for no limit.
    reports : Path, optional
        A folder for one report per record.
    machine : what all records are of, "" where their units tell
    how : what else `ns.read` takes, for all records: Ts, channels, missing, units, roles
    """

    base: str = "linear"
    max_effects: int = 1
    seed: int = 0
    budget: float = 0.0
    reports: Path | None = None
    machine: str = ""
    how: Mapping[str, Any] = field(default_factory=dict)


class BudgetError(NarxError):
    """A record took longer than it may."""


def entries(
    source: str | Path, group: str = "", columns: dict[str, str] | None = None, validate: str = ""
) -> list[Entry]:
    """Return the records of a folder, of a pattern such as `logs/*.csv`, or of a CSV that lists files.

    Parameters
    ----------
    source : folder, pattern, or CSV with a column `file`
        The list may have the columns u, y and t (names of columns in that record); files are relative to it.
    group : str
        What tells the machine: a column of the list, or a regular expression for the path (its first group).
        By default the column `tag`, or the folder that a record is in. A path that does not match is of the machine
        `UNKNOWN`, and a warning says so.
    columns : dict, optional
        Names of the columns u, y, t.
    validate : str
        A regular expression: records whose path it matches are validation records of the same machine.

    Raises
    ------
    DataError
        Where nothing is found, no path matches, or the list lacks a column or a file.
    """
    named, path = {**COLUMNS, **(columns or {})}, Path(source)
    listed = _listed(path, group, named) if path.is_file() else _found(path, group, named)
    if not listed:
        raise DataError(f"{source}: no records ({', '.join(SUFFIXES)}) are there.")
    listed = [replace(e, content=_content(e.file)) for e in listed]
    judging = _matching(listed, validate) if validate else []
    return [replace(e, validation=tuple(v for v in judging if v.tag == e.tag)) for e in listed if e not in judging]


def _matching(listed: list[Entry], pattern: str) -> list[Entry]:
    try:
        found = [e for e in listed if re.search(pattern, str(e.file))]
    except re.error as error:
        raise DataError(f"--validate {pattern!r} is no regular expression: {error}.") from None
    if len(found) in (0, len(listed)):
        raise DataError(f"--validate {pattern!r} matches {'every' if found else 'no'} path, such as {listed[0].file}.")
    return found


def _content(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""  # what is wrong with it will be said in its row


def _found(path: Path, group: str, columns: dict[str, str]) -> list[Entry]:
    files = path.rglob("*") if path.is_dir() else Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))
    try:
        pattern = re.compile(group) if group else None
    except re.error as error:
        raise DataError(f"--group {group!r} is no regular expression: {error}.") from None
    found = []
    for file in sorted(files, key=_counted):
        if file.suffix.lower() in SUFFIXES and file.is_file():
            tag = _machine(pattern, file) if pattern else file.parent.name
            found.append(Entry(file, tag, columns))
    others = [e.file for e in found if pattern and e.tag == UNKNOWN]
    if others and len(others) == len(found):
        raise DataError(f"--group {group!r} matches no path, such as {others[0]}.")
    if others:
        warnings.warn(
            f"--group {group!r} does not match {len(others)} of {len(found)} paths, such as {others[0]}: their "
            f"machine is named {UNKNOWN}",
            stacklevel=3,
        )
    return found


def _counted(file: Path) -> list[tuple[int, str]]:
    """Order paths as people count: log_2 before log_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", str(file))]


def _machine(pattern: re.Pattern[str], file: Path) -> str:
    match = pattern.search(str(file))
    return (match[1 if pattern.groups else 0] if match else "") or UNKNOWN


def _listed(path: Path, group: str, columns: dict[str, str]) -> list[Entry]:
    import pandas as pd

    try:
        header = path.read_text(encoding="utf-8-sig").partition("\n")[0]
        mark = next((mark for mark in ";\t" if mark in header), ",")  # a list of one column has none
        rows = pd.read_csv(path, dtype=str, keep_default_na=False, sep=mark, encoding="utf-8-sig")
    except (ValueError, OSError) as error:
        raise DataError(f"{path}: {error}") from None
    if LIST not in rows.columns:
        raise DataError(
            f"{path}: a list of records needs a column {LIST!r}; it has {', '.join(map(str, rows.columns))}."
        )
    if group and group not in rows.columns:
        raise DataError(
            f"{path}: there is no column {group!r} for the tag; it has {', '.join(map(str, rows.columns))}."
        )
    tags = rows[group] if group else rows["tag"] if "tag" in rows.columns else [""] * len(rows)
    found = []
    for tag, (_, row) in zip(tags, rows.iterrows(), strict=True):
        own = {name: row[name] for name in columns if row.get(name)}
        found.append(Entry(path.parent / row[LIST], str(tag), columns | own))
    return found


def fleet(
    listed: Sequence[Entry], settings: Settings, jobs: int | None = -1,
    resumed: Callable[[int], Any] = lambda done: None,
) -> list[Row]:  # fmt: skip
    """Diagnose every record; return one row each, the worst first, problems last.

    The work spreads to what `joblib.parallel_config` names; inside `narx_sym.resuming(file)` it goes on from there.

    Parameters
    ----------
    resumed : callable
        Told how many records were done already.
    """
    check_kind(settings.base)
    check_machine(settings.machine)

    def holds(row: Row) -> bool:
        """Whether the report of a row that was kept is still there."""
        return settings.reports is None or not row["report"] or (settings.reports / row["report"]).is_file()

    calls, what = [(entry, settings) for entry in listed], f"Diagnosing {len(listed)} records"
    rows = [row | {"order": i} for i, row in enumerate(sweep(look, calls, what, jobs, holds, resumed))]
    return sorted(rows, key=_worst)


def _worst(row: Row) -> tuple[Any, ...]:
    """Order rows: valves that stick, and of the others what explains most; problems last."""
    return bool(row["problem"]), STICKING not in row["missing"], -row["explained"], row["tag"], row["order"]


def look(entry: Entry, settings: Settings) -> Row:
    """Diagnose one record; whatever goes wrong becomes its row, which is `Passing` where the record is not to blame."""
    begin = time.monotonic()
    row: Row = {
        "file": str(entry.file), "tag": entry.tag, "verdict": "", "finding": "", "missing": [], "valve": "",
        "sizes": {}, "before": None, "after": None, "unit": "", "explained": 0.0, "report": "", "problem": "",
    }  # fmt: skip

    def watch(_: str) -> None:
        if settings.budget and time.monotonic() - begin > settings.budget:
            raise BudgetError(f"It took longer than the time limit of {settings.budget:g} s.")

    passing = False
    try:
        names, record = entry.columns, _read(entry, settings)
        base = identify_base(settings.base, [record])
        found = diagnose(
            base, record, max_effects=settings.max_effects, seed=settings.seed, report=watch,
            validation=[_read(one, settings) for one in entry.validation], machine=settings.machine,
        )  # fmt: skip
        row |= _told(found) | {"unit": record.units.get("y", "")}
        if settings.reports is not None:
            chosen = [names[n] for n in ("u", "y") if names[n] != COLUMNS[n]]  # two loops of one log are two reports
            parts = filter(None, (entry.tag, entry.file.stem, *chosen, entry.content[:8]))
            name = re.sub(r"[^\w.-]+", "_", "_".join(parts)) + ".html"
            found.report(settings.reports / name, {}, [entry.file], {"base": settings.base})
            row["report"] = name
    except NarxError as error:
        row["problem"] = str(error)
    except Exception as error:  # nothing stops the rest
        row["problem"], passing = _not_its_own(error), True
    row["seconds"] = round(time.monotonic() - begin, 3)
    return Passing(row) if passing else row


def _read(entry: Entry, settings: Settings) -> Record:
    return read(entry.file, **entry.columns, **settings.how)


def _not_its_own(error: Exception) -> str:
    """Say what went wrong that is no fault of a record: of the machine, or of this package."""
    if isinstance(error, MemoryError):
        return "not enough memory; use fewer processes (--jobs) or shorter records"
    if isinstance(error, OSError):
        return f"{error.filename or 'a file'}: {error.strerror or error}; check space and permissions there"
    return f"internal error, {type(error).__name__}: {error}; please report it"


def _told(found: Diagnosis) -> Row:
    """Return what a diagnosis says, as plain data; errors are those of the free run on validation data [unit of y].

    `explained` is a share of the output's standard deviation, so that records compare: a report tells the share of the
    error that could be removed.
    """
    first, spread = found.steps[0], found.steps[0].base.problem.spread
    before, after = (found.ladder[i]["validation_rms"] for i in (0, -1))
    later = [effect for step in found.steps[1:] for effect in step.added]
    missing = list(dict.fromkeys([*first.confusion_set, *later]))
    valve = worst_valve(first.valves) if first.valves else None
    if valve is not None and valve.found:
        missing = [STICKING]
    elif first.verdict == "outside_library":
        missing = ["outside the catalogue"]
    sizes = {}
    if found.candidates and missing:
        best = found.best
        named = [e for e in best.model.effects if e.effect in best.effect.split(" + ")]
        sizes = {f"{e.effect} {n}": float(best.model.values[s]) for e in named for n, s in e.symbols.items()}
    if valve is not None and valve.band:
        sizes = {BAND: 100 * valve.band / valve.span}
    return {
        "verdict": first.verdict, "finding": first.finding, "missing": missing, "sizes": sizes,
        "valve": "" if valve is None else valve.verdict, "before": float(before), "after": float(after),
        "explained": max(0.0, float(before - after)) / spread,
    }  # fmt: skip
