"""A model in the making: each revision is a model with the diagnosis of what it still lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ..data.record import Record
from ..diagnosis.add import Addition
from ..diagnosis.procedure import Diagnosis, diagnose
from ..diagnosis.progress import ROUND, Told, inside
from ..diagnosis.refit import Fitted, prune
from ..diagnosis.table.candidates import Candidate, Pair
from ..models.effects import EFFECTS
from ..models.model import Model
from .base import check_pace, identify_base

Progress = Callable[[str], Any]
STAGES = 1 + 1 + len(ROUND)  # what is new, the base, and a round of a diagnosis


@dataclass(frozen=True, eq=False)
class Revision:
    """One state of a model.

    Attributes
    ----------
    name : str
        What was done to get here.
    found : Diagnosis
        Of this model: `found.steps[0].base` is the model as it is shown.
    model : Model
    effect : str
        The effect that was added, or two as "one + other"; "" for a base or an edited term.
    notes : tuple of str
    """

    name: str
    found: Diagnosis
    model: Model
    effect: str = ""
    notes: tuple[str, ...] = ()

    @property
    def base(self) -> Fitted:
        """The model as it is shown."""
        return self.found.steps[0].base

    @property
    def errors(self) -> dict[str, float]:
        """Free-run errors on the records and on validation data, as `Diagnosis.ladder` has them."""
        return self.found.steps[0].figures(self.base)


def begin(base: str | Model, records: Sequence[Record], progress: Progress, **known: Any) -> Revision:
    """Identify a base, unless it is a model already, and diagnose it; `known` is what else `diagnose` is told."""
    if isinstance(base, Model):
        progress(Told("taking the model from its file", 1, STAGES))
        check_pace(base, records[0].Ts, "The data have")
        return revised("model file", base, records, progress, **known)
    progress(Told(f"identifying a {base} base from {sum(map(len, records))} samples", 1, STAGES))
    return revised(f"{base} base", identify_base(base, records), records, progress, **known)


def with_effect(before: Revision, effect: str, records: Sequence[Record], progress: Progress, **known: Any) -> Revision:
    """Add an effect as the diagnosis fitted it, or two that it found together; or any other of the catalogue."""
    step = before.found.steps[0]
    offered: list[Candidate | Pair] = [*([step.pair] if step.pair is not None else []), *step.candidates]
    candidate = next((c for c in offered if c.effect == effect), None)
    progress(Told(f"adding {effect}", 1, STAGES))
    if candidate is None:
        addition = Addition(before.base.model, effect, None, EFFECTS)
        model = addition.fit(list(records), progress=lambda now: progress(Told(f"adding it: {now}", 1, STAGES)))
    elif step.chosen is not None and " + ".join(step.added) == effect:
        model = step.chosen.model
    else:
        model = prune(candidate.fitted, before.base).model
    return revised(f"+ {effect}", model, records, progress, effect, **known)


def revised(
    name: str, model: Model, records: Sequence[Record], progress: Progress, effect: str = "", **known: Any
) -> Revision:
    """Diagnose a model."""
    found = diagnose(model, list(records), report=inside(progress, before=1), **known)
    base = found.steps[0].base
    return Revision(name, found, base.model, effect)
