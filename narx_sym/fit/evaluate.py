"""The one protocol by which a model is compared with a record.

The error of a model on a record is that of its free run over the whole record, at the record's own rate, from start
states that are estimated on that record; a gap starts a new run. Nothing else is fitted to the record, unless it is
asked for (`align`: a constant offset of the sensor). Of a model that integrates, the constant load counts as a start
state; the error without it stands beside. MATLAB's `compare` estimates start states in the same way.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..data.metrics import mape, nrmse
from ..data.record import Record
from ..data.timegrid import same_pace
from ..data.units import in_units
from ..engines.algebra import smallest
from ..errors import DataError, Diverged, FitError
from ..models.model import Model
from .freerun import FreeRun, load_of
from .simulate import Records, arrays, by_parts, fitted, predict, segments, simulate

Array = np.ndarray
PROTOCOL = (
    "free run over the whole record at its own sampling rate, from start states estimated on that record; a new run "
    "starts after each gap; nothing else is fitted to it"
)
STEPS, SETTLED, STEP = 30, 1e-9, 1e-4  # of a start, in standard deviations of the output
CLEARLY = 1e-6  # of a squared error: less is no other minimum
FEWEST, MOST, MOVED = 4, 17, 0.01  # digits on paper; share of its error by which a free run may move
DEPENDENT = 1e-6  # directions that a record does not show stay where they are


@dataclass(frozen=True)
class Started:
    """A free run along one contiguous record.

    Attributes
    ----------
    run : (N,) array
        From the estimated start states; NaN from where it diverges [unit of the output].
    offset : float
        Of the sensor; 0 where it was not asked for [unit of the output].
    load : float
        By how much the constant of a model that integrates differs from the model's own [unit of the output].
    """

    run: Array
    offset: float = 0.0
    load: float = 0.0


def started(model: Model, part: Record, align: bool = False, loads: bool = True, engine: str = "native") -> Started:
    """Run a model along one contiguous record from start states estimated on it, by Gauss-Newton from measured ones.

    Parameters
    ----------
    align : bool
        Whether a constant offset of the sensor is estimated too.
    loads : bool
        Whether the constant load of a model that integrates is.
    """
    try:
        problem = FreeRun(model, part, None, loads=loads)
    except FitError:  # no sample to estimate from
        data = arrays(model, part)
        return Started(simulate(model, data[model.input.name], data[model.output.name], data, engine, warn=False))
    z, constant = problem.start(fitted(model)), 0.0
    if align:  # where Sigma_y = 1 no record tells a start from an offset: first only what nobody measured moves
        z, constant = estimated(problem, z, constant, _unmeasured(problem, load=True), True)
    z, constant = estimated(problem, z, constant)
    run = problem.simulate(z, 0, engine)
    return Started(run + constant, constant, float(z[-1]) if problem.load is not None else 0.0)


def estimated(
    problem: FreeRun, z: Array, constant: float = 0.0, moves: Array | None = None, offset: bool = False
) -> tuple[Array, float]:
    """Return the start states, and the offset of the sensor, with the least free-run error, by Gauss-Newton.

    Derivatives are differences of a few runs: a linear model is exact with any step, and no model is compiled again.

    Parameters
    ----------
    problem : FreeRun
        Of fixed parameters: its unknowns are start states alone.
    z : (unknowns,) array
        Where it begins.
    constant : float
        The offset of the sensor [unit of the output], which moves where `offset` says so.
    moves : (unknowns of a segment,) bool array, optional
        Which start states are estimated; all by default.
    """
    z, memory = z.copy(), _unmeasured(problem, load=False)  # a load is linear in the run: no step of it is too large
    for i in range(len(problem.data)):
        found = _one_start(problem, z, i, constant, moves, offset)
        if moves is None and memory.any() and not memory.all():
            # A measured start that hardly matters may take a step that is too large for the memory beside it.
            first = _one_start(problem, z, i, constant, memory, False)
            other = _one_start(problem, first[1], i, first[2], moves, offset)
            found = other if other[0] < (1 - CLEARLY) * found[0] else found
        _, z, constant = found
    return z, constant


def _unmeasured(problem: FreeRun, load: bool) -> Array:
    """Return which unknowns of a segment are no measured outputs: what effects remember, and the load if asked for."""
    listed = [s.back is None for s in problem.starts] + [load] * (problem.load is not None)
    return np.array(listed, dtype=bool)


def _one_start(
    problem: FreeRun, z: Array, i: int, constant: float, moves: Array | None, offset: bool
) -> tuple[float, Array, float]:
    """Return the squared error of segment i, all unknowns with its start states, and the offset."""
    own, rows, measured = problem.own(i), problem.rows[i], problem.data[i][problem.name]
    listed = np.arange(own.start, own.stop)[np.ones(own.stop - own.start, bool) if moves is None else moves]
    width = STEP * problem.spread

    def gap(at: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray((problem.simulate(at, i) - measured)[rows])

    best, kept, step = np.inf, (z, constant), np.zeros(listed.size + 1)
    for _ in range(STEPS):
        left = gap(z) + constant
        cost = float(left @ left) if np.all(np.isfinite(left)) else np.inf
        if not cost < best:  # halve the way back to the best one
            if not np.isfinite(best):
                break
            step = step / 2
        else:
            settled = cost > (1 - SETTLED) * best
            best, kept = cost, (z.copy(), constant)
            if settled or not (listed.size or offset):
                break
            beside = np.repeat(z[None], listed.size, axis=0)
            beside[np.arange(listed.size), listed] += width
            columns = [(gap(at) + constant - left) / width for at in beside] + [np.full(left.size, float(offset))]
            if not np.all(np.isfinite(columns)):
                break
            step = smallest(np.column_stack(columns), -left, DEPENDENT)
        z, constant = kept[0].copy(), kept[1] + float(step[-1])
        z[listed] += step[:-1]
    return best, *kept


def free_run(model: Model, record: Record, engine: str = "native", align: bool = False, loads: bool = True) -> Array:
    """Simulate a model along a record, from start states that are estimated on this record.

    After each gap a new run starts.

    Parameters
    ----------
    model : Model with theta
    record : Record
    engine : "native", "python" or "casadi"
    align : bool
        Whether a constant offset of the sensor is estimated too.
    loads : bool
        Whether an unknown constant load is estimated if the model is an integrator.

    Returns
    -------
    (N,) array [unit of the output]
        The first samples, as many as the largest lag, are the measured ones. For an inverse model the last `lead`
        samples of each piece are missing.

    Raises
    ------
    Diverged
        If the run diverges.
    ModelError
        If the model has no parameter values, or the record does not have one of its channels.

    Examples
    --------
    >>> import narx_sym as ns
    >>> record = ns.Record.from_arrays(u=[1, 1, 0, 0, 1], y=[0, 2, 3.2, 1.4, 0.8], Ts=0.1)
    >>> model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.5, 2.0])
    >>> ns.free_run(model, record).round(3)
    array([0.   , 2.061, 3.031, 1.515, 0.758])
    """
    return by_parts(model, record, partial(_run, model, engine, align, loads))


def _run(model: Model, engine: str, align: bool, loads: bool, part: Record) -> Array:
    found = started(model, part, align, loads, engine)
    data = arrays(model, part)
    measured, depth = data[model.output.name], max(1, model.recursion.depth)
    if not np.all(np.isfinite(found.run)):  # which says where, and why
        return simulate(model, data[model.input.name], measured[:depth], data, engine, warn=False)
    return np.concatenate([measured[:depth], found.run[depth:]]) if model.recursion.depth else found.run


@dataclass(frozen=True)
class Errors:
    """One-step and free-run errors of a model; see `evaluate` for an example.

    Judge a model by its free run: a model that repeats the last sample has a small one-step error too.

    Attributes
    ----------
    one_step_nrmse, free_run_nrmse : float
        rms(y - model) / std(y): 0 is exact, 1 is no better than a constant.
    one_step_mape, free_run_mape : float
        Mean absolute error in per cent of the range of y.
    free_run_rms : float
        rms of the free-run error [unit of the output].
    own_load_nrmse : float or None
        The free-run NRMSE with the model's own constant load; None if the model is not an integrator.
    """

    one_step_nrmse: float
    free_run_nrmse: float
    one_step_mape: float
    free_run_mape: float
    free_run_rms: float = float("nan")
    own_load_nrmse: float | None = None

    @property
    def fit(self) -> float:
        """Fit of the free run as MATLAB's `compare` gives it, 100 (1 - NRMSE) [%]."""
        return 100.0 * (1.0 - self.free_run_nrmse)


def evaluate(model: Model, records: Records, align: bool = False) -> Errors:
    """Compute the one-step and free-run errors of a model on measurements.

    The free run covers the whole record at its own sampling rate. Its start states are estimated on the record, and a
    new run starts after each gap; nothing else is fitted. If the model is an integrator, an unknown constant load is
    estimated too. A run that diverges has an infinite error.

    Parameters
    ----------
    model : Model with theta
    records : Record or list of Record
        The measurements, (N,) arrays in the user's units. All samples of all records have the same weight.
    align : bool
        Whether a constant offset of the sensor is estimated too.

    Returns
    -------
    Errors

    Raises
    ------
    DataError
        If the output is constant.
    ModelError
        If the model has no parameter values, or a record does not have one of its channels.

    Examples
    --------
    >>> import narx_sym as ns
    >>> record = ns.Record.from_arrays(u=[1, 1, 0, 0, 1, 1], y=[0, 2, 3.2, 1.4, 0.8, 2.5], Ts=0.1)
    >>> model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.5, 2.0])
    >>> errors = ns.evaluate(model, record)
    >>> round(errors.one_step_nrmse, 3), round(errors.free_run_nrmse, 3)
    (0.122, 0.096)
    """
    fitted(model)
    listed = in_units(segments(records), model.info.units)
    for record in listed:
        if model.Ts and not same_pace(record.Ts, model.Ts):
            warnings.warn(
                f"The record {record.name!r} has Ts = {record.Ts:g} s, the model was identified at {model.Ts:g} s.",
                stacklevel=2,
            )
    target = np.concatenate([arrays(model, r)[model.output.name] for r in listed])
    if np.ptp(target) == 0:
        raise DataError(
            f"record {listed[-1].name!r}: {model.output.name} is constant ({target[0]:.6g}), so there is no relative "
            "error. Check the columns (--input, --output) and the rows (--rows)."
        )
    one = along(model, listed, predict)
    free = along(model, listed, partial(free_run, align=align))
    own = along(model, listed, partial(free_run, align=align, loads=False)) if load_of(model) is not None else None
    pairs = [measure(target, run) for run in (one, free)]
    with np.errstate(over="ignore"):
        rms = float(np.sqrt(np.mean((target - free) ** 2)))
    return Errors(
        pairs[0][0], pairs[1][0], pairs[0][1], pairs[1][1], rms, None if own is None else measure(target, own)[0]
    )


def free_run_nrmse(model: Model, records: Records) -> float:
    """Compute the free-run error of `evaluate` alone."""
    listed = in_units(segments(records), model.info.units)
    target = np.concatenate([arrays(model, r)[model.output.name] for r in listed])
    return measure(target, along(model, listed, free_run))[0]


def digits(model: Model, records: Records) -> int:
    """Return how many significant digits of its parameters a model needs on paper, at least four.

    With them its free run differs from that of the model by at most a hundredth of its error (rms over all records). On
    paper a load is a constant like others.
    """
    listed, as_printed = in_units(segments(records), model.info.units), partial(free_run, loads=False)
    run = along(model, listed, as_printed)
    error = run - np.concatenate([arrays(model, r)[model.output.name] for r in listed])
    if not np.all(np.isfinite(run)):
        return FEWEST
    for count in range(FEWEST, MOST):
        rounded = model.replace(theta=[float(f"{v:.{count}g}") for v in fitted(model)])
        if np.sum((along(rounded, listed, as_printed) - run) ** 2) <= MOVED**2 * np.sum(error**2):
            return count
    return MOST


def along(model: Model, listed: Sequence[Record], run: object) -> Array:
    """Return the runs along contiguous records, one array; infinite where one diverges."""
    found = []
    for record in listed:
        try:
            found.append(run(model, record))  # type: ignore[operator]
        except Diverged:
            found.append(np.full(arrays(model, record)[model.output.name].size, np.inf))
    return np.concatenate(found)


def measure(target: Array, run: Array) -> tuple[float, float]:
    """Return NRMSE and MAPE of a run."""
    with np.errstate(over="ignore"):
        return (nrmse(target, run), mape(target, run)) if np.isfinite(run).all() else (np.inf, np.inf)
