"""Plain data, as JSON has it, as values of declared types: a dataclass says what a file may hold, and checks it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from itertools import repeat
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from ..errors import ModelError

MOST = 1000  # entries of a list or an object
SAID = {str: "a text", bool: "true or false", int: "a whole number", float: "a finite number"}


def read(kind: Any, value: Any, name: str = "") -> Any:
    """Return plain data as a value of a type.

    Parameters
    ----------
    kind : str, bool, int, float, Any, a dataclass; `X | None`, tuple[X, ...], tuple[X, Y], Mapping[str, X] of such
    name : str
        Where the data stand, for messages.

    Raises
    ------
    ModelError
        For data of another kind, too many of them, and a field that is unknown or missing.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if kind is Any or (origin is UnionType and value is None):
        return value
    if origin is UnionType:
        return read(parts[0], value, name)
    if origin is tuple:
        some = parts[-1] is Ellipsis
        if not isinstance(value, list) or (len(value) > MOST if some else len(value) != len(parts)):
            raise ModelError(f"{name!r} must be a list of {f'at most {MOST}' if some else len(parts)} entries.")
        kinds = repeat(parts[0]) if some else parts
        return tuple(read(own, one, name) for own, one in zip(kinds, value, strict=False))
    if is_dataclass(kind) or origin is Mapping:
        if not isinstance(value, dict) or len(value) > MOST:
            raise ModelError(f"{name!r} must be an object of at most {MOST} entries.")
        if origin is Mapping:
            return {n: read(parts[1], one, name) for n, one in value.items()}
        return _filled(kind, value, name)
    if type(value) is kind or (kind is float and type(value) is int):
        if kind is not float:
            return value
        if abs(value) < 1e308:
            return float(value)
    raise ModelError(f"{name!r} must be {SAID[kind]}.")


def _filled(kind: Any, value: Mapping[str, Any], name: str) -> Any:
    """Return a dataclass with these fields."""
    kinds, where = get_type_hints(kind), f" of {name!r}" * bool(name)
    for unknown in sorted(set(value) - set(kinds))[:1]:
        raise ModelError(f"unknown field {unknown[:40]!r}{where}; a newer version may have written this file.")
    for one in fields(kind):
        if one.name not in value and one.default is MISSING and one.default_factory is MISSING:
            raise ModelError(f"the field {one.name!r}{where} is missing.")
    prefix = f"{name}." * bool(name)
    return kind(**{n: read(kinds[n], v, prefix + n) for n, v in value.items()})
