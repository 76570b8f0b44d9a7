"""The README is kept true: its walk through a user's own CSV and its Python examples are run."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

import narx_sym as ns
from narx_sym.cli import main as cli

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.S)


def commands():
    block = next(b for b in blocks("console") if "my_data.csv" in b)
    return [line for line in block.splitlines() if line.startswith("narx-sym ")]


@pytest.fixture
def own_data(tmp_path, monkeypatch):
    """What the README supposes: my_data.csv and wanted.csv in the current folder."""
    monkeypatch.chdir(tmp_path)
    u = ns.plants.filtered_noise(N=5000, Ts=0.01, cutoff=0.5, peak=75.0, seed=5)
    y = ns.plants.bouc_wen(u, Ts=0.01)
    t = np.arange(u.size) * 0.01
    rows = "\n".join(f"{a:.2f},{b:.8g},{c:.8g}" for a, b, c in zip(t, u, y, strict=True))
    Path("my_data.csv").write_text("t,u,y\n" + rows + "\n")
    wanted = "\n".join(f"{a:.2f},{30 * np.sin(a):.8g}" for a in t[:1000])
    Path("wanted.csv").write_text("t,r\n" + wanted + "\n")
    return tmp_path


def test_walk_through_own_csv(own_data, monkeypatch, capsys):
    lines = commands()
    assert len(lines) >= 6
    for line in lines:
        monkeypatch.setattr(sys, "argv", line.split())
        with pytest.raises(SystemExit) as stop:
            cli.main()
        assert not stop.value.code, line
    for name in (
        "model.json",
        "compare.png",
        "derivation.tex",
        "sets.png",
        "law.tex",
        "law.c",
        "law.st",
        "input.csv",
        "expected.csv",
    ):
        assert (own_data / name).stat().st_size > 0, name
    # The law inverts the model: what it expects is what was wanted.
    expected, wanted = ns.read("expected.csv"), ns.read("input.csv", u="m", y="r")
    assert ns.metrics.nrmse(wanted.y, expected.y) < 0.02
    assert "free-run NRMSE" in capsys.readouterr().out


def test_python_examples(own_data):
    names: dict = {}
    try:
        for block in blocks("python"):
            exec(compile(block, "README.md", "exec"), names)
    finally:
        ns.EFFECTS.pop("soft_start", None)
    assert names["found"].best.effect == "hysteresis"
    assert names["law"].residual() == 0
    assert np.allclose(names["bouc_wen"].theta, [0.7, 0.008, 0.008, 1.6], rtol=0.02)


def test_effect_from_text(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(next(b for b in blocks("toml")), encoding="utf-8")
    (one,) = ns.load_effects(path, ns.effects.Catalogue())
    assert one.id == "soft_start"
    assert one.shape == ("s",)


def test_two_commands_stand_alone():
    lines = [line for b in blocks("console") for line in b.splitlines()]
    assert len([line for line in lines if "narx-sym demo" in line]) == 1
    assert len([line for line in lines if "pytest" in line]) == 1
