"""A fleet at size: the same files with one process, with two, and on a Dask cluster that loses a worker and its client.

    python tests/bench/fleet.py [--records 500] [--base linear] [--seed 0] [--loops FOLDER]

Simulated machines, one record of 300 to 600 samples each; a dead zone or a play is hidden in every fourth. One process first: its
seconds per record are in the journal, its memory is read whenever a result comes. Then two processes. Then two Dask workers of
one thread: after a third of the records one of them gets kill -9, after two thirds the command itself; it is started again with
the same journal, and the worker that is left ends the work. All three must write the same CSV, Parquet and page, byte for byte.

--loops: a folder of records `stiction_TAG_...csv` and `none_TAG_...csv` with a setpoint, labelled by the plant's engineers; they
are diagnosed from a list, and what comes out is printed by loop.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import common
import numpy as np
from common import ROOT

from narx_sym.files.atomic import write_csv
from narx_sym.files.journal import alive

PAUSE = 0.05  # seconds between looks at the journal
TABLES = ("fleet.csv", "fleet.parquet", "fleet.html")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
FIRST_ORDER, NOISE, HIDDEN = 0.8, 0.005, 0.5  # a pole, rms of the noise, half the dead zone or play


def machine(i: int, seed: int) -> dict[str, Any]:
    """Return time, input and output of one machine, (N,) arrays; every fourth hides a dead zone or a play."""
    rng = np.random.default_rng([seed, i])
    n = int(rng.integers(300, 601))
    u, driven, y = np.zeros(n), np.zeros(n), np.zeros(n)
    for k, w in enumerate(rng.standard_normal(n - 1), 1):
        u[k] = 0.9 * u[k - 1] + 0.6 * w
        driven[k] = u[k]
        if i % 8 == 0:
            driven[k] = np.sign(u[k]) * max(abs(u[k]) - HIDDEN, 0)
        elif i % 8 == 4:
            driven[k] = max(u[k] - HIDDEN, min(u[k] + HIDDEN, driven[k - 1]))
        y[k] = FIRST_ORDER * y[k - 1] + 0.4 * driven[k - 1]
    return {"t": 0.01 * np.arange(n), "u": u, "y": y + NOISE * rng.standard_normal(n)}


def rows(journal: Path) -> list[dict[str, Any]]:
    """Return the rows of the records that are done, in the order in which they came."""
    found = []
    for line in journal.read_text().splitlines()[1:] if journal.exists() else []:
        try:
            value = alive(json.loads(line)["value"])
        except (ValueError, KeyError):
            continue  # half written
        if isinstance(value, dict) and "verdict" in value:
            found.append(value)
    return found


def started(source: str, folder: Path, name: str, *options: str) -> tuple[subprocess.Popen[bytes], Path]:
    """Start the command in `folder`; its files go to a folder of that name there."""
    (folder / name).mkdir(exist_ok=True)
    journal = folder / name / "journal"
    command = [sys.executable, "-m", "narx_sym", "fleet", source, "--out", f"{name}/fleet.html"]
    log = (folder / name / "log").open("ab")
    made = subprocess.Popen(
        [*command, "--resume", str(journal), *options], cwd=folder, env=ENVIRONMENT, stdout=log, stderr=log
    )
    return made, journal


def followed(running: subprocess.Popen[bytes], journal: Path, each: Callable[[int], bool] = lambda n: False) -> None:
    """Wait for the command; `each` is told how many records are done, and ends the watch with True."""
    seen = -1
    while running.poll() is None:
        if (now := len(rows(journal))) != seen:
            seen = now
            if each(now):
                return
        time.sleep(PAUSE)
    if running.returncode:
        raise SystemExit((journal.parent / "log").read_text())


def memory(process: int) -> float:
    """Return the resident memory of a process [MB]."""
    text = Path(f"/proc/{process}/status").read_text()
    return int(text.split("VmRSS:")[1].split()[0]) / 1024


def serial(folder: Path, *options: str) -> None:
    """Run with one process, and print seconds and memory of the first and the last fifth, at most 100 each."""
    running, journal = started("records", folder, "one", "--jobs", "1", *options)
    held: dict[int, float] = {}

    def look(done: int) -> bool:
        held[done] = memory(running.pid)
        return False

    followed(running, journal, look)
    done = rows(journal)
    few = min(100, max(len(done) // 5, 1))
    for word, part in (("first", slice(0, few)), ("last", slice(-few, None))):
        seconds, kept = [r["seconds"] for r in done[part]], [held[n] for n in sorted(held) if n][part]
        quiet = [r["seconds"] for r in done[part] if not r["missing"]] or seconds
        print(
            f"{word} {few}: {sum(seconds) / few:.2f} s per record, median {median(seconds):.2f} s "
            f"(nothing missing: {median(quiet):.2f} s), memory {median(kept):.0f} MB, at most {max(kept):.0f} MB"
        )
    right = sum(r["missing"] == expected(r["file"]) for r in done)
    print(f"{right} of {len(done)} rows name what is hidden, or nothing where nothing is", flush=True)


def expected(file: str) -> list[str]:
    """Return what is hidden in a record."""
    return {0: ["dead_zone"], 4: ["backlash"]}.get(int(Path(file).stem) % 8, [])


@contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Run a Dask scheduler and two workers of one thread, without nannies: who is killed stays away."""
    said = folder / "scheduler.json"
    usual = {
        "cwd": folder,
        "env": ENVIRONMENT,
        "stdout": subprocess.DEVNULL,
        "stderr": (folder / "workers.log").open("wb"),
    }
    options = ["--port", "0", "--scheduler-file", str(said), "--no-dashboard", "--host", "127.0.0.1"]
    begun = [subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", *options], **usual)]
    try:
        while not said.exists() or not said.read_text().strip():
            time.sleep(PAUSE)
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(said), "--no-nanny"]
        begun += [
            subprocess.Popen([*worker, "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)], **usual)
            for _ in "ab"
        ]
        yield json.loads(said.read_text())["address"], begun[1:]
    finally:
        for one in begun:
            one.kill()
            one.wait()


def on_dask(folder: Path, count: int, *options: str) -> None:
    """Run on two workers, kill one of them, then the command; go on from the journal."""
    with cluster(folder) as (address, workers):
        running, journal = started("records", folder, "dask", "--dask", address, *options)

        def kill(done: int) -> bool:
            if done >= count // 3 and workers[0].poll() is None:
                workers[0].send_signal(signal.SIGKILL)
                print(f"a worker is killed after {done} records", flush=True)
            return done >= 2 * count // 3

        followed(running, journal, kill)
        running.kill()
        running.wait()
        kept = len(rows(journal))
        print(f"the command is killed after {kept} records, and started again", flush=True)
        running, journal = started("records", folder, "dask", "--dask", address, *options)
        followed(running, journal)
        assert f"{kept} results were taken from" in (journal.parent / "log").read_text()


def loops(folder: Path, records: Path, *options: str) -> None:
    """Diagnose labelled loops from a list, and print what is said of each valve."""
    files = sorted(records.glob("*.csv"))
    tags = [f.stem.split("_")[1] for f in files]
    (folder / "loops.csv").write_text("file,tag\n" + "".join(f"{f},{t}\n" for f, t in zip(files, tags, strict=True)))
    running, journal = started("loops.csv", folder, "loops", "--jobs", "-1", "--channels", "setpoint", *options)
    followed(running, journal)
    print("| loop | engineers | records | sticking valve | closed loop, no sticking | other | not diagnosed |")
    print("|---|---|---|---|---|---|---|")
    done = rows(journal)
    for tag in dict.fromkeys(tags):
        of = [r for r in done if r["tag"] == tag]
        sticks = [r for r in of if r["missing"] == ["sticking valve"]]
        calm = [r for r in of if r["verdict"] == "closed_loop" and r not in sticks]
        failed = [r for r in of if r["problem"]]
        word = "stiction" if any(Path(r["file"]).name.startswith("stiction") for r in of) else "none"
        other = len(of) - len(sticks) - len(calm) - len(failed)
        print(f"| {tag} | {word} | {len(of)} | {len(sticks)} | {len(calm)} | {other} | {len(failed)} |")
    print(
        f"{sum(r['seconds'] for r in done) / len(done):.2f} s per record", *{r["problem"] for r in done if r["problem"]}
    )


def main() -> None:
    asked = common.asked(__doc__, records=500, base="linear", seed=0, loops=Path, runs="one,two,dask")
    with tempfile.TemporaryDirectory() as name:
        folder, options = Path(name), ("--base", asked.base, "--max-effects", "1")
        if asked.loops:
            return loops(folder, asked.loops.resolve(), *options)
        for i in range(asked.records):
            place = folder / "records" / f"machine_{i % 10}"
            place.mkdir(parents=True, exist_ok=True)
            write_csv(place / f"{i:04d}.csv", machine(i, asked.seed))
        runs = {
            "one": lambda: serial(folder, *options),
            "two": lambda: followed(*started("records", folder, "two", "--jobs", "2", *options)),
            "dask": lambda: on_dask(folder, asked.records, *options),
        }
        ways = asked.runs.split(",")
        for run in ways:
            begin = time.monotonic()
            runs[run]()
            print(f"{run}: {time.monotonic() - begin:.0f} s for {asked.records} records", flush=True)
            for table in TABLES:
                same = (folder / run / table).read_bytes() == (folder / ways[0] / table).read_bytes()
                assert same, f"{table} of {run} differs"
        print("the same bytes: " + ", ".join(TABLES))


if __name__ == "__main__":
    main()
