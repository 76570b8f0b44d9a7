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
from . import words
from .comparison import Units
from .figures import describe, zoomed
from .panels.registry import Material, Part, panels

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
        "spaced": words.spaced, "number": words.number, "percent": words.percent, "plus_minus": words.plus_minus,
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
    scripts: bool = True,
    keys: Sequence[str] | None = None,
) -> list[Section]:
    """Return the parts of the story as HTML, in their order; one without content is left out.

    Parameters
    ----------
    diagnosis : Diagnosis
    units : mapping such as {"u": "V", "y": "um"}
        By default those of the records.
    files : paths of the data
    settings : mapping of what else was chosen
    scripts : bool
        Whether the interactive pictures are among them; their script is `zoomed.bundle`.
    keys : keys of panels, optional
        The parts that are wanted.
    """
    units = {"u": "", "y": ""} | said_first(diagnosis.units, units)
    material = Material(words.with_units(diagnosis, units), units, files, settings or {}, scripts)
    made = []
    for key, part in panels().items():
        if keys is None or key in keys:
            section: Section | None = Section(key, part.title, NOT_MADE)  # no other part is lost with one that fails
            with fenced(f"The part {key} of the report"):
                section = _section(key, part, material)
            if section is not None:
                made.append(section)
    return made


def _section(key: str, part: Part, material: Material) -> Section | None:
    """Return one part as HTML; None where it has nothing to tell."""
    content = part.tell(material)
    if content is None:
        return None
    template = templates().select_template([f"panels/{key}.html", "pictures.html"])
    drawn = {
        p.key: p.draw[0] for p in material.pictures(key) if p.zoomable and material.scripts and not callable(p.draw)
    }
    script, live = zoomed.zoomed(drawn)
    given = {
        "pictures": material.pictures(key), "live": live, "script": script, "keys": describe.keys(*drawn.values()),
        "units": material.units, "d": material.diagnosis, **content,
    }  # fmt: skip
    return Section(key, content.get("title", part.title), template.render(given))


def page(
    diagnosis: Diagnosis,
    units: Units | None = None,
    files: Sequence[PathLike] = (),
    settings: Mapping[str, Any] | None = None,
) -> str:
    """Return the whole page; see `sections`."""
    parts = sections(diagnosis, units, files, settings)
    name = ", ".join(dict.fromkeys(r.name for r in diagnosis.steps[0].base.split.records))
    return str(
        templates().get_template("page.html").render(
            sections=parts, name=name, headline=words.headline(diagnosis), colours=describe.stylesheet(),
            style=style(), bokeh=zoomed.bundle(),
        )
    )  # fmt: skip


def write_report(
    diagnosis: Diagnosis,
    path: PathLike,
    units: Units | None = None,
    files: Sequence[PathLike] = (),
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write one self-contained HTML file; it appears whole or not at all.

    Parameters
    ----------
    path : str or Path
    units : mapping such as {"u": "V", "y": "um"}
    files : paths of the data, for their hashes
    settings : mapping of what else was chosen, for the record; a "scale" is that of `Model.continuous`
    """
    write_text(path, page(diagnosis, units, files, settings))


def style() -> str:
    """Return the style sheet of the page."""
    return (Path(__file__).parent / "templates" / "style.css").read_text(encoding="utf-8")
