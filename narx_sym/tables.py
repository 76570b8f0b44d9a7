"""Files of measurements as raw columns: CSV in its dialects, .npz, .mat, .parquet; never pickled objects."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import DataError
from .signals import plain_name
from .timegrid import Grid, Vector, check_step, regular_time, uniform_time

PathLike = str | os.PathLike[str]


@dataclass
class Table:
    """Raw columns of a file; each is checked only when it is asked for."""

    path: str
    columns: dict[str, NDArray[Any]]
    lines: list[int] | None = None  # line number in the file of each data row, for text files
    notes: list[str] = field(default_factory=list)
    repeated: frozenset[str] = frozenset()
    decimal: str = "."

    @property
    def listing(self) -> str:
        """The columns there are, for messages."""
        return "the columns " + ", ".join(n for n in self.columns if n)

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

    def channels(self, wanted: str | Sequence[str], used: set[str | None], cut: slice) -> list[str]:
        """Names of the further columns; "all" leaves out text, and says so; `plain_name` of a column finds it too."""
        if wanted != "all":
            listed = [n.strip() for n in wanted.split(",") if n.strip()] if isinstance(wanted, str) else list(wanted)
            plain = {plain_name(n): n for n in self.columns if n}
            names = list(dict.fromkeys(n if n in self.columns else plain.get(n, n) for n in listed))
        else:
            names = [n for n in self.columns if n and n not in used]
            for n in [n for n in names if self._first_text(self.columns[n][cut]) is not None]:
                self.notes.append(f"column '{n}' holds text and is left out of the channels")
                names.remove(n)
        called: dict[str, str] = {}
        for n in names:
            other = called.setdefault(plain_name(n), n)
            if other != n:
                raise DataError(
                    f"{self.path}: as channels the columns '{other}' and '{n}' would both be called {plain_name(n)}; "
                    "rename one, or leave it out with --channels"
                )
            if plain_name(n) != n:
                self.notes.append(f"column '{n}' is the channel {plain_name(n)}")
        return names

    def numbers(self, name: str, option: str, cut: slice) -> Vector:
        """Column `name` within `cut` as a finite (N,) array."""
        if name not in self.columns:
            raise DataError(f"{self.path}: no column '{name}'; there are {self.listing}; choose with {option}")
        if name in self.repeated:
            raise DataError(f"{self.path}: two columns are named '{name}'; rename one, or choose another with {option}")
        raw = self.columns[name][cut]
        text = self._first_text(raw)
        if text is not None:
            raise DataError(
                f"{self.path}: column '{name}' has text in {self.where(cut.start + text)}: "
                f"{str(raw[text])!r}; correct it, leave the row out with --rows, "
                f"or choose another column with {option}"
            )
        values: Vector = np.array([self._number(x) for x in raw] if raw.dtype.kind == "O" else raw, dtype=np.float64)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise DataError(
                f"{self.path}: column '{name}' has {bad.size} missing or infinite value(s), the first in "
                f"{self.where(cut.start + int(bad[0]))}; repair them or leave the rows out with --rows A:B"
            )
        return values

    def time(self, t: str | None, Ts: float | None, cut: slice) -> Grid | None:
        """Time grid of the rows, None where nothing says the time."""
        if Ts is not None:
            if t in self.columns:
                self.notes.append(f"time column '{t}' not used, Ts = {check_step(Ts):.10g} s was given")
            return uniform_time(cut.stop - cut.start, check_step(Ts), cut.start)
        if t is None or t not in self.columns:
            return None
        stamps = self.numbers(t, "--time", cut)
        return regular_time(stamps, lambda i: self.where(cut.start + i), f"{self.path}: column '{t}', ")

    def _number(self, x: Any) -> float:
        if isinstance(x, str) and self.decimal == ",":
            x = x.replace(".", "?").replace(",", ".")
        return float(x)

    def _first_text(self, raw: NDArray[Any]) -> int | None:
        """Position of the first entry that is no number."""
        if raw.dtype.kind in "fiub":
            return None
        for i, x in enumerate(raw):
            try:
                self._number(x)
            except (TypeError, ValueError):
                return i
        return None


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


def load(path: PathLike) -> Table:
    """All columns of a file, by its suffix."""
    name, suffix = os.fspath(path), Path(path).suffix.lower()
    readers = {
        ".npz": _load_npz,
        ".mat": _load_mat,
        ".parquet": _load_parquet,
        **dict.fromkeys((".csv", ".txt", ".tsv", ".dat"), _load_text),
    }
    if Path(path).is_dir():
        raise DataError(f"{name}: is a folder; give a data file")
    if not Path(path).exists():
        raise DataError(f"{name}: no such file; check the name and the folder")
    if suffix not in readers:
        raise DataError(f"{name}: unknown kind of file '{suffix}'; use one of {' '.join(sorted(readers))}")
    try:
        if Path(path).stat().st_size == 0:
            raise DataError(f"{name}: the file is empty; write a header such as t,u,y and the data below it")
        return readers[suffix](name)
    except OSError as error:
        raise DataError(
            f"{name}: cannot be read ({error.strerror or error}); check the file and its permissions"
        ) from None


def _load_text(name: str) -> Table:
    """Text with a header line; separator, decimal sign and encoding are found out."""
    import pandas as pd

    text, notes = _decode(Path(name).read_bytes(), name)
    numbered = [(i, s) for i, s in enumerate(re.split(r"\r\n|\r|\n", text), 1) if s.strip()]
    if not numbered:
        raise DataError(f"{name}: the file is empty; write a header such as t,u,y and the data below it")
    numbers, lines = zip(*numbered, strict=True)
    sep = _separator(lines)
    header = [h.strip() for h in (lines[0].split() if sep == " " else next(csv.reader([lines[0]], delimiter=sep)))]
    if all(re.fullmatch(r"[+-]?\d*[.,]?\d+([eE][+-]?\d+)?", h) for h in header):
        raise DataError(
            f"{name}: line {numbers[0]} has numbers where the column names should be; add a header such as t,u,y"
        )
    body = "\n".join(lines[1:])
    decimal = "," if sep != "," and re.search(r"(?:^|[;\t ])[ \"]*[+-]?\d*,\d", body, re.M) else "."
    width = _check_width(name, numbers, lines, sep, len(header))
    frame = pd.DataFrame()
    if body:
        try:
            frame = pd.read_csv(
                io.StringIO(body),
                sep=r"\s+" if sep == " " else sep,
                decimal=decimal,
                header=None,
                names=range(width),
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
            )
        except (pd.errors.ParserError, ValueError) as error:
            raise DataError(f"{name}: cannot be read as a table ({error}); check the quotes") from None
    columns = {}
    for i, h in reversed(list(enumerate(header))):
        column = frame[i] if body else pd.Series([], dtype=float)
        numeric = pd.api.types.is_numeric_dtype(column.dtype)
        columns[h] = column.to_numpy(dtype=None if numeric else object)
    repeated = frozenset(h for h in header if header.count(h) > 1)
    return Table(name, {h: columns[h] for h in header}, list(numbers[1:]), notes, repeated, decimal)


def _decode(raw: bytes, name: str) -> tuple[str, list[str]]:
    """Text of the bytes, and a note where it is not UTF-8."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace"), ["the file is UTF-16 text, not UTF-8"]
    if b"\0" in raw:
        raise DataError(f"{name}: holds binary data, not text; export it as CSV")
    try:
        return raw.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        return raw.decode("latin-1"), ["the file is not UTF-8; read as Latin-1, so check names with special letters"]


def _separator(lines: Sequence[str]) -> str:
    """Semicolon, tab, comma or blanks; a comma counts last because it may be the decimal sign."""
    header = re.sub(r'"[^"]*"', "", lines[0])
    for sep in (";", "\t", ","):
        if sep in header:
            return sep
    # Blanks separate only where the data has them too: a single column may be named "my signal".
    return " " if len(header.split()) > 1 and len(lines) > 1 and len(lines[1].split()) > 1 else ","


def _check_width(name: str, numbers: Sequence[int], lines: Sequence[str], sep: str, width: int) -> int:
    """Widest line in fields; refuse a line with more values than the header has names."""
    for number, line in zip(numbers, lines, strict=True):
        if '"' in line:
            continue  # a quoted field may hold the separator
        fields = len(line.split()) if sep == " " else line.rstrip(sep + " ").count(sep) + 1
        if fields > width:
            raise DataError(
                f"{name}: line {number} has {fields} values but the header has {width} names; "
                "correct the line (a decimal comma needs semicolons between the columns)"
            )
    return width if sep == " " else max(width, max(s.count(sep) + 1 for s in lines))


def _load_npz(name: str) -> Table:
    """Vectors of a NumPy archive; pickled objects are refused."""
    try:
        with np.load(name, allow_pickle=False) as archive:
            return _from_variables(name, {n: archive[n] for n in archive.files})
    except DataError:
        raise
    except Exception as error:  # a damaged archive raises many kinds
        raise DataError(f"{name}: cannot be read as .npz ({error}); save plain arrays with numpy.savez") from None


def _load_mat(name: str) -> Table:
    """Vectors of a MATLAB file up to version 7."""
    from scipy.io import loadmat

    try:
        variables = loadmat(name)
    except NotImplementedError:
        raise DataError(f"{name}: is a MATLAB v7.3 file, which cannot be read; save it with save(..., '-v7')") from None
    except Exception as error:  # a damaged file raises many kinds
        raise DataError(f"{name}: cannot be read as .mat ({error}); save it with save(..., '-v7')") from None
    return _from_variables(name, {n: a for n, a in variables.items() if not n.startswith("__")})


def _from_variables(name: str, variables: Mapping[str, Any]) -> Table:
    """Take the vectors among named arrays; others are left out with a note."""
    arrays = {n: np.asarray(a) for n, a in variables.items()}
    vectors = {
        n: a.ravel() for n, a in arrays.items() if a.size > 1 and a.size == max(a.shape) and a.dtype.kind in "fiub"
    }
    others = [f"{n} {a.shape}" for n, a in arrays.items() if n not in vectors]
    notes = ["not a vector of real numbers, left out: " + ", ".join(others)] if others else []
    if not vectors:
        raise DataError(f"{name}: holds no vector of real numbers; " + "; ".join(notes or ["it is empty"]))
    return Table(name, vectors, None, notes)


def _load_parquet(name: str) -> Table:
    """Columns of a Parquet file, where its reader is installed."""
    import pandas as pd

    try:
        frame = pd.read_parquet(name)
    except ImportError:
        raise DataError(
            f"{name}: reading .parquet needs pyarrow; install it (pip install pyarrow) or use CSV"
        ) from None
    except Exception as error:  # each reader has its own errors
        raise DataError(f"{name}: cannot be read as .parquet ({error})") from None
    numeric = {c: pd.api.types.is_numeric_dtype(frame[c].dtype) for c in frame.columns}
    return Table(
        name,
        {
            str(c): frame[c].to_numpy(dtype=float, na_value=np.nan) if numeric[c] else frame[c].to_numpy(dtype=object)
            for c in frame.columns
        },
    )
