"""What several test modules share."""

import sys

import pytest

import narx_sym as ns
from narx_sym.cli import main as cli
from narx_sym.data.examples import PLAY, STAGE_UNITS, stage


@pytest.fixture
def run(monkeypatch, capsys):
    """Run a command in this process: (exit code, stdout, stderr)."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["narx-sym", *map(str, arguments)])
        try:
            cli.main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture(scope="session")
def stage_diagnosis():
    """Return the demo's diagnosis of the stage with play in its gear, without its search for orders."""
    record = stage(PLAY)
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "y[k-3]", "u[k-2]", "u[k-3]", "u[k-4]", "1"])
    return ns.diagnose(base.fit(record, method="free_run"), record)


@pytest.fixture(scope="session")
def stage_report(stage_diagnosis, tmp_path_factory):
    """Return the demo's report."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    stage_diagnosis.report(path, STAGE_UNITS)
    return path
