"""Text to expressions and back, hostile texts, and LaTeX that LaTeX reads."""

import random
import shutil
import subprocess
import sys

import pytest
import sympy as sp
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from paper import BENCH
from places import ROOT

from narx_sym.errors import ModelError, NotInvertible, ParseError
from narx_sym.models.model import NARX, Model
from narx_sym.models.pool import pool
from narx_sym.symbolic import functions
from narx_sym.symbolic.grammar import MAX_POWER, parse
from narx_sym.symbolic.mathml import mathml
from narx_sym.symbolic.printing import latex, latex_sum, text
from narx_sym.symbolic.signals import breve_phi1, breve_phi2, k, phi1, phi2, signal, u, y

A, B = sp.symbols("a theta_1", real=True)
SIGNALS = (y, u, phi1, phi2, breve_phi1, breve_phi2, signal("p"), signal("long_name"))
NAMES = {"signals": ("p", "long_name"), "symbols": ("a", "theta_1")}

# ---------------------------------------------------------------- what is read


@pytest.mark.parametrize(
    "written, expected",
    (
        ("phi2[k-2]*phi1[k-2]*u[k-2]", phi2[k - 2] * phi1[k - 2] * u[k - 2]),
        (" y [ k - 1 ]\n+\tu[k]", y[k - 1] + u[k]),
        ("u[k+2]", u[k + 2]),
        ("-u[k]**2", -(u[k] ** 2)),
        ("2**-1*u[k]", u[k] / 2),
        ("2**2**3", sp.Integer(256)),
        ("u[k]-u[k-1]-u[k-2]", u[k] - u[k - 1] - u[k - 2]),
        ("u[k]/2/y[k-1]*3", 3 * u[k] / (2 * y[k - 1])),
        ("u[k] - -u[k-1]", u[k] + u[k - 1]),
        ("+u[k]*-1", -u[k]),
        ("-(u[k]+1)*(y[k-1]+1)", -((u[k] + 1) * (y[k - 1] + 1))),
        ("abs(u[k])*Abs(y[k-1])", sp.Abs(u[k]) * sp.Abs(y[k - 1])),
        ("Max(u[k], 0.5, y[k-1])", sp.Max(u[k], sp.Float(0.5), y[k - 1])),
        ("1.5e-3*u[k]", sp.Float(1.5e-3) * u[k]),
        (".5*u[k]", sp.Float(0.5) * u[k]),
        ("1/3", sp.Rational(1, 3)),
        ("sqrt(u[k])", sp.sqrt(u[k])),
    ),
)
def test_reading(written, expected):
    assert parse(written) == expected


def test_signals_and_symbols_are_the_ones_of_the_package():
    found = parse("a*p[k-3] + theta_1", **NAMES)
    assert found == A * signal("p")[k - 3] + B
    assert found.xreplace({k: k + 3}).has(signal("p")[k])


# ---------------------------------------------------------------- round trip

numbers = st.one_of(
    st.integers(-9, 9).map(sp.Integer),
    st.fractions(-9, 9, max_denominator=20).map(lambda f: sp.Rational(f.numerator, f.denominator)),
    st.floats(-1e6, 1e6, allow_nan=False).filter(lambda f: f == 0 or abs(f) > 1e-12).map(sp.Float),
)
leaves = st.one_of(
    st.tuples(st.sampled_from(SIGNALS), st.integers(-3, 12)).map(lambda t: t[0][k - t[1]]),
    st.sampled_from((A, B)),
    numbers,
)


def compared(function, *arguments):
    try:
        return function(*arguments)
    except ValueError:  # not comparable: infinite or complex
        return sp.nan


def grown(inner):
    one = ("sign", "abs", "sin", "cos", "tanh", "atan", "exp")
    return st.one_of(
        st.lists(inner, min_size=2, max_size=3).map(lambda p: sp.Add(*p)),
        st.lists(inner, min_size=2, max_size=3).map(lambda p: sp.Mul(*p)),
        st.tuples(inner, st.sampled_from((-2, -1, 2, 3))).map(lambda t: t[0] ** t[1] if t[0] != 0 else t[0]),
        st.tuples(st.sampled_from(one), inner).map(lambda t: functions.NAMES[t[0]].cls(t[1])),
        st.tuples(st.sampled_from((sp.Max, sp.Min)), inner, inner).map(lambda t: compared(*t)),
        inner.map(lambda e: sp.sqrt(e**2 + 1)),
    )


def in_grammar(e):
    if e.has(sp.zoo, sp.nan, sp.oo, sp.I, sp.E):
        return False
    constants = [f for f in e.atoms(sp.exp) if f.args[0].is_number]
    high = [p for p in e.atoms(sp.Pow) if p.exp.is_Number and abs(p.exp) > MAX_POWER]
    edge = [n for n in e.atoms(sp.Number) if n and not 1e-250 < abs(n) < 1e250]
    return not (constants or high or edge)


@example(-(u[k] + 1) * (y[k - 1] + 2))
@example(-(A + 1) * u[k] / 3)
@example(sp.Float(-0.1) * (u[k] + 1))
@example(sp.Rational(-7, 3) * u[k - 1] ** 3 * sp.Abs(phi1[k - 1]) / y[k - 1])
@settings(max_examples=150, deadline=None)
@given(st.recursive(leaves, grown, max_leaves=6))
def test_parse_reads_back_what_text_writes(e):
    assume(in_grammar(e))
    written = text(e)
    found = parse(written, **NAMES)
    # 1/(2*(a + b)) comes back as 1/(2*a + 2*b): SymPy multiplies a number into a sum.
    assert found == e or sp.factor_terms(found) == sp.factor_terms(e) or sp.simplify(found - e) == 0, written


# ---------------------------------------------------------------- hostile texts

HOSTILE = {
    "empty": "", "blank": " \t\n", "dunder": "__import__('os').system('true')", "class": "().__class__", "lambda": "lambda: 0",
    "attribute": "y.real", "method": "u[k].subs(1,2)", "string": "'u'", "comprehension": "[u for u in y]", "walrus": "(a:=1)",
    "keyword": "Max(u[k], key=1)", "star": "Max(*u)", "call of a signal": "u(k)", "double index": "u[k][k]", "slice": "u[k:1]",
    "free index": "u[j-1]", "product index": "u[2*k]", "float index": "u[k-1.5]", "two steps": "u[k-1-1]", "double sign": "u[k--1]",
    "no operator": "u[k] u[k]", "juxtaposed": "2u[k]", "power of power": "9**9**9", "tower": "((9**16)**16)**16",
    "small tower": "(" * 30 + "2**-16" + ")**16" * 30, "symbolic power": "2**u[k]", "power sum": "(u[k]+1)**17",
    "hidden power": "exp(100*log(u[k]))", "powers by product": "*".join(["u[k]**9"] * 2),
    "10000 brackets": "(" * 10_000 + "u[k]" + ")" * 10_000, "open brackets": "(" * 39, "minus signs": "-" * 3_900 + "u[k]",
    "powers": "2**" * 3_000 + "1", "digits": "1" * 5_000, "digits after the point": "0." + "1" * 5_000, "lag": "u[k-100001]",
    "long lag": "u[k-" + "9" * 4_000 + "]", "long sum": "+".join(["u[k-1]"] * 1_000_000), "long name": "a" * 19_000,
    "non-ASCII letter": "\u00fc[k]", "non-ASCII digit": "\u0663*u[k]", "superscript": "u[k]\u00b2", "minus sign": "u[k\u22121]",
    "no-break space": "u[k]\u00a0", "direction mark": "\u202eu[k]", "surrogate": "\ud800", "null byte": "u[k]\x00", "escape": "\x1b[2J",
    "1e999": "1e999", "nan": "nan", "inf": "inf", "infinite product": "1e300*1e300", "infinite factor": "(1e200*u[k])**2",
    "zero": "1/0", "zero float": "1/0.0", "zero power": "0**-1", "zero to zero": "0**0", "hidden zero": "1/(u[k]-u[k])",
    "log of zero": "log(0)", "log of nothing": "log(u[k]-u[k])", "complex": "sqrt(-1)", "complex power": "(0-8)**(1/3)",
    "complex in Max": "Max(1, sqrt(0-1))", "undecided Max": "Max((sqrt(2)+sqrt(3))**2-5-2*sqrt(6), 0)", "exp": "exp(10000000)",
    "Max of many": "Max(" + ",".join(f"u[k-{i}]" for i in range(1_800)) + ")",
    "many Max": "*".join(f"Max(u[k],y[k-{i}])" for i in range(900)), "no arguments": "sin()", "two arguments": "sin(u[k],y[k])",
    "unknown function": "eval(u[k])", "unknown name": "os", "unknown sequence": "z[k]", "signal without index": "u", "index": "k",
    "comment": "u[k] # y", "semicolon": "u[k];u[k]", "equation": "y[k] = u[k]", "comparison": "u[k] < 1", "floor": "u[k]//2",
    "percent": "u[k]%2", "matrix": "u[k]@u[k]", "xor": "u[k]^2", "complex literal": "1j*u[k]", "hex": "0x10", "underscore": "1_000",
}  # fmt: skip


def test_hostile_texts_are_refused():
    # In a process of its own: a text that hangs fails this test instead of stopping all of them.
    program = (
        "import json, sys\nfrom narx_sym.errors import ParseError\nfrom narx_sym.symbolic.grammar import parse\n"
        "for name, text in json.load(sys.stdin).items():\n"
        "    try: print('read', name, str(parse(text))[:99])\n"
        "    except ParseError as e: print('long message' if len(str(e)) > 400 else 'fine', name)\n"
        "    except BaseException as e: print('wrong error', name, type(e).__name__)\n"
    )
    import json

    done = subprocess.run(
        [sys.executable, "-c", program], input=json.dumps(HOSTILE), capture_output=True, text=True, timeout=240,
        cwd=ROOT, env={"PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip
    lines = done.stdout.splitlines()
    assert [line for line in lines if not line.startswith("fine")] == [], done.stderr
    assert len(lines) == len(HOSTILE), f"the last text read was {lines[-1:]}: {done.stderr}"


@pytest.mark.parametrize("thing", (None, 3, b"u[k]", ["u[k]"], sp.Symbol("u")))
def test_only_texts_are_parsed(thing):
    with pytest.raises(ParseError, match=type(thing).__name__):
        parse(thing)


def test_messages_show_the_place_and_what_is_known():
    for written, words in (
        ("u[k] + §", "near"), ("z[k-1]", "unknown sequence 'z'.*phi1"), ("theta", "unknown name 'theta'"),
        ("u", r"u\[k-1\]"), ("foo(u[k])", "unknown function 'foo'.*tanh"), ("sin(u[k],u[k])", "one argument, not 2"),
    ):  # fmt: skip
        with pytest.raises(ParseError, match=words):
            parse(written)


def test_random_texts_give_an_expression_or_a_parse_error():
    tokens = (
        "u[k]", "y[k-1]", "phi1[k-2]", "u", "k", "[", "]", "[k", "(", ")", "+", "-", "*", "/", "**", "**", ",", "0", "1", "2", "16",
        "0.0", "1e300", "1e-300", ".5", "1/2", "sqrt(", "log(", "Max(", "Min(", "exp(", "sign(", "abs(", "atan(", "tan(", " ", "e", ".",
    )  # fmt: skip
    pick = random.Random(7)
    read = 0
    for _ in range(3_000):
        written = "".join(pick.choices(tokens, k=pick.randint(1, 9)))
        try:
            found = parse(written)
        except ParseError:
            continue
        read += 1
        assert isinstance(found, sp.Expr) and found.free_symbols <= {y, u, phi1} | found.atoms(sp.Indexed) | {
            k, *(b.label for b in (y, u, phi1))
        }, written  # fmt: skip
        assert parse(text(found)) == found, written
    assert read > 60


@settings(max_examples=150, deadline=None)
@given(st.text(alphabet="uyk[]()+-*/.,0123456789eE phi_sqrt\n", max_size=40) | st.text(max_size=20))
def test_random_characters_give_an_expression_or_a_parse_error(written):
    try:
        assert isinstance(parse(written), sp.Expr)
    except ParseError:
        pass


def test_model_texts_are_checked_too():
    with pytest.raises(ParseError):
        NARX.from_terms(["y[k-1]", "__import__('os')"])
    with pytest.raises(ModelError, match="list of terms"):
        NARX.from_terms("y[k-1]")
    with pytest.raises(ModelError, match="twice"):
        NARX.from_terms(["y[k-1]", "u[k-1]", "y[k - 1]"])
    model = NARX.from_terms(["u[k-1]", "breve_phi1[k-1]*phi1[k-1]"], input="y", output="u")
    assert model.terms == (u[k - 1], breve_phi1[k - 1] ** 2)


# ---------------------------------------------------------------- LaTeX


def test_latex_is_the_papers_notation():
    assert latex(phi1[k - 1]) == r"\phi_{1,\,k-1}" and latex(breve_phi2[k]) == r"\breve{\phi}_{2,\,k}"
    assert latex(sp.Float(1.44e-5)) == r"1.44 \times 10^{-5}" and latex(y[k]) == "y_{k}"
    model = BENCH.published()
    shown = model.latex(numbers=True)
    assert r"0.77\,\phi_{1,\,k-1}" in shown and r"- 0.0096\,\phi_{2,\,k-2} \phi_{1,\,k-2} y_{k-1}" in shown


def formulas():
    """LaTeX of everything that is printed: (what, text)."""
    model = BENCH.published()
    inverse = NARX.from_terms(
        ["u[k-1]", "breve_phi1[k-1]", "breve_phi2[k-2]*breve_phi1[k-2]*u[k-1]"],
        [1, 1.2, -0.01],
        input="y",
        output="u",
        lead=2,
    )
    around = BENCH.published(operating_point={y: -96.0, u: 1.8e-5})
    second = NARX.from_terms(
        ["y[k-1]", "y[k-2]", "phi1[k-1]", "long_name[k-1]"], [1.5, -0.5, 0.2, 1], channels=["long_name"]
    )
    one = NARX.from_terms(["y[k-1]", "u[k-1]"])
    for name, m in (("model", model), ("inverse", inverse), ("around", around), ("second", second), ("one", one)):
        yield name, m.latex()
        if m.theta is not None:
            yield f"{name} in numbers", m.latex(numbers=True)
        yield f"{name} quasi-static", m.quasi_static().latex()
        yield f"{name} equation", latex(m.equation)
        try:
            law = m.compensator()
        except NotInvertible:
            continue
        yield f"{name} law", law.latex()
        yield f"{name} law in numbers", law.latex(numbers=True)
        yield f"{name} law expanded", latex(law.equation)
    a, b = sp.symbols("a b", real=True)
    branched = Model(y[k - 1] + a * phi1[k] + b * sp.Abs(phi1[k]) * (2 * u[k - 1] - y[k - 1]), (a, b), [0.7, 0.1])
    bent = NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.5, 1, 0.1])
    for name, m in (("branched", branched), ("bent", bent)):
        yield f"{name} law", m.compensator().latex()
        yield f"{name} law in numbers", m.compensator().latex(numbers=True)
    yield "constraint", latex(sp.Eq(model.sigma_y, 1, evaluate=False))
    yield "terms", latex(list(pool(degree=2, functions=("abs", "sin", "tanh"), constant=True)))
    yield "functions", latex([parse(f"{f}(u[k-1])") for f, row in functions.NAMES.items() if not row.extreme])
    yield "Max", latex(parse("Max(u[k], Min(y[k-1], phi1[k]))**2 + sign(u[k])**3 + 1.5e-10*sqrt(u[k])"))
    yield "pieces", latex(sp.Piecewise((u[k], u[k] > 0), (0, True)))


def test_every_formula_has_balanced_brackets():
    for name, written in formulas():
        assert written.count("{") == written.count("}"), name
        assert written.count(r"\left") == written.count(r"\right"), name
        assert written.count(r"\begin{") == written.count(r"\end{"), name
        assert not any(word in written for word in ("Indexed", "Float(", "nan", "None", "phi1", "theta_{1}1")), (
            name,
            written,
        )


def test_latex_compiles(tmp_path):
    program = next((p for p in ("pdflatex", "latex", "lualatex", "xelatex") if shutil.which(p)), None)
    if program is None:
        pytest.skip("no LaTeX in PATH")
    body = "\n".join(rf"\paragraph{{{name}}}\[ {written} \]" for name, written in formulas())
    document = rf"\documentclass{{article}}\usepackage{{amsmath}}\begin{{document}}{body}\end{{document}}"
    (tmp_path / "all.tex").write_text(document, encoding="utf-8")
    done = subprocess.run(
        [program, "-interaction=nonstopmode", "-halt-on-error", "all.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stdout[-3000:]


def test_mathml_is_xml():
    from xml.dom import minidom

    model = BENCH.published()
    for thing in (model, model.compensator(), phi1[k - 1] ** 2, sp.Float(1e-9) * u[k] / y[k - 1]):
        assert minidom.parseString(mathml(thing)).documentElement.tagName == "math"


def test_a_number_before_a_negative_term_takes_its_sign():
    """Not "0.5 - 1 max(...)", which is another equation."""
    shown = latex_sum(sp.Symbol("z"), [(sp.Float(0.5), -sp.Max(-1, u[k])), (sp.Float(-2), -u[k])])
    assert shown.split("&= ")[1].startswith(r"- 0.5\,\max\left(-1, u_{k}\right) + 2\,u_{k}")
