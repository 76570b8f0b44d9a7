"""Nothing is lost: every writer leaves the old file or the new one, whatever stops it."""

import ast
import errno
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from places import PACKAGE
from sampling import some

import narx_sym as ns
from narx_sym.cli import main as cli
from narx_sym.cli.options import save_figure
from narx_sym.diagnosis.experiment import Experiment
from narx_sym.diagnosis.misfit import misfit_of
from narx_sym.errors import DataError
from narx_sym.files import atomic as files
from narx_sym.files.atomic import write_bytes, write_csv, write_figure, write_text

MODEL = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "u[k-1]*phi1[k-1]"], [1.0, 0.7, 0.01], Ts=0.01)


def figure():
    from matplotlib.figure import Figure

    return Figure(figsize=(1, 1))


WRITERS = {
    "bytes": lambda path: write_bytes(path, b"new"),
    "text": lambda path: write_text(path, "new"),
    "CSV": lambda path: write_csv(path, {"t": [0.0, 1.0]}),
    "model": lambda path: ns.save(MODEL, path),
    "picture": lambda path: write_figure(figure(), path),
    "picture of a command": lambda path: save_figure(figure(), path),
    "picture of plots": lambda path: ns.plots.where_it_fails(misfit(), path),
    "C": lambda path: write_text(path, MODEL.compensator().export("c")),
    "LaTeX": lambda path: write_text(path, ns.latex(MODEL)),
    "experiment": lambda path: experiment().save(path),
    "journal": lambda path: ns.resuming(path).__enter__(),
}


def misfit():
    u = np.sin(np.arange(300) / 9)
    record = ns.Record.from_arrays(u, 0.7 * u + 0.1 * u**3, Ts=0.01)
    return misfit_of(MODEL, record, record.y - ns.free_run(MODEL, record), None)


def experiment():
    from dataclasses import MISSING, fields

    given = {"t": np.arange(3.0), "u": np.ones(3)}
    needed = {
        f.name: given.get(f.name) for f in fields(Experiment) if f.default is MISSING and f.default_factory is MISSING
    }
    return Experiment(**needed)


def old(folder, name):
    path = folder / name
    path.write_text("" if name == "journal" else "old")
    return path


def name_of(writer):
    return "a.png" if writer.startswith("picture") else "journal" if writer == "journal" else "a.txt"


def raised(number):
    def refuse(*args, **kwargs):
        raise OSError(number, os.strerror(number))

    return refuse


@pytest.mark.parametrize("writer", some(WRITERS, 2))
@pytest.mark.parametrize("step", some(("replace", "fsync")))
def test_a_full_disk_leaves_the_old_file(writer, step, tmp_path, monkeypatch):
    path = old(tmp_path, name_of(writer))
    monkeypatch.setattr(files.os, step, raised(errno.ENOSPC))
    with pytest.raises(DataError, match=rf"{path.name}: cannot be written \(No space left"):
        WRITERS[writer](path)
    assert path.read_text() in ("old", "") and os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("writer", some(WRITERS, 4))
def test_ctrl_c_leaves_the_old_file(writer, tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    path = old(tmp_path, name_of(writer))
    monkeypatch.setattr(files.os, "fsync", stop)
    with pytest.raises(KeyboardInterrupt):
        WRITERS[writer](path)
    assert path.read_text() in ("old", "") and os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("writer", WRITERS)
def test_each_replaces_the_old_file(writer, tmp_path):
    path = old(tmp_path, name_of(writer))
    WRITERS[writer](path)
    assert path.read_bytes() not in (b"old", b"") and os.listdir(tmp_path) == [path.name]


# What opens a file for writing anywhere in the package; `files/atomic.py` and the journal's one appended line are all.
WRITING = {"write_text", "write_bytes", "savefig", "to_csv", "savetxt", "save", "savez", "dump", "touch", "to_parquet"}
ALLOWED = {
    ("files/atomic.py", "savetxt"),  # into a StringIO
    ("files/atomic.py", "write_bytes"),  # what is no file: /dev/stdout, a pipe
    ("files/atomic.py", "savefig"),  # into a BytesIO
    ("files/atomic.py", "open"),
    ("files/journal.py", "open"),
    ("files/cache.py", "open"),  # a file of its own name, moved into place
    ("files/store.py", "open"), ("models/effects/_text.py", "open"), ("data/logs.py", "open"),  # for reading
    ("cli/main.py", "open"),  # /dev/null
    ("cli/diagnose.py", "save"),  # Experiment.save, by write_csv
    ("report/svg.py", "savefig"),  # into a buffer
    ("app/choice.py", "write_bytes"), ("app/command.py", "open"),  # an upload, into a folder of its own; a method
}  # fmt: skip


def test_all_writers_go_through_files():
    found = set()
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                own = isinstance(node.func, ast.Name) and name in ("write_text", "write_bytes", "save")
                if (name in WRITING and not own) or name == "open":
                    found.add((path.relative_to(PACKAGE).as_posix(), name))
    assert found <= ALLOWED, found - ALLOWED


def test_links_permissions_and_devices(tmp_path):
    (tmp_path / "real").write_text("old")
    os.chmod(tmp_path / "real", 0o640)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "real").read_text() == "new"
    assert stat.S_IMODE((tmp_path / "real").stat().st_mode) == 0o640
    os.mkfifo(tmp_path / "pipe")
    with subprocess.Popen(["cat", str(tmp_path / "pipe")], stdout=subprocess.PIPE) as reader:
        write_text(tmp_path / "pipe", "into the pipe")
        assert reader.communicate(timeout=20)[0] == b"into the pipe"
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_device_that_is_full(tmp_path, run):
    device = tmp_path / "full"
    device.symlink_to("/dev/full")  # should the code replace what it is given, it replaces the link
    with pytest.raises(DataError, match="No space left on device"):
        write_text(device, "x" * 100)
    assert stat.S_ISCHR(device.stat().st_mode)


def test_targets_are_checked_before_any_work(tmp_path, run, monkeypatch):
    ns.save(MODEL, tmp_path / "m.json")
    (tmp_path / "d.csv").write_text("t,u,y\n" + "".join(f"{i / 10},{i % 7},{i % 5}\n" for i in range(60)))
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr("narx_sym.cli.options.Reading.records", lambda *_: pytest.fail("work was begun"))
    cases = {
        ("fit", tmp_path / "d.csv", "--out", tmp_path / "folder"): "is a folder; give a file name",
        ("fit", tmp_path / "d.csv", "--out", tmp_path / "no" / "m.json"): "no does not exist; make it first",
        ("fit", tmp_path / "d.csv", "--out", tmp_path / "d.csv"): "this command reads this file",
        ("derive", tmp_path / "m.json", "--latex", tmp_path / "a.png", "--plot", tmp_path / "a.png"): "the same file",
        ("compensate", tmp_path / "m.json", "--c", tmp_path / "a", "--st", tmp_path / "a"): "the same file",
        ("diagnose", tmp_path / "d.csv", "--resume", tmp_path / "d.csv"): "this command reads this file",
        ("demo", "--out", tmp_path / "m.json"): "cannot be a folder here",
    }
    for given, words in cases.items():
        code, _, err = run(*given)
        assert code == 2 and words in err and err.count("\n") == 1, err
    code, _, err = run("fit", tmp_path / "d.csv", "--out", tmp_path / "new.json", "--base", "foo")
    assert code == 2 and err.startswith("narx-sym: Unknown base 'foo': --base is one of narx,"), err
    code, _, err = run("fit", tmp_path / "d.csv", "--out", tmp_path / "new.json", "--method", "foo")
    assert code == 2 and "'foo'" in err and err.count("\n") == 1, err
    if Path("/proc/self").exists():  # root may do anything there, says access(2)
        with pytest.raises(DataError, match="is not writable"):
            files.check_path("/proc/new.json")

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(files.Path, "open", refused)
    with pytest.raises(DataError, match=r"is not writable \(Permission denied\)"):
        files.check_path(tmp_path / "new.json")
    monkeypatch.setattr(files, "check_path", Path)
    for name, left in (("new.json", False), ("m.json", True)):
        with pytest.raises(DataError, match="cannot be written") as error:
            files.write_text(tmp_path / name, "{}")
        assert ("as it was" in str(error.value)) == left
    monkeypatch.undo()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["d.csv", "folder", "m.json"]


def test_no_memory_and_system_errors_are_one_line(run, monkeypatch):
    for error, words in (
        (MemoryError(), "not enough memory"),
        (OSError(28, "No space left on device"), "No space left"),
    ):

        def fail(error=error):
            raise error

        monkeypatch.setattr(cli, "app", fail)
        code, _, err = run("effects")
        assert code == 2 and words in err and err.count("\n") == 1


def hears_ctrl_c():
    """A job in the background starts deaf to Ctrl-C, and what it starts inherits that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def command(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "narx_sym", *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=PACKAGE.parent, preexec_fn=hears_ctrl_c,
    )  # fmt: skip


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_standard_output_on_a_full_disk():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "narx_sym", "effects"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=PACKAGE.parent,
        )
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "No space left on device" in done.stderr


@pytest.mark.parametrize(
    "dropped", some(["pass", "raise ImportError('half loaded') from None", "raise ValueError('-')"])
)
def test_ctrl_c_is_not_lost_where_something_drops_it(dropped, tmp_path):
    code = f"""if True:
        import os, signal, sys, time
        import narx_sym.__main__ as command
        from narx_sym.cli import main as cli
        def work():
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(30)
            except BaseException:
                {dropped}
            time.sleep(30)
        cli.app = work
        command.main()"""
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent)
    assert done.returncode == 130 and done.stderr.startswith("narx-sym: interrupted") and done.stderr.count("\n") == 1
    assert time.monotonic() - begin < 30


@pytest.mark.parametrize("seconds", some([1.0, 0.1, 3.0]))
def test_ctrl_c_is_one_line(seconds, tmp_path):
    t = np.arange(20_000) * 0.01
    u = np.sin(t) + np.sin(2.7 * t)
    write_csv(tmp_path / "d.csv", {"t": t, "u": u, "y": np.tanh(u)})
    job = command("diagnose", tmp_path / "d.csv", "--json", tmp_path / "j.json", "--max-effects", 3)
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        time.sleep(0.02)
    job.send_signal(signal.SIGINT)
    _, err = job.communicate(timeout=60)
    if "site" in err or "<frozen" in err:
        pytest.skip("Python itself had not started yet")
    said = [line for line in err.splitlines() if not line.startswith(("Identifying", "Diagnosing", "note:"))]
    assert job.returncode in (130, -signal.SIGINT)  # a shell shows 130 for both
    assert len(said) == 1 and "interrupted; files are either whole" in said[0], err
    assert os.listdir(tmp_path) == ["d.csv"]
