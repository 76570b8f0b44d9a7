"""The portrait of what is missing: the missing input against what explains it, and what the law leaves of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...data.units import headed
from ...diagnosis.misfit import Panel as View
from ...diagnosis.misfit import Portrait
from ..figures.describe import TIME, Area, Line, Panel

Array = np.ndarray
Units = Mapping[str, str]
SHOWN = 99.0  # per cent of the samples that the axis covers at least: a start transient would flatten the rest


def portrait_panels(portrait: Portrait, units: Units) -> tuple[Panel, ...]:
    """Describe the portrait before, with the law of the last model over it, and below it what that law leaves.

    Parameters
    ----------
    units : mapping such as {"u": "V", "y": "um"}
    """
    view, law = portrait.view, list(portrait.laws)[-1:]
    x, high = places(portrait), height(portrait, *law)
    rows = [("", portrait.missing, view), *((n, portrait.missing - portrait.laws[n], portrait.left(n)) for n in law)]
    name, *said = labels(portrait, units)
    found = []
    for after, w, seen in rows:
        marks: list[Line | Area] = [_band(seen), Area(0, 0, role="zero"), Line(x, w - w.mean(), "samples", "sample")]
        marks += [Line(*joined(seen, seen.mean), "mean", "mean")]
        marks += [] if after else [Line(*joined(view, portrait.of(n).mean), f"law of {n}", "after") for n in law]
        found.append(Panel(name, said[bool(after)], marks, y_range=(-high, high)))
    return tuple(found)


def labels(portrait: Portrait, units: Units) -> tuple[str, str, str]:
    """Return the labels of what explains it, of what is missing, and of what is still missing with a law."""
    kind, unit, view = "input" if portrait.unit_of == "u" else "forcing", units.get(portrait.unit_of), portrait.view
    name = TIME if view.name == "time" else headed(view.label, view.unit(units))
    return name, headed(f"missing {kind}", unit), headed(f"{kind} still missing", unit)


def height(portrait: Portrait, *laws: str) -> float:
    """Return how far the axis goes up and down: with or without laws the same."""
    rows = [portrait.missing, *(portrait.missing - portrait.laws[n] for n in laws)]
    high = max(float(np.percentile(np.abs(w - w.mean()), SHOWN)) for w in rows)
    return 1.05 * max(high, float(np.nanmax(np.abs(portrait.view.mean))))


def places(portrait: Portrait) -> Array:
    """Return where the samples stand along the axis of the best view: way since a turn is negative while it falls."""
    view, x = portrait.view, portrait.values[portrait.view.name]
    turned = np.where(view.cell >= 0, np.sign(view.centres)[view.cell], np.nan)
    return x * turned if view.name.startswith("distance") else x


def joined(view: View, heights: Array) -> tuple[Array, Array]:
    """Return the means as points, with a gap where another class of the view begins."""
    x = np.where(np.diff(view.low, prepend=-np.inf) < 0, np.nan, view.centres)
    breaks = np.flatnonzero(np.isnan(x))
    return np.insert(view.centres, breaks, np.nan), np.insert(heights, breaks, np.nan)


def chance(view: View) -> tuple[Array, Array]:
    """Return half the width of what chance makes of the means, of the widest class at each place."""
    x, at = np.unique(view.centres, return_inverse=True)
    half = np.zeros(x.size)
    np.maximum.at(half, at, np.nan_to_num(view.error))
    return x, half


def _band(view: View) -> Line:
    """Return the band of chance as one area, that of the widest class."""
    x, half = chance(view)
    return Line(np.concatenate([x, x[::-1]]), np.concatenate([half, -half[::-1]]), "chance", "range")
