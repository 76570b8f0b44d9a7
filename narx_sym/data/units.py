"""Units of signals: where a file says them, and whether two convert.

A label that pint does not know ("%", "inc") is a unit of its own: it cancels against itself and converts to nothing
else.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeVar

from ..errors import DataError, ModelError

Measured = TypeVar("Measured", bound=Any)  # a Record: that module uses this one
LONGEST = 40  # characters of a label
# One name with a whole power of one digit, and products and quotients of such: nothing else is given to pint.
NAME = r"(?:[^\W\d_²³¹⁰-⁹]+|°[A-Za-z]?)"
FACTOR = rf"\(*{NAME}(?:(?:\*\*|\^)?-?[1-9]|[²³])?\)*"
LABEL = re.compile(rf"(?:1 ?/ ?)?{FACTOR}(?:(?: ?[*/·.] ?| ){FACTOR})*")
HEADER = re.compile(r"(.*\S)\s*(?:\[([^][]*)\]|\(([^()]*)\))")
PURE = ("1", "-")  # how files say that a signal has no unit


# -- labels ----------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _registry() -> Any:
    """Return pint's units; it is imported here, because most commands need none."""
    import pint

    return pint.UnitRegistry()


@lru_cache(maxsize=1000)
def unit(label: str) -> Any:
    """Return a label as a unit of pint: one that pint knows, else one of its own dimension."""
    known = _known(label)
    if known is not None:
        return known
    name = "own_" + label.encode().hex()  # any characters may stand in a label
    _registry().define(f"{name} = [{name}]")
    return _registry().Unit(name)


def _known(label: str) -> Any:
    """Return what pint knows by a label, None where it knows nothing."""
    if label in PURE:
        return _registry().Unit("")
    if len(label) > LONGEST or not LABEL.fullmatch(label) or label.count("(") != label.count(")"):
        return None
    try:
        return _registry().Unit(re.sub(rf"({NAME})(-?\d)", r"\1**\2", label).replace(".", "*"))
    except Exception:  # pint has many kinds of errors for a name that it does not know
        return None


def bare(text: str) -> str:
    """Return a label without the brackets around it."""
    return re.sub(r"\[(.*)\]|\((.*)\)", r"\1\2", text.strip()).strip()


def is_unit(label: str) -> bool:
    """Whether a label names a unit that is known."""
    return label == "%" or _known(label) is not None


def powers(label: str) -> dict[str, Fraction]:
    """Return the power of each name in a unit; nothing for a pure number."""
    return {
        name: Fraction(power).limit_denominator(100)
        for name, power in _registry().Quantity(1, unit(label)).unit_items()
    }


def product(of: Mapping[str, Fraction]) -> Any:
    """Return the unit of which `powers` returns this."""
    found = _registry().Unit("")
    for name, power in of.items():
        found *= _registry().Unit(name) ** (int(power) if power.denominator == 1 else float(power))
    return found


def shown(of: Any, labels: Iterable[str]) -> str:
    """Return a unit as text, each name as the user spells it in `labels`; "1" for a pure number."""
    spelled = {f"{unit(label):~P}": label for label in labels}
    for name in {name for label in labels if LABEL.fullmatch(label) for name in re.findall(NAME, label)}:
        spelled.setdefault(f"{unit(name):~P}", name)
    written = f"{of:~P}"
    if written in spelled:  # a whole label: as it is written there
        return spelled[written] if written else "1"
    return re.sub(rf"own_[0-9a-f]+|{NAME}", lambda m: spelled.get(m[0], m[0]), written) or "1"


def in_header(text: str) -> tuple[str, str]:
    """Split the name of a column: "u [V]" and "u (V)" are u in V; the unit is empty where none is said.

    What stands in round brackets is a unit only where it is one that is known: "y (filtered)" is a name.
    """
    found = HEADER.fullmatch(text)
    if not found:
        return text, ""
    label = (found[2] if found[2] is not None else found[3]).strip()
    if not label or label.isdigit() or (found[3] is not None and label != "%" and _known(label) is None):
        return text, ""
    return found[1], label


def headed(name: str, label: str | None) -> str:
    """Return a name with its unit, where one is known: what `in_header` splits."""
    return f"{name} [{label}]" if label else name


def said_first(known: Mapping[str, str], said: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return units by name: what the user says, else what is known."""
    return {**known, **{name: label for name, label in (said or {}).items() if label}}


def converted(values: Any, own: str, wanted: str) -> Any:
    """Return numbers in another unit; None where the two do not convert.

    Rotations, counts and pure numbers are told apart: a unit converts to what has the same root.
    """
    here, there = unit(own), unit(wanted)
    try:
        if _registry().get_root_units(here)[1] != _registry().get_root_units(there)[1]:
            return None
        return _registry().Quantity(values, here).to(there).magnitude
    except Exception:  # such as a product with degrees Celsius, or decibels
        return None


def listed(records: Any) -> list[Any]:
    """Return one record or several as a list; refuse anything else.

    Raises
    ------
    ModelError
        For what is no record, and for none.
    """
    found = [records] if isinstance(records, str) or not isinstance(records, Iterable) else list(records)
    if not found or not all(hasattr(record, "segments") for record in found):
        raise ModelError("Give a Record or a non-empty list of Records (ns.read, ns.Record.from_arrays).")
    return found


def in_units(
    records: Sequence[Measured], units: Mapping[str, str] | None = None, whose: str = "the model was identified"
) -> list[Measured]:
    """Return records in one set of units; what was converted is noted in each.

    Parameters
    ----------
    units : mapping of names to labels, optional
        Those that are wanted, of a model; by default, and for further names, those of the first record that says them.
    whose : str
        Who has these units, for the error.

    Raises
    ------
    DataError
        Where a unit does not convert.
    """
    records, wanted = listed(records), dict(units or {})
    for record in records:
        wanted = said_first(record.units, wanted)
    return [_converted(record, wanted, whose if units else "the record before it was measured") for record in records]


def _converted(record: Measured, wanted: Mapping[str, str], whose: str) -> Measured:
    other = {n: wanted[n] for n, label in record.units.items() if wanted.get(n, label) != label}
    if not other:
        return record
    made = {}
    for name, label in other.items():
        own = record.units[name]
        made[name] = converted(record.signals[name], own, label)
        if made[name] is None:
            has, needs = (f"{w.get('u') or '?'} -> {w.get('y') or '?'}" for w in (record.units, wanted))
            raise DataError(
                f"record '{record.name}' is in {has}, but {whose} in {needs}: {name} in {own} does not convert to "
                f"{label}; give a record in {label}, or say with --units (units=) what the record really is in"
            )
    notes = [f"{name} is converted from {record.units[name]} to {label}" for name, label in other.items()]
    return replace(
        record, u=made.pop("u", record.u), y=made.pop("y", record.y), channels={**record.channels, **made},
        units={**record.units, **other}, notes=(*record.notes, *notes),
    )  # fmt: skip
