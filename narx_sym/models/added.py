"""One effect that was added to a model: which, in which form, where, and what it brought."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any


@dataclass(frozen=True)
class AddedEffect:
    """An effect in a model; the model's symbols and states say the rest.

    Attributes
    ----------
    effect : id that users see, with its channel, such as "channel:temp"
    form : which of several forms, such as "Bouc-Wen"
    where : "input", "inside" or "output"
    driver : "u", "y", "uy", "t" or "channel"
    group : of the states that it remembers
    coefficients, shape : mappings from the effect's own names, such as "c" and "r", to the model's symbols
    fixed : mapping from shape parameters in whole samples to their values
    """

    effect: str
    form: str = ""
    where: str = ""
    driver: str = ""
    group: str = ""
    coefficients: Mapping[str, Any] = field(default_factory=dict)
    shape: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, int] = field(default_factory=dict)

    @property
    def symbols(self) -> dict[str, Any]:
        """All symbols that the effect brought, by its own names."""
        return {**self.coefficients, **self.shape}

    def among(self, symbols: Collection[Any]) -> AddedEffect:
        """Return what is left of the effect where only some symbols are left."""
        coefficients, shape = ({n: s for n, s in d.items() if s in symbols} for d in (self.coefficients, self.shape))
        return replace(self, coefficients=coefficients, shape=shape)
