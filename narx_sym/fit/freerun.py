"""The free-run (simulation-error) fit: nonlinear least squares with derived sensitivities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import sympy as sp
from scipy.linalg import LinAlgError, qr, solve_triangular
from scipy.optimize import least_squares

from ..engines.algebra import banded, gathered
from ..engines.columns import Columns, reader
from ..engines.compile import compile
from ..engines.slopes import Walk, with_slopes
from ..errors import FitError
from ..files.parallel import one_blas_thread, sweep
from ..models.extend import form_of
from ..models.model import NARX, Model
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import expand_phi, k, lag, lags, samples
from .constraints import Elimination
from .ensemble import costs
from .simulate import Records, arrays, initial_values, parts, segments

Array = np.ndarray
MANY = 16  # more parameters than this: one banded solve instead of one compiled equation each
SPREAD, TRIED, PIECES = 0.3, 64, 12
SECANTS = (3.0, 1.0, 0.3, 0.1)  # how many times its error a secant moves the free run to either side, in turn
HUGE, LARGEST = 1e12, 1e100  # derivatives times parameters, in standard deviations of the output; in any unit


@dataclass(frozen=True)
class Start:
    """One unknown about the time before the first computed sample: a shift of some states.

    `back` counts from the last initial sample; without it all initial samples shift together.
    """

    states: tuple[Any, ...]
    back: int | None = None

    def shape(self, depth: int) -> Array:
        """Return where the shift acts, (depth,)."""
        return np.ones(depth) if self.back is None else (np.arange(depth) == depth - 1 - self.back) * 1.0


def starts(model: Model) -> list[Start]:
    """Return the unknowns about the time before the first sample: each output that the core uses, and each memory."""
    groups: dict[str, list[Any]] = {}
    for state in model.memory:
        groups.setdefault(state.group, []).append(state.left.base)
    outputs = [i - 1 for i in lags(model.core, model.inner)]
    return [*(Start((model.inner,), i) for i in outputs), *(Start(tuple(g)) for g in groups.values())]


def has_integrator(model: Model) -> bool:
    """Whether a pole of a model is 1: the slopes of its core by older outputs add up to it.

    By a constraint, or as it is written.
    """
    listed = tuple(c for c in model.constraints if not isinstance(c, str))
    return _sums_to_one(expand_phi(model.core, model.input), model.inner, listed, not isinstance(model, NARX))


@lru_cache(maxsize=64)
def _sums_to_one(core: Any, inner: Any, constraints: tuple[Any, ...], simplify: bool) -> bool:
    total = sp.Add(*(derivative(core, inner[k - i]) for i in lags(core, inner)))
    if samples(total):
        return False
    equations = [sp.expand(c.lhs - c.rhs if isinstance(c, sp.Equality) else c) for c in constraints]
    equations += [sp.simplify(total) - total] if simplify else []
    return any(0 in (sp.expand(e - total + 1), sp.expand(e + total - 1)) for e in equations)


def load_of(model: Model) -> Any:
    """Return the constant of a model that integrates: an unknown load, which may differ between records; else None."""
    return _constant(expand_phi(model.core, model.input), model.symbols) if has_integrator(model) else None


@lru_cache(maxsize=64)
def _constant(core: Any, symbols: tuple[Any, ...]) -> Any:
    beside = ((s, sp.diff(core, s)) for s in symbols)
    return next((s for s, slope in beside if slope != 0 and not samples(slope) and not slope.has(s)), None)


def determined(z: Array, size: Array) -> bool:
    """Whether the unknowns determine a free run: the norms of its derivatives stay bounded, it is not chaotic."""
    return bool(np.all(size * np.abs(z) < HUGE) and np.all(size < LARGEST))


class FreeRun:
    """Residuals and their derivatives of a model along records, under linear constraints.

    The unknowns are z: the free parameters, then per segment the shifts in `starts`: of each initial output, and of
    what each effect remembers. (In a Sigma_y = 1 model an error in the initial output never decays.) Last may come that
    of the load.

    Parameters
    ----------
    model : Model
    records : Record or list of Record
    equations : sequence of Eq in the model's symbols; None where the model's parameters stay as they are
    use : list of (N,) bool arrays, optional
        Which samples of each segment count; all by default.
    loads : bool
        Whether the load of a model that integrates (`load_of`) is estimated for each segment, like a start state.
    """

    def __init__(
        self,
        model: Model,
        records: Records,
        equations: Sequence[Any] | None,
        use: Sequence[Array] | None = None,
        loads: bool = False,
    ):
        self.model, self.records, self.equations, self.use, self.loads = model, records, equations, use, loads
        load = load_of(model) if loads else None
        self.load = None if load is None else list(model.symbols).index(load)
        if equations is None:
            self.elimination = Elimination(np.array(model.theta), np.zeros((len(model.symbols), 0)))
        else:
            held = [] if load is None else [sp.Eq(load, model.values.get(load, sp.S.Zero))]
            self.elimination = Elimination.of([*equations, *held], model.symbols)
        self.name, self.depth = model.output.name, max(1, model.recursion.depth)
        self.data = [arrays(model, p) for p in segments(records)]
        self.free = self.elimination.Z.shape[1]
        self.rows = [
            slice(self.depth, None) if use is None else np.flatnonzero(use[i][self.depth :]) + self.depth
            for i in range(len(self.data))
        ]
        measured = [d[self.name] for d in self.data]
        self.spread = float(np.std(np.concatenate(measured))) or 1.0
        self.edges = np.cumsum([0, *(m[r].size for m, r in zip(measured, self.rows, strict=True))])
        if min(m.size for m in measured) <= self.depth or self.edges[-1] <= self.free:
            raise FitError(f"{self.free} parameters cannot be estimated from {max(self.edges[-1], 0)} samples.")
        self.initial = [initial_values(model, d, self.depth) for d in self.data]
        self.starts = starts(model)
        self._moved = [([state.name for state in s.states], s.shape(self.depth)) for s in self.starts]
        numbers = {s.left.base.name for s in model.memory if sp.sympify(s.initial).is_number}
        self.blank = [[n for n in names if n in numbers] for names, _ in self._moved]
        self.own_unknowns = len(self.starts) + (self.load is not None)
        self.shifts = len(self.data) * self.own_unknowns
        self._last: Array | None = None
        self._reduced: tuple[Array, Array] | None = None

    @cached_property
    def slopes(self) -> Array:
        """Where the derivatives go, (rows, unknowns)."""
        return np.zeros((self.edges[-1], self.free + self.shifts))

    @cached_property
    def residuals(self) -> Array:
        """Where the residuals go, (rows,)."""
        return np.empty(self.edges[-1])

    def rest(self) -> None:
        """Give the memory of runs back; the next one takes it again."""
        for name in ("slopes", "residuals", "_move"):
            self.__dict__.pop(name, None)
        self._last = self._reduced = None

    @cached_property
    def _move(self) -> Any:
        """The run with its derivatives: derived and compiled when it is first needed."""
        long = isinstance(self.model, NARX) and len(self.model.symbols) > MANY
        return self._banded() if long else self._forward()

    def __reduce__(self) -> Any:
        """Rebuild in another process: machine code does not travel."""
        return FreeRun, (self.model, self.records, self.equations, self.use, self.loads)

    def start(self, theta: Array) -> Array:
        """Return the unknowns of given parameters, with the measured initial outputs."""
        z = self.elimination.Z.T @ (np.asarray(theta) - self.elimination.t0)
        return np.concatenate([z, np.zeros(self.shifts)])

    def begun(self, z: Array, errors: Sequence[Array]) -> Array:
        """Return unknowns whose initial outputs are those of free runs with errors (N,), one per segment.

        Poles near 1 make much of the noise of measured ones.
        """
        z = z.copy()
        for i, error in enumerate(errors):
            for at, start in enumerate(self.starts, self.own(i).start):
                if start.back is not None:
                    z[at] = error[self.depth - 1 - start.back]
        return z

    def theta(self, z: Array) -> Array:
        """Return the parameters of given unknowns; with the mean of the loads, where these are unknowns."""
        theta = self.elimination.t0 + self.elimination.Z @ z[: self.free]
        if self.load is not None:
            lengths = [d[self.name].size for d in self.data]
            theta[self.load] += np.average([z[self.own(i)][-1] for i in range(len(self.data))], weights=lengths)
        return theta

    def along(self, z: Array, i: int) -> tuple[Array, Array]:
        """Return the parameters along segment i, with its own load, and the shifts of its starts."""
        theta, shifts = self.elimination.t0 + self.elimination.Z @ z[: self.free], z[self.own(i)]
        if self.load is not None:
            theta[self.load] += shifts[-1]
        return theta, shifts[: len(self.starts)]

    def run(self, z: Array) -> tuple[Array, Array]:
        """Return residuals (rows,) and derivatives (rows, unknowns), in standard deviations of the output.

        Both arrays are reused by the next call; they hold NaN from where a run diverges.
        """
        if self._last is not None and np.array_equal(self._last, z):
            return self.residuals, self.slopes
        with np.errstate(all="ignore"):  # what diverges is seen by its values
            self._run(z)
        self._last = z.copy()
        return self.residuals, self.slopes

    @cached_property
    def _open(self) -> bool:
        """Whether no constraint holds: the unknowns are the parameters."""
        Z = self.elimination.Z
        return Z.shape[0] == Z.shape[1] and bool(np.array_equal(Z, np.eye(len(Z))))

    def _run(self, z: Array) -> None:
        for i, d in enumerate(self.data):
            own = self.own(i)
            simulated, moved = self.moved(i, *self.along(z, i))
            rows, kept, p = slice(self.edges[i], self.edges[i + 1]), self.rows[i], moved.shape[1] - len(self.starts)
            self.residuals[rows] = (simulated[kept] - d[self.name][kept]) / self.spread
            if self._open and p:
                np.divide(moved[kept, :p], self.spread, out=self.slopes[rows, :p])
            elif self.free:
                self.slopes[rows, : self.free] = moved[kept, :p] @ (self.elimination.Z / self.spread)
            self.slopes[rows, own.start : own.start + len(self.starts)] = moved[kept, p:] / self.spread
            if self.load is not None:
                self.slopes[rows, own.stop - 1] = moved[kept, self.load] / self.spread

    def moved(self, i: int, theta: Array, shifts: Array) -> tuple[Array, Array]:
        """Return the free run along segment i, (N,), and its derivatives by the parameters and by the segment's starts.

        Both are used again by the next call; NaN from where the run diverges.
        """
        runs, columns = self._move(i, theta, shifts)
        return runs[self.name], columns[:, :-1]

    def compared(self, i: int, theta: Array, shifts: Array) -> Array:
        """Return the derivatives along segment i and, last, simulated minus measured: (N, columns), used again."""
        runs, columns = self._move(i, theta, shifts)
        np.subtract(runs[self.name], self.data[i][self.name], out=columns[:, -1])
        return np.asarray(columns)

    def walked(self, i: int, z: Array, shifts: Array | None = None) -> dict[str, Array]:
        """Return every computed sequence along segment i from measured or shifted starts, (N,) each, used again."""
        return dict(self._move(i, self.along(z, i)[0], np.zeros(len(self.starts)) if shifts is None else shifts)[0])

    def reach(self, z: Array, i: int) -> Array:
        """Return how far what starts at a number goes along segment i from there, (starts,); infinite of the others."""
        runs = self.walked(i, z)
        return np.array([max(map(np.ptp, (runs[n] for n in names)), default=np.inf) for names in self.blank])

    def own(self, i: int) -> slice:
        """Return where the shifts of segment i stand among the unknowns."""
        return slice(self.free + i * self.own_unknowns, self.free + (i + 1) * self.own_unknowns)

    def shifted(self, i: int, shifts: Array) -> dict[str, Array]:
        """Return the initial values of segment i with each group of starts shifted."""
        values = dict(self.initial[i])
        for (names, shape), shift in zip(self._moved, shifts, strict=True):
            for name in names:
                values[name] = values[name] + shift * shape
        return values

    def simulate(self, z: Array, i: int, engine: str = "native") -> Array:
        """Return the free run along segment i, (N,)."""
        return np.asarray(self.states(z, i, engine)[self.name])

    def states(self, z: Array, i: int, engine: str = "native") -> dict[str, Array]:
        """Return every computed sequence along segment i, by name, (N,) each."""
        compiled, (theta, shifts) = compile(self.model.recursion, engine), self.along(z, i)
        return dict(compiled(self.data[i], theta, self.shifted(i, shifts), on_divergence="nan"))

    def determined(self, z: Array) -> bool:
        """Whether the unknowns determine the free run along all samples, those too that do not count."""

        def bounded(i: int) -> bool:
            theta, shifts = self.along(z, i)
            with np.errstate(all="ignore"):
                size = np.linalg.norm(self.moved(i, theta, shifts)[1], axis=0) / self.spread
                return determined(np.concatenate([theta, shifts]), size)

        return all(bounded(i) for i in range(len(self.data)))

    def _forward(self) -> Any:
        """Sensitivities in the same compiled pass as the run."""
        groups = tuple(s.states for s in self.starts)  # with all parameters, fixed ones too: derived and compiled once
        compiled = with_slopes(self.model.recursion, groups, self.model.output)
        walks: dict[tuple[int, int], tuple[Any, dict[str, Array], Walk]] = {}  # the data may be exchanged

        def move(i: int, theta: Array, shifts: Array) -> tuple[dict[str, Array], Array]:
            data = self.data[i]
            key = (i, id(data))
            if key not in walks:
                walk = compiled.over(data, self.initial[i], self._moved)
                begin = {n: walk.states[n][: self.depth].copy() for group, _ in self._moved for n in group}
                walks[key] = data, begin, walk
            _, begin, walk = walks[key]
            for name, start in begin.items():
                walk.states[name][: self.depth] = start
            for (group, shape), shift in zip(self._moved, shifts, strict=True):
                for name in group:
                    walk.states[name][: self.depth] += shift * shape
            walk.run(np.ascontiguousarray(theta, dtype=float))
            return walk.states, walk.columns

        return move

    def _banded(self) -> Any:
        """All derivatives from one banded system L S = Psi along the run, with L = 1 - sum dF/dy[k-i] q^-i."""
        model = self.model
        compiled = compile(model.recursion)
        orders = range(1, model.n_y + 1)
        gradients = (expand_phi(derivative(model.right, model.output[k - i])) for i in orders)
        read, steepness = reader(tuple(gradients), tuple(model.symbols))
        terms = [model.in_user_units(t) for t in model.terms]  # type: ignore[attr-defined]
        psi = Columns(terms)

        def move(i: int, theta: Array, shifts: Array) -> tuple[dict[str, Array], Array]:
            d, depth = self.data[i], self.depth
            n, p = d[self.name].size, len(terms)
            runs = dict(compiled(d, theta, self.shifted(i, shifts), on_divergence="nan"))
            run = runs[self.name]
            moved = np.zeros((n, p + len(shifts) + 1), order="F")
            if not np.all(np.isfinite(run)):
                moved[:] = np.nan
                return runs, moved
            values = {**d, self.name: run}
            moved[depth:, :p] = psi.block(values, depth, n)
            moved[:depth, p:-1] = np.array([s.shape(depth) for s in self.starts]).reshape(-1, depth).T  # or none
            older = [values[s.base.name][depth - lag(s) : n - lag(s)] for s in read]
            slopes = np.zeros((len(orders), n))
            for column, slope in zip(slopes, steepness(*older, *theta), strict=True):
                column[depth:] = slope
            return runs, banded(orders, list(slopes), moved) if orders else moved

        return move

    def bounds(self, limits: Mapping[Any, tuple[float, float]]) -> tuple[Array, Array]:
        """Return bounds of the unknowns from the limits of some parameters and from the model's own bounds.

        Of parameters that no constraint ties to others.
        """
        low = np.full(self.free + self.shifts, -np.inf)
        high = -low
        for symbol, (least, most) in {**self.model.bounds, **limits}.items():
            row = self.elimination.Z[list(self.model.symbols).index(symbol)]
            if np.count_nonzero(row) == 1 and row.max() == 1.0:
                low[int(np.argmax(row))], high[int(np.argmax(row))] = least, most
        return low, high

    def _widths(self, z: Array) -> dict[Any, tuple[float, float]]:
        """Return that what an effect's shape is, a width or a time, stays positive where it is, unless it has a sign.

        Below zero some effects only change their sign, as tanh(x/s) does, and c theirs.
        """
        theta = dict(zip(self.model.symbols, self.theta(z), strict=True))
        known = ((e, form.scan if (form := form_of(e)) else {}) for e in self.model.effects)
        shapes = [s for e, scan in known for n, s in e.shape.items() if not (n in scan and scan[n].signed)]
        return {s: (0.0, np.inf) for s in shapes if theta[s] > 0}

    def minimise(
        self, start: Array, max_steps: int, tolerance: float = 1e-12, limits: Mapping[Any, Any] | None = None
    ) -> Any:
        """Minimise from given unknowns; return SciPy's result."""
        if not start.size:
            raise FitError("There is nothing to fit: the model has no free parameter and no unknown start.")
        if not np.all(np.isfinite(self.run(start)[0])):
            one_step = "fit one step ahead with fewer terms first, or give theta."
            own = "give start values nearer to the machine, or narrower bounds."
            raise FitError(
                f"The free run of the start values diverges: {one_step if isinstance(self.model, NARX) else own}"
            )
        bounds = self.bounds({**self._widths(start), **(limits or {})})

        def slopes(z: Array) -> Array:
            moved = self._triangle(z)[:, :-1]
            if not determined(z, np.linalg.norm(moved, axis=0)):
                raise FitError("The derivatives of the free run diverge: the model is unstable there.")
            return moved

        def found(begin: Array, errors: Any, steps: Any) -> Any:
            return least_squares(
                errors, np.clip(begin, *bounds), jac=steps, bounds=bounds, x_scale="jac", method="trf",
                max_nfev=max_steps, xtol=tolerance, ftol=tolerance, gtol=tolerance,
            )  # fmt: skip

        try:
            with np.errstate(all="ignore"), one_blas_thread():
                best = found(start, lambda z: self._triangle(z)[:, -1], slopes)
                for reach in SECANTS if self.jumps else ():  # from what is far off to what is near, as a graduated fit
                    best = found(best.x, self.errors_of, lambda z, reach=reach: self.secants(z, reach, *bounds))
                return best
        except LinAlgError:
            raise FitError(
                "The derivatives of the free run cannot be decomposed: the model is close to instability."
            ) from None

    @cached_property
    def jumps(self) -> bool:
        """Whether the next value jumps where an earlier one crosses a threshold: at a sign, or a step, of what is run.

        When that happens moves with the parameters too, and no derivative along the run tells it.
        """
        recursion = self.model.recursion
        steps = (a for _, right in recursion.updates for a in right.atoms(sp.sign, sp.Heaviside))
        return any(s.base in recursion.states for a in steps for s in a.atoms(sp.Indexed))

    def secants(self, z: Array, reach: float, low: Array, high: Array) -> Array:
        """Return central differences of the residuals, (rows, unknowns).

        Each moves the free run by `reach` times its error to either side, as far as the derivatives tell, within
        bounds. Where it diverges there, the derivative stays.
        """
        residuals, moved = self.run(z)
        steps = reach * np.linalg.norm(residuals) / np.linalg.norm(moved, axis=0)
        found = moved.copy()
        for j in np.flatnonzero(np.isfinite(steps)):
            ends = np.clip(z[j] + np.array([-steps[j], steps[j]]), low[j], high[j])
            every = range(len(self.data)) if j < self.free else [(j - self.free) // self.own_unknowns]
            for i in every:
                before, after = (self._misses(np.where(np.arange(z.size) == j, end, z), i) for end in ends)
                secant = (after - before) / np.ptp(ends)
                if np.all(np.isfinite(secant)):
                    found[self.edges[i] : self.edges[i + 1], j] = secant
        return found

    def errors_of(self, z: Array) -> Array:
        """Return the residuals alone, (rows,), in standard deviations of the output."""
        return np.concatenate([self._misses(z, i) for i in range(len(self.data))])

    def _misses(self, z: Array, i: int) -> Array:
        return np.asarray((self.simulate(z, i) - self.data[i][self.name])[self.rows[i]] / self.spread)

    def _triangle(self, z: Array) -> Array:
        """Return a square matrix with the products of the derivatives and the residuals [J r]."""
        if self._reduced is None or not np.array_equal(self._reduced[0], z):
            residuals, slopes = self.run(z)
            blocks = [(slice(*self.edges[i : i + 2]), self.own(i)) for i in range(len(self.data))]
            self._reduced = z.copy(), gathered(slopes, residuals, blocks, self.free)
        return self._reduced[1]

    def solve(self, theta: Array, max_steps: int) -> tuple[Array, Array, bool, float]:
        """Minimise from given parameters: theta, standard errors, converged, half the sum of squares."""
        found = self.minimise(self.start(theta), max_steps)
        return self.theta(found.x), self.errors(found), bool(found.status > 0), float(found.cost)

    def errors(self, found: Any) -> Array:
        """Return the standard errors of the parameters at a minimum, under white noise; NaN where undetermined."""
        # A start that moves nothing, as of a play that the input soon takes along, leaves the others determined.
        moves = np.any(found.jac != 0, axis=0) | (np.arange(found.x.size) < self.free)
        with one_blas_thread():
            R = qr(found.jac[:, moves], mode="economic")[1]
        freedom = max(1, self.edges[-1] - found.x.size)
        Z = self.elimination.Z
        try:
            with np.errstate(all="ignore"), one_blas_thread():
                inverse = solve_triangular(R, np.eye(R.shape[0]))
                whole = 2 * found.cost / freedom * inverse @ inverse.T
                found_errors = np.sqrt(np.maximum(np.diag(Z @ whole[: self.free, : self.free] @ Z.T), 0.0))
                if self.load is not None:
                    at = int(np.count_nonzero(moves[: self.own(0).stop])) - 1
                    found_errors[self.load] = np.sqrt(max(whole[at, at], 0.0))
                return np.asarray(found_errors)
        except (LinAlgError, ValueError):
            return np.full(Z.shape[0], np.nan)  # the data do not determine the parameters


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
        return problem.solve(theta0 if isinstance(model, NARX) else _near(problem, theta0, max_steps), max_steps)[:3]
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


def _near(problem: FreeRun, theta0: Array, max_steps: int) -> Array:
    """Return the better start of two: given parameters, and those of a fit in pieces, each from its own start.

    A piece stays near the measured output where a whole run from wrong parameters does not (multiple shooting: Bock
    1983).
    """
    whole, least = segments(problem.records), 10 * problem.depth
    pieces = [r[s] for r in whole for s in parts(len(r), min(PIECES, max(1, len(r) // least)))]
    try:
        near = FreeRun(problem.model, pieces, problem.equations).solve(theta0, max_steps)[0]
    except FitError:
        return theta0
    with np.errstate(all="ignore"):
        costs = [float(np.sum(problem.errors_of(problem.start(theta)) ** 2)) for theta in (theta0, near)]
    return near if not np.isfinite(costs[0]) or costs[1] < costs[0] else theta0


def _refine(problem: FreeRun, theta: Array, max_steps: int) -> tuple[Array, Array, bool, float] | None:
    try:
        return problem.solve(theta, max_steps)
    except FitError:
        return None
