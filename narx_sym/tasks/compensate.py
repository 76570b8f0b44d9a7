"""The compensation law of a model: what a user should know before it runs, its sources, and a run of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..codegen.registry import exports, files
from ..data.metrics import nsavi
from ..diagnosis.progress import Told
from ..errors import ModelError, NarxError, NotInvertible
from ..fit.laws.damping import Share
from ..fit.laws.excursions import operating_range
from ..inversion.compensator import Compensator, compensator
from ..models.model import Model

Array = np.ndarray


@dataclass(frozen=True)
class Law:
    """A compensation law as text, or why there is none.

    Attributes
    ----------
    lines, latex : the law with numbers
    symbols : its LaTeX with symbols
    notes : what a user should know before it runs
    sources : mapping from the endings of files (".c") to the law as source, where it has one
    why_not : str
        "" where there is a law.
    """

    lines: tuple[str, ...] = ()
    latex: str = ""
    symbols: str = ""
    notes: tuple[str, ...] = ()
    sources: Mapping[str, str | bytes] = field(default_factory=dict)
    why_not: str = ""


def ahead(law: Compensator) -> str:
    """Say how far a law looks ahead."""
    return f"It looks {law.preview} sample{'' if law.preview == 1 else 's'} ahead in the reference."


def caution(law: Compensator, share: Share = "auto") -> str:
    """Say that a law rings, or where its own dynamics repel in its operating range; an empty text where neither is."""
    damping = law.damping()
    if damping.rings and share == "auto":
        return str(damping.sentence)
    found = operating_range(law) if law.share(share) == 1 else None
    return "" if found is None else found.sentence


def law_of(
    model: Model,
    limits: tuple[float, float] | None = None,
    rate: float | None = None,
    share: Share = "auto",
    progress: Callable[[str], Any] = lambda what: None,
) -> Law:
    """Derive the compensation law of a model, with its source.

    Parameters
    ----------
    limits, rate, share : of the actuator's input and of its change per sample, for the source; as in `Compensator.run`
    """
    progress(Told("deriving the compensation law", 1, 2))
    try:
        law = compensator(model)
    except (NotInvertible, ModelError) as error:
        return Law(why_not=str(error))
    notes = [ahead(law)]
    ranges = [f"{name} from {low:.4g} to {high:.4g}" for name, (low, high) in model.info.ranges.items()]
    if ranges:
        notes.append(f"It was identified for {' and '.join(ranges)}: beyond that nothing was measured.")
    if law.staged:
        progress(Told("counting the solutions of each stage", 2, 2))
        notes.append(f"Checked: {law.checked}.")
    notes += filter(None, [caution(law, share)])
    sources, lacking = _sources(law, limits=limits, rate=rate, share=share)
    return Law(tuple(law.lines(numbers=True)), law.latex(numbers=True), law.latex(), (*notes, *lacking), sources)


def _sources(law: Compensator, **options: Any) -> tuple[dict[str, str | bytes], list[str]]:
    """Return the law for every target that is a file, by its ending, and why there is none for others."""
    found: dict[str, str | bytes] = {}
    lacking: dict[str, list[str]] = {}
    for ending, name in files().items():
        try:
            found[ending] = law.export(name, **options)
        except NarxError as error:
            lacking.setdefault(str(error), []).append(exports()[name].title)
    return found, [f"There is no {' and no '.join(titles)}: {why}" for why, titles in lacking.items()]


@dataclass(frozen=True, eq=False)
class Followed:
    """A run of a law over a reference.

    Attributes
    ----------
    m : (N,) array [unit of the input]
    start : float
        The input at rest before it.
    effort : float or None
        NSAVI against the reference's; None where that does not move.
    """

    m: Array
    start: float
    effort: float | None


def follow(law: Compensator, r: Array, m0: float | None = None, **options: Any) -> Followed:
    """Run a law over a reference, (N,) array [unit of the output], from rest.

    Parameters
    ----------
    m0 : float, optional
        Input before the start; what keeps the model at the first sample of the reference by default.
    options : limits, rate, share, clip, as `Compensator.run` takes them
    """
    if law.model.channels:
        raise ModelError(f"The law needs the channel {law.model.channels[0]!r}; use Python for this one.")
    start = law.rest_input(r[0], options.get("limits")) if m0 is None else m0
    m = law.run(r, start, **options)
    return Followed(m, start, nsavi(m, r) if np.ptp(r) > 0 else None)
