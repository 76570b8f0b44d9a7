"""Candidate pools: what is the same, what a rule keeps out, and that the rest is independent."""

import numpy as np
import pytest
import sympy as sp
from paper import BENCH
from sampling import some
from scipy.linalg import qr

from narx_sym.engines.columns import Columns
from narx_sym.errors import ModelError
from narx_sym.models.assumptions import ASSUMPTION_1, COMPENSATION, CONTINUUM, RULES, Structure
from narx_sym.models.model import NARX
from narx_sym.models.pool import pool
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.identities import independent
from narx_sym.symbolic.signals import breve_phi1, breve_phi2, k, lag, lags, phi1, phi2, samples, signal, u, y


def data(n=500, seed=0):
    """Random sequences that rest now and then, return to 0, and repeat: phi2 takes all of its values."""
    random = np.random.default_rng(seed)
    found = {name: random.standard_normal(n) for name in ("u", "y", "p")}
    for x in found.values():
        x[:: random.integers(7, 12)] = 0
        rest = np.flatnonzero(random.random(n) < 0.2)
        x[rest[1:]] = x[rest[1:] - 1]
    found["y"][3::17] = -found["u"][3::17]
    return found


def rank(terms):
    values = Columns(terms)(data())
    R = qr(values / np.linalg.norm(values, axis=0), mode="r", pivoting=True)[0]
    return int(np.sum(np.abs(np.diag(R)) > 1e-9))


# ---------------------------------------------------------------- identities

F1, F2, F3 = phi1[k - 1], phi2[k - 1], phi2[k - 2]


@pytest.mark.parametrize(
    "before, term, reason",
    (
        ([F2], F2**3, "= phi2[k-1]"),
        ([F2**2], F2**4, "= phi2[k-1]**2"),
        ([F1], F2**2 * F1, "= phi1[k-1]"),
        ([F1], F2**4 * F1, "= phi1[k-1]"),
        ([F2 * F1], F2**3 * F1, "= phi1[k-1]*phi2[k-1]"),
        ([F2 * F1], sp.Abs(F1), "= phi1[k-1]*phi2[k-1]"),
        ([F1**2], sp.Abs(F1) * F2 * F1, "= phi1[k-1]**2"),
        ([u[k], u[k - 1]], phi1[k], "= u[k] - u[k-1]"),
        ([F1, u[k - 1]], u[k - 2], "= -phi1[k-1] + u[k-1]"),
        ([y[k - 1] * F1], y[k - 1] * F1 * F2**2, "= phi1[k-1]*y[k-1]"),
        ([F2 * u[k - 1], F2 * F1], F2 * u[k - 2], "= -phi1[k-1]*phi2[k-1] + phi2[k-1]*u[k-1]"),
        ([F2**2 * phi1[k - 2]], F2**2 * F3**2 * phi1[k - 2], "= phi1[k-2]*phi2[k-1]**2"),
        ([F3**2 * F1], F2**2 * F3**2 * F1, "= phi1[k-1]*phi2[k-2]**2"),
        ([F3 * F2**2], F3**3 * F2**2, "= phi2[k-1]**2*phi2[k-2]"),
        ([sp.Abs(u[k - 1])], sp.sign(u[k - 1]) * u[k - 1], "= abs(u[k-1])"),
        ([u[k - 1]], sp.sign(u[k - 1]) ** 2 * u[k - 1], "= u[k-1]"),
        ([breve_phi1[k]], breve_phi2[k] ** 2 * breve_phi1[k], "= breve_phi1[k]"),
        ([y[k], y[k - 1]], breve_phi1[k], "= y[k] - y[k-1]"),
    ),
)
def test_what_is_the_same_is_dropped_with_the_reason(before, term, reason):
    kept, dropped = independent([*before, term])
    assert kept == before and list(dropped) == [term] and dropped[term].startswith("= ")
    identity = parse(dropped[term].removeprefix("= "))
    assert identity == parse(reason.removeprefix("= "))
    found = Columns([term, identity])(data())
    np.testing.assert_allclose(found[:, 0], found[:, 1], rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "terms",
    (
        [sp.S.One, F2**2],  # sign(0)^2 = 0: not 1 while the input rests
        [F2, F2**2], [F1, F2 * F1], [u[k - 1], F2**2 * u[k - 1]], [F1, F3**2 * F1], [sp.Abs(y[k - 1]), y[k - 1]],
        [F2 * F3, F2, F3], [sp.sign(u[k - 1] + y[k - 1]) ** 2 * u[k - 1], u[k - 1]], [sp.sign(sp.sin(u[k])), u[k]],
        [sp.sin(F1), F1], [sp.tanh(u[k - 1]), sp.tanh(u[k - 2])],
    ),
)  # fmt: skip
def test_what_differs_is_kept(terms):
    assert independent(terms) == (terms, {})
    assert rank(terms) == len(terms)


SIZES = ((1, 2, 3, 1), (1, 2, 3, 0), (2, 3, 2, 1), (1, 5, 2, 3), (0, 2, 3, 1), (2, 1, 3, 1), (1, 3, 2, 0), (1, 1, 5, 1))


@pytest.mark.parametrize("size", some(SIZES, 8))
@pytest.mark.parametrize("rules", ((), CONTINUUM, (*CONTINUUM, *COMPENSATION)))
def test_a_pool_is_independent_and_its_reasons_hold(size, rules):
    found = pool(*size, rules=rules)
    assert rank(found.terms) == len(found) == len(set(found)) > 0
    # A duplicate may be that of an excluded term; the identity that is its reason holds in any case.
    dropped = list(found.duplicates)
    reasons = [parse(found.duplicates[t].removeprefix("= ")) for t in dropped]
    values = Columns([*dropped, *reasons, sp.S.One])(data())
    np.testing.assert_allclose(values[:, : len(dropped)], values[:, len(dropped) : -1], rtol=0, atol=1e-12)
    listed = {*found, *(v.term for v in found.excluded)}
    assert {part.as_coeff_Mul()[1] for reason in reasons for part in sp.Add.make_args(reason)} <= listed
    if not rules:
        assert rank([*found.terms, *dropped]) == len(found)


@pytest.mark.parametrize("functions", some([("abs",), ("sin",), ("tanh",), ("sign",), ("abs", "sin", "tanh")]))
def test_functions_enter_as_factors(functions):
    found = pool(1, 2, 2, functions=functions, constant=True)
    assert rank(found.terms) == len(found) == rank([*found.terms, *found.duplicates])
    for name in functions:
        function = {"abs": sp.Abs, "sin": sp.sin, "tanh": sp.tanh, "sign": sp.sign}[name]
        inside = [f.args[0] for t in (*found, *found.duplicates) for f in t.atoms(function)]
        assert y[k - 1] in inside and phi1[k - 1] in inside
        assert not any(x.has(phi2) for x in inside)
    assert sp.S.One in found.terms
    with pytest.raises(ModelError, match="abs, sin"):
        pool(functions=("gamma",))


# ---------------------------------------------------------------- shape of a pool


def test_own_lags_per_signal():
    found = pool(degree=1, lags={"y": [1, 4], "u": 3, "phi1": range(2, 3), "phi2": [], "p": [0, 2]}, delay=1)
    listed = {*found, *found.duplicates}
    p = signal("p")
    assert listed == {y[k - 1], y[k - 4], phi1[k - 2], p[k], p[k - 2], *(u[k - i] for i in lags(sum(listed), u))}
    assert {1, 2, 3} <= set(lags(sum(listed), u))
    assert pool(degree=1, lags={"y": 2}).terms[:2] == [y[k - 1], y[k - 2]]


def test_delay_is_the_smallest_lag_of_the_input_side():
    for delay in (0, 1, 3):
        found = pool(1, 4, 2, delay)
        used = {lag(s) for t in (*found, *found.duplicates) for s in samples(t) if s.base != y}
        assert min(used) == delay and max(used) == 4
    no_phi = pool(1, 2, 2, phi=False)
    assert not any(t.has(phi1, phi2) for t in no_phi) and len(no_phi) == 3 + 6
    assert max(sum(f.as_base_exp()[1] for f in sp.Mul.make_args(t)) for t in pool(degree=4)) == 4


def test_an_inverse_pool_exchanges_the_signals():
    rules = (*CONTINUUM, "A1(i)")
    there, back = pool(1, 3, 3, rules=rules), pool(1, 3, 3, rules=rules, inverse=True)
    exchange = {y: u, u: y, phi1: breve_phi1, phi2: breve_phi2}
    swapped = [t.xreplace({s: exchange[s.base][s.indices[0]] for s in samples(t)}) for t in there]
    assert set(swapped) == set(back) and back.structure == Structure(u, y, 1)
    assert rank(back.terms) == len(back)


@pytest.mark.parametrize("size", ((1, 0, 3, 1), (-1, 2, 3, 1), (1, 2, 0, 1), (1, 2, 3, -1)))
def test_impossible_sizes(size):
    with pytest.raises(ModelError, match="A pool needs"):
        pool(*size)


def test_the_papers_terms_survive_the_papers_rules():
    found = pool(1, 2, 3, rules=(*CONTINUUM, *COMPENSATION))
    assert {parse(t) for t in BENCH.terms} <= set(found)
    assert (
        str(found)
        == f"Pool({len(found)} terms; {len({v.term for v in found.excluded})} excluded by rule, {len(found.duplicates)} duplicates)"
    )


# ---------------------------------------------------------------- rules

# Term, and the rules that it breaks for delay 1.
TABLE = {
    "y[k-1]": "", "y[k-2]": "", "1": "rest",
    "y[k-1]**2": "1(i) rest", "y[k-1]*y[k-2]": "1(i) rest", "y[k-1]**2*phi1[k-2]": "1(i)", "y[k-1]**2*phi2[k-2]": "1(i)",
    "y[k-1]*phi1[k-2]": "", "y[k-1]*phi2[k-2]": "", "y[k-1]**2*u[k-2]*phi1[k-2]": "",
    "phi2[k-2]": "", "phi2[k-2]**2": "1(ii)", "phi2[k-2]**2*u[k-2]": "1(ii)", "phi2[k-2]*phi2[k-3]": "",
    "y[k-1]*u[k-2]": "1(iii) rest", "y[k-1]*u[k-2]**2": "1(iii) rest", "y[k-1]*u[k-2]*phi1[k-2]": "", "y[k-1]*u[k-2]*phi2[k-2]": "",
    "u[k-2]": "rest linear", "u[k-3]": "rest linear", "u[k-2]**2": "rest", "u[k-1]": "rest linear", "phi1[k-1]": "", "phi1[k-2]": "linear",
    "u[k-1]**2": "rest A1(i)", "u[k-1]*y[k-1]": "1(iii) rest A1(i)", "phi2[k-1]": "A1(i)", "phi1[k-1]*u[k-2]": "A1(i)",
    "phi1[k-1]**2": "A1(i)", "phi2[k-1]*phi1[k-1]": "A1(i)", "phi2[k-1]*y[k-1]": "A1(i)", "phi1[k-2]*u[k-2]*y[k-1]": "",
    "phi2[k-2]*phi1[k-2]*y[k-1]": "", "phi1[k-2]*u[k-2]**2": "", "phi1[k-2]**3": "", "sin(u[k-1])": "rest A1(i)", "abs(phi1[k-1])": "A1(i)",
    "sin(phi1[k-2])": "", "tanh(u[k-2])": "rest", "exp(phi1[k-2])": "rest", "cos(y[k-1])*phi1[k-2]": "",
}  # fmt: skip


@pytest.mark.parametrize("term", TABLE)
def test_each_rule_excludes_what_it_says(term):
    parsed, structure = parse(term), Structure(y, u, 1)
    broken = {name: rule.violates(parsed, structure) for name, rule in RULES.items() if name != "rate"}
    assert {name for name, reason in broken.items() if reason} == set(TABLE[term].split())


# Of first degree in phi1; the rest of the terms is not.
RATE = {"y[k-1]", "y[k-2]", "phi1[k-1]", "phi1[k-2]*u[k-2]*y[k-1]", "phi2[k-2]*phi1[k-2]*y[k-1]", "abs(phi1[k-1])"}


@pytest.mark.parametrize(
    "term", (*sorted(RATE), "phi1[k-1]**2", "phi1[k-1]*phi1[k-2]", "phi2[k-2]", "y[k-1]**2", "u[k-1]")
)
def test_the_rate_rule_keeps_what_is_of_first_degree_in_phi1(term):
    assert (RULES["rate"].violates(parse(term), Structure(y, u, 1)) == "") == (term in RATE)


def test_rules_of_an_inverse_look_at_the_breve_signals():
    structure = Structure(u, y, 1)
    for term, broken in (("breve_phi1[k-1]*u[k-1]", {"A1(i)"}), ("u[k-1]**2*breve_phi2[k-2]", {"1(i)"}), ("breve_phi2[k-3]**2", {"1(ii)"}),
                         ("y[k-2]*u[k-1]", {"1(iii)", "rest"})):  # fmt: skip
        assert {n for n, rule in RULES.items() if n != "rate" and rule.violates(parse(term), structure)} == broken


def test_check_names_each_term_that_breaks_an_assumption():
    terms = ["y[k-1]", "y[k-1]**2", "phi2[k-2]**2", "y[k-1]*u[k-2]", "phi1[k-1]*u[k-2]", "phi1[k-2]*y[k-1]"]
    found = NARX.from_terms(terms).check()
    named = {(str(v).split(" violates ")[0], v.rule) for v in found}
    assert named == {
        ("y[k-1]**2", "1(i)"), ("y[k-1]**2", "rest"), ("phi2[k-2]**2", "1(ii)"), ("u[k-2]*y[k-1]", "1(iii)"), ("u[k-2]*y[k-1]", "rest"),
        ("phi1[k-1]*u[k-2]", "A1(i)"),
    }  # fmt: skip
    assert {v.rule for v in NARX.from_terms(terms).check(ASSUMPTION_1)} == set(ASSUMPTION_1)
    assert [(v.rule, v.term) for v in NARX.from_terms(["y[k-1]"]).check()] == [("A2(i)", None)]
    assert [v.rule for v in NARX.from_terms(["y[k-1]", "u[k-1]"]).check(None)] == ["rest", "A1(ii)"]
    known = NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])  # another sum than 1: it rests in one place anyway
    assert [v.rule for v in known.check()] == ["A1(ii)"]
    assert "n_u = 1 is not larger than tau_d = 1" in str(NARX.from_terms(["y[k-1]", "u[k-1]"]).check()[-1])
    paper = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi1[k-2]*u[k-2]**2"]
    assert NARX.from_terms(paper).check() == []


@pytest.mark.parametrize(
    "rules, left",
    (
        ((), 79),  # of 119 products: 40 are the same as others
        ((*ASSUMPTION_1, "A1(i)"), 23),
        ((*ASSUMPTION_1, "A1(i)", "rest", "linear"), 19),
    ),
)
def test_how_many_terms_the_papers_assumptions_leave(rules, left):
    found = pool(n_y=1, n_u=2, degree=3, rules=rules)
    banned = {v.term for v in found.excluded}
    assert len(found) == left and len(found) + len(banned) + len(found.duplicates) == 119
