"""An effect added to a model, and what it is worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ..data.record import Record
from ..diagnosis.add import Addition
from ..diagnosis.refit import Trial
from ..fit.evaluate import Errors, evaluate
from ..fit.identify import prepare
from ..models.model import Model


@dataclass(frozen=True, eq=False)
class Added:
    """A model with an effect.

    Attributes
    ----------
    model : Model
    errors : list of (name, Errors)
        Before, before but fitted to the same data, and with the effect.
    without : Model
        The model without the effect, fitted to the same data.
    """

    model: Model
    errors: list[tuple[str, Errors]]
    without: Model


def add(
    addition: Addition, records: Sequence[Record], seed: int = 0, progress: Callable[[str], Any] = lambda what: None
) -> Added:
    """Fit a model with an effect, both together in free run, and compare the errors before and after.

    Parameters
    ----------
    addition : Addition
        The model, the effect and its place, from `narx_sym.diagnosis.add`.
    """
    listed = prepare(list(records), addition.model.info.units)
    before = evaluate(addition.model, listed)
    trial = Trial.of(listed, listed)
    without = trial.final(trial.as_given(addition.model)).model
    model = addition.fit(listed, seed, progress)
    errors = [
        ("before", before), ("before, fitted to these data", evaluate(without, listed)),
        (f"with {addition.effect}", evaluate(model, listed)),
    ]  # fmt: skip
    return Added(model, errors, without)
