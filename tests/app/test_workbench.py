"""The live form without a page: the work in its process, the states of the workbench, and who may talk to it."""

import asyncio
import os
import re
import stat
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import live
import pytest
from sampling import only

import narx_sym as ns
from narx_sym.app import command, workbench
from narx_sym.app.choice import guessed, shortened
from narx_sym.app.guard import Guard
from narx_sym.app.workbench import State, Workbench
from narx_sym.app.worker import Outcome, Worker
from narx_sym.cli import main as cli
from narx_sym.files.store import to_text
from narx_sym.report.panels import registry
from narx_sym.tasks import revise
from narx_sym.tasks.reference import MOST


def gone(pid):
    """Whether a process has ended."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{pid}/stat").exists() and Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z"


# -- the process ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def worker():
    made = Worker()
    yield made
    made.stop()


def outcome(worker):
    until = time.monotonic() + 60
    while (found := worker.poll()) is None:
        assert time.monotonic() < until
        time.sleep(0.01)
    return found


def test_a_process_does_one_piece_of_work_after_the_other(worker):
    worker.start(live.count, 3)
    assert outcome(worker).result == 3 and not worker.busy and worker.progress == "counting to 3"
    first = worker._process.pid
    worker.start(live.warn)
    found = outcome(worker)
    assert (found.result, found.notes) == ("done", ("this is worth a look",))
    assert worker._process.pid == first


def test_what_goes_wrong_there_is_one_message(worker):
    worker.start(live.fail, "said")
    assert outcome(worker).error == "what is wrong, in one sentence"
    worker.start(live.fail, "unexpected")
    assert outcome(worker).error.startswith("Internal error, KeyError")
    worker.start(live.fail, "dies")
    assert "ended" in outcome(worker).error
    worker.start(live.count, 1)  # and a new process takes over
    assert outcome(worker).result == 1


def test_stop_ends_the_process(worker, tmp_path):
    worker.start(live.forever, str(tmp_path / "pid"))
    while worker.progress != "never ends":
        assert worker.poll() is None
        time.sleep(0.01)
    pid = int((tmp_path / "pid").read_text())
    worker.stop()
    assert gone(pid) and not worker.busy and worker.poll() is None


def wait(bench):
    """Wait until nothing is under way."""
    while bench.busy:
        bench.poll()
        time.sleep(0.05)


# -- the workbench -------------------------------------------------------------------------------------------------


@pytest.fixture
def bench():
    made = Workbench(limit=300_000)
    yield made
    made.close()


@pytest.fixture(scope="module")
def data():
    return live.hidden(600)


@pytest.fixture(scope="module")
def climbed():
    """A workbench after a diagnosis of a model file and one addition; it is stepped on by the tests below."""
    u, y = live.hidden()
    made = Workbench()
    made.upload("stage.csv", live.csv(u=u, y=y))
    made.choose(units={"u": "V", "y": "mm"})
    made.upload_model("base.json", live.linear_model(u, y))
    made.diagnose()
    wait(made)
    assert not made.error, made.error
    made.add("dead_zone")
    wait(made)
    assert not made.error, made.error
    yield made
    made.close()


def test_an_upload_is_read_at_once_where_its_columns_are_clear(bench, data):
    u, y = data
    bench.upload("stage.csv", live.csv(u=u, y=y))
    assert not bench.error and len(bench.record) == len(u) and bench.record.name == "stage"
    assert (bench.choice.t, bench.choice.u, bench.choice.y) == ("t", "u", "y") and "<svg" in bench.preview


class Here(Worker):
    """Does its work at once, in this process."""

    def start(self, work, *arguments):
        self.made, self.busy = Outcome(work(*arguments, progress=lambda text: None)), True

    def poll(self):
        self.busy = False
        return self.made


def test_the_kind_of_machine_is_told_to_the_diagnosis(bench, data, monkeypatch):
    u, y = (x[:400] for x in data)
    few = only("dead_zone", "coulomb_friction")
    monkeypatch.setattr(revise, "diagnose", partial(revise.diagnose, catalogue=few))
    monkeypatch.setattr(bench, "worker", Here())
    monkeypatch.setattr(registry, "_PANELS", {n: registry.panels()[n] for n in ("verdict", "candidates")})
    bench.upload("heater.csv", live.csv(u=u, y=y))
    bench.upload_model("base.json", live.linear_model(u, y))
    bench.choose(machine="thermal")
    bench.diagnose()
    wait(bench)
    assert not bench.error, bench.error
    found = bench.current.found
    assert found.machine.name == "thermal" and "coulomb_friction" in found.excluded
    assert [c.effect for c in found.candidates] == ["dead_zone"]
    assert "dead zone" in bench.current.page


def test_names_of_files_are_shown_and_never_followed(bench, data, tmp_path):
    u, y = data
    for name in ("../../../tmp/evil.csv", "/etc/passwd.csv", "..\\..\\evil.csv", "a\0b\n.csv", "x" * 300 + ".csv"):
        bench.upload(name, live.csv(u=u, y=y))
        assert not bench.error, bench.error
        assert bench.path.parent.parent == bench.folder and bench.path.stem.isidentifier()
        assert len(list(bench.folder.iterdir())) == 1  # the one before is gone
        assert len(bench.file) <= 80 and bench.file.isprintable() and "/" not in bench.file
    assert stat.S_IMODE(bench.folder.stat().st_mode) == 0o700
    bench.close()
    assert not bench.folder.exists()


@pytest.mark.parametrize(
    "name, content, why",
    [
        ("a.csv", b"", "empty"), ("a.exe", b"t,u,y\n", "a file with columns"), ("a.npz", b"PK", "npz"),
        ("a.csv", b"x" * 300_001, "at most 0.3 MB"), ("a.csv", b"1,2,3\n4,5,6\n", "header"),
        ("a.csv", b"t,u,y\n0,1,2\n", "At least|at least"), ("a.csv", b"\0\1\2,\3", "binary"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_data_is_one_message(bench, data, name, content, why):
    bench.upload("good.csv", live.csv(u=data[0], y=data[1]))
    bench.upload(name, content)
    assert re.search(why, bench.error) and str(bench.folder) not in bench.error and "\n" not in bench.error
    assert list(bench.folder.iterdir()) == [bench.path.parent]
    if "least" not in why:  # that is a file of data, of too few: else those of before stay
        assert bench.file == "good.csv" and bench.record is not None


def test_a_file_of_the_user_stays(bench, data, tmp_path):
    own = tmp_path / "own.csv"
    own.write_bytes(live.csv(u=data[0], y=data[1]))
    bench.open(own)
    bench.example()
    assert not bench.error and len(bench.record) == 2000 and "[mm]" in bench.preview
    bench.close()
    assert own.exists()


@pytest.mark.parametrize(
    "changed, field, why",
    [
        ({"u": "y"}, "y", "same column"), ({"u": ""}, "u", "Choose the column"), ({"rows": "5:3"}, "rows", "row"),
        ({"rows": "a"}, "rows", "Rows A:B"), ({"Ts": "fast"}, "Ts", "Sampling time must be a number"),
        ({"Ts": "-1"}, "Ts", "positive"), ({"t": ""}, "Ts", "ampling time"),
        ({"y": "word"}, "", "has text"), ({"u": "nobody"}, "", "no column"),
    ],
)  # fmt: skip
def test_a_choice_that_cannot_be_read_is_one_message_at_its_field(bench, data, changed, field, why):
    u, y = data
    lines = live.csv(u=u, y=y).decode().splitlines()
    text = "\n".join([lines[0] + ",word", *(line + ",a" for line in lines[1:])])
    bench.upload("stage.csv", text.encode())
    bench.choose(**changed)
    assert re.search(why, bench.error), bench.error
    assert (list(bench.faults) == [field] and not bench.error.startswith("stage.csv")) or not field
    assert bench.record is None and "--" not in bench.error and str(bench.folder) not in bench.error


def test_each_field_keeps_its_message_until_it_is_right(bench, data):
    u, y = data
    bench.upload("stage.csv", live.csv(u=u, y=y))
    bench.choose(rows="all", Ts="fast")
    assert set(bench.faults) == {"rows", "Ts"}
    bench.choose_base("cubic")
    assert set(bench.faults) == {"rows", "Ts", ""}
    bench.choose(rows="0:500")
    assert set(bench.faults) == {"Ts"} and bench.record is None and bench.choice.Ts == "fast"
    bench.choose(Ts="")
    assert not bench.faults and len(bench.record) == 500


def test_missing_values_are_left_out_where_it_is_chosen(bench, data):
    u, y = data
    lines = live.csv(u=u[:300], y=y[:300]).decode().splitlines()
    lines[50] = lines[50].rpartition(",")[0] + ","
    bench.upload("stage.csv", "\n".join(lines).encode())
    assert "drop them with Missing values: leave the rows out" in bench.error and bench.record is None
    bench.choose(missing="drop")
    assert not bench.error and bench.record is not None and any("filled" in note for note in bench.notes), bench.notes


def test_a_choice_waits_until_the_file_is_read(bench, data, monkeypatch):
    """All that an upload brings is there at once; what is chosen meanwhile is not lost."""
    u, y = data
    drawing, go = threading.Event(), threading.Event()
    drawn = workbench.signals_svg

    def slowly(*what):
        drawing.set()
        assert go.wait(30)
        return drawn(*what)

    bench.upload("first.csv", live.csv(u=u, y=y))
    monkeypatch.setattr(workbench, "signals_svg", slowly)
    threads = [threading.Thread(target=bench.upload, args=("second.csv", live.csv("t,u,y,c", u=u, y=y, c=u)))]
    threads[0].start()
    assert drawing.wait(30)
    assert bench.file == "first.csv" and bench.record.name == "first"
    threads.append(threading.Thread(target=bench.choose, kwargs={"channels": ["c"]}))
    threads[1].start()
    threads[1].join(0.2)
    assert threads[1].is_alive()
    go.set()
    for thread in threads:
        thread.join(30)
    assert not bench.faults and bench.record.name == "second" and list(bench.record.channels) == ["c"]


def test_units_that_do_not_convert_are_said_at_their_field(bench, data):
    u, y = data
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"])
    record = ns.Record.from_arrays(u, y, Ts=live.TS, units={"u": "V", "y": "mm"})
    bench.upload("stage.csv", live.csv(u=u, y=y))
    bench.upload_model("m.json", to_text(model.fit(record)).encode())
    bench.choose(units={"u": "V", "y": "K"})
    bench.diagnose()
    assert list(bench.faults) == ["unit y"] and "mm" in bench.error and not bench.busy
    bench.choose(units={"u": "V", "y": "um"})
    assert not bench.faults


def test_a_column_called_like_markup_is_a_channel_with_a_plain_name(bench, data):
    u, y = data
    bench.upload("stage.csv", live.csv("t,u,y,<script>alert(1)</script>", u=u, y=y, c=u))
    bench.choose(channels=["<script>alert(1)</script>"])
    assert list(bench.record.channels) == ["script_alert_1_script"]


def test_nothing_begins_before_what_it_needs(bench):
    for do, why in (
        (bench.diagnose, "data"), (lambda: bench.add("backlash"), "Diagnose"),
        (bench.undo, "nothing to undo"), (bench.redo, "nothing to redo"), (bench.run_law, "Diagnose"), (lambda: bench.choose(u="u"), "Drop a data file"),
        (lambda: bench.choose_base("cubic"), "Unknown base"),
    ):  # fmt: skip
        do()
        assert why in bench.error and not bench.busy
    with pytest.raises(ns.errors.ModelError):
        bench.download("model.json")


@pytest.mark.parametrize("content", (b"{}", b"no json", b'{"schema": 1}', b"[" * 10_000))
def test_a_file_that_is_no_model_is_one_message(bench, content):
    bench.upload_model("m.json", content)
    assert bench.error.startswith("m.json") and bench.base == "linear"


@pytest.mark.long
def test_a_state_comes_back_with_its_base_and_law_and_a_new_step_forgets_what_was_undone(climbed):
    revisions, states = climbed.state.revisions, list(climbed.states)
    climbed.run_law(first="3")
    wait(climbed)
    law, run = climbed.state.law, climbed.state.run
    climbed.choose_base("static")
    climbed.diagnose()
    wait(climbed)
    assert not climbed.error and len(climbed.state.revisions) == 1 and climbed.current is not revisions[0]
    climbed.undo()
    assert climbed.state.revisions == revisions and climbed.state.law is law and climbed.base_name == "base.json"
    climbed.redo()
    assert climbed.base == "static" and climbed.state.law is None and not climbed.busy
    climbed.go(1)
    assert (climbed.state.law, climbed.state.run) == (law, run) and len(climbed.states) == len(states) + 1


@pytest.mark.long
def test_the_law_and_its_limits(climbed):
    climbed.run_law(first="3", low="-3", high="3", rate="0.5")
    wait(climbed)
    law = climbed.state.law
    assert not climbed.error and law.sources[".c"] and "m_{k}" in law.latex and law.lines
    limited = climbed.state.law.sources[".c"]
    climbed.run_law(low="", high="", rate="")
    wait(climbed)
    assert climbed.state.law.sources[".c"] != limited
    for fields, wrong in (
        (("1", "", ""), {"high"}), (("2", "1", ""), {"high"}), (("a", "b", ""), {"low", "high"}), (("", "", "-1"), {"rate"}),
    ):  # fmt: skip
        climbed.run_law(**dict(zip(("low", "high", "rate"), fields, strict=True)))
        assert set(climbed.faults) == wrong and not climbed.busy


@pytest.mark.long
def test_references_of_every_kind(climbed):
    before = climbed.wanted
    for kind, more in (
        ("measured", {"first": "3"}), ("sine", {}), ("file", {"column": "b"}),
    ):  # fmt: skip
        if kind == "file":
            climbed.upload_reference(
                "../../r.csv", b"t,a,b\n" + b"".join(b"%g,0,%g\n" % (k / 100, k) for k in range(9))
            )
            assert not climbed.error and climbed.wanted.file == "r.csv"
            assert climbed.folder in climbed.wanted.path.parents
        climbed.run_law(kind=kind, low="-9", high="9", rate="", **more)
        wait(climbed)
        assert not climbed.error, climbed.error
        size = {"measured": 300, "file": 9}.get(kind)
        assert size is None or climbed.state.run.tracked.r.size == size
    run = climbed.state.run
    for more, why in (
        ({"column": "nobody"}, "r.csv: no column 'nobody'|r.csv.*nobody"), ({"column": ""}, "which column"),
        ({"kind": "sine", "amplitude": ""}, "amplitude is missing"), ({"kind": "sine", "frequency": "1e9"}, "too fast"),
        ({"kind": "measured", "first": "1e-9"}, "samples"),
        ({"kind": "sine", "low": "1", "high": "-1"}, "below"), ({"kind": "file", "rate": "0"}, "positive"),
    ):  # fmt: skip
        climbed.run_law(
            **{"kind": "file", "low": "", "high": "", "rate": "", "amplitude": "1", "frequency": "1"} | more
        )
        wait(climbed)
        assert re.search(why, climbed.error), climbed.error
        assert climbed.state.run is run and "\n" not in climbed.error and str(climbed.folder) not in climbed.error
    climbed.upload_reference("r.exe", b"")
    assert "a file with columns" in climbed.error and climbed.wanted.file == "r.csv"
    climbed.wanted = before


@pytest.fixture
def ready(bench, data):
    """A workbench with data and a model, of which nothing but that it is there is needed here."""
    u, y = (x[:300] for x in data)
    bench.upload("stage.csv", live.csv(u=u, y=y))
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.5])
    bench.states, bench.at = [State((SimpleNamespace(model=model),))], 0
    return bench


@pytest.mark.parametrize(
    ("text", "why"), [("", "missing"), ("long", "number"), ("0", "positive"), ("1e9", f"{MOST} are taken")]
)
def test_a_bad_reference_is_one_message_at_its_field(ready, text, why):
    ready.run_law(kind="sine", seconds=text)
    assert list(ready.faults) == ["seconds"] and why in ready.error and not ready.busy
    assert "\n" not in ready.error and len(ready.error) < 150
    assert ready.wanted.seconds == text  # what was typed stays


def test_why_there_is_no_law():
    from narx_sym.tasks.compensate import law_of

    model = ns.NARX.from_terms(["y[k-1]"], [0.5])
    assert "no input" in law_of(model).why_not


def test_small_things():
    assert shortened("C:\\x\\a.csv") == "a.csv" and shortened("\n\0") == "file"
    assert (lambda c: (c.t, c.u, c.y))(guessed(["Time", "Input", "Output"])) == ("Time", "Input", "Output")
    assert (lambda c: (c.t, c.u, c.y))(guessed(["a", "b"])) == ("", "a", "b")


def test_an_effect_of_the_catalogue_is_pickled_by_name():
    import pickle

    one = ns.EFFECTS["hysteresis"][0]
    assert pickle.loads(pickle.dumps(one)) is one


# -- the guard -----------------------------------------------------------------------------------------------------


def ask(scope, body=(b"",), limit=10):
    """Ask a guard before an application that reads everything: status, headers, whether the application was asked."""
    sent, asked = [], []

    async def app(scope, receive, send):
        asked.append(True)
        while (await receive()).get("more_body"):
            pass
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"ok"})

    parts = [{"type": "http.request", "body": b, "more_body": i + 1 < len(body)} for i, b in enumerate(body)]

    async def receive():
        return parts.pop(0)

    async def send(message):
        sent.append(message)

    asyncio.run(Guard(app, 8000, limit)(scope, receive, send))
    return sent[0].get("status", sent[0]["type"]), dict(sent[0].get("headers", ())), bool(asked)


def http(method="GET", host="127.0.0.1:8000", origin=None, kind="http", **more):
    headers = [(b"host", host.encode())] if host is not None else []
    headers += [(b"origin", origin.encode())] if origin is not None else []
    headers += [(n.replace("_", "-").encode(), v.encode()) for n, v in more.items()]
    return {"type": kind, "method": method, "path": "/", "headers": headers}


OWN = "http://127.0.0.1:8000"


@pytest.mark.parametrize(
    "scope, status",
    [
        (http(), 200), (http(host="localhost:8000"), 200), (http(host="LOCALHOST:8000"), 200),
        (http(host="evil.example:8000"), 403), (http(host="127.0.0.1"), 403), (http(host="127.0.0.1:9000"), 403),
        (http(host=None), 403), (http(host="127.0.0.1:8000.evil.example"), 403),
        (http(origin="http://evil.example"), 403), (http(origin="null"), 403), (http(origin=OWN), 200),
        (http("POST"), 403), (http("POST", origin="http://evil.example"), 403), (http("POST", origin=OWN), 200),
        (http("POST", origin="https://127.0.0.1:8000"), 403), (http("POST", origin="http://127.0.0.1:9000"), 403),
        (http("DELETE"), 403), (http("POST", origin=OWN, content_length="11"), 413),
        (http("POST", origin=OWN, content_length="-1"), 413), (http("POST", origin=OWN, content_length="10"), 200),
        (http(kind="websocket"), "websocket.close"),
        (http(kind="websocket", origin="http://evil.example"), "websocket.close"),
        (http(kind="websocket", host="evil.example", origin=OWN), "websocket.close"),
    ],
)  # fmt: skip
def test_who_is_let_in(scope, status):
    got, headers, asked = ask(scope)
    assert got == status and asked == (status == 200)
    if scope["type"] == "http":
        assert b"frame-ancestors 'none'" in headers[b"content-security-policy"]


def test_two_hosts_are_refused():
    scope = http()
    scope["headers"].append((b"host", b"127.0.0.1:8000"))
    assert ask(scope)[0] == 403


def test_a_body_that_hides_its_length_is_counted():
    scope = http("POST", origin=OWN)
    assert ask(scope, (b"12345", b"67890"))[0] == 200
    assert ask(scope, (b"12345", b"67890", b"1"))[0] == 413


# -- the command ---------------------------------------------------------------------------------------------------


def test_without_the_extra_the_command_says_what_to_install(run, monkeypatch):
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    code, out, err = run("app")
    assert code == 2 and 'pip install "narx-sym[app]"' in err and "Traceback" not in err and not out


def test_a_file_that_is_not_there_ends_the_command(run, monkeypatch, tmp_path):
    monkeypatch.setattr(command, "find_spec", lambda name: object())
    monkeypatch.setattr(cli.live, "find_spec", lambda name: object())
    monkeypatch.setattr("narx_sym.app.server.serve", None)
    code, _, err = run("app", tmp_path / "nobody.csv")
    assert code == 2 and "no such file" in err and "Traceback" not in err


# -- sessions ------------------------------------------------------------------------------------------------------


def test_sessions_are_apart_and_the_first_without_a_page_goes():
    pytest.importorskip("nicegui", reason="the extra narx-sym[app] is not installed")
    from narx_sym.app.server import Sessions

    sessions = Sessions(Workbench, most=2)
    try:
        (one, first), (_, second) = sessions.new(), sessions.new()
        assert first is not second and first.folder != second.folder
        sessions.entered(one)
        three, _ = sessions.new()
        assert set(sessions.benches) == {one, three} and not second.folder.exists()
        sessions.entered(three)
        with pytest.raises(ns.errors.NarxError, match="close one"):
            sessions.new()
        sessions.left(three)
        sessions.new()
        assert one in sessions.benches and three not in sessions.benches
    finally:
        sessions.close()
    assert not first.folder.exists()
