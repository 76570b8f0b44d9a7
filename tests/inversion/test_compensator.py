"""Compensation laws: put back into the model they give the reference."""

import numpy as np
import pytest
import sympy as sp
from paper import BENCH
from sampling import more, some

from narx_sym.engines.compile import compile
from narx_sym.errors import Diverged, ModelError, NotInvertible, Unreachable
from narx_sym.inversion.compensator import compensator
from narx_sym.inversion.grouping import polynomials, q
from narx_sym.models.info import Info
from narx_sym.models.model import NARX
from narx_sym.symbolic.signals import k, lag, m, r, samples, u, y


def reference(n=200, size=2.0):
    i = np.arange(n)
    return size * np.sin(0.07 * i) + 0.3 * size * np.sin(0.31 * i + 1)


def follow(model, r_values, m0=0.3):
    """Run the law, feed the model with it, and return |y - r| for the samples that the law commands.

    Before k = 0 the input is m0 and the output r[0]; it stays there for the first tau_d samples, which no law reaches.
    """
    delay, before = model.delay, 12
    commanded = model.compensator().run(r_values, m0)
    source = np.concatenate([np.full(before, m0), commanded])
    start = np.full(before + delay, r_values[0])
    out = compile(model.recursion)({"u": source}, model.theta, {"y": start}, start=before + delay)["y"]
    return np.abs(out[before:] - r_values)[delay:]


def delayed(d):
    """Terms of a model with the pure delay d."""
    return [
        "y[k-1]", "y[k-2]", f"u[k-{d}]", f"phi1[k-{d}]", f"phi2[k-{d + 1}]*phi1[k-{d + 1}]*u[k-{d + 1}]", f"phi1[k-{d + 2}]*y[k-1]",
        f"u[k-{d + 1}]*phi2[k-{d + 2}]", "1", f"sin(u[k-{d + 1}])*y[k-2]",
    ]  # fmt: skip


DELAYED = (0.9, -0.2, 0.5, 0.8, 0.05, -0.03, 0.1, 0.2, 0.05)


@pytest.mark.parametrize("delay", some([2, 0, 1, 3], 2))
def test_a_law_for_each_delay(delay):
    model = NARX.from_terms(delayed(delay), DELAYED)
    law = model.compensator()
    assert model.delay == law.preview == delay
    assert law.residual() == 0
    assert max(lag(s) for s in samples(law.law, m)) == 3 and min(lag(s) for s in samples(law.law, m)) == 1
    error = follow(model, reference())
    assert error.size == 200 - delay and error.max() < 1e-9


@pytest.mark.parametrize("terms, theta", [(BENCH.terms, BENCH.theta), pytest.param(delayed(2), DELAYED, marks=more)])
def test_a_law_in_the_users_units(terms, theta):
    y0, u0 = -96.0, 1.8
    plain, moved = NARX.from_terms(terms, theta), NARX.from_terms(terms, theta, operating_point={y: y0, u: u0})
    target = reference()
    np.testing.assert_allclose(
        moved.compensator().run(target + y0, 0.3 + u0), plain.compensator().run(target, 0.3) + u0, atol=1e-9
    )
    assert follow(moved, target + y0, 0.3 + u0).max() < 1e-9
    rounded = sp.nsimplify(moved.compensator().residual(), rational=True)
    assert sp.expand(rounded.subs(dict(zip(moved.symbols, (2, 3, 5, 7, 11, 13, 17, 19, 23), strict=False)))) == 0


# ---------------------------------------------------------------- no law


@pytest.mark.parametrize(
    "terms, theta, words",
    (
        (
            ["y[k-1]", "u[k-1]", "phi2[k-1]"],
            None,
            r"u\[k-1\] cannot be isolated: phi2\[k-1\] violates Assumption A1\(i\)",
        ),
        (["y[k-1]", "phi1[k-1]*u[k-2]"], None, r"phi1\[k-1\]\*u\[k-2\] violates Assumption A1\(i\)"),
        (["u[k-1]", "u[k-1]*y[k-1]"], None, r"u\[k-1\]\*y\[k-1\] violates"),
        (["u[k-1]", "u[k-1]**2"], None, r"u\[k-1\]\*\*2 violates"),
        (["u[k-2]", "1/u[k-2]"], None, r"1/u\[k-2\] violates"),
        (["u[k-1]", "abs(phi1[k-1])", "sin(u[k-1])"], None, r"abs\(phi1\[k-1\]\), sin\(u\[k-1\]\) violate Assumption"),
        (["u[k-1]", "Max(u[k-1], y[k-1])"], None, r"Max\(.*\) violates"),
        (["y[k-1]", "y[k-2]"], None, "no input term"),
        (["y[k-1]", "1"], None, "no input term"),
        (["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 0, 1], r"coefficient of u\[k-1\] is zero"),
        (["y[k-1]", "phi1[k-1]", "u[k-1]"], [0.5, 2, -2], r"coefficient of u\[k-1\] is zero"),
    ),
)
def test_not_invertible_names_the_term_and_the_assumption(terms, theta, words):
    with pytest.raises(NotInvertible, match=words) as error:
        compensator(NARX.from_terms(terms, theta))
    assert "A1" in str(error.value)


# ---------------------------------------------------------------- A, B, f


def operate(operator, base):
    return sum(
        term.as_coeff_exponent(q)[0] * base[k + term.as_coeff_exponent(q)[1]]
        for term in sp.Add.make_args(sp.expand(operator))
    )


@pytest.mark.parametrize(
    "terms",
    (
        BENCH.terms,
        delayed(0),
        delayed(2),
        ["y[k-1]", "y[k-3]", "phi1[k-1]", "u[k-2]*u[k-3]"],
        ["u[k-1]", "1", "tanh(u[k-2])", "u[k-2]**2"],
    ),
)
@pytest.mark.parametrize("point", ({}, {y: 2, u: -3}))
def test_the_grouping_is_the_equation(terms, point):
    model = NARX.from_terms(terms, operating_point=point)
    A, B, f = polynomials(model)
    assert (
        sp.simplify(sp.nsimplify(sp.expand(operate(A, y) - operate(B, u) - f - (y[k] - model.right)), rational=True))
        == 0
    )
    # f holds no linear regressor
    linear = [
        t for t in sp.Add.make_args(sp.expand(f)) if sp.Mul(*(x for x in t.args if x.has(sp.Indexed))) in samples(t)
    ]
    assert linear == [] or point


# ---------------------------------------------------------------- the identified inverse


@pytest.mark.parametrize("lead", (1, 2, 3))
def test_an_identified_inverse_is_its_own_law(lead):
    terms = ["u[k-1]", "breve_phi1[k-1]", "breve_phi2[k-2]*breve_phi1[k-2]*u[k-1]", "breve_phi1[k-2]*y[k-2]"]
    theta = (1.0, 1.2, -0.01, 0.02)
    model = NARX.from_terms(terms, theta, input="y", output="u", lead=lead)
    t, law = model.symbols, model.compensator()
    i = k - 1 + lead
    new, old = r[i] - r[i - 1], r[i - 1] - r[i - 2]
    expected = t[0] * m[k - 1] + t[1] * new + t[2] * sp.sign(old) * old * m[k - 1] + t[3] * old * r[i - 1]
    assert sp.expand(law.law - expected) == 0
    assert law.preview == lead - 1 and law.residual() == 0 and law.A is None
    target, m0 = reference(80), 0.4
    found = law.run(target, m0)
    at = np.concatenate([np.full(5, target[0]), target, np.full(3, target[-1])])
    past = [m0]
    for j in range(5, 85):
        i = j - 1 + lead
        new, old = at[i] - at[i - 1], at[i - 1] - at[i - 2]
        past.append(theta[0] * past[-1] + theta[1] * new + theta[2] * abs(old) * past[-1] + theta[3] * old * at[i - 1])
    np.testing.assert_allclose(found, past[1:], atol=1e-12)
    assert "m_{k}" in law.latex() and r"\phi" not in law.latex()


# ---------------------------------------------------------------- running a law


def test_the_start_of_a_law():
    model = NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, 0.2])
    law = model.compensator()
    with pytest.warns(UserWarning, match="starts from 0"):
        found = law.run([1.0, 1, 1])
    assert found[0] == pytest.approx(0.5) and found[1] == pytest.approx(0.4)
    law = model.replace(info=Info(line=(1.0, 2.0))).compensator()  # y = 1 + 2 u: at r = 3 the input rests at 1
    assert law.run([3.0, 3.0])[0] == pytest.approx(1.5 - 0.2)
    assert law.run([3.0, 3.0], m0=0)[0] == pytest.approx(1.5)


def test_where_the_input_does_not_act_it_stays():
    """The gain is 0.4 y: at rest at zero nothing moves the output, and nothing is divided by zero."""
    law = NARX.from_terms(["y[k-1]", "u[k-1]*y[k-1]"], [0.5, 0.4]).compensator()
    wanted = np.array([1.0, 1.2, 1.0, 0.0, 0.0, 1.0])
    with pytest.raises(Unreachable, match="at sample 5: r = 1, the model gives at most 0"):
        law.run(wanted, 1.25)
    with pytest.warns(UserWarning, match="misses"):
        found = law.run(wanted, 1.25, clip=True)
    assert found[0] == pytest.approx(1.75) and found[2] == pytest.approx(-1.25) and np.all(found[3:] == found[2])
    source = law.export("c")
    assert "NAN" not in source and "past->m[0]" in source


def test_a_law_that_cannot_run():
    unstable = NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, 3.0])  # m[k] = ... - 3 m[k-1]
    with pytest.raises(Diverged, match="m is not finite"):
        unstable.compensator().run(reference(900), 0.1, share=None)
    with pytest.raises(ModelError, match="no parameter values"):
        BENCH.model().compensator().run([1.0, 2.0])
    for bad in ([1.0], [1.0, np.nan], []):
        with pytest.raises(ModelError, match="at least two samples"):
            BENCH.published().compensator().run(bad)


def test_a_law_prints_its_numbers():
    law = BENCH.published().compensator()
    assert r"\frac{1}{\theta_{2}}" in law.latex() and r"\frac{1}{0.77}" in law.latex(numbers=True)
    assert repr(law).startswith(f"Compensator({str(law.stability()).rstrip('.')}; m[k] = ")
    assert str(law).splitlines()[0] == str(law.stability()) and not law.expand().rhs.free_symbols & set(law.symbols)


# ---------------------------------------------------------------- limits, starts, what is empty


def lines(latex):
    """The equation without its environment."""
    return latex.removeprefix("\\begin{aligned}\n").removesuffix("\n\\end{aligned}")


def test_the_grouping_is_printed_in_powers_of_q():
    law = NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]", "phi1[k-2]*u[k-2]*y[k-1]"]).compensator()
    assert [lines(text) for text in law.latex_grouping()] == [
        r"A(q) &= 1 - \theta_{1}\,q^{-1} - \theta_{2}\,q^{-2}",
        r"B(q) &= \theta_{3}\,q^{-1} + \theta_{4}\,q^{-2}",
        r"f(\cdot) &= \theta_{5}\,u_{k-2} y_{k-1} \left(u_{k-2} - u_{k-3}\right)",
    ]
    inverse = NARX.from_terms(["u[k-1]", "breve_phi1[k-1]"], input="y", output="u", lead=2).compensator()
    assert inverse.latex_grouping() == []


def test_the_printed_law_has_references_first_then_inputs_then_what_is_not_linear():
    law = NARX.from_terms(["u[k-2]*y[k-1]", "u[k-1]", "1", "u[k-3]", "y[k-2]", "y[k-1]"]).compensator()
    printed = lines(law.latex()).replace("\\\\\n &\\quad ", "")
    assert printed == (
        r"m_{k} &= \frac{1}{\theta_{2}} \Big[ r_{k+1} - \theta_{6}\,r_{k} - \theta_{5}\,r_{k-1} "
        r"- \theta_{4}\,m_{k-2} - \theta_{3} - \theta_{1}\,r_{k} m_{k-1} \Big]"
    )
