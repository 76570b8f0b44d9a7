"""The command line: the main commands on real and simulated files, and one clear message for every bad input."""

import json
import shlex

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.cli.main import _noted

TERMS = ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A short record of the simulated actuator and a model of it, as files."""
    folder = tmp_path_factory.mktemp("bench")
    u = ns.plants.filtered_noise(N=6000, Ts=5e-3, peak=75.0, seed=3)
    record = ns.Record.from_arrays(u, ns.plants.bouc_wen(u, Ts=5e-3), Ts=5e-3)
    lines = [f"{t:.3f},{a:.9g},{b:.9g}" for t, a, b in zip(record.t, record.u, record.y, strict=True)]
    (folder / "data.csv").write_text("t,u,y\n" + "\n".join(lines) + "\n")
    model = ns.NARX.from_terms(TERMS).fit(record, ["continuum"])
    ns.save(model, folder / "model.json")
    t = np.arange(800) * 5e-3
    r = 30 * np.sin(2 * np.pi * t)
    (folder / "ref.csv").write_text("t,r\n" + "\n".join(f"{a:.3f},{b:.9g}" for a, b in zip(t, r, strict=True)))
    return folder


def test_fit_compare_simulate(run, bench, tmp_path):
    out = tmp_path / "m.json"
    text, err = run.good("fit", bench / "data.csv", "--rows", "0:1500", "--out", out, "--for-compensation")
    assert "free-run NRMSE" in text and "y[k-1]" in text
    model = ns.load(out)
    assert float(model.sigma_y.xreplace(model.values)) == 1.0
    picture = tmp_path / "p.png"
    code, text, err = run("compare", out, bench / "data.csv", "--rows", "0:2000", "--plot", picture, "--units", "V,um")
    assert code == 0 and picture.stat().st_size > 10_000, err
    text, err = run.good("simulate", out, bench / "data.csv", "--input", "u", "--out", tmp_path / "y.csv", "--y0", "0")
    simulated = ns.read(tmp_path / "y.csv")
    measured = ns.read(bench / "data.csv")
    assert ns.metrics.nrmse(measured.y, simulated.y) < 0.1


@pytest.fixture(scope="module")
def lagging(tmp_path_factory):
    """A short noisy record of a lag with an offset, and where it rests: y = 2 u + 1."""
    folder, rng = tmp_path_factory.mktemp("lagging"), np.random.default_rng(0)
    u, y = np.repeat(rng.uniform(4, 6, 12), 10), np.full(120, 11.0)
    for i in range(1, u.size):
        y[i] = 0.9 * y[i - 1] + 0.2 * u[i - 1] + 0.1
    rows = np.column_stack([0.1 * np.arange(u.size), u, y + 0.1 * rng.standard_normal(u.size)])
    np.savetxt(folder / "d.csv", rows, delimiter=",", header="t,u [V],y [mm]", comments="")
    (folder / "rest.csv").write_text("u [mV],y [mm]\n4000,9\n5000,11\n6000,13\n")
    return folder


def test_fit_takes_steady_state_data(run, lagging, tmp_path):
    asked = ["fit", lagging / "d.csv", "--base", "linear", "--n-u", "1", "--delay", "1", "--out", tmp_path / "m.json"]

    def off():
        model = ns.load(tmp_path / "m.json")
        return max(abs(model.simulate(np.full(4000, v), y0=2 * v + 1)[-1] - 2 * v - 1) for v in (4.5, 5.5))

    run.good(*asked, "--method", "one_step")
    without = off()
    code, text, err = run(*asked, "--steady-state", lagging / "rest.csv", "--weight", "100")
    assert code == 0 and "converted from mV to V" in err and "Fit: one_step" in text, err
    assert off() < 0.1 * without
    code, _, err = run(*asked, "--steady-state", lagging / "rest.csv", "--weight", "0")
    assert code == 0 and off() == pytest.approx(without, rel=1e-9)


BAD_REST = {
    "absent": (None, (), "rest.csv: no such file"),
    "no header": ("1,2\n3,4\n", (), "rest.csv: line 1 has numbers"),
    "other column": ("u,z\n1,2\n3,4\n", (), "rest.csv: no column 'y'"),
    "text": ("u,y\n1,2\nx,4\n", (), "rest.csv: column 'u' has text in line 3"),
    "missing": ("u,y\n1,2\n3,\n", (), "rest.csv: column 'y' has 1 missing"),
    "no rows": ("u,y\n", (), "rest.csv: no data rows"),
    "unit": ("u [s],y\n1,2\n3,4\n", (), "rest.csv: column 'u [s]' is in s"),
    "weight": ("u,y\n1,2\n3,4\n", ("--weight", "-1"), "--weight"),
    "method": ("u,y\n1,2\n3,4\n", ("--method", "els"), "use --method one_step, not els"),
    "base": ("u,y\n1,2\n3,4\n", ("--base", "play"), "--base narx, linear or static, not play"),
}


@pytest.mark.parametrize("name", BAD_REST)
def test_bad_steady_state_data_are_one_message(run, lagging, tmp_path, name):
    content, more, said = BAD_REST[name]
    if content is not None:
        (tmp_path / "rest.csv").write_text(content)
    code, _, err = run(
        "fit", lagging / "d.csv", "--out", tmp_path / "m.json", "--base", "linear",
        "--steady-state", tmp_path / "rest.csv", *more,
    )  # fmt: skip
    assert code == 2 and said in err and "Traceback" not in err
    assert not (tmp_path / "m.json").exists()


def test_a_weight_needs_steady_state_data(run, lagging, tmp_path):
    code, _, err = run("fit", lagging / "d.csv", "--out", tmp_path / "m.json", "--weight", "2")
    assert code == 2 and "give its file too" in err


def test_derive_writes_latex_and_picture(run, bench, tmp_path):
    text, _ = run.good("derive", bench / "model.json", "--latex", tmp_path / "d.tex", "--plot", tmp_path / "q.png")
    for expected in ("Sigma_y", "theta_1 = 1", "continuum", "attracting where", "none is violated", "m[k] ="):
        assert expected in text
    document = (tmp_path / "d.tex").read_text()
    assert r"\phi_{1,\,k-1}" in document and r"\end{document}" in document
    assert (tmp_path / "q.png").stat().st_size > 10_000


def test_derive_gives_a_differential_equation_in_newtons(run, tmp_path):
    n, Ts = 600, 0.01
    axis = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-2]", "1"], theta=[1.9, -0.9, 0.01, 0.002], Ts=Ts)
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, n // 20), 20)
    y = axis.simulate(u, y0=0.0) + 1e-3 * np.random.default_rng(1).standard_normal(n)
    rows = np.column_stack([np.arange(n) * Ts, u, y])
    np.savetxt(tmp_path / "d.csv", rows, delimiter=",", header="t,u [V],y [m]", comments="")
    ns.save(axis, tmp_path / "m.json")
    asked = ["derive", tmp_path / "m.json", "--continuous", "--units", "V,m"]
    written = ["--json", tmp_path / "c.json", "--latex", tmp_path / "c.tex"]
    text, err = run.good(*asked, "--scale", "u=20N/V", "--data", tmp_path / "d.csv", *written)
    assert "g*(" in text and "  m: mass 0.1" in text and " kg, 95 % " in text and "dead time 10.0 ms" in text
    rows = {row["name"]: row for row in json.loads((tmp_path / "c.json").read_text())["quantities"]}
    assert rows["viscous friction"]["low"] < 20 * 0.1 < rows["viscous friction"]["high"]
    assert rows["offset of the input"]["value"] == pytest.approx(0.2)
    assert r"\frac{d^{2}}{d t^{2}}" in (tmp_path / "c.tex").read_text()
    code, text, err = run(*asked)
    assert code == 0 and "mass 9.4" in text and " mV s²/m" in text and "95 %" not in text
    code, _, err = run("derive", tmp_path / "m.json", "--scale", "20N/V")
    assert code == 2 and "need derive --continuous" in err
    code, _, err = run(*asked, "--scale", "20")
    assert code == 2 and "scale" in err and "Traceback" not in err


def test_compensate_tracks_and_compare_reads_the_log(run, bench, tmp_path):
    text, _ = run.good(
        f"compensate {bench}/model.json --latex {tmp_path}/law.tex --reference {bench}/ref.csv --out {tmp_path}/m.csv"
    )
    assert "m[k] =" in text and "NSAVI" in text and (tmp_path / "law.tex").exists()
    log = ns.read(tmp_path / "m.csv", u="m", y="r")
    y = ns.plants.bouc_wen(log.u, Ts=5e-3)
    assert ns.mape(log.y, y) < 0.5 * ns.mape(log.y, ns.plants.bouc_wen(log.y, Ts=5e-3))
    lines = [f"{a:.3f},{b:.9g},{c:.9g},{d:.9g}" for a, b, c, d in zip(log.t, log.y, log.u, y, strict=True)]
    (tmp_path / "log.csv").write_text("t,r,m,y\n" + "\n".join(lines))
    text, _ = run.good(f"compare {bench}/model.json {tmp_path}/log.csv --input m --reference r --no-plot")
    assert f"{ns.mape(log.y, y):.4g}" in text and f"{ns.nsavi(log.u, log.y):.4g}" in text


def test_compensate_exports_the_law(run, bench, tmp_path):
    code, text, err = run("compensate", bench / "model.json", "--c", tmp_path / "law.c", "--st", tmp_path / "law.st")
    assert code == 0 and not err and "C99 source" in text and "Structured Text" in text
    law = ns.load(bench / "model.json").compensator()
    assert (tmp_path / "law.c").read_text() == law.export("c") and (tmp_path / "law.st").read_text() == law.export("st")
    code, _, err = run("compensate", bench / "model.json", "--st", bench / "model.json")
    assert code == 2 and "this command reads this file" in err


def test_a_law_without_source_is_refused_before_anything_is_written(run, tmp_path):
    ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**3"], [0.5, 1.0, -0.2], Ts=0.01).save(tmp_path / "cubic.json")
    (tmp_path / "ref.csv").write_text("t,r\n0,0\n0.01,0.1\n0.02,0.2\n")
    code, _, err = run(
        f"compensate {tmp_path}/cubic.json --latex {tmp_path}/law.tex --c {tmp_path}/law.c --reference "
        f"{tmp_path}/ref.csv --out {tmp_path}/m.csv"
    )
    assert code == 2 and "This law cannot be exported" in err
    assert {path.name for path in tmp_path.iterdir()} == {"cubic.json", "ref.csv"}


def test_version_and_help(run):
    code, text, _ = run("--version")
    assert code == 0 and text.strip() == ns.__version__
    for command in ("fit", "derive", "compare", "compensate", "simulate", "demo", "diagnose", "add", "effects"):
        code, text, _ = run(command, "--help")
        assert code == 0 and "Usage" in text


@pytest.mark.parametrize("asked, more", (("r", ()), ("r_um", ()), ("r [um]", ()), ("r", ("--channels", "all"))))
def test_a_reference_is_found_by_its_name_before_the_unit(run, tmp_path, asked, more):
    t = np.arange(60) * 0.1
    rows = np.column_stack([t, 1.1 * np.sin(t), np.sin(t) + 0.01 * np.cos(9 * t), np.sin(t)])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t [s],m [V],y [um],r [um]", comments="")
    ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.5], Ts=0.1).save(tmp_path / "model.json")
    given = ["compare", tmp_path / "model.json", tmp_path / "log.csv", "--input", "m", "--reference", asked]
    code, out, err = run(*given, "--no-plot", *more)
    assert code == 0 and "Tracking of the reference" in out and "NSAVI" in out, err


def test_a_constant_output_is_told_by_its_record(run, bench, tmp_path):
    (tmp_path / "still.csv").write_text("t,u,y\n" + "".join(f"{i / 200},{i % 7},3\n" for i in range(60)))
    code, _, err = run("compare", bench / "model.json", tmp_path / "still.csv", "--plot", tmp_path / "p.png")
    assert code == 2 and "record 'still': y is constant (3)" in err and "--output" in err
    assert not (tmp_path / "p.png").exists()


def test_channels_that_a_model_needs_are_columns_of_the_file(run, tmp_path):
    """A law over a reference, and the model over what came of it, with the load that both read."""
    terms = ["y[k-1]", "u[k-1]", "temp_C[k]*u[k-1]"]
    loaded = ns.NARX.from_terms(terms, [0.8, 0.2, 0.05], Ts=0.1, channels=["temp_C"])
    ns.save(loaded, tmp_path / "m.json")
    t = 0.1 * np.arange(80)
    table = "t,r,temp [C]\n" + "".join(f"{a},{np.sin(a)},{2 + np.cos(a)}\n" for a in t)
    (tmp_path / "r.csv").write_text(table)
    (tmp_path / "bare.csv").write_text("t,r\n" + "".join(f"{a},{np.sin(a)}\n" for a in t))
    given = ("compensate", tmp_path / "m.json", "--m0", "0", "--out", tmp_path / "m.csv", "--reference")
    code, text, err = run(*given, tmp_path / "r.csv")
    assert code == 0 and (tmp_path / "m.csv").read_text().startswith("t,r,m,temp_C\n"), err
    (line,) = [line for line in text.splitlines() if line.startswith("  narx-sym ")]
    code, _, err = run(*shlex.split(line)[1:-1], tmp_path / "expected.csv")
    made = ns.read(tmp_path / "expected.csv")
    assert code == 0 and np.abs(made.y[1:] - np.sin(t)[1:]).max() < 1e-6, err
    (tmp_path / "m.csv").unlink()
    code, _, err = run(*given, tmp_path / "bare.csv")
    assert code == 2 and "The model needs the channel 'temp_C'" in err and "there are the columns t, r" in err
    assert not (tmp_path / "m.csv").exists()


def test_another_rate_is_refused_and_no_rate_is_that_of_the_model(run, bench, tmp_path):
    model, out = bench / "model.json", tmp_path / "m.csv"
    for name in ("data", "ref"):
        head, *rows = (bench / f"{name}.csv").read_text().splitlines()
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows[::2]]))
    for given in (
        ("compensate", model, "--reference", tmp_path / "ref.csv", "--out", out),
        ("simulate", model, tmp_path / "data.csv", "--input", "u", "--out", out),
        ("compare", model, tmp_path / "data.csv", "--no-plot"),
        ("commission", model, bench / "data.csv", "--reference", tmp_path / "ref.csv", "--plot", tmp_path / "c.png"),
        ("diagnose", tmp_path / "data.csv", "--base", model),
        ("add", model, "backlash", tmp_path / "data.csv", "--out", tmp_path / "a.json"),
    ):
        code, text, err = run(*given)
        assert code == 2 and "Ts = 0.01 s, the model was identified at 0.005 s" in err and "resample to" in err, err
        assert not text and not out.exists()
    bare = [line.split(",")[1] for line in (bench / "ref.csv").read_text().splitlines()]
    (tmp_path / "bare.csv").write_text("\n".join(bare))
    code, text, err = run("compensate", model, "--reference", tmp_path / "bare.csv", "--out", out)
    assert code == 0 and ns.read(out, u="m", y="r").Ts == 0.005, err
    (line,) = [line for line in text.splitlines() if line.startswith("  narx-sym ")]
    code, _, err = run(*shlex.split(line)[1:-1], tmp_path / "expected.csv")
    assert code == 0 and ns.read(tmp_path / "expected.csv", u="u").Ts == 0.005, err


def test_a_gap_in_a_reference_is_not_said_to_be_split(run, bench, tmp_path):
    (tmp_path / "r.csv").write_text("t,r\n" + "".join(f"{i / 10 + 9 * (i > 9)},{i % 3}\n" for i in range(20)))
    code, _, err = run(f"compensate {bench}/model.json --reference {tmp_path}/r.csv --out {tmp_path}/m.csv")
    assert code == 2 and "have a gap (line 12: gap of" in err and "split" not in err and "use --rows or use --ts" in err


def test_what_is_told_to_do_about_a_hole_can_be_done(run, bench, tmp_path):
    """A reference file is read whole by `commission`: no option drops or cuts its rows."""
    text = "t,r\n" + "".join(f"{i / 10},{'' if i == 5 else i % 3}\n" for i in range(20))
    (tmp_path / "holed.csv").write_text(text)
    model, data, holed = bench / "model.json", bench / "data.csv", tmp_path / "holed.csv"
    code, _, err = run("commission", model, data, "--reference", holed, "--plot", tmp_path / "c.png")
    assert code == 2 and "line 7" in err and "--rows" not in err and "--missing" not in err
    code, _, err = run("compensate", model, "--reference", holed, "--out", tmp_path / "m.csv")
    assert code == 2 and "--rows A:B" in err and "--missing" not in err
    code, _, err = run("fit", holed, "--input", "t", "--output", "r", "--out", tmp_path / "m.json")
    assert code == 2 and "leave the rows out with --rows A:B, or drop them with --missing drop" in err


def test_bad_usage(run, bench, tmp_path):
    for arguments, expected in {
        ("fit",): "Missing argument",
        ("nonsense",): "No such command",
        ("fit", tmp_path / "no.csv", "--out", tmp_path / "m.json"): "no such file",
        ("fit", bench / "data.csv", "--out", tmp_path / "no" / "m.json"): "does not exist",
        ("fit", bench / "data.csv", "--out", tmp_path / "m.json", "--base", "cubic"): "Unknown base",
        ("fit", bench / "data.csv", "--out", tmp_path / "m.json", "--rows", "a:b"): "--rows A:B",
        ("fit", bench / "data.csv", "--out", tmp_path / "m.json", "--delay", "500"): "--delay",
        ("fit", bench / "data.csv", "--out", tmp_path / "m.json", "--method", "foo"): "Unknown method 'foo'",
        ("fit", bench / "data.csv", "--out", bench / "data.csv"): "this command reads this file",
        ("compensate", bench / "model.json", "--latex", bench / "model.json"): "this command reads this file",
        ("compare", bench / "model.json", bench / "data.csv", "--plot", bench / "data.csv"): "this command reads this file",
        ("fit", bench / "data.csv", "--out", tmp_path / "m.json", "--rows", "0:50", "--n-u", "60", "--degree", "1"): "shorter than the largest lag",
        ("fit", bench / "data.csv", "--out", tmp_path / "m.json", "--n-u", "60"): "The pool would have",
        ("derive", tmp_path / "no.json"): "no such model",
        ("compensate", bench / "model.json", "--reference", bench / "ref.csv"): "--reference and --out together",
        ("compensate", bench / "model.json", "--rows", "3:9"): "--rows needs a run of the law",
        ("compensate", bench / "model.json", "--clip"): "--clip needs a run of the law",
        ("compensate", bench / "model.json", "--reference", bench / "ref.csv", "--out", tmp_path / "m.xlsx"): "ends in .csv",
        ("simulate", bench / "model.json", bench / "ref.csv", "--input", "r", "--out", tmp_path / "m.xlsx"): "ends in .csv",
        ("compensate", bench / "model.json", "--reference", bench / "ref.csv", "--column", "q", "--out", tmp_path / "m.csv"): "no column 'q'",
        ("compare", bench / "model.json", bench / "data.csv", "--plot", tmp_path / "p.xyz"): "unknown kind of picture",
        ("compare", bench / "model.json", bench / "data.csv", "--channels", "temp"): "no column 'temp'",
    }.items():  # fmt: skip
        code, _, err = run(*arguments)
        assert code == 2 and expected in " ".join(err.split()), (arguments, err)
        assert "Traceback" not in err


def test_not_invertible_names_term_and_assumption(run, tmp_path):
    path = tmp_path / "m.json"
    ns.save(ns.NARX.from_terms(["y[k-1]", "phi2[k-1]*y[k-1]"], [1.0, 0.1]), path)
    code, _, err = run("compensate", path)
    assert code == 2 and "phi2[k-1]*y[k-1]" in err and "A1(i)" in err


def test_diverging_simulation_is_said(run, tmp_path, bench):
    path = tmp_path / "m.json"
    ns.save(ns.NARX.from_terms(["y[k-1]", "y[k-1]**3", "u[k-1]"], [1.5, 1.0, 1.0]), path)
    code, _, err = run("simulate", path, bench / "data.csv", "--input", "u", "--out", tmp_path / "y.csv", "--y0", "1")
    assert code == 2 and "diverges" in err and not (tmp_path / "y.csv").exists()


def test_what_numpy_warns_of_is_no_note(capsys):
    _noted("overflow encountered in square", RuntimeWarning)
    _noted("The free run explains little.", UserWarning)
    assert capsys.readouterr().err == "note: The free run explains little.\n"


def test_a_machine_with_several_outputs_goes_its_whole_way(run, tmp_path):
    rng, n = np.random.default_rng(4), 600
    v1, v2 = (np.repeat(rng.standard_normal(n), hold)[:n] for hold in (9, 14))
    h = np.zeros((n, 2))
    for i in range(2, n):
        h[i] = 0.9 * h[i - 1] + [0.3 * v1[i - 1] + 0.1 * v2[i - 2], 0.4 * v2[i - 1] - 0.2 * v1[i - 2]]
    h += 0.01 * h.std(0) * rng.standard_normal(h.shape)
    data, model, out = (tmp_path / name for name in ("d.csv", "m.json", "y.csv"))
    rows = np.column_stack([0.1 * np.arange(n), v1, v2, h])
    np.savetxt(data, rows, delimiter=",", header="t,v1,v2,h1,h2", comments="")
    named = ("--input", "v1,v2", "--output", "h1,h2")
    text, _ = run.good("fit", data, *named, "--out", model)
    assert r"\mathrm{h2}_{k}" in text and "d: h2" in text
    assert ns.load(model).outputs == ("h1", "h2") and ns.load(model).inputs == ("u", "v2")
    text, _ = run.good("derive", model, "--latex", tmp_path / "m.tex")
    assert "Stable: its own dynamics" in text and "m_v2[k] = " in text
    assert "Steady state" in (tmp_path / "m.tex").read_text()
    run.good("compare", model, data, "--input", "v1,v2", "--json", tmp_path / "e.json")
    errors = json.loads((tmp_path / "e.json").read_text())["errors"]
    assert [e["record"] for e in errors] == ["d: h1", "d: h2"] and all(e["free_run_nrmse"] < 0.02 for e in errors)
    run.good("simulate", model, data, "--input", "v1,v2", "--y0", "0,0", "--out", out)
    assert ns.metrics.nrmse(h[99:, 1], ns.read(out, u="u", y="h2").y[99:]) < 0.02
    for command, said in (
        (("compensate", model), "this needs one output"),
        (("diagnose", data, "--base", model), "this needs one output"),
        (("derive", model, "--continuous"), "--continuous needs a model with one output"),
        (("simulate", model, data, "--input", "v1", "--out", out), "--input: give one for each of u, v2"),
        (("simulate", model, data, "--y0", "a,b", "--out", out), "--y0 a,b: give a number"),
        (("fit", data, *named, "--out", model, "--creep"), "--creep needs a model with one output"),
    ):
        code, _, err = run(*command)
        assert code == 2 and said in err, err
