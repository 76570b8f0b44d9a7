"""Small things that the page is made of. Whatever comes from data or from a user is text, never markup."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

from nicegui import ui

from ..printing import mathml
from .story import Drawing


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


def drawn(pictures: Iterable[Drawing], wide: bool = False) -> None:
    """Show pictures side by side, or one below the other."""
    with ui.element("div").classes("wide" if wide else "pictures"):
        for one in pictures:
            markup = f"<figcaption>{escape(one.title)}</figcaption>{one.svg}"
            figure(markup)


def figure(markup: str) -> None:
    """Show a picture; one that is wider than the screen may be scrolled."""
    ui.html(markup, tag="figure", sanitize=False).props("tabindex=0")


def equation(left: Any, right: Any) -> None:
    """Show an equation as MathML; a long one may be scrolled."""
    import sympy as sp

    short = right.xreplace({f: sp.Float(f"{float(f):.6g}") for f in right.atoms(sp.Float)})
    scrolled(mathml(sp.Eq(left, short, evaluate=False)))


def scrolled(markup: str) -> None:
    """Show MathML that may be scrolled, by keys too."""
    ui.html(markup, sanitize=False).classes("equation").props('tabindex=0 role=group aria-label="Equation"')


def plain_table(title: str, columns: list[str], rows: list[list[str]], name: str) -> None:
    """Show a table of texts."""
    with ui.element("table").classes("grid").mark(name):
        caption(title)
        head(columns)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    data_cells(columns, row)


def caption(title: str) -> None:
    """Give a table its title."""
    ui.html(escape(title), tag="caption", sanitize=False)


def head(titles: list[str]) -> None:
    """Make the head of a table."""
    with ui.element("thead"), ui.element("tr"):
        for title in titles:
            ui.html(escape(title), tag="th", sanitize=False).props("scope=col") if title else ui.element("td")


def data_cells(titles: list[str], cells: list[str]) -> None:
    """Make the cells of a row, each with its title for narrow screens."""
    for title, cell in zip(titles, cells, strict=False):
        ui.html(escape(cell), tag="td", sanitize=False).props(f'data-title="{escape(title)}"')
