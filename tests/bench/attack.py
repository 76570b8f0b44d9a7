"""Independent attack on what laws and proofs say, with fresh seeds on demand.

    python tests/bench/attack.py [--models 500] [--seed 0] [--jobs 2] [--effects 2] [--late 0] [--names]
    python tests/bench/attack.py --slips 4 [--models 30] [--seed 4000]

Random models with up to `--effects` effects of the catalogue, in every place, with up to `--late` samples of dead time
more, and with `--names` a channel that is called as the package itself calls something, are driven by a random input that also rests;
the law must then make the model's own output from the same state, and its C and its Structured Text (where gcc and
blark are at hand) must give the same input, within limits that never act. Where it misses, every input is tried: "lost"
means that some input would have given the wanted output, "dead end" that an earlier choice between two inputs, both
right, left none; "by other choices" that it follows once such a choice is made otherwise. "Runs away, as it says" means
that the law says that it is unstable there, "last digits decide" that it follows, but that what differs between
languages are last digits that grow, or turn a sign, or that the last digits of the reference move the input as far. A
proof ("exactly one") is refuted where a search over inputs finds none or two, "cannot be reached" where the model has made
that output itself. Nothing is tuned.

With --slips the models have elastic friction that slips, behind a dead time of 1 to `--slips` samples, `--models` of each.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from common import asked, parallel

import narx_sym as ns
from narx_sym.errors import Diverged, NarxError, NotInvertible, Unreachable
from narx_sym.fit.laws.crossings import around, gap_along
from narx_sym.fit.laws.run import RUNS_AWAY
from narx_sym.fit.laws.trial import growth
from narx_sym.models.effects import Effect
from narx_sym.models.extend import Variant, extend, variants
from narx_sym.symbolic.signals import u, y

Array = np.ndarray
N, TS = 100, 0.01
SETTLES = 6000  # samples
SAME = 1e-9  # of the largest input: by how much languages may differ
GOOD = 1e-9  # of the largest output
SHAPES = {"tau": 0.05, "b": 0.7, "g": 0.9, "d": 1.1, "f": 3.0, "s": 0.1}
CHANNEL = "temp"
# What the package calls something; m and the names of effects are refused.
NAMES = (CHANNEL, "r", "theta_1", "y_wanted", "m_hint", "z", "c", "int", "end", "dy_0")
CLEAR = 1e-10  # of the largest gap of a stage: what is smaller has no sign


def bases(late: int = 0) -> dict[str, ns.NARX]:
    """Models without effects, whose input comes some samples later."""
    made = {
        "static": (["u[k]"], [1.5], {u: 0.4, y: 2.0}),
        "first order": (["y[k-1]", "u[k-1]"], [0.6, 0.4], {}),
        "second order": (["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], {}),
        "delayed": (["y[k-1]", "u[k-2]"], [0.7, 0.4], {u: -1.0, y: 3.0}),
        "continuum": (
            ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"],
            [1.0, 0.7, 0.1, -0.2], {u: 0.3, y: -2.0},
        ),
        "delayed continuum": (["y[k-1]", "phi1[k-3]", "phi2[k-3]*phi1[k-4]*y[k-1]"], [1.0, 0.7, 0.1], {}),
    }  # fmt: skip

    def later(term: str) -> str:
        return re.sub(r"(u|phi\d)\[k(-\d+)?\]", lambda f: f"{f[1]}[k-{late - int(f[2] or 0)}]", term) if late else term

    return {
        n: ns.NARX.from_terms([*map(later, terms)], theta, operating_point=at, Ts=TS)
        for n, (terms, theta, at) in made.items()
    }


def with_effect(base: ns.Model, variant: Variant, rng: np.random.Generator) -> ns.Model:
    """Add an effect with random coefficients: a whole one up to 95 %, others of either sign."""
    added = extend(base, variant)
    inside = variant.where == "inside"
    high = 0.95 if variant.effect.full else 0.05 if inside else 0.3
    values = dict(zip(base.symbols, base.theta, strict=True))
    for c in added.coefficients:
        size = rng.uniform(0.05 * high, high)
        values[c] = size if variant.effect.sign or variant.effect.full else size * rng.choice([-1.0, 1.0])
    if len(added.coefficients) > 2:  # shares of one whole
        values |= {c: abs(values[c]) / len(added.coefficients) for c in added.coefficients}
    for s, name in zip(added.shape, variant.shape, strict=True):
        values[s] = SHAPES.get(name, 0.25) * rng.uniform(0.5, 2.0)
    return added.model.replace(theta=[values[s] for s in added.model.symbols])


# What models are drawn from whose seeds are kept by tests: a new effect would make others of them.
LATER = {
    ("end_stop", "rigid both sides"), ("saturation", "hard, two limits"), ("coulomb_friction", "viscoelastic"),
    *(("channel_friction", form) for form in ("of a speed", "smooth, of a speed", "holding", "holding, of a speed")),
}  # fmt: skip


def _as_before(e: Effect) -> Effect:
    """Return an effect as it was then: what a channel presses on was no force."""
    acts = {place: by for place, by in e.places.items() if place != "force" or e.id != "channel_friction"}
    return replace(e, places=acts)


KEPT = ns.effects.Catalogue(
    {
        name: [_as_before(e) for e in forms if (e.id, e.form) not in LATER]
        for name, forms in ns.EFFECTS.of("").without("rate_limit", "uneven_speed").items()
    }
)


def drawn(
    rng: np.random.Generator,
    effects: int,
    catalogue: ns.effects.Catalogue = ns.EFFECTS,
    late: int = 0,
    channel: str = CHANNEL,
) -> tuple[str, ns.Model]:
    """Return a random model with some effects, and its name."""
    name = str(rng.choice(list(bases())))
    model: ns.Model = bases(late)[name]
    name += f", {late} later" if late else ""
    for _ in range(effects):
        listed = list(variants(model, [channel], catalogue))
        # Every effect alike, however many ways it has.
        wanted = rng.choice(sorted({(v.id, v.where, v.effect.form) for v in listed}))
        fitting = [v for v in listed if (v.id, v.where, v.effect.form) == tuple(wanted)]
        variant = fitting[rng.integers(len(fitting))]
        name += f" + {variant}"
        model = with_effect(model, variant, rng)
    return name, model


def moved(rng: np.random.Generator, n: int = N) -> Array:
    """Return a random input between -1 and 1 that starts at 0, with steps, ramps and rests."""
    found = [np.zeros(6)]
    while sum(map(len, found)) < n:
        length, last = int(rng.integers(3, 15)), found[-1][-1]
        kind = rng.integers(3)
        found.append(
            np.full(length, last) if kind == 0
            else np.linspace(last, rng.uniform(-1, 1), length + 1)[1:] if kind == 1
            else rng.uniform(-1, 1, length)
        )  # fmt: skip
    return np.concatenate(found)[:n]


class Run:
    """A model, an input and its own output, at rest before the start; in the law's time."""

    def __init__(self, model: ns.Model, rng: np.random.Generator, channel: str = CHANNEL):
        self.model, self.law = model, model.compensator()
        u0, y0 = (model.operating_point.get(b, 0.0) for b in (u, y))
        ahead = self.law.preview
        self.u = np.concatenate([np.full(ahead, u0), u0 + moved(rng)])
        self.channels: dict[str, Array] = {}
        wave = np.sin(np.maximum(np.arange(self.u.size) - 8.0 - ahead, 0.0) / 25)
        if channel in model.channels:
            self.channels[channel] = wave
        if "t" in map(str, (b.label for b in model.recursion.inputs)):
            self.channels["t"] = TS * np.maximum(np.arange(self.u.size) - ahead, 0)
        self.u0, self.y0, self.ahead, self.held = u0, y0, ahead, 0
        rests = False
        for _ in range(100):  # to where it rests and stays; else the output drifts, or t moves it
            still = {n: np.full(SETTLES, c[0]) for n, c in self.channels.items()}
            settled = self._simulated(np.full(SETTLES, u0), still)
            if np.ptp(settled[-50:]) > 1e-12 or not np.isfinite(settled).all():
                break
            rests, moved_on, self.y0 = True, abs(settled[-1] - self.y0), float(settled[-1])
            if moved_on < 1e-12:
                break
        if not rests:  # held until the first command can arrive, at an output that it can give: |y| is none below 0
            self.held, self.y0 = ahead, float(self.output(self.u)[ahead])
        self.y = self.output(self.u)
        self.size = GOOD * max(1.0, float(np.abs(self.y).max()))

    def output(self, driven: Array) -> Array:
        """What the model gives; where it does not rest, its first output until the first command can arrive."""
        held, n = self.held, driven.size
        given = {name: c[held:n] for name, c in self.channels.items()}
        return np.concatenate([np.full(held, self.y0), self._simulated(driven[held:], given)])

    def _simulated(self, driven: Array, channels: dict[str, Array]) -> Array:
        return self.model.simulate(driven, self.y0, channels, u0=self.u0)

    def lost(self, driven: Array, at: int) -> bool:
        """Return whether another command would have given the output that was missed first."""
        when = at - self.ahead
        tried = np.concatenate([[driven[when - 1], self.u[when]], np.linspace(-10, 10, 801)])

        def gap(w: float) -> float:
            commands = np.concatenate([driven[:when], [w], np.full(self.ahead, w)])
            try:
                return float(self.output(commands)[at] - self.y[at])
            except NarxError:
                return float("nan")

        gaps = [gap(w) for w in tried]
        if min(map(abs, gaps)) < self.size:
            return True
        for a, b, first, last in zip(tried[2:], tried[3:], gaps[2:], gaps[3:], strict=False):
            if first * last < 0:
                for _ in range(60):
                    middle = (a + b) / 2
                    here = gap(middle)
                    a, b = (middle, b) if (here > 0) == (first > 0) else (a, middle)
                if abs(gap(a)) < self.size or abs(gap(b)) < self.size:
                    return True
        return False

    def follow(self) -> Any:
        """Let the law make the model's own output."""
        return self.law.follow(self.y, self.u0, self.channels, share=None)


def false_word(run: Run, found: Any) -> str:
    """Return what a law says of itself that its run refutes; empty where nothing is."""
    law, n = run.law, run.y.size - run.ahead
    if law.residual() != 0:
        return "a residual"
    if found.runs_away and law.stability().stable:
        return "called stable"
    if found.unreached.any():
        try:
            law.run(run.y, run.u0, run.channels, share=None)
        except Unreachable as error:
            if str(error).startswith("The reference cannot be reached"):
                return "called out of reach"
        except NarxError:
            pass
    at = np.unique(np.linspace(2, n - 1, 40).astype(int))
    at = at[~found.unreached[at + run.ahead]]
    for stage in law.staged.stages if law.staged else ():
        if not stage.proved or stage.needs:
            continue
        reached = found.values[stage.unknown.base.name][:n]
        gap = gap_along(law, stage, found.values, run.y, at)(around(reached, 2.0)[None, :])
        for row in gap:
            signs = np.sign(row[np.abs(row) > CLEAR * np.abs(row).max()])
            if np.count_nonzero(signs[1:] != signs[:-1]) > 1:
                return f"two {stage.unknown} where one is proved"
    return ""


def outcome(seed: int, effects: int = 2, late: int = 0, names: bool = False) -> tuple[str, str, int]:
    """Run one random model: what became of it, its name, and the samples that its law misses."""
    rng, name = np.random.default_rng(seed), "no model"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            channel = str(rng.choice(NAMES)) if names else CHANNEL
            name, model = drawn(
                rng, 1 + seed % effects, late=int(rng.integers(late + 1)) if late else 0, channel=channel
            )
            run = Run(model, rng, channel)
        except NotInvertible:
            return "no law", name, 0
        except NarxError as error:
            return "unstable" if "diverge" in str(error) else "error", name, 0
        if not np.all(np.abs(run.y) < 1e6):
            return "unstable", name, 0
        try:
            found = run.follow()
        except Diverged as error:
            return "refused: it runs away" if "law diverges" in str(error) else "diverges", name, N
        except NarxError:
            return "refused", name, N
        if word := false_word(run, found):
            return f"FALSE WORD: {word}", name, int(found.missed.sum())
        try:
            missed = np.abs(run.output(found.m) - run.y) > run.size
        except NarxError:
            if found.runs_away:
                return "runs away, as it says", name, N
            missed = np.ones(N, dtype=bool)
        if not missed.any():
            return _as_source(run, name) if not found.tried else ("follows by other choices", name, found.tried)
        if not (run.law.staged and run.law.staged.note):
            if found.aside:
                return "does not rest at the start, as it says", name, int(missed.sum())
            if run.lost(found.m, int(np.argmax(missed))):
                return "lost", name, int(missed.sum())
            if not found.runs_away:
                return "dead end", name, int(missed.sum())
        return "runs away, as it says", name, int(missed.sum())


def _as_source(run: Run, name: str) -> tuple[str, str, int]:
    """Say whether the law of a run does the same in every language."""
    from bench import attacked  # the laws of the export tests take seconds to derive

    try:
        gaps = attacked.gaps(run)
    except NotInvertible:
        return "follows", name, 0  # no closed form
    apart = [language for language, gap in gaps.items() if not gap <= SAME]
    if apart and (growth(run.law, run.y, run.u0, run.channels, N - 1) >= RUNS_AWAY or _nudged(run) > SAME):
        return "follows, last digits decide", name, 0
    return ("follows", name, 0) if not apart else (f"{' and '.join(apart)} differ", name, 0)


def _nudged(run: Run) -> float:
    """Return how far the input of a law moves with the last digits of its reference, in sizes of the input."""
    options: Any = {"limits": (-1e9, 1e9), "share": None}
    one, other = (run.law.follow(r, run.u0, run.channels, **options).m for r in (run.y, run.y + 4 * np.spacing(run.y)))
    return float(np.abs(one - other).max() / max(1.0, np.abs(one).max()))


def slipping(seed: int, tau: int) -> bool:
    """Whether a law follows what a random model made whose friction slips."""
    from inversion.test_flat import slipped

    _, law, made = slipped(seed, tau)
    return not law.follow(made, 0.0, share=None).missed.any()


def slips(seeds: range, most: int, jobs: int) -> int:
    """Print how many of those laws follow, by dead time."""
    for tau in range(1, most + 1):
        found = parallel(slipping, [(seed, tau) for seed in seeds], jobs, f"tau_d = {tau}")
        print(f"tau_d = {tau}: {sum(found)} of {len(found)} follow", flush=True)
    return 0


def main() -> int:
    """Attack, and print what was found."""
    options = asked(__doc__, models=500, seed=0, jobs=2, effects=2, late=0, names=False, slips=0)
    seeds = range(options.seed, options.seed + options.models)
    if options.slips:
        return slips(seeds, options.slips, options.jobs)
    tally: Counter[str] = Counter()
    pool = ProcessPoolExecutor(options.jobs) if options.jobs > 1 else None
    attacked = partial(outcome, effects=options.effects, late=options.late, names=options.names)
    for seed, (what, name, missed) in zip(seeds, (pool.map if pool else map)(attacked, seeds), strict=True):
        tally[what] += 1
        if what not in ("follows", "no law", "unstable"):
            print(f"{what:10} {missed:4} seed {seed}: {name}", flush=True)
    print("| " + " | ".join(tally) + " |")
    print("| " + " | ".join(map(str, tally.values())) + " |")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
