"""Linear algebra of fits as machine code: equal to NumPy's, and the same bits under every kernel of OpenBLAS."""

import numpy as np
import pytest
from scipy.linalg import solve_banded

from narx_sym.engines import algebra

RNG = np.random.default_rng(4)
SIZES = (1, 2, 3, 4, 5, 7, 8, 9, 12, 13, 17, 31, 60)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("order", ["rows", "part of wider rows", "columns"])
def test_products_of_rows_with_themselves(n, order):
    J = RNG.normal(size=(301, n))
    if order == "columns":
        J = np.asfortranarray(J)
    elif order == "part of wider rows":
        wide = np.full((301, n + 4), np.nan)
        wide[:, :n] = J
        J = wide[:, :n]
    out = np.ones((3, n, n))
    algebra.add_grams(J, [(0, slice(0, 301)), (2, slice(5, 140))], out)
    for made, rows in ((out[0], slice(None)), (out[2], slice(5, 140))):
        wanted = 1 + J[rows].T @ J[rows]
        assert np.abs(made - wanted).max() < 1e-12 * np.abs(wanted).max()
        assert np.array_equal(made, made.T)
    assert np.all(out[1] == 1)


@pytest.mark.parametrize("n", SIZES)
def test_a_step_solves_the_damped_equations(n):
    A = RNG.normal(size=(3 * n, n))
    H, g = A.T @ A, RNG.normal(size=n)
    w, wanted = algebra.step(H, g, 0.1), -np.linalg.solve(H + 0.1 * np.eye(n), g)
    assert np.abs(w - wanted).max() < 1e-12 * np.abs(wanted).max() * np.linalg.cond(H + 0.1 * np.eye(n))


def test_no_step_where_the_equations_are_not_positive_definite():
    for H in (np.diag([1.0, -1.0, 1.0]), np.ones((3, 3)), np.full((3, 3), np.nan), np.diag([1.0, np.inf, 1.0])):
        assert algebra.step(H, np.ones(3)) is None
    assert algebra.step(np.ones((3, 3)), np.ones(3), 1e-3) is not None


def test_a_banded_recursion_equals_lapack():
    lags, right = [1, 3, 9], RNG.normal(size=(200, 5))
    slopes = [0.3 * RNG.normal(size=200) for _ in lags]
    band = np.eye(1, 10).T * np.ones(200)
    for i, c in zip(lags, slopes, strict=True):
        band[i, :-i] = -c[i:]
    wanted = solve_banded((9, 0), band, right)
    assert algebra.banded(lags, slopes, right) == pytest.approx(wanted, rel=1e-12, abs=1e-12)


@np.errstate(all="raise")
def test_what_single_precision_cannot_hold_stays_as_it_is():
    x = np.array([1 / 3, -1e39, np.inf, np.nan])
    rough = algebra.single(x)
    assert rough[0] == np.float32(1 / 3)
    np.testing.assert_array_equal(rough[1:], x[1:])


@pytest.mark.parametrize("rows", [[50], [40, 30, 25], [40, 2, 0, 25, 4]])
@pytest.mark.parametrize("starts", [0, 2])
def test_of_segments_with_their_own_starts_the_products_stay(rows, starts, capfd):
    """A segment may have fewer samples that count than unknowns, or none."""
    rng, shared, edges = np.random.default_rng(3), 3, np.cumsum([0, *rows])
    J, r = np.zeros((edges[-1], shared + starts * len(rows))), rng.normal(size=edges[-1])
    J[:, :shared] = rng.normal(size=(edges[-1], shared))
    blocks = []
    for i in range(len(rows)):
        block, own = slice(*edges[i : i + 2]), slice(shared + i * starts, shared + (i + 1) * starts)
        J[block, own] = rng.normal(size=(rows[i], starts))
        blocks.append((block, own))
    both, R = np.column_stack([J, r]), algebra.gathered(J, r, blocks, shared)
    assert R.shape == (J.shape[1] + 1,) * 2
    np.testing.assert_allclose(R.T @ R, both.T @ both, atol=1e-12)
    assert "illegal" not in "".join(capfd.readouterr())  # LAPACK's own words
