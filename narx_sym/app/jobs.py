"""The long pieces of work, as the process of the page does them: each makes a revision, and what is shown of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..data.record import Record
from ..diagnosis.progress import Told, inside
from ..files.telling import fenced
from ..inversion.compensator import compensator
from ..models.model import Model
from ..report.page import material, page
from ..tasks.compensate import Law, law_of, track
from ..tasks.reference import Reference
from ..tasks.revise import STAGES, Progress, Revision
from .browser.preview import Ran, ran
from .story import Shown, shown

Units = Mapping[str, str]


def revision(
    make: Callable[..., Revision], what: Sequence[Any], before: Sequence[Revision], records: Sequence[Record],
    units: Units, progress: Callable[[Any], Any], **known: Any,
) -> Shown:  # fmt: skip
    """Make a revision with a function of `tasks.revise`, and show it; `known` is what else `diagnose` is told."""

    def tell(now: Any) -> Any:
        """Show the base as soon as it is known."""
        if now.look is not None and not before:
            with fenced("The first look"):
                progress(page(material(now.look(), units, searching=True), framed=True).encode())
        return progress(now)

    made = make(*what, records, inside(tell, after=1), **known)
    progress(Told("drawing", STAGES + 1, STAGES + 1))
    return shown(before, made, units)


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
