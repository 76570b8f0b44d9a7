"""Linear constraints on the parameters: (S, c) derived from equations, and eliminated before a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from scipy.linalg import qr, solve_triangular

from ..errors import FitError
from ..models.analysis import constraint_matrix
from ..models.model import Model
from ..models.rest.equilibria import continuum_conditions

Array = np.ndarray


@dataclass(frozen=True)
class Elimination:
    """theta = t0 + Z z solves S theta = c for every z; Z has orthonormal columns."""

    t0: Array
    Z: Array

    @classmethod
    def of(cls, equations: Sequence[Any], symbols: Sequence[Any]) -> Elimination:
        """Derive (S, c) from the equations by linear algebra on the symbols and eliminate by QR."""
        n = len(symbols)
        if not equations:
            return cls(np.zeros(n), np.eye(n))
        S_symbolic, c_symbolic = constraint_matrix(equations, symbols)
        S, c = np.array(S_symbolic, dtype=float), np.array(c_symbolic, dtype=float).ravel()
        # What an equation says does not depend on its unit: each is scaled to a largest coefficient of 1.
        scale = np.abs(S).max(axis=1, initial=0.0)
        S, c = S / np.where(scale > 0, scale, 1.0)[:, None], c / np.where(scale > 0, scale, 1.0)
        t0, fixed = np.zeros(n), np.zeros(n, dtype=bool)
        # A constraint that leaves one parameter free fixes it, exactly; what it fixes may make others so.
        while True:
            open_ = S * ~fixed
            rest = c - S[:, fixed] @ t0[fixed]
            lone = [i for i in range(len(S)) if np.count_nonzero(open_[i]) == 1]
            if not lone:
                break
            at = int(np.flatnonzero(open_[lone[0]])[0])
            t0[at], fixed[at] = rest[lone[0]] / S[lone[0], at], True
        free = np.flatnonzero(~fixed)
        Z = np.eye(n)[:, free]
        rows = np.any(open_ != 0, axis=1)
        if rows.any():
            Q, R, order = qr(open_[rows][:, free].T, pivoting=True)
            rank = int(np.sum(np.abs(np.diag(R)) > 1e-12 * max(1.0, abs(R[0, 0]))))
            t0[free] = Q[:, :rank] @ solve_triangular(R[:rank, :rank], rest[rows][order][:rank], trans="T")
            Z = Z @ Q[:, rank:]
        if not np.allclose(S @ t0, c, rtol=1e-10, atol=1e-12):
            raise FitError("The constraints contradict each other.")
        return cls(t0, Z)


def constraint_equations(model: Model, constraints: Sequence[Any] | str | None) -> list[Any]:
    """Return the equations; the word "continuum" stands for all conditions of Lemma 1."""
    given = model.constraints if constraints is None else constraints
    chosen = [given] if isinstance(given, str) else list(given)
    listed = []
    for c in chosen:
        if isinstance(c, str):
            if c != "continuum":
                raise FitError(
                    f"Unknown constraint {c!r}: give an equation such as Eq(model.sigma_y, 1), or 'continuum'."
                )
            listed += continuum_conditions(model)
        else:
            listed.append(c)
    if sp.false in listed:
        raise FitError("A constraint can never hold.")
    return [c for c in listed if c != sp.true]
