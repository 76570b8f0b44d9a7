"""The parts of the page that show a model: what was found, what may be added or changed, law, downloads."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from ...models.effects import EFFECTS
from ...report.words import removed, spaced
from ...symbolic.numbers import sized
from ..downloads import offered
from ..workbench import Workbench
from . import law
from .widgets import Fault, heading, link, said, section

TABS = {"diagnosis": "Diagnosis", "law": "Law", "export": "Export"}


def tab(name: str, bench: Workbench) -> None:
    """Show what may be done with a model."""
    if bench.current is not None:
        {"diagnosis": sight, "law": law.LawTab, "export": files}[name](bench)


def sight(bench: Workbench) -> None:
    """Show the report, in a frame that the page's script fills; what its button adds comes back here."""
    # The frame says it too; who uses a reader is led here.
    heading(bench.current.headline if bench.current else "", 2, "found").classes("visually-hidden")
    frame()


def frame() -> None:
    """Make the place of a page of the report."""
    ui.html('<div data-live="live"></div>', sanitize=False)


def effects(bench: Workbench) -> None:
    """Show the choice of every effect; the first screen has a button for what it names."""
    current = bench.current
    if current is None:
        return
    shares = {row["effect"]: f"{spaced(row['effect'])}: {removed(row)[0]}" for row in current.found.table()}
    with section("Change the model"), ui.element("div").classes("other"):
        said("The number is the fraction of the removable error that the effect removes.").classes("hint")
        others = {n: spaced(n) for n in others_of(bench, set(shares))}
        chosen = ui.select(shares | others, label="Another effect").classes("field")
        chosen.props("outlined dense options-dense")
        Fault(chosen, bench, "effect")
        ui.button("Add it", on_click=lambda: bench.add(chosen.value or "")).props("no-caps outline")


def steps(bench: Workbench) -> None:
    """Show what was done with the validation error that is left; each state may be shown again."""
    said("Validation error after each step. Click, or Ctrl+Z and Ctrl+Y: back and forth.").classes("hint")
    with ui.element("ol").classes("steps"):
        for i, state in enumerate(bench.states):
            with ui.element("li").classes("undone" if i > bench.at else ""):
                now, last = i == bench.at, state.revisions[-1]
                first, error = (one.errors["validation_rms"] for one in (state.revisions[0], last))
                text = f"{spaced(last.name)}: {sized(error, bench.known['y'], beside=first)}"
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


def files(bench: Workbench) -> None:
    """Show the files to download."""
    with section("Download"):
        if bench.state.law is None:
            said("For the files of the compensation law, derive it under Law first.").classes("hint")
        with ui.element("ul").classes("files"):
            for name, (title, _) in offered(bench, bench._last.model).items():
                with ui.element("li"):
                    link(name, title)
