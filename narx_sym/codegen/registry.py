"""The targets of an export: each is one file of this folder with `@export`; the command line and the page list them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..errors import ModelError
from ..symbolic.recursion import Recursion
from ..symbolic.registered import load_registered

Coefficients = Callable[[Sequence[tuple[Any, Any]]], Sequence[tuple[str, str]]]
TOLERANCE = {False: 1e-12, True: 1e-4}  # of a self-test, relative; double and single
ROUNDINGS = 30  # a self-test allows as many times what the last bits of the numbers do to a run


@dataclass(frozen=True)
class Example:
    """Samples for a self-test: what each step takes, what it must return, and the values at rest, all by signal.

    `rounding` is how far the last bits of all numbers move the result, relative.
    """

    given: Mapping[Any, Any]
    rest: Mapping[Any, float]
    expected: Any
    rounding: float = 0.0

    def allowed(self, single: bool) -> float:
        """Return how far a self-test may be off, relative."""
        return max(TOLERANCE[single], ROUNDINGS * self.rounding)


@dataclass(frozen=True)
class Request:
    """What is to be exported: one step of a recursion with numbers.

    Attributes
    ----------
    recursion : Recursion
    values : mapping from each parameter to its number
    name : str
        Of what is written: a function, a block, the prefix of both.
    single : bool
        Single precision instead of double.
    returned : IndexedBase
        The state that a step returns.
    initial : mapping from states to expressions
        What they are at rest, in samples of other sequences and parameters; the rest of the others is an argument.
    heading : str
        What the comment on top, or the description, begins with.
    notes : sequence of str
        For the comment on top.
    example : function of whether each step takes every input at time k
        Returns an Example for a self-test, None where short runs from rest tell nothing.
    instance : bool
        For a system of sampled signals: the parameters stay beside the state, where they can be changed, and a step
        takes every input at time k (or the last sample of its preview), also where older samples alone are read.
    Ts : sampling time [s], None where nobody said it
    ranges, rest, units : mappings from names of signals to (low, high), a number at rest, a unit
    coefficients : function from equations to rows (coefficients as a text, their unit), for the comment on top
    outputs : all states that are asked for, `returned` first
    """

    recursion: Recursion
    values: Mapping[Any, Any]
    name: str
    single: bool
    returned: Any
    initial: Mapping[Any, Any]
    notes: Sequence[str] = ()
    example: Callable[[bool], Example | None] = lambda sampled: None
    instance: bool = False
    Ts: float | None = None
    ranges: Mapping[str, Sequence[float]] = field(default_factory=dict)
    rest: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    coefficients: Coefficients = lambda equations: ()
    heading: str = ""
    outputs: Sequence[Any] = ()

    @property
    def settles(self) -> bool:
        """Whether inputs were at rest before the start at what they begin with: what is returned starts from them."""
        return self.returned in self.initial


@dataclass(frozen=True)
class Export:
    """A target: a function from a Request to a source, what it is called, and how its files end ("" for an object)."""

    write: Callable[[Request], Any]
    title: str
    suffix: str = ""


_EXPORTS: dict[str, Export] = {}


def export(name: str, title: str, suffix: str = "") -> Callable[[Callable[[Request], Any]], Callable[[Request], Any]]:
    """Register a target, `@export("c", "C99 source", ".c")`; `model.export("c")` and files that end so lead there."""

    def register(write: Callable[[Request], Any]) -> Callable[[Request], Any]:
        _EXPORTS[name] = Export(write, title, suffix)
        return write

    return register


def exports() -> dict[str, Export]:
    """Return all targets by name."""
    load_registered(__name__)
    return dict(sorted(_EXPORTS.items()))


def files() -> dict[str, str]:
    """Return the targets that are files: name by the ending of the file."""
    return {one.suffix: name for name, one in exports().items() if one.suffix}


def target(name: str) -> Export:
    """Return a target by its name.

    Raises
    ------
    ModelError
        Where there is none of this name.
    """
    found = exports()
    if name not in found:
        raise ModelError(f"There is no export {name[:40]!r}; there are {', '.join(found)}.")
    return found[name]


def target_of(path: Any) -> str:
    """Return the name of the target that a file asks for by its ending."""
    known, ending = files(), path.suffix.lower()
    if ending not in known:
        raise ModelError(f"{path}: unknown kind of source file; end the name in one of {', '.join(sorted(known))}.")
    return known[ending]
