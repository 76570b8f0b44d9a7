"""Where the model fails: its error and the missing input against the variables that explain most."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...diagnosis.misfit import Panel
from ..comparison import Comparison, Units, region, spans
from ..figures.still import legend
from ..picture import Picture
from ..plots import draw_panel, reach
from .registry import Material, panel

SHOWN, LEAST = 4, 0.02  # variables that are shown, and the share that each must explain


@dataclass(frozen=True, eq=False)
class Failure:
    """One panel of where the model fails: what it explains of the error and of the missing input, and its pictures."""

    name: str
    label: str
    share: float
    share_missing: float
    worst: str
    pictures: list[Picture] = field(default_factory=list)
    cells: dict[str, list[Cell]] = field(default_factory=dict)  # by the key of the picture
    stretch: tuple[int, int] | None = None  # of the worst cell


@dataclass(frozen=True)
class Cell:
    """Where the mean of a cell is drawn [% of the picture], and the stretch of the record where its error is largest.

    The stretch, [first sample, behind the last], has as much of the record on either side.
    """

    left: float
    top: float
    stretch: tuple[int, int]
    worst: bool


def failures(material: Material, most: int = SHOWN) -> list[Failure]:
    """Return the panels that explain most, each with the error, the missing input, and the worst region in time."""
    now, units = material.lacking, material.units
    misfit, c = now.misfit, material.compared if now is material.diagnosis else Comparison.of(now)
    same = now.steps[0].base.worst == material.diagnosis.steps[0].base.worst  # else no stretch of the page is meant
    errors, missing = ({p.name: p for p in ps} for ps in (misfit.panels, misfit.panels_missing))
    rows = [(max(r["share"], np.nan_to_num(r["share_missing"])), r) for r in misfit.table(units)]
    found = []
    ranked = sorted(rows, key=lambda p: -p[0])
    shown = [row for i, (share, row) in enumerate(ranked[:most]) if share > LEAST or i == 0]
    # Rounding is no forcing.
    least = 1e-6 * now.floor
    missing = missing if misfit.missing is not None and np.abs(misfit.missing).max() > least else {}
    tops = [reach([p[r["panel"]] for r in shown if r["panel"] != "spectrum"]) for p in (errors, missing) if p]
    for i, row in enumerate(shown):
        name, made, places = row["panel"], [], {}
        both = [("error", "Free-run error", errors[name])]
        both += [("missing", "Equivalent missing input", missing[name])] if name in missing else []
        for (word, title, one), top in zip(both, tops, strict=False):
            title = f"{title}: {one.label}"
            floor = c.floor if word == "error" and c.band else None
            made.append(_panel(f"where_{i + 1}_{word}", title, one, floor, top, units))
            places[made[-1].key] = cells(made[-1], one, misfit.residual) if same else []
        # The residual that the panel explains better says where to look.
        of_missing = name in missing and (missing[name].share > errors[name].share or errors[name].worst is None)
        worst = missing[name].where(units).replace("error", "missing input") if of_missing else row["worst"]
        if name != "spectrum":
            inside = misfit.region(name, of_missing)
            listed = {"t": c.t, "error": c.errors["base"], "in the worst region": inside}
            columns = {column: values[c.keep] for column, values in listed.items()}
            alt = f"Error of the base over time; marked: {worst}."
            draw = [region(c, inside, units)]
            title = f"The worst region in time: {errors[name].label}"
            made.append(Picture(f"where_{i + 1}_time", title, alt, draw, columns))
        told = places[f"where_{i + 1}_{'missing' if of_missing else 'error'}"]
        stretch = next((cell.stretch for cell in told if cell.worst), None)
        shares = row["share"], row["share_missing"]
        found.append(Failure(name, errors[name].label, *shares, worst, made, places, stretch))
    return found


def _panel(key: str, title: str, of: Panel, floor: float | None, top: float, units: Units) -> Picture:
    what = {"spectrum": "rms in a bin"}.get(of.name, "mean")

    def draw(ax: Any) -> list[tuple[int, float, float]]:
        drawn = draw_panel(ax, of, floor, dict(units), "error" if "error" in key else "missing input", top)
        ax.set_title("", loc="left")
        if of.low.ndim == 1:
            legend(ax, size=8)
        return [(cell, place, of.mean[cell]) for cell, place in drawn]

    low, high = np.atleast_2d(of.low.T), np.atleast_2d(of.high.T)
    columns = {f"{side} {i + 1}" if len(low) > 1 else side: x for side, b in (("from", low), ("to", high))
               for i, x in enumerate(b)}  # fmt: skip
    columns |= {what: of.mean, "standard error": of.error, "samples": of.count}
    alt = f"{title}. It explains {100 * of.share:.0f} % of the variance; {of.where(units)}."
    return Picture(key, title, alt, draw, columns, clickable=True)


def cells(picture: Picture, of: Panel, residual: np.ndarray) -> list[Cell]:
    """Return the cells of a panel's picture, for the page to zoom to."""
    if not of.cell.size:
        return []
    found = []
    for cell, (left, top) in picture.places.items():
        parts = spans(of.cell == cell)
        if parts:
            a, b = max(parts, key=lambda part: float(np.abs(residual[part[0] : part[1]]).sum()))
            stretch = max(0, 2 * a - b), min(residual.size, 2 * b - a)
            found.append(Cell(left, top, stretch, cell == of.worst))
    return found


def pictures(material: Material) -> list[Picture]:
    """Return the pictures of all that is shown."""
    return [p for f in material.once(failures) for p in f.pictures]


@panel("Where the model fails", order=40, draws=pictures)
def where(material: Material) -> dict[str, Any]:
    """Tell what each variable explains, and where it is worst."""
    return {"failures": material.once(failures)}
