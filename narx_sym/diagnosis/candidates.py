"""Steps 3 to 8: score every effect, fit the best, verify them on held-out data, say which cannot be told apart."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from ..files.journal import remembered
from ..fit.bootstrap import block_length, moving_blocks
from ..fit.constraints import constraint_equations
from ..fit.freerun import FreeRun
from ..models.effects import Catalogue
from ..models.extend import Variant, equations
from ..models.model import Model
from ..symbolic import printing
from . import gate
from .bases import integrates
from .blackbox import predictable
from .directions import Direction, Linearised
from .refit import Fitted, add

Array = np.ndarray
REFITTED, FORMS = 6, 3  # effects that are fitted, and ways of each
CLOSE = 1.02  # a candidate this near to the best held-out error cannot be told from it
EQUAL = 1.003  # errors this near are equal
MANY_MORE, CLEARLY = 2, 0.02  # so many parameters more must remove so much more of the error
TAKES_OVER = 0.9  # of the base's error: without a term of the base, and still better
SIMILAR = 2.0  # squared errors within this factor: the simpler explanation comes first
BELOW = 4.0  # a shape parameter may leave its grid downwards by this factor
LARGE = 0.25  # share of the held-out error: what removes more is no accident of the noise
WORSE = 1.1  # what makes the held-out error grow by more is no candidate
TARGETS = {
    "input": "v_{k} - u_{k}", "inside": r"\Delta F", "motion": r"y_{k} - \mathrm{free}_{k}", "output": "y_{k} - x_{k}",
    "sensor": r"y_{k} - \mathrm{sensed}_{k}",
}  # fmt: skip
DRAWS = 200
LEAST = 0.2  # of the removable error: what is less in a bootstrap sample is no denominator


@dataclass(repr=False)
class Candidate:
    """One effect that may be missing, fitted.

    Attributes
    ----------
    effect : str
        Its id.
    variant : Variant
    fitted : Fitted
        The model that has it.
    share : float
        Of the removable error on held-out data.
    interval : (low, high)
        95 % interval of the share, by block bootstrap.
    p_value : float
        Corrected for everything that was tried.
    mean_square, before : float
        Held-out free-run error with the effect, and that of the base [unit of y squared].
    replaces : bool
        Whether it took the place of a lag or velocity term of the base.
    """

    effect: str
    variant: Variant
    fitted: Fitted
    p_value: float
    mean_square: float
    before: float
    replaces: bool = False
    share: float = 0.0
    interval: tuple[float, float] = (0.0, 0.0)

    def __repr__(self) -> str:
        return f"Candidate({self.variant}, {100 * self.share:.0f} % of the removable error)"

    @property
    def model(self) -> Model:
        """The fitted model with the effect."""
        return self.fitted.model

    @property
    def where(self) -> str:
        """The place where it acts."""
        return self.variant.where

    @property
    def parameters(self) -> dict[str, float]:
        """Coefficients c and shape parameters by their short names."""
        values = dict(zip(self.model.symbols, self.model.theta, strict=True))
        return {n: float(values[s]) for n, s in self.model.effects[-1].symbols.items()}

    @property
    def latex(self) -> str:
        """LaTeX of the contribution with what it remembers."""
        form = equations(self.model, self.variant)
        names = self.parameters
        coefficients = [n for n in names if n.startswith("c")]
        shown = [(sp.Float(f"{names[c]:.4g}"), z) for c, z in zip(coefficients, form.z, strict=False)]
        target = TARGETS[self.where]
        lines = [printing.latex_sum(sp.Symbol(target), shown)]
        lines += [f"{printing.latex(s.left)} = {printing.latex(s.right)}" for s in form.states]
        return r",\quad ".join(lines)

    @property
    def sentence(self) -> str:
        """What it is, and what adding it does, in plain words."""
        numbers = ", ".join(f"{n} = {v:.3g}" for n, v in self.parameters.items())
        return (
            f"{self.variant.effect.sentence} Adding {self.variant} with {numbers} removes {100 * self.share:.0f} % of "
            "the removable error on data that were not used for fitting."
        )


@dataclass
class Scored:
    """Step 3 to 5: directions and scores of everything in the catalogue."""

    fitted: Fitted
    line: Linearised
    channels: tuple[str, ...]
    directions: list[Direction]
    matrix: Array
    scores: gate.Scores
    rows: Array

    def extended(self, *chosen: int) -> Fitted | None:
        """Fit the model with what the chosen directions stand for; None where no stable fit is found."""
        directions = [self.directions[i] for i in chosen]
        columns = [self.matrix[self.rows, d.columns] for d in directions]
        added = [(d.variant, d.shape, self._ranges(d.variant)) for d in directions]
        return add(self.fitted, added, columns, self.residual, self.line.own[self.rows])

    def _ranges(self, variant: Variant) -> dict[str, tuple[float, float]]:
        """Return how far each shape parameter may leave its grid."""
        found = {}
        for name in variant.shape:
            scan = variant.effect.scan[name]
            grid, _ = self.line.scale(scan, variant)
            found[name] = (-3.0, 3.0) if scan.of == "ratio" else (min(grid) / BELOW, max(grid) * scan.beyond)
        return found

    @cached_property
    def structure(self) -> float:
        """Share of the held-out squared error that follows from the signals, as far as a black box can tell."""
        line, split, names = self.line, self.fitted.split, [str(d.variant) for d in self.directions]
        depends = (line.problem, line.residual, line.own, self.matrix, names, split.train, split.held, self.channels)
        given = (line, split, self.directions, self.matrix, self.channels)
        return float(remembered(predictable, *given, on=depends))

    @property
    def missing(self) -> float:
        """Share of the squared error that is no noise: what the black box tells, or a significant effect."""
        significant = self.scores.p_value <= gate.LEVEL
        return max(self.structure, float(self.scores.share.max()) if significant else 0.0)

    @property
    def residual(self) -> Array:
        """Measured minus simulated on the training rows."""
        return self.line.residual[self.rows]


def score(fitted: Fitted, channels: Iterable[str], catalogue: Catalogue, seed: int) -> Scored:
    """Derive all directions at a fitted model and score them, grid-corrected and whitened."""
    whole = FreeRun(fitted.model, list(fitted.split.records), constraint_equations(fitted.model, None))
    line = Linearised(whole, fitted.unknowns)
    directions, matrix = line.directions(channels, catalogue)
    rows = np.concatenate([m[whole.depth :] for m in fitted.split.train])
    scores = gate.score(
        line.residual, line.own, matrix, [d.columns for d in directions], [d.searched for d in directions],
        whole.edges, rows, seed, [d.columns for d in directions if d.line], fitted.split.noise,
    )  # fmt: skip
    return Scored(fitted, line, tuple(channels), directions, matrix, scores, rows)


def shortlist(scored: Scored) -> list[int]:
    """Return the directions to fit: the best forms of the best effects, with the sign that means this effect."""
    share, gain = scored.scores.share, scored.scores.gain
    own, e = scored.line.own[scored.rows], scored.residual
    Q = gate.orthonormal(own)
    best: dict[str, dict[str, int]] = {}
    left = e - Q @ (Q.T @ e)
    for i, direction in enumerate(scored.directions):
        if share[i] <= 0:
            continue
        variant = direction.variant
        if variant.effect.sign:
            D = scored.matrix[scored.rows, direction.columns]
            if float(variant.effect.sign * (D[:, 0] @ left)) <= 0:
                continue
        forms = best.setdefault(variant.id, {})
        key = str(variant)
        if key not in forms or share[i] > share[forms[key]]:
            forms[key] = i
    picked: list[int] = []
    # Both views count: energy in the output, and likelihood after whitening.
    for measure, effects, forms_each in ((share, REFITTED, FORMS), (gain, REFITTED // 2, 1)):
        order = sorted(best, key=lambda name: -max(measure[i] for i in best[name].values()))
        for name in order[:effects]:
            forms_of = sorted(best[name].values(), key=lambda i: -measure[i])
            top = measure[forms_of[0]]
            for i in forms_of[:forms_each]:
                if measure[i] > 0.6 * top and i not in picked:
                    picked.append(i)
    return picked


def imitated(catalogue: Catalogue) -> Catalogue:
    """Return the effects that a lag or a velocity term may imitate."""
    return Catalogue({name: forms for name, forms in catalogue.items() if forms[0].family in ("memory", "friction")})


def refit(scored: Scored, report: Callable[[str], Any], instead_of: Fitted | None = None) -> list[Candidate]:
    """Step 6: fit the shortlist on the training samples."""
    base = scored.fitted
    before = (instead_of or base).mean_square(base.split.held)
    found: list[Candidate] = []
    for i in shortlist(scored):
        direction = scored.directions[i]
        report(f"fitting {direction.variant}")
        made = scored.extended(i)
        if made is None or integrates(made, base.model):
            continue
        candidate = Candidate(
            direction.variant.id, direction.variant, made, scored.scores.corrected(i),
            made.mean_square(base.split.held), before, instead_of is not None,
        )  # fmt: skip
        sign = direction.variant.effect.sign
        if sign and sign * next(iter(candidate.parameters.values())) <= 0:
            continue
        if not candidate.mean_square < WORSE * before:
            continue
        found.append(candidate)
    return found


def _takes_over(c: Candidate) -> bool:
    return c.replaces and c.mean_square < TAKES_OVER * c.before


def _preferred(c: Candidate, old: Candidate, independent: float) -> bool:
    """Whether one form of an effect beats another: BIC, but first one that takes the place of base terms."""
    if c.replaces != old.replaces:
        return _takes_over(c if c.replaces else old) == c.replaces
    return c.fitted.criterion(independent) < old.fitted.criterion(independent)


def ranked(found: Sequence[Candidate], independent: float) -> list[Candidate]:
    """Return the best candidate of each effect, best first.

    Among forms of one effect BIC decides. A form with many more parameters must be clearly better to come first.
    """
    best: dict[str, Candidate] = {}
    for c in found:
        old = best.get(c.effect)
        if old is None or _preferred(c, old, independent):
            best[c.effect] = c
    listed = sorted(best.values(), key=lambda c: (c.mean_square, c.effect))
    if not listed:
        return []
    worst = max(c.before for c in listed)
    kept: list[Candidate] = []
    for c in listed:
        at = next(
            (
                i
                for i, o in enumerate(kept)
                if len(o.parameters) >= len(c.parameters) + MANY_MORE
                and c.mean_square - o.mean_square < CLEARLY * worst
            ),
            len(kept),
        )
        kept.insert(at, c)
    # What does without a term of the base, and still beats the base, explains that term too.
    least = min(c.mean_square for c in kept)
    return sorted(kept, key=lambda c: not (_takes_over(c) and c.mean_square < SIMILAR * least))


def confusion_set(candidates: Sequence[Candidate]) -> list[str]:
    """Step 8: the candidates that these data cannot tell from the best.

    A richer form that contains a simpler one (plays contain a play) is left out where it explains nothing more.
    """
    best = candidates[0]
    close = [c for c in candidates if 1 / CLOSE**2 <= c.mean_square / best.mean_square <= CLOSE**2]
    simple = [
        c for c in close
        if not any(
            (len(o.parameters) + 2 <= len(c.parameters) and o.mean_square <= EQUAL**2 * c.mean_square)
            or (o is best and len(o.parameters) + MANY_MORE <= len(c.parameters))
            for o in close
        )
    ]  # fmt: skip
    return [c.effect for c in simple]


def shares(base: Fitted, candidates: Sequence[Candidate], floor: float, seed: int) -> None:
    """Step 7: the share of the removable error that each candidate removes, with a block-bootstrap interval."""
    e0 = base.error(base.split.held) ** 2
    removable = e0.mean() - floor
    before = np.maximum(_drawn(e0, seed).mean(axis=1) - floor, LEAST * abs(removable) or 1.0)
    for c in candidates:
        em = c.fitted.error(base.split.held) ** 2
        c.share = float((e0.mean() - em.mean()) / removable) if removable > 0 else 0.0
        drawn = _drawn(e0 - em, seed).mean(axis=1) / before
        c.interval = (float(np.quantile(drawn, 0.025)), float(np.quantile(drawn, 0.975)))


def chance(base: Fitted, best: Fitted, scored: Scored, seed: int) -> float:
    """Return the p-value of an improvement against surrogates of what it leaves.

    Where the error wanders slowly no improvement counts, unless it is `large`.
    """
    if gate.wanders(max(base.errors, key=len)):
        return 1.0
    added = best.problem.free - base.problem.free
    counted = [m & (np.arange(m.size) >= scored.line.problem.depth) for m in base.split.train]
    before, after = base.error(counted), best.error(counted)
    return gate.by_surrogates(scored.scores, before, after, max(1, added), seed)


def large(base: Fitted, best: Fitted, seed: int) -> float | None:
    """Return the p-value of a large improvement on held-out samples (block bootstrap), None if it is not large."""
    held = base.split.held
    if best.mean_square(held) > (1 - LARGE) * base.mean_square(held):
        return None
    drawn = _drawn(base.error(held) ** 2 - best.error(held) ** 2, seed)
    return float((1 + np.sum(drawn.mean(axis=1) <= 0)) / (DRAWS + 1))


def _drawn(x: Array, seed: int) -> Array:
    """Return block-bootstrap samples of a series, (DRAWS, N)."""
    return moving_blocks(x, block_length(x, x.size // 8), DRAWS, np.random.default_rng(seed))


def detectable(scored: Scored) -> dict[str, float]:
    """Return per effect the rms contribution that would have been seen [unit of y]."""
    found: dict[str, list[float]] = {}
    for direction, size in zip(scored.directions, scored.scores.detectable, strict=True):
        if np.isfinite(size):
            found.setdefault(direction.variant.id, []).append(float(size))
    return {name: float(np.median(sizes)) for name, sizes in sorted(found.items())}


def absorbed(scored: Scored) -> list[str]:
    """Return the effects whose every direction a refit of the base absorbs."""
    seen: dict[str, bool] = {}
    for direction, part in zip(scored.directions, scored.scores.absorbed, strict=True):
        seen[direction.variant.id] = seen.get(direction.variant.id, True) and bool(part > 0.999)
    return sorted(name for name, gone in seen.items() if gone)
