"""The live part of the report as a widget of Jupyter and marimo, and for a frame: the same page and JavaScript."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ...diagnosis.procedure import Diagnosis
from ...errors import ModelError
from .. import hero
from ..page import material, page

if TYPE_CHECKING:
    from .widget import Live


def live(diagnosis: Diagnosis, units: Mapping[str, str] | None = None) -> Live:
    """Return the interactive part of the report for a notebook.

    It needs `pip install "narx-sym[notebook]"`.

    Parameters
    ----------
    diagnosis : Diagnosis
    units : mapping such as {"u": "V", "y": "um"}
        By default those of the records.

    Raises
    ------
    ModelError
        Where anywidget is not there.
    """
    try:
        from .widget import Live
    except ImportError:
        raise ModelError('anywidget is not installed: pip install "narx-sym[notebook]"') from None
    of = material(diagnosis, units)
    return Live(page(of, framed=True, keys=hero.FRAMED), [one.fitted.model for one in of.once(hero.models)])
