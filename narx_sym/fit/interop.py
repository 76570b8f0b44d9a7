"""Other people's libraries: python-control systems of models, and models from and for SysIdentPy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy as sp

from ..codegen.export import written
from ..codegen.layout import numbered, shortened
from ..data.record import Record
from ..errors import ModelError
from ..inversion.compensator import Compensator
from ..models.info import Info
from ..models.model import NARX, Model
from ..symbolic.printing import text
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, lag, samples, signal, t, u, y
from .simulate import fitted, predict

Array = np.ndarray
AGREES = 1e-9  # of the largest prediction: what an import must reproduce
MAX_LAG = 999  # SysIdentPy writes y[k-i] as 1000 + i, u[k-i] as 2000 + i
MAX_RUN_LAG = 499  # its free run rounds the codes to thousands: y[k-500] would be an input (measured with 0.9.0)


def rest_state(recursion: Recursion, initial: Mapping[Any, Any], rest: Mapping[str, float]) -> Array:
    """Return the state vector, in the order of `recursion.past`, of a system that rests.

    Parameters
    ----------
    initial : mapping from states to expressions
        What each of them is at rest; the values of all other sequences are in `rest`, by name.

    Raises
    ------
    ModelError
        For a value that is missing or belongs to nothing.
    """
    needed = {s.base for e in initial.values() for s in samples(e)}
    needed |= {s.base for s in recursion.past if s.base not in initial}
    known = {base.name for base in (*needed, *recursion.states, *recursion.inputs)}
    missing, foreign = sorted({b.name for b in needed} - set(rest)), sorted(set(rest) - known)
    if missing or foreign:
        raise ModelError(f"The state at rest needs {', '.join(missing)}." if missing else f"There is no {foreign[0]}.")
    values = {}
    for base in {s.base for s in recursion.past}:
        expr = sp.sympify(initial.get(base, base[k]))
        values[base] = expr.xreplace({s: sp.Float(float(rest[s.base.name])) for s in samples(expr)})
    return np.array([float(values[s.base]) for s in recursion.past])


def model_rest_state(model: Model, **rest: float) -> Array:
    """Return the state of `export("casadi")` and `to_control` at rest: `model.rest_state(u=1.0, y=2.0)`."""
    begin = {b: e.xreplace(model.values) for b, e in model.starts.items()}
    clock = {"t": 0.0} if any(samples(e, t) for e in begin.values()) else {}
    return rest_state(model.recursion, begin, clock | rest)


def law_rest_state(law: Compensator, share: Any = "auto", **rest: float) -> Array:
    """Return the state of `export("casadi")` at rest: `law.rest_state(m=1.0, r=2.0, y=2.0)`; `share` is as there.

    What the model computes counts where it runs beside the law.
    """
    recursion = law.exported(share=share)
    idle = {b.name for b in (law.model.output, *law.starts) if b not in recursion.states}
    rest = {name: value for name, value in rest.items() if name not in idle}
    begin = {b: e.xreplace(law.model.values) for b, e in law.starts.items() if b in recursion.states}
    clock = {"t": 0.0} if t in recursion.inputs else {}
    return rest_state(recursion, begin, clock | rest)


def to_control(model: Model, name: str = "model") -> Any:
    """Return a model as a discrete-time `control.NonlinearIOSystem` with dt = Ts.

    The state is `model.recursion.past` (`model.rest_state` gives it at rest), the inputs are those of
    `model.recursion.given` but time, which python-control passes itself. Without Ts the system has dt = True. Names
    that python-control does not take get letters, digits and underscores only.

    Raises
    ------
    ModelError
        Where python-control is not installed, or the model has no parameter values.
    """
    try:
        import control
    except ImportError:
        raise ModelError('python-control is not installed: pip install "narx-sym[interop]"') from None
    recursion = model.recursion
    function = written("casadi", recursion, model.values, name, output=model.output)
    own = [s for s in recursion.given if s.base != t]
    labels: dict[Any, str] = {}
    for base in dict.fromkeys(s.base for s in (*recursion.past, *recursion.given)):
        labels[base] = numbered(shortened(base.name, 60), lambda n: n not in labels.values())

    def step(time: float, state: Array, inputs: Array) -> Any:
        given = dict(zip(own, inputs, strict=True))
        return function(state, np.array([given.get(s, time) for s in recursion.given], dtype=float))

    return control.NonlinearIOSystem(
        lambda time, state, inputs, _: np.array(step(time, state, inputs)[0]).ravel(),
        lambda time, state, inputs, _: np.array(step(time, state, inputs)[1]).ravel(),
        inputs=[labels[s.base] for s in own],
        outputs=[model.output.name],
        states=[text(signal(labels[s.base])[s.indices[0]]) for s in recursion.past],
        dt=model.Ts or True,
        name=name,
    )


def from_sysidentpy(fitted: Any, Ts: float | None = None) -> NARX:
    """Return a fitted polynomial model of SysIdentPy (`FROLS` and its relatives) as a model.

    Row i of `final_model` belongs to `theta[i]` in every class that estimates theta itself. `SimulateNARMAX` with a
    theta of the user's own sorts the rows and leaves theta as it is (measured with 0.9.0): it is refused. The import is
    compared with SysIdentPy's own one-step prediction before it is returned.

    Parameters
    ----------
    fitted : a model of SysIdentPy with one input
    Ts : float, optional
        Sampling time, which SysIdentPy does not know [s].

    Raises
    ------
    ModelError
        For another basis than Polynomial, several inputs, a model that is not fitted, or predictions that differ.
    """
    basis = type(getattr(fitted, "basis_function", None)).__name__
    if basis != "Polynomial":
        raise ModelError(f"Only polynomial models of SysIdentPy can be imported, not the basis {basis}.")
    if getattr(fitted, "final_model", None) is None or getattr(fitted, "theta", None) is None:
        raise ModelError("The SysIdentPy model is not fitted.")
    if getattr(fitted, "estimate_parameter", True) is False:
        raise ModelError(
            "SimulateNARMAX sorts the rows of a model but not the theta it was given, so theta no longer matches the "
            "terms. "
            "Use NARX.from_terms with your terms and theta."
        )
    codes = np.asarray(fitted.final_model, dtype=int)
    theta = np.asarray(fitted.theta, dtype=float).ravel()
    if (fitted.n_inputs or 0) > 1 or codes.max(initial=0) > 2000 + MAX_LAG:
        raise ModelError(f"The SysIdentPy model has {fitted.n_inputs} inputs; models here have one.")
    if int(fitted.max_lag) > MAX_LAG:
        raise ModelError(f"SysIdentPy's codes are ambiguous for lags above {MAX_LAG}.")
    if codes.ndim != 2 or len(codes) != len(theta):
        raise ModelError(f"The SysIdentPy model has {len(codes)} rows and {len(theta)} parameters.")
    terms = [sp.Mul(*((y, u)[c // 1000 - 1][k - c % 1000] for c in row.tolist() if c)) for row in codes]
    model = NARX(terms, theta.tolist(), Ts=Ts, info=Info(method=f"SysIdentPy {type(fitted).__name__}"))
    _check_import(model, fitted)
    return model


def _check_import(model: NARX, fitted: Any) -> None:
    """Compare one-step predictions over a short record of random numbers."""
    depth = int(fitted.max_lag)
    u_, y_ = np.random.default_rng(0).uniform(-1, 1, (2, 4 * depth + 50))
    theirs = np.asarray(fitted.predict(X=u_[:, None], y=y_[:, None], steps_ahead=1)).ravel()[depth:]
    ours = predict(model, Record.from_arrays(u_, y_, Ts=1.0))[depth:]
    gap = float(np.abs(ours - theirs).max())
    if not gap <= AGREES * max(1.0, float(np.abs(theirs).max())):
        raise ModelError(f"SysIdentPy's predictions differ from its own rows and theta (by {gap:.3g}): not imported.")


def to_sysidentpy(model: Model) -> Any:
    """Return a polynomial model as a fitted `FROLS` of SysIdentPy, for its `predict`, metrics and plots.

    Written in the user's units: an operating point and phi1 are multiplied out, so there may be more rows than terms.
    `predict(X=u[:, None], y=y[:, None])` is the free run from the first samples of y, with `steps_ahead=1` one step
    ahead. SysIdentPy 0.9 asks for an older NumPy than the newest; this package does not depend on it.

    Raises
    ------
    ModelError
        Where SysIdentPy is not installed, the model has no values, or something has no place in its polynomials: a term
        that is no product of older samples, the input at time k, another channel, a state that an effect remembers.
    """
    fitted(model)
    rows = _rows(model)
    degree, depth = max(len(row) for row in rows), max(c % 1000 for row in rows for c in row)
    if depth > MAX_RUN_LAG:
        raise ModelError(f"SysIdentPy's free run confuses inputs and outputs for lags above {MAX_RUN_LAG}.")
    try:
        from sysidentpy.basis_function import Polynomial
        from sysidentpy.model_structure_selection import FROLS
        from sysidentpy.parameter_estimation import LeastSquares
    except ImportError:
        raise ModelError("SysIdentPy is not installed: pip install sysidentpy") from None
    ylag, xlag = (sorted({c % 1000 for row in rows for c in row if c // 1000 == n}) or [1] for n in (1, 2))
    made = FROLS(
        order_selection=False, n_terms=len(rows), ylag=ylag, xlag=xlag, basis_function=Polynomial(degree=degree),
        estimator=LeastSquares(),
    )  # fmt: skip
    codes = np.array([[*row, *[0] * (degree - len(row))] for row in rows])
    space = {tuple(sorted(row, reverse=True)): i for i, row in enumerate(made.regressor_space(1).tolist())}
    made.n_inputs, made.final_model, made.theta = 1, codes, np.array(list(rows.values()))[:, None]
    made.pivv = np.array([space[tuple(row)] for row in codes.tolist()])  # where its one-step prediction finds them
    made.err = np.zeros(len(rows))  # its tables of results print one for each row
    return made


def _rows(model: Model) -> dict[tuple[int, ...], float]:
    """Return the coefficient of each product of older samples, by SysIdentPy's codes, largest code first."""
    if model.hidden:
        state = model.hidden[0].left
        raise ModelError(f"SysIdentPy cannot represent {text(state)}, which an effect remembers.")
    right = sp.expand(model.right.xreplace(model.values))
    read = sorted(samples(right), key=str)
    if not read:
        raise ModelError("SysIdentPy cannot represent a model without samples of the input or the output.")
    first = {model.output: 1000, model.input: 2000}
    for one in read:
        if one.base not in first:
            raise ModelError(f"SysIdentPy cannot represent {text(one)}: models of one input only are written.")
        if lag(one) < 1:
            raise ModelError(f"SysIdentPy cannot represent {text(one)}: its terms begin one sample before k.")
    for term in sp.Add.make_args(right):
        if not term.is_polynomial(*read):
            raise ModelError(f"SysIdentPy cannot represent the term {text(term)}: it is no product of samples.")
    found = {}
    for powers, value in sp.Poly(right, *read).terms():
        listed = [first[s.base] + lag(s) for s, n in zip(read, powers, strict=True) for _ in range(n)]
        found[tuple(sorted(listed, reverse=True))] = float(value)
    return found
