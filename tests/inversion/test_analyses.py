"""Every analysis has a row here: what it says of the paper's first example, and of models that it does not suit."""

import pytest

import narx_sym as ns
from narx_sym.inversion.analyses import ANALYSES, Analysis, Finding, Subject, analysis, derived, document, summary

TERMS = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"]
MODEL = ns.NARX.from_terms(TERMS, [1.0, 0.8, 0.02, -0.1])
# Name of the analysis: a line of the terminal, and an equation of the document ("" where it is not told there).
CASES = {
    "equation": ("theta_2 = 0.8", ""),
    "in_units": ("+ 0.8*u[k-1] - 0.8*u[k-2] + 1.0*y[k-1]", ""),
    "sigma_y": ("theta_1 = 1", r"\Sigma_y = \theta_{1} = 1"),
    "steady_state": ("*theta_1", r"\bar{y} = \bar{y} \theta_{1}"),
    "continuum": ("", r"\theta_{1} = 1"),
    "property_1": ("holds", ""),
    "quasi_static": ("loading:", r"\tilde{y}"),
    "assumptions": ("none is violated", ""),
    "law": ("m[k] = ", "m_{k} &= "),
    "grouping": ("", "A(q)"),
    "dynamics": ("attracting where", ""),
    "attracting": ("", "<"),
}


def test_every_analysis_has_a_case():
    assert set(CASES) == set(ANALYSES)


@pytest.mark.parametrize("name", ANALYSES)
def test_what_it_says(name):
    one, (line, equation) = ANALYSES[name], CASES[name]
    found = one.find(Subject(MODEL))
    assert bool(line) == bool(one.heading) and bool(equation) == bool(one.title)
    assert line in "\n".join(found.lines) and equation in "\n".join(found.equations)
    assert not one.heading or (one.heading, found.lines) in summary(MODEL)
    assert not one.title or (one.title, found.equations) in [(d.title, d.latex) for d in derived(Subject(MODEL))]


def test_a_reason_is_told_once_and_where_nothing_is_derived():
    autonomous = ns.NARX.from_terms(["y[k-1]"], [0.5])
    reasons = [one.reason for one in derived(Subject(autonomous)) if one.reason]
    assert len(reasons) == len(set(reasons)) and any("no input term" in r for r in reasons)
    assert "no input term" in dict(summary(autonomous))["Compensation law"][0]
    assert document(autonomous).count("no input term") == 1


def test_one_more_is_told_everywhere():
    """One function is all that a new analysis takes."""
    try:

        @analysis(35, "Number of terms", "Terms")
        def size(subject):
            return Finding([str(len(subject.model.symbols))], [r"n = 4"])

        assert isinstance(ANALYSES["size"], Analysis)
        headings = [heading for heading, _ in summary(MODEL)]
        assert headings.index("Sigma_y") < headings.index("Number of terms") < headings.index("Steady state")
        assert "\\section*{Terms}" in document(MODEL)
    finally:
        del ANALYSES["size"]
