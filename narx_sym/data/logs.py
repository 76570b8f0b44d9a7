"""Logs of measuring systems to raw columns: MDF (.mf4), TDMS, MATLAB 7.3; channels of several rates come to one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..symbolic.signals import channel_name
from .tables import Table, check_bytes, readable

MATLAB_NUMBERS = {"double", "single", "logical", *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64))}


@dataclass(frozen=True)
class Channel:
    """One channel of a log: `read` returns its values and its time stamps in s, None where it has none."""

    name: str
    group: str
    unit: str
    size: int
    read: Callable[[], tuple[Any, Any]]


def library(path: str, package: str, why: str, more: str = "") -> Any:
    """Return a package that reads a kind of log; DataError where it is not installed."""
    try:
        return import_module(package)
    except ImportError:
        raise DataError(
            f'{path}: {why}; install it (pip install "narx-sym[logs]") or export the channels as CSV{more}'
        ) from None


def load_mdf(name: str, wanted: Collection[str] | None) -> Table:
    """Channels of an MDF file, with the stamps of their groups."""
    asammdf = library(name, "asammdf", "reading MDF needs asammdf")
    with open(name, "rb") as raw:
        if not raw.read(8).startswith((b"MDF ", b"UnFinMF")):
            raise DataError(f"{name}: is no MDF file; check its ending")

    def read(file: Any, group: int, index: int) -> tuple[Any, Any]:
        signal = file.get(group=group, index=index)
        return signal.samples, signal.timestamps

    with readable(name, "MDF"), asammdf.MDF(name) as file:
        found = [
            Channel(one.name, f"group {g}", one.unit or "", group.channel_group.cycles_nr, partial(read, file, g, i))
            for g, group in enumerate(file.groups)
            for i, one in enumerate(group.channels)
            if i != file.masters_db.get(g)
        ]
        return _table(name, found, wanted)


def load_tdms(name: str, wanted: Collection[str] | None) -> Table:
    """Channels of a TDMS file; the time of a channel is that of its waveform."""
    nptdms = library(name, "nptdms", "reading TDMS needs npTDMS")

    def read(channel: Any) -> tuple[Any, Any]:
        stamps = None
        with suppress(KeyError):  # no waveform
            stamps = channel.time_track()
        return channel[:], stamps

    with readable(name, "TDMS"), nptdms.TdmsFile.open(name) as file:
        found = [
            Channel(one.name, group.name, str(one.properties.get("unit_string", "")), len(one), partial(read, one))
            for group in file.groups()
            for one in group.channels()
        ]
        return _table(name, found, wanted)


def load_mat73(name: str, wanted: Collection[str] | None) -> Table:
    """Vectors of a MATLAB file of version 7.3, which is HDF5."""
    h5py = library(name, "h5py", "is a MATLAB v7.3 file, which needs h5py", ", or save it with save(..., '-v7')")

    def kind(one: Any) -> str:
        said = one.attrs.get("MATLAB_class", b"")
        return said.decode("ascii", "replace") if isinstance(said, bytes) else str(said)

    def is_vector(one: Any) -> bool:
        numbers = isinstance(one, h5py.Dataset) and kind(one) in MATLAB_NUMBERS
        return numbers and one.size == max(one.shape, default=0) > 1

    def read(one: Any) -> tuple[Any, Any]:
        return one[()].ravel(), None

    with readable(name, "a MATLAB v7.3 file", "save it with save(..., '-v7')"), h5py.File(name, "r") as file:
        variables = {n: one for n, one in file.items() if not n.startswith("#")}
        vectors = {n: one for n, one in variables.items() if is_vector(one)}
        others = [f"{n} ({kind(one) or 'unknown'})" for n, one in variables.items() if n not in vectors]
        found = [Channel(n, "", "", v.size, partial(read, v)) for n, v in vectors.items()]
        return _table(name, found, wanted, others)


def _table(path: str, found: Sequence[Channel], wanted: Collection[str] | None, others: Sequence[str] = ()) -> Table:
    """Return the wanted channels, all where nobody says which, on the stamps of the fastest; what was done is noted."""
    times = Counter(c.name for c in found)
    named = [replace(c, name=f"{c.group}/{c.name}") if times[c.name] > 1 else c for c in found]
    chosen = [c for c in named if wanted is None or c.name in wanted or channel_name(c.name) in wanted]
    check_bytes(path, 8 * sum(c.size for c in chosen), "choose fewer channels")
    left, values, stamps = list(others), {}, {}
    for c in chosen:
        raw, times_of = c.read()
        raw = np.asarray(raw)
        if raw.ndim != 1 or raw.dtype.kind not in "fiub":
            left.append(c.name)
            continue
        values[c.name] = raw
        if times_of is not None and raw.size > 1:
            stamps[c.name] = np.asarray(times_of, dtype=np.float64)
    notes = ["not a vector of real numbers, left out: " + ", ".join(left)] if left else []
    units = {c.name: c.unit.strip() for c in chosen if c.unit.strip() and c.name in values}
    notes += ["units in the file: " + ", ".join(f"{n} [{label}]" for n, label in units.items())] if units else []
    unread = tuple(c.name for c in named if c not in chosen)
    if not values and not unread:
        raise DataError(f"{path}: holds no vector of real numbers; " + "; ".join(notes or ["it is empty"]))
    return Table(path, _at_one_rate(path, values, stamps, notes), notes=notes, unread=unread, units=units)


def _at_one_rate(
    path: str, values: dict[str, NDArray[Any]], stamps: dict[str, NDArray[Any]], notes: list[str]
) -> dict[str, NDArray[Any]]:
    """Interpolate the channels to the stamps of the fastest, within the time that all have."""
    if not stamps:
        return values
    steps = {}
    for name, t in stamps.items():
        if not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0):
            raise DataError(f"{path}: the time stamps of '{name}' do not increase")
        steps[name] = float(np.median(np.diff(t)))
    fastest = min(steps, key=lambda n: steps[n])
    first, last = max(t[0] for t in stamps.values()), min(t[-1] for t in stamps.values())
    own = stamps[fastest]
    keep = (own >= first) & (own <= last)
    if keep.sum() < 2:
        raise DataError(f"{path}: the channels {', '.join(stamps)} were not recorded at the same time")
    if not keep.all():
        notes.append(f"the channels have {keep.sum()} samples of {own.size} in common: {first:.6g} s to {last:.6g} s")
    made = {}
    for name, x in values.items():
        if name not in stamps:
            notes.append(f"'{name}' has no time stamps, left out")
        elif np.array_equal(stamps[name], own):
            made[name] = x[keep]
        else:
            made[name] = np.interp(own[keep], stamps[name], x.astype(np.float64))
            notes.append(
                f"'{name}' ({1 / steps[name]:.6g} Hz) is interpolated to the stamps of '{fastest}' "
                f"({1 / steps[fastest]:.6g} Hz)"
            )
    return made if "t" in made else {"t": own[keep], **made}
