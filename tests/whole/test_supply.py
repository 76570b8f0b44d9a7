"""What the package stands on: every dependency has a tested floor, no cap, and a licence that the book states."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata, version

import pytest
from floors import FAST, floors
from places import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DIRECT = [re.match(r"[\w.-]+", text)[0] for text in PROJECT["dependencies"]]
PAGE = (ROOT / "derivations" / "results" / "supply.md").read_text(encoding="utf-8")
TABLE = dict(re.findall(r"^\| `([\w-]+)` \| [^|]+ \| ([^|]+) \|", PAGE, re.M))
WORDS = {  # of a licence's texts in the metadata of a distribution
    "BSD-2-Clause": "BSD", "BSD-3-Clause": "BSD|NumPy Developers|Enthought", "MIT": "MIT", "LGPL-3.0-or-later": "LGPL|Lesser",
    "PSF-based": "matplotlib|Python Software Foundation",
}  # fmt: skip


def said(name):
    """All that a distribution says about its licence."""
    known = metadata(name)
    fields = [
        known.get("License-Expression") or "",
        (known.get("License") or "")[:300],
        *(known.get_all("Classifier") or []),
    ]
    return " ".join(f for f in fields if "Programming Language" not in f)


def test_the_book_lists_every_dependency_and_no_other():
    assert sorted(TABLE) == sorted(DIRECT)
    assert set(map(str.strip, TABLE.values())) <= set(WORDS)


@pytest.mark.parametrize("name", DIRECT)
def test_the_licence_is_the_one_of_the_distribution(name):
    try:
        found = said(name)
    except PackageNotFoundError:
        pytest.skip(f"{name} is not installed")
    assert re.search(WORDS[TABLE[name].strip()], found), found


def test_the_floors_in_the_book_are_those_of_the_project():
    found = dict(re.findall(r"^\| `([\w-]+)` \| ([0-9.]+) \|", PAGE, re.M))
    allowed = floors()
    assert found == {name: allowed[name] for name in DIRECT}


def test_what_is_installed_is_allowed():
    def number(text):
        return tuple(int(p) for p in re.findall(r"\d+", text)[:3])

    for name, floor in floors().items():
        try:
            assert number(version(name)) >= number(floor), name
        except PackageNotFoundError:
            continue


def test_the_fast_subset_exists():
    assert all((ROOT / "tests" / f"{name}.py").is_file() for name in FAST)


def test_the_checks_build_sdist_and_wheel():
    script = ROOT / ".ci" / "run"
    if not script.is_file():
        pytest.skip("an sdist has no .ci")
    text = script.read_text(encoding="utf-8")
    assert "-t sdist" in text and "*.tar.gz" in text and "*.whl" in text
