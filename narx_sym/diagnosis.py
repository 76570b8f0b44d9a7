"""Which physical effect is missing: gate, score, refit, verify, verdict; the functions below, in order."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from scipy.signal import lfilter

from . import gate, printing
from .bootstrap import correlation_length
from .compile import Columns
from .constraints import constraint_equations
from .directions import Direction, Linearised
from .effects import EFFECTS, Catalogue
from .errors import FitError, ModelError
from .estimate import describe
from .experiment import Experiment, propose
from .extend import Variant, equations, find
from .freerun import FreeRun
from .identification import prepare
from .misfit import Misfit, missing_input, where_it_fails
from .model import NARX, Model
from .parallel import one_blas_thread
from .refit import Fitted, Split, add, period_noise, prune, settle
from .sensitivity import derivative
from .signals import expand_phi, k, lags, samples, u, y
from .simulation import Records

Array = np.ndarray
REFITTED, FORMS = 6, 3  # effects that are fitted, and ways of each
CLOSE = 1.02  # a candidate this near to the best held-out error cannot be told from it
EQUAL = 1.003  # errors this near are equal
EXPLAINED, NEARLY_ALL, HELPS = 0.85, 0.995, 0.3  # shares of the removable error
NEAR = 0.2  # "named" also needs an error within this of the noise floor, or nearly everything removed
SLOW = 0.998  # a linear base whose pole is beyond this integrates
MANY_MORE, CLEARLY = 3, 0.02  # so many parameters more must remove so much more of the error
CYCLES = 3  # of a periodic input at least
NARROW, SHORT = 0.9, 100  # share of the energy in one spectral line; samples of a segment that do not count
TAKES_OVER = 0.9  # of the base's error: without a term of the base, and still better
BELOW = 4.0  # a shape parameter may leave its grid downwards by this factor
LARGE = 0.25  # share of the held-out error: what removes more is no accident of the noise
WORSE = 1.1  # what makes the held-out error grow by more is no candidate
DRAWS = 200
FEATURES = 40
OVERSAMPLED = 25
VERDICTS = ("nothing_detectable", "named", "confused", "helps_but_incomplete", "outside_library")


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
        added = self.model.info["effects"][-1]
        values = dict(zip(map(str, self.model.symbols), self.model.theta, strict=True))
        return {n.split("_")[0]: float(values[n]) for n in (*added["coefficients"], *added["shape"]) if n in values}

    @property
    def latex(self) -> str:
        """LaTeX of the contribution with what it remembers."""
        form = equations(self.model, self.variant)
        names = self.parameters
        coefficients = [n for n in names if n.startswith("c")]
        shown = [(sp.Float(f"{names[c]:.4g}"), z) for c, z in zip(coefficients, form.z, strict=False)]
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

    def nrmse(self, fitted: Fitted) -> dict[str, float]:
        """Return the free-run errors of a model over the standard deviation of the output."""
        spread, split = fitted.problem.spread, self.base.split
        return {
            "train": float(np.sqrt(fitted.mean_square(split.train)) / spread),
            "validation": float(np.sqrt(fitted.mean_square(split.held)) / spread),
        }

    def sentence(self, units: Mapping[str, str]) -> str:
        """Return the verdict in plain words."""
        unit = f" {units['y']}" if units.get("y") else ""
        error = np.sqrt(self.base.mean_square(self.base.split.held))
        spread = self.base.problem.spread
        sizes = f"The error is {error:.3g}{unit} rms ({100 * error / spread:.2g} % of the output's standard deviation)"
        if self.verdict == "nothing_detectable":
            seen = sorted(self.smallest_detectable.items(), key=lambda p: p[1])
            shown = ", ".join(f"{name} above {size:.2g}{unit}" for name, size in seen[:3])
            return f"Nothing is missing that these data can show. {sizes}; seen would have been {shown} rms."
        sizes += f"; the noise floor is about {self.floor:.3g}{unit}"
        if self.verdict == "outside_library":
            return (
                f"Something is missing that the catalogue does not know. {sizes}. Look at where the model fails, and "
                "at the equivalent missing input."
            )
        best = self.candidates[0]
        share = f"{100 * best.share:.0f} % of the removable error on data never used for fitting"
        what = f"{best.variant.effect.sentence.rstrip('.')} ({best.effect})"
        if self.verdict == "helps_but_incomplete":
            return f"{what} explains {share}, but not all that is missing. {sizes}."
        if self.verdict == "confused":
            others = ", ".join(e for e in self.confusion_set if e != best.effect)
            text = f"One of several effects is missing: {best.effect}, or as well {others}. {sizes}. "
            text += f"{best.effect} removes {share}."
            return f"{text} {self.experiment.sentence}" if self.experiment else text
        return f"{best.effect} is probably missing. {what}. {sizes}. Adding it removes {share}."

    def to_dict(self, experiment_file: str | None) -> dict[str, Any]:
        """Return the step as plain data."""
        base = self.base.model
        terms = [printing.text(t) for t in base.terms] if isinstance(base, NARX) else [printing.text(base.F)]
        return {
            "verdict": self.verdict,
            "sentence": self.sentence({}),
            "confusion_set": self.confusion_set,
            "p_value": self.p_value,
            "base": {
                "latex": base.latex(), "terms": terms, "theta": [float(v) for v in base.theta],
                "nrmse": {
                    **self.nrmse(self.base), "noise_floor": float(self.floor / self.base.problem.spread),
                    "noise_floor_from": self.floor_kind,
                },
            },
            "candidates": [
                {
                    "effect": c.effect, "where": c.where, "form": str(c.variant), "parameters": c.parameters,
                    "latex": c.latex, "share_of_removable_error": c.share, "interval": list(c.interval),
                    "p_value": c.p_value, "sentence": c.sentence, "nrmse": self.nrmse(c.fitted),
                }
                for c in self.candidates
            ],
            "smallest_detectable": self.smallest_detectable,
            "absorbed_by_a_refit": self.absorbed,
            "where_it_fails": [],
            "experiment": self.experiment and {
                "separates": list(self.experiment.separates), "file": experiment_file,
                "sentence": self.experiment.sentence,
            },
        }  # fmt: skip


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
    """Return the largest pole of the linear part of a model's core."""
    values = dict(zip(model.symbols, map(float, model.theta), strict=True))
    slopes = []
    for i in range(1, model.n_y + 1):
        slope = derivative(model.core, model.inner[k - i])
        constant = [p for p in sp.Add.make_args(slope) if not p.has(sp.Indexed)]
        slopes.append(float(sum(p.xreplace(values) for p in constant)))
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

    def ranges(self, variant: Variant) -> dict[str, tuple[float, float]]:
        """Return how far each shape parameter may leave its grid."""
        found = {}
        for name in variant.shape:
            scan = variant.effect.scan[name]
            grid, _ = self.line.scale(scan, variant)
            found[name] = (-3.0, 3.0) if scan.of == "ratio" else (min(grid) / BELOW, max(grid) * scan.beyond)
        return found

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
        whole.edges, rows, seed, [d.columns for d in directions if d.line], period_noise(fitted.split.records),
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
    for measure, effects, forms_each in ((share, REFITTED, FORMS), (gain, REFITTED // 2, 1)):
        order = sorted(best, key=lambda name: -max(measure[i] for i in best[name].values()))
        for name in order[:effects]:
            forms_of = sorted(best[name].values(), key=lambda i: -measure[i])
            top = measure[forms_of[0]]
            for i in forms_of[:forms_each]:
                if measure[i] > 0.6 * top and all(j != i for _, j in ranked):
                    ranked.append((scored.directions[i], i))
    return ranked


def simpler(base: Fitted) -> list[Fitted]:
    """Return bases without the dynamics of a linear base that may only imitate what is missing.

    On one sine a lag looks like hysteresis; at one speed drag looks like friction.
    """
    model = base.model
    if not isinstance(model, NARX) or not _is_linear(model):
        return []
    if not all(narrow(r) for r in base.split.records if len(r) > SHORT):
        return []
    now = min((i for i in lags(model.core, u)), default=0)
    found = []
    for orders in sorted({model.n_y, 0}):
        terms = [*(y[k - i] for i in range(1, orders + 1)), u[k - max(now, model.delay)], sp.S.One]
        if len(terms) >= len(model.symbols):
            continue
        made = NARX(terms, operating_point=model.operating_point, Ts=model.Ts)
        made.info = {n: v for n, v in model.info.items() if n == "selection"}
        try:
            made.fit(list(base.split.records))
            found.append(settle(made, base.split))
        except FitError:
            continue
    return found


def _takes_over(c: Candidate) -> bool:
    return c.replaces and c.mean_square < TAKES_OVER * c.before


def _preferred(c: Candidate, old: Candidate, independent: float) -> bool:
    """Whether one form of an effect beats another: BIC, but first one that takes the place of base terms."""
    if c.replaces != old.replaces:
        return _takes_over(c if c.replaces else old) == c.replaces
    return c.fitted.criterion(independent) < old.fitted.criterion(independent)


def imitated(catalogue: Catalogue) -> Catalogue:
    """Return the effects that a lag or a velocity term may imitate."""
    return Catalogue({name: forms for name, forms in catalogue.items() if forms[0].family in ("memory", "friction")})


def narrow(record: Any) -> bool:
    """Whether nearly all of an input's energy is at one frequency, as in a sine or a triangle."""
    power = np.abs(np.fft.rfft((record.u - record.u.mean()) * np.hanning(len(record)))) ** 2
    peak = int(np.argmax(power))
    return bool(peak >= CYCLES and power[max(0, peak - 3) : peak + 4].sum() > NARROW * power.sum())


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
    return sorted(kept, key=lambda c: not _takes_over(c))


def refit(
    base: Fitted, scored: Scored, report: Callable[[str], Any], instead_of: Fitted | None = None
) -> list[Candidate]:
    """Step 6: fit the shortlist on the training samples."""
    before = (instead_of or base).mean_square(base.split.held)
    own, e = scored.line.own[scored.rows], scored.residual
    found: list[Candidate] = []
    for direction, i in shortlist(scored):
        report(f"fitting {direction.variant}")
        D = scored.matrix[scored.rows, direction.columns]
        made = add(base, direction.variant, direction.shape, D, e, own, scored.ranges(direction.variant))
        if made is None or (_is_linear(base.model) and slowest(made.model) > max(SLOW, slowest(base.model))):
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
    before = np.maximum(_drawn(e0, seed).mean(axis=1) - floor, 1e-300)
    for c in candidates:
        em = c.fitted.error(base.split.held) ** 2
        c.share = float((e0.mean() - em.mean()) / removable) if removable > 0 else 0.0
        drawn = _drawn(e0 - em, seed).mean(axis=1) / before
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
    v0, repeats = base.mean_square(split.held), period_noise(split.records)
    kind = "repeated periods" if repeats else "estimate"
    floor = float(np.mean(np.concatenate(repeats) ** 2)) if repeats else v0
    made = Step(base, "nothing_detectable", [], [], float(np.sqrt(floor)), kind, scores.p_value, detectable, absorbed)
    if scores.p_value > gate.LEVEL and scores.share.max() < LARGE:
        return made
    found = refit(base, scored, report)
    for other in simpler(base) if imitated(catalogue) else []:
        report("trying the effects in the place of base terms")
        found += refit(other, score(other, channels, imitated(catalogue), seed), report, instead_of=base)
    candidates = ranked(found, base.independent())
    if not candidates:
        made.verdict = "outside_library"
        return made
    confused = confusion_set(candidates)
    candidates.sort(key=lambda c: c.effect not in confused)
    best = candidates[0]
    strongest = min(candidates, key=lambda c: c.mean_square)
    chance = _chance(base, strongest, scored, seed)
    made.p_value = max(made.p_value, chance)
    large, base_error = _large(base, strongest, seed), (1 - LARGE) * base.mean_square(split.held)
    if large is not None:
        # No noise does this, whatever its colour; a periodic error that the noise model takes for noise passes here.
        made.p_value = min(made.p_value, large)
        for c in candidates:
            c.p_value = made.p_value if c.p_value > gate.LEVEL and c.mean_square < base_error else c.p_value
    if made.p_value > gate.LEVEL:
        return made
    report("estimating the noise floor")
    rescored = score(best.fitted, channels, catalogue, seed)
    if not repeats:
        floor = min(remainder(best.fitted, rescored), remainder(base, scored), *(c.mean_square for c in candidates))
    made.floor = float(np.sqrt(floor))
    shares(base, candidates, floor, seed)
    made.candidates = candidates
    # The sealed samples are opened here, once: what is real helps at the end of the record too.
    worse = strongest.fitted.mean_square(split.test) > base.mean_square(split.test)
    if strongest.interval[0] <= 0 or (large is None and worse):
        made.candidates = []
        return made
    made.confusion_set = confused
    if max(c.share for c in candidates) < HELPS:
        made.verdict = "outside_library"
    elif best.share < EXPLAINED or (best.mean_square > (1 + NEAR) ** 2 * floor and best.share < NEARLY_ALL):
        made.verdict = "helps_but_incomplete"
    elif len(made.confusion_set) > 1:
        made.verdict = "confused"
    else:
        made.verdict = "named"
    if made.verdict == "confused":
        report("looking for an experiment that separates them")
        models = {c.effect: c.model for c in candidates if c.effect in made.confusion_set}
        made.experiment = propose(models, list(split.records), made.floor, seed)
    if made.verdict != "outside_library":
        report("deleting what became redundant")
        added = best.model.info["effects"][-1]
        made.chosen = prune(best.fitted, [*added["coefficients"], *added["shape"]], base)
    return made


def _chance(base: Fitted, best: Candidate, scored: Scored, seed: int) -> float:
    """Return the p-value of the best candidate's improvement against surrogates of what it leaves."""
    added = best.fitted.problem.free - base.problem.free
    counted = [m & (np.arange(m.size) >= scored.whole.depth) for m in base.split.train]
    before, after = base.error(counted), best.fitted.error(counted)
    return gate.by_surrogates(scored.scores, before, after, max(1, added), seed)


def _large(base: Fitted, best: Candidate, seed: int) -> float | None:
    """Return the p-value of a large improvement on held-out samples (block bootstrap), None if it is not large."""
    held = base.split.held
    if best.mean_square > (1 - LARGE) * base.mean_square(held):
        return None
    drawn = _drawn(base.error(held) ** 2 - best.fitted.error(held) ** 2, seed)
    return float((1 + np.sum(drawn.mean(axis=1) <= 0)) / (DRAWS + 1))


def _drawn(x: Array, seed: int) -> Array:
    """Return block-bootstrap samples of a series, (DRAWS, N) (Kunsch 1989)."""
    n = x.size
    block = int(min(max(10, 3 * correlation_length(x)), max(2, n // 8)))
    starts = np.random.default_rng(seed).integers(0, n - block + 1, size=(DRAWS, -(-n // block)))
    return np.asarray(x[(starts[:, :, None] + np.arange(block)).reshape(DRAWS, -1)[:, :n]])


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
    misfit: Misfit
    seconds: float
    seed: int

    @property
    def verdict(self) -> str:
        """The verdict of the first step: one of `VERDICTS`."""
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
    def experiment(self) -> Experiment | None:
        """The experiment that separates the confusion set of the first step."""
        return self.steps[0].experiment

    @property
    def best(self) -> Candidate:
        """The best candidate."""
        if not self.candidates:
            raise ModelError(f"There is no candidate: the verdict is {self.verdict}.")
        return self.candidates[0]

    @property
    def model(self) -> Model:
        """The model after the last step that added something, else the base as fitted here."""
        fitted = next((s.chosen for s in reversed(self.steps) if s.chosen is not None), self.steps[0].base)
        return fitted.model

    @property
    def ladder(self) -> list[dict[str, Any]]:
        """The errors after each addition, down to the noise floor: name, NRMSE on training and held-out samples."""
        rungs = [{"added": "base", **self.steps[0].nrmse(self.steps[0].base)}]
        for one in self.steps:
            if one.chosen is not None:
                rungs.append({"added": one.candidates[0].effect, **one.nrmse(one.chosen)})
        return rungs

    def sentence(self, units: Mapping[str, str] | None = None) -> str:
        """Return the verdict in plain words."""
        return self.steps[0].sentence(units or {})

    def table(self) -> list[dict[str, Any]]:
        """One row per candidate of the first step."""
        return [
            {
                "effect": c.effect, "where": c.where, "share": c.share, "low": c.interval[0], "high": c.interval[1],
                "nrmse": self.steps[0].nrmse(c.fitted)["validation"], "p_value": c.p_value,
                "in_confusion_set": c.effect in self.confusion_set,
                "parameters": ", ".join(f"{n} = {v:.4g}" for n, v in c.parameters.items()),
            }
            for c in self.candidates
        ]  # fmt: skip

    def to_dict(self, experiment_file: str | None = None) -> dict[str, Any]:
        """Return everything as plain data, in the published schema."""
        first = self.steps[0].to_dict(experiment_file)
        first["where_it_fails"] = [
            {"panel": row["panel"], "share": round(float(row["share"]), 6), "worst": row["worst"]}
            for row in self.misfit.table()
        ]
        first |= {"schema": 1, "seed": self.seed, "seconds": round(self.seconds, 3), "ladder": self.ladder}
        if len(self.steps) > 1:
            rest = [s.to_dict(None) for s in self.steps[1:]]
            first["steps"] = [{n: v for n, v in first.items() if n not in ("schema", "seconds", "seed")}, *rest]
        return first

    def __repr__(self) -> str:
        return f"Diagnosis({self.sentence()})"


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
    """Compare a model with measurements and name the physical effect that is missing.

    Parameters
    ----------
    model : Model
        The base. Its parameters are refitted in free run: what a refit absorbs is not missing.
    records : Record or list of Record
        Every record is split in blocks: for fitting, for judging, and a sealed end.
    max_effects : int
        How many effects are added, one after the other.
    channels : names or "all"
        Which further measured signals may act.
    catalogue : Catalogue
        The effects that are tried.
    report : callable
        Told what is going on.

    Returns
    -------
    Diagnosis

    Raises
    ------
    FitError
        Where the base cannot follow the data at all.
    """
    begin = time.perf_counter()
    if max_effects < 1:
        raise ModelError("max_effects must be at least 1.")
    listed = prepare(records)
    measured = [n for n in listed[0].channels if all(n in r.channels for r in listed)]
    unknown = [] if channels == "all" else [n for n in channels if n not in measured]
    if unknown:
        raise ModelError(
            f"There is no channel {unknown[0]!r} in every record; there are {', '.join(measured) or 'none'}."
        )
    named = measured if channels == "all" else list(channels)
    split = Split.of(listed)
    report("fitting the base in free run")
    base = fit_base(model, split)
    steps: list[Step] = []
    failed: Misfit | None = None
    with one_blas_thread():
        while True:
            made = step(base, named, catalogue, seed, report)
            steps.append(made)
            failed = failed or misfit_of(base, made.floor)
            if made.chosen is None or len(steps) >= max_effects:
                break
            base = made.chosen
    return Diagnosis(steps, failed, time.perf_counter() - begin, seed)


def misfit_of(fitted: Fitted, floor: float | None) -> Misfit:
    """Where a model fails along the longest segment: the free-run error and the equivalent missing input."""
    i = int(np.argmax([len(r) for r in fitted.split.records]))
    record, e = fitted.split.records[i], fitted.errors[i]
    known = dict(zip(fitted.model.symbols, map(float, fitted.model.theta), strict=True))
    simulated = record.y - e
    seen = {"u": record.u, "y": simulated, "x": simulated, "v": record.u, "t": record.t, **record.channels}
    slopes = np.zeros((len(record), fitted.model.n_y))
    for j in range(fitted.model.n_y):
        slope = sp.sympify(derivative(fitted.model.core, fitted.model.inner[k - j - 1]).xreplace(known))
        if not slope.atoms(sp.Indexed):
            slopes[:, j] = float(slope)
            continue
        columns = Columns([fitted.model.in_user_units(expand_phi(slope))])
        if all(str(s.base.label) in seen for s in samples(columns.terms[0])):
            slopes[columns.depth :, j] = columns(seen)[:, 0]
    missing = missing_input(e, slopes, floor)
    return where_it_fails(record.u, record.y, simulated, record.Ts, record.channels, missing, floor)


class Addition:
    """A model about to get an effect: `fit` finds how it acts, and returns the extended model.

    Made by `Model.add`.
    """

    def __init__(self, model: Model, effect: str | Candidate, where: str | None = None, catalogue: Catalogue = EFFECTS):
        self.model, self.effect, self.where, self.catalogue = model, effect, where, catalogue
        if isinstance(effect, str):
            self.forms, self.channel = find(effect, catalogue)
            places = sorted({p for f in self.forms for p in f.places})
            if where is not None and where not in places:
                raise ModelError(f"{effect} does not act at {where!r}: choose among {', '.join(places)}.")

    def fit(self, records: Records, seed: int = 0, report: Callable[[str], Any] = lambda what: None) -> Model:
        """Fit the extended model in free run on all samples.

        Raises
        ------
        FitError
            Where no stable fit is found, or a refit of the model absorbs the effect.
        """
        listed = prepare(records)
        split = Split.whole(listed)
        if isinstance(self.effect, Candidate):
            fitted = settle(_copy(self.effect.model), split, limits=self.effect.fitted.limits)
        else:
            with one_blas_thread():
                fitted = self._search(split, seed, report)
        model = fitted.model
        describe(model, listed, "free_run", fitted.converged)
        return model

    def _search(self, split: Split, seed: int, report: Callable[[str], Any]) -> Fitted:
        only = Catalogue({self.forms[0].id: self.forms})
        base = settle(_copy(self.model), split)
        scored = score(base, [self.channel] if self.channel else [], only, seed)
        kept = [i for i, d in enumerate(scored.directions) if self.where in (None, d.variant.where)]
        own, e = scored.line.own[scored.rows], scored.residual
        found = []
        for i in sorted(kept, key=lambda i: -scored.scores.share[i])[:REFITTED]:
            direction = scored.directions[i]
            report(f"fitting {direction.variant}")
            D = scored.matrix[scored.rows, direction.columns]
            made = add(base, direction.variant, direction.shape, D, e, own, scored.ranges(direction.variant))
            if made is not None:
                found.append(made)
        if not found:
            raise FitError(f"No stable fit with {self.effect} was found, or a refit of the model absorbs it.")
        independent = base.independent()
        return min(found, key=lambda f: f.criterion(independent))
