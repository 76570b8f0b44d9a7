"""What a user chose and typed: columns and rows, numbers, names; and messages in the words of the page."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

from ..data.units import in_header
from ..errors import DataError, NarxError

OPTIONS = {"input": "Input", "output": "Output", "time": "Time", "ts": "Sampling time", "rows": "Rows", "units": "Unit"}
OPTIONS |= {"channels": "Channels"}  # what the options of the command line are called in the page


@dataclass
class Choice:
    """Which columns and rows of a file are used; texts as a user types them."""

    u: str = ""
    y: str = ""
    t: str = ""
    Ts: str = ""
    channels: list[str] = field(default_factory=list)
    rows: str = ""
    units: dict[str, str] = field(default_factory=lambda: {"u": "", "y": ""})


def in_the_page(message: str) -> str:
    """Name the fields of the page in the place of options of the command line."""
    return re.sub(r"--(\w+)", lambda found: OPTIONS.get(found[1], found[0]), message)


def shortened(name: str) -> str:
    """Return a file name to show: its last part, without control characters, at most 80 characters."""
    last = re.split(r"[/\\]", name)[-1]
    return "".join(c for c in last if c.isprintable())[-80:] or "file"


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


class Said:
    """Turns what a user may see into the one message of a workbench; everything else passes."""

    def __init__(self, bench: Any):
        self.bench = bench

    def __enter__(self) -> None:
        self.bench.error, self.bench.notes = "", ()

    def __exit__(self, kind: Any, error: Any, trace: Any) -> bool:
        if isinstance(error, NarxError):
            self.bench.error = in_the_page(str(error))
            return True
        return False
