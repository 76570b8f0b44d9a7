"""The live part of the report as a widget of Jupyter and marimo: the same page, the same JavaScript."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ...diagnosis.procedure import Diagnosis
from ...errors import ModelError
from ..page import sections, style, templates
from ..panels.try_it import models
from ..svg import stylesheet

if TYPE_CHECKING:
    from .widget import Live


def live(diagnosis: Diagnosis, units: Mapping[str, str] | None = None) -> Live:
    """Return the live part of the report for a notebook.

    It needs `pip install "narx-sym[notebook]"`.

    Parameters
    ----------
    diagnosis : Diagnosis
    units : mapping such as {"u": "V", "y": "um"}
        By default those of the records.

    Raises
    ------
    ModelError
        Where no model of the diagnosis can run in a browser, or anywidget is not there.
    """
    try:
        from .widget import Live
    except ImportError:
        raise ModelError('anywidget is not installed: pip install "narx-sym[notebook]"') from None
    made = sections(diagnosis, units, keys=["try_it"])
    if not made:
        raise ModelError("None of these models can run in a browser, so there is nothing to move.")
    page = templates().get_template("notebook.html").render(part=made[0], colours=stylesheet(), style=style())
    return Live(page, [one.fitted.model for one in models(diagnosis)])
