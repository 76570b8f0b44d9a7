"""What the error of a model is looked at against: one panel for each variable, without a residual yet."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .cells import along, empty, grid, since
from .motion import Motion
from .panel import SINCE, Panel

Array = np.ndarray


def empty_panels(u: Array, y: Array, Ts: float, channels: Mapping[str, Array], begin: float = 0.0) -> list[Panel]:
    """Return panels with cells along a run; a variable that does not vary has none.

    The simulated output is free of the noise in the error.
    """
    found = [along("u", "input u", "u", u), along("y", "simulated output y", "y", y)]
    found += _moving(Motion.of(u), Ts) if np.ptp(u) > 0 else []
    found.append(along("time", "time", "s", begin + Ts * np.arange(u.size)))
    found += [along(f"channel:{n}", n, n, x) for n, x in channels.items()]
    return [panel for panel in found if panel is not None]


def _moving(motion: Motion, Ts: float) -> list[Panel | None]:
    """Look along how the input moves: its way, its speed, what it did since it turned back, and its whole swings."""
    way, low = np.where(motion.still, 0, np.sign(motion.slope)).astype(int) + 1, np.array([-1.5, -0.5, 0.5])
    far = np.maximum((motion.smooth - motion.smooth[motion.last]) * motion.sign, 0)
    ago = Ts * (np.arange(motion.after.size) - motion.last)
    swings = np.abs(motion.height)[motion.swing] / 2, 1 / (2 * Ts * motion.length)[motion.swing]
    return [
        empty("direction", "direction of u", "", low, low + 1, way) if np.unique(way).size > 1 else None,
        along("rate", "rate of u", "u/s", motion.slope / Ts),
        *(
            since(name, name.replace("_", " "), unit, np.where(motion.after >= 0, x, np.nan), motion.sign)
            for name, unit, x in zip(SINCE, ("u", "s"), (far, ago), strict=True)
        ),
        grid(*(np.where(motion.whole, x, np.nan) for x in swings)),
    ]
