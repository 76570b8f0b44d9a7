"""What was done, so that it can be undone and done again: every state is kept whole, so nothing is computed anew."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..models.model import Model
from ..tasks.compensate import Law
from .browser.preview import Ran
from .story import Shown

MOST = 30  # states that are kept: each has the pictures of its diagnosis


@dataclass(frozen=True, eq=False)
class State:
    """What the page shows after a step.

    Attributes
    ----------
    revisions : the models so far, with their diagnoses; the last one is shown
    base, base_name : the base that was chosen
    law, run : of the last model, where they were asked for
    notes : what was said of it
    """

    revisions: tuple[Shown, ...]
    base: str | Model
    base_name: str
    law: Law | None = None
    run: Ran | None = None
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What was done to get here."""
        return self.revisions[-1].name

    @property
    def error(self) -> float:
        """The free-run error on validation data [unit of y]."""
        return self.revisions[-1].errors["validation_rms"]


@dataclass
class History:
    """The states in the order in which they were made, and the one that is shown.

    Attributes
    ----------
    states : list of State
    at : int
        Index of the state that is shown, -1 before the first.
    """

    states: list[State] = field(default_factory=list)
    at: int = -1

    def put(self, state: State) -> None:
        """Take a new state; what was undone before is forgotten, and the first where there are too many."""
        self.states = [*self.states[: self.at + 1], state][-MOST:]
        self.at = len(self.states) - 1
