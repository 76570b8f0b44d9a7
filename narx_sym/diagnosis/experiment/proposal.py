"""A proposed experiment: the input, what each candidate says will be measured, and what it will show, in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...files.atomic import PathLike, write_csv
from ...symbolic.numbers import sized, with_unit
from ..bases import words
from ..settings import CLEARLY, VISIBLE

Array = np.ndarray
FILE = "next.csv"


@dataclass(frozen=True, eq=False)
class Experiment:
    """An input to run next.

    Attributes
    ----------
    separates : list of str
        Ids of the candidates.
    name : str
        The signal in words.
    t, u : (N,) arrays
        Time [s] and input [its unit], within `limits` and the rate of the present records.
    separation : float
        Smallest pairwise rms distance between the candidates' outputs, after a refit [unit of y].
    present : float
        The same on the present records; NaN where a candidate cannot be run from their first samples.
    floor : float
        rms of the noise [unit of y].
    outputs : dict of (N,) arrays
        What each candidate says will be measured [unit of y].
    file : str
        Where the input is written, if it is.
    units : mapping of "u" and "y" to texts
    together : list of pairs of ids
        No signal of the family separates these; where other pairs can be separated, the distances are of those.
    limits : (low, high)
        Of the input [its unit].
    given : bool
        Whether the user gave them; else they are the range of the present records.
    seen : (low, high)
        That range.
    wider : Experiment, optional
        The best one over twice the range, where this one hardly decides and that one does.
    """

    separates: list[str]
    name: str
    t: Array
    u: Array
    separation: float
    present: float
    floor: float
    outputs: dict[str, Array]
    file: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    together: list[tuple[str, str]] = field(default_factory=list)
    limits: tuple[float, float] = (-np.inf, np.inf)
    given: bool = False
    seen: tuple[float, float] = (-np.inf, np.inf)
    wider: Experiment | None = None

    @property
    def ratio(self) -> float:
        """The separation in multiples of the noise; infinite without noise."""
        return self.separation / self.floor if self.floor > 0 else float("inf")

    @property
    def visible(self) -> bool:
        """Whether the difference can be seen at all: all samples together stand out of the noise and of rounding."""
        return self.separation > threshold(self.floor, self.outputs.values())

    @property
    def clear(self) -> bool:
        """Whether it separates the candidates visibly, and clearly better than the present records do."""
        return self.visible and not self.separation < CLEARLY * self.present

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def sentence(self) -> str:
        """What to run, and what it will show, in plain words."""
        *most, last = map(words, self.separates)
        between = f"{', '.join(most)} and {last}"
        which = "their outputs" if len(most) == 1 else "any two of their outputs"
        least = "" if len(most) == 1 else "at least "
        which += " that can be distinguished" if self.together else ""
        where = f" ({self.file})" if self.file else ""
        noise = f", {self.ratio:.2g} times the noise" if np.isfinite(self.ratio) else ""
        if not self.visible:
            within = f"{self._range(self.limits)} at the present rate" if self.given else "the present range and rate"
            return (
                f"No tested input within {within} distinguishes {between}: after a refit their outputs are the same "
                f"even for the best input ({self.name}).{self._further}"
            )
        first = float(self.u[0]) if abs(self.u[0]) > 1e-9 * np.ptp(self.u) else 0.0
        rest = with_unit(first, self.units.get("u", ""))
        said = (
            f"To decide between {between}: run this {self.duration:.3g} s input{where}, from rest at {rest}: "
            f"{self.name}. Even after a refit {which} then differ by {least}{self._y(self.separation)} rms{noise}."
        )
        if self.u.min() < self.seen[0] or self.u.max() > self.seen[1]:
            said += f" Beyond {self._range(self.seen)} the models extrapolate."
        if not self.clear:
            how = "no better" if self.separation <= self.present else "hardly better"
            said += (
                f" This is {how} than the present record ({self._y(self.present)}), and no tested input is: a wider "
                f"range or faster moves may decide.{self._further}"
            )
        elif self.ratio < 1:
            said += " Repeat it and average: one sample's noise is larger than the difference."
        for a, b in self.together:
            said += f" No tested input distinguishes {words(a)} and {words(b)}."
        return said

    def _range(self, limits: tuple[float, float]) -> str:
        return with_unit(limits[0], "") + " ... " + with_unit(limits[1], self.units.get("u", ""))

    @property
    def _further(self) -> str:
        """What twice the range would show, with a space before it."""
        if self.wider is None:
            return ""
        where = f", {wider_file(self.file).name}" if self.file else ""
        return (
            f" If the actuator may go twice as far ({self._range(self.wider.limits)}{where}), they differ by "
            f"{self._y(self.wider.separation)} rms."
        )

    def save(self, path: PathLike = FILE) -> None:
        """Write the columns t [s] and u [its unit] as CSV; the input of twice the range beside it (`wider_file`)."""
        write_csv(path, {"t": self.t, "u": self.u})
        if self.wider is not None:
            write_csv(wider_file(path), {"t": self.wider.t, "u": self.wider.u})

    def _y(self, value: float) -> str:
        return sized(value, self.units.get("y", ""), 2)


def wider_file(path: PathLike) -> Path:
    """Return where the input of twice the range is written: next_wider.csv beside next.csv."""
    return Path(path).with_stem(f"{Path(path).stem}_wider")


def threshold(floor: float, outputs: Iterable[Array]) -> float:
    """Return the rms distance between outputs, (N,) arrays, that N samples of noise, or rounding, could make."""
    listed = list(outputs)
    return max(VISIBLE * floor / np.sqrt(listed[0].size), 1e-9 * max(float(np.abs(y).max()) for y in listed))
