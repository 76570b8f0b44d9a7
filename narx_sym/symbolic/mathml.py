"""MathML from the paper's LaTeX: equations that a browser shows without scripts, with new terms marked."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from html import escape
from typing import Any

import sympy as sp

from . import printing
from .signals import samples

SPACE = "http://www.w3.org/1998/Math/MathML"
ELEMENTS = set("math mrow mi mn mo mtext mspace msub msup msubsup mover munder munderover mfrac msqrt mroot mstyle "
               "mtable mtr mtd mpadded mphantom menclose merror".split())  # fmt: skip
_HIDDEN = {ord(c): 0xE000 + i for i, c in enumerate("<>&")}  # the converter does not escape what stands in texts
ATTRIBUTES = set("accent class columnalign columnlines columnspacing depth display displaystyle fence form "
                 "height linethickness lspace mathvariant maxsize minsize movablelimits notation rowlines "
                 "rowspacing rspace scriptlevel separator stretchy width xmlns".split())  # fmt: skip
BREAK = " \\\\\n"  # between the lines of an `aligned` block


def mathml(thing: Any) -> str:
    """Return presentation MathML of a model, a law, a condition or an expression (no scripts are needed to show it)."""
    return from_latex(printing.latex(getattr(thing, "equation", thing)))


def from_latex(text: str, digits: int | None = None) -> str:
    """Return MathML of the package's own LaTeX; an `aligned` block becomes a table of lines.

    What is not understood, or is no MathML, is shown as its LaTeX.

    Parameters
    ----------
    digits : int, optional
        Numbers are rounded to so many significant digits.
    """
    if digits is not None:
        text = re.sub(r"\d+\.\d+", lambda found: f"{float(found[0]):.{digits}g}", text)
        # A factor 1 that came from a number is left out.
        text = re.sub(r"(?<![\w.{^}])1 ?(?=[a-z]_|\\theta|\\phi|\\operatorname)", "", text)
    inside = re.search(r"\\begin\{aligned\}\n(.*?)\n\\end\{aligned\}", text, flags=re.DOTALL)
    if inside is None:
        return _math([["", "", text]])
    before, after = text[: inside.start()], text[inside.end() :]
    rows = []
    for line in inside[1].split(BREAK):
        left, _, right = line.partition("&")
        rows.append(["", left.strip(), right.removeprefix(r"\quad").strip()])
    rows[0][0], rows[-1][2] = before, rows[-1][2] + after
    return _math(rows)


def marked(model: Any, new: Iterable[Any] = (), values: bool = False, width: int = 36) -> str:
    """Return the equations of a model as MathML; what contains one of the new symbols or states has the class "new".

    Parameters
    ----------
    model : Model
    new : parameter symbols and sequences
    values : bool
        Numbers, with the digits that the free run needs, in the place of the parameters.
    width : int
        About how many characters stand on a line.
    """
    known = model.printed if values else {}
    wanted, rows = set(new), []
    for left, terms in model.system():
        whole = left.base in wanted
        pieces = [_piece(c, e, known, not whole and _has(c * e, wanted)) for c, e in terms]
        for i, line in enumerate(_lines(pieces, width)):
            shown = "".join(line).removeprefix("+" if i == 0 else "")
            lead = printing.latex(left) if i == 0 else ""
            row = [lead, ("= " if i == 0 else r"\quad ") + (shown or "0")]
            rows.append(["", *(rf"\class{{new}}{{{cell}}}" if whole and cell else cell for cell in row)])
    return _math(rows)


def _piece(coefficient: Any, term: Any, known: dict[Any, Any], is_new: bool) -> str:
    """Return one signed term as LaTeX."""
    block = printing.latex_sum(sp.Symbol("A"), [(coefficient.xreplace(known), term.xreplace(known))])
    shown = block.split("&= ")[1].split("\n")[0]
    sign, body = ("-", shown[2:]) if shown.startswith("- ") else ("+", shown)
    return f"{sign} " + (rf"\class{{new}}{{{body}}} " if is_new else f"{body} ")


def _lines(pieces: list[str], width: int) -> list[list[str]]:
    """Distribute terms over lines; a long one stands alone."""
    lines: list[list[str]] = [[]]
    used = 0
    for piece in pieces:
        size = len(re.sub(r"\\class\{new\}|\\[a-zA-Z]+|[{}_^\\, ]", "", piece))
        if lines[-1] and used + size > width:
            lines, used = [*lines, []], 0
        lines[-1].append(piece)
        used += size
    return lines


def _has(expr: Any, wanted: set[Any]) -> bool:
    return bool(wanted & (expr.free_symbols | {s.base for s in samples(expr)}))


def _math(rows: list[list[str]]) -> str:
    """Return rows of LaTeX cells as one element."""
    try:
        cells = [[_converted(cell) for cell in row] for row in rows]
    except ValueError:
        return f'<code class="latex">{escape(" ".join(c for row in rows for c in row))}</code>'
    if len(rows) == 1:
        body = "".join(cells[0])
    else:
        body = "".join(
            f'<mtr><mtd style="text-align: right">{before}{left}</mtd><mtd style="text-align: left">{right}</mtd></mtr>'
            for before, left, right in cells
        )
        body = f'<mtable displaystyle="true" class="lines">{body}</mtable>'
    return f'<math xmlns="{SPACE}" display="block">{body}</math>'


def _converted(text: str) -> str:
    """Return the content of one formula, checked element by element.

    Raises
    ------
    ValueError
        Where the result is no MathML.
    """
    from latex2mathml.converter import convert

    if not text.strip():
        return ""
    # Names of several letters stand upright, in one piece.
    text = re.sub(r"_\{(\d*) ?([A-Za-z]{2,}[^{},]*)\}", r"_{\1\\text{\2}}", text.replace(r"\\[6pt]", r"\\"))
    text = re.sub(r"\\mathrm\{([^{}]*)\}", r"\\text{\1}", text)
    text = re.sub(r"\\text\{[^{}]*\}", lambda found: found[0].translate(_HIDDEN), text)
    text = text.replace("<", r"\lt ").replace(">", r"\gt ")
    try:
        shown = convert(text)
        found = ET.fromstring(shown)
    except Exception as error:  # whatever the converter raises: the LaTeX itself can still be read
        raise ValueError(str(error)) from None
    unknown = {e.tag.partition("}")[2] for e in found.iter()} - ELEMENTS
    unknown |= {name for e in found.iter() for name in e.attrib} - ATTRIBUTES
    if unknown:
        raise ValueError(f"unknown: {unknown}")
    shown = shown[shown.index(">") + 1 : shown.rindex("<")]
    return re.sub("[\ue000-\ue002]", lambda found: escape("<>&"[ord(found[0]) - 0xE000]), shown)
