"""Laws run over a reference: start at rest, limits of the actuator, what cannot be reached, branches counted."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from ..engines.columns import lambdify
from ..engines.compile import Compiled, compile
from ..errors import Diverged, ModelError, NarxError, Unreachable
from ..inversion.compensator import Compensator
from ..inversion.solution import Solution
from ..symbolic.signals import lag, r, samples, t, y
from .excursions import law_warnings, run_away
from .simulate import fitted, rest_input, rest_states, vector

Array = np.ndarray
MISSED = 1e-6  # of the reference's range: more than this off is missed
POINTS, GRID, TRIAL = 200, 801, 400  # where solutions are counted, on how fine a grid, along a sine of this length


@dataclass(frozen=True)
class Following:
    """A run of a law, and what the model does then.

    Attributes
    ----------
    m : (N,) array [unit of u]
    y : (N,) array [unit of y]
        What the model gives: the reference wherever it is reached, once the law's first command has arrived.
    held : (N,) bool array
        Where a limit or the rate holds the input back.
    missed : (N,) bool array
        Where the model's output is not the reference.
    error : float
        The largest distance between both [unit of y].
    values : mapping of names to (N + preview,) arrays
        Every sequence of the law as the recursion computes it.
    """

    m: Array
    y: Array
    held: Array
    missed: Array
    error: float
    values: Mapping[str, Array]

    @property
    def report(self) -> list[str]:
        """What is held and missed, in words; empty where nothing is."""
        found = []
        if self.held.any():
            found.append(f"the limits of the actuator hold the input in {self.held.mean():.1%} of the samples")
        if self.missed.any():
            found.append(
                f"the model misses the reference in {self.missed.mean():.1%} of the samples, first at sample "
                f"{int(np.argmax(self.missed))}, by {self.error:.3g} at most"
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
) -> Array:
    """Compute the compensated input over a reference.

    Parameters
    ----------
    reference : (N,) array [unit of y]
        The law looks `law.preview` samples ahead; after its end the reference is held.
    m0 : number, optional
        The input before the start, at rest [unit of u]. By default the line through the fitted data at r[0].
    channels : mapping of names to (N,) arrays
        Further measured sequences that the law uses; it reads them ahead like the reference. (On a machine, where the
        future of a channel is not known, hold its newest value.) `t`, time in seconds, starts from 0 unless it is
        given.
    limits : (lowest, highest) input, optional [unit of u]
    rate : largest change of the input from sample to sample, optional [unit of u]
    clip : bool
        Come as near as possible where the reference cannot be reached, and warn. With `limits` or `rate` this is so
        anyway.

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
    target = vector(reference, "reference", least=2)
    start = rest_input(law.model, float(target[0])) if m0 is None else m0
    found = follow(law, target, start, channels, limits, rate)
    known = law_warnings(law, target, found.m, start)  # a law that runs away misses too: the cause is said first
    if found.missed.any() and limits is None and rate is None and not clip:
        raise _unreachable(law, found, target)
    for warning in [*found.report, *known]:
        warnings.warn(warning, stacklevel=2)
    return found.m


def follow(
    law: Compensator,
    reference: Any,
    m0: Any = None,
    channels: Mapping[str, Any] | None = None,
    limits: Sequence[float] | None = None,
    rate: float | None = None,
) -> Following:
    """Compute the compensated input and what the model then does; parameters and errors as for `run_law`."""
    theta = fitted(law.model)
    target = vector(reference, "reference", least=2)
    start = rest_input(law.model, float(target[0])) if m0 is None else float(m0)
    if not np.isfinite(start):
        raise ModelError("The input before the start, m0, is not finite.")
    # The model runs beside the law: what acts on the output before the first command arrives is then made up for.
    beside = law.model.input != y or limits is not None or rate is not None
    compiled = compile(law.limited(limits, rate) if beside else law.recursion)
    given = _padded(law, compiled, target, channels or {})
    first = {name: float(c[0]) for name, c in given.items()}
    initial = rest_states(law.model, start, float(target[0]), first) if beside else {}
    initial |= {"m": start, str(law.model.output.label): float(target[0])}
    depth, n = compiled.recursion.depth, target.size
    try:
        runs = compiled(given, theta, initial, start=depth, output="m")
    except Diverged as error:
        said = " ".join(run_away(law, target, np.asarray(error.trajectory)[depth : max(depth, error.at - 1)], start))
        raise Diverged(f"{error} {said}".strip(), error.at, error.trajectory) from None
    values = {name: run[depth:] for name, run in runs.items()} | {name: c[depth:] for name, c in given.items()}
    command = values["m"][:n]
    asked = values.get("m_wanted", values["m"])[:n]
    held = np.abs(asked - command) > 1e-12 * (1.0 + np.abs(command)) if beside else np.zeros(n, dtype=bool)
    if not beside or law.model.input == y:
        return Following(command, target, held, np.zeros(n, dtype=bool), 0.0, values)
    ahead = law.staged.delay if law.staged else law.preview
    reached = np.concatenate([np.full(ahead, target[0]), values["y"]])[:n]
    gap = np.abs(reached - target)
    gap[:ahead] = 0.0  # no law reaches these
    size = float(np.abs(target).max())
    missed = gap > MISSED * max(float(np.ptp(target)), 1e-3 * size) + 1e-12 * (1.0 + size)
    return Following(command, reached, held, missed, float(gap.max()), values)


def law_start(law: Compensator, output: float, m0: float | None = None) -> dict[str, float]:
    """Return the values before the start, at rest, by name: what the recursion and the C source begin with."""
    begin = rest_input(law.model, float(output)) if m0 is None else float(m0)
    rest = rest_states(law.model, begin, float(output))
    return {"m": begin, "r": float(output), str(law.model.output.label): float(output)} | rest


def law_rest_input(law: Compensator, output: float) -> float:
    """Return the input to start from; see `narx_sym.fit.simulate.rest_input`."""
    return rest_input(law.model, float(output))


def _padded(law: Compensator, compiled: Compiled, target: Array, channels: Mapping[str, Any]) -> dict[str, Array]:
    """Put the time before the start in front: everything rests at its first value; after the end at its last."""
    given = {"r": target, **{name: vector(c, f"channel {name}") for name, c in channels.items()}}
    depth, ahead, Ts = compiled.recursion.depth, 0, law.model.Ts or 1.0
    if t in compiled.recursion.inputs and "t" not in given:
        given["t"], ahead = np.arange(target.size) * Ts, compiled.recursion.lead
    padded = {n: np.concatenate([np.full(depth, c[0]), c, np.full(ahead, c[-1])]) for n, c in given.items()}
    if ahead:  # the law's own clock goes on
        padded["t"][depth + target.size :] += np.arange(1, ahead + 1) * Ts
    return padded


def _unreachable(law: Compensator, found: Following, target: Array) -> Unreachable:
    """Say where a reference cannot be reached, and how near the model comes."""
    at = int(np.argmax(found.missed))
    limit = "at most" if found.y[at] < target[at] else "at least"
    stages = law.staged.stages if law.staged else ()
    known = "; ".join(dict.fromkeys(s.proof for s in stages if s.reach != (-sp.oo, sp.oo) or s.needs or s.notes))
    return Unreachable(
        f"The reference cannot be reached at sample {at}: r = {target[at]:.6g}, the model gives {limit} "
        f"{found.y[at]:.6g} there{f' ({known})' if known else ''}. {int(found.missed.sum())} of {target.size} samples "
        f"are missed, by {found.error:.3g} at most. Shrink or shift the reference, or come as near as possible with "
        "clip=True (--clip).",
        at,
    )


# -- branches in numbers ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Check:
    """What is known about the solutions of a law's stages.

    Attributes
    ----------
    proofs : texts
        What algebra says about each stage.
    proved : bool
        Whether algebra leaves nothing open: exactly one solution, wherever the machine is.
    points : int
        Where solutions were counted, along a run; 0 where that was not needed or not possible.
    none, several : float
        The share of the points without a solution, and with more than one within the range of the run, widened by half.
    first : mapping of "none" and "several" to the reference at the first such point [unit of y]
    """

    proofs: tuple[str, ...]
    proved: bool = False
    points: int = 0
    none: float = 0.0
    several: float = 0.0
    first: Mapping[str, float] | None = None

    @property
    def good(self) -> bool:
        """Whether nothing speaks against exactly one solution."""
        return not self.none and not self.several and (self.proved or self.points > 0)

    def __str__(self) -> str:
        said = "; ".join(self.proofs)
        if not self.points:
            return said if self.proved else f"{said}. Not counted: give a reference to check(reference)"
        counted = f"{said}. Counted at {self.points} points of a run: "
        if self.good:
            return counted + "exactly one solution at each"
        parts = [
            f"{name} at {share:.1%} (first at r = {(self.first or {})[name]:.4g})"
            for name, share in (("none", self.none), ("several", self.several))
            if share
        ]
        return f"{counted}one at {1 - self.none - self.several:.1%}, {', '.join(parts)}"


def check(law: Compensator, reference: Any = None, m0: Any = None, channels: Mapping[str, Any] | None = None) -> Check:
    """Say whether each stage of a law has exactly one solution: by proof, else by counting along a run.

    Parameters
    ----------
    reference : (N,) array, optional [unit of y]
        By default a slow sine through nine tenths of the identified outputs, where algebra leaves something open;
        further channels are zero then.
    """
    stages = law.staged.stages if law.staged else ()
    note = (law.staged.note,) if law.staged and law.staged.note else ()
    proofs = (*(s.proof for s in stages), *note) or ("m[k] enters linearly: exactly one for every reference",)
    is_open = any(s.needs or not s.proved for s in stages)
    low, high = law.model.info.ranges.get("y", (0.0, 0.0))
    if not stages or not law.model.values or (reference is None and not (is_open and high > low)):
        return Check(proofs, not is_open)
    if reference is None:
        wave = np.sin(2 * np.pi * np.arange(TRIAL) / (TRIAL / 2))
        reference = (low + high) / 2 + 0.45 * (high - low) * wave
        channels = {name: np.zeros(TRIAL) for name in law.model.channels} | dict(channels or {})
    target = vector(reference, "reference", least=2)
    try:
        found = follow(law, target, m0, channels)
    except NarxError as error:
        return Check((*proofs, f"it does not run: {error}"), not is_open)
    ahead, n = law.preview, target.size
    chosen = np.unique(np.linspace(2, n - ahead - 1, min(POINTS, n - ahead - 2)).astype(int))
    several = np.zeros(chosen.size, dtype=bool)
    for stage in stages:
        several |= _count(law, stage, found, target, chosen) > 1
    none = found.missed[chosen + ahead]
    several &= ~none
    first = {
        name: float(target[chosen + ahead][mask][0])
        for name, mask in (("none", none), ("several", several))
        if mask.any()
    }
    return Check(proofs, not is_open, int(chosen.size), float(none.mean()), float(several.mean()), first)


def _count(law: Compensator, stage: Solution, found: Following, target: Array, at: Array) -> Array:
    """Count the solutions of one stage at some samples of a run: the changes of sign on a grid."""
    assert law.staged is not None
    leads = {left.base: -lag(left) for left, _ in law.beside()}
    delay, names = law.staged.delay, [s for s in samples(stage.expr - stage.target) if s != stage.unknown]
    held = np.concatenate([target, np.full(delay + 1, target[-1])])

    def along(s: Any) -> Array:
        """Return a sample at every chosen k."""
        if s.base == r:  # the law's own past is the model's
            past = np.concatenate([np.full(delay, target[0]), found.values["y"]])
            return held[at + delay] if -lag(s) == delay else past[np.maximum(at - lag(s), 0)]
        if s == stage.target:
            return found.values[f"{s.base.label}_wanted"][at]
        column = found.values[str(s.base.label)]
        place = at - lag(s) - leads.get(s.base, 0)
        return column[np.clip(place, 0, column.size - 1)]

    base = stage.unknown.base
    reached = found.values[str(base.label)][: target.size]
    low, high = float(reached.min()), float(reached.max())
    wide = 0.5 * (high - low) or 1.0
    grid = np.linspace(low - wide, high + wide, GRID)
    plain = [sp.Symbol(f"s{i}", real=True) for i in range(len(names) + 1)]
    gap = (stage.expr - stage.target).xreplace(law.model.values)
    gap = gap.xreplace(dict(zip([*names, stage.unknown], plain, strict=True)))
    columns = [along(s)[:, None] for s in names]
    found_gap = lambdify([gap], plain)(*columns, grid[None, :])[0]
    side = np.broadcast_to(found_gap, (at.size, GRID)) > 0
    return np.asarray((side[:, 1:] != side[:, :-1]).sum(axis=1))
