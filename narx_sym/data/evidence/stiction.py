"""Whether the valve of a control loop sticks, from controller output (OP), process variable (PV) and no more.

The valve holds until OP has moved away from it by the static band f_s, and then jumps to within f_d of OP (He, Wang,
Pottmann & Qin 2007); f_d = f_s is backlash. A linear process with such a valve before it is compared with the linear
process alone, both in free run (Hammerstein approach: Srinivasan et al. 2005, Jelali 2008), by BIC. Levels integrate:
the process may have a pole at 1. A valve sticks if it does so by more than a healthy one may: dead band and stiction
together at most 1 % of span (EnTech, Control Valve Dynamic Specification, 1998).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.signal import lfilter

from ...errors import DataError
from ..record import Record
from .dead_time import Pairs, output_error

Array = np.ndarray
SPEC = 0.01  # of span: dead band and stiction of a valve in order
BANDS = (0.002, 0.003, 0.004, 0.006, 0.008, 0.012, 0.016, 0.024, 0.032, 0.05, 0.08)  # of span: f_s + f_d
JUMPS = (1.0, 0.5, 0.15, 0.0)  # f_d over f_s
STARTS = (-0.99, 0.0, 0.99)  # of f_s: where the valve is within its band before the record
ORDER, DELAYS, POLISHED = (2, 2), (1, 2, 4), 4  # y is measured before u is written: nothing acts at once
SLOW = 0.95  # pole of the filter that takes out what is slower than 20 samples, such as a load
WIDEST = 0.9  # of the range of OP: a wider band is never left
SEARCHED = 4  # parameters of a sticking valve: f_s, f_d, start, and that the best of many is taken
LONG = 1500  # samples that are looked at


@dataclass(frozen=True, eq=False)
class Sticking:
    """What a valve does.

    Attributes
    ----------
    found : bool
        Whether it sticks by more than the specification allows.
    band, jump : float
        f_s + f_d, how far OP moves before the valve follows after a reversal, and f_s - f_d, how far the valve then
        jumps [unit of OP]; 0 where a linear process explains the record.
    left : float
        Squared error of the process with this valve over that of the linear process.
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

    @property
    def sentence(self) -> str:
        """Return the verdict and its reason."""
        percent, jump = 100 * self.band / self.span, 100 * self.jump / self.span
        if not self.band:
            return (
                "The valve does not stick as far as this record shows: a linear process explains the output at least "
                "as well as one behind a sticking valve, so an oscillation comes from tuning or a disturbance"
            )
        shape = f"then jumps by {jump:.2g} %" if self.jump else "without a jump"
        what = f"the valve holds until OP has come back by {percent:.2g} % of span, {shape}"
        why = f"with it {100 * (1 - self.left):.0f} % of the squared error of a linear process goes"
        if self.found:
            return f"The valve sticks: {what}; {why}"
        return f"The valve does not stick by more than a valve may (1 % of span): {what}; {why}"


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


def percent(record: Record, span: float = 100.0) -> bool:
    """Whether the input can be the output of a controller with this span."""
    return bool(record.u.min() >= 0 and record.u.max() <= span)


def sticking(record: Record, span: float = 100.0) -> Sticking:
    """Ask whether the valve of a control loop sticks.

    Parameters
    ----------
    record : Record
        u is the controller's output, y the process variable; the longest segment is judged.
    span : float
        Of the controller's output: 100 where it is in percent.

    Raises
    ------
    DataError
        Where the controller's output leaves its span.
    """
    part = max(record.segments(), key=len)[:LONG]
    if not percent(part, span):
        raise DataError(
            f"record '{record.name}': the controller's output goes from {part.u.min():.4g} to {part.u.max():.4g}, "
            f"outside 0 to {span:g}; give its span, in its unit, or scale it to percent"
        )
    op, y, range_ = part.u, _quick(part.y), float(np.ptp(part.u))
    linear = min(_error(op, y, d) for d in DELAYS)
    delays = sorted({DELAYS[0], linear[1]})
    found = []
    for band, share, start in product(BANDS, JUMPS, STARTS):
        static = band * span / (1 + share)
        if static + share * static > 2 * WIDEST * range_ or static > WIDEST * range_:
            continue
        position = held(op, static, share * static, float(op[0]) + start * static)
        if np.ptp(position) > 0:
            error = min(_error(position, y, d) for d in delays)
            found.append((error[0], band * span, (1 - share) * static, position))
    best = min(found, key=lambda one: one[0], default=None)
    if best is None or len(part) * np.log(best[0] / linear[0]) + SEARCHED * np.log(len(part)) > 0:
        return Sticking(False, 0.0, 0.0, 1.0, op, part, span)
    least, band, jump, position = best
    return Sticking(bool(band >= SPEC * span), band, jump, least / linear[0], position, part, span)


def _quick(x: Array) -> Array:
    """Take out what is slow: under feedback OP follows the load, and a load is no valve that holds."""
    return np.asarray(lfilter([1.0, -1.0], [1.0, -SLOW], x - x[0]))


def _error(source: Array, y: Array, d: int) -> tuple[float, int]:
    """Return the mean squared error of a linear process behind a signal, and its dead time."""
    pairs: Pairs = [(_quick(source), y)]
    return output_error(pairs, ORDER, d, max(DELAYS), POLISHED).error, d
