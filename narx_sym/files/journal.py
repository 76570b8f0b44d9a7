"""Long work that may be interrupted: each result is kept in a file as soon as it is there, and found again.

    with ns.resuming("run.jsonl"):
        found = ns.diagnose(model, record, max_effects=3)

Sweeps, multi-starts, bootstraps and the fits of a diagnosis look here first. A result is found by a digest of all
that it depends on: the function, its arguments with all data, the code of this package, the versions of its libraries.
So a resumed run gives what the uninterrupted one gives, byte for byte, and a result of other data is never taken.
"""

from __future__ import annotations

import base64
import hashlib
import inspect
import json
import math
import os
import platform
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from ..errors import DataError, FitError
from ..models.model import Model
from .atomic import PathLike, check_path, write_text

FORMAT = 1
LIBRARIES = ("numpy", "scipy", "sympy", "llvmlite")
_active: ContextVar[Journal | None] = ContextVar("journal", default=None)


class Passing(dict[str, Any]):
    """A result that is not kept, as after an error that need not come again: a resumed run computes it once more."""


class Journal:
    """A file of results: a first line that says what wrote it, then one JSON line each.

    A line that a crash left half written is dropped when the file is opened; a line that was changed is not believed.

    Attributes
    ----------
    found : int
        Results that were taken from the file.
    """

    def __init__(self, path: PathLike):
        self.path, self.found = check_path(path), 0
        self._values: dict[str, Any] = {}
        head = json.dumps({"narx_sym_journal": FORMAT, "code": code()})
        try:
            lines = self.path.read_text(encoding="utf-8").split("\n") if self.path.exists() else []
        except (OSError, UnicodeDecodeError) as error:
            raise DataError(f"{path}: cannot be read as a journal ({error}); name another file") from None
        if any(lines):
            first = _object(lines[0])
            if first.get("narx_sym_journal") != FORMAT:
                raise DataError(f"{path}: is no journal of results; name another file")
            if lines[0] != head:
                raise DataError(
                    f"{path}: was written by another version of narx_sym or of its libraries; delete it to start again"
                )
        good = [line for line in lines[1:] if self._take(line)]
        if lines != [head, *good, ""]:
            write_text(self.path, "\n".join([head, *good, ""]))

    def _take(self, line: str) -> bool:
        one = _object(line)
        if one.get("sum") != _sum(one.get("key"), one.get("value")):
            return False
        self._values[one["key"]] = one["value"]
        return True

    def __len__(self) -> int:
        return len(self._values)

    def find(self, key: str, holds: Callable[[Any], bool] = lambda result: True) -> Any:
        """Return a kept result in a one-element list, or an empty list; also for one that does not hold any more."""
        if key not in self._values or not holds(result := alive(self._values[key])):
            return []
        self.found += 1
        return [result]

    def keep(self, key: str, result: Any) -> None:
        """Append a result: one line, one write; nothing of one that is `Passing`."""
        if isinstance(result, Passing):
            return
        value = plain(result)
        line = json.dumps({"key": key, "sum": _sum(key, value), "value": value}) + "\n"
        try:
            file = os.open(self.path, os.O_WRONLY | os.O_APPEND)
            try:
                os.write(file, line.encode())
            finally:
                os.close(file)
        except OSError as error:
            raise DataError(f"{self.path}: cannot be written ({error.strerror or error})") from None
        self._values[key] = value


@contextmanager
def resuming(path: PathLike) -> Iterator[Journal]:
    """Save intermediate results of long computations in a file, and reuse those that are already there.

    Raises
    ------
    DataError
        If the file is no such file, was written by another version, or cannot be written.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import narx_sym as ns
    >>> path = pathlib.Path(tempfile.mkdtemp(), "results.jsonl")
    >>> with ns.resuming(path) as journal:  # ns.diagnose(...) in here continues where it was interrupted
    ...     print(journal.found, "results were in the file")
    0 results were in the file
    """
    journal = Journal(path)
    token = _active.set(journal)
    try:
        yield journal
    finally:
        _active.reset(token)


def active() -> Journal | None:
    """Return the journal that is open here."""
    return _active.get()


def remembered(function: Callable[..., Any], *arguments: Any, on: tuple[Any, ...] = ()) -> Any:
    """Return function(*arguments), from the open journal where it is there; a `FitError` is kept too.

    Parameters
    ----------
    on : what the result depends on; the arguments by default
    """
    journal = active()
    if journal is None:
        return function(*arguments)
    key = digest(function, *(on or arguments))
    known = journal.find(key)
    if not known:
        try:
            known = [["result", function(*arguments)]]
        except FitError as error:
            known = [["failed", str(error)]]
        journal.keep(key, known[0])
    kind, value = known[0]
    if kind == "failed":
        raise FitError(value)
    return value


# -- what a result depends on ----------------------------------------------------------------------------------


@cache
def code() -> str:
    """Return a digest of the code that computes: this package, Python, and the libraries below it."""
    found = hashlib.sha256()
    folder = Path(__file__).parents[1]
    for file in sorted(folder.rglob("*.py")):
        found.update(file.relative_to(folder).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    found.update(f"{platform.python_version()} {platform.machine()}".encode())
    for name in LIBRARIES:
        try:
            found.update(f" {name} {version(name)}".encode())
        except PackageNotFoundError:
            found.update(f" {name} -".encode())
    return found.hexdigest()


def digest(*things: Any) -> str:
    """Return a digest of values: numbers, texts, arrays, expressions, models, records, containers, functions.

    Raises
    ------
    DataError
        For a thing whose content cannot be told.
    """
    found = hashlib.sha256()
    _feed(found, things)
    return found.hexdigest()


def _feed(into: Any, thing: Any) -> None:  # noqa: C901, PLR0912
    """Add one thing, with its type and its length: no two things look alike."""

    def add(*parts: Any) -> None:
        into.update(f"<{type(thing).__name__} {len(parts)}>".encode())
        for part in parts:
            _feed(into, part)

    if thing is None or isinstance(thing, (bool, int, float, complex, str, bytes)):
        raw = repr(thing).encode("utf-8", "surrogatepass")
        into.update(f"<{type(thing).__name__} {len(raw)}>".encode() + raw)
    elif isinstance(thing, (np.ndarray, np.generic)):
        array = np.asarray(thing)
        if array.dtype.kind == "O":
            raise DataError("two arrays of objects cannot be compared; use numbers")
        into.update(f"<array {array.dtype.str} {array.shape}>".encode())
        into.update(np.ascontiguousarray(array).data)
    elif isinstance(thing, sp.Basic):
        add(sp.srepr(thing))
    elif isinstance(thing, Mapping):
        add(*sorted(((digest(n), n, v) for n, v in thing.items()), key=lambda p: p[0]))
    elif isinstance(thing, (list, tuple)):
        add(*thing)
    elif isinstance(thing, (set, frozenset)):
        add(*sorted(map(digest, thing)))
    elif isinstance(thing, Model):
        names = sorted(n for n in vars(thing) if not isinstance(inspect.getattr_static(type(thing), n, None), property))
        cached = {n for c in type(thing).__mro__ for n, v in vars(c).items() if hasattr(v, "attrname")}
        add(type(thing).__qualname__, {n: vars(thing)[n] for n in names if n not in cached})
    elif inspect.isfunction(thing):
        if thing.__closure__:
            raise DataError(f"{thing.__qualname__} is a closure; pass the values that it needs as arguments")
        source = inspect.getsourcefile(thing)
        add(
            thing.__module__ if thing.__module__ != "__main__" else "",
            thing.__qualname__,
            _file(source),
            thing.__defaults__,
        )
    elif is_dataclass(thing) and not isinstance(thing, type):
        add(type(thing).__qualname__, *(getattr(thing, f.name) for f in fields(thing)))
    elif type(thing).__reduce__ is not object.__reduce__:
        add(*(part if not isinstance(part, type) else part.__qualname__ for part in thing.__reduce__()[:2]))
    else:
        raise DataError(
            f"two objects of the type {type(thing).__name__} cannot be compared; give numbers, texts, arrays or records"
        )


@cache
def _file(source: str | None) -> str:
    """Return a digest of a source file: a function that was edited gives other results."""
    return hashlib.sha256(Path(source).read_bytes()).hexdigest() if source and Path(source).is_file() else ""


# -- results as JSON -------------------------------------------------------------------------------------------


def plain(value: Any) -> Any:
    """Return a result as plain JSON from which `alive` makes the same value, bit for bit.

    Raises
    ------
    DataError
        For a result of another type than None, numbers, texts, arrays, lists, tuples and mappings with texts as names.
    """
    if value is None or isinstance(value, (bool, str)) or type(value) is int:
        return value
    if type(value) is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "fiubc":
        array = np.ascontiguousarray(value)
        content = base64.b64encode(array.tobytes()).decode()
        kind = "array" if isinstance(value, np.ndarray) else "scalar"
        return {kind: [array.dtype.str, list(np.shape(value)), content]}
    if type(value) is list:
        return [plain(v) for v in value]
    if type(value) is tuple:
        return {"tuple": [plain(v) for v in value]}
    if isinstance(value, Mapping) and all(isinstance(n, str) for n in value):
        return {"mapping": [[n, plain(v)] for n, v in value.items()]}
    raise DataError(
        f"a result of type {type(value).__name__} cannot be saved; return numbers, texts, arrays or lists of them"
    )


def alive(value: Any) -> Any:
    """Return the value that `plain` was given."""
    if isinstance(value, list):
        return [alive(v) for v in value]
    if not isinstance(value, dict):
        return value
    ((kind, content),) = value.items()
    if kind == "float":
        return float(content)
    if kind == "tuple":
        return tuple(alive(v) for v in content)
    if kind == "mapping":
        return {n: alive(v) for n, v in content}
    dtype, shape, raw = content
    array = np.frombuffer(base64.b64decode(raw), dtype=np.dtype(dtype)).reshape(shape).copy()
    return array if kind == "array" else array[()]


def _object(line: str) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _sum(key: Any, value: Any) -> int:
    return zlib.crc32(json.dumps([key, value], sort_keys=True).encode())
