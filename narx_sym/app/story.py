"""The revisions of a model as one diagnosis, and the parts of the report that the page shows of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

from ..diagnosis.procedure import Diagnosis
from ..diagnosis.steps import Step
from ..files.telling import fenced
from ..models.model import Model
from ..report import words
from ..report.page import material, page, sections
from ..report.panels.registry import LAST, TAKEN, WAY, panels
from ..tasks.revise import Revision


@dataclass
class Story(Diagnosis):
    """Several revisions told as one diagnosis, as if each next model had been the choice of the step before.

    Attributes
    ----------
    way : name and errors of each revision, the base first
    final : the last model fitted on all samples, where it is the one that is told of
    """

    way: tuple[tuple[str, Mapping[str, float]], ...] = ()
    final: Model | None = None

    @property
    def model(self) -> Model:
        """The last model, or `final`."""
        return self.final or super().model

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
    html : mapping from the keys of the report's parts to HTML, without scripts
    hero : the first screen of the report as a page for a frame (`report.hero`)
    headline : what is still missing
    """

    html: Mapping[str, str] = field(default_factory=dict)
    hero: str = ""
    headline: str = ""

    def bare(self) -> Revision:
        """Return the revision alone: little to send to a process."""
        return Revision(**{f.name: getattr(self, f.name) for f in fields(Revision)})


def shown(before: Sequence[Revision], made: Revision, units: Mapping[str, str]) -> Shown:
    """Show the whole way to a revision, and what it still lacks: a picture that fails does not lose the revision."""
    every = [*before, made]
    stories = {WAY: Story.of(every), LAST: Story.of([made]), TAKEN: replace(Story.of(every), final=made.model)}
    parts = [
        part
        for about, story in stories.items()
        for part in sections(story, units, keys=[n for n, one in panels().items() if one.tab and one.about == about])
    ]
    first = ""
    with fenced("The first screen"):
        first = page(material(stories[WAY], units, later=stories[LAST]), framed=True)
    own = {f.name: getattr(made, f.name) for f in fields(Revision)}
    html = {part.key: part.html for part in parts}
    return Shown(**own, html=html, hero=first, headline=words.headline(stories[LAST]))
