"""A recursion as an FMU for co-simulation, FMI 3.0 or 2.0: its C source, a binary, and a description.

The communication step is a multiple of the sampling time. A step takes the inputs as they are at its beginning. Nothing
can be set between a step and what is read after it: an output that needs no newer input is the one at the end of the
step; one that answers an input at once, as that of every law, is the one of the sample that the step took, so one
sample late. The functions of the standard stand in the folder `fmi`.
"""

from __future__ import annotations

import hashlib
import io
import platform
import shutil
import subprocess
import tempfile
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

from ..engines.writer import indented
from ..errors import ModelError
from ..symbolic.signals import t
from .c import layout_of, source
from .layout import Layout, numbered, plain
from .markup import document, element
from .registry import Request, export

COMPILERS = ("cc", "gcc", "clang")
LONGEST_COMPILATION = 120  # [s]
FOLDERS = {  # of binaries: system, machine, in FMI 3.0 and in 2.0
    ("Linux", "x86_64"): ("x86_64-linux", "linux64"),
    ("Linux", "aarch64"): ("aarch64-linux", ""),
    ("Darwin", "x86_64"): ("x86_64-darwin", "darwin64"),
    ("Darwin", "arm64"): ("aarch64-darwin", ""),
    ("Windows", "AMD64"): ("x86_64-windows", "win64"),
}
ENDINGS = {"Linux": ".so", "Darwin": ".dylib", "Windows": ".dll"}
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file inside: the same model gives the same bytes


@dataclass(frozen=True)
class Variable:
    """One variable of an FMU; its value reference is its place in the list.

    `kind` is "t" for time, "i" for an input, "o" for the output, "p" for a parameter, "r" for a value at rest.
    """

    kind: str
    name: str
    about: str
    start: float = 0.0
    unit: str = ""
    range: tuple[float, float] | None = None


@export("fmu", "FMU, FMI 3.0", ".fmu")
def fmi_3(request: Request) -> bytes:
    """Return the FMU as bytes; see `narx_sym.codegen.targets.export_model`."""
    return _archive(request, 3)


@export("fmu2", "FMU, FMI 2.0")
def fmi_2(request: Request) -> bytes:
    """Return the FMU as bytes; see `narx_sym.codegen.targets.export_model`."""
    return _archive(request, 2)


def _archive(request: Request, version: int) -> bytes:
    if request.Ts is None:
        raise ModelError("An FMU needs the sampling time of its model: model.replace(Ts=...).")
    request = replace(request, instance=True)
    layout = layout_of(request)
    listed = _variables(request, layout)
    described, code = _description(request, layout, listed, version), _source(request, layout, listed, version)
    digest = hashlib.sha256(Xml.tostring(described) + code.encode("ascii")).hexdigest()
    token = "{" + "-".join(digest[a:b] for a, b in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"
    described.set("instantiationToken" if version == 3 else "guid", token)
    code = f'#define FMI_TOKEN "{token}"\n{code}'
    files = {"modelDescription.xml": document(described).encode(), f"sources/{request.name}.c": code.encode("ascii")}
    if version == 3:
        files["sources/buildDescription.xml"] = document(_build(request.name)).encode()
    files |= _binary(request.name, code, version)
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, EPOCH), content, zipfile.ZIP_DEFLATED)
    return made.getvalue()


def _variables(request: Request, layout: Layout) -> list[Variable]:
    """Return time, the inputs, the output, the parameters and the values at rest."""
    labels, taken = layout.labels, {"time"}

    def named(label: str) -> str:
        taken.add(name := numbered(label, lambda one: one not in taken))
        return name

    def about(base: Any, what: str) -> str:
        known = request.ranges.get(base.name)
        where = f", identified between {known[0]:.6g} and {known[1]:.6g}" if known else ""
        return f"{what} {plain(base)}{where}"

    def signal(kind: str, base: Any, name: str, what: str, ranged: bool) -> Variable:
        own = base.name
        rest, known = request.rest.get(own, 0.0), request.ranges.get(own)
        limits = (known[0], known[1]) if ranged and known and known[0] <= rest <= known[1] else None
        return Variable(kind, named(name), about(base, what), rest, _unit(request.units, own), limits)

    listed = [Variable("t", "time", "time", unit="s")]
    for base in (b for b in layout.recursion.inputs if b != t):
        ahead = -layout.newest[base]
        what = f"input, {ahead} sample{'s' * (ahead > 1)} ahead," if ahead else "input"
        listed.append(signal("i", base, labels[base], what, True))
    what = "output, one sample late," if _late(layout) else "output"
    listed.append(signal("o", request.returned, layout.output, what, False))
    listed += [
        Variable("p", named(label), f"parameter {plain(p)}", float(request.values[p]))
        for p, label in layout.parameters.items()
    ]
    rested = (b for b in layout.rested if b != t and not _settles(request, b))
    return [*listed, *(signal("r", b, f"{labels[b]}_rest", "value before the start of", False) for b in rested)]


def _settles(request: Request, base: Any) -> bool:
    """Whether a sequence is an input that was at rest, before the start, at what it begins with."""
    return request.settles and base in request.recursion.inputs


def _unit(units: Mapping[str, str], name: str) -> str:
    unit = units.get(name, "")
    if not unit.isprintable():
        raise ModelError(f"The unit of {name} holds characters that cannot be printed.")
    return unit


# -- the source ------------------------------------------------------------------------------------------------


def _source(request: Request, layout: Layout, listed: list[Variable], version: int) -> str:
    """Return one file: the exported source, how its functions are called, and the functions of the standard."""
    exported = source(request)
    folder = Path(__file__).with_name("fmi")
    types, common, functions = (
        (folder / f"{name}.c").read_text(encoding="ascii") for name in (f"types{version}", "common", f"fmi{version}")
    )
    return "\n".join([exported, types, *_glue(request, layout, listed), "", common, functions])


def _glue(request: Request, layout: Layout, listed: list[Variable]) -> list[str]:
    """Return how the values of an instance reach the exported functions."""
    name = request.name
    order = {kind: [i for i, v in enumerate(listed) if v.kind == kind] for kind in "iopr"}
    taking, resting, keeping = (iter(order[kind]) for kind in "irp")
    clock = f"time + {-layout.newest[t]} * FMI_TS" if layout.newest.get(t) else "time"  # of the newest sample
    steps = [f"({clock})" if b == t else f"value[{next(taking)}]" for b in layout.recursion.inputs]
    begins = dict(zip((b for b in layout.recursion.inputs if b != t), order["i"], strict=True))
    rests = [
        "time" if b == t else f"value[{begins[b] if _settles(request, b) else next(resting)}]" for b in layout.rested
    ]
    filled = [f"past->{label} = ({name}_real)value[{next(keeping)}];" for label in layout.parameters.values()]
    unused = ["(void)value;", "(void)time;"]
    given = f"{name}_state *past, const double value[], double time"
    return [
        f"#define FMI_IDENTIFIER {name}",
        f"#define FMI_TS {request.Ts!r}",
        f"#define FMI_COUNT {len(listed)}",
        f"#define FMI_LATE {int(_late(layout))}",
        f"typedef {name}_state fmi_memory;",
        f"static const double fmi_first[FMI_COUNT] = {{{', '.join(repr(v.start) for v in listed)}}};",
        f'static const char fmi_kind[] = "{"".join(v.kind for v in listed)}";',
        *["", f"static void fmi_begin({given})", "{"],
        *indented([*unused, *filled, f"{name}_init({', '.join(['past', *(f'({name}_real){r}' for r in rests)])});"]),
        *["}", "", f"static double fmi_next({given})", "{"],
        *indented(
            [*unused, *filled, f"return {name}_step({', '.join(['past', *(f'({name}_real){s}' for s in steps)])});"]
        ),
        "}",
    ]


def _binary(name: str, code: str, version: int) -> dict[str, bytes]:
    """Return the binary for this machine by its place in the archive; nothing, and a warning, where there is none."""
    system = platform.system()
    folder = FOLDERS.get((system, platform.machine()), ("", ""))[3 - version]
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)

    def without(why: str) -> dict[str, bytes]:
        warnings.warn(f"The FMU holds its source, but no binary: {why}", stacklevel=3)
        return {}

    if not folder or compiler is None:
        return without("no C compiler was found." if folder else f"FMI {version}.0 has no name for this machine.")
    file = name + ENDINGS[system]
    with tempfile.TemporaryDirectory() as work:
        command = [
            compiler, "-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden",
            f"-DFMI{version}_OVERRIDE_FUNCTION_PREFIX", "-x", "c", "-", "-o", file, "-lm",
        ]  # fmt: skip
        options: Any = {"cwd": work, "capture_output": True, "text": True, "timeout": LONGEST_COMPILATION}
        try:
            ran = subprocess.run(command, input=code, **options)
        except (OSError, subprocess.TimeoutExpired) as error:
            return without(f"{compiler}: {error}.")
        if ran.returncode:
            return without(f"{compiler} says: {ran.stderr.strip()[:300]}")
        return {f"binaries/{folder}/{file}": Path(work, file).read_bytes()}


def _late(layout: Layout) -> bool:
    """Whether the output answers an input at once: what a step ends with is then one sample old."""
    delays, inputs = layout.recursion.graph.delays, (b for b in layout.recursion.inputs if b != t)
    # On every slower way a sample is older.
    return any(delays(b)[layout.request.returned] == layout.newest[b] for b in inputs)


# -- the description -------------------------------------------------------------------------------------------


def _description(request: Request, layout: Layout, listed: list[Variable], version: int) -> Any:
    """Return modelDescription.xml."""
    name, Ts = request.name, repr(request.Ts)
    exchange = {"modelIdentifier": name, "canHandleVariableCommunicationStepSize": "true"}
    sources = [] if version == 3 else [element("SourceFiles", {}, element("File", {"name": f"{name}.c"}))]
    units, output = sorted({v.unit for v in listed} - {""}), next(i for i, v in enumerate(listed) if v.kind == "o")
    # A step decides the output, so it depends on no input that is set after the step.
    if version == 3:
        own, exchange = {"valueReference": str(output)}, exchange | {"fixedInternalStepSize": Ts}
        structure = [element("Output", own | {"dependencies": ""}), element("InitialUnknown", own)]
    else:
        own = {"index": str(output + 1)}  # FMI 2.0 counts from 1
        structure = [
            element("Outputs", {}, element("Unknown", own | {"dependencies": ""})),
            element("InitialUnknowns", {}, element("Unknown", own)),
        ]
    return element(
        "fmiModelDescription",
        {"fmiVersion": f"{version}.0", "modelName": name, "description": _said(request, layout),
         "generationTool": "narx_sym", "variableNamingConvention": "flat"},
        element("CoSimulation", exchange, *sources),
        element("UnitDefinitions", {}, *(element("Unit", {"name": unit}) for unit in units)),
        element("LogCategories", {}, element("Category", {"name": "logStatusError"})),
        element("DefaultExperiment", {"startTime": "0", "stepSize": Ts}),
        element("ModelVariables", {}, *(_variable(place, one, version) for place, one in enumerate(listed))),
        element("ModelStructure", {}, *structure),
    )  # fmt: skip


def _said(request: Request, layout: Layout) -> str:
    """Say what a step takes, and what it ends with."""
    output, late = layout.output, _late(layout)
    takes = ", ".join(layout.when(b) for b in layout.recursion.inputs if b != t) or "nothing"
    ends = f"{output}[k]; to have {output} in time, give the inputs one sample earlier" if late else f"{output}[k+1]"
    heading = f"{layout.heading} " if layout.heading else ""
    steps = f"the step that begins at sample k takes {takes} and ends with {ends}"
    return f"{heading}{output} every {request.Ts:.10g} s: {steps}"


def _variable(place: int, one: Variable, version: int) -> Any:
    causality, variability = {
        "t": ("independent", "continuous"), "i": ("input", "continuous"), "o": ("output", "continuous"),
        "p": ("parameter", "tunable"), "r": ("parameter", "fixed"),
    }[one.kind]  # fmt: skip
    shared = {
        "name": one.name, "valueReference": str(place), "description": one.about,
        "causality": causality, "variability": variability,
    }  # fmt: skip
    if one.kind in "opr":
        shared["initial"] = "calculated" if one.kind == "o" else "exact"
    number = {"start": repr(one.start)} if one.kind in "ipr" else {}
    number |= {"unit": one.unit} if one.unit else {}
    number |= {"min": repr(float(one.range[0])), "max": repr(float(one.range[1]))} if one.range else {}
    if version == 3:
        return element("Float64", shared | number)
    return element("ScalarVariable", shared, element("Real", number))


def _build(name: str) -> Any:
    """Return buildDescription.xml of FMI 3.0."""
    files = element("SourceFileSet", {"language": "C99"}, element("SourceFile", {"name": f"{name}.c"}))
    configuration = element("BuildConfiguration", {"modelIdentifier": name}, files)
    return element("fmiBuildDescription", {"fmiVersion": "3.0"}, configuration)
