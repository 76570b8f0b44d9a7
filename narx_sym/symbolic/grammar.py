"""Text terms such as "phi2[k-2]*phi1[k-2]*u[k-2]" to expressions, by a grammar and never by `eval`.

Text comes from strangers' files. Everything that is not in the grammar, and everything that could grow without
bound (long texts, deep nesting, large powers), is refused with a `ParseError`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import cache
from math import comb
from typing import Any

import sympy as sp

from ..errors import ParseError
from .functions import NAMES
from .signals import breve_phi1, breve_phi2, k, phi1, phi2, signal, u, y

GRAMMAR = r"""
    ?start: sum
    ?sum: term (SIGN term)*
    ?term: product | SIGN term -> signed
    ?product: power (TIMES unary)*
    ?unary: power | SIGN unary -> signed
    ?power: atom ("**" unary)?
    ?atom: NUMBER -> number
         | NAME -> symbol
         | NAME "[" "k" [SIGN INT] "]" -> sample
         | NAME "(" sum ("," sum)* ")" -> call
         | "(" sum ")"
    SIGN: "+" | "-"
    TIMES: "*" | "/"
    NAME: /[A-Za-z_][A-Za-z_0-9]*/
    INT: /[0-9]+/
    NUMBER: /([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?/
    %ignore /[ \t\n]+/
"""
SIGNALS = {b.name: b for b in (y, u, phi1, phi2, breve_phi1, breve_phi2)}
MAX_LENGTH, MAX_DEPTH, MAX_POWER, MAX_DIGITS, MAX_LAG = 20_000, 40, 16, 310, 100_000
MAX_COMPARED, LARGEST = 1_000, 1e300
MAX_FACTORS, MAX_CALLS, MAX_CONSTANTS = 200, 500, 3  # in a product; functions, and those in a constant argument


@cache
def _parser() -> Any:
    import lark  # loaded when the first text is read: half the start-up time of the package otherwise

    return lark.Lark(GRAMMAR, parser="lalr", propagate_positions=False, maybe_placeholders=True)


def parse(text: str, signals: Iterable[str] = (), symbols: Iterable[Any] = ()) -> Any:
    """Read one expression.

    Parameters
    ----------
    text : str
        Sums, products, quotients and integer powers of samples `x[k-i]`, numbers, parameters and the
        elementary functions of `narx_sym.symbolic.functions`.
    signals : names
        Further sequences (beside y, u, phi1, phi2, breve_phi1, breve_phi2) that may appear.
    symbols : names, or Symbols
        Parameters that may appear; what is only named is real.

    Raises
    ------
    ParseError
        For anything else: the message shows the place.
    """
    import lark

    if not isinstance(text, str):
        raise ParseError(f"A term is a text such as 'phi1[k-1]*u[k-1]', not {type(text).__name__}.")
    if len(text) > MAX_LENGTH:
        raise ParseError(f"The expression has {len(text)} characters; at most {MAX_LENGTH} are read.")
    depth = deepest = 0
    for character in text:
        depth += (character in "([") - (character in ")]")
        deepest = max(deepest, depth)
    if deepest > MAX_DEPTH or text.count("**") + text.count("-") + text.count("+") > 4000:
        raise ParseError(f"The expression is nested or repeated too deeply (at most {MAX_DEPTH} brackets).")
    known = SIGNALS | {name: signal(name) for name in signals}
    builder = _Builder(
        text, known, {str(s): s if isinstance(s, sp.Symbol) else sp.Symbol(s, real=True) for s in symbols}
    )
    try:
        expr = builder.build(_parser().parse(text))
    except lark.exceptions.UnexpectedInput as error:
        place = text[max(0, (error.pos_in_stream or 0) - 15) :][:40]
        raise ParseError(
            f"Cannot read {_short(text)!r} near {place!r}: write terms like 'phi2[k-2]*phi1[k-2]*u[k-2]'."
        ) from None
    except RecursionError:
        raise ParseError(f"The expression {_short(text)!r} is nested too deeply.") from None
    if expr.has(sp.zoo, sp.nan, sp.oo, -sp.oo, sp.I):
        raise ParseError(f"{_short(text)!r} is not a finite real expression.")
    for part in sp.preorder_traversal(expr):
        if part.is_Pow and part.exp.is_Number and abs(part.exp) > MAX_POWER:
            raise ParseError(f"A power above {MAX_POWER} in {_short(text)!r} is refused.")
        if part.is_Pow and part.is_number and not part.is_real:
            raise ParseError(f"{_short(text)!r} is not a finite real expression.")
        if part.is_Number:
            builder.bounded(part)
    return expr


def read_json(text: str) -> Any:
    """Read JSON in which no name appears twice in an object and every number is finite.

    Raises
    ------
    ValueError, RecursionError
        Not JSON, or JSON that two readers may take differently.
    """

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [n for n, _ in pairs]
            raise ValueError(f"the name {next(n for n in names if names.count(n) > 1)[:40]!r} appears twice")
        return found

    def number(token: str) -> float:
        value = float(token)
        if value in (float("inf"), float("-inf")):
            raise ValueError(f"the number {token[:40]} is too large")
        return value

    def constant(name: str) -> Any:
        raise ValueError(f"{name} is no number")

    return json.loads(text, object_pairs_hook=once, parse_float=number, parse_constant=constant)


def expanded_terms(expr: Any) -> int:
    """Return how many terms `expand` may make of an expression, the largest of its arguments included."""
    largest = 1

    def count(e: Any) -> int:
        nonlocal largest
        made = [count(a) for a in e.args] if not e.is_Indexed else []
        found = 1
        if e.is_Add:
            found = sum(made)
        elif e.is_Mul:
            for n in made:
                found *= n
        elif e.is_Pow and e.exp.is_Integer and e.exp > 0:
            found = comb(made[0] + int(e.exp) - 1, int(e.exp))
        largest = max(largest, found)
        return found

    count(expr)
    return largest


def _short(text: str) -> str:
    return text if len(text) < 60 else text[:57] + "..."


def _some(names: Iterable[str], most: int = 20) -> str:
    listed = list(names)
    return ", ".join(map(_short, listed[:most])) + (f" and {len(listed) - most} more" if len(listed) > most else "")


class _Builder:
    """Turns the syntax tree into SymPy, refusing whatever could grow without bound."""

    def __init__(self, text: str, signals: dict[str, Any], symbols: dict[str, Any]):
        self.text, self.signals, self.symbols = text, signals, symbols
        self.compared = self.calls = 0

    def build(self, node: Any) -> Any:
        if node is None or not hasattr(node, "data"):
            return node
        return getattr(self, node.data)(*[self.build(child) for child in node.children])

    def fail(self, why: str) -> ParseError:
        return ParseError(f"In {_short(self.text)!r}: {why}")

    def sum(self, *parts: Any) -> Any:
        return sp.Add(parts[0], *(p if s == "+" else -p for s, p in zip(parts[1::2], parts[2::2], strict=True)))

    def product(self, *parts: Any) -> Any:
        factors = [parts[0]]
        for operator, factor in zip(parts[1::2], parts[2::2], strict=True):
            if operator == "/" and factor == 0:
                raise self.fail("division by zero.")
            factors.append(factor if operator == "*" else 1 / factor)
        if sum(len(sp.Mul.make_args(f)) for f in factors) > MAX_FACTORS:
            raise self.fail(f"a product of more than {MAX_FACTORS} factors is refused.")
        return self.bounded(sp.Mul(*factors))

    def signed(self, sign: str, value: Any) -> Any:
        return value if sign == "+" else -value

    def power(self, base: Any, exponent: Any = None) -> Any:
        if exponent is None:
            return base
        if not exponent.is_Number or abs(exponent) > MAX_POWER:
            raise self.fail(f"the power {_short(str(exponent))} is refused; numbers up to {MAX_POWER} are read.")
        if base == 0 and exponent <= 0:
            raise self.fail("division by zero.")
        return self.bounded(base**exponent)

    def number(self, token: str) -> Any:
        if sum(c.isdigit() for c in token) > MAX_DIGITS:
            raise self.fail(f"a number has more than {MAX_DIGITS} digits.")
        if token.isdigit():
            return self.bounded(sp.Integer(int(token)))
        value = float(token)
        if value in (float("inf"), float("-inf")):
            raise self.fail(f"the number {token} is too large.")
        return sp.Float(value)

    def symbol(self, name: str) -> Any:
        name = str(name)
        if name in self.symbols:
            return self.symbols[name]
        if name == "pi":  # SymPy makes it, from atan(1) for one
            return sp.pi
        if name in self.signals:
            raise self.fail(f"{name} needs a time index: {name}[k-1].")
        raise self.fail(f"unknown name {_short(name)!r}; known are {_some([*self.signals, *self.symbols])}.")

    def sample(self, name: str, sign: str | None, steps: str | None) -> Any:
        name = str(name)
        if name not in self.signals:
            raise self.fail(f"unknown sequence {_short(name)!r}; known are {_some(self.signals)}.")
        if steps is None:
            return self.signals[name][k]
        if len(steps) > 6 or int(steps) > MAX_LAG:
            raise self.fail(f"the lag {_short(steps)} is larger than {MAX_LAG}.")
        return self.signals[name][k + int(sign + steps)]  # type: ignore[operator]

    def call(self, name: str, *arguments: Any) -> Any:
        name = str(name)
        row = NAMES.get(name)
        if row is None:
            raise self.fail(f"unknown function {_short(name)!r}; known are {', '.join(NAMES)}.")
        self.calls += 1
        if self.calls > MAX_CALLS:
            raise self.fail(f"there are more than {MAX_CALLS} functions.")
        if not row.extreme and len(arguments) != 1:
            raise self.fail(f"{name} takes one argument, not {len(arguments)}.")
        if any(a.is_Number for a in arguments) and not row.constant:
            raise self.fail(f"{name} of a constant is refused; write the number.")
        if row.extreme:  # SymPy compares each pair, those of a nested Max too
            self.compared += sum(len(a.args) if isinstance(a, (sp.Max, sp.Min)) else 1 for a in arguments) ** 2
            if self.compared > MAX_COMPARED:
                raise self.fail("there are too many arguments of Max and Min.")
        if any(a.is_number and len(a.atoms(sp.Function)) >= MAX_CONSTANTS for a in arguments):
            raise self.fail(f"{name} of nested constants is refused; write the number.")
        try:
            return row.cls(*arguments)
        except ValueError as error:
            raise self.fail(f"{error}") from None

    def bounded(self, value: Any) -> Any:
        if value.is_Number and value and not 1 / LARGEST < abs(value) < LARGEST:
            raise self.fail("constants above 1e300 or below 1e-300 are refused.")
        return value
