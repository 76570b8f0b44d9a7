"""Whether the valve of a control loop sticks, from controller output (OP), process variable (PV) and no more.

The valve holds until OP has moved away from it by the static band f_s, and then jumps to within f_d of OP (He, Wang,
Pottmann & Qin 2007); f_d = f_s is backlash. A process behind such a valve is compared with the process alone
(Hammerstein approach: Srinivasan et al. 2005, Jelali 2008). Under feedback OP follows the load, and a process without a
model of the load is biased (Ljung 1999, section 13.4): both predict one step ahead, with as many lags as the process
alone earns, and with a bend of the valve where that does (AIC: Shibata 1980), so that what is compared is what neither
PV's past nor OP's predicts. Levels integrate: nothing forbids a pole at 1. A valve sticks if it does so by more than a
healthy one may: dead band and stiction together at most 1 % of span (EnTech, Control Valve Dynamic Specification,
1998). It also does where OP moves by little more than the band: so swings a loop that cycles by its valve, however
small the band. What a load or the tuning moves goes far beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import qr

from ...errors import DataError
from ..record import Record
from .feedback import setpoint

Array = np.ndarray
SPEC = 0.01  # of span: dead band and stiction of a valve in order
CYCLE = 0.5  # of OP's swing: what the band is at least in a loop that cycles by its valve
BANDS = (0.002, 0.003, 0.004, 0.006, 0.008, 0.012, 0.016, 0.024, 0.032, 0.05, 0.08)  # of span: f_s + f_d
JUMPS = (1.0, 0.5, 0.15, 0.0)  # f_d over f_s
STARTS = (-0.99, 0.0, 0.99)  # of f_s: where the valve is within its band before the record
LAGS = (1, 2, 3, 4, 6, 8, 12, 16, 24)  # of PV and OP; y is measured before u is written: nothing acts at once
WIDEST = 0.9  # of the range of OP: a wider band is never left
SEARCHED = 2  # parameters of a sticking valve: f_s and f_d
LEADS = 1 / 3  # of PV's range: a setpoint moves by this at least; 0.38 ... 1.7 where valves stick, a trifle 0 ... 0.3
SHARES = ("", "1", "%", "percent", "pct")  # units of an output that is told in parts of its span; none may be that too
LONG, SHORT = 6000, 10  # samples that are looked at; samples for each lag, at least
OWN = 1e-3  # of a lag of OP: a controller without noise makes the rest from the lags of PV, where it is no parameter
ROUNDING = 1e-7  # of PV's deviation: what rounding leaves of an output without noise


@dataclass(frozen=True, eq=False)
class Sticking:
    """What a valve does.

    Attributes
    ----------
    found : bool
        Whether it sticks by more than the specification allows or makes the loop cycle, as a setpoint has shown that
        moves more than once, and by a third of PV's range.
    perhaps : bool
        Whether it looks so, but hardly anything moved the loop but its load: one that steps or ramps would look
        alike. Where the setpoint is known, only what cycles by the valve looks so.
    band, jump : float
        f_s + f_d, how far OP moves before the valve follows after a reversal, and f_s - f_d, how far the valve then
        jumps [unit of OP]; 0 where a process without it explains the record.
    left : float
        Mean squared one-step error of the process with this valve over that without it.
    position : (N,) array
        Of the valve, as estimated [unit of OP].
    record : Record
        What was judged.
    """

    found: bool
    band: float
    jump: float
    left: float
    position: Array
    record: Record
    span: float
    perhaps: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return what a JSON file says of the valve."""
        return {
            "record": self.record.name, "sticks": self.found, "perhaps": self.perhaps, "band": self.band,
            "jump": self.jump, "sentence": self.sentence,
        }  # fmt: skip

    @property
    def verdict(self) -> str:
        """Return the verdict in a few words."""
        return (
            f"the valve {'probably sticks' if self.found else 'may stick' if self.perhaps else 'is not found to stick'}"
        )

    @property
    def sentence(self) -> str:
        """Return the verdict and its reason."""
        if not self.band:
            return (
                "The valve is not found to stick: a process model without stiction predicts the output about as "
                "well. This is no proof: stiction of one or two percent of span is often not found, in level control "
                "also more"
            )
        percent, jump = 100 * self.band / self.span, 100 * self.jump / self.span
        taken = "" if self.record.units.get("u") else ", as OP has no unit"
        what = (
            f"after a reversal the valve does not move until OP has changed by {percent:.2g} % of its span of "
            f"{self.span:g}{taken}"
        )
        what += f", then jumps by {jump:.2g} %" if self.jump else ""
        why = (
            f"with this valve a process model predicts the output with {100 * (1 - self.left):.2g} % less squared error"
        )
        if self.found:
            return f"The valve probably sticks: {what}; {why}"
        if self.perhaps:
            return (
                f"The valve may stick: {what}; {why}. But no moving setpoint was recorded, and a load with steps or "
                "ramps looks the same: move the setpoint up and down by a few percent, and record it too"
            )
        swing = f"the range of OP is {float(np.ptp(self.record.u)) / self.band:.2g} times as large"
        if self.band < SPEC * self.span:
            return f"The valve is not found to stick by more than is acceptable (1 % of span): {what}; {why}; {swing}"
        return (
            f"The valve is not found to stick: {what}; {why}. But the setpoint hardly moves the loop, and {swing}: "
            "this comes from the load, which then looks the same as stiction"
        )


def worst_valve(valves: Sequence[Sticking]) -> Sticking:
    """Return the valve that most surely sticks; the first one where none does."""
    return max(valves, key=lambda v: (v.found, v.perhaps))


def held(op: Array, static: float, moving: float, start: float) -> Array:
    """Return the position of a valve that holds within `static` of OP, and then jumps to within `moving` of it."""
    position, x = np.empty_like(op), start
    for k, wanted in enumerate(op.tolist()):
        if wanted - x > static:
            x = wanted - moving
        elif x - wanted > static:
            x = wanted + moving
        position[k] = x
    return position


def span_of(record: Record) -> float:
    """Return the span of the input as the output of a controller, or 0 where it cannot be one.

    1 for fractions, 100 for percent, 16 where its unit is mA (4 to 20): a loop does not work below 1 % of its span.
    In another unit it is the setpoint of a second controller, or nobody knows its span.
    """
    low, high, unit = float(record.u.min()), float(record.u.max()), record.units.get("u", "")
    if unit == "mA":
        return 16.0 if low >= 3 and high <= 21 else 0.0
    if unit not in SHARES:
        return 0.0
    return next((span for span in (1.0, 100.0) if low >= 0 and high <= span), 0.0)


def sticking(record: Record, span: float = 0.0) -> Sticking:
    """Ask whether the valve of a control loop sticks.

    Parameters
    ----------
    record : Record
        u is the controller's output, y the process variable; the longest segment is judged.
    span : float
        Of the controller's output, in its unit; 0: see `span_of`.

    Raises
    ------
    DataError
        Where the controller's output has no known span.
    """
    part = max(record.segments(), key=len)[:LONG]
    span = span or span_of(record)
    if not span:
        unit = " " + record.units["u"] if record.units.get("u") else ""
        raise DataError(
            f"record '{record.name}': the controller's output goes from {part.u.min():.4g} to {part.u.max():.4g}{unit}"
            ", which is neither a fraction nor percent nor 4 to 20 mA; give its span, in its unit, or scale it to "
            "percent"
        )
    op, range_ = part.u, float(np.ptp(part.u))
    process = _Process.of(part)
    found = []
    for band, share, start in product(BANDS, JUMPS, STARTS):
        static = band * span / (1 + share)
        if static + share * static > 2 * WIDEST * range_ or static > WIDEST * range_:
            continue
        position = held(op, static, share * static, float(op[0]) + start * static)
        if np.ptp(position) > 0:
            found.append((process.behind(position)[0], band * span, (1 - share) * static, position))
    (alone, own), best = process.behind(op), min(found, key=lambda one: one[0], default=None)
    every = process.lags * (1 + process.bent)  # of the position every lag may be its own
    price = SEARCHED * np.log(process.n) + 2 * (every - own)
    if best is None or process.n * np.log(best[0] / alone) + price > 0:
        return Sticking(False, 0.0, 0.0, 1.0, op, part, span)
    least, band, jump, position = best
    wide, cycles, wanted = bool(band >= SPEC * span), bool(band >= CYCLE * range_), setpoint(part)
    moved = wanted is not None and _moves(part.y, wanted)
    perhaps = not moved and (cycles or (wide and wanted is None))
    return Sticking(moved and (wide or cycles), band, jump, least / alone, position, part, span, perhaps)


def _moves(y: Array, wanted: Array) -> bool:
    """Whether the setpoint moves more than once, and much of what PV does: a load that steps looks alike."""
    return bool(np.count_nonzero(np.diff(wanted)) > 1 and np.ptp(wanted) >= LEADS * np.ptp(y))


@dataclass(frozen=True)
class _Process:
    """What PV is predicted from, one step ahead: its own last `lags` samples, and those of what moves the process.

    That acts through a straight line, or where `bent` through a parabola, as that of an equal-percentage valve.

    `known` is an orthonormal basis of PV's own and of a constant; `target` is PV without it; `n` samples are predicted.
    """

    lags: int
    bent: bool
    n: int
    known: Array
    target: Array
    least: float

    @classmethod
    def of(cls, part: Record) -> _Process:
        """Choose the number of lags, and whether it is bent, for the process without a sticking valve."""
        y = part.y - part.y.mean()
        most = max(1, min(LAGS[-1], y.size // SHORT))
        n, least = y.size - most, float(np.var(y)) * ROUNDING**2
        found = []
        for lags in (n for n in LAGS if n <= most):
            known = qr(np.column_stack([_past(y, lags, n), np.ones(n)]), mode="economic")[0]
            target = y[most:] - known @ (known.T @ y[most:])
            for bent in (False, True):
                one = cls(lags, bent, n, known, target, least)
                error, own = one.behind(part.u)
                found.append((n * np.log(error) + 2 * (lags + own), one))
        return min(found, key=lambda pair: pair[0])[1]

    def behind(self, moved: Array) -> tuple[float, int]:
        """Return the mean squared one-step error where `moved` moves the process, and how many of its lags count."""
        x = moved - moved.mean()
        past = np.column_stack([_past(part, self.lags, self.n) for part in ([x, x**2] if self.bent else [x])])
        past /= np.maximum(np.linalg.norm(past, axis=0), np.finfo(float).tiny)
        past -= self.known @ (self.known.T @ past)
        basis, triangle, _ = qr(past, mode="economic", pivoting=True)
        own = np.abs(np.diag(triangle))
        basis = basis[:, own > ROUNDING]
        e = self.target - basis @ (basis.T @ self.target)
        return max(float(e @ e) / self.n, self.least), int(np.sum(own > OWN))


def _past(x: Array, lags: int, n: int) -> Array:
    """Return the last samples before each of the last n, (n, lags)."""
    return np.column_stack([x[x.size - n - i : x.size - i] for i in range(1, lags + 1)])
