"""What C and Structured Text share: a past that is filled at rest, the equations, and the shift of the past."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from ..engines.plan import Plan
from ..engines.writer import Writer
from .layout import Layout

UNROLLED = 4  # samples: a longer past is filled and shifted in a loop


class StepWriter(Writer):
    """A language of steps: beside the words of expressions, those of a past."""

    first: ClassVar[int] = 0  # the index of the newest sample of a past

    def past(self, label: str, index: Any) -> str:
        """Write a past sample."""
        raise NotImplementedError

    def clock(self) -> str:
        """Write the time index as a number."""
        raise NotImplementedError

    def loop(self, start: int, stop: int, line: str) -> list[str]:
        """Write a loop of one line over `i`, from start to stop with both, up or down."""
        raise NotImplementedError

    def each(self, line: Callable[[Any], str], start: int, stop: int, length: int) -> list[str]:
        """Repeat a line for each index of a past of some length; in a loop where that is long."""
        if length > UNROLLED:
            return self.loop(start, stop, line("i"))
        way = 1 if start <= stop else -1
        return [line(i) for i in range(start, stop + way, way)]

    def start(
        self, layout: Layout, depth: Mapping[Any, int], rest: Mapping[Any, str], kept: Mapping[Any, str]
    ) -> list[str]:
        """Return the lines that fill the past with values at rest; a state that starts from others is computed.

        Parameters
        ----------
        depth : mapping from signals to the lengths of their pasts
        rest, kept : the text of each value at rest, and of each parameter beside the state
        """
        lines = []
        for base, d in depth.items():
            shown, label = rest.get(base) or self.number(0.0), layout.labels[base]
            if base in layout.initial:
                expr, named = layout.at_rest(base, rest)
                self.names = {**named, **kept}
                shown = self(expr)
            fill = lambda i, label=label, shown=shown: self.assign(self.past(label, i), shown)  # noqa: E731
            lines += self.each(fill, self.first, self.first + d - 1, d)
        begun, self.lines = [*self.lines, *lines], []
        return begun

    def step(
        self, layout: Layout, depth: Mapping[Any, int], kept: Mapping[Any, str], computed: Callable[[str, str], str]
    ) -> list[str]:
        """Return the lines of the equations, and of the shift of the past; `computed` writes the value of a state."""
        labels, plan = layout.labels, layout.plan
        self.names = {Plan.time: self.clock(), **kept}
        for key, symbol in plan.sample.items():
            base, age = layout.place(key)
            self.names[symbol] = self.past(labels[base], self.first + age - 1) if age else labels[base]
        states = [labels[b] for b in layout.recursion.states]
        self.updates(plan, lambda s, shown: self.lines.append(computed(states[s], shown)))
        lines = [*self.lines]
        for base, d in depth.items():
            label = labels[base]

            def shifted(i: Any, label: str = label) -> str:
                before = f"{i} - 1" if isinstance(i, str) else i - 1
                return self.assign(self.past(label, i), self.past(label, before))

            lines += self.each(shifted, self.first + d - 1, self.first + 1, d) if d > 1 else []
            lines.append(self.assign(self.past(label, self.first), label))
        return lines
