"""Pools of candidate terms: products of lagged signals, without what a rule excludes and what is there already."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from math import comb
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.functions import TABLE
from ..symbolic.identities import canonical, independent
from ..symbolic.signals import RESERVED, differences, k, signal, u, y
from . import assumptions
from .info import whole

MAX_POOL = 20_000
FUNCTIONS = {row.name: row.cls for row in TABLE if row.everywhere and not row.extreme}


def lagged(lags: Mapping[str, Any], named: Mapping[str, Any] | None = None) -> list[Any]:
    """Return samples of sequences by name: `{"w": 2}` gives w[k], w[k-1], w[k-2]; y begins at y[k-1].

    Parameters
    ----------
    lags : mapping from names to an int (the largest lag), a range or a list
    named : sequences that have other names than their own

    Raises
    ------
    ModelError
        For a name that means something else in equations.
    """
    taken = [n for n in lags if n in RESERVED and n not in ("u", "y", *(named or ()))]
    if taken:
        raise ModelError(f"{taken[0]!r} means something else in equations: give that channel another name.")
    steps = {n: range(n == "y", w + 1) if isinstance(w, int) else w for n, w in lags.items()}
    return [((named or {}).get(n) or signal(n))[k - i] for n, listed in steps.items() for i in listed]


@dataclass(frozen=True)
class Pool(printing.InLatex):
    """Candidate terms for `select`, and the excluded terms, each with the reason; see `pool` for an example."""

    terms: list[Any]
    excluded: list[assumptions.Violation]
    duplicates: dict[Any, str]
    structure: assumptions.Structure
    rules: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.terms)

    def __iter__(self) -> Any:
        return iter(self.terms)

    def latex(self) -> str:
        """LaTeX of the terms, separated by commas."""
        return r",\; ".join(map(printing.latex, self.terms))

    def __repr__(self) -> str:
        banned = len({v.term for v in self.excluded})
        return f"Pool({len(self.terms)} terms; {banned} excluded by rule, {len(self.duplicates)} duplicates)"


def pool(
    n_y: int = 1,
    n_u: int = 2,
    degree: int = 3,
    delay: int = 1,
    *,
    rules: Sequence[str] = (),
    lags: Mapping[str, Any] | None = None,
    functions: Iterable[str] = (),
    phi: bool = True,
    constant: bool = False,
    inverse: bool = False,
) -> Pool:
    """List the candidate terms of a NARX model: products up to `degree` of lagged outputs, inputs, phi1 and phi2.

    Parameters
    ----------
    n_y, n_u : int
        Largest lags of the output and of the input [samples].
    degree : int
        Largest degree of the products, the paper's l.
    delay : int
        tau_d >= 0, the smallest lag of the input [samples].
    rules : names of `assumptions.RULES`
        Terms that violate a rule are excluded; `excluded` lists them with the reason.
    lags : mapping, optional
        Lags of "y", "u", "phi1", "phi2" or a channel, instead: an int n (0 ... n, for y 1 ... n), a range or a list.
    functions : names among abs, sin, cos, tanh, exp, sign
        Functions of each lagged sample (abs also of phi1) to use as further factors.
    phi : bool
        Whether phi1 and phi2 are used.
    constant : bool
        Whether the constant 1 is a candidate.
    inverse : bool
        Exchange y and u, for an identified inverse.

    Returns
    -------
    Pool
        Without terms that are equal to a combination of others.

    Raises
    ------
    ModelError
        For invalid sizes, lags below the delay, an unknown function, or a reserved channel name.

    Examples
    --------
    >>> import narx_sym as ns
    >>> candidates = ns.pool(n_y=1, n_u=1, degree=1)
    >>> candidates.terms
    [y[k - 1], phi1[k - 1], phi2[k - 1], u[k - 1]]
    """
    output, source = (u, y) if inverse else (y, u)
    first, second = differences(source)
    whole(n_y=n_y, n_u=n_u, degree=degree, delay=delay)
    if delay < 0 or n_u < delay or n_y < 0 or degree < 1:
        raise ModelError(f"A pool needs n_y >= 0, degree >= 1 and n_u >= delay >= 0; got n_u = {n_u}, delay = {delay}.")
    chosen: dict[str, Any] = {
        output.name: range(1, n_y + 1),
        "phi1": range(delay, n_u + 1) if phi else (),
        "phi2": range(delay, n_u + 1) if phi else (),
        source.name: range(delay, n_u + 1),
    }
    factors = lagged(chosen | dict(lags or {}), {"phi1": first, "phi2": second})
    for name in functions:
        if name not in FUNCTIONS:
            raise ModelError(f"Unknown function {name!r}; there are {', '.join(FUNCTIONS)}.")
        plain = [s for s in factors if isinstance(s, sp.Indexed) and s.base != second]
        factors += [FUNCTIONS[name](s) for s in plain]
    wanted = comb(len(factors) + degree, degree)
    if wanted > MAX_POOL:
        raise ModelError(
            f"The pool would have {wanted} terms ({len(factors)} factors, degree {degree}); at most {MAX_POOL} are "
            "built. Lower n_y, n_u or the degree, or name the lags."
        )
    structure = assumptions.Structure(output, source, delay)
    terms: list[Any] = [sp.S.One] if constant else []
    seen = set(terms)
    for size in range(1, degree + 1):
        for product in combinations_with_replacement(factors, size):
            term = sp.Mul(*product)
            if term not in seen:
                seen.add(term)
                terms.append(term)
    # Shortened first: phi2^2 phi1 is phi1, and must not slip past a rule that excludes phi1.
    shortened = {t: short for t in terms if (short := canonical(t)) != t and short in seen}
    excluded = assumptions.violations([t for t in terms if t not in shortened], rules, structure)
    banned = {v.term for v in excluded}
    kept, duplicates = independent([t for t in terms if t not in banned and t not in shortened])
    duplicates |= {t: f"= {printing.text(short)}" for t, short in shortened.items()}
    return Pool(kept, excluded, duplicates, structure, tuple(rules))
