r"""LaTeX and text in the paper's notation: `\\phi_{1,\\,k-1}`, `1.44 \\times 10^{-2}`, `phi1[k-1]`."""

from __future__ import annotations

import re
from typing import Any

import sympy as sp
from mpmath.libmp import prec_to_dps
from sympy.printing.latex import LatexPrinter
from sympy.printing.str import StrPrinter

from .functions import arguments_of, row_of
from .signals import Name, k, lag

DIGITS, FULL = 6, 15  # of a printed number; of a float that was not rounded


def _digits(value: Any) -> int:
    """Return with how many digits a float is printed: its own where it was rounded to some, else six."""
    return (_rounded(value) or DIGITS) if isinstance(value, sp.Float) else DIGITS


def _rounded(value: Any) -> int:
    """Return to how many digits a float was rounded; 0 where it was not."""
    own = int(prec_to_dps(value._prec))
    return own if own != FULL else 0


def _number(value: Any) -> tuple[str, str]:
    """Return mantissa and exponent of a float as texts; the exponent is empty where none is wanted."""
    shown = f"{float(value):.{_digits(value)}g}"
    mantissa, _, exponent = shown.partition("e")
    return mantissa, str(int(exponent)) if exponent else ""


def _upright(name: str) -> str:
    """Return a name of several letters upright: else it would be a product of them."""
    return name if len(name) == 1 else rf"\mathrm{{{name}}}"


class _Latex(LatexPrinter):
    def _print_Indexed(self, expr: Any) -> str:
        name, index = expr.base.name, self._print(expr.indices[0]).replace(" ", "")
        breve = name.startswith("breve_")
        head, digits = name.removeprefix("breve_"), ""
        if head in ("phi1", "phi2"):
            head, digits = r"\phi", head[-1]
        elif len(parts := head.split("_")) == 2 and all(parts):  # m_play: a signal m of its own
            head, digits = _upright(parts[0]), rf"\mathrm{{{parts[1]}}}"
        elif len(head) > 1:
            head = rf"\mathrm{{{head.replace('_', chr(92) + '_')}}}"
        if breve:
            head = rf"\breve{{{head}}}"
        return rf"{head}_{{{digits},\,{index}}}" if digits else f"{head}_{{{index}}}"

    def _print_Float(self, expr: Any) -> str:
        mantissa, exponent = _number(expr)
        return rf"{mantissa} \times 10^{{{exponent}}}" if exponent else mantissa

    def _print_Pow(self, expr: Any) -> str:
        if expr.base == Name("q"):  # the shift operator: q^{-1}, not 1/q
            return rf"q^{{{self._print(expr.exp)}}}"
        return str(super()._print_Pow(expr))

    def _print_ExpBase(self, expr: Any, exp: Any = None, name: str = r"\exp") -> str:  # beside a parameter e
        shown = rf"{name}\left({self._print(expr.args[0])}\right)"
        return rf"{shown}^{{{exp}}}" if exp else shown

    def _print_sign(self, expr: Any, exp: Any = None) -> str:
        return self._print_ExpBase(expr, exp, r"\operatorname{sign}")


class _Law(_Latex):
    """Newest samples first, differences without a leading minus, cases as in a textbook."""

    def _print_Add(self, expr: Any, order: Any = None) -> str:
        if not expr.has(sp.Indexed) and k in expr.free_symbols:
            return str(super()._print_Add(expr, order))  # an index

        def rank(term: Any) -> tuple[bool, int, str]:
            lags = [lag(s) for s in term.atoms(sp.Indexed)]
            return (
                term.could_extract_minus_sign(),
                -1 if term in term.atoms(sp.Indexed) else min(lags, default=-2),
                "",
            )

        shown = ""
        for term in sorted(expr.args, key=rank):
            minus = term.could_extract_minus_sign()
            printed = self._print(-term if minus else term)
            shown += f"{' - ' if minus else ' + ' if shown else ''}{printed}"
        return shown.strip()

    def _print_Piecewise(self, expr: Any) -> str:
        rows = [
            rf"{self._print(value)}, & \text{{{'otherwise' if condition == sp.true else 'if '}}}"
            + ("" if condition == sp.true else self._print(condition))
            for value, condition in expr.args
        ]
        return r"\begin{cases} " + r" \\ ".join(rows) + r" \end{cases}"

    def _print_Root(self, expr: Any, exp: str | None = None) -> str:
        gap, w, last, *_ = map(self._print, expr.args)
        if exp is not None:
            return rf"\left({self._print_Root(expr)}\right)^{{{exp}}}"
        return rf"{w} \text{{ nearest to }} {last} \text{{ with }} {gap} = 0"


def latex_law(equations: list[tuple[Any, Any]]) -> str:
    """Return the equations of a law, one below the other, as one `aligned` block."""
    shown = " \\\\\n".join(f"{latex(lhs)} &= {_Law(_LATEX_SETTINGS).doprint(rhs)}" for lhs, rhs in equations)
    return f"\\begin{{aligned}}\n{shown}\n\\end{{aligned}}"


class InLatex:
    """What a notebook shows of anything that has `latex`."""

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"  # type: ignore[attr-defined]


_LATEX_SETTINGS: dict[str, Any] = {"mul_symbol": None, "fold_short_frac": False}


def latex(thing: Any) -> str:
    r"""Return LaTeX of anything in the package: a model, a law, a condition, an expression, or a list of these.

    Examples
    --------
    >>> import narx_sym as ns
    >>> print(ns.latex(ns.phi1[ns.k - 1] * ns.y[ns.k - 2]))
    \phi_{1,\,k-1} y_{k-2}
    """
    if hasattr(thing, "latex") and callable(thing.latex):
        return str(thing.latex())
    if isinstance(thing, (list, tuple)) and not isinstance(thing, sp.Basic):
        return r" \\ ".join(latex(item) for item in thing)
    return _Latex(_LATEX_SETTINGS).doprint(sp.sympify(thing) if isinstance(thing, (int, float, sp.Basic)) else thing)


def latex_sum(lhs: Any, terms: list[tuple[Any, Any]], per_line: int = 3) -> str:
    """Return `lhs = c1 t1 + c2 t2 ...` in the given order, a few terms a line, as an `aligned` block."""
    return latex_system([(lhs, terms)], per_line)


def latex_system(equations: list[tuple[Any, list[tuple[Any, Any]]]], per_line: int = 3) -> str:
    """Return several equations like that of `latex_sum`, one below the other, as one `aligned` block."""
    shown = " \\\\\n".join(f"{latex(lhs)} &= {_sum(terms, per_line)}" for lhs, terms in equations)
    return f"\\begin{{aligned}}\n{shown}\n\\end{{aligned}}"


def _sum(terms: list[tuple[Any, Any]], per_line: int) -> str:
    pieces = []
    for coefficient, term in terms:
        if sp.sympify(term).as_coeff_Mul()[0].is_negative:  # a minus between two factors would be a difference
            coefficient, term = -coefficient, -term
        negative = sp.sympify(coefficient).could_extract_minus_sign()
        size = -coefficient if negative else coefficient
        unit = size.is_number and float(size) == 1 and term != 1
        held = size.is_Add and (term != 1 or negative)  # one sign for all of a sum
        product = "" if unit else rf"\left({latex(size)}\right)" if held else latex(size)
        shown = product if term == 1 else (product + r"\," if product else "") + _factors(term)
        pieces.append(("- " if negative else "+ ") + shown)
    if not pieces:
        pieces = ["+ 0"]
    pieces[0] = pieces[0].removeprefix("+ ")
    lines = [" ".join(pieces[i : i + per_line]) for i in range(0, len(pieces), per_line)]
    return " \\\\\n &\\quad ".join(lines)


def _factors(term: Any) -> str:
    """Print the factors in the paper's order: phi2, phi1, u, y, and what else there is."""
    order = ("phi2", "phi1", "u", "y")

    def rank(factor: Any) -> tuple[int, int, str]:
        base = factor.as_base_exp()[0]
        if isinstance(base, sp.Indexed):
            name = base.base.name.removeprefix("breve_")
            return (order.index(name) if name in order else 4, lag(base), name)
        return (5, 0, str(factor))

    factors = sorted(sp.Mul.make_args(term), key=rank)
    return " ".join(rf"\left({latex(f)}\right)" if f.is_Add else latex(f) for f in factors)


class _Text(StrPrinter):
    printmethod = "_narx_text"  # Indexed carries its own "_sympystr", which would win otherwise

    def _print_Indexed(self, expr: Any) -> str:
        return f"{expr.base.name}[{str(expr.indices[0]).replace(' ', '')}]"

    def _print_Float(self, expr: Any) -> str:
        own = _rounded(expr)
        return repr(float(f"{float(expr):.{own}g}") if own else float(expr))

    def _print_Mul(self, expr: Any) -> str:
        number, rest = expr.as_coeff_Mul()
        below = any(f.is_Pow and f.base.is_Add and f.exp.is_negative for f in sp.Mul.make_args(rest))
        if below and number.is_Rational and number.q != 1:  # SymPy multiplies 2*(1 - a) out where it is read
            shown = str(self._print(rest))
            return f"{number}{shown.removeprefix('1')}" if shown.startswith("1/") else f"{number}*{shown}"
        return str(super()._print_Mul(expr))

    def _print_Exp1(self, expr: Any) -> str:  # the grammar has no name for it
        return repr(float(expr))

    def _print_Function(self, expr: Any) -> str:
        row = row_of(expr)
        shown = ", ".join(map(self._print, arguments_of(expr) if row else expr.args))
        return f"{row.name if row else expr.func.__name__}({shown})"

    _print_Abs = _print_Heaviside = _print_Function  # noqa: N815  SymPy's names

    def _print_Dummy(self, expr: Any) -> str:
        return str(expr.name)

    def _print_Root(self, expr: Any) -> str:
        gap, w, last, *_ = map(self._print, expr.args)
        return f"({w} nearest to {last} with {gap} = 0)"


class _Shown(_Text):
    def _print_Float(self, expr: Any) -> str:
        digits = f"{float(expr):.{_digits(expr)}g}"
        return digits if re.search(r"[.en]", digits) else f"{digits}.0"  # 1.0 is measured, 1 is exact

    def _print_Symbol(self, expr: Any) -> str:
        return re.sub(r"\\(\w+)\{(\w+)\}", r"\2_\1", expr.name)


def text(expr: Any) -> str:
    """Return an expression as text, in the form that `NARX.from_terms` and model files use.

    Examples
    --------
    >>> import narx_sym as ns
    >>> ns.text(3 * ns.u[ns.k - 1] ** 2)
    '3*u[k-1]**2'
    """
    return str(_Text().doprint(expr))


def shown(expr: Any) -> str:
    r"""Return a text to read: six digits, `y_bar` for `\bar{y}`."""
    return str(_Shown().doprint(expr))


BOX = r"\parbox{0.9\linewidth}"  # breaks lines, which \text does not


def latex_text(message: str) -> str:
    """Return LaTeX of a sentence that stands among equations."""
    for special in "_^&%#$":
        message = message.replace(special, "\\" + special if special != "^" else r"\textasciicircum{}")
    return rf"\text{{{message}}}"


def boxed(equation: str) -> str:
    """Return LaTeX of an equation for a document: a sentence there is broken into lines."""
    return equation.replace(r"\text", BOX, 1) if equation.startswith(r"\text{") else equation


def document_of(parts: list[tuple[str, list[str]]]) -> str:
    """Return a LaTeX document with equations under headings; it compiles with amsmath alone."""
    body = "\n\n".join(
        rf"\section*{{{heading}}}" + "\n" + "\n".join(f"\\[\n{boxed(e)}\n\\]" for e in equations)
        for heading, equations in parts
    )
    return (
        "\\documentclass{article}\n\\usepackage{amsmath}\n\\usepackage[margin=2cm]{geometry}\n"
        f"\\begin{{document}}\n{body}\n\\end{{document}}\n"
    )
