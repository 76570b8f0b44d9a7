"""The only bridge from symbols to numbers: recursions to functions over arrays, terms to columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
import sympy as sp

from ..errors import Diverged, ModelError
from ..inversion.solution import Root
from ..models.analysis import phi1_, u_, ytilde
from ..models.model import Model
from ..symbolic.recursion import Recursion
from ..symbolic.signals import expand_phi, lag, samples
from .numpy import MODULES
from .plan import Plan

ENGINES = ("native", "numpy", "casadi", "python")
Array = np.ndarray


class Compiled:
    """A recursion as a function over arrays; made by `compile`.

    Attributes
    ----------
    recursion : Recursion
    engine : str
    """

    def __init__(self, recursion: Recursion, engine: str):
        self.recursion, self.engine = recursion, engine
        self.plan = Plan.of(recursion)
        self._run = import_module(f".{engine}", __package__).build(self.plan)
        # Names once: SymPy's printer would take longer than a short run.
        self._inputs = [str(base.label) for base in recursion.inputs]
        self._states = [str(base.label) for base in recursion.states]
        self._remembered = {s for s, i in self.plan.sample if i >= 1}

    def __call__(
        self,
        inputs: Mapping[Any, Any],
        theta: Any = (),
        initial: Mapping[Any, Any] | None = None,
        length: int | None = None,
        start: int | None = None,
        on_divergence: str = "raise",
        out: Mapping[str, Array] | None = None,
        output: Any = None,
    ) -> dict[str, Array]:
        """Run over N samples.

        Parameters
        ----------
        inputs : mapping from a sequence or its name to (N,) arrays
            Where the recursion looks ahead, the last value is held.
        theta : (n_parameters,) array
        initial : mapping from a state or its name to a number or (>= start,) array
            The values before `start`; needed for each state that is used at a lag.
        length : int
            N, for a recursion without inputs.
        start : int
            The first k that is computed, at least `recursion.depth` (the default).
        on_divergence : "raise" or "nan"
            What happens at the first value that is not finite: an error, or NaN from there on.
        out : mapping from the states' names to contiguous (N,) float arrays, optional
            Where the results go: fits that run the same recursion many times save the allocation.
        output : a state or its name, optional
            The state that an error speaks of; by default the first one that is not finite.

        Returns
        -------
        dict from the states' names to (N,) arrays.

        Raises
        ------
        Diverged
            With the first bad sample.
        ModelError
            For missing or unequal inputs.
        """
        recursion = self.recursion
        given = _named(inputs)
        columns = []
        for name in self._inputs:
            if name not in given:
                raise ModelError(f"The input sequence {name} is missing.")
            column = np.ascontiguousarray(given[name], dtype=float)
            if column.size != max(column.shape, default=1):
                raise ModelError(f"The input sequence {name} has shape {column.shape}; one of shape (N,) is needed.")
            columns.append(column.ravel())
        sizes = {c.size for c in columns} | ({length} if length is not None else set())
        if not sizes:  # nothing is read from the inputs: they only say how long the run is
            sizes = {np.size(x) for x in given.values()}
        if not sizes:
            raise ModelError("A recursion without inputs needs the length of the run.")
        if len(sizes) != 1:
            raise ModelError(f"The input sequences have different lengths: {sorted(map(str, sizes))}.")
        n = int(sizes.pop())
        first = max(recursion.depth, start or 0)
        if recursion.lead:
            columns = [np.concatenate([c, np.repeat(c[-1:], recursion.lead)]) for c in columns]
        states = self._start(n, min(first, n), initial or {}, out or {})
        theta = np.ascontiguousarray(theta, dtype=float)
        if theta.shape != (len(recursion.parameters),):
            raise ModelError(f"{len(recursion.parameters)} parameter values are needed, {theta.size} were given.")
        if n > first:
            reached = self._run([*states, *columns], theta, first, n)
            if reached < n:
                if on_divergence == "raise":
                    raise self._diverged(states, reached, output)
                for state in states:
                    state[reached:] = np.nan
        return dict(zip(self._states, states, strict=True))

    def _start(self, n: int, first: int, initial: Mapping[Any, Any], out: Mapping[str, Array]) -> list[Array]:
        given = _named(initial)
        states = []
        for position, name in enumerate(self._states):
            state = out[name] if out else np.empty(n)
            if state.shape != (n,) or state.dtype != float or not state.flags.c_contiguous:
                raise ModelError(f"The result array of {name} must be a contiguous float array of shape ({n},).")
            value = given.get(name, None if position in self._remembered else np.nan)
            if value is None:
                raise ModelError(f"The recursion needs {first} initial samples of {name}.")
            value = np.asarray(value, dtype=float).ravel()
            if value.size != 1 and value.size < first:
                raise ModelError(f"{name} needs {first} initial samples, {value.size} were given.")
            state[:first] = value if value.size == 1 else value[:first]
            states.append(state)
        return states

    def _diverged(self, states: list[Array], at: int, output: Any) -> Diverged:
        """Say where a run leaves the finite numbers: of the output, or else of the state that does so first."""
        bad = (i for i, x in enumerate(states) if not np.isfinite(x[at]))
        shown = next(bad, -1) if output is None else self._states.index(str(getattr(output, "label", output)))
        before = ", ".join(f"{v:.3g}" for v in states[shown][max(0, at - 3) : at])
        return Diverged(
            f"The simulation of {self._states[shown]} diverges: sample {at} is not finite (before it: {before}). "
            "Likely causes: an unstable model, an input far outside the identified range, or wrong initial values.",
            at,
            states[shown],
        )


def _named(mapping: Mapping[Any, Any]) -> dict[str, Any]:
    """Key by name: a sequence may stand for its name."""
    return {base if isinstance(base, str) else str(getattr(base, "label", base)): x for base, x in mapping.items()}


@lru_cache(maxsize=256)
def _compiled(recursion: Recursion, engine: str) -> Compiled:
    return Compiled(recursion, engine)


def compile(recursion: Recursion, engine: str = "native") -> Compiled:
    """Turn a recursion into a function over arrays, once per recursion and engine.

    Parameters
    ----------
    recursion : Recursion
    engine : "native", "numpy", "casadi" or "python"
        Machine code by LLVM, banded solves in NumPy, CasADi's virtual machine, or a generated Python loop. They agree
        to rounding. Where llvmlite is not installed, and for laws that need a root finder, "native" falls back to
        "python".
    """
    if engine not in ENGINES:
        raise ModelError(f"Unknown engine {engine!r}; there are {', '.join(ENGINES)}.")
    if engine == "native" and any(right.has(Root) for _, right in recursion.updates):
        engine = "python"  # only there is a root finder
    if engine == "native":
        try:
            import llvmlite  # noqa: F401
        except ImportError:
            engine = "python"
    return _compiled(recursion, engine)


def to_casadi(recursion: Recursion) -> Any:
    """Return the step of a recursion as a CasADi `Function` (past, inputs, theta, k) -> (following, newest)."""
    from .casadi import step

    return step(Plan.of(recursion))[0]


def lambdify(expressions: Sequence[Any], arguments: Sequence[Any]) -> Any:
    """Return a NumPy function of plain symbols for expressions that are not recursions."""
    function = sp.lambdify(list(arguments), list(expressions), modules=MODULES, cse=True, dummify=True)

    def quiet(*values: Any) -> Any:
        with np.errstate(all="ignore"):  # what is not finite is looked for where it matters
            return function(*values)

    return quiet


class Columns:
    """The regressors of a data set, block by block: a product tree over shared factors.

    Parameters
    ----------
    terms : sequence of expressions in samples `x[k-i]`
    """

    def __init__(self, terms: Iterable[Any]):
        self.terms = [sp.sympify(t) for t in terms]
        self._factors: dict[Any, int] = {}
        self._tree: list[tuple[int | None, int]] = []  # node = parent node times factor
        nodes: dict[tuple[int, ...], int] = {}
        self._nodes = []
        for term in self.terms:
            path: tuple[int, ...] = ()
            parent = None
            for factor in self._split(term):
                path = (*path, factor)
                if path not in nodes:
                    nodes[path] = len(self._tree)
                    self._tree.append((parent, factor))
                parent = nodes[path]
            self._nodes.append(parent)
        written = [expand_phi(f) for f in self._factors]
        self._samples = sorted({s for f in written for s in samples(f)}, key=str)
        self.depth = max([0, *(lag(s) for s in self._samples)])
        self.lead = max([0, *(-lag(s) for s in self._samples)])
        plain = [sp.Symbol(f"s{i}", real=True) for i in range(len(self._samples))]
        renamed = [f.xreplace(dict(zip(self._samples, plain, strict=True))) for f in written]
        self._evaluate = lambdify(renamed, plain)

    def _split(self, term: Any) -> list[int]:
        found = []
        for factor in sp.Mul.make_args(term):
            base, exponent = factor.as_base_exp()
            whole = exponent.is_Integer and 0 < exponent <= 8
            for one in [base] * int(exponent) if whole else [factor]:
                found.append(self._factors.setdefault(one, len(self._factors)))
        return sorted(found)

    def block(self, data: Mapping[str, Array], start: int, stop: int) -> Array:
        """Return the (stop - start, n_terms) values, Fortran order, for start <= k < stop."""
        n = stop - start
        values = []
        for s in self._samples:
            i = lag(s)
            values.append(data[str(s.base.label)][start - i : stop - i])
        with np.errstate(all="ignore"):
            factors = [np.broadcast_to(np.asarray(f, dtype=float), n) for f in self._evaluate(*values)]
        products = np.empty((n, max(1, len(self._tree))), order="F")
        for node, (parent, factor) in enumerate(self._tree):
            if parent is None:
                products[:, node] = factors[factor]
            else:
                np.multiply(products[:, parent], factors[factor], out=products[:, node])
        if self._nodes == list(range(len(self._tree))):
            return products
        result = np.empty((n, len(self.terms)), order="F")
        for column, last in enumerate(self._nodes):
            result[:, column] = 1.0 if last is None else products[:, last]
        return result

    def __call__(self, data: Mapping[str, Array]) -> Array:
        """Return all rows for which every sample exists: (N - depth - lead, n_terms)."""
        n = (
            min(len(data[str(s.base.label)]) for s in self._samples)
            if self._samples
            else len(next(iter(data.values())))
        )
        return self.block(data, self.depth, n - self.lead)


class StaticSets:
    """Quasi-static solutions along an input: numbers and masks.

    Attributes
    ----------
    u, phi1 : (N,) arrays
    ytilde : (N,) array
        The solution of the branch that each sample is on; NaN where the input rests, and where Sigma_y = 1 leaves none
        [unit of the output].
    loading, attracting : (N,) bool arrays
    spectral_radius : (N,) array
        The largest |eigenvalue| of dF/dy; below 1 the set attracts.
    """

    def __init__(self, quasi_static: Any, u: Array, phi1: Array):
        model = quasi_static.model
        self.u, self.phi1 = u, phi1
        self.loading = phi1 > 0
        moving = phi1 != 0
        branches = zip((quasi_static.loading, quasi_static.unloading), quasi_static.branches, strict=True)
        solution, slopes = [], []
        with np.errstate(all="ignore"):
            for expression, derivatives in branches:
                if isinstance(expression, sp.FiniteSet):
                    raise ModelError("The quasi-static equation has several solutions; evaluate them one by one.")
                numeric = [sp.sympify(e).xreplace(model.values) for e in (expression, *derivatives)]
                if _vanishing(expression, model):  # 1 - Sigma_y = 0: every output, or none, is a solution
                    numeric[0] = sp.nan
                foreign = {s for e in numeric for s in e.free_symbols} - {u_, phi1_, ytilde}
                if foreign:
                    raise ModelError(f"The sets depend on further signals ({', '.join(map(str, foreign))}).")
                values_at = lambdify([numeric[0]], [u_, phi1_])(u, phi1)[0]
                solution.append(np.broadcast_to(np.asarray(values_at, dtype=float), u.shape))
                found = lambdify(numeric[1:], [u_, phi1_, ytilde])(u, phi1, solution[-1]) if derivatives else []
                slopes.append([np.broadcast_to(np.asarray(f, dtype=float), u.shape) for f in found])
            self.ytilde = np.where(moving, np.where(self.loading, *solution), np.nan)
            chosen = [np.where(self.loading, a, b) for a, b in zip(*slopes, strict=True)]
        self.spectral_radius = _spectral_radius(chosen, u.size)
        self.attracting = moving & (self.spectral_radius < 1)

    @property
    def repelling(self) -> Array:
        """(N,) bool array."""
        return (self.phi1 != 0) & ~self.attracting


def _vanishing(expression: Any, model: Any) -> bool:
    """Whether the denominator of a quasi-static solution is a number that is zero to rounding."""
    below = sp.fraction(sp.together(expression))[1].xreplace(model.values)
    parts = [abs(float(p)) for p in sp.Add.make_args(below)] if below.is_number else []
    return bool(parts) and abs(float(below)) <= 1e-12 * max(1.0, *parts)


def _spectral_radius(slopes: Sequence[Array], n: int) -> Array:
    if len(slopes) < 2:
        return np.abs(slopes[0]) if slopes else np.zeros(n)
    order = len(slopes)
    companion = np.zeros((n, order, order))
    companion[:, 0, :] = np.stack(slopes, axis=1)
    companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
    return np.abs(np.linalg.eigvals(companion)).max(axis=1)


def evaluate_quasi_static(quasi_static: Any, u: Any, phi1: Any = None) -> StaticSets:
    """Evaluate the quasi-static sets of a fitted model along an input.

    Parameters
    ----------
    u : (N,) array [unit of the model's input]
    phi1 : (N,) array or number, optional
        First difference of the input; that of `u` by default.
    """
    if not quasi_static.model.values:
        raise ModelError("The model has no parameter values: fit it or give theta.")
    source = np.atleast_1d(np.asarray(u, dtype=float))
    step = (
        np.diff(source, prepend=source[:1]) if phi1 is None else np.broadcast_to(np.asarray(phi1, float), source.shape)
    )
    return StaticSets(quasi_static, source, np.array(step))


def largest_root(polynomial: Any, z: Any, arguments: Mapping[Any, Array]) -> Array:
    """Return the largest |root| in z of a polynomial whose coefficients depend on arrays, (N,)."""
    n = max((np.size(v) for v in arguments.values()), default=1)
    lead, *rest = sp.Poly(polynomial, z).all_coeffs()
    names = list(arguments)
    found = lambdify([-c / lead for c in rest], names)(*arguments.values()) if rest else []
    return _spectral_radius([np.broadcast_to(np.asarray(f, dtype=float), n) for f in found], n)


def theta_array(model: Model) -> Array | None:
    """Return the parameter values, (n_theta,) float array, or None before a fit."""
    return None if model._theta is None else np.array(model._theta, dtype=float)
