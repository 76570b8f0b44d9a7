"""What may be taken away from a workbench."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ModelError
from ..files.store import to_text
from ..symbolic.signals import plain_name
from .story import Story

if TYPE_CHECKING:
    from .workbench import Workbench


def download(bench: Workbench, kind: str) -> tuple[str, str]:
    """Return name and content of a file.

    Parameters
    ----------
    kind : str
        "report.html", "model.json", "model.tex", "model.c", and with a law "law.tex", "law.c".

    Raises
    ------
    ModelError
        Where there is no such file (yet).
    """
    from ..inversion.summary import document

    rung, law = bench.rung, bench.law
    if rung is None:
        raise ModelError("There is no model yet: diagnose a base first.")
    makers: dict[str, Callable[[], str]] = {
        "report.html": lambda: _report(bench),
        "model.json": lambda: to_text(rung.model),
        "model.tex": lambda: document(rung.model),
        "model.c": lambda: rung.model.to_c(),
    }
    if law is not None and not law.why_not:
        makers["law.tex"] = lambda: f"\\[\n{law.latex}\n\\]\n"
        if law.code:
            makers["law.c"] = lambda: law.code
    if kind not in makers:
        raise ModelError(f"There is no {kind[:40]!r}; there are {', '.join(makers)}.")
    return f"{plain_name(Path(bench.file).stem)}_{kind}", makers[kind]()


def _report(bench: Workbench) -> str:
    from ..report.page import page

    choice = bench.choice
    settings = {"base": bench.base_name or str(bench.base), "rows": choice.rows or "all"}
    settings["channels"] = ", ".join(choice.channels) or "none"
    return page(Story.of(bench.rungs), choice.units, [bench.path] if bench.path else [], settings)
