"""Writing files: each appears whole or not at all."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .errors import DataError

PathLike = str | os.PathLike[str]


def write_csv(path: PathLike, columns: Mapping[str, Any]) -> None:
    """Write (N,) columns with 10 significant digits; the file appears whole or not at all."""
    arrays = {n: np.asarray(a, dtype=np.float64).reshape(-1) for n, a in columns.items()}
    if len({a.size for a in arrays.values()}) != 1:
        raise DataError(
            f"{os.fspath(path)}: the columns must have equal lengths, not "
            + ", ".join(f"{n}: {a.size}" for n, a in arrays.items())
        )
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(arrays)
    np.savetxt(text, np.column_stack(list(arrays.values())), fmt="%.10g", delimiter=",")
    write_text(path, text.getvalue())


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
    target = Path(path)
    if not target.parent.is_dir():
        raise DataError(f"{target}: the folder {target.parent} does not exist; make it first")
    if target.is_dir():
        raise DataError(f"{target}: is a folder; give a file name")
    # The same folder, because a rename is atomic only within one file system.
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        os.replace(part, target)
    except OSError as error:
        raise DataError(
            f"{target}: cannot be written ({error.strerror or error}); check the folder's permissions"
        ) from None
    finally:
        part.unlink(missing_ok=True)
