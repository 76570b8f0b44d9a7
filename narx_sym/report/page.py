"""The report: one HTML file that tells what was found, from measurement to error falling. It needs no network.

Every part of `pictures.PANELS` is a template of its own; `sections` returns them as HTML, `report` writes the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..diagnosis.bases import words
from ..diagnosis.procedure import Diagnosis
from ..errors import ModelError, NotInvertible
from ..files.atomic import PathLike, csv_text, write_text
from ..files.store import to_text
from ..fit.excursions import operating_range
from ..inversion.analyses import derived
from ..inversion.compensator import compensator
from ..models.extend import Variant
from ..models.model import Model
from ..symbolic.mathml import from_latex, marked
from ..symbolic.signals import v, x
from . import interactive, pictures, story
from .comparison import Comparison, Units
from .pictures import PANELS, Picture
from .svg import stylesheet

DIGITS = 4


@dataclass(frozen=True)
class Section:
    """One part of the page: key and heading from `PANELS`, and its HTML."""

    key: str
    title: str
    html: str


@cache
def _templates() -> Any:
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
        "plain": story.plain, "number": story.number, "percent": story.percent, "plus_minus": story.plus_minus,
        "math": lambda text: Markup(from_latex(text, DIGITS)), "download": download,
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
    files : paths of the data
    settings : mapping of what else was chosen
    scripts : bool
        Whether the interactive pictures are among them; their script is `interactive.bundle`.
    keys : names among `PANELS`, optional
        The parts that are wanted.
    """
    units = {"u": "", "y": "", **(units or {})}
    found = story.with_units(diagnosis, units)
    drawn = pictures.pictures(found, units)
    compared = Comparison.of(found)
    script, elements = interactive.comparison(compared, units) if scripts else ("", {})
    segments = len(found.steps[0].base.split.records)
    known = {
        "verdict": lambda: _verdict(found, units),
        "compare": lambda: _compare(compared, drawn["compare"], script, elements, segments),
        "ladder": lambda: {"rungs": _rungs(found), "kind": found.steps[0].floor_kind},
        "where": lambda: {"failures": pictures.failures(found, units)},
        "candidates": lambda: {"rows": _candidates(found, units), "step": found.steps[0],
                               "small": story.detectable(found.steps[0], units),
                               "later": [(i, s) for i, s in enumerate(found.steps[1:], 2)]},
        "model": lambda: _model(found, units),
        "derived": lambda: _derived(found.model),
        "experiment": lambda: _experiment(found, drawn["experiment"], units, scripts),
        "provenance": lambda: _provenance(found, files, settings or {}, drawn, script),
    }  # fmt: skip
    made = []
    for key, title in PANELS:
        if (key == "experiment" and found.experiment is None) or (keys is not None and key not in keys):
            continue
        html = (
            _templates().get_template(f"{key}.html").render(**known[key](), pictures=drawn[key], units=units, d=found)
        )
        title = "The model" if key == "model" and len(found.ladder) == 1 else title
        made.append(Section(key, title, html))
    return made


def page(
    diagnosis: Diagnosis,
    units: Units | None = None,
    files: Sequence[PathLike] = (),
    settings: Mapping[str, Any] | None = None,
) -> str:
    """Return the whole page; see `sections`."""
    parts = sections(diagnosis, units, files, settings)
    name = diagnosis.steps[0].base.split.records[0].name
    return str(
        _templates().get_template("page.html").render(
            sections=parts, name=name, headline=story.headline(diagnosis), colours=stylesheet(),
            style=style(), bokeh=interactive.bundle(),
        )
    )  # fmt: skip


def report(
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
    settings : mapping of what else was chosen, for the record
    """
    write_text(path, page(diagnosis, units, files, settings))


def style() -> str:
    """Return the style sheet of the page."""
    return (Path(__file__).parent / "templates" / "style.css").read_text(encoding="utf-8")


# -- what each part needs --------------------------------------------------------------------------------------


def _verdict(d: Diagnosis, units: Units) -> dict[str, Any]:
    rows = [r for r in d.misfit.table(units) if max(r["share"], r["share_missing"] or 0) > 0.05]
    return {
        "headline": story.headline(d), "sentence": d.sentence(units), "sizes": story.sizes(d, units),
        "next": story.what_next(d), "worst": rows[0] if rows else None,
        "steps": [s.sentence(units) for s in d.steps[1:]],
    }  # fmt: skip


def _compare(
    c: Comparison, drawn: Sequence[Picture], script: str, elements: Mapping[str, str], count: int
) -> dict[str, Any]:
    from markupsafe import Markup

    static = {p.key: p for p in drawn}
    same = {"time": "time_0", "errors": "errors", "loop0": "loop_0", "loop1": "loop_1"}
    live = [(name, static[same[name]], Markup(element)) for name, element in elements.items()]
    return {"script": Markup(script), "live": live, "runs": list(c.runs), "name": c.name, "count": count}


def _rungs(d: Diagnosis) -> list[dict[str, Any]]:
    spread = d.steps[0].base.problem.spread
    rows = [{"name": n, **r} for n, r in zip(d.rungs, d.ladder, strict=True)]
    rows.append({"name": "noise floor", "train": None, "validation": d.floor / spread})
    return [r | {"size": r["validation"] * spread} for r in rows]


def _candidates(d: Diagnosis, units: Units) -> list[dict[str, Any]]:
    return [
        row | {"latex": c.latex.split(r",\quad "), "sentence": c.variant.effect.sentence, "form": _form(c.variant),
               "parameters": story.candidate_parameters(c, units)}
        for row, c in zip(d.table(), d.candidates, strict=True)
    ]  # fmt: skip


def _form(variant: Variant) -> str:
    return str(variant).removeprefix(variant.id).strip()[1:-1]


def _model(d: Diagnosis, units: Units) -> dict[str, Any]:
    from markupsafe import Markup

    before, after = d.steps[0].base.model, d.model
    # Of the base's own equation, and of the input that it sees, only what was added is new.
    states = {s.left.base for s in after.states} - {s.left.base for s in before.states} - {x, v}
    new = (set(after.symbols) - set(before.symbols)) | states
    rows = story.parameters(before, after, units, story.shape_units(d, units))
    try:
        file = to_text(after)
    except ModelError:  # a channel's name that a model file does not take
        file = ""
    return {
        "before": [Markup(marked(before, values=v)) for v in (False, True)],
        "after": [Markup(marked(after, new, v)) for v in (False, True)] if after is not before else [],
        "rows": rows, "moved": story.moved(rows), "point": after.operating_point, "latex": after.latex(),
        "python": story.python(after), "file": file,
    }  # fmt: skip


def _derived(model: Model) -> dict[str, Any]:
    parts = derived(model)
    try:
        law = compensator(model)
    except NotInvertible:  # the reason stands among the parts
        return {"derived": parts, "law": None}
    away = operating_range(law)
    shown = {
        "latex": law.latex(), "numbers": law.latex(numbers=True), "lines": law.lines(numbers=True),
        "preview": law.preview, "checked": law.checked, "away": away.sentence if away is not None else "",
    }  # fmt: skip
    return {"derived": parts, "law": shown}


def _experiment(d: Diagnosis, drawn: Sequence[Picture], units: Units, scripts: bool) -> dict[str, Any]:
    from markupsafe import Markup

    e = d.experiment
    assert e is not None
    script, elements = interactive.experiment(e, units) if scripts else ("", {})
    live = [(name, p, Markup(part)) for (name, part), p in zip(elements.items(), drawn, strict=False)]
    looks = zip(map(words, e.outputs), interactive.LOOKS, interactive.DASHES, strict=False)
    csv = csv_text({"t": e.t, "u": e.u})
    return {"e": e, "csv": csv, "script": Markup(script), "live": live, "looks": list(looks)}


def _provenance(
    d: Diagnosis,
    files: Sequence[PathLike],
    settings: Mapping[str, Any],
    drawn: Mapping[str, list[Picture]],
    script: str,
) -> dict[str, Any]:
    records = d.steps[0].base.split.records
    chosen = {"seed": d.seed, "steps": len(d.steps), **settings}
    shared: dict[int, tuple[list[str], Picture]] = {}
    for picture in (p for listed in drawn.values() for p in listed if p.columns):
        shared.setdefault(id(picture.columns), ([], picture))[0].append(picture.title)
    return {
        "sources": story.sources(records, files), "records": story.record_lines(records), "settings": chosen,
        "versions": story.versions(), "seconds": d.seconds, "numbers": list(shared.values()),
        "now": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }  # fmt: skip
