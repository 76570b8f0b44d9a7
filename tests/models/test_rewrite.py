"""Terms given as text: replaced, put in, taken out; what cannot be read is one message."""

import pytest
import sympy as sp

import narx_sym as ns
from narx_sym.errors import ModelError, ParseError
from narx_sym.models.extend import extend, variants
from narx_sym.models.rewrite import rewritten, written_terms

PAPER = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"]


@pytest.fixture
def paper():
    return ns.NARX.from_terms(PAPER, [1.0, 0.5, 0.1], constraints=("continuum",))


@pytest.fixture
def extended():
    """A linear model with a dead zone at its input and an offset-like effect at its output."""
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])
    found = next(v for v in variants(model) if v.effect.id == "dead_zone")
    made = extend(model, found).model.replace(theta=[0.5, 1.0, 0.9, 0.2])
    drift = next(v for v in variants(made) if v.effect.id == "drift")
    return extend(made, drift).model.replace(theta=[0.5, 1.0, 0.9, 0.2, 0.01])


def test_a_term_is_replaced_put_in_and_taken_out(paper):
    assert list(written_terms(rewritten(paper, "theta_2", "phi1[k-3]")).values())[1] == "phi1[k-3]"
    more = rewritten(paper, "", "u[k-1]*phi1[k-1]")
    assert list(written_terms(more)) == ["theta_1", "theta_2", "theta_3", "theta_4"]
    less = rewritten(paper, "theta_2", " ")
    assert list(written_terms(less).values()) == ["y[k-1]", "phi1[k-2]*phi2[k-2]*u[k-2]"]
    assert paper.terms == ns.NARX.from_terms(PAPER).terms  # the model itself is as it was


def test_the_constraint_follows_the_terms(paper):
    assert [str(c) for c in rewritten(paper, "", "y[k-2]").constraints] == ["Eq(theta_1 + theta_4, 1)"]
    with pytest.raises(ModelError, match="forces the parameter"):
        rewritten(paper, "", "u[k-1]*y[k-1]")


def test_a_constraint_of_another_kind_keeps_its_term():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])
    a, _ = model.symbols
    model = model.replace(constraints=(sp.Eq(a, 0.5),))
    with pytest.raises(ModelError, match="theta_1"):
        rewritten(model, "theta_1", "y[k-2]")
    assert rewritten(model, "theta_2", "u[k-2]").constraints == model.constraints


def test_effects_stay_when_a_term_of_the_core_changes(extended):
    assert written_terms(extended) == {"theta_1": "x[k-1]", "theta_2": "v[k-1]"}
    made = rewritten(extended, "theta_2", "v[k-2]")
    assert written_terms(made)["theta_2"] == "v[k-2]"
    assert made.symbols == extended.symbols and list(made.theta) == list(extended.theta)
    assert made.effects == extended.effects and len(made.states) == len(extended.states)
    more = rewritten(extended, "", "x[k-2]*v[k-1]")
    assert str(more.symbols[-1]) == "theta_3" and more.theta[-1] == 0.0
    less = rewritten(more, "theta_3", "")
    assert written_terms(less) == written_terms(extended)


@pytest.mark.parametrize("text", ("u[k-1]**2+", "__import__('os')", "import os", "foo[k-1]", "u", "u[k-1]/0", "1e400"))
def test_bad_text_is_one_message(paper, text):
    with pytest.raises(ParseError):
        rewritten(paper, "theta_2", text)


@pytest.mark.parametrize(
    "name, text, why",
    [
        ("", "y[k]", "past values"), ("", "y[k+1]", "past values"), ("", "u[k+1]", "after k"),
        ("", "phi1[k-1]", "already"), ("nobody", "u[k-1]", "no term"), ("", " ", "Write a term"),
    ],
)  # fmt: skip
def test_what_is_no_term_of_this_model(paper, name, text, why):
    with pytest.raises(ModelError, match=why):
        rewritten(paper, name, text)


def test_the_output_itself_is_no_signal_of_a_core_under_output_effects(extended):
    with pytest.raises(ModelError, match=r"past values of x"):
        rewritten(extended, "theta_1", "y[k-1]")


def test_the_last_term_stays():
    model = ns.NARX.from_terms(["u[k-1]"], [1.0])
    with pytest.raises(ModelError, match="last term"):
        rewritten(model, "theta_1", "")
