"""Structure selection: the error reduction ratio (Chen, Billings & Luo 1989) on one streamed QR factor.

The data are read once, in blocks; memory does not depend on their length. AIC, BIC and the free-run error are read off
the one path, never by selecting again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...engines.columns import Columns
from ...errors import FitError
from ...models.model import NARX, Model
from ...models.pool import Pool
from ...symbolic.signals import expand_phi, k, samples
from ..evaluate import free_run_nrmse
from ..least_squares import check_method, factor, fit, free_run_error
from ..simulate import Records, arrays, segments, shifted

Array = np.ndarray
INDEPENDENT, TIE = 1e-10, 1e-7
PATH_STEPS = 15  # of the free-run fits along the path; the chosen model is refined further


@dataclass(frozen=True)
class Path:
    """Candidates in the order of their error reduction ratio.

    Attributes
    ----------
    order : list of int
        Positions in the candidate list.
    err : (n,) array
        Error reduction ratio of each pick, as a share of the target's energy.
    rss : (n + 1,) array
        Residual sum of squares with 0, 1, ... picks [unit of the target squared].
    rows : int
    """

    order: list[int]
    err: Array
    rss: Array
    rows: int

    @property
    def aic(self) -> Array:
        """Akaike's criterion N ln(rss/N) + 2 n for 0, 1, ... terms."""
        return self._criterion(2.0)

    @property
    def bic(self) -> Array:
        """Schwarz's criterion N ln(rss/N) + n ln N."""
        return self._criterion(np.log(self.rows))

    def _criterion(self, price: float) -> Array:
        floor = np.finfo(float).tiny
        return self.rows * np.log(np.maximum(self.rss, floor) / self.rows) + price * np.arange(len(self.rss))


def err_path(R: Array, rows: int, max_terms: int, forced: Sequence[int] = ()) -> Path:
    """Order candidates by error reduction ratio, given R of [candidates, target].

    Modified Gram-Schmidt with a second pass, on the columns of R: no more than width^2 numbers are touched. A candidate
    of which the others leave less than 1e-10 is collinear and out; ties within 1e-7 go to the lowest index, so that
    the picks do not depend on rounding.

    Parameters
    ----------
    R : (width, width) upper triangular
    forced : positions that come first, in this order
    """
    W, target = R[:, :-1].copy(), R[:, -1].copy()
    size = np.sqrt(np.einsum("ij,ij->j", W, W))
    energy = float(target @ target)
    if energy == 0:
        raise FitError("The target is zero on these data: nothing can be selected.")
    alive = size > 0
    W[:, alive] /= size[alive]
    order: list[int] = []
    gains, rss = [], [energy]
    basis = np.empty((R.shape[0], 0))
    for step in range(min(max_terms, W.shape[1])):
        left = np.sqrt(np.einsum("ij,ij->j", W, W))
        alive &= left > INDEPENDENT
        if not alive.any():
            break
        with np.errstate(all="ignore"):
            gain = np.where(alive, (target @ W) ** 2 / left**2, -1.0)
        if step < len(forced):
            pick = forced[step]
            if not alive[pick]:
                raise FitError("A term that must be in the model is zero on these data, or repeats another.")
        else:
            pick = int(np.flatnonzero(gain >= gain.max() * (1 - TIE))[0])
        direction = W[:, pick] - basis @ (basis.T @ W[:, pick])
        direction /= np.linalg.norm(direction)
        basis = np.column_stack([basis, direction])
        share = float(direction @ target)
        target -= share * direction
        W -= np.outer(direction, direction @ W)
        alive[pick] = False
        order.append(pick)
        gains.append(share**2 / energy)
        rss.append(float(target @ target))
    return Path(order, np.array(gains), np.array(rss), rows)


@dataclass
class Selection:
    """The outcome of a structure selection.

    Attributes
    ----------
    model : NARX
        Fitted with the chosen number of terms.
    candidates : list of expressions, path : Path
    free_run_nrmse : list of float
        Free-run error after 1, 2, ... picks, on the records selected on.
    chosen : int
        The number of picks.
    reason : str
        Why this many.
    """

    model: Model
    candidates: list[Any]
    path: Path
    free_run_nrmse: list[float] = field(default_factory=list)
    chosen: int = 0
    reason: str = ""

    @property
    def picks(self) -> list[Any]:
        """The candidates in the order of selection."""
        return [self.candidates[i] for i in self.path.order]


def candidates_of(pool: Pool | Iterable[Any], continuum: bool, output: Any) -> tuple[list[Any], Any, list[Any]]:
    """Return candidates, target and the terms that are always in.

    With Sigma_y = 1 the parameter of y[k-1] is 1 minus those of y[k-2], ...: the target becomes y[k] - y[k-1] and the
    other linear output terms become y[k-i] - y[k-1]. (On the raw target y[k-1] takes all but 1e-5 of the energy.)
    """
    terms = list(pool)
    if not continuum:
        return terms, output[k], []
    last = output[k - 1]
    linear = [t for t in terms if t in samples(t, output)]
    candidates = [t - last if t in linear else t for t in terms if t != last]
    return candidates, output[k] - last, [last]


def path_of(
    frame: Model,
    candidates: Sequence[Any],
    target: Any,
    records: Records,
    max_terms: int,
    first: Sequence[Any] = (),
) -> Path:
    """Read the records once and order the candidates, those in `first` before the others."""
    columns = Columns([*candidates, target])
    read = {s.base.name for term in candidates for s in samples(expand_phi(term))}
    R, rows = factor(columns, [shifted(frame, arrays(frame, p, sorted(read))) for p in segments(records)])
    return err_path(R, rows, max_terms, [list(candidates).index(t) for t in first])


def select(
    pool: Pool,
    records: Records,
    *,
    continuum: bool = True,
    max_terms: int = 10,
    criterion: str = "free_run",
    n_terms: int | None = None,
    method: str = "one_step",
    validation: Records | None = None,
    frame: Model | None = None,
    accept: Callable[[Model], bool] | None = None,
    first: Sequence[Any] = (),
    report: Callable[[str], Any] = lambda what: None,
) -> Selection:
    """Choose the terms of a NARX model by the error reduction ratio (ERR), and fit it.

    Parameters
    ----------
    pool : Pool
        The candidate terms, from `pool`.
    records : Record or list of Record
        The terms are chosen on all records together.
    continuum : bool
        Whether Sigma_y = 1 is imposed, on the selection and on the fit.
    criterion : "free_run", "aic", "bic" or "knee"
        How many terms to keep. `free_run`: the smallest number whose free-run error is within 10 % of the best, on
        `validation` (default: the records themselves). `knee`: stop where AIC falls by less than 5 % of what the first
        term lowered it by. Without noise AIC and BIC do not reach a minimum.
    n_terms : int, optional
        Number of terms, instead of a criterion.
    method : "one_step", "free_run", "els" or "auto"
        How each model is fitted; `auto` compares one-step and free-run fits.
    frame : Model, optional
        A model with the operating point and the lead to use.
    accept : function of a fitted model, optional
        With the criterion `free_run`: models for which it returns False are only chosen if there is no other.
    first : list of terms
        Terms that are chosen before all others.
    report : callable
        Receives a text before each fit.

    Returns
    -------
    Selection

    Raises
    ------
    FitError
        For an unknown criterion or method, a target that is zero, or if every model diverges.

    Examples
    --------
    >>> import narx_sym as ns
    >>> u = ns.plants.filtered_noise(N=300, Ts=0.01, cutoff=5.0, peak=1.0, seed=1)
    >>> truth = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2])
    >>> record = ns.Record.from_arrays(u, truth.simulate(u, y0=0.0, u0=0.0), Ts=0.01)
    >>> chosen = ns.select(ns.pool(n_y=1, n_u=2, degree=1, phi=False), record, continuum=False, n_terms=2)
    >>> chosen.model.terms
    (y[k - 1], u[k - 1])
    """
    check_method(method)
    output, source = pool.structure.output, pool.structure.input
    frame = frame or NARX([output[k - 1]], output=output, input=source)
    candidates, target, always = candidates_of(pool, continuum, output)
    path = path_of(frame, candidates, target, records, max_terms, first)
    constraints = ("continuum",) if continuum else ()

    def fitted(n: int, how: str) -> Model:
        report(f"fitting {n} of at most {len(path.order)} terms")
        picks = [candidates[i] for i in path.order[:n]]
        terms = [*always, *(t for p in picks for t in (p.args if p.is_Add else (p,)))]
        terms = list(dict.fromkeys(-t if t.could_extract_minus_sign() else t for t in terms))
        model = NARX(
            terms, output=output, input=source, operating_point=frame.operating_point, lead=frame.lead,
            constraints=constraints,
        )  # fmt: skip
        return fit(model, records, method=how, max_steps=PATH_STEPS, warn=False)

    result = Selection(frame, candidates, path)
    limit = len(path.order)
    if n_terms is None and criterion == "free_run":
        ways = ("one_step", "free_run") if method == "auto" else (method,)
        _by_free_run(result, limit, fitted, ways, validation, accept)
    elif n_terms is not None:
        result.chosen, result.reason = min(n_terms, limit), "asked for"
    elif criterion in ("aic", "bic"):
        result.chosen = max(1, int(np.argmin(getattr(path, criterion))))
        result.reason = f"minimum of {criterion.upper()}"
    elif criterion == "knee":
        drops = -np.diff(path.aic)
        result.chosen = 1 + int(np.max(np.flatnonzero(drops >= 0.05 * drops[0])))
        result.reason = "knee of AIC: later picks lower it by less than 5 % of what the first did"
    else:
        raise FitError(f"Unknown criterion {criterion!r}: use free_run, aic, bic or knee.")
    if result.model is frame:  # chosen by number, not yet fitted
        result.model = fitted(result.chosen, method)
    if result.model.info.method == "free_run":
        result.model = fit(result.model, records, method="free_run")
    return result


def _by_free_run(
    result: Selection,
    limit: int,
    fitted: Callable[[int, str], Model],
    ways: Sequence[str],
    validation: Records | None,
    accept: Callable[[Model], bool] | None,
) -> None:
    """Take the fewest terms within 10 % of the best free run among the acceptable models of the path."""
    tried: list[tuple[int, float, bool, Model]] = []
    for n in range(1, limit + 1):
        for how in ways:
            try:
                model = fitted(n, how)
            except FitError:
                continue
            own = free_run_error(model)  # the fit has judged itself on its own records
            error = own if validation is None else free_run_nrmse(model, validation)
            if np.isfinite(error):
                tried.append((n, error, accept is None or accept(model), model))
        result.free_run_nrmse.append(min([e for m, e, _, _ in tried if m == n], default=float("inf")))
    if not tried:
        raise FitError("Every model on the path diverges in free run: use a smaller degree or n_y, or more data.")
    good = [t for t in tried if t[2]] or tried
    best = min(t[1] for t in good)
    result.chosen, _, _, result.model = min((t for t in good if t[1] <= 1.1 * best), key=lambda t: (t[0], t[1]))
    result.reason = f"fewest terms within 10 % of the best free-run error on the path ({best:.4g})"
    if len(good) < len(tried):
        result.reason += "; models with an unstable law were skipped"
    elif accept is not None and not good[0][2]:
        result.reason += "; the law of every model on the path is unstable on these data"
