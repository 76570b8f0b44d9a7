"""The live part of the report as a widget of Jupyter and marimo, and for a frame: the same page and JavaScript."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ...diagnosis.procedure import Diagnosis
from ...errors import ModelError
from ..figures.describe import stylesheet
from ..page import sections, style, templates
from ..panels.try_it import models

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
    page = framed(diagnosis, units)
    if not page:
        raise ModelError("None of these models can run in a browser, so there is nothing to move.")
    return Live(page, [one.fitted.model for one in models(diagnosis)])


def framed(diagnosis: Diagnosis, units: Mapping[str, str] | None = None) -> str:
    """Return the live part as a page of its own, for the frame of `live.js`; "" where no model can run in a browser."""
    made = sections(diagnosis, units, keys=["try_it"])
    if not made:
        return ""
    return str(templates().get_template("notebook.html").render(part=made[0], colours=stylesheet(), style=style()))
