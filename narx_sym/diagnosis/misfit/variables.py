"""What the error of a model is looked at against: each variable is one function with `@variable`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .cells import along, empty, grid, since
from .motion import Motion
from .panel import SINCE, Panel

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Run:
    """What a model was run along: input and simulated output, (N,) arrays, with further channels; Ts in s."""

    u: Array
    y: Array
    Ts: float
    channels: Mapping[str, Array] = field(default_factory=dict)

    @cached_property
    def motion(self) -> Motion:
        """How the input moves."""
        return Motion.of(self.u)


Find = Callable[[Run], Iterable[Panel | None]]
VARIABLES: dict[str, tuple[Find, bool]] = {}


def variable(moves: bool = False) -> Callable[[Find], Find]:
    """Register a variable under the name of its function, which returns its panels without a residual.

    Parameters
    ----------
    moves : bool
        It looks at the motion of the input: where that rests, there is no panel.
    """

    def register(find: Find) -> Find:
        VARIABLES[find.__name__] = (find, moves)
        return find

    return register


def empty_panels(run: Run) -> list[Panel]:
    """Return panels with cells, but without a residual yet; a variable that does not vary has none."""
    moving = bool(np.ptp(run.u) > 0)
    found = (panel for find, moves in VARIABLES.values() if moving or not moves for panel in find(run))
    return [panel for panel in found if panel is not None]


@variable()
def u(run: Run) -> list[Panel | None]:
    """Look along the input."""
    return [along("u", "input u", "u", run.u)]


@variable()
def y(run: Run) -> list[Panel | None]:
    """Look along the simulated output: it is free of the noise in the error."""
    return [along("y", "simulated output y", "y", run.y)]


@variable(moves=True)
def direction(run: Run) -> list[Panel | None]:
    """Tell rising, resting and falling apart."""
    way = np.where(run.motion.still, 0, np.sign(run.motion.slope)).astype(int) + 1
    low = np.array([-1.5, -0.5, 0.5])
    return [empty("direction", "direction of u", "", low, low + 1, way) if np.unique(way).size > 1 else None]


@variable(moves=True)
def rate(run: Run) -> list[Panel | None]:
    """Look along the speed of the input."""
    return [along("rate", "rate of u", "u/s", run.motion.slope / run.Ts)]


@variable(moves=True)
def distance_since_reversal(run: Run) -> list[Panel | None]:
    """Look along the way since the input turned back."""
    motion = run.motion
    far = np.maximum((motion.smooth - motion.smooth[motion.last]) * motion.sign, 0)
    return [_since_reversal(SINCE[0], "u", far, motion)]


@variable(moves=True)
def time_since_reversal(run: Run) -> list[Panel | None]:
    """Look along the time since the input turned back."""
    return [_since_reversal(SINCE[1], "s", run.Ts * (np.arange(run.u.size) - run.motion.last), run.motion)]


def _since_reversal(name: str, kind: str, values: Array, motion: Motion) -> Panel | None:
    return since(name, name.replace("_", " "), kind, np.where(motion.after >= 0, values, np.nan), motion.sign)


@variable(moves=True)
def amplitude_frequency(run: Run) -> list[Panel | None]:
    """Look along the size and the pace of whole swings; those that the ends of the record cut off have none."""
    motion = run.motion
    values = (np.abs(motion.height)[motion.swing] / 2, 1 / (2 * run.Ts * motion.length)[motion.swing])
    return [grid(*(np.where(motion.whole, x, np.nan) for x in values))]


@variable()
def time(run: Run) -> list[Panel | None]:
    """Look along the record."""
    return [along("time", "time", "s", run.Ts * np.arange(run.u.size))]


@variable()
def channel(run: Run) -> list[Panel | None]:
    """Look along each further channel."""
    return [along(f"channel:{n}", n, n, x) for n, x in run.channels.items()]
