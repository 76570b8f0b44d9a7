"""JavaScript of a recursion: its run over whole arrays, with the parameters as arguments."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import sympy as sp

from ..engines.plan import Plan
from ..engines.writer import RELATIONS, Writer, indented
from ..errors import ModelError
from ..symbolic.signals import samples, t
from .layout import Layout, numbered, shortened, wrapped
from .registry import Request, export

# Reserved words of all editions, what strict mode forbids, and the names that the source itself uses.
WORDS = set(
    """abstract arguments async await boolean break byte case catch char class const continue debugger default delete
    do double else enum eval export extends false final finally float for function get goto if implements import in
    instanceof int interface let long native new null of package private protected public return set short static
    super switch synchronized this throw throws transient true try typeof undefined var void volatile while with yield
    inputs states parameters values rested output depth rest simulate given start theta runs run samples at n k i x
    ahead module""".split()
)


class _JavaScript(Writer):
    """The words of ECMAScript 2015."""

    language, words = "JavaScript", "javascript"
    relations: ClassVar[Mapping[Any, str]] = {**RELATIONS, sp.Equality: "===", sp.Unequality: "!=="}
    joints, truth = ("&&", "||", "!"), ("false", "true")
    pow, nan, defining, declaring = "Math.pow", "NaN", "const {name} = {shown};", "let {name};"


@export("js", "JavaScript", ".js")
def source(request: Request) -> str:
    """Return one constant with its functions: `narx_sym.codegen.export.written`."""
    name = request.name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,40}", name) or name in WORDS:
        raise ModelError(f"{name!r} cannot be the name of a constant in JavaScript.")
    if request.single:
        raise ModelError("JavaScript computes in double precision only.")
    layout = Layout.of(replace(request, values={}), _label, WORDS | {name})
    recursion = layout.recursion
    # What is at rest before the first sample, of which the states start; inputs are given with their past.
    read = {s.base for e in layout.initial.values() for s in samples(e)}
    rested = [b for b in layout.rested if b in recursion.states or b in read]
    takes = ", ".join(map(_plain, recursion.inputs)) or "nothing"
    lines = [
        "/*",
        *(f" * {line}".rstrip() for line in layout.comment(
            *request.notes,
            f"{name}.simulate(inputs, start, parameters) takes an array of arrays ({takes}), the first "
            f"{recursion.depth} samples of each state (a number or an array each), and the parameters; it returns "
            f"{_plain(request.returned)} as a Float64Array, NaN from where a state is not finite. A further argument "
            "takes one Float64Array for each state.",
            _said_of_rest(name, rested),
        )),
        " */",
        f"const {name} = (() => {{",
        '    "use strict";',
        f"    const inputs = {_names(recursion.inputs)}, states = {_names(recursion.states)};",
        f"    const parameters = {_names(request.recursion.parameters)}, rested = {_names(rested)};",
        f"    const values = [{', '.join(repr(float(v)) for v in request.values.values())}];",
        f"    const output = {recursion.states.index(request.returned)}, depth = {recursion.depth};",
        "",
        *indented(["function rest(at, theta = values) {", *wrapped(_rest(layout, rested)), "}"]),
        "",
        *(line.rstrip() for line in indented(_simulate(layout))),
        "",
        "    return {inputs, states, parameters, values, rested, output, depth, rest, simulate};",
        "})();",
        f'if (typeof module === "object") module.exports = {name};',
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _said_of_rest(name: str, rested: list[Any]) -> str:
    """Return what the comment says of `rest`."""
    said = f"{name}.rest(at, parameters) returns what the states start from at rest"
    if not rested:
        return f"{said}; at is not read."
    shown = ", ".join(map(_plain, rested))
    clock = "; t is the time of the first sample in s, one number too" * (t in rested)
    return f"{said}: at has one number for each sequence in {name}.rested, in that order ({shown}){clock}."


def _rest(layout: Layout, rested: list[Any]) -> list[str]:
    """Return the body of what gives the states at rest."""
    labels, writer = layout.labels, _JavaScript({})
    shown = []
    for base in layout.recursion.states:
        if base in layout.initial:
            expr, names = layout.at_rest(base, {b: labels[b] for b in rested})
            writer.names = {**names, **layout.parameters}
            shown.append(writer(expr))
        else:
            shown.append(labels[base] if base in rested else writer.number(0.0))
    taken = [f"const [{', '.join(labels[b] for b in rested)}] = at;"] * bool(rested)
    return [*taken, *_unpacked(layout), *writer.lines, f"return [{', '.join(shown)}];"]


def _simulate(layout: Layout) -> list[str]:
    """Return the function that runs over arrays."""
    recursion, labels, plan = layout.recursion, layout.labels, layout.plan
    writer = _JavaScript({Plan.time: "k", **layout.parameters})
    for (signal, lag), symbol in plan.sample.items():
        at = "k" if not lag else f"k {'-' if lag > 0 else '+'} {abs(lag)}"
        writer.names[symbol] = f"{labels[plan.signals[signal]]}[{at}]"

    def done(s: int, shown: str) -> None:
        newest = writer.names[plan.sample[s, 0]]
        writer.lines.extend([f"{newest} = {shown};", f"if (!Number.isFinite({newest})) break;"])

    fixed = {*plan.parameters}
    for symbol, e in plan.shared[0]:  # what the parameters alone decide stands before the loop
        if e.free_symbols <= fixed:
            fixed.add(symbol)
            writer.names[symbol] = writer.part(e)
    before, writer.lines = writer.lines, []
    writer.updates(plan, done)
    made = "states.map(() => new Float64Array(given[0].length))"
    body = [
        "const n = runs[0].length;",
        *([f"const [{', '.join(labels[b] for b in recursion.inputs)}] = given{'.map(ahead)' * bool(recursion.lead)};"]
          * bool(recursion.inputs)),
        f"const [{', '.join(labels[b] for b in recursion.states)}] = runs;",
        *_unpacked(layout),
        *before,
        "runs.forEach((run, i) => {",
        "    for (let k = 0; k < Math.min(depth, n); k++) run[k] = start[i].length ? start[i][k] : start[i];",
        "});",
        "let k = depth;",
        "for (; k < n; k++) {",
        *indented(writer.lines),
        "}",
        "for (const run of runs) run.fill(NaN, k);",
        "return runs[output];",
    ]  # fmt: skip
    ahead = [  # the last value is held
        "function ahead(x) {",
        f"    const n = x.length, samples = new Float64Array(n + {recursion.lead});",
        "    samples.set(x);",
        "    return samples.fill(x[n - 1], n);",
        "}",
        "",
    ]
    head = f"function simulate(given, start, theta = values, runs = {made}) {{"
    return [*ahead * bool(recursion.lead), head, *wrapped(body), "}"]


def _unpacked(layout: Layout) -> list[str]:
    """Return the parameters out of their array; those that nothing reads leave a hole."""
    read = [layout.parameters.get(p, "") for p in layout.recursion.parameters]
    return [f"const [{', '.join(read)}] = theta;"] * bool(layout.parameters)


def _plain(base: Any) -> str:
    return shortened(base.name, 40)


def _names(listed: Any) -> str:
    """Return names as an array of texts that can stand inside a page."""
    return json.dumps([str(getattr(b, "label", b)) for b in listed]).replace("<", "\\u003c")


def _label(plain: str, taken: set[str]) -> str:
    """Return an identifier."""
    return numbered(shortened(plain, 40), lambda name: name not in taken and not re.fullmatch(r"part_\d+", name))
