"""Logs of measuring systems: the tests write a file of each kind with the library of its format, and read it."""

import sys

import numpy as np
import pytest

from narx_sym.data.readers import load
from narx_sym.data.record import read, read_signal
from narx_sym.errors import DataError

FAST, SLOW = np.arange(1000) * 0.001, np.arange(101) * 0.01  # [s]
U, Y, TEMP = np.sin(FAST * 9), np.cos(FAST * 9) / 2, 20 + 3 * SLOW


def mdf(path):
    asammdf = pytest.importorskip("asammdf")
    file = asammdf.MDF(version="4.10")

    def signals(t, **named):
        return [
            asammdf.Signal(np.asarray(x), t, name=n.replace("__", " "), unit=unit) for n, (x, unit) in named.items()
        ]

    file.append(signals(FAST, Voltage=(U, "V"), Position=(Y, "um")))
    file.append(signals(SLOW, Temp__C=(TEMP, "degC"), Twice=(SLOW, "")))
    file.append(signals(SLOW + 0.005, Twice=(2 * SLOW, "")))
    file.append([asammdf.Signal(np.array([b"on"] * 101), SLOW, name="State", encoding="utf-8")])
    file.save(path)
    file.close()
    return path


def tdms(path):
    nptdms = pytest.importorskip("nptdms")

    def channel(group, name, x, step=None, unit=""):
        time = {} if step is None else {"wf_increment": step, "wf_start_offset": 0.0}
        return nptdms.ChannelObject(group, name, x, properties={**time, **({"unit_string": unit} if unit else {})})

    with nptdms.TdmsWriter(path) as file:
        file.write_segment(
            [
                channel("drive", "Voltage", U, 0.001, "V"), channel("stage", "Position", Y, 0.001, "um"),
                channel("stage", "Temp C", TEMP, 0.01, "degC"), channel("a", "Twice", SLOW, 0.01),
                channel("b", "Twice", 2 * SLOW, 0.01), channel("b", "State", ["on"] * 3), channel("b", "Loose", SLOW),
            ]
        )  # fmt: skip
    return path


def mat(path, **more):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, x in {"t": FAST, "Voltage": U, "Position": Y, **more}.items():
            file.create_dataset(name, data=x[None, :]).attrs["MATLAB_class"] = np.bytes_(b"double")
        file.create_dataset("text", data=np.array([[72, 105]], dtype="u2")).attrs["MATLAB_class"] = np.bytes_(b"char")
        file.create_dataset("matrix", data=np.eye(3)).attrs["MATLAB_class"] = np.bytes_(b"double")
        file.create_group("settings").attrs["MATLAB_class"] = np.bytes_(b"struct")
        file.create_group("#refs#")
    with open(path, "r+b") as raw:  # the text that MATLAB puts in front
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


@pytest.fixture(params=(mdf, tdms, mat), ids=("x.mf4", "x.tdms", "x.mat"))
def log(request, tmp_path):
    return request.param(tmp_path / {mdf: "x.mf4", tdms: "x.tdms", mat: "x.mat"}[request.param])


def test_channels_are_chosen_by_name(log):
    record = read(log, u="Voltage", y="Position")
    assert np.array_equal(record.u, U) and np.array_equal(record.y, Y) and record.Ts == pytest.approx(0.001)
    values, step, _ = read_signal(log, "Position")
    assert np.array_equal(values, Y) and step == pytest.approx(0.001)


def test_a_wrong_name_is_answered_with_the_one_that_was_meant(log):
    with pytest.raises(DataError, match=r"no column 'position', did you mean 'Position'\? there are .*Voltage"):
        read(log, u="Voltage", y="position")
    with pytest.raises(DataError, match=r"no column 'qqq'; there are"):
        read(log, u="qqq", y="Position")


@pytest.mark.parametrize("kind", (mdf, tdms), ids=("mf4", "tdms"))
def test_several_rates_come_to_the_fastest_of_those_chosen(kind, tmp_path):
    path = kind(tmp_path / f"x.{'mf4' if kind is mdf else 'tdms'}")
    record = read(path, u="Voltage", y="Position", channels=["Temp C"])
    assert np.abs(record.channels["Temp_C"] - (20 + 3 * FAST)).max() < 1e-9 and np.array_equal(record.u, U)
    (said,) = [n for n in record.notes if "interpolated" in n]
    assert "'Temp C' (100 Hz)" in said and "(1000 Hz)" in said
    (units,) = [n for n in record.notes if "units" in n]
    assert "Voltage [V]" in units and "Position [um]" in units and "Temp C [degC]" in units
    assert not any("interpolated" in n for n in read(path, u="Voltage", y="Position").notes)
    # The slow ones alone stay at their own rate.
    twice = ("group 1/Twice", "Temp C") if kind is mdf else ("a/Twice", "Temp C")
    slow = read(path, u=twice[0], y=twice[1])
    assert slow.Ts == pytest.approx(0.01) and np.array_equal(slow.u, SLOW) and np.array_equal(slow.y, TEMP)


def test_one_name_in_several_groups_is_told_apart_and_text_left_out(tmp_path):
    for table, first, second in (
        (load(mdf(tmp_path / "x.mf4")), "group 1/Twice", "group 2/Twice"),
        (load(tdms(tmp_path / "x.tdms")), "a/Twice", "b/Twice"),
    ):
        assert {first, second} <= set(table.columns) and "Twice" not in table.columns and "State" not in table.columns
        assert any("left out: State" in n for n in table.notes)
        assert len({x.size for x in table.columns.values()}) == 1
    assert any("'Loose' has no time stamps" in n for n in table.notes)


def test_only_the_time_that_all_have_is_kept(tmp_path):
    record = read(mdf(tmp_path / "x.mf4"), u="Voltage", y="group 2/Twice")
    assert record.t[0] == pytest.approx(0.005) and len(record) == 995
    assert np.abs(record.y - 2 * (record.t - 0.005)).max() < 1e-9
    assert any("995 samples of 1000 in common" in n for n in record.notes)


def test_matlab_of_version_7_3_says_what_it_leaves_out(tmp_path):
    table = load(mat(tmp_path / "x.mat"))
    (said,) = table.notes
    assert set(table.columns) == {"t", "Voltage", "Position"}
    assert "text (char)" in said and "matrix" in said and "settings (struct)" in said and "#refs#" not in said


@pytest.mark.parametrize("ending", (".mf4", ".mdf", ".tdms"))
def test_what_is_no_log(ending, tmp_path):
    pytest.importorskip("nptdms" if ending == ".tdms" else "asammdf")
    for content in (b"junk", bytes(300), b"MDF     4.10" + bytes(500), b"TDSm" + b"\xff" * 100):
        (tmp_path / f"a{ending}").write_bytes(content)
        with pytest.raises(DataError, match=f"a{ending}: "):
            load(tmp_path / f"a{ending}")


def test_a_broken_matlab_file(tmp_path):
    path = mat(tmp_path / "x.mat")
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(DataError, match=r"x\.mat: cannot be read"):
        load(path)


@pytest.mark.parametrize(("package", "ending"), (("asammdf", ".mf4"), ("nptdms", ".tdms"), ("h5py", ".mat")))
def test_without_the_extra(package, ending, tmp_path, monkeypatch):
    path = mat(tmp_path / "x.mat") if ending == ".mat" else tmp_path / f"x{ending}"
    if ending != ".mat":
        path.write_bytes(b"log")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(DataError, match=r"narx-sym\[logs\]"):
        load(path)


def test_too_much(tmp_path, monkeypatch):
    path = tdms(tmp_path / "x.tdms")
    monkeypatch.setattr("narx_sym.data.tables.LARGEST_FILE", 10_000)
    with pytest.raises(DataError, match="choose fewer"):
        load(path)
    assert load(path, {"Voltage"}).columns["Voltage"].size == 1000


def test_on_the_command_line(run, tmp_path):
    path = tdms(tmp_path / "x.tdms")
    code, text, err = run(f"fit {path} --input Voltage --output Position --base linear --out {tmp_path}/m.json")
    assert code == 0 and "units in the file: Voltage [V], Position [um]" in (text + err).replace("\n", " ")
