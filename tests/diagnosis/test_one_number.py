"""One number: what a diagnosis shows is what a user gets who repeats it, by every way."""

import numpy as np
import one_number
import pytest
import truths
from places import SHARED, needs_shared
from sampling import more, only

import narx_sym as ns
from narx_sym.files.atomic import write_csv


def checked(record, file, base="linear", rows=None, catalogue=ns.EFFECTS):
    """Diagnose a record, and return what is wrong with the numbers."""
    linear = ns.identify(record, base=base)
    found = ns.diagnose(linear, record, catalogue=catalogue)
    for part, data in (("estimation", record), ("validation", list(found.steps[0].trial.validation))):
        for name, model in (("baseline", found.base), ("completed", found.model)):
            if name in found.errors:
                assert ns.evaluate(model, data).free_run_nrmse == found.errors[name][part]
    return one_number.faults(found, one_number.ways(found, linear, record, file, rows))


def simulated(kind, seed, folder, **options):
    """A record of a machine that is integrated elsewhere, and its file."""
    case = truths.case("in", kind, seed, N=600, **options)
    file = folder / "record.csv"
    write_csv(file, {"t": np.arange(case.u.size) * case.Ts, "u": case.u, "y": case.y, **case.channels})
    return ns.read(file, channels="all"), file


def test_a_simulated_machine_gives_one_number(tmp_path):
    assert not checked(*simulated("asymmetric_gain", 7001, tmp_path), catalogue=only("asymmetric_gain", "drift"))


@more
@pytest.mark.parametrize("seed", (7001, 7002, 7003, 7004))
@pytest.mark.parametrize("kind", sorted(truths.IN))
def test_every_simulated_machine_gives_one_number(kind, seed, tmp_path):
    assert not checked(*simulated(kind, seed, tmp_path))


@needs_shared
@pytest.mark.long
@pytest.mark.parametrize("name, rows, base, _", one_number.MEASURED)
def test_every_measured_record_gives_one_number(name, rows, base, _):
    file = SHARED / f"{name}.csv"
    assert not checked(ns.read(file, rows=rows), file, base, rows)
