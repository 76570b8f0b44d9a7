"""The widget itself; `live` makes it."""

from __future__ import annotations

from pathlib import Path

import anywidget
import traitlets

from ...models.model import Model


class Live(anywidget.AnyWidget):
    """The first screen of the report: switches, loop and portrait, and a slider for every parameter, in the browser.

    Attributes
    ----------
    chosen : int
        Which model the sliders move: 0 is the base.
    theta : list of float
        Its parameters as the sliders stand.
    rms : float or None
        Its free-run error over the record [unit of y]; None where it diverges.
    added : str
        The effect that "Add" was last pressed for.
    """

    _esm = Path(__file__).with_name("live.js")
    page = traitlets.Unicode().tag(sync=True)
    chosen = traitlets.Int(0).tag(sync=True)
    theta = traitlets.List(traitlets.Float()).tag(sync=True)
    added = traitlets.Unicode("").tag(sync=True)
    rms = traitlets.Float(None, allow_none=True).tag(sync=True)

    def __init__(self, page: str, listed: list[Model]) -> None:
        super().__init__(page=page)
        self._listed = listed

    @property
    def model(self) -> Model:
        """The model with the parameters as the sliders stand."""
        one = self._listed[self.chosen]
        return one.replace(theta=list(self.theta)) if self.theta else one
