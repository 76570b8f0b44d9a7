"""Writing files: each appears whole or not at all."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError

PathLike = str | os.PathLike[str]
COLUMNS = (".csv", ".txt", ".tsv", ".dat")  # files that are read as text


def write_csv(path: PathLike, columns: Mapping[str, Any]) -> None:
    """Write (N,) columns with 10 significant digits; the file appears whole or not at all."""
    check_columns(path)
    write_text(path, columns_text(columns, os.fspath(path)))


def check_columns(path: PathLike | None) -> None:
    """Refuse a name that ends as another kind of file does: columns of text would not be read again."""
    if path is not None and Path(path).suffix.lower() not in ("", *COLUMNS):
        raise DataError(f"{path}: columns are written as text; give a name that ends in {', '.join(COLUMNS)}.")


def columns_text(columns: Mapping[str, Any], name: str) -> str:
    """Return (N,) columns of numbers with 10 significant digits as CSV; `name` stands in errors."""
    arrays = {n: np.asarray(a, dtype=np.float64).reshape(-1) for n, a in columns.items()}
    if len({a.size for a in arrays.values()}) != 1:
        raise DataError(
            f"{name}: the columns must have equal lengths, not "
            + ", ".join(f"{n}: {a.size}" for n, a in arrays.items())
        )
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(arrays)
    np.savetxt(text, np.column_stack(list(arrays.values())), fmt="%.10g", delimiter=",")
    return text.getvalue()


def csv_text(columns: Mapping[str, Any]) -> str:
    """Return (N,) columns of numbers (6 significant digits) or texts as CSV."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        table.writerow([f"{x:.6g}" if isinstance(x, (float, np.floating)) else x for x in row])
    return text.getvalue()


def write_text(path: PathLike, text: str) -> None:
    """Write UTF-8 text; the file appears whole or not at all."""
    write_bytes(path, text.encode("utf-8"))


def write_figure(figure: Any, path: PathLike, dpi: int = 150) -> None:
    """Write a picture in the format of its suffix; the file appears whole or not at all."""
    raw, suffix = io.BytesIO(), Path(path).suffix.lstrip(".").lower()
    try:
        figure.savefig(raw, dpi=dpi, format=suffix or None)
    except ValueError as error:
        raise DataError(f"{os.fspath(path)}: {str(error)[:300]}") from None
    write_bytes(path, raw.getvalue())


def write_bytes(path: PathLike, raw: bytes) -> None:
    """Write a file under a temporary name beside the old one, flush it to the disk, and rename it.

    Whatever stops it (Ctrl-C, kill -9, a full disk) leaves the old file or the new one. A link is followed, the old
    file's permissions are kept, and what is no file (`/dev/stdout`, a pipe) is written to, never replaced.

    Raises
    ------
    DataError
        Where the folder is missing, the target is a folder, or the system refuses.
    """
    target = check_path(path)
    part, old = _part(target), target.exists()
    try:
        if target.exists() and not target.is_file():
            target.write_bytes(raw)
            return
        try:
            with part.open("wb") as file:
                file.write(raw)
                file.flush()
                os.fsync(file.fileno())
            if target.exists():
                os.chmod(part, target.stat().st_mode & 0o7777)
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        left = ", the file is as it was" if old else ""
        raise DataError(
            f"{os.fspath(path)}: cannot be written ({error.strerror or error}){left}; check the folder's space and "
            "permissions"
        ) from None


def _part(target: Path) -> Path:
    """Return the temporary name: in the same folder, because a rename is atomic only within one file system."""
    return target.with_name(f".{target.name[:200]}.{os.getpid()}.part")


def check_path(path: PathLike) -> Path:
    """Return where a file would be written, links followed; refuse what cannot be: it is tried with an empty file."""
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise DataError(f"{os.fspath(path)}: the folder {Path(path).parent} does not exist; make it first")
    if target.is_dir():
        raise DataError(f"{os.fspath(path)}: is a folder; give a file name")
    if target.is_file() or not target.exists():
        try:
            _part(target).open("wb").close()
            _part(target).unlink()
        except OSError as error:
            why = error.strerror or error
            raise DataError(
                f"{os.fspath(path)}: the folder {Path(path).parent} is not writable ({why}); choose another"
            ) from None
    return target
