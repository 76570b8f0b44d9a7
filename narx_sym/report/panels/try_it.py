"""The models moved by hand: the page itself runs them over the record, with the parameters that its sliders say."""

from __future__ import annotations

from typing import Any

from .. import hero
from .registry import Material, panel


@panel("Try it", order=15)
def try_it(material: Material) -> dict[str, Any] | None:
    """Tell the sliders; nothing where no model can be run by a page."""
    told = material.once(hero.told)
    return {"told": told} if any(one["run"] is None for one in told["models"]) else None
