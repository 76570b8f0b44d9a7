"""A run over time and as a loop: a model beside a measurement, and a plant under a compensation law."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...data.metrics import nrmse
from ...data.record import Record
from ...data.units import headed, in_units, said_first
from ...fit.evaluate import free_run
from ...fit.simulate import arrays, simulate
from ...models.model import Model
from ...symbolic.numbers import sized
from ...tasks.commission import Commissioning
from ..figures.describe import SEVERAL, TIME, Area, Line, Panel, traces
from ..figures.still import draw, new_axes, split
from .sets import input_range


def plot_comparison(model: Model, record: Record, axes: Any = None, units: dict[str, str] | None = None) -> Any:
    """Draw measured and simulated output over time, the error, and both loops.

    Parameters
    ----------
    axes : three matplotlib axes (time, error, loop), optional
    units : mapping such as {"u": "V", "y": "um"}
    """
    (record,) = in_units([record], model.info.units)
    units = said_first(record.units, units)
    if axes is None:
        _, (left, right) = new_axes(1, 2, figsize=(11, 5), width_ratios=(3, 2))
        axes = [*split(left, (3, 1)), right]
    parts = record.segments()
    listed = [arrays(model, part) for part in parts]
    source, output = model.input.name, model.output.name
    simulated = np.concatenate([free_run(model, part) for part in parts])
    measured, driver = (np.concatenate([d[name] for d in listed]) for name in (output, source))
    time = np.concatenate([part.t[: d[output].size] for part, d in zip(parts, listed, strict=True)])
    told = {"measured": ("measured", measured), "free run": ("before", simulated)}
    moves = np.ptp(measured) > 0  # else an error has nothing to be compared with
    title = f"{record.name}{f': free-run NRMSE {nrmse(measured, simulated):.3g}' if moves else ''}"
    y, u = (headed(name, units.get(name)) for name in (output, source))
    left = {"": ("before", measured - simulated)}
    draw(axes[0], traces(TIME, time, y, told, title=title))
    draw(axes[1], traces(TIME, time, f"error of {y}", left, Area(0, 0, role="zero")))
    return draw(axes[2], traces(u, driver, y, told))


def reversal_curves(
    model: Model, count: int = 8, leg: int = 400, record: Record | None = None
) -> list[tuple[Any, Any]]:
    """Return first-order reversal curves of a model over the input's range it was fitted on, else that of a record.

    Slowly swept, from the top the input falls to each of `count` levels and rises again: each curve is that rise.

    Returns
    -------
    list of (u, y), (leg,) arrays [units of u and y], from the highest level to the lowest
    """
    low, high = input_range(model, record)
    levels = [high - (high - low) * i / count for i in range(1, count + 1)]
    path = [np.linspace(low, high, leg)]
    for level in levels:
        path += [np.linspace(high, level, leg), np.linspace(level, high, leg)]
    source = np.concatenate(path)
    run = simulate(model, source, warn=False)
    edges = [(2 + 2 * i) * leg for i in range(count)]
    return [(source[a : a + leg], run[a : a + leg]) for a in edges]


def plot_reversal_curves(
    model: Model, record: Record | None = None, ax: Any = None, count: int = 8, units: dict[str, str] | None = None
) -> Any:
    """Draw first-order reversal curves of a model: how it goes on after each turn; over the loops of a record.

    Parameters
    ----------
    record : Record, optional
        Its rising branches are drawn behind the curves.
    units : mapping such as {"u": "V", "y": "um"}
    """
    units = said_first(model.info.units, units)
    if ax is None:
        _, ax = new_axes(figsize=(6.5, 5.0))
    marks = []
    if record is not None:
        rising = np.where(np.diff(record.u, prepend=record.u[0]) >= 0, record.y, np.nan)
        marks.append(Line(record.u, rising, "measured, rising", "recorded"))
    for source, run in reversal_curves(model, count, record=record):
        marks += [Line(source, run, "model, after each turn", "after"), Line(source[:1], run[:1], role="start")]
    return draw(ax, Panel(headed("u", units.get("u")), headed("y", units.get("y")), marks))


def plot_compensation(
    t: Any,
    r: Any,
    m: Any,
    outputs: dict[str, Any],
    units: dict[str, str] | None = None,
    limits: tuple[float, float] | None = None,
) -> Any:
    """Draw responses and compensated input over time, the tracking errors, and the loops r against y.

    Parameters
    ----------
    outputs : mapping from a name ("compensated", "without") to the (N,) plant output
    limits : (lowest, highest) input, optional
        They are marked.
    """
    units = units or {}
    r_name, m_name, y_name, error = (
        headed(name, units.get(of)) for name, of in (("r", "y"), ("m", "u"), ("y", "y"), ("r - y", "y"))
    )
    t, r, m = (np.asarray(x, dtype=float) for x in (t, r, m))
    runs = {name: (role, np.asarray(y, dtype=float)) for role, (name, y) in zip(SEVERAL, outputs.items(), strict=False)}
    errors = {name: (role, r - y) for name, (role, y) in runs.items()}
    held = [Area(limit, limit, "limits", "limit") for limit in limits or ()]
    panels = (
        traces(TIME, t, y_name, {"reference r": ("reference", r)} | runs),
        traces(TIME, t, error, errors, Area(0, 0, role="zero")),
        traces(TIME, t, m_name, {"compensated input m": ("input", m)}, *held),
        traces(r_name, r, y_name, runs),
    )
    figure, axes = new_axes(2, 2, figsize=(11, 7))
    for ax, panel in zip(axes.flat, panels, strict=True):
        draw(ax, panel, most=4000)
    return figure


def plot_commissioning(found: Commissioning, units: dict[str, str] | None = None) -> Any:
    """Draw the input of a law, the reference, and the band of the tracking error.

    Parameters
    ----------
    units : mapping such as {"u": "V", "y": "um"}
    """
    units = said_first(found.law.model.info.units, units)
    time = np.arange(found.r.size) * (found.law.model.Ts or 1.0)
    t = TIME if found.law.model.Ts else "time [samples]"
    verdict, unit = "Go" if found.go else "No go", units.get("y", "")
    title = f"{verdict}: error {sized(found.expected, unit)} rms, a constant gain {sized(found.without, unit)}"
    way = np.concatenate([time, time[::-1]]), np.concatenate([found.low, found.high[::-1]])
    band = Line(*way, "95 % of the models that fit the records", "range")
    return draw(
        new_axes(figsize=(10, 7.5))[1],
        Panel(t, headed("reference", units.get("y")), [Line(time, found.r, role="reference")], title, along=True),
        Panel(t, headed("input of the law", units.get("u")), [Line(time, found.run.m, role="input")], along=True),
        Panel(t, headed("y - r", units.get("y")), [band, Area(0, 0, role="zero")], along=True),
    )
