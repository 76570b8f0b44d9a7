"""The Law tab: what a law shall follow, within which limits, the law, and its run."""

from __future__ import annotations

from nicegui import ui

from ...data.readers import READERS
from ..workbench import Workbench
from .widgets import BEAT, Fault, Part, drop, equation, figure, listed, said, section

KINDS = {"measured": "Measured output", "sine": "Sine", "file": "A file"}
FIELDS = {
    "measured": {"first": "First seconds (empty: all) [s]"},
    "sine": {
        "offset": "Offset [{y}]", "amplitude": "Amplitude [{y}]", "frequency": "Frequency [Hz]",
        "seconds": "Duration [s]",
    },
    "file": {"column": "Column of the reference (empty: r, or the only one)"},
}  # fmt: skip
LIMITS = {"low": "Smallest input [{u}]", "high": "Largest input [{u}]", "rate": "Largest change per sample [{u}]"}


class LawTab:
    """What is typed here is kept in the workbench, whatever is made anew."""

    def __init__(self, bench: Workbench):
        self.bench, self.current = bench, bench.current
        with section("Compensation law"):
            said(
                "The law computes the input that makes the output follow a reference. It is run on the model, and "
                "compared with the best constant gain. The limits, at first the range of the data, hold here and in "
                "the source code of the law; without them the input is not limited."
            )
            self.fill(LIMITS)
            with ui.element("div").props('role=group aria-label="Reference"'):
                said("Reference that the output shall follow:")
                kinds = ui.radio(KINDS, value=bench.wanted.kind, on_change=lambda event: self.choose(event.value))
                kinds.props("inline")
            self.fields = Part(lambda: (bench.wanted.kind, bench.wanted.file), self.chosen)
            run = ui.button("Derive and run the law", on_click=lambda: bench.run_law())
            run.props("no-caps unelevated").classes("main-button")
            made = Part(lambda: (bench.state.law, bench.state.run), self.ran)
        # Each by itself: who has pressed a button stays where he is.
        self.parts = (self.fields, made)
        ui.timer(BEAT, self.look)

    def look(self) -> None:
        """Show what has changed of this model; with another one the tab is made anew."""
        with self.bench.shown:
            for one in self.parts if self.bench.current is self.current else ():
                one.look()

    def fill(self, titles: dict[str, str]) -> None:
        """Make fields; what is typed is kept."""
        with ui.element("div").classes("fields"):
            for name, title in titles.items():
                made = ui.input(title.format(**self.bench.known), value=getattr(self.bench.wanted, name))
                made.props("outlined dense maxlength=80").classes("field")
                made.on_value_change(lambda event, name=name: setattr(self.bench.wanted, name, event.value or ""))
                Fault(made, self.bench, name)

    def choose(self, kind: str) -> None:
        """Choose a kind of reference."""
        self.bench.wanted.kind = kind
        self.fields.look()

    def chosen(self) -> None:
        """Show the fields of the kind of reference."""
        bench, kind = self.bench, self.bench.wanted.kind
        if kind == "file":
            file = bench.wanted.file
            taken = f"Taken: {file}." if file else "A header such as t,r and numbers below it."
            title = "Drop a file with the reference, or choose one"
            drop("reference", "reference-file", ",".join(READERS), bench.limit, title, [taken])
        self.fill(FIELDS[kind])

    def ran(self) -> None:
        """Show the law, its run, and what to know of both."""
        law, run = self.bench.state.law, self.bench.state.run
        if law is not None and law.why_not:
            said(f"There is no law: {law.why_not}").classes("verdict")
        elif law is not None:
            equation(law.latex, "Compensation law")
            listed(law.notes)
        if run is not None:
            said(run.sentence).classes("ran")
            figure(run.figure)
            listed(run.notes)
            said("The files of the law and of this run are under Export.").classes("hint")
