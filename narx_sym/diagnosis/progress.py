"""How far work with known stages is: a text for who reads it, and its numbers for who draws a bar."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..files.telling import fenced

Look = Callable[[], Any]
Removed = tuple[tuple[str, float], ...]
BASE, WAYS, ALONE = "fitting the base and its delay", "deriving the response to each effect", "trying each effect alone"
PAIRS, JUDGE = "trying pairs of effects", "validating what was found"
ROUND = (WAYS, ALONE, PAIRS, JUDGE)  # the stages of each step of a diagnosis, after the base


class Told(str):
    """What work says of itself: "Step 3 of 5: trying each effect alone, 12 of 85 (so far: ...)".

    Attributes
    ----------
    what : str
        The stage in plain words.
    stage, stages : int
        Which stage of how many, from 1.
    done, of : int
        How many of how many within the stage; 0 of 0 where that is not known.
    removed : tuple of pairs
        The best effects by now in words, each with the share of the squared error that it removes.
    found : str
        The same as a text; "" before anything is known.
    part : float
        Share of the stage that is done.
    look : callable or None
        Where the base is fitted: returns what is known by then, a `Diagnosis` without an effect.
    """

    what: str
    stage: int
    stages: int
    done: int
    of: int
    removed: Removed
    found: str
    part: float
    look: Look | None = None

    def __new__(
        cls, what: str, stage: int = 1, stages: int = 1, done: int = 0, of: int = 0, removed: Removed = (),
        part: float = 0.0,
    ) -> Told:  # fmt: skip
        """Put the text together."""
        count = f", {done} of {of}" if of else ""
        listed = [f"{name} {'' if i else 'removes '}{100 * share:.0f} %" for i, (name, share) in enumerate(removed)]
        found = ", ".join([f"{one} of the squared error" for one in listed[:1]] + listed[1:])
        more = f" (so far: {found})" if found else ""
        made = super().__new__(cls, f"Step {stage} of {stages}: {what}{count}{more}")
        made.what, made.stage, made.stages, made.done, made.of = what, stage, stages, done, of
        made.removed, made.found, made.part = removed, found, part
        return made

    def __reduce__(self) -> tuple[Any, ...]:  # a look stays in its process
        return Told, (self.what, self.stage, self.stages, self.done, self.of, self.removed, self.part)

    @property
    def fraction(self) -> float:
        """Share of all stages that is done."""
        return (self.stage - 1 + self.part) / self.stages


def inside(tell: Callable[[str], Any], before: int = 0, after: int = 0) -> Callable[[str], Any]:
    """Return a listener for work that is a part of other work, with so many stages before and after it."""

    def retell(now: str) -> Any:
        if not isinstance(now, Told):
            return tell(now)
        stage, stages = now.stage + before, now.stages + before + after
        told = Told(now.what, stage, stages, now.done, now.of, now.removed, now.part)
        told.look = now.look
        return tell(told)

    return retell


class Course:
    """Tells one stage after the other: a stage that is not needed is passed over, and none is gone back to.

    Nothing in it can end the work; only what a listener raises itself goes through, as a caller cancels by that.
    """

    def __init__(self, tell: Callable[[str], Any], stages: Sequence[str]):
        self.tell, self.stages = tell, tuple(stages)
        self.at, self.what, self.part, self.asked = -1, "", 0.0, False
        self.removed: Removed = ()

    @property
    def enough(self) -> bool:
        """Whether a listener has returned True, and something was found: then nothing more is searched."""
        return self.asked and bool(self.removed)

    def reach(self, stage: str) -> None:
        """Begin the next stage of this name; where none is left, as in a round more than planned, the last goes on."""
        last = len(self.stages) - 1
        at = next((i for i in range(self.at + 1, last + 1) if self.stages[i] == stage), last)
        self.at, self.what, self.part = at, stage, self.part if at == self.at else 0.0
        self.say()

    def say(
        self, more: str = "", done: int = 0, of: int = 0, turn: int = 0, turns: int = 1,
        found: Callable[[], Removed] = lambda: (), look: Look | None = None,
    ) -> None:  # fmt: skip
        """Tell how far a stage is: so many of so many, in this turn of so many; what is `found` by now, if anything."""
        now = None
        with fenced("Progress"):
            self.part = max(self.part, min(1.0, (turn + done / max(1, of)) / turns))
            self.removed = found() or self.removed
            now = Told(f"{self.what}{more}", self.at + 1, len(self.stages), done, of, self.removed, self.part)
            now.look = look
        if now is not None and self.tell(now) is True:
            self.asked = True
