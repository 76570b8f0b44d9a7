"""The import rule: a module knows only the modules that stand before it."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1] / "narx_sym"
LAYERS = (
    "errors signals recursion parsing printing markup smoothing identities assumptions sensitivity effects model analysis extend rewriting internal solution kinks branches stages grouping invert "
    "engines compile excursions export metrics timegrid tables data files seen simulation tracking interop misfit journal parallel constraints ensemble freerun estimate bootstrap selection identification directions gate refit bases blackbox candidates pairs sensor experiment diagnosis addition store derive plots svg traces figures interactive story report notebook plants terminal cli_diagnose demo app cli"
).split()
SYMBOLIC = LAYERS[: LAYERS.index("engines")]  # these stay free of NUMERIC
NUMERIC = {"numpy", "scipy", "casadi", "llvmlite", "pandas", "matplotlib"}
DOORS = {"model", "analysis", "internal", "invert", "recursion", "diagnosis"}  # their methods may import later modules
ONLY = {"plants": {"errors"}}  # the plants are an independent truth
FILES = sorted(f for f in ROOT.rglob("*.py") if f not in (ROOT / "__init__.py", ROOT / "__main__.py"))


def targets(node: ast.Import | ast.ImportFrom, package: list[str]) -> list[str]:
    """Absolute dotted names that one statement imports, `narx_sym.X` for a name X of the package."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    base = package[: len(package) - node.level + 1] if node.level else []
    source = ".".join([*base, *filter(None, [node.module])])
    return [f"{source}.{alias.name}" for alias in node.names] if source == "narx_sym" else [source]


def imports(node: ast.AST, package: list[str], place: str = "module") -> Iterator[tuple[int, str, str]]:
    """Line, name and place (module, class, function or method) of the imports that run."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        yield from ((node.lineno, name, place) for name in targets(node, package))
    children = list(ast.iter_child_nodes(node))
    if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
        children = list(node.orelse)
    elif isinstance(node, ast.ClassDef) and place == "module":
        place = "class"
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        place = "method" if place in ("class", "method") else "function"
    for child in children:
        yield from imports(child, package, place)


def broken(layer: str, name: str, place: str) -> str | None:
    """Say which rule an import breaks, if any."""
    root, _, rest = name.partition(".")
    target = rest.partition(".")[0]
    if root in NUMERIC and layer in SYMBOLIC:
        return "a symbolic module imports no numerical package"
    if root != "narx_sym" or target == layer:
        return None
    if target not in LAYERS:
        return "this is no module of LAYERS"
    if layer in ONLY and target not in ONLY[layer]:
        return f"{layer} may import only {sorted(ONLY[layer])}"
    if LAYERS.index(target) < LAYERS.index(layer) or (place == "method" and layer in DOORS):
        return None
    return "it does not stand before this module"


def test_files_found() -> None:
    assert FILES


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.relative_to(ROOT).as_posix())
def test_layer(file: Path) -> None:
    parts = file.relative_to(ROOT).with_suffix("").parts
    assert parts[0] in LAYERS, f"{file.name}: add {parts[0]} to LAYERS"
    package = ["narx_sym", *parts[:-1]]
    found = imports(ast.parse(file.read_text(encoding="utf-8")), package)
    faults = [
        f"{file.name}:{line}: imports {name}: {why}"
        for line, name, place in found
        if (why := broken(parts[0], name, place))
    ]
    assert not faults, "\n".join(faults)
