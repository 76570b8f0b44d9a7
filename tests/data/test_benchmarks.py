"""The figure of merit of the official benchmarks: what the window is for, and what does not count."""

import numpy as np
import pytest
from benchmarks import BENCHMARKS, Test, error, table
from exported import valued

import narx_sym as ns

Test.__test__ = False  # no test of pytest


def wave(n=600):
    return np.cumsum(np.random.default_rng(0).normal(size=n)) * 0.2


@pytest.fixture(scope="module")
def slack():
    """A lag behind a slack: what it remembers is not measured."""
    linear = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=0.1)
    return valued(linear, "backlash at input", value=1.0, r=0.7)


def test_the_window_finds_what_is_remembered(slack):
    u = wave()
    whole = ns.Record.from_arrays(u, slack.simulate(u, 0.0, warn=False), Ts=0.1)
    late = whole[200:]  # the slack is somewhere inside
    assert error(slack, Test("", late, 100)) < 1e-12 < error(slack, Test("", late))


def test_the_window_does_not_count_and_the_rest_does():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=0.1)
    u = wave()
    y = model.simulate(u, 0.0)
    wrong = y + np.where(np.arange(u.size) < 49, 5.0, 0.0)  # the last sample of the window is where the run begins
    assert error(model, Test("", ns.Record.from_arrays(u, wrong, Ts=0.1), 50)) < 1e-12
    after = y + np.where(np.arange(u.size) >= 50, 0.3, 0.0)
    assert error(model, Test("", ns.Record.from_arrays(u, after, Ts=0.1), 50)) == pytest.approx(0.3, rel=1e-9)


def test_of_a_steady_state_the_second_period_counts():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=0.1)
    u = np.sin(2 * np.pi * np.arange(400) / 400)
    y = model.simulate(np.tile(u, 3), 0.0)[-400:]
    begun = np.r_[y[:1] + 3.0, y[1:]]  # a wrong start is forgotten by then, but for the sample itself
    assert error(model, Test("", ns.Record.from_arrays(u, y, Ts=0.1), steady=True)) < 1e-12
    assert error(model, Test("", ns.Record.from_arrays(u, begun, Ts=0.1), steady=True)) == pytest.approx(3 / 20)


def test_a_run_that_looks_further_back_than_the_window_starts_from_rest():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-9]"], [0.5, 1.0], Ts=0.1)
    u = np.r_[np.zeros(30), wave(100)]
    y = model.simulate(u, 0.0)
    assert error(model, Test("", ns.Record.from_arrays(u, y, Ts=0.1), 4)) < 1e-12


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_published_figure_has_a_source_and_a_test(name):
    benchmark = BENCHMARKS[name]
    for method, *figures in benchmark.published:
        assert any(c.isdigit() for c in method) and len(figures) == len(benchmark.tests)
    loaded = benchmark.load()
    assert loaded is None or len(loaded[1]) == len(benchmark.tests)
    lines = [line for line in table(benchmark, [], benchmark.tests).splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in lines}) == 1
