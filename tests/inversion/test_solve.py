"""One equation in one unknown: every branch solves it, the conditions choose the right one, nothing is hidden."""

import math

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from sampling import some

import narx_sym as ns
from narx_sym.engines.python import root
from narx_sym.errors import NotInvertible
from narx_sym.inversion.solution import Branch, Root, Solution
from narx_sym.inversion.solve import solve_for
from narx_sym.models.effects import clip
from narx_sym.symbolic.signals import k, m, samples, signal, u, v, y

a, b, c, d, w, h = sp.symbols("a b c d width h", real=True)
p = signal("p")
NUMBERS = {a: 0.7, b: 0.008, c: 0.4, d: 1.6, w: 0.3}
LAST = m[k - 1]


def solve(expr, values=NUMBERS, target=v[k], **options):
    rest = lambda e: e.xreplace(dict.fromkeys(samples(e), sp.S.Zero))  # noqa: E731
    return solve_for(expr, m[k], target, LAST, values, rest=rest, **options)


def evaluate(expr, known):
    """Put numbers in the place of parameters and samples."""
    return float(expr.xreplace({s: sp.Float(x) for s, x in known.items()}))


def value_of(found, known):
    """Follow the steps of a solution, then its branches, by hand."""
    known = dict(known)
    for name, step in found.steps:
        known[signal(name)[k]] = evaluate(step, known)
    for branch in found.branches:
        if (
            branch.condition == sp.true
            or branch.condition.xreplace({s: sp.Float(x) for s, x in known.items()}) == sp.true
        ):
            return evaluate(branch.solution, known)
    raise AssertionError("no branch holds")


# ---------------------------------------------------------------- in closed form


CASES = {
    "dead zone": m[k] - c * clip(m[k], w),
    "saturation": m[k] + c * (clip(m[k], w) - m[k]),
    "play": m[k] + c * (sp.Max(m[k] - w, sp.Min(m[k] + w, p[k - 1])) - m[k]),
    "asymmetric gain": m[k] + c * sp.Abs(m[k]),
    "drag": 2 * m[k] + c * sp.Max(m[k], p[k - 1]) - sp.Abs(m[k] - LAST) / 3,
    "decreasing": p[k - 1] - 2 * m[k] + c * sp.Abs(m[k] - LAST),
    "linear with a changing gain": (1 + c * p[k - 1]) * m[k] + p[k - 2],
    "hysteresis of a polynomial model": a * m[k] + b * sp.Abs(m[k] - LAST) * (m[k] - p[k - 1]) + b * m[k] * p[k - 2],
    "bent dead zone": m[k] - c * clip(m[k], w) + 0.1 * m[k] * sp.Max(m[k], 0),
    "falling hysteresis": p[k - 1] - a * m[k] + b * (m[k] - LAST) * sp.Abs(m[k]),
    "bounded": a * sp.tanh(2 * m[k] + p[k - 1]) + p[k - 2],
    "exponential": p[k - 1] + a * sp.exp(c * m[k]),
}  # fmt: skip


@pytest.mark.parametrize("name", some(CASES, 2))
def test_a_solution_solves(name):
    expr = CASES[name]
    found = solve(expr)
    assert found.closed_form and found.residual() == 0
    assert [n for n in found.notes if "reverses far away" not in n] == []
    assert found.proved != (name == "falling hysteresis")  # 0.7 - 0.008 |m| changes its sign at last
    rng = np.random.default_rng(1)
    for _ in range(40):
        known = NUMBERS | {s: rng.uniform(-1, 1) for s in (m[k - 1], p[k - 1], p[k - 2])}
        wanted = rng.uniform(-2, 2)
        target = evaluate(expr, known | {m[k]: wanted})
        assert value_of(found, known | {v[k]: target}) == pytest.approx(wanted, abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(
    weights=st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=3),
    kinks=st.lists(st.floats(-2, 2), min_size=6, max_size=6),
    where=st.lists(st.booleans(), min_size=3, max_size=3),
    wanted=st.floats(-3, 3),
    size=st.floats(0.2, 3),
)
def test_random_increasing_maps(weights, kinks, where, wanted, size):
    """Kinks in a known order, and kinks whose order depends on samples."""
    held = {signal(f"q{i}")[k - 1]: x for i, x in enumerate(kinks)}
    places = [s if moving else sp.Float(x) for (s, x), moving in zip(held.items(), where, strict=False)]
    expr = size * (m[k] + sum(x * sp.Abs(m[k] - q) for x, q in zip(weights, places, strict=False)))
    found = solve(expr)
    target = evaluate(expr, held | {m[k]: wanted})
    assert value_of(found, held | {v[k]: target, LAST: 0.0}) == pytest.approx(wanted, abs=1e-9)
    if found.how == "branches":
        assert found.residual() == 0 or abs(evaluate(found.residual(), held | {v[k]: target, LAST: 0.0})) < 1e-9


def test_a_quadratic_gain_keeps_its_side():
    found = solve(m[k] + c * m[k] ** 2)
    assert found.how == "quadratic" and found.reach == (-1 / (4 * c), sp.oo) and found.residual() == 0
    for wanted, last in ((0.3, 0.2), (-1.0, -1.2), (-2.0, -2.1), (-3.0, -1.26), (5.0, 4.0)):
        target = wanted + 0.4 * wanted**2
        other = -1 / 0.4 - wanted
        got = value_of(found, NUMBERS | {v[k]: target, LAST: last})
        assert got == pytest.approx(wanted if (wanted + 1.25) * (last + 1.25) >= 0 else other, abs=1e-12)
    small = dict(NUMBERS) | {c: 1e-14}
    assert value_of(found, small | {v[k]: 0.5, LAST: 0.0}) == pytest.approx(0.5, abs=1e-12)
    assert value_of(found, NUMBERS | {v[k]: -5.0, LAST: 0.0}) == pytest.approx(-1.25)  # the vertex is the nearest
    turned = solve(p[k - 1] * m[k] + c * m[k] ** 2)  # where the sign of the linear term is not known
    for linear, wanted in ((1.0, 0.5), (-1.0, 3.0), (-1.0, -0.5), (2.0, -4.0)):
        known = NUMBERS | {v[k]: linear * wanted + 0.4 * wanted**2, LAST: wanted + 0.01, p[k - 1]: linear}
        assert value_of(turned, known) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("linear", [0, d])
def test_a_curve_that_begins_flat_rises_or_falls_with_its_coefficient(sign, linear):
    """A drag c s |s| of the step s has the slope zero at its kink on both sides, whatever its sign."""
    step = m[k] - m[k - 1]
    found = solve(sign * (linear * step + c * step * sp.Abs(step)) + p[k - 1])
    assert "exactly one" in found.proof
    for wanted, last in ((0.8, 0.3), (-0.9, 0.1), (2.0, -1.0), (0.4, 0.4)):
        s = wanted - last
        target = sign * (NUMBERS.get(linear, 0) * s + NUMBERS[c] * s * abs(s)) + 0.2
        known = NUMBERS | {v[k]: target, LAST: last, p[k - 1]: 0.2}
        assert value_of(found, known) == pytest.approx(wanted, abs=1e-7)


# ---------------------------------------------------------------- where there is a choice, or none


def test_a_full_dead_zone_stays_and_a_full_play_jumps():
    full = dict(NUMBERS) | {c: 1.0}
    zone = solve(CASES["dead zone"], full)
    assert not zone.proved and "every m[k] from -width" in zone.proof and "nearest to m[k-1] is taken" in zone.proof
    for last, expected in ((0.1, 0.1), (0.9, 0.3), (-0.9, -0.3)):
        assert value_of(zone, full | {v[k]: 0.0, LAST: last}) == pytest.approx(expected)
        assert value_of(zone, full | {v[k]: 1e-13, LAST: last}) == pytest.approx(expected)  # rounding is no reason
    assert value_of(zone, full | {v[k]: 0.2, LAST: 0.0}) == pytest.approx(0.5)
    slack = solve(CASES["play"], full)
    known = full | {p[k - 1]: 1.0, LAST: 1.3}  # it was rising
    assert value_of(slack, known | {v[k]: 1.1}) == pytest.approx(1.4)
    assert value_of(slack, known | {v[k]: 1.0}) == pytest.approx(1.3)
    assert value_of(slack, known | {v[k]: 0.9}) == pytest.approx(0.6)  # the slack is jumped over


def test_a_saturation_says_what_it_reaches():
    full = dict(NUMBERS) | {c: 1.0}
    hard = solve(CASES["saturation"], full)
    assert hard.reach == (-w, w) and "from -width to width, but every m[k] up to -width gives" in hard.proof
    assert "nothing else is reached" in hard.proof and not hard.proved
    assert [value_of(hard, full | {v[k]: 0.3, LAST: x}) for x in (0.0, 0.3, 0.7)] == pytest.approx([0.3, 0.3, 0.7])
    assert [value_of(hard, full | {v[k]: x, LAST: 0.0}) for x in (-9, -0.1, 9)] == pytest.approx([-0.3, -0.1, 0.3])
    soft = solve(m[k] + c * (w * sp.tanh(m[k] / w) - m[k]), full)
    assert soft.how == "inverse function" and [float(x) for x in soft.reach] == pytest.approx([-0.3, 0.3])
    assert value_of(soft, full | {v[k]: 0.2, LAST: 0.0}) == pytest.approx(0.3 * math.atanh(2 / 3))
    assert math.isfinite(value_of(soft, full | {v[k]: 7.0, LAST: 0.0}))


def test_jumps_are_said():
    gap = solve(m[k] + c * sp.sign(m[k] - LAST))
    assert gap.notes == ("no solution while -c + m[k-1] < v[k] < c + m[k-1]: it stays at the jump",)
    assert value_of(gap, NUMBERS | {v[k]: 1.1, LAST: 1.0}) == 1.0
    assert value_of(gap, NUMBERS | {v[k]: 2.0, LAST: 1.0}) == pytest.approx(1.6)
    both = solve(m[k] - c * sp.sign(m[k] - LAST))
    assert both.notes[0].startswith("two solutions while")
    unknown = solve(m[k] + c * sp.sign(m[k] - LAST) * p[k - 1])
    assert len(unknown.notes) == 2 and unknown.proof.startswith("one m[k] for every v[k] is taken (not proved")
    assert not unknown.proved


def test_what_cannot_be_solved():
    for expr in (sp.sign(m[k] - LAST) * p[k - 1], 0.0 * m[k] + p[k - 1], c * m[k] - c * m[k] + p[k - 1]):
        with pytest.raises(NotInvertible, match=r"only through its sign|does not matter"):
            solve(sp.sympify(expr))
    for expr in (CASES["dead zone"], CASES["linear with a changing gain"], c * m[k] ** 2):
        with pytest.raises(NotInvertible, match="values"):
            solve(expr, {})
    assert solve(a * m[k] + p[k - 1], {}).value == (v[k] - p[k - 1]) / a


def test_a_wrong_branch_has_a_residual():
    good = solve(CASES["dead zone"])
    wrong = tuple(Branch(x.condition, x.solution + 1, x.form) for x in good.branches)
    assert Solution(m[k], v[k], good.expr, LAST, "branches", wrong).residual() != 0


# ---------------------------------------------------------------- without a closed form


def test_the_root_finder():
    found = solve(m[k] + c * m[k] ** 3, limits=(-5, 5))
    assert not found.closed_form and "no closed form" in found.proof
    node = found.value
    assert isinstance(node, Root)
    assert node.free_symbols == (node.args[0].free_symbols - {node.args[1]}) | LAST.free_symbols
    slope = sp.diff(node.xreplace({v[k]: h}), h)  # the implicit function theorem
    at = {h: sp.Float(1.4), c: sp.Float(0.4)}
    assert float(slope.xreplace({node.xreplace({v[k]: h}): sp.S.One}).xreplace(at)) == pytest.approx(1 / 2.2)


@settings(max_examples=100, deadline=None)
@given(st.floats(0.01, 3), st.floats(-1, 3), st.floats(-20, 20), st.floats(-3, 3))
def test_roots_of_increasing_functions(slope, cubic, wanted, last):
    def gap(x):
        return slope * x + max(cubic, 0) * x**3 + math.tanh(x) - target

    target = 0.0
    target = gap(wanted)
    assert root(gap, last, -100.0, 100.0) == pytest.approx(wanted, rel=1e-12, abs=1e-12)


def test_the_nearest_root_or_the_least_gap():
    assert root(lambda x: x**2 - 1, 0.9, -5.0, 5.0) == pytest.approx(1)
    assert root(lambda x: x**2 - 1, -0.9, -5.0, 5.0) == pytest.approx(-1)
    assert abs(root(lambda x: math.tanh(x) - 2, 0.0, -5.0, 5.0)) == 5.0
    assert root(lambda x: math.exp(x) - 1e300, 0.0, -1e9, 1e9) == pytest.approx(math.log(1e300))  # where exp overflows
    assert math.isnan(root(lambda x: math.nan, 0.0, -5.0, 5.0))


@pytest.mark.parametrize(
    "terms, theta, said",
    [
        (["y[k-1]", "tan(u[k-1])"], [0.5, 1.0], "not proved"),  # rises between its poles, and starts again
        (["y[k-1]", "1/u[k-1]", "u[k-1]"], [0.5, -1.0, 1.0], "not proved"),
        (["y[k-1]", "u[k-1]*abs(u[k-1])"], [0.5, 1.0], "exactly one m[k] for every r[k+1] (proved)"),
        (["y[k-1]", "u[k-1]", "y[k-1]*u[k-1]**2"], [0.5, 1.0, 0.2], "none, one or two"),
        (["y[k-1]", "log(u[k-1])"], [0.5, -1.0], "exactly one m[k] for every r[k+1] (proved)"),
        (["y[k-1]", "tanh(y[k-1]*u[k-1])"], [0.5, 1.0], "not proved"),  # at y = 0 no input acts
        # A step inside a step: 0.2 from rest is given by -0.4 and by 0.65.
        (
            ["y[k-1]", "u[k-1]", "sign(0.5+sign(u[k-1]-u[k-2]))", "Max(0,u[k-1]-0.2)", "Max(0,u[k-1]-y[k-1])"],
            [0.5, 1.0, -0.6, 0.2, 0.1],
            "not proved",
        ),
    ],
)
def test_a_proof_says_what_brute_force_finds(terms, theta, said):
    proof = str(ns.NARX.from_terms(terms, theta, Ts=0.1).compensator().checked)
    assert said in proof and "False" not in proof and "oo*" not in proof


def test_numbers_in_the_equation_are_known():
    """y[k] = 0.5 y[k-1] + 2 u[k-1] + |u[k-1]|, with parameters and without."""
    a, b, c = sp.symbols("a b c", real=True)
    plain = ns.Model(0.5 * y[k - 1] + 2 * u[k - 1] + sp.Abs(u[k - 1]), [])
    named = ns.Model(a * y[k - 1] + b * u[k - 1] + c * sp.Abs(u[k - 1]), [a, b, c], [0.5, 2.0, 1.0])
    goal = np.sin(np.arange(40) / 5)
    assert np.allclose(plain.compensator().run(goal, 0.0), named.compensator().run(goal, 0.0), rtol=1e-12)
    with pytest.raises(ns.NarxError, match="needs the parameters' values"):
        named.replace(theta=None).compensator()
