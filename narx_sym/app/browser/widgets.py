"""Small things that the page is made of. Whatever comes from data or from a user is text, never markup."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from html import escape
from typing import Any

from nicegui import ui

from ...symbolic.mathml import from_latex

BEAT = 0.2  # seconds between looks at the workbench


class Part:
    """A part of the page that is made anew when its key has changed."""

    def __init__(self, key: Callable[[], Any], build: Callable[[], None]):
        self.key, self.build = key, build
        self.box = ui.element("div").classes("part")
        self.seen: Any = key()
        self.fill()

    def fill(self) -> None:
        """Make it anew."""
        self.box.clear()
        with self.box:
            self.build()

    def look(self) -> bool:
        """Make it anew where the key has changed."""
        now = self.key()
        changed = bool(now != self.seen)
        if changed:
            self.seen = now
            self.fill()
        return changed


@contextmanager
def section(title: str, name: str = "") -> Iterator[None]:
    """Make a part of the story with its heading."""
    with ui.element("section").classes("section"):
        heading(title, 2, name)
        yield


def heading(text: str, level: int, name: str = "") -> ui.html:
    """Make a heading; one with a name can be led to."""
    made = ui.html(escape(text), tag=f"h{level}", sanitize=False)
    return made.props(f"id={name} tabindex=-1") if name else made


def said(text: str, tag: str = "p") -> Any:
    """Make a text; whatever it holds is text."""
    return ui.label(text).props(f"tag={tag}") if tag == "p" else ui.html(escape(text), tag=tag, sanitize=False)


def drop(target: str, name: str, accept: str, limit: int, title: str, more: list[str]) -> None:
    """Make a field for a file: a label over a file input, so that a click, a key or a dropped file will do."""
    hints = "".join(f'<span class="hint">{escape(text)}</span>' for text in more)
    ui.html(
        f'<label class="drop" for="{name}"><span class="what">{escape(title)}</span>{hints}'
        f'<input type="file" id="{name}" accept="{accept}" data-to="{target}" data-limit="{limit}"></label>',
        sanitize=False,
    )


def part(html: str) -> None:
    """Show a part of the report; its templates escape whatever comes from data."""
    if html:
        # The inner class is what the report's style sheet asks of a page with scripts.
        ui.html(f'<div class="js">{html}</div>', sanitize=False).classes("report")


def equation(latex: str, means: str) -> None:
    """Show an equation; one that is wider than the screen may be scrolled."""
    part(f'<div class="equation" tabindex="0" role="group" aria-label="{escape(means)}">{from_latex(latex)}</div>')


def figure(markup: str) -> None:
    """Show a picture; one that is wider than the screen may be scrolled."""
    ui.html(markup, tag="figure", sanitize=False).classes("preview").props("tabindex=0")


def listed(notes: Iterable[str]) -> None:
    """Show notes as a list."""
    with ui.element("ul").classes("notes"):
        for note in notes:
            with ui.element("li"):
                said(note)


def link(name: str, title: str) -> None:
    """Make a link to a file."""
    ui.html(f'<a href="download/{name}" download>{escape(title)}</a>', sanitize=False)


class Fault(ui.label):
    """What is wrong with a field, below it, for a reader its description; `look` shows what has changed."""

    def __init__(self, field: Any, bench: Any, name: str):
        self.field, self.bench, self.name = field.without_auto_validation().props("hide-bottom-space"), bench, name
        with field.add_slot("error"):
            super().__init__()
        self.props(f"id=wrong-{field.id} role=alert")
        self.shown = ""
        self.look()

    def look(self) -> None:
        """Show what is wrong now; a field that is folded away is opened."""
        text = self.bench.faults.get(self.name, "")
        if text == self.shown:
            return
        self.shown = text
        self.set_text(text)
        if text:
            self.field.props(f"error aria-invalid=true aria-describedby=wrong-{self.field.id}")
            ui.run_javascript(f"getHtmlElement({self.field.id})?.closest('details')?.setAttribute('open', '')")
        else:
            self.field.props(remove="error aria-invalid aria-describedby")


@contextmanager
def details(title: str, open_: bool = False) -> Iterator[None]:
    """Make what may be folded."""
    with ui.element("details").props("open" if open_ else ""):
        ui.html(escape(title), tag="summary", sanitize=False)
        yield


def tabs(titles: Mapping[str, str]) -> None:
    """Make the heads of tabs, of which the first is chosen; the page's script chooses another one."""
    heads = "".join(
        f'<button type="button" role="tab" id="tab-{name}" aria-controls="panel-{name}" '
        f'aria-selected="{str(not i).lower()}" tabindex="{-bool(i)}">{escape(title)}</button>'
        for i, (name, title) in enumerate(titles.items())
    )
    ui.html(heads, sanitize=False).classes("tabs").props('role=tablist aria-label="Parts"')


def tab_panel(name: str, first: bool) -> ui.element:
    """Make the place of a tab's parts."""
    made = ui.element("div").props(f"role=tabpanel id=panel-{name} aria-labelledby=tab-{name}")
    return made if first else made.props("hidden")
