"""The long pieces of work, as the process of the page does them: each makes a revision, and what is shown of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from ..data.record import Record
from ..diagnosis.progress import Told, inside
from ..inversion.compensator import compensator
from ..models.model import Model
from ..tasks.compensate import Law, Tracked, law_of, track
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


def derived(model: Model, limits: tuple[float, float] | None, rate: float | None, progress: Progress) -> Law:
    """Derive the compensation law, with its source."""
    return law_of(model, limits, rate, progress=progress)


def followed(
    model: Model, make: Callable[[], Reference], limits: tuple[float, float] | None, rate: float | None, units: Units,
    progress: Progress,
) -> Ran:  # fmt: skip
    """Run the law of a model over a reference."""
    progress(Told("making the reference"))
    reference = make()
    progress(Told("deriving the compensation law"))
    law = compensator(model)
    progress(Told(f"running the law over {reference.r.size} samples"))
    found = track(law, reference, limits, rate)
    progress(Told("drawing"))
    return ran(found, units)


def relabelled(
    every: Sequence[Revision], run: Tracked | None, records: Sequence[Record], units: Units, progress: Progress
) -> tuple[list[Shown], Ran | None]:
    """Show all revisions again, and a run of the law, with other units."""
    found = []
    for i, made in enumerate(every):
        progress(Told("drawing", done=i + 1, of=len(every), part=i / len(every)))
        found.append(shown(every[:i], made, units))
    return found, None if run is None else ran(run, units)


def _drawn(before: Sequence[Revision], make: Callable[[Progress], Revision], units: Units, progress: Progress) -> Shown:
    made = make(inside(progress, after=1))
    progress(Told("drawing", STAGES + 1, STAGES + 1))
    return shown(before, made, units)
