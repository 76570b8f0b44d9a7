"""Raw columns of a file of measurements: each is checked, and its time is read, when it is asked for."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..symbolic.signals import channel_name, plain_name
from .arrays import Vector
from .evidence.roles import IGNORE, INPUT, SETPOINT, is_setpoint
from .timegrid import GAP, Grid, check_step, regular_time, uniform_time
from .units import converted, in_header

PathLike = str | os.PathLike[str]
MOST_NAMED = 40  # columns in a message
LARGEST_FILE = 8_000_000_000  # bytes of all arrays that are read from a file
LARGEST = 1e100  # in any unit
YEAR_LAST = re.compile(r"^(\d{1,2})[-/.](\d{1,2})[-/.](\d{4})(?!\d)")
ALL = "all"  # instead of names of columns


@contextmanager
def readable(name: str, kind: str, advice: str = "") -> Iterator[None]:
    """Turn what a library raises at a damaged file, which is of many kinds, into one DataError."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:
        then = f"; {advice}" if advice else ""
        raise DataError(f"{name}: cannot be read as {kind} ({str(error)[:200]}){then}") from None


def check_bytes(path: str, size: int, then: str) -> None:
    """Refuse a file whose arrays would fill the memory."""
    if size > LARGEST_FILE:
        raise DataError(f"{path}: holds {size / 1e9:.3g} GB, at most {LARGEST_FILE / 1e9:g} GB are read; {then}")


@dataclass
class Table:
    """Raw columns of a file; each is checked only when it is asked for."""

    path: str
    columns: dict[str, NDArray[Any]]
    lines: NDArray[np.int64] | None = None  # line number in the file of each data row, for text files
    header: int = 1  # the line that the names were read from
    notes: list[str] = field(default_factory=list)
    repeated: frozenset[str] = frozenset()
    decimal: str = "."
    unread: tuple[str, ...] = ()  # columns of the file that nobody asked for
    units: Mapping[str, str] = field(default_factory=dict)  # of a log's channels
    offers: tuple[str, ...] = ("--rows", "--missing")  # what the one who asks has against rows that cannot be used

    @property
    def listing(self) -> str:
        """The columns there are, for messages."""
        named = [n if len(n) <= 60 else n[:57] + "..." for n in (*self.columns, *self.unread) if n]
        shown = ", ".join(named[:MOST_NAMED]) + (f" and {len(named) - MOST_NAMED} more" * (len(named) > MOST_NAMED))
        line = "" if self.lines is None else f" (line {self.header})"
        return f"the columns {shown}{line}" + "".join(f"; {n}" for n in self.notes if "left out" in n)

    def named(self, asked: str) -> str:
        """Return the column that is meant: of that name, else the only one of which it is the name.

        That of "temp [C]" is temp, before the unit, and temp_C, as a channel.
        """
        alike = [n for n in self.columns if n and asked in (in_header(n)[0], plain_name(n), channel_name(n))]
        return alike[0] if len(alike) == 1 and asked not in self.columns else asked

    def unit(self, column: str) -> str:
        """Return the unit of a column, empty where the file does not say it."""
        return self.units.get(column) or in_header(column)[1]

    def where(self, row: int) -> str:
        """Name a row as the user sees it: its line in a text file."""
        return f"row {row}" if self.lines is None else f"line {self.lines[row]}"

    def cut(self, rows: slice | str | None) -> slice:
        """Rows as a slice with non-negative ends, at least 2 rows."""
        size = max((a.size for a in self.columns.values()), default=0)
        if size == 0:
            raise DataError(f"{self.path}: no data rows below the header; at least 2 are needed")
        start, stop, step = _rows(rows, self.path).indices(size)
        if step != 1:
            raise DataError(f"{self.path}: rows must have step 1, not {step}; write --rows A:B")
        if stop - start < 2:
            raise DataError(
                f"{self.path}: {max(stop - start, 0)} data row(s) left of {size}; at least 2 are needed"
                + ("" if rows is None else ", check --rows")
            )
        return slice(start, stop)

    def channels(
        self, wanted: str | Sequence[str], used: tuple[str, str, str | None], cut: slice, said: Mapping[str, str]
    ) -> tuple[dict[str, str], dict[str, str]]:
        """Return further columns by the names of their channels, and the roles that are said, by these names too.

        Taken is what was asked for, or has a role; "all", alone or beside names, takes every column that no name has
        taken; it leaves out text, and says so. Where nothing was asked for, a column that is called a setpoint is one.
        """
        every, listed = wants_all(wanted), names_of(wanted)
        roles = self._roles(said, used)
        ignored = {n for n, role in roles.items() if role == IGNORE}
        pairs = [(n, self.named(n)) for n in listed if not every or n != ALL]
        taken = {used_by for _, used_by in pairs} | {*used, *ignored}
        pairs = [(name, n) for name, n in pairs if n not in ignored]
        pairs += [(asked, n) for asked in said if (n := self.named(asked)) in roles and n not in taken]
        for n in [n for n in self.columns if every and n and n not in taken and n not in roles]:
            if self._parsed(n, cut)[1] is None:
                pairs.append((n, n))
            else:
                self.notes.append(f"column '{n}' holds text and is left out of the channels")
        called: dict[str, str] = {}
        for name, n in ((channel_name(asked), n) for asked, n in pairs):
            other = called.setdefault(name, n)
            if other != n:
                raise DataError(
                    f"{self.path}: as channels the columns '{other}' and '{n}' would both be called {name}; "
                    "rename one, or leave it out with --channels"
                )
            if name != n and (told := f"column '{n}' is the channel {name}") not in self.notes:
                self.notes.append(told)
        left = [n for n in (*self.columns, *self.unread) if n and n not in {*called.values(), *used, *ignored}]
        found = [n for n in left if is_setpoint(channel_name(n))]
        if found and SETPOINT not in roles.values() and not any(map(is_setpoint, called)):
            values, text = self._parsed(found[0], cut)
            if not listed and len(found) == 1 and text is None and values.size and np.all(np.isfinite(values)):
                called[channel_name(found[0])] = found[0]
            else:
                self.notes.append(
                    f"column '{found[0]}' is not used; if it is the setpoint of a controller, use --role "
                    f"{plain_name(found[0])}={SETPOINT}"
                )
        return called, {name: roles[n] for name, n in called.items() if n in roles} | dict.fromkeys(ignored, IGNORE)

    def _roles(self, said: Mapping[str, str], used: tuple[str, str, str | None]) -> dict[str, str]:
        """Return the roles that are said, by column; refuse those of input, output and time, and of no column."""
        roles = {self.named(n): role for n, role in said.items()}
        own = {used[0]: INPUT, used[2]: IGNORE}  # what these columns are anyway
        for n in [n for n, role in roles.items() if n in used and own.get(n) == role]:
            del roles[n]
        for n in roles:
            if n in used:
                what = ("input", "output", "time")[used.index(n)]
                raise DataError(f"{self.path}: column '{n}' is the {what} (--{what}), and has no other role")
            if n not in self.columns and n not in self.unread:
                raise self._absent(n, "--role")
        return roles

    def _absent(self, name: str, option: str) -> DataError:
        """Return the error for a column that is not there."""
        alike = get_close_matches(name, [*self.columns, *self.unread], n=1)
        meant = f", did you mean '{alike[0]}'?" if alike else ""
        return DataError(
            f"{self.path}: no column '{name}'{meant or ';'} there are {self.listing}; choose with {option}"
        )

    def aside(self, used: set[str | None], cut: slice) -> tuple[str, ...]:
        """Return the names, as channels, of the signals that are not used: no text, no constant, no clock."""
        found = [n for n in self.unread if n and n not in used]
        for n in (n for n in self.columns if n and n not in used):
            values, text = self._parsed(n, cut)
            steps = np.diff(values[np.isfinite(values)])
            if text is None and steps.any() and not steps.max() < 2 * steps.min():
                found.append(n)
        return tuple(map(channel_name, found))

    def complete(self, names: Sequence[str], stamps: Sequence[str], cut: slice) -> NDArray[np.bool_]:
        """Rows of `cut` to keep: in which no stamp is empty, NaN or infinite, and no longer run of the named columns.

        In a short run `numbers` fills what is missing and leaves the other columns as they are; both are noted.
        """
        whole, timed = (np.ones(cut.stop - cut.start, dtype=bool) for _ in range(2))
        for n in stamps:
            if (dates := self._dates(n, cut)) is not None:
                timed &= np.isfinite(dates)
        for n, known in (*((n, whole) for n in names), *((n, timed) for n in stamps)):
            values, text = self._parsed(n, cut)
            if values.size == known.size and text is None:
                known &= np.isfinite(values)
        near = np.diff(np.flatnonzero(np.concatenate([[True], whole, [True]])))  # rows from one whole one to the next
        keep = timed.copy()
        for begin, rows in zip(np.cumsum(near) - near, near, strict=True):
            if rows > GAP or begin == 0 or begin + rows > whole.size:  # at the ends nothing tells what was there
                keep[begin : begin + rows - 1] = False
        filled = "filled there by linear interpolation"
        for lost, how in ((np.flatnonzero(~keep), "dropped"), (np.flatnonzero(keep & ~whole), filled)):
            if lost.size:
                self.notes.append(
                    f"{lost.size} row(s) with missing or infinite values are {how}, the first in "
                    f"{self.where(cut.start + int(lost[0]))}"
                )
        if np.sum(keep & whole) < 2:
            raise DataError(
                f"{self.path}: {np.sum(keep & whole)} complete row(s) of {keep.size}; at least 2 are needed"
            )
        return keep

    def numbers(self, name: str, option: str, cut: slice, keep: NDArray[np.bool_] | None = None) -> Vector:
        """Column `name` within `cut`, and of the rows to `keep`, as a finite (N,) array."""
        if name not in self.columns:
            raise self._absent(name, option)
        if name in self.repeated:
            raise DataError(f"{self.path}: two columns are named '{name}'; rename one, or choose another with {option}")
        raw = self.columns[name][cut]
        values, text = self._parsed(name, cut)
        if text is not None:
            raise DataError(
                f"{self.path}: column '{name}' has text in {self.where(cut.start + text)}: {str(raw[text])!r}; correct "
                f"it, {'leave the row out with --rows, ' if '--rows' in self.offers else ''}or choose another column "
                f"with {option}"
            )
        if raw.dtype.kind == "b" or (raw.dtype.kind == "O" and any(isinstance(x, bool) for x in raw)):
            self.notes.append(f"column '{name}' holds True and False, read as 1 and 0")
        if keep is not None and keep.size == values.size:
            values = values[keep]
            known = np.flatnonzero(np.isfinite(values))
            values = np.interp(np.arange(values.size), known, values[known]) if known.size else values
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise DataError(
                f"{self.path}: column '{name}' has {bad.size} missing or infinite value(s), the first in "
                f"{self.where(cut.start + int(bad[0]))}; {self._repair}"
            )
        check_size(values, f"{self.path}: column '{name}'")
        return values

    def time(self, t: str | None, Ts: float | None, cut: slice, keep: NDArray[np.bool_] | None = None) -> Grid | None:
        """Time grid of the rows (of those to `keep`), None where nothing says the time."""
        kept = np.arange(cut.start, cut.stop) if keep is None else cut.start + np.flatnonzero(keep)
        if Ts is not None:
            if t in self.columns:
                self.notes.append(f"time column '{t}' not used, Ts = {check_step(Ts):.10g} s was given")
            if kept.size == cut.stop - cut.start:
                return uniform_time(kept.size, check_step(Ts), cut.start)
            return regular_time(kept * check_step(Ts), lambda i: self.where(int(kept[i])), f"{self.path}: ")
        if t is None or t not in self.columns:
            return None
        dates, own = self._dates(t, cut), "s"
        if dates is None:
            stamps, own = self.numbers(t, "--time", cut, keep), self.unit(t) or _ending(t)
        else:
            stamps = dates if keep is None else dates[keep]
            if not np.isfinite(stamps).all():
                raise DataError(f"{self.path}: column '{t}' has rows without a date; {self._repair}")
            stamps = stamps - stamps[0]
            self.notes.append(f"time column '{t}' holds dates, read as seconds since the first one")
        if own != "s":
            seconds = converted(stamps, own, "s")
            if seconds is None:
                raise DataError(f"{self.path}: the time column '{t}' is in {own}, not in s; give --ts SECONDS")
            self.notes.append(f"time column '{t}' is converted from {own} to s")
            stamps = seconds
        return regular_time(stamps, lambda i: self.where(int(kept[i])), f"{self.path}: column '{t}', ")

    def _dates(self, t: str, cut: slice) -> Vector | None:
        """Return a column of dates in s from the first, NaN where one is missing; None where it begins with numbers."""
        values, text = self._parsed(t, cut)
        if text is None or np.isfinite(values[:text]).any():
            return None
        import pandas as pd

        given = pd.Series(self.columns[t][cut])
        dates = (_turned(given, order) for order in ((), (2, 1), (1, 2)))  # as they stand; the day, the month first
        ways: Any = (partial(pd.to_datetime, x, format="ISO8601", utc=True, errors="coerce") for x in dates)
        read, bad = [], []
        for way in chain(ways, [partial(pd.to_timedelta, given, errors="coerce")]):  # then hours, minutes and seconds
            read.append(way())
            bad.append(np.flatnonzero(read[-1].isna() & given.notna()))
            if not bad[0].size:
                break
        least = min(bad, key=len)
        if least.size:
            raise DataError(
                f"{self.path}: the time column '{t}' holds text such as {str(given[least[0]])!r} in "
                f"{self.where(cut.start + int(least[0]))}: write numbers (seconds) or dates as 2024-10-27T00:59:50, or "
                "ignore the column with --ts SECONDS"
            )
        stamps, *others = (x - x.min() for x, wrong in zip(read, bad, strict=True) if not wrong.size)
        if not all(stamps.equals(x) for x in others):
            raise DataError(
                f"{self.path}: {str(given[0])!r} in the time column '{t}' may begin with the day or with the month: "
                "write dates as 2024-10-27T00:59:50, or ignore the column with --ts SECONDS"
            )
        return np.asarray(stamps.dt.total_seconds(), dtype=np.float64)

    @property
    def _repair(self) -> str:
        """What can be done about missing values."""
        ways = {"--rows": "leave the rows out with --rows A:B", "--missing": "drop them with --missing drop"}
        *first, last = "repair them", *(way for option, way in ways.items() if option in self.offers)
        return f"{', '.join(first)}{',' if len(first) > 1 else ''} or {last}" if first else last

    def _parsed(self, column: str, cut: slice) -> tuple[Vector, int | None]:
        """Return the numbers of a column, NaN where there is none, and the position of the first text in it."""
        raw = self.columns.get(column, np.zeros(0))[cut]
        if raw.dtype.kind in "fiub":
            return raw.astype(np.float64), None
        values, text = np.full(raw.size, np.nan), None
        for i, x in enumerate(raw):
            try:
                values[i] = x.replace(".", "?").replace(",", ".") if isinstance(x, str) and self.decimal == "," else x
            except (TypeError, ValueError):
                text = i if text is None else text
        return values, text


def _turned(given: Any, order: tuple[int, ...]) -> Any:
    """Write dates that end in the year with the year first, then the parts that `order` names: the month, the day."""
    if not order:
        return given
    month, day = order
    return given.str.replace(YEAR_LAST, lambda x: f"{x[3]}-{x[month]:0>2}-{x[day]:0>2}", regex=True)


def _ending(t: str) -> str:
    """Return the unit that a time column is named after, as t_ms; seconds where it is none."""
    found = re.fullmatch(r".*_(ns|us|µs|ms|min|h)", t)
    return found[1] if found else "s"


def wants_all(wanted: str | Sequence[str]) -> bool:
    """Whether all further columns are asked for; a list names its columns."""
    return isinstance(wanted, str) and ALL in names_of(wanted)


def names_of(wanted: str | Sequence[str]) -> list[str]:
    """Return the names of a list, or of a text with commas."""
    return [n.strip() for n in wanted.split(",") if n.strip()] if isinstance(wanted, str) else list(wanted)


def check_size(x: Vector, where: str) -> None:
    """Refuse values whose squares would leave the floating-point numbers."""
    size = float(max(np.max(x, initial=0.0), -np.min(x, initial=0.0)))
    if size > LARGEST or 0 < size < 1 / LARGEST:
        raise DataError(f"{where} has values of the size {size:.3g}; choose another unit")


def _rows(rows: slice | str | None, path: str) -> slice:
    """`rows` as a slice; text is "A:B", either end may be left out."""
    if rows is None or isinstance(rows, slice):
        return rows or slice(None)
    match = re.fullmatch(r"\s*(-?\d*)\s*:\s*(-?\d*)\s*", rows)
    try:
        ends = [int(e) if e else None for e in match.groups()] if match else None
    except ValueError:
        ends = None
    if ends is None:
        raise DataError(f"{path}: cannot read the rows '{rows}'; write --rows A:B, counted from 0, such as 20:5000")
    return slice(*ends)
