"""A model against measurements: errors in pairs, what is new to it, where it fails, and how a reference is tracked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ..data.evidence.noise import period_noise
from ..data.evidence.several import moving
from ..data.metrics import mape, nsavi
from ..data.record import Record
from ..data.units import in_units
from ..diagnosis.misfit import Misfit, misfit_of
from ..errors import DataError, NarxError
from ..fit.evaluate import PROTOCOL, Errors, evaluate, free_run, started
from ..fit.simulate import arrays, extrapolates
from ..models.model import Model
from ..symbolic.signals import channel_name, u
from .result_file import write_plain

OFFSET = 0.5  # share of the mean square that a constant offset must explain to be spoken of


@dataclass(frozen=True, eq=False)
class Compared:
    """What a comparison found.

    Attributes
    ----------
    errors : list of (name of the record, Errors)
        By the protocol of `evaluate`.
    misfit : Misfit or None
        Where the model fails along the longest segment; None where that cannot be said.
    notes : list of str
        Where records leave what the model has seen, why there is no misfit, and where a constant offset explains most
        of the error.
    """

    errors: list[tuple[str, Errors]]
    misfit: Misfit | None
    notes: list[str]


def compare(model: Model, records: Sequence[Record], align: bool = False) -> Compared:
    """Compare a model, as it is, with measurements.

    Parameters
    ----------
    align : bool
        Whether a constant offset of the sensor is estimated on each contiguous record.
    """
    records = in_units(list(records), model.info.units)
    moved = moving(records, model.output.name)
    errors = errors_of(model, records, align)
    notes = [
        f"{record.name}: {said}"
        for record in records
        for said in extrapolates(model, [arrays(model, s)[model.input.name] for s in record.segments()], record.Ts)
    ]
    for (name, found), record in zip(errors, moved, strict=True):
        without = found if align else evaluate(model, record, align=True)
        if without.free_run_rms**2 < (1 - OFFSET) * found.free_run_rms**2:
            notes.append(
                f"{name}: without a constant offset of the sensor the free-run NRMSE is {without.free_run_nrmse:.3g}; "
                "--align estimates the offset"
            )
        if align:
            offsets = [f"{started(model, part, True).offset:.3g}" for part in record.segments()]
            notes.append(f"{name}: estimated offset of the sensor {', '.join(offsets)}")
        if found.own_load_nrmse is not None:
            notes.append(
                f"{name}: the model is an integrator, so a constant load is estimated on the record, like a start "
                f"state; with the load of the model the free-run NRMSE is {found.own_load_nrmse:.4g}"
            )
    misfit, why_not = where_it_fails(model, moved)
    return Compared(errors, misfit, [*notes, *filter(None, [why_not])])


def errors_of(model: Model, records: Sequence[Record], align: bool = False) -> list[tuple[str, Errors]]:
    """Return name and errors of each record that moves."""
    return [(r.name, evaluate(model, r, align)) for r in moving(records, model.output.name)]


def validated(model: Model, records: Sequence[Record], align: bool = False) -> list[tuple[str, Errors]]:
    """Return name and errors of validation records."""
    return [(f"{name} (validation)", e) for name, e in errors_of(model, records, align)] if records else []


def where_it_fails(model: Model, records: Sequence[Record]) -> tuple[Misfit | None, str]:
    """Return where a model fails along the longest segment; None, and the reason, where that cannot be said."""
    if model.input != u:
        return None, "for inverse models it is not shown where the model fails"
    record = max((s for r in records for s in r.segments()), key=len)
    try:
        error = record.y - free_run(model, record)
        noise = [x for part in period_noise([record]) for x in part.tolist()]
        floor = math.sqrt(math.fsum(x * x for x in noise) / len(noise)) if noise else None
        return misfit_of(model, record, error, floor), ""
    except NarxError as error:
        return None, f"it cannot be shown where the model fails: {error}"


def write_errors(found: Compared, path: Path) -> None:
    """Write the errors as JSON; null stands for those of a run that diverges."""
    rows = [{"record": name, **asdict(e), "free_run_fit": e.fit} for name, e in found.errors]
    write_plain({"schema": 1, "protocol": PROTOCOL, "errors": rows}, path)


@dataclass(frozen=True)
class Tracking:
    """How well a compensated run followed its reference: MAPE [% of range] and NSAVI (the effort)."""

    name: str
    mape: float
    nsavi: float


def tracking(record: Record, reference: str) -> Tracking:
    """Judge a log of a compensated run; `reference` names its channel with the wanted output.

    Raises
    ------
    DataError
        Where there is no such channel, or it is in another unit than the output.
    """
    name = reference if reference in record.channels else channel_name(reference)
    if name not in record.channels:
        listed = ", ".join(record.channels) or "none"
        raise DataError(
            f"record '{record.name}': there is no channel {reference!r} for the reference; there is {listed}"
        )
    of_r, of_y = record.units.get(name, ""), record.units.get("y", "")
    if of_r and of_y and of_r != of_y:
        raise DataError(
            f"record '{record.name}': the reference is in {of_r}, the output in {of_y}: convert one of them"
        )
    wanted = record.channels[name]
    return Tracking(record.name, mape(wanted, record.y), nsavi(record.u, wanted))
