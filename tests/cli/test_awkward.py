"""Bad and awkward data: for each kind the message, or what is done and said. One table, on the command line."""

import io
import json
import zipfile

import numpy as np
import pytest
from sampling import only, some
from scipy.io import savemat

import narx_sym as ns
from narx_sym.errors import DataError
from narx_sym.tasks.base import what_to_print

N = 400
T = np.arange(N) * 0.01
U = np.sin(2 * np.pi * T) + 0.5 * np.sin(2 * np.pi * 2.7 * T + 1)


def answer(u):
    y = np.zeros(u.size)
    for i in range(1, u.size):
        y[i] = 0.7 * y[i - 1] + 0.6 * u[i - 1]
    return y + 0.01 * np.random.default_rng(0).standard_normal(u.size)


Y = answer(U)


def csv(t=T, u=U, y=Y, head="t,u,y", sep=",", end="\n", dec=".", extra=None, top=""):
    def shown(x):
        return (x if isinstance(x, str) else f"{x:.9g}").replace(".", dec)

    columns = [t, u, y, *([] if extra is None else [extra])]
    return top + end.join([head, *(sep.join(map(shown, row)) for row in zip(*columns, strict=True))]) + end


def put(x, places, value):
    x = [f"{v:.9g}" for v in x]
    for i in places:
        x[i] = value
    return x


def moved(x, at, by):
    return np.where(np.arange(N) >= at, x + by, x)


def npz(**arrays):
    raw = io.BytesIO()
    np.savez(raw, **arrays)
    return raw.getvalue()


def archive(shape, size=0):
    """A .npz file whose header promises an array of this shape, with `size` bytes of zeros behind it."""
    raw, head = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr("u.npy", head.getvalue() + bytes(size))
    return raw.getvalue()


def mat(**variables):
    raw = io.BytesIO()
    savemat(raw, variables)
    return raw.getvalue()


P = np.random.default_rng(1).permutation(N)
JITTER = T + np.random.default_rng(2).uniform(-0.003, 0.003, N)
NOISE = bytes(np.random.default_rng(3).integers(0, 256, 5000, dtype=np.uint8))
GAPS = np.concatenate([100 * i + 0.01 * np.arange(20) for i in range(20)])

# case: (file name, content, words of the one message on stderr), exit code 2
REFUSED = {
    "NaN": ("a.csv", csv(y=put(Y, [50], "nan")), ["'y' has 1 missing or infinite", "line 52", "--missing drop"]),
    "too many digits": ("a.csv", csv(u=put(U, [5], "1" * 400)), ["'u' has 1 missing or infinite"]),
    "NaN in .npz": ("a.npz", npz(t=T, u=U, y=np.where(T == 0, np.nan, Y)), ["'y' has 1 missing", "row 0"]),
    "text column": ("a.csv", csv(u=["on"] * N), ["'u' has text in line 2: 'on'"]),
    "hexadecimal": ("a.csv", csv(u=["0x10"] * N), ["text in line 2: '0x10'"]),
    "dates": ("a.csv", csv(t=[f"1st of May 00:00:{x:06.3f}" for x in T]), ["'t' holds text", "--ts SECONDS"]),
    "a second row of names": ("a.csv", csv(head="t,u,y\nclock,pump,level"), ["'u' has text in line 2: 'pump'", "--rows"]),
    "thousands": ("a.csv", csv(u=["1,234.5"] * N), ["line 2 has 4 values but the header has 3 names"]),
    "constant input": ("a.csv", csv(u=np.ones(N)), ["the input is constant (1 in all 400"]),
    "constant output": ("a.csv", csv(y=np.ones(N)), ["the output is constant (1 in all 400"]),
    "one signal": ("a.csv", csv(y=U), ["output and input are the same signal", "--output"]),
    "ten samples": ("a.csv", csv(T[:10], U[:10], Y[:10]), ["10 samples are too few", "20 are needed"]),
    "empty": ("a.csv", "", ["the file is empty"]),
    "no header": ("a.csv", csv(head="0,0,0"), ["line 1 has numbers where the column names should be"]),
    "binary": ("a.csv", NOISE, ["binary data"]),
    "zero bytes": ("a.csv", b"t,u,y\n0,1,2\n\0\n", ["binary data"]),
    "wrong names": ("a.csv", csv(head="time,in,out"), ["no column 'u'", "time, in, out (line 1)", "--input"]),
    "two time columns": ("a.csv", csv(head="t,t,u,y", extra=Y), ["two columns are named 't'"]),
    "huge header": ("a.csv", csv(head="t,u,y" + "x" * 3_000_000), ["line 1 has more than 1000000 characters"]),
    "20 000 columns": ("a.csv", ",".join(f"c{i}" for i in range(20_000)) + "\n" + 2 * (",".join("1" * 20_000) + "\n"),
                       ["no column 'u'", "and 19960 more"]),
    "unsorted": ("a.csv", csv(T[P], U[P], Y[P]), ["'t', line 3: time decreases", "sort the rows", "--ts"]),
    "coarse stamps": ("a.csv", csv(np.floor(T * 10) / 10), ["time repeats", "--ts"]),
    "gaps everywhere": ("a.csv", csv(np.arange(N) // 3 * 1000 + np.arange(N) % 3), ["gaps everywhere"]),
    "near the largest number": ("a.csv", csv(y=Y * 1e300), ["'y' has values of the size", "another unit"]),
    "truncated .npz": ("a.npz", npz(t=T, u=U, y=Y)[:5000], ["cannot be read as .npz"]),
    "complex .npz": ("a.npz", npz(t=T, u=U, y=Y + 1j), ["no column 'y'", "left out: y (400,)"]),
    "two outputs in .npz": ("a.npz", npz(t=T, u=U, y=np.c_[Y, Y]), ["no column 'y'", "left out: y (400, 2)"]),
    ".npz that promises too much": ("a.npz", archive((10**13,)), ["cannot be read as .npz"]),
    "truncated .mat": ("a.mat", mat(t=T, u=U, y=Y)[:5000], ["cannot be read as .mat"]),
    "cell in .mat": ("a.mat", mat(t=T, u=U, y=np.array([1, "a"], dtype=object)), ["no column 'y'", "left out: y (1, 2)"]),
    "junk .parquet": ("a.parquet", b"junk", ["a.parquet", "parquet"]),
}  # fmt: skip

# case: (file name, content, options, words of the notes on stderr), exit code 0; no words: nothing is said
SAID = {
    "plain": ("a.csv", csv(), (), []),
    "BOM": ("a.csv", csv().encode("utf-8-sig"), (), []),
    "semicolons": ("a.csv", csv(head="t;u;y", sep=";"), (), []),
    "decimal commas": ("a.csv", csv(head="t;u;y", sep=";", dec=","), (), []),
    "tabs": ("a.tsv", csv(head="t\tu\ty", sep="\t"), (), []),
    "blanks": ("a.dat", csv(head="t u y", sep="  "), (), []),
    "UTF-16": ("a.txt", csv().encode("utf-16"), (), ["UTF-16"]),
    "Latin-1": ("a.csv", csv(head="t,u,y,Länge", extra=U).encode("latin-1"), (), ["not UTF-8; read as Latin-1"]),
    "text beside": ("a.csv", csv(head="t,u,y,remark", extra=["ok"] * N), (), []),
    "text among all channels": ("a.csv", csv(head="t,u,y,remark", extra=["ok"] * N), ("--channels", "all"), ["holds text"]),
    "markup as a name": ("[red].csv", csv(head="t,u,y,<script>", extra=U), (), []),
    "whole numbers": ("a.csv", csv(u=np.round(100 * U).astype(int), y=np.round(100 * Y).astype(int)), (), []),
    "truth values": ("a.csv", csv(u=["True" if x > 0 else "False" for x in U]), (), ["True and False, read as 1 and 0", "two values"]),
    "two-level input": ("a.csv", csv(u=np.sign(U), y=answer(np.sign(U))), (), ["the input takes only two values, -1 and 1"]),
    "saturated sensor": ("a.csv", csv(y=np.clip(Y, -1, 1)), (), ["cut off at 1 in", "cut off at -1 in"]),
    "row of units": ("a.csv", csv(head="t,u,y\ns,V,um"), (), ["line 2 has the units: t [s], u [V], y [um]"]),
    "preamble": ("a.csv", csv(top="Recorder: X\nDate; 2020\n"), (), ["the text above the column names in line 3 is skipped"]),
    "comments": ("a.csv", csv(top="# made by\n" * 2000), (), ["2000 line(s) of comments"]),
    "names behind a mark": ("a.csv", csv(head="# t,u,y"), (), []),
    "comment at the end": ("a.csv", csv() + "# end of file\n", (), ["1 line(s) of comments below the header"]),
    "milliseconds": ("a.csv", csv(1000 * T, head="t_ms,u,y"), ("--time", "t_ms"), ["'t_ms' is converted from ms to s"]),
    "jitter": ("a.csv", csv(JITTER), (), ["time stamps are irregular", "resampled by linear interpolation"]),
    "rounded stamps": ("a.csv", csv(np.round(np.arange(N) / 750, 4)), (), ["snapped"]),
    "lost samples": ("a.csv", csv(T[P < 397], U[P < 397], Y[P < 397]), (), ["3 sample(s) are missing", "filled by linear"]),
    "gap": ("a.csv", csv(moved(T, 200, 5)), (), ["line 202: gap of 5.01 s", "split there"]),
    "twenty gaps": ("a.csv", csv(GAPS), (), ["gap of 99.81 s", "9 further gap(s)"]),
    "repeated stamps, --ts": ("a.csv", csv(np.floor(T * 10) / 10), ("--ts", "0.01"), ["time column 't' not used"]),
    "nanoseconds": ("a.csv", csv(T * 1e9), (), ["seems to last 127 years"]),
    "NaN dropped": ("a.csv", csv(y=put(Y, [50, 60], "")), ("--missing", "drop"),
                    ["2 row(s) with missing or infinite values are filled there by linear interpolation, the first in line 52"]),
    "long NaN dropped": ("a.csv", csv(y=put(Y, range(50, 80), "nan")), ("--missing", "drop"),
                         ["30 row(s)", "line 82: gap of 0.31 s"]),
    "NaN dropped without a time column": ("a.csv", csv(head="a,u,y", u=put(U, [50], "inf")), ("--missing", "drop", "--ts", "0.01"),
                                          ["1 row(s) with missing or infinite values are filled there"]),
    "float32": ("a.npz", npz(t=T.astype("f4"), u=U.astype("f4"), y=Y.astype("f4")), (), ["snapped"]),
    ".mat with other things": ("a.mat", mat(t=T, u=U, y=Y, s={"a": 1}), (), ["left out: s"]),
    "both": ("a.csv", csv(u=U * 1e-9, y=Y * 1e9), (), []),
    "1970": ("a.npz", npz(t=np.round(1.7e9 + T, 2), u=U, y=Y), (), ["by at most 1.1e-07 s"]),
}  # fmt: skip


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, run, tmp_path):
    name, content, words = REFUSED[case]
    path, out = write(tmp_path, name, content), tmp_path / "m.json"
    code, text, err = run("fit", path, "--out", out, "--base", "linear")
    said = [line for line in err.splitlines() if not line.startswith("Identifying")]
    assert code == 2 and not text and len(said) == 1 and said[0].startswith("narx-sym: "), err
    for word in [path.stem, *words] if "too few" not in words[0] else words:
        assert word in said[0]
    assert len(said[0]) < 1500 and sorted(p.name for p in tmp_path.iterdir()) == [name]


def read(path, options):
    """Read a file as the command does with these options."""
    return ns.read(
        path, t=options[1] if "--time" in options else "t", Ts=0.01 if "--ts" in options else None,
        missing="drop" if "drop" in options else "refuse", channels="all" if "all" in options else (),
    )  # fmt: skip


@pytest.mark.parametrize("case", SAID)
def test_said(case, tmp_path):
    name, content, options, words = SAID[case]
    record = read(write(tmp_path, name, content), options)
    said = what_to_print([record])
    for word in words:
        assert any(word in n for n in said), (word, said)
    if not words:  # what is said to be unchanged is
        assert not said
        for found, given in ((record.u, U), (record.y, Y)):
            assert np.allclose(found / np.std(found), given / np.std(given), atol=0.01)


@pytest.mark.parametrize("case", some(SAID, 6))
def test_the_command_says_what_reading_does(case, run, tmp_path):
    name, content, options, _ = SAID[case]
    path, out = write(tmp_path, name, content), tmp_path / "m.json"
    code, text, err = run("fit", path, "--out", out, "--base", "linear", "--n-y", 1, "--n-u", 1, "--delay", 0, *options)
    assert code == 0 and out.exists() and "nan" not in text.replace(path.stem, "").lower(), err
    notes = [line.removeprefix("note: ") for line in err.splitlines() if line.startswith("note:")]
    assert notes == what_to_print([read(path, options)])


def test_several_records_of_different_length(run, tmp_path):
    for name, rows in (("a.csv", slice(0, 150)), ("b.csv", slice(150, 400)), ("c.csv", slice(0, 30))):
        (tmp_path / name).write_text(csv(T[rows], U[rows], Y[rows]))
    code, text, err = run(
        "fit", *(tmp_path / f"{n}.csv" for n in "abc"), "--out", tmp_path / "m.json", "--base", "linear", "--n-y", 1,
        "--n-u", 1, "--delay", 0,
    )  # fmt: skip
    assert code == 0 and "from 430 samples" in err and all(f" {n} " in text for n in "abc")
    (tmp_path / "d.csv").write_text(csv(2 * T))
    code, _, err = run("fit", tmp_path / "a.csv", tmp_path / "d.csv", "--out", tmp_path / "n.json")
    assert code == 2 and "different sampling times (a: 0.01 s, d: 0.02 s)" in err


def test_the_notes_are_in_the_diagnosis(run, tmp_path, monkeypatch):
    monkeypatch.setattr("narx_sym.cli.diagnose.with_own", lambda files: only("drift"))
    path, found = write(tmp_path, "a.csv", csv(moved(T, 200, 5), np.sign(U), y=answer(np.sign(U)))), tmp_path / "d.json"
    _, err = run.good("diagnose", path, "--json", found, "--rows", "100:")
    said = json.loads(found.read_text())["data_notes"]
    assert len(said) == 2 and said[0].startswith("a: line 202: gap") and "two values" in said[1]
    assert all(f"note: {s}" in err for s in said)


@pytest.mark.parametrize("command", ("compare", "diagnose", "add", "simulate", "compensate"))
@pytest.mark.parametrize("case", ("NaN", "wrong names"))
def test_the_other_commands_refuse_too(command, case, run, tmp_path):
    name, content, words = REFUSED[case]
    path, model, out = write(tmp_path, name, content), tmp_path / "m.json", tmp_path / "out"
    ns.save(ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.7, 0.6], Ts=0.01), model)
    given = {
        "compare": ("compare", model, path, "--plot", tmp_path / "out.png"), "diagnose": ("diagnose", path, "--json", out),
        "add": ("add", model, "backlash", path, "--out", out), "simulate": ("simulate", model, path, "--out", out, "--input", "u"),
        "compensate": ("compensate", model, "--reference", path, "--column", "y", "--out", out),
    }  # fmt: skip
    code, _, err = run(*given[command])
    if command == "simulate" and case == "NaN":  # only y is bad; it is not read
        assert code == 0
        return
    assert code == 2 and err.count("narx-sym: ") == 1 and "Traceback" not in err and "internal" not in err
    assert words[0].split("'")[0] in err
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([name, "m.json"])


def test_too_few_complete_rows(tmp_path):
    path = write(tmp_path, "a.csv", csv(y=["nan"] * N))
    with pytest.raises(DataError, match="0 complete row"):
        ns.read(path, missing="drop")
    with pytest.raises(DataError, match="refused or dropped"):
        ns.read(path, missing="zero")


def test_archives_that_would_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("narx_sym.data.tables.LARGEST_FILE", 1_000_000)
    for name, content in (("a.npz", archive((10**6,), 8 * 10**6)), ("a.mat", mat(u=np.zeros(10**6)))):
        with pytest.raises(DataError, match=r"0\.008 GB"):
            ns.read(write(tmp_path, name, content))
