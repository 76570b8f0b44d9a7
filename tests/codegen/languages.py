"""How what each target of an export writes is run: one function for each, over the steps of a `Subject`."""

import re
import shutil
import subprocess

import javascript
import numpy as np
import pytest
from exported import of
from iec import Block

import narx_sym as ns
from narx_sym.fit.simulate import rest_states

TS = 0.01
gcc = shutil.which("gcc")
needs_gcc = pytest.mark.skipif(gcc is None, reason="no C compiler here")
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2"]


def built(folder, source, *flags):
    """Compile a source into a program in its folder."""
    if gcc is None:
        pytest.skip("no C compiler here")
    path = folder / "x.c"
    path.write_text(source, encoding="utf-8")
    subprocess.run([gcc, *FLAGS, *flags, path, "-o", folder / "x", "-lm"], check=True, capture_output=True, text=True)
    return folder / "x"


def self_tested(folder, source, name):
    """What the self-test of a C source prints, and whether it ends well."""
    told = subprocess.run(
        [built(folder, source, f"-D{name.upper()}_SELF_TEST")], cwd=folder, capture_output=True, text=True
    )
    return ("passed" if told.returncode == 0 and "passed" in told.stdout else "FAILED", told.stdout)


def arguments(source, function):
    """The signals that a function takes, as its header names them."""
    return re.search(rf"{function}\(\w+_state \*past(.*?)\);", source).group(1).replace(",", " ").split()[1::2]


def stepped(folder, source, name, steps, rest):
    """Step an exported source over arrays, in the order of its own arguments: all by a main of a few lines."""
    takes = arguments(source, f"{name}_step")
    n = len(next(iter(steps.values()))) if steps else 100
    body = f"""
    #include <stdio.h>
    int main(void) {{
        {name}_state s; double row[{len(takes) + 1}] = {{0.0}};
        {name}_init({", ".join(["&s", *(f"{v!r}" for v in rest)])});
        while (fread(row, sizeof(double), {max(1, len(takes))}, stdin) == {max(1, len(takes))}) {{
            const double out = (double){name}_step({", ".join(["&s", *(f"({name}_real)row[{i}]" for i in range(len(takes)))])});
            fwrite(&out, sizeof(double), 1, stdout);
        }}
        return 0;
    }}"""
    rows = np.column_stack(list(steps.values())) if steps else np.zeros((n, 1))
    ran = subprocess.run([built(folder, source + body)], input=rows.tobytes(), capture_output=True, check=True)
    return np.frombuffer(ran.stdout)


def at_rest(subject, label):
    """The value at rest of a signal by its identifier, as it stands in an exported text."""
    name = re.sub(r"_sig\d*$", "", label)
    return subject.at_rest(name) if name != "t" else 0.0


def in_c(source, subject, n, folder):
    rest = [at_rest(subject, a) for a in arguments(source, "x1_init")]
    return stepped(folder, source, "x1", subject.steps(n), rest)


def in_st(source, subject, n, folder):
    pytest.importorskip("blark")
    block, steps = Block(source), list(subject.steps(n).values())
    takes = block.inputs[: len(steps)]  # in the order of the recursion's
    others = [name for name in block.inputs[len(steps) :] if name != "RESTART"]
    rest = {name: at_rest(subject, name.removesuffix("_REST").lower()) for name in others}
    rows = zip(*steps, strict=True) if steps else [()] * n
    return np.array([block.scan(**dict(zip(takes, map(float, row), strict=True)), **rest) for row in rows])


def in_plcopen(source, subject, n, folder):
    pytest.importorskip("plcopen")
    from test_plcopen import texts

    return in_st(texts(source)["x1"], subject, n, folder)


def in_casadi(function, subject, n, folder):
    state, found = subject.thing.rest_state(**(subject.rest or {"u": 0.3, "y": 0.3})), []
    for (x,) in zip(*subject.steps(n, sampled=True).values(), strict=True):
        state, output = function(state, [x])
        found.append(float(output))
    return np.array(found)


def in_js(source, subject, n, folder):
    if why := javascript.why_no_javascript():
        pytest.skip(why)
    depth, output = subject.recursion.depth, subject.output.name
    held = [np.concatenate([np.full(depth, x[0]), x]) for x in subject.waves(n).values()]
    if isinstance(subject.thing, ns.Compensator):
        begin = subject.thing.start(subject.at_rest("r"), subject.at_rest("m"))
    else:
        begin = rest_states(subject.thing, subject.at_rest("u"), subject.at_rest("y")) | {
            output: subject.at_rest(output)
        }
    start = [begin.get(str(b.label), 0.0) for b in subject.recursion.states]
    return javascript.run(source, "x1", held, start)["runs"][output][depth:]


def in_fmu(archive, subject, n, folder):
    """Run it from where it rests; what answers its inputs at once is read one sample late."""
    pytest.importorskip("fmpy")
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    from fmus import opened

    moved = subject.steps(n, sampled=True)
    with opened(archive, folder) as found:
        rested = [v for v in found.description.modelVariables if v.variability == "fixed"]
        one = found.instance()
        one.begin(**{v.name: subject.at_rest(v.description.removeprefix("value before the start of ")) for v in rested})
        order = [str(b.label) for b in subject.recursion.inputs if str(b.label) != "t"]
        got = one.run(TS, **{a: moved[b] for a, b in zip(found.named("input"), order, strict=True)})
        return got[1:] if late(found) else got[:-1]


def late(fmu):
    """Whether the description says that what a step ends with is the output at its beginning."""
    (output,) = (v for v in fmu.description.modelVariables if v.causality == "output")
    said = fmu.description.description
    assert ("late" in output.description) == (f"ends with {output.name}[k];" in said) != (f"{output.name}[k+1]" in said)
    return "late" in output.description


RUN = {"c": in_c, "st": in_st, "plcopen": in_plcopen, "casadi": in_casadi, "js": in_js, "fmu": in_fmu, "fmu2": in_fmu}


def run(to, subject, n, folder, **options):
    """Export a subject to a target, and run that."""
    return RUN[to](subject.export(to, "x1", **options), subject, n, folder)


REFERENCE = np.concatenate([np.full(6, 0.2), 0.2 + 1.8 * np.sin(np.arange(1, 115) / 8)])


def law_over(model, reference=REFERENCE):
    """The law of a model with what it follows: from m = 0.1, at rest with the first sample."""
    rest = {"m": 0.1, "r": float(reference[0]), "y": float(reference[0])}
    return of(model.compensator(), rest=rest, given={"r": reference})
