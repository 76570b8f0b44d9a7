"""The unknowns that a core leaves free, as a map between them and all unknowns of a frame.

No product goes through BLAS: last digits that differ between its kernels would grow, step by step, where a fit meets
kinks.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ...engines.algebra import single
from ...fit.constraints import Elimination

Array = np.ndarray


class Span:
    """The points x = t0 + T w: nearly all columns of T are those of the identity.

    Parameters
    ----------
    t0 : (n,) array
    T : (n, m) array
    """

    def __init__(self, t0: Array, T: Array):
        self.t0, self.T = t0, T
        self._own = np.argmax(T == 1.0, axis=0)  # T is one there, and a few rows have more
        rest = T.copy()
        rest[self._own, np.arange(T.shape[1])] -= 1.0
        self._more = [(int(r), rest[r]) for r in np.flatnonzero(rest.any(axis=1))]
        self._picked = np.ix_(self._own, self._own)

    @classmethod
    def of(cls, equations: Sequence[Any], symbols: Sequence[Any], size: int) -> Span:
        """Return the points whose first unknowns, the `symbols`, keep equations; the others, up to `size`, are free."""
        t0, T = np.zeros(size), np.eye(size)
        if equations:
            rule = Elimination.of(equations, symbols)
            n, free = rule.Z.shape
            t0[:n], T = rule.t0, np.eye(size, free + size - n, free - n)
            T[:n, :free] = rule.Z
        return cls(t0, T)

    def where_one(self, unknowns: Sequence[int]) -> Span:
        """Return those points at which some unknowns are 1."""
        at, t0 = list(unknowns), self.t0.copy()
        t0[at] = 1.0
        return Span(t0, np.delete(self.T, np.flatnonzero(self.T[at].any(axis=0)), axis=1)) if at else self

    @property
    def size(self) -> int:
        """How many directions there are."""
        return int(self.T.shape[1])

    def last(self, count: int) -> Span:
        """Return the last ones alone."""
        return self if count == self.size else Span(self.t0, self.T[:, self.size - count :])

    @cached_property
    def _turned(self) -> Array:
        return np.ascontiguousarray(self.T.T)

    def rounded(self, x: Array) -> Array:
        """Return a point with w in single precision, (n,); itself where w cannot be read off it."""
        read = len(set(self._own.tolist())) == self.size and not any(r in self._own for r, _ in self._more)
        return self.t0 + self.along(single(x[self._own])) if read else x

    def squared(self, G: Array) -> Array:
        """Return T'G T, (m, m), of a symmetric (n, n) array."""
        if not self._more:
            return np.asarray(G[self._picked])
        right = G[:, self._own]
        for r, weights in self._more:
            right = right + G[:, r, None] * weights
        found = right[self._own]
        for r, weights in self._more:
            found = found + weights[:, None] * right[r]
        return found

    def across(self, v: Array) -> Array:
        """Return T'v, (m,)."""
        return np.asarray(np.add.reduce(self._turned * v, axis=1)) if self._more else v[self._own]

    def along(self, w: Array) -> Array:
        """Return T w, (n,)."""
        if self._more:
            return np.asarray(np.add.reduce(self.T * w, axis=1))
        moved = np.zeros(len(self.T))
        moved[self._own] = w
        return moved
