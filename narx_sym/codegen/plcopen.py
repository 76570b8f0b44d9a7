"""PLCopen XML (TC6, 2.01) of a recursion: the function block of `st`, and a program that tests it on the controller."""

from __future__ import annotations

from typing import Any

from .layout import numbered, wrapped
from .markup import document, element
from .registry import Example, Request, export
from .st import Block, Variable, block, label, layout_of, number

SPACE, TEXT = "http://www.plcopen.org/xml/tc6_0201", "http://www.w3.org/1999/xhtml"
MADE = "1980-01-01T00:00:00"  # the standard wants a date; the same model gives the same bytes
SECTIONS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars", "VAR_TEMP": "tempVars"}
ELEMENTARY = ("LREAL", "REAL", "BOOL", "DINT", "UDINT")
KINDS = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}


@export("plcopen", "PLCopen XML", ".xml")
def source(request: Request) -> str:
    """Return one project with the function block, and a program that tests it where short runs tell something."""
    made, example = block(request), request.example(request.instance)
    blocks = [made, *([_self_test(request, example)] if example else [])]
    header = {"companyName": "", "productName": "narx_sym", "productVersion": "1", "creationDateTime": MADE}
    scaling = [element(lang, {}, element("scaling", {"x": "1", "y": "1"})) for lang in ("fbd", "ld", "sfc")]
    project = element(
        "project",
        {"xmlns": SPACE, "xmlns:xhtml": TEXT},
        element("fileHeader", header),
        element("contentHeader", {"name": request.name}, element("coordinateInfo", {}, *scaling)),
        element("types", {}, element("dataTypes"), element("pous", {}, *map(_pou, blocks))),
        element("instances", {}, element("configurations")),
    )
    return document(project)


def _pou(one: Block) -> Any:
    sections = (
        element(SECTIONS[section], {}, *map(_variable, listed)) for section, listed in one.declared.items() if listed
    )
    return element(
        "pou",
        {"name": one.name, "pouType": KINDS[one.kind]},
        element("interface", {}, *sections),
        element("body", {}, element("ST", {}, element("xhtml:p", {}, "\n".join(one.body)))),
        element("documentation", {}, element("xhtml:p", {}, "\n".join(one.comment))),
    )


def _variable(one: Variable) -> Any:
    kind = element(one.kind) if one.kind in ELEMENTARY else element("derived", {"name": one.kind})
    if one.size:
        dimension = element("dimension", {"lower": "1", "upper": str(one.size)})
        kind = element("array", {}, dimension, element("baseType", {}, kind))
    made = element("variable", {"name": one.name}, element("type", {}, kind))
    if isinstance(one.start, tuple):
        values = (element("value", {}, element("simpleValue", {"value": value})) for value in one.start)
        made.append(element("initialValue", {}, element("arrayValue", {}, *values)))
    elif one.start:
        made.append(element("initialValue", {}, element("simpleValue", {"value": one.start})))
    return made


def _self_test(request: Request, example: Example) -> Block:
    """Return a program that steps the block through the example, one sample per scan."""
    layout, single = layout_of(request), request.single
    real, labels, inputs = "REAL" if single else "LREAL", layout.labels, request.recursion.inputs
    taken = {request.name.lower()}

    def named(plain: str) -> str:
        taken.add(name := label(plain, taken))
        return name

    def listed(values: Any) -> tuple[str, ...]:
        return tuple(number(float(v), single) for v in values)

    program = numbered(f"{request.name[:24].rstrip('_')}_test", lambda n: n.lower() not in taken)
    taken.add(program.lower())
    tested, expected, sample, gap, worst, wrong, passed, done = map(
        named, ("tested", "expected", "sample", "gap", "worst", "wrong", "passed", "finished")
    )
    size, fields = len(example.expected), {b: named(f"given_{i}") for i, b in enumerate(inputs, start=1)}
    rests = [f"{labels[b]}_rest := {number(example.rest[b], single)}" for b in layout.rested if b not in inputs]
    given = [*(f"{labels[b]} := {fields[b]}[{sample}]" for b in inputs), *rests, f"restart := {sample} = 1"]
    right = f"{expected}[{sample}]"
    body = [
        f"IF {sample} < {size} THEN",
        f"    {sample} := {sample} + 1;",
        f"    {tested}({', '.join(given)});",
        f"    {gap} := ABS({tested}.{layout.output} - {right}) / ({number(1.0)} + ABS({right}));",
        f"    IF NOT ({gap} <= {number(example.allowed(single), single)}) THEN",
        f"        {wrong} := {wrong} + 1;",
        "    END_IF;",
        f"    IF {gap} > {worst} THEN",
        f"        {worst} := {gap};",
        "    END_IF;",
        "END_IF;",
        f"{done} := {sample} >= {size};",
        f"{passed} := {done} AND {wrong} = 0;",
    ]
    variables = [
        Variable(tested, request.name),
        *(Variable(fields[b], real, size, listed(example.given[b])) for b in inputs),
        Variable(expected, real, size, listed(example.expected)),
        *(Variable(n, "DINT", start="0") for n in (sample, wrong)),
        *(Variable(n, real, start=number(0.0)) for n in (gap, worst)),
        *(Variable(n, "BOOL", start="FALSE") for n in (passed, done)),
    ]
    comment = [f"Tests {request.name}: {size} scans; then {done} is TRUE, and {passed} where every value was right."]
    return Block(program, comment, {"VAR": variables}, [line[4:] for line in wrapped(body)], "PROGRAM")
