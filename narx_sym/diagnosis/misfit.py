"""Where the model fails: its error against everything that may matter, sorted by the share that each explains.

Two residuals are looked at: the free-run error, and the equivalent missing input, the smallest forcing that makes the
model follow the measurement (Hooker 2009). The dynamics smear the first; the second sits at the cause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sp
from scipy.linalg import solveh_banded
from scipy.optimize import brentq, minimize_scalar
from scipy.signal import savgol_filter, welch

from ..data.metrics import correlation_length
from ..data.record import Record
from ..engines.compile import Columns
from ..errors import DataError
from ..fit.simulate import vector
from ..models.model import Model
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import expand_phi, k, samples

Array = np.ndarray
CELLS = 12  # of a panel
LEAST = 10  # samples in a cell, and three correlation lengths
WIDE = 2  # a spectral line of the Hann window reaches this many bins to each side
DIRECTIONS = ("falling", "resting", "rising")
SINCE = ("distance_since_reversal", "time_since_reversal")  # negative while falling: their effects change sign


@dataclass(frozen=True, eq=False)
class Panel:
    """The residual against one variable.

    Attributes
    ----------
    name : str
        "u", "y", "direction", "rate", "amplitude_frequency", "distance_since_reversal", "time_since_reversal",
        "time", "spectrum" or "channel:<name>"; "y" is the simulated output, free of the noise in the error.
    label, unit_of : str
        Name of the axis, and which unit it has: "u", "u/s", "y", "s", "Hz", "" or a channel; "u, Hz" for two axes.
    low, high : (cells,) arrays, or (cells, 2) for "amplitude_frequency" [unit of the variable]
        Bounds of the cells. Distance and time since a reversal are negative while u falls.
    mean, error : (cells,) arrays [unit of y]
        Mean residual and its standard error, which holds for coloured residuals too; NaN where too few samples.
        For "spectrum": rms of a frequency bin, in what the other panels leave.
    count : (cells,) array of int
    share : float
        Share of the residual's variance that the cell means explain, without what chance explains; 0 to 1.
        For "spectrum": share of the strongest line, in what the other panels leave.
    cell : (N,) array of int
        Cell of each sample, -1 where there is none; empty for "spectrum".
    line : int or None
        Cell of the strongest line, for "spectrum".
    """

    name: str
    label: str
    unit_of: str
    low: Array
    high: Array
    mean: Array
    error: Array
    count: Array
    share: float
    cell: Array
    line: int | None = None

    @property
    def centres(self) -> Array:
        """Middles of the cells, in the shape of `low`."""
        return (self.low + self.high) / 2

    @property
    def worst(self) -> int | None:
        """The line, or the cell with the largest mean residual less its standard error; None where all are grey."""
        if self.line is not None:
            return self.line
        sure = np.abs(self.mean) - self.error
        return int(np.nanargmax(sure)) if np.isfinite(sure).any() else None

    def where(self, units: Mapping[str, str] | None = None) -> str:
        """Say in words where the worst cell is."""
        if self.worst is None:
            return "too few samples"
        units = units or {}
        low, high = np.atleast_1d(self.low[self.worst]), np.atleast_1d(self.high[self.worst])
        if self.name == "direction":
            place = DIRECTIONS[int(low[0] + 1.5)]
        elif self.name == "spectrum":
            place = f"around {low.mean() / 2 + high.mean() / 2:.3g} Hz"
        elif self.name in SINCE:
            near, far = sorted(np.abs([low[0], high[0]]))
            word = "rising" if high[0] > 0 else "falling"
            place = f"{_span(near, far, self.unit(units), '{} to {}')} after a reversal, {word}"
        elif self.low.ndim == 2:
            names, kinds = self.label.split(", "), self.unit_of.split(", ")
            axes = zip(names, low, high, kinds, strict=True)
            place = " and ".join(f"{n} in {_span(a, b, _unit(k, units))}" for n, a, b, k in axes)
        else:
            place = f"{self.short} in {_span(low[0], high[0], self.unit(units))}"
        what = (
            "rms error " if self.name == "spectrum" else "mean error +" if self.mean[self.worst] > 0 else "mean error -"
        )
        return f"{place}: {what}{abs(self.mean[self.worst]):.2g} {units.get('y', '')}".rstrip()

    @property
    def short(self) -> str:
        """The variable in a sentence."""
        return self.name.removeprefix("channel:")

    def unit(self, units: Mapping[str, str]) -> str:
        """Return the unit of the axis, where it is known."""
        return _unit(self.unit_of, units)


def _span(low: float, high: float, unit: str, form: str = "[{}, {}]") -> str:
    """Two bounds with just the digits that tell them apart."""
    size = max(abs(low), abs(high), 1e-300)
    digits = int(np.clip(np.ceil(np.log10(size / max(high - low, 1e-12 * size))) + 2, 2, 12))
    values = [0.0 if abs(x) < 1e-3 * (high - low) else x for x in (low, high)]
    return f"{form.format(*(f'{x:.{digits}g}' for x in values))} {unit}".rstrip()


def _unit(kind: str, units: Mapping[str, str]) -> str:
    if kind == "u/s":
        return f"{units['u']}/s" if units.get("u") else ""
    return kind if kind in ("s", "Hz") else units.get(kind, "")


@dataclass(frozen=True, eq=False)
class Misfit:
    """What `where_it_fails` found.

    Attributes
    ----------
    residual : (N,) array [unit of y]
        Free-run error, measured - simulated.
    missing : (N,) array or None [unit of y]
        Equivalent missing input.
    panels, panels_missing : lists of Panel
        For each of the two, the panel that explains most first.
    floor : float or None [unit of y]
        Standard deviation of the measurement noise.
    """

    residual: Array
    missing: Array | None
    panels: list[Panel]
    panels_missing: list[Panel]
    floor: float | None = None

    def table(self, units: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
        """Rows "panel", "share", "share_missing" (NaN without a missing input) and "worst", in words."""
        other = {p.name: p.share for p in self.panels_missing}
        return [
            {"panel": p.name, "share": p.share, "share_missing": other.get(p.name, np.nan), "worst": p.where(units)}
            for p in self.panels
        ]

    def region(self, name: str, missing: bool = False) -> Array:
        """Find the samples in the worst cell of a panel, (N,) array of bool; all of them for "spectrum"."""
        panels = {p.name: p for p in (self.panels_missing if missing else self.panels)}
        if name not in panels:
            raise DataError(f"There is no panel {name!r}; there are {', '.join(panels) or 'none'}.")
        panel = panels[name]
        if panel.worst is None:
            return np.zeros(self.residual.size, dtype=bool)
        return np.asarray(panel.cell == panel.worst) if panel.cell.size else np.ones(self.residual.size, dtype=bool)


def where_it_fails(
    u: Any,
    y: Any,
    simulated: Any,
    Ts: float,
    channels: Mapping[str, Any] | None = None,
    missing: Any = None,
    floor: float | None = None,
) -> Misfit:
    """Look at the error of a model against everything that may matter.

    Parameters
    ----------
    u, y, simulated : (N,) arrays [units of u and y]
        Input, measured output and free run.
    Ts : float [s]
    channels : mapping of names to (N,) arrays
    missing : (N,) array, optional [unit of y]
        Equivalent missing input, from `missing_input`.
    floor : float, optional [unit of y]
        Standard deviation of the measurement noise.

    Returns
    -------
    Misfit
        A variable that does not vary gives no panel.
    """
    named = {"input": u, "measured output": y, "simulated output": simulated}
    named |= {f"channel {n}": x for n, x in (channels or {}).items()}
    named |= {} if missing is None else {"missing input": missing}
    data = {n: vector(x, n, least=2) for n, x in named.items()}
    sizes = {n: x.size for n, x in data.items()}
    if len(set(sizes.values())) > 1:
        raise DataError(f"Give arrays of one length, not {', '.join(f'{n}: {s}' for n, s in sizes.items())}.")
    residual = data["measured output"] - data["simulated output"]
    extra = {n: data[f"channel {n}"] for n in channels or {}}
    empty = _variables(data["input"], data["simulated output"], Ts, extra)
    w = data.get("missing input")
    return Misfit(residual, w, _panels(empty, residual, Ts), [] if w is None else _panels(empty, w, Ts), floor)


def missing_input(residual: Any, slopes: Any, floor: float | None = None) -> Array:
    """Find the smallest forcing that makes the model follow the measurement.

    The free-run error obeys e[k] = sum_i a_i[k] e[k-i] + w[k]. Its noise-free part x minimises
    |e - x|^2 + lam |L x|^2, where L x is the forcing w (Tikhonov); the first n_y rows of L are those of the identity.

    Parameters
    ----------
    residual : (N,) array [unit of y]
        Free-run error e.
    slopes : (N, n_y) array
        a_i[k] = dF/dy[k-i] along the run. Without memory (n_y = 0) the forcing is the error itself.
    floor : float, optional [unit of y]
        Standard deviation of the noise: lam makes rms(e - x) as large (Morozov's discrepancy principle). Without it,
        lam minimises the generalised cross validation (Golub, Heath and Wahba 1979), for white noise.

    Returns
    -------
    w : (N,) array [unit of y]
    """
    e = vector(residual, "free-run error")
    a = np.asarray(slopes, dtype=float)
    if a.ndim != 2 or a.shape[0] != e.size or not np.all(np.isfinite(a)):
        raise DataError(f"The slopes must be finite, of the shape ({e.size}, n_y), not {a.shape}.")
    depth = a.shape[1]
    size = float(np.sqrt(np.mean(e**2)))
    if depth == 0 or size == 0 or e.size <= depth:
        return np.array(e)
    # Row i: what w[k] takes from x[k-i].
    rows = np.vstack([np.ones(e.size), -a.T])
    rows[1:, :depth] = 0
    gram = _gram(rows)
    trials = {False: e[:, None], True: np.column_stack([e, np.random.default_rng(0).choice([-1.0, 1.0], e.size)])}

    def smooth(log_lam: float, probe: bool = False) -> Array:
        band = 10**log_lam * gram
        band[0] += 1
        return np.asarray(solveh_banded(band, trials[probe], lower=True, check_finite=False))

    def excess(log_lam: float) -> float:
        return float(np.log(np.sqrt(np.mean((e - smooth(log_lam)[:, 0]) ** 2)) / max(floor or 0.0, 1e-12 * size)))

    def validation(log_lam: float) -> float:
        x = smooth(log_lam, probe=True)
        # Hutchinson 1990: the trace of the smoother, from one random vector of signs.
        free = 1 - float(trials[True][:, 1] @ x[:, 1]) / e.size
        return float(np.log(np.mean((e - x[:, 0]) ** 2)) - 2 * np.log(free))

    ends = (-4.0, 10.0)
    if floor is None:
        best = float(minimize_scalar(validation, bounds=ends, method="bounded", options={"xatol": 0.1}).x)
    elif excess(ends[0]) >= 0:
        best = ends[0]
    elif excess(ends[1]) <= 0:
        best = ends[1]
    else:
        best = float(brentq(excess, *ends, xtol=0.01))
    x = smooth(best)[:, 0]
    return np.asarray(sum(rows[i, i:] * x[: e.size - i] if i == 0 else _late(rows[i], x, i) for i in range(depth + 1)))


def _late(row: Array, x: Array, lag: int) -> Array:
    """Return row[k] x[k - lag], 0 before the start."""
    return np.concatenate([np.zeros(lag), row[lag:] * x[:-lag]])


def _gram(rows: Array) -> Array:
    """Lower bands of L'L, (n_y + 1, N): entry [d, j] is (L'L)[j + d, j]."""
    depth, n = rows.shape[0] - 1, rows.shape[1]
    out = np.zeros_like(rows)
    for d in range(depth + 1):
        for i in range(d, depth + 1):  # row k = j + i of L holds both columns j and j + d
            out[d, : n - i] += rows[i, i:] * rows[i - d, i:]
    return out


# -- what may matter -------------------------------------------------------------------------------------------


def reversals(u: Array, threshold: float) -> Array:
    """Return the indices where u turns back by more than a threshold: local extremes, noise left out."""
    steps = np.flatnonzero(np.diff(u))
    turns = np.flatnonzero(np.diff(np.sign(np.diff(u)[steps]))) + 1
    found: list[int] = []
    low = high = 0
    way = 0
    for at in [*steps[turns].tolist(), u.size - 1]:
        low, high = (at if u[at] < u[low] else low), (at if u[at] > u[high] else high)
        if way >= 0 and u[at] < u[high] - threshold:
            found += [high] if way else []
            way, low = -1, at
        elif way <= 0 and u[at] > u[low] + threshold:
            found += [low] if way else []
            way, high = 1, at
    return np.array(found, dtype=int)


def _noise(u: Array) -> float:
    """Guess the noise on the input, (N,) array: from third differences and from the steps of a converter."""
    spread = float(np.ptp(u))
    step = spread / max(1, np.unique(u).size - 1)
    third = np.median(np.abs(np.diff(u, 3))) / 0.6745 / np.sqrt(20) if u.size > 3 else 0.0
    # Above this it is excitation, not noise.
    return min(float(max(third, step / np.sqrt(12) if step <= 0.01 * spread else 0.0)), 0.005 * spread)


def _variables(u: Array, y: Array, Ts: float, channels: Mapping[str, Array]) -> list[Panel]:
    """Panels with cells, but without a residual yet."""
    out = [_along("u", "input u", "u", u), _along("y", "simulated output y", "y", y)]
    if np.ptp(u) > 0:
        out += _motion(u, Ts)
    out += [_along("time", "time", "s", Ts * np.arange(u.size))]
    out += [_along(f"channel:{n}", n, n, x) for n, x in channels.items()]
    return [p for p in out if p is not None]


def _motion(u: Array, Ts: float) -> list[Panel | None]:
    """Panels of the direction, the rate and the swings of u."""
    noise, spread, m = _noise(u), float(np.ptp(u)), 0
    smooth = u
    for _ in range(2):  # the second time without noise
        level = noise * 1.5 / np.sqrt(2 * m + 1)
        turns = reversals(smooth, float(np.clip(6 * level, 0.01 * spread, 0.04 * spread)))
        ends = np.unique([0, *turns, u.size - 1])
        swing = np.clip(np.searchsorted(ends, np.arange(u.size), side="right") - 1, 0, ends.size - 2)
        length, height = np.diff(ends), np.diff(smooth[ends])
        pace = np.abs(height / length)[swing]  # mean speed of the own swing, per sample
        if m == 0:
            # The slope of a line through 2 m + 1 samples: its noise is a twentieth of the usual pace at most.
            wanted = np.cbrt(1.5 * (noise / max(0.05 * float(np.median(pace)), 1e-300)) ** 2)
            m = int(
                np.clip(np.ceil(wanted), 1, max(1, min(500, int(np.median(length[swing])) // 4, (u.size - 1) // 2)))
            )
            smooth = savgol_filter(u, 2 * m + 1, 2) if u.size > 2 else u
    slope = savgol_filter(u, 2 * m + 1, 2, deriv=1) if u.size > 2 else np.full(u.size, u[1] - u[0])
    still = _resting(slope, np.maximum(0.05 * pace, 2 * noise * np.sqrt(3 / (m * (m + 1) * (2 * m + 1)))), 2 * m + 1)
    low = np.array([-1.5, -0.5, 0.5])
    way = np.where(still, 0, np.sign(slope)).astype(int) + 1
    out = [_empty("direction", "direction of u", "", low, low + 1, way) if np.unique(way).size > 1 else None]
    out += [_along("rate", "rate of u", "u/s", slope / Ts)]
    after = np.searchsorted(turns, np.arange(u.size), side="right") - 1
    last = turns[np.maximum(after, 0)] if turns.size else np.zeros(u.size, dtype=int)
    sign = np.sign(height)[swing]
    far = np.maximum((smooth - smooth[last]) * sign, 0)
    for name, values, kind in ((SINCE[0], far, "u"), (SINCE[1], Ts * (np.arange(u.size) - last), "s")):
        out += [_since(name, name.replace("_", " "), kind, np.where(after >= 0, values, np.nan), sign)]
    # Swings that are cut off by the ends of the record have no amplitude.
    whole = (after >= 0) & (after < turns.size - 1)
    out += [_grid(*(np.where(whole, x, np.nan) for x in (np.abs(height)[swing] / 2, 1 / (2 * Ts * length)[swing])))]
    return out


def _resting(slope: Array, least: Array, window: int) -> Array:
    """Find where u rests, (N,) array of bool. Where it only turns, the slope passes evenly through zero."""
    near = np.abs(slope) <= 4 * least
    marks = np.diff(np.concatenate([[0], near.astype(int), [0]]))
    first, last = np.flatnonzero(marks > 0), np.flatnonzero(marks < 0)
    inner = np.concatenate([[0], np.cumsum(np.abs(slope) <= least)])
    out = np.zeros(slope.size, dtype=bool)
    for a, b in zip(first, last, strict=True):
        out[a:b] = b - a > window and inner[b] - inner[a] >= 0.5 * (b - a)
    return out


def _edges(x: Array, most: int, even: bool = False) -> Array | None:
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


def _place(x: Array, edges: Array) -> Array:
    """Cell of each sample, -1 where x is NaN."""
    inside = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2)
    return np.where(np.isnan(x), -1, inside)


def _empty(name: str, label: str, kind: str, low: Array, high: Array, cell: Array) -> Panel:
    none, count = np.full(len(low), np.nan), np.bincount(cell[cell >= 0], minlength=len(low))
    return Panel(name, label, kind, low, high, none, none, count, 0.0, cell)


def _along(name: str, label: str, kind: str, x: Array) -> Panel | None:
    """Panel along one variable."""
    edges = _edges(x, CELLS, even=name == "time")
    return None if edges is None else _empty(name, label, kind, edges[:-1], edges[1:], _place(x, edges))


def _since(name: str, label: str, kind: str, x: Array, sign: Array) -> Panel | None:
    """Panel along x >= 0, with cells of its own for the two directions."""
    known = x[np.isfinite(x)]
    edges = _edges(known, 2 * CELLS // 3) if known.size else None
    if edges is None:
        return None
    edges[0] = 0.0
    cell, half = _place(x, edges), edges.size - 1
    both = np.where(cell < 0, -1, np.where(sign > 0, half + cell, half - 1 - cell))
    low = np.concatenate([-edges[:0:-1], edges[:-1]])
    return _empty(name, label, kind, low, np.concatenate([-edges[-2::-1], edges[1:]]), both)


def _grid(amplitude: Array, frequency: Array) -> Panel | None:
    """Panel of joint cells of amplitude and frequency."""
    known = np.isfinite(amplitude)
    sides, places = [], []
    for x, most in ((amplitude, 4), (frequency, 3)):
        # Small differences between swings are noise, not a reason to tell them apart.
        varied = known.any() and np.ptp(x[known]) > 0.05 * np.max(x[known])
        edges = _edges(x[known], most) if varied else None
        if edges is None:
            edges = np.array([np.min(x[known], initial=np.inf), np.max(x[known], initial=-np.inf)])
        sides.append(edges)
        places.append(_place(x, edges))
    first, second = (s.size - 1 for s in sides)
    if first * second < 2:
        return None
    cell = np.where(known, places[0] + first * places[1], -1)  # the amplitude runs faster
    low, high = (
        np.column_stack([np.tile(sides[0][c], second), np.repeat(sides[1][c], first)])
        for c in (slice(None, -1), slice(1, None))
    )
    return _empty("amplitude_frequency", "amplitude, frequency", "u, Hz", low, high, cell)


# -- cell means and their sureness -----------------------------------------------------------------------------


def _panels(empty: list[Panel], r: Array, Ts: float) -> list[Panel]:
    """Fill the panels with a residual, (N,) array; of two that explain the same, the one with fewer cells first."""
    filled = sorted((_fill(p, r) for p in empty), key=lambda p: 0.001 * p.mean.size - p.share)
    rest = r - r.mean()
    for panel in filled:
        if panel.share > 0.02:
            means = _fill(panel, rest).mean
            rest = rest - np.append(np.nan_to_num(means), 0.0)[panel.cell]
    line = _spectrum(rest, float(np.var(r)), Ts)
    return sorted([*filled, *line], key=lambda p: 0.001 * (3 if p.name == "spectrum" else p.mean.size) - p.share)


def _fill(panel: Panel, r: Array) -> Panel:
    """Mean residual of each cell, its standard error, and the share that all means explain."""
    cell, count = panel.cell, panel.count
    inside = cell >= 0
    means = np.bincount(cell[inside], r[inside], count.size) / np.maximum(count, 1)
    apart = np.where(inside, r - means[cell], 0.0)
    length = correlation_length(apart)
    enough = count >= max(LEAST, 3 * length)
    variance = np.full(count.size, np.nan)
    for i in np.flatnonzero(enough):
        # Newey and West 1987: the Bartlett kernel is a running sum, squared. Lags are those of the record.
        lags = int(np.clip(5 * length, 1, count[i] // 3))
        total = np.concatenate([np.zeros(lags), np.cumsum(np.where(cell == i, apart, 0.0)), np.zeros(lags - 1)])
        total[lags + r.size :] = total[lags + r.size - 1]
        sums = total[lags:] - total[:-lags]
        variance[i] = np.einsum("i,i", sums, sums) / lags / count[i] ** 2 / (1 - lags / count[i])
    energy = float(np.sum((r - r.mean()) ** 2))
    between = count * ((means - r.mean()) ** 2 - variance * (1 - count / r.size))
    share = float(np.nansum(between)) / energy if energy > 0 else 0.0
    means = np.where(enough, means, np.nan)
    return replace(panel, mean=means, error=np.sqrt(variance), share=float(np.clip(share, 0.0, 1.0)))


def _spectrum(rest: Array, variance: float, Ts: float) -> list[Panel]:
    """Panel of the spectrum (Welch 1967); none for a short record. `rest` is what the other panels leave."""
    if rest.size < 128:
        return []
    size = int(np.clip(1 << (rest.size // 8).bit_length() - 1, 32, 4096))
    f, density = welch(rest, 1 / Ts, nperseg=size)
    power = density * (f[1] - f[0])
    averages = 2 * rest.size / size - 1
    # A line stands out from the bins to its left and to its right; a hump of coloured noise does not.
    sides = np.convolve(np.pad(power, 8, mode="reflect"), np.full(2 * WIDE, 0.25), "valid")
    background = np.maximum(sides[2 : 2 + f.size], sides[11 : 11 + f.size])
    bands = np.convolve(power, np.ones(2 * WIDE + 1), "same") - (2 * WIDE + 1) * background
    slow = 2 * WIDE + 1  # below, a line cannot be told from a drift
    top = slow + int(np.argmax(bands[slow:]))
    # Less what the highest of many bins of pure noise reaches.
    line = bands[top] - 3 * (2 * WIDE + 1) * background[top] / np.sqrt(averages)
    share = float(np.clip(line / variance, 0.0, 1.0)) if variance > 0 else 0.0
    half, rms = (f[1] - f[0]) / 2, np.sqrt(power)
    count = np.full(f.size, rest.size)
    return [
        Panel("spectrum", "frequency", "Hz", np.maximum(f - half, 0), f + half, rms, rms / np.sqrt(4 * averages), count,
              share, np.empty(0, dtype=int), top)
    ]  # fmt: skip


def misfit_of(model: Model, record: Record, error: Array, floor: float | None) -> Misfit:
    """Where a model fails along a record: the free-run error, and the equivalent missing input.

    Parameters
    ----------
    error : (N,) array
        Measured minus simulated [unit of y].
    floor : float, optional
        rms of the noise [unit of y].
    """
    known = dict(zip(model.symbols, map(float, model.theta), strict=True))
    simulated = record.y - error
    seen = {"u": record.u, "y": simulated, "x": simulated, "v": record.u, "t": record.t, **record.channels}
    slopes = np.zeros((len(record), model.n_y))
    for j in range(model.n_y):
        slope = sp.sympify(derivative(model.core, model.inner[k - j - 1]).xreplace(known))
        if not slope.atoms(sp.Indexed):
            slopes[:, j] = float(slope)
            continue
        columns = Columns([model.in_user_units(expand_phi(slope))])
        if all(str(s.base.label) in seen for s in samples(columns.terms[0])):
            slopes[columns.depth :, j] = columns(seen)[:, 0]
    missing = missing_input(error, slopes, floor)
    return where_it_fails(record.u, record.y, simulated, record.Ts, record.channels, missing, floor)
