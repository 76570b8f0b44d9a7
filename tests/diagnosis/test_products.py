"""Inner products against the rows that they stand for."""

import numpy as np
import pytest
from scipy.signal import lfilter

from narx_sym.diagnosis.screening.products import CHUNK, Left, bases, filtered, told, whitened


@pytest.fixture
def rows():
    """Own directions, a residual and directions of a record of two segments, one longer than what is held at a time."""
    rng = np.random.default_rng(3)
    n = CHUNK + 700
    own, residual, directions = rng.standard_normal((n, 3)), rng.standard_normal(n), rng.standard_normal((n, 5))
    directions[:, 4] = own @ [1.0, -2.0, 3.0]  # a refit absorbs it
    directions[:, 3] = directions[:, 2] * 2.0
    return own, residual, directions, np.array([0, 650, n]), rng.uniform(size=n) < 0.8


def test_a_banded_product_is_a_filter():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((333, 4))
    for a in (np.ones(1), np.array([1.0, -0.5]), np.r_[1.0, rng.standard_normal(90)]):
        np.testing.assert_allclose(filtered(x, a), lfilter(a, [1.0], x, axis=0)[a.size - 1 :], atol=1e-12)
    assert filtered(x[:3], np.ones(9)).shape == (0, 4)


def test_what_a_refit_leaves(rows):
    own, residual, directions, edges, counts = rows
    a = np.array([1.0, -0.7, 0.2])
    left = Left.of(own, residual, directions, edges, counts, a)
    P, e, D = (
        np.concatenate(list(whitened(np.asarray(x).reshape(len(residual), -1), a, edges, counts)))
        for x in (own, residual, directions)
    )
    Q = np.linalg.qr(P)[0]
    D_left, e_left = D - Q @ (Q.T @ D), (e - Q @ (Q.T @ e))[:, 0]
    np.testing.assert_allclose(left.columns, D_left.T @ D_left, atol=1e-9 * left.energy.max())
    np.testing.assert_allclose(left.residual, D_left.T @ e_left, atol=1e-9 * left.energy.max())
    assert left.power == pytest.approx(e_left @ e_left) and left.rank == 3 and left.count == counts.sum()
    assert list(left.usable) == [True] * 4 + [False]
    beside = left.without(2)
    q = D_left[:, 2] / np.linalg.norm(D_left[:, 2])
    np.testing.assert_allclose(beside.residual, (D_left - np.outer(q, q @ D_left)).T @ e_left, atol=1e-6)
    assert beside.power == pytest.approx(e_left @ e_left - (q @ e_left) ** 2) and not beside.usable[3]


def test_sums_of_columns_are_orthonormal_and_what_repeats_is_left_out(rows):
    own, residual, directions, edges, counts = rows
    left = Left.of(own, residual, directions, edges, counts)
    groups = [slice(0, 2), slice(2, 4), slice(4, 5)]
    basis, owner = bases(left.columns, left.energy, groups)
    assert list(owner) == [0, 0, 1]  # one of the third and fourth, none of what a refit absorbs
    products = basis.T @ left.columns @ basis
    np.testing.assert_allclose(products[:2, :2], np.eye(2), atol=1e-12)
    assert products[2, 2] == pytest.approx(1.0)
    known = told(groups, left.columns, basis, owner)
    assert known[0, 0] == pytest.approx(left.columns[:2, :2].trace())
    assert known[1, 1] == pytest.approx(left.columns[2:4, 2:4].trace())
    share, absorbed = left.shares(groups)
    D, e = directions[counts], residual[counts]
    Q = np.linalg.qr(own[counts])[0]
    D, e = D - Q @ (Q.T @ D), e - Q @ (Q.T @ e)
    best = D[:, :2] @ np.linalg.lstsq(D[:, :2], e, rcond=None)[0]
    assert share[0] == pytest.approx(best @ best / (e @ e)) and absorbed[2] == pytest.approx(1.0)
