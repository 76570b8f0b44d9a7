"""What may be taken away from a workbench."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ..codegen.registry import exports, files
from ..data.units import said_first
from ..files.atomic import columns_text
from ..files.store import to_text
from ..inversion.analyses import document
from ..models.model import Model
from ..report.page import material, page
from .story import Story


def offered(bench: Any, model: Model) -> dict[str, tuple[str, Callable[[], str | bytes]]]:
    """Return by its name what each file is called, and what makes its content.

    "report.html", "model.json", "model.tex", "model.c" and the other exports, with a law "law.tex", "law.c"... and with
    a run of it "law_run.csv".
    """
    law, run = bench.state.law, bench.state.run
    sources = {ending: (name, exports()[name].title) for ending, name in files().items()}
    found: dict[str, tuple[str, Callable[[], str | bytes]]] = {
        "report.html": ("Report (HTML)", partial(report_of, bench)),
        "model.json": ("Model (JSON)", partial(to_text, model)),
        "model.tex": ("Derivation (LaTeX)", partial(document, model)),
        **{f"model{e}": (f"Model ({title})", partial(model.export, name)) for e, (name, title) in sources.items()},
    }
    if law is not None and not law.why_not:
        found["law.tex"] = "Law (LaTeX)", lambda: f"\\[\n{law.latex}\n\\]\n"
        found |= {f"law{e}": (f"Law ({sources[e][1]})", partial(law.sources.get, e)) for e in law.sources}
    if run is not None:
        found["law_run.csv"] = (
            "Run of the law (CSV)",
            lambda: columns_text(run.tracked.columns(run.units), "law_run.csv"),
        )
    return found


def report_of(bench: Any) -> str:
    """Return the report of what a workbench shows, as a page."""
    choice = bench.choice
    settings = {"base": bench.base_name or str(bench.base), "rows": choice.rows or "all"}
    settings["channels"] = ", ".join(choice.channels) or "none"
    settings |= {"missing": choice.missing, "machine": choice.machine or "from the units, if they show it"}
    units = said_first(bench.record.units, choice.units)
    return page(material(Story.of(bench.state.revisions), units, [bench.path] if bench.path else [], settings))
