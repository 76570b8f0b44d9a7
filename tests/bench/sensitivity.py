"""Which names change when a constant of the verdict is halved or doubled? Real records, each searched once.

    python tests/bench/sensitivity.py [--only emps,tanks] [--search] [--markdown FILE]

The verdict is a function of the table of hypotheses: the table is filled once per record, and read again with each
constant of `diagnosis/settings.py` halved and doubled. With `--search` it is filled again for each of the constants
that decide what is tried. A name is right where the source of the record says so.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import asked, diagnosed, publish
from places import SHARED

import narx_sym as ns
from narx_sym.diagnosis.steps import new_effect, won
from narx_sym.diagnosis.table import verdict

CHANGED = ("PER_PARAMETER", "PER_EFFECT", "ENOUGH", "ALIKE")  # those that the names depend on
SEARCHED = (
    ("diagnosis.settings", "HELPS"), ("diagnosis.settings", "LEFT"),
    ("diagnosis.settings", "LARGE"), ("fit.bases.integrating", "DRIVEN"),
    ("diagnosis.settings", "TRIED"), ("diagnosis.settings", "PARTNERS"),
    ("diagnosis.settings", "TOGETHER"), ("diagnosis.settings", "LEVEL"),
)  # fmt: skip
FRICTION = {"coulomb_friction", "stribeck_friction", "stiction"}
RECORDS: dict[str, tuple[str, slice, set[str]]] = {
    "emps": ("emps/train.csv", slice(None), FRICTION),
    "damper 0 A": ("mr_damper_utfsm/10mm1Hz_0A.csv", slice(None), FRICTION | {"hysteresis"}),
    "damper 0.5 A": ("mr_damper_utfsm/10mm1Hz_0x5A.csv", slice(None), FRICTION | {"hysteresis"}),
    "damper 0.75 A": ("mr_damper_utfsm/25mm0x25Hz_0x75A.csv", slice(None), FRICTION | {"hysteresis"}),
    "damper 3 Hz": ("mr_damper_utfsm/5mm3Hz_0A.csv", slice(None), FRICTION | {"hysteresis"}),
    "friction damper": ("friction_damper_brfd/d1_0.5Hz_35lb.csv", slice(None), FRICTION | {"backlash"}),
    "seal 1 bar": ("pneumatic_seal_friction/Oring_1bar.csv", slice(4300), FRICTION),
    "seal 3 bar": ("pneumatic_seal_friction/Oring_3bar.csv", slice(None), FRICTION),
    "motor": ("hydraulic_motor_rotation/run.csv", slice(None), {"saturation", "hysteresis", "backlash"}),
    "piezo": ("piezo_dbo/train_1Hz_full_range.csv", slice(20, None), {"hysteresis", "backlash"}),
    "tanks": ("cascaded_tanks/train.csv", slice(None), {"sqrt_outflow", "end_stop", "saturation", "output_limit"}),
}


@dataclass
class Read:
    """What one reading of a table says."""

    named: str
    right: bool
    in_set: bool


def read(rows: list[Any], accept: set[str]) -> Read:
    """Read a table: what is named first, and what cannot be told from it."""
    known, best = won(rows, min((r for r in rows if not r.ids), key=lambda r: (r.more, r.price)))
    if best is None:
        return Read("-", False, False)
    names = {v.id for v in best.beyond(known)}
    alike = names | {new_effect(r, known) for r in verdict.alike(rows, best)}
    return Read(" + ".join(sorted(names)), bool(names) and names <= accept, bool(alike & accept))


def records_of(only: str) -> dict[str, Any]:
    """Return the records, or those whose names are listed."""
    names = set(filter(None, only.split(",")))
    return {
        name: ns.read(SHARED / file, channels=[])[rows]
        for name, (file, rows, _) in RECORDS.items()
        if not names or name in names
    }


def changes() -> Iterator[tuple[str, float]]:
    """Yield each constant with each value; ENOUGH is a share: what it leaves is halved and doubled."""
    yield "as it is", 0.0
    for name in CHANGED:
        value = getattr(verdict, name)
        for factor in (0.5, 2.0):
            yield name, 1 - (1 - value) * factor if name == "ENOUGH" else value * factor


@contextmanager
def changed(module: str, name: str, factor: float) -> Iterator[float]:
    """Change a constant wherever the diagnosis has it by its name."""
    value = getattr(sys.modules[f"narx_sym.{module}"], name)
    new = type(value)(value * factor)
    held = [
        m for full, m in sys.modules.items()
        if full.startswith("narx_sym.") and getattr(m, name, None) is value
    ]  # fmt: skip
    for one in held:
        setattr(one, name, new)
    try:
        yield new
    finally:
        for one in held:
            setattr(one, name, value)


def searched(records: dict[str, Any]) -> Iterator[str]:
    """Yield a line of the table for each constant of the search, halved and doubled: the tables are filled again."""
    for module, name in SEARCHED:
        for factor in (0.5, 2.0):
            with changed(module, name, factor) as value:
                found = {n: diagnosed(r) for n, r in records.items()}
                said = {n: read(f.hypotheses, RECORDS[n][2]) for n, f in found.items()}
            cells = [f"{s.named} ({found[n].verdict})" for n, s in said.items()]
            counts = f"{sum(s.right for s in said.values())} | {sum(s.in_set for s in said.values())}"
            line = f"| {name} | {value:g} | {' | '.join(cells)} | {counts} |"
            print(line, flush=True)
            yield line


def main() -> None:
    options = asked(__doc__, only="", search=False, markdown=Path)
    warnings.simplefilter("ignore")
    tables = {}
    records = records_of(options.only)
    for name, record in records.items():
        accept = RECORDS[name][2]
        found = diagnosed(record)
        tables[name] = ([row.judged() for row in found.hypotheses], accept)  # at other prices others may be worth it
        print(name, found.verdict, found.confusion_set, read(*tables[name]), f"{found.seconds:.0f} s", flush=True)
    lines = ["| constant | value | " + " | ".join(tables) + " | right | in the set |", "|---" * (len(tables) + 4) + "|"]
    if options.search:
        lines += searched(records)
    for name, value in () if options.search else changes():
        before = getattr(verdict, name, None)
        if before is not None:
            setattr(verdict, name, value)
        said = [read(*table) for table in tables.values()]
        if before is not None:
            setattr(verdict, name, before)
        counts = f"{sum(s.right for s in said)} | {sum(s.in_set for s in said)}"
        lines.append(f"| {name} | {value:g} | " + " | ".join(s.named for s in said) + f" | {counts} |")
    publish("\n".join(lines), options.markdown)


if __name__ == "__main__":
    main()
