"""The law's own dynamics: eigenvalues, fixed points, regions, excursions of a run."""

import warnings

import numpy as np
import pytest
import sympy as sp
from paper import BENCH, BENCH_INVERSE, VALVE

import narx_sym as ns
from narx_sym import plots
from narx_sym.errors import Diverged, ModelError, NarxError
from narx_sym.fit.laws.internal import dynamics, operating_range
from narx_sym.inversion.stability import direction, heading, mbar, rbar
from narx_sym.models.analysis import z
from narx_sym.models.info import Info


def valve(**options):
    return VALVE.published(Ts=0.01, **options).compensator()


def sine(n=3000, size=0.56, level=3.0):
    return level + size * np.sin(0.002 * np.pi * np.arange(n))


# -- symbols ---------------------------------------------------------------------------------------------------


def test_the_published_valve_law():
    """PAPER_NOTES: (19.76 + s (-9.44 m + 12.61 r)) / 19.32, 1.51 rising and 0.53 falling at m = r = 3."""
    internal = valve().internal
    printed = (sp.Rational("19.76") + direction * (-sp.Rational("9.44") * mbar + sp.Rational("12.61") * rbar)) / (
        sp.Rational("19.32")
    )
    gaps = sp.Poly(internal.eigenvalue - printed, mbar, rbar, direction).coeffs()
    assert max(abs(float(c)) for c in gaps) < 1e-12
    assert internal.integrates and internal.fixed_points.equilibria == "continuum"
    assert internal.radius(3, 3, 1) == pytest.approx(1.51, abs=0.01)
    assert internal.radius(3, 3, -1) == pytest.approx(0.53, abs=0.01)
    assert isinstance(internal.region, sp.Ge) and internal.region.free_symbols == {mbar, rbar, direction}
    for level, goal, s in ((3, 3, 1), (3, 3, -1), (5, 3, 1), (5, 3, -1)):
        inside = bool(internal.region.subs({mbar: level, rbar: goal, direction: s}))
        assert inside == internal.repelling(level, goal, s)
    assert internal.repelling([3, 5], [3, 3]).tolist() == [True, True]  # one direction is enough
    assert str(internal.turns[direction]) == "sign(m[k - 1] - m[k - 2])"


def test_an_inverse_turns_with_its_reference():
    law = BENCH_INVERSE.published().compensator()
    internal = law.internal
    theta = law.symbols
    assert sp.expand(internal.polynomial - (z - theta[0] - theta[4] * heading * rbar)) == 0
    assert not internal.integrates  # theta_1 = 1 is not the whole eigenvalue
    assert internal.radius(0.0, 40.0, -1) == pytest.approx(1 + 40 * 1.07e-5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # 1.0004 while falling, 0.9996 while rising: nothing to warn of
        goal = 40 * np.sin(2e-3 * np.pi * np.arange(4000))
        found = internal.along(law.run(goal, 0.0), goal, 0.0)
    assert found.share == pytest.approx(0.5, abs=0.01) and 1 < found.growth < 1.2 and not found.noteworthy


def test_fixed_points():
    linear = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, 0.25]).compensator().internal
    (point,) = linear.fixed_points.equilibria
    assert sp.expand(point - rbar * 0.4) == 0  # 0.5 r = 1.25 m
    assert linear.eigenvalue == -0.25 and linear.region == sp.false and not linear.turns
    unfitted = BENCH.model().compensator()
    conditions = unfitted.internal.fixed_points.conditions
    theta = unfitted.symbols
    assert [sp.simplify((c.lhs - c.rhs) * theta[1] / (theta[0] - 1)) for c in conditions] == [1]


def test_two_roots_left():
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]", "u[k-3]"], [0.5, 1.0, 0.3, -0.4]).compensator()
    assert law.internal.eigenvalue is None and law.internal.region == sp.false
    roots = np.abs(np.roots([1, 0.3, -0.4]))
    assert law.internal.radius(0.0, 0.0) == pytest.approx(roots.max())
    assert not law.internal.repelling(1.0, 2.0)


@pytest.mark.parametrize(
    "term", ("abs(phi1[k-2])*u[k-2]", "Max(phi1[k-2], 0)*u[k-2]", "tanh(1000*phi1[k-2])*phi1[k-2]*u[k-2]")
)
def test_every_way_to_ask_for_a_direction(term):
    """|phi1| u and a steep tanh are sign(phi1) phi1 u; Max(phi1, 0) u is half of it plus half of phi1 u."""
    plain = (
        ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"], [1, 2, 0.5]).compensator().internal
    )
    other = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", term], [1, 2, 0.5]).compensator().internal
    wanted = plain.eigenvalue.subs(direction, (1 + direction) / 2) if "Max" in term else plain.eigenvalue
    assert sp.expand(other.eigenvalue - wanted) == 0


# -- runs ------------------------------------------------------------------------------------------------------


def test_a_reference_that_enters_the_region_is_flagged():
    law, goal = valve(), sine()
    with pytest.warns(
        UserWarning, match=r"amplifies its own errors at .* % of the samples, first at sample \d+ \(t = 0.*transient"
    ) as said:
        volts = law.run(goal, 3.0)
    assert len(said) == 1
    found = law.internal.along(volts, goal, 3.0)
    assert found.first == np.flatnonzero(found.radius > 1)[0] and found.share == np.mean(found.radius > 1)
    assert f"first at sample {found.first} " in str(said[0].message)
    steps = np.diff(np.concatenate([[3.0, 3.0], volts]))[1:-1]
    at = found.first
    assert found.radius[at] == pytest.approx(law.internal.radius(volts[at - 1], goal[at], np.sign(steps[at - 1])))


def test_a_run_that_forgets_is_not_flagged():
    law, goal = BENCH.published().compensator(), sine(size=40.0, level=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = law.internal.along(law.run(goal, 0.0), goal, 0.0)
    assert found.first is None and found.share == 0 and found.growth == 1 and found.rate < 0.5
    assert "stable along the whole run" in found.sentence()


def test_a_law_that_runs_away_says_where_it_began():
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, 3.0], Ts=0.01).compensator()
    with pytest.raises(Diverged, match=r"first at sample 0 \(t = 0 s\) .*eigenvalue 3.*the law can diverge"):
        law.run(sine(900), 0.1, share=None)


def response(step, m_values, r_values, at, size=1e-7):
    """By how much an error of m at one sample is larger or smaller at each later one: the law run twice."""
    moved = m_values.copy()
    for j in range(at, m_values.size):
        moved[j] = step(moved, r_values, j) + size * (j == at)
    return np.abs(moved - m_values)[at:] / size


def run_of(step, r_values):
    """The law's output, by hand."""
    volts = np.zeros(r_values.size)
    for j in range(3, volts.size):
        volts[j] = step(volts, r_values, j)
    return volts


def test_a_product_of_matrices_is_no_product_of_eigenvalues():
    """m[k] = 1.9 r m[k-1] - 0.95 m[k-2] + ...: eigenvalues of 0.975, and growth without end where r changes sign."""
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "y[k-1]*u[k-2]", "u[k-3]"], [0.5, 1.0, -1.9, 0.95]).compensator()

    def step(m_, r_, j):
        return r_[min(j + 1, r_.size - 1)] - 0.5 * r_[j] + 1.9 * r_[j] * m_[j - 1] - 0.95 * m_[j - 2]

    for every, grows in ((4, True), (16, True), (400, False)):
        goal = 0.9999 * np.where((np.arange(400) // every) % 2, 1.0, -1.0)
        volts = run_of(step, goal)
        found = law.internal.along(volts, goal, 0.0)
        assert found.first is None and found.noteworthy  # a transient, or more
        assert (found.rate > 1) == grows and ("does not shrink" in found.sentence()) == grows
        if not grows:
            peak = max(response(step, volts, goal, at).max() for at in range(3, 380, 20))
            assert found.growth == pytest.approx(peak, rel=0.02)


def test_growth_against_the_law_run_twice():
    """Random laws with three lags of m and a product: the largest response at any sample is what is said."""
    rng = np.random.default_rng(0)
    terms = ["y[k-1]", "u[k-1]", "u[k-2]", "u[k-3]", "u[k-4]", "u[k-2]*y[k-1]"]
    goal = np.sin(0.9 * np.arange(120)) * 0.9
    for a, b, c, d in rng.uniform(-0.5, 0.5, (8, 4)):
        law = ns.NARX.from_terms(terms, [0.5, 1.0, -a, -b, -c, -d]).compensator()

        def step(m_, r_, j, a=a, b=b, c=c, d=d):
            known = r_[min(j + 1, 119)] - 0.5 * r_[j]
            return known + a * m_[j - 1] + b * m_[j - 2] + c * m_[j - 3] + d * r_[j] * m_[j - 1]

        volts = run_of(step, goal)
        peak = max(response(step, volts, goal, at).max() for at in range(3, 120))
        assert law.internal.along(volts, goal, 0.0).growth == pytest.approx(max(peak, 1.0), rel=1e-3)


@pytest.mark.parametrize("weight", (0.0, 1e-3))
def test_a_law_that_integrates_keeps_an_error(weight):
    """m[k] = m[k-1] + (r[k+1] - r[k]) / 0.77: for ever; with a term in |m[k-1] - m[k-2]| m[k-1] it fades."""
    goal = 20 * np.sin(np.arange(2000) / 60)
    terms = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"][: 3 if weight else 2]
    law = ns.NARX.from_terms(terms, [1.0, 0.77, weight][: len(terms)]).compensator()

    def step(m_, r_, j):
        rise = r_[min(j + 1, 1999)] - r_[j]
        return m_[j - 1] + (rise - weight * abs(m_[j - 1] - m_[j - 2]) * m_[j - 1]) / 0.77

    volts = run_of(step, goal)
    found = law.internal.along(volts, goal, 0.0)
    assert found.kept == pytest.approx(response(step, volts, goal, 3)[-1], rel=1e-2)
    assert f"is an integrator: of an error of 1 in m at the start {found.kept:.3g} is left" in found.sentence()


def test_two_signals_of_one_length():
    for m_values, r_values in (([1.0], [1.0]), ([1.0, 2.0], [1.0, 2.0, 3.0])):
        with pytest.raises(ModelError, match="same length"):
            valve().internal.along(m_values, r_values)


# -- the operating range ---------------------------------------------------------------------------------------


def with_ranges(theta, printed=VALVE, line=(0.0, 1.0), band=0.2):
    info = Info(ranges={"u": (2.0, 4.0), "y": (2.0, 4.0)}, line=line, band=band)
    return printed.model(theta, Ts=0.01, info=info)


def test_the_operating_range_is_a_band_around_the_line():
    law = with_ranges(VALVE.theta).compensator()
    found = operating_range(law)
    assert found.shares["rising"] == 1.0 and found.shares["falling"] == 0.0
    assert found.largest == pytest.approx(law.internal.radius(*found.at, 1))
    assert abs(found.at[0] - found.at[1]) <= 0.2 + 1e-9
    assert "A short visit is not a divergence" in found.sentence and "100 % while rising" in found.sentence
    calm = operating_range(with_ranges([1, -1, 2, 0, 0]).compensator())
    assert calm.sentence == "" and calm.shares == {"moving": 0.0}
    assert operating_range(valve()) is None
    inverse = with_ranges(BENCH_INVERSE.theta, BENCH_INVERSE).compensator()
    assert operating_range(inverse).shares == {"rising": 0.0, "falling": 1.0}


def test_a_law_that_repels_everywhere_has_no_elsewhere():
    """A zero at 1.02: nothing shrinks again."""
    info = Info(ranges={"u": (2.0, 4.0), "y": (2.0, 4.0)}, line=(0.0, 1.0), band=0.2)
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, -1.02], Ts=0.01).replace(info=info)
    said = operating_range(model.compensator()).sentence
    assert "repel in all of the operating range" in said and "elsewhere" not in said and "short visit" not in said


def test_the_command_says_it_once(run, tmp_path):
    for theta, expected in ((VALVE.theta, 1), ([1, -1, 2, 0, 0], 0)):
        ns.save(with_ranges(theta), tmp_path / "model.json")
        text, _ = run.good("compensate", tmp_path / "model.json")
        assert text.replace("\n", " ").count("own dynamics repel") == expected


# -- the picture -----------------------------------------------------------------------------------------------


def test_the_picture(tmp_path):
    law = valve()
    figure = plots.plot_internal(law, ranges={"m": (2, 4), "r": (2, 4)}, units={"u": "V", "y": "V"})
    assert [ax.get_xlabel() for ax in figure.axes[:2]] == ["r [V]", "r [V]"] and figure.axes[0].get_ylabel() == "m [V]"
    assert figure.axes[0].get_title() == "while m rises"
    figure.savefig(tmp_path / "law.png")
    with pytest.raises(NarxError, match="range of m"):
        plots.plot_internal(law)


def test_a_disturbance_along_a_run_is_what_the_poles_say():
    """0.8 from sample to sample, once the output that was moved too is made up for; with branches it is the same there."""
    plain = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, -0.8])
    bent = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "abs(u[k-1])", "u[k-2]"], [0.5, 1.5, -0.5, -0.8])
    target = 5 + np.sin(np.arange(40) / 6)
    for law in (plain.compensator(), bent.compensator()):
        found = law.disturbance(target, 12.5, at=3)
        assert np.allclose(found, [1.0, *(0.3 * 0.8 ** np.arange(36))], rtol=0, atol=1e-12)
    law = bent.compensator()
    assert np.array_equal(law.internal.along(target, 12.5, at=3), found)
    with pytest.raises(ns.ModelError, match=r"no eigenvalues: use law\.internal\.along"):
        dynamics(law)
    with pytest.raises(ns.ModelError, match="one of 40 samples"):
        law.disturbance(target, 12.5, at=40)
