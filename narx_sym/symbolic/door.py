"""Doors: what users call on an object and what lives in a later room is loaded when it is first used."""

from __future__ import annotations

from importlib import import_module
from types import MethodType
from typing import Any


class Door:
    """A method or an attribute that is a function of a room above: its first argument is the object.

    The class shows the function itself, so that `help`, `inspect.signature` and editors show its text.
    """

    def __init__(self, module: str, name: str, called: bool):
        self.module, self.name, self.called = module, name, called

    @property
    def function(self) -> Any:
        """What stands behind the door."""
        return getattr(import_module(f"narx_sym.{self.module}"), self.name)

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None:
            return self.function if self.called else property(self.function)
        return MethodType(self.function, instance) if self.called else self.function(instance)


def door(module: str, name: str) -> Any:
    """Return a method: `simulate = door("fit.simulate", "simulate")` makes `model.simulate(u)` `simulate(model, u)`."""
    return Door(module, name, called=True)


def view(module: str, name: str) -> Any:
    """Return an attribute: `sigma_y = view("models.analysis", "sigma_y")` makes `model.sigma_y` `sigma_y(model)`."""
    return Door(module, name, called=False)
