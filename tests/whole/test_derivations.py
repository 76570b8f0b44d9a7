"""Each page of the book that has code runs top to bottom and ends in an assert; no row of the paper is without one.

`.ci/run` runs the long ones by building the book, which shows their pictures too.
"""

import runpy

import pytest
from places import ROOT

BOOK = ROOT / "derivations"
ROOMS = ("bench_test", "examples", "guides", "inside")
SCRIPTS = sorted(script for room in ROOMS for script in (BOOK / room).glob("*.py"))
ROWS = ("E1", "E2", *(f"P{n}" for n in range(1, 12)), "V1", "V2", "B1", "B2", "B3", "B4", "B5", "B6")
QUICK = ("E1", "P1")  # the others run when the book is built, or with -m long
OF_THE_PAPER = [script for script in SCRIPTS if script.parent.name in ("bench_test", "examples")]


def row_of(script):
    return script.stem.split("_")[0] if script in OF_THE_PAPER else script.stem


def mark(script):
    return pytest.param(script, id=row_of(script), marks=[] if row_of(script) in QUICK else pytest.mark.long)


def test_every_row_has_one_script():
    assert sorted(map(row_of, OF_THE_PAPER)) == sorted(ROWS)


@pytest.mark.parametrize("script", SCRIPTS, ids=row_of)
def test_page_has_a_title_and_ends_in_an_assert(script):
    text = script.read_text(encoding="utf-8")
    row = f" {row_of(script)}:" if script in OF_THE_PAPER else " "
    assert text.startswith("# %% [markdown]\n# #" + row)
    assert "assert" in text.split("# %%")[-1]


@pytest.mark.parametrize("script", SCRIPTS, ids=row_of)
def test_page_is_in_the_table_of_contents(script):
    assert script.relative_to(BOOK).with_suffix("").as_posix() in (BOOK / "index.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("script", [mark(script) for script in SCRIPTS])
def test_script_runs(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)  # it must not depend on where it is started
    names = runpy.run_path(str(script), run_name="__main__")
    printed = capsys.readouterr().out
    if script in OF_THE_PAPER:
        assert "\\" in printed, "the derivation prints no LaTeX"
    assert not list(tmp_path.iterdir()), "the page wrote into the current folder"
    if "figure" in names:
        assert all(ax.has_data() for ax in names["figure"].axes)
