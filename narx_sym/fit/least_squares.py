"""Section 2 of the paper: constrained least squares on a streamed QR factor, and the one door to every fit."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtpqrt

from ..data.coverage import seen
from ..data.record import Record, check_excitation
from ..data.units import in_units, said_first
from ..engines.columns import Columns
from ..engines.numbers import floats
from ..errors import FitError
from ..files.parallel import one_blas_thread
from ..models.info import Nrmse
from ..models.model import NARX, Model
from ..symbolic.signals import k, signal, u, y
from .constraints import Elimination, constraint_equations
from .evaluate import digits, evaluate
from .freerun import free_run_fit
from .simulate import Records, arrays, centre, predict, segments, shifted

Array = np.ndarray
BLOCK = 2048
# Of the smallest scaled diagonal of R: above, nothing is gained; below, its square drowns in rounding.
CORRECTED = (1e-7, 1e-2)
NOISE, MOVING, ROUNDS, SETTLED = "xi", 2, 100, 1e-7  # of extended least squares
STILL = 1e-12  # of the largest regressor at rest: what constraints leave of it is rounding


# -- least squares ---------------------------------------------------------------------------------------------


def stack_qr(R: Array, block: Array) -> Array:
    """Return the R factor of [R; block]; the block is overwritten. One step of a streamed QR (LAPACK dtpqrt)."""
    # Panels of 16 columns: wider ones make OpenBLAS split tiny steps over threads that then wait for each other.
    merged, _, _, info = dtpqrt(0, min(16, R.shape[0]), R, block, overwrite_a=1, overwrite_b=1)
    if info:
        raise FitError(f"LAPACK dtpqrt failed with code {info}.")
    return merged


def blocks(columns: Columns, records: Sequence[Mapping[str, Array]], transform: Any = None) -> Iterator[Array]:
    """Yield the rows of [Psi y], at most BLOCK at a time; arguments as for `factor`."""
    for data in records:
        n = min(len(x) for x in data.values()) - columns.lead
        for start in range(columns.depth, n, BLOCK):
            block = columns.block(data, start, min(start + BLOCK, n))
            yield block if transform is None else transform(block)


def factor(columns: Columns, records: Sequence[Mapping[str, Array]], transform: Any = None) -> tuple[Array, int]:
    """Stream the rows of [Psi y] through one QR factorisation.

    Parameters
    ----------
    columns : Columns
        The regressors and, last, the target.
    records : the sequences of each experiment
    transform : function of a (rows, width) block, optional

    Returns
    -------
    R : (width, width) upper triangular
    rows : int
    """
    R: Array | None = None
    rows = 0
    with one_blas_thread():
        for block in blocks(columns, records, transform):
            block = np.asfortranarray(block)
            if not np.all(np.isfinite(block)):
                raise FitError("A regressor is not finite on these data; check the ranges or drop the term.")
            if R is None:
                R = np.zeros((block.shape[1],) * 2, order="F")
            rows += len(block)
            R = stack_qr(R, block)
    if R is None:
        raise FitError(f"The records are shorter than the largest lag ({columns.depth} samples).")
    return np.triu(R), rows


def rest_rows(model: NARX, columns: Columns, points: Array) -> Array:
    """Return the rows [Psi y] of ybar = F(ybar, ..., ubar, ...): all lags at one point, phi1 = phi2 = 0.

    Parameters
    ----------
    columns : Columns
        The regressors and, last, the target.
    points : (n, 2) array of (ubar, ybar) [units of the model]

    Returns
    -------
    rows : (n, n_theta + 1) array

    Raises
    ------
    FitError
        Where a regressor is not finite at a point.
    """
    span = columns.depth + columns.lead + 1
    held = dict(zip(_at_rest(model), np.repeat(points, span, axis=0).T, strict=True))
    rows = columns(shifted(model, held))[::span]
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if bad.size:
        at = "u = {:g}, y = {:g}".format(*points[bad[0]])
        raise FitError(f"A regressor is not finite at rest at {at}; leave out the point or drop the term.")
    return rows


def _at_rest(model: Model) -> tuple[str, str]:
    """Return the names of what a pair holds: input and output of the machine, of an inverse model too."""
    return (model.input if model.output == y else u).name, y.name


def one_step(
    model: NARX, records: Records, equations: Sequence[Any], points: Array | None = None, weight: float = 1.0
) -> tuple[Array, Array]:
    """Least squares under S theta = c by QR: theta and its standard errors.

    The estimator of the paper (Eq. ConstrainedParameters_Estimator, Draper & Smith 1998), solved by elimination
    instead of normal equations. With steady-state data it minimises J = MSE_dynamic + weight MSE_rest: their rows are
    multiplied by sqrt(weight N / n), of N equations one step ahead and n points.
    """
    parts = segments(records)
    elimination = Elimination.of(equations, model.symbols)
    n, free = elimination.Z.shape
    columns = Columns([*model.terms, model.output[k]])

    def reduced(block: Array) -> Array:
        return np.column_stack([block[:, :n] @ elimination.Z, block[:, n] - block[:, :n] @ elimination.t0])

    data = [shifted(model, arrays(model, p)) for p in parts]
    R, rows = factor(columns, data, reduced)
    rest = np.zeros((0, free + 1))
    if points is not None:
        still = rest_rows(model, columns, points)
        rest = np.sqrt(weight * rows / len(points)) * reduced(still)
        if np.abs(reduced(still)[:, :free]).max(initial=0.0) <= STILL * np.abs(still).max():
            warnings.warn(
                "The steady-state data change nothing: under its constraints the free terms of this model vanish at "
                "rest. Leave the data out, or fit without the constraints.",
                stacklevel=3,
            )
        R = np.triu(stack_qr(R, rest.copy(order="F")))
        rows += len(points)
    if rows <= free:
        raise FitError(
            f"{free} parameters cannot be estimated from {rows} equations: give more samples or fewer terms."
        )
    if free == 0:
        return elimination.t0, np.zeros(n)
    z, covariance = solve_factor(R, rows, [str(t) for t in model.terms])
    z = refined(z, R, chain(blocks(columns, data, reduced), [rest]))
    spread = elimination.Z @ covariance @ elimination.Z.T
    return elimination.t0 + elimination.Z @ z, np.sqrt(np.maximum(np.diag(spread), 0.0))


def solve_factor(R: Array, rows: int, names: Sequence[str]) -> tuple[Array, Array]:
    """Solve the triangular system of [Psi y]: parameters and covariance.

    Raises
    ------
    FitError
        Where columns are linearly dependent on these data.
    """
    p = R.shape[0] - 1
    scale = np.linalg.norm(R[:p, :p], axis=0)
    if np.any(scale == 0):
        raise FitError(f"The term {names[int(np.argmin(scale))]} is zero on all of these data: drop it.")
    square = R[:p, :p] / scale
    # R is scaled, so a small diagonal entry means a column that the others explain.
    if np.min(np.abs(np.diag(square))) < 1e-13:
        raise FitError(
            "The regressors are linearly dependent on these data: the input does not excite the model enough, "
            "or a term repeats others. Use fewer terms or a richer input."
        )
    with one_blas_thread():
        z = solve_triangular(square, R[:p, p]) / scale
        inverse = solve_triangular(square, np.eye(p)) / scale[:, None]
    variance = R[p, p] ** 2 / (rows - p)
    return z, variance * inverse @ inverse.T


def refined(z: Array, R: Array, rows: Iterable[Array]) -> Array:
    """Correct a least-squares solution once, with residuals in extended precision (Bjorck 1987).

    Parameters
    ----------
    z : (p,) array
    R : (p + 1, p + 1) upper triangular
        The factor of the rows [Psi y] that z was solved from.
    rows : blocks of these rows
    """
    p = z.size
    square = R[:p, :p] / np.linalg.norm(R[:p, :p], axis=0)
    if not CORRECTED[0] < np.min(np.abs(np.diag(square))) < CORRECTED[1]:
        return z
    gradient = np.zeros(p, dtype=np.longdouble)
    weights = np.append(-z, 1.0).astype(np.longdouble)
    for block in rows:
        wide = block.astype(np.longdouble)
        gradient += (wide @ weights) @ wide[:, :p]
    step = solve_triangular(R[:p, :p], gradient.astype(float), trans="T")
    return np.asarray(z + solve_triangular(R[:p, :p], step))


def extended(model: NARX, records: Records, equations: Sequence[Any]) -> tuple[Array, Array, bool]:
    """Fit with the residuals of the round before as regressors, a moving average of the noise: extended least squares.

    Noise that enters after the dynamics biases `one_step`: it stands in the regressors y[k-1] too. Its own terms take
    it up and are left out of the model (Young 1968; Billings & Voon 1984; Tavares, Abreu & Aguirre 2020).

    Returns
    -------
    theta, std : (n_theta,) arrays
    converged : bool
    """
    parts, noise = segments(records), signal(NOISE)
    if NOISE in model.channels:
        raise FitError(f"The channel {NOISE!r} has the name of the residuals: rename it.")
    wide = NARX(
        [*model.terms, *(noise[k - i] for i in range(1, MOVING + 1))],
        output=model.output, input=model.input, operating_point=model.operating_point, lead=model.lead, Ts=model.Ts,
    )  # fmt: skip
    theta, errors = one_step(model, parts, equations)
    n, listed = theta.size, parts
    guess: Model = model.replace(theta=theta.tolist())
    for _ in range(ROUNDS):
        listed = [_with_residuals(guess, part) for part in listed]
        found, spread = one_step(wide, listed, equations)
        moved = float(np.abs(found[:n] - theta).max())
        theta, errors, guess = found[:n], spread[:n], wide.replace(theta=found.tolist())
        if moved <= SETTLED * float(np.abs(theta).max()):
            return theta, errors, True
    return theta, errors, False


def _with_residuals(model: Model, part: Record) -> Record:
    """Return a segment with the residuals of the one-step prediction beside its channels."""
    ahead = predict(model, part)
    own = arrays(model, part)[model.output.name] - ahead
    residuals = np.concatenate([own, np.zeros(len(part) - own.size)])  # an inverse model ends earlier
    return replace(part, channels={**part.channels, NOISE: residuals})


# -- the door ----------------------------------------------------------------------------------------------


def check_method(method: str) -> None:
    """Refuse an unknown way to fit."""
    if method not in ("auto", "one_step", "free_run", "els"):
        raise FitError(f"Unknown method {method!r}: use 'auto', 'one_step', 'free_run' or 'els'.")


def check_steady_state(model: Model, steady_state: Any, weight: float, method: str) -> Array | None:
    """Return the (ubar, ybar) pairs of a fit as an (n, 2) array; None where there are none or they have no weight."""
    if steady_state is None:
        return None
    if method != "one_step":
        raise FitError("Steady-state data enter the one-step fit: use method='one_step'.")
    if not isinstance(model, NARX):
        raise FitError("Steady-state data enter models that are linear in their parameters, and this one is not.")
    if further := [b.name for b in model.recursion.inputs if b.name not in _at_rest(model)]:
        raise FitError(
            f"Steady-state data hold input and output alone, but the model reads {further[0]!r}: leave out its terms, "
            "or the steady-state data."
        )
    try:
        points, weight = floats(steady_state), float(weight)
    except (TypeError, ValueError):
        raise FitError("steady_state must be (ubar, ybar) pairs of numbers, (n, 2), and weight a number.") from None
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise FitError(f"steady_state must be (ubar, ybar) pairs, (n, 2) with n > 0; this has shape {points.shape}.")
    if not np.all(np.isfinite(points)):
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise FitError(f"steady_state has a value that is missing or infinite in row {row}: leave the row out.")
    if not 0 <= weight < np.inf:
        raise FitError(f"The weight of the steady-state data must be a finite number from 0 on, not {weight:g}.")
    return points if weight else None


def fit(
    model: Model,
    records: Records,
    constraints: Sequence[Any] | str | None = None,
    method: str = "one_step",
    max_steps: int = 60,
    starts: int = 1,
    seed: int = 0,
    warn: bool = True,
    steady_state: Any = None,
    weight: float = 1.0,
) -> Model:
    """Estimate the parameters of a model and return the fitted model; the given model does not change.

    Parameters
    ----------
    model : Model
        `one_step` needs one that is linear in its parameters; `free_run` starts from its theta, or from `one_step`.
    records : Record or list of Record
    constraints : sequence of Eq in the model's symbols and of "continuum", or "continuum" alone, optional
        "continuum" stands for all conditions under which every output may rest. By default what the model carries.
    method : "one_step", "free_run", "els" or "auto"
        `auto` fits one step ahead, and from there in free run where that does not diverge. `els` is one step ahead
        with a moving average of the noise.
    starts, seed : int
        Of the free-run fit: how many start values are refined (see `freerun.free_run_fit`).
    warn : bool
        Whether to warn where the fit stops after `max_steps` without having converged.
    steady_state : (n, 2) array of (ubar, ybar), optional
        Pairs that were measured at rest, for `one_step`: each adds the equation ybar = F(ybar, ..., ubar, ...), which
        is linear in theta, so no fixed point is computed [units of the model, else of the records].
    weight : float
        Of the mean squared error of these equations beside that of the one-step prediction; 0 leaves them out.

    Returns
    -------
    Model : with `theta`, `standard_errors` (under white noise) and `info`
        A fit that stops before it converged keeps the best parameters found; `info.converged` is False then.

    Raises
    ------
    FitError
        For dependent regressors, contradicting constraints, too few samples, a diverging start, and steady-state data
        that are no finite pairs, or given to another method.
    """
    check_method(method)
    points = check_steady_state(model, steady_state, weight, method)
    records = in_units(segments(records), model.info.units)
    made, method, converged = estimate(model, records, constraints, method, max_steps, starts, seed, points, weight)
    made = describe(made, records, method, converged)
    return unfinished(described(made, records)) if warn else made


def estimate(
    model: Model,
    records: Sequence[Record],
    constraints: Sequence[Any] | str | None = None,
    method: str = "auto",
    max_steps: int = 60,
    starts: int = 1,
    seed: int = 0,
    points: Array | None = None,
    weight: float = 1.0,
) -> tuple[Model, str, bool]:
    """Estimate parameters as `fit` does: the model without its description, how it was fitted, whether it converged."""
    check_excitation(*records)
    equations = constraint_equations(model, constraints)
    converged = True
    auto = method == "auto" and isinstance(model, NARX)
    if method in ("one_step", "els") or auto or model.theta is None:
        if not isinstance(model, NARX):
            raise FitError("This model is not linear in its parameters: give start values and use method='free_run'.")
        if method == "els":
            theta, errors, converged = extended(model, records, equations)
        else:
            theta, errors = one_step(model, records, equations, points, weight)
    if method in ("free_run", "auto"):
        begin = theta if auto or model.theta is None else model.theta
        try:
            theta, errors, converged = free_run_fit(model, records, equations, begin, max_steps, starts, seed)
            method = "free_run"
        except FitError:
            if not auto:
                raise
            method = "one_step"
    if not np.all(np.isfinite(theta)):
        raise FitError("The estimate is not finite; check the data ranges.")
    known = model.constraints if constraints is None else equations
    made = model.replace(theta=theta.tolist(), standard_errors=errors, constraints=known, Ts=records[0].Ts)
    return made, method, converged


def unfinished(model: Model) -> Model:
    """Warn where a fit stopped before it converged."""
    if not model.info.converged:
        warnings.warn(
            "The fit stopped before it converged; the best parameters found are kept, marked by model.info.converged. "
            "Allow more max_steps, or begin from other values.",
            stacklevel=3,
        )
    return model


def free_run_error(model: Model) -> float:
    """Return the free-run NRMSE on the records that a model was fitted on."""
    return model.info.nrmse.free_run if model.info.nrmse else float("inf")


def described(model: Model, records: Records) -> Model:
    """Return a fitted model with the digits that its printed parameters need."""
    return model.replace(info=replace(model.info, digits=digits(model, records)))


def describe(model: Model, records: Records, method: str, converged: bool) -> Model:
    """Return a model with what it was fitted on: ranges, the line through the data and the band around it, errors."""
    parts = segments(records)
    used = [arrays(model, p) for p in parts]
    signals = {b.name: [one[b.name] for one in used] for b in (model.input, model.output)}
    source, output = map(np.concatenate, signals.values())
    slope = np.polyfit(source, output, 1)[0]
    # Through the centre: a line fitted to all data has an offset where the input merely lingered on one side.
    offset = centre(output) - slope * centre(source)
    pair = evaluate(model, records)
    Ts = parts[0].Ts
    info = replace(
        model.info,
        method=method,
        converged=converged,
        samples=sum(len(p) for p in parts),
        nrmse=Nrmse(pair.one_step_nrmse, pair.free_run_nrmse),
        line=(float(offset), float(slope)),
        band=float(np.max(np.abs(output - offset - slope * source))),
        start=(float(source[0]), float(output[0])),
        steps={name: _step(pieces) for name, pieces in signals.items()},
        units=said_first(model.info.units, parts[0].units),
        roles=dict(parts[0].roles),
        **seen(signals, Ts),
    )
    return model.replace(info=info)


def _step(pieces: Sequence[Array]) -> float:
    """Return the median size of the steps of a signal, where it moves: within records, else from one to the next."""
    within = np.concatenate([np.diff(x) for x in pieces])
    moves = np.abs(within if within.any() else np.diff(np.concatenate(pieces)))
    return float(np.median(moves[moves > 0]))
