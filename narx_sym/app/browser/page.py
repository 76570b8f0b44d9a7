"""The page: a thin layer above the workbench. Each part is made anew when what it shows has changed."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ElementFilter, run, ui

from ...data.readers import READERS
from ...diagnosis.machine import NONE
from ...diagnosis.progress import Told
from ...models.effects import MACHINES
from ...report.figures.describe import stylesheet
from ...report.page import style
from ..choice import MISSING
from ..workbench import Workbench
from . import results
from .widgets import BEAT, Fault, Part, details, drop, figure, heading, listed, said, section, tab_panel, tabs

HERE = Path(__file__).parent
# The choice of data has done its work; who is in it stays there.
FOLD = "document.querySelector('.columns:not(:focus-within) > details')?.removeAttribute('open')"
# Who has asked for a result is led to it, also with a keyboard or a reader.
LEAD = ";document.getElementById('tab-diagnosis').click();"
LEAD += "document.getElementById('found')?.focus({preventScroll: innerWidth > 1000})"
BASES = {
    "linear": "Linear: a difference equation, its orders and delay are chosen",
    "static": "Static: a polynomial of the input",
    "narx": "NARX: the paper's hysteresis terms",
}
KINDS = {"": "as the units suggest", **MACHINES, NONE: "not known: every effect is considered"}


class Page:
    """One open page; several may look at the same workbench."""

    def __init__(self, bench: Workbench, place: str):
        self.bench, self.faults = bench, bench.faults
        # The style sheet of the report, for its parts alone.
        ui.add_css(f"{stylesheet()}\n.report {{ {style()} }}\n{(HERE / 'page.css').read_text(encoding='utf-8')}")
        # Here the page is found again when it is loaded anew; what it asks for lies below.
        script = (HERE / "page.js").read_text(encoding="utf-8")
        ui.add_body_html(f"<script>history.replaceState(null, '', '{place}');{script}</script>")
        ui.colors(primary="#0b5a94", negative="#a4262c")
        ui.on("refused", lambda event: self.refused(str(event.args)))
        with ui.element("div").classes("head"):
            heading("narx_sym", 1)
            said(
                "See where a model fails, add the missing effect, and compare the errors. Your data stay on this "
                "machine."
            )
        with ui.element("div").classes("main"):
            with ui.element("div").classes("dock"):  # in sight wherever the page is
                self.parts = [
                    Part(lambda: bench.faults.get("", ""), self.message),
                    Part(lambda: bench.busy, self.progress),
                ]
            with ui.element("div").classes("bench"):
                self.rail()
                self.work()
        ui.on("add", lambda event: bench.add(str(event.args)))
        ui.on("undo", bench.undo)
        ui.on("redo", bench.redo)
        ui.timer(BEAT, self.look)

    def rail(self) -> None:
        """Make the rail: data, base, what may be added, and what was done."""
        bench = self.bench
        with ui.element("div").classes("rail").props('role=region aria-label="Data, base and steps"'):
            self.parts += [Part(lambda: (bench.path,), self.data), Part(lambda: (bench.record,), self.samples)]
            self.parts += [
                Part(lambda: bench.path, self.columns),
                Part(lambda: (bench.base_name, bench.state.revisions[:1]), self.base),
                Part(lambda: (bench.current,), lambda: results.effects(bench)),
            ]
            self.history = ui.element("div")
            with self.history, section("Steps"):
                seen = Part(lambda: (bench.at, len(bench.states), bench.current), self.steps)
            self.parts.append(seen)

    def steps(self) -> None:
        """Show the history."""
        results.steps(self.bench)

    def work(self) -> None:
        """Make what is worked on: the report in its frame, and the tabs."""
        bench = self.bench
        with ui.element("div").classes("work"):
            self.parts += [
                Part(lambda: bench.notes, self.notes),
                Part(lambda: (bench.preview, bench.current is None, bench.early), self.preview),
            ]
            self.tabs = ui.element("div")
            with self.tabs:
                tabs(results.TABS)
                for i, name in enumerate(results.TABS):
                    with tab_panel(name, first=not i):
                        shown = Part(partial(self.shown, name), partial(results.tab, name, bench))
                    self.parts.append(shown)
        self.show()

    def shown(self, tab: str) -> Any:
        """Return what a tab depends on."""
        bench = self.bench
        return (bench.current, bench.state.law, bench.state.run) if tab == "export" else (bench.current,)

    def show(self) -> None:
        """Show what has something to show, and what may be pressed."""
        bench = self.bench
        for box in (self.history, self.tabs):
            box.set_visibility(bench.current is not None)
        self.start.set_enabled(bench.record is not None and not bench.busy)
        self.first.set_visibility(bench.record is None)
        kind = bench.base if isinstance(bench.base, str) else "file"
        if self.kinds.value != kind and kind in self.kinds.options:
            self.kinds.set_value(kind)

    def look(self) -> None:
        """Take over what the process has done, and show what has changed."""
        before = self.bench.current
        self.bench.poll()
        try:
            with self.bench.shown:
                for part in self.parts:
                    part.look()
        except Exception as error:
            self.bench.refuse(f"Internal error, {type(error).__name__}: {error}. Please report it.")
            raise
        if self.bench.faults != self.faults:
            self.faults = self.bench.faults
            for one in ElementFilter(kind=Fault):
                one.look()
        if self.bench.busy:
            self.tell()
        self.show()
        if self.bench.current is not None and self.bench.current is not before:
            ui.run_javascript(FOLD * (before is None) + LEAD)

    def refused(self, text: str) -> None:
        """Show what the page itself refused."""
        self.bench.refuse(text[:300])

    # -- parts -------------------------------------------------------------------------------------------------

    def message(self) -> None:
        """Show one message where something went wrong."""
        text = self.bench.faults.get("", "")
        with ui.element("div").props("role=alert").classes("wrong" if text else "idle"):
            if text:
                said(text)
                close = ui.button("Close", on_click=self.bench.understood).props("no-caps flat dense")
                close.props('aria-label="Close the message"')

    def notes(self) -> None:
        """Show what was changed or kept in silence."""
        if self.bench.notes:
            listed(self.bench.notes)

    def data(self) -> None:
        """Show the file, its columns and rows."""
        bench = self.bench
        with section("Data"):
            if bench.table is not None:
                names = [n for n in bench.table.columns if n]
                rows = max(a.size for a in bench.table.columns.values())
                text = f"{bench.file}: {rows} rows, columns {', '.join(names)}"
                said(text).classes("file").props["title"] = text
                return
            self.drop()
            with ui.element("p"):
                said("No data at hand? ", "span")
                ui.button("Take a simulated example", on_click=self.example).props("flat no-caps dense")

    def drop(self) -> None:
        """Show the field for a data file."""
        limit = self.bench.limit
        drop("data", "data-file", ",".join(READERS), limit, "Drop a data file here, or choose one", [
            f"CSV with a header such as t,u,y, or .npz, .mat, .parquet, .mf4, .tdms; at most {limit / 1e6:g} MB. It "
            "stays in a private folder of this machine until the program ends."
        ])  # fmt: skip

    def columns(self) -> None:
        """Show the choice of columns and rows, and the way to another file."""
        bench, choice = self.bench, self.bench.choice
        if bench.table is None:
            return
        names = [n for n in bench.table.columns if n]
        units = {"u": "Unit of the input", "y": "Unit of the output"}
        with ui.element("div").classes("folded"):
            with ui.element("div").classes("columns"), details("Columns, rows, units", open_=bench.current is None):
                with ui.element("div").classes("fields"):
                    self.fields: dict[str, Any] = {
                        "u": self.select("Input", names, choice.u),
                        "y": self.select("Output", names, choice.y),
                        **{
                            f"unit {n}": self.typed(title, choice.units[n], "maxlength=12 stack-label")
                            for n, title in units.items()
                        },
                        "t": self.select("Time [s]", {"": "none", **{n: n for n in names}}, choice.t),
                        "Ts": self.typed("Sampling time [s]", choice.Ts),
                        "rows": self.typed("Rows A:B, from 0", choice.rows),
                        "missing": self.select("Missing values", MISSING, choice.missing),
                        "machine": self.select("Kind of machine", KINDS, choice.machine),
                        "channels": self.select("Further channels", names, list(choice.channels), multiple=True),
                    }
                    self.in_header()
                    for name, field in self.fields.items():
                        Fault(field, bench, name)
                        # A text is read when it is left.
                        field.on("change" if isinstance(field, ui.input) else "update:model-value", self.choose)
            with details("Another file"):
                self.drop()

    def select(self, title: str, options: Any, value: Any, **more: Any) -> ui.select:
        """Make a field that chooses columns."""
        made = ui.select(options, label=title, value=value if value in options or more else None, **more)
        return made.props("outlined dense options-dense").classes("field")

    def typed(self, title: str, value: str, props: str = "") -> ui.input:
        """Make a field with a text."""
        return ui.input(title, value=value).props(f"outlined dense {props}").classes("field")

    async def choose(self) -> None:
        """Read the data with another choice; where a diagnosis would go, ask first."""
        choice, now = self.bench.choice, {name: field.value for name, field in self.fields.items()}
        now["units"] = {n: now.pop(f"unit {n}") for n in choice.units}
        changed = {name: value for name, value in now.items() if value != getattr(choice, name)}
        if self.bench.states and changed and not await self.sure():
            self.as_it_was()
        elif changed:
            await run.io_bound(self.bench.choose, **changed)
            self.in_header()

    def in_header(self) -> None:
        """Show the units that the file says where none is typed."""
        for n in self.bench.choice.units:
            field = self.fields[f"unit {n}"]
            known = self.bench.record.units.get(n, "") if self.bench.record else ""
            field.props["placeholder"] = known or "such as V or mm"
            field.update()

    def as_it_was(self) -> None:
        """Show the choice again."""
        choice = self.bench.choice
        for name, field in self.fields.items():
            of, _, signal = name.partition(" ")
            field.set_value(choice.units[signal] if of == "unit" else getattr(choice, name))

    async def sure(self) -> bool:
        """Ask whether the diagnosis may go."""
        count = len(self.bench.states)
        with ui.dialog().props('persistent transition-duration=0 aria-label="Change the data?"') as asked, ui.card():
            said(f"With other data, units or machine the diagnosis and its steps ({count}) are deleted.")
            with ui.element("div").classes("undo"):
                ui.button("Keep them", on_click=lambda: asked.submit(False)).props("no-caps outline autofocus")
                ui.button("Change the data", on_click=lambda: asked.submit(True)).props("no-caps outline")
        answer = bool(await asked)
        asked.delete()
        return answer

    async def example(self) -> None:
        """Take simulated measurements."""
        await run.io_bound(self.bench.example)

    def samples(self) -> None:
        """Say what was read."""
        record = self.bench.record
        if record is not None:
            length = record.t[-1] - record.t[0]
            said(f"Read: {len(record)} samples, {record.Ts:.6g} s apart, {length:.6g} s").classes("file")

    def preview(self) -> None:
        """Show what was read, until there is more to see."""
        bench = self.bench
        if bench.early:
            results.frame()
        elif bench.current is None and bench.record is not None:
            with section("What was read"):
                figure(bench.preview)
        elif bench.current is None:
            said(
                "Three steps: choose a file with the input and the output of a machine, press Diagnose, and add "
                "the effect that is found. The law then computes the input that makes the output follow a reference."
            ).classes("place")

    def base(self) -> None:
        """Show the base, and the button that begins."""
        bench, revisions = self.bench, self.bench.state.revisions
        with section("Base model"):
            options = {**BASES, **({"file": f"Model file {bench.base_name}"} if bench.base_name else {})}
            value = bench.base if isinstance(bench.base, str) else "file"
            title = f"{revisions[0].name.capitalize()}; choose another one" if revisions else "A simple model"
            with details(title, open_=bench.current is None):
                with ui.element("div").props('role=group aria-label="Kind of base"'):
                    self.kinds = ui.radio(options, value=value, on_change=lambda event: self.based(event.value))
                with details("A model file"):
                    drop("model", "model-file", ".json", bench.limit, "Drop a model file (.json), or choose one", [])
                text = "Diagnose" if bench.current is None else "Diagnose with this base"
                self.start = ui.button(text, on_click=bench.diagnose).props("no-caps unelevated")
                self.start.classes("main-button").set_enabled(bench.record is not None)
                self.first = said("Choose the measurements first.").classes("hint")

    def based(self, kind: str) -> None:
        """Choose a kind of base; that of a file is chosen already."""
        if kind in BASES:
            self.bench.choose_base(kind)

    def progress(self) -> None:
        """Show what is under way, and how to end it."""
        with ui.element("div").classes("doing" if self.bench.busy else "idle"):
            with ui.element("div").props("role=status"):
                self.doing = said("Starting" if self.bench.busy else "")
            if self.bench.busy:
                self.bar = ui.linear_progress(0.0, show_value=False).props('indeterminate aria-label="Working"')
                with ui.element("div").classes("done"):
                    self.count = said("")
                    self.enough = ui.button("Take the best so far", on_click=self.bench.enough)
                    self.enough.props("no-caps outline").set_visibility(False)
                    ui.button("Cancel", on_click=self.bench.cancel).props("no-caps outline")

    def tell(self) -> None:
        """Tell what is under way: a reader hears of stages and of what was found, not of each second."""
        now, seconds = self.bench.worker.progress, f"{self.bench.worker.seconds:.0f} s"
        if not isinstance(now, Told):
            self.doing.text, self.count.text = now[:1].upper() + now[1:], seconds
            return
        if self.bench.early:
            ui.run_javascript(f"tellFrame({json.dumps(now.removed)})")
        found = f" So far: {now.found}." if now.found else ""
        self.enough.set_visibility(bool(now.found) and now.stage < now.stages - 1)
        self.doing.text = f"Step {now.stage} of {now.stages}: {now.what}.{found}"
        self.count.text = f"{now.done} of {now.of}, {seconds}" if now.of else seconds
        self.bar.props(remove="indeterminate").set_value(max(self.bar.value, round(now.fraction, 3)))
