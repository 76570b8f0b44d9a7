"""What an exported step looks like: what it takes, remembers and returns, its names and its comment."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp

from ..engines.plan import Plan
from ..engines.writer import indented
from ..symbolic.printing import text
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, lag, samples, signal
from .registry import Request

WIDTH = 108  # of a line
ASCII = str.maketrans({"°": "deg", "µ": "u", "μ": "u", "·": " "})  # of units
RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⋅", "0123456789-.")


@dataclass(frozen=True)
class Layout:
    """What one exported step is given, remembers and returns, and a legal identifier for each of its signals.

    Attributes
    ----------
    request : Request
    values : mapping from each parameter that does not stay beside the state to its number
    initial : mapping from states to expressions
        What a state is before the first step, in samples of the sequences that `rested` lists.
    labels : mapping from signals to identifiers
    parameters : mapping from parameters without a number to identifiers
    newest : mapping from inputs to numbers
        The lag of the sample of each input that a step takes; a preview is negative.
    """

    request: Request
    values: Mapping[Any, Any]
    initial: Mapping[Any, Any]
    labels: Mapping[Any, str]
    parameters: Mapping[Any, str]
    newest: Mapping[Any, int]

    @classmethod
    def of(cls, request: Request, label: Callable[[str, set[str]], str], taken: Iterable[str]) -> Layout:
        """Lay out a step; `label` makes an identifier from a name and from the identifiers that are taken."""
        recursion, values = request.recursion, {} if request.instance else request.values
        initial = {b: e.xreplace(dict(values)) for b, e in request.initial.items()}
        read = sorted({s.base for e in initial.values() for s in samples(e)}, key=str)
        written = set().union(*(e.free_symbols for e in (*initial.values(), *(e for _, e in recursion.updates))))
        kept = [p for p in recursion.parameters if p in written and p not in values]
        names: dict[Any, str] = {}
        used = set(taken)
        for one in dict.fromkeys((*recursion.states, *recursion.inputs, *read, *kept)):
            names[one] = label(str(getattr(one, "label", one)), used)
            used.add(names[one])
        parameters = {p: names.pop(p) for p in kept}
        return cls(request, values, initial, names, parameters, newest(recursion, request.instance))

    @property
    def recursion(self) -> Recursion:
        """The equations."""
        return self.request.recursion

    @property
    def output(self) -> str:
        """The identifier of what a step returns."""
        return self.labels[self.request.returned]

    @property
    def heading(self) -> str:
        """The first line of the comment."""
        return harmless(self.request.heading)

    @cached_property
    def plan(self) -> Plan:
        """The equations with numbers in the place of the parameters that have one."""
        return Plan.of(self.recursion.subs(self.values))

    @cached_property
    def lags(self) -> dict[Any, list[int]]:
        """The lags at which each signal is read."""
        found: dict[Any, set[int]] = {b: set() for b in (*self.recursion.states, *self.recursion.inputs)}
        for _, right in self.recursion.updates:
            for s in samples(right):
                found[s.base].add(lag(s))
        return {b: sorted(i) for b, i in found.items()}

    @property
    def depth(self) -> dict[Any, int]:
        """How many past samples of each signal a step needs; of an input they are older than the one it takes."""
        first = dict.fromkeys(self.recursion.states, 0) | dict(self.newest)
        return {b: i[-1] - first[b] for b, i in self.lags.items() if i and i[-1] > first[b]}

    @property
    def rested(self) -> list[Any]:
        """The sequences whose value at rest, before the first step, must be given."""
        read = {s.base for e in self.initial.values() for s in samples(e)}
        return [b for b in self.labels if b in read or (b in self.depth and b not in self.initial)]

    @property
    def counts(self) -> bool:
        """Whether an equation contains the time index itself."""
        return any(e.has(Plan.time) for e in self.plan.updates)

    def place(self, key: tuple[int, int]) -> tuple[Any, int]:
        """Return the signal of a sample of the plan, and its age: 0 is what is computed or taken now."""
        base = self.plan.signals[key[0]]
        return base, key[1] - self.newest.get(base, 0)

    def at_rest(self, base: Any, names: Mapping[Any, str]) -> tuple[Any, dict[Any, str]]:
        """Return the initial value of a state over plain symbols, and the text of each symbol."""
        plain = {b: sp.Dummy(b.name, real=True) for b in names}
        e = self.initial[base]
        return e.xreplace({s: plain[s.base] for s in samples(e)}), {plain[b]: shown for b, shown in names.items()}

    def comment(self, *sentences: str) -> list[str]:
        """Return what stands above the code: the equations in its identifiers, an empty line, units, some sentences.

        It also says which identifiers are not the names of their signals, without what could end a comment.
        """
        named = {b: signal(label) for b, label in self.labels.items()}
        equations, written = [], self.recursion.subs(self.values).updates
        plain_symbols = {p: sp.Symbol(label, real=True) for p, label in self.parameters.items()}
        for pair in written:
            known = [plain_symbols | {s: named[s.base][s.indices[0]] for s in samples(e)} for e in pair]
            left, right = (e.xreplace(of) for e, of in zip(pair, known, strict=True))
            equations.append(f"{text(left)} = {text(right)}")
        renamed = [
            f"{label} is the {'parameter' if one in self.parameters else 'signal'} {shown!r}"
            for one, label in (*self.labels.items(), *self.parameters.items())
            if (shown := plain(one)) != label
        ]
        rows = ((harmless(listed), unit) for listed, unit in self.request.coefficients(written))
        told = "; ".join(f"{one} (pure)" if unit == "1" else f"{one} in {plain(unit)}" for one, unit in rows)
        units = [f"Units of the coefficients: {told}."] if told else []
        first = [*wrapped([self.heading]), ""] if self.heading else []
        return [line[4:] for line in (*first, *wrapped(equations), "", *wrapped([*units, *sentences, *renamed]))]

    def when(self, base: Any) -> str:
        """Return the sample of an input that a step takes, such as `r[k+1]`."""
        return text(signal(self.labels[base])[k - self.newest[base]])


def newest(recursion: Recursion, sampled: bool = False) -> dict[Any, int]:
    """Return the lag of the newest sample of each input that is read, at most 0 where all are taken as `sampled`."""
    read = {s for _, right in recursion.updates for s in samples(right)}
    latest = {b: min(lag(s) for s in read if s.base == b) for b in recursion.inputs}
    return {b: min(0, i) if sampled else i for b, i in latest.items()}


def plain(one: Any) -> str:
    """Return the name of a signal or a parameter, or a unit, in ASCII, with dots for what could end a comment."""
    return harmless(str(getattr(one, "label", one)))[:60]


def harmless(said: str) -> str:
    """Return a text in ASCII, with dots for what could end a comment."""
    raised = re.sub(f"[{''.join(map(chr, RAISED))}]+", lambda found: f"^{found[0].translate(RAISED)}", said)
    return re.sub(r"[^A-Za-z0-9_ .,;:()=+/%^-]", ".", raised.translate(ASCII))


def shortened(name: str, longest: int) -> str:
    """Return letters, digits and single underscores of a name, beginning with a letter."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:longest].rstrip("_")
    return plain if plain[:1].isalpha() else f"x{plain}"


def numbered(plain: str, free: Callable[[str], bool]) -> str:
    """Return the first of name, name_sig, name_sig2, ... that is free."""
    if free(plain):
        return plain
    number = 1
    while not free(name := f"{plain}_sig{number if number > 1 else ''}"):
        number += 1
    return name


def wrapped(lines: Iterable[str]) -> list[str]:
    """Put lines one level further in, and break long ones where there is a space."""
    made = []
    for line in indented(lines):
        inner = line[: len(line) - len(line.lstrip())] + "    "
        made += textwrap.wrap(line, WIDTH, subsequent_indent=inner, break_long_words=False, break_on_hyphens=False)
    return made
