"""C99 source of a recursion: state in a struct, an init and a step function, no heap, a self-test."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import sympy as sp

from ..engines.writer import indented
from ..errors import ModelError
from ..symbolic.functions import TABLE, Elementary
from .layout import Layout, numbered, shortened, wrapped
from .registry import Example, Request, export
from .steps import StepWriter

PAST = "past"  # the pointer to the state
# Words of C (and of C++ and later C), of its library, of compilers, and of the source itself.
WORDS = set(
    """auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    alignas alignof asm bool class constexpr false namespace new nullptr private public static_assert template this
    thread_local true typeof typeof_unqual using virtual catch delete friend operator protected throw try typename
    acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp2 expm1 fabs fdim floor fma fmax
    fmin fmod fpclassify frexp hypot ilogb isfinite isgreater isgreaterequal isinf isless islessequal islessgreater
    isnan isnormal isunordered ldexp lgamma llrint llround log log10 log1p log2 logb lrint lround math_errhandling modf
    nan nearbyint nextafter nexttoward pow remainder remquo rint round scalbln scalbn signbit sin sinh sqrt tan tanh
    tgamma trunc stdin stdout stderr errno unix linux i386
    main printf none expected sample worst size got gap good count i""".split()
) | {PAST}
# What needs an argument twice is a function of its own in the source.
HELPERS = {row.name.lower(): row for row in TABLE if row.c.count("{x}") > 1}


class _C(StepWriter):
    """The words of C99."""

    language, words = "C source", "c"
    joints, truth = ("&&", "||", "!"), ("0", "1")

    def __init__(self, name: str, single: bool, counter: str):
        super().__init__({}, single)
        self.prefix, self.real, self.mark, self.counter = name, f"{name}_real", "F" if single else "", counter
        self.helpers: set[str] = set()
        self.mathematics = False

    def number(self, value: float) -> str:
        shown = repr(value)
        return (shown if re.search(r"[.e]", shown) else shown + ".0") + self.mark

    def call(self, name: str, *arguments: str) -> str:
        self.mathematics = True
        return super().call(name + ("f" if self.single else ""), *arguments)

    def applied(self, row: Elementary, *arguments: tuple[str, int]) -> str:
        texts, name = [shown for shown, _ in arguments], row.name.lower()
        if name not in HELPERS:
            return self.worded(row, *texts)
        self.helpers.add(name)
        return f"{self.prefix}_{name}({', '.join(texts)})"

    def worded(self, row: Elementary, *arguments: str) -> str:
        """Write a function of texts in its own words."""
        self.mathematics |= "{f}" in row.c
        words = {"zero": self.number(0.0), "one": self.number(1.0), "f": "f" if self.single else ""}
        return row.c.format(**words, **dict(zip("xy", arguments, strict=False)))

    def undefined(self, expr: Any) -> str:
        self.mathematics = True
        return "NAN"

    def define(self, name: str, shown: str, boolean: bool = False) -> list[str]:
        return [f"const {'int' if boolean else self.real} {name} = {shown};"]

    def declare(self, name: str) -> list[str]:
        return [f"{self.real} {name};"]

    def past(self, label: str, index: Any) -> str:
        return f"{PAST}->{label}[{index}]"

    def clock(self) -> str:
        return f"({self.real}){PAST}->{self.counter}"

    def loop(self, start: int, stop: int, line: str) -> list[str]:
        way = f"i <= {stop}; i++" if start <= stop else f"i >= {stop}; i--"
        return [f"for (int i = {start}; {way}) {{", f"    {line}", "}"]

    def definitions(self) -> list[str]:
        """Return the helpers that were used."""
        lines = []
        for name in sorted(self.helpers):
            arguments = "xy" if HELPERS[name].extreme else "x"
            shown, body = ", ".join(f"{self.real} {a}" for a in arguments), self.worded(HELPERS[name], *arguments)
            lines += [f"static {self.real} {self.prefix}_{name}({shown})", "{", f"    return {body};", "}", ""]
        return lines


@export("c", "C99 source", ".c")
def source(request: Request) -> str:
    """Return one self-contained C99 file: `narx_sym.codegen.export.written`."""
    name, recursion, example = request.name, request.recursion, request.example(request.instance)
    layout = layout_of(request)
    labels, inputs, rested = layout.labels, list(recursion.inputs), layout.rested
    # Every state but the one that is returned can be read from the struct.
    depth = {b: 1 for b in recursion.states if b != request.returned} | layout.depth
    clock = numbered("k", lambda free: free not in labels.values())
    writer = _C(name, request.single, clock)
    start, step = _init(layout, depth, writer), _step(layout, depth, writer)
    real = writer.real
    opening = f"void {name}_init({', '.join([f'{name}_state *{PAST}', *(f'{real} {labels[b]}' for b in rested)])})"
    stepping = f"{real} {name}_step({', '.join([f'{name}_state *{PAST}', *(f'{real} {labels[b]}' for b in inputs)])})"
    fields = [
        *(f"{real} {labels[b]}[{d}];" for b, d in depth.items()),
        *[f"unsigned long {clock};"] * layout.counts,
        *(f"{real} {label};" for label in layout.parameters.values()),
    ]
    filling = f"void {name}_defaults({name}_state *{PAST})"
    numbers = [f"{PAST}->{label} = {writer(sp.Float(request.values[p]))};" for p, label in layout.parameters.items()]
    lines = [
        "/*",
        *(f" * {line}".rstrip() for line in _comment(layout, writer, request, example is not None)),
        " */",
        *["#include <math.h>"] * writer.mathematics,
        "",
        f"typedef {'float' if request.single else 'double'} {real};",
        "",
        "typedef struct {",
        *indented(fields or ["char none;"]),
        f"}} {name}_state;",
        "",
        *[f"{filling};"] * bool(numbers),
        f"{opening};",
        f"{stepping};",
        "",
        *writer.definitions(),
        *([filling, "{", *indented(numbers), "}", ""] if numbers else []),
        opening,
        "{",
        *wrapped(start if fields else [f"{PAST}->none = 0;"]),
        "}",
        "",
        stepping,
        "{",
        *wrapped(step if fields else [f"(void){PAST};", *step]),
        "}",
    ]
    return "\n".join([*lines, *(_self_test(layout, writer, example) if example else [])]) + "\n"


def layout_of(request: Request) -> Layout:
    """Return what the source takes, remembers and returns, with the identifiers that it has there."""
    name = request.name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,40}", name):
        raise ModelError(f"{name!r} cannot be a C identifier.")
    own = {name, *(f"{name}_{part}" for part in ("real", "state", "defaults", "init", "step", *HELPERS))}
    return Layout.of(request, _label, WORDS | own)


def _comment(layout: Layout, writer: _C, request: Request, tested: bool) -> list[str]:
    """Return the comment on top: the equations, how the functions are used, and how the source tests itself."""
    name, library = request.name, " -lm" if writer.mathematics else ""
    takes = ", ".join(layout.when(b) for b in request.recursion.inputs) or "nothing"
    none = "No self-test: short runs from rest diverge, or depend on the last bits of the numbers."
    test = f"Self-test: cc -std=c99 -D{name.upper()}_SELF_TEST file.c{library} && ./a.out"
    return layout.comment(
        *request.notes,
        *[f"{name}_defaults gives the parameters in the struct their numbers; call it first."]
        * bool(layout.parameters),
        f"{name}_init fills the past with values at rest; {name}_step takes {takes} and returns "
        f"{layout.output}[k]; further states are in the struct, newest first.",
        f"Pass finite numbers only: a NaN may stay in the past samples until {name}_init is called again.",
        f"No heap, no static data. C99{'; link with -lm' if library else ''}.",
        test if tested else none,
    )


def _init(layout: Layout, depth: Mapping[Any, int], writer: _C) -> list[str]:
    """Return the body of the init function."""
    rest = {b: layout.labels[b] for b in layout.rested}
    start = writer.start(layout, depth, rest, _kept(layout))
    read = set(re.findall(r"(?<![>\w])\w+", "\n".join(start)))  # not the fields of the struct
    unused = [f"(void){label};" for label in rest.values() if label not in read]
    return unused + start + [f"{PAST}->{writer.counter} = {layout.recursion.depth}UL;"] * layout.counts


def _step(layout: Layout, depth: Mapping[Any, int], writer: _C) -> list[str]:
    """Return the body of the step function: the equations, the shift of the past, the value."""
    step = writer.step(layout, depth, _kept(layout), lambda label, shown: f"const {writer.real} {label} = {shown};")
    read = {layout.place(key) for key in layout.plan.sample}
    unused = [f"(void){layout.labels[b]};" for b in layout.recursion.inputs if b not in depth and (b, 0) not in read]
    return [*unused, *step, *[f"{PAST}->{writer.counter}++;"] * layout.counts, f"return {layout.output};"]


def _kept(layout: Layout) -> dict[Any, str]:
    """Return the text of each parameter that stays in the struct."""
    return {p: f"{PAST}->{label}" for p, label in layout.parameters.items()}


def _label(plain: str, taken: set[str]) -> str:
    """Return a C identifier; capitals alone may be a macro."""
    name = shortened(plain, 40)
    return numbered(
        name, lambda n: n not in taken and not re.fullmatch(r"part_\d+", n) and (len(n) == 1 or n.upper() != n)
    )


def _self_test(layout: Layout, writer: _C, example: Example) -> list[str]:
    """Return a main function that steps through the example."""
    name, labels, real = writer.prefix, layout.labels, writer.real

    def literal(value: float) -> str:
        return writer(sp.Float(float(value)))

    def table(label: str, numbers: Any) -> list[str]:
        shown = [literal(v) for v in numbers]
        rows = [", ".join(shown[i : i + 4]) for i in range(0, len(shown), 4)]
        return [f"static const {real} {label}[{len(shown)}] = {{", *indented(f"{row}," for row in rows), "};"]

    def size(of: str) -> str:
        return f"({of} < 0.0 ? -{of} : {of})"

    n, inputs = len(example.expected), layout.recursion.inputs
    body = [
        *(line for b in inputs for line in table(labels[b], example.given[b])),
        *table("expected", example.expected),
        f"{name}_state {PAST};",
        "double worst = 0.0;",
        "int good = 1;",
        *[f"{name}_defaults(&{PAST});"] * bool(layout.parameters),
        f"{name}_init(&{PAST}{''.join(', ' + literal(example.rest[b]) for b in layout.rested)});",
        f"for (int sample = 0; sample < {n}; sample++) {{",
        f"    const double got = (double){name}_step(&{PAST}{''.join(f', {labels[b]}[sample]' for b in inputs)});",
        "    const double size = (double)expected[sample], gap = (got - size) / (1.0 + " + size("size") + ");",
        f"    if (!({size('gap')} <= {example.allowed(writer.single):.3g})) good = 0;",
        f"    if ({size('gap')} > worst) worst = {size('gap')};",
        "}",
        f'printf("{name}: %s, worst relative difference %g\\n", good ? "passed" : "FAILED", worst);',
        "return good ? 0 : 1;",
    ]
    return [
        "", f"#ifdef {name.upper()}_SELF_TEST", "#include <stdio.h>", "int main(void)", "{", *indented(body), "}",
        "#endif",
    ]  # fmt: skip
