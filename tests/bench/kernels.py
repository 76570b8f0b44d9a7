"""Whether a verdict hangs on rounding: the same records under other kernels of OpenBLAS, other threads, other last digits.

    python tests/bench/kernels.py [--seeds 9880:9881] [--real] [--kernels Haswell SkylakeX Zen] [--jobs 2]

Simulated machines of `truths` with one hidden effect and with none; with `--real` the measured records of `sensitivity` too.
Each is identified and diagnosed by a process of its own for every kernel, once more with two threads of BLAS, and once
more with noise of 1e-9 of each signal on the data. Verdict, set, what was added and the order of all candidates are
compared with those of the first kernel. A kernel that this processor cannot run is named as such.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from common import asked, diagnosed, record_of, seeds_of

KINDS = ("in", "off", "null")
LAST_DIGITS = 1e-9


def records(seeds: range, real: bool) -> Iterator[tuple[str, Any]]:
    """Yield names and records."""
    import sensitivity
    import truths

    for kind in KINDS:
        for spec in truths.battery(kind, seeds):
            case = truths.case(**spec)
            yield case.name, record_of(case)
    yield from sensitivity.records_of("").items() if real else ()


def told(name: str, record: Any, jitter: bool) -> dict[str, Any]:
    """Diagnose a record and return what is compared."""
    if jitter:
        rng = np.random.default_rng(1)
        signals = (x + LAST_DIGITS * np.std(x) * rng.standard_normal(x.size) for x in (record.u, record.y))
        record = replace(record, **dict(zip("uy", signals, strict=True)))
    found = diagnosed(record)
    return {
        "name": name, "verdict": found.verdict, "set": sorted(found.confusion_set),
        "steps": [s.added for s in found.steps],
        "order": [[f"{c.effect}@{c.where}" for c in s.candidates] for s in found.steps],
    }  # fmt: skip


def run(variant: tuple[str, int, bool], options: argparse.Namespace) -> list[dict[str, Any]] | None:
    """Judge all records in a process of its own; None where the kernel cannot run."""
    kernel, threads, jitter = variant
    command = [
        sys.executable,
        __file__,
        "--seeds",
        options.seeds,
        "--one",
        str(int(jitter)),
        *["--real"][: options.real],
    ]
    # Nothing in the package may decide on the number of threads: it limits them itself where that is faster.
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": str(threads)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode < 0 or done.returncode == 132:
        return None
    if done.returncode:
        raise SystemExit(done.stderr)
    return [json.loads(line) for line in done.stdout.splitlines()]


def compared(ours: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> str:
    """Return a row of counts of what differs, and print which records these are."""
    parts = ("verdict", "set", "steps", "order")
    for a, b in zip(ours, theirs, strict=True):
        differ = [part for part in parts if a[part] != b[part]]
        if differ:
            print(a["name"], *(f"{part}: {a[part]} / {b[part]}" for part in differ), sep="\n    ", flush=True)
    return " | ".join(str(sum(a[p] != b[p] for a, b in zip(ours, theirs, strict=True))) for p in parts)


def main() -> None:
    options = asked(__doc__, seeds="9880:9881", real=False, kernels=("Haswell", "SkylakeX", "Zen"), jobs=2, one=int)
    if options.one is not None:
        warnings.simplefilter("ignore")
        for name, record in records(seeds_of(options.seeds), options.real):
            print(json.dumps(told(name, record, bool(options.one))), flush=True)
        return
    first = options.kernels[0]
    variants = [(kernel, 1, False) for kernel in options.kernels] + [(first, 2, False), (first, 1, True)]
    with ThreadPoolExecutor(options.jobs) as pool:
        results = list(pool.map(lambda v: run(v, options), variants))
    ours = results[0]
    if ours is None:
        raise SystemExit(f"{first} cannot run on this processor")
    print(
        f"| {len(ours)} records, beside {first} on one thread | verdict | set | added | order |\n|---|---|---|---|---|"
    )
    for (kernel, threads, jitter), theirs in list(zip(variants, results, strict=True))[1:]:
        name = f"{kernel}, threads {threads}" + (f", {LAST_DIGITS:g} on the data" if jitter else "")
        print(f"| {name} | {compared(ours, theirs) if theirs is not None else 'cannot run on this processor'} |")


if __name__ == "__main__":
    main()
