"""Files to raw columns: CSV in its dialects, .npz, .mat, .parquet, logs; never pickled objects."""

from __future__ import annotations

import csv
import io
import math
import os
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..files.atomic import COLUMNS
from .logs import MATLAB_NUMBERS, load_mat73, load_mdf, load_tdms
from .tables import PathLike, Table, check_bytes, readable
from .units import bare, headed, is_unit

LONGEST_HEADER = 1_000_000  # characters
SHORT = 5_000_000  # bytes of a table that NumPy reads before pandas were loaded
FIRST_LINES = 200  # in which numbers must begin, for names below other lines to be seen
EXCEL = re.compile(r'"?sep=."?', re.IGNORECASE)  # its first line, which says the separator
NUMBER = re.compile(r"[+-]?(\d*[.,]?\d+|\d+[.,])([eE][+-]?\d+)?")
DATE = re.compile(r"\d{1,4}[-/.:]\d{1,2}[-/.:][-\d/.:TZ+ ]+")


def load(path: PathLike, wanted: Collection[str] | None = None) -> Table:
    """All columns of a file, by its suffix; of a log only those that are `wanted`, where that is said."""
    name, suffix = os.fspath(path), Path(path).suffix.lower()
    if Path(path).is_dir():
        raise DataError(f"{name}: is a folder; give a data file")
    if not Path(path).exists():
        raise DataError(f"{name}: no such file; check the name and the folder")
    if suffix not in READERS:
        raise DataError(f"{name}: unknown kind of file '{suffix}'; use one of {' '.join(sorted(READERS))}")
    try:
        if Path(path).stat().st_size == 0:
            raise DataError(f"{name}: the file is empty; write a header such as t,u,y and the data below it")
        return READERS[suffix](name, wanted)
    except OSError as error:
        raise DataError(
            f"{name}: cannot be read ({error.strerror or error}); check the file and its permissions"
        ) from None


def _load_text(name: str, wanted: Collection[str] | None) -> Table:
    """Text with a header line; separator, decimal sign and encoding are found out."""
    raw, notes = _decode(Path(name).read_bytes(), name)
    raw = re.sub(rb"(?m)^[ \t\f\v]+$", b"", raw)  # lines of blanks are empty
    first, top, start = _header(name, raw, notes)
    body = raw[start:]
    del raw  # a record of ten million samples is large
    above = body.split(b"\n", FIRST_LINES)[:FIRST_LINES]
    lines = [top, *(line.decode() for line in above)]
    at, of_units, data = _names(lines)
    body = body[sum(len(line) + 1 for line in above[: data - 1]) :]
    top = lines[at]
    if at:
        notes.append(f"the text above the column names in line {first + at} is skipped")
    below = re.search(rb"[^\n]+", body)
    sep = _separator([top, below[0].decode()] if below else [top])
    header = _fields(top, sep)
    if all(map(NUMBER.fullmatch, header)):
        raise DataError(
            f"{name}: line {first} has numbers where the column names should be; add a header such as t,u,y"
        )
    units = dict(zip(header, map(bare, _fields(lines[of_units], sep)), strict=False)) if of_units else {}
    units = {column: label for column, label in units.items() if column and label}
    if units:
        told = ", ".join(headed(column, label) for column, label in units.items())
        notes.append(f"line {first + of_units} has the units: {told}")
    body = _without_comments(body, sep, len(header), notes)
    ends = np.flatnonzero(np.frombuffer(body, dtype=np.uint8) == ord("\n"))
    edges = np.concatenate(([0], ends + 1))
    full = np.flatnonzero(np.diff(np.append(edges, len(body) + 1)) > 1)  # the lines that are not empty
    decimal = "," if sep != "," and re.search(rb"(?:^|[;\t ])[ \"]*[+-]?\d*,\d", body, re.M) else "."
    numbers = first + data + full
    found = _columns(name, body, sep, decimal, len(header))
    if len(found[0]) != full.size:
        raise DataError(f"{name}: {full.size} lines of data give {len(found[0])} rows; check the quotes")
    beyond = [x == x for x in found[len(header) :]]  # what is missing is no equal
    for row in np.flatnonzero(np.any(beyond, axis=0))[:1]:
        fields = len(header) + max(i for i, there in enumerate(beyond, 1) if there[row])
        raise DataError(
            f"{name}: line {numbers[row]} has {fields} values but the header has {len(header)} names; "
            "correct the line (a decimal comma needs semicolons between the columns)"
        )
    columns: dict[str, Any] = {}
    for h, x in zip(header, found, strict=False):
        columns.setdefault(h, x)
    repeated = frozenset(h for h, count in Counter(header).items() if count > 1)
    return Table(name, columns, numbers, first + at, notes, repeated, decimal, units=units)


def _decode(raw: bytes, name: str) -> tuple[bytes, list[str]]:
    """UTF-8 with plain line ends, and a note where the file was something else."""
    notes = []
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raw, notes = raw.decode("utf-16", errors="replace").encode(), ["the file is UTF-16 text, not UTF-8"]
    if re.search(rb"[\x00-\x08\x0e-\x1f]", raw):
        raise DataError(f"{name}: holds binary data, not text; export it as CSV")
    if not raw.isascii():
        try:
            raw = raw.removeprefix(b"\xef\xbb\xbf")
            raw.decode("utf-8")
        except UnicodeDecodeError:
            if len(re.sub(rb"[\x80-\xff]+", b"", raw)) < 0.7 * len(raw):
                raise DataError(f"{name}: holds binary data, not text; export it as CSV") from None
            raw = raw.decode("latin-1").encode()
            notes.append("the file is not UTF-8; read as Latin-1, so check names with special letters")
    return raw.replace(b"\r\n", b"\n").replace(b"\r", b"\n"), notes


def _header(name: str, raw: bytes, notes: list[str]) -> tuple[int, str, int]:
    """Return number and text of the line with the names, and where the data start; comments above it are noted."""
    number, start, comment, comments = 0, 0, "", 0
    while start < len(raw):
        end = raw.find(b"\n", start)
        end = len(raw) if end < 0 else end
        line, number = raw[start : min(end, start + LONGEST_HEADER + 1)].decode("utf-8", "replace"), number + 1
        if len(line) > LONGEST_HEADER:
            raise DataError(
                f"{name}: line {number} has more than {LONGEST_HEADER} characters; this is no header of names"
            )
        if number == 1 and EXCEL.fullmatch(line.strip()):
            start = end + 1
            continue
        if line.strip() and line.lstrip()[0] not in "#%":
            break
        if line.strip():
            comment, comments = line, comments + 1
        start = end + 1
    else:
        raise DataError(f"{name}: the file is empty; write a header such as t,u,y and the data below it")
    if comments and re.fullmatch(r"[-+0-9.eE,; \t]+", line):  # names behind the mark, as numpy.savetxt writes them
        return number - 1, comment.lstrip(" #%"), start
    if comments:
        notes.append(f"{comments} line(s) of comments above the header are skipped")
    return number, line, end + 1


def _fields(line: str, sep: str) -> list[str]:
    """Return the fields of a line."""
    try:
        return [x.strip() for x in (line.split() if sep == " " else next(csv.reader([line], delimiter=sep)))]
    except csv.Error:  # a field that is too long
        return line.split(sep)


def _number(field: str) -> bool:
    """Whether a field may stand in a line of numbers: a number, a date, or none that is missing."""
    return field.lower() in ("", "nan", "inf", "-inf") or bool(NUMBER.fullmatch(field) or DATE.fullmatch(field))


def _names(lines: Sequence[str]) -> tuple[int, int, int]:
    """Return in which of some lines the names, their units (0: in none) and the first data are.

    Above the first line of numbers, lines of text with as many fields begin with the names; one of the others that
    mostly names units has the units. What stands above the names is a preamble. Where nothing is found, the first line
    has the names.
    """
    full = [i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"]
    for at, i in enumerate(full[1:], 1):
        sep = _separator([lines[full[at - 1]], lines[i]])
        row, *above = (_fields(lines[n], sep) for n in (i, *reversed(full[:at])))
        texts = list(takewhile(lambda one: len(one) == len(above[0]) and _texts(one), above))  # noqa: B023
        if len(_filled(row)) > 1 and all(map(_number, row)) and texts and len(_filled(texts[-1])) >= len(_filled(row)):
            names = full[at - len(texts)]
            units = next((full[at - 1 - n] for n, one in enumerate(texts[:-1]) if _labels(one)), 0)
            if not names or len(set(_filled(texts[-1]))) == len(_filled(texts[-1])):
                return names, units, i if units else names + 1
    return 0, 0, 1


def _filled(fields: Sequence[str]) -> list[str]:
    """Return the fields that are not empty: some files pad all lines with separators."""
    return [field for field in fields if field]


def _texts(fields: Sequence[str]) -> bool:
    """Whether a line has text, and no number."""
    return not any(map(_number, _filled(fields) or [""]))


def _labels(fields: Sequence[str]) -> bool:
    """Whether most of the fields that are not empty are units."""
    said = list(map(bare, _filled(fields)))
    return 2 * sum(map(is_unit, said)) > len(said)


def _without_comments(body: bytes, sep: str, width: int, notes: list[str]) -> bytes:
    """Return the data with empty lines for comments: what begins with a mark and has fewer fields than the header."""
    count = 0

    def emptied(line: re.Match[bytes]) -> bytes:
        nonlocal count
        if sep != " " and line[0].count(sep.encode()) >= width - 1:
            return line[0]
        count += 1
        return b""

    if b"#" in body or b"%" in body:
        body = re.sub(rb"(?m)^[ \t]*[#%].*$", emptied, body)
    if count:
        notes.append(f"{count} line(s) of comments below the header are skipped")
    return body


def _separator(lines: Sequence[str]) -> str:
    """Semicolon, tab, comma or blanks; a comma counts last because it may be the decimal sign."""
    header = re.sub(r'"[^"]*"', "", lines[0])
    for sep in (";", "\t", ","):
        if sep in header:
            return sep
    # Blanks separate only where the data has them too: a single column may be named "my signal".
    return " " if len(header.split()) > 1 and len(lines) > 1 and len(lines[1].split()) > 1 else ","


def _columns(name: str, body: bytes, sep: str, decimal: str, width: int) -> list[Any]:
    """Return the columns of the lines of data, as wide as the widest line: what stands beyond the header is seen there.

    NumPy reads a table of numbers alone, and pandas any other: it takes as long to load as a short table to read.
    """
    first = re.search(rb"[^\n]+", body)
    if first is None:
        return [np.zeros(0)] * width
    if len(body) < SHORT and (decimal == "." or b"." not in body):
        with suppress(ValueError):
            plain = body.replace(b",", b".") if decimal == "," else body
            table = np.loadtxt(io.BytesIO(plain), delimiter=None if sep == " " else sep, comments=None, ndmin=2)
            if table.shape[1] >= width:
                return list(np.ascontiguousarray(table.T))
    import pandas as pd

    width = max(width, len(_fields(first[0].decode(), sep)))
    while True:
        try:
            frame = pd.read_csv(
                io.BytesIO(body),
                sep=r"\s+" if sep == " " else sep,
                decimal=decimal,
                header=None,
                names=range(width),
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
            )
            break
        except (pd.errors.ParserError, ValueError) as error:
            wider = re.search(r"saw (\d+)", str(error))
            if wider is None:
                raise DataError(f"{name}: cannot be read as a table ({error}); check the quotes") from None
            width = int(wider[1])
    numeric = pd.api.types.is_numeric_dtype
    return [frame[i].to_numpy(dtype=None if numeric(frame[i].dtype) else object) for i in frame.columns]


def _load_npz(name: str, wanted: Collection[str] | None) -> Table:
    """Vectors of a NumPy archive; pickled objects are refused."""
    with readable(name, ".npz", "save plain arrays with numpy.savez"):
        _check_archive(name)
        with np.load(name, allow_pickle=False) as archive:
            return _from_variables(name, {n: archive[n] for n in archive.files})


def _check_archive(name: str) -> None:
    """Refuse what is no archive, and one that would fill the memory when it is unpacked."""
    with zipfile.ZipFile(name) as archive:
        size = sum(one.file_size for one in archive.infolist())
    check_bytes(name, size, "unpack only what is needed")


def _load_mat(name: str, wanted: Collection[str] | None) -> Table:
    """Vectors of a MATLAB file."""
    from scipy.io import loadmat, whosmat

    with readable(name, ".mat", "save it with save(..., '-v7')"):
        try:
            found = whosmat(name)
        except NotImplementedError:
            return load_mat73(name, wanted)
        plain = [n for n, _, kind in found if kind in MATLAB_NUMBERS]
        size = 8 * sum(math.prod(shape) for n, shape, _ in found if n in plain)
        check_bytes(name, size, "save fewer variables")
        variables = loadmat(name, variable_names=plain)
        variables |= {
            n: np.empty(shape, dtype=[]) for n, shape, _ in found if n not in plain and math.prod(shape) < 1e6
        }
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
    return Table(name, vectors, notes=notes)


def _load_parquet(name: str, wanted: Collection[str] | None) -> Table:
    """Columns of a Parquet file, where its reader is installed."""
    import pandas as pd

    try:
        frame = pd.read_parquet(name)
    except ImportError:
        raise DataError(
            f'{name}: reading .parquet needs pyarrow; install it (pip install "narx-sym[parquet]") or use CSV'
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


READERS: dict[str, Callable[[str, Collection[str] | None], Table]] = {
    **dict.fromkeys(COLUMNS, _load_text), ".npz": _load_npz, ".mat": _load_mat, ".parquet": _load_parquet,
    ".mf4": load_mdf, ".mdf": load_mdf, ".tdms": load_tdms,
}  # fmt: skip
