"""Cells of a panel: bounds at quantiles of the variable, and the cell of each sample."""

from __future__ import annotations

import numpy as np

from ..settings import CELLS
from .panel import Panel

Array = np.ndarray


def edges_of(x: Array, most: int, even: bool = False) -> Array | None:
    """Edges of cells at quantiles of x, with fewer samples in the tails; None where x does not vary."""
    values = np.unique(x)
    if values.size < 2 or np.ptp(values) <= 1e-9 * np.abs(values).max():
        return None
    if values.size <= most:  # levels: a cell for each
        inner = (values[1:] + values[:-1]) / 2
        return np.array([values[0] - (inner[0] - values[0]), *inner, values[-1] + (values[-1] - inner[-1])])
    cells = int(np.clip(x.size // 30, 2, most))
    parts = np.linspace(0, 1, cells + 1)
    edges = np.unique(np.quantile(x, parts if even else parts / 2 + (1 - np.cos(np.pi * parts)) / 4))
    return edges if edges.size > 2 else np.array([edges[0], edges.mean(), edges[-1]])


def place(x: Array, edges: Array) -> Array:
    """Cell of each sample, -1 where x is NaN."""
    inside = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2)
    return np.where(np.isnan(x), -1, inside)


def empty(name: str, label: str, kind: str, low: Array, high: Array, cell: Array) -> Panel:
    """Panel without a residual."""
    none, count = np.full(len(low), np.nan), np.bincount(cell[cell >= 0], minlength=len(low))
    return Panel(name, label, kind, low, high, none, none, count, 0.0, cell)


def along(name: str, label: str, kind: str, x: Array) -> Panel | None:
    """Panel along one variable."""
    edges = edges_of(x, CELLS, even=name == "time")
    return None if edges is None else empty(name, label, kind, edges[:-1], edges[1:], place(x, edges))


def since(name: str, label: str, kind: str, x: Array, sign: Array) -> Panel | None:
    """Panel along x >= 0, with cells of its own for the two directions."""
    known = x[np.isfinite(x)]
    edges = edges_of(known, 2 * CELLS // 3) if known.size else None
    if edges is None:
        return None
    edges[0] = 0.0
    cell, half = place(x, edges), edges.size - 1
    both = np.where(cell < 0, -1, np.where(sign > 0, half + cell, half - 1 - cell))
    low = np.concatenate([-edges[:0:-1], edges[:-1]])
    return empty(name, label, kind, low, np.concatenate([-edges[-2::-1], edges[1:]]), both)


def beside(name: str, label: str, x: Array, other: Array, classes: int) -> Panel | None:
    """Panel along the input, with cells of its own for classes of another variable; lines that fan out, or a loop."""
    edges, sides = edges_of(x, CELLS), edges_of(other.astype(float), classes)
    if edges is None or sides is None:
        return None
    cells, own = edges.size - 1, place(other.astype(float), sides)
    low, high = np.tile(edges[:-1], sides.size - 1), np.tile(edges[1:], sides.size - 1)
    return empty(f"u|{name}", label, "u", low, high, np.where(own < 0, -1, place(x, edges) + cells * own))


def grid(amplitude: Array, frequency: Array) -> Panel | None:
    """Panel of joint cells of amplitude and frequency."""
    known = np.isfinite(amplitude)
    sides, places = [], []
    for x, most in ((amplitude, 4), (frequency, 3)):
        # Small differences between swings are noise, not a reason to tell them apart.
        varied = known.any() and np.ptp(x[known]) > 0.05 * np.max(x[known])
        edges = edges_of(x[known], most) if varied else None
        if edges is None:
            edges = np.array([np.min(x[known], initial=np.inf), np.max(x[known], initial=-np.inf)])
        sides.append(edges)
        places.append(place(x, edges))
    first, second = (s.size - 1 for s in sides)
    if first * second < 2:
        return None
    cell = np.where(known, places[0] + first * places[1], -1)  # the amplitude runs faster
    low, high = (
        np.column_stack([np.tile(sides[0][c], second), np.repeat(sides[1][c], first)])
        for c in (slice(None, -1), slice(1, None))
    )
    return empty("amplitude_frequency", "amplitude, frequency", "u, Hz", low, high, cell)
