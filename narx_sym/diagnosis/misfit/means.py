"""Mean residuals of cells, how sure they are, and the share of the variance that they explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from ...data.metrics import correlation_length
from ..settings import LEAST, TOLD, WIDE
from .panel import Panel

Array = np.ndarray


def filled_panels(empty: list[Panel], r: Array, Ts: float) -> list[Panel]:
    """Fill the panels with a residual, (N,) array; of two that explain the same, the one with fewer cells first."""
    filled = sorted((_fill(p, r) for p in empty), key=lambda p: 0.001 * p.mean.size - p.share)
    rest = r - r.mean()
    for panel in filled:
        if panel.share > TOLD:
            rest = taken_off(panel, _fill(panel, rest).mean, rest)
    line = spectrum(rest, float(np.var(r)), Ts)
    return sorted([*filled, *line], key=lambda p: 0.001 * (3 if p.name == "spectrum" else p.mean.size) - p.share)


def cell_means(panel: Panel, r: Array) -> Array:
    """Return the mean of a residual, (N,), in each cell; NaN where a cell is empty."""
    inside, count = panel.cell >= 0, panel.count
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(panel.cell[inside], r[inside], count.size) / np.where(count, count, np.nan))


def taken_off(panel: Panel, means: Array, r: Array) -> Array:
    """Return a residual, (N,), less the means of the cells that are known."""
    return np.asarray(r - np.append(np.nan_to_num(means), 0.0)[panel.cell])


def _fill(panel: Panel, r: Array) -> Panel:
    """Mean residual of each cell, its standard error, and the share that all means explain."""
    cell, count = panel.cell, panel.count
    inside = cell >= 0
    means = cell_means(panel, r)
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


def spectrum(rest: Array, variance: float, Ts: float) -> list[Panel]:
    """Panel of the spectrum (Welch 1967); none for a short record. `rest` is what the other panels leave."""
    if rest.size < 128:
        return []
    size = int(np.clip(1 << (rest.size // 4).bit_length() - 1, 32, 4096))
    f = np.fft.rfftfreq(size, Ts)
    window = np.hanning(size + 1)[:-1]
    parts = np.lib.stride_tricks.sliding_window_view(rest, size)[:: size // 2]
    lines = np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window)) ** 2
    power = 2 * lines.mean(axis=0) / (size * (window @ window))
    power[[0, -1]] /= 2
    averages = 2 * rest.size / size - 1
    # A line stands out from the bins to its left and to its right; a hump of coloured noise does not.
    sides = np.convolve(np.pad(power, 8, mode="reflect"), np.full(2 * WIDE, 0.25), "valid")
    background = np.maximum(sides[2 : 2 + f.size], sides[11 : 11 + f.size])
    bands = np.convolve(power, np.ones(2 * WIDE + 1), "same") - (2 * WIDE + 1) * background
    slow = 2 * WIDE + 1  # below, a line cannot be told from a drift
    peak = power >= maximum_filter1d(power, 2 * WIDE + 1)  # not the side of a slower line
    top = slow + int(np.argmax(np.where(peak, bands, -np.inf)[slow:]))
    # Less what the highest of many bins of pure noise reaches.
    line = bands[top] - 3 * (2 * WIDE + 1) * background[top] / np.sqrt(averages)
    share = float(np.clip(line / variance, 0.0, 1.0)) if variance > 0 else 0.0
    half, rms = (f[1] - f[0]) / 2, np.sqrt(power)
    count = np.full(f.size, rest.size)
    return [
        Panel("spectrum", "frequency", "Hz", np.maximum(f - half, 0), f + half, rms, rms / np.sqrt(4 * averages), count,
              share, np.empty(0, dtype=int), top)
    ]  # fmt: skip
