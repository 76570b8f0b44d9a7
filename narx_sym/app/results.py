"""The parts of the page that show a rung: what was found, where it fails, candidates, model, law, downloads."""

from __future__ import annotations

from html import escape
from itertools import groupby

from nicegui import ui

from ..effects import EFFECTS
from ..recursion import State
from ..signals import k
from .jobs import Rung
from .widgets import caption, data_cells, drawn, equation, head, plain_table, said, scrolled, section
from .workbench import Workbench

DOWNLOADS = {
    "report.html": "Report (HTML)", "model.json": "Model (JSON)", "model.tex": "Derivation (LaTeX)",
    "model.c": "Model (C99)",
}  # fmt: skip
LAW_FILES = {"law.tex": "Law (LaTeX)", "law.c": "Law (C99)"}


def found(bench: Workbench) -> None:
    """Show the verdict, the ladder, before and after, where it fails, and the candidates."""
    rung = bench.rung
    if rung is None:
        return
    with section("3. What was found", "found"):
        said(rung.found.sentence(bench.choice.units)).classes("verdict").mark("verdict")
        ladder(bench, rung)
        drawn(rung.shown["ladder"])
    with section("4. What may be missing"):
        candidates(bench, rung)
        drawn(rung.shown.get("candidates", []))
        drawn(rung.shown["experiment"], wide=True)
    with section("5. Measured and simulated"):
        drawn([d for d in rung.shown["compare"] if not d.key.startswith("loop")], wide=True)
        drawn([d for d in rung.shown["compare"] if d.key.startswith("loop")])
    with section("6. Where the model fails"):
        for place, pictures in groupby(rung.shown["where"], lambda d: d.place):
            said(place).classes("place")
            drawn(pictures)
    with section("7. The model"):
        model(bench, rung)


def ladder(bench: Workbench, rung: Rung) -> None:
    """Show the error after each step, as a table with a way back."""
    columns = ["step", "error on training samples", "error on held-out samples"]
    rows = [[r["name"], f"{r['train']:.4g}", f"{r['validation']:.4g}"] for r in bench.ladder]
    rows.append(["noise floor", "", f"{bench.floor:.4g}"])
    plain_table("Free-run error over the output's standard deviation", columns, rows, "ladder")
    if len(bench.rungs) > 1:
        back = ui.button(f"Step back from “{rung.name}”", on_click=bench.back).props("no-caps outline")
        back.mark("back")


def candidates(bench: Workbench, rung: Rung) -> None:
    """Show the candidates, each with its button, and any other effect."""
    rows = rung.found.table()
    if not rows:
        said("Nothing stands out: no effect of the catalogue would make this model clearly better.")
    else:
        said("Share of the removable error on samples never used for fitting. What is marked * cannot be told apart.")
        titles = ["effect", "where", "share", "95 % interval", "error after", "parameters", ""]
        with ui.element("table").classes("grid").mark("candidates"):
            caption("Candidates")
            head(titles)
            with ui.element("tbody"):
                for row in rows:
                    star = " *" if row["in_confusion_set"] else ""
                    cells = [
                        row["effect"].replace("_", " ") + star, row["where"], f"{100 * row['share']:.0f} %",
                        f"{100 * row['low']:.0f} to {100 * row['high']:.0f} %", f"{row['nrmse']:.3g}",
                        row["parameters"],
                    ]  # fmt: skip
                    with ui.element("tr"):
                        data_cells(titles, cells)
                        with ui.element("td"):
                            add = ui.button("Add", on_click=lambda name=row["effect"]: bench.add(name))
                            add.props(
                                f'no-caps unelevated dense padding="4px 14px" aria-label="Add {escape(row["effect"])}"'
                            )
                            add.mark(f"add-{row['effect']}")
        with ui.element("details"):
            ui.html("What these effects are", tag="summary", sanitize=False)
            for one in rung.found.candidates:
                said(one.sentence)
    others = others_of(bench, {r["effect"] for r in rows})
    with ui.element("div").classes("fields"):
        chosen = ui.select(others, label="Another effect").props("outlined dense options-dense")
        chosen.classes("field")
        ui.button("Add it", on_click=lambda: bench.add(chosen.value or "")).props("no-caps outline")


def others_of(bench: Workbench, shown: set[str]) -> list[str]:
    """Ids of the effects that are no candidates, with the channels there are."""
    channels = bench.record.channels if bench.record is not None else {}
    names = []
    for name, forms in sorted(EFFECTS.items()):
        driven = any("channel" in f.arguments for f in forms)
        names += [f"{name}:{c}" for c in channels] if driven else [name]
    return [n for n in names if n not in shown]


def model(bench: Workbench, rung: Rung) -> None:
    """Show the equations with numbers, the parameters, and the terms as text."""
    now = rung.model
    values = now.values
    for state in [*now.states, State(now.output[k], now.F)]:
        equation(state.left, state.right.xreplace(values))
    if now.operating_point:
        around = ", ".join(f"{b.label} - ({v:g})" for b, v in now.operating_point.items())
        said(f"Terms are in the signals measured from the operating point: {around}.")
    said(
        "Fitted on all samples. A term is changed by its text, in sums, products, powers and sign, abs, exp, Max, Min."
    )
    rows = {r["symbol"]: r for r in now.table()}
    titles = ["parameter", "value", "standard error", "term", ""]
    with ui.element("table").classes("grid").mark("terms"):
        caption("Parameters and terms")
        head(titles)
        with ui.element("tbody"):
            for name, row in rows.items():
                std = f"{row['std']:.2g}" if row["std"] else "fixed"
                with ui.element("tr"):
                    data_cells(titles, [name, f"{row['theta']:.6g}", std])
                    editable(bench, titles, name, row["term"])
            with ui.element("tr"):
                data_cells(titles, ["new", "", ""])
                editable(bench, titles, "", "")


def editable(bench: Workbench, titles: list[str], name: str, term: str) -> None:
    """Two cells: a term as text, and the buttons that fit the model with it."""
    own = bench.terms.get(name)
    with ui.element("td").props(f'data-title="{titles[3]}"'):
        if name and own is None:
            said(term or "shape of an effect", "span")
            return_cell = True
        else:
            return_cell = False
            what = f"Term of {name}" if name else "A further term, such as u[k-2]"
            field = ui.input(what, value=own or "").props("outlined dense maxlength=500").classes("term")
            field.mark(f"term-{name or 'new'}")
    with ui.element("td"):
        if not return_cell:
            ui.button("Fit", on_click=lambda: bench.edit(name, field.value)).props(
                f'no-caps outline dense padding="4px 12px" aria-label="Fit with this term of {name or "a new parameter"}"'
            ).mark(f"fit-{name or 'new'}")
            if name:
                ui.button("Take out", on_click=lambda: bench.edit(name, "")).props(
                    f'no-caps flat dense aria-label="Take out the term of {name}"'
                )


def take_away(bench: Workbench) -> None:
    """Show the compensator, and the files to download."""
    if bench.rung is None:
        return
    law = bench.law
    with section("8. Compensator"):
        said("The law that makes the output follow a reference. Limits go into its source.")
        with ui.element("div").classes("fields"):
            fields = [
                ui.input(title).props("outlined dense").classes("field")
                for title in ("Smallest input", "Largest input", "Largest change per sample")
            ]
            ui.button(
                "Open the compensator", on_click=lambda: bench.open_law(*(f.value for f in fields))
            ).props("no-caps outline").mark("law")  # fmt: skip
        if law is not None and law.why_not:
            said(f"There is no law: {law.why_not}").classes("verdict").mark("law-text")
        elif law is not None:
            for markup in law.mathml:
                scrolled(markup)
            with ui.element("ul").classes("notes").mark("law-text"):
                for note in law.notes:
                    with ui.element("li"):
                        said(note)
    with section("9. Take it away"):
        files = DOWNLOADS | (
            {n: t for n, t in LAW_FILES.items() if n != "law.c" or law.code} if law and not law.why_not else {}
        )
        with ui.element("ul").classes("files"):
            for name, title in files.items():
                with ui.element("li"):
                    ui.html(f'<a href="/download/{name}" download>{escape(title)}</a>', sanitize=False)
