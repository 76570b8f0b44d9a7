"""What a picture is made of: lines and areas with words and roles, on axes with units; and how a role looks."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Array = np.ndarray
TIME = "time [s]"
# Okabe & Ito (2008), distinguishable without colour vision: on white paper, on a dark page, and on either.
COLOURS = {
    "orange": ("#E69F00", "#F0B030", "#C47F00"), "sky": ("#56B4E9", "#56B4E9", "#56B4E9"),
    "green": ("#009E73", "#1BBF92", "#0E9A72"), "yellow": ("#F0E442", "#B8AE20", "#F0E442"),
    "blue": ("#0072B2", "#4DA6E0", "#1F83C0"), "red": ("#D55E00", "#F07A30", "#D55E00"),
    "pink": ("#CC79A7", "#DB93BB", "#B8618F"), "paper": ("#FFFFFF", "#14171C", "#FFFFFF"),
    "faint": ("#D9D9D9", "#3A3F47", "#D9D9D9"), "rule": ("#CCCCCC", "#4A505A", "#CCCCCC"),
    "grey": ("#808080", "#8A9099", "#808080"), "black": ("#000000", "#FFFFFF", "#767676"),
}  # fmt: skip


@dataclass(frozen=True)
class Look:
    """How a role is drawn: a line [points] with its dashes [widths], dots [points], or, with neither, an area."""

    colour: str
    width: float = 1.2
    dash: tuple[float, ...] = ()
    dot: float = 0.0
    alpha: float = 1.0

    @property
    def on_page(self) -> dict[str, Any]:
        """The same in pixels, in a colour for light and dark paper."""
        dash = [round(4 / 3 * self.width * part) for part in self.dash]
        return {
            "colour": COLOURS[self.colour][2], "width": self.width, "dash": dash, "alpha": self.alpha, "dot": self.dot,
        }  # fmt: skip


_DASHED, _DOTTED, _MIXED = (4.0, 1.6), (1.2, 1.6), (6.0, 1.6, 1.2, 1.6)
SEVERAL = tuple(f"several-{i}" for i in range(1, 7))  # roles of things that stand beside each other
LOOKS = {
    "measured": Look("black", 2.0), "recorded": Look("black", 0.9), "reference": Look("black", 2.0),
    "before": Look("orange", 1.4, _DASHED), "after": Look("blue"), "candidate": Look("pink", 2.0, _MIXED),
    "input": Look("blue"), "estimate": Look("orange", 1.6, _DASHED), "limit": Look("red", 1.0, _DOTTED),
    "setpoint": Look("red", 1.0, _DOTTED), "zero": Look("black", 0.6), "region": Look("red", 0.0, dot=5.0),
    "start": Look("black", 0.0, dot=4.0), "sample": Look("grey", 0.0, dot=2.0), "mean": Look("black", 0.0, dot=7.0),
    "floor": Look("yellow", 0.0, alpha=0.45),
    "range": Look("sky", 0.0, alpha=0.35), "held-out": Look("grey", 0.0, alpha=0.24),
    "brush": Look("sky", 0.0, alpha=0.45),
} | dict(zip(SEVERAL, (
    Look("blue"), Look("orange", 1.4, _DASHED), Look("green", 1.4, _MIXED), Look("pink", 1.6, _DOTTED),
    Look("black", 0.8), Look("red", 2.0, _DASHED),
), strict=True))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Line:
    """Points (x, y), (N,) arrays; joined, dotted or filled as the role says."""

    x: Array
    y: Array
    name: str = ""
    role: str = "measured"


@dataclass(frozen=True)
class Area:
    """What lies between two values of y, or of x where it stands upright; a line at the first where its role is one."""

    low: float
    high: float
    name: str = ""
    role: str = "floor"
    upright: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes with what they show, in words and units; the first mark lies below the others.

    Attributes
    ----------
    along : bool
        Whether x runs along, as time does: there is no room beside the lines, and all are read at one x.
    y_range : (lowest, highest), optional
    height : float
        Relative to a usual panel.
    """

    x: str
    y: str
    marks: Sequence[Line | Area]
    title: str = ""
    along: bool = False
    y_range: tuple[float, float] | None = None
    height: float = 1.0


def traces(name: str, x: Array, y: str, runs: Mapping[str, tuple[str, Array]], *below: Area, **more: Any) -> Panel:
    """Return a panel of lines over the same x; `runs` has a role and (N,) values for each word."""
    lines = [Line(x, values, word, role) for word, (role, values) in runs.items()]
    return Panel(name, y, [*below, *lines], along=name == TIME, **more)


def span(*values: Array) -> tuple[float, float]:
    """Return the range of values with some room."""
    low, high = (float(f(f(x) for x in values)) for f in (min, max))
    room = 0.05 * (high - low) or 1.0
    return low - room, high + room


def thin(x: Array, most: int = 4000) -> Array:
    """Return indices that keep the extremes of each bin: enough points to draw, none that matters lost."""
    if x.size <= 2 * most:
        return np.arange(x.size)
    edges = np.linspace(0, x.size, most // 2 + 1).astype(int)
    picks = [i for a, b in itertools.pairwise(edges) for i in (a + np.argmin(x[a:b]), a + np.argmax(x[a:b]))]
    return np.unique([0, *picks, x.size - 1])


def thinned(most: int, *panels: Panel) -> list[Panel]:
    """Return panels with fewer points: longer arrays of one length keep the same samples, with the extremes of all."""
    lines = [mark for panel in panels for mark in panel.marks if isinstance(mark, Line)]
    every = {id(a): a for line in lines for a in (line.x, line.y)}
    kept: dict[int, Any] = {}
    for n in {a.size for a in every.values()}:
        alike = [np.nan_to_num(a) for a in every.values() if a.size == n > most]
        kept[n] = np.unique([i for a in alike for i in thin(a, most // len(alike))]) if alike else slice(None)
    less = {id(a): a[kept[a.size]] for a in every.values()}

    def drawn(mark: Line | Area) -> Line | Area:
        return replace(mark, x=less[id(mark.x)], y=less[id(mark.y)]) if isinstance(mark, Line) else mark

    return [replace(panel, marks=[*map(drawn, panel.marks)]) for panel in panels]


# -- for pages -------------------------------------------------------------------------------------------------


def key(role: str) -> str:
    """Return the CSS of the key of a role: an area, or a line with its dashes."""
    look, paint = LOOKS[role], f"var(--{role})"
    if not look.width:
        return f"height: .8rem; background: {paint}; opacity: {look.alpha}"
    ends = itertools.pairwise(itertools.accumulate(look.on_page["dash"], initial=0.0))
    stops = "".join(f", {c} {a:.3g}px {b:.3g}px" for c, (a, b) in zip([paint, "#0000"] * 2, ends, strict=False))
    shown = f"repeating-linear-gradient(90deg{stops})" if stops else paint
    return f"height: {max(1.5, look.width):.3g}px; background: {shown}"


def script() -> str:
    """Return what the scripts of pages share with all pictures."""
    return f"const TIME = {json.dumps(TIME)};\nconst LOOKS = {json.dumps({r: x.on_page for r, x in LOOKS.items()})};"


def stylesheet(selector: str = ":root") -> str:
    """Return the CSS variables of the colours, for light and for dark pages, and of the roles, for both."""
    light, dark = ("; ".join(f"--{n}: {pair[i]}" for n, pair in COLOURS.items()) for i in (0, 1))
    roles = "; ".join(f"--{role}: {look.on_page['colour']}" for role, look in LOOKS.items())
    return (
        f"{selector} {{ {light}; {roles} }}\n"
        f"@media screen and (prefers-color-scheme: dark) {{ {selector} {{ {dark} }} }}\n"
    )
