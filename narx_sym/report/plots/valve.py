"""The valve of a control loop: what the controller asks for, where the valve is thought to be, and what comes out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...data.evidence.feedback import setpoint
from ...data.evidence.stiction import Sticking
from ...data.units import said_first
from ...files.atomic import write_figure
from .style import BLACK, BLUE, ORANGE, SKY, label, new_axes


def plot_valve(valve: Sticking, path: str | Path | None = None, units: dict[str, str] | None = None) -> Any:
    """Draw a loop over time, and PV over OP: a valve in order gives a line, a sticking one a parallelogram.

    Parameters
    ----------
    valve : Sticking
    path : str or Path, optional
        Where the picture is saved; its ending chooses the format.
    units : mapping with the units of "u" and "y"
    """
    record, unit = valve.record, said_first(valve.record.units, units)
    op, pv, wanted = label("OP", unit.get("u", "")), label("PV", unit.get("y", "")), setpoint(record)
    figure, _ = new_axes(figsize=(12.5, 5.0))
    figure.clear()
    (above, loop), (below, rest) = figure.subplots(2, 2, width_ratios=(3, 2))
    rest.remove()
    above.plot(record.t, record.y, color=BLUE, lw=1, label="PV")
    if wanted is not None:
        above.plot(record.t, wanted, color=BLACK, lw=1, ls="--", label="setpoint")
    above.set_ylabel(pv)
    below.plot(record.t, record.u, color=ORANGE, lw=1, label="OP")
    if valve.band:
        below.plot(record.t, valve.position, color=SKY, lw=1.5, label="valve, as estimated")
        loop.plot(valve.position, record.y, color=SKY, lw=1, label="PV over the estimated valve")
    loop.plot(record.u, record.y, color=ORANGE, lw=0.8, label="PV over OP")
    below.set(xlabel="time [s]", ylabel=op)
    loop.set(xlabel=op, ylabel=pv)
    for axes in (above, below, loop):
        axes.legend(fontsize=8, loc="best")
    figure.suptitle(f"{record.name}: {'the valve sticks' if valve.found else 'no valve that sticks'}")
    if path is not None:
        write_figure(figure, path)
    return figure
