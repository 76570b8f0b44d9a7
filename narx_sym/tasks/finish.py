"""The model to take away: fitted on all samples, where the diagnosis has held some back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..data.record import Record
from ..diagnosis.add import FINAL
from ..diagnosis.procedure import Diagnosis
from ..diagnosis.refit import Fitted, Split, settle
from ..errors import FitError
from ..fit.least_squares import describe, unfinished
from ..fit.simulate import Errors, evaluate, segments
from ..models.model import Model

WORSE = 1.2  # than what was shown


@dataclass(frozen=True, eq=False)
class Finished:
    """A model fitted on all samples.

    Attributes
    ----------
    model : Model
    note : str
        Why the parameters are those of before; "" where the fit went well.
    nrmse : float
        Of the free run over all samples, each segment from the start that the fit found: as the ladder judges. From
        the measured start (`evaluate`) it is larger by what the first samples do not tell, and by their noise.
    shown : float
        What the ladder said of this model; infinite where it said nothing.
    """

    model: Model
    note: str = ""
    nrmse: float = np.nan
    shown: float = np.inf


def fit_on_all(
    model: Model,
    records: Sequence[Record],
    limits: Mapping[Any, Any] | None = None,
    shown: float = np.inf,
    unknowns: np.ndarray | None = None,
) -> Finished:
    """Fit a model in free run on all samples; where that fails, or is not what was shown, keep its parameters.

    Parameters
    ----------
    limits : of some parameters, as in the fit before
    shown : float
        The free-run NRMSE that was told; the new one may be larger by `WORSE`.
    unknowns : of the fit before, on the same segments: where it starts, if that is nearer
    """
    listed = list(records)
    kept = "the one on the training blocks is kept"
    try:
        made = settle(model, Split.whole(listed), limits=limits, steps=FINAL, unknowns=unknowns)
    except FitError as error:
        return Finished(describe(model, listed, "free_run", True), f"the fit on all samples failed ({error}); {kept}")
    after = _over_all(made)
    if not after <= WORSE * shown:
        note = f"the fit on all samples ends at a free-run NRMSE of {after:.3g} instead of {shown:.3g}; {kept}"
        return Finished(describe(model, listed, "free_run", True), note)
    return Finished(unfinished(describe(made.model, listed, "free_run", made.converged)), nrmse=after, shown=shown)


def finish(found: Diagnosis, records: Sequence[Record]) -> tuple[Finished, list[tuple[str, Errors]]]:
    """Return the model of a diagnosis to take away, fitted on all samples, with the errors on the way there by name.

    What is saved is what was shown: its free run is as good as the ladder says, and over whole records better than
    that of the base, each from the start that its fit found. Else the model before it is taken, and the note says why.
    It also says where runs from measured starts leave clearly more.
    """
    names, notes = found.rungs, []
    rungs = [found.steps[0].base, *(s.chosen for s in found.steps if s.chosen is not None)]
    listed = found.judged or list(records)
    base = _over_all(rungs[0])
    errors = [("base", evaluate(rungs[0].model, listed))] if len(rungs) > 1 else []
    while True:
        fitted, what = rungs.pop(), " ".join(names[: len(rungs) + 1])
        shown = max(found.steps[0].nrmse(fitted).values())
        errors.append((f"{what}, fitted on the training blocks", evaluate(fitted.model, listed)))
        same = [len(s) for s in segments(listed)] == [len(s) for s in fitted.split.records]
        made = fit_on_all(fitted.model, listed, fitted.limits, shown, fitted.unknowns if same else None)
        if made.note:
            made = replace(made, nrmse=_over_all(fitted), shown=shown)
        notes += [made.note] if made.note else []
        whole = evaluate(made.model, listed)
        if not made.note:  # else its parameters are those of the row before
            errors.append((f"{what}, fitted on all samples", whole))
        measured = whole.free_run_nrmse
        if not rungs or (made.nrmse < base and np.isfinite(measured)):
            if measured > WORSE * made.nrmse:
                notes.append(
                    f"the first samples do not tell well where a run begins: from them it leaves {measured:.3g} (base "
                    f"{errors[0][1].free_run_nrmse:.3g}), from fitted starts, as judged, {made.nrmse:.3g} ({base:.3g})"
                )
            return replace(made, note="; ".join(notes)), errors
        left = made.nrmse if np.isfinite(measured) else measured
        notes.append(
            f"with {what} the free run over whole records is no better than that of the base (NRMSE {left:.3g}, "
            f"{base:.3g}): the model before it is taken"
        )


def _over_all(fitted: Fitted) -> float:
    """Return the NRMSE of the free run over all samples, from the starts that the fit found."""
    return float(np.sqrt(fitted.mean_square(Split.whole(fitted.split.records).train))) / fitted.problem.spread
