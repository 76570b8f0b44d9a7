"""Every effect is a direction: the derivative of the free run with respect to its coefficient, at zero.

z is the effect's contribution along the present free run. Inside it drives the linearised core, at the input it passes
through dF/du first, at the output it stands as it is; all three follow from one symbolic derivative.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from ...engines.algebra import single
from ...engines.compile import compile
from ...errors import ModelError
from ...fit.freerun import LARGEST, FreeRun
from ...fit.simulate import segments, shifted
from ...models.effects import EFFECTS, Catalogue, Form, Scan, effect
from ...models.extend import Variant, equations, extend, origin, own_states, variants
from ...symbolic.recursion import Recursion
from ...symbolic.sensitivity import sensitivities
from ...symbolic.signals import k, samples, sensed
from ..settings import BELOW, CYCLES, LINE, PADDING
from .contribution import contribution

Array = np.ndarray
PUSH = "injected sequence"  # no column may be called so: a name of two words is no symbol of a model


@effect({"input": "channel", "force": "channel", "inside": "channel"}, id="injection", register=False)
def injection(channel: Any) -> Any:
    """Something given acts on the model."""
    return channel[k]


@dataclass(frozen=True)
class Direction:
    """One variant at one point of its shape grid.

    Attributes
    ----------
    columns : slice
        Its columns in the matrix of all directions, one per coefficient.
    searched : float
        How many alternatives its shape was picked from by looking at the residual (1 for none).
    line : bool
        Whether it is a sharp spectral line, which no noise has.
    """

    variant: Variant
    shape: tuple[float, ...]
    columns: slice
    searched: float = 1.0
    line: bool = False


class Linearised:
    """A model at its fitted values along records: free run, residual, and the directions of whatever is added.

    Parameters
    ----------
    problem : FreeRun
        Of all samples of the records.
    unknowns : (n,) array
        Parameters and initial shifts.
    """

    def __init__(self, problem: FreeRun, unknowns: Array):
        self.problem, self.model = problem, problem.model
        theta = problem.theta(unknowns)
        residual, slopes = problem.run(unknowns)
        self.residual = -residual * problem.spread  # measured minus simulated
        self.own = slopes * problem.spread
        self._pushed: dict[tuple[str, str, str], Any] = {}
        self._known: dict[Any, list[Array]] = {}
        self.runs: list[dict[str, Array]] = []
        for i, (data, record) in enumerate(zip(problem.data, segments(problem.records), strict=True)):
            self.runs.append({**record.channels, "t": record.t, **data, **problem.states(unknowns, i)})
        # Effects are written in the model's signals, measured from its operating point.
        self.seen = [shifted(self.model, run) for run in self.runs]
        for seen in self.seen:  # before effects act on the output, it is what the core computes
            for name in ("x", "free", "sensed"):
                seen.setdefault(name, seen[str((self.model.output if name == "sensed" else self.model.inner).label)])
            for name in own_states(self.model):
                seen.setdefault(f"{name}_free", seen[name])
            if "v" in seen:  # what acts at the input next is driven by what the first effect there lets through
                seen.setdefault("passed", seen["v"])
            for name in self.model.channels:
                if f"v_{name}" in seen:
                    seen.setdefault(f"passed_{name}", seen[f"v_{name}"])
        self.values = dict(zip(self.model.symbols, map(float, theta), strict=True))

    def contributions(self, form: Form, values: Mapping[Any, float]) -> list[Array]:
        """Return z of an effect along the free run, one (N, coefficients) array per segment."""
        key = form, tuple(values.items())
        if key not in self._known:
            self._known[key] = [contribution(form, values, seen) for seen in self.seen]
        return list(self._known[key])

    def moved(self, where: str, z: Sequence[Array], state: str = "", at: str = "") -> Array:
        """Return the directions of the free run, (rows, coefficients), that contributions at a place cause.

        `state` is the state of the model's own that they join, if they do not join the output; `at` a further input.
        """
        if where == "sensor" or (where == "output" and not any(s.left.base == sensed for s in self.model.states)):
            return np.concatenate([part[self.problem.depth :] for part in z])
        if (where, state, at) not in self._pushed:
            self._pushed[where, state, at] = self._response(where, state, at)
        recursion, name = self._pushed[where, state, at]
        if name is None:
            return np.zeros((self.problem.edges[-1], z[0].shape[1]))
        compiled = compile(recursion)
        theta = [self.values[p] for p in recursion.parameters]
        zero = dict.fromkeys((s.name for s in recursion.states), 0.0)
        parts = []
        for run, columns in zip(self.runs, z, strict=True):
            found = np.empty(columns.shape, order="F")
            for j in range(columns.shape[1]):
                moved = compiled(
                    {**run, PUSH: columns[:, j]}, theta, zero, on_divergence="nan", start=self.problem.depth
                )
                found[:, j] = moved[name]
            parts.append(found[self.problem.depth :])
        return np.concatenate(parts)

    def _response(self, where: str, state: str, at: str) -> tuple[Recursion, str | None]:
        """Derive how the output moves when a given sequence is injected; the run itself is an input of it.

        The name is None where nothing moves: at the input of a core that has lost it.
        """
        added = extend(self.model, Variant(injection, where, state or "channel", PUSH, at=at))
        (c,) = added.coefficients
        full, (direction,) = sensitivities(added.model.recursion, [c])
        own = len(added.model.recursion.updates)
        # At c = 0 the input that the core sees is u itself.
        known = {c: sp.S.Zero}
        updates = [(left, right.xreplace(known)) for left, right in full.updates[own:]]
        before = {left.base for left, _ in added.model.recursion.updates} - {b for b in self.model.recursion.states}
        for base in before:
            definition = next(r for left, r in added.model.recursion.updates if left.base == base).xreplace(known)
            updates = [
                (left, right.xreplace({s: definition.xreplace({k: s.indices[0]}) for s in samples(right, base)}))
                for left, right in updates
            ]
        moved = direction.get(self.model.output)
        return Recursion(tuple(updates), self.model.symbols), None if moved is None else moved.name

    def scale(self, scan: Scan, variant: Variant) -> list[float]:
        """Return the grid of one shape parameter."""
        drivers = {n: n for n in own_states(self.model)} | {"y": self.model.inner.name}
        driver = drivers.get(variant.driver, variant.at or self.model.input.name)
        offset = origin(self.model, variant.driver) if variant.raw else 0.0
        x = np.concatenate([seen[driver] for seen in self.seen]) + offset
        Ts, n = self.model.Ts or 1.0, max(len(r) for r in (s[driver] for s in self.seen))
        if scan.of == "ratio":
            return list(scan.values)
        if scan.of == "peaks":
            return self._peaks(len(scan.values))
        if scan.of in ("amplitude", "depth"):
            below = -float(np.quantile(x, 0.02)) if scan.of == "depth" else 0.0
            unit = max(below, 0.0) or float(np.quantile(np.abs(x), 0.98)) or 1.0
        elif scan.of == "speed":
            moving = np.abs(np.concatenate([np.diff(s[driver]) for s in self.seen]))
            unit = float(np.sqrt(np.mean(moving**2))) or 1.0
        elif scan.of == "stroke":
            way = [np.cumsum(s[driver] - s[driver].mean()) * Ts for s in self.seen]
            unit = max(float(np.ptp(w)) for w in way) / 2 or 1.0
        elif scan.of == "time":
            low, high = 3 * Ts, max(n * Ts / 4, 30 * Ts)
            return [low * (high / low) ** v for v in scan.values]
        elif scan.of == "gain":
            y = np.concatenate([r[self.model.output.name] for r in self.runs])
            unit = float(np.abs(np.polyfit(x, y, 1)[0])) or 1.0
        else:
            raise ModelError(f"Unknown scan rule {scan.of!r}.")
        if scan.per_channel:
            beside = np.abs(np.concatenate([seen[str(variant.channel)] for seen in self.seen]))
            unit /= float(np.quantile(beside, 0.98)) or 1.0
        return [float(x) for x in single([v * unit**scan.power for v in scan.values])]

    def grid(self, variant: Variant) -> list[tuple[float, ...]]:
        """Return the shapes from which an effect is tried."""
        return list(product(*(self.scale(variant.effect.scan[p], variant) for p in variant.shape)))

    def ranges(self, variant: Variant) -> dict[str, tuple[float, float]]:
        """Return how far each shape parameter may leave its grid."""
        found = {}
        for name in variant.shape:
            scan = variant.effect.scan[name]
            grid = self.scale(scan, variant)
            if grid:
                most = max(grid) * scan.beyond
                least = -most if scan.signed else min(grid) / BELOW
                found[name] = (min(grid), max(grid)) if scan.of == "ratio" else (least, most)
        return found

    def _peaks(self, count: int) -> list[float]:
        """Return the strongest frequencies of the residual [Hz], from its first segment.

        At least `CYCLES` periods must be seen. At multiples of a periodic input's frequency a disturbance cannot be
        told from what the input causes.
        """
        frequencies, power = self._spectrum
        at = _peaks_apart(power, 2 * PADDING)
        at = at[(at >= CYCLES * PADDING) & ~self._of_input(at)]
        best = at[np.argsort(-power[at], kind="stable")[:count]]
        return [float(frequencies[i]) for i in best]

    def _of_input(self, at: Array) -> Array:
        """Whether bins of the spectrum are multiples of the frequency that holds most of the input's power.

        A line that is not seen four times cannot be told from the slow end of a random input. What bends shows in low
        multiples first: a line above all lower ones, from the fourth on, is near a multiple by chance.
        """
        u = self.runs[0][self.model.input.name][self.problem.depth :]
        power = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(u.size), PADDING * u.size)) ** 2
        peak = int(np.argmax(power))
        if peak < 4 * PADDING or power[max(0, peak - 3 * PADDING) : peak + 3 * PADDING].sum() < power.sum() / 2:
            return np.zeros(at.size, dtype=bool)
        order = np.maximum(1, np.round(at / peak)).astype(int)
        left, near = self._spectrum[1], 2 * PADDING
        tops = [
            left[max(0, n * peak - near) : n * peak + near].max(initial=0.0) for n in range(1, order.max(initial=1) + 1)
        ]
        lower = np.concatenate([[np.inf] * 3, np.maximum.accumulate(tops[1:])[1:]])  # of multiples 4 and more
        return np.asarray((np.abs(at - peak * order) < near) & (left[at] <= lower[order - 1]))

    @cached_property
    def _spectrum(self) -> tuple[Array, Array]:
        """Frequencies [Hz] and power of the residual's first segment; what is slower than two periods is zero."""
        e = self.residual[: max(self.problem.edges[1], 16)]
        e = e - np.polyval(np.polyfit(np.arange(e.size), e, 1), np.arange(e.size))
        power = np.abs(np.fft.rfft(e * np.hanning(e.size), PADDING * e.size)) ** 2
        power[: 2 * PADDING] = 0.0
        return np.arange(power.size) / (PADDING * e.size * (self.model.Ts or 1.0)), power

    def tone(self) -> Array:
        """Return cosine and sine of the residual's strongest frequency, (rows, 2), or (rows, 0) if it is no line."""
        times = np.concatenate([run["t"][self.problem.depth :] for run in self.runs])
        lines = [f for f in self._peaks(1) if self.is_line(f)]
        return np.column_stack(
            [times[:, None][:, :0], *(w(2 * np.pi * f * times) for f in lines for w in (np.cos, np.sin))]
        )

    def is_line(self, frequency: float) -> bool:
        """Whether the residual has a sharp spectral line there: far above its neighbourhood on both sides."""
        frequencies, power = self._spectrum
        at = int(np.argmin(np.abs(frequencies - frequency)))
        near, far = 3 * PADDING, 25 * PADDING
        sides = [power[max(2 * PADDING, at - far) : max(0, at - near)], power[at + near : at + far]]
        medians = [float(np.median(s)) for s in sides if s.size > near]
        return bool(medians) and power[at] > LINE * np.log(power.size / PADDING) * max(medians)

    def directions(self, channels: Iterable[str] = (), catalogue: Catalogue = EFFECTS) -> tuple[list[Direction], Array]:
        """Return every variant at every grid point, and the matrix of their directions (rows, columns)."""
        listed, blocks, at, own = [], [], 0, own_states(self.model)
        for variant in variants(self.model, channels, catalogue):
            form = equations(self.model, variant)
            picked = any(variant.effect.scan[p].of == "peaks" for p in variant.shape)
            searched = self._spectrum[1].size / PADDING if picked else 1.0
            symbols = [sp.Symbol(p, real=True) for p in variant.shape]
            for point in self.grid(variant):
                z = self.contributions(form, dict(zip(symbols, point, strict=True)))
                block = self.moved(variant.where, z, variant.driver if variant.driver in own else "", variant.at)
                if not 0 < np.abs(block).max(initial=0.0) < LARGEST:  # nothing, or what runs away
                    continue
                line = picked and self.is_line(point[0])
                listed.append(Direction(variant, point, slice(at, at + block.shape[1]), searched, line))
                blocks.append(block)
                at += block.shape[1]
        if not blocks:
            only = f"The effect {next(iter(catalogue))} does not apply" if len(catalogue) == 1 else ""
            raise ModelError(f"{only or 'No effect of the catalogue applies'} to this model.")
        return listed, np.concatenate(blocks, axis=1)


def _peaks_apart(power: Array, apart: int) -> Array:
    """Return where maxima are, each the highest within so many bins, in their order."""
    inner = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    kept = np.zeros(power.size, dtype=bool)
    for i in inner[np.argsort(-power[inner], kind="stable")]:
        kept[i] = not kept[max(0, i - apart + 1) : i + apart].any()
    return np.flatnonzero(kept)
