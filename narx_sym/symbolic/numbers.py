"""Numbers in sentences: few digits, with a unit, in the SI prefix that suits their size."""

from __future__ import annotations

import re
from math import floor, isfinite, log10

PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "": 1.0, "c": 1e-2, "m": 1e-3, "µ": 1e-6, "n": 1e-9}
# A unit that takes a prefix, to the power of one, in front of what else there is.
PREFIXED = re.compile(r"([GMkcmuµμn]?)((?:m|s|V|A|W|N|Nm|J|Pa|bar|Hz|K|rad|Ω)(?![\w²³^*-]).*)")
SMALL = 0.1  # a smaller number is told with a smaller prefix
FAR = 1e-3  # a smaller number is not told with the prefix of a larger one


def few(value: float, digits: int = 3) -> str:
    """Return a number with a few significant digits: 440 and not 4.4e+02."""
    return f"{float(f'{value:.{digits}g}'):.12g}"


def number(value: float, digits: int = 3) -> str:
    """Return a number with a few significant digits, without an exponent where it is of usual size."""
    if value == 0 or not isfinite(value):
        return "0" if value == 0 else "-"
    if 1e-3 <= abs(value) < 1e5:
        rounded = float(f"{value:.{digits - 1}e}")
        return f"{value:.{max(0, digits - 1 - floor(log10(abs(rounded))))}f}"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def with_unit(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit, where one is known."""
    return f"{few(value, digits)} {unit}".rstrip()


def prefixed(unit: str, value: float) -> tuple[float, str]:
    """Return a factor and a unit such as "mm", in which a value [unit] is no small number; else 1 and the unit."""
    found, size = PREFIXED.fullmatch(unit), abs(value)
    if not found or not 0 < size < SMALL:
        return 1.0, unit
    own = PREFIXES[found[1].translate(str.maketrans("uμ", "µµ"))]
    fitting = [p for p, one in PREFIXES.items() if p != "c" and one <= size * own]
    return (own / PREFIXES[fitting[0]], fitting[0] + found[2]) if fitting else (1.0, unit)


def sized(value: float, unit: str, digits: int = 3, beside: float = 0.0) -> str:
    """Return a size with its unit, in the SI prefix that suits it, or the size beside it where that is not far."""
    factor, label = prefixed(unit, beside or value)
    if abs(factor * value) < FAR:
        factor, label = prefixed(unit, value)
    return with_unit(factor * value, label, digits)
