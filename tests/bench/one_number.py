"""One number by every way: what a diagnosis shows, and what a user gets who repeats it.

python tests/bench/one_number.py [--only PART_OF_A_NAME]    the table of the book over the measured records
"""

import json
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from common import asked
from places import SHARED
from printed import printed
from typer.testing import CliRunner

import narx_sym as ns
from narx_sym.cli import main as cli

# Record, its rows, base, and records of another day.
MEASURED = (
    ("emps/train", None, "linear", ("emps/test_pulses",)),
    ("piezo_dbo/train_1Hz_full_range", None, "linear", ("piezo_dbo/test_varying_amplitude",)),
    ("piezo_dbo/train_1Hz_full_range", "20:", "linear", ("piezo_dbo/test_varying_amplitude",)),
    ("cascaded_tanks/train", None, "linear", ("cascaded_tanks/test",)),
    ("friction_damper_brfd/d1_0.5Hz_35lb", None, "linear", ()),
    ("friction_damper_brfd/d1_1Hz_70lb", None, "linear", ()),
    ("friction_damper_brfd/d1_0.5Hz_35lb", None, "static", ()),
    ("mr_damper_utfsm/10mm1Hz_0A", None, "linear", ("mr_damper_utfsm/5mm3Hz_0A", "mr_damper_utfsm/25mm0x25Hz_0A")),
    ("mr_damper_utfsm/10mm1Hz_0x5A", None, "linear", ()),
    ("mr_damper_utfsm/25mm0x25Hz_0x75A", None, "linear", ()),
    ("pneumatic_seal_friction/Oring_1bar", None, "static", ()),
    ("pneumatic_seal_friction/Oring_3bar", None, "static", ()),
    ("pneumatic_seal_friction/Oring_1bar", None, "linear", ()),
    ("hydraulic_motor_rotation/run", None, "linear", ()),
    ("boucwen/train_multisine", None, "linear", ("boucwen/test_multisine",)),
)
WAYS = ("shown", "evaluate", "saved, compare", "printed", "added and fitted")


def compared(model, file, rows=None):
    """The free-run NRMSE that `narx-sym compare` writes."""
    with tempfile.TemporaryDirectory() as folder:
        saved, out = Path(folder) / "model.json", Path(folder) / "errors.json"
        ns.save(model, saved)
        call = ["compare", str(saved), str(file), "--no-plot", "--json", str(out)]
        call += ["--rows", rows] if rows else []
        call += ["--channels", ",".join(model.channels)] if model.channels else []
        done = CliRunner().invoke(cli.app, call)
        assert done.exit_code == 0, done.output
        return json.loads(out.read_text())["errors"][0]["free_run_nrmse"]


def ways(found, linear, record, file, rows=None):
    """The error of what was found on its record, by each way; NaN where there is nothing to add."""
    model = found.model
    shown = found.errors.get("completed", found.errors["baseline"])["estimation"]
    added = np.nan
    if "completed" in found.errors:
        added = ns.evaluate(linear.add(found.best).fit(record), record).free_run_nrmse
    errors, paper = ns.evaluate(model, record), ns.evaluate(printed(model), record).free_run_nrmse
    if errors.own_load_nrmse is not None:  # on paper no constraint says that the constant is a load
        paper *= errors.free_run_nrmse / errors.own_load_nrmse
    return dict(zip(WAYS, (shown, errors.free_run_nrmse, compared(model, file, rows), paper, added), strict=True))


def faults(found, numbers):
    """What is wrong with the numbers of a diagnosis: nothing, where all ways give one number."""
    wrong = [f"{w}: {numbers[w]:.9g}" for w in WAYS[1:3] if not np.isclose(numbers[w], numbers["shown"], rtol=1e-9)]
    if abs(numbers["printed"] - numbers["shown"]) > 0.0101 * numbers["shown"]:
        wrong.append(f"printed: {numbers['printed']:.9g}")
    if numbers["added and fitted"] > numbers["shown"] * (1 + 1e-9):
        wrong.append(f"added and fitted: {numbers['added and fitted']:.9g}")
    before, after = found.errors["baseline"], found.errors.get("completed", found.errors["baseline"])
    wrong += [f"{part} rises" for part in before if after[part] > before[part] * np.exp(0.05)]
    return wrong


def row(name, rows, base, tests):
    file = SHARED / f"{name}.csv"
    record = ns.read(file, rows=rows)
    linear = ns.identify(record, base=base)
    begin = time.perf_counter()
    found = ns.diagnose(linear, record)
    seconds = time.perf_counter() - begin
    numbers = ways(found, linear, record, file, rows)
    others = []
    for test in tests:
        other = ns.read(SHARED / f"{test}.csv")
        pair = [ns.evaluate(m, other) for m in (found.base, found.model)]
        assert np.isclose(compared(found.model, SHARED / f"{test}.csv"), pair[1].free_run_nrmse, rtol=1e-9)
        others.append(f"{pair[0].free_run_nrmse:.3g} -> {pair[1].free_run_nrmse:.3g} ({pair[1].free_run_rms:.3g})")
    base_now = found.errors["baseline"]
    what = ", ".join(found.rungs[1:]) or found.steps[0].finding
    return [
        f"{name}{f' {rows}' if rows else ''}, {base}", what, f"{base_now['estimation']:.4g}",
        *(f"{v:.6g}" for v in numbers.values()),
        " -> ".join(f"{found.errors.get(k, base_now)['validation']:.3g}" for k in ("baseline", "completed")),
        "; ".join(others), "; ".join(faults(found, numbers)) or "one number", f"{seconds:.0f}",
    ]  # fmt: skip


def main():
    only = asked(__doc__, only="").only
    warnings.simplefilter("ignore")
    print("| record | added | base |", " | ".join(WAYS), "| last part | another day (rms) | ways | s |")
    print("|" + "---|" * (len(WAYS) + 7))
    for one in MEASURED:
        if only in one[0]:
            try:
                print("|", " | ".join(row(*one)), "|", flush=True)
            except Exception as error:  # the table goes on
                print("|", one[0], "|", f"{type(error).__name__}: {error}", "|", flush=True)


if __name__ == "__main__":
    main()
