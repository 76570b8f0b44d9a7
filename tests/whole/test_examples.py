"""Every public function and class has an example, and every example in the package runs."""

import doctest
import importlib
import inspect
from pathlib import Path

import pytest

import narx_sym as ns

ROOT = Path(ns.__file__).parent
FILES = [path for path in sorted(ROOT.rglob("*.py")) if ">>> " in path.read_text(encoding="utf-8")]
MODULES = [".".join(("narx_sym", *path.relative_to(ROOT).with_suffix("").parts)) for path in FILES]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_run(name):
    found = doctest.testmod(importlib.import_module(name))
    assert found.attempted > 1 and not found.failed


def test_every_public_name_has_an_example():
    public = {name: getattr(ns, name) for name in ns.__all__}
    asked = {n: x for n, x in public.items() if inspect.isroutine(x) or inspect.isclass(x)}
    without = [
        name
        for name, thing in asked.items()
        if not (inspect.isclass(thing) and issubclass(thing, Exception))
        and not any(mark in (inspect.getdoc(thing) or "") for mark in (">>> ", "for an example"))
    ]
    assert len(asked) > 30 and not without
