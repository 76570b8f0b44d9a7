"""Folders that tests read: the project, its package, and measured data beside it."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "narx_sym"
_PLACES = (ROOT.parent / "shared" / "data", ROOT / "shared" / "data")
SHARED = next((p for p in _PLACES if p.is_dir()), Path("shared-data-absent"))
CASES = SHARED.parent / "cases"
needs_cases = pytest.mark.skipif(not CASES.is_dir(), reason="the inputs that once failed are not beside this folder")
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the measured data sets are not beside this folder")
