"""What several test modules share."""

import os
import sys

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:  # the cores are taken: threads of linear algebra would wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import narx_sym as ns
from narx_sym.cli import main as cli
from narx_sym.data.examples import PLAY, STAGE_UNITS, stage

STAGE_EFFECTS = ("backlash", "hysteresis", "dead_zone", "coulomb_friction", "creep", "inertia", "drift")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Keep tests that share a fixture of their module or of the session in one process: it is made once."""
    for item in items:
        found = [made[-1] for made in item._fixtureinfo.name2fixturedefs.values()]
        shared = [(f.scope != "session", f.baseid, f.argname) for f in found if f.baseid and f.scope != "function"]
        if shared:
            item.add_marker(pytest.mark.xdist_group("-".join(min(shared)[1:])))


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
    """Return the demo's diagnosis of the stage with play in its gear, among fewer effects and without its search."""
    record = stage(PLAY)
    catalogue = ns.effects.Catalogue({name: ns.EFFECTS[name] for name in STAGE_EFFECTS})
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "y[k-3]", "u[k-2]", "u[k-3]", "u[k-4]", "1"])
    return ns.diagnose(base.fit(record, method="free_run"), record, catalogue=catalogue)


@pytest.fixture(scope="session")
def stage_report(stage_diagnosis, tmp_path_factory):
    """Return the demo's report."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    stage_diagnosis.report(path, STAGE_UNITS)
    return path
