"""What only tells how work goes on never ends it: a fence, and a stderr that may be lost."""

import io
import os
import subprocess
import sys

import pytest

from narx_sym.files.parallel import sweep
from narx_sym.files.telling import Stderr, fenced


def test_an_error_behind_a_fence_is_only_heard(fences):
    with fenced("The bar"):
        raise TypeError("no bar")
    assert fences == ["The bar failed; the computation continues"]
    fences.clear()


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_ctrl_c_passes_a_fence(stop):
    with pytest.raises(stop), fenced("The bar"):
        raise stop


class Full(io.StringIO):
    def write(self, *text):
        raise OSError(28, "No space left on device")

    flush = write


@pytest.mark.parametrize("stream", [Full(), None, io.TextIOWrapper(io.BytesIO(), encoding="ascii")])
def test_a_stderr_that_takes_nothing_ends_no_work(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    print("µ", file=Stderr(), flush=True)
    assert sweep(abs, [(-1,), (2,)], what="µ") == [1, 2]


def test_a_closed_stderr_is_passed_over(monkeypatch):
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr(sys, "stderr", closed)
    Stderr().write("lost")
    Stderr().flush()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="Linux has a disk that is always full")
def test_a_command_ends_well_though_the_disk_of_its_log_is_full(tmp_path):
    code = (
        "from narx_sym.cli.printing import working, note\n"
        "with working('Working') as tell:\n    tell('a stage')\nnote('a note')\nprint('done')"
    )
    with open("/dev/full", "w") as full:
        ended = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=full, text=True)
    assert ended.returncode == 0 and ended.stdout == "done\n"
