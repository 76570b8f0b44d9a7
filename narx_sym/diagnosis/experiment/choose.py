"""The choice of the next experiment among many inputs.

A discriminating design (Hunter & Reiner 1965), judged by the two models that come closest to each other (Buzzi-Ferraris
& Forzatti 1984). What a refit of one model could absorb does not count as a difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from scipy.linalg import qr

from ...data.record import Record
from ...data.tables import LARGEST
from ...errors import ModelError, NarxError
from ...files.parallel import one_blas_thread
from ...fit.constraints import constraint_equations
from ...fit.evaluate import free_run
from ...fit.freerun import FreeRun
from ...fit.simulate import Records, fitted, segments, simulate
from ...models.model import Model
from ...symbolic.signals import u as input_sequence
from ..settings import AT_ONCE, CLEARLY, FAR, SETTLE, SHORTEST, SMALLER, TINY
from .proposal import Experiment, threshold
from .signals import Limits, family

Array = np.ndarray


def propose(
    models: Mapping[str, Model],
    records: Records,
    floor: float,
    seed: int = 0,
    longest: int = 8000,
    units: Mapping[str, str] | None = None,
    limits: tuple[float, float] | None = None,
) -> Experiment | None:
    """Choose the input that separates fitted models best.

    Parameters
    ----------
    models : mapping from an effect id to a fitted Model
        They explain the records equally well. Further channels are held at their means.
    records : Record or list of Record
        They set range, rate, sampling time and length.
    floor : float
        rms of the noise [unit of y].
    seed : int
        Of the random signals.
    longest : int
        Most samples.
    units : mapping of "u" and "y" to texts, optional
    limits : (low, high), optional
        How far the input may go [unit of u]; by default as far as in the records. Then, where no input within them
        decides, twice that range is looked at too (`Experiment.wider`).

    Returns
    -------
    Experiment, or None where there is nothing to decide or no signal that all models survive

    Raises
    ------
    ModelError
        For a model that was not fitted, or an inverse one; for limits that are none.
    """
    check_limits(limits)
    if len(models) < 2:
        return None
    if any(m.input != input_sequence for m in models.values()):
        raise ModelError("An experiment needs models from u to y; in an inverse model nobody can command the input.")
    for model in models.values():
        fitted(model)
    parts = segments(records)
    bench = _Bench.of(parts)
    allowed = Limits.of(parts, limits)
    n = min(longest, sum(len(p) for p in parts))
    if allowed.half <= 0 or allowed.rate <= 0 or n < 2 * SHORTEST:
        return None
    given, seen = units or {}, (min(float(p.u.min()) for p in parts), max(float(p.u.max()) for p in parts))
    now = {name: _as_measured(model, parts) for name, model in models.items()}
    present = _distances(models, lambda model, truth: _on_all(model, now[truth]))[:, 0]

    def best(within: Limits) -> Experiment | None:
        drawn = family(within, n, parts[0].Ts, seed, given.get("u", ""))
        found = _best(models, bench, present, drawn, floor)
        reach = (within.low, within.high)
        return found and replace(found, units=dict(given), limits=reach, given=limits is not None, seen=seen)

    found = best(allowed)
    if found is None or found.clear:
        return found
    # What a full range hides, a small one may show: a band is a larger part of it.
    closer = filter(None, (best(Limits.of(parts, allowed.times(share))) for share in SMALLER))
    found = max((found, *closer), key=lambda e: e.separation)
    if found.clear or limits is not None:
        return found
    further = best(Limits.of(parts, allowed.times(2.0)))
    better = further is not None and further.clear and further.separation > CLEARLY * found.separation
    return replace(found, wider=further if better else None)


def check_limits(limits: tuple[float, float] | None) -> None:
    """Refuse limits of the input that are none.

    Raises
    ------
    ModelError
    """
    said = "The limits of the input must be two finite numbers, the smaller one first, not"
    try:
        low, high = (0.0, 1.0) if limits is None else map(float, limits)
    except (TypeError, ValueError):
        raise ModelError(f"{said} {limits!r}.") from None
    if not -np.inf < low < high < np.inf:
        raise ModelError(f"{said} {low:g} and {high:g}.")


def _best(
    models: Mapping[str, Model],
    bench: _Bench,
    present: Array,
    drawn: Iterable[tuple[str, Array]],
    floor: float,
) -> Experiment | None:
    """Return the signal that separates the models best; None where they do not all survive one.

    `present`, (pairs,), is how far they are apart on the present records [unit of y].
    """
    tried = [(name, u, outputs) for name, u in drawn if (outputs := bench.simulated(models, u)) is not None]
    if not tried:
        return None
    runs = {name: [bench.record(u, outputs[name]) for _, u, outputs in tried] for name in models}
    pairs = list(combinations(models, 2))
    apart = _distances(models, lambda model, truth: _on_each(model, runs[truth]))
    usable = np.flatnonzero(np.isfinite(apart).all(axis=0))
    if not usable.size:
        return None
    lowest = [threshold(floor, outputs.values()) for _, _, outputs in tried]
    possible: Array = np.any((apart > lowest)[:, usable], axis=1)
    chosen = possible if possible.any() else ~possible
    worst = apart[chosen].min(axis=0)
    best = int(usable[np.argmax(worst[usable])])
    name, u, outputs = tried[best]
    return Experiment(
        list(models), name, bench.Ts * np.arange(u.size), u, float(worst[best]), float(present[chosen].min()),
        float(floor), outputs, together=[p for p, c in zip(pairs, possible, strict=True) if not c],
    )  # fmt: skip


@dataclass(frozen=True)
class _Bench:
    """How a proposed input is simulated: from rest, at the records' operating conditions.

    Attributes
    ----------
    Ts, start : float
        Sampling time and the time of the first sample [s].
    line : (slope, offset)
        Of the measured output over the input.
    outputs : (low, high)
        Which outputs are believed [unit of y].
    channels : means of the further channels
    """

    Ts: float
    start: float
    line: tuple[float, float]
    outputs: tuple[float, float]
    channels: dict[str, float]

    @classmethod
    def of(cls, parts: Sequence[Record]) -> _Bench:
        u, y = (np.concatenate([getattr(p, name) for p in parts]) for name in "uy")
        about = u - u.mean()
        slope = float(about @ y / max(about @ about, 1e-300))
        means = {
            name: float(np.mean(np.concatenate([p.channels[name] for p in parts])))
            for name in parts[0].channels
            if all(name in p.channels for p in parts)
        }
        room = FAR * float(np.ptp(y))
        return cls(
            parts[0].Ts, float(parts[0].t[0]), (slope, float(y.mean() - slope * u.mean())),
            (float(y.min()) - room, float(y.max()) + room), means,
        )  # fmt: skip

    def simulated(self, models: Mapping[str, Model], u: Array) -> dict[str, Array] | None:
        """Return each model's output, (N,) arrays [unit of y]; None where one diverges or goes far outside."""
        settle = min(u.size // 4, SETTLE)
        padded = np.concatenate([np.full(settle, u[0]), u])
        given: dict[str, Array] = {name: np.full(padded.size, value) for name, value in self.channels.items()}
        given["t"] = self.start + self.Ts * (np.arange(padded.size) - settle)
        found = {}
        for name, model in models.items():
            try:
                run = simulate(model, padded, self.line[1] + self.line[0] * u[0], given, warn=False)[settle:]
            except NarxError:
                return None
            if not (np.isfinite(run).all() and self.outputs[0] <= run.min() and run.max() <= self.outputs[1]):
                return None
            found[name] = _recorded(run)
        return found

    def record(self, u: Array, y: Array) -> Record:
        """Return a record as the experiment would give it."""
        channels = {name: np.full(u.size, value) for name, value in self.channels.items()}
        t: Array = self.start + self.Ts * np.arange(u.size)
        return Record(u, y, t, self.Ts, channels)


def _recorded(run: Array) -> Array:
    """Return a simulated output as a record holds it: what has died away is zero."""
    return np.where(np.abs(run) < 1 / LARGEST, 0.0, run)


def _as_measured(model: Model, parts: Sequence[Record]) -> list[Record]:
    """Return the present records with a model's output in the place of the measured one; none where it diverges."""
    found = []
    for part in parts:
        try:
            run = free_run(model, part)
        except NarxError:
            return []
        if not np.isfinite(run).all():
            return []
        found.append(replace(part, y=_recorded(run)))
    return found


def _distances(models: Mapping[str, Model], left: Callable[[Model, str], list[float]]) -> Array:
    """Return the rms distances of each pair of models [unit of y], (pairs, n), as `itertools.combinations` orders them.

    One model plays the truth, the other is refitted to it: to first order what its slopes explain is absorbed. `left`
    returns the n distances that stay of one model from the truth of that name; NaN where a run diverges.
    """
    with np.errstate(all="ignore"), one_blas_thread():
        found = {(one, truth): left(models[one], truth) for one, truth in permutations(models, 2)}
    return np.array([np.minimum(found[a, b], found[b, a]) for a, b in combinations(models, 2)])


def _on_each(model: Model, records: Sequence[Record]) -> list[float]:
    """Return what a refit leaves on each of some proposed signals; their slopes are large: a few at a time."""
    blocks = (list(records[i : i + AT_ONCE]) for i in range(0, len(records), AT_ONCE))
    return [_left(p, i, i + 1) for p in (_run(model, block) for block in blocks) for i in range(len(p.data))]


def _on_all(model: Model, records: list[Record]) -> list[float]:
    """Return what one refit leaves on the present records; NaN where there are none."""
    if not records:
        return [float("nan")]
    problem = _run(model, records)
    return [_left(problem, 0, len(problem.data))]


def _run(model: Model, records: list[Record]) -> FreeRun:
    """Return the free run of a model along records, with its slopes."""
    problem = FreeRun(model, records, constraint_equations(model, None))
    problem.run(problem.start(model.theta))
    return problem


def _left(problem: FreeRun, first: int, last: int) -> float:
    """Return the rms that a refit on some segments leaves [unit of y]; NaN where the run diverges."""
    rows, shifts = slice(problem.edges[first], problem.edges[last]), len(problem.starts)
    own = np.r_[: problem.free, problem.free + first * shifts : problem.free + last * shifts]
    residual, slopes = problem.residuals[rows], problem.slopes[rows][:, own]
    if not (np.isfinite(residual).all() and np.isfinite(slopes).all()):
        return float("nan")
    size = np.linalg.norm(slopes, axis=0)
    Q, R, _ = qr(slopes[:, size > 0] / size[size > 0], mode="economic", pivoting=True)
    Q = Q[:, np.abs(np.diag(R)) > TINY]
    left = residual - Q @ (Q.T @ residual)
    left = left - Q @ (Q.T @ left)  # what rounding left of the first projection
    return float(np.sqrt(np.mean(left**2)) * problem.spread)
