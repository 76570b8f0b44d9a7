"""Section 2 of the paper: one-step and free-run prediction, (constrained) least squares, free-run fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from scipy.linalg import qr, solve_triangular
from scipy.linalg.lapack import dtpqrt
from scipy.optimize import least_squares

from .analysis import constraint_matrix, continuum_conditions
from .compile import Columns, compile
from .data import Record, check_excitation
from .errors import FitError
from .model import NARX, Model
from .sensitivity import sensitivities
from .signals import k
from .simulation import arrays, evaluate, segments, shifted

Array = np.ndarray
BLOCK = 2048
Records = Record | Sequence[Record]


# -- least squares ---------------------------------------------------------------------------------------------


def stack_qr(R: Array, block: Array) -> Array:
    """Return the R factor of [R; block]; the block is overwritten. One step of a streamed QR (LAPACK dtpqrt)."""
    width = R.shape[0]
    merged, _, _, info = dtpqrt(0, min(32, width), R, block, overwrite_a=1, overwrite_b=1)
    if info:
        raise FitError(f"LAPACK dtpqrt failed with code {info}.")
    return merged


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
    for data in records:
        n = min(len(x) for x in data.values()) - columns.lead
        for start in range(columns.depth, n, BLOCK):
            block = columns.block(data, start, min(start + BLOCK, n))
            block = np.asfortranarray(block if transform is None else transform(block))
            if not np.all(np.isfinite(block)):
                raise FitError("A regressor is not finite on these data; check the ranges or drop the term.")
            if R is None:
                R = np.zeros((block.shape[1],) * 2, order="F")
            rows += len(block)
            R = stack_qr(R, block)
    if R is None:
        raise FitError(f"The records are shorter than the largest lag ({columns.depth} samples).")
    return np.triu(R), rows


@dataclass(frozen=True)
class Elimination:
    """theta = t0 + Z z solves S theta = c for every z; Z has orthonormal columns."""

    t0: Array
    Z: Array

    @classmethod
    def of(cls, equations: Sequence[Any], symbols: Sequence[Any]) -> Elimination:
        """Derive (S, c) from the equations by linear algebra on the symbols and eliminate by QR."""
        n = len(symbols)
        if not equations:
            return cls(np.zeros(n), np.eye(n))
        S_symbolic, c_symbolic = constraint_matrix(equations, symbols)
        S, c = np.array(S_symbolic, dtype=float), np.array(c_symbolic, dtype=float).ravel()
        t0, fixed = np.zeros(n), np.zeros(n, dtype=bool)
        # A constraint that leaves one parameter free fixes it, exactly; what it fixes may make others so.
        while True:
            open_ = S * ~fixed
            rest = c - S[:, fixed] @ t0[fixed]
            lone = [i for i in range(len(S)) if np.count_nonzero(open_[i]) == 1]
            if not lone:
                break
            at = int(np.flatnonzero(open_[lone[0]])[0])
            t0[at], fixed[at] = rest[lone[0]] / S[lone[0], at], True
        free = np.flatnonzero(~fixed)
        Z = np.eye(n)[:, free]
        rows = np.any(open_ != 0, axis=1)
        if rows.any():
            Q, R, order = qr(open_[rows][:, free].T, pivoting=True)
            rank = int(np.sum(np.abs(np.diag(R)) > 1e-12 * max(1.0, abs(R[0, 0]))))
            t0[free] = Q[:, :rank] @ solve_triangular(R[:rank, :rank], rest[rows][order][:rank], trans="T")
            Z = Z @ Q[:, rank:]
        if not np.allclose(S @ t0, c, rtol=1e-10, atol=1e-12):
            raise FitError("The constraints contradict each other.")
        return cls(t0, Z)


def constraint_equations(model: Model, constraints: Sequence[Any] | None) -> list[Any]:
    """Return the equations; the word "continuum" stands for all conditions of Lemma 1."""
    chosen = list(model.constraints if constraints is None else constraints)
    listed = []
    for c in chosen:
        if isinstance(c, str):
            if c != "continuum":
                raise FitError(
                    f"Unknown constraint {c!r}: give an equation such as Eq(model.sigma_y, 1), or 'continuum'."
                )
            listed += continuum_conditions(model)
        else:
            listed.append(c)
    if sp.false in listed:
        raise FitError("A constraint can never hold.")
    return [c for c in listed if c != sp.true]


def one_step(model: NARX, records: Records, equations: Sequence[Any]) -> tuple[Array, Array]:
    """Least squares under S theta = c by QR: theta and its standard errors.

    The estimator of the paper (Eq. ConstrainedParameters_Estimator, Draper & Smith 1998), solved by elimination
    instead of normal equations.
    """
    parts = segments(records)
    elimination = Elimination.of(equations, model.symbols)
    n, free = elimination.Z.shape
    columns = Columns([*model.terms, model.output[k]])

    def reduced(block: Array) -> Array:
        return np.column_stack([block[:, :n] @ elimination.Z, block[:, n] - block[:, :n] @ elimination.t0])

    R, rows = factor(columns, [shifted(model, arrays(model, p)) for p in parts], reduced)
    if rows <= free:
        raise FitError(
            f"{free} parameters cannot be estimated from {rows} equations: give more samples or fewer terms."
        )
    if free == 0:
        return elimination.t0, np.zeros(n)
    z, covariance = solve_factor(R, rows, [str(t) for t in model.terms])
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
    z = solve_triangular(square, R[:p, p]) / scale
    inverse = solve_triangular(square, np.eye(p)) / scale[:, None]
    variance = R[p, p] ** 2 / (rows - p)
    return z, variance * inverse @ inverse.T


# -- free-run fit ----------------------------------------------------------------------------------------------


def free_run_fit(
    model: Model, records: Records, equations: Sequence[Any], theta0: Array, max_steps: int = 60
) -> tuple[Array, Array, bool]:
    """Minimise the free-run (simulation) error with derived sensitivities, under the same constraints.

    The initial output of each record is estimated beside theta: in a Sigma_y = 1 model an error in it never decays.

    Returns
    -------
    theta, std : (n_theta,) arrays
    converged : bool
    """
    parts = segments(records)
    elimination = Elimination.of(equations, model.symbols)
    recursion, directions = sensitivities(model.recursion, initial=True)
    compiled = compile(recursion)
    name, depth = str(model.output.label), max(1, recursion.depth)
    data = [arrays(model, p) for p in parts]
    moved = [str(d[model.output].label) for d in directions]
    free = elimination.Z.shape[1]
    start = np.concatenate([elimination.Z.T @ (theta0 - elimination.t0), np.zeros(len(parts))])
    spread = float(np.std(np.concatenate([d[name] for d in data]))) or 1.0
    names = [name, *moved]
    lengths = [len(d[name]) - depth for d in data]
    edges = np.cumsum([0, *lengths])
    # The recursion writes straight into the columns of these: no allocation while the fit runs.
    buffers = [np.empty((len(d[name]), len(names)), order="F") for d in data]
    outs = [{n: w[:, i] for i, n in enumerate(names)} for w in buffers]
    slopes = np.zeros((edges[-1], free + len(parts)), order="F")
    residuals = np.empty(edges[-1])
    last: list[Array] = []

    def run(z: Array) -> tuple[Array, Array]:
        if last and np.array_equal(last[0], z):
            return residuals, slopes
        theta = elimination.t0 + elimination.Z @ z[:free]
        for i, (d, w) in enumerate(zip(data, buffers, strict=True)):
            initial = {name: d[name][:depth] + z[free + i], **dict.fromkeys(moved, 0.0), moved[-1]: 1.0}
            compiled(d, theta, initial, on_divergence="nan", out=outs[i])
            rows = slice(edges[i], edges[i + 1])
            np.subtract(w[depth:, 0], d[name][depth:], out=residuals[rows])
            residuals[rows] /= spread
            slopes[rows, :free] = w[depth:, 1:-1] @ (elimination.Z / spread)
            slopes[rows, free + i] = w[depth:, -1] / spread
        last[:] = [z.copy()]
        return residuals, slopes

    first = run(start)[0]
    if not np.all(np.isfinite(first)):
        raise FitError(
            "The free run of the start values diverges: fit one step ahead with fewer terms first, or give theta."
        )
    with np.errstate(all="ignore"):
        found = least_squares(
            lambda z: run(z)[0].copy(), start, jac=lambda z: run(z)[1].copy(), x_scale="jac", method="trf",
            max_nfev=max_steps, xtol=1e-12, ftol=1e-12, gtol=1e-12,
        )  # fmt: skip
    theta = elimination.t0 + elimination.Z @ found.x[:free]
    freedom = max(1, found.fun.size - found.x.size)
    R = qr(found.jac, mode="economic")[1]
    try:
        inverse = solve_triangular(R, np.eye(R.shape[0]))
        covariance = (2 * found.cost / freedom * inverse @ inverse.T)[:free, :free]
        std = np.sqrt(np.maximum(np.diag(elimination.Z @ covariance @ elimination.Z.T), 0.0))
    except np.linalg.LinAlgError:
        std = np.full(theta.size, np.nan)
    return theta, std, bool(found.status > 0)


def fit(
    model: Model,
    records: Records,
    constraints: Sequence[Any] | None = None,
    method: str = "one_step",
    max_steps: int = 60,
) -> Model:
    """Estimate the parameters of a model in place.

    Parameters
    ----------
    model : Model
        `one_step` needs one that is linear in its parameters; `free_run` starts from its theta, or from `one_step`.
    records : Record or list of Record
    constraints : sequence of Eq in the model's symbols, or "continuum", optional
        By default those that the model carries.
    method : "one_step", "free_run" or "auto"
        `auto` fits one step ahead, then in free run, and keeps the better free run.

    Returns
    -------
    model : the same object, with `theta`, `std` (standard errors under white noise) and `info`

    Raises
    ------
    FitError
        For dependent regressors, contradicting constraints, too few samples, or a diverging start.
    """
    if method not in ("auto", "one_step", "free_run"):
        raise FitError(f"Unknown method {method!r}: use 'auto', 'one_step' or 'free_run'.")
    if method == "auto":
        return _better_fit(model, records, constraints, max_steps)
    for record in [records] if isinstance(records, Record) else records:
        check_excitation(record)
    equations = constraint_equations(model, constraints)
    converged = True
    if method == "one_step" or model.theta is None:
        if not isinstance(model, NARX):
            raise FitError("This model is not linear in its parameters: give start values and use method='free_run'.")
        theta, std = one_step(model, records, equations)
    if method == "free_run":
        theta, std, converged = free_run_fit(
            model, records, equations, theta if model.theta is None else model.theta, max_steps
        )
    if not np.all(np.isfinite(theta)):
        raise FitError("The estimate is not finite; check the data ranges.")
    model.theta = theta.tolist()
    model.std = tuple(float(s) for s in std)
    if constraints is not None:
        model.constraints = tuple(equations)
    describe(model, records, method, converged)
    return model


def _better_fit(model: Model, records: Records, constraints: Sequence[Any] | None, max_steps: int) -> Model:
    """Fit one step ahead and in free run, and keep the better free run; a failed free-run fit changes nothing."""
    if isinstance(model, NARX):
        fit(model, records, constraints)
    before = (model.theta, model.std, dict(model.info))
    try:
        fit(model, records, constraints, "free_run", max_steps)
    except FitError:
        if before[0] is None:
            raise
        return model
    if isinstance(model, NARX) and model.info["nrmse"]["free_run"] > before[2]["nrmse"]["free_run"]:
        model.theta, model.std, model.info = before
    return model


def describe(model: Model, records: Records, method: str, converged: bool) -> None:
    """Keep in the model what it was fitted on: ranges, the line through the data, errors in pairs."""
    parts = segments(records)
    source, output = (
        np.concatenate([arrays(model, p)[str(b.label)] for p in parts]) for b in (model.input, model.output)
    )
    slope = np.polyfit(source, output, 1)[0]
    # Through the operating point: a line through all data has an offset where the input merely lingered on one side.
    offset = model.operating_point.get(model.output, 0.0) - slope * model.operating_point.get(model.input, 0.0)
    pair = evaluate(model, records)
    model.Ts = parts[0].Ts
    model.info |= {
        "method": method,
        "converged": converged,
        "samples": int(sum(len(p) for p in parts)),
        "ranges": {
            str(b.label): [float(x.min()), float(x.max())] for b, x in ((model.input, source), (model.output, output))
        },
        "line": [float(offset), float(slope)],
        "nrmse": {"one_step": pair.one_step_nrmse, "free_run": pair.free_run_nrmse},
    }
