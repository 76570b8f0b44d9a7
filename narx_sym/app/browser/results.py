"""The parts of the page that show a model: what was found, where it fails, candidates, model, law, downloads."""

from __future__ import annotations

from functools import partial
from html import escape
from typing import Any

from nicegui import ui

from ...models.effects import EFFECTS
from ...report import words
from ...report.panels.registry import panels
from ...report.words import number, removed, spaced
from ..downloads import titles
from ..story import Shown
from ..workbench import Workbench
from . import law
from .widgets import Fault, caption, data_cells, figure, head, heading, link, part, said, section, small

TABS = {"evidence": "Evidence", "model": "Model", "law": "Law", "export": "Export"}
TAB_OF = {"model": "model", "derived": "law"}  # of the parts of the report; the others are evidence
NOTHING = "Nothing stands out: no effect of the catalogue would make this model clearly better."
IN_LOOP = "Nothing is named: in a closed loop, what seems to be missing may be the controller's."
NEXT = {
    "named": "Next: add it from the list, and watch the error fall.",
    "confused": "Next: run the experiment below and diagnose its data; or add the one that you know to be there.",
    "helps_but_incomplete": "Next: add the best one from the list, and see what is missing then.",
    "outside_library": "Next: look where the model fails. A term of your own may be put in under Model.",
}


def tab(name: str, bench: Workbench) -> None:
    """Show the parts of the report that belong to a tab, each with what may be done there."""
    current = bench.current
    if current is None:
        return
    for key_of_section, title, keys in on_the_page(name):
        with section(title, key_of_section):
            for key in keys:
                part(current.html.get(key, ""))
                AFTER.get(key, nothing)(bench, current)
    MORE.get(name, nothing)(bench, current)


def draw(bench: Workbench) -> None:
    """Draw the pictures that can be zoomed, when their places are there."""
    if bench.current is not None:
        ui.run_javascript(f"narxDraw(() => {{ {bench.current.script} }})")


def on_the_page(tab: str) -> list[tuple[str, str, list[str]]]:
    """Return the sections of a tab with parts of the report: name, heading, and the keys of the parts."""
    live = sorted((one.live, key, one.live_title) for key, one in panels().items() if one.live is not None)
    sections: list[tuple[str, str, list[str]]] = []
    for _, key, title in live:
        if TAB_OF.get(key, "evidence") == tab:
            if title or not sections:
                sections.append((key, title or key, []))
            sections[-1][2].append(key)
    return sections


def sight(bench: Workbench) -> None:
    """Show what stays in sight: what is missing, the last step in a picture, and the error of each step."""
    current = bench.current
    if current is None:
        return
    heading(current.headline, 2, "found")
    if current.fall:
        said(current.fall).classes("fall")
    with ui.element("div").classes("seen"):
        with ui.element("div"):
            figure(current.html["sight"])
            ui.html("", tag="p", sanitize=False).classes("previewed").props("role=status")
        rungs(bench)


def rungs(bench: Workbench) -> None:
    """Show the error of each step as a bar; the last one falls from the one before."""
    sizes = [(r["name"], r["validation_rms"]) for r in bench.ladder]
    most, unit = max(size for _, size in sizes), bench.unit
    rows, was = [], 100.0
    current = bench.current
    floor = [("noise floor", bench.floor)] if current is not None and words.has_floor(current.found) else []
    for name, size in [*sizes, *floor]:
        width = 100 * size / most
        look = "floor" if name == "noise floor" else "last" if name == sizes[-1][0] and len(sizes) > 1 else ""
        rows.append(
            f'<li><span class="rung">{escape(spaced(name))}</span> <b>{number(size)} {escape(unit)}</b>'
            f'<span class="bar {look}" style="--was: {was:.1f}%; width: {width:.1f}%"></span></li>'
        )
        was = width
    ui.html("".join(rows), tag="ol", sanitize=False).classes("rungs").props(
        'aria-label="Error of each step, validation data"'
    )


def nothing(bench: Workbench, current: Shown) -> None:
    """Nothing may be done here."""


def what_next(bench: Workbench, current: Shown) -> None:
    """Say what to do next."""
    found = current.found
    here = NEXT.get(found.verdict)
    said(here or f"Next: {words.what_next(found)}").classes("next-step")


def candidates(bench: Workbench) -> None:
    """Show the candidates, each with its button, and any other effect."""
    current = bench.current
    if current is None:
        return
    rows = current.found.table()
    with section("Add"):
        if not rows:
            looped = current.found.verdict == "closed_loop"
            said(IN_LOOP if looped else NOTHING).classes("hint")
        else:
            first = current.found.steps[0]
            tied = len(first.confusion_set) > 1 and first.pair is None
            more = (
                " What is marked * cannot be told apart." if tied else " Together two help most." if first.pair else ""
            )
            said(f"Share of the removable error.{more}").classes("hint")
            with ui.element("ul").classes("candidates"):
                for i, row in enumerate(rows):
                    candidate(bench, i, row, tied)
        with ui.element("div").classes("other"):
            others = others_of(bench, {r["effect"] for r in rows})
            chosen = ui.select(others, label="Another effect").props("outlined dense options-dense").classes("field")
            Fault(chosen, bench, "effect")
            ui.button("Add it", on_click=lambda: bench.add(chosen.value or "")).props("no-caps outline")


def candidate(bench: Workbench, i: int, row: Any, tied: bool) -> None:
    """Show one candidate; the page previews its run while it is pointed at or has the focus."""
    share, interval = removed(row)
    name = spaced(row["effect"])
    with ui.element("li").props(f'data-candidate={i} data-name="{escape(name)}"'):
        ui.html(
            f'<span class="name">{escape(name)}{" *" if tied and row["in_confusion_set"] else ""}</span> <b>{share}</b>'
            f'<span class="bar" style="width: {max(0.0, 100 * row["share"]):.1f}%"></span>'
            f'<span class="hint">95 %: {interval}</span>', tag="div", sanitize=False,
        )  # fmt: skip
        small("Add", f"Add {row['effect']}", partial(bench.add, row["effect"]))


def steps(bench: Workbench) -> None:
    """Show what was done; each state may be shown again."""
    with ui.element("ol").classes("steps"):
        for i, state in enumerate(bench.history.states):
            with ui.element("li").classes("undone" if i > bench.history.at else ""):
                now = i == bench.history.at
                text = f"{spaced(state.name)}: {number(state.error)} {bench.unit}"
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


def sliders(bench: Workbench, current: Shown) -> None:
    """Make the place of the sliders; the page's script fetches them when it comes into sight."""
    if current.live:
        with section("Try it"):
            ui.html('<div data-live="live"></div>', sanitize=False)


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
            small("Take out", f"Take out the term of {name}", lambda: bench.edit(name, ""))


def files(bench: Workbench, current: Shown) -> None:
    """Show the files to download."""
    with section("Take it away"), ui.element("ul").classes("files"):
        for name, title in titles(bench.law, bench.run).items():
            with ui.element("li"):
                link(name, title)


# What may be done at a part of the report, and what stands at the end of a tab.
AFTER = {"verdict": what_next, "model": model}
MORE = {"model": sliders, "law": law.law, "export": files}
