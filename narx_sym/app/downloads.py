"""What may be taken away from a workbench."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ..codegen.registry import exports, files
from ..data.units import said_first
from ..errors import ModelError
from ..files.atomic import columns_text
from ..files.store import to_text
from ..inversion.analyses import document
from ..models.model import Model
from ..report.page import material, page
from ..tasks.compensate import Law
from .browser.preview import Ran
from .story import Story


def written(kind: str, model: Model, law: Law | None, run: Ran | None, report: Callable[[], str]) -> str | bytes:
    """Return the content of a file.

    Parameters
    ----------
    kind : str
        "report.html", "model.json", "model.tex", "model.c" and the other exports, with a law "law.tex", "law.c"... and
        with a run of it "law_run.csv".
    law : Law, optional
    run : Ran, optional
    report : function that makes the page

    Raises
    ------
    ModelError
        Where there is no such file (yet).
    """
    makers: dict[str, Callable[[], str | bytes]] = {
        "report.html": report,
        "model.json": lambda: to_text(model),
        "model.tex": lambda: document(model),
    }
    makers |= {f"model{ending}": partial(model.export, name) for ending, name in files().items()}
    if law is not None and not law.why_not:
        makers["law.tex"] = lambda: f"\\[\n{law.latex}\n\\]\n"
        makers |= {f"law{ending}": partial(law.sources.__getitem__, ending) for ending in law.sources}
    if run is not None:
        makers["law_run.csv"] = lambda: columns_text(run.tracked.columns(run.units), "law_run.csv")
    if kind not in makers:
        raise ModelError(f"There is no {kind[:40]!r}; there are {', '.join(makers)}.")
    return makers[kind]()


def titles(law: Law | None, run: Ran | None) -> dict[str, str]:
    """Return what there is to take away, and what it is called."""
    sources = {ending: exports()[name].title for ending, name in files().items()}
    found = {"report.html": "Report (HTML)", "model.json": "Model (JSON)", "model.tex": "Derivation (LaTeX)"}
    found |= {f"model{ending}": f"Model ({title})" for ending, title in sources.items()}
    if law is not None and not law.why_not:
        found["law.tex"] = "Law (LaTeX)"
        found |= {f"law{ending}": f"Law ({sources[ending]})" for ending in law.sources}
    if run is not None:
        found["law_run.csv"] = "Run of the law (CSV)"
    return found


def report_of(bench: Any) -> str:
    """Return the report of what a workbench shows, as a page."""
    choice = bench.choice
    settings = {"base": bench.base_name or str(bench.base), "rows": choice.rows or "all"}
    settings["channels"] = ", ".join(choice.channels) or "none"
    settings |= {"missing": choice.missing, "machine": choice.machine or "from the units, if they show it"}
    units = said_first(bench.record.units, choice.units)
    return page(material(Story.of(bench.revisions), units, [bench.path] if bench.path else [], settings))
