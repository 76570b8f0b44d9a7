"""Where a fit with an effect starts: from a core that is estimated together with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ....data.record import Record
from ....engines.algebra import filtered
from ....errors import DataError
from ....symbolic.signals import samples
from ...settings import HALF, MOVES, PER_PARAMETER, TURNS
from ..frame import Frame
from ..hypotheses import Core
from ..row import Row
from .arx import arx_start, gains, inputs, nearest_product, polynomial, start_beside

Array = np.ndarray
MACHINE = ("force", "inside", "motion")  # where an effect acts on what moves


def beginnings(frame: Frame, base: Row, shape: Sequence[float]) -> list[Array]:
    """Return the points from which the last effect of a frame is fitted beside a row, of one shape.

    The core as it is, and one estimated with the effect, where that starts better. A brief look and a closer fit begin
    at the same ones.
    """
    key = base, tuple(shape)
    if key not in frame.begins:
        (cs, where), core = frame.added[-1], base.hypothesis.core
        x = np.concatenate(
            [base.values[: cs[0]], np.zeros(len(cs) + len(where)), frame.shifts(base.frame, base.values)]
        )
        x[cs], x[where] = HALF if frame.effects[-1].effect.full else 0.0, shape
        x = x if core.given or core.integrating else _as_measured(frame, x, core)
        other = x if core.given else restarted(frame, x, core)
        frame.begins[key] = [x] if other is x else [x, other]
    return frame.begins[key]


@np.errstate(all="ignore")
def _as_measured(frame: Frame, x: Array, core: Core) -> Array:
    """Return the point at which what follows the input begins where the output is, at rest; x where that is better.

    A motor at its full speed, or a slack, that begins elsewhere than its input: from where it has arrived there no
    derivative tells. Where that is, the core says, or the ranges of input and output, where the effect hides the core;
    of an axis that integrates the output tells nothing of it.
    """
    model, linear, n = frame.problem.model, x[frame.used(core)], core.n_y
    if core.further:  # where an input is in rest, several say
        return x
    own = [s for s in model.states if s.group == model.effects[-1].group]
    follow = {s.left.base for s in own if any(i.base == model.input for i in samples(s.initial))}
    at = [j for j, s in enumerate(frame.problem.starts) if s.back is None and follow.issuperset(s.states)]
    gain = float(linear[n : n + core.n_u].sum())
    if not at or not gain:
        return x
    frame.late(core)
    records = frame.measured()
    u, y = (np.concatenate([getattr(r, name) for r in records]) for name in "uy")
    slope = float(np.copysign(np.ptp(u) / (np.ptp(y) or 1.0), gain))
    points = [x]
    for level, rise in (
        (-float(linear[n + core.n_u]) / gain, (1 - float(linear[:n].sum())) / gain),
        (float(u.max() + u.min() - slope * (y.max() + y.min())) / 2, slope),
    ):
        points.append(x.copy())
        for i, r in enumerate(records):
            rest = np.clip(level + rise * r.y[0], u.min(), u.max())
            points[-1][frame.problem.own(i).start + np.array(at)] = rest - r.u[0]
    return min(points, key=lambda point: frame.error(point, core))


@np.errstate(all="ignore")
def restarted(frame: Frame, x: Array, core: Core) -> Array:
    """Return the point with a core estimated together with what the last effect adds; x where its free run is better.

    At the input that is estimated behind what the effect lets through; on the machine one step ahead, beside what it
    adds along the measured output.
    """
    frame.late(core)
    found = _behind if frame.effects[-1].where == "input" else _along
    points = [x]
    with suppress(DataError):  # of signals that run away there is no record
        points += (frame.free(core).rounded(point) for point in found(frame, x, core.at_once))
    return min(points, key=lambda point: frame.error(point, core))


def _behind(frame: Frame, x: Array, core: Core) -> list[Array]:
    """Return points with a core behind an effect at the input.

    One that is whole wherever it acts is so here; another coefficient is estimated with the core.
    """
    (cs, _), z, at = frame.added[-1], x.copy(), frame.effects[-1].at or "u"

    def seen(c: Any) -> list[dict[str, Array]]:
        z[cs] = c
        return _through(frame, z, core)

    c, records = np.ones(len(cs)), frame.measured()
    if not frame.effects[-1].effect.full:
        bare = seen(0.0)
        each = [[v[at] - u[at] for v, u in zip(seen(one), bare, strict=True)] for one in np.eye(len(cs))]
        own, *others = ([u[name] for u in bare] for name in (at, *(n for n, _ in core.inputs if n != at)))
        c = np.clip(gains(records, core, x[: core.n_y], [own, *each], others), frame.low[cs], frame.high[cs])
    z[cs] = c
    return _driven(frame, z, core, _behind_effects(frame, z, core), x[: core.n_y])


def _along(frame: Frame, x: Array, core: Core) -> list[Array]:
    """Return points with a core beside what an effect adds on the machine along the measured output.

    A force takes the way of the input.
    """
    *others, variant = frame.effects
    if variant.where not in MACHINE or any(v.where != "input" for v in others):
        return []
    (cs, shapes), point = frame.added[-1], x.copy()
    records = _behind_effects(frame, x, core)
    z = frame.contributions(records, x[shapes])
    acts = [[part[:, j] for part in z] for j in range(len(cs))]
    if not all(np.isfinite(part).all() for given in acts for part in given):
        return []
    force, m = variant.where == "force", core.n_y + core.b
    taps, own = core.n_u if force else 1, inputs(records, core)
    guess = arx_start(records, core, driven=[*own, *((given, taps) for given in acts)])
    if force:
        b = np.append(guess[core.n_y :][: core.n_u], guess[m:-1])
        c = np.clip(nearest_product(b, [own[0][0], *acts]), frame.low[cs], frame.high[cs])
        if not np.isfinite(c).all():
            return []
        point[cs] = c
        acting = [replace(r, u=r.u + part @ c) for r, part in zip(records, z, strict=True)]
        return _driven(frame, point, core, acting, guess[: core.n_y])
    if not np.isfinite(guess).all():
        return []
    found = [(guess, [part @ guess[m:-1] for part in z])]
    strong = variant.where == "motion" and variant.effect.full and bool(shapes)
    if strong:
        found.append(_held(records, core, acts[0]))
    points = []
    for guess, added in found:
        if strong:  # as strong as it is, its shape says
            point[cs], size = 1.0, shapes[0]
            point[size] = np.clip(guess[m] * x[size], frame.low[size], frame.high[size])
        else:
            point[cs] = np.clip(guess[m:-1], frame.low[cs], frame.high[cs])
        A = polynomial(guess[: core.n_y])
        alone = [replace(r, y=r.y - filtered(A, e)) for r, e in zip(records, added, strict=True)]
        points += _placed(frame, point, core, alone, np.append(guess[:m], guess[-1]))
    return points


def _held(records: Sequence[Record], core: Core, z: Sequence[Array]) -> tuple[Array, list[Array]]:
    """Return a, b, c and the constant of a core whose motion is held, c times as strongly as z, and what holds it.

    z is along the step that is measured: of that which the core would make it has the sign, where the part moves. At
    rest it is held by what is wanting, which the core tells: first it is estimated on the move alone, then beside that.
    """
    own, most = inputs(records, core), max(float(np.abs(part).max()) for part in z) or 1.0
    moving = [np.abs(part) > MOVES * most for part in z]
    guess = arx_start(records, core, driven=[*own, (z, 1)], turns=1, counts=moving)
    strong, n = float(guess[-2]), core.n_y
    for _ in range(TURNS):
        held = []
        for i, r in enumerate(records):
            free = np.convolve([0.0, *guess[:n]], r.y)[: len(r)]
            for (x, _), b in zip(own, guess[n : n + core.b].reshape(-1, core.n_u), strict=True):
                free = free + np.convolve(b, x[i])[: len(r)]
            held.append(np.clip(r.y - (free + guess[-1]), -abs(strong) * most, abs(strong) * most))
        guess = arx_start(records, core, driven=[*own, (held, 1)], turns=1)
        strong *= float(guess[-2])
    added = [part * guess[-2] for part in held]
    guess[-2] = strong
    return guess, added


def _through(frame: Frame, x: Array, core: Core) -> list[dict[str, Array]]:
    """Return the inputs, (N,) each, behind the effects that act there, per segment."""
    at, found = {v.at for v in frame.effects if v.where == "input"}, []
    for i, record in enumerate(frame.measured()):
        runs = frame.problem.walked(i, x)
        passed = {name or "u": runs[f"v_{name}" if name else "v"].copy() for name in at}
        found.append({name: passed.get(name, record.signals[name]) for name, _ in core.inputs})
    return found


def _behind_effects(frame: Frame, x: Array, core: Core) -> list[Record]:
    """Return the segments with these inputs.

    Raises
    ------
    DataError
        Where one runs away.
    """
    found = []
    if all(v.where != "input" for v in frame.effects):
        return frame.measured()
    for record, passed in zip(frame.measured(), _through(frame, x, core), strict=True):
        driven = passed.pop("u")
        found.append(replace(record, u=driven, channels=record.channels | passed))
    return found


def _driven(frame: Frame, x: Array, core: Core, records: Sequence[Record], a: Array) -> list[Array]:
    """Return points with a core estimated from records whose u is what drives it; a filters first."""
    return _placed(frame, x, core, records, arx_start(records, core, a, turns=2))


def _placed(frame: Frame, x: Array, core: Core, records: Sequence[Record], guess: Array) -> list[Array]:
    """Return the point with a, b and the constant of a core, and that with its a where the free run tells the rest.

    To the rest belong the starts; where it runs away there is no such point.
    """
    points = [frame.put(x, core, guess)]
    if all(np.isfinite(r.y).all() for r in records):
        linear, errors = start_beside(records, core, guess[: core.n_y])
        points.append(frame.problem.begun(frame.put(x, core, linear), errors))
    return points


def whole(row: Row, keeps: Callable[[Row], bool], worth: float) -> Row:
    """Return a row whose effects are whole, where that costs less: a share near 1 may be the error of its fit.

    It is fitted where, with that parameter less, it may cost less than `worth`.
    """
    core = row.hypothesis.core
    for variant, (cs, _) in zip(row.hypothesis.effects, row.frame.added, strict=True):
        if variant.effect.full and row.before_judged - PER_PARAMETER < worth:
            frame, x = row.frame.whole(cs[0]), row.values.copy()
            x[cs[0]] = 1.0
            x, cost = frame.fit(x, core, 15)
            made = replace(row, frame=frame, values=x, fitted=cost, parameters=frame.parameters(core))
            if np.isfinite(cost) and made.before_judged < row.before_judged and keeps(made):
                row = made
    return row
