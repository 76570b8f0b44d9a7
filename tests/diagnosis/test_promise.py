"""What is promised to be seen, against brute force."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.diagnosis.screening.promise import TURNS, detectable, doubt, left_out, paid
from narx_sym.diagnosis.table.frame import BLOCKS, FOLDS
from narx_sym.diagnosis.table.hypotheses import Core
from narx_sym.diagnosis.table.search import Search
from narx_sym.diagnosis.table.verdict import ALIKE, alike, price


def test_at_the_promised_size_an_effect_is_just_worth_its_price():
    """Grown by that factor, it lowers the logarithm of the squared error by its cost: fitted by least squares."""
    rng = np.random.default_rng(0)
    D = rng.standard_normal((400, 3))
    D[:, 2] += D[:, 0]
    groups, costs = [slice(0, 1), slice(1, 3)], np.array([0.37, 0.47])
    grow = paid(groups, D.T @ D, 100.0, costs)
    for i, hidden in enumerate(groups):
        for j, tried in enumerate(groups):
            if not np.isfinite(grow[i, j]):
                continue
            # Each column hides alone, the squares add up; noise lies across all columns.
            before = 100 + grow[i, j] * np.sum(D[:, hidden] ** 2)
            rest = D[:, hidden] - D[:, tried] @ np.linalg.lstsq(D[:, tried], D[:, hidden], rcond=None)[0]
            after = 100 + grow[i, j] * np.sum(rest**2)
            np.testing.assert_allclose(np.log(before / after), costs[j], rtol=1e-9)


def test_an_effect_that_explains_nothing_of_another_is_never_worth_it():
    grow = paid([slice(0, 1), slice(1, 2)], np.eye(2), 1.0, np.full(2, 0.3))
    assert np.all(np.isfinite(grow.diagonal())) and np.isinf(grow[0, 1]) and np.isinf(grow[1, 0])


def test_what_a_refit_without_a_fold_leaves_is_what_the_table_judges_rows_by():
    """A small wave on the output of a linear machine: its share of the error of every block that is held out."""
    rng = np.random.default_rng(1)
    u = np.cumsum(rng.standard_normal(600)) * 0.1
    y = np.zeros(600)
    for i in range(1, 600):
        y[i] = 0.9 * y[i - 1] + 0.2 * u[i - 1]
    wave = 1e-3 * np.sin(2 * np.pi * np.arange(600) ** 1.5 / 5000)[:, None]
    record = ns.Record.from_arrays(u, y + wave[:, 0], 0.1)
    base = ns.identify(record, base="linear", n_y=1, n_u=1, delay=1)
    search = Search(base, [record], sizes=[(1, 1)])
    (row,) = search.cored([Core(1, 1, 1)])
    problem = row.frame.problem
    own = np.array(problem.run(row.values)[1])
    free, depth = problem.free, problem.depth
    folds = np.arange(600 - depth) * BLOCKS // (600 - depth) % FOLDS
    left = left_out(own[:, :free], own[:, free:], wave[depth:], folds)
    edges = np.linspace(0, len(left), BLOCKS + 1).astype(int)
    expected = [np.mean(left[b:e] ** 2) / record.y.var() for b, e in itertools.pairwise(edges)]
    np.testing.assert_allclose(row.judged().blocks, expected, rtol=0.05, atol=1e-9)
    scaled = left_out(own[:, :free] * 1e9, own[:, free:] * 1e-9, wave[depth:], folds)  # in any units
    np.testing.assert_allclose(scaled, left, rtol=1e-6, atol=1e-12)


def row(ids: tuple[str, ...], blocks: np.ndarray, parameters: int) -> SimpleNamespace:
    """Return what the verdict reads of a row."""
    held, count = float(blocks.mean()), len(ids)
    return SimpleNamespace(
        ids=ids, blocks=blocks, held=held, parameters=parameters, count=count, charged=count, becomes=frozenset(),
        price=price(held, parameters, count),
    )  # fmt: skip


@pytest.mark.parametrize("blocks", [12, 3])
def test_what_is_promised_is_no_longer_alike(blocks):
    """An effect in some of the blocks: at the size promised the verdict tells it from nothing, and not below it."""
    noise, direction = np.ones(1_200_000), np.zeros((1_200_000, 1))
    direction[: blocks * 100_000] = 1.0
    costs, group = np.array([price(1.0, 1, 1)]), [slice(0, 1)]
    margin, energy = np.array([ALIKE]), np.where(np.arange(12) < blocks, 1e5, 0.0)[None]
    for _ in range(TURNS):
        grown = paid(group, direction.T @ direction, 1.2e6, costs + margin)[:, 0]
        margin = doubt(energy, np.full(12, 1e5), noise.size, costs, grown)

    def seen(size: float) -> bool:
        empty = row((), np.where(np.arange(12) < blocks, 1.0 + size, 1.0), 3)
        best = row(("drift",), np.ones(12), 4)
        return empty not in alike([empty, best], best)

    assert seen(1.1 * grown[0]) and not seen(0.9 * grown[0])


@np.errstate(all="raise")
def test_of_what_moves_nothing_nothing_is_promised():
    """A dead zone under two levels adds nothing that a test could pass, or fail."""
    rng = np.random.default_rng(2)
    matrix = np.column_stack([rng.standard_normal(120), np.zeros(120)])
    named = [SimpleNamespace(id=name, where="input", shape=()) for name in ("drift", "dead_zone")]
    columns = [slice(0, 1), slice(1, 2)]
    scored = SimpleNamespace(
        directions=[SimpleNamespace(columns=c, variant=v) for c, v in zip(columns, named, strict=True)],
        line=SimpleNamespace(residual=rng.standard_normal(120), own=np.ones((120, 1)), problem=SimpleNamespace(free=1)),
        matrix=matrix, scores=SimpleNamespace(passes=np.array([[1.0, np.inf], [np.inf, np.inf]])),
    )  # fmt: skip
    assert set(detectable(scored)) == {"drift"}
