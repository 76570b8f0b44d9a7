"""A model's error against everything that may matter, sorted by the share that each explains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...data.record import Record
from ...errors import DataError
from ...fit.simulate import vector
from ...models.model import Model
from .forcing import missing_input
from .means import filled_panels
from .panel import Panel
from .slopes import slopes_along
from .variables import empty_panels

Array = np.ndarray


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
    begin: float = 0.0,
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
    begin : float [s]
        The time of the first sample.

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
    empty = empty_panels(data["input"], data["simulated output"], Ts, extra, begin)
    w = data.get("missing input")
    return Misfit(
        residual, w, filled_panels(empty, residual, Ts), [] if w is None else filled_panels(empty, w, Ts), floor
    )


def misfit_of(model: Model, record: Record, error: Array, floor: float | None) -> Misfit:
    """Where a model fails along a record: the free-run error, and the equivalent missing input.

    Parameters
    ----------
    error : (N,) array
        Measured minus simulated [unit of y].
    floor : float, optional
        rms of the noise [unit of y].
    """
    simulated = record.y - error
    slopes = slopes_along(model, record, simulated)[0]
    missing = missing_input(error, slopes, floor)
    return where_it_fails(record.u, record.y, simulated, record.Ts, record.channels, missing, floor, float(record.t[0]))
