"""From measurements to a model in one call: pool, rules, selection, constrained fit, operating point."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from sympy import Eq, S

from ..data.evidence.dead_time import PLAIN, dead_time
from ..data.evidence.rate import at_one_step
from ..data.evidence.roles import INPUT, acting
from ..data.evidence.several import moving, rests
from ..data.record import Record, check_excitation
from ..data.units import in_units
from ..engines.algebra import filtered, smallest, triangle
from ..errors import FitError, ModelError, NotInvertible
from ..files.parallel import one_blas_thread
from ..inversion.compensator import compensator
from ..models import assumptions
from ..models.info import around, whole
from ..models.model import NARX, Model
from ..models.pool import lagged, pool
from ..symbolic.signals import k, lag, phi1, samples, signal, u, y
from .bases.bouc_wen import identify_bouc_wen
from .bases.choice import choose_base
from .bases.integrating import grows, hardly_decays, integrates, slowest
from .bases.judged import judged
from .bases.play import KNOTS, PLAYS, identify_play
from .bases.select import PATH_STEPS, Selection, select
from .evaluate import free_run_nrmse
from .laws.internal import law_radius
from .least_squares import check_method, estimate, fit
from .simulate import Records, centre, segments

Array = np.ndarray
BASES = ("narx", "linear", "static", "play", "bouc-wen", "auto")
OPEN = ("linear", "static")  # a diagnosis chooses their orders again
SEVERAL = ("narx", "linear", "static")  # have further inputs
HELD_OUT = 0.3
CANCELS, CALM = 5.0, 2.0
LONGEST = 200  # dead time of a further input that is looked for [samples]
TURNS, CLOSEST, NEAR, DEPENDENT = 4, 4, 6, 1e-12  # of the search of the orders of several inputs
FEWEST = 20  # samples; below this a structure cannot be told from chance


def operating_point(records: Records) -> dict[Any, float]:
    """Return the point to measure u and y from: zero where zero lies well inside both ranges, else their means.

    Polynomial regressors are not shift-invariant: far from zero they become nearly dependent and the fit fails.
    The means are rounded to three digits of the range, so that the equations stay readable.
    """
    parts = segments(records)
    point = {}
    for base in (u, y):
        x = np.concatenate([getattr(p, base.name) for p in parts])
        digit = 10.0 ** (np.floor(np.log10(np.ptp(x) / 2)) - 2)
        point[base] = float(np.round(centre(x) / digit) * digit)
    return {b: float(f"{v:.12g}") for b, v in point.items() if v}


def prepare(records: Any, units: Mapping[str, str] | None = None) -> list[Record]:
    """Return the records as a list in the units of a model, or of the first; in one at least both signals move.

    Or each begins with a step, and the input only differs between them. Sampling times that differ by less than a
    factor of two become that of the most samples.
    """
    listed = at_one_step(in_units(records, units))
    seen = moving(moving(listed), "u")  # what rests is one among these
    for part in [seen] if rests(seen) else [[r] for r in seen]:
        check_excitation(*part)
    total = sum(len(r) for r in listed)
    if total < FEWEST:
        raise FitError(f"{total} samples are too few to choose a structure: at least {FEWEST} are needed.")
    return listed


def identify(  # noqa: PLR0913
    records: Records,
    *,
    base: str = "narx",
    n_y: int = 1,
    n_u: int = 2,
    degree: int = 3,
    delay: int | None = None,
    for_compensation: bool = False,
    rate_independent: bool = True,
    functions: Iterable[str] = (),
    lags: Mapping[str, Any] | None = None,
    criterion: str = "free_run",
    n_terms: int | None = None,
    max_terms: int = 10,
    method: str = "auto",
    point: Mapping[Any, float] | str = "auto",
    plays: int = PLAYS,
    knots: int = KNOTS,
    creep: bool = False,
    report: Callable[[str], Any] = lambda what: None,
) -> Model:
    """Identify a model from measurements: choose its structure and fit its parameters.

    Parameters
    ----------
    records : Record or list of Record
        The measurements: u and y are (N,) arrays in the user's units.
    base : "narx", "linear", "static", "play", "bouc-wen" or "auto"
        `narx`: a polynomial with phi1 and phi2, under Sigma_y = 1, as in the paper. `linear`: ARX, with orders and
        delay chosen by the free-run error. `static`: a polynomial of the input at the same sample. `play`: plays of
        several radii in parallel, a static curve and a lag (Prandtl-Ishlinskii). `bouc-wen`: the paper's actuator,
        with or without a lag. `auto`: the best of them in cross-validation, with a penalty on the number of parameters.
    n_y, n_u, degree : int
        Largest lags of output and input [samples], and largest degree of the products (`narx`, `static`).
    delay : int, optional
        Delay of the input [samples]. Default: estimated if it is long (`dead_time`); else 1 (`narx`), 0 (`static`), or
        chosen with the orders (`linear`).
    for_compensation : bool
        Use only terms for which a compensation law exists (Assumption A1), and prefer models with a stable law.
    rate_independent : bool
        Use only terms of first degree in phi1: the loop does then not depend on the speed of the input.
    lags : mapping, optional
        Lags of a further channel, such as {"temp": 2}; one that is not named is used if its role is an input, from its
        own dead time on. With `narx` also those of "y", "u", "phi1" and "phi2". An int n (0 ... n), a range or a list
        [samples].
    functions, criterion, n_terms, max_terms
        See `pool` and `select`.
    method : "auto", "one_step", "free_run" or "els"
        How the parameters are fitted. `auto` fits one step ahead, and from there in free run.
    point : mapping or "auto"
        Operating point such as {"u": 1.0, "y": 2.0} [units of u and y]; {} measures the signals from zero.
    plays, knots : int
        With `play`: number of plays, and of breakpoints of the curve.
    creep : bool
        With `play`: whether creep (a slow part of the motion) is fitted too.
    report : callable
        With `narx`: receives a text before each fit, as `report=print` does.

    Returns
    -------
    Model
        Fitted; `info.selection` says what was chosen and why.

    Raises
    ------
    FitError
        If no model can be fitted.
    ModelError
        For an unknown base or channel, or an invalid size.

    Examples
    --------
    >>> import narx_sym as ns
    >>> volts = ns.plants.filtered_noise(N=500, Ts=0.01, cutoff=2.0, peak=5.0, seed=1)
    >>> truth = ns.NARX.from_terms(["y[k-1]", "u[k-2]"], theta=[0.9, 0.2])
    >>> record = ns.Record.from_arrays(volts, truth.simulate(volts, y0=0.0, u0=0.0), Ts=0.01)
    >>> model = ns.identify(record, base="linear", point={})
    >>> model.terms, model.theta.round(3)
    ((y[k - 1], u[k - 2], 1), array([0.9, 0.2, 0. ]))
    >>> model.delay, model.info.selection.base
    (2, 'linear')
    """
    check_method(method)
    whole(n_y=n_y, n_u=n_u, degree=degree, delay=delay)
    listed = prepare(records)
    inputs = [n for n in listed[0].channels if base in SEVERAL and all(r.roles.get(n) == INPUT for r in listed)]
    own = _own_channels(base, listed, lags, inputs)
    origin = operating_point(listed) if point == "auto" else around(point)
    if base not in BASES:
        raise ModelError(f"Unknown base {base!r}; there are {', '.join(BASES)}.")
    if base == "auto":
        options: dict[str, Any] = {
            "n_y": n_y, "n_u": n_u, "degree": degree, "delay": delay, "for_compensation": for_compensation,
            "rate_independent": rate_independent, "method": method, "point": point, "creep": creep,
            "report": report,
        }  # fmt: skip
        return choose_base(listed, lambda name, some, size: identify(some, base=name, **options, **size))
    inputs, found = [name for name in inputs if name not in own], {}
    if inputs:
        with one_blas_thread():
            found = _input_lags(["u", *inputs], listed) | ({} if delay is None else {"u": range(delay, delay + 2)})
    delays = (max(found["u"][0], int(base == "narx")),) if found else _delays(base, listed, delay)
    if base != "linear":
        own |= {name: found[name] for name in inputs}
        lags = {**(lags or {}), **own}
    if base == "narx":
        (delay,) = delays
        n_u = max(n_u, delay + 1)  # Assumption A1(ii): some input terms must be older than the delay
        rules: tuple[str, ...] = assumptions.CONTINUUM
        rules += assumptions.COMPENSATION if for_compensation else ()
        rules += ("rate",) if rate_independent else ()
        candidates = pool(n_y, n_u, degree, delay, rules=rules, functions=functions, lags=lags)
        frame = NARX([y[k - 1]], operating_point=origin)
        chosen = select(
            candidates, listed, max_terms=max_terms, criterion=criterion, n_terms=n_terms, method=method, frame=frame,
            accept=(lambda model: stable_law(model, listed)) if for_compensation else None,
            # The term that the law divides by must be there, whatever ERR thinks of it.
            first=[phi1[k - delay]] if for_compensation and phi1[k - delay] in candidates.terms else (),
            report=report,
        )  # fmt: skip
        model = _finish(chosen, len(candidates))
        if for_compensation:
            compensator(model, force=True)  # NotInvertible here rather than later
            model = _selected(model, stable_law=stable_law(model, listed))
        return judged(model, listed)
    if base == "linear":
        if inputs:
            with one_blas_thread():
                near = _own_orders(listed, origin, found, own, {"u"} if delay is not None else ())
            return _choose(near, listed, "linear", method, for_compensation)
        return _linear(listed, origin, n_y, n_u, delays, own, method, for_compensation)
    if base in ("play", "bouc-wen"):
        return _remembering(base, listed, origin, delays, {"plays": plays, "knots": knots, "creep": creep}, own)
    return _static(listed, origin, degree, delays[0], own, method, for_compensation)


def _input_lags(names: Sequence[str], records: list[Record]) -> dict[str, range]:
    """Return two lags of each of several inputs: from the dead time on with which least is left one step ahead.

    Of one after the other, twice, beside those of the others and two older outputs: of two inputs with a pole each
    there is one denominator of second order, and numerators of two lags.
    """
    parts = [s for r in records for s in r.segments()]
    most = min(LONGEST, min(map(len, parts)) // 4)
    found = {names[0]: range(PLAIN)}

    def columns(part: Record, name: str, lags: range) -> list[Array]:
        x = part.u if name == "u" else part.channels[name]
        return [np.roll(x, i)[most + 1 :] for i in lags]

    for name in [*names[1:], *names]:
        others = {n: lags for n, lags in found.items() if n != name}
        beside = [[c for n, lags in others.items() for c in columns(s, n, lags)] for s in parts]
        older = [[np.roll(s.y, i)[most + 1 :] for i in range(3)] for s in parts]
        blocks = [np.column_stack([*a, np.ones(a[0].size), *b]) for a, b in zip(older, beside, strict=True)]
        fixed, left = np.concatenate(blocks), []
        Q = np.linalg.qr(fixed[:, 1:])[0]
        target = fixed[:, 0] - Q @ (Q.T @ fixed[:, 0])
        for d in range(most):
            own = np.concatenate([np.column_stack(columns(s, name, range(d, d + 2))) for s in parts])
            left.append(_least_squares(own - Q @ (Q.T @ own), target)[1])
        first = int(np.argmin(left))
        found[name] = range(first, first + 2)
    return found


def _least_squares(X: Array, target: Array) -> tuple[Array, float]:
    """Return the smallest least-squares solution, and the sum of squares that it leaves: by one triangle."""
    R = triangle(np.column_stack([X, target]))
    return smallest(R[:-1, :-1], R[:-1, -1], DEPENDENT), float(R[-1, -1] ** 2)


def _own_channels(
    base: str, records: list[Record], lags: Mapping[str, Any] | None, inputs: Sequence[str]
) -> dict[str, Any]:
    """Return the lags of the channels that take part; warn about one that does not, and is no further input."""
    if not isinstance(lags or {}, Mapping):
        raise ModelError('lags must be a mapping of names to the largest lags, such as {"temp": 1}.')
    own = {name: wanted for name, wanted in (lags or {}).items() if name not in ("u", "y", "phi1", "phi2")}
    left_out = [name for r in records for name in acting(r) if name not in own and name not in inputs]
    if left_out:
        warnings.warn(
            f"The {base} base uses the input, the output and the channels in `lags` only; the channel {left_out[0]!r} "
            f"is not used (give lags={{{left_out[0]!r}: 1}} to use it).",
            stacklevel=3,
        )
    return own


def _remembering(
    base: str, records: list[Record], origin: Mapping[Any, float], delays: Sequence[int], size: Mapping[str, Any],
    own: Any,
) -> Model:  # fmt: skip
    """Identify a base that remembers where the input turned."""
    if own:
        raise ModelError(f"The {base} base has one input; the channel {next(iter(own))!r} cannot be used.")
    if base == "play":
        return judged(identify_play(records, origin, delays, **size), records)
    return judged(identify_bouc_wen(records, origin, delays), records)


def _delays(base: str, records: list[Record], given: int | None) -> Sequence[int]:
    """Return the delays to try: the given one, or those around a long dead time where there is one."""
    if given is not None:
        longest = max(len(s) for r in records for s in r.segments())
        if given >= longest:
            raise FitError(
                f"A delay of {given} samples is too long: the longest piece of a record has {longest} samples."
            )
        return (given,)
    found = dead_time(records)
    if base in ("linear", "play", "bouc-wen"):
        return range(found.samples - 1, found.samples + 2) if found.long else range(PLAIN)
    return (found.samples if found.long else int(base == "narx"),)


def identify_inverse(
    records: Records,
    *,
    lead: int = 2,
    n_y: int = 1,
    n_u: int = 1,
    degree: int = 3,
    criterion: str = "free_run",
    rate_independent: bool = False,
    n_terms: int | None = None,
    max_terms: int = 10,
    method: str = "auto",
    point: Mapping[Any, float] | str = "auto",
) -> Model:
    """Identify the inverse relationship, from y to u (section 4.3 of the paper); its law needs no inversion.

    Noise on y acts on the input of this model: smooth a noisy y first (`Record.smoothed`).

    Parameters
    ----------
    records : Record or list of Record
        The measurements: u and y are (N,) arrays in the user's units.
    lead : int
        tau_s >= tau_d + 1 [samples]: y[k] in the model means the measured y[k + lead].
    n_y, n_u : int
        Largest lags of the model's output u and of its input y [samples].
    degree, functions, criterion, n_terms, max_terms, method
        As in `identify`.

    Returns
    -------
    Model, fitted

    Raises
    ------
    ModelError
        For a lead below 1.
    FitError
        As in `identify`.

    Examples
    --------
    >>> import narx_sym as ns
    >>> volts = ns.plants.filtered_noise(N=500, Ts=0.01, cutoff=2.0, peak=5.0, seed=1)
    >>> lag = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2])
    >>> record = ns.Record.from_arrays(volts, lag.simulate(volts, y0=0.0, u0=0.0), Ts=0.01)
    >>> inverse = ns.identify_inverse(record, degree=1, n_terms=2)
    >>> inverse.input, inverse.output, inverse.lead
    (y, u, 2)
    """
    listed = prepare(records)
    origin = operating_point(listed) if point == "auto" else around(point)
    check_method(method)
    whole(lead=lead, n_y=n_y, n_u=n_u, degree=degree)
    if lead < 1:
        raise ModelError(f"The lead tau_s must be at least 1 (tau_d + 1), not {lead}.")
    rules = (*assumptions.CONTINUUM, *(("rate",) if rate_independent else ()))
    candidates = pool(n_y, n_u, degree, 1, inverse=True, rules=rules)
    frame = NARX([u[k - 1]], output=u, input=y, lead=lead, operating_point=origin)
    chosen = select(
        candidates, listed, max_terms=max_terms, criterion=criterion, n_terms=n_terms, method=method, frame=frame
    )
    return judged(_finish(chosen, len(candidates)), listed)


def _finish(chosen: Selection, candidates: int) -> Model:
    """Keep in the model why it has these terms."""
    err = tuple(float(e) for e in chosen.path.err[: chosen.chosen])
    return _selected(chosen.model, candidates=candidates, chosen=chosen.chosen, reason=chosen.reason, err=err)


def _selected(model: Model, **said: Any) -> Model:
    return model.replace(info=replace(model.info, selection=replace(model.info.selection, **said)))


def stable_law(model: Model, records: Records) -> bool:
    """Whether the model's compensation law forgets its own errors on the data."""
    try:
        law = compensator(model, force=True)
        return law.staged is None and law_radius(law, records) < 1
    except NotInvertible:
        return False


def with_steady_state(model: Model, records: Records, points: Any, weight: float = 1.0) -> Model:
    """Fit an identified model again, beside pairs that were measured at rest, and judge it anew.

    Parameters
    ----------
    points, weight
        As `steady_state` and `weight` of `fit`.
    """
    listed = prepare(records)
    model = fit(model, listed, steady_state=points, weight=weight)
    if model.info.selection.stable_law is not None:
        model = _selected(model, stable_law=stable_law(model, listed))
    return judged(model, listed)


def _validation(records: list[Record]) -> tuple[list[Record], list[Record]]:
    """Hold out the last record that moves, or the last part of the only one: of what moves in it, where a part rests.

    One step that is over at once cannot be parted: it judges itself.
    """
    *others, one = moving(records)
    still = [r for r in records if not np.ptp(r.y)]
    if others:
        return [*others, *still], [one]
    at = round((1 - HELD_OUT) * len(one))
    if not all(map(np.ptp, (one.u[:at], one.y[:at], one.y[at:]))):
        changes = [np.flatnonzero(np.diff(x)) for x in (one.u, one.y)]
        begin, end = max(c[0] for c in changes), changes[1][-1]
        at = round(begin + (1 - HELD_OUT) * (end - begin))
        if not begin + 2 <= at <= end:
            return records, records
    return [one[:at], *still], [one[at:]]


def _choose(candidates: list[NARX], records: list[Record], what: str, method: str, for_compensation: bool) -> Model:
    """Fit each candidate on one part, judge it in free run on the other, refit the best on all.

    One that has values is fitted in free run from these.
    """

    def how(model: Model) -> str:
        return "free_run" if method == "auto" and model.theta is not None else method

    train, held = _validation(records)
    tried, fits, scored, imitating = list[Model](candidates), list[Model](), [], []
    for model in tried:  # grows by those that integrate
        fits.append(model)
        try:
            fitted = fits[-1] = estimate(model, train, method=how(model), max_steps=PATH_STEPS)[0]
            score = free_run_nrmse(fitted, held)
        except FitError:
            continue
        row = (score, len(model.symbols) - len(model.constraints), len(fits) - 1)
        if not model.constraints and what == "linear" and hardly_decays(fitted, train):
            if not integrates(fitted, train):  # a pole at 1 that no input drives: the start of each run is an offset
                imitating += [row] * bool(np.isfinite(score))
                continue
            tried.append(model.replace(constraints=[Eq(model.sigma_y, 1)], theta=None))
            if grows(fitted):  # no machine does by itself: with the pole at 1 it stands for an integrator
                continue
        if np.isfinite(score):
            scored.append(row)
    scored = scored or imitating
    if not scored:
        raise FitError(f"No {what} model follows these data in free run.")
    stable = [s for s in scored if stable_law(fits[s[2]], train)] if for_compensation else scored
    scored = stable or scored
    best = min(scored)[0]
    # The smallest model within 2 % of the best one; a well-conditioned one may be somewhat worse.
    close = [s for s in scored if s[0] <= 1.02 * best]
    calm = [s for s in scored if s[0] <= CALM * best and not cancels(fits[s[2]])]
    if all(cancels(fits[s[2]]) for s in close) and calm:
        close = [s for s in calm if s[0] <= 1.02 * min(calm)[0]]
    _, _, i = min(close, key=lambda s: (cancels(fits[s[2]]), s[1], s[2]))
    reason = f"smallest {what} model within 2 % of the best free run on validation data ({best:.4g})"
    final = fit(tried[i], records, method=how(tried[i]))
    final = _selected(final, base=what, candidates=len(tried), reason=reason)
    final = _selected(final, stable_law=stable_law(final, records)) if for_compensation else final
    return judged(final, records)


def cancels(model: Model) -> bool:
    """Whether large input coefficients cancel: a finite-difference trick that smooth inputs allow.

    Of several inputs each must: one denominator has the poles of all, and a numerator takes those of the others away.
    """
    inputs = [c for c, (_, term) in zip(model.theta, model.parts(), strict=True) if term.has(u)]
    return not model.channels and bool(len(inputs) > 1 and np.sum(np.abs(inputs)) > CANCELS * abs(np.sum(inputs)))


def _linear(
    records: list[Record],
    origin: Mapping[Any, float],
    n_y: int,
    n_u: int,
    delays: Sequence[int],
    own: Mapping[str, Any],
    method: str,
    for_compensation: bool,
) -> Model:
    """ARX with a constant: orders from 0 and delay chosen by free-run validation; channels enter at their own lags."""
    beside = lagged(own)
    candidates = [
        NARX(
            [*(y[k - i] for i in range(1, a + 1)), *(u[k - d - j] for j in range(b)), *beside, S.One],
            operating_point=origin,
        )
        for a, b, d in product(range(0, max(2, n_y) + 1), range(1, max(2, n_u) + 1), delays)
    ]
    return _choose(candidates, records, "linear", method, for_compensation)


def _own_orders(
    records: list[Record], origin: Mapping[Any, float], lags: dict[str, range], own: Mapping[str, Any],
    known: Collection[str],
) -> list[NARX]:  # fmt: skip
    """Return the `CLOSEST` ARX models of several inputs, each with its own first lag and number of lags.

    First all have the same number; then the order, an end of the lags of one input, or all its lags change while that
    costs less. The first lags of `known` inputs stay.
    """
    beside, (u0, y0) = lagged(own), (origin.get(base, 0.0) for base in (u, y))
    parts = [replace(s, u=s.u - u0, y=s.y - y0) for r in records for s in r.segments()]
    others = [(x.base.name, range(lag(x), lag(x) + 1)) for term in beside for x in samples(term)]
    most, last = len(lags) + 2, max(some[-1] for some in lags.values())
    first = max(last + most, min(last + LONGEST // 5, min(map(len, parts)) // 4))
    costs: dict[tuple[int, tuple[tuple[str, range], ...]], tuple[float, Array]] = {}

    def cost(way: tuple[int, dict[str, range]]) -> float:
        key = way[0], tuple(way[1].items())
        if key not in costs:
            near = costs.get((best[0], tuple(best[1].items())), (0.0, np.zeros(0)))[1][: best[0]]
            costs[key] = _output_error(parts, way[0], [*key[1], *others], first, near)
        return costs[key][0]

    sizes = product(range(most), range(1, most))
    best: tuple[int, dict[str, range]] = (0, {})
    best = min(((n, {x: range(i[0], i[0] + b) for x, i in lags.items()}) for n, b in sizes), key=cost)
    while True:
        n, lags = best
        moved = [
            (n, lags | {name: range(some[0] + a, some[-1] + 1 + b)})
            for name, some in lags.items()
            for a, b in ((-1, 0), (1, 0), (0, 1), (0, -1), *((d, d) for d in range(-NEAR, NEAR + 1) if d))
            if 0 <= some[0] + a <= some[-1] + b <= first and not (a and name in known)
        ]
        moved += [(n, {x: i for x, i in lags.items() if x != name}) for name in lags if name != "u"]  # it does not act
        best = min([best, *moved, *((i, lags) for i in (n - 1, n + 1) if 0 <= i <= most)], key=cost)
        if best == (n, lags):
            break
    candidates: list[NARX] = []
    for n, chosen in sorted(costs, key=lambda way: costs[way][0])[:CLOSEST]:
        inputs = [signal(name)[k - i] for name, some in chosen for i in some]
        terms = [*(y[k - i] for i in range(1, n + 1)), *inputs, *beside, S.One]
        theta = costs[n, chosen][1].tolist()
        candidates.append(NARX(terms, theta if np.isfinite(theta).all() else None, operating_point=origin))
    return [*candidates, NARX(candidates[0].terms, operating_point=origin)]


def _output_error(
    parts: Sequence[Record], n: int, lags: Sequence[tuple[str, range]], first: int, near: Array
) -> tuple[float, Array]:
    """Return ln(mean square) of the free run of an ARX, with a price for its parameters, and these: a, b, constant.

    By Steiglitz & McBride (1965), least squares filtered by the denominator of the turn before; given that, the rest of
    the free run, with where each part starts, is least squares. The price is that of Schwarz (1978).
    """
    a = near if near.size == n else np.zeros(n)
    paid = n + sum(len(some) for _, some in lags)
    best, found, targets, columns = np.inf, np.full(paid + 1, np.nan), [s.y[first:] for s in parts], []
    for i, s in enumerate(parts):
        inputs = [s.signals[name][first - j : len(s) - j] for name, some in lags for j in some]
        begun = np.zeros((len(s) - first, n * len(parts)))
        begun[:n, n * i : n * (i + 1)] = np.eye(n)[: len(begun)]
        columns.append(np.column_stack([*inputs, np.ones(len(begun)), begun]))
    measured = np.concatenate(targets)
    for turn in range(TURNS + 1 if n else 1):
        A = np.append(1.0, -a)
        X = np.concatenate([filtered(A, x) for x in columns])
        if turn or near.size == n or not n:
            b, left = _least_squares(X, measured)
            best, found = min((best, found), (left, np.append(a, b)[: paid + 1]), key=lambda one: one[0])
        Y = [filtered(A, x) for x in targets]
        older = [np.concatenate([np.append(np.zeros(j), x)[: x.size] for x in Y]) for j in range(1, n + 1)]
        a = _least_squares(np.column_stack([*older, X]), np.concatenate(Y))[0][:n]
        if not np.isfinite(a).all() or slowest(a) >= 1:
            break
    return float(np.log(best / measured.size) + np.log(measured.size) / measured.size * paid), found


def _static(
    records: list[Record], origin: Mapping[Any, float], degree: int, delay: int, own: Mapping[str, Any], method: str,
    for_compensation: bool,
) -> Model:  # fmt: skip
    """Polynomial of the input, beside channels at their own lags; of first degree where a law is wanted."""
    degree = 1 if for_compensation else degree
    beside = lagged(own)
    candidates = [
        NARX([S.One, *(u[k - delay] ** p for p in range(1, n + 1)), *beside], operating_point=origin)
        for n in range(1, max(1, degree) + 1)
    ]
    return _choose(candidates, records, "static", method, for_compensation)
