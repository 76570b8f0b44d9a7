"""The estimator among scikit-learn's own tools: its common checks, splitters, searches and pipelines."""

import builtins
import importlib
import sys

import numpy as np
import pytest
from sampling import more

import narx_sym as ns
from narx_sym.errors import DataError, ModelError

pytest.importorskip("sklearn", reason="scikit-learn is not installed here (the sklearn extra)")

from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut, TimeSeriesSplit, cross_val_score
from sklearn.utils.estimator_checks import parametrize_with_checks

from narx_sym.sklearn import NARXRegressor

ORDER = "rows are samples in time: what a row gives depends on those before it"
FEW = "the check has fewer than 20 samples, too few to choose a structure from; the error says so"
FAILS = {
    "check_methods_sample_order_invariance": ORDER,
    "check_methods_subset_invariance": ORDER,
    "check_n_features_in_after_fitting": FEW,
    "check_estimators_nan_inf": FEW,
    "check_regressors_no_decision_function": FEW,
    "check_fit2d_1feature": FEW,
    "check_fit1d": "an input without channels may have the shape (N,)",
}


@pytest.mark.filterwarnings("ignore:The free run")  # of rows in no order
@parametrize_with_checks(
    [NARXRegressor(n_u=1, degree=1, method="one_step")], expected_failed_checks=lambda _: FAILS, xfail_strict=True
)
def test_scikit_learn_agrees(estimator, check):
    check(estimator)


def machine(u, y0=0.0, heat=None):
    y, beside = np.full(len(u), y0), np.zeros(len(u)) if heat is None else heat
    for i in range(1, len(u)):
        y[i] = 0.8 * y[i - 1] + 0.4 * u[i - 1] + beside[i - 1]
    return y


def wave(n=400, seed=0):
    return np.cumsum(np.random.default_rng(seed).normal(size=n)) * 0.1


def linear(**options):
    return NARXRegressor(**{"base": "linear", "method": "one_step", "delay": 1} | options)


def test_it_is_identify():
    u = wave()
    y = machine(u)
    made = linear(Ts=0.5).fit(u, y)
    own = ns.identify(ns.Record.from_arrays(u, y, Ts=0.5), base="linear", method="one_step", delay=1)
    assert made.model_.lines(numbers=True) == own.lines(numbers=True) and made.model_.Ts == 0.5
    assert made.n_features_in_ == 1
    assert np.array_equal(made.predict(u), own.simulate(u))
    assert np.array_equal(made.predict(u[:, None]), made.predict(list(u)))


def test_the_score_is_that_of_the_free_run():
    u = wave()
    y = machine(u) + 0.05 * np.random.default_rng(1).normal(size=u.size)
    made = linear().fit(u, y)
    nrmse = ns.metrics.nrmse(y, made.predict(u))
    assert made.score(u, y) == pytest.approx(1 - nrmse**2, abs=1e-12) and nrmse < 0.5


def test_records_stand_apart():
    """Three records that begin elsewhere: as one record the joints would be motion."""
    waves = [wave(150, seed) + 3 * seed for seed in range(3)]
    outputs = [machine(u, 2 * u[0]) for u in waves]
    groups = np.repeat(["a", "b", "a"], 150)  # the same label later is another record
    u, y = np.concatenate(waves), np.concatenate(outputs)
    made = linear().fit(u, y, groups=groups)
    records = [ns.Record.from_arrays(a, b, Ts=1.0) for a, b in zip(waves, outputs, strict=True)]
    own = ns.identify(records, base="linear", method="one_step", delay=1)
    assert made.model_.lines(numbers=True) == own.lines(numbers=True)
    assert np.array_equal(made.predict(u, groups), np.concatenate([made.predict(a) for a in waves]))
    assert made.score(u, y, groups=groups) > 0.999


@more
def test_channels_take_part_under_their_names():
    import pandas as pd

    u, heat = wave(), np.random.default_rng(3).uniform(-1, 1, 400)
    y = machine(u, heat=heat)
    table = pd.DataFrame({"volt": u, "temp [C]": heat})
    made = linear(n_u=1).fit(table, y)
    assert made.model_.channels == ("temp_C",) and made.n_features_in_ == 2
    assert linear(n_u=1).fit(table.to_numpy(), y).model_.channels == ("x1",)
    assert made.score(table, y) > 0.9 > linear().fit(u, y).score(u, y)
    with pytest.raises(DataError, match="same name"):
        linear().fit(pd.DataFrame({"u": u, "a b": heat, "a_b": heat}), y)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (("u", "t"), "column 't' is the time: leave it out or rename it"),
        (("t", "u"), "column 't' is the time"),
        (("temp", "u"), "column 'u' has the name of the input, which is the first column"),
        (("u", "y"), "column 'y' has the name of the output"),
        (("u", "r "), "column 'r ' has a name that means something else"),
        (("u", "phi1"), "column 'phi1' has a name that means something else"),
    ],
)
def test_columns_whose_names_mean_something_else_are_refused(columns, said):
    """A law with a channel r would take it for the reference."""
    import pandas as pd

    u = wave()
    with pytest.raises(DataError, match=said):
        linear().fit(pd.DataFrame(dict(zip(columns, (u, wave(seed=1)), strict=True))), machine(u))


def test_splitters_searches_and_metadata_take_it():
    u = np.concatenate([wave(200, seed) for seed in range(3)])
    y = np.concatenate([machine(wave(200, seed)) for seed in range(3)])
    groups = np.repeat(np.arange(3), 200)
    scores = cross_val_score(linear(), u, y, groups=groups, cv=LeaveOneGroupOut(), params={"groups": groups})
    assert scores.min() > 0.95
    search = GridSearchCV(linear(), {"base": ["linear", "static"]}, cv=TimeSeriesSplit(2)).fit(u[:400, None], y[:400])
    assert search.best_params_ == {"base": "linear"}


def test_what_is_wrong_is_said():
    u = wave()
    with pytest.raises(ModelError, match="Unknown base 'nrax'"):
        NARXRegressor(base="nrax").fit(u, machine(u))
    with pytest.raises(ValueError, match="inconsistent numbers of samples"):
        linear().fit(u, machine(u), groups=np.zeros(7))
    with pytest.raises(ValueError, match="NaN"):
        linear().fit(np.where(np.arange(u.size) == 5, np.nan, u), machine(u))


def test_without_scikit_learn_the_command_is_named(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.partition(".")[0] == "sklearn":
            raise ImportError(name)
        return real(name, *rest)

    kept = sys.modules.pop("narx_sym.sklearn")
    monkeypatch.setattr(builtins, "__import__", without)
    try:
        with pytest.raises(ImportError, match=r"pip install \"narx-sym\[sklearn\]\""):
            importlib.import_module("narx_sym.sklearn")
    finally:
        sys.modules["narx_sym.sklearn"] = kept
