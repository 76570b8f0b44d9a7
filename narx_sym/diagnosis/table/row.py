"""A row of the table: one hypothesis, fitted and judged."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...data.evidence.several import rests
from ...data.record import Record
from ...engines.algebra import filtered
from ...fit.bases.integrating import DRIVEN, drives, poles, slowest
from ...models.extend import Variant
from ...symbolic.identities import added
from ..bases import joined, spaced
from ..settings import FORGOTTEN, OF_FEW, RIVALS
from .frame import Frame
from .hypotheses import Core, Hypothesis, filters, slopes
from .starts.arx import polynomial
from .verdict import price

Array = np.ndarray


@dataclass(eq=False)
class Row:
    """One hypothesis of the table, fitted: what it costs, and what it leaves of the error.

    Attributes
    ----------
    values : (n,) array
        The unknowns of its frame.
    fitted : float
        Mean squared free-run error where it was fitted, over the variance of y.
    parameters : int
    blocks, weights : (BLOCKS,) array
        The error on each block where the other folds fitted it, and its samples; empty where it was not judged.
    more : int
        What it does that the base does not, each like an effect: the memory of a core beside a static base, a further
        resonance beside a linear one, and a lag of an effect's own that is no pole of the best core without effects.
    """

    hypothesis: Hypothesis
    frame: Frame
    values: Array
    fitted: float
    parameters: int
    blocks: Array = field(default_factory=lambda: np.zeros(0))
    weights: Array = field(default_factory=lambda: np.zeros(0))
    shape: tuple[float, ...] = ()  # from which its last effect was fitted
    more: int = 0

    @cached_property
    def held(self) -> float:
        """Mean squared held-out error, over the variance of y."""
        w, seen = self.weights, self.weights > 0
        return float(self.blocks[seen] @ w[seen] / w.sum()) if self.blocks.size else np.inf

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids of its effects."""
        return self.hypothesis.ids

    @property
    def becomes(self) -> frozenset[str]:
        """The ids of effects that one of its own is at a limit of its shape."""
        return frozenset(v.effect.limit[2] for v in self.hypothesis.effects if v.effect.limit)

    @property
    def a(self) -> Array:
        """The coefficients of older outputs in its core, (n_y,)."""
        return self.values[: self.hypothesis.core.n_y]

    @property
    def size(self) -> Core:
        """Its core without the delays, which are tuned for each."""
        return self.hypothesis.core.at_once

    @property
    def count(self) -> int:
        """How many effects it has, with what its core does like one."""
        return len(self.hypothesis.effects) + self.more

    @cached_property
    def charged(self) -> float:
        """How many effects it pays for: a sum of like parts with weights of both signs is two, one against another.

        What only filters beside another effect is one of few, and stands where more lags of the core would.
        """
        added = zip(self.hypothesis.effects, self.frame.added, strict=True)
        weights = (self.values[cs] for variant, (cs, _) in added if variant.effect.weights)
        filtering = sum(filters(v.effect) for v in self.hypothesis.effects)
        few = filtering if filtering < len(self.hypothesis.effects) else 0
        return self.count - few * (1 - OF_FEW) + sum(int(w.min() < 0 < w.max()) for w in weights)

    @property
    def met_at_rest(self) -> bool:
        """Whether the last effect, where it ends a way, acts where the output is what the input makes of it at rest.

        The input passes the poles alone, by the gain at rest: a swing may reach an end, but what only the changes of
        the input reach is no end of a way. Where the input, time or a channel moves other effects too, any may.
        """
        core, a = self.hypothesis.core, self.a
        if core.given or not any(v.effect.at_rest for v in self.hypothesis.effects[-1:]):
            return True
        b, constant = np.split(self.values[self.frame.used(core)][core.n_y :][: core.b + 1], [core.b])
        others = self.hypothesis.effects[:-1]
        if core.integrating or slowest(a) >= 1 or any(v.driver != "y" for v in others):
            return True
        measured, seen, denominator = self.frame.measured(), [], polynomial(a)
        for record in measured:
            gains = b.reshape(-1, core.n_u).sum(axis=1)
            driven = constant + added(g * record.signals[n] for g, (n, _) in zip(gains, core.inputs, strict=True))
            seen.append(driven[0] / denominator.sum() + filtered(denominator, driven - driven[0]))
        shape = self.values[self.frame.added[-1][1]]
        return any(z.any() for z in self.frame.contributions(measured, shape, seen))

    @cached_property
    def paid(self) -> float:
        """How many parameters it pays for: its own, and where its core and its memories begin in each segment.

        A start counts for the share of the segment until it is forgotten; one that never is, is a constant of its own.
        That of an axis that integrates is one for every hypothesis, and counts for none.
        """
        core, x, problem = self.hypothesis.core, self.values, self.frame.problem
        remembered = [j for j, start in enumerate(problem.starts) if start.back is None]
        sizes = [] if core.given else sorted(np.abs(poles(self.a)))[: core.n_y - core.integrating]
        last = [-1 / np.log(p) if p < 1 else np.inf for p in sizes if p]
        shares = added(min(1.0, samples / len(s)) for s in self.frame.segments for samples in last)
        self.frame.late(core)
        for i in range(len(problem.data) if remembered else 0):
            moved = problem.moved(i, problem.theta(x), x[problem.own(i)])[1][problem.depth - 1 :]
            for j in remembered:
                left = np.abs(moved[:, j - len(problem.starts)])
                if left.max() > 0:
                    shares += float(np.flatnonzero(left >= left.max() * FORGOTTEN)[-1] + 1) / left.size
        return self.parameters + shares

    @cached_property
    def goes_back(self) -> bool:
        """Whether what the last effect remembers goes back on its way within a segment: on one way it is a curve."""
        problem, x, names = self.frame.problem, self.values, self.states
        self.frame.late(self.hypothesis.core)
        for i in range(len(problem.data)):
            runs = problem.walked(i, x, x[problem.own(i)])
            steps = (np.diff(runs[n][problem.depth - 1 :]) for n in names)
            if any(s.min() < 0 < s.max() for s in steps):
                return True
        return not names

    def driven(self, records: Sequence[Record], slow: float, error: float) -> bool:
        """Whether the input drives the poles of its core that hardly decay; `error` is what is left with them.

        Of records that each answer a step at its beginning the run without the input tells.

        Parameters
        ----------
        records : as they are fitted, in pieces where the axis integrates
        slow : the pole from which on one hardly decays
        error : mean square over the variance of y
        """
        core = self.hypothesis.core
        if not rests(records):
            return drives(self.a, core.n_u, core.inputs, records, slow, error * self.frame.problem.spread**2)
        x = self.values.copy()
        x[self.frame.used(core)[core.n_y : core.n_y + core.b]] = 0.0
        return self.frame.error(x, core) > DRIVEN * error

    @property
    def expands(self) -> set[str]:
        """Of what other effects one of its own is the Taylor polynomial: it takes away, and turns back beyond the data.

        A cubic that falls is a saturation, which costs as much and means something outside the data too. What turns
        back where the input goes is none.
        """
        model, found = self.frame.problem.model, set[str]()
        for variant, (cs, _) in zip(self.hypothesis.effects, self.frame.added, strict=True):
            if variant.effect.series:
                degree, other = variant.effect.series
                middle = 0.0 if variant.raw or variant.at else float(model.operating_point.get(model.input, 0.0))
                most = max(float(np.max(np.abs(r.signals[variant.at or "u"] - middle))) for r in self.frame.segments)
                if -1 < degree * float(self.values[cs[0]]) * most ** (degree - 1) < 0:
                    found.add(other)
        return found

    @property
    def linearised(self) -> Array:
        """The coefficients of older outputs in its core, with what its effects add nearly everywhere, (n_y,).

        A tank whose outflow is the effect is an integrator without it, and no integrator with it. Between end stops
        nothing is added. What is added is that at nine of ten samples at least.
        """
        core, x, frame, a = self.hypothesis.core, self.values, self.frame, self.a.copy()
        model = frame.problem.model
        measured = np.concatenate([d[frame.problem.name] for d in frame.problem.data])
        for variant, (cs, shapes) in zip(self.hypothesis.effects, frame.added, strict=True):
            if variant.where not in ("inside", "force") or variant.driver != "y":
                continue
            through = x[frame.used(core)][core.n_y : core.n_y + core.n_u] if variant.where == "force" else np.ones(1)
            offset = 0.0 if variant.raw else float(model.operating_point.get(model.output, 0.0))
            beside = np.concatenate([r.channels[variant.channel] for r in frame.segments]) if variant.channel else 0.0
            for i, z in enumerate(slopes(variant)):
                for j, slope in enumerate(z[: core.n_y]):
                    with np.errstate(all="ignore"):
                        added = slope(measured - offset, beside, *x[shapes])
                    often = x[cs[i]] * float(added[np.argsort(np.abs(added))[added.size // 10]])
                    a[j : j + through.size] += often * through[: core.n_y - j]
        return a

    @property
    def states(self) -> list[str]:
        """The names of what its last effect remembers."""
        model = self.frame.problem.model
        return [s.left.base.name for s in model.memory if s.group == model.effects[-1].group]

    def beyond(self, known: Row) -> tuple[Variant, ...]:
        """Return the effects that another row does not have."""
        return self.hypothesis.effects[len(known.hypothesis.effects) :]

    def falls(self, other: Row, to: float) -> bool:
        """Whether the error falls from that of another delay to a share, where both have samples that count.

        What a dead time leaves out at the beginning of each record it does not explain.
        """
        late = max(self.hypothesis.core.dead, other.hypothesis.core.dead)
        return self._after(late) < to * other._after(late)

    def _after(self, delay: int) -> float:
        errors = self.frame.errors(self.values, self.hypothesis.core)
        self.frame.judge_from(delay)
        cut = [e[rows] for e, blocks in zip(errors, self.frame.cuts[1], strict=True) for _, rows in blocks]
        return float(np.mean(np.concatenate(cut) ** 2))

    def judged(self) -> Row:
        """Score it on held-out blocks, once, and return it."""
        if not self.blocks.size:
            self.frame.late(self.hypothesis.core)
            self.blocks = self.frame.held_out(self.values, self.hypothesis.core, 6)
            self.weights = self.frame.counts
            self.__dict__.pop("held", None)  # infinite until now
        return self

    @property
    def price(self) -> float:
        """The one price: logarithm of the held-out mean square, plus what parameters and effects cost."""
        return price(self.held, self.paid, self.charged)

    @property
    def before_judged(self) -> float:
        """The same price of the error where it was fitted: it orders rows that are not judged."""
        return price(self.fitted, self.paid, self.charged)

    def __repr__(self) -> str:
        return f"Row({self.hypothesis}, nrmse {np.sqrt(self.held):.4g}, price {self.price:.3f})"


def leading(rows: Sequence[Row]) -> float:
    """Return the price of the first of some rows, before it was judged."""
    return rows[0].before_judged


def so_far(rows: Iterable[Row], base: Row) -> tuple[tuple[str, float], ...]:
    """Return the effects of the best rows in words, each with the share of the squared error that it removes."""
    found: dict[str, float] = {}
    for row in sorted((r for r in rows if r.beyond(base) and r.held < base.held), key=lambda r: r.price):
        found.setdefault(joined(spaced(v.id) for v in row.beyond(base)), 1 - row.held / base.held)
    return tuple(found.items())[:RIVALS]
