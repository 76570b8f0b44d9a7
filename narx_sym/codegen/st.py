"""IEC 61131-3 Structured Text of a recursion: a function block with its state, that starts from rest."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any, ClassVar

import sympy as sp

from ..engines.writer import RELATIONS
from ..errors import ModelError
from .layout import Layout, numbered, shortened, wrapped
from .registry import Request, export
from .steps import UNROLLED, StepWriter

LONGEST = 24  # letters of a name: with its ending it keeps to the 32 that every compiler reads
# Keywords of the standard's editions and of common compilers, names of its functions and function blocks.
WORDS = set(
    """abs abstract acos action add and and_then andn any any_bit any_date any_derived any_elementary any_int
    any_magnitude any_num any_real any_string array asin at atan atan2 bit bool by byte cal calc calcn case cd cdt
    char class clk concat configuration constant continue cos ct ctd ctu ctud cu cv d date date_and_time delete dint
    div do ds dt dword else elsif en end_action end_case end_class end_configuration end_for end_function
    end_function_block end_if end_interface end_method end_namespace end_program end_property end_repeat end_resource
    end_step end_struct end_transition end_type end_union end_var end_while eno eq et exit exp expt extends f_edge
    f_trig false final find for from function function_block ge gt if implements in initial_step insert int interface
    internal interval jmp jmpc jmpcn l ld ldate ldn ldt le left len limit lint ln log lower_bound lreal lt ltime ltod
    lword max method mid min mod move mul mux n namespace ne neg non_retain not null of on or or_else orn overlap
    override p persistent pi pointer pragma priority private program property protected pt public pv q q1 qd qu r r1
    r_edge r_trig read_only read_write real ref ref_to reference release repeat replace resource ret retain retc
    retcn return right rol ror round rs rtc s s1 sd sel sema shl shr sin single sint sizeof sl split sqrt sr st step
    stn stop string struct sub super t tan task then this time time_of_day to tod tof ton tp transition true trunc
    type udint uint ulint union until upper_bound using usint utf8 var var_access var_config var_external var_global
    var_in_out var_input var_inst var_output var_stat var_temp wchar while with word write wstring xor xorn""".split()
)
ENDINGS = ("", "_past", "_rest")


class _ST(StepWriter):
    """The words of Structured Text; `locals` collects the parts, which are declared in front."""

    language, words = "Structured Text", "st"
    relations: ClassVar[Mapping[Any, str]] = {**RELATIONS, sp.Equality: "=", sp.Unequality: "<>"}
    joints, truth, first = ("AND", "OR", "NOT "), ("FALSE", "TRUE"), 1
    assigning, choosing = "{name} := {shown};", ("IF {condition} THEN", "ELSE", "END_IF;")

    def __init__(self, single: bool):
        super().__init__({}, single)
        self.real = "REAL" if single else "LREAL"
        self.locals: list[Variable] = []

    def number(self, value: float) -> str:
        mantissa, _, exponent = repr(value).partition("e")
        mantissa += "" if "." in mantissa else ".0"
        return f"{mantissa}E{exponent}" if exponent else mantissa

    def power(self, base: str, exponent: str) -> str:
        # A literal by itself would be of single precision for some compilers.
        return self.call("EXPT", base, f"{self.real}#{exponent}" if exponent[:1].isdigit() else exponent)

    def undefined(self, expr: Any) -> str:
        raise ModelError(f"In Structured Text a Piecewise needs a last case that is always true: {expr} has none.")

    def define(self, name: str, shown: str, boolean: bool = False) -> list[str]:
        self.locals.append(Variable(name, "BOOL" if boolean else self.real))
        return [self.assign(name, shown)]

    def declare(self, name: str) -> list[str]:
        self.locals.append(Variable(name, self.real))
        return []

    def past(self, label: str, index: Any) -> str:
        return f"{label}_past[{index}]"

    def clock(self) -> str:
        return f"UDINT_TO_{self.real}(k)"

    def loop(self, start: int, stop: int, line: str) -> list[str]:
        return [f"FOR i := {start} TO {stop}{' BY -1' * (stop < start)} DO", f"    {line}", "END_FOR;"]


@dataclass(frozen=True)
class Variable:
    """One declaration; an array where it has a size, its start is then a list."""

    name: str
    kind: str
    size: int = 0
    start: str | tuple[str, ...] = ""

    @property
    def text(self) -> str:
        """The line that declares it."""
        kind = f"ARRAY [1..{self.size}] OF {self.kind}" if self.size else self.kind
        start = f"[{', '.join(self.start)}]" if isinstance(self.start, tuple) else self.start
        return f"{self.name} : {kind}{f' := {start}' if start else ''};"


@dataclass(frozen=True)
class Block:
    """A function block, or a program: its comment, what it declares (by VAR_INPUT and so on), and its statements."""

    name: str
    comment: list[str]
    declared: Mapping[str, list[Variable]]
    body: list[str]
    kind: str = "FUNCTION_BLOCK"

    @property
    def text(self) -> str:
        """The source."""
        sections = [
            [section, *wrapped(v.text for v in listed), "END_VAR"]
            for section, listed in self.declared.items()
            if listed
        ]
        lines = ["(*", *(f"  {line}".rstrip() for line in self.comment), "*)", f"{self.kind} {self.name}"]
        return "\n".join([*lines, *chain(*sections), "", *self.body, f"END_{self.kind}"]) + "\n"


@export("st", "Structured Text", ".st")
def source(request: Request) -> str:
    """Return one function block: `narx_sym.codegen.export.written`."""
    return block(request).text


def layout_of(request: Request) -> Layout:
    """Return what the block takes, remembers and returns, with the identifiers that it has there."""
    name = request.name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", name) or len(name) > 32 or name.lower() in WORDS:
        raise ModelError(f"{name!r} cannot be the name of a function block.")
    return Layout.of(request, label, {name.lower(), "restart", "started", "i", "k"})


def block(request: Request) -> Block:
    """Return the function block of a recursion."""
    recursion, returned, layout = request.recursion, request.returned, layout_of(request)
    labels, depth = layout.labels, layout.depth
    writer = _ST(request.single)
    real, inputs = writer.real, list(recursion.inputs)
    rest = {b: labels[b] if b in inputs else f"{labels[b]}_rest" for b in layout.rested}
    start = [
        *writer.start(layout, depth, rest, {}), *[f"k := {recursion.depth};"] * layout.counts, "started := TRUE;",
    ]  # fmt: skip
    step = [*writer.step(layout, depth, {}, writer.assign), *["k := k + 1;"] * layout.counts]
    takes = ", ".join(layout.when(b) for b in inputs) or "nothing"
    comment = layout.comment(
        *request.notes,
        f"Call it once per sample with {takes}; it gives {layout.output}[k].",
        "In its first call, and whenever restart is TRUE, it starts from rest: the inputs have their present values, "
        "the other signals those whose names end in _rest.",
        "Pass finite numbers only: a NaN may stay in the past samples until restart is TRUE.",
    )
    declared = {
        "VAR_INPUT": [
            *(Variable(labels[b], real) for b in inputs),
            *(Variable(f"{labels[b]}_rest", real, start=writer.number(0.0)) for b in layout.rested if b not in inputs),
            Variable("restart", "BOOL", start="FALSE"),
        ],
        "VAR_OUTPUT": [Variable(labels[returned], real)],
        "VAR": [
            *(Variable(labels[b], real) for b in recursion.states if b != returned),
            *(Variable(f"{labels[b]}_past", real, d) for b, d in depth.items()),
            *[Variable("k", "UDINT")] * layout.counts,
            Variable("started", "BOOL", start="FALSE"),
        ],
        "VAR_TEMP": [*[Variable("i", "DINT")] * any(d > UNROLLED for d in depth.values()), *writer.locals],
    }
    body = ["IF restart OR NOT started THEN", *wrapped(start), "END_IF;", *(line[4:] for line in wrapped(step))]
    return Block(request.name, comment, declared, body)


def number(value: float, single: bool = False) -> str:
    """Return a number as a literal."""
    return _ST(single)(sp.Float(value))


def label(plain: str, taken: set[str]) -> str:
    """Return an identifier that means nothing else, whatever the case of its letters."""
    used = {n.lower() + ending for n in taken for ending in ENDINGS}

    def free(name: str) -> bool:
        mine = {name.lower() + ending for ending in ENDINGS}
        return not mine & (used | WORDS) and not re.fullmatch(r"part_\d+", name.lower())

    return numbered(shortened(plain, LONGEST), free)
