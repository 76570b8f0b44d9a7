"""Which candidate terms are the same thing: normal forms under the identities of phi1 and phi2.

phi1[k] = u[k] - u[k-1], phi2^3 = phi2, phi2^2 phi1 = phi1, phi2 phi1 = |phi1|. Not phi2^2 = 1: it fails while the
input rests (sign(0)^2 = 0) and would change Sigma_y.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import lru_cache, reduce
from typing import Any

import sympy as sp

from .printing import text
from .signals import breve_phi1, breve_phi2, expand_phi, phi1, phi2, samples

Monomial = tuple[tuple[int, int], ...]  # ((atom, power), ...)
Polynomial = dict[Monomial, Fraction]
CLEAR = 1e-6  # of the size of its terms: a sum above this is no zero that was rounded
DIGITS, POINTS = 60, 3  # of numbers, and how many places, by which an identity is told


class _NormalForms:
    """Polynomials over samples, signs and functions, reduced by the identities; one instance per pool."""

    def __init__(self) -> None:
        self.atoms: list[Any] = []
        self.signs: dict[
            int, tuple[int, ...]
        ] = {}  # sign atom -> its sample, or the two samples whose difference it takes

    def atom(self, expr: Any) -> int:
        if expr not in self.atoms:
            self.atoms.append(expr)
            if isinstance(expr, sp.sign):
                self.signs[self.atoms.index(expr)] = tuple(self.atom(s) for s in _compared(expr.args[0]))
        return self.atoms.index(expr)

    def of(self, term: Any) -> Polynomial:
        """Return the normal form of a term."""
        total: Polynomial = {(): Fraction(1)}
        for factor in sp.Mul.make_args(expand_phi(term)):
            base, exponent = factor.as_base_exp()
            if not (exponent.is_Integer and exponent > 0):
                base, exponent = factor, 1
            for _ in range(int(exponent)):
                total = self.reduce(_multiply(total, self.linear(base)))
        return total

    def linear(self, base: Any) -> Polynomial:
        if isinstance(base, sp.Abs) and _compared(base.args[0]):
            inside = base.args[0]  # |phi1| = phi2 phi1
            return _multiply({((self.atom(sp.sign(inside)), 1),): Fraction(1)}, self.linear(inside))
        if base.is_Number:
            return (
                {(): Fraction(int(base.p), int(base.q))} if base.is_Rational else {((self.atom(base), 1),): Fraction(1)}
            )
        result: Polynomial = {}
        for part in sp.Add.make_args(base):
            coefficient, rest = part.as_coeff_Mul()
            if not coefficient.is_Rational:
                coefficient, rest = sp.S.One, part
            key: Monomial = ((self.atom(rest), 1),) if rest != 1 else ()
            result[key] = result.get(key, Fraction(0)) + Fraction(int(coefficient.p), int(coefficient.q))
        return result

    def reduce(self, polynomial: Polynomial) -> Polynomial:
        """Apply s^3 = s, s^2 a = s^2 b + a - b for s = sign(a - b), s^2 a = a for s = sign(a) until nothing changes."""
        waiting: Polynomial = dict(polynomial)
        done: Polynomial = {}
        while waiting:
            monomial, coefficient = waiting.popitem()
            powers = dict(monomial)
            squares = [s for s in self.signs if powers.get(s, 0) >= 2]
            s = next((s for s in squares if powers[s] >= 3 or any(powers.get(a) for a in self.signs[s][:1])), None)
            if s is None:
                _add(done, monomial, coefficient)
                continue
            shorter = _times(powers, s, -2)
            _add(waiting, _key(shorter), coefficient)
            if powers[s] == 2 and len(self.signs[s]) == 2:
                first, second = self.signs[s]
                _add(waiting, _key(_times(_times(powers, first, -1), second, 1)), coefficient)
                _add(waiting, _key(_times(_times(shorter, first, -1), second, 1)), -coefficient)
        return done


def _compared(expr: Any) -> list[Any]:
    """Return [a] of a sample a, [a, b] of a difference of two in a fixed order, else nothing."""
    parts = [p.as_coeff_Mul() for p in sp.Add.make_args(expr)]
    plain = all(isinstance(s, sp.Indexed) for _, s in parts)
    if not plain or sorted(c for c, _ in parts) not in ([1], [-1, 1]):
        return []
    return sorted((s for _, s in parts), key=str)  # a - b or b - a: only s^2 is used


def _times(powers: dict[int, int], atom: int, exponent: int) -> dict[int, int]:
    return powers | {atom: powers.get(atom, 0) + exponent}


def _key(powers: dict[int, int]) -> Monomial:
    return tuple(sorted((i, n) for i, n in powers.items() if n))


def _add(polynomial: Polynomial, monomial: Monomial, coefficient: Fraction) -> None:
    value = polynomial.get(monomial, Fraction(0)) + coefficient
    if value:
        polynomial[monomial] = value
    else:
        polynomial.pop(monomial, None)


def _multiply(a: Polynomial, b: Polynomial) -> Polynomial:
    product: Polynomial = {}
    for m, x in a.items():
        for n, z in b.items():
            powers = dict(m)
            for i, e in n:
                powers[i] = powers.get(i, 0) + e
            _add(product, _key(powers), x * z)
    return product


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

    Returns
    -------
    kept : list of terms, in order
    dropped : dict from a dropped term to the reason, written as an identity such as "= phi1[k-1]"
    """
    forms = _NormalForms()
    rows: list[tuple[Monomial, Polynomial, dict[int, Fraction]]] = []  # pivot, reduced form, combination of kept
    kept: list[Any] = []
    dropped: dict[Any, str] = {}
    for term in terms:
        form, combination = dict(forms.of(term)), {len(kept): Fraction(1)}
        for pivot, row, made_of in rows:
            factor = form.get(pivot)
            if factor:
                for monomial, coefficient in row.items():
                    _add(form, monomial, -factor * coefficient)
                for i, coefficient in made_of.items():
                    combination[i] = combination.get(i, Fraction(0)) - factor * coefficient
        if form:
            pivot = min(form)
            scale = form[pivot]
            rows.append(
                (
                    pivot,
                    {m: c / scale for m, c in form.items()},
                    {i: c / scale for i, c in combination.items()},
                )
            )
            kept.append(term)
        else:
            used = {i: -c for i, c in combination.items() if i < len(kept) and c}
            identity = sp.Add(*(sp.Rational(c.numerator, c.denominator) * kept[i] for i, c in used.items()))
            dropped[term] = f"= {text(identity)}"
    return kept, dropped
