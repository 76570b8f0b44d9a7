"""What is kept between processes: found again, never taken from others or when damaged, bounded, never an error."""

import os
import stat
import subprocess
import sys

import numpy as np
import pytest

from narx_sym.engines.compile import _compiled
from narx_sym.engines.machine import emitter
from narx_sym.files import cache
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, u, y

posix = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="the owners and rights of POSIX")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "kept"))
    cache._folder.cache_clear()
    yield tmp_path / "kept" / "narx_sym"
    cache._folder.cache_clear()


def only(folder):
    (found,) = [f for f in folder.iterdir()]
    return found


def test_what_is_kept_is_found_under_its_text_alone(folder):
    assert cache.kept("a") is None
    cache.keep("a", b"code of a")
    assert cache.kept("a") == b"code of a" and cache.kept("b") is None
    cache.keep("a", b"newer")
    assert cache.kept("a") == b"newer" and len(list(folder.iterdir())) == 1  # no part is left


@posix
def test_nobody_else_may_read_or_write_it(folder):
    cache.keep("a", b"code")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700 and stat.S_IMODE(only(folder).stat().st_mode) == 0o600


@pytest.mark.parametrize(
    "change", (lambda x: x[:-1], lambda x: b"", lambda x: x[:40] + b"?" + x[41:], lambda x: x + b" ")
)
def test_a_damaged_file_is_not_used(folder, change):
    cache.keep("a", b"code of some length")
    file = only(folder)
    file.write_bytes(change(file.read_bytes()))
    assert cache.kept("a") is None


def test_a_file_under_the_name_of_another_is_not_used(folder):
    cache.keep("a", b"code of a")
    file = only(folder)
    cache.keep("b", b"code of b")
    other = next(f for f in folder.iterdir() if f != file)
    other.write_bytes(file.read_bytes())
    assert cache.kept("b") is None and cache.kept("a") == b"code of a"


@posix
def test_what_others_can_change_is_not_used(folder, tmp_path):
    cache.keep("a", b"code")
    file = only(folder)
    file.chmod(0o622)
    assert cache.kept("a") is None
    file.chmod(0o600)
    assert cache.kept("a") == b"code"
    elsewhere = tmp_path / "elsewhere"
    file.rename(elsewhere)
    file.symlink_to(elsewhere)
    assert cache.kept("a") is None
    file.unlink()
    folder.chmod(0o777)
    cache._folder.cache_clear()
    cache.keep("a", b"code")
    assert cache.kept("a") is None and not list(folder.iterdir())


@posix
def test_a_linked_folder_is_not_used(folder, tmp_path):
    (tmp_path / "other").mkdir(mode=0o700)
    folder.parent.mkdir()
    folder.symlink_to(tmp_path / "other")
    cache.keep("a", b"code")
    assert cache.kept("a") is None and not list((tmp_path / "other").iterdir())


@posix
def test_a_folder_of_another_user_is_not_used(folder, monkeypatch):
    cache.keep("a", b"code")
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1, raising=False)
    cache._folder.cache_clear()
    assert cache.kept("a") is None


@pytest.mark.parametrize("value", ("", "off", "OFF", "0"))
def test_it_can_be_switched_off(monkeypatch, tmp_path, value):
    monkeypatch.setenv(cache.VARIABLE, value)
    monkeypatch.chdir(tmp_path)
    cache.keep("a", b"code")
    assert cache.kept("a") is None and not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_no_error(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no folder")
    for place in (tmp_path / "file", tmp_path / "file" / "below", "/proc/nowhere", "\0"):
        if "\0" not in str(place):
            monkeypatch.setenv(cache.VARIABLE, str(place))
            cache.keep("a", b"code")
            assert cache.kept("a") is None


def test_the_older_half_goes_where_there_is_too_much(folder, monkeypatch):
    monkeypatch.setattr(cache, "MANY", 10)
    for i in range(12):
        cache.keep(str(i), b"code")
        os.utime(folder / cache._name(str(i)), (i, i))
    cache._folder.cache_clear()  # the next process
    assert [i for i in range(12) if cache.kept(str(i))] == list(range(6, 12))
    monkeypatch.setattr(cache, "LARGEST", 100)
    cache._folder.cache_clear()
    assert sum(cache.kept(str(i)) is not None for i in range(12)) == 3


def test_without_a_home_there_is_none(monkeypatch):
    for name in (cache.VARIABLE, "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(cache.Path, "home", homeless)
    cache._folder.cache_clear()
    cache.keep("a", b"code")
    assert cache.kept("a") is None
    cache._folder.cache_clear()


# -- compiled code ---------------------------------------------------------------------------------------------


def run():
    compiled = _compiled.__wrapped__(Recursion(((y[k], 0.9 * y[k - 1] + u[k] ** 2),)), "native")
    return compiled({"u": np.linspace(-1, 1, 300)}, (), {"y": 0.5})["y"]


def test_code_that_was_kept_computes_the_same(folder, monkeypatch):
    first = run()
    assert len(list(folder.iterdir())) == 1
    monkeypatch.setattr(emitter.llvm, "create_pass_builder", None)  # nothing is optimised a second time
    assert np.array_equal(run(), first)
    monkeypatch.setattr(emitter, "processor", lambda: "another processor")
    with pytest.raises(TypeError):  # code for another processor is not taken
        run()


def test_another_process_takes_what_was_kept(folder):
    here = run()
    script = (
        "import llvmlite.binding as llvm, sys; sys.path.insert(0, 'tests/files'); import test_cache as t;"
        "t.emitter.llvm.create_pass_builder = None; print(t.run().tobytes().hex())"
    )
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    environment = {**os.environ, "PYTHONPATH": root, "PYTHONHASHSEED": "7"}
    made = subprocess.run(
        [sys.executable, "-c", script], cwd=root, env=environment, capture_output=True, text=True, check=True
    )
    assert made.stdout.strip() == here.tobytes().hex()
