"""C99 source of a recursion: state in a struct, an init and a step function, no heap, a self-test."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import sympy as sp
from sympy.printing.c import C99CodePrinter

from ..errors import ModelError
from ..printing import text
from ..recursion import Recursion
from .plan import Plan

CHECKED = 24  # samples of the self-test
PAST = "past"  # the pointer to the state
# Words of C, of its mathematics, and of the source itself: signals of these names get an underscore behind them.
WORDS = set(
    """auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp2 expm1 fabs fdim floor fma fmax
    fmin fmod fpclassify frexp hypot ilogb isfinite isgreater isgreaterequal isinf isless islessequal islessgreater
    isnan isnormal isunordered ldexp lgamma llrint llround log log10 log1p log2 logb lrint lround math_errhandling modf
    nan nearbyint nextafter nexttoward pow remainder remquo rint round scalbln scalbn signbit sin sinh sqrt tan tanh
    tgamma trunc HUGE_VAL INFINITY NAN
    main printf none expected sample worst got gap good""".split()
) | {PAST}


class _Printer(C99CodePrinter):
    """Products instead of pow, literals of the wanted precision, and an error for what C cannot say."""

    def __init__(self, single: bool):
        super().__init__({"precision": 17})
        self.mark = "F" if single else ""

    def _print_Float(self, expr: Any) -> str:
        shown = f"{float(expr):.17g}"
        return (shown if re.search(r"[.e]", shown) else shown + ".0") + self.mark

    def _print_Integer(self, expr: Any) -> str:
        return f"{int(expr)}.0{self.mark}"

    def _print_Rational(self, expr: Any) -> str:
        return f"({int(expr.p)}.0{self.mark}/{int(expr.q)}.0{self.mark})"

    def _print_Pi(self, expr: Any) -> str:
        return self._print_Float(expr)  # C99 itself has no M_PI

    def _print_Exp1(self, expr: Any) -> str:
        return self._print_Float(expr)

    def _print_Dummy(self, expr: Any) -> str:
        return str(expr.name)

    def _print_Pow(self, expr: Any) -> str:
        base, exponent = expr.as_base_exp()
        if exponent.is_Integer:
            shown = "*".join([f"({self._print(base)})"] * abs(int(exponent)))
            return shown if exponent > 0 else f"(1.0{self.mark}/({shown}))"
        if exponent == sp.Rational(1, 2):
            return f"{self._call('sqrt')}({self._print(base)})"
        return f"{self._call('pow')}({self._print(base)}, {self._print(exponent)})"

    def _print_sign(self, expr: Any) -> str:
        x = self._print(expr.args[0])
        one, zero = f"1.0{self.mark}", f"0.0{self.mark}"
        return f"(({x}) > {zero} ? {one} : (({x}) < {zero} ? -{one} : {zero}))"

    def _print_Abs(self, expr: Any) -> str:
        return f"{self._call('fabs')}({self._print(expr.args[0])})"

    def _print_Heaviside(self, expr: Any) -> str:
        return f"(({self._print(expr.args[0])}) > 0.0{self.mark} ? 1.0{self.mark} : 0.0{self.mark})"

    def _extreme(self, name: str, arguments: Any) -> str:
        shown = self._print(arguments[0])
        for argument in arguments[1:]:
            shown = f"{self._call(name)}({shown}, {self._print(argument)})"
        return shown

    def _print_Max(self, expr: Any) -> str:
        return self._extreme("fmax", expr.args)

    def _print_Min(self, expr: Any) -> str:
        return self._extreme("fmin", expr.args)

    def _print_Function(self, expr: Any) -> str:
        name = type(expr).__name__
        if name not in ("sin", "cos", "tan", "tanh", "sinh", "cosh", "exp", "log", "atan", "asin", "acos"):
            raise ModelError(f"C source has no rule for {name} in {expr}.")
        return f"{self._call(name)}({self._print(expr.args[0])})"

    _print_sin = _print_cos = _print_tan = _print_tanh = _print_exp = _print_log = _print_atan = _print_Function
    _print_sinh = _print_cosh = _print_asin = _print_acos = _print_Function

    def _call(self, name: str) -> str:
        return name + ("f" if self.mark else "")


def source(
    recursion: Recursion,
    values: Mapping[Any, float],
    name: str = "narx",
    single: bool = False,
    example: tuple[Mapping[str, Any], Any, Mapping[str, float]] | None = None,
    output: Any = None,
) -> str:
    """Return one self-contained C99 file.

    Parameters
    ----------
    recursion : Recursion
    values : mapping from each parameter to its number
    name : str
        Prefix of the type and the functions.
    single : bool
        float instead of double.
    example : (inputs by name, expected output, rest values by name), optional
        Samples for the self-test, compiled with -D<NAME>_SELF_TEST.
    output : IndexedBase, optional
        The state that a step returns; the last by default.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,40}", name):
        raise ModelError(f"{name!r} cannot be a C identifier.")
    plan = Plan.of(recursion.subs({p: sp.Float(v) for p, v in values.items()}))
    if plan.parameters:
        raise ModelError(f"No value was given for {', '.join(map(str, plan.parameters))}.")
    if any(c.has(Plan.time) for c in plan.updates):
        raise ModelError("An equation with the time index itself cannot be exported.")
    printer, states = _Printer(single), range(len(plan.updates))
    returned = len(plan.updates) - 1 if output is None else recursion.states.index(output)
    labels = _labels(plan, name)
    oldest = {s: max([i for j, i in plan.sample if j == s]) for s in range(len(plan.signals))}
    ahead = {s: min([i for j, i in plan.sample if j == s]) for s in range(len(plan.signals)) if s not in states}
    # Every state but the one that is returned can be read from the struct.
    depth = {s: max(oldest[s], int(s != returned)) if s in states else oldest[s] - ahead[s] for s in oldest}
    held = [s for s in range(len(plan.signals)) if depth[s] > 0]

    def sample(s: int, i: int) -> str:
        back = i if s in states else i - ahead[s]
        return f"{PAST}->{labels[s]}[{back - 1}]" if back else labels[s]

    real, upper = f"{name}_real", name.upper()
    inputs = [s for s in range(len(plan.signals)) if s not in states]
    arguments = "".join(f", {real} {labels[s]}" for s in inputs)
    rest = "".join(f", {real} {labels[s]}" for s in held)
    body = [
        f"const {real} {symbol.name} = {sample(s, i)};"
        for (s, i), symbol in plan.sample.items()
        if s not in states or i
    ]
    common, rows = plan.shared
    waiting = dict(common)

    for s in states:
        for c in rows[s]:
            body += [f"const {real} {x.name} = {printer.doprint(e)};" for x, e in plan.needed(c, waiting)]
        shown = printer.doprint(rows[s][-1])
        for c in reversed(rows[s][:-1]):
            shown = f"{printer.doprint(c)} + ({shown})*{plan.sample[s, 1].name}"
        body.append(f"const {real} {plan.sample[s, 0].name} = {shown};")
    for s in held:
        body += [f"{PAST}->{labels[s]}[{i}] = {PAST}->{labels[s]}[{i - 1}];" for i in range(depth[s] - 1, 0, -1)]
        body.append(f"{PAST}->{labels[s]}[0] = {plan.sample[s, 0].name if s in states else labels[s]};")
    equations = [f"{text(left)} = {text(right)}" for left, right in recursion.subs(dict(values)).updates]
    when = ", ".join(f"{labels[s]}[k{-ahead[s]:+d}]" if ahead[s] else f"{labels[s]}[k]" for s in inputs)
    lines = [
        "/*",
        *(f" * {part}" for e in equations for part in _wrapped(e)),
        " *",
        f" * {name}_init fills the past with rest values; {name}_step takes {when or 'nothing'}",
        f" * and returns {labels[returned]}[k]; further states are in the struct, newest first.",
        " * No heap, no static data. C99; link with -lm.",
        f" * Self-test: cc -std=c99 -D{upper}_SELF_TEST file.c -lm && ./a.out",
        " */",
        "#include <math.h>",
        "",
        f"typedef {'float' if single else 'double'} {real};",
        "",
        "typedef struct {",
        *(f"    {real} {labels[s]}[{depth[s]}];" for s in held),
        *([] if held else ["    char none;"]),
        f"}} {name}_state;",
        "",
        f"void {name}_init({name}_state *{PAST}{rest});",
        f"{real} {name}_step({name}_state *{PAST}{arguments});",
        "",
        f"void {name}_init({name}_state *{PAST}{rest})",
        "{",
        *(f"    {PAST}->{labels[s]}[{i}] = {labels[s]};" for s in held for i in range(depth[s])),
        *([] if held else [f"    {PAST}->none = 0;"]),
        "}",
        "",
        f"{real} {name}_step({name}_state *{PAST}{arguments})",
        "{",
        *([] if held else [f"    (void){PAST};"]),
        *(f"    {line}" for line in body),
        f"    return {plan.sample[returned, 0].name};",
        "}",
    ]
    if example is not None:
        plain = {label: str(base.label) for label, base in zip(labels, plan.signals, strict=True)}
        read, rested = ({labels[s]: plain[labels[s]] for s in listed} for listed in (inputs, held))
        lines += _self_test(name, real, read, rested, example, printer)
    return "\n".join(lines) + "\n"


def _labels(plan: Plan, name: str) -> list[str]:
    """Return a C identifier for each signal that means nothing else in the source."""
    taken = WORDS | {name, *(f"{name}_{part}" for part in ("real", "state", "init", "step"))}
    taken |= {symbol.name for symbol in (*plan.sample.values(), *(symbol for symbol, _ in plan.shared[0]))}
    labels = []
    for base in plan.signals:
        label = re.sub(r"\W|^(?=\d)", "_", str(base.label), flags=re.ASCII)
        while label in taken:
            label += "_"
        taken.add(label)
        labels.append(label)
    return labels


def _wrapped(equation: str, width: int = 100) -> list[str]:
    import textwrap

    # A comment must not end early.
    return textwrap.wrap(equation.replace("*/", "* /"), width, break_long_words=False, break_on_hyphens=False)


def _self_test(
    name: str,
    real: str,
    inputs: Mapping[str, str],
    held: Mapping[str, str],
    example: tuple[Any, ...],
    printer: _Printer,
) -> list[str]:
    """Return a main function; `inputs` and `held` give the signal behind each identifier."""
    given, expected, rest = example
    n = min(CHECKED, len(expected))
    number = lambda v: printer.doprint(sp.Float(float(v)))  # noqa: E731
    tolerance = "1e-4" if printer.mark else "1e-12"
    return [
        "",
        f"#ifdef {name.upper()}_SELF_TEST",
        "#include <stdio.h>",
        "int main(void)",
        "{",
        *(
            f"    static const {real} {i}[{n}] = {{{', '.join(number(v) for v in given[of][:n])}}};"
            for i, of in inputs.items()
        ),
        f"    static const {real} expected[{n}] = {{{', '.join(number(v) for v in expected[:n])}}};",
        f"    {name}_state {PAST};",
        "    int sample;",
        "    double worst = 0.0;",
        f"    {name}_init(&{PAST}{''.join(', ' + number(rest[of]) for of in held.values())});",
        f"    for (sample = 0; sample < {n}; sample++) {{",
        f"        const double got = (double){name}_step(&{PAST}{''.join(f', {i}[sample]' for i in inputs)});",
        "        const double gap = fabs(got - (double)expected[sample]) / (1.0 + fabs((double)expected[sample]));",
        "        if (!(gap <= worst)) worst = gap;",
        "    }",
        f"    const int good = worst <= {tolerance};",
        f'    printf("{name}: %s, worst relative difference %g\\n", good ? "passed" : "FAILED", worst);',
        "    return good ? 0 : 1;",
        "}",
        "#endif",
    ]
