"""What the scripts behind the book's figures share: paths, one thread of BLAS, options, parallel work, tables."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
for one in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # before NumPy loads its BLAS; the workers inherit it
    os.environ.setdefault(one, "1")


def asked(text: str | None, **defaults: Any) -> argparse.Namespace:
    """Read options: False stands for a flag, a type for an option without a default, a sequence for several values."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        option = "--" + name.replace("_", "-")
        if default is False:
            parser.add_argument(option, action="store_true")
        elif isinstance(default, type):
            parser.add_argument(option, type=default)
        elif isinstance(default, list | tuple):
            parser.add_argument(option, nargs="+", type=type(default[0]), default=default)
        else:
            parser.add_argument(option, type=type(default), default=default)
    return parser.parse_args()


def seeds_of(text: str) -> range:
    """Read "first:last+1" or one seed."""
    first, _, stop = text.partition(":")
    return range(int(first), int(stop) if stop else int(first) + 1)


def parallel(function: Callable[..., Any], calls: Sequence[tuple[Any, ...]], jobs: int, what: str) -> list[Any]:
    """Run the calls through joblib under a progress bar."""
    from joblib import Parallel, delayed
    from rich.progress import track

    work = Parallel(n_jobs=jobs, return_as="generator")(delayed(function)(*c) for c in calls)
    return list(track(work, description=what, total=len(calls)))


def mark(right: bool, visible: bool) -> str:
    """Return what a case is: right, wrong, or not to be seen."""
    return "right" if right else "WRONG" if visible else "-"


def print_counts(counts: Mapping[tuple[str, str], int]) -> None:
    """Print how many cases of each group are what."""
    for (group, what), n in counts.items():
        print(f"{group}: {n} {what}")


def publish(text: str, path: Path | None) -> None:
    """Print a page, and write it where a file is named."""
    print(text)
    if path:
        path.write_text(text + "\n", encoding="utf-8")


def record_of(case: Any) -> Any:
    """Return the record of a case of `truths`."""
    from narx_sym import Record

    return Record.from_arrays(case.u, case.y, case.Ts, channels=case.channels, name=case.name)


def diagnosed(record: Any, **options: Any) -> Any:
    """Go the way of a user: a linear base, then its diagnosis."""
    from narx_sym import diagnose, identify

    return diagnose(identify(record, base="linear"), record, **options)
