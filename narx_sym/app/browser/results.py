"""The parts of the page that show a model: what was found, where it fails, candidates, model, law, downloads."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from ...models.effects import EFFECTS
from ...report.words import number, removed, spaced
from ..downloads import titles
from ..workbench import Workbench
from . import law
from .widgets import Fault, caption, data_cells, head, heading, link, said, section, small

TABS = {"diagnosis": "Diagnosis", "model": "Model", "law": "Law", "export": "Export"}


def tab(name: str, bench: Workbench) -> None:
    """Show what may be done with a model."""
    if bench.current is not None:
        {"diagnosis": sight, "model": model, "law": law.LawTab, "export": files}[name](bench)


def sight(bench: Workbench) -> None:
    """Show the report, in a frame that the page's script fills; what its button adds comes back here."""
    # The frame says it too; who uses a reader is led here.
    heading(bench.current.headline if bench.current else "", 2, "found").classes("visually-hidden")
    ui.html('<div data-live="live"></div>', sanitize=False)


def effects(bench: Workbench) -> None:
    """Show the choice of every effect; the first screen has a button for what it names."""
    current = bench.current
    if current is None:
        return
    shares = {row["effect"]: f"{spaced(row['effect'])}: {removed(row)[0]}" for row in current.found.table()}
    with section("Add another effect"), ui.element("div").classes("other"):
        said("The number is the fraction of the removable error that the effect removes.").classes("hint")
        others = {n: spaced(n) for n in others_of(bench, set(shares))}
        chosen = ui.select(shares | others, label="Effect").props("outlined dense options-dense").classes("field")
        Fault(chosen, bench, "effect")
        ui.button("Add it", on_click=lambda: bench.add(chosen.value or "")).props("no-caps outline")


def steps(bench: Workbench) -> None:
    """Show what was done with the validation error that is left; each state may be shown again."""
    said("Validation error after each step. Click, or Ctrl+Z and Ctrl+Y: back and forth.").classes("hint")
    with ui.element("ol").classes("steps"):
        for i, state in enumerate(bench.history.states):
            with ui.element("li").classes("undone" if i > bench.history.at else ""):
                now = i == bench.history.at
                text = f"{spaced(state.name)}: {number(state.error)} {bench.known['y']}"
                made = ui.button(text, on_click=partial(bench.go, i)).props("no-caps flat dense align=left")
                made.props('aria-current="step"' if now else "").classes("step")


def others_of(bench: Workbench, shown: set[str]) -> list[str]:
    """Ids of the effects that are no candidates, with the channels there are."""
    channels = bench.record.channels if bench.record is not None else {}
    names = []
    for name, forms in sorted(EFFECTS.items()):
        driven = any("channel" in f.arguments for f in forms)
        names += [f"{name}:{c}" for c in channels] if driven else [name]
    return [n for n in names if n not in shown]


def model(bench: Workbench) -> None:
    """Show the parameters, and the terms as text."""
    heading("Change a term", 3)
    said("Edit a term as text: sums, products, powers, and the functions sign, abs, sin, cos, tanh, exp, Max, Min.")
    rows = {r["symbol"]: r for r in bench.revisions[-1].model.table()}
    titles = ["parameter", "value", "standard error", "term", ""]
    with ui.element("table").classes("grid"):
        caption("Parameters and terms")
        head(titles)
        with ui.element("tbody"):
            for name, row in rows.items():
                std = f"{row['standard_error']:.2g}" if row["standard_error"] else "fixed"
                with ui.element("tr"):
                    data_cells(titles, [name, f"{row['theta']:.6g}", std])
                    editable(bench, titles, name, row["term"])
            with ui.element("tr"):
                data_cells(titles, ["new", "", ""])
                editable(bench, titles, "", "")


def editable(bench: Workbench, titles: list[str], name: str, term: str) -> None:
    """Two cells: a term as text, and the buttons that fit the model with it."""
    own = bench.terms.get(name)
    if name and own is None:
        data_cells(titles[3:], [term or "shape of an effect", ""])
        return
    with ui.element("td").props(f'data-title="{titles[3]}"'):
        what = f"Term of {name}" if name else "A further term, such as u[k-2]"
        field = ui.input(what, value=own or "").props("outlined dense maxlength=500").classes("term")
        Fault(field, bench, f"term {name}")
    whose = name or "a new parameter"
    with ui.element("td"):
        small("Fit", f"Fit with this term of {whose}", lambda: bench.edit(name, field.value or ""))
        if name:
            small("Remove", f"Remove the term of {name}", lambda: bench.edit(name, ""))


def files(bench: Workbench) -> None:
    """Show the files to download."""
    with section("Download"), ui.element("ul").classes("files"):
        for name, title in titles(bench.law, bench.run).items():
            with ui.element("li"):
                link(name, title)
