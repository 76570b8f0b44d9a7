"""FMUs of both versions: fmpy finds them valid, and runs them like the free run."""

import io
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from exported import SUBJECTS, valued
from languages import in_fmu, late
from sampling import more

import narx_sym as ns
from narx_sym.codegen import fmu as writer
from narx_sym.codegen.export import written
from narx_sym.models.info import Info
from narx_sym.symbolic.signals import u, y

fmpy = pytest.importorskip("fmpy", reason="the extra fmu is not installed here")
if shutil.which("cc") is None:
    pytest.skip("no C compiler here", allow_module_level=True)

from fmpy.fmi1 import FMICallException  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402
from fmus import opened  # noqa: E402

VERSIONS = ("3.0", "2.0")
BOTH = pytest.mark.parametrize("fmi", VERSIONS)
TARGETS = {"3.0": "fmu", "2.0": "fmu2"}
TS, N = 0.01, 300
MODEL = ns.NARX.from_terms(
    ["y[k-1]", "y[k-2]", "u[k-1]", "Max(u[k-2], y[k-1])"], [0.6, -0.1, 0.4, 0.05], Ts=TS
).replace(info=Info(ranges={"u": (-2.0, 3.0), "y": (-4.0, 5.0)}))
WAVE = np.sin(np.arange(N) / 9) + 0.4 * np.sin(np.arange(N) / 2.3)


def by_turns(*names):
    """Ask each case in one version of FMI, in turns; in the other one with -m more."""
    cases = [(i + j, name, fmi) for i, name in enumerate(names) for j, fmi in enumerate(VERSIONS)]
    return pytest.mark.parametrize("name, fmi", [pytest.param(*c, marks=more if n % 2 else ()) for n, *c in cases])


def put(thing, path, fmi="3.0", **options):
    path.write_bytes(thing.export(TARGETS[fmi], **options))


def content(file, inside):
    with zipfile.ZipFile(file) as archive:
        return archive.read(inside)


@pytest.fixture(scope="module", params=("3.0", "2.0"))
def made(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "plant.fmu"
    put(MODEL, path, fmi=request.param, name="plant", units={"u": "V", "y": "µm <&>"})
    with opened(path.read_bytes(), path.parent) as found:
        yield found


def test_fmpy_finds_it_valid(made):
    assert validate_fmu(made.file) == []
    assert made.description.modelName == "plant" and made.description.defaultExperiment.stepSize == "0.01"


def test_fmpy_simulates_the_free_run(made):
    record = np.rec.fromarrays([np.arange(N) * TS, WAVE], names=["time", "u"])
    run = fmpy.simulate_fmu(
        made.file, input=record, output=["y"], step_size=TS, output_interval=TS, stop_time=(N - 1) * TS,
        start_values={"u_rest": 0.3, "y_rest": 0.2},
    )  # fmt: skip
    expected = MODEL.simulate(WAVE, 0.2, u0=0.3)
    assert run["y"].shape == expected.shape and np.ptp(expected) > 0.5
    assert np.abs(run["y"] - expected).max() <= 1e-9


def test_reset_gives_the_same_again(made):
    one = made.instance()
    one.begin(u_rest=0.3, y_rest=0.2, theta_1=0.5)
    first = one.run(TS, u=WAVE)
    one.reset()
    assert one.get("theta_1") == 0.6  # as described
    one.begin(u_rest=0.3, y_rest=0.2, theta_1=0.5)
    assert np.array_equal(one.run(TS, u=WAVE), first)


def test_two_instances_share_nothing(made):
    alone = made.instance()
    alone.begin(u_rest=0.3)
    expected = alone.run(TS, u=WAVE)
    one, two = made.instance(), made.instance()
    one.begin(u_rest=0.3)
    two.begin(u_rest=-1.0, theta_3=0.1)
    found = [one.get("y")]
    for x in WAVE:
        one.set(u=x)
        two.set(u=-5 * x)
        two.step(TS)
        one.step(TS)
        found.append(one.get("y"))
        assert two.get("y") != found[-1]
    assert np.array_equal(found, expected)


def test_a_parameter_is_the_theta_of_the_model(made):
    one = made.instance()
    changed = MODEL.replace(theta=[0.5, -0.2, 0.7, 0.1])
    one.begin(u_rest=0.3, y_rest=0.2, **{f"theta_{i}": v for i, v in enumerate(changed.theta.tolist(), start=1)})
    found, expected = one.run(TS, u=WAVE)[:-1], changed.simulate(WAVE, 0.2, u0=0.3)
    assert np.abs(found - expected).max() <= 1e-9 < np.abs(found - MODEL.simulate(WAVE, 0.2, u0=0.3)).max()
    one.set(theta_1=0.6, theta_2=-0.1, theta_3=0.4, theta_4=0.05)  # between two steps
    (two := made.instance()).begin(u_rest=WAVE[-1], y_rest=found[-1])
    assert np.abs(one.run(TS, u=np.full(500, 0.3))[-1] - two.run(TS, u=np.full(500, 0.3))[-1]) <= 1e-9


def test_several_samples_in_one_step(made):
    one = made.instance()
    one.begin(u_rest=0.3, y_rest=0.2)
    held = np.repeat(WAVE[:40], 5)
    found = one.run(5 * TS, u=WAVE[:40])[:-1]
    assert np.abs(found - MODEL.simulate(held, 0.2, u0=0.3)[::5]).max() <= 1e-9
    assert one.get("time") == pytest.approx(200 * TS, abs=1e-12)


@pytest.mark.parametrize("length", (0.5 * TS, 1.001 * TS, 0.0, -TS, float("nan"), float("inf")))
def test_a_step_that_is_no_multiple_is_refused(made, length):
    one = made.instance()
    one.begin()
    with pytest.raises(FMICallException):
        one.step(length)
    assert any("multiple of the sampling time 0.01 s" in text for text in one.said), one.said


def test_what_cannot_be_set_is_refused_with_a_message(made):
    one = made.instance()
    one.begin()
    for name, value, word in (
        ("y", 1.0, "output cannot be set"), ("u_rest", 1.0, "before the first step"), ("u", float("nan"), "finite"),
    ):  # fmt: skip
        with pytest.raises(FMICallException):
            one.set(**{name: value})
        assert word in one.said[-1]
    with pytest.raises(FMICallException):
        one.begin()


def test_a_run_that_leaves_the_finite_numbers_is_an_error(made):
    one = made.instance()
    one.begin(theta_1=10.0)
    one.set(u=1.0)
    with pytest.raises(FMICallException):
        for _ in range(1000):
            one.step(TS)
    assert "left the finite numbers" in one.said[-1]
    with pytest.raises(FMICallException):
        one.get("y")
    one.reset()
    one.begin()
    assert one.get("y") == 0.0


def test_units_and_ranges_are_in_the_description(made):
    found = {v.name: v for v in made.description.modelVariables}
    assert (found["u"].unit, found["y"].unit, found["u_rest"].unit, found["time"].unit) == ("V", "µm <&>", "V", "s")
    assert (float(found["u"].min), float(found["u"].max)) == (-2.0, 3.0)
    assert found["y"].min is None and "between -4 and 5" in found["y"].description  # a run may go beyond
    assert [found[f"theta_{i}"].variability for i in range(1, 5)] == ["tunable"] * 4
    assert found["theta_2"].start == "-0.1" and found["u_rest"].variability == "fixed"


@BOTH
def test_the_same_model_gives_the_same_bytes(fmi, tmp_path):
    for file in ("a", "b"):
        put(MODEL, tmp_path / file, fmi=fmi)
    files = zipfile.ZipFile(tmp_path / "a").namelist()
    described = [f for f in files if not f.startswith("binaries")]
    assert all(content(tmp_path / "a", f) == content(tmp_path / "b", f) for f in described)
    assert "sources/model.c" in described and len(files) == len(described) + 1
    assert {i.date_time for i in zipfile.ZipFile(tmp_path / "a").infolist()} == {(1980, 1, 1, 0, 0, 0)}
    put(MODEL.replace(theta=[0.6, -0.1, 0.4, 0.06]), tmp_path / "c", fmi=fmi)
    tokens = [re.search(rb"\{[0-9a-f-]{36}\}", content(tmp_path / f, "modelDescription.xml"))[0] for f in "abc"]
    assert tokens[0] == tokens[1] != tokens[2]


@BOTH
def test_without_a_compiler_the_source_is_inside(fmi, tmp_path, monkeypatch):
    monkeypatch.setattr(writer.shutil, "which", lambda name: None)
    with pytest.warns(UserWarning, match="no binary: no C compiler"):
        put(MODEL, tmp_path / "x.fmu", fmi=fmi)
    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        names = archive.namelist()
    assert "sources/model.c" in names and not any(n.startswith("binaries") for n in names)


@by_turns("law", "effects", "clock", "play", "law of plays", "awkward")
def test_direct_inputs_previews_time_and_states(name, fmi, tmp_path):
    """An output that answers its inputs is one sample late, a preview is taken ahead, time is the clock of the run."""
    agrees(SUBJECTS[name], TARGETS[fmi], tmp_path)


def agrees(subject, target, folder, n=200):
    """Run a subject as an FMU, from where it rests, and compare with the package's own run."""
    starts = getattr(subject.thing, "starts", None)
    made = written(target, subject.recursion, subject.values, "x1", False, subject.output, starts, Ts=TS)
    got, expected = in_fmu(made, subject, n, folder), subject.expected(n)
    assert np.ptp(expected) > 0 and np.abs(got - expected).max() <= 1e-9 * max(1.0, np.abs(expected).max())


def test_only_what_answers_at_once_is_late(tmp_path):
    behind, direct = (ns.NARX.from_terms(["y[k-1]", f"u[k-{i}]"], [0.5, 1.0], Ts=TS) for i in (1, 0))
    for fmi, model, expected in (("3.0", behind, False), ("2.0", direct, True), ("3.0", behind.compensator(), True)):
        with opened(model.export(TARGETS[fmi]), tmp_path) as found:
            (output,) = found.description.outputs
            assert late(found) == expected and output.dependencies == []


def ordinary(file, starts=None, **waves):
    """Let fmpy's own master run an FMU over inputs that are given by time; it reads at the start and after each step."""
    n = len(next(iter(waves.values())))
    record = np.rec.fromarrays([np.arange(n) * TS, *waves.values()], names=["time", *waves])
    run = fmpy.simulate_fmu(
        str(file), input=record, start_values=starts or {}, step_size=TS, output_interval=TS, stop_time=n * TS
    )
    return run[run.dtype.names[1]]


REFERENCE = np.concatenate([np.full(4, 0.4), 0.4 + 0.5 * np.sin(np.arange(1, 200) / 9)])
PLANTS = {
    "first order": ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=TS),
    "dead time": ns.NARX.from_terms(["y[k-1]", "u[k-3]", "u[k-4]"], [0.7, 0.4, 0.1], Ts=TS),
    "kinked": ns.NARX.from_terms(["y[k-1]", "u[k-1]", "Max(u[k-2], 0)"], [0.6, 0.3, 0.1], Ts=TS),
    "bent": ns.NARX.from_terms(["y[k-1]", "tanh(u[k-1])"], [0.5, 0.5], Ts=TS),
}


@by_turns(*PLANTS)
@pytest.mark.filterwarnings("ignore:the limits:UserWarning", "ignore:the model misses:UserWarning")
def test_an_ordinary_master_reads_the_law_one_sample_late(name, fmi, tmp_path):
    """Set, step, read; nothing is computed anew between: the values are those of the law's own run."""
    law, n = PLANTS[name].compensator(), REFERENCE.size - 10
    expected = law.run(REFERENCE, 0.0, limits=(-1.0, 1.5), rate=0.8)[:n]
    put(law, tmp_path / "law.fmu", fmi=fmi, limits=(-1.0, 1.5), rate=0.8)
    run = ordinary(tmp_path / "law.fmu", {"y_rest": REFERENCE[0]}, r=REFERENCE[law.preview :][:n])
    assert np.ptp(expected) > 0.5 and np.abs(run[1:] - expected).max() <= 1e-9
    assert run[0] == run[1]  # at the start it answers the inputs as they are then


@by_turns("first order", "dead time")
def test_law_and_plant_joined_by_an_ordinary_master(name, fmi, tmp_path):
    """The reference is given one sample earlier than the law's preview: what the plant makes is the reference."""
    plant = PLANTS[name]
    law, n, target = plant.compensator(), 150, TARGETS[fmi]
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    r = REFERENCE - REFERENCE[0]
    with opened(law.export(target), tmp_path / "a") as one, opened(plant.export(target), tmp_path / "b") as two:
        control, process, found = one.instance(), two.instance(), []
        control.begin()
        process.begin()
        for i in range(n):
            found.append(process.get("y"))
            process.set(u=control.get("m"))
            control.set(r=r[i + law.preview + 1])
            process.step(TS)
            control.step(TS)
    assert np.ptp(found) > 0.5 and np.abs(found - r[:n]).max() <= 1e-9


@by_turns("drift", "ageing")
def test_the_clock_of_a_law_is_as_far_ahead_as_it_reads(name, fmi, tmp_path):
    """The law against a drift reads t[k+1], the one against ageing t[k]."""
    law = valued(PLANTS["first order"], name, value=0.5).compensator()
    expected = law.run(REFERENCE, 0.3, share=None)
    with opened(law.export(TARGETS[fmi], share=None), tmp_path) as fmu:
        one = fmu.instance()
        rest = {"m_rest": 0.3, "r_rest": REFERENCE[0], "y_rest": REFERENCE[0]}
        one.begin(**{a: v for a, v in rest.items() if a in fmu.references})
        found = one.run(TS, r=REFERENCE[1:])[1:]
    assert np.abs(found - expected[:-1]).max() <= 1e-9


@BOTH
def test_prototypes_are_those_of_the_standard(fmi, tmp_path):
    """The headers that fmpy brings are read before the source: another prototype would not compile."""
    old = fmi == "2.0"
    version = fmi[0]
    put(MODEL, tmp_path / "x.fmu", fmi=fmi)
    text = content(tmp_path / "x.fmu", "sources/model.c").decode()
    types = {
        "2": "typedef fmi2Status fmi_status; typedef fmi2Type fmi_type; typedef fmi2StatusKind fmi_asked;"
        "typedef fmi2CallbackLogger fmi_log; typedef fmi2CallbackFunctions fmi_callbacks;"
        "\n#define FMI_COSIMULATION fmi2CoSimulation\n#define FMI_LAST_TIME fmi2LastSuccessfulTime\n"
        "#define FMI_TERMINATED fmi2Terminated\n",
        "3": "typedef fmi3Status fmi_status; typedef fmi3DependencyKind fmi_dependency; typedef fmi3IntervalQualifier "
        "fmi_qualifier; typedef fmi3LogMessageCallback fmi_log; typedef fmi3ClockUpdateCallback fmi_clocked;"
        "typedef fmi3LockPreemptionCallback fmi_lock; typedef fmi3IntermediateUpdateCallback fmi_intermediate;\n",
    }[version] + "".join(f"#define fmi_{s.lower()} fmi{version}{s}\n" for s in ("OK", "Discard", "Error"))
    text, swapped = re.subn(
        r"/\* The types of FMI.*?/\* End of the types\. \*/",
        f'#include "fmi{version}Functions.h"\n{types}',
        text,
        flags=re.S,
    )
    assert swapped == 1
    (tmp_path / "x.c").write_text(text)
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-strict-prototypes", f"-I{headers}", "-shared", "-fPIC"]
    flags.append(f"-DFMI{version}_OVERRIDE_FUNCTION_PREFIX")
    done = subprocess.run(
        ["cc", *flags, tmp_path / "x.c", "-o", tmp_path / "x.so", "-lm"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[:2000]
    declared = set(re.findall(rf"\b(fmi{version}\w+)TYPE\s+\w+;", (headers / f"fmi{version}Functions.h").read_text()))
    exported = subprocess.run(["nm", "-D", tmp_path / "x.so"], capture_output=True, text=True, check=True).stdout
    lacking = {f for f in declared if f" T {f}" not in exported}
    exchange = r"Event|NewDiscrete|ContinuousT|Integrator|SetTime|ContinuousS|GetDerivatives|Nominals"
    assert len(declared) > 30 and not {f for f in lacking if not (old and re.search(exchange, f))}


def test_a_source_that_does_not_stand_alone_has_prefixed_names(tmp_path):
    """Several FMUs in one program: the functions of a source are named after it."""
    for fmi, flags in (("3.0", []), ("2.0", ["-DFMI2_FUNCTION_PREFIX=fmi_"])):
        put(MODEL, tmp_path / "x.fmu", name="fmi", fmi=fmi)
        (tmp_path / "x.c").write_bytes(content(tmp_path / "x.fmu", "sources/fmi.c"))
        subprocess.run(["cc", "-std=c99", "-c", *flags, "x.c", "-o", "x.o"], cwd=tmp_path, check=True)
        names = subprocess.run(["nm", "x.o"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
        assert f"T fmi_fmi{fmi[0]}DoStep" in names and f"T fmi{fmi[0]}DoStep" not in names


def test_where_a_model_rests_without_a_word():
    point = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0], Ts=TS, operating_point={u: 5.0, y: -3.0})
    seen = MODEL.replace(info=Info(ranges={"u": (2.0, 4.0), "y": (1.0, 9.0)}, line=(1.0, 2.0)))

    def rests(model):
        archive = zipfile.ZipFile(io.BytesIO(model.export("fmu")))
        text = archive.read("modelDescription.xml").decode()
        return {a: float(b) for a, b in re.findall(r'name="(\w)_rest".*?start="([^"]*)"', text)}

    assert rests(point) == {"u": 5.0, "y": -3.0} and rests(seen) == {"u": 3.0, "y": 7.0}
    assert rests(MODEL) == {"u": 0.0, "y": 0.0}


def test_law_on_the_command_line(run, tmp_path):
    simple = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=TS)
    simple.save(tmp_path / "model.json")
    code, text, err = run(
        "compensate", tmp_path / "model.json", "--fmu", tmp_path / "law.fmu", "--fmu2", tmp_path / "law2.fmu",
        "--limits", -2, 2, "--units", "V,um",
    )  # fmt: skip
    assert code == 0 and not err and "FMI 3.0" in text and "FMI 2.0" in text
    r = np.sin(np.arange(N) / 40)
    expected = simple.compensator().follow(np.append(r, r[-1]), 0.0, limits=(-2, 2)).m[:N]
    for file, version in (("law.fmu", "3.0"), ("law2.fmu", "2.0")):
        assert validate_fmu(str(tmp_path / file)) == []
        with opened((tmp_path / file).read_bytes(), tmp_path) as found:
            units = {v.name: v.unit for v in found.description.modelVariables}
            assert found.description.fmiVersion == version and (units["r"], units["m"]) == ("um", "V")
            one = found.instance()
            one.begin()
            got = one.run(TS, r=np.append(r[1:], r[-1]))[1:]
        assert np.abs(got - expected).max() <= 1e-9
