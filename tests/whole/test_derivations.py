"""Each derivation runs top to bottom, and no row of the paper is without one."""

import runpy
import time
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "derivations"
SCRIPTS = sorted(FOLDER.glob("*.py"))
ROWS = ("E1", "E2", *(f"P{n}" for n in range(1, 12)), "V1", "V2", "B2")


def row_of(script):
    return script.stem.split("_")[0]


@pytest.mark.parametrize("row", ROWS)
def test_every_row_has_one_script(row):
    assert [s for s in SCRIPTS if row_of(s) == row], f"derivations/{row}_*.py is missing"
    assert len([s for s in SCRIPTS if row_of(s) == row]) == 1


@pytest.mark.parametrize("script", SCRIPTS, ids=row_of)
def test_script_has_cells_and_ends_in_an_assert(script):
    cells = script.read_text(encoding="utf-8").split("# %%")
    assert script.read_text(encoding="utf-8").startswith("# %% [markdown]\n# # " + row_of(script) + ":")
    assert "assert" in cells[-1]


@pytest.mark.parametrize("script", SCRIPTS, ids=row_of)
def test_script_runs(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)  # it must not depend on where it is started
    started = time.time()
    names = runpy.run_path(str(script), run_name="__main__")
    printed = capsys.readouterr().out
    assert "\\" in printed, "the derivation prints no LaTeX"
    assert not list(tmp_path.iterdir()), "the derivation wrote into the current folder"
    figure = names.get("FIGURE")
    if figure is not None:
        assert figure.parent == FOLDER / "figures" and figure.stem == row_of(script)
        # Two seconds of slack: some file systems keep coarse time stamps.
        assert figure.stat().st_size > 10_000 and figure.stat().st_mtime > started - 2
