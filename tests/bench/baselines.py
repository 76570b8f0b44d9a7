"""Which effect is missing, asked of other toolkits: same cases, same base, same pool of columns.

    python tests/bench/battery.py --baselines ...

The pool. Regressors of the linear base (lags of y and u, constant) that our method starts from, and the contributions
z of every effect: all forms, places and drivers, at every grid point, with the grids of our own directions. All is
evaluated along the *measured* output, one step ahead. `inside`: z as it stands. `input`: z delayed like u, by the
delay of the base. `output`: z as it stands; where y itself drives it, z[k] holds the very y[k] that is to be predicted,
so it comes one sample later. Rows are those that our method uses (training and held-out); the sealed ones are left out.

What all methods are given. Columns are standardised, and an effect with a declared sign is offered only where its
coefficient beside the base has this sign (ours does the same; dead zone and saturation are one column otherwise).
The one-step methods always keep the base: it is projected out of target and columns, which equals picking its terms
first (forward selection) or leaving them unpenalised (lasso). Columns inside the span of the base are dropped.
As people call them, with base terms that compete like all others, they do worse.

- SysIdentPy: `FROLS.error_reduction_ratio(psi, y, n)` takes the matrix directly (`max_lag = 0`); order of picking.
- PySINDy: its optimizers take the matrix directly; the discrete-time model is y[k] = pool @ coefficients. `SSR` with
  normalised columns and its own ridge of 0.05, which did better than `STLSQ` with several ridges. Order: last to be
  eliminated first. (Its `FROLS` fails on nearly dependent columns.)
- lasso: scikit-learn's `lars_path_gram(method="lasso")`; order of entering the path, so no cross-validation.
- correlation: |correlation| of raw columns with the free-run residual of the base, on the same rows.

The first column of an effect gives its rank. Settings were chosen on seed 100, in favour of these methods.
Noise on y biases one-step estimates towards further lags: `inertia`, `rate_dependence` and `input_delay`, which are
never the truth here, are then named first.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import sympy as sp

from narx_sym import NARX, Record
from narx_sym.diagnosis.refit import Fitted
from narx_sym.diagnosis.screening.directions import Linearised
from narx_sym.engines.columns import Columns
from narx_sym.files.parallel import one_blas_thread
from narx_sym.fit.constraints import constraint_equations
from narx_sym.fit.freerun import FreeRun
from narx_sym.models.effects import EFFECTS
from narx_sym.models.extend import equations

Array = np.ndarray
TINY = 1e-7  # share of a column's energy below which the base spans it
PICKS = 25  # columns that a forward selection takes
STEPS = 80  # along the lasso path


@dataclass
class Pool:
    """What a method chooses from.

    Attributes
    ----------
    names : effect id of each column, "" for a term of the base
    matrix : (rows, columns) array, raw
    target : (rows,) array, the measured output
    residual : (rows,) array, measured minus free run of the base
    signs : (columns,) array, +1 or -1 where only this sign of the coefficient means the effect, else 0
    """

    names: list[str]
    matrix: Array
    target: Array
    residual: Array
    signs: Array


def pool_of(fitted: Fitted, record: Record) -> Pool:
    """Build the pool at a fitted linear base."""
    base = fitted.model
    if not isinstance(base, NARX):
        raise TypeError("The base must be a NARX model.")
    whole = FreeRun(base, list(fitted.split.records), constraint_equations(base, None))
    line = Linearised(whole, fitted.unknowns)
    directions, _ = line.directions(list(record.channels), EFFECTS)
    # From here on contributions are read along the measured output.
    measured = Linearised(whole, fitted.unknowns)
    output = str(base.output.label)
    offset = base.operating_point.get(base.output, 0.0)
    for seen, data in zip(measured.seen, whole.data, strict=True):
        seen[output] = seen["x"] = data[output] - offset
    names, signs, blocks = [""] * len(base.terms), [0] * len(base.terms), []
    for one in directions:
        variant = one.variant
        form = equations(base, variant)
        symbols = [sp.Symbol(p, real=True) for p in variant.shape]
        later = base.delay if variant.where == "input" else int(variant.where == "output" and variant.driver == "y")
        z = measured.contributions(form, dict(zip(symbols, one.shape, strict=True)))
        blocks.append([_delayed(columns, later) for columns in z])
        names += [variant.id] * z[0].shape[1]
        signs += [variant.effect.sign] * z[0].shape[1]
    terms, first = Columns(base.terms), whole.depth
    parts = []
    for i, seen in enumerate(measured.seen):
        own = terms.block(seen, first, len(seen[output]))
        parts.append(np.column_stack([own, *(b[i][first:] for b in blocks)]))
    rows = np.concatenate([~sealed[first:] for sealed in fitted.split.test])
    target = np.concatenate([seen[output][first:] for seen in measured.seen])
    return Pool(names, np.concatenate(parts)[rows], target[rows], line.residual[rows], np.array(signs))


def _delayed(columns: Array, samples: int) -> Array:
    """Shift columns to later samples; before the first one they rest."""
    return columns if not samples else np.concatenate([np.repeat(columns[:1], samples, axis=0), columns[:-samples]])


# ---- what the methods see -------------------------------------------------------------------------------------------


def _standard(columns: Array) -> tuple[Array, Array]:
    """Return columns with mean 0 and spread 1, and which of them move at all."""
    centred = columns - columns.mean(axis=0)
    spread = centred.std(axis=0)
    moves = spread > 1e-12 * np.abs(columns).max(axis=0)
    return centred[:, moves] / spread[moves], moves


def _beside_base(pool: Pool) -> tuple[Array, Array, Array]:
    """Return the columns of effects without what the base spans, the target alike, and the indices of the columns."""
    own = np.array([not name for name in pool.names])
    Q, R = np.linalg.qr(np.column_stack([np.ones(pool.target.size), _standard(pool.matrix[:, own])[0]]))
    Q = Q[:, np.abs(np.diag(R)) > 1e-9 * np.abs(np.diag(R)).max()]
    X, moves = _standard(pool.matrix)
    at = np.flatnonzero(moves)
    X, y = X - Q @ (Q.T @ X), pool.target - Q @ (Q.T @ pool.target)
    left = np.einsum("ij,ij->j", X, X) / len(X)
    usable = ~own[at] & (left > TINY) & ((pool.signs[at] == 0) | (pool.signs[at] * (X.T @ y) > 0))
    return X[:, usable] / np.sqrt(left[usable]), y / y.std(), at[usable]


def _first(pool: Pool, columns: Array) -> list[str]:
    """Return effect ids in the order of their first column."""
    return list(dict.fromkeys(pool.names[i] for i in columns if pool.names[i]))


# ---- methods --------------------------------------------------------------------------------------------------------


def frols(pool: Pool) -> list[str]:
    """SysIdentPy's forward selection by the error reduction ratio."""
    from sysidentpy.model_structure_selection import FROLS

    X, y, at = _beside_base(pool)
    chooser = FROLS(n_terms=PICKS, order_selection=False)
    chooser.max_lag = 0
    _, order, _ = chooser.error_reduction_ratio(X, y[:, None], min(PICKS, X.shape[1]))
    return _first(pool, at[np.asarray(order)])


def ssr(pool: Pool) -> list[str]:
    """PySINDy's stepwise sparse regression: one coefficient is eliminated after the other."""
    from pysindy import SSR

    X, y, at = _beside_base(pool)
    fitted = SSR(max_iter=X.shape[1], normalize_columns=True).fit(X, y)
    order: list[int] = []
    for coefficients in map(np.ravel, reversed(fitted.history_)):
        size = np.abs(coefficients)
        order += [i for i in np.argsort(-size, kind="stable") if size[i] > 0]
    return _first(pool, at[order])


def lasso(pool: Pool) -> list[str]:
    """Order of entering the lasso path."""
    from sklearn.linear_model import lars_path_gram

    X, y, at = _beside_base(pool)
    _, _, path = lars_path_gram(X.T @ y, X.T @ X, n_samples=len(y), method="lasso", max_iter=STEPS)
    used = path != 0
    entered = [i for i in np.argsort(used.argmax(axis=1), kind="stable") if used[i].any()]
    return _first(pool, at[entered])


def correlation(pool: Pool) -> list[str]:
    """Correlate raw columns with the free-run residual."""
    X, moves = _standard(pool.matrix)
    at = np.flatnonzero(moves)
    r = X.T @ (pool.residual - pool.residual.mean())
    size = np.where((pool.signs[at] == 0) | (pool.signs[at] * r > 0), np.abs(r), -1.0)
    order = np.argsort(-size, kind="stable")
    return _first(pool, at[order[size[order] >= 0]])


METHODS: dict[str, Callable[[Pool], list[str]]] = {
    "SysIdentPy FROLS": frols,
    "PySINDy": ssr,
    "lasso": lasso,
    "correlation": correlation,
}


def ranked(pool: Pool) -> dict[str, list[str]]:
    """Return the ids that each method ranks, best first; one whose package is missing is left out with a warning."""
    found = {}
    with one_blas_thread(), warnings.catch_warnings():
        for name, method in METHODS.items():
            try:
                warnings.simplefilter("ignore")  # of convergence: a collinear pool is the point here
                found[name] = method(pool)
            except ImportError as error:
                warnings.simplefilter("default")
                warnings.warn(f"{name} is skipped: {error}.", stacklevel=2)
            except (ValueError, np.linalg.LinAlgError):  # it names nothing
                found[name] = []
    return found
