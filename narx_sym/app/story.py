"""The rungs as one diagnosis, and the parts of the report that the page shows of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..diagnosis.procedure import Diagnosis, Step
from ..models.model import Model
from ..report import page as report

if TYPE_CHECKING:
    from .jobs import Rung

LAST = ("verdict", "where", "candidates", "experiment")  # what the last model still lacks
WAY = ("compare", "ladder", "model")  # from the base to the last model
TAKEN = ("derived",)  # of the model that is taken away
SCRIPT = re.compile(r"<script[^>]*>(.*?)</script>", re.DOTALL)


@dataclass
class Story(Diagnosis):
    """Several rungs told as one diagnosis, as if each next model had been the choice of the step before.

    Attributes
    ----------
    way : name and errors of each rung, the base first
    final : the last model fitted on all samples, where it is the one that is told of
    """

    way: tuple[tuple[str, Mapping[str, float]], ...] = ()
    final: Model | None = None

    @property
    def model(self) -> Model:
        """The last model, or `final`."""
        return self.final or super().model

    @classmethod
    def of(cls, rungs: Sequence[Rung]) -> Story:
        """Tell it."""
        steps = [_chosen(a, b) for a, b in pairwise(rungs)]
        steps.append(replace(rungs[-1].found.steps[0], chosen=None))
        first = rungs[0].found
        way = tuple((r.name if i else "base", r.errors) for i, r in enumerate(rungs))
        seconds = sum(r.found.seconds for r in rungs)
        return cls(steps, first.misfit, seconds, first.seed, first.faults, first.data_notes, way)

    @property
    def ladder(self) -> list[dict[str, Any]]:
        """The errors of each rung: name, NRMSE on training and held-out samples."""
        return [{"added": name.removeprefix("+ "), **errors} for name, errors in self.way]

    @property
    def rungs(self) -> list[str]:
        """What was done on the way, in words."""
        return [name for name, _ in self.way]


def _chosen(rung: Rung, after: Rung) -> Step:
    """Return the step of a rung with the next model as its choice; what was added stands first."""
    step = rung.found.steps[0]
    order = sorted(step.candidates, key=lambda c: c.effect != after.effect)
    return replace(step, candidates=order, chosen=after.base)


@dataclass(frozen=True)
class Told:
    """The parts of the report as HTML by their keys, and the script that draws what can be zoomed."""

    html: Mapping[str, str]
    script: str = ""


def told(rungs: Sequence[Rung], units: Mapping[str, str]) -> Told:
    """Tell the whole way, and what the last model still lacks."""
    parts = report.sections(Story.of(rungs), units, keys=WAY)
    parts += report.sections(Story.of(rungs[-1:]), units, keys=LAST)
    parts += report.sections(replace(Story.of(rungs), final=rungs[-1].model), units, keys=TAKEN)
    scripts = [script for part in parts for script in SCRIPT.findall(part.html)]
    return Told({part.key: SCRIPT.sub("", part.html) for part in parts}, "\n".join(scripts))
