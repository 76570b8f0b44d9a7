"""Which sequence reads which, at which lags: the graph of an ordered list of update equations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp

from .signals import expand_phi, lag, samples


@dataclass(frozen=True)
class Graph:
    """Which sequences each computed sequence reads, and at which lags.

    Attributes
    ----------
    reads : mapping from each computed sequence to the sequences it reads, and these to their lags, smallest first
    """

    reads: Mapping[Any, Mapping[Any, tuple[int, ...]]]

    @classmethod
    def of(cls, updates: Iterable[tuple[Any, Any]]) -> Graph:
        """Return the graph of (left side at k, right side) pairs."""
        return cls({left.base: read(right) for left, right in updates})

    def reached(self, *starts: Any) -> set[Any]:
        """Return what some sequences read, themselves and through others."""
        found: set[Any] = set()
        more = {there for base in starts for there in self.reads.get(base, ())}
        while more:
            found |= more
            more = {there for base in more for there in self.reads.get(base, ())} - found
        return found

    @cached_property
    def recurrent(self) -> frozenset[Any]:
        """The sequences that depend on their own past, through each other too."""
        return frozenset(base for base in self.reads if base in self.reached(base))

    def without(self, *bases: Any) -> Graph:
        """Return the graph as if some sequences were neither computed nor read."""
        kept = {b: there for b, there in self.reads.items() if b not in bases}
        return Graph({b: {c: at for c, at in there.items() if c not in bases} for b, there in kept.items()})

    def delays(self, source: Any) -> dict[Any, int | None]:
        """Return after how many samples a sequence reaches each computed one, None where it does not."""
        found: dict[Any, int | None] = dict.fromkeys(self.reads)
        for _ in self.reads:
            for base in self.reads:
                found[base] = min((d for d, _ in self._arrivals(base, source, found)), default=None)
        return found

    def fastest(self, source: Any) -> Graph:
        """Return the graph of the ways on which a sequence arrives first."""
        delays = self.delays(source)
        first = {
            base: [(there, d) for d, there in self._arrivals(base, source, delays) if d == delays[base]]
            for base in self.reads
        }
        known = {source: 0} | delays
        return Graph({b: {there: (d - (known[there] or 0),) for there, d in ways} for b, ways in first.items()})

    def _arrivals(self, base: Any, source: Any, delays: Mapping[Any, int | None]) -> list[tuple[int, Any]]:
        """Return the delays at which a source reaches a sequence, each with what it comes through."""
        known = {source: 0} | {b: d for b, d in delays.items() if d is not None}
        return [(at + known[there], there) for there, lags in self.reads[base].items() if there in known for at in lags]


def read(expr: Any) -> dict[Any, tuple[int, ...]]:
    """Return the sequences that an expression reads, with their lags, smallest first."""
    found: dict[Any, set[int]] = {}
    for s in samples(expand_phi(sp.sympify(expr))):
        found.setdefault(s.base, set()).add(lag(s))
    return {base: tuple(sorted(lags)) for base, lags in found.items()}
