"""The parts of the page that show a model: what was found, where it fails, candidates, model, law, downloads."""

from __future__ import annotations

from functools import partial
from html import escape

from nicegui import ui

from ...models.effects import EFFECTS
from ...report.panels.registry import panels
from ...report.words import removed, spaced
from ..downloads import titles
from ..story import Shown
from ..workbench import Workbench
from .widgets import caption, data_cells, equation, head, heading, part, said, section, small

FIRST = 3  # the number of the first section here
NEXT = {
    "nothing_detectable": "Next: take the model away. Smaller effects show with less noise, a longer record or a wider "
    "input.",
    "named": "Next: add it below, and watch the error fall.",
    "confused": "Next: run the experiment below and diagnose its data; or add the one that you know to be there.",
    "helps_but_incomplete": "Next: add the best one below, and see what is missing then.",
    "closed_loop": "Next: record again with the controller in manual, and diagnose that.",
    "outside_library": "Next: look where the model fails. A term of your own may be put in below.",
}


def found(bench: Workbench) -> None:
    """Show every part of the report that is live, each with what may be done there."""
    current = bench.current
    if current is None:
        return
    for number, (name, title, keys) in enumerate(on_the_page(), FIRST):
        with section(f"{number}. {title}", name):
            for key in keys:
                BEFORE.get(key, nothing)(bench, current)
                part(current.html.get(key, ""))
                AFTER.get(key, nothing)(bench, current)
    ui.run_javascript(f"narxDraw(() => {{ {current.script} }})")


def on_the_page() -> list[tuple[str, str, list[str]]]:
    """Return the sections with parts of the report: name, heading, and the keys of the parts."""
    live = sorted((one.live, key, one.live_title) for key, one in panels().items() if one.live is not None)
    sections: list[tuple[str, str, list[str]]] = []
    for _, key, title in live:
        if title or not sections:
            sections.append((key if sections else "found", title or key, []))
        sections[-1][2].append(key)
    return sections


def nothing(bench: Workbench, current: Shown) -> None:
    """Nothing may be done here."""


def what_next(bench: Workbench, current: Shown) -> None:
    """Say what to do next."""
    said(NEXT[current.found.verdict]).classes("next-step")


def step_back(bench: Workbench, current: Shown) -> None:
    """Offer the way back to the model before."""
    if len(bench.revisions) > 1:
        ui.button(f"Step back from “{current.name}”", on_click=bench.back).props("no-caps outline")


def candidates(bench: Workbench, current: Shown) -> None:
    """Show the candidates, each with its button, and any other effect."""
    rows = current.found.table()
    if not rows:
        said("Nothing stands out: no effect of the catalogue would make this model clearly better.")
    else:
        said("Share of the removable error on samples never used for fitting. What is marked * cannot be told apart.")
        titles = ["effect", "where", "share", "95 % interval", "error after", "parameters", ""]
        with ui.element("table").classes("grid"):
            caption("Candidates")
            head(titles)
            with ui.element("tbody"):
                for row in rows:
                    star = " *" if row["in_confusion_set"] else ""
                    cells = [
                        spaced(row["effect"]) + star, row["where"], *removed(row), f"{row['nrmse']:.3g}",
                        row["parameters"],
                    ]  # fmt: skip
                    with ui.element("tr"):
                        data_cells(titles, cells)
                        with ui.element("td"):
                            small("Add", f"Add {row['effect']}", partial(bench.add, row["effect"]))
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


def model(bench: Workbench, current: Shown) -> None:
    """Show the parameters, and the terms as text."""
    now = current.model
    heading("Change a term", 3)
    said(
        "The same model fitted on all samples: the one to take away. A term is changed by its text: sums, products, "
        "powers, and the functions "
        "sign, abs, sin, cos, tanh, exp, Max, Min."
    )
    rows = {r["symbol"]: r for r in now.table()}
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
    whose = name or "a new parameter"
    with ui.element("td"):
        small("Fit", f"Fit with this term of {whose}", lambda: bench.edit(name, field.value or ""))
        if name:
            small("Take out", f"Take out the term of {name}", lambda: bench.edit(name, ""))


def take_away(bench: Workbench) -> None:
    """Show the compensator, and the files to download."""
    if bench.current is None:
        return
    law = bench.law
    number = FIRST + len(on_the_page())
    with section(f"{number}. Compensator"):
        said("The law that makes the output follow a reference. Limits go into its source.")
        with ui.element("div").classes("fields"):
            fields = [
                ui.input(title).props("outlined dense").classes("field")
                for title in ("Smallest input", "Largest input", "Largest change per sample")
            ]
            ui.button(
                "Open the compensator", on_click=lambda: bench.open_law(*(f.value for f in fields))
            ).props("no-caps outline")  # fmt: skip
        if law is not None and law.why_not:
            said(f"There is no law: {law.why_not}").classes("verdict")
        elif law is not None:
            equation(law.latex, "Compensation law")
            with ui.element("ul").classes("notes"):
                for note in law.notes:
                    with ui.element("li"):
                        said(note)
    with section(f"{number + 1}. Take it away"):
        with ui.element("ul").classes("files"):
            for name, title in titles(law).items():
                with ui.element("li"):
                    ui.html(f'<a href="/download/{name}" download>{escape(title)}</a>', sanitize=False)


# What may be done at a part of the report, before and after it.
BEFORE = {"candidates": candidates}
AFTER = {"verdict": what_next, "ladder": step_back, "model": model}
