"""The long pieces of work, as the process of the page does them: each makes a revision, and what is shown of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from ..data.record import Record
from ..diagnosis.progress import Told, inside
from ..inversion.compensator import compensator
from ..models.model import Model
from ..tasks.compensate import Law, law_of, track
from ..tasks.reference import Reference
from ..tasks.revise import STAGES, Progress, Revision, begin, with_effect, with_term
from .browser.preview import Ran, ran
from .story import Shown, shown

Units = Mapping[str, str]


def diagnosed(base: str | Model, records: Sequence[Record], units: Units, progress: Progress, **known: Any) -> Shown:
    """Identify a base, unless it is a model already, and diagnose it; `known` is what else `diagnose` is told."""
    return _drawn((), partial(begin, base, records, **known), units, progress)


def added(
    effect: str, before: Sequence[Revision], records: Sequence[Record], units: Units, progress: Progress, **known: Any
) -> Shown:
    """Add an effect to the last of the revisions before."""
    return _drawn(before, partial(with_effect, before[-1], effect, records, **known), units, progress)


def edited(
    model: Model, name: str, what: str, before: Sequence[Revision], records: Sequence[Record], units: Units,
    progress: Progress, **known: Any,
) -> Shown:  # fmt: skip
    """Fit a model whose term with the parameter `name` is new."""
    return _drawn(before, partial(with_term, model, name, what, records, **known), units, progress)


def followed(
    model: Model, make: Callable[[], Reference], limits: tuple[float, float] | None, rate: float | None, units: Units,
    progress: Progress,
) -> tuple[Law, Ran | None]:  # fmt: skip
    """Derive the law of a model with its source, and run it over a reference, where there is one."""
    reference, law = make(), law_of(model, limits, rate, progress=progress)
    if law.why_not:
        return law, None
    progress(Told(f"running the law over {reference.r.size} samples"))
    found = track(compensator(model), reference, limits, rate)
    progress(Told("drawing"))
    return law, ran(found, units)


def _drawn(before: Sequence[Revision], make: Callable[[Progress], Revision], units: Units, progress: Progress) -> Shown:
    made = make(inside(progress, after=1))
    progress(Told("drawing", STAGES + 1, STAGES + 1))
    return shown(before, made, units)
