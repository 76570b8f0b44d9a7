"""What a user chose and typed: columns and rows, a reference, numbers, names; and messages in the words of the page."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..data.readers import READERS
from ..data.record import Record, read
from ..data.tables import Table
from ..data.timegrid import check_step
from ..data.units import in_header, in_units
from ..errors import DataError, ModelError, NarxError
from ..fit.identify import prepare
from ..models.model import Model
from ..symbolic.signals import plain_name
from ..tasks.reference import PERIODS, Reference, from_file, lasting, sine, usual
from ..tasks.reference import measured as first_of

OPTIONS = {
    "input": "Input", "output": "Output", "time": "Time", "ts": "Sampling time", "rows": "Rows", "units": "Unit",
    "missing": "Missing values:",
}  # fmt: skip
MISSING = {"refuse": "refuse", "drop": "leave the rows out"}
OPTIONS |= {"channels": "Channels", "column": "Column of the reference"}  # options of the command line, in the page


@dataclass
class Choice:
    """Which columns and rows of a file are used; texts as a user types them."""

    u: str = ""
    y: str = ""
    t: str = ""
    Ts: str = ""
    channels: list[str] = field(default_factory=list)
    rows: str = ""
    missing: str = "refuse"
    machine: str = ""  # a key of `MACHINES`, "none", or "" where the units tell
    units: dict[str, str] = field(default_factory=lambda: {"u": "", "y": ""})


@dataclass
class Wanted:
    """What a law shall follow, and within which limits; texts as a user types them.

    Attributes
    ----------
    kind : "measured", "sine" or "file"
    low, high, rate : limits of the input and of its change per sample
    first : seconds of the measurement
    offset, amplitude, frequency, seconds : of the sine
    column : of the file
    file, path : the file's name to show, and where it is
    """

    kind: str = "measured"
    low: str = ""
    high: str = ""
    rate: str = ""
    first: str = ""
    offset: str = ""
    amplitude: str = ""
    frequency: str = ""
    seconds: str = ""
    column: str = ""
    file: str = ""
    path: Path | None = None

    @classmethod
    def of(cls, record: Record, before: Wanted) -> Wanted:
        """Return the usual fields for a record: its output, within the range of its input; a given file stays."""
        found, (low, high) = usual(record), (float(end(record.u)) for end in (np.min, np.max))
        limits = {"low": f"{low:.6g}", "high": f"{high:.6g}"} if low < high else {}
        digits = 2 - int(np.floor(np.log10(found.amplitude)))  # of the offset too: a far level costs none
        return cls(
            offset=f"{round(found.offset, digits):.10g}", amplitude=f"{found.amplitude:.3g}",
            frequency=f"{found.frequency:.3g}", seconds=f"{PERIODS / found.frequency:.3g}",
            file=before.file, path=before.path, **limits,
        )  # fmt: skip

    def made(self, said: Said, record: Record, unit: str) -> Callable[[], Reference]:
        """Return what makes the reference; a field that cannot be read is said there.

        Parameters
        ----------
        record : what was measured
        unit : of the output
        """
        if self.kind == "measured":
            with said.field("first"):
                seconds = number(self.first, "The time")
            said.stop()
            return partial(first_of, record, seconds)
        if self.kind == "file":
            if self.path is None:
                raise DataError("Drop a file with the reference first.")
            return partial(from_file, self.path, self.file, self.column.strip() or None, unit)
        given = []
        for name in ("offset", "amplitude", "frequency", "seconds"):
            what = "duration" if name == "seconds" else name
            with said.field(name):
                value = number(getattr(self, name), f"The {what}")
                if value is None:
                    raise DataError(f"The {what} is missing.")
                if name == "seconds":
                    lasting(value, record.Ts)
                given.append(value)
        said.stop()
        return partial(sine, record.Ts, *given)


def in_the_page(message: str) -> str:
    """Name the fields of the page in the place of options of the command line."""
    message = re.sub(r"--missing (\w+)", lambda found: f"--missing {MISSING.get(found[1], found[1])}", message)
    return re.sub(r"--(\w+)(?: \(\w+=\))?", lambda found: OPTIONS.get(found[1], found[0]), message)


def shortened(name: str) -> str:
    """Return a file name to show: its last part, without control characters, at most 80 characters."""
    last = re.split(r"[/\\]", name)[-1]
    return "".join(c for c in last if c.isprintable())[-80:] or "file"


def check_size(limit: int, size: int, name: str) -> None:
    """Refuse an upload above the limit, in bytes."""
    if size > limit:
        raise DataError(f"{name} has {size / 1e6:.1f} MB; at most {limit / 1e6:g} MB are taken.")


def kept_data(folder: Path, name: str, content: bytes, limit: int) -> tuple[Path, str]:
    """Keep an upload with columns; return where it is, and its name to show. It is never used as a path."""
    shown, suffix = shortened(name), Path(name).suffix.lower()
    if suffix not in READERS:
        raise DataError(f"{shown}: drop a file with columns ({', '.join(READERS)}).")
    check_size(limit, len(content), shown)
    return kept(folder, shown, suffix, content), shown


def kept(folder: Path, shown: str, suffix: str, content: bytes) -> Path:
    """Write an upload into a folder of its own; of its name only letters, digits and underscores are kept."""
    path = Path(tempfile.mkdtemp(dir=folder)) / f"{plain_name(Path(shown).stem)}{suffix}"
    path.write_bytes(content)
    return path


def dropped(folder: Path, path: Path | None) -> None:
    """Remove an upload; a file of the user's own stays."""
    if path is not None and folder in path.parents:
        shutil.rmtree(path.parent, ignore_errors=True)


def number(text: str, what: str) -> float | None:
    """Return the number that a user typed, None for nothing."""
    if not str(text).strip():
        return None
    try:
        value = float(str(text).replace(",", "."))
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e300:
        raise DataError(f"{what} must be a number, not {str(text)[:40]!r}.")
    return value


def guessed(columns: list[str]) -> Choice:
    """Guess which columns are time, input and output: by name, else in this order."""
    found = Choice()
    lower = {in_header(n)[0].lower(): n for n in reversed(columns)}
    usual = {
        "t": ("t", "time", "time_s"),
        "u": ("u", "input", "in", "voltage"),
        "y": ("y", "output", "out", "position"),
    }
    for field_, names in usual.items():
        setattr(found, field_, next((lower[n] for n in names if n in lower), ""))
    left = [n for n in columns if n not in (found.t, found.u, found.y)]
    for field_ in ("u", "y"):
        if not getattr(found, field_) and left:
            setattr(found, field_, left.pop(0))
    return found


class Refused(NarxError):  # noqa: N818
    """What was wrong is said at its field already."""


class Said:
    """Turns what a user may see into the messages of a workbench; everything else passes.

    A message stands at the field that was read when it was refused, else at "". It goes when the field is read again.
    """

    def __init__(self, bench: Any):
        self.bench = bench
        self.read = {""}
        self.wrong: dict[str, str] = {}

    def __enter__(self) -> Said:
        self.bench.understood()
        self.bench.notes = ()
        return self

    @contextmanager
    def field(self, name: str, file: str = "") -> Iterator[None]:
        """Read a field: what is refused meanwhile stands there, where the name of the file is known.

        Other fields may be read before `stop`.
        """
        self.read.add(name)
        try:
            yield
        except NarxError as error:
            text = in_the_page(str(error)).removeprefix(f"{file}: ")
            self.wrong[name] = text[:1].upper() + text[1:]

    def stop(self) -> None:
        """Go no further where a field was refused."""
        if self.wrong:
            raise Refused("; ".join(self.wrong.values()))

    def __exit__(self, kind: Any, error: Any, trace: Any) -> bool:
        if isinstance(error, NarxError) and not isinstance(error, Refused):
            self.wrong[""] = in_the_page(str(error))
        left = {name: text for name, text in self.bench.faults.items() if name not in self.read}
        self.bench.faults = left | self.wrong
        return isinstance(error, NarxError)


def measured(said: Said, path: Path, shown: str, table: Table, choice: Choice) -> Record:
    """Read a file as it was chosen; in messages it is called `shown`."""
    with said.field("u"):
        if not choice.u:
            raise DataError("Choose the column of the input.")
    with said.field("y"):
        if not choice.y:
            raise DataError("Choose the column of the output.")
        if choice.u == choice.y:
            raise DataError(f"Input and output are the same column {choice.u!r}.")
    with said.field("Ts"):
        Ts = number(choice.Ts, "Sampling time")
        if Ts is not None:
            check_step(Ts)
        elif not choice.t:
            raise DataError("Give the sampling time, or choose the column of the time.")
    rows = choice.rows.strip() or None
    with said.field("rows", shown):
        if rows:
            table.cut(rows)
    said.read |= {"channels", "unit u", "unit y"}
    said.stop()
    channels = [n for n in choice.channels if n not in (choice.u, choice.y, choice.t)]
    try:
        made = read(
            path, u=choice.u, y=choice.y, t=choice.t or None, Ts=Ts, rows=rows, channels=channels,
            missing=choice.missing,
        )  # fmt: skip
    except NarxError as error:
        raise DataError(str(error).replace(str(path), shown)) from None
    record = replace(made, name=Path(shown).stem)
    prepare(record)
    return record


def suits(said: Said, model: Model, record: Record) -> None:
    """Refuse measurements whose units do not convert to the model's, or without a channel of the model."""
    for signal in ("u", "y"):
        with said.field(f"unit {signal}"):
            in_units([record], {n: label for n, label in model.info.units.items() if n == signal})
    with said.field("channels"):
        needed = [n for n in model.channels if n not in record.channels]
        if needed:
            raise ModelError(f"The model needs the channel {needed[0]!r}: choose it here.")
    said.stop()


def limits_of(said: Said, low: str, high: str, rate: str) -> tuple[tuple[float, float] | None, float | None]:
    """Read the limits of the input, and of its change per sample."""
    with said.field("low"):
        a = number(low, "The lower limit")
    with said.field("high"):
        b = number(high, "The upper limit")
    with said.field("rate"):
        largest = number(rate, "The largest change")
        if largest is not None and largest <= 0:
            raise DataError("The largest change must be positive.")
    said.stop()
    with said.field("high"):
        limits = None if a is None or b is None else (a, b)
        if limits is None and a is not b:
            raise DataError("Give both limits, or none.")
        if limits and not limits[0] < limits[1]:
            raise DataError("The lower limit must be below the upper one.")
    said.stop()
    return limits, largest
