"""Which physical effect is missing: gate, score, refit, verify, verdict (the steps are the functions below, in order)."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy as sp
from scipy.signal import lfilter

from . import gate, printing
from .bootstrap import correlation_length
from .constraints import constraint_equations
from .directions import Direction, Linearised
from .effects import EFFECTS, Catalogue
from .errors import FitError, ModelError
from .experiment import Experiment, propose
from .extend import Variant, equations, find
from .freerun import FreeRun
from .identification import prepare
from .model import NARX, Model
from .refit import Fitted, Split, add, prune, settle
from .sensitivity import derivative
from .signals import k, u, y
from .simulation import Records

Array = np.ndarray
REFITTED, FORMS = 6, 3  # effects that are fitted, and ways of each
CLOSE = 1.02  # a candidate this near to the best held-out error cannot be told from it
EQUAL = 1.003  # errors this near are equal
EXPLAINED, NEARLY_ALL, HELPS = 0.85, 0.995, 0.3  # shares of the removable error
NEAR = 0.2  # "named" also needs an error within this of the noise floor, or nearly everything removed
SLOW = 0.998  # a linear base whose pole is beyond this integrates
WORSE = 1.1  # what makes the held-out error grow by more is no candidate
DRAWS = 200
FEATURES = 40
OVERSAMPLED = 25
VERDICTS = ("nothing_detectable", "named", "confused", "helps_but_incomplete", "outside_library")


@dataclass
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
    mean_square : float
        Held-out free-run error [unit of y squared].
    """

    effect: str
    variant: Variant
    fitted: Fitted
    p_value: float
    mean_square: float
    share: float = 0.0
    interval: tuple[float, float] = (0.0, 0.0)

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
        added = self.model.info["effects"][-1]
        values = dict(zip(map(str, self.model.symbols), self.model.theta, strict=True))
        return {n.split("_")[0]: float(values[n]) for n in (*added["coefficients"], *added["shape"]) if n in values}

    @property
    def latex(self) -> str:
        """LaTeX of the contribution with what it remembers."""
        form = equations(self.model, self.variant)
        names = self.parameters
        coefficients = [n for n in names if n.startswith("c")]
        shown = [
            (sp.Float(f"{names[c]:.4g}"), z) for c, z in zip(coefficients, form.z, strict=False)
        ]
        target = {"input": r"v_{k} - u_{k}", "inside": r"\Delta F", "output": r"y_{k} - x_{k}"}[self.where]
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
class Step:
    """One round of the procedure: a base, what may be missing from it, and a verdict.

    Attributes
    ----------
    base : Fitted
    scores : gate.Scores
    floor : float
        rms of what no model could remove [unit of y].
    """

    base: Fitted
    verdict: str
    candidates: list[Candidate]
    confusion_set: list[str]
    floor: float
    floor_kind: str
    p_value: float
    smallest_detectable: dict[str, float]
    absorbed: list[str]
    experiment: Experiment | None = None
    chosen: Fitted | None = None
    notes: list[str] = field(default_factory=list)


def fit_base(model: Model, split: Split) -> Fitted:
    """Step 1: the given model, refitted in free run on the training samples; a linear base gets room."""
    models = [*(roomy(model, more) for more in (1, 0) if _is_linear(model)), model]
    reason = ""
    fits = []
    for one in map(_copy, models):
        try:
            if one.theta is None:
                one.fit(list(split.records))
            made = settle(one, split)
        except FitError as error:
            reason = str(error)
            continue
        # A pole that moved to 1 imitates a drift by integrating a constant.
        if not _is_linear(model) or slowest(made.model) <= max(SLOW, slowest(model)):
            return made
        fits.append(made)
    if fits:
        return fits[-1]
    raise FitError(f"The base model cannot follow these data in free run: {reason} Choose another base.")


def _is_linear(model: Model) -> bool:
    return isinstance(model, NARX) and model.info.get("selection", {}).get("base") == "linear"


def roomy(model: Any, more: int) -> Model:
    """Return a linear base with one lag more on the input's sides, and `more` lags of the output.

    Its orders were chosen while something was missing, and may be too small once it is there; what is superfluous is
    deleted after each addition.
    """
    a = model.n_y and min(model.n_y + more, 3)
    first, last = max(0, model.delay - 1), model.n_u + 1
    terms = [*(y[k - i] for i in range(1, a + 1)), *(u[k - j] for j in range(first, last + 1)), sp.S.One]
    known = dict(zip(model.terms, model.theta, strict=True))
    made = NARX(terms, [known.get(t, 0.0) for t in terms], operating_point=model.operating_point, Ts=model.Ts)
    made.info = dict(model.info)
    return made


def slowest(model: Model) -> float:
    """Return the largest pole of a linear model."""
    values = dict(zip(model.symbols, map(float, model.theta), strict=True))
    slopes = [float(derivative(model.core, model.inner[k - i]).xreplace(values)) for i in range(1, model.n_y + 1)]
    return float(np.abs(np.roots([1.0, *(-s for s in slopes)])).max()) if slopes else 0.0


def _copy(model: Model) -> Model:
    import copy

    made = copy.copy(model)
    made.info = dict(model.info)
    return made


@dataclass
class Scored:
    """Step 3 to 5: directions and scores of everything in the catalogue."""

    line: Linearised
    whole: FreeRun
    directions: list[Direction]
    matrix: Array
    scores: gate.Scores
    rows: Array

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
        whole.edges, rows, seed, [d.columns for d in directions if d.line],
    )  # fmt: skip
    return Scored(line, whole, directions, matrix, scores, rows)


def shortlist(scored: Scored) -> list[tuple[Direction, int]]:
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
    ranked: list[tuple[Direction, int]] = []
    # Both views count: energy in the output, and likelihood after whitening.
    for measure in (share, gain):
        order = sorted(best, key=lambda name: -max(measure[i] for i in best[name].values()))
        for name in order[:REFITTED]:
            forms_of = sorted(best[name].values(), key=lambda i: -measure[i])
            top = measure[forms_of[0]]
            for i in forms_of[:FORMS]:
                if measure[i] > 0.6 * top and all(j != i for _, j in ranked):
                    ranked.append((scored.directions[i], i))
    return ranked


def refit(base: Fitted, scored: Scored, report: Callable[[str], Any]) -> list[Candidate]:
    """Step 6: fit the shortlist; of each effect the form with the best compromise is kept."""
    own, e = scored.line.own[scored.rows], scored.residual
    found: dict[str, Candidate] = {}
    for direction, i in shortlist(scored):
        report(f"fitting {direction.variant}")
        D = scored.matrix[scored.rows, direction.columns]
        made = add(base, direction.variant, direction.shape, D, e, own)
        if made is None:
            continue
        candidate = Candidate(
            direction.variant.id, direction.variant, made, scored.scores.corrected(i),
            made.mean_square(base.split.held),
        )  # fmt: skip
        sign = direction.variant.effect.sign
        if sign and sign * next(iter(candidate.parameters.values())) <= 0:
            continue
        if not candidate.mean_square < WORSE * base.mean_square(base.split.held):
            continue
        old = found.get(candidate.effect)
        if old is None or made.criterion < old.fitted.criterion:
            found[candidate.effect] = candidate
    return sorted(found.values(), key=lambda c: (c.mean_square, c.effect))


def remainder(fitted: Fitted, scored: Scored) -> float:
    """Return the held-out mean square that is left when every clear pattern is taken out.

    Beside the catalogue, random features of the signals are tried: what they explain is structure without a name.
    """
    split = fitted.split
    extra = features(scored.line)
    matrix = np.column_stack([scored.matrix, extra])
    held = np.concatenate([m[scored.whole.depth :] for m in split.held])
    residual = scored.line.residual
    lines = [d.columns for d in scored.directions if d.line]
    noise = gate.whitened(residual, scored.line.own, matrix, scored.whole.edges, scored.rows, lines)[1]
    before, after = float(np.mean(residual[held] ** 2)), float(np.mean(noise[held] ** 2))
    return min(before, after)


def features(line: Linearised) -> Array:
    """Return directions of random smooth functions of the signals: a black box for what the catalogue lacks."""
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((9, FEATURES))
    phases = rng.uniform(0, 2 * np.pi, FEATURES)
    at_output, at_input = [], []
    for seen in line.seen:
        u, y = (seen[str(b.label)] for b in (line.model.input, line.model.inner))
        slow = [lfilter([1 - a], [1, -a], u, zi=[a * u[0]])[0] for a in (0.8, 0.97)]
        du, dy = np.diff(u, prepend=u[0]), np.diff(y, prepend=y[0])
        base = np.column_stack([u, y, *slow, du, dy, np.sign(du) * np.abs(u), np.sign(dy), np.arange(u.size)])
        spread = base.std(axis=0)
        base = (base - base.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
        z = np.cos(0.7 * base @ weights + phases)
        at_output.append(z)
        at_input.append(z[:, : FEATURES // 2])
    blocks = [line.moved("output", at_output), line.moved("input", at_input)]
    return np.concatenate(blocks, axis=1)


def shares(base: Fitted, candidates: Sequence[Candidate], floor: float, seed: int) -> None:
    """Step 7: the share of the removable error that each candidate removes, with a block-bootstrap interval."""
    e0 = base.error(base.split.held) ** 2
    removable = e0.mean() - floor
    n = e0.size
    block = int(min(max(10, 3 * correlation_length(np.sqrt(e0))), max(2, n // 8)))
    rng = np.random.default_rng(seed)
    starts = rng.integers(0, n - block + 1, size=(DRAWS, -(-n // block)))
    index = (starts[:, :, None] + np.arange(block)).reshape(DRAWS, -1)[:, :n]
    for c in candidates:
        em = c.fitted.error(base.split.held) ** 2
        c.share = float((e0.mean() - em.mean()) / removable) if removable > 0 else 0.0
        drawn = (e0 - em)[index].mean(axis=1) / np.maximum(e0[index].mean(axis=1) - floor, 1e-300)
        c.interval = (float(np.quantile(drawn, 0.025)), float(np.quantile(drawn, 0.975)))


def step(
    base: Fitted,
    channels: Sequence[str] = (),
    catalogue: Catalogue = EFFECTS,
    seed: int = 0,
    report: Callable[[str], Any] = lambda what: None,
) -> Step:
    """Run one round of the procedure at a fitted base."""
    split = base.split
    report("deriving the directions of all effects")
    scored = score(base, channels, catalogue, seed)
    scores = scored.scores
    detectable, absorbed = _detectable(scored), _absorbed(scored)
    v0 = base.mean_square(base.split.held)
    made = Step(base, "nothing_detectable", [], [], np.sqrt(v0), "estimate", scores.p_value, detectable, absorbed)
    if scores.p_value > gate.LEVEL:
        return made
    candidates = refit(base, scored, report)
    if not candidates:
        made.verdict = "outside_library"
        return made
    best = candidates[0]
    added = best.fitted.problem.free - base.problem.free
    counted = [m & (np.arange(m.size) >= scored.whole.depth) for m in split.train]
    chance = gate.by_surrogates(scores, base.error(counted), best.fitted.error(counted), max(1, added), seed)
    made.p_value = max(made.p_value, chance)
    if chance > gate.LEVEL:
        return made
    report("estimating the noise floor")
    rescored = score(best.fitted, channels, catalogue, seed)
    floor = min(remainder(best.fitted, rescored), remainder(base, scored), best.mean_square)
    made.floor = float(np.sqrt(floor))
    shares(base, candidates, floor, seed)
    made.candidates = sorted(candidates, key=lambda c: (c.effect not in confusion_set(candidates), c.mean_square))
    best = made.candidates[0]
    # The sealed samples are opened here, once: what is real helps at the end of the record too.
    if best.interval[0] <= 0 or best.fitted.mean_square(split.test) > base.mean_square(split.test):
        made.candidates = []
        return made
    made.confusion_set = confusion_set(candidates)
    if best.share < HELPS:
        made.verdict = "outside_library"
    elif best.share < EXPLAINED or best.mean_square > (1 + NEAR) ** 2 * floor and best.share < NEARLY_ALL:
        made.verdict = "helps_but_incomplete"
    elif len(made.confusion_set) > 1:
        made.verdict = "confused"
    else:
        made.verdict = "named"
    made.chosen = best.fitted
    return made


def confusion_set(candidates: Sequence[Candidate]) -> list[str]:
    """Step 8: the candidates that these data cannot tell from the best.

    A richer form that contains a simpler one (plays contain a play) is left out where it explains nothing more.
    """
    best = candidates[0].mean_square
    close = [c for c in candidates if c.mean_square <= CLOSE**2 * best]
    simple = [
        c for c in close
        if not any(
            o.fitted.problem.free + 2 <= c.fitted.problem.free and o.mean_square <= EQUAL**2 * c.mean_square
            for o in close
        )
    ]  # fmt: skip
    return [c.effect for c in simple]


def _detectable(scored: Scored) -> dict[str, float]:
    """Return per effect the rms contribution that would have been seen [unit of y]."""
    found: dict[str, list[float]] = {}
    for direction, size in zip(scored.directions, scored.scores.detectable, strict=True):
        if np.isfinite(size):
            found.setdefault(direction.variant.id, []).append(float(size))
    return {name: float(np.median(sizes)) for name, sizes in sorted(found.items())}


def _absorbed(scored: Scored) -> list[str]:
    """Return the effects whose every direction a refit of the base absorbs."""
    seen: dict[str, bool] = {}
    for direction, part in zip(scored.directions, scored.scores.absorbed, strict=True):
        seen[direction.variant.id] = seen.get(direction.variant.id, True) and bool(part > 0.999)
    return sorted(name for name, gone in seen.items() if gone)


@dataclass
class Diagnosis:
    """What is missing from a model, step by step."""

    steps: list[Step]
    seconds: float
    seed: int

    @property
    def verdict(self) -> str:
        """The verdict of the first step."""
        return self.steps[0].verdict

    @property
    def candidates(self) -> list[Candidate]:
        """The candidates of the first step, best first."""
        return self.steps[0].candidates

    @property
    def confusion_set(self) -> list[str]:
        """The effects of the first step that these data cannot tell apart."""
        return self.steps[0].confusion_set

    @property
    def best(self) -> Candidate:
        """The best candidate."""
        if not self.candidates:
            raise ModelError(f"There is no candidate: the verdict is {self.verdict}.")
        return self.candidates[0]

    @property
    def model(self) -> Model:
        """The model after the last step that added something, else the base."""
        fitted = next((s.chosen for s in reversed(self.steps) if s.chosen is not None), self.steps[0].base)
        return fitted.model


def diagnose(
    model: Model,
    records: Records,
    *,
    max_effects: int = 1,
    channels: Sequence[str] | str = "all",
    catalogue: Catalogue = EFFECTS,
    seed: int = 0,
    report: Callable[[str], Any] = lambda what: None,
) -> Diagnosis:
    """Compare a model with measurements and name the physical effect that is missing."""
    begin = time.perf_counter()
    listed = prepare(records)
    named = list(listed[0].channels) if channels == "all" else list(channels)
    split = Split.of(listed)
    report("fitting the base in free run")
    base = fit_base(model, split)
    steps = []
    for _ in range(max_effects):
        made = step(base, named, catalogue, seed, report)
        steps.append(made)
        if made.chosen is None:
            break
        base = made.chosen
    return Diagnosis(steps, time.perf_counter() - begin, seed)
