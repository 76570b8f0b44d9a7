"""Whether an output stays where it is, at kinks: what is said against long runs of random piecewise maps."""

import numpy as np
import pytest
from exported import valued
from sampling import some

from narx_sym import NARX
from narx_sym.models.analysis import property_1


def grown(step, depth, starts=40, steps=3000):
    """By how much random disturbances of 1e-9 grow, at most, until they are large or gone: (logarithms, starts)."""
    rng = np.random.default_rng(1)
    x = 1e-9 * rng.standard_normal((depth, starts))
    first = np.abs(x).max(axis=0)
    for _ in range(steps):
        x = np.vstack([step(x), x[:-1]])
        if not 1e-60 < np.abs(x).max() < 1e60:
            break
    return np.log10(np.maximum(np.abs(x).max(axis=0), 1e-300) / first)


def test_both_slopes_decide_a_kink_of_one_lag():
    rng = np.random.default_rng(0)
    said = []
    for a, b in rng.uniform(-1.5, 1.5, (20, 2)):
        verdict = property_1(NARX.from_terms(["y[k-1]", "abs(y[k-1])"], [a, b]))
        truth = grown(lambda x, a=a, b=b: a * x[:1] + b * np.abs(x[:1]), 1)
        assert verdict.diverging is bool(truth.max() > 0), (a, b, verdict)
        said.append(verdict.diverging)
    assert 3 < sum(said) < 17


@pytest.mark.parametrize(
    "kink", some(["Max(y[k-1], y[k-2])", "abs(y[k-1])", "Min(y[k-2], 0)", "abs(y[k-1] - y[k-2])"], 2)
)
def test_what_is_said_of_two_lags_is_what_runs_do(kink):
    """Not everything is decided; what is said is true."""
    rng = np.random.default_rng(2)
    code = {"abs(y[k-1])": lambda x: np.abs(x[0]), "Max(y[k-1], y[k-2])": lambda x: np.maximum(x[0], x[1]),
            "abs(y[k-1] - y[k-2])": lambda x: np.abs(x[0] - x[1]), "Min(y[k-2], 0)": lambda x: np.minimum(x[1], 0)}[kink]  # fmt: skip
    said = []
    for a, b, c in rng.uniform(-1.2, 1.2, (12, 3)):
        verdict = property_1(NARX.from_terms(["y[k-1]", "y[k-2]", kink], [a, b, c]))
        truth = grown(lambda x, a=a, b=b, c=c: a * x[0] + b * x[1] + c * code(x), 2)
        if 0.0 in verdict.equilibria and len(verdict.equilibria) == 1:
            said.append(verdict.diverging)
            assert said[-1] is None or said[-1] is bool(truth.max() > 0), (a, b, c, verdict)
    assert True in said and False in said and said.count(None) < len(said) / 2


@pytest.mark.parametrize("weight, steady", ((2.0, False), (-2.0, False), (0.6, True), (0.0, True)))
def test_a_continuum_with_a_kink_along_it(weight, steady):
    """y[k] = y[k-1] + c |y[k-1] - y[k-2]|: a step of 1e-9 grows with c and with -c from one side."""
    verdict = property_1(NARX.from_terms(["y[k-1]", "abs(y[k-1] - y[k-2])", "phi1[k-1]"], [1.0, weight, 0.5]))
    assert verdict.equilibria == "continuum" and verdict.holds is steady and verdict.diverging is not steady


def test_friction_is_not_decided_by_its_linearisation():
    """Coulomb friction jumps where the output rests: a step of 1e-9 ends in a limit cycle."""
    base = NARX.from_terms(["y[k-1]", "y[k-2]", "phi1[k-1]"], [1.5, -0.5, 0.15], Ts=0.01)
    verdict = property_1(valued(base, "coulomb_friction at inside", value=-0.1))
    assert verdict.holds is None and verdict.diverging is None and "not decided" in verdict.reason


def test_no_grid_of_outputs_hides_what_repels():
    terms = ["y[k-1]", "y[k-2]", "cos(8*pi*y[k-1])*y[k-1]", "cos(8*pi*y[k-1])*y[k-2]"]
    verdict = property_1(NARX.from_terms(terms, [0.9, 0.1, -1.5, 1.5]))
    assert "diverging at 53% of the outputs" in verdict.reason and "(255 looked at)" in verdict.reason
