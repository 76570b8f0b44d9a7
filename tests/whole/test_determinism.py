"""The same data, seed and version give the same bytes: repeated, in other processes, in parallel, on another Python."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import same

from narx_sym.fit.bootstrap import block_bootstrap

SCRIPT = Path(same.__file__)
WRITTEN = {
    "model.json", "model.tex", "law.tex", "law.c", "law.st", "law.js", "bootstrap.json", "found.json", "completed.json",
    "completed.tex",
}  # fmt: skip
USED = "numpy scipy sympy llvmlite lark joblib pandas"  # their versions belong to the result
VERSIONS = f"import sys; print(sys.version_info[:2], *(__import__(n).__version__ for n in {USED!r}.split()))"


def files(folder):
    return {f.name: f.read_bytes() for f in folder.iterdir()}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("same")
    same.write_all(folder, 1)
    found = files(folder)
    assert found.keys() == WRITTEN and all(len(content) > 50 for content in found.values())
    return found


def fresh(python, folder, jobs, seed):
    """Run in a fresh process with another seed of Python's hashes."""
    environment = {**os.environ, "PYTHONPATH": str(SCRIPT.parents[1]), "PYTHONHASHSEED": str(seed)}
    subprocess.run([python, SCRIPT, folder, str(jobs)], env=environment, check=True, timeout=300)
    return files(folder)


def others():
    """Interpreters of other versions, from NARX_SYM_PYTHONS and the path."""
    named = filter(None, os.environ.get("NARX_SYM_PYTHONS", "").split(os.pathsep))
    return [*named, *filter(None, map(shutil.which, ("python3.11", "python3.12", "python3.13")))]


def versions(python):
    found = subprocess.run([python, "-c", VERSIONS], capture_output=True, text=True, timeout=120, check=False)
    return found.stdout.strip().partition(")") if found.returncode == 0 else ("", "", "")


@pytest.mark.long
def test_repeated_in_one_process(reference, tmp_path):
    same.write_all(tmp_path, 1)
    assert files(tmp_path) == reference


@pytest.mark.long
def test_in_a_fresh_process_with_other_hashes_and_two_workers(reference, tmp_path):
    assert fresh(sys.executable, tmp_path, 2, 1) == reference


@pytest.mark.long
def test_on_another_python(reference, tmp_path):
    own = versions(sys.executable)
    equal = [p for p in others() if (v := versions(p))[0] != own[0] and v[2] == own[2]]
    if not equal:
        pytest.skip(f"no other Python with the same versions of {USED} is installed (NARX_SYM_PYTHONS names one)")
    assert fresh(equal[0], tmp_path, 1, 2) == reference


def test_another_seed_gives_other_files():
    """The comparison can fail: what is random depends on the seed."""
    import narx_sym as ns

    steps, noise = same.sources()
    record = ns.Record.from_arrays(steps, steps + 0.1 * noise, Ts=1.0)
    model = ns.identify(record, base="static")
    draws = [block_bootstrap(model, record, draws=4, seed=s).thetas.tobytes() for s in (5, 5, 6)]
    assert draws[0] == draws[1] != draws[2]
