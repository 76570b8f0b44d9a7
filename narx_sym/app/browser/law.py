"""The Law tab: the limits of the actuator, the law, and a run of it over a reference."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from ..choice import SUFFIXES
from ..workbench import Workbench
from .drawn import drawing
from .widgets import BEAT, Fault, Part, details, drop, equation, figure, link, listed, said, section

LIMITS = {"low": "Smallest input", "high": "Largest input", "rate": "Largest change per sample"}
KINDS = {"measured": "Measured output", "sine": "Sine", "staircase": "Staircase", "drawn": "Drawn", "file": "A file"}
FIELDS = {
    "measured": {"first": "First seconds (empty: all) [s]"},
    "sine": {"offset": "Offset", "amplitude": "Amplitude", "frequency": "Frequency [Hz]", "seconds": "Duration [s]"},
    "staircase": {"offset": "Offset", "amplitude": "Amplitude", "steps": "Steps up", "hold": "Time of a step [s]"},
    "drawn": {"seconds": "Duration [s]"},
    "file": {"column": "Column of the reference (empty: r, or the only one)"},
}
OF_OUTPUT = ("offset", "amplitude")


class LawTab:
    """What is typed here is kept in the workbench, whatever is made anew."""

    def __init__(self, bench: Workbench):
        self.bench, self.current = bench, bench.current
        with section("Compensator"):
            said(
                "The law computes the input that makes the output follow a reference. The limits apply to its run "
                "and to its source code."
            )
            with ui.element("div").classes("fields"):
                for name, title in LIMITS.items():
                    self.field(name, title)
                ui.button("Open the compensator", on_click=self.open).props("no-caps outline")
            laws = Part(lambda: bench.law, self.law)
        with section("Run it over a reference"):
            said("The output of the model with the law, and without it (with the best constant gain instead).")
            with ui.element("div").props('role=group aria-label="Reference"'):
                kinds = ui.radio(KINDS, value=bench.wanted.kind, on_change=lambda event: self.choose(event.value))
                kinds.props("inline")
            self.fields = Part(lambda: (bench.wanted.kind, bench.wanted.file, bench.law), self.chosen)
            ui.button("Run the law", on_click=self.run).props("no-caps outline")
            runs = Part(lambda: bench.run, self.ran)
        # Each by itself: who has pressed a button, or draws, stays where he is.
        self.parts = (laws, self.fields, runs)
        ui.timer(BEAT, self.look)

    def look(self) -> None:
        """Show what has changed of this model; with another one the tab is made anew."""
        with self.bench.shown:
            for one in self.parts if self.bench.current is self.current else ():
                one.look()

    def field(self, name: str, title: str, make: Any = ui.input, props: str = "maxlength=80") -> None:
        """Make a field; what is typed is kept."""
        made = make(title, value=getattr(self.bench.wanted, name)).props(f"outlined dense {props}")
        made.classes(f"field field-{name}").on_value_change(
            lambda event: setattr(self.bench.wanted, name, event.value or "")
        )
        Fault(made, self.bench, name)

    def choose(self, kind: str) -> None:
        """Choose a kind of reference."""
        self.bench.wanted.kind = kind
        self.fields.look()

    def chosen(self) -> None:
        """Show the fields of the kind of reference."""
        bench, kind = self.bench, self.bench.wanted.kind
        with ui.element("div").classes(f"of-{kind}"):
            if kind == "file":
                file = bench.wanted.file
                taken = f"Taken: {file}." if file else "A header such as t,r and numbers below it."
                title = "Drop a CSV with the reference, or choose one"
                drop("reference", "reference-file", ",".join(SUFFIXES), bench.limit, title, [taken])
            with ui.element("div").classes("fields"):
                for name, title in FIELDS[kind].items():
                    self.field(name, f"{title} [{bench.unit.strip('()')}]" if name in OF_OUTPUT else title)
            if kind == "drawn":
                drawing(bench)
                with details("The points as text"):
                    self.field("points", f"Time [s] and level [{bench.unit.strip('()')}] in each line", ui.textarea, "")

    def open(self) -> None:
        """Derive the law."""
        self.bench.open_law()

    def run(self) -> None:
        """Run it."""
        self.bench.run_law()

    def law(self) -> None:
        """Show the law, and what to know before it runs."""
        found = self.bench.law
        if found is not None and found.why_not:
            said(f"There is no law: {found.why_not}").classes("verdict")
        elif found is not None:
            equation(found.latex, "Compensation law")
            listed(found.notes)

    def ran(self) -> None:
        """Show a run, and what to know of it."""
        run = self.bench.run
        if run is not None:
            said(run.sentence).classes("ran")
            figure(run.figure)
            listed(run.notes)
            link("law_run.csv", "Run of the law (CSV)")
