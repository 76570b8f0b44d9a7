"""The free-run (simulation-error) fit: nonlinear least squares with derived sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, qr, solve_triangular
from scipy.linalg.lapack import dtbtrs
from scipy.optimize import least_squares

from .compile import Columns, compile
from .constraints import Elimination
from .ensemble import costs
from .errors import FitError
from .model import NARX, Model
from .parallel import one_blas_thread, sweep
from .sensitivity import derivative, sensitivities
from .signals import k
from .simulation import Records, arrays, segments

Array = np.ndarray
MANY = 16  # more parameters than this: one banded solve instead of one compiled equation each
SPREAD, TRIED = 0.3, 64


class FreeRun:
    """Residuals and their derivatives of a model along records, under linear constraints.

    The unknowns are z: the free parameters, then one shift of the initial outputs per record. (In a Sigma_y = 1 model
    an error in the initial output never decays.)

    Parameters
    ----------
    model : Model
    records : Record or list of Record
    equations : sequence of Eq in the model's symbols
    """

    def __init__(self, model: Model, records: Records, equations: Sequence[Any]):
        self.model, self.records, self.equations = model, records, equations
        self.elimination = Elimination.of(equations, model.symbols)
        self.name, self.depth = str(model.output.label), max(1, model.recursion.depth)
        self.data = [arrays(model, p) for p in segments(records)]
        self.free = self.elimination.Z.shape[1]
        self.shifts = len(self.data) if model.n_y else 0  # without memory the initial output moves nothing
        measured = [d[self.name] for d in self.data]
        self.spread = float(np.std(np.concatenate(measured))) or 1.0
        self.edges = np.cumsum([0, *(m.size - self.depth for m in measured)])
        if min(m.size for m in measured) <= self.depth or self.edges[-1] <= self.free:
            raise FitError(f"{self.free} parameters cannot be estimated from {max(self.edges[-1], 0)} samples.")
        long = isinstance(model, NARX) and len(model.symbols) > MANY
        self._move = self._banded() if long else self._forward()
        self.slopes = np.zeros((self.edges[-1], self.free + self.shifts), order="F")
        self.residuals = np.empty(self.edges[-1])
        self._last: Array | None = None

    def __reduce__(self) -> Any:
        """Rebuild in another process: machine code does not travel."""
        return FreeRun, (self.model, self.records, self.equations)

    def start(self, theta: Array) -> Array:
        """Return the unknowns of given parameters, with the measured initial outputs."""
        z = self.elimination.Z.T @ (np.asarray(theta) - self.elimination.t0)
        return np.concatenate([z, np.zeros(self.shifts)])

    def theta(self, z: Array) -> Array:
        """Return the parameters of given unknowns."""
        return self.elimination.t0 + self.elimination.Z @ z[: self.free]

    def run(self, z: Array) -> tuple[Array, Array]:
        """Return residuals (rows,) and derivatives (rows, unknowns), in standard deviations of the output.

        Both arrays are reused by the next call; they hold NaN from where a run diverges.
        """
        if self._last is not None and np.array_equal(self._last, z):
            return self.residuals, self.slopes
        theta = self.theta(z)
        for i, d in enumerate(self.data):
            simulated, moved = self._move(i, theta, z[self.free + i] if self.shifts else 0.0)
            rows = slice(self.edges[i], self.edges[i + 1])
            self.residuals[rows] = (simulated[self.depth :] - d[self.name][self.depth :]) / self.spread
            self.slopes[rows, : self.free] = moved[self.depth :, :-1] @ (self.elimination.Z / self.spread)
            if self.shifts:
                self.slopes[rows, self.free + i] = moved[self.depth :, -1] / self.spread
        self._last = z.copy()
        return self.residuals, self.slopes

    def _forward(self) -> Any:
        """Sensitivities in the same compiled pass as the run."""
        recursion, directions = sensitivities(self.model.recursion, initial=True)
        compiled = compile(recursion)
        moved = [str(d[self.model.output].label) for d in directions]
        names = [self.name, *moved]
        # The recursion writes straight into the columns of these: no allocation while the fit runs.
        buffers = [np.empty((len(d[self.name]), len(names)), order="F") for d in self.data]
        outs = [{n: w[:, c] for c, n in enumerate(names)} for w in buffers]

        def move(i: int, theta: Array, shift: float) -> tuple[Array, Array]:
            d = self.data[i]
            initial = {self.name: d[self.name][: self.depth] + shift, **dict.fromkeys(moved, 0.0), moved[-1]: 1.0}
            compiled(d, theta, initial, on_divergence="nan", out=outs[i])
            return buffers[i][:, 0], buffers[i][:, 1:]

        return move

    def _banded(self) -> Any:
        """All derivatives from one banded system L S = Psi along the run, with L = 1 - sum dF/dy[k-i] q^-i."""
        model = self.model
        compiled = compile(model.recursion)
        lags = range(1, model.n_y + 1)
        gradients = [derivative(model.right, model.output[k - i]) for i in lags]
        terms = [model.in_user_units(t) for t in model.terms]  # type: ignore[attr-defined]
        psi = Columns(terms)

        def move(i: int, theta: Array, shift: float) -> tuple[Array, Array]:
            d, depth = self.data[i], self.depth
            n, p = d[self.name].size, len(terms)
            run = compiled(d, theta, {self.name: d[self.name][:depth] + shift}, on_divergence="nan")[self.name]
            moved = np.zeros((n, p + 1), order="F")
            if not np.all(np.isfinite(run)):
                moved[:] = np.nan
                return run, moved
            values = {**d, self.name: run}
            moved[depth:, :p] = psi.block(values, depth, n)
            moved[:depth, p] = 1.0
            band = np.zeros((len(lags) + 1, n), order="F")
            band[0] = 1.0
            known = dict(zip(model.symbols, theta, strict=True))
            for lag, slope in zip(lags, gradients, strict=True):
                column = np.zeros(n)
                if slope != 0:
                    column[depth:] = Columns([slope.xreplace(known)]).block(values, depth, n)[:, 0]
                band[lag, : n - lag] = -column[lag:]
            solved, info = dtbtrs(band, moved, uplo="L", diag="U")
            if info:
                raise FitError(f"LAPACK dtbtrs failed with code {info}.")
            return run, solved

        return move

    def solve(self, theta: Array, max_steps: int) -> tuple[Array, Array, bool, float]:
        """Minimise from given parameters: theta, standard errors, converged, half the sum of squares."""
        start = self.start(theta)
        if not np.all(np.isfinite(self.run(start)[0])):
            raise FitError(
                "The free run of the start values diverges: fit one step ahead with fewer terms first, or give theta."
            )
        with np.errstate(all="ignore"), one_blas_thread():
            found = least_squares(
                lambda z: self.run(z)[0].copy(), start, jac=lambda z: self.run(z)[1].copy(),
                x_scale="jac", method="trf", max_nfev=max_steps, xtol=1e-12, ftol=1e-12, gtol=1e-12,
            )  # fmt: skip
        R = qr(found.jac, mode="economic")[1]
        freedom = max(1, found.fun.size - found.x.size)
        Z = self.elimination.Z
        try:
            inverse = solve_triangular(R, np.eye(R.shape[0]))
            covariance = (2 * found.cost / freedom * inverse @ inverse.T)[: self.free, : self.free]
            std = np.sqrt(np.maximum(np.diag(Z @ covariance @ Z.T), 0.0))
        except (LinAlgError, ValueError):
            std = np.full(Z.shape[0], np.nan)  # the data do not determine the parameters
        return self.theta(found.x), std, bool(found.status > 0), float(found.cost)


def free_run_fit(
    model: Model,
    records: Records,
    equations: Sequence[Any],
    theta0: Array,
    max_steps: int = 60,
    starts: int = 1,
    seed: int = 0,
) -> tuple[Array, Array, bool]:
    """Minimise the free-run error under constraints.

    Parameters
    ----------
    theta0 : (n_theta,) array
    starts : int
        With more than one, random sets around theta0 are simulated side by side, and the best are refined too.

    Returns
    -------
    theta, std : (n_theta,) arrays
    converged : bool
    """
    problem = FreeRun(model, records, equations)
    if starts <= 1:
        return problem.solve(theta0, max_steps)[:3]
    rng = np.random.default_rng(seed)
    z = problem.start(theta0)[: problem.free]
    scale = SPREAD * np.maximum(np.abs(z), 1e-3 * np.abs(z).max(initial=1e-12))
    cloud = z + scale * rng.standard_normal((TRIED * starts, z.size))
    thetas = problem.elimination.t0 + cloud @ problem.elimination.Z.T
    order = np.argsort(costs(model, thetas, records), kind="stable")[: starts - 1]
    calls = [(problem, theta, max_steps) for theta in [np.asarray(theta0), *thetas[order]]]
    found = [f for f in sweep(_refine, calls) if f is not None]
    if not found:
        raise FitError("The free run diverges from every start: fit one step ahead first, or give theta.")
    return min(found, key=lambda f: f[3])[:3]


def _refine(problem: FreeRun, theta: Array, max_steps: int) -> tuple[Array, Array, bool, float] | None:
    try:
        return problem.solve(theta, max_steps)
    except FitError:
        return None
