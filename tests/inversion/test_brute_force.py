"""What a solution promises is counted: random maps of a few pieces, in several units, each piece solved by hand."""

import math

import numpy as np
import pytest
import sympy as sp
from sampling import some

import narx_sym as ns
from narx_sym.inversion.piecewise import FALLING, FURTHER
from narx_sym.inversion.solve import solve_for
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.signals import k, m, u, v, y

LAST, x, h = m[k - 1], sp.Symbol("x", real=True), sp.Symbol("h", positive=True)
UNITS = ((1.0, 1.0), (1e-9, 1e-9), (1e9, 1e-9), (1e-6, 1.0), (1e9, 1e9))  # of the unknown, of the map
STOPS = (sp.Abs, lambda e: sp.Max(0, e), lambda e: sp.Max(-1, sp.Min(1, e)))
NODES = (*STOPS, sp.sign, lambda e: sp.sign(e) ** 2, sp.Heaviside)
SIZES, STIFF = (0.1, 0.25, 0.5, 1.0, 1.5, -0.1, -0.25, -0.5, -1.0), (1e10, 0.5)
NUMBERS = [{"sign": np.sign, "Heaviside": lambda e, at: float(e > 0)}, "math"]


def drawn(rng, out):
    """Return a random map of x, the values of its coefficients, and where it may have kinks."""
    expr, values, places = sp.S.Zero, {}, set()
    for i in range(rng.integers(2, 5)):
        c = sp.Symbol(f"c{i}", real=True)
        sizes, nodes = (STIFF, STOPS) if i == 2 else (SIZES, NODES)
        values[c] = out * float(rng.choice(sizes))
        at = float(rng.choice([-1.5, 0.0, 0.5, 2.0]))
        expr += c * (nodes[rng.integers(len(nodes))](x - at) if i else x)
        places |= {at - 1, at, at + 1}
    return expr, values, sorted(places)


def counted(f, places, target, rounding):
    """Return each x that gives a target: the kinks, and what lies on a line between two; inf for a whole line."""
    found = [w for w in places if abs(f(w) - target) <= rounding]
    for a, b in zip([-100.0, *places], [*places, 100.0], strict=True):
        one, other = a + (b - a) / 4, a + (b - a) * 3 / 4
        low, rise = f(one), f(other) - f(one)
        if abs(rise) <= rounding:
            found += [math.inf] if abs(low - target) <= rounding else []
            continue
        ends = [low - (math.inf if a == -100.0 else 0.5) * rise, low + (math.inf if b == 100.0 else 1.5) * rise]
        if min(ends) + rounding < target < max(ends) - rounding:
            found.append(one + (target - low) / rise * (other - one))
    return found


def limits(f, places):
    """Return what a map comes near to on both sides of its kinks; at a jump it need not be reached there."""
    for a, b in zip([-100.0, *places], [*places, 100.0], strict=True):
        one, other = f(a + (b - a) / 4), f(a + (b - a) * 3 / 4)
        yield from (1.5 * one - 0.5 * other, 1.5 * other - 0.5 * one)


def attack(seed):
    """Exactly one solution within what is said to be reached, none beyond; and a law that takes one wherever one is."""
    rng = np.random.default_rng(seed)
    unit, out = UNITS[seed % len(UNITS)]
    expr, values, places = drawn(rng, out)
    found = solve_for(expr.xreplace({x: m[k] / h}), m[k], v[k], LAST, values | {h: unit})
    if not found.closed_form:  # it promises nothing
        return
    numbers = {c: sp.Float(n) for c, n in values.items()}
    known, given = [*values, h], [*values.values(), unit]
    f, law = sp.lambdify([x, *values], expr, NUMBERS), sp.lambdify([v[k], LAST, *known], found.value, NUMBERS)
    reach = [float(e.xreplace(numbers | {h: sp.Float(unit)})) for e in found.reach]
    rounding = 1e-14 * sum(map(abs, values.values())) + 1e-12 * out

    def at(w):
        return float(f(w, *values.values()))

    targets = [at(w) for w in (*places, *rng.uniform(-5, 5, 8))]
    # What only an unused piece reaches, where a used one comes near to it at a jump, is not met.
    taken = [at(w) for w in places] if FALLING in found.notes else [math.nan]
    targets += [e for e in limits(at, places) if not min(abs(e - own) for own in taken) > rounding]
    for target in targets:
        for wanted in (target, target + 0.1 * out * rng.normal()):
            true = counted(at, places, wanted, rounding)
            if found.proved and min(abs(wanted - e) for e in reach) > 10 * rounding:
                assert len(true) == (reach[0] < wanted < reach[1]) and math.inf not in true
            if true and FURTHER not in found.notes:
                got = law(wanted, unit * rng.uniform(-3, 3), *given) / unit
                near = min(abs(got - w) for w in true) <= 1e-5  # at the end of a stop the last digit decides
                assert near or abs(at(got) - wanted) <= 10 * rounding


@pytest.mark.parametrize("seed", some(range(1, 26), 4))
def test_what_is_proved_and_what_is_reached(seed):
    attack(seed)


def model(expr, **values):
    """Return y[k] = y[k-1]/2 and a map of u[k-1] that is written in x."""
    known = {sp.Symbol(name, real=True): value for name, value in values.items()} | {sp.Symbol("a", real=True): 0.5}
    own = sp.sympify(expr, {str(c): c for c in known} | {"x": u[k - 1], "y": y[k - 1]})
    return ns.Model(sp.Symbol("a", real=True) * y[k - 1] + own, list(known), list(known.values()))


def followed(made, inputs):
    """Return by how much a law misses what its model gives under some inputs."""
    output = made.simulate(np.array(inputs), 0.0, u0=0.0, warn=False)
    driven = made.compensator().run(output, m0=0.0, share=None)
    return np.abs(made.simulate(driven, 0.0, u0=0.0, warn=False) - output).max()


@pytest.mark.parametrize("even", ["phi2[k-1]**2", "abs(phi2[k-1])"])
def test_a_sign_that_enters_evenly_is_zero_at_rest(even):
    """phi2**2 is 1 while the input moves, and 0 where it rests: both may give the same output, and rest goes first."""
    made = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", even], [1.0, 1.0, 0.1])
    law = made.compensator()
    assert "proved)" not in law.checked.replace("not proved", "") and "m[k] = m[k-1] gives" in law.checked
    assert law.run(np.zeros(6), m0=0.0).tolist() == [0.0] * 6
    assert followed(made, 0.3 * np.sin(np.arange(40) / 5)) < 1e-12


def test_every_target_of_a_map_that_rises_in_the_end_is_reached():
    assert followed(model("b*x - c*Max(-1, Min(1, x))", b=0.1, c=0.25), [0, 0, 3, 4, 6, 5, 3, -4, -5, 2]) < 1e-9
    assert followed(model("b*x + tanh(x)", b=1e-6), [0, 0, 2e9, 1.5e9, 3e9, 3e9]) < 1e-6  # however far away


@pytest.mark.parametrize("stiff", [0.9e9, 1e10])
def test_a_stiff_stop_leaves_the_other_side(stiff):
    made = model("x + c*Max(0, x - 1)", c=stiff)
    assert made.compensator().checked == "exactly one m[k] for every r[k+1] (proved)"
    assert followed(made, 0.5 * np.sin(np.arange(40) / 6)) < 1e-12


def test_one_curve_on_both_sides_of_a_kink_is_solved():
    made = ns.NARX.from_terms(["y[k-1]", "phi2[k-1]**2", "u[k-1]", "u[k-1]**2"], [0.5, 0.1, 1.0, 0.1])
    assert followed(made, 0.4 * np.sin(np.arange(40) / 5)) < 1e-12
    assert "where True" not in model("b*x + c*Heaviside(x)*x**2", b=1.0, c=1.0).compensator().checked
    assert solve_for(m[k] ** 2 + sp.Max(m[k], 0) + sp.Min(m[k], 0), m[k], v[k], LAST, {h: 1.0}).how != "branches"


def test_what_was_not_searched_is_not_called_out_of_reach():
    law = model("sin(x) + c*x", c=1e-10).compensator()
    with pytest.raises(ns.Unreachable, match=r"^The law does not reach the reference at sample"):
        law.run(np.repeat([0.0, 3.0], 4), m0=0.0, share=None)


def test_rounding_is_no_residual():
    """Numbers beside symbols were divided: 15.3 times 1/15.3 is not 1 to the last digit."""
    base = ns.NARX.from_terms(["u[k]"], [1.3], Ts=0.01)
    stop = [e for e in variants(base, []) if (e.id, e.where) == ("end_stop", "input")][-1]
    added = extend(base, stop)
    values = {"theta_1": 1.3, "c1_end_stop": 1.0, "c2_end_stop": 0.3, "r_end_stop": 0.5, "tau_end_stop": 0.5}
    law = added.model.replace(theta=[values[str(s)] for s in added.model.symbols]).compensator()
    assert "15.3" in str(law.staged.stages[-1].branches) and law.residual() == 0
