"""The commands about effects: diagnose, add, effects, and where a model fails; files, errors, and the same twice."""

import hashlib
import io
import json
import re
import shlex
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace

import numpy as np
import pytest
from sampling import more

import narx_sym as ns
from narx_sym.cli import main as cli
from narx_sym.cli.options import with_own
from narx_sym.report.panels import registry

N, TS, DEAD, NOISE = 1500, 0.01, 0.6, 0.01
SEARCHED = ("dead_zone", "backlash", "saturation", "creep", "drift")
STEP_KEYS = {
    "verdict", "confusion_set", "base", "candidates", "smallest_detectable", "where_it_fails", "experiment",
}  # fmt: skip
CANDIDATE_KEYS = {
    "effect", "where", "parameters", "latex", "share_of_removable_error", "p_value", "sentence", "nrmse",
}  # fmt: skip
OWN = """
[[effect]]
id = "my_slack"
where = "input"
z = "-Max(-w, Min(w, x[k]))"
scan = { w = "amplitude" }
sign = 1
sentence = "My own slack: small inputs are lost."
"""
INVERSE = {"input": "y", "output": "u", "lead": 1, "terms": ["u[k-1]", "y[k-1]"], "theta": [0.5, 1.0], "info": {}}
INVERSE |= {"symbols": ["theta_1", "theta_2"], "standard_errors": None, "constraints": [], "operating_point": {}}


def one_message(code, err):
    """Whether a command failed with one message and no traceback."""
    return code == 2 and "Traceback" not in err and "internal error" not in err


def plant(u):
    """A second-order lag, without anything of the package."""
    y = np.zeros(u.size)
    for k in range(2, u.size):
        y[k] = 1.3 * y[k - 1] - 0.4 * y[k - 2] + 0.08 * u[k - 1]
    return y


def write(path, **columns):
    t = np.arange(N) * TS
    rows = np.column_stack([t, *columns.values()])
    path.write_text(
        ",".join(["t", *columns]) + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows) + "\n"
    )


@pytest.fixture(scope="module", autouse=True)
def searched():
    """Search few effects: here words, options and files are looked at."""
    with pytest.MonkeyPatch.context() as patch:
        others = [name for name in ns.EFFECTS if name not in SEARCHED]
        patch.setattr("narx_sym.cli.diagnose.with_own", lambda files: with_own(files).without(*others))
        yield


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A record with a hidden dead zone, one where nothing is hidden, a linear model, and an effect as text."""
    folder = tmp_path_factory.mktemp("diagnose")
    rng = np.random.default_rng(1)
    white, noise = rng.standard_normal(N), NOISE * rng.standard_normal(N)
    u = np.zeros(N)
    for k in range(1, N):
        u[k] = 0.9 * u[k - 1] + 0.6 * white[k]
    dead = np.sign(u) * np.maximum(np.abs(u) - DEAD, 0)
    write(folder / "dead.csv", u=u, y=plant(dead) + noise, temp=rng.standard_normal(N))
    write(folder / "null.csv", u=u, y=plant(u) + noise)
    linear = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]", "1"])
    linear.fit(ns.read(folder / "null.csv"), method="free_run").save(folder / "linear.json")
    (folder / "own.toml").write_text(OWN)
    return folder


@pytest.fixture(scope="module")
def diagnosed(files):
    """The record with the dead zone, diagnosed once: what was printed, and the files; of the report two parts."""
    out, err = io.StringIO(), io.StringIO()
    arguments = [
        "diagnose", "dead.csv", "--base", "linear.json", "--json", "d.json", "--save", "m.json", "--plot", "p.png",
        "--units", "V,mm", "--report", "r.html", "--verbose",
    ]  # fmt: skip
    arguments = [str(files / a) if "." in a else a for a in arguments]
    parts = {name: registry.panels()[name] for name in ("verdict", "provenance")}
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["narx-sym", *arguments])
        patch.setattr(registry, "_PANELS", parts)
        with pytest.raises(SystemExit) as stop:
            cli.main()
    assert not stop.value.code, err.getvalue()
    return out.getvalue(), err.getvalue()


def test_a_terminal_shows_the_step_whole_and_nothing_of_it_is_markup(monkeypatch):
    from rich.console import Console

    from narx_sym.cli import printing
    from narx_sym.diagnosis.progress import Told

    shown = Console(file=io.StringIO(), force_terminal=True, width=60)
    monkeypatch.setattr(printing, "console", lambda stderr=False: shown)
    with printing.working("Diagnosing") as tell:
        tell("a plain [text]")
        tell(Told("trying each effect alone", 3, 5, 12, 40, (("backlash", 0.82),), 0.3))
    text = " ".join(re.sub(r"\x1b\[[0-9;?]*\w", " ", shown.file.getvalue()).split())
    assert "Step 3 of 5:" in text and "12 of 40" in text and "squared error)" in text and "0:00:0" in text


def test_names_the_hidden_effect(files, diagnosed):
    text, err = diagnosed
    assert "Diagnosing ..." in err
    for expected in (
        "one explanation fits", "Probably missing: dead zone", "µm rms", "+ dead zone", "noise floor", "Where the model fails",
        "Detection limits", "dead zone *", "fit [%], validation", "Max(-0.",
    ):  # fmt: skip
        assert expected in text, text
    for picture in ("p.png", "p_where.png"):
        assert (files / picture).stat().st_size > 10_000
    assert not list(files.glob("next.csv"))


def test_five_lines_first_and_the_same_data_and_seed_give_the_same_file(files, diagnosed, run):
    arguments = ["diagnose", files / "dead.csv", "--base", files / "linear.json", "--units", "V,mm"]
    text, _ = run.good(*arguments, "--json", files / "again.json")
    lines = text.splitlines()
    assert re.fullmatch(r"Dead zone is probably missing\. \(.+ %: one explanation fits\)", lines[0])
    assert "falls from" in lines[1] and " µm" in lines[1] and "Probably missing: dead zone" in lines[2]
    (told,) = (line for line in lines if line.startswith("In physical units: half-width of the dead zone 0."))
    size = re.search(r"half-width of the dead zone (0\.[0-9]+) V", told)
    assert size and float(size[1]) == pytest.approx(DEAD, rel=0.02)
    assert " V, 95 % 0." in told and "gain 0." in told and "time constant" in told
    assert any(line.startswith("Next: ") for line in lines) and any("narx-sym diagnose" in line for line in lines)
    assert "Candidates (" not in text and len(lines) <= 9
    first, second = ((files / name).read_text().splitlines() for name in ("d.json", "again.json"))
    differ = [(a, b) for a, b in zip(first, second, strict=True) if a != b]
    assert all('"seconds"' in a for a, _ in differ) and len(differ) <= 1


@more
def test_the_command_to_go_on_with_reads_the_data_as_this_one_did(files, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = (files / "dead.csv").read_text().replace("t,u,y,temp", "Zeit s,Spannung,Weg,temp").splitlines()
    rows[50] = rows[50].replace(",", ",nan,", 1)[: rows[50].rindex(",")]
    (tmp_path / "my record.csv").write_text("\n".join(rows[:602]))
    options = [
        "--time", "Zeit s", "--input", "Spannung", "--output", "Weg", "--rows", "10:600", "--missing", "drop", "--units",
        "V,mm", "--channels", "temp", "--delay", "1", "--max-effects", "1", "--limits", "-3.0", "3.0", "--effects",
        str(files / "own.toml"),
    ]  # fmt: skip
    text, _ = run.good("diagnose", "my record.csv", *options, "--json", tmp_path / "d.json")
    (line,) = [line for line in text.splitlines() if line.startswith("  narx-sym ")]
    said = shlex.split(line)
    at = [said.index(option) for option in options if option.startswith("--")]
    assert said[:3] == ["narx-sym", "diagnose", "my record.csv"] and "--json" not in said
    assert all(said[i : i + 2] == options[options.index(said[i]) :][:2] for i in at)
    assert said[said.index("--limits") + 2] == "3.0"
    stop = said.index("NEW_RECORD.csv") if "NEW_RECORD.csv" in said else None
    if stop is not None:
        del said[stop]
    run.good(*said[1:], "--quiet")


def test_what_was_done_with_the_data_and_every_unit_are_printed(files, run, stage_diagnosis, monkeypatch):
    first = stage_diagnosis.steps[0]
    slow = replace(first.experiment, name="steps of 0.5, moving at 62.6 per s")
    kept = ["dead: read before", "The candidate effects were compared on averages of 20 samples."]
    told = replace(stage_diagnosis, steps=[replace(first, experiment=slow)], data_notes=kept)
    monkeypatch.setattr("narx_sym.diagnosis.procedure.diagnose", lambda *_, **__: told)
    monkeypatch.setattr("narx_sym.tasks.base.what_to_know", lambda records: {"read before": [r.name for r in records]})
    monkeypatch.setattr(type(told), "units", {"u": "V", "y": "mm"})
    arguments = ["diagnose", files / "dead.csv", "--base", files / "linear.json", "--units", "V,mm"]
    code, text, err = run(*arguments, "--verbose")
    assert code == 0 and err.count("read before") == 1 and f"note: {kept[1]}" in err, err
    assert "steps of 0.5 V, moving at 62.6 V/s" in text and "62.6 per s" not in text


@more
@pytest.mark.parametrize("given", [3, 1])
def test_a_dead_time_that_is_given_is_kept_and_said(files, run, given):
    code, text, _ = run("diagnose", files / "dead.csv", "--base", "linear", "--rows", "0:600", "--delay", given)
    assert code == 0 and f"acts after {given} sample{'s' * (given > 1)} ({given / 100} s)" in text


def test_json_has_the_published_form(files, diagnosed):
    written = (files / "d.json").read_text()
    data = json.loads(written, parse_constant=lambda name: pytest.fail(name))
    assert data["schema"] == 1 and STEP_KEYS | {"schema", "seconds"} <= set(data)
    assert data["verdict"] == "named" and data["confusion_set"] == ["dead_zone"] and data["experiment"] is None
    assert {"latex", "terms", "theta", "nrmse"} <= set(data["base"])
    assert {"train", "validation", "noise_floor"} <= set(data["base"]["nrmse"])
    assert data["base"]["terms"] and len(data["base"]["terms"]) == len(data["base"]["theta"])
    best = data["candidates"][0]
    assert all(set(c) >= CANDIDATE_KEYS and {"train", "validation"} <= set(c["nrmse"]) for c in data["candidates"])
    assert best["effect"] == "dead_zone" and best["where"] == "input" and best["share_of_removable_error"] > 0.95
    assert best["parameters"] == pytest.approx({"c": 1, "r": DEAD}, rel=0.05)
    assert data["base"]["nrmse"]["validation"] > 5 * best["nrmse"]["validation"]
    assert data["smallest_detectable"]["backlash"] > 0
    assert data["units"] == {"u": "V", "y": "mm"}
    assert all({"panel", "share"} <= set(row) and row["share"] <= 1 for row in data["where_it_fails"])
    (width,) = (row for row in data["physical"] if row["name"] == "half-width of the dead zone")
    assert width["low"] < DEAD < width["high"] and (width["unit"], width["effect"]) == ("V", "dead_zone")
    # Sorted, and what differs from run to run comes last.
    assert list(data)[:-1] == sorted(set(data) - {"seconds"}) and list(data)[-1] == "seconds"


def test_report_names_its_data(files, diagnosed):
    text, _ = diagnosed
    page = (files / "r.html").read_text(encoding="utf-8")
    assert "Report: " in text and "Dead zone is probably missing." in page
    assert hashlib.sha256((files / "dead.csv").read_bytes()).hexdigest() in page and "linear.json" in page


def test_saved_model_is_read_and_fits(files, diagnosed, run):
    model = ns.load(files / "m.json")
    assert model.effects[0].effect == "dead_zone" and model.Ts == TS
    assert ns.evaluate(model, ns.read(files / "dead.csv")).free_run_nrmse < 0.02
    text, err = run.good(f"simulate {files}/m.json {files}/dead.csv --input u --out {files}/y.csv --y0 0")
    # With its effect nothing is missing any more, on the same data.
    code, text, err = run("diagnose", files / "dead.csv", "--base", files / "m.json", "--quiet")
    assert code == 0 and "(nothing found)" in text and len(text.splitlines()) == 1, (text, err)


def test_nothing_hidden_nothing_found(files, run, tmp_path):
    written = ["--json", tmp_path / "n.json", "--save", tmp_path / "m.json"]
    text, err = run.good("diagnose", files / "null.csv", "--rows", "0:700", *written)
    assert "(nothing found)" in text.splitlines()[0] and "no effect was added" in err
    data = json.loads((tmp_path / "n.json").read_text())
    assert data["candidates"] == [] and data["confusion_set"] == [] and data["smallest_detectable"]
    assert "steps" not in data and ns.load(tmp_path / "m.json").info.nrmse.free_run < 0.02


def test_add(files, run, tmp_path):
    out = tmp_path / "added.json"
    arguments = ["add", files / "linear.json", "dead_zone", files / "dead.csv", "--out", out]
    text, err = run.good(*arguments, "--where", "input", "--rows", "0:700")
    assert "before, fitted to these data" in text and "with dead_zone" in text and "v[k] = u[k]" in text
    model = ns.load(out)
    assert model.values and ns.evaluate(model, ns.read(files / "dead.csv")).free_run_nrmse < 0.02
    for wrong, expected in {("--where", "output"): "does not act at 'output'", ("--rows", "0:10"): "too few"}.items():
        code, _, err = run(*arguments, *wrong)
        assert one_message(code, err) and expected in err, err
    code, _, err = run("add", files / "linear.json", "magic", files / "dead.csv", "--out", out)
    assert one_message(code, err) and "Unknown effect 'magic'" in err and "backlash" in err
    code, _, err = run("add", files / "linear.json", "channel:load", files / "dead.csv", "--out", out)
    assert one_message(code, err) and "no column 'load'" in err


@pytest.mark.long
def test_own_effect_from_a_file(files, run, tmp_path):
    out = tmp_path / "d.json"
    text, _ = run.good(
        f"diagnose {files}/dead.csv --base {files}/linear.json --effects {files}/own.toml --json {out} --max-effects 2"
    )
    data = json.loads(out.read_text())
    own = next(c for c in data["candidates"] if c["effect"] == "my_slack")
    assert own["parameters"]["w"] == pytest.approx(DEAD, rel=0.05)
    # It is the dead zone by another name: these data cannot tell them apart, and no experiment can.
    assert data["verdict"] == "confused" and set(data["confusion_set"]) == {"dead_zone", "my_slack"}
    assert data["experiment"]["file"] == "next.csv" and "next.csv" in text
    proposed = ns.read(tmp_path / "next.csv", u="u", y="u")
    assert proposed.Ts == pytest.approx(TS) and np.abs(proposed.u).max() <= np.abs(ns.read(files / "dead.csv").u).max()
    assert len(data["steps"]) == 2 and all(STEP_KEYS <= set(s) for s in data["steps"]) and "Step 2: Nothing is" in text
    assert data["steps"][0]["candidates"] == data["candidates"] and data["steps"][1]["verdict"] == "nothing_detectable"
    assert "my_slack" not in ns.EFFECTS
    code, text, _ = run("effects", "--effects", files / "own.toml")
    assert code == 0 and "My own slack" in text


def test_effects_in_words(run):
    text, _ = run.good("effects")
    for name, forms in ns.EFFECTS.items():
        assert name in text and all(f.sentence in text and f.source in text for f in forms)
    for expected in (
        "p[k] = Max(", "exp(-Ts/tau)", "sensor_saturation", "channel:<name>", "in Hz", "at the input, driven by u",
    ):  # fmt: skip
        assert expected in text, expected
    assert "-x[k-1] + x[k]" not in text


def test_compare_says_where_it_fails(files, run, tmp_path):
    picture = tmp_path / "c.png"
    text, _ = run.good(f"compare {files}/linear.json {files}/dead.csv --plot {picture} --units V,mm")
    assert "Where the model fails" in text and "mean error" in text and "mm" in text
    assert picture.stat().st_size > 10_000 and (tmp_path / "c_where.png").stat().st_size > 10_000


def test_bad_usage(files, run, tmp_path):
    data = files / "dead.csv"
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "constant.csv").write_text("t,u,y\n" + "".join(f"{k * 0.01:.2f},3,{k}\n" for k in range(100)))
    (tmp_path / "broken.toml").write_text("[[effect]]\nid = 'x'\n")
    inverse = tmp_path / "inverse.json"
    inverse.write_text(json.dumps(json.loads((files / "linear.json").read_text()) | INVERSE))
    linear = files / "linear.json"
    for arguments, expected in {
        (data, "--max-effects", 0): "--max-effects",
        (data, "--base", "cubic"): "Unknown base 'cubic'",
        (data, "--base", tmp_path / "broken.json"): "not a model file",
        (data, "--base", tmp_path / "absent.json"): "no such model",
        (data, "--base", inverse): "inverse model",
        (data, "--base", linear, "--channels", "load"): "no column 'load'",
        (data, "--base", linear, "--rows", "0:10"): "10 samples are too few",
        (data, "--rows", "0:10"): "10 samples are too few",
        (data, "--delay", 1500): "has 1500",
        (tmp_path / "constant.csv",): "input is constant",
        (tmp_path / "absent.csv",): "no such file",
        (data, "--effects", tmp_path / "broken.toml"): "'where' is missing",
        (data, "--effects", tmp_path / "absent.toml"): "no such file",
        (data, "--json", data): "this command reads this file",
        (data, "--json", tmp_path / "no" / "d.json"): "does not exist",
        (data, "--json", tmp_path / "a.json", "--save", tmp_path / "a.json"): "same file",
        (data, "--plot", tmp_path / "p.xyz"): "unknown kind of picture",
        (data, "--experiment", tmp_path / "next.xyz"): "columns are written as text",
    }.items():
        code, _, err = run("diagnose", *arguments)
        assert one_message(code, err), (arguments, code, err)
        assert expected in " ".join(err.split()), (arguments, err)


def test_an_input_that_was_run_is_not_overwritten(files, run, tmp_path):
    """The next input goes to next.csv beside the JSON, unless that is the record."""
    for name in ("next.csv", "next_wider.csv"):
        record = tmp_path / name
        record.write_bytes((files / "dead.csv").read_bytes())
        code, _, err = run("diagnose", record, "--base", files / "linear.json", "--json", tmp_path / "found.json")
        assert one_message(code, err) and "this command reads this file" in err
        assert record.read_bytes() == (files / "dead.csv").read_bytes() and not (tmp_path / "found.json").exists()


def test_equations_of_ones_own_are_a_base(run, tmp_path):
    rng = np.random.default_rng(6)
    u = np.cumsum(rng.standard_normal(900)) / 5
    y, speed = np.zeros(900), 0.0
    for i in range(1, 900):
        y[i] = y[i - 1] + 0.01 * speed
        speed += 0.01 * (4 * u[i - 1] - 2 * speed - 3 * y[i - 1])
    rows = np.column_stack([0.01 * np.arange(900), u, y])
    np.savetxt(tmp_path / "swing.csv", rows, delimiter=",", header="t,u,y", comments="")
    own = tmp_path / "swing.txt"
    own.write_text("x'' = (g*u - d*x' - s*x)/1\ny = x\ng ~ 3\nd ~ 1 in 0.1 ... 20\ns ~ 2 in 0.1 ... 50\n")
    code, text, _ = run("fit", tmp_path / "swing.csv", "--base", own, "--out", tmp_path / "m.json")
    assert not code and "Equations" in text
    model = ns.load(tmp_path / "m.json")
    assert model.theta == pytest.approx([4, 2, 3], rel=0.05)
    assert [float(b) for b in model.bounds[model.symbols[1]]] == [0.1, 20]
    own.write_text("x'' = (g*u - q*x')/1\ny = x\ng ~ 3\n")
    code, _, err = run("diagnose", tmp_path / "swing.csv", "--base", own)
    assert code and "swing.txt" in err and "unknown name 'q'" in err
