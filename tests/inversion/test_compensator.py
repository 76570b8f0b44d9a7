"""Compensation laws: put back into the model they give the reference."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from paper import BENCH
from sampling import more, some

from narx_sym.engines.compile import compile
from narx_sym.errors import Diverged, ModelError, NotInvertible, Unreachable
from narx_sym.inversion.compensator import compensator
from narx_sym.inversion.grouping import offending, polynomials, q
from narx_sym.models.info import Info
from narx_sym.models.model import NARX, Model
from narx_sym.symbolic.signals import expand_phi, k, lag, m, phi1, phi2, r, samples, shift, u, y


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


def test_the_papers_law_symbol_by_symbol():
    model = BENCH.published()
    t, law = model.symbols, model.compensator()
    assert sp.expand(law.law - BENCH.law) == 0
    assert law.residual() == 0 and law.preview == 1
    assert follow(model, 20 * np.sin(0.01 * np.arange(600)), m0=0.0).max() < 1e-9
    assert not law.expand().rhs.free_symbols & set(t)


@more
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    delay=st.integers(0, 3),
    gain=st.floats(0.5, 2),
    linear=st.lists(st.floats(-0.4, 0.4), min_size=2, max_size=2),
    chosen=st.lists(st.integers(0, 8), min_size=1, max_size=4, unique=True),
    weights=st.lists(st.floats(-1, 1), min_size=4, max_size=4),
    newest=st.sampled_from((u, phi1)),
)
def test_random_invertible_models_round_trip(delay, gain, linear, chosen, weights, newest):
    d = delay + 1
    others = [
        u[k - d], phi2[k - d] * phi1[k - d], phi2[k - d] * y[k - 1], sp.tanh(u[k - d]) * y[k - 2], sp.sin(y[k - 1]), sp.Abs(u[k - d - 1]),
        phi1[k - d - 1] * sp.cos(u[k - d]), sp.Max(u[k - d], y[k - 2]), sp.sign(u[k - d]) * sp.tanh(u[k - d - 1] ** 2),
    ]  # fmt: skip
    terms = [y[k - 1], y[k - 2], newest[k - delay], *(others[i] for i in chosen)]
    # Small gains keep the law's own dynamics contracting; phi1 in it integrates.
    bound = 0.1 * gain / len(chosen) * (0.2 if newest == phi1 else 1)
    theta = [*linear, gain, *(bound * w for w in weights[: len(chosen)])]
    model = NARX(terms, theta)
    law = model.compensator()
    assert law.preview == delay
    error = follow(model, reference(60, 1.0))
    assert error.max() < 1e-9
    followed = shift(
        expand_phi(model.F).xreplace({s: {u: m, y: r}[s.base][s.indices[0]] for s in samples(expand_phi(model.F))}),
        delay,
    )
    assert sp.expand(followed.xreplace({m[k]: law.law}) - r[k + delay]) == 0


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


def test_further_parameters_and_models_that_are_not_linear_in_them():
    a, d = sp.symbols("a d", real=True)
    h = d * u[k - 1] - y[k - 1]
    model = Model(y[k - 1] + a * u[k] + sp.exp(-(d**2)) * phi1[k - 1] * sp.Abs(h), [a, d], [0.7, 1.6])
    assert model.compensator().residual() == 0 and model.compensator().preview == 0
    assert follow(model, reference(size=0.5)).max() < 1e-9


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


def test_example_1_of_the_paper_is_not_invertible():
    terms = ["y[k-1]", "phi1[k-1]*u[k-1]", "phi2[k-1]", "phi1[k-1]"]
    model = NARX.from_terms(terms)
    assert [term for term, _ in offending(model)] == [phi1[k - 1] * u[k - 1], phi2[k - 1]]
    with pytest.raises(NotInvertible):
        model.compensator()


def test_a_product_that_does_not_contain_the_newest_input_is_no_obstacle():
    model = NARX.from_terms(["u[k-1]", "phi2[k-2]*phi1[k-2]*u[k-3]", "exp(u[k-2])*y[k-1]"])
    assert offending(model) == [] and model.compensator().residual() == 0


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


def test_the_grouping_of_the_papers_model():
    model = BENCH.model()
    t, law = model.symbols, model.compensator()
    assert sp.expand(law.A - (1 - t[0] / q)) == 0
    assert sp.expand(law.B - t[1] * (1 / q - q**-2)) == 0
    assert sp.expand(law.f - expand_phi(sum(c * x for c, x in zip(t[2:], model.terms[2:], strict=True)))) == 0
    assert law.A.subs(q, 1) == 1 - model.sigma_y


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
    assert str(law).splitlines()[0] == str(law.stability())


# ---------------------------------------------------------------- limits, starts, what is empty


def test_limits_must_leave_room():
    law = NARX.from_terms(["y[k-1]", "phi1[k-1]"], [1.0, 0.5]).compensator()
    for limits in ((1, 1), (2, 1), (1, float("nan"))):
        with pytest.raises(ModelError, match="lower and a higher"):
            law.limited(limits)
    for rate in (0, -1.0, float("inf"), float("nan")):
        with pytest.raises(ModelError, match="positive"):
            law.limited((0, 1), rate)
    assert law.limited((0, 1), 0.5).depth >= 1


def test_the_start_is_on_the_line_or_where_it_is_asked():
    model = NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])
    model = model.replace(info=Info(line=(1.0, 2.0)))
    law = model.compensator()
    assert law.start(5.0)["m"] == law.rest_input(5.0) == 2.0 and law.start(5.0)["r"] == law.start(5.0)["y"] == 5.0
    assert law.start(5.0, 0.0)["m"] == 0.0 and law.start(5.0, 7)["m"] == 7.0


def test_a_law_in_one_piece_has_no_branches():
    law = NARX.from_terms(["y[k-1]", "phi1[k-1]"], [1.0, 0.5]).compensator()
    assert law.branches == () and law.closed_form and law.staged is None and law.preview == 1


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
