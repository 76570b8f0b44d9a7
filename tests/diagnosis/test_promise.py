"""What is promised to be seen, against brute force."""

from types import SimpleNamespace

import numpy as np

from narx_sym.diagnosis.screening.promise import detectable, left_out, paid


def test_at_the_promised_size_an_effect_is_just_worth_its_price():
    """Grown by that factor, it lowers the logarithm of the squared error by its cost: fitted by least squares."""
    rng = np.random.default_rng(0)
    D = rng.standard_normal((400, 3))
    D[:, 2] += D[:, 0]
    groups, costs = [slice(0, 1), slice(1, 3)], [0.37, 0.47]
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
    grow = paid([slice(0, 1), slice(1, 2)], np.eye(2), 1.0, [0.3, 0.3])
    assert np.all(np.isfinite(grow.diagonal())) and np.isinf(grow[0, 1]) and np.isinf(grow[1, 0])


def test_what_the_other_folds_explain_is_left_out_of_each():
    rng = np.random.default_rng(1)
    own, directions, folds = rng.standard_normal((60, 2)), rng.standard_normal((60, 1)), np.arange(60) // 20
    own[20:, 1] = 0  # the start of the record: no other fold determines it
    left = left_out(own, directions, folds)
    for fold in range(3):
        of, seen = folds == fold, [0] if fold == 0 else [0, 1]
        fitted = np.linalg.lstsq(own[~of][:, seen], directions[~of], rcond=None)[0]
        expected = directions[of] - own[of][:, seen] @ fitted
        if fold == 0:
            start = own[of][:, [1]]
            expected = expected - start @ np.linalg.lstsq(start, expected, rcond=None)[0]
        np.testing.assert_allclose(left[of], expected, atol=1e-12)
    np.testing.assert_allclose(left_out(own * [1e9, 1e-9], directions, folds), left, atol=1e-12)  # in any units


@np.errstate(all="raise")
def test_of_what_moves_nothing_nothing_is_promised():
    """A dead zone under two levels adds nothing that a test could pass, or fail."""
    rng = np.random.default_rng(2)
    matrix = np.column_stack([rng.standard_normal(120), np.zeros(120)])
    named = [SimpleNamespace(id=name, where="input", shape=()) for name in ("drift", "dead_zone")]
    columns = [slice(0, 1), slice(1, 2)]
    scored = SimpleNamespace(
        directions=[SimpleNamespace(columns=c, variant=v) for c, v in zip(columns, named, strict=True)],
        line=SimpleNamespace(residual=rng.standard_normal(120), own=np.ones((120, 1))),
        matrix=matrix, scores=SimpleNamespace(passes=np.array([[1.0, np.inf], [np.inf, np.inf]])),
    )  # fmt: skip
    assert set(detectable(scored)) == {"drift"}
