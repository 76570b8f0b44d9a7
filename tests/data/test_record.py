"""Records, reading, regular time, writing: values and messages."""

import os

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import CASES, SHARED, needs_cases, needs_shared
from scipy.io import savemat

from narx_sym.data.record import Record, check_excitation, one_sine, read, read_signal
from narx_sym.data.timegrid import regular_time
from narx_sym.errors import DataError
from narx_sym.files.atomic import write_csv, write_text


def record(n=100, **more):
    k = np.arange(n)
    return Record.from_arrays(np.sin(0.1 * k), np.cos(0.1 * k), Ts=0.5, channels={"p": k}, **more)


def put(folder, text, name="x.csv", encoding="utf-8"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return path


def message(call, *args, **kwargs):
    with pytest.raises(DataError) as error:
        call(*args, **kwargs)
    assert "\n" not in str(error.value)
    return str(error.value)


# ---------------------------------------------------------------- Record


def test_record_holds_read_only_float_copies():
    u, series = np.arange(5), pd.Series([1, 2, 3, 4, 5.5])
    r = Record.from_arrays(u, series, Ts=0.1, channels={"p": u[:, None]})
    u[0] = series.iloc[0] = 99
    assert r.u[0] == 0 and r.channels["p"][0] == 0 and r.y[0] == 1
    for a in (r.u, r.y, r.t, r.channels["p"], r[1:].u):
        assert a.dtype == np.float64 and a.ndim == 1 and a.flags.c_contiguous and not a.flags.writeable
    with pytest.raises(AttributeError):
        r.Ts = 3
    np.testing.assert_allclose(r.t, [0, 0.1, 0.2, 0.3, 0.4])
    assert len(r) == 5 and r.notes == () and r.breaks == ()


def test_from_arrays_finds_Ts_from_stamps():
    r = Record.from_arrays([1, 2, 3], [1, 2, 3], t=[5, 5.25, 5.5])
    assert r.Ts == 0.25 and r.t[0] == 5
    r = Record.from_arrays([1, 2, 3], [1, 2, 3], t=[5, 4, 3], Ts=2)  # the given Ts wins, and is said
    assert r.Ts == 2 and r.t.tolist() == [0, 2, 4] and "not used" in r.notes[0]


@pytest.mark.parametrize(
    "u, y, more, words",
    [
        ([1, 2, 3], [1, 2], {"Ts": 1}, "u has 3 samples but y has 2"),
        ([1, 2], [1, 2], {"Ts": 1, "channels": {"p": [1]}}, "channel p has 1"),
        ([1, 2], [1, 2], {"t": [1, 2, 3]}, "t has 3"),
        ([1], [1], {"Ts": 1}, "at least 2"),
        ([1, np.nan, np.nan], [1, 2, 3], {"Ts": 1}, "u has 2 missing or infinite value(s), the first at index 1"),
        ([1, 2], [1, np.inf], {"Ts": 1}, "y has 1 missing"),
        (np.eye(3), [1, 2, 3], {"Ts": 1}, "shape (3, 3)"),
        (["a", "b"], [1, 2], {"Ts": 1}, "u is not an array of real numbers"),
        ([1j, 2], [1, 2], {"Ts": 1}, "real numbers"),
        ([1, 2], [1, 2], {}, "no sampling time"),
        ([1, 2], [1, 2], {"Ts": 0}, "positive number of seconds, not 0"),
        ([1, 2], [1, 2], {"Ts": "fast"}, "'fast'"),
        ([1, 2, 3], [1, 2, 3], {"t": [0, 2, 1]}, "t[2]: time decreases"),
    ],
)
def test_from_arrays_refuses(u, y, more, words):
    assert words in message(Record.from_arrays, u, y, **more)


def test_breaks_must_lie_inside():
    x = np.arange(4.0)
    for breaks in ((0,), (4,), (2, 2), (3, 1)):
        assert "breaks" in message(Record, x, x, x, 1.0, breaks=breaks)


def test_slices_carry_channels_breaks_and_notes():
    r = record(30)
    r = Record(r.u, r.y, r.t, r.Ts, r.channels, "b", ("said",), (10, 20))
    s = r[5:25]
    assert len(s) == 20 and s.breaks == (5, 15) and s.notes == ("said",) and s.name == "b" and s.Ts == 0.5
    np.testing.assert_array_equal(s.channels["p"], np.arange(5, 25))
    np.testing.assert_array_equal(s.t, r.t[5:25])
    assert r[10:].breaks == (10,) and r[:10].breaks == () and r[-5:].breaks == ()
    assert [len(p) for p in s.segments()] == [5, 10, 5]
    assert all(p.breaks == () for p in s.segments())
    np.testing.assert_array_equal(np.concatenate([p.u for p in s.segments()]), s.u)
    assert [len(p) for p in r[9:].segments()] == [10, 10]  # one sample alone is no segment
    assert len(record(7).segments()) == 1


def test_slices_refuse():
    r = record(30)
    assert "step of a slice must be 1, not 2" in message(r.__getitem__, slice(0, 20, 2))
    assert "at least 2" in message(r.__getitem__, slice(5, 6))
    with pytest.raises(TypeError, match="slice"):
        r[3]


def test_split():
    a, b = record(100).split(0.7)
    assert len(a) == 70 and len(b) == 30 and b.channels["p"][0] == 70
    for fraction in (0, 1, 0.001, 1.5, -0.2):
        assert "fewer than 2" in message(record(100).split, fraction)


def test_repr_is_one_line():
    text = repr(record(101, name="run"))
    assert "\n" not in text
    for part in ("'run'", "N = 101", "Ts = 0.5 s", "50 s", "u in [-", "y in [", "p in [0, 100]"):
        assert part in text


def test_check_excitation():
    check_excitation(record())
    x = np.arange(5)
    text = message(check_excitation, Record.from_arrays(np.full(5, 1.8), x, Ts=1))
    assert "input is constant (1.8" in text and "nothing can be identified" in text and "--input" in text
    assert "output is constant" in message(check_excitation, Record.from_arrays(x, 0 * x, Ts=1))


# ---------------------------------------------------------------- text files

GOOD = "t,u,y,p\n0,1,10,5\n0.1,2,20,6\n0.2,3.5,30,7\n0.3,4,40,8\n"


def test_numbers_are_read_with_full_precision(tmp_path):
    values = np.random.default_rng(0).normal(size=200) * 10.0 ** np.arange(-100, 100)
    text = "t,u,y\n" + "".join(f"{k},{float(v)!r},1\n" for k, v in enumerate(values))
    np.testing.assert_allclose(read(put(tmp_path, text)).u, values, rtol=1e-13)  # exact from pandas 3 on
    text = text.replace(",", ";").replace(".", ",")
    np.testing.assert_allclose(read(put(tmp_path, text)).u, values, rtol=1e-13)  # exact from pandas 3 on


def test_chosen_columns_and_channels(tmp_path):
    path = put(tmp_path, GOOD)
    r = read(path, u="p", y="u", channels=["y"])
    assert r.u.tolist() == [5, 6, 7, 8] and r.y.tolist() == [1, 2, 3.5, 4] and list(r.channels) == ["channel_y"]
    assert list(read(path, channels="all").channels) == ["p"]
    assert list(read(path, channels="p, y").channels) == ["p", "channel_y"]
    assert "no column 'q'" in (text := message(read, path, channels=["q"])) and "--channels" in text


def test_rows(tmp_path):
    path = put(tmp_path, GOOD)
    for rows in ("1:3", slice(1, 3), " 1 : 3 ", "-3:-1"):
        r = read(path, rows=rows)
        assert r.u.tolist() == [2, 3.5] and r.t[0] == 0.1
    assert len(read(path, rows="1:")) == 3 and len(read(path, rows=":2")) == 2
    assert "A:B" in message(read, path, rows="1-3")
    assert "A:B" in message(read, path, rows="-:3")
    assert "step 1" in message(read, path, rows=slice(0, 4, 2))
    assert "1 data row(s) left of 4" in message(read, path, rows="3:9")


def test_Ts_overrides_the_column_even_a_bad_one(tmp_path):
    path = put(tmp_path, "t,u,y\nx,1,2\nx,2,3\n")
    r = read(path, Ts=0.25)
    assert r.t.tolist() == [0, 0.25] and "not used" in r.notes[0] and "0.25" in r.notes[0]
    assert read(put(tmp_path, "u,y\n1,2\n2,3\n"), Ts=2).notes == ()


@pytest.mark.parametrize(  # further ones: tests/cli/test_awkward.py
    "text, words",
    [
        ("t,u,out\n0,1,2\n1,2,3\n", ["no column 'y'", "t, u, out", "--output"]),
        ("time,u,y\n0,1,2\n1,2,3\n", ["no time column 't'", "--ts", "--time", "time, u, y"]),
        ("t,u,y\n0,1,2\n1,2,3\n2,oops,4\n3,zzz,4\n", ["'u'", "text in line 4", "'oops'"]),
        ("t,u,y\n0,1,2\n\n1,2,3\n2,oops,4\n", ["text in line 5"]),
        ("t;u;y\n0;1,5;2\n1;2.5;3\n", ["'u'", "line 3", "'2.5'"]),
        ("t,u,y\n0,1,2\n1,,3\n2,nan,4\n", ["'u'", "2 missing or infinite", "line 3", "--rows"]),
        ("t,u,y\n0,1,2\n1,2\n2,3,4\n", ["'y'", "1 missing", "line 3"]),
        ('t,u,y\n0,1,"2\n1,2,3\n', ["quotes"]),
    ],
)
def test_bad_text_files(tmp_path, text, words):
    path = put(tmp_path, text)
    found = message(read, path)
    for word in [str(path), *words]:
        assert word in found


def test_only_used_columns_and_rows_matter(tmp_path):
    text = "t,u,y,q,q\ns,V,um,-,-\n0,1,2,nan,x\n1,2,3,,x\n2,nan,3,,x\n"
    path = put(tmp_path, text)
    r = read(path, rows="1:3")
    assert r.u.tolist() == [1, 2] and r.y.tolist() == [2, 3]
    assert "line 5" in message(read, path, rows="1:")
    assert "text in line 2" in message(read, path)
    assert "named 'q'" in message(read, path, rows="1:3", channels=["q"])
    path = put(tmp_path, "t,u,y\n0,1,2\n1,2,3\n2,x,3\n")
    assert "text in line 4" in message(read, path, rows="1:")


def test_paths_are_refused(tmp_path):
    assert "no such file" in message(read, tmp_path / "none.csv")
    assert "is a folder" in message(read, tmp_path)
    assert "unknown kind of file '.xlsx'" in message(read, put(tmp_path, "x", "x.xlsx"))


# ---------------------------------------------------------------- other formats


def test_npz(tmp_path):
    k = np.arange(5.0)
    np.savez(tmp_path / "a.npz", t=k * 0.1, u=k[:, None], y=k**2, gain=3.0)
    r = read(tmp_path / "a.npz")
    assert r.u.tolist() == k.tolist() and r.Ts == 0.1 and "gain" in r.notes[0]
    np.savez(tmp_path / "b.npz", t=k, u=np.where(k == 3, np.nan, k), y=k)
    assert "row 3" in message(read, tmp_path / "b.npz")
    np.savez(tmp_path / "c.npz", t=k, u=k, y=k[:3])
    assert "samples but" in message(read, tmp_path / "c.npz")
    np.savez(tmp_path / "d.npz", u=np.array([{}, 1], dtype=object))
    assert "cannot be read as .npz" in message(read, tmp_path / "d.npz")
    assert "cannot be read as .npz" in message(read, put(tmp_path, "junk", "e.npz"))
    np.savez(tmp_path / "f.npz", u=np.eye(3))
    assert "no vector" in message(read, tmp_path / "f.npz")


def test_mat(tmp_path):
    k = np.arange(5.0)
    savemat(tmp_path / "a.mat", {"t": k * 0.1, "u": k, "y": k[:, None] ** 2, "s": {"a": 1}})
    r = read(tmp_path / "a.mat")
    assert r.y.tolist() == (k**2).tolist() and r.Ts == 0.1 and "s" in r.notes[0]
    assert "no column 'v'; there are the columns t, u, y" in message(read, tmp_path / "a.mat", u="v")
    assert "cannot be read as .mat" in message(read, put(tmp_path, "junk", "b.mat"))
    header = b"MATLAB 7.3 MAT-file".ljust(124, b" ") + b"\x00\x02IM"
    assert "v7.3" in message(read, put(tmp_path, header + bytes(512), "c.mat"))


def test_parquet_without_its_reader(tmp_path, monkeypatch):
    def missing(*args, **kwargs):
        raise ImportError("no engine")

    monkeypatch.setattr(pd, "read_parquet", missing)
    assert "pyarrow" in message(read, put(tmp_path, "x", "a.parquet"))


def test_parquet_columns(tmp_path, monkeypatch):
    frame = pd.DataFrame(
        {"t": [0, 1, 2], "u": [1.0, 2, 3], "y": pd.array([1, None, 3], dtype="Int64"), "w": list("abc")}
    )
    monkeypatch.setattr(pd, "read_parquet", lambda name: frame)
    path = put(tmp_path, "x", "a.parquet")
    assert read(path, y="u").y.tolist() == [1, 2, 3]
    assert "'y' has 1 missing" in message(read, path)
    assert "text in row 0: 'a'" in message(read, path, y="w")


# ---------------------------------------------------------------- one signal


def test_read_signal(tmp_path):
    path = put(tmp_path, "r\n1\n1\n1\n")
    values, Ts, t = read_signal(path, "r")
    assert values.tolist() == [1, 1, 1] and Ts is None and t.tolist() == [0, 1, 2]
    assert read_signal(path, None, Ts=0.5)[1:][1].tolist() == [0, 0.5, 1]
    path = put(tmp_path, GOOD)
    values, Ts, t = read_signal(path, "y", rows="1:")
    assert values.tolist() == [20, 30, 40] and Ts == 0.1 and t[0] == 0.1
    assert "which column" in (text := message(read_signal, path, None, option="--reference")) and "--reference" in text
    assert "no column 'r'" in (text := message(read_signal, path, "r", option="--reference")) and "--reference" in text
    assert "line 2" in message(read_signal, put(tmp_path, "r\n\n1\n"[:2] + "a\n1\n"), "r")


def test_read_signal_says_resampling_and_refuses_gaps(tmp_path):
    t = np.arange(40) * 0.1
    jitter = t + 0.02 * np.sin(np.arange(40) ** 2)
    rows = "".join(f"{a:.6f},{a:.6f}\n" for a in jitter)
    with pytest.warns(UserWarning, match="irregular"):
        values, _, time = read_signal(put(tmp_path, "t,r\n" + rows), "r")
    np.testing.assert_allclose(values, time, atol=1e-9)
    for start in (1, 20):
        gap = np.where(np.arange(40) < start, t, t + 5)
        rows = "".join(f"{a:.6f},{a:.6f}\n" for a in gap)
        assert "gap" in message(read_signal, put(tmp_path, "t,r\n" + rows), "r")


# ---------------------------------------------------------------- time


@settings(max_examples=150, deadline=None)
@given(
    n=st.integers(2, 400),
    Ts=st.sampled_from([0.005, 1 / 750, 0.01, 1e-6, 2.0, 1 / 3, 1 / 44100, 0.0123]),
    start=st.sampled_from([0.0, 1.0, 1234.5, -3.0]),
    digits=st.integers(1, 6),
    floor=st.booleans(),
)
def test_rounded_stamps_never_change_samples(n, Ts, start, digits, floor):
    unit = 10.0 ** (np.floor(np.log10(Ts)) - digits)
    exact = start + Ts * np.arange(n)
    t = np.round((np.floor if floor else np.rint)(exact / unit) * unit, 15)
    x = np.random.default_rng(n).normal(size=n)
    grid = regular_time(t)
    np.testing.assert_array_equal(grid.apply(x), x)
    assert not grid.resampled and grid.breaks == () and grid.t.size == n
    if n >= 20:  # a few stamps may all end in 0, then their last digit is not the printed one
        assert np.max(np.abs(grid.t - t)) <= 1.3 * unit + 3e-3 * Ts
        # Stamps lie within one unit of the truth and the grid within 0.6 of the stamps, at both ends.
        assert abs(grid.Ts - Ts) * (n - 1) <= 2.2 * unit + 3e-3 * Ts
    assert np.ptp(np.diff(grid.t)) <= 1e-9 * Ts + 4 * np.spacing(np.abs(grid.t).max())


def test_nice_steps_are_found():
    k = np.arange(5000)
    assert regular_time(np.round(k / 750, 6)).Ts == 1 / 750
    assert regular_time(k * 0.005).Ts == 0.005
    assert regular_time(np.round(k * 0.005, 3)).notes == ()  # exact stamps: nothing to say
    assert "snapped" in regular_time(np.round(k / 750, 6)).notes[0]
    assert regular_time(k * np.pi / 1000).Ts == pytest.approx(np.pi / 1000, rel=1e-9)


def test_jitter_below_a_thousandth_is_no_jitter():
    noise = np.random.default_rng(0).uniform(-1, 1, 500)
    t = np.arange(500) * 0.01
    assert not regular_time(t + 0.5e-5 * noise).resampled
    assert regular_time(t + 3e-5 * noise).resampled


def test_jitter_is_resampled_and_said():
    rng = np.random.default_rng(1)
    t = 0.01 * np.arange(500) + rng.uniform(-0.002, 0.002, 500)
    grid = regular_time(t)
    assert grid.resampled and grid.breaks == () and grid.Ts == pytest.approx(0.01, rel=0.05)
    assert "irregular" in grid.notes[-1] and "linear interpolation" in grid.notes[-1] and "jitter" in grid.notes[-1]
    np.testing.assert_allclose(grid.apply(3 * t + 1), 3 * grid.t + 1, atol=1e-9)  # a line stays a line
    switch = (t > 2.0).astype(float)  # and a command that rests has no values between its levels
    assert set(grid.apply(switch)) == {0.0, 1.0}
    changes = (float(x[np.argmax(s > 0)]) for x, s in ((t, switch), (grid.t, grid.apply(switch))))
    assert abs(next(changes) - next(changes)) <= grid.Ts
    assert grid.t[0] == t[0] and grid.t[-1] <= t[-1] + 1e-6
    assert grid.t[-1] > t[-1] - grid.Ts


@pytest.mark.parametrize("holes", [[50], [20, 21, 22], [7, 8, 30, 61, 62, 63, 64, 110, 151, 152, 190]])
def test_missing_samples_are_filled_and_the_others_kept(holes):
    k = np.delete(np.arange(200), holes)
    x = np.random.default_rng(0).normal(size=k.size)
    for t in (np.round(k * 0.01, 2), np.round(k * 0.01, 4)):
        grid = regular_time(t)
        assert grid.Ts == 0.01 and grid.t.size == 200 and f"{len(holes)} sample(s) are missing" in grid.notes[-1]
        np.testing.assert_array_equal(grid.apply(x)[k], x)


def test_gaps_split_and_short_parts_are_dropped():
    t = np.concatenate([[0.0], 1 + 0.01 * np.arange(50), 5 + 0.01 * np.arange(30), [9.0, 9.01]]).round(3)
    x = np.arange(t.size, dtype=float)
    grid = regular_time(t, lambda i: f"line {i + 2}")
    assert grid.breaks == (50,) and not grid.resampled and grid.Ts == 0.01
    np.testing.assert_array_equal(grid.apply(x), x[1:81])
    np.testing.assert_allclose(grid.t, t[1:81], atol=1e-12)
    notes = " ".join(grid.notes)
    assert "line 2: a piece of only 1 sample" in notes and "line 3: gap of 1 s" in notes
    assert "line 83: a piece of only 2 sample" in notes


def test_ten_steps_are_no_gap_and_eleven_are():
    for steps, breaks in ((10, ()), (11, (20,))):
        k = np.concatenate([np.arange(20), 19 + steps + np.arange(20)])
        assert regular_time(k * 0.5).breaks == breaks


def in_bursts(Ts, poll, seed=0, n=400):
    """Stamps of rows of every Ts seconds that are read about every poll seconds, many at once."""
    rng = np.random.default_rng(seed)
    reads = poll * (np.arange(int(n * Ts / poll) + 3) + rng.uniform(0, 0.1, int(n * Ts / poll) + 3))
    at = np.searchsorted(reads, Ts * np.arange(n))
    place = np.arange(n) - np.searchsorted(at, at)
    return reads[at] + (0.02 * place + rng.uniform(0, 0.005, n)) * Ts


@pytest.mark.parametrize(("Ts", "poll"), [(0.008, 0.064), (0.0123, 0.1), (0.001, 0.016), (0.02, 0.25)])
def test_rows_read_in_bursts_are_even(Ts, poll):
    x = np.random.default_rng(1).normal(size=400)
    grid = regular_time(in_bursts(Ts, poll))
    assert grid.Ts == pytest.approx(Ts, rel=1e-3) and not grid.breaks and "bursts" in grid.notes[0]
    np.testing.assert_array_equal(grid.apply(x), x)


def test_a_clock_that_pauses_and_uneven_parts_are_no_bursts():
    clock = np.concatenate([0.5 * i + 0.001 * np.arange(12) for i in range(20)])
    assert len(regular_time(clock).breaks) == 19
    rng = np.random.default_rng(0)
    starts, sizes = np.cumsum(rng.uniform(0.5, 20, 20)), rng.integers(11, 200, 20)
    steps = 0.001 * rng.uniform(0.7, 1.3, (20, 200))
    parts = np.concatenate([s + np.cumsum(d[:n]) for s, d, n in zip(starts, steps, sizes, strict=True)])
    assert len(regular_time(parts).breaks) == 19


def test_stamps_that_repeat_propose_an_even_step():
    assert "--ts 0.01," in message(regular_time, np.floor(np.arange(401) / 10) / 10)
    assert "evenly" not in message(regular_time, np.array([0.0, 1.0, 0.5]))


# ---------------------------------------------------------------- names below other lines, and units below names

DATA = "".join(f"{i / 10},{i % 7},{i % 5}\n" for i in range(30))


@pytest.mark.parametrize(
    ("text", "units", "words"),
    [
        (
            "2024-03-05 10:11:12.5\nt, u, y\ns, A, N.mm\n" + DATA,
            {"u": "A", "y": "N.mm"},
            ["line 2", "line 3 has the units"],
        ),
        ("t;u;y\n[s];[bar];(inc)\n" + DATA.replace(",", ";"), {"u": "bar", "y": "inc"}, ["y [inc]"]),
        ("t,u,y\ns,%,\n" + DATA, {"u": "%"}, ["u [%]"]),
        ("# rig 3\nt\tu\ty\n\ns\tV\tmm\n" + DATA.replace(",", "\t"), {"u": "V", "y": "mm"}, ["comments", "line 4 has"]),
        ("rig,4,,,\nno,1,axis,x,5\n,,,,\nt,u,y,,\n" + DATA.replace("\n", ",,\n"), {}, ["in line 4 is skipped"]),
        ("logger;a;b;c;d\nt;u;y\n" + DATA.replace(",", ";"), {}, ["in line 2 is skipped"]),
    ],
)
def test_preambles_and_lines_of_units(tmp_path, text, units, words):
    r = read(put(tmp_path, text))
    assert r.u.tolist() == [i % 7 for i in range(30)] and r.y.tolist() == [i % 5 for i in range(30)] and r.Ts == 0.1
    assert r.units == units and all(any(w in n for n in r.notes) for w in words), r.notes


def test_a_time_in_milliseconds_by_its_line_of_units(tmp_path):
    rows = "".join(f"{20 * i},{i % 7},{i % 5}\n" for i in range(30))
    assert read(put(tmp_path, "t,u,y\nms,V,V\n" + rows)).Ts == 0.02
    r = read(put(tmp_path, "Time[ms],u,y\n" + rows), t="Time[ms]")
    assert r.Ts == 0.02 and "converted from ms to s" in r.notes[0]


@needs_cases
def test_files_that_once_could_not_be_read():
    r = read(CASES / "bursts.csv", u="pwm", y="position", t="timestamp")
    assert len(r) == 404 and r.Ts == 0.008 and r.roles == {"target": "setpoint"} and "bursts" in r.notes[0]
    check_excitation(r)
    r = read(CASES / "units_row.csv", u="Motor current", y="Output Torque", t="Time")
    assert r.Ts == 0.5 and r.units == {"u": "A", "y": "N.mm"} and r.u[0] == 2.0075
    r = read(CASES / "preamble_commas.csv", u="Goal Position", y="Present Position", t="Time[ms]")
    assert r.Ts == 0.02 and len(r) == 400 and r.u[0] == r.y[0] == 2048


# ---------------------------------------------------------------- measured files


@needs_shared
@pytest.mark.parametrize(
    "name, n, Ts",
    [
        ("boucwen/test_multisine.csv", 8192, 1 / 750),
        ("boucwen/train_multisine.csv", 40960, 1 / 750),
        ("boucwen/test_sinesweep.csv", 153000, 1 / 750),
        ("hydraulic_motor_rotation/run.csv", 15246, 0.02),
        ("piezo_dbo/train_1Hz_full_range.csv", 8027, 0.005),
        ("piezo_dbo/test_varying_amplitude.csv", 14155, 0.005),
    ],
)
def test_measured_files_on_a_grid_are_not_changed(name, n, Ts):
    r = read(SHARED / name)
    frame = pd.read_csv(SHARED / name)
    assert len(r) == n and r.Ts == Ts and r.breaks == ()
    np.testing.assert_array_equal(r.u, frame["u"])
    np.testing.assert_array_equal(r.y, frame["y"])


@needs_shared
@pytest.mark.parametrize("name, parts, dropped", [("Oring257_1bar", 3, 1), ("Oring_1bar", 2, 0), ("Oring_3bar", 3, 0)])
def test_measured_files_with_jitter_and_gaps(name, parts, dropped):
    path = SHARED / "pneumatic_seal_friction" / f"{name}.csv"
    r = read(path, channels="all")
    raw = pd.read_csv(path)
    assert r.Ts == 0.01 and len(r.segments()) == parts and list(r.channels) == ["pressure_bar"]
    assert sum("is dropped" in n for n in r.notes) == dropped
    assert any("irregular" in n for n in r.notes)
    for s in r.segments():
        np.testing.assert_allclose(np.diff(s.t), 0.01, rtol=1e-6)
        np.testing.assert_allclose(s.y, np.interp(s.t, raw["t"], raw["y"]), atol=1e-9)


# ---------------------------------------------------------------- writing


def test_write_csv_round_trip(tmp_path):
    path = tmp_path / "out.csv"
    k = np.arange(50)
    write_csv(path, {"t": k * 0.005, "u": np.sin(k) * 1e-5, "y": np.exp(k)})
    r = read(path)
    np.testing.assert_allclose(r.u, np.sin(k) * 1e-5, rtol=1e-9)
    assert r.Ts == 0.005 and path.read_bytes().startswith(b"t,u,y\n0,0,1\n0.005,8.414709848e-06,2.718281828\n")
    assert os.listdir(tmp_path) == ["out.csv"]


def test_write_refuses(tmp_path):
    assert "does not exist" in message(write_csv, tmp_path / "no" / "a.csv", {"u": [1]})
    assert "equal lengths" in message(write_csv, tmp_path / "a.csv", {"u": [1], "y": [1, 2]})
    assert "is a folder" in message(write_text, tmp_path, "x")
    assert os.listdir(tmp_path) == []


def test_a_channel_with_a_unit_in_its_name(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("t,u,y,temp [C],2nd\n" + "".join(f"{i / 10},{i % 7},{i % 5},{20 + i},{i}\n" for i in range(30)))
    record = read(path, channels="all")
    assert list(record.channels) == ["temp_C", "channel_2nd"]
    assert "column 'temp [C]' is the channel temp_C" in record.notes
    assert list(read(path, channels="temp_C").channels) == list(read(path, channels="temp [C]").channels) == ["temp_C"]
    named = read(path, channels="temp", units={"u": "V"})
    assert list(named.channels) == ["temp"] and named.units == {"u": "V", "temp": "C"}
    assert "column 'temp [C]' is the channel temp" in named.notes
    assert list(read(path, channels="all,temp").channels) == ["temp", "channel_2nd"]
    assert set(read(path, channels="temp,temp_C,temp [C]").channels) == {"temp", "temp_C"}  # each by its name
    path.write_text("t,u,y,a b,a-b\n" + "".join(f"{i / 10},{i % 7},{i % 5},{i},{i}\n" for i in range(30)))
    with pytest.raises(DataError, match="'a b' and 'a-b' would both be called a_b"):
        read(path, channels="all")


@pytest.mark.parametrize(
    ("kind", "frequency"),
    (("sine", 2.0), ("triangle", 0), ("two sines", 0), ("growing", 0), ("one cycle", 0), ("rest", 0)),
)
def test_a_single_sine_is_seen(kind, frequency):
    t = np.arange(1000) * 0.01
    signals = {
        "sine": 1 + np.sin(2 * np.pi * 2 * t + 0.3) + 0.02 * np.random.default_rng(0).standard_normal(t.size),
        "triangle": np.abs((2 * t) % 1 - 0.5),
        "two sines": np.sin(2 * np.pi * 2 * t) + 0.2 * np.sin(2 * np.pi * 0.7 * t),
        "growing": (t + 1) * np.sin(2 * np.pi * 2 * t),
        "one cycle": np.sin(2 * np.pi * 0.1 * t),
        "rest": np.ones(t.size),
    }
    record = Record.from_arrays(signals[kind], np.cos(t), Ts=0.01)
    assert one_sine(record.u, record.Ts) == pytest.approx(frequency)
    assert any("one sine of 2 Hz" in text for text in record.remarks()) == (kind == "sine")


def test_dates_are_no_seconds():
    days = np.array(["2026-01-01", "2026-01-02", "2026-01-03"], dtype="datetime64[ns]")
    for stamps in (days, days - days[0]):
        with pytest.raises(DataError, match="not an array of real numbers"):
            Record.from_arrays(np.arange(3.0), np.arange(3.0), t=stamps)


def test_a_setpoint_that_nobody_reads_is_noted(tmp_path):
    path = tmp_path / "loop.csv"
    path.write_text("t,u,y,load,Setpoint [mm]\n" + "".join(f"{k},{k % 3},{k % 5},{k % 7},1\n" for k in range(20)))
    found = read(path, channels="load")  # who names channels names all of them
    assert list(found.channels) == ["load"] and "use --role Setpoint_mm=setpoint" in found.notes[-1]
    assert not any("is not used; if it is" in note for note in read(path, channels="Setpoint_mm").notes)
    assert read(path).roles == {"Setpoint_mm": "setpoint"}  # one that never moves is one too
    ignored = read(path, roles={"Setpoint [mm]": "ignore"})
    assert not ignored.channels and not ignored.notes and ignored.aside == ("load",)


def test_a_setpoint_that_moves_is_that_of_the_controller(tmp_path):
    path = tmp_path / "loop.csv"
    path.write_text("t,u,y,load,Setpoint [mm]\n" + "".join(f"{k},{k % 3},{k % 5},{k},{k // 5}\n" for k in range(20)))
    found = read(path)
    assert list(found.channels) == ["Setpoint_mm"] and found.units["Setpoint_mm"] == "mm"
    assert "assumed to be the setpoint of a controller" in found.notes[-1] and "--open-loop" in found.notes[-1]
    assert list(read(path, channels="load").channels) == ["load"]  # who names channels names all of them
    path.write_text(path.read_text().replace("19,1,4,19,3", "19,1,4,19,"))
    assert not read(path).channels and "is not used; if it is" in read(path).notes[-1]


@pytest.mark.parametrize("begin", [0.0, 1.7e9, 1.7e9 + 0.4])
@pytest.mark.parametrize("rate", [60, 300, 700])
def test_stamps_in_milliseconds_after_a_round_number_keep_their_step(begin, rate):
    """Nine digits before the point are no sign that the last printed digit is larger than a step."""
    t = np.round(begin + np.arange(600) / rate, 3)
    record = Record.from_arrays(np.sin(t - begin), np.cos(t - begin), t=t)
    assert record.Ts == pytest.approx(1 / rate, rel=1e-3)


def test_dates_are_a_time(tmp_path):
    """ISO 8601, with and without fractions, with a zone; other text is refused with what to do."""
    path = tmp_path / "iso.csv"
    rows = ["2024-10-27T00:59:59.5+02:00", "2024-10-27T01:00:00+02:00", "2024-10-27T01:00:00.500+02:00"]
    path.write_text("t,u,y\n" + "".join(f"{at},{i},{2 * i}\n" for i, at in enumerate(rows)))
    record = read(path)
    assert record.Ts == 0.5 and record.t.tolist() == [0, 0.5, 1.0] and "holds dates" in record.notes[0]
    path.write_text("t,u,y\n31st of March,1,2\n1st of April,2,3\n")
    with pytest.raises(DataError, match=r"31st of March.*--ts SECONDS"):
        read(path)
    assert len(read(path, Ts=5.0)) == 2
    path.write_text("t,u,y\n2024-10-27,1,2\n,2,3\n2024-10-29,2,3\n")
    with pytest.raises(DataError, match="without a date"):
        read(path)
    days = "".join(f"2024-10-{d},{d},{d}\n" for d in range(10, 25) if d != 12).replace("2024-10-17", "")
    path.write_text("t,u,y\n" + days)
    record = read(path, missing="drop")  # a row without a date is a hole in the stamps
    assert len(record) == 15 and record.Ts == 86400 and record.t[0] == 0
    path.write_text("t,u,y\n" + days.replace("2024-10-20", "yesterday"))
    with pytest.raises(DataError, match="'yesterday' in line 11"):
        read(path, missing="drop")


@pytest.mark.parametrize(
    ("rows", "step"),
    [
        (["31.3.2024 23:59:58", "1.4.2024 00:00:00", "1.4.2024 00:00:02"], 2.0),  # no month has the number 31
        (["3/31/2024 23:59:58", "4/1/2024 00:00:00", "4/1/2024 00:00:02"], 2.0),
        (["0:59:58", "1:00:00", "1:00:02"], 2.0),  # hours, minutes and seconds since the start
        (["05-03-2021 16:35:48", "05-03-2021 16:35:48.5", "05-03-2021 16:35:49"], 0.5),  # one day, whichever it is
    ],
)
def test_the_day_or_the_month_may_come_first(tmp_path, rows, step):
    path = tmp_path / "days.csv"
    path.write_text("t,u,y\n" + "".join(f"{at},{i},{2 * i}\n" for i, at in enumerate(rows)))
    assert read(path).t.tolist() == [0, step, 2 * step]


def test_a_day_that_may_be_a_month_is_not_guessed(tmp_path):
    path = tmp_path / "days.csv"
    path.write_text("t,u,y\n" + "".join(f"0{i}/04/2024,{i},{2 * i}\n" for i in (1, 2, 3)))
    with pytest.raises(DataError, match=r"'01/04/2024'.*with the day or with the month"):
        read(path)


def test_a_missing_output_does_not_change_the_input(tmp_path):
    """Cells that were emptied are filled; the other columns of their rows, which were measured, stay."""
    rng = np.random.default_rng(0)
    t, u, y = 0.1 * np.arange(60), rng.standard_normal(60), rng.standard_normal(60)
    told = [f"{y[i]}" for i in range(60)]
    for i in (20, 21, 40):
        told[i] = ""
    path = tmp_path / "holes.csv"
    path.write_text("t,u,y\n" + "".join(f"{a:.1f},{b!r},{c}\n" for a, b, c in zip(t, u.tolist(), told, strict=True)))
    record = read(path, missing="drop")
    assert len(record) == 60 and not record.breaks and np.array_equal(record.u, u)
    assert record.y[20] == pytest.approx(y[19] + (y[22] - y[19]) / 3) and np.array_equal(record.y[41:], y[41:])
    assert "3 row(s)" in record.notes[0] and "filled" in record.notes[0]


def test_signals_that_nobody_asked_for_stand_aside(tmp_path):
    """A text, a constant, a second clock and a name that is asked for are none of them."""
    rows = "".join(f"{i / 10},{i % 3},{i % 5},{20 + i % 7},{i},a,5,{10 * i}\n" for i in range(30))
    (tmp_path / "log.csv").write_text("t,u,y,oil temp [C],index,note,rig,t_ms\n" + rows)
    assert read(tmp_path / "log.csv").aside == ("oil_temp_C",)
    assert read(tmp_path / "log.csv")[3:20].aside == ("oil_temp_C",)
    assert read(tmp_path / "log.csv", channels="oil temp [C]").aside == ()
    assert read(tmp_path / "log.csv", u="index").aside == ("channel_u", "oil_temp_C")
