"""What may be taken away from a workbench."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import ModelError
from ..files.store import to_text
from ..inversion.analyses import document
from ..models.model import Model
from ..tasks.compensate import Law


def written(kind: str, model: Model, law: Law | None, report: Callable[[], str]) -> str:
    """Return the content of a file.

    Parameters
    ----------
    kind : str
        "report.html", "model.json", "model.tex", "model.c", and with a law "law.tex", "law.c".
    law : Law, optional
    report : function that makes the page

    Raises
    ------
    ModelError
        Where there is no such file (yet).
    """
    makers: dict[str, Callable[[], str]] = {
        "report.html": report,
        "model.json": lambda: to_text(model),
        "model.tex": lambda: document(model),
        "model.c": lambda: model.to_c(),
    }
    if law is not None and not law.why_not:
        makers["law.tex"] = lambda: f"\\[\n{law.latex}\n\\]\n"
        if law.code:
            makers["law.c"] = lambda: law.code
    if kind not in makers:
        raise ModelError(f"There is no {kind[:40]!r}; there are {', '.join(makers)}.")
    return makers[kind]()
