"""Feedback: whether the input answers the output, as that of a controller does.

Under feedback the input contains the disturbance, and a fit of the plant is biased towards the negative inverse of the
controller (Soederstroem & Stoica 1989, chapter 10): a healthy valve looks like one with friction. What tells it is the
part of the input that its own past does not predict (and the setpoint, where it is recorded). In the open loop the
output can only follow it; a controller makes it from the output (Granger 1969, with the same sample included).

Where y's past foretells the input, it answers: no plant does that. A plant that passes its input on at once (a damper,
whose force follows the speed) also links both at the same sample. Without a setpoint it is told from a controller by
the form of the relation. A controller opposes: what the input answers has the opposite sign of what it does to the
output a little later. Or its step follows from the last outputs, most of it from their change; a plant read backwards
takes the level of y as much as its change, or has both in the order of a plant: what passes at once is part of what
passes in the end. A plant that forgets its input (y = du), or passes more of it on at once than in the end (a lead), is
a controller read backwards: nothing but the setpoint tells them apart, or who took the record. A controller that runs
more slowly than the record holds its output in between: it answers when it moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq

from ...engines.algebra import smoothed
from ..record import Record
from .noise import usual_size
from .roles import SETPOINT

Array = np.ndarray
OWN, TURNS = 12, 8  # lags of each signal; rounds of the robust fit
FRESH = 0.03  # of the input's movement: less than that is new, and there is nothing to explain
LEFT = 0.65  # share of what is new in the input that the output leaves unexplained, under feedback at most
LATE = 0.4  # the same by past outputs alone: late controllers leave 0 ... 0.36, steps on sines 0.47, open records 0.66
SURE = 0.15  # so little is left by no bent plant that is read backwards: 0.24 and more of 450 dampers
AHEAD, CAUSED = 2, 0.95  # samples until the output shows what the input does, and the error of a forecast without it
ORDER = 0.5  # slow over fast relation of a plant without dead time at least
INTEGRAL = 0.7  # integral over proportional action within one sample, at most; a damper read backwards has 1
ROUNDING = 1e-9  # of the output's range: a gain without noise
FEWEST, LONG = 100, 20_000  # samples that are needed, and that are looked at
COPY = 1e-6  # of a signal's range: what is as near as that is the same signal, written with fewer digits
LED = 0.9  # share of the input's variance that the setpoint makes, at least: servo axes 0.98, under loads 0 ... 0.9
BLOCKS, FILTERS = 12, 1 - np.geomspace(0.5, 0.002, 9)  # of a record; poles of lags through which a setpoint may act


@dataclass(frozen=True)
class Feedback:
    """Whether the input answers the output.

    Attributes
    ----------
    found : bool
    fresh : float
        Share of the input's movement that its own past (and the setpoint) does not predict.
    left : float
        Share of that which stays when the output is known too.
    given : bool
        Whether the setpoint is recorded, so that the loop is known.
    led : float
        Share of the input's variance within a block that follows from the setpoint; the rest answers disturbances, and
        what bends.
    rests : bool
        Whether the setpoint never moves, so that it does not tell whether the controller was in manual.
    """

    found: bool
    fresh: float
    left: float
    given: bool = False
    led: float = 0.0
    rests: bool = False

    @property
    def sentence(self) -> str:
        """What to know, and what to record instead."""
        why = (
            (f": the output explains {100 * (1 - self.left):.0f} % of the unpredictable part of the input")
            if self.found
            else ""
        )
        if self.unseen:
            return (
                "The setpoint never moves, so this record does not show whether it was taken in closed loop: no "
                "effect is named. If the controller was in manual mode, leave the setpoint out (--role NAME=ignore)"
            )
        if self.given and not self.rests:
            return (
                f"This record has a setpoint and was taken in closed loop{why}. What seems to be missing may come "
                "from the controller. So an effect is named only if the setpoint causes nearly all movement of the "
                "input, and the effect alone removes nearly all of the error"
            )
        taken = "taken" if self.given else "probably taken"
        where = "with a setpoint that moves" if self.rests else "give the setpoint (--role NAME=setpoint)"
        if not self.given:
            where += ". If there was no controller, use --open-loop"
        return (
            f"This record was {taken} in closed loop{why}. Disturbances reach the input through the "
            "controller, so what seems to be missing may come from the controller. Record again with the controller "
            f"in manual mode and steps or a slow triangle as input, or {where}"
        )

    @property
    def unseen(self) -> bool:
        """Whether nothing tells that this was a closed loop but a setpoint that never moves."""
        return self.rests and not self.found

    @property
    def moved_by_setpoint(self) -> bool:
        """Whether hardly anything but the setpoint moves the input, so that an effect can be told."""
        return self.led > LED

    @property
    def outweighed(self) -> str:
        """What to know where an effect explains more than a controller's answers could imitate."""
        return (
            f"This record was taken in closed loop. The setpoint causes {100 * self.led:.0f} % of the movement of "
            "the input, so disturbances that pass through the controller can imitate only a small part of the effect"
        )


def setpoint(record: Record) -> Array | None:
    """Return the setpoint where a channel has that role.

    One that is the input or the output itself tells of no loop: the input of a servo as a whole is its setpoint, and in
    manual many controllers let the setpoint follow the output.
    """
    r = next((x for name, x in record.channels.items() if record.roles[name] == SETPOINT), None)
    return None if r is None or any(_same(r, x) for x in (record.u, record.y)) else r


def _same(r: Array, x: Array) -> bool:
    return bool(np.max(np.abs(r - x)) <= COPY * np.ptp(x))


def feedback(record: Record) -> Feedback:
    """Ask the longest segment of a record whether its input answers its output."""
    part = max(record.segments(), key=len)[:LONG]
    wanted = setpoint(part)
    u, y, r = part.u, part.y, wanted
    given, rests = wanted is not None, wanted is not None and not np.ptp(wanted)
    moves = np.flatnonzero(np.diff(u)) + 1
    if 2 * moves.size < u.size:  # what is held in between answers when it moves
        u, y, r = u[moves], y[moves], None if r is None else r[moves]
    rows = np.arange(OWN + 1, u.size)
    target, now = u[rows] - u[rows - 1], y[rows] - y[rows - 1]
    moved = usual_size(target) if rows.size >= FEWEST else 0.0
    if rests:
        r = None  # it tells nothing
    if moved == 0 or not np.any(now):
        return Feedback(False, 0.0, 1.0, given, rests=rests)
    own, past = _lags(u, rows - 1), _lags(y, rows - 1)
    if r is not None:
        dr = np.diff(r, prepend=r[0])
        own += [x for x in (r[rows - 1], dr[rows], dr[rows - 1]) if np.ptp(x) > 0]
    alone, _ = _robust(own, target)
    both, slopes = _robust([*own, past[0], now, *past[1:]], target)
    of = usual_size(alone) or 1.0
    ramp = usual_size(target - own[1])  # what goes on as before is not new; where a sweep begins again, a fit is bent
    fresh, left = min(usual_size(alone), ramp) / moved, usual_size(both) / of
    found = fresh > FRESH and left < LEFT
    late = usual_size(_robust([*own, *past], target)[0]) if found and r is None else 0.0
    if late > LATE * of:
        slow_u, slow_y, fast = -slopes[0], slopes[len(own)], slopes[len(own) + 1 :]
        line, level = np.polyfit(u - u.mean(), y, 1)
        exact = line > 0 and np.ptp(y - level - line * (u - u.mean())) <= ROUNDING * np.ptp(y)  # a gain without noise
        quick, own_order = _answers(slow_u, slow_y, fast, line)
        newest = usual_size(both) < CAUSED * late  # else it is no answer at once
        found = not exact and quick and newest and ((own_order and left < SURE) or _opposes(u, y, fast[0]))
    leads = 0.0 if wanted is None or rests else led(part.u, wanted)
    return Feedback(bool(found), float(fresh), float(min(left, 1.0)), given, leads, rests)


def led(u: Array, r: Array) -> float:
    """Return the share of the input's variance that follows from a setpoint through lags: the median over blocks.

    Least squares of u on r, its step, and r behind one lag and two of each pole in FILTERS. What a block holds on to
    does not count, so that a setpoint that hardly ever steps leads nothing.
    """
    columns = [r, np.diff(r, prepend=r[0]), np.ones(r.size)]
    for pole in FILTERS:
        columns.append(smoothed(pole, r - r[0]))
        columns.append(smoothed(pole, columns[-1]))
    X = np.column_stack(columns)
    e = u - X @ lstsq(X, u, cond=1e-10)[0]
    moved = [(np.var(a), np.var(b)) for a, b in zip(np.array_split(u, BLOCKS), np.array_split(e, BLOCKS), strict=True)]
    return float(max(0.0, np.median([1 - left / of if of > 0 else 0.0 for of, left in moved])))


def _answers(slow_u: float, slow_y: float, fast: Array, line: float) -> tuple[bool, bool]:
    """Return whether most of an answer comes from the change of y, and whether it has not the order of a plant.

    slow_u u = slow_y y at rest; of a plant that is its gain, and at least about what its first sample says.
    """
    first = fast[np.argmax(np.abs(fast))]
    ordered = slow_u * first >= ORDER * slow_y if slow_y > 0 else slow_u * first <= ORDER * slow_y
    return bool(abs(slow_y) < INTEGRAL * abs(first)), bool(not ordered or first * line < 0)


def _opposes(u: Array, y: Array, at_once: float) -> bool:
    """Return whether the input answers the output with the opposite sign of what it does to it.

    What it does is seen some samples later, beside all that the output's own past foretells, and lowers the error of
    that forecast clearly: the force of a damper follows the speed, and a speed returns to its mean by itself.
    """
    rows = np.arange(OWN, u.size - AHEAD)
    caused = y[rows + AHEAD] - y[rows]
    error, slopes = _robust([*_lags(y, rows), *_lags(u, rows)], caused)
    new = slopes[OWN] + slopes[OWN + 1]  # the level of u, and its last step
    return bool(new * at_once < 0 and usual_size(error) < CAUSED * usual_size(_robust(_lags(y, rows), caused)[0]))


def _lags(x: Array, rows: Array) -> list[Array]:
    """Return a signal at some rows and its last steps before them, OWN columns."""
    return [x[rows], *(x[rows - i + 1] - x[rows - i] for i in range(1, OWN))]


def closed_loop(records: Sequence[Record]) -> Feedback | None:
    """Return the clearest feedback in some records, or None; a record with a setpoint is in a loop anyway."""
    found = [one for one in map(feedback, records) if one.found or one.given]
    return min(found, key=lambda one: one.left, default=None)


def _robust(columns: Sequence[Array], target: Array) -> tuple[Array, Array]:
    """Return the residuals and slopes of a fit that rare large values do not bend: weights fall with the residual."""
    X = np.column_stack([*columns, np.ones(target.size)])
    scale = np.linalg.norm(X - np.append(X[:, :-1].mean(axis=0), 0.0), axis=0)
    scale[scale == 0] = 1.0
    X, weights = X / scale, np.ones(target.size)
    for _ in range(TURNS):
        theta = lstsq(X * weights[:, None], target * weights, cond=1e-10)[0]
        e = target - X @ theta
        usual = 2 * usual_size(e)
        weights = 1 / np.sqrt(np.maximum(1.0, np.abs(e) / (usual or 1.0)))
    return e, theta / scale
