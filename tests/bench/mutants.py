"""Mutation testing: small faults are put into a module, one at a time, and the tests must notice.

    python tests/bench/mutants.py [--modules fit/least_squares models/analysis] [--count 60] [--seed 7] [--out mutants.json]

First the tests run once, and which test reaches which line is kept. Then each mutant runs in a fork of this process that
has the other packages loaded already: its module is compiled from the changed tree (no file is touched), and the tests
that reach the line run, quick ones first, until one fails. `--again mutants.json` runs those that were not noticed once
more, on all tests of the module's own files, and takes over the others. Needs `coverage`.
"""

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
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import common
from common import ROOT

MODULES = ("fit/least_squares", "models/analysis", "inversion/compensator", "symbolic/sensitivity")
TESTS = (
    "fit/test_least_squares models/test_analysis inversion/test_compensator whole/test_paper inversion/test_stability "
    "data/test_coverage fit/test_select symbolic/test_smoothing symbolic/test_sensitivity fit/test_steady_state "
    "models/test_pool models/test_equilibria inversion/test_damping inversion/test_law_stability inversion/test_polynomials "
    "fit/test_numerical_truth::^(?!.*engines) fit/test_interop::casadi|rest|state|loop engines/test_engines::sensitivities "
    "inversion/test_laws::^(?!.*(random|every|completed)) models/test_extend::static|sigma_y|remembers|inner|by_hand|initial|law|time|rest"
)  # after :: a pattern of the names of tests
OWN = {
    "fit/least_squares": "data/test_coverage fit/test_least_squares fit/test_numerical_truth::^(?!.*(engines|complex|cover))",
    "models/analysis": "models/test_analysis models/test_pool models/test_equilibria",
    "inversion/compensator": "inversion/test_compensator::^(?!.*random)",
    "symbolic/sensitivity": "symbolic/test_sensitivity fit/test_numerical_truth::complex",
}
SECONDS = 150  # for a mutant; an endless loop counts as noticed
UNNOTICED = ("passed", "not reached")
MOST = 40  # tests for a mutant
LOADED = "numpy scipy.linalg scipy.optimize sympy casadi llvmlite.binding pandas lark joblib hypothesis matplotlib.pyplot coverage"

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


def sites(tree: ast.AST) -> list[tuple[int, int, range]]:
    """(number of the node, number of the change, lines) of every possible mutant."""
    numbers = {id(node): i for i, node in enumerate(ast.walk(tree))}
    found: list[tuple[int, int, range]] = []

    def visit(node: ast.AST, lines: range) -> None:
        if skipped(node):
            return
        if isinstance(node, ast.expr | ast.stmt):
            last = node.test if isinstance(node, ast.If | ast.While) else node
            lines = range(node.lineno, (last.end_lineno or node.lineno) + 1)
        found.extend((numbers[id(node)], j, lines) for j in range(len(list(changes(node)))))
        hidden = {"annotation", "returns", "decorator_list"}
        for name, value in ast.iter_fields(node):
            if name not in hidden:
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        visit(child, lines)

    visit(tree, range(0))
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
        self.name, self.path = "narx_sym." + module.replace("/", "."), str(ROOT / "narx_sym" / f"{module}.py")
        self.code = compile(tree, self.path, "exec")  # type: ignore[arg-type]

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def exec_module(self, module: Any) -> None:
        exec(self.code, module.__dict__)  # our own source, changed


def chosen_tests(names: str) -> list[str]:
    """The tests of a list such as "test_a test_b::pattern"."""
    found = []
    for name, _, part in (n.partition("::") for n in names.split()):
        file = ROOT / "tests" / f"{name}.py"
        functions = re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.M)
        found += [f"{file}::{f}" for f in functions if re.search(part, f)] if part else [str(file)]
    return found


def in_fork(work: Callable[[], int]) -> str:
    """Run something in a fork, silently: "failed", "timeout", "crashed" or "passed"."""
    child = os.fork()
    if child == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        code = 1
        try:
            import hypothesis

            phases = [hypothesis.Phase.explicit, hypothesis.Phase.generate]
            options: dict[str, Any] = {"phases": phases, "database": None, "derandomize": True, "deadline": None}
            hypothesis.settings.register_profile("mutants", **options)
            hypothesis.settings.load_profile("mutants")
            code = work()
        finally:
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    if os.WIFSIGNALED(status):
        return "timeout" if os.WTERMSIG(status) == signal.SIGALRM else "crashed"
    return "passed" if os.WEXITSTATUS(status) == 0 else "failed"


def run_tests(tests: list[str], *plugins: Any) -> int:
    import pytest

    return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "--no-header", *tests], list(plugins)))


class Reached:
    """A pytest plugin: how long each test takes, and which lines of the modules it reaches."""

    def __init__(self, file: str):
        import coverage

        self.file, self.seconds = file, {}
        self.cover = coverage.Coverage(data_file=None, include=[str(ROOT / "narx_sym" / f"{m}.py") for m in MODULES])
        self.cover.start()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.cover.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration

    def pytest_sessionfinish(self) -> None:
        self.cover.stop()
        data = self.cover.get_data()
        files = {f: Path(f).relative_to(ROOT / "narx_sym").with_suffix("").as_posix() for f in data.measured_files()}
        lines = {module: data.contexts_by_lineno(f) for f, module in files.items()}
        Path(self.file).write_text(json.dumps({"seconds": self.seconds, "lines": lines}), encoding="utf-8")


def reached() -> dict[str, Any]:
    """Run all tests once: {"seconds": by test, "lines": by module and line, the tests that reach it}."""
    with tempfile.TemporaryDirectory() as folder:
        file = f"{folder}/reached.json"
        if in_fork(lambda: run_tests(chosen_tests(TESTS), Reached(file))) != "passed":
            raise SystemExit("The tests fail without any change.")
        return dict(json.loads(Path(file).read_text(encoding="utf-8")))


def verdict_of(module: str, tree: ast.AST, tests: list[str]) -> str:
    """What the tests say to a changed module."""

    def work() -> int:
        signal.alarm(SECONDS)
        sys.meta_path.insert(0, Changed(module, tree))
        return run_tests(tests)

    return in_fork(work) if tests else "not reached"


def main() -> None:
    asked = common.asked(__doc__, modules=MODULES, count=60, seed=7, again=Path, out=Path)
    earlier = json.loads(asked.again.read_text(encoding="utf-8")) if asked.again else []
    os.chdir(ROOT)
    for name in LOADED.split():
        importlib.import_module(name)
    known, results = {"seconds": {}, "lines": {}} if asked.again else reached(), []
    print(f"{len(known['seconds'])} tests, {sum(known['seconds'].values()):.0f} s", flush=True)
    for module in asked.modules:
        tree = ast.parse((ROOT / "narx_sym" / f"{module}.py").read_text(encoding="utf-8"))
        possible = sites(tree)
        chosen = random.Random(asked.seed).sample(possible, min(asked.count, len(possible)))
        by_line = known["lines"].get(module, {})
        for at, change, lines in sorted(chosen, key=lambda c: (c[2].start, c[0])):
            changed, before, after = mutated(tree, at, change)
            tests = {t for line in lines for t in by_line.get(str(line), ())}
            if "" in tests:  # reached when the module is imported
                tests |= {t for all_tests in by_line.values() for t in all_tests}
            quick = sorted(tests - {""}, key=lambda t: (known["seconds"].get(t, 0.0), t))[:MOST]
            quick = chosen_tests(OWN[module]) if asked.again else quick
            what = list(changes(before))[change][0]
            shown = f"{ast.unparse(before)} -> {ast.unparse(after)}".replace("\n", " ")
            began = time.perf_counter()
            same = [e["verdict"] for e in earlier if (e["module"], e["what"], e["change"]) == (module, what, shown)]
            done = same and not set(same) & set(UNNOTICED)
            verdict = same[0] if done else verdict_of(module, changed, quick)
            results.append({"module": module, "line": lines.start, "what": what, "change": shown, "verdict": verdict})
            seconds = time.perf_counter() - began
            print(
                f"{module}:{lines.start} {what}: {verdict} ({seconds:.1f} s, {len(quick)} tests) {shown[:150]}",
                flush=True,
            )
    for names in (*([m] for m in asked.modules), asked.modules):
        own = [r for r in results if r["module"] in names]
        killed = sum(r["verdict"] not in UNNOTICED for r in own)
        print(f"{' '.join(names)}: {killed} of {len(own)} noticed, {killed / max(1, len(own)):.1%}")
    if asked.out:
        asked.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
