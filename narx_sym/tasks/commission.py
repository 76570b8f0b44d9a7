"""Before a law goes on the machine: how well it would track, by Monte Carlo, and what speaks against it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..data.evidence.noise import CLEARLY, sensor_noise
from ..data.metrics import rms
from ..data.units import in_units, said_first
from ..errors import Diverged, ModelError
from ..fit.bootstrap import as_large, block_bootstrap, fresh_blocks
from ..fit.coverage import beyond
from ..fit.evaluate import free_run
from ..fit.identify import prepare
from ..fit.laws.damping import Share
from ..fit.least_squares import describe
from ..fit.simulate import Records, segments, simulate, vector
from ..inversion.compensator import Compensator, ends
from ..models.info import whole
from ..models.model import Model
from ..symbolic.numbers import sized
from ..symbolic.signals import u
from .compensate import Followed, Straight, caution, follow, straight
from .result_file import write_plain

Array = np.ndarray
LEVEL = 0.95  # of the band, and of what is called worst
WITHOUT = "with the best constant gain instead of the law"
GAINS = 1.05  # times less error, or more: with less the law is not said to help, or to harm
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
    unexplained : median rms of what is added of that, part of every error [unit of the output]
    sensor : standard deviation of the sensor's noise in the records; what is left beyond it may come with the motion
    plain : the input of the best constant gain, which the law is compared with
    without : median of the same errors under that input [unit of the output]
    steepest : largest change of the input [its unit per sample]
    at_limits : share of the time at a limit of the input, or of its rate
    against : what speaks against it, in sentences
    """

    law: Compensator
    r: Array
    run: Followed
    low: Array
    high: Array
    errors: Array
    unexplained: float
    sensor: float
    plain: Straight
    without: float
    steepest: float
    at_limits: float
    against: tuple[str, ...] = ()

    @property
    def expected(self) -> float:
        """Median rms tracking error [unit of the output]."""
        return float(np.median(self.errors))

    @property
    def worst(self) -> float:
        """The rms tracking error that 95 % of the simulated runs stay below [unit of the output]."""
        return float(np.quantile(self.errors, LEVEL))

    @property
    def go(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.against

    def sentence(self, units: Mapping[str, str] | None = None) -> str:
        """Return go or no go, in words; by default in the units of the model."""
        known = said_first(self.law.model.info.units, units)
        of_y, of_u = (known.get(name, "") for name in ("y", "u"))
        gain = self.without / self.expected if self.expected else np.inf
        less = f"{gain:.3g} times less than" if gain > GAINS else "no less than"
        beside = f", {less} {WITHOUT} ({self.plain})" if np.isfinite(gain) else ""
        text = f"Expected: an error of {sized(self.expected, of_y)} rms{beside}; 95 % of the simulated runs"
        left = f"This includes {sized(self.unexplained, of_y)} rms that the model does not explain."
        if 0 < CLEARLY * self.sensor < self.unexplained:  # it is drawn by chance, and may be none
            left += (
                f" The sensor causes {sized(self.sensor, of_y, 2)} of that. The rest comes with the motion, for "
                "example from friction or slack that the model does not contain. It may be larger on this reference, "
                "and no bound is known for it."
            )
        text += f" stay below {sized(self.worst, of_y)}. {left}"
        text += f" The input changes by up to {sized(self.steepest, of_u)} per sample."
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
    validation: Records = (),
) -> Commissioning:
    """Predict the error of a law on the machine: simulate it on many models that fit the records.

    The parameter sets are those of a moving-block bootstrap (Kunsch 1989) of the records on which the model was
    fitted; to each run a piece of what the model leaves unexplained there is added, drawn in blocks too, from a
    resampled record: how much is left on one record is not how much is left on the next.

    Parameters
    ----------
    reference : (N,) array [unit of the output]
    records : Record or list of Record
    m0, limits, rate, share : as `Compensator.run` takes them
    draws : int
    validation : Record or list of Record
        What the model leaves unexplained is taken from these, where they are given.

    Raises
    ------
    ModelError
        Where the model has further inputs, or models the input from the output.
    Unreachable
        Where the reference cannot be followed at all.
    """
    model, limits = law.model, ends(limits)
    _check(model, draws)
    listed, r, share = prepare(records, model.info.units), vector(reference, "reference", least=2), law.share(share)
    run = follow(law, r, m0, limits=limits, rate=rate, share=share)
    judged = in_units(segments(validation), model.info.units) if validation else segments(listed)
    left = np.concatenate([s.y - free_run(model, s) for s in judged])
    drawn = block_bootstrap(model, listed, draws, seed=seed)
    noise = fresh_blocks(as_large(left, len(model.symbols)), drawn.block, draws, r.size, np.random.default_rng(seed))

    def missed(m: Array, start: float) -> Array:
        """Return y - r under an input for each parameter set, (sets, N); NaN where that one runs away."""
        found = np.full((draws, r.size), np.nan)
        for one, theta, more in zip(found, drawn.thetas, noise, strict=True):
            with suppress(Diverged):
                one[:] = simulate(model.replace(theta=theta.tolist()), m, r[0], u0=start, warn=False) - r + more
        return found

    gaps = missed(run.m, run.start)
    errors = rms(gaps)
    stays = np.isfinite(errors)
    if not stays.any():
        raise ModelError("The model diverges under the input of the law for every parameter set that fits the records.")
    # Of few sets the outermost are no bounds: this estimate is unbiased (Weibull 1939).
    low, high = np.quantile(gaps[stays], [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0, method="weibull")
    seen = describe(model, listed, model.info.method, bool(model.info.converged)).info
    plain = straight(model, r, limits, rate)
    bare = rms(missed(plain.m, float(plain.m[0])))
    worse = float(np.mean(errors[stays] > GAINS * bare[stays]))  # set by set: the same machine, the same noise
    found = Commissioning(
        law, r, run, low, high,
        errors=errors[stays], unexplained=float(np.median(rms(noise[stays]))), sensor=sensor_noise(listed),
        plain=plain, without=float(np.median(np.nan_to_num(bare, nan=np.inf))),
        steepest=float(np.abs(np.diff(run.m, prepend=run.start)).max()),
        at_limits=float(run.held.mean()),
    )  # fmt: skip
    said = [*beyond(seen, "u", "input", [run.m], model.Ts), *beyond(seen, "y", "reference", [r], model.Ts)]
    said += filter(None, [caution(law, share).rstrip(".")])
    if not stays.all():
        said.append(f"{np.sum(~stays)} of {draws} parameter sets that fit the records diverge")
    if found.at_limits > RESTS:
        said.append(f"the input is at a limit for {100 * found.at_limits:.0f} % of the time")
    if worse > 1 - LEVEL:
        said.append(f"for {100 * worse:.0f} % of the parameter sets the error is larger than {WITHOUT}")
    return replace(found, against=tuple(text[0].upper() + text[1:] for text in said))


def _check(model: Model, draws: int) -> None:
    """Refuse models whose law cannot be judged so, and too few draws."""
    whole(draws=draws)
    if draws < 2:
        raise ModelError(f"At least 2 parameter sets must be drawn, not {draws}.")
    if model.channels or model.input != u:
        raise ModelError(
            "Commissioning needs the law of a model with one input and one output; use Python for this model."
        )


def write_commissioning(found: Commissioning, path: Path) -> None:
    """Write the figures as JSON."""
    named = ("go", "expected", "worst", "sensor", "without", "unexplained", "steepest", "at_limits", "against")
    rows = {"schema": 1, "sentence": found.sentence({}), **{name: getattr(found, name) for name in named}}
    rows["without_input"] = {"offset": found.plain.offset, "slope": found.plain.slope}
    write_plain(rows, path)
