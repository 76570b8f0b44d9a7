"""Where a law's own dynamics repel, in numbers: at points, along a run, over the range of the identification."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from ...engines.columns import lambdify, largest_root
from ...errors import Diverged, ModelError
from ...inversion.compensator import Compensator
from ...inversion.stability import InternalDynamics, direction, heading, mbar, rbar
from ...models.rest.equilibria import z
from ...symbolic.identities import added
from ...symbolic.signals import lag, samples, signal
from ..coverage import beyond, excess, leaves
from ..simulate import Records, segments

Array = np.ndarray
DOUBLES = 2.0  # a disturbance that grows less than this before it shrinks again is not worth a warning
ROUNDING, FORGOTTEN = 1e-6, 1e-2  # of a disturbance: what is no growth, and what is left of one that is forgotten
GRID = 81
SMALLEST, FAR = 1e-12, 1e100  # of a factor, so that its logarithm is finite; beyond which nothing is followed
LOOKED = 5_000_000  # products at most
M, R = signal("m"), signal("r")


@dataclass(frozen=True)
class Excursion:
    """How a law reacts to its own errors along a run: its eigenvalues, and what becomes of a disturbance of m.

    Attributes
    ----------
    radius : (N,) array
        The largest |eigenvalue| at each sample; NaN where nothing moves and the law asks for a direction.
    share : float
        Of the samples with an eigenvalue beyond 1.
    first : int or None
        The first of them.
    largest : float
    growth : float
        The largest factor by which a disturbance of m grows before it shrinks again: by the product of the Jacobians
        along the run. Of a law that integrates, a disturbance of the changes of m.
    rate : float
        The factor per sample over the whole run: below 1, the run as a whole forgets disturbances.
    kept : float or None
        What becomes of a lasting error of 1 in m over the run; None of a law that does not integrate.
    """

    radius: Array
    share: float
    first: int | None
    largest: float
    growth: float
    rate: float
    kept: float | None = None

    @property
    def noteworthy(self) -> bool:
        """Whether a disturbance at least doubles on the way."""
        return max(self.growth, self.kept or 0.0) >= DOUBLES

    @property
    def unstable(self) -> bool:
        """Whether there is anything to say but that it forgets."""
        return self.first is not None or self.noteworthy or self.rate >= 1

    def sentence(self, Ts: float | None = None) -> str:
        """Say where it repels, by how much a disturbance grows, and whether it stays."""
        lasting = ""
        if self.kept is not None:
            left = f"{self.kept:.3g}" if self.kept > FORGOTTEN else f"less than {FORGOTTEN:g}"
            lasting = (
                f"the law is an integrator: of an error of 1 in m at the start {left} is left at the end; "
                "apart from this "
            )
        it = "it" if lasting else "the law"
        if not self.unstable:
            return f"{lasting}{it} {self._forgets()}"
        grown = f"{self.growth:.3g} times" if self.growth < 1e4 else "more than 10 000 times"
        stays = (
            f"over the whole run it shrinks ({self.rate:.3g} times per sample on average): a transient excursion"
            if self.rate < 1
            else "over the whole run it does not shrink: the law can diverge"
        )
        if self.first is None:
            where = f"is not stable although no internal eigenvalue exceeds 1 ({self.largest:.3g} at most):"
        else:
            when = f"sample {self.first}" + (f" (t = {self.first * Ts:.4g} s)" if Ts else "")
            where = (
                f"amplifies its own errors at {100 * self.share:.3g} % of the samples, first at {when} (internal "
                f"eigenvalue {self.largest:.3g}, stable below 1): there"
            )
        return f"{lasting}{it} {where} a disturbance of m grows up to {grown}; {stays}"

    def _forgets(self) -> str:
        if np.isnan(self.rate):
            return "was not moved, so its reaction to its own errors is unknown"
        left = self.rate**self.radius.size
        told = [f"an error grows up to {self.growth:.3g} times before it decays"] * (self.growth > 1 + ROUNDING)
        told += [f"of an error at the start {left:.3g} is left at the end"] * (left > FORGOTTEN)
        return "is stable along the whole run: its own errors decay" + (f" ({'; '.join(told)})" if told else "")


def radius(internal: InternalDynamics, m: Any, r: Any, s: float | None = None) -> Array:
    """Return the largest |eigenvalue| of a law at points (m, r).

    Parameters
    ----------
    m : number or (N,) array [unit of u]
    r : number or (N,) array [unit of y]
    s : 1 or -1, optional
        The direction of the motion; by default the worse of both.

    Returns
    -------
    (N,) array; a number for numbers

    Raises
    ------
    ModelError
        For a model without values, or a law whose eigenvalues depend on further channels or on time.
    """
    m_, r_ = np.broadcast_arrays(np.asarray(m, dtype=float), np.asarray(r, dtype=float))
    polynomial = _numbers(internal)
    used = [d for d in (direction, heading) if polynomial.has(d)]
    ways = product((1.0, -1.0), repeat=len(used)) if s is None else [(float(s),) * len(used)]
    found = [_roots(polynomial, m_.ravel(), r_.ravel(), dict(zip(used, way, strict=True))) for way in ways]
    worst = np.max(found, axis=0).reshape(m_.shape)
    return worst if worst.ndim else worst[()]


def repelling(internal: InternalDynamics, m: Any, r: Any, s: float | None = None) -> Array:
    """Return whether a law repels at points (m, r), (N,) bool: moving in the direction s = 1 or -1, or in any."""
    return radius(internal, m, r, s) > 1


def dynamics(law: Compensator) -> InternalDynamics:
    """Return the internal dynamics of a law that has eigenvalues; ModelError for a law with branches or states."""
    found = law.internal
    if not isinstance(found, InternalDynamics):
        raise ModelError("A law with branches or further states has no eigenvalues: use law.internal.along(reference).")
    return found


def _numbers(internal: InternalDynamics) -> Any:
    """Return the polynomial with numbers, or say what keeps it from being one."""
    polynomial = internal.numbers
    unknown = polynomial.free_symbols - {z, mbar, rbar, direction, heading}
    unknown |= {s.base for slope in internal.jacobian for s in samples(slope)} - {M, R}
    if unknown:
        raise ModelError(
            f"The eigenvalues of this law depend on {', '.join(sorted(map(str, unknown)))}: give the model values, and "
            "hold further channels constant."
        )
    return polynomial


def _roots(polynomial: Any, m: Array, r: Array, moving: dict[Any, Any]) -> Array:
    values = {name: np.broadcast_to(np.asarray(x, dtype=float), m.shape) for name, x in moving.items()}
    return largest_root(polynomial, z, {mbar: m, rbar: r, **values})


def excursion(internal: InternalDynamics, m: Any, r: Any, m0: float | None = None) -> Excursion:
    """Follow the eigenvalue along a run of a law.

    Parameters
    ----------
    m, r : (N,) arrays [units of u and y]
        The law's output and its reference.
    m0 : number, optional
        The input before the first sample, where the reference rests; the first m by default. [unit of u]

    Returns
    -------
    Excursion
        At each sample from the last m, the reference, and the directions in which they move. Where these rest,
        nothing is judged that depends on them.
    """
    past, goal = (np.asarray(x, dtype=float).ravel() for x in (m, r))
    if past.shape != goal.shape or past.size < 2:
        raise ModelError("m and r must have the same length, at least two samples.")
    past = np.concatenate([[past[0] if m0 is None else m0], past])  # past[k] is m[k-1]
    polynomial = _numbers(internal)
    moving = {
        d: _along(turn.xreplace(internal.law.model.values), past, goal)
        for d, turn in internal.turns.items()
        if polynomial.has(d)
    }
    found = _roots(polynomial, past[:-1], goal, moving)
    for name, way in moving.items():
        if internal.turns[name].has(sp.sign):
            found = np.where(way == 0, np.nan, found)
    beyond = found > 1
    values = internal.law.model.values
    slopes = np.array([_along(e.xreplace(values), past, goal) for e in internal.jacobian]).reshape(-1, goal.size)
    integrates = len(slopes) > sp.Poly(polynomial, z).degree()
    moved = ~np.isnan(found)
    growth, rate = disturbed((-np.cumsum(slopes[::-1], axis=0)[-2::-1] if integrates else slopes)[:, moved])
    return Excursion(
        found,
        float(np.mean(beyond)),
        int(np.argmax(beyond)) if beyond.any() else None,
        float(np.nan_to_num(found, posinf=1e300).max()),
        growth,
        float(rate ** (moved.sum() / moved.size)),
        kept(slopes) if integrates else None,
    )


def _along(turn: Any, past: Array, goal: Array) -> Array:
    """Evaluate a direction along a run; beyond its ends everything rests."""
    rows, sources = np.arange(goal.size), {M: (past, 1), R: (goal, 0)}
    columns = []
    for s in samples(turn):
        x, offset = sources[s.base]
        columns.append(x[np.clip(rows - lag(s) + offset, 0, x.size - 1)])
    return np.broadcast_to(np.asarray(_function(turn)(*columns)[0], dtype=float), goal.shape)


@lru_cache(maxsize=256)
def _function(turn: Any) -> Any:
    read = samples(turn)
    names = [sp.Symbol(f"x{i}", real=True) for i in range(len(read))]
    return lambdify([turn.xreplace(dict(zip(read, names, strict=True)))], names)


@dataclass(frozen=True)
class OperatingRange:
    """Where a law repels within the range of its identification.

    Attributes
    ----------
    shares : mapping from "rising" and "falling" to the share of the range
        One entry "moving" for a law that knows no direction.
    largest : float
        The largest |eigenvalue| there.
    at : (m, r), where it is
    """

    shares: dict[str, float]
    largest: float
    at: tuple[float, float]

    @property
    def sentence(self) -> str:
        """What a user should know before the law is used; empty where it repels nowhere."""
        if not any(self.shares.values()):
            return ""
        where = ", ".join(f"{100 * share:.3g} % while {way}" for way, share in self.shares.items() if share)
        m, r = self.at
        largest = f"internal eigenvalue up to {self.largest:.4g}, at m = {m:.4g}, r = {r:.4g}; stable below 1"
        if min(self.shares.values()) == 1:
            return (
                f"The law's own dynamics repel in all of the operating range ({largest}): wherever it moves, an error "
                "of m grows from sample to sample, by up to that factor."
            )
        return (
            f"The law's own dynamics repel in a part of the operating range ({where}; {largest}): while it moves "
            "there, an error of m grows by that factor from sample to sample, and elsewhere it shrinks again. A short "
            "visit is not a divergence; a run over a reference says how long it stays."
        )


def operating_range(law: Compensator) -> OperatingRange | None:
    """Look for repelling points over the identified ranges, as far from the line through the data as these were.

    Returns
    -------
    OperatingRange, or None where the model does not know its ranges, the eigenvalues depend on further channels, or
    the law has branches or further states
    """
    if law.staged:
        return None
    info, internal = law.model.info, dynamics(law)
    ranges = info.ranges
    if not {"u", "y"} <= set(ranges):
        return None
    inputs, outputs = (np.linspace(ranges[name][0], ranges[name][1], GRID) for name in ("u", "y"))
    m_grid, r_grid = (x.ravel() for x in np.meshgrid(inputs, outputs))
    if info.band is not None and info.line is not None:
        offset, slope = info.line
        direct = law.model.input.name == "u"
        distance = r_grid - offset - slope * m_grid if direct else m_grid - offset - slope * r_grid
        inside = np.abs(distance) <= info.band
        m_grid, r_grid = m_grid[inside], r_grid[inside]
    directed = internal.numbers.has(direction, heading)
    ways = {"rising": 1.0, "falling": -1.0} if directed else {"moving": 1.0}
    try:
        found = {way: radius(internal, m_grid, r_grid, s) for way, s in ways.items()}
    except ModelError:
        return None
    worst = np.max(list(found.values()), axis=0)
    top = int(np.argmax(worst))
    shares = {way: float(np.mean(x > 1)) for way, x in found.items()}
    return OperatingRange(shares, float(worst[top]), (float(m_grid[top]), float(r_grid[top])))


# -- what becomes of a disturbance: the product of the Jacobians along a run, not of their eigenvalues --------------


def disturbed(slopes: Array) -> tuple[float, float]:
    """Follow disturbances through d[k] = slopes[0, k] d[k-1] + slopes[1, k] d[k-2] + ...

    Parameters
    ----------
    slopes : (n, N) array

    Returns
    -------
    growth : float
        The largest factor by which one grows that begins at any sample, before it has shrunk to a hundredth.
    rate : float
        The factor per sample by which the whole product grows; NaN without samples.
    """
    n, N = slopes.shape
    slopes = np.nan_to_num(slopes, nan=0.0, posinf=FAR, neginf=-FAR)
    if not N:
        return 1.0, math.nan
    if not n:
        return 1.0, 0.0
    one = np.log(np.maximum(np.abs(slopes[0]), SMALLEST))
    logs = one if n == 1 else _followed(slopes, [1.0] + [0.0] * (n - 1))[0]
    heights = np.concatenate([[0.0], np.cumsum(logs)])
    grown = float(np.max(heights - np.minimum.accumulate(heights)))
    if n > 1:
        # A tangent turns with the run at its start; what is compared is its own size, wherever that begins.
        grown = max(_impulses(slopes), grown if heights[-1] > 0 else 0.0)
    return float(np.exp(min(grown, 700.0))), float(np.exp(np.mean(logs)))


def _followed(slopes: Array, d: list[float]) -> tuple[Array, float]:
    """Return the logarithm of the growth of one disturbance in each sample, and what is left of that in m at last."""
    logs, left = [], 1.0
    for row in np.nan_to_num(slopes, nan=0.0, posinf=FAR, neginf=-FAR).T.tolist():
        d = [added(a * x for a, x in zip(row, d, strict=True)), *d[:-1]]
        size = max(max(map(abs, d)), SMALLEST**20)
        logs.append(math.log(size))
        d = [x / size for x in d]
        left = abs(d[0])
    return np.array(logs), left


def _impulses(slopes: Array) -> float:
    """Return the logarithm of the largest response to a unit error of m at any sample, while it has not died out."""
    n, N = slopes.shape
    d = np.zeros((n, N))
    d[0] = 1.0  # column s: the error at sample s, then what has become of it
    starts, largest = np.arange(N), 1.0
    for step in range(1, min(N, max(LOOKED // N, 100))):
        inside = starts + step < N
        d, starts = d[:, inside], starts[inside]
        new = np.einsum("ij,ij->j", slopes[:, starts + step], d)
        d = np.vstack([new, d[:-1]])
        size = np.abs(d).max(axis=0)
        largest = max(largest, float(np.abs(new).max(initial=0.0)))
        living = (size > FORGOTTEN) & (size < FAR)
        d, starts = d[:, living], starts[living]
        if not starts.size:
            break
    return math.log(largest)


def kept(slopes: Array) -> float:
    """Return what a lasting error of 1 in m has become at the end."""
    logs, left = _followed(slopes, [1.0] * len(slopes))
    return float(left * np.exp(min(logs.sum(), 700.0)))


# -- what is known about a run of a law ------------------------------------------------------------------------


def law_warnings(law: Compensator, r: Array, m: Array, m0: float | None = None, damped: bool = False) -> list[str]:
    """Say where a run of a law leaves what was identified, and whether it amplifies its own errors.

    Of a damped law, whose dynamics are others, the second is not said.

    Raises
    ------
    Diverged
        Where the input runs more than ten of the identified ranges away.
    """
    ranges = law.model.info.ranges
    found = [f"{s}: this extrapolates" for s in beyond(law.model.info, "y", "reference", [r], law.model.Ts)]
    visit = None if damped else _excursion(law, m, r, m0)
    unstable = visit.sentence(law.model.Ts) if visit is not None and visit.unstable else ""
    if "u" in ranges and (out := leaves(law.model.info, "u", "compensated input", [m])):
        if excess(m, *ranges["u"]) > 10:
            advice = "check m0 and the reference, or give the limits of the input"
            raise Diverged(f"The law diverges: {out}; {unstable or advice}.")
        found.append(out)
    return [*found, unstable] if visit is not None and visit.noteworthy else found


def run_away(law: Compensator, r: Array, path: Array, m0: float | None = None) -> list[str]:
    """Say what may have made a law diverge: a reference outside what was identified, its own dynamics on the way."""
    outside = leaves(law.model.info, "y", "reference", [r])
    visit = _excursion(law, path, r[: path.size], m0) if path.size > 1 else None
    repels = visit is not None and visit.unstable
    return [
        *([f"Here {outside}."] if outside else []),
        *([f"Before that, {visit.sentence(law.model.Ts)}."] if visit is not None and repels else []),
    ]


def _excursion(law: Compensator, m: Array, r: Array, m0: float | None = None) -> Excursion | None:
    """Follow the law's internal eigenvalue; None where it depends on further channels."""
    try:
        return excursion(dynamics(law), m, r, m0)
    except ModelError:
        return None


def law_radius_at(law: Compensator) -> float | None:
    """Return the largest internal eigenvalue of a law; None where it depends on where the law is."""
    try:
        polynomial = _numbers(dynamics(law))
    except ModelError:
        return None
    return None if polynomial.free_symbols - {z} else float(radius(dynamics(law), 0.0, 0.0))


def law_radius(law: Compensator, records: Records) -> float:
    """Return the largest internal eigenvalue of a law that 99 % of the measured points stay below.

    Below 1 the law forgets its own errors; above, it amplifies them from sample to sample.
    """
    parts = segments(records)
    m_values, r_values = (np.concatenate([getattr(p, n) for p in parts]) for n in ("u", "y"))
    try:
        return float(np.quantile(radius(dynamics(law), m_values, r_values), 0.99))
    except ModelError:
        return 0.0  # it depends on further channels
