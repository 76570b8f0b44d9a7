"""What several test modules share."""

import logging
import os
import re
import shlex
import sys
from dataclasses import replace
from functools import cache

import pytest
from hypothesis import settings

if "PYTEST_XDIST_WORKER" in os.environ:  # the cores are taken: threads of linear algebra would wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # every process that a test starts would compile the package again

import live
from places import ROOT
from sampling import only

import narx_sym as ns
from narx_sym.cli import main as cli
from narx_sym.data.examples import PLAY, STAGE_UNITS, stage
from narx_sym.diagnosis.experiment.choose import propose
from narx_sym.files.telling import LOG

# A property holds or fails the same way in every run. HYPOTHESIS_PROFILE=default looks at new examples each time.
settings.register_profile("same", derandomize=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
STAGE_EFFECTS = ("backlash", "hysteresis", "dead_zone", "coulomb_friction", "creep", "inertia", "drift")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep tests that share a fixture in one process, where it is made once; spread all others singly."""
    from xdist.scheduler import LoadScopeScheduling

    class Sharing(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return _shared(file) or nodeid

    return Sharing(config, log)


@cache
def _shared(file):
    """Return what the tests of a file share: the stage's diagnosis, a fixture of the file, or nothing."""
    text = (ROOT / file).read_text(encoding="utf-8")
    return "stage" if "(stage_" in text or ", stage_" in text else file if 'scope="module"' in text else ""


class Fences(logging.Handler):
    """Hears what failed behind a fence, where no user is troubled by it."""

    def __init__(self):
        super().__init__(logging.DEBUG)
        self.heard = []

    def emit(self, record):
        self.heard.append(record.getMessage())


FENCES = Fences()
LOG.addHandler(FENCES)
LOG.setLevel(logging.DEBUG)


@pytest.fixture(autouse=True)
def fences():
    """Fail a test in which something failed behind a fence, unless it expects that and clears the list."""
    yield FENCES.heard
    heard = [*FENCES.heard]
    FENCES.heard.clear()
    assert not heard


@pytest.fixture
def run(monkeypatch, capsys):
    """Run a command in this process, given as its words or as one line: (exit code, stdout, stderr)."""

    def call(*arguments):
        if len(arguments) == 1:
            arguments = shlex.split(str(arguments[0]))
        monkeypatch.setattr(sys, "argv", ["narx-sym", *map(str, arguments)])
        try:
            cli.main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        out, err = capsys.readouterr()
        return code, out, err

    def good(*arguments):
        """Run a command that must end well: (stdout, stderr)."""
        code, out, err = call(*arguments)
        assert code == 0, err
        return out, err

    call.good = good
    return call


@pytest.fixture(scope="session")
def stage_diagnosis():
    """Return the demo's diagnosis of the stage with play in its gear, among fewer effects and without its search.

    It is told as if the data could not decide between its first two candidates: then the report has all its parts.
    """
    record = stage(PLAY)
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "y[k-3]", "u[k-2]", "u[k-3]", "u[k-4]", "1"])
    found = ns.diagnose(base.fit(record, method="free_run"), record, catalogue=only(*STAGE_EFFECTS))
    assert found.confusion_set == ["backlash"]
    two = {c.effect: c.model for c in found.candidates[:2]}
    experiment = propose(two, record, found.floor)
    first = replace(found.steps[0], verdict="confused", confusion_set=list(two), experiment=experiment)
    return replace(found, steps=[first])


@pytest.fixture(scope="session")
def stage_report(stage_diagnosis, tmp_path_factory):
    """Return the demo's report."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    stage_diagnosis.report(path, STAGE_UNITS)
    return path


@pytest.fixture(scope="session")
def stage_parts(stage_report):
    """Return the parts of the demo's report by their keys, each from its title on."""
    page = stage_report.read_text(encoding="utf-8")
    return dict(re.findall(r'<section id="(\w+)" .*?(<h[12].*?)</section>', page, re.DOTALL))


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=live.CHROMIUM, args=live.FLAGS)
        yield made
        made.close()
