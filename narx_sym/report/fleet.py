"""One page for a fleet, and its rows as tables: what is missing where, the worst first; tag by effect; what grows."""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..files.atomic import csv_text, write_bytes, write_text
from . import words
from .figures.describe import stylesheet
from .page import style, templates

Row = dict[str, Any]
# The time that a record took is in no table: the same records give the same bytes.
FIELDS = (
    "file", "tag", "verdict", "finding", "missing", "valve", "before", "after", "unit", "explained", "sizes", "report",
    "problem",
)  # fmt: skip
WIDTH, HEIGHT = 160, 32  # of a trend [px]
FEWEST = 3  # records of one tag that make a trend


def write_fleet(rows: Sequence[Row], path: Path, reports: str = "") -> list[Path]:
    """Write the page, and the same rows beside it as CSV, and as Parquet where pyarrow is there; return the paths.

    Parameters
    ----------
    reports : str
        The folder of the reports as seen from the page.
    """
    page = templates().get_template("fleet.html")
    told = page.render(
        rows=rows, unit=_same_unit(rows), reports=reports, badges=words.BADGES, heat=heat(rows), trends=trends(rows),
        colours=stylesheet(), style=style(), width=WIDTH, height=HEIGHT,
        found=sum(bool(r["missing"]) for r in rows), problems=sum(bool(r["problem"]) for r in rows),
        judged=sum(map(judged, rows)), nothing=nothing,
    )  # fmt: skip
    write_text(path, told)
    tables = beside(path)
    for table in tables:
        write_bytes(table, as_csv(rows).encode("utf-8") if table.suffix == ".csv" else as_parquet(rows))
    return [path, *tables]


def judged(row: Row) -> bool:
    """Whether a record was judged: an unreadable file is not healthy, nor is a loop of which nothing is said."""
    return not row["problem"] and (row["verdict"] != "closed_loop" or bool(row["valve"]))


def nothing(row: Row) -> str:
    """Say in words that nothing is named in a record."""
    if not judged(row):
        return "not judged"
    if row["valve"]:
        return str(row["valve"])
    return "no detectable effect" if row["finding"] == "nothing_detectable" else "no effect is named"


def _same_unit(rows: Sequence[Row]) -> str:
    """Return the unit of all errors; an empty text where the records have several."""
    said = {r["unit"] for r in rows if not r["problem"]}
    return said.pop() if len(said) == 1 else ""


def beside(page: Path) -> list[Path]:
    """Return where the rows of a page go: as CSV, and as Parquet where pyarrow is there."""
    return [page.with_suffix(ending) for ending in (".csv", *[".parquet"] * (find_spec("pyarrow") is not None))]


def as_parquet(rows: Sequence[Row]) -> bytes:
    """Return the rows as a Parquet file: numbers in full, effects as lists, sizes as maps from names to numbers."""
    import pyarrow
    from pyarrow import parquet

    kinds = {
        "missing": pyarrow.list_(pyarrow.string()), "sizes": pyarrow.map_(pyarrow.string(), pyarrow.float64()),
        **dict.fromkeys(("before", "after", "explained"), pyarrow.float64()),
    }  # fmt: skip
    columns = {
        name: pyarrow.array(
            [list(row[name].items()) if name == "sizes" else row[name] for row in rows],
            kinds.get(name, pyarrow.string()),
        )
        for name in FIELDS
    }
    raw = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), raw)
    return raw.getvalue()


def as_csv(rows: Sequence[Row]) -> str:
    """Return the rows as CSV; lists are joined by semicolons."""
    joined = {
        "missing": lambda effects: ";".join(effects),
        "sizes": lambda sizes: ";".join(f"{name}={value:.6g}" for name, value in sizes.items()),
    }
    return csv_text({n: [joined[n](row[n]) if n in joined else row[n] for row in rows] for n in FIELDS})


def heat(rows: Sequence[Row]) -> dict[str, Any]:
    """Return tag by effect: in how many records of a tag an effect may be missing, of how many that were judged."""
    tags = sorted({r["tag"] for r in rows})
    effects = sorted({e for r in rows for e in r["missing"]})
    counts = {t: [sum(e in r["missing"] for r in rows if r["tag"] == t) for e in effects] for t in tags}
    of = {t: sum(judged(r) for r in rows if r["tag"] == t) for t in tags}
    left = {t: sum(not judged(r) for r in rows if r["tag"] == t) for t in tags}
    return {"effects": effects, "counts": counts, "of": of, "left": left}


def trends(rows: Sequence[Row]) -> list[Row]:
    """Return every size that enough records of one tag have, in the order of the list, or of the names."""
    made = []
    for tag in sorted({r["tag"] for r in rows}):
        own = sorted((r for r in rows if r["tag"] == tag and r["sizes"]), key=lambda r: r["order"])
        for name in sorted({n for r in own for n in r["sizes"]}):
            values = np.array([r["sizes"][name] for r in own if name in r["sizes"]])
            if values.size >= FEWEST:
                made.append({"tag": tag, "size": name, "values": values.tolist(), "line": _line(values)})
    return made


def _line(values: Any) -> str:
    """Return the points of a polyline."""
    span = float(np.ptp(values)) or 1.0
    x = np.linspace(3, WIDTH - 3, values.size)
    y = HEIGHT - 3 - (values - values.min()) / span * (HEIGHT - 6)
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
