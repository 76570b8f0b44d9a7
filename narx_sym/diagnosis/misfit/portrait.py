"""The portrait of what is missing: the equivalent missing input against the variable that explains most of it.

It is computed from the data and the base alone, at the working rate of the diagnosis: there friction is a step at zero
velocity, slack and hysteresis a loop, the root of a level a root. What each model adds is smoothed alike, so the
picture of the base less that of a law is the picture of what the law leaves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...data.evidence.rate import means
from ...data.record import Record
from ...models.model import Model
from ..settings import BAND, CYCLE, ENOUGH, FAINT, SHIFTS, TOLD, TWICE
from ..table.starts.arx import resampled
from .cells import along, beside, since
from .forcing import Forcing
from .means import cell_means, spectrum, taken_off
from .motion import Motion
from .panel import Panel
from .slopes import slopes_along

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Portrait:
    """What a model lacks, against each variable that may explain it.

    Attributes
    ----------
    t : (M,) array [s]
    missing : (M,) array [`unit_of`]
        Equivalent missing input (Hooker 2009), positive where it drives as the input does.
    unit_of : str
        "u", or "y" where the base has no gain from its input.
    bandwidth : float [Hz]
        Where the smoother passes half of an error.
    views : list of Panel
        The variable that explains most first; `error` is half the width of the band of chance in each cell.
    values : mapping from the name of a view to its variable, (M,) array
    laws : mapping from what was added to (M,) arrays [`unit_of`]
        What each model adds to the base, through the same smoother.
    """

    t: Array
    missing: Array
    unit_of: str
    bandwidth: float
    views: list[Panel]
    values: dict[str, Array]
    laws: dict[str, Array]

    @property
    def view(self) -> Panel:
        """The view that explains most."""
        return self.views[0]

    def seen(self, panel: Panel | None = None) -> bool:
        """Whether a view, or any, explains more than 5 %, and some mean leaves its band of chance."""
        views = self.views if panel is None else [panel]
        return any(p.share > FAINT and bool(np.any(np.abs(p.mean) > p.error)) for p in views)

    def of(self, name: str) -> Panel:
        """Return the law of a model in the best view: the means of what it adds."""
        return replace(self.view, mean=cell_means(self.view, self.laws[name] - self.laws[name].mean()))

    def left(self, name: str) -> Panel:
        """Return the best view after a model was added; its share is that of the missing input before."""
        return filled(self.view, self.missing - self.laws[name], of=self.missing)

    def to_dict(self) -> dict[str, Any]:
        """Return the best view, the share of each, and the means of the laws as plain data."""
        best = self.view
        return {
            "variable": best.name, "label": best.label, "unit_of": self.unit_of,
            "bandwidth_Hz": _short(self.bandwidth), "seen": self.seen(best),
            "share": {p.name: round(p.share, 6) for p in self.views},
            "low": _listed(best.low), "high": _listed(best.high), "mean": _listed(best.mean),
            "band": _listed(best.error),
            "laws": {n: {"mean": _listed(self.of(n).mean), "left": round(self.left(n).share, 6)} for n in self.laws},
        }  # fmt: skip


def _listed(x: Array) -> list[float | None]:
    return [_short(v) for v in x.tolist()]


def _short(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None


def portrait_of(
    model: Model, record: Record, error: Array, factor: int = 1, after: Mapping[str, Array] | None = None
) -> Portrait:
    """Draw what a model lacks along a record.

    Parameters
    ----------
    error : (N,) array [unit of y]
        Measured minus simulated.
    factor : int
        Samples that become one: the working rate is the record's over it.
    after : mapping from a name to (N,) arrays [unit of y], optional
        Measured minus simulated by models with something added.

    Returns
    -------
    Portrait
    """
    a, b = (s.mean(axis=0) for s in slopes_along(model, record, record.y - error))
    slow = resampled(a, 1 / factor) if factor > 1 and a.size else a
    gain = float(b.sum()) * _steps(a, slow, factor)
    e, u, y, t = (means(x, factor) for x in (error, record.u, record.y, record.t))
    own = np.append(1.0, -slow)
    # The forcing is smoothed, not made small: its second difference is what costs.
    bent = -np.convolve(own, [1.0, -2.0, 1.0])[1:]
    smoother = Forcing(e, np.tile(bent, (e.size, 1)), started=True)
    smoother.log_lam = smoother.reaching(1 / CYCLE)
    inner = slice(bent.size, None)  # before, a start takes what is forced

    def forcing(error: Array) -> Array:
        return np.asarray(scale * np.convolve(own, smoother.smooth(error))[: e.size][inner])

    unit, scale = ("u", 1 / gain) if gain and np.isfinite(gain) else ("y", 1.0)
    Ts, lag = factor * record.Ts, round(model.delay / factor)
    late = np.concatenate([np.full(lag, u[0]), u[: u.size - lag]])
    channels = {n: means(x, factor)[inner] for n, x in record.channels.items()}
    level = (y - e + smoother.smooth(e))[inner] if a.size else None
    views, values = _views(late[inner], level, t[inner], channels, Ts)
    w, t = forcing(e), t[inner]
    w = w - w.mean()
    found = ranked([filled(p, w) for p in views])
    rest = w
    for panel in found:
        rest = taken_off(panel, cell_means(panel, rest), rest) if panel.share > TOLD else rest
    for line in spectrum(rest, float(np.var(w)), Ts):
        if line.share > 0 and (hum := _folded(line, rest, w, t)) is not None:
            found, values["period"] = ranked([*found, hum]), hum.centres[hum.cell]
    laws = {name: forcing(e - means(left, factor)) for name, left in (after or {}).items()}
    return Portrait(t, w, unit, 1 / (CYCLE * Ts), found, values, laws)


def _steps(a: Array, slow: Array, factor: int) -> float:
    """How many inputs of one sample make that of a slow sample: the same gain at rest, or slope of an integrator."""
    one, many = 1 - a.sum(), 1 - slow.sum()
    if abs(one) > 1e-9:  # arithmetic leaves less of an exact integrator
        return float(many / one)
    late = np.arange(1, a.size + 1)
    return float(factor * (late @ slow) / (late @ a)) if a.size else 1.0


def _folded(line: Panel, rest: Array, of: Array, t: Array) -> Panel | None:
    """Return what the others leave, over the period of its strongest line."""
    low, high = line.low[line.line], line.high[line.line]
    tried = np.linspace(2 * low - high, 2 * high - low, 6 * int(np.ceil((high - low) * np.ptp(t))) + 1)
    f = tried[np.argmax(np.abs(np.exp(-2j * np.pi * np.outer(tried, t)) @ rest))]
    phase = np.mod(t - t[0], 1 / f)
    made = along("period", f"time within the period of {f:.4g} Hz", "s", phase)
    return made and filled(made, rest, of)


def _views(u: Array, y: Array | None, t: Array, channels: Mapping[str, Array], Ts: float) -> tuple[list[Panel], Any]:
    """Return the variables that are looked along, (M,) arrays, with empty panels."""
    seen = {"u": u} if y is None else {"u": u, "y": y}  # without memory the output is no cause
    values: dict[str, Array] = {**seen, "time": t} | {f"channel:{n}": x for n, x in channels.items()}
    labels = {"u": "input u", "y": "output y"} | {f"channel:{n}": n for n in channels}
    kinds = {"u": "u", "y": "y", "time": "s"} | {f"channel:{n}": n for n in channels}
    found: list[Panel | None] = []
    for name, x in seen.items():
        word = {"u": "input", "y": "output"}[name]
        if not np.ptp(x) > 0:
            continue
        motion = Motion.of(x)
        speed, turned = ("velocity", "rate")[name == "u"], f"distance_since_reversal:{name}"
        values[speed], labels[speed], kinds[speed] = motion.slope / Ts, f"rate of the {word}", f"{name}/s"
        far = np.maximum((motion.smooth - motion.smooth[motion.last]) * motion.sign, 0)
        values[turned] = np.where(motion.after >= 0, far, np.nan)
        found.append(since(turned, f"travel of the {word} since its reversal", name, values[turned], motion.sign))
        if name == "u":
            found.append(beside("u", "input u, rising and falling", u, motion.slope > 0, 2))
    found += [along(n, labels.get(n, n), kinds[n], x) for n, x in values.items() if n in labels or n == "time"]
    for other in ("time", *list(seen)[1:], *(f"channel:{n}" for n in channels)):
        found.append(beside(other, f"input u, by {labels.get(other, other)}", u, values[other], 3))
    views = [panel for panel in found if panel is not None]
    return views, values | {p.name: u for p in views if p.name.startswith("u|")}


def ranked(views: list[Panel]) -> list[Panel]:
    """Return views, that which explains most first: of those that explain as much, one variable, and one that acts.

    Two variables stand there only where one alone explains less than half.
    """
    alone = {p.name: p.share for p in views}
    found = [p for p in views if "|" not in p.name or p.share > TWICE * alone.get("u", 0.0)]
    found.sort(key=lambda p: -p.share)
    alike = [p for p in found if p.share >= ENOUGH * found[0].share]
    first = min(alike, key=lambda p: ("|" in p.name, "time" in p.name))
    return [first, *(p for p in found if p is not first)]


def filled(panel: Panel, w: Array, of: Array | None = None) -> Panel:
    """Fill a view: means, what chance makes of them, and the share of the variance beyond chance.

    Chance is what the view leaves, shifted in time as a circle against the variable: it keeps its own colour.
    """
    w = w - w.mean()
    mean, inside = cell_means(panel, w), panel.cell >= 0
    apart = np.where(inside, w - mean[panel.cell], 0.0)
    shifts = np.linspace(0, w.size, SHIFTS + 1, endpoint=False).astype(int)[1:]
    moved = np.array([cell_means(panel, np.roll(apart, s)) for s in shifts])
    chance = moved.std(axis=0)
    energy = float(np.sum((w if of is None else of - of.mean()) ** 2))
    share = float(np.nansum(panel.count * (mean**2 - chance**2))) / energy if energy else 0.0
    return replace(
        panel, mean=mean, error=np.maximum(BAND * chance, np.abs(moved).max(axis=0)), share=float(np.clip(share, 0, 1))
    )
