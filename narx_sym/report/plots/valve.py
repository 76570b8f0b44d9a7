"""The valve of a control loop: what the controller asks for, where the valve is thought to be, and what comes out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...data.evidence.feedback import setpoint
from ...data.evidence.stiction import Sticking
from ...data.units import headed, said_first
from ...files.atomic import write_figure
from ..figures.describe import TIME, Line, Panel, traces
from ..figures.still import draw, label, new_axes


def loop_panels(valve: Sticking, units: Mapping[str, str]) -> list[Panel]:
    """Describe a control loop: PV and OP over time, and PV over OP, each with the valve as it is estimated."""
    record, unit = valve.record, said_first(valve.record.units, units)
    op, pv, wanted = headed("OP", unit.get("u")), headed("PV", unit.get("y")), setpoint(record)
    came = {"PV": ("recorded", record.y)} | ({} if wanted is None else {"setpoint": ("setpoint", wanted)})
    asked, loops = {"OP": ("input", record.u)}, [Line(record.u, record.y, "PV over OP", "input")]
    if valve.band:
        asked["valve, as estimated"] = ("estimate", valve.position)
        loops.append(Line(valve.position, record.y, "PV over the estimated valve", "estimate"))
    return [traces(TIME, record.t, pv, came), traces(TIME, record.t, op, asked), Panel(op, pv, loops)]


def plot_valve(valve: Sticking, path: str | Path | None = None, units: dict[str, str] | None = None) -> Any:
    """Draw a loop over time, and PV over OP and over the valve as estimated.

    Parameters
    ----------
    valve : Sticking
    path : str or Path, optional
        Where the picture is saved; its ending chooses the format.
    units : mapping with the units of "u" and "y"
    """
    *over_time, loop = loop_panels(valve, units or {})
    figure, axes = new_axes(1, 2, figsize=(12.5, 5.0), width_ratios=(3, 2))
    draw(axes[0], *over_time)
    draw(axes[1], loop)
    figure.suptitle(label(f"{valve.record.name}: {valve.verdict}"))
    if path is not None:
        write_figure(figure, path)
    return figure
