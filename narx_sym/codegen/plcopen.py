"""PLCopen XML (TC6, 2.01) of a recursion: the function block of `st`, and a program that tests it on the controller."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree as Xml

from .layout import numbered, wrapped
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
    root = Xml.Element("project", {"xmlns": SPACE, "xmlns:xhtml": TEXT})
    header = {"companyName": "", "productName": "narx_sym", "productVersion": "1", "creationDateTime": MADE}
    Xml.SubElement(root, "fileHeader", header)
    places = Xml.SubElement(Xml.SubElement(root, "contentHeader", {"name": request.name}), "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        Xml.SubElement(Xml.SubElement(places, language), "scaling", {"x": "1", "y": "1"})
    types = Xml.SubElement(root, "types")
    Xml.SubElement(types, "dataTypes")
    pous = Xml.SubElement(types, "pous")
    for one in blocks:
        _pou(pous, one)
    Xml.SubElement(Xml.SubElement(root, "instances"), "configurations")
    Xml.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def _pou(parent: Any, one: Block) -> None:
    pou = Xml.SubElement(parent, "pou", {"name": one.name, "pouType": KINDS[one.kind]})
    interface = Xml.SubElement(pou, "interface")
    for section, listed in one.declared.items():
        if listed:
            variables = Xml.SubElement(interface, SECTIONS[section])
            for variable in listed:
                _variable(variables, variable)
    statements = Xml.SubElement(Xml.SubElement(pou, "body"), "ST")
    Xml.SubElement(statements, "xhtml:p").text = "\n".join(one.body)
    Xml.SubElement(Xml.SubElement(pou, "documentation"), "xhtml:p").text = "\n".join(one.comment)


def _variable(parent: Any, one: Variable) -> None:
    variable = Xml.SubElement(parent, "variable", {"name": one.name})
    kind = Xml.SubElement(variable, "type")
    if one.size:
        array = Xml.SubElement(kind, "array")
        Xml.SubElement(array, "dimension", {"lower": "1", "upper": str(one.size)})
        kind = Xml.SubElement(array, "baseType")
    if one.kind in ELEMENTARY:
        Xml.SubElement(kind, one.kind)
    else:
        Xml.SubElement(kind, "derived", {"name": one.kind})
    if not one.start:
        return
    start = Xml.SubElement(variable, "initialValue")
    if isinstance(one.start, str):
        Xml.SubElement(start, "simpleValue", {"value": one.start})
        return
    listed = Xml.SubElement(start, "arrayValue")
    for value in one.start:
        Xml.SubElement(Xml.SubElement(listed, "value"), "simpleValue", {"value": value})


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
