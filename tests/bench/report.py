"""How long the report takes beyond the diagnosis, and how large it is: python tests/bench/report.py [samples]."""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import narx_sym as ns
from narx_sym import plants


def main(n: int) -> None:
    u = plants.filtered_noise(N=n, Ts=0.01, cutoff=2.0, peak=5.0, seed=1)
    v = np.sign(u) * np.maximum(np.abs(u) - 0.3, 0.0)  # a dead zone
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = 1.6 * y[k - 1] - 0.68 * y[k - 2] + 0.08 * v[k - 1]
    record = ns.Record.from_arrays(u, y + 0.01 * np.random.default_rng(0).standard_normal(n), Ts=0.01)
    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "1"])
    found = ns.diagnose(base.fit(record), record)
    print(f"{n} samples, {found.verdict}: diagnosis {found.seconds:.1f} s")
    for what in ("first", "second"):
        wall, own = time.perf_counter(), time.process_time()
        path = Path(tempfile.mkdtemp()) / "report.html"
        found.report(path, {"u": "V", "y": "mm"})
        wall, own = time.perf_counter() - wall, time.process_time() - own
        print(f"{what} report: {wall:.2f} s ({own:.2f} s of one core), {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50_000)
