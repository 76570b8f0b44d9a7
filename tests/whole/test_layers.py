"""The import rule: a room knows only the rooms that stand before it; what users call on an object goes through doors."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import PACKAGE

ROOMS = "errors symbolic models files inversion engines codegen data fit diagnosis report app cli".split()
SYMBOLIC = ROOMS[: ROOMS.index("engines")]  # these stay free of NUMERIC
NUMERIC = {"numpy", "scipy", "casadi", "llvmlite", "pandas", "matplotlib"}
ONLY = {"data/plants.py": {"errors"}}  # the plants are an independent truth
FILES = sorted(f for f in PACKAGE.rglob("*.py") if f not in (PACKAGE / "__init__.py", PACKAGE / "__main__.py"))
MOST = 12  # things in a folder


def imported(tree: ast.AST, package: list[str]) -> Iterator[tuple[int, str]]:
    """Line and absolute dotted name of every import, those inside functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *filter(None, [node.module])])
            bare = source == "narx_sym"
            yield from ((node.lineno, f"{source}.{a.name}" if bare else source) for a in node.names)


def broken(file: str, name: str) -> str | None:
    """Say which rule an import breaks, if any."""
    here = file.removesuffix(".py").partition("/")[0]
    root, _, rest = name.partition(".")
    there = rest.partition(".")[0]
    if root in NUMERIC and here in SYMBOLIC and here != "files":
        return "a symbolic room imports no numerical package"
    if root != "narx_sym":
        return None
    if there not in ROOMS:
        return "this is no room"
    if there != here and there not in ONLY.get(file, {there}):
        return f"it may import only {sorted(ONLY[file])}"
    return None if ROOMS.index(there) <= ROOMS.index(here) else "that room does not stand before this one"


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.relative_to(PACKAGE).as_posix())
def test_layer(file: Path) -> None:
    name = file.relative_to(PACKAGE).as_posix()
    package = ["narx_sym", *name.split("/")[:-1]]
    found = imported(ast.parse(file.read_text(encoding="utf-8")), package)
    faults = [f"{name}:{line}: imports {what}: {why}" for line, what in found if (why := broken(name, what))]
    assert not faults, "\n".join(faults)
