"""Where the figures come from: data, settings, versions, and the numbers behind the pictures."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from ...data.record import Record
from ..picture import Picture
from ..words import Row
from .registry import Material, panel, panels

PACKAGES = ("narx-sym", "numpy", "scipy", "sympy", "matplotlib")


@panel("Where these figures come from", order=90)
def provenance(material: Material) -> dict[str, Any]:
    """Tell where everything comes from."""
    d = material.diagnosis
    records = d.steps[0].base.split.records
    chosen = {"seed": d.seed, "steps": len(d.steps), **material.settings}
    shared: dict[int, tuple[list[str], Picture]] = {}
    for picture in (p for key in panels() for p in material.pictures(key) if p.columns):
        shared.setdefault(id(picture.columns), ([], picture))[0].append(picture.title)
    return {
        "sources": sources(records, material.files), "records": record_lines(records), "settings": chosen,
        "versions": versions(), "seconds": d.seconds, "numbers": list(shared.values()),
        "now": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }  # fmt: skip


def sources(records: Sequence[Record], files: Sequence[Any]) -> list[Row]:
    """Return name and SHA-256 of each data file, or of the arrays of records that come from none."""
    if files:
        return [{"name": Path(f).name, "sha256": hashlib.sha256(Path(f).read_bytes()).hexdigest()} for f in files]
    return [
        {"name": f"{r.name} (arrays u, y, t)", "sha256": hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes()
                                                                               for a in (r.u, r.y, r.t))).hexdigest()}
        for r in records
    ]  # fmt: skip


def versions() -> list[tuple[str, str]]:
    """Return the versions of what computed the figures."""
    found = [("Python", platform.python_version())]
    for name in PACKAGES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:  # run from a folder
            continue
    return found


def record_lines(records: Sequence[Record]) -> list[str]:
    """Say how long each segment is."""
    return [f"{r.name}: {len(r)} samples, Ts = {r.Ts:.6g} s" for r in records]
