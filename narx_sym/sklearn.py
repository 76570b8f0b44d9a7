"""A scikit-learn estimator, so that grid searches, cross-validation and pipelines take these models.

It needs `pip install "narx-sym[sklearn]"`; nothing else here imports scikit-learn.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from .data.record import Record
from .engines.numbers import floats
from .errors import DataError
from .fit.identify import identify
from .models.model import Model
from .symbolic.signals import RESERVED, plain_name

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.metrics import r2_score
    from sklearn.utils.validation import check_consistent_length, check_is_fitted, column_or_1d, validate_data
except ImportError:
    raise ImportError('scikit-learn is not installed: pip install "narx-sym[sklearn]"') from None

Array = np.ndarray
# Names that mean something else in equations: what such a column is, and what to do.
TAKEN = {
    "t": "is the time: leave it out or rename it; Ts is the sampling time",
    "u": "has the name of the input, which is the first column: put it there or rename it",
    "y": "has the name of the output, which is no column of X: leave it out or rename it",
}


class NARXRegressor(RegressorMixin, BaseEstimator):
    """`narx_sym.identify` behind fit, predict and score.

    Rows are samples in time, not independent ones: no shuffling. Several records come as scikit-learn's own `groups`,
    one label per sample: a record is a run of equal labels. A list of arrays could be neither cut nor indexed by its
    splitters; with `groups`, `LeaveOneGroupOut` and `GroupKFold` hold out whole records. A part that a splitter cuts
    out of the middle of a record is joined again as if nothing were missing: cut by `groups` or `TimeSeriesSplit`.

    Parameters
    ----------
    base, n_y, n_u, degree, delay, method
        As in `narx_sym.identify`. Every column of X after the first is a channel, with the lags 0 to n_u; the bases
        `play` and `bouc-wen` take none.
    Ts : float
        Sampling time [s].

    Attributes
    ----------
    model_ : Model
        With its equation, its law and its exports; `model_.simulate(u, y0)` starts from outputs of your own.
    n_features_in_ : int
        1 + the number of channels.
    """

    model_: Model

    def __init__(
        self,
        base: str = "narx",
        n_y: int = 1,
        n_u: int = 2,
        degree: int = 3,
        delay: int | None = None,
        method: str = "auto",
        Ts: float = 1.0,
    ):
        self.base = base
        self.n_y = n_y
        self.n_u = n_u
        self.degree = degree
        self.delay = delay
        self.method = method
        self.Ts = Ts

    def fit(self, X: Any, y: Any, groups: Any = None) -> NARXRegressor:
        """Identify a model.

        Parameters
        ----------
        X : (N,) or (N, 1 + channels) array or DataFrame
            The input in the first column [its unit]; further columns are channels. Time is no column.
        y : (N,) array
            The output [its unit].
        groups : (N,) array of labels, optional
            Where it changes, another record begins.

        Raises
        ------
        ValueError
            From scikit-learn for what is no array of finite numbers; `NarxError`, which is one, for the rest, such as
            a channel whose name means something else in equations.
        """
        X, y = validate_data(self, _columns(_seen(X)), _seen(y), y_numeric=True, dtype=np.float64)
        names = self._channels()
        records = [
            Record.from_arrays(X[a:b, 0], y[a:b], self.Ts, channels=dict(zip(names, X[a:b, 1:].T, strict=True)))
            for a, b in _parts(groups, len(X))
        ]
        self.model_ = identify(
            records, base=self.base, n_y=self.n_y, n_u=self.n_u, degree=self.degree, delay=self.delay,
            method=self.method, lags=dict.fromkeys(names, self.n_u) or None,
        )  # fmt: skip
        return self

    def predict(self, X: Any, groups: Any = None) -> Array:
        """Free run over each record: no measured output is used, and each starts from rest at its first input.

        The output at rest is read off the line through the data of the fit (`Model.simulate`).

        Parameters
        ----------
        X, groups
            As in `fit`.

        Returns
        -------
        (N,) array [unit of y]
        """
        check_is_fitted(self)
        X = _seen(X)
        X = validate_data(self, _columns(X) if self.n_features_in_ == 1 else X, reset=False, dtype=np.float64)
        names = self._channels()
        return np.concatenate(
            [
                self.model_.simulate(X[a:b, 0], channels=dict(zip(names, X[a:b, 1:].T, strict=True)), warn=False)
                for a, b in _parts(groups, len(X))
            ]
        )

    def score(self, X: Any, y: Any, sample_weight: Any = None, groups: Any = None) -> float:
        """Return R2 of the free run, scikit-learn's score of every regressor: 1 - NRMSE**2.

        Parameters
        ----------
        X, y, groups
            As in `fit`.
        sample_weight : (N,) array, optional
        """
        return float(r2_score(y, self.predict(X, groups), sample_weight=sample_weight))

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # of rows in no order of time, as the common checks have them
        return tags

    def _channels(self) -> list[str]:
        """Return the names of the columns after the first, as they may stand in equations."""
        own = [str(name) for name in getattr(self, "feature_names_in_", [f"x{i}" for i in range(self.n_features_in_)])]
        names = [plain_name(name) for name in own[1:]]
        for column, name in zip(own, [plain_name(own[0]), *names], strict=True):
            if name == "t" or (name in names and name in RESERVED):  # else the input may be called as it likes
                why = TAKEN.get(name, "has a name that means something else in equations: rename it")
                raise DataError(f"column {column!r} {why}.")
        if len(set(names)) < len(names):
            raise DataError("Two columns have the same name once it may stand in an equation; rename one.")
        return names


def _seen(given: Any) -> Any:
    """Return an array with what is masked as NaN, which scikit-learn refuses; it does not look at masks."""
    return floats(given) if isinstance(given, np.ma.MaskedArray) else given


def _columns(X: Any) -> Any:
    """Return an input of shape (N,) as one column; all else is left to scikit-learn."""
    shape = np.shape(X) if isinstance(X, (list, tuple)) else getattr(X, "shape", ())
    return np.reshape(X, (-1, 1)) if len(shape) == 1 else X


def _parts(groups: Any, n: int) -> list[tuple[int, int]]:
    """Return where each record begins and ends."""
    if groups is None:
        return [(0, n)]
    labels = column_or_1d(groups)
    check_consistent_length(labels, np.empty(n))
    return list(pairwise((0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), n)))
