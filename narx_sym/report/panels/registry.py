"""The registry of the parts: each is one file of this folder with `@panel`; report and live page ask for them here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

from ...diagnosis.procedure import Diagnosis
from ...files.atomic import PathLike
from ...inversion.analyses import Subject
from ...symbolic.registered import load_registered
from ..comparison import Comparison, Units
from ..picture import Picture

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class Material:
    """What the parts are made of.

    Attributes
    ----------
    diagnosis : Diagnosis
        With units in its sentences.
    units : mapping such as {"u": "V", "y": "um"}
    files : paths of the data
    settings : mapping of what else was chosen
    later : Diagnosis, optional
        Of what the last model still lacks, where a user adds one effect after the other.
    searching : bool
        Whether effects are still searched: then only the errors and pictures of the base are shown.
    """

    diagnosis: Diagnosis
    units: Units
    files: Sequence[PathLike] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    later: Diagnosis | None = None
    searching: bool = False

    @property
    def lacking(self) -> Diagnosis:
        """The diagnosis that says what is missing now."""
        return self.later or self.diagnosis

    @cached_property
    def compared(self) -> Comparison:
        """Measured and simulated output, before and after."""
        return Comparison.of(self.diagnosis)

    @cached_property
    def subject(self) -> Subject:
        """The model to take away, with its law."""
        return Subject(self.diagnosis.model)

    @cached_property
    def _made(self) -> dict[Callable[[Material], Any], Any]:
        return {}

    def once(self, make: Callable[[Material], Made]) -> Made:
        """Return what a function makes of this material; it is called once."""
        if make not in self._made:
            self._made[make] = make(self)
        made: Made = self._made[make]
        return made

    def pictures(self, key: str) -> list[Picture]:
        """Return the pictures of a part."""
        return self.once(panels()[key].draws)


@dataclass(frozen=True)
class Part:
    """A part of the report.

    Attributes
    ----------
    tell : function from Material to what its template needs, None where it has nothing to tell
        The template is `templates/panels/<key>.html`; a part without one shows its pictures. "title" among what it
        returns is another heading.
    title : str
        Its heading.
    order : float
        Its place in the report.
    draws : function from Material to pictures
    """

    tell: Callable[[Material], dict[str, Any] | None]
    title: str
    order: float
    draws: Callable[[Material], list[Picture]]


_PANELS: dict[str, Part] = {}
Tell = Callable[[Material], dict[str, Any] | None]


def panel(
    title: str,
    order: float,
    draws: Callable[[Material], list[Picture]] = lambda material: [],
) -> Callable[[Tell], Tell]:
    """Register a part under the name of its function; see `Part`."""

    def register(tell: Tell) -> Tell:
        _PANELS[tell.__name__] = Part(tell, title, order, draws)
        return tell

    return register


def panels() -> dict[str, Part]:
    """Return all parts by key, in the order of the report."""
    load_registered(__name__)
    return dict(sorted(_PANELS.items(), key=lambda pair: pair[1].order))
