"""The rungs as one diagnosis, with its pictures: what the page and the report tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from .. import figures
from ..diagnosis import Diagnosis, Step

if TYPE_CHECKING:
    from .jobs import Rung

Units = Mapping[str, str]


class Story(Diagnosis):
    """Several rungs told as one diagnosis, as if each next model had been the choice of the step before.

    Parameters
    ----------
    rungs : sequence of Rung, the base first
    """

    def __init__(self, rungs: Sequence[Rung]):
        steps = [_chosen(a, b) for a, b in pairwise(rungs)]
        steps.append(replace(rungs[-1].found.steps[0], chosen=None))
        first = rungs[0].found
        super().__init__(steps, first.misfit, sum(r.found.seconds for r in rungs), first.seed, first.faults)
        self._ladder = [{"added": r.name.removeprefix("+ "), **r.errors} for r in rungs]
        self._rungs = ["base", *(r.name for r in rungs[1:])]

    @property
    def ladder(self) -> list[dict[str, Any]]:
        """The errors of each rung: name, NRMSE on training and held-out samples."""
        return self._ladder

    @property
    def rungs(self) -> list[str]:
        """What was done on the way, in words."""
        return self._rungs


def _chosen(rung: Rung, after: Rung) -> Step:
    """Return the step of a rung with the next model as its choice; what was added stands first."""
    step = rung.found.steps[0]
    order = sorted(step.candidates, key=lambda c: c.effect != after.effect)
    return replace(step, candidates=order, chosen=after.base)


@dataclass(frozen=True)
class Drawing:
    """A picture as it stands in the page; `place` says what it belongs to, such as the worst region of a panel."""

    key: str
    title: str
    alt: str
    svg: str
    place: str = ""


def drawings(rungs: Sequence[Rung], units: Units) -> dict[str, list[Drawing]]:
    """Return the pictures by the keys of `figures.PANELS`: the whole way, and what the last model still lacks."""
    story, last = Story(rungs), rungs[-1]
    found = {"compare": figures.comparison(story, units), "ladder": [figures.ladder(story, units)]}
    if last.found.candidates:
        found["candidates"] = [figures.candidates(last.found)]
    found["derived"] = [p for p in [figures.quasi_static(last.model, units)] if p is not None]
    found["experiment"] = figures.experiment(last.found, units)
    made = {key: [_drawn(p) for p in pictures] for key, pictures in found.items()}
    made["where"] = [
        _drawn(p, _place(f)) for f in figures.failures(last.found, units) for p in f.pictures
    ]  # fmt: skip
    return made


def _drawn(picture: figures.Picture, place: str = "") -> Drawing:
    return Drawing(picture.key, picture.title, picture.alt, picture.svg, place)


def _place(failure: figures.Failure) -> str:
    """Say what a panel explains, and where it is worst."""
    known = failure.share_missing == failure.share_missing
    missing = f", {100 * failure.share_missing:.0f} % of the missing input" if known else ""
    name = failure.name.replace("_", " ").replace("channel:", "")
    return f"Against {name}: it explains {100 * failure.share:.0f} % of the error{missing}. Worst: {failure.worst}."
