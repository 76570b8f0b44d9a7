"""PLCopen XML: read by a parser made from the standard's schema; its blocks run like the package's own run."""

import re

import pytest
from exported import SUBJECTS
from iec import Block

import narx_sym as ns

pytest.importorskip("blark")
plcopen = pytest.importorskip("plcopen")

from xsdata.exceptions import ParserError  # noqa: E402
from xsdata.formats.dataclass.parsers import XmlParser  # noqa: E402
from xsdata.formats.dataclass.parsers.config import ParserConfig  # noqa: E402

SECTIONS = {"input_vars": "VAR_INPUT", "output_vars": "VAR_OUTPUT", "local_vars": "VAR", "temp_vars": "VAR_TEMP"}
ELEMENTARY = {"lreal": "LREAL", "real": "REAL", "bool_value": "BOOL", "dint": "DINT", "udint": "UDINT"}
QUICK = ("clock",)
REST = [pytest.param(n, marks=pytest.mark.long) for n in SUBJECTS if n not in (*QUICK, "awkward", "functions")]


def kind_of(kind):
    if kind.array is not None:
        (size,) = kind.array.dimension
        return f"ARRAY [{size.lower}..{size.upper}] OF {kind_of(kind.array.base_type)}"
    if kind.derived is not None:
        return kind.derived.name
    (found,) = [shown for field, shown in ELEMENTARY.items() if getattr(kind, field) is not None]
    return found


def start_of(value):
    if value is None:
        return ""
    return "" if value.simple_value is None else f" := {value.simple_value.value}"


def read(source):
    return (
        XmlParser(config=ParserConfig(fail_on_unknown_attributes=True))
        .from_string(source, plcopen.Project)
        .types.pous.pou
    )


def texts(source):
    """The blocks of a project as Structured Text by name, put together from what the parser read; without lists."""
    found = {}
    for pou in read(source):
        word = {"functionBlock": "FUNCTION_BLOCK", "program": "PROGRAM"}[pou.pou_type.value]
        lines = [f"{word} {pou.name}"]
        for section, keyword in SECTIONS.items():
            for listed in getattr(pou.interface, section):
                declared = [f"    {v.name} : {kind_of(v.type)}{start_of(v.initial_value)};" for v in listed.variable]
                lines += [keyword, *declared, "END_VAR"]
        (body,) = pou.body
        found[pou.name] = "\n".join([*lines, body.st.w3_org_1999_xhtml_element.text, f"END_{word}", ""])
    return found


def program_of(source, change=lambda text: text):
    """The program that tests a block, with its lists filled; `change` is made to the block."""
    block, program = texts(source).values()
    made = Block(change(block) + program)
    (variables,) = read(source)[1].interface.local_vars
    for v in variables.variable:
        if v.type.array is not None:
            numbers = [float(one.simple_value.value) for one in v.initial_value.array_value.value]
            assert len(numbers) == len(made.values[v.name.upper()])
            made.values[v.name.upper()] = dict(enumerate(numbers, start=1))
    return made


@pytest.mark.parametrize("name", (*QUICK, *REST))
def test_its_own_test_passes_on_the_controller(name):
    source = SUBJECTS[name].export("plcopen", "law")
    assert list(texts(source)) == ["law", "law_test"]
    program, scans = program_of(source), int(re.search(r"IF sample &lt; (\d+)", source)[1])
    for i in range(scans):
        assert not program.values["FINISHED"] and not program.values["PASSED"], i
        program.scan()
    assert program.values["FINISHED"] and program.values["PASSED"] and scans >= 48
    program.scan()
    assert program.values["SAMPLE"] == scans  # and rests there


@pytest.mark.parametrize("wrong", (("y_past[1]", "y_past[2]"), pytest.param(("0.4", "0.41"), marks=pytest.mark.long)))
def test_a_wrong_block_fails_its_own_test(wrong):
    mixed = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "Max(u[k-2], y[k-1])"], [0.6, -0.1, 0.4, 0.05])

    def changed(text):
        start, end, step = text.partition("END_IF;")
        assert step.replace(*wrong, 1) != step
        return start + end + step.replace(*wrong, 1)

    program = program_of(mixed.export("plcopen", "law"), changed)
    for _ in range(60):
        program.scan()
    assert program.values["FINISHED"] and not program.values["PASSED"] and program.values["WRONG"] > 0


@pytest.mark.parametrize("name", ("effects",))
def test_the_block_is_that_of_structured_text(name):
    subject = SUBJECTS[name]
    for single in (False, True):
        text, found = (
            subject.export("st", "law", single=single),
            texts(subject.export("plcopen", "law", single=single))["law"],
        )

        def words(source):
            return sorted(re.sub(r"\(\*.*?\*\)", "", source, flags=re.S).replace("\n", " ").split())

        assert words(text) == words(found) and ("LREAL" in found) is not single


def test_a_run_that_tells_nothing_has_no_test():
    wild = ns.NARX.from_terms(["y[k-1]", "y[k-1]**3", "u[k-1]"], [9.0, 9.0, 1.0])
    assert list(texts(wild.export("plcopen", "law"))) == ["law"]


def test_the_parser_refuses_what_is_not_of_the_standard():
    source = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4]).export("plcopen", "law")
    for good, bad in (("inputVars", "inputVariables"), ("pouType=", "type="), ("<LREAL />", "<FLOAT />")):
        with pytest.raises((ParserError, TypeError)):
            texts(source.replace(good, bad))


def test_a_block_may_be_called_as_what_tests_it():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=0.01)
    program = program_of(model.export("plcopen", "sample"))
    for _ in range(60):
        program.scan()
    assert program.values[next(n for n in program.values if n.startswith("PASSED"))] is True
