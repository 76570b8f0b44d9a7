"""The model to take away: fitted on all samples, where the diagnosis has held some back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..data.record import Record
from ..diagnosis.procedure import Diagnosis
from ..errors import FitError
from ..fit.least_squares import describe, fit
from ..fit.simulate import Errors, evaluate
from ..models.model import Model


@dataclass(frozen=True, eq=False)
class Finished:
    """A model fitted on all samples.

    Attributes
    ----------
    model : Model
    note : str
        Why the parameters are those of before; "" where the fit went well.
    """

    model: Model
    note: str = ""


def fit_on_all(model: Model, records: Sequence[Record]) -> Finished:
    """Fit a model in free run on all samples; where that fails, keep its parameters and describe them."""
    try:
        return Finished(fit(model, list(records), method="free_run"))
    except FitError as error:
        kept = describe(model, list(records), "free_run", True)
        note = f"the fit on all samples failed ({error}); the one on the training blocks is kept"
        return Finished(kept, note)


def finish(found: Diagnosis, records: Sequence[Record]) -> tuple[Finished, list[tuple[str, Errors]]]:
    """Return the last model of a diagnosis, fitted on all samples, with the errors on the way there by name."""
    names, listed = found.rungs, list(records)
    what = " ".join(names)
    errors = [("base", evaluate(found.steps[0].base.model, listed))] if len(names) > 1 else []
    errors.append((f"{what}, fitted on the training blocks", evaluate(found.model, listed)))
    made = fit_on_all(found.model, listed)
    errors.append((f"{what}, fitted on all samples", evaluate(made.model, listed)))
    return made, errors
