"""The report: one HTML file that tells what was found, from measurement to error falling. It needs no network.

Every part is a file of `panels`; `sections` returns them as HTML, `write_report` writes the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..data.units import said_first
from ..diagnosis.procedure import Diagnosis
from ..files.atomic import PathLike, write_text
from ..files.telling import fenced
from ..symbolic.mathml import from_latex
from . import hero, words
from .comparison import Units
from .figures import describe
from .panels.registry import Material, Part, panels

SEARCHING = "Searching for what is missing ..."
NOT_MADE = "<p>This part could not be made: please report it. What was found does not depend on it.</p>"


@dataclass(frozen=True)
class Section:
    """One part of the page: key and heading, and its HTML."""

    key: str
    title: str
    html: str


@cache
def templates() -> Any:
    """Return the environment of the templates: autoescaped, a missing name is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    made = Environment(
        loader=PackageLoader("narx_sym.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {
        **{one.__name__: one for one in (words.spaced, words.begun, words.number, words.percent, words.plus_minus)},
        "math": lambda text: Markup(from_latex(text, words.DIGITS)), "download": download,
    }  # fmt: skip
    return made


def download(text: str, kind: str = "text/csv") -> str:
    """Return a link that holds a file."""
    return f"data:{kind};charset=utf-8,{quote(text, safe=',;()*~!/-_. ').replace(' ', '%20')}"


def sections(
    diagnosis: Diagnosis,
    units: Units | None = None,
    files: Sequence[PathLike] = (),
    settings: Mapping[str, Any] | None = None,
    keys: Sequence[str] | None = None,
) -> list[Section]:
    """Return the parts of the story as HTML, in their order and without scripts; one without content is left out.

    Parameters
    ----------
    diagnosis : Diagnosis
    units : mapping such as {"u": "V", "y": "um"}
        By default those of the records.
    files : paths of the data
    settings : mapping of what else was chosen
    keys : keys of panels, optional
        The parts that are wanted.
    """
    return _sections(material(diagnosis, units, files, settings), keys)


def material(
    diagnosis: Diagnosis,
    units: Units | None = None,
    files: Sequence[PathLike] = (),
    settings: Mapping[str, Any] | None = None,
    later: Diagnosis | None = None,
    searching: bool = False,
) -> Material:
    """Return what the parts are made of; see `sections`, and `Material` for `later` and `searching`."""
    units = {"u": "", "y": ""} | said_first(diagnosis.units, units)
    now = later and words.with_units(later, units)
    return Material(words.with_units(diagnosis, units), units, files, settings or {}, now, searching)


def _sections(of: Material, keys: Sequence[str] | None = None) -> list[Section]:
    made = []
    for key, part in panels().items():
        if keys is None or key in keys:
            section: Section | None = Section(key, part.title, NOT_MADE)  # no other part is lost with one that fails
            with fenced(f"The part {key} of the report"):
                section = _section(key, part, of)
            if section is not None:
                made.append(section)
    return made


def _section(key: str, part: Part, of: Material) -> Section | None:
    """Return one part as HTML; None where it has nothing to tell."""
    content = part.tell(of)
    if content is None:
        return None
    template = templates().select_template([f"panels/{key}.html", "pictures.html"])
    given = {"pictures": of.pictures(key), "units": of.units, "d": of.lacking, **content}
    return Section(key, content.get("title", part.title), template.render(given))


def page(of: Material, framed: bool = False, keys: Sequence[str] | None = None) -> str:
    """Return the whole page, or some parts of it; in a frame without its name. `hero` shows the JSON that it holds."""
    parts = _sections(of, hero.FRAMED if of.searching else keys)
    names = dict.fromkeys(r.name for r in of.diagnosis.steps[0].base.split.records)
    headline = SEARCHING if of.searching else words.headline_with(of.diagnosis, of.lacking)
    script = data = ""
    with fenced("The script of the report"):
        script, data = hero.script(of), hero.data(of)
    template = templates().get_template("page.html")
    return str(template.render(
        sections=parts, name=", ".join(names), headline=headline, colours=describe.stylesheet(), style=style(),
        framed=framed, script=script, data=data,
    ))  # fmt: skip


def write_report(
    diagnosis: Diagnosis,
    path: PathLike,
    units: Units | None = None,
    files: Sequence[PathLike] = (),
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write the report as one HTML file that needs no network.

    Parameters
    ----------
    path : str or Path
    units : mapping such as {"u": "V", "y": "um"}
    files : paths of the data, for their hashes
    settings : mapping of what else was chosen, for the record; a "scale" is that of `Model.continuous`
    """
    write_text(path, page(material(diagnosis, units, files, settings)))


def style() -> str:
    """Return the style sheet of the page."""
    return (Path(__file__).parent / "templates" / "style.css").read_text(encoding="utf-8")
