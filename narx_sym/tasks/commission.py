"""Before a law goes on the machine: how well it would track, by Monte Carlo, and what speaks against it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..data.coverage import beyond
from ..data.units import said_first
from ..errors import Diverged, ModelError
from ..files.atomic import write_text
from ..fit.bootstrap import block_bootstrap, block_length, moving_blocks
from ..fit.identify import prepare
from ..fit.laws.damping import Share
from ..fit.least_squares import describe
from ..fit.simulate import Records, free_run, simulate
from ..inversion.compensator import Compensator
from ..models.model import Model
from ..symbolic.signals import u
from .compensate import Followed, caution, follow
from .result_file import finite

Array = np.ndarray
LEVEL = 0.95  # of the band, and of what is called worst
GAINS = 1.05  # times less error: with less the law is not said to help
RESTS = 0.01  # share of the time at a limit that needs no word


@dataclass(frozen=True, eq=False)
class Commissioning:
    """What a run of a law over a reference would give on the machine.

    Attributes
    ----------
    law : Compensator
    r : (N,) array, the reference [unit of the output]
    run : the law's run: its input and where it starts
    low, high : (N,) arrays, the band of the tracking error, 95 % at each sample [unit of the output]
    errors : (draws,) array, rms tracking error of each parameter set with what its model leaves unexplained
    unexplained : rms of what the model leaves on its records, part of every error [unit of the output]
    without : rms error where the straight line through the records is inverted instead [unit of the output]
    steepest : largest change of the input [its unit per sample]
    at_limits : share of the time at a limit of the input
    against : what speaks against it, in sentences
    """

    law: Compensator
    r: Array
    run: Followed
    low: Array
    high: Array
    errors: Array
    unexplained: float
    without: float
    steepest: float
    at_limits: float
    against: tuple[str, ...]

    @property
    def expected(self) -> float:
        """Median rms tracking error [unit of the output]."""
        return float(np.median(self.errors))

    @property
    def worst(self) -> float:
        """The rms tracking error that 95 % of the parameter sets stay below [unit of the output]."""
        return float(np.quantile(self.errors, LEVEL))

    @property
    def go(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.against

    def sentence(self, units: Mapping[str, str] | None = None) -> str:
        """Return go or no go, in words; by default in the units of the model."""
        known = said_first(self.law.model.info.units, units)
        of_y, of_u = (f" {known[name]}" if known.get(name) else "" for name in ("y", "u"))
        gain = self.without / self.expected if self.expected else np.inf
        times = f", {gain:.3g} times less than without the law" if np.isfinite(gain) and gain > GAINS else ""
        text = f"Expected: an error of {self.expected:.3g}{of_y} rms{times}; 95 % of the parameter sets stay below"
        left = f"What the model leaves unexplained, {self.unexplained:.3g}{of_y} rms, is part of it."
        text += f" {self.worst:.3g}{of_y}. {left}"
        text += f" The input changes by up to {self.steepest:.3g}{of_u} per sample."
        return f"{'Go' if self.go else 'No go'}. {text}{''.join(f' {reason}.' for reason in self.against)}"


def commission(
    law: Compensator,
    reference: Array,
    records: Records,
    *,
    m0: float | None = None,
    limits: tuple[float, float] | None = None,
    rate: float | None = None,
    share: Share = "auto",
    draws: int = 200,
    seed: int = 0,
) -> Commissioning:
    """Run a law over a reference, and its input through many models that the records allow as well.

    The parameter sets are those of a moving-block bootstrap (Kunsch 1989) of the records on which the model was
    fitted; to each run a piece of what the model leaves unexplained there is added, drawn in blocks too.

    Parameters
    ----------
    reference : (N,) array [unit of the output]
    records : Record or list of Record
    m0, limits, rate, share : as `Compensator.run` takes them
    draws : int

    Raises
    ------
    ModelError
        Where the model has further inputs, or models the input from the output.
    Unreachable
        Where the reference cannot be followed at all.
    """
    model = law.model
    if model.channels or model.input != u:
        raise ModelError(
            "Commissioning needs a law from a model of the output with one input; use Python for this one."
        )
    listed = prepare(records, model.info.units)
    r = np.asarray(reference, dtype=float)
    run = follow(law, r, m0, limits=limits, rate=rate, share=law.share(share))
    left = np.concatenate([s.y - free_run(model, s) for one in listed for s in one.segments()])
    drawn = block_bootstrap(model, listed, draws, seed=seed)
    rng = np.random.default_rng(seed)
    size, many = block_length(left, left.size // 4), -(-r.size // left.size)
    gaps, diverged = [], 0
    for theta in drawn.thetas:
        try:
            got = simulate(model.replace(theta=theta.tolist()), run.m, r[0], u0=run.start, warn=False)
        except Diverged:
            diverged += 1
            continue
        gaps.append(got - r + moving_blocks(left, size, many, rng).ravel()[: r.size])
    if not gaps:
        raise ModelError(
            "The model diverges under the input of the law for every parameter set that the records allow."
        )
    found = np.array(gaps)
    # Of few sets the outermost are no bounds: this estimate is unbiased (Weibull 1939).
    low, high = np.quantile(found, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0, method="weibull")
    errors = np.sqrt(np.mean(found**2, axis=1))
    steps = np.abs(np.diff(run.m, prepend=run.start))
    at_limits = float(np.mean((run.m <= limits[0]) | (run.m >= limits[1]))) if limits else 0.0
    seen = describe(model, listed, model.info.method, bool(model.info.converged))
    without = _without(seen, r, limits)
    info, Ts = seen.info, model.Ts
    against = [*beyond(info, "u", "input", [run.m], Ts), *beyond(info, "y", "reference", [r], Ts)]
    if said := caution(law, share):
        against.append(said.rstrip("."))
    if diverged:
        against.append(f"{diverged} of {draws} parameter sets that the records allow run away")
    if at_limits > RESTS:
        against.append(f"The input is at a limit for {100 * at_limits:.2g} % of the time")
    if np.quantile(errors, LEVEL) >= without:
        against.append(f"Without the law the error would be {without:.3g} rms, which is no worse than what may come")
    left_rms = float(np.sqrt(np.mean(left**2)))
    against = [said[0].upper() + said[1:] for said in against]
    return Commissioning(
        law, r, run, low, high, errors, left_rms, without, float(steps.max()), at_limits, tuple(against)
    )


def write_commissioning(found: Commissioning, path: Path) -> None:
    """Write the figures as JSON."""
    rows = {
        "schema": 1, "go": found.go, "expected": found.expected, "worst": found.worst, "without": found.without,
        "unexplained": found.unexplained, "steepest": found.steepest, "at_limits": found.at_limits,
        "against": list(found.against), "sentence": found.sentence({}),
    }  # fmt: skip
    write_text(path, json.dumps(finite(rows), indent=1, sort_keys=True, allow_nan=False) + "\n")


def _without(model: Model, r: Array, limits: tuple[float, float] | None) -> float:
    """Return the rms error where the line through the records is inverted [unit of y]; inf where it diverges."""
    offset, slope = model.info.line or (0.0, 1.0)
    if slope == 0:
        return np.inf
    m = np.clip((r - offset) / slope, *(limits or (-np.inf, np.inf)))
    try:
        return float(np.sqrt(np.mean((simulate(model, m, r[0], u0=float(m[0]), warn=False) - r) ** 2)))
    except Diverged:
        return np.inf
