"""The lowest versions that pyproject.toml allows, as constraints for pip; and a fast subset of the tests with them.

    python tests/bench/floors.py                  # prints name==floor for every direct dependency
    python tests/bench/floors.py --run FOLDER     # makes an environment in FOLDER with them and runs the tests there

Needs pip's index. A floor that is too low shows as an installation that fails, or as a failing test.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FAST = (
    "whole/test_layers",
    "symbolic/test_grammar",
    "files/test_store",
    "data/test_record",
    "cli/test_main",
    "fit/test_least_squares",
    "fit/test_select",
    "engines/test_engines",
    "models/test_extend",
    "data/test_metrics",
    "models/test_pool",
    "files/test_atomic",
)


def floors(extra: str = "test") -> dict[str, str]:
    """Return name and lowest version of the dependencies and of an extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = {}
    for text in (*project["dependencies"], *project["optional-dependencies"][extra]):
        match = re.fullmatch(r"([A-Za-z0-9_.-]+)>=([0-9.]+)(?:,!=[0-9.]+)*", text)
        if match is None:
            raise SystemExit(f"{text}: a dependency is written name>=floor and versions left out, without an upper cap")
        found[match[1]] = match[2]
    return found


def main() -> int:
    """Print the floors, or test with them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    pins = [f"{name}=={version}" for name, version in floors().items()]
    if options.run is None:
        print("\n".join(pins))
        return 0
    options.run.mkdir(parents=True, exist_ok=True)
    constraints = options.run / "floors.txt"
    constraints.write_text("\n".join(pins) + "\n", encoding="utf-8")
    python = options.run / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", options.run], check=True)
    subprocess.run([python, "-m", "pip", "install", "-q", "-c", constraints, "-e", f"{ROOT}[test]"], check=True)
    tests = [f"tests/{name}.py" for name in FAST]
    return subprocess.run([python, "-m", "pytest", "-q", *tests], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
