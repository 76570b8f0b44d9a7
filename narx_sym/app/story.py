"""The revisions of a model as one diagnosis, and the parts of the report that the page shows of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

from ..diagnosis.procedure import Diagnosis
from ..diagnosis.steps import Step
from ..report import words
from ..report.page import material, page
from ..tasks.revise import Revision


@dataclass
class Story(Diagnosis):
    """Several revisions told as one diagnosis, as if each next model had been the choice of the step before.

    Attributes
    ----------
    way : name and errors of each revision, the base first
    """

    way: tuple[tuple[str, Mapping[str, float]], ...] = ()

    @classmethod
    def of(cls, revisions: Sequence[Revision]) -> Story:
        """Tell it."""
        steps = [_chosen(a, b) for a, b in pairwise(revisions)]
        steps.append(replace(revisions[-1].found.steps[0], chosen=None))
        first = revisions[0].found
        way = tuple((r.name if i else "base", r.errors) for i, r in enumerate(revisions))
        seconds = sum(r.found.seconds for r in revisions)
        return cls(steps, first.misfit, seconds, first.seed, first.faults, first.data_notes, way=way)

    @property
    def ladder(self) -> list[dict[str, Any]]:
        """The errors of each revision, as `Diagnosis.ladder` has them."""
        return [{"added": name.removeprefix("+ "), **errors} for name, errors in self.way]

    @property
    def rungs(self) -> list[str]:
        """What was done on the way, in words."""
        return [name for name, _ in self.way]


def _chosen(before: Revision, after: Revision) -> Step:
    """Return the step of a revision with the next model as its choice; what was added stands first."""
    step = before.found.steps[0]
    order = sorted(step.candidates, key=lambda c: c.effect != after.effect)
    return replace(step, candidates=order, chosen=after.base)


@dataclass(frozen=True, eq=False)
class Shown(Revision):
    """A revision with what the page shows of it.

    Attributes
    ----------
    page : the report on it, for a frame; its first screen is that of `report.hero`
    headline : what is still missing
    """

    page: str = ""
    headline: str = ""

    def bare(self) -> Revision:
        """Return the revision alone: little to send to a process."""
        return Revision(**{f.name: getattr(self, f.name) for f in fields(Revision)})


def shown(before: Sequence[Revision], made: Revision, units: Mapping[str, str]) -> Shown:
    """Show the whole way to a revision, and what it still lacks."""
    way, last = Story.of([*before, made]), made.found
    own = {f.name: getattr(made, f.name) for f in fields(Revision)}
    told = page(material(way, units, later=last), framed=True)
    return Shown(**own, page=told, headline=words.headline_with(way, last))
