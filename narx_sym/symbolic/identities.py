"""Which candidate terms are the same thing: normal forms under the identities of phi1 and phi2.

phi1[k] = u[k] - u[k-1], phi2^3 = phi2, phi2^2 phi1 = phi1, phi2 phi1 = |phi1|. Not phi2^2 = 1: it fails while the
input rests (sign(0)^2 = 0) and would change Sigma_y.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from functools import lru_cache, reduce
from typing import Any

import sympy as sp
from sympy.polys.matrices import DomainMatrix
from sympy.polys.rings import PolyRing

from .printing import text
from .signals import breve_phi1, breve_phi2, expand_phi, lag, phi1, phi2, rewritten, samples

CLEAR = 1e-6  # of the size of its terms: a sum above this is no zero that was rounded
DIGITS, POINTS = 60, 3  # of numbers, and how many places, by which an identity is told


def _compares(expr: Any) -> bool:
    """Whether an expression is a sample or a difference of two."""
    parts = [p.as_coeff_Mul() for p in sp.Add.make_args(expr)]
    return all(isinstance(s, sp.Indexed) for _, s in parts) and sorted(c for c, _ in parts) in ([1], [-1, 1])


def canonical(term: Any) -> Any:
    """Shorten a monomial by phi2^3 = phi2 and phi2^2 phi1 = phi1 at equal lags."""
    powers = {f.as_base_exp()[0]: f.as_base_exp()[1] for f in sp.Mul.make_args(term)}
    result = term
    for first, second in ((phi1, phi2), (breve_phi1, breve_phi2)):
        for s in samples(term, second):
            n = powers.get(s, sp.S.Zero)
            if not (n.is_Integer and n >= 2):
                continue
            with_phi1 = first[s.indices[0]] in powers
            result = result / s ** (n - (n % 2 if with_phi1 else 2 - n % 2))
    return result


def added(numbers: Iterable[float]) -> float:
    """Return the sum of numbers, added from left to right as compiled code does.

    The built-in `sum` of floats compensates rounding from Python 3.12 on: what it decides would hang on the version.
    """
    return reduce(operator.add, numbers, 0.0)


def clearly_not_zero(expr: Any) -> bool:
    """Whether numbers in the place of all symbols leave far more of an expression than rounding could.

    One point where it does not vanish decides: no identity needs to be searched for. False says nothing.
    """
    known = {s: sp.Float(0.37 + (0.618034 * i) % 1.3) for i, s in enumerate(sorted(expr.free_symbols, key=str))}
    values = [part.xreplace(known) for part in sp.Add.make_args(expr)]
    if not all(v.is_number and v.is_extended_real and v.is_finite for v in values):
        return False  # outside of where it is defined
    numbers = [float(v) for v in values]
    return abs(added(numbers)) > CLEAR * added(map(abs, numbers))


def expanded(expr: Any) -> Any:
    """Multiply out sums, but no exponent: of exp(-(a - b)**2) the factors overflow where it does not."""
    return sp.expand(expr, power_exp=False)


@lru_cache(maxsize=1024)
def vanishes(expr: Any) -> bool:
    """Whether an expression is identically zero, as far as SymPy can tell; numbers are taken as they are written.

    Where functions or roots of parameters stand in it, numbers with `DIGITS` digits at several points tell: algebra
    takes minutes for the exponentials of two poles.
    """
    if clearly_not_zero(expr):
        return False
    exact = sp.nsimplify(expr, rational=True)
    if any(not f.has(sp.Indexed) for f in exact.atoms(sp.exp, sp.sin, sp.cos)):
        return all(_is_zero_at(exact, i) for i in range(POINTS))
    return bool(sp.expand(sp.fraction(sp.together(exact))[0]) == 0 or sp.simplify(exact) == 0)


def _is_zero_at(expr: Any, point: int) -> bool:
    """Whether an expression of exact numbers is zero at a point, as far as many digits tell."""
    listed = sorted(expr.free_symbols, key=str)
    known = {s: sp.Rational(37 + 61 * i % 130 + 17 * point, 101 + 2 * point) for i, s in enumerate(listed)}
    values = [part.xreplace(known).evalf(DIGITS) for part in sp.Add.make_args(expr)]
    return bool(abs(sp.Add(*values)) <= sp.Float(10) ** (-DIGITS // 2) * sp.Add(*map(abs, values)))


def independent(terms: Sequence[Any]) -> tuple[list[Any], dict[Any, str]]:
    """Keep the terms that are linearly independent of those before them.

    Terms are polynomials over samples, signs and functions, reduced by s^3 = s and s^2 a = a for s = sign(a), where a
    is a sample or a difference of two.

    Returns
    -------
    kept : list of terms, in order
    dropped : dict from a dropped term to the reason, written as an identity such as "= phi1[k-1]"
    """
    atoms: dict[Any, Any] = {sp.S.One: sp.Dummy()}  # a ring has a generator

    def plain(part: Any) -> Any:
        """Put a symbol for what is no sum, product or power of others."""
        if isinstance(part, sp.Abs) and _compares(part.args[0]):  # |phi1| = phi2 phi1
            return plain(sp.sign(part.args[0])) * rewritten(part.args[0], plain)
        if part.is_Add or part.is_Mul or (part.is_Pow and part.exp.is_Integer and part.exp > 0):
            return None
        return part if part.is_Rational else atoms.setdefault(part, sp.Dummy())

    written = [rewritten(expand_phi(term), plain) for term in terms]
    rules = []
    for one in [one for one in atoms if isinstance(one, sp.sign)]:
        s, inside = atoms[one], rewritten(one.args[0], plain)
        rules += [s**3 - s, *[s**2 * inside - inside] * _compares(one.args[0])]
    newest = sorted(atoms, key=lambda one: min(map(lag, samples(one)), default=0))  # each step then leads by another
    ring = PolyRing([atoms[one] for one in newest], sp.QQ)
    identities = [ring.from_expr(rule) for rule in rules]
    forms = [ring.from_expr(e).rem(identities) for e in written]
    rows: dict[Any, dict[int, Any]] = {}
    for column, form in enumerate(forms):
        for monomial, coefficient in form.items():
            rows.setdefault(monomial, {})[column] = coefficient
    found, pivots = DomainMatrix(dict(enumerate(rows.values())), (len(rows), len(forms)), sp.QQ).rref()
    kept, made_of = [terms[i] for i in pivots], found.to_dod()
    dropped = {}
    for column in sorted(set(range(len(forms))) - set(pivots)):
        parts = (sp.QQ.to_sympy(row[column]) * kept[i] for i, row in made_of.items() if column in row)
        dropped[terms[column]] = f"= {text(sp.Add(*parts))}"
    return kept, dropped
