"""kill -9 at random moments: nothing is lost or half written, and every resumed sweep equals the uninterrupted one.

    python tests/bench/kill.py [--kills 50] [--seed 0]

Half of the kills hit a process that saves two models in turn to the same file, with a picture and a CSV beside; after each kill
every file must be whole: the old one or the new one. The other half hit a sweep, or a diagnosis of several steps, that keeps its
results in a journal; after the kill the work is started again with the same journal, and its result must have the same bytes
as the uninterrupted one. A kill that came after the end is drawn again.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import ROOT, asked

SAVE = """
import sys
import numpy as np
import narx_sym as ns
from matplotlib.figure import Figure
from narx_sym.files.atomic import write_csv, write_figure
models = [ns.NARX.from_terms(["y[k-1]", *(f"u[k-{i}]" for i in range(1, n))], list(np.linspace(0.1, 0.9, n))) for n in (3, 300)]
columns = {"t": np.arange(3000) * 0.01, "u": np.sin(np.arange(3000))}
figure = Figure(figsize=(2, 2))
print("ready", flush=True)
for i in range(100_000):
    ns.save(models[i % 2], "m.json")
    write_csv("a.csv", {n: a[: 3000 if i % 2 else 30] for n, a in columns.items()})
    if i % 5 == 0:
        write_figure(figure, "a.png")
"""

SWEEP = """
import sys
sys.path.insert(0, {root!r} + "/tests/bench")
import json
import narx_sym as ns
from kill import one, whole
from narx_sym.files.parallel import sweep
print("ready", flush=True)
with ns.resuming("journal"):
    found = sweep(one, [(seed, 400) for seed in range({count})])
open("result", "w").write(whole(found))
"""

DIAGNOSIS = """
import sys
sys.path.insert(0, {root!r} + "/tests/bench")
import narx_sym as ns
from kill import two_effects, whole
base, record = two_effects()
print("ready", flush=True)
with ns.resuming("journal"):
    found = ns.diagnose(base, record, max_effects=2, catalogue=ns.EFFECTS.without("hysteresis")).to_dict()
found.pop("seconds")
open("result", "w").write(whole(found))
"""


def one(seed: int, n: int) -> list[object]:
    """Fit a model to one noise realisation: what a sweep does."""
    import numpy as np

    import narx_sym as ns

    u = ns.plants.filtered_noise(N=n, Ts=0.01, cutoff=2.0, peak=3.0, seed=seed)
    y = ns.plants.bouc_wen(u, Ts=0.01) + 0.01 * np.random.default_rng(seed).standard_normal(n)
    model = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi1[k-1]*u[k-1]"])
    model = model.fit(ns.Record.from_arrays(u, y, Ts=0.01), ["continuum"])
    return [model.theta, float(np.sum(model.theta)), (seed, None, "fitted")]


def two_effects():  # type: ignore[no-untyped-def]
    """Return a base and a record of a first-order lag behind a gear with play, with a cubic sensor."""
    import numpy as np
    from scipy.signal import lfilter

    import narx_sym as ns

    n = 1500
    u = ns.plants.filtered_noise(N=n, Ts=0.01, cutoff=2.0, peak=5.0, seed=1)
    p, played = u[0], []
    for a in u:
        p = max(a - 0.3, min(a + 0.3, p))
        played.append(p)
    x = lfilter([0.0, 0.3], [1.0, -0.7], np.array(played))
    y = x + 0.01 * x**3 + 0.02 * np.random.default_rng(0).standard_normal(n)
    return ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.7, 0.3], Ts=0.01), ns.Record.from_arrays(u, y, Ts=0.01)


def whole(found: object) -> str:
    """Return all bits of a result as text."""
    from narx_sym.files.journal import plain

    return json.dumps(plain(found), sort_keys=True)


def start(program: str, folder: Path) -> subprocess.Popen[str]:
    """Start a program and wait until it works."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    job = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if (job.stdout.readline() if job.stdout else "").strip() != "ready":
        raise RuntimeError(job.communicate()[1])
    return job


def run(program: str, folder: Path) -> tuple[str, float]:
    """Run a program to its end; return its result and the seconds that it worked."""
    job, begin = start(program, folder), time.perf_counter()
    error = job.communicate()[1]
    if job.returncode:
        raise RuntimeError(error)
    return (folder / "result").read_text(), time.perf_counter() - begin


def kill(program: str, folder: Path, seconds: float, lines: int = 0) -> bool:
    """Start a program, kill it some seconds after its journal has so many lines; return whether it was still at work."""
    job = start(program, folder)
    while lines and job.poll() is None and kept(folder) < lines:
        time.sleep(0.001)
    time.sleep(seconds)
    alive = job.poll() is None
    if alive:
        os.kill(job.pid, signal.SIGKILL)
    job.communicate()
    return alive


def kept(folder: Path) -> int:
    """Return how many results a journal has."""
    path = folder / "journal"
    return path.read_bytes().count(b"\n") - 1 if path.exists() else 0


def damage(folder: Path) -> list[str]:
    """Return what is wrong with the files of `SAVE`."""
    import narx_sym as ns

    wrong = []
    try:
        if len(ns.load(folder / "m.json").terms) not in (3, 300):
            wrong.append("m.json: another model")
    except ns.NarxError as error:
        wrong.append(str(error))
    text = (folder / "a.csv").read_text()
    if text.count("\n") not in (31, 3001) or not text.endswith("\n"):
        wrong.append(f"a.csv: {text.count(chr(10))} lines")
    raw = (folder / "a.png").read_bytes()
    if not (raw.startswith(b"\x89PNG") and raw[-8:-4] == b"IEND"):
        wrong.append("a.png: cut off")
    return wrong


def saves(kills: int, pick: random.Random) -> list[str]:
    """Kill a process that saves; return what was lost."""
    faults = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kill(SAVE, folder, 1.5)  # the first files
        for i in range(kills):
            kill(SAVE, folder, pick.uniform(0.0, 0.6))
            faults += [f"save, kill {i + 1}: {f}" for f in damage(folder)]
            parts = [p.name for p in folder.iterdir() if p.name not in ("m.json", "a.csv", "a.png")]
            faults += [
                f"save, kill {i + 1}: {p} is left" for p in parts if not (p.startswith(".") and p.endswith(".part"))
            ]
    return faults


def resumes(program: str, kills: int, pick: random.Random, what: str) -> list[str]:
    """Kill long work with a journal, one to three times in a row, and resume it; return what differs."""
    faults, done = [], 0
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "0").mkdir()
        expected, seconds = run(program, Path(name) / "0")
        number, total = 0, kept(Path(name) / "0")
        while done < kills:
            number += 1
            folder = Path(name) / str(number)
            folder.mkdir()
            for _ in range(min(pick.randint(1, 3), kills - done)):
                moment = pick.uniform(0.0, 0.9 * seconds / total)
                done += kill(program, folder, moment, pick.randint(0, total - 1))
            found = run(program, folder)[0]
            if found != expected:
                faults.append(f"{what}, run {number}: the resumed result differs")
        replay = run(program, Path(name) / "0")[1]
        print(
            f"{what}: {done} kills in {number} runs of {seconds:.1f} s; {total} results kept; a finished one again: {replay:.1f} s"
        )
    return faults


def main() -> int:
    """Kill, look, and count."""
    options = asked(__doc__, kills=50, seed=0)
    pick = random.Random(options.seed)
    saved, swept = options.kills // 2, options.kills // 3
    faults = saves(saved, pick)
    print(f"save: {saved} kills")
    faults += resumes(SWEEP.format(root=str(ROOT), count=150), swept, pick, "sweep")
    faults += resumes(DIAGNOSIS.format(root=str(ROOT)), options.kills - saved - swept, pick, "diagnosis")
    print("\n".join(faults))
    print(f"{options.kills} kills: {len(faults)} files lost or half written, or results that differ")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
