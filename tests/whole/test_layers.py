"""The import rule: a room knows only the rooms that stand before it; what users call on an object goes through doors."""

import ast
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from places import PACKAGE

# `tasks` stands before all that people see: command line, page and report call the same functions.
ROOMS = "errors symbolic models files inversion engines data codegen fit sklearn diagnosis tasks report app cli".split()
SYMBOLIC = ROOMS[: ROOMS.index("engines")]  # these stay free of NUMERIC
NUMERIC = {"numpy", "scipy", "casadi", "llvmlite", "pandas", "matplotlib"}
ONLY = {"data/plants.py": {"errors"}}  # the plants are an independent truth
DATA = {"errors", "symbolic", "files", "engines", "data"}  # all that data know of: no model
FILES = sorted(f for f in PACKAGE.rglob("*.py") if f not in (PACKAGE / "__init__.py", PACKAGE / "__main__.py"))

# What does not keep a rule yet. Each list only shrinks: an entry that is no longer needed fails too.
UPWARDS: set[str] = set()
TYPES_ONLY = {  # circles that only names for type checkers close: nothing is loaded in them
    ("inversion.compensator", "inversion.stability")
}


def place(file: Path) -> str:
    return file.relative_to(PACKAGE).as_posix()


@cache
def tree_of(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def imported(tree: ast.AST, package: list[str]) -> Iterator[tuple[int, str, list[str]]]:
    """Line, absolute dotted source and names of every import, those inside functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name, []) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *filter(None, [node.module])])
            yield node.lineno, source, [a.name for a in node.names]


def package_of(file: Path) -> list[str]:
    return ["narx_sym", *file.relative_to(PACKAGE).parts[:-1]]


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
    only = ONLY.get(file, DATA if here == "data" else {there})
    if there not in (here, *only):
        return f"it may import only {sorted(only)}"
    return None if ROOMS.index(there) <= ROOMS.index(here) else "that room does not stand before this one"


def faults_of(file: Path) -> dict[str, str]:
    found = {}
    for line, source, names in imported(tree_of(file), package_of(file)):
        for name in [f"{source}.{n}" for n in names] if source == "narx_sym" else [source]:
            if why := broken(place(file), name):
                found[f"{place(file)}: {name}"] = f"{place(file)}:{line}: imports {name}: {why}"
    return found


def test_layers() -> None:
    faults = {fault: said for file in FILES for fault, said in faults_of(file).items()}
    assert not faults.keys() - UPWARDS, "\n".join(faults.values())
    assert faults.keys() >= UPWARDS, f"no longer needed in the list: {UPWARDS - faults.keys()}"


DOORS = [f for f in FILES if f.name == "doors.py"]


def lines_of(tree: ast.Module) -> Iterator[ast.AST]:
    """What a file of doors is made of, without texts and the import of `door`."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield from (n for n in node.body if not (isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)))
        elif isinstance(node, ast.ImportFrom):
            assert {a.name for a in node.names} <= {"door", "view"}, f"line {node.lineno}: only doors are imported"
        else:
            assert isinstance(node, ast.Expr), f"line {node.lineno}: a file of doors holds nothing but doors"


@pytest.mark.parametrize("file", DOORS, ids=place)
def test_doors_hold_nothing_but_doors_that_open(file: Path) -> None:
    for node in lines_of(tree_of(file)):
        assert isinstance(node, ast.Assign) and isinstance(node.value, ast.Call), ast.dump(node)
        assert isinstance(node.value.func, ast.Name) and node.value.func.id in ("door", "view"), ast.dump(node)
        module, name = (a.value for a in node.value.args if isinstance(a, ast.Constant))
        behind = getattr(import_module(f"narx_sym.{module}"), str(name), None)
        assert callable(behind), f"{place(file)}:{node.lineno}: there is no function {name} in {module}"
        assert behind.__module__ == f"narx_sym.{module}", f"{place(file)}:{node.lineno}: {name} lives elsewhere"
        assert behind.__doc__, f"{place(file)}:{node.lineno}: {name} has no docstring"


def test_doors_stand_in_the_files_of_doors_only() -> None:
    for file in set(FILES) - {*DOORS, PACKAGE / "symbolic" / "door.py"}:
        for _, source, _ in imported(tree_of(file), package_of(file)):
            assert source != "narx_sym.symbolic.door", f"{place(file)} has a door of its own"


def for_types_only(tree: ast.Module) -> set[ast.AST]:
    """What stands under `if TYPE_CHECKING:`."""
    guards = (n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test).endswith("TYPE_CHECKING"))
    return {inner for guard in guards for inner in ast.walk(guard)}


def arrows(types: bool) -> dict[str, set[str]]:
    """Which module imports which, inside functions too; what is imported for type checkers alone only if `types`."""
    names = {place(f).removesuffix(".py").replace("/", ".").removesuffix(".__init__"): f for f in FILES}
    found: dict[str, set[str]] = {}
    for name, file in names.items():
        tree = tree_of(file)
        skipped = set() if types else for_types_only(tree)
        nodes = [n for n in ast.walk(tree) if isinstance(n, (ast.Import, ast.ImportFrom)) and n not in skipped]
        found[name] = set()
        for _, source, listed in imported(ast.Module(body=nodes, type_ignores=[]), package_of(file)):  # type: ignore[arg-type]
            bare = source.removeprefix("narx_sym").removeprefix(".")
            for there in (f"{bare}.{n}".removeprefix(".") for n in listed) if listed else [bare]:
                found[name].add(there if there in names else bare)
        found[name] &= names.keys() - {name}
    return found


def circles(graph: dict[str, set[str]]) -> set[tuple[str, ...]]:
    """Return the sets of modules that reach each other, each as a sorted tuple."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        more = {start}
        while more:
            more = {there for here in more for there in graph[here]} - seen
            seen |= more
        return seen

    beyond = {name: reached(name) for name in graph}
    return {tuple(sorted(o for o in beyond[n] if n in beyond[o])) for n in graph if n in beyond[n]}


def test_no_module_imports_itself_through_others() -> None:
    assert circles(arrows(types=False)) == set()


def test_circles_of_type_checkers_only_shrink() -> None:
    assert circles(arrows(types=True)) == TYPES_ONLY


def test_the_search_for_circles_finds_them() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == {("a", "b", "c")}
    assert len(arrows(types=False)["cli.main"]) > 5


def test_every_number_that_a_diagnosis_decides_by_stands_in_one_file():
    """No module of the diagnosis but its settings has a numeric constant, and each of those is said what it is."""
    folder = PACKAGE / "diagnosis"

    def numbers(path: Path) -> list[int]:
        """Lines of constants made of numbers alone; what holds samples, x[k - 1], is an equation."""
        found = []
        for node in tree_of(path).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
                parts = list(ast.walk(node.value))
                kinds = {type(c.value) for c in parts if isinstance(c, ast.Constant)}
                if kinds and kinds <= {int, float} and not any(isinstance(x, ast.Subscript) for x in parts):
                    found.append(node.lineno)
        return found

    settings = folder / "settings.py"
    others = {place(p): numbers(p) for p in folder.rglob("*.py") if p != settings}
    assert {p: lines for p, lines in others.items() if lines} == {}
    lines, listed = settings.read_text(encoding="utf-8").splitlines(), numbers(settings)
    assert len(listed) > 30
    assert [n for n in listed if "  # " not in lines[n - 1]] == []


def hidden(function: ast.AST, known: set[str]) -> Iterator[str]:
    """Names of a module that a comprehension of a function takes for its own, and the function reads elsewhere."""
    comprehensions = [n for n in ast.walk(function) if isinstance(n, (ast.ListComp, ast.SetComp, ast.DictComp))]
    own = [{x.id for g in c.generators for x in ast.walk(g.target) if isinstance(x, ast.Name)} for c in comprehensions]
    for name in set().union(*own) & known:
        inside = {id(n) for c, names in zip(comprehensions, own, strict=True) if name in names for n in ast.walk(c)}
        others = [n for n in ast.walk(function) if isinstance(n, ast.Name) and n.id == name and id(n) not in inside]
        if others and all(isinstance(n.ctx, ast.Load) for n in others) and name not in arguments(function):
            yield name


def arguments(function: ast.AST) -> set[str]:
    """Names of the arguments of a function, and of those inside it."""
    return {n.arg for n in ast.walk(function) if isinstance(n, ast.arg)}


def test_no_comprehension_hides_a_name_of_the_module() -> None:
    """Python 3.12.1 puts a comprehension into its function, and then takes the name there for a local one too."""
    found = []
    for file in FILES:
        tree = tree_of(file)
        known = {a.asname or a.name for n in tree.body if isinstance(n, (ast.Import, ast.ImportFrom)) for a in n.names}
        functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]
        found += [f"{place(file)}: {f.name}: {name}" for f in functions for name in hidden(f, known)]
    assert not found
