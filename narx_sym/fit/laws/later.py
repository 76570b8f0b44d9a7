"""What is taken on a flat piece is chosen later: by what the reference asks of the samples that follow.

Every input on a flat piece gives the same sample, but what an older input adds to later ones differs. Where the input
nearest to the last one leaves none for a later sample, the last few inputs m are moved together from what the law took,
as few as can be, until the model gives the reference there:

    sum_k (y[k] - r[k])^2 = 0

by Levenberg-Marquardt, whose steps are the shortest ones. The sample of a flat piece has no slope in its own input, so
that there it is the later samples that move it. Where the way there leads over an edge, `lookback` tries single inputs.
A law that goes on from sample to sample, on a machine, cannot do so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import sympy as sp
from scipy.optimize import least_squares

from ...engines.compile import compile
from ...inversion.compensator import Compensator
from ...inversion.stages import in_order
from ...symbolic.signals import k, signal
from .driven import FREE, Prepared

Array = np.ndarray
STRETCHES = (2, 4, 8, 16, 32, 64, 128)  # samples up to a miss that are moved together: the fewest that do
STEPS, EXACT = 60, 1e-15  # of a search; where it ends
DIFFERENCES = (None, 1e-6)  # steps of an input, as SciPy has them: near its kinks first, then far above rounding
ASKED = signal("m_taken")


class Later:
    """The runs of a law some of whose inputs are given.

    Parameters
    ----------
    target : (N,) array, the reference [unit of y]
    start : number, the input before it [unit of u]
    missed : function of an output, (n,), that returns its first sample that is not the reference, or None
    within : number, a gap that is none [unit of y]
    """

    def __init__(
        self, law: Compensator, target: Array, start: float, channels: Mapping[str, Any],
        missed: Callable[[Array], int | None], within: float,
    ):  # fmt: skip
        assert law.staged is not None
        made = law.beside(lambda asked: sp.Piecewise((ASKED[k], ASKED[k] < FREE), (asked, True)))
        self.prepared = Prepared.of(law, compile(in_order(made, law.symbols)), target, start, channels)
        self.target, self.missed, self.within = target, missed, within
        self.delay, self.taken = law.staged.delay, np.full(target.size, FREE)
        self.stretches = 0

    def reached(self) -> dict[str, Array] | None:
        """Return every sequence of a run that misses nothing; None where none was found."""
        values, before = self._run({}, 0), -1
        while (missed := self.missed(values["y"][self.prepared.depth :])) is not None:
            begins = dict.fromkeys(max(0, missed + 1 - size) for size in STRETCHES)
            moved = (
                (begin, found) for begin in begins if (found := self._moved(values, begin, missed + 1)) is not None
            )
            begin, found = next(moved, (0, None))
            if found is None or missed <= before:
                return None
            self.taken[begin : missed + 1], before = found, missed
            values = self._run(values, begin)
            self.stretches += 1
        return self.prepared.shown({**values, "m_wanted": values["m"]})

    def _run(self, values: Mapping[str, Array], begin: int) -> dict[str, Array]:
        return self.prepared.run({ASKED.name: (self.taken, FREE)}, values, begin, self.target.size)

    def _moved(self, values: Mapping[str, Array], begin: int, end: int) -> Array | None:
        """Return inputs of a stretch with which nothing is missed in it, (end - begin,); None where none were found."""
        made, depth, size = self.prepared, self.prepared.depth, end - begin
        ahead = made.compiled.recursion.lead
        given = {name: column[begin : depth + end + ahead] for name, column in made.given.items()}
        initial = {name: column[begin : begin + depth] for name, column in values.items()}
        wanted = self.target[self.delay :][begin:end]

        def gap(m: Array) -> Array:
            taken = np.concatenate([np.full(depth, FREE), m, np.full(ahead, FREE)])
            run = made.compiled({**given, ASKED.name: taken}, made.theta, initial, start=depth, on_divergence="nan")
            return np.nan_to_num(run["y"][depth : depth + size] - wanted, nan=FREE**0.25, posinf=FREE**0.25)

        tried = [values["m"][depth + begin : depth + end]]
        for step in DIFFERENCES:
            options = {"diff_step": step, "max_nfev": STEPS, "xtol": EXACT, "ftol": EXACT, "gtol": EXACT}
            tried.append(least_squares(gap, tried[-1], method="lm", **options).x)
        best = min(tried, key=lambda m: np.abs(gap(m)).max())
        return best if np.abs(gap(best)).max() <= self.within else None
