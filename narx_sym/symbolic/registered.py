"""Registries: what registers itself stands in the files of one folder, imported when it is first asked for."""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules


@cache
def load_registered(registry: str) -> None:
    """Import every file of a registry's folder, once: each may register something. `registry` is its `__name__`."""
    package = registry.rpartition(".")[0]
    for found in iter_modules(import_module(package).__path__):
        import_module(f"{package}.{found.name}")
