"""README and book are kept true: the commands and examples that they print are run."""

import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from places import PACKAGE, ROOT
from sampling import more

import narx_sym as ns
from narx_sym.cli import main as cli

BOOK = ROOT / "derivations"
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted(p for room in (".", "guides", "results", "inside", "reference") for p in (BOOK / room).glob("*.md"))
SCRIPTS = sorted(p for p in BOOK.glob("*/*.py") if p.parent.name != "figures")


def prose(path):
    """The text of a page; of a script its Markdown cells."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return text
    cells = [cell for cell in text.split("# %%") if cell.startswith(" [markdown]")]
    return "\n".join(line.removeprefix("# ").removeprefix("#") for cell in cells for line in cell.splitlines()[1:])


def blocks(text):
    """Language and content of each fenced block that is no directive."""
    return re.findall(r"^```(\w+)\n(.*?)^```", text, re.S | re.M)


def lines(text):
    return [line for language, block in blocks(text) for line in block.splitlines() if language == "console"]


def run(line, monkeypatch):
    monkeypatch.setattr(sys, "argv", shlex.split(line))
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code, line


@pytest.fixture
def own_data(tmp_path, monkeypatch):
    """What README and book suppose: my_data.csv, stage.csv and wanted.csv in the current folder."""
    monkeypatch.chdir(tmp_path)
    u = ns.plants.filtered_noise(N=5000, Ts=0.01, cutoff=0.5, peak=75.0, seed=5)
    y = ns.plants.bouc_wen(u, Ts=0.01)
    t = np.arange(u.size) * 0.01
    rows = "\n".join(f"{a:.2f},{b:.8g},{c:.8g}" for a, b, c in zip(t, u, y, strict=True))
    for name in ("my_data.csv", "stage.csv"):
        Path(name).write_text("t,u,y\n" + rows + "\n")
    wanted = "\n".join(f"{a:.2f},{30 * np.sin(a):.8g}" for a in t[:1000])
    Path("wanted.csv").write_text("t,r\n" + wanted + "\n")
    return tmp_path


@more
def test_walk_through_own_csv(own_data, monkeypatch, capsys):
    commands = [line for line in lines(README) if line.startswith("narx-sym ")]
    assert len(commands) == 5
    for line in commands:
        run(line, monkeypatch)
    written = "model.json compare.png derivation.tex sets.png input.csv law.c law.st found.html"
    for name in written.split():
        assert (own_data / name).stat().st_size > 0, name
    assert "free-run NRMSE" in capsys.readouterr().out
    # The law inverts the model: what the model makes of the planned input is what was wanted.
    planned = ns.read("input.csv", u="m", y="r")
    expected = ns.load("model.json").simulate(planned.u, y0=0.0)
    assert ns.metrics.nrmse(planned.y, expected) < 0.02


def test_python_examples(own_data):
    names: dict = {}
    examples = [block for language, block in blocks(README) if language == "python"]
    assert examples
    for block in examples:
        exec(compile(block, "README.md", "exec"), names)
    assert names["found"].best.effect == "hysteresis"
    assert names["law"].residual() == 0


@pytest.mark.bench
def test_commands_of_the_guides(own_data, monkeypatch):
    commands = [line for page in (*PAGES, *SCRIPTS) for line in lines(prose(page)) if line.startswith("narx-sym ")]
    assert len(commands) >= 6
    run("narx-sym fit my_data.csv --for-compensation --out model.json", monkeypatch)
    for line in commands:
        # A live page has no end, and journals are tried where runs are interrupted.
        run("narx-sym app --help" if line.startswith("narx-sym app") else line, monkeypatch)


def test_blocks_of_the_book_are_of_a_kind_that_is_run():
    for page in (*PAGES, *SCRIPTS):
        for language, _ in blocks(prose(page)):
            assert language in ("console",), f"{page}: what is written in {language} stands in a script, which is run"
        for line in lines(prose(page)):
            assert line.split()[0] in ("narx-sym", "pip", "python3", ".venv/bin/python", ".venv/bin/ruff"), line


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES, *SCRIPTS], ids=lambda p: p.stem)
def test_files_that_are_named_exist(page):
    text = prose(page)
    for name in re.findall(r"\b(?:tests|derivations)/[\w/]+\.\w+", text):
        assert (ROOT / name).exists(), f"{page}: {name}"
    for name in re.findall(r"`((?:symbolic|models|inversion|engines|codegen|data|fit|report)/\w+(?:\.py|/))`", text):
        assert (PACKAGE / name).exists(), f"{page}: {name}"
    for target in re.findall(r"\]\(((?!https?:|#)[^)#]+)", text):
        assert (page.parent / target).exists(), f"{page}: {target}"


def test_two_commands_stand_alone():
    assert len([line for line in lines(README) if "narx-sym demo" in line]) == 1
    assert len([line for line in lines(README) if "pytest" in line]) == 1


def test_readme_is_short():
    assert len(README.splitlines()) <= 160


def test_the_reference_lists_the_public_names():
    listed = re.findall(
        r"^   ~narx_sym\.[\w.]+\.(\w+)$", (BOOK / "reference" / "public.md").read_text(encoding="utf-8"), re.M
    )
    public = [
        n for n in ns.__all__ if callable(getattr(ns, n)) and (getattr(ns, n).__module__ or "").startswith("narx_sym")
    ]
    assert sorted(listed) == sorted(public)
