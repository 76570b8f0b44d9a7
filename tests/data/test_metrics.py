"""Error measures: values by hand, invariances, messages."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narx_sym.data.metrics import fit_percent, mape, nrmse, nsavi, rmse
from narx_sym.errors import NarxError

Y, Y_HAT = [0.0, 2.0, 4.0, 2.0], [1.0, 2.0, 2.0, 2.0]


def test_values_by_hand():
    assert mape(Y, Y_HAT) == pytest.approx(100 * 3 / (4 * 4))
    assert rmse(Y, Y_HAT) == pytest.approx(np.sqrt(5 / 4))
    assert nrmse(Y, Y_HAT) == pytest.approx(np.sqrt(5 / 4) / np.sqrt(2))
    assert nrmse(Y, np.full(4, 2.0)) == pytest.approx(1) and fit_percent(Y, Y) == 100
    assert fit_percent(Y, Y_HAT) == pytest.approx(100 * (1 - np.sqrt(5 / 8)))


def test_nsavi_is_the_ratio_of_sums():
    m, r = [0.0, 3.0, 3.0], [0.0, 1.0, 3.0]
    assert nsavi(m, r) == pytest.approx(3 / 3)  # the sum of ratios would be 3/1 + 0/2 = 3
    assert nsavi([0, 2, 2, 0], [0, 1, 1, 0]) == pytest.approx(2)  # finite where the reference rests


def test_column_vectors_and_plain_types():
    column = np.array(Y)[:, None]
    assert rmse(column, column + 1) == pytest.approx(1)
    assert type(mape(Y, Y_HAT)) is float and type(nsavi(Y, Y)) is float and type(rmse(Y, Y_HAT)) is float


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30), st.floats(0.1, 10), st.floats(-5, 5))
def test_relative_measures_do_not_depend_on_the_unit(values, gain, offset):
    y = np.array(values)
    y[0] = y.max() + 1.0  # never constant
    y_hat = y[::-1]
    assert nrmse(gain * y + offset, gain * y_hat + offset) == pytest.approx(nrmse(y, y_hat), rel=1e-6, abs=1e-9)
    assert mape(gain * y + offset, gain * y_hat + offset) == pytest.approx(mape(y, y_hat), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("metric", [mape, nsavi, rmse, nrmse, fit_percent])
@pytest.mark.parametrize(
    "a, b, words",
    [
        ([1, 2, 3], [1, 2], "same shape"),
        (np.zeros(3), np.zeros((3, 1)), "same shape"),
        (np.eye(2), np.eye(2), "one signal"),
        ([], [], "is empty"),
        ([1, 2, np.nan], [1, 2, 3], "1 missing or infinite value(s), the first at index 2"),
        ([1, 2, 3], [1, np.inf, 3], "diverge"),
        (["a", "b"], [1, 2], "not an array of real numbers"),
    ],
)
def test_bad_arrays_are_refused(metric, a, b, words):
    with pytest.raises(NarxError) as error:
        metric(a, b)
    assert words in str(error.value)


@pytest.mark.parametrize("metric", [mape, nrmse, fit_percent])
def test_constant_output_is_refused(metric):
    with pytest.raises(NarxError, match="y is constant"):
        metric([2, 2, 2], [1, 2, 3])


def test_constant_reference_is_refused_but_not_a_constant_input():
    with pytest.raises(NarxError, match="r is constant"):
        nsavi([1, 2, 3], [1, 1, 1])
    assert nsavi([1, 1, 1], [1, 2, 3]) == 0
    assert rmse([1, 1], [1, 1]) == 0
