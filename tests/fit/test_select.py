"""The order of the error reduction ratio, criteria, and the structure of the paper."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import BENCH
from truth import classical, random_problem, triangle

from narx_sym import plants
from narx_sym.data.record import Record
from narx_sym.engines.columns import Columns
from narx_sym.errors import FitError
from narx_sym.fit.bases.select import err_path, path_of, select
from narx_sym.fit.evaluate import evaluate
from narx_sym.models.assumptions import COMPENSATION, CONTINUUM
from narx_sym.models.model import NARX
from narx_sym.models.pool import pool
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.signals import k, phi1, phi2, u, y


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_the_path_equals_the_classical_one(seed):
    Psi, target = random_problem(seed)
    order, shares, gap = classical(Psi, target, 8)
    path = err_path(triangle(Psi, target), len(target), 8)
    steps = 8 if gap > 1e-6 else 0  # nearly equal candidates: either order is right
    assert path.order[:steps] == order[:steps]
    np.testing.assert_allclose(path.err[:steps], shares[:steps], rtol=1e-9, atol=1e-15)
    assert path.rss[0] == pytest.approx(target @ target, rel=1e-12)


@pytest.mark.parametrize("seed", (1, 2))
def test_the_residual_of_each_step_is_that_of_least_squares(seed):
    Psi, target = random_problem(seed)
    path = err_path(triangle(Psi, target), len(target), 12)
    assert len(path.order) == 12 == len(set(path.order)) and len(path.rss) == 13
    scaled = Psi / np.linalg.norm(Psi, axis=0)
    for n in range(1, 13):
        residual = target - scaled[:, path.order[:n]] @ np.linalg.lstsq(scaled[:, path.order[:n]], target)[0]
        assert path.rss[n] == pytest.approx(residual @ residual, rel=1e-9)
    np.testing.assert_allclose(path.err, -np.diff(path.rss) / path.rss[0], rtol=1e-6, atol=1e-14)
    rows = len(target)
    sizes = np.arange(13)
    np.testing.assert_allclose(path.aic, rows * np.log(path.rss / rows) + 2 * sizes, rtol=1e-13)
    np.testing.assert_allclose(path.bic, rows * np.log(path.rss / rows) + np.log(rows) * sizes, rtol=1e-13)


def test_forced_terms_come_first():
    Psi, target = random_problem(3)
    free = err_path(triangle(Psi, target), 300, 4).order
    last = [j for j in range(12) if j not in free][:2]
    path = err_path(triangle(Psi, target), 300, 5, forced=last)
    assert path.order[:2] == last
    scaled = Psi[:, last] / np.linalg.norm(Psi[:, last], axis=0)
    residual = target - scaled @ np.linalg.lstsq(scaled, target)[0]
    assert path.rss[2] == pytest.approx(residual @ residual, rel=1e-9)


def test_a_target_of_zeros_is_refused():
    with pytest.raises(FitError, match="target is zero"):
        err_path(triangle(np.eye(5)[:, :3], np.zeros(5)), 5, 2)


# ---------------------------------------------------------------- ties and collinearity


def roundings(Psi, target):
    """The same problem with other roundings: rows permuted, stacked from blocks, columns scaled."""
    yield triangle(Psi, target)
    for seed in range(4):
        random = np.random.default_rng(seed)
        rows = random.permutation(len(target))
        yield triangle(Psi[rows], target[rows])
        half = np.vstack([triangle(Psi[a], target[a]) for a in np.array_split(rows, 3)])
        yield np.linalg.qr(half, mode="r")
        yield triangle(Psi * random.uniform(0.1, 9, Psi.shape[1]), target)


def test_equal_candidates_go_to_the_lowest_index():
    Psi, target = random_problem(5, width=6)
    order = err_path(triangle(Psi, target), 300, 6).order
    doubled = np.column_stack([Psi, Psi[:, ::-1], -2.5 * Psi])
    for R in roundings(doubled, target):
        assert err_path(R, 300, 18).order == order


@pytest.mark.parametrize(
    "terms",
    (
        (phi1[k - 1], u[k - 1], u[k - 2]),
        (u[k - 2], phi1[k - 1], u[k - 1], y[k - 1]),
        (
            phi2[k - 2] ** 2 * phi1[k - 2],
            phi1[k - 2],
            u[k - 2] * phi1[k - 2],
            phi2[k - 2] ** 2 * phi1[k - 2] * u[k - 2],
        ),
        (
            phi1[k - 1] * y[k - 1],
            u[k - 1] * y[k - 1],
            u[k - 2] * y[k - 1],
            sp.Abs(phi1[k - 1]),
            phi2[k - 1] * phi1[k - 1],
            phi2[k - 1],
        ),
    ),
)
def test_exactly_collinear_terms_are_ordered_the_same_whatever_the_rounding(terms):
    i = np.arange(900)
    source = np.sin(0.11 * i) + 0.4 * np.sin(0.037 * i + 1)
    source[300:330] = source[300]
    values = Columns(terms)({"u": source, "y": np.cumsum(np.abs(source)) * 0.01})
    target = np.random.default_rng(0).standard_normal(len(values)) * 0.01 + values @ np.linspace(1, 2, len(terms))
    found = [tuple(err_path(R, len(target), 10).order) for R in roundings(values, target)]
    assert len(set(found)) == 1
    rank = np.linalg.matrix_rank(values / np.linalg.norm(values, axis=0), tol=1e-8)
    assert len(found[0]) == rank < len(terms)


def test_nearly_collinear_terms_are_still_told_apart():
    random = np.random.default_rng(0)
    a, b, c = random.standard_normal((3, 400))
    for small in (1e-4, 1e-6, 1e-8):
        Psi = np.column_stack([a, a + small * b, c])
        target = a + 1.0 * b  # only the difference of the first two columns holds b
        path = err_path(triangle(Psi, target), 400, 3)
        assert len(path.order) == 3 and path.rss[3] < 1e-12 * path.rss[0]
    dead = err_path(triangle(np.column_stack([a, a + 1e-13 * b, np.zeros(400)]), a + c), 400, 3)
    assert dead.order == [0]


# ---------------------------------------------------------------- from records


def recorded(n=600, seed=0, noise=0.02):
    i, random = np.arange(n), np.random.default_rng(seed)
    source = sum(np.sin(w * i + p) for w, p in zip(random.uniform(0.01, 0.08, 5), random.uniform(0, 6, 5), strict=True))
    source *= 3 * np.minimum(1, i / 40)
    truth = NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"], (1, 0.7, 0.1))
    return Record.from_arrays(source, truth.simulate(source, 0.0) + noise * random.standard_normal(n), Ts=0.01)


def test_records_are_selected_on_as_if_stacked():
    records = [recorded(n, seed) for n, seed in ((400, 1), (3_000, 2), (90, 3))]
    candidates = list(pool(1, 2, 2))
    frame = NARX([y[k - 1]])
    path = path_of(frame, candidates, y[k], records, 8)
    parts = [Columns([*candidates, y[k]])({"u": r.u, "y": r.y}) for r in records]
    stacked = np.vstack(parts)
    expected = err_path(triangle(stacked[:, :-1], stacked[:, -1]), len(stacked), 8)
    assert path.order == expected.order and path.rows == len(stacked)
    np.testing.assert_allclose(path.rss, expected.rss, rtol=1e-7)
    merged = Record(
        *(np.concatenate([getattr(r, n) for r in records]) for n in "uy"),
        np.arange(3_490) * 0.01,
        0.01,
        breaks=(400, 3_400),
    )
    assert path_of(frame, candidates, y[k], merged, 8).order == path.order


@pytest.mark.parametrize("criterion", ("free_run", "aic", "bic", "knee"))
def test_each_criterion_chooses_a_model_on_the_path(criterion):
    record = recorded(1_500, noise=0.001)
    found = select(pool(1, 2, 3, rules=(*CONTINUUM, *COMPENSATION)), record, criterion=criterion, max_terms=6)
    assert found.reason and 1 <= found.chosen <= 6 and len(found.model.terms) == found.chosen + 1
    assert found.model.theta[0] == 1 and set(found.model.terms[1:]) == set(found.picks[: found.chosen])
    if criterion in ("aic", "bic"):
        values = getattr(found.path, criterion)
        assert values[found.chosen] == values[1:].min()
    if criterion == "free_run":
        best = min(found.free_run_nrmse)
        assert len(found.free_run_nrmse) == 6 and found.free_run_nrmse[found.chosen - 1] <= 1.1 * best
        assert all(e > 1.1 * best for e in found.free_run_nrmse[: found.chosen - 1])
        assert evaluate(found.model, record).free_run_nrmse == pytest.approx(
            found.free_run_nrmse[found.chosen - 1], rel=1e-9
        )
    assert {parse("phi1[k-1]"), parse("phi2[k-2]*phi1[k-2]*u[k-2]")} <= set(found.picks[:3])


def test_a_second_output_lag_under_a_continuum_keeps_sigma_y():
    record = recorded(800, noise=0.01)
    found = select(pool(2, 2, 1, rules=CONTINUUM), record, n_terms=3)
    assert y[k - 2] in found.model.terms and y[k - 1] in found.model.terms
    coefficient = dict(zip(found.model.terms, found.model.theta, strict=True))
    assert coefficient[y[k - 1]] + coefficient[y[k - 2]] == pytest.approx(1, abs=1e-14)
    assert found.reason == "asked for" and found.chosen == 3


def test_unknown_criterion():
    with pytest.raises(FitError, match="free_run, aic, bic or knee"):
        select(pool(1, 2, 1), recorded(), criterion="magic")


# ---------------------------------------------------------------- the paper


def test_ten_records_together_give_the_papers_regressors():
    n = 5_000
    inputs = np.column_stack([plants.filtered_noise(N=n, seed=s, peak=70 + s) for s in range(10)])
    outputs = plants.bouc_wen(inputs)
    records = [Record.from_arrays(inputs[:, s], outputs[:, s], Ts=1e-3) for s in range(10)]
    candidates = pool(1, 2, 3, delay=1, rules=(*CONTINUUM, *COMPENSATION))
    found = select(candidates, records, continuum=True, n_terms=5)
    six = {parse(t) for t in BENCH.terms}
    assert set(found.model.terms) == six
    assert found.picks[0] == phi1[k - 1]
    assert found.model.theta[0] == 1.0 and found.path.rss[5] < 1e-2 * found.path.rss[0]
