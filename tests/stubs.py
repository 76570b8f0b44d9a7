"""Stubs of the doors: editors and mypy see the signature of the function that stands behind each.

python tests/stubs.py    writes `doors.pyi` beside every `doors.py`
"""

import importlib
import inspect
from pathlib import Path

from places import PACKAGE

from narx_sym.symbolic.door import Door

DOORS = sorted(PACKAGE.rglob("doors.py"))


def stub(file: Path) -> str:
    """The stub of a file of doors: what each is, and the first sentence of its class."""
    room = file.parent.name
    module = importlib.import_module(f"narx_sym.{room}.doors")
    imports, bodies = set(), []
    for name, cls in vars(module).items():
        if not inspect.isclass(cls) or cls is Door:
            continue
        lines = [f"class {name}:"]
        for attribute, found in vars(cls).items():
            if not isinstance(found, Door):
                continue
            local = f"_{found.module.replace('.', '_')}_{found.name}"
            if found.called:
                imports.add(f"from narx_sym.{found.module} import {found.name} as {local}")
                lines.append(f"    {attribute} = {local}")
            else:  # an attribute
                lines += ["    @property", f"    def {attribute}(self) -> Any: ..."]
        bodies.append("\n".join(lines))
    text = "# What editors and mypy see of the doors; written by tests/stubs.py.\n"
    text += "from typing import Any\n\n" if any("Any" in body for body in bodies) else ""
    return text + "\n".join(sorted(imports)) + "\n\n" + "\n\n".join(bodies) + "\n"


if __name__ == "__main__":
    for one in DOORS:
        one.with_suffix(".pyi").write_text(stub(one), encoding="utf-8")
