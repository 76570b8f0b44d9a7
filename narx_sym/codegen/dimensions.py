"""Units by inference: every equation is a system of linear equations in the powers of units, solved over fractions.

What is added up, compared, or stands on both sides of an equation has one unit; a product adds powers. Each signal
without a known unit, each parameter and each decimal number is an unknown. What the solution leaves free has no unit
here: it is not guessed (A. Kennedy, Programming languages and dimensions, Cambridge 1996, has the method for programs).

An equation that contradicts the others is left out with all that it says. That an argument of exp or tanh is a pure
number, a whole number too, and that an inner signal has the unit of the outer one, is believed where nothing else
contradicts it.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, NamedTuple

import sympy as sp

from ..inversion.solution import Root
from ..symbolic.functions import arguments_of, row_of

Powers = dict[Any, Fraction]  # of names of units, of unknowns, and of the relations that were used


class Unknown(NamedTuple):
    """What has no unit yet: a signal or a parameter by name, or a number by its place."""

    kind: str
    name: Any


class Relation(NamedTuple):
    """A mark in a row: it came from this one of all relations."""

    number: int


def plus(a: Mapping[Any, Fraction], b: Mapping[Any, Fraction], times: Any = 1) -> Powers:
    """Return the sum of powers: that of a product; `times` -1 for a quotient."""
    found = {key: a.get(key, Fraction(0)) + Fraction(times) * b.get(key, Fraction(0)) for key in {**a, **b}}
    return {key: power for key, power in found.items() if power}


class Dimensions:
    """The units in equations.

    Parameters
    ----------
    signals, parameters : mappings from their names to powers of units, as far as they are known
    """

    def __init__(self, signals: Mapping[str, Powers], parameters: Mapping[str, Powers]):
        self.known = {Unknown("signal", n): of for n, of in signals.items()}
        self.known |= {Unknown("parameter", n): of for n, of in parameters.items()}
        self.hard: list[tuple[int, Powers]] = []  # (group, what must be no unit): a group is left out as a whole
        self.soft: list[list[Powers]] = []  # each list as far as nothing contradicts
        self.numbers: list[tuple[float, Powers]] = []  # each decimal number where it stands
        self.groups = 0
        self.solved: dict[Any, Powers] | None = None

    # -- equations -------------------------------------------------------------------------------------------------

    def equal(self, left: Any, right: Any) -> None:
        """Take an equation."""
        self._same([self.walk(left), self.walk(right)])

    def alike(self, base: Any, other: Any) -> None:
        """Believe that two signals have one unit where nothing contradicts it."""
        self.soft.append([plus(self.named(base), self.named(other), -1)])

    def named(self, one: Any) -> Powers:
        """Return the powers of a signal or a parameter."""
        signal = isinstance(one, sp.IndexedBase)
        own = Unknown("signal" if signal else "parameter", str(one.label if signal else one))
        return self.known.get(own, {own: Fraction(1)})

    def walk(self, e: Any) -> Powers:
        """Return the powers of an expression, and take in what it says about its parts."""
        if isinstance(e, (sp.Indexed, sp.Symbol)):
            return self.named(e.base if isinstance(e, sp.Indexed) else e)
        if e.is_Number or e.is_NumberSymbol:
            return self._number(e)
        if e.is_Add:
            return self._same([self.walk(a) for a in e.args])
        if e.is_Mul:
            found: Powers = {}
            for a in e.args:
                found = plus(found, {} if a.is_number and not a.has(sp.Float) else self.walk(a))
            return found
        if e.is_Pow:
            return self._power(e)
        if isinstance(e, sp.Piecewise):
            for _, condition in e.args:
                self._condition(condition)
            return self._same([self.walk(value) for value, _ in e.args])
        if isinstance(e, Root):
            return self._root(e)
        return self._function(e)

    def _number(self, e: Any) -> Powers:
        """Return an unknown: a decimal number has any unit, a whole one is believed to be pure, zero has every unit."""
        own = self._fresh()
        if e.is_Float and e != 0:
            self.numbers.append((float(e), own))
        elif e.is_finite and e != 0:
            self.soft.append([own])
        return own

    def _power(self, e: Any) -> Powers:
        inner = self.walk(e.base)
        if e.exp.is_Rational:
            return {key: power * Fraction(int(e.exp.p), int(e.exp.q)) for key, power in inner.items()}
        found = self._fresh()
        self.soft += [[self.walk(e.exp)], [inner, found]]  # a pure number to any power is one
        return found

    def _function(self, e: Any) -> Powers:
        row = row_of(e)
        if row is None:
            return self._fresh()
        inner = [self.walk(a) for a in arguments_of(e)]
        if row.dimension == "kept":
            return self._same(inner)
        if row.dimension == "none":
            self.soft += [[one] for one in inner]
        return {}

    def _root(self, e: Any) -> Powers:
        """Return the powers of the unknown of a root: those of its last value and of its limits."""
        gap, w, last, low, high = e.args[:5]
        self.walk(gap)
        return self._same([self.walk(one) for one in (w, last, low, high)])

    def _condition(self, c: Any) -> None:
        if c.is_Relational:
            self._same([self.walk(c.lhs), self.walk(c.rhs)])
        else:
            for a in c.args:
                self._condition(a)

    def _same(self, parts: list[Powers]) -> Powers:
        """Return the powers that all parts have."""
        found = self._fresh()
        self.groups += 1
        self.hard += [(self.groups, plus(one, found, -1)) for one in parts]
        return found

    def _fresh(self) -> Powers:
        self.groups += 1
        return {Unknown("place", self.groups): Fraction(1)}

    # -- the solution ----------------------------------------------------------------------------------------------

    def unit(self, powers: Powers) -> dict[str, Fraction] | None:
        """Return what is left when the unknowns are put in; None where some stay free."""
        if self.solved is None:
            self.solved = self._solution()
        found = {key: p for key, p in _put(powers, self.solved).items() if not isinstance(key, Relation)}
        return None if any(isinstance(key, Unknown) for key in found) else found

    def _solution(self) -> dict[Any, Powers]:
        left_out: set[int] = set()
        while True:
            solved: dict[Any, Powers] = {}
            for i, (group, row) in enumerate(self.hard):
                if group not in left_out:
                    against = _taken(solved, row, Relation(i))
                    if against:
                        left_out |= {self.hard[j][0] for j in against}
                        break
            else:
                break
        for belief in self.soft:
            for row in belief:
                if _taken(solved, row, Relation(len(self.hard))):
                    break
        return solved


def _put(row: Powers, solved: Mapping[Any, Powers]) -> Powers:
    """Put in what is solved: solved unknowns stand in no other solution."""
    found = row
    for key in [key for key in row if key in solved]:
        found = plus({k: p for k, p in found.items() if k != key}, solved[key], row[key])
    return found


def _taken(solved: dict[Any, Powers], row: Powers, mark: Relation) -> list[int]:
    """Take a row that must be no unit into a solution; return the rows that contradict, this one among them."""
    found = plus(_put(row, solved), {mark: Fraction(1)})
    unknown = next((key for key in found if isinstance(key, Unknown)), None)
    if unknown is None:
        used = [key.number for key in found if isinstance(key, Relation)]
        return used if len(used) < len(found) else []
    own = {key: -power / found[unknown] for key, power in found.items() if key != unknown}
    for key, old in solved.items():
        if unknown in old:
            solved[key] = _put(old, {unknown: own})
    solved[unknown] = own
    return []
