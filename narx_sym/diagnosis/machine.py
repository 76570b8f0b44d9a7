"""What kind of machine was measured: said by the user, or told by the units of input and output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from ..data.units import converted
from ..errors import ModelError
from ..models.effects import MACHINES, Catalogue
from .bases import spaced
from .settings import SMALL

NONE = "none"  # switches the guess off
# Units of u and y that only one kind of machine has. A volt may be any sensor's, and a percentage or a 4-20 mA loop any
# actuator's: they tell nothing.
TELLING = (
    (("W", "A"), ("K",), "thermal"),
    (("m^3/s", "kg/s"), ("K",), "process"),
    (("m^3/s",), ("m", "m^3"), "tank"),
    (("V", "A", "N*m"), ("rad/s", "m/s"), "drive"),
    (("m", "m/s"), ("N",), "motion-force"),
    (("V",), ("um",), "smart-material"),
    (("A/m",), ("T",), "smart-material"),
    (("V/m",), ("C/m^2",), "smart-material"),
)


@dataclass(frozen=True)
class Machine:
    """The kind of machine: a key of `MACHINES`, "" where it is not known, and whether its units told it."""

    name: str = ""
    guessed: bool = False

    def notes(self, catalogue: Catalogue, units: Mapping[str, str]) -> list[str]:
        """Say what it was taken for, and which effects are not considered in its catalogue."""
        if not self.name:
            return []
        left = ", ".join(map(spaced, catalogue.excluded))
        said = [f"Not considered, because impossible in {MACHINES[self.name]}: {left}."] if left else []
        if self.guessed:
            by = f"because of the units {units['u']} -> {units['y']}"
            other = "if this is wrong, use --machine NAME, or --machine none if it is unknown"
            said = [" ".join([f"The machine is assumed to be {MACHINES[self.name]}, {by}; {other}.", *said])]
        return said


def check_machine(name: str) -> str:
    """Return the name of a kind of machine, "" or "none"; ModelError for what is none of them."""
    if name and name not in (*MACHINES, NONE):
        meant = get_close_matches(str(name), MACHINES, n=1)
        raise ModelError(
            f"Unknown machine {name!r}{f', did you mean {meant[0]}?' if meant else ''}; machines are "
            f"{', '.join(MACHINES)}, or {NONE} where it is not known."
        )
    return name


def machine_of(said: str, units: Mapping[str, str]) -> Machine:
    """Return the machine that the user says, else the one that the units of "u" and "y" tell, if they do."""
    if check_machine(said):
        return Machine("" if said == NONE else said)
    own = units.get("u", ""), units.get("y", "")
    name = next((name for u, y, name in TELLING if all(own) and _is(own[0], u) and _is(own[1], y)), "")
    return Machine(name, bool(name))


def _is(label: str, kinds: tuple[str, ...]) -> bool:
    """Whether a unit is one of these kinds, in any size that does not make it another kind."""
    sizes = [(kind, converted(1.0, label, kind)) for kind in kinds]
    return any(size is not None and size <= SMALL.get(kind, size) and label != "mA" for kind, size in sizes)
