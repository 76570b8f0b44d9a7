"""Everything that is written, from fixed data: run in fresh processes whose files are compared byte by byte.

python tests/same.py FOLDER JOBS
"""

import json
import sys
import warnings
from pathlib import Path

import joblib
import numpy as np

import narx_sym as ns
from narx_sym.fit.bootstrap import block_bootstrap
from narx_sym.inversion.analyses import document
from narx_sym.tasks.result_file import write_json

N, TS = 900, 0.01
EFFECTS = ("dead_zone", "backlash", "saturation")  # an empty tuple: the whole catalogue


def sources():
    """Inputs by integer arithmetic, so that no library decides their digits."""
    state, values = 12345, []
    for _ in range(2 * N):
        state = (1103515245 * state + 12345) % 2**31
        values.append(state / 2**30 - 1.0)
    return np.array(values[:N]), np.array(values[N:])


def write_all(folder, jobs):
    steps, noise = sources()
    u = np.zeros(N)
    for k in range(1, N):
        u[k] = 0.97 * u[k - 1] + steps[k]
    y, v = np.zeros(N), np.sign(u) * np.maximum(np.abs(u) - 0.8, 0.0)  # a dead zone is hidden
    for k in range(2, N):
        y[k] = 1.3 * y[k - 1] - 0.4 * y[k - 2] + 0.08 * v[k - 1]
    linear = ns.Record.from_arrays(u, y + 0.01 * noise, Ts=TS)
    truth = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"], [1.0, 0.8, -0.02])
    loop = ns.Record.from_arrays(u, truth.simulate(u, 0.0) + 0.05 * noise, Ts=TS)

    with joblib.parallel_config("loky", n_jobs=jobs):
        model = ns.identify(loop, for_compensation=True, degree=2, max_terms=6)
        model = model.fit(loop, ["continuum"], "free_run", starts=4, seed=3)
        base = ns.identify(linear, base="linear", n_y=2, n_u=1, delay=1)
        spread = block_bootstrap(base, linear, draws=8, seed=5)
    law = model.compensator()
    ns.save(model, folder / "model.json")
    (folder / "law.tex").write_text(law.latex(numbers=True), encoding="utf-8")
    (folder / "model.tex").write_text(document(model), encoding="utf-8")
    (folder / "law.c").write_text(law.export("c"), encoding="utf-8")
    (folder / "law.st").write_text(law.export("st"), encoding="utf-8")
    (folder / "law.js").write_text(law.export("js"), encoding="utf-8")
    (folder / "bootstrap.json").write_text(json.dumps(np.asarray(spread.thetas).tolist()), encoding="utf-8")

    some = ns.effects.Catalogue({n: ns.EFFECTS[n] for n in EFFECTS} if EFFECTS else dict(ns.EFFECTS))
    found = ns.diagnose(base, linear, max_effects=1, seed=2, catalogue=some)
    write_json(found, folder / "found.json", None)
    lines = (folder / "found.json").read_text(encoding="utf-8").splitlines()
    (folder / "found.json").write_text("\n".join(line for line in lines if '"seconds"' not in line), encoding="utf-8")
    ns.save(found.model, folder / "completed.json")
    (folder / "completed.tex").write_text(ns.latex(found.model), encoding="utf-8")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    write_all(Path(sys.argv[1]), int(sys.argv[2]))
