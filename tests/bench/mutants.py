"""Mutation testing: small faults are put into a module, one at a time, and the tests must notice.

    python tests/bench/mutants.py [--modules estimate analysis] [--count 220] [--seed 7] [--out mutants.json]

Each mutant runs in a fork of this process that has the other packages loaded already; its module is compiled from the
changed tree, and no file is touched. A module's own tests run first, the further ones only on what they let pass.
"""

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import json
import os
import random
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
TESTS = {
    "estimate": ("test_estimate", "test_numerical_truth::^(?!.*(engines|complex)) test_seen test_selection"),
    "analysis": ("test_paper test_analysis", "test_internal test_extend::static|sigma_y|remembers|inner"),
    "invert": (
        "test_paper test_invert::^(?!.*random)",
        "test_interop::casadi|rest|state|loop test_smoothing test_laws::limits|start|closed|stages|inverse|no_law|delay",
    ),
    "sensitivity": (
        "test_estimate::sensitivities|direction",
        "test_estimate::free_run test_engines::sensitivities test_extend::by_hand|initial",
    ),
}  # a module's own tests, and further ones; after :: a pattern of the names of tests
SECONDS = 180  # for a mutant; an endless loop counts as noticed
LOADED = (
    "numpy scipy.linalg scipy.optimize sympy casadi llvmlite.binding pandas lark joblib hypothesis matplotlib.pyplot"
)

COMPARE = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Add,
    ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr, ast.Mod: ast.Mult, ast.FloorDiv: ast.Mult,
}  # fmt: skip

Change = tuple[str, Callable[[Any], None]]


def put(field: str, value: Any) -> Callable[[Any], None]:
    return lambda node: setattr(node, field, value)


def changes(node: ast.AST) -> Iterator[Change]:
    """What can be changed at one node."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        yield "comparison", put("ops", [COMPARE[type(node.ops[0])]()])
    elif isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        yield "operator", put("op", ARITHMETIC[type(node.op)]())
    elif isinstance(node, ast.BoolOp):
        yield "and/or", put("op", ast.Or() if isinstance(node.op, ast.And) else ast.And())
        yield "one condition less", put("values", node.values[1:] if len(node.values) > 2 else [node.values[0]] * 2)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "constant", put("value", not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield "constant", put("value", node.value + 1)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield "sign", put("op", ast.UAdd()) if isinstance(node.op, ast.USub) else put("op", ast.Not())
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        yield "never", put("test", ast.Constant(False))
        yield "always", put("test", ast.Constant(True))
    elif isinstance(node, ast.Return) and node.value is not None and not isinstance(node.value, ast.Constant):
        yield "returns None", put("value", ast.Constant(None))
    elif isinstance(node, ast.comprehension) and node.ifs:
        yield "filter dropped", put("ifs", node.ifs[1:])
    elif isinstance(node, ast.Call) and node.keywords and node.keywords[-1].arg:
        yield "argument dropped", put("keywords", node.keywords[:-1])


def skipped(node: ast.AST) -> bool:
    """Texts, types and messages are no part of the sample."""
    kinds = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.AnnAssign, ast.arg)
    typing = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    typing |= (
        isinstance(node, ast.Assign) and isinstance(node.value, ast.BinOp) and isinstance(node.value.op, ast.BitOr)
    )
    return typing or (isinstance(node, kinds) and not (isinstance(node, ast.AnnAssign) and node.value is not None))


def sites(tree: ast.AST) -> list[tuple[int, int, str]]:
    """(number of the node, number of the change, what) of every possible mutant."""
    numbers = {id(node): i for i, node in enumerate(ast.walk(tree))}
    found: list[tuple[int, int, str]] = []

    def visit(node: ast.AST) -> None:
        if skipped(node):
            return
        found.extend((numbers[id(node)], j, what) for j, (what, _) in enumerate(changes(node)))
        hidden = {"annotation", "returns", "decorator_list"}
        for name, value in ast.iter_fields(node):
            if name not in hidden:
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        visit(child)

    visit(tree)
    return found


def mutated(tree: ast.AST, at: int, change: int) -> tuple[ast.AST, ast.AST, ast.AST]:
    """The changed tree, and the node before and after."""
    own = copy.deepcopy(tree)
    node = next(n for i, n in enumerate(ast.walk(own)) if i == at)
    before = copy.deepcopy(node)
    list(changes(node))[change][1](node)
    if isinstance(node, ast.UnaryOp) and isinstance(before, ast.UnaryOp) and isinstance(before.op, ast.Not):
        node.operand = ast.UnaryOp(ast.Not(), node.operand)  # not x becomes x
    return ast.fix_missing_locations(own), before, node


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives the changed module in the place of its file."""

    def __init__(self, module: str, tree: ast.AST):
        self.name, self.path = f"narx_sym.{module}", str(ROOT / "narx_sym" / f"{module}.py")
        self.code = compile(tree, self.path, "exec")  # type: ignore[arg-type]

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def exec_module(self, module: Any) -> None:
        exec(self.code, module.__dict__)  # our own source, changed


def chosen_tests(names: str) -> list[str]:
    """The tests of a list such as "test_a test_b::part"."""
    found = []
    for name, _, part in (n.partition("::") for n in names.split()):
        file = ROOT / "tests" / f"{name}.py"
        functions = re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.M)
        found += [f"{file}::{f}" for f in functions if re.search(part, f)] if part else [str(file)]
    return found


def noticed(finder: Changed | None, names: str) -> str:
    """Run tests in a fork: "failed", "timeout" or "passed"."""
    child = os.fork()
    if child == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        signal.alarm(SECONDS)
        if finder:
            sys.meta_path.insert(0, finder)
        import hypothesis
        import pytest

        phases = [hypothesis.Phase.explicit, hypothesis.Phase.generate]
        hypothesis.settings.register_profile("mutants", phases=phases, database=None, derandomize=True, deadline=None)
        hypothesis.settings.load_profile("mutants")
        code = 1
        try:
            code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "--no-header", *chosen_tests(names)]))
        finally:
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    if os.WIFSIGNALED(status):
        return "timeout" if os.WTERMSIG(status) == signal.SIGALRM else "crashed"
    return "passed" if os.WEXITSTATUS(status) == 0 else "failed"


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--modules", nargs="*", default=list(TESTS))
    ask.add_argument("--count", type=int, default=60, help="Mutants per module, at most.")
    ask.add_argument("--seed", type=int, default=7)
    ask.add_argument("--out", type=Path)
    asked = ask.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    for name in LOADED.split():
        importlib.import_module(name)
    results = []
    for module in asked.modules:
        first, further = TESTS[module]
        for tests in (first, further):
            began = time.perf_counter()
            if noticed(None, tests) != "passed":
                raise SystemExit(f"{tests}: some fail without any change")
            print(f"{module}: {tests} take {time.perf_counter() - began:.1f} s", flush=True)
        tree = ast.parse((ROOT / "narx_sym" / f"{module}.py").read_text(encoding="utf-8"))
        possible = sites(tree)
        chosen = random.Random(asked.seed).sample(possible, min(asked.count, len(possible)))
        for at, change, what in sorted(chosen):
            changed, before, after = mutated(tree, at, change)
            finder, began = Changed(module, changed), time.perf_counter()
            verdict = noticed(finder, first)
            if verdict == "passed":
                verdict = noticed(finder, further)
            line = getattr(before, "lineno", 0)
            shown = f"{ast.unparse(before)} -> {ast.unparse(after)}".replace("\n", " ")
            results.append({"module": module, "line": line, "what": what, "change": shown, "verdict": verdict})
            seconds = time.perf_counter() - began
            print(f"{module}:{line} {what}: {verdict} ({seconds:.1f} s) {shown[:150]}", flush=True)
    for module in asked.modules:
        own = [r for r in results if r["module"] == module]
        killed = sum(r["verdict"] != "passed" for r in own)
        print(f"{module}: {killed} of {len(own)} noticed")
    killed = sum(r["verdict"] != "passed" for r in results)
    print(f"all: {killed} of {len(results)} noticed, {killed / max(1, len(results)):.1%}")
    if asked.out:
        asked.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
