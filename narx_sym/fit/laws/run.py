"""Laws run over a reference: start at rest, limits of the actuator, damping, what cannot be reached."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from ...engines.compile import compile
from ...errors import Diverged, ModelError, Unreachable
from ...inversion.compensator import Compensator, allowed, ends
from ...inversion.halving import halved
from ...inversion.piecewise import FURTHER, TURNING
from ...models.model import Model
from ...symbolic.recursion import Recursion
from ...symbolic.signals import y
from ..simulate import fitted, named, vector
from .backtracking import INEXACT, corrected
from .damping import Share, damping, share_of
from .driven import driven
from .internal import law_warnings, run_away
from .start import rest_input
from .trial import alone, growth

Array = np.ndarray
MISSED = 1e-6  # of the reference's range: more than this off is missed
ASIDE = 1e-6  # of the reference's range: an error of the start
RUNS_AWAY = 1e3  # times that a disturbance grows


@dataclass(frozen=True)
class Following:
    """A run of a law, and what the model does then.

    Attributes
    ----------
    m : (N,) array [unit of u]
    y : (N,) array [unit of y]
        What the model makes of that input by itself, all at rest before the start: infinite from where it runs away.
    held : (N,) bool array
        Where a limit or the rate holds the input back.
    missed : (N,) bool array
        Where that is not the reference, once the law's first command has arrived.
    unreached : (N,) bool array
        The same of a model whose output stays at the first sample of the reference until then, as the law has it: what
        the law itself misses, whatever the start.
    error : float
        The largest distance between both from there on [unit of y].
    values : mapping of names to (N + preview,) arrays
        Every sequence of the law as the recursion computes it.
    share : float
        Of the change that it asks for, the input goes this part in a sample; 1 where the law is not damped.
    tried : int
        How many other choices between several inputs were tried, where the first one missed; see
        `narx_sym.fit.laws.backtracking`.
    grown : float
        Where something is not reached: by how much a disturbance of the input grows until then, or along that of the
        other choices that came furthest, whichever is more.
    aside : float
        By how much the model leaves that sample before any command arrives, where it does not rest at the start.
    """

    m: Array
    y: Array
    held: Array
    missed: Array
    unreached: Array
    error: float
    values: Mapping[str, Array]
    share: float = 1.0
    tried: int = 0
    grown: float = 0.0
    aside: float = 0.0

    @property
    def runs_away(self) -> bool:
        """Whether what the law misses is its own error, which has grown."""
        return self.grown >= RUNS_AWAY

    @property
    def why(self) -> str:
        """Say what led to the first miss; empty where nothing is known."""
        if self.runs_away:
            times = f"{self.grown:.1g} times" if self.grown < np.inf else "without limit"
            where = " along the best of them" if self.tried else ""
            other = f"{self.tried} other choices between several inputs were tried. " if self.tried else ""
            return f"{other}The law diverges: until then a disturbance of its input grows {times}{where}"
        if self.tried:
            return (
                f"{self.tried} other choices between several possible inputs were tried up to this sample: each of "
                "them misses the reference later"
            )
        if self.aside:
            return (
                f"The model is not at rest at the start: it moves by {self.aside:.3g} before the first command "
                "arrives, and the law does not know this"
            )
        return ""

    @property
    def holds(self) -> str:
        """Say in how many samples limits hold the input; empty where they never do."""
        if not self.held.any():
            return ""
        return f"the input is at a limit of the actuator in {self.held.mean():.1%} of the samples"

    @property
    def report(self) -> list[str]:
        """What is held and missed, in words; empty where nothing is."""
        found = [self.holds] if self.holds else []
        if self.share < 1:
            where = f"with damping the model stays within {self.error:.3g} of the reference"
            found.append(f"{where}. {self.why}" if self.runs_away else where)
        elif self.missed.any():
            found.append(
                f"the model misses the reference in {self.missed.mean():.1%} of the samples, first at sample "
                f"{int(np.argmax(self.missed))}, by {self.error:.3g} at most{f'. {self.why}' if self.why else ''}"
            )
        elif self.tried:
            found.append(
                "where several inputs are possible, the law revised earlier choices, because it knows the whole "
                "reference; computed sample by sample on a machine it would miss some samples"
            )
        return found


def run_law(
    law: Compensator,
    reference: Any,
    m0: Any = None,
    channels: Mapping[str, Any] | None = None,
    limits: Sequence[float] | None = None,
    rate: float | None = None,
    clip: bool = False,
    share: Share = "auto",
) -> Array:
    """Compute the compensated input for a reference.

    Parameters
    ----------
    reference : (N,) array [unit of y]
        The law looks `law.preview` samples ahead; after its end the reference is held.
    m0 : number, optional
        The input before the start, at rest [unit of u]. By default the one at which the model rests at r[0], within
        the limits; see `narx_sym.fit.laws.start`.
    channels : mapping of names to (N,) arrays
        Further measured sequences that the law uses; it reads them ahead like the reference. (On a machine, where the
        future of a channel is not known, hold its newest value.) `t`, time in seconds, starts from 0 unless it is
        given.
    limits : (lowest, highest) input, optional [unit of u]
    rate : largest change of the input from sample to sample, optional [unit of u]
    clip : bool
        Come as near as possible where the reference cannot be reached, and warn. With `limits` or `rate` this is so
        anyway.
    share : "auto", None or a number up to 1
        Of the change that the law asks for, the input goes this part in a sample. "auto" damps a law that rings, and
        warns; see `narx_sym.fit.laws.damping`. None never does.

    Returns
    -------
    m : (N,) array [unit of u]

    Raises
    ------
    Diverged
        Where the law runs away: the first bad sample.
    Unreachable
        Where no input gives the wanted output: the first sample, and how near the model comes.
    """
    fitted(law.model)
    target, limits = vector(reference, "reference", least=2), ends(limits)
    m0 = None if m0 is None else vector(np.atleast_1d(m0), "input before the start, m0,")[0]
    start = rest_input(law, float(target[0]), limits) if m0 is None else float(m0)
    found, said = told(law, target, start, channels, limits, rate, clip, share)
    for warning in said:
        warnings.warn(warning, stacklevel=2)
    return found.m


def exported(
    law: Compensator, limits: Sequence[float] | None = None, rate: float | None = None, share: Share = "auto"
) -> Recursion:
    """Return the equations that a controller computes in each sample; arguments as for `run_law`.

    It is the law alone where that reaches every reference; else the model is beside it. A root that is proved to be
    alone is found in a fixed number of steps, with the present values of the parameters in the place of their symbols.

    Raises
    ------
    NotInvertible
        Where a root finder is needed, and it is not proved that there is one root.
    """
    part = share_of(law, share)
    alone = limits is None and rate is None and part == 1 and law.staged is None
    return law.recursion if alone else halved(law, law.limited(limits, rate, part))


def told(
    law: Compensator,
    target: Array,
    start: float,
    channels: Mapping[str, Any] | None = None,
    limits: Sequence[float] | None = None,
    rate: float | None = None,
    clip: bool = False,
    share: Share = "auto",
) -> tuple[Following, list[str]]:
    """Run a law from an input before the start, and return what `run_law` warns of; errors as there."""
    channels = law.named(named(channels))
    found = follow(law, target, start, channels, limits, rate, share)
    # A law that runs away misses too: the cause is said first.
    known = law_warnings(law, target, found.m, start, found.share < 1)
    if found.runs_away and found.share < 1 and limits is None and rate is None:
        raise Diverged(
            f"The law diverges although it is damped: a disturbance of its input grows {found.grown:.1g} times, and "
            f"the error of the model reaches {found.error:.3g}. Give limits of the input, a slower reference, or "
            "stronger damping (a smaller --share).",
            int(np.argmax(found.missed)),
            found.m,
        )
    if found.unreached.any() and limits is None and rate is None and found.share == 1 and not clip:
        raise _unreachable(law, found, target)
    rings = [damping(law).sentence] if share == "auto" and found.share < 1 else []
    return found, [*rings, *found.report, *_unstable(law.model, found, target, start, channels), *known]


def follow(
    law: Compensator,
    reference: Any,
    m0: Any = None,
    channels: Mapping[str, Any] | None = None,
    limits: Sequence[float] | None = None,
    rate: float | None = None,
    share: Share = "auto",
    back: bool = True,
) -> Following:
    """Compute the compensated input and the output of the model; parameters and errors as for `run_law`.

    Parameters
    ----------
    back : bool
        Whether a law without limits and damping goes back to an earlier choice where it misses the reference, which a
        machine cannot; see `narx_sym.fit.laws.backtracking`.
    """
    fitted(law.model)
    target, limits = vector(reference, "reference", least=2), ends(limits)
    n = target.size
    start = rest_input(law, float(target[0]), limits) if m0 is None else float(m0)
    if not np.isfinite(start):
        raise ModelError("The input before the start, m0, is not finite.")
    low, high = allowed(limits, rate)
    if not low <= start <= high:
        raise ModelError(f"The input before the start, m0 = {start:.6g}, is outside the limits {low:g} to {high:g}.")
    part, channels = share_of(law, share), law.named(named(channels))
    # The model runs beside the law, from the first output on: what acts on it then is made up for.
    beside = law.model.input != y or limits is not None or rate is not None
    compiled = compile(law.limited(limits, rate, part) if beside else law.recursion)
    free = back and beside and law.model.input != y and limits is None and rate is None and part == 1
    values, tried, furthest, diverged = None, 0, 0.0, None
    try:
        values = driven(law, compiled, target, start, channels, beside)
    except Diverged as error:
        diverged = error
    if free:
        values, tried, furthest = corrected(law, target, start, channels, values)
    if values is None:
        assert diverged is not None
        raise _diverged(law, target, start, diverged, compiled.recursion.depth) from None
    command = values["m"][:n]
    last = np.concatenate([[start], command[:-1]])
    asked = values.get("m_wanted", values["m"])[:n]
    asked = asked if part == 1 else last + part * (asked - last)
    held = np.abs(asked - command) > 1e-12 * (1.0 + np.abs(command)) if beside else np.zeros(n, dtype=bool)
    none = np.zeros(n, dtype=bool)
    if not beside or law.model.input == y:
        return Following(command, target, held, none, none, 0.0, values)
    ahead, size = law.staged.delay if law.staged else law.preview, float(np.abs(target).max())
    least = MISSED * max(float(np.ptp(target)), 1e-3 * size) + 1e-12 * (1.0 + size)
    reached = alone(law.model, command, target[0], start, channels)
    seen = np.concatenate([np.full(ahead, target[0]), values["y"]])[:n]
    gap, own = (np.where(np.arange(n) < ahead, 0.0, np.abs(x - target)) for x in (reached, seen))
    missed, unreached = gap > least, own > least
    off = own > INEXACT * size if free else unreached
    grown = growth(law, target, start, channels, int(np.argmax(off))) if free and off.any() else 0.0
    if part < 1:  # damped for slow motion: along this reference it may run away all the same
        grown = growth(law, target, start, channels, n - 1, share=part)
    grown = max(grown, furthest)
    moved = float(np.abs(reached - target[0])[: max(1, ahead)].max()) if ahead else 0.0
    return Following(
        command, reached, held, missed, unreached, float(gap.max()), values, part, tried, grown,
        moved if moved > least else 0.0,
    )  # fmt: skip


def _unstable(model: Model, found: Following, target: Array, start: float, channels: Mapping[str, Any]) -> list[str]:
    """Say where the model itself runs away from where the law has it: no input alone holds it there."""
    if model.input == y:
        return []
    aside = ASIDE * (float(np.ptp(target)) or 1.0)
    with np.errstate(all="ignore"):
        there = alone(model, found.m, target[0] + aside, start, channels)
        grown = float(np.nan_to_num(np.abs(there - found.y), nan=np.inf).max() / aside)
    if grown < RUNS_AWAY:
        return []
    times = f"{grown:.1g} times" if grown < np.inf else "without limit"
    return [
        f"the model is unstable: an error of its start grows {times}, and no input computed in advance can correct it"
    ]


def _diverged(law: Compensator, target: Array, start: float, error: Diverged, depth: int) -> Diverged:
    """Say what may have made a law diverge, after `depth` samples before the start."""
    path = np.asarray(error.trajectory)[depth : max(depth, error.at)]
    before = ", ".join(f"{v:.3g}" for v in path[-3:])
    causes = " ".join(run_away(law, target, path[:-1], start)) or (
        "Likely causes: zeros of the model outside the unit circle, an input before the start that does not fit, or a "
        "reference that the model cannot follow."
    )
    said = f"The law diverges: its input m is not finite at sample {error.at - depth}"
    return Diverged(f"{said} (before it: {before}). {causes}", error.at, error.trajectory)


def _unreachable(law: Compensator, found: Following, target: Array) -> Unreachable:
    """Say where a reference cannot be reached, and how near the model comes."""
    at = int(np.argmax(found.unreached))
    limit = "at most" if found.y[at] < target[at] else "at least"
    stages = law.staged.stages if law.staged else ()
    why = f"{found.why}. " if found.why else ""
    if flat := any(s.flat for s in law.open_stages()):
        why += "Before that, several inputs gave the same output (a flat piece); another choice leads to other inputs. "
    known = "; ".join(dict.fromkeys(s.proof for s in stages if s.reach != (-sp.oo, sp.oo) or s.needs or s.notes))
    sure = (
        not flat
        and not found.runs_away
        and all(
            (s.closed_form or s.steep is not None) and not s.needs and not {FURTHER, TURNING} & {*s.notes}
            for s in stages
        )
    )
    said = "The reference cannot be reached" if sure else "The law does not reach the reference"
    return Unreachable(
        f"{said} at sample {at}: r = {target[at]:.6g}, the model gives {limit} "
        f"{found.y[at]:.6g} there{f' ({known})' if known else ''}. {int(found.missed.sum())} of {target.size} samples "
        f"are missed, by {found.error:.3g} at most. {why}Shrink or shift the reference, or use clip=True (--clip) to "
        "come as close as possible.",
        at,
    )
