"""The portrait: does the variable of the true effect explain most of what the linear base lacks?

    python tests/bench/portraits.py [--seeds 100:101] [--part measured,in,off,null]

Every case is identified as a linear base, without a diagnosis, and its missing input is looked at. "first": the variable of
the true effect stands first. "motion": another variable of the same motion does (what sticks or slips on a spring changes
with the way since a reversal and with the sign of the speed). "silent": no view leaves the band of chance.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import truths
from places import SHARED

import narx_sym as ns
from narx_sym.data.evidence.rate import working
from narx_sym.diagnosis.misfit import Portrait, portrait_of
from narx_sym.fit.evaluate import free_run

TURNED = {"distance_since_reversal:u", "distance_since_reversal:y", "u|u"}
SPEED = {"velocity", "rate"}
ALIKE: list[tuple[str, set[str]]] = [  # kinds of `truths.py`, and the variables that are right
    ("backlash hysteresis elastic_backlash maxwell_slip jiles_atherton", TURNED),
    ("coulomb_friction stribeck_friction lugre_friction tanh_friction quadratic_drag", {"velocity"}),
    ("hardening_spring quadratic_spring sinh_spring", {"y"}), ("bilinear_gain", {"u|y", "u", "y"}),
    ("dead_zone saturation asymmetric_gain quadratic_gain cubic_gain", {"u"}),
    ("atan_saturation soft_dead_zone exponential_gain", {"u"}), ("drift sqrt_drift", {"time"}),
    ("ageing warming_gain", {"u|time"}), ("periodic_disturbance two_harmonics", {"period"}),
    ("saturating_load", {"channel:load"}), ("channel:temperature", {"channel:temperature"}),
    ("channel_gain:temperature", {"u|channel:temperature"}), ("creep log_creep", {"past of u"}),  # no view has it
]  # fmt: skip
TRUE = {kind: right for kinds, right in ALIKE for kind in kinds.split()}
MEASURED = {
    "emps/train.csv": {"velocity"}, "boucwen/train_multisine.csv": TURNED | SPEED | {"y"},
    "cascaded_tanks/train.csv": {"y"}, "friction_damper_brfd/d1_0.5Hz_35lb.csv": TURNED | {"rate"},
    "friction_damper_brfd/d1_1Hz_70lb.csv": TURNED | {"rate"}, "hydraulic_motor_rotation/run.csv": {"u"} | TURNED,
    "mr_damper_utfsm/10mm1Hz_0A.csv": TURNED | {"rate"}, "mr_damper_utfsm/10mm1Hz_0x5A.csv": TURNED | {"rate"},
    "mr_damper_utfsm/25mm0x25Hz_0x75A.csv": TURNED | {"rate"}, "piezo_dbo/train_1Hz_full_range.csv": TURNED,
    "pneumatic_seal_friction/Oring_1bar.csv": {"rate"}, "pneumatic_seal_friction/Oring_3bar.csv": {"rate"},
}  # fmt: skip


def looked_at(record: ns.Record) -> Portrait:
    """Return the portrait of what a linear base of a record lacks."""
    record = max(record.segments(), key=len)
    base = ns.identify(record, base="linear")
    return portrait_of(base, record, record.y - free_run(base, record), working([record])[1])


def cases(part: str, seeds: range) -> Iterator[tuple[str, ns.Record, set[str]]]:
    """Name every case of a part, with the variables that are right; none for a null."""
    if part == "measured":
        for file, right in MEASURED.items():
            yield file, ns.read(SHARED / file), right
        return
    for spec in truths.battery(part, seeds):
        case = truths.case(**spec)
        record = ns.Record.from_arrays(case.u, case.y, case.Ts, channels=case.channels, name=case.name)
        yield case.name, record, TRUE.get(spec["kind"], set())


def judged(portrait: Portrait, right: set[str]) -> str:
    """Say how the first view compares with the truth."""
    if not portrait.seen():
        return "silent"
    name = portrait.view.name
    motion = bool(right & (TURNED | SPEED)) and name in TURNED | SPEED
    return "first" if name in right else "motion" if motion else "other"


def main() -> None:
    """Print one line for each case, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="100:101")
    parser.add_argument("--part", default="measured,in,off,null")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    for part in given.part.split(","):
        counts: Counter[str] = Counter()
        for name, record, right in cases(part, range(*map(int, given.seeds.split(":")))):
            found = looked_at(record)
            said = judged(found, right)
            counts[said] += 1
            views = ", ".join(f"{p.name} {p.share:.2f}" for p in found.views[:3])
            print(f"{name:45}{said:8}{found.bandwidth:9.3g} Hz  {views}", flush=True)
        print(f"{part}: {', '.join(f'{n} {said}' for said, n in counts.most_common())} of {sum(counts.values())}\n")


if __name__ == "__main__":
    main()
