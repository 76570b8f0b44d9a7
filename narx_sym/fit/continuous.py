"""`model.continuous()`: the differential equation of a fitted model, with intervals where records are given."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy as sp
from scipy.linalg import LinAlgError, qr, solve_triangular

from ..codegen.units import coefficient_units
from ..data.units import in_units, said_first
from ..errors import FitError, ModelError
from ..models.continuous_time import (
    Continuous,
    Linear,
    Row,
    Unit,
    equation_of,
    linear_part,
    linear_rows,
    quantity,
    transfer,
    with_errors,
)
from ..models.model import Model
from ..models.physical import effect_rows
from .constraints import constraint_equations
from .evaluate import estimated
from .freerun import FreeRun
from .simulate import Records, segments

Array = np.ndarray
JUMPS = (sp.sign, sp.Heaviside)  # what has no derivative where it matters
ROUNDS = 2  # of differences, each over the standard errors of the last
FEW = 60  # unknowns: of more, each of which asks for two runs, the derivatives as they are
SCALE = re.compile(r"\s*(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>\S.*?)\s*")


def continuous(
    model: Model,
    scale: Mapping[str, Any] | str | None = None,
    records: Records | None = None,
    units: Mapping[str, str] | None = None,
) -> Continuous:
    r"""Derive the differential equation behind a fitted model, with its quantities in physical units.

    Of a driven mass m x'' + d x' + k x + effects = g (u + u_0); else time constants, gain, natural frequencies.
    The poles are exact for an input that is held between samples: the logarithm of the recursion's poles. What is not
    exact is named in `notes`. Forces have the unit of the input, or that of `scale`.

    Parameters
    ----------
    scale : mapping such as {"u": (35.15, "N/V")} or a text "35.15 N/V", optional
        The force [N] per unit of the input [V].
    records : Record or list of Record, optional
        What the model was fitted on: 95 % intervals by the delta method, from the covariance of its free-run errors
        under white noise. Coloured errors make true intervals wider.
    units : mapping such as {"u": "V", "y": "m"}, optional
        By default those of the model's records.

    Returns
    -------
    Continuous : with `equation`, `quantities`, `text`, `latex()`, `to_dict()`

    Raises
    ------
    ModelError
        Where there is no such equation (a pole that is not positive and does not fade, a core with states of its own),
        for a model without values or sampling time, and for a scale that cannot be read.

    Notes
    -----
    Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 1998.

    Examples
    --------
    >>> import narx_sym as ns
    >>> lag = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2], Ts=0.1)
    >>> lag.continuous().text
    'gain 2.00 unit of y/(unit of u); time constant 0.949 s'
    """
    labels = said_first(model.info.units, units)
    names = {n: labels.get(n) or f"unit of {n}" for n in ("u", "y")}
    factor, force = _scale(scale, labels.get("u", ""))
    names["u"] = names["u"] if labels.get("u") or not scale else _per(scale)
    names["force"] = force or names["u"]
    linear = linear_part(model)
    way = transfer(linear, model.values)
    direction = 1 if linear.real(linear.B, model.values) > 0 else -1
    own, term, notes = effect_rows(model, linear, direction, coefficient_units(model, labels))
    if model.channels:
        notes.append(f"further inputs: {', '.join(model.channels)}")
    plain = linear_rows(linear, way, direction, model.values)
    rows = [*own, *_directions(plain, own), *_offset(model, linear)]
    approximate = [way.reason] if way.reason else []
    if not linear.linear:
        approximate.append("the model is nonlinear: this is its linearisation at the operating point")
    made = [quantity(row, linear, model, names, factor) for row in rows]
    early = linear.real(way.delay, model.values) < 0
    if early:
        approximate.append(
            "the input acts earlier than a zero-order hold allows: no dead time is given; the true "
            "hold is a different one"
        )
    found = Continuous(
        equation_of(linear, way, rows, term, scale is not None), tuple(made), way.exact and linear.linear,
        tuple(dict.fromkeys([*(f"approximation: {reason}" for reason in approximate), *notes])),
        {p: complex(v) for p, v in linear.poles.items()}, frozenset(r.symbol for r in rows if r.main),
    )  # fmt: skip
    return found if records is None else with_errors(found, linear, model, covariance(model, records))


def _directions(plain: list[Row], own: list[Row]) -> list[Row]:
    """Tell viscous friction in both directions, and its mean, where an effect makes them differ."""
    more = next((r for r in own if r.symbol == "d_f"), None)
    at = next((i for i, r in enumerate(plain) if r.symbol == "d"), None)
    if more is None or at is None:
        return plain
    rising = plain[at]
    mean = Row("mean viscous friction", "d_m", rising.expression + more.expression / 2, rising.unit)
    named = Row("viscous friction while the output rises", "d", rising.expression, rising.unit)
    return [*plain[:at], mean, named, *plain[at + 1 :]]


def _offset(model: Model, linear: Linear) -> list[Row]:
    """Return the constant beside the input, in its unit: with it the signals are measured from zero."""
    y0, u0 = (sp.Float(model.operating_point.get(base, 0.0)) for base in (model.output, model.input))
    stiff = 0 if linear.integrators else y0 / linear.gain
    total = linear.constant / linear.B - u0 + stiff
    return [Row("offset of the input", "u_0", total, Unit(input=1), main=False)] if total != 0 else []


# -- scale -----------------------------------------------------------------------------------------------------


def _given(scale: Mapping[str, Any] | str) -> tuple[float, str]:
    """Return the number and the unit of a scale of the input."""
    one: Any = scale
    if isinstance(scale, Mapping):
        if set(scale) != {"u"}:
            raise ModelError(
                f'A scale can only be given for the input, such as {{"u": (35.15, "N/V")}}, not for '
                f"{', '.join(map(str, scale))}."
            )
        one = scale["u"]
    if isinstance(one, str):
        text = one.strip().removeprefix("u=")
        match = SCALE.fullmatch(text)
        one = (match["number"], match["unit"]) if match else None
    try:
        number, unit = one
        value, label = float(number), str(unit).strip()
    except (TypeError, ValueError):
        raise ModelError(
            f'The scale {scale!r} cannot be read: give a number and a unit, such as "35.15 N/V".'
        ) from None
    if not (np.isfinite(value) and value > 0) or not all(label.rpartition("/")[::2]):
        raise ModelError(f'The scale {scale!r} must be a positive number of force per input, such as "35.15 N/V".')
    return value, label


def check_scale(scale: Mapping[str, Any] | str | None, known: str = "") -> None:
    """Refuse a scale that cannot be read, or is per another unit than a known one, before any work is done."""
    _scale(scale, known)


def _per(scale: Mapping[str, Any] | str) -> str:
    return _given(scale)[1].rpartition("/")[2].strip()


def _scale(scale: Mapping[str, Any] | str | None, known: str) -> tuple[float, str]:
    """Return the force per unit of the input, and its unit; (1, "") without a scale.

    Raises
    ------
    ModelError
        Where it cannot be read, or is per another unit than that of the input.
    """
    if scale is None:
        return 1.0, ""
    value, label = _given(scale)
    force, _, per = label.rpartition("/")
    if known and per.strip() != known:
        raise ModelError(f"The scale is per {per.strip()}, but the input is in {known}: give it per {known}.")
    return value, force.strip().removeprefix("(").removesuffix(")")


# -- covariance ------------------------------------------------------------------------------------------------


def covariance(model: Model, records: Records) -> Array:
    """Return the covariance of a model's parameters under white noise of its free run on records, (n_theta, n_theta).

    The unknowns of its fit are asked for together: the free parameters, the start states of each contiguous record, and
    its load where the model integrates. NaN where the records do not fix the parameters.

    Raises
    ------
    ModelError, DataError
        For records that the model cannot run along.
    FitError
        For too few samples.
    """
    listed = segments(in_units(segments(records), model.info.units))
    begins = FreeRun(model, listed, None, loads=True)
    problem = FreeRun(model, listed, constraint_equations(model, None), loads=True)
    z = problem.start(model.theta)
    z[problem.free :] = estimated(begins, begins.start(model.theta))[0]
    n = len(model.symbols)
    square = np.array(problem._triangle(z))  # its products are those of the derivatives and the residuals
    if not np.all(np.isfinite(square)):
        raise FitError("The free run diverges on these records: there is no covariance of its parameters.")
    noise = float(np.linalg.norm(square[:, -1])) / np.sqrt(max(1, problem.edges[-1] - z.size))
    moves, inverse = _inverse(square[:, :-1], problem.free)
    jumps = any(right.has(*JUMPS) for _, right in model.recursion.updates)
    for _ in range(ROUNDS if jumps and z.size <= FEW else 0):
        if inverse is not None:
            width = noise * np.linalg.norm(inverse, axis=1)
            slopes = _differences(problem, z, np.flatnonzero(moves), width)
            moves, inverse = _inverse(slopes, problem.free) if np.all(np.isfinite(slopes)) else (moves, None)
    if inverse is None:
        return np.full((n, n), np.nan)
    to_theta = np.zeros((n, z.size))
    to_theta[:, : problem.free] = problem.elimination.Z
    if problem.load is not None:  # the model's own is the mean of those of its records
        lengths = np.array([d[problem.name].size for d in problem.data], dtype=float)
        for i, length in enumerate(lengths):
            to_theta[problem.load, problem.own(i).stop - 1] = length / lengths.sum()
    half = noise * to_theta[:, moves] @ inverse
    return np.asarray(half @ half.T)


def _inverse(slopes: Array, free: int) -> tuple[Array, Array | None]:
    """Return which unknowns move the run or are free, and R^-1 of their derivatives; None where it does not exist."""
    moves = np.any(slopes != 0, axis=0) | (np.arange(slopes.shape[1]) < free)
    size = np.linalg.norm(slopes[:, moves], axis=0)
    if not np.all(size > 0):
        return moves, None
    R = qr(slopes[:, moves] / size, mode="r")[0][: size.size]
    try:
        inverse = solve_triangular(R, np.eye(size.size)) / size[:, None]
    except (LinAlgError, ValueError):
        return moves, None
    return moves, inverse if np.all(np.isfinite(inverse)) else None


def _differences(problem: FreeRun, z: Array, listed: Array, width: Array) -> Array:
    """Return derivatives of the run as differences over a standard error to either side, (rows, unknowns).

    A reversal moves with the parameters; the derivative of a sign, zero wherever it exists, does not know that.
    """
    found = np.zeros((problem.edges[-1], z.size))
    for at, by in zip(listed, width, strict=True):
        step = np.zeros(z.size)
        step[at] = by
        found[:, at] = (problem.run(z + step)[0].copy() - problem.run(z - step)[0]) / (2 * by)
    return found
