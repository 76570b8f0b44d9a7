"""The compensation law of a model: what a user should know before it runs, its sources, and a run of it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy as sp
from scipy.optimize import least_squares

from ..codegen.registry import exports, files
from ..data.metrics import nsavi, rms
from ..data.units import headed
from ..diagnosis.progress import Told
from ..engines.compile import compile
from ..errors import Diverged, ModelError, NarxError, NotInvertible
from ..fit.laws.damping import Share
from ..fit.laws.internal import operating_range
from ..fit.laws.run import told
from ..fit.laws.start import rests_at, rests_with
from ..fit.simulate import simulate, vector
from ..inversion.compensator import Compensator, compensator, ends
from ..models.model import Model
from ..symbolic.functions import follows
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, m, u, y
from .base import check_pace
from .reference import Reference

Array = np.ndarray
STEP, CLOSE, MOST_TRIED = 1e-4, 1e-6, 50  # of the search for the best straight line: both numbers are of the size 1
FAR = 1e3  # of the reference's range: as far as a model that runs away


@dataclass(frozen=True)
class Law:
    """A compensation law as text, or why there is none.

    Attributes
    ----------
    lines, latex : the law with numbers; the first line says whether it is stable, and where it is known
    symbols : its LaTeX with symbols
    notes : what a user should know before it runs
    sources : mapping from the endings of files (".c") to the law as source, where it has one
    why_not : str
        "" where there is a law.
    limits : of the input, or None
    rests : the outputs at which the model rests with the input held at either limit, or None
        See `narx_sym.fit.laws.start.rests_at`.
    """

    lines: tuple[str, ...] = ()
    latex: str = ""
    symbols: str = ""
    notes: tuple[str, ...] = ()
    sources: Mapping[str, str | bytes] = field(default_factory=dict)
    why_not: str = ""
    limits: tuple[float, float] | None = None
    rests: tuple[float, float] | None = None


def ahead(law: Compensator) -> str:
    """Say how far a law looks ahead."""
    return f"It looks {law.preview} sample{'' if law.preview == 1 else 's'} ahead in the reference."


def caution(law: Compensator, share: Share = "auto") -> str:
    """Say that a law rings, or where its own dynamics repel in its operating range; an empty text where neither is."""
    damping = law.damping()
    if damping.rings and share == "auto":
        return str(damping.sentence)
    found = operating_range(law) if law.share(share) == 1 else None
    return "" if found is None else found.sentence


def law_of(
    model: Model,
    limits: tuple[float, float] | None = None,
    rate: float | None = None,
    share: Share = "auto",
    force: bool = False,
    progress: Callable[[str], Any] = lambda what: None,
) -> Law:
    """Derive the compensation law of a model, with its source.

    Parameters
    ----------
    limits, rate, share : of the actuator's input and of its change per sample, for the source; as in `Compensator.run`
    force : make the law of a model that its fit said not to use, and the source of one that is unstable
    """
    progress(Told("deriving the compensation law", 1, 2))
    try:
        law = compensator(model, force)
    except (NotInvertible, ModelError) as error:
        return Law(why_not=str(error))
    first, notes = str(law.stability()), [ahead(law)]
    if law.staged:
        progress(Told("counting the solutions of each stage", 2, 2))
        notes.append(f"Checked: {law.checked}.")
    notes += filter(None, [caution(law, share)])
    rests = rests_at(model, limits) if limits else None
    if limits and rests:
        ends = (f"{level:.4g} with {held:.4g}" for level, held in zip(rests, limits, strict=True))
        notes.append(f"With the input at a limit, the steady state of the model is {' and at '.join(ends)}.")
    sources, lacking = _sources(law, limits=limits or "known", rate=rate, share=share, force=force)
    return Law(
        (first, *law.lines(numbers=True)),
        law.latex(numbers=True),
        law.latex(),
        (first, *notes, *lacking),
        sources,
        limits=limits,
        rests=rests,
    )


def _sources(law: Compensator, **options: Any) -> tuple[dict[str, str | bytes], list[str]]:
    """Return the law for every target that is a file, by its ending, and why there is none for others."""
    found: dict[str, str | bytes] = {}
    lacking: dict[str, list[str]] = {}
    for ending, name in files().items():
        try:
            found[ending] = law.export(name, **options)
        except NarxError as error:
            lacking.setdefault(str(error), []).append(exports()[name].title)
    return found, [f"There is no {' and no '.join(titles)}: {why}" for why, titles in lacking.items()]


@dataclass(frozen=True, eq=False)
class Followed:
    """A run of a law over a reference.

    Attributes
    ----------
    m : (N,) array [unit of the input]
    start : float
        The input at rest before it.
    held : (N,) bool array
        Where a limit or the rate holds the input back.
    effort : float or None
        NSAVI against the reference's; None where that does not move.
    rests : bool
        Whether the model rests at that input with the first output of the reference.
    """

    m: Array
    start: float
    held: Array
    effort: float | None
    rests: bool


def follow(
    law: Compensator, r: Array, m0: float | None = None, channels: Mapping[str, Array] | None = None, **options: Any
) -> Followed:
    """Run a law over a reference, (N,) array [unit of the output], from rest.

    Parameters
    ----------
    m0 : float, optional
        Input before the start; what keeps the model at the first sample of the reference by default.
    channels : mapping of names to (N,) arrays, those that the model needs
    options : limits, rate, share, clip, as `Compensator.run` takes them
    """
    _alone(law, channels or {})
    r = vector(r, "reference", least=2)
    start = law.rest_input(r[0], ends(options.get("limits"))) if m0 is None else m0
    found, said = told(law, r, start, channels, **options)
    for warning in said:
        warnings.warn(warning, stacklevel=2)
    first = {name: float(values[0]) for name, values in law.named(channels).items()}
    rests = law.model.input == y or rests_with(law.model, start, float(r[0]), first)
    return Followed(found.m, start, found.held, nsavi(found.m, r) if np.ptp(r) > 0 else None, rests)


def _alone(law: Compensator, known: Mapping[str, Array]) -> None:
    """Refuse a law that needs more channels than those that are known."""
    if lacking := [name for name in law.model.channels if name not in law.named(known)]:
        raise ModelError(f"The law needs the channel {lacking[0]!r}, which is not given here.")


@dataclass(frozen=True, eq=False)
class Straight:
    """What goes in without a law: the straight line input = offset + slope r that is best for a reference.

    Attributes
    ----------
    m : (N,) array, within the limits [unit of the input]
    offset, slope : [unit of the input, unit of the input per unit of the output]
    y : (N,) array, what the model makes of it [unit of the output]; NaN where it runs away
    """

    m: Array
    offset: float
    slope: float
    y: Array

    def __str__(self) -> str:
        offset = self.offset if abs(self.offset) > 1e-9 * float(np.abs(self.m).max()) else 0.0
        return f"input = {self.slope:.3g} r{f' {offset:+.3g}' if offset else ''}"


def straight(model: Model, r: Array, limits: tuple[float, float] | None = None, rate: float | None = None) -> Straight:
    """Return the constant gain and offset with which a model comes nearest to a reference, in least squares.

    They are sought from the line through the records on. What a law gains over them is not a poor choice of the gain.

    Parameters
    ----------
    r : (N,) array, the reference [unit of the output]
    limits, rate : as in `Compensator.run`
    """
    line, wide = model.info.line or (0.0, 1.0), float(np.ptp(r)) or float(np.abs(r).max()) or 1.0
    gain, middle = abs(line[1]) or 1.0, float(np.mean(r))
    limited = None if rate is None else compile(Recursion(((m[k], follows(u[k], m[k - 1], sp.Float(rate))),)))

    def given(z: Array) -> Array:
        """Return the input for its mean, and its slope, in sizes of the line through the records."""
        along = np.clip((z[0] * wide + z[1] * (r - middle)) / gain, *(limits or (-np.inf, np.inf)))
        return along if limited is None else limited({"u": along}, initial={"m": along[0]})["m"]

    def made(z: Array) -> Array:
        m = given(z)
        try:
            return simulate(model, m, r[0], u0=float(m[0]), warn=False)
        except Diverged:
            return np.full(r.size, np.nan)

    def missed(z: Array) -> Array:
        return np.nan_to_num((made(z) - r) / wide, nan=FAR, posinf=FAR, neginf=-FAR)

    z0 = [(middle - line[0]) / wide * np.sign(line[1]), np.sign(line[1])]
    # This method also stands where nothing changes, as where limits hold the input all the time.
    z = least_squares(missed, z0, method="lm", diff_step=STEP, xtol=CLOSE, ftol=CLOSE, max_nfev=MOST_TRIED).x
    return Straight(given(z), float((z[0] * wide - z[1] * middle) / gain), float(z[1] / gain), made(z))


@dataclass(frozen=True, eq=False)
class Tracked:
    """What the model makes of a reference, with the law and without it.

    Attributes
    ----------
    t, r : (N,) arrays, the reference [s, unit of the output]
    m, y : (N,) arrays, the input of the law and the model's output [units of input and output]
    plain : the same with the best constant gain instead of the law
    held : (N,) bool array
        Where limits hold the input of the law.
    limits : of the input, or None
    holds : str
        In how many samples limits hold the input, in words; "" where they never do.
    notes : what a user should know of this run
    """

    t: Array
    r: Array
    m: Array
    y: Array
    plain: Straight
    held: Array
    limits: tuple[float, float] | None
    holds: str
    notes: tuple[str, ...]

    @property
    def errors(self) -> dict[str, tuple[float, float]]:
        """The rms and the largest error with the law and without it [unit of the output]; rounding counts as 0."""
        least = 1e-12 * float(np.abs(self.r).max())
        gaps = {"with the law": self.y - self.r, "without": self.plain.y - self.r}
        sizes = {name: (float(rms(gap)), float(np.abs(gap).max())) for name, gap in gaps.items()}
        return {name: (0.0, 0.0) if found[1] <= least else found for name, found in sizes.items()}

    def columns(self, units: Mapping[str, str]) -> dict[str, Array]:
        """Return time, reference, input and model output by name and unit."""
        named = {"t": (self.t, "s"), "r": (self.r, units.get("y")), "m": (self.m, units.get("u"))}
        named["y"] = (self.y, units.get("y"))
        return {headed(name, unit): values for name, (values, unit) in named.items()}


def track(
    law: Compensator,
    reference: Reference,
    limits: tuple[float, float] | None = None,
    rate: float | None = None,
    share: Share = "auto",
) -> Tracked:
    """Run a law over a reference, from rest, and the model behind it; where it cannot follow, it comes near.

    Parameters
    ----------
    limits, rate, share : as in `Compensator.run`

    Raises
    ------
    Diverged
        Where the law runs away.
    ModelError
        Where the law needs more than a reference.
    DataError
        Where the reference has another sampling time than the model.
    """
    _alone(law, {})
    r, model = reference.r, law.model
    check_pace(model, reference.Ts, "The reference has")
    start = law.rest_input(r[0], limits)
    found, said = told(law, r, start, limits=limits, rate=rate, share=share, clip=True)
    y = simulate(model, found.m, r[0], u0=start, warn=False)
    notes = [text for text in said if text != found.holds]
    return Tracked(
        reference.t, r, found.m, y, straight(model, r, limits, rate), found.held, limits, found.holds,
        tuple(text[0].upper() + text[1:] for text in notes),
    )  # fmt: skip
