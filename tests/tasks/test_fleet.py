"""Many records: entries from folders, patterns and lists; rows, page and CSV; a bad file, a budget, going on."""

import csv
from functools import partial

import numpy as np
import pytest
from sampling import only

import narx_sym as ns
from narx_sym.data.readers import load
from narx_sym.errors import DataError
from narx_sym.files.journal import remembered
from narx_sym.report import fleet as pages
from narx_sym.report.fleet import heat, trends, write_fleet
from narx_sym.tasks import fleet as fleets
from narx_sym.tasks.fleet import BAND, STICKING, Settings, _worst, entries, fleet, look

N, TS = 900, 0.01
ROW = {
    "file": "a.csv", "tag": "V1", "verdict": "named", "finding": "named", "missing": ["backlash"], "valve": "",
    "sizes": {"backlash r": 0.3}, "before": 0.2, "after": 0.05, "unit": "mm", "explained": 0.6, "seconds": 1.0,
    "order": 0, "report": "", "problem": "",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two machines: one with a dead zone, one without, and a file that is no record."""
    made = tmp_path_factory.mktemp("logs")
    rng = np.random.default_rng(3)
    u = np.interp(np.arange(N), np.arange(0, N + 30, 30), rng.uniform(-2, 2, N // 30 + 1))
    for name, y in (("V1/one", 2 * (u - np.clip(u, -0.6, 0.6))), ("V2/two", 2 * u)):
        path = made / f"{name}.csv"
        path.parent.mkdir()
        np.savetxt(
            path, np.column_stack([np.arange(N) * TS, u, y + 0.01 * rng.standard_normal(N)]), delimiter=",", header="t,u,y",
            comments="",
        )  # fmt: skip
    (made / "V2" / "broken.csv").write_text("t,u\n0,1\n")
    return made


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Search few effects: here files, rows and pages are looked at."""
    catalogue = only("dead_zone", "drift")
    monkeypatch.setattr(fleets, "diagnose", partial(fleets.diagnose, catalogue=catalogue))


def test_a_fleet_is_diagnosed_and_a_bad_file_stops_nothing(folder, tmp_path):
    listed = entries(folder)
    assert [(e.file.stem, e.tag) for e in listed] == [("one", "V1"), ("broken", "V2"), ("two", "V2")]
    with ns.resuming(tmp_path / "kept") as journal:
        rows = fleet(listed, Settings(base="static"), jobs=1)
        assert not journal.found
    assert [(r["tag"], r["missing"], bool(r["problem"])) for r in rows] == [
        ("V1", ["dead_zone"], False), ("V2", [], False), ("V2", [], True),
    ]  # fmt: skip
    assert rows[0]["after"] < 0.1 * rows[0]["before"]
    assert rows[0]["sizes"]["dead_zone r"] == pytest.approx(0.6, rel=0.05)
    assert "broken.csv: 1 data row" in rows[2]["problem"]
    with ns.resuming(tmp_path / "kept") as journal:
        assert fleet(listed, Settings(base="static"), jobs=1) == rows
        assert journal.found == 3


@pytest.mark.long
def test_going_on_writes_again_what_was_deleted(folder, tmp_path, run):
    command = (
        "fleet", folder, "--out", tmp_path / "plant.html", "--base", "static", "--jobs", "1",
        "--reports", tmp_path / "reports", "--resume", tmp_path / "kept",
    )  # fmt: skip
    assert run(*command)[0] == 0
    first, second = sorted((tmp_path / "reports").iterdir())
    title, other = first.read_text().partition("</title>")[0], second.stat().st_mtime_ns
    first.unlink()
    assert run(*command)[0] == 0
    assert first.read_text().startswith(title) and second.stat().st_mtime_ns == other
    assert "3 of 3 records were done already" in run(*command)[2]


def test_the_page_and_the_csv_say_the_same(tmp_path):
    grows = [ROW | {"file": f"{i}.csv", "sizes": {"backlash r": 0.3 + 0.1 * i}} for i in range(3)]
    healthy = ROW | {
        "tag": "V<2>",
        "verdict": "nothing_detectable",
        "finding": "nothing_detectable",
        "missing": [],
        "sizes": {},
    }
    left = healthy | {"tag": "V4", "finding": "trace"}
    broken = ROW | {"tag": "V3", "verdict": "", "missing": [], "sizes": {}, "problem": "no column y"}
    rows = [*grows, healthy, left, broken]
    page, table, *_ = write_fleet(rows, tmp_path / "plant.html", "reports/")
    text = page.read_text()
    assert "3 of 5 diagnosed records" in text and "V&lt;2&gt;" in text and "no column y" in text
    assert "polyline" in text
    assert "http" not in text.split("</style>")[1] and "<script" not in text
    read = list(csv.DictReader(table.open()))
    assert [r["missing"] for r in read] == ["backlash"] * 3 + ["", "", ""] and read[2]["sizes"] == "backlash r=0.5"
    assert heat(rows)["counts"] == {"V1": [3], "V3": [0], "V4": [0], "V<2>": [0]}
    assert heat(rows)["of"] == {"V1": 3, "V3": 0, "V4": 1, "V<2>": 1} and heat(rows)["left"]["V3"] == 1
    assert text.count(">0 of 1<") == 2 and '<td class="heat">-</td><td class="heat">1</td>' in text
    assert text.count("no detectable effect") == 1 and "a small unexplained error" in text
    (trend,) = trends(rows)
    assert trend["values"] == pytest.approx([0.3, 0.4, 0.5])


def test_what_is_written_does_not_tell_how_long_it_took(tmp_path):
    first, second = (
        [p.read_bytes() for p in write_fleet([ROW | {"seconds": s}], tmp_path / "plant.html")] for s in (1.0, 2.0)
    )
    assert first == second


def test_entries_from_patterns_and_lists(folder, tmp_path):
    assert [e.tag for e in entries(str(folder / "*" / "*.csv"), group=r"V(\d)")] == ["1", "2", "2"]
    listed = folder / "list.txt"
    listed.write_text("file,unit,y\nV1/one.csv,left,u\nmissing.csv,right,\n")
    first, second = entries(listed, group="unit")
    assert (first.tag, dict(first.columns)["y"], second.tag) == ("left", "u", "right")
    assert "missing.csv" in look(second, Settings())["problem"]
    (empty := tmp_path / "empty.txt").write_text("")
    for source, group, said in (
        (empty, "", "empty.txt: "),
        (tmp_path, "", "no records"), (listed, "valve", "no column 'valve'"), (folder / "V1" / "one.csv", "", "needs a column"),
        (folder, "(", "no regular expression"),
    ):  # fmt: skip
        with pytest.raises(DataError, match=said):
            entries(source, group=group)


def test_a_path_that_does_not_tell_its_machine_is_said(folder):
    with pytest.warns(UserWarning, match=r"does not match 1 of 3 paths, such as .*one.csv: their machine is named unk"):
        assert [e.tag for e in entries(folder, group=r"V(2)|one")] == ["unknown", "2", "2"]
    with pytest.raises(DataError, match=r"--group 'FV1' matches no path, such as .*one.csv"):
        entries(folder, group="FV1")


def test_a_budget_ends_one_record(folder, monkeypatch):
    (entry,) = [e for e in entries(folder) if e.file.stem == "one"]
    row = look(entry, Settings(base="static", budget=1e-9))
    assert "time limit" in row["problem"] and not row["missing"]


def test_what_is_no_fault_of_a_record_is_said_and_tried_again(folder, tmp_path, monkeypatch):
    def failing(base, record, **options):
        if record.name == "one":
            raise errors[-1]
        return diagnosed(base, record, **options)

    settings, diagnosed, listed, errors = Settings(base="static"), fleets.diagnose, entries(folder), []
    failure = pytest.MonkeyPatch()
    failure.setattr(fleets, "diagnose", failing)
    for error, said in (
        (NameError("no foo"), "internal error, NameError: no foo; please report it"),
        (MemoryError(), "not enough memory"),
        (OSError(28, "No space left on device", "a.html"), "a.html: No space left on device; check space"),
    ):
        errors.append(error)
        with ns.resuming(tmp_path / "kept"):
            rows = {r["file"]: r["problem"] for r in fleet(listed, settings, jobs=1)}
        assert said in rows[str(listed[0].file)] and not rows[str(listed[2].file)]
    failure.undo()
    told = []
    with ns.resuming(tmp_path / "kept"):
        rows = fleet(listed, settings, jobs=1, resumed=told.append)
    assert rows[0]["missing"] == ["dead_zone"] and not rows[0]["problem"] and told == [2]


def half(number):
    return number / 2


def looked(entry, settings):
    """A row with a result within it that is kept too."""
    remembered(half, 3.0)
    return ROW | {"file": str(entry.file), "tag": entry.tag}


def test_records_that_were_done_are_counted_not_results(folder, tmp_path, run, monkeypatch):
    command = (
        "fleet", folder, "--out", tmp_path / "plant.html", "--base", "static", "--jobs", "1", "--resume",
        tmp_path / "kept",
    )  # fmt: skip
    monkeypatch.setattr(fleets, "look", looked)
    assert "done already" not in run(*command)[2]
    (folder / "V1" / "three.csv").write_text("t,u,y\n")
    try:
        _, text, err = run(*command)
    finally:
        (folder / "V1" / "three.csv").unlink()
    assert "kept: 3 of 4 records were done already" in err and "results" not in err
    assert "fraction of std(y)" in " ".join(text.split())


def test_the_command(folder, tmp_path, run, monkeypatch):
    monkeypatch.setattr(fleets, "look", lambda entry, settings: ROW | {"file": str(entry.file), "tag": entry.tag})
    code, text, err = run("fleet", folder, "--out", tmp_path / "plant.html", "--jobs", "1", "--units", "V,mm")
    assert code == 0 and "The worst of 3 records" in text and (tmp_path / "plant.csv").exists(), err
    code, _, err = run("fleet", tmp_path / "nothing", "--out", tmp_path / "p.html")
    assert code and "no records" in err
    code, _, err = run("fleet", folder, "--out", tmp_path / "p.csv", "--jobs", "1")
    assert code and "two results would go to the same file" in err and not (tmp_path / "p.csv").exists()
    before = (folder / "V1" / "one.csv").read_bytes()
    code, _, err = run("fleet", folder, "--out", folder / "V1" / "one.html", "--jobs", "1")
    assert code and "this command reads this file" in err and (folder / "V1" / "one.csv").read_bytes() == before


def test_parquet_where_its_writer_is_there(folder, tmp_path, run, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet")
    broken = ROW | {
        "missing": [],
        "sizes": {},
        "before": None,
        "after": None,
        "explained": 0.0,
        "problem": "no column y",
    }
    rows = [ROW | {"before": 1 / 3}, broken]
    paths = write_fleet(rows, tmp_path / "plant.html")
    assert [p.name for p in paths] == ["plant.html", "plant.csv", "plant.parquet"]
    read = [{n: dict(v) if n == "sizes" else v for n, v in r.items()} for r in parquet.read_table(paths[2]).to_pylist()]
    assert read == [{n: v for n, v in row.items() if n not in ("seconds", "order")} for row in rows]
    with monkeypatch.context() as context:
        context.setattr(pages, "find_spec", lambda name: None)
        assert len(write_fleet(rows, tmp_path / "bare.html")) == 2 and not (tmp_path / "bare.parquet").exists()
    monkeypatch.setattr(fleets, "look", lambda entry, settings: ROW | {"file": str(entry.file), "tag": entry.tag})
    code, text, err = run("fleet", folder, "--out", tmp_path / "all.html", "--jobs", "1")
    assert code == 0 and "all.parquet" in text.replace("\n", "") and len(load(tmp_path / "all.parquet").columns) == 13
    code, _, err = run("fleet", folder, "--out", tmp_path / "p.parquet", "--jobs", "1")
    assert code and "two results would go to the same file" in err and not (tmp_path / "p.parquet").exists()
    before = (tmp_path / "all.parquet").read_bytes()
    listed = tmp_path / "all.csv"
    listed.write_text("file\nall.parquet\n")
    code, _, err = run("fleet", listed, "--out", tmp_path / "all.html", "--jobs", "1")
    assert code and "this command reads this file" in err and (tmp_path / "all.parquet").read_bytes() == before


def test_what_was_not_judged_is_not_called_healthy(tmp_path):
    row = ROW | {"verdict": "closed_loop", "missing": [], "sizes": {}}
    page, *_ = write_fleet([row], tmp_path / "plant.html")
    assert "0 of 0 diagnosed records" in page.read_text() and heat([row])["left"] == {"V1": 1}
    assert ">not judged</td>" in page.read_text() and "no detectable effect" not in page.read_text()


def test_of_a_valve_the_page_says_what_the_report_does(tmp_path):
    """A loop whose valve is told is judged, and a valve that sticks comes before what explains more."""
    loop = {"verdict": "closed_loop", "finding": "valve", "sizes": {BAND: 4.0}, "explained": 0.0}
    sticks = ROW | loop | {"tag": "V1", "missing": [STICKING], "valve": "the valve sticks"}
    perhaps = ROW | loop | {"tag": "V2", "missing": [], "valve": "the valve may stick"}
    assert sorted([perhaps, ROW, sticks], key=_worst)[0] is sticks
    page, table, *_ = write_fleet([sticks, perhaps], tmp_path / "plant.html")
    assert "1 of 2 diagnosed records" in page.read_text() and heat([sticks])["of"] == {"V1": 1}
    assert "not judged</td>" not in page.read_text() and "the valve may stick" in page.read_text()
    assert "the valve may stick" in table.read_text() and f"{BAND}=4" in table.read_text()


def test_trends_go_by_the_order_of_the_list_and_numbers_count(tmp_path):
    rows = [ROW | {"file": name, "sizes": {"r": i}, "order": i} for i, name in enumerate(("z", "m", "a"))]
    assert trends(rows[::-1])[0]["values"] == [0, 1, 2]
    for i in (10, 9, 1):
        (tmp_path / f"log_{i}.csv").write_text("u,y\n")
    assert [e.file.name for e in entries(tmp_path)] == ["log_1.csv", "log_9.csv", "log_10.csv"]
