"""Effects between two filters: behind a first lag, before the core. v[k] = u[k] + c (g(w[k]) - u[k]), w a lag of u.

A coefficient of 1 is the whole of it, the lag and the effect: at c = 0 the core stands alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import sympy as sp

from ...symbolic.recursion import State
from ...symbolic.signals import k, signal
from . import static  # its effects stand first in the catalogue
from ._effect import WHOLE, Effect, Form, Scan, clip
from .memory import backlash, play

BETWEEN = "behind a lag"
FIRST = Scan("time", (0.1, 0.35, 0.6), beyond=2.0)  # a few samples to a tenth of the record
LIMIT = Scan("amplitude", (0.2, 0.45, 0.7), beyond=1.4)


def first_lag(x: Any, w: Any, tau: Any, Ts: Any) -> State:
    """A first-order lag by an implicit Euler step: rational in tau, so that a law can cancel it."""
    return State(w[k], w[k - 1] + (x[k] - w[k - 1]) / (1 + tau / Ts), x[k])


def behind_a_lag(one: Effect, form: str = BETWEEN, source: str = "Billings & Fakhouri 1982 (general model)") -> Any:
    """Declare a form of an effect that stands behind a first-order lag."""
    return one.another(form, "input", scan={"r": LIMIT, "tau": FIRST}, share=WHOLE, source=source)


@behind_a_lag(static.dead_zone)
def lagged_dead_zone(x: Any, r: Any, tau: Any, Ts: Any) -> Form:
    """What is left of the lag beyond r."""
    w = signal("w")
    return Form((w[k] - clip(w[k], r) - x[k],), (first_lag(x, w, tau, Ts),))


@behind_a_lag(static.saturation)
def lagged_saturation(x: Any, r: Any, tau: Any, Ts: Any) -> Form:
    """The lag, limited to r."""
    w = signal("w")
    return Form((clip(w[k], r) - x[k],), (first_lag(x, w, tau, Ts),))


@behind_a_lag(backlash)
def lagged_backlash(x: Any, r: Any, tau: Any, Ts: Any) -> Form:
    """The lag, through a play."""
    w, p = signal("w"), signal("p")
    held = replace(play(w, p, r), initial=x[k])  # at rest the lag is where its input is
    return Form((p[k] - x[k],), (first_lag(x, w, tau, Ts), held))


def limited_lag(x: Any, tau: Any, Ts: Any, limit: Any) -> Form:
    """A lag that stops at a limit: a first tank that overflows, an actuator with an end stop."""
    w = signal("w")
    free = first_lag(x, w, tau, Ts)
    return Form((w[k] - x[k],), (State(w[k], limit(free.right), x[k]),))


@behind_a_lag(
    static.end_stop, "of a first lag, upper", "Schoukens & Noel 2017 (cascaded tanks: overflow of the upper one)"
)
def upper_stop_of_a_lag(x: Any, r: Any, tau: Any, Ts: Any) -> Form:
    """w[k] = Min(lag of x, r)."""
    return limited_lag(x, tau, Ts, lambda free: sp.Min(free, r))


@behind_a_lag(static.end_stop, "of a first lag, lower", "Schoukens & Noel 2017, mirrored")
def lower_stop_of_a_lag(x: Any, r: Any, tau: Any, Ts: Any) -> Form:
    """w[k] = Max(lag of x, -r)."""
    return limited_lag(x, tau, Ts, lambda free: sp.Max(free, -r))


@behind_a_lag(static.end_stop, "of a first lag, spilling over", "Schoukens & Noel 2017 (cascaded tanks)")
def spilling_lag(x: Any, r: Any, tau: Any, Ts: Any) -> Form:
    """A first tank that overflows at r; a share c2 of what leaves it so reaches the next one at once."""
    w, f = signal("w"), signal("f")
    level = first_lag(x, w, tau, Ts)  # written out in both: what the tank remembers is w alone, from a free start
    spilled = sp.Max(f[k] - r, 0) * (1 + tau / Ts)  # as a flow, in the unit of x
    return Form((w[k] - x[k], spilled), (State(f[k], level.right, x[k]), State(w[k], sp.Min(level.right, r), x[k])))
