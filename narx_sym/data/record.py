"""Measured records: one experiment on a regular time grid, from arrays or from a file."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..symbolic.signals import channel_name
from .arrays import Vector, vector
from .coverage import one_sine
from .evidence.roles import INPUT, OUTPUT, check_roles, column_roles
from .readers import load
from .tables import PathLike, check_size, names_of, wants_all
from .timegrid import check_step, regular_time, uniform_time
from .units import converted, said_first

YEARS = 3e8  # [s], ten years: a record that seems longer has its time in another unit


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """One experiment on a regular time grid: input u, output y and further channels.

    Make it with `read` (from a file) or `Record.from_arrays`. Its arrays are read-only copies.

    Attributes
    ----------
    u, y, t : (N,) arrays
        Input and output in the user's units, time in s.
    Ts : float
        Sampling time in s.
    channels : dict of (N,) arrays
        Further measured signals.
    notes : tuple of str
        What was removed, filled or resampled.
    breaks : tuple of int
        Indices where a new segment starts after a gap.
    units : dict of str
        Units of u, y and the channels, if they are known.
    aside : tuple of str
        Names of the columns of the file that are not used.
    roles : dict of str
        Role of each channel, one of `roles.ROLES`. A role that is not given is detected from values, name and unit.

    Examples
    --------
    >>> import narx_sym as ns
    >>> record = ns.Record.from_arrays(u=[0, 1, 1, 0], y=[0, 0.5, 0.9, 0.4], Ts=0.1, units={"u": "V", "y": "mm"})
    >>> record
    Record 'record': N = 4, Ts = 0.1 s, 0.3 s, u in [0, 1] V, y in [0, 0.9] mm
    >>> len(record[1:]), record.units["y"]
    (3, 'mm')
    """

    u: Vector
    y: Vector
    t: Vector
    Ts: float
    channels: dict[str, Vector] = field(default_factory=dict)
    name: str = "record"
    notes: tuple[str, ...] = ()
    breaks: tuple[int, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    aside: tuple[str, ...] = ()
    roles: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f"record '{self.name}': "
        arrays = _vectors({"u": self.u, "y": self.y, "t": self.t}, self.channels, where)
        channels = {n: arrays.pop("channel " + n) for n in self.channels}
        breaks = tuple(int(b) for b in self.breaks)
        if any(b <= a for a, b in pairwise((0, *breaks, arrays["u"].size))):
            raise DataError(f"{where}breaks {breaks} must increase and lie inside 1..N-1")
        units = {n: label for n, label in self.units.items() if label and n in ("u", "y", *channels)}
        roles, told = column_roles(self.roles, channels, arrays["u"], arrays["y"], units, breaks)
        values = {
            **arrays,
            "Ts": check_step(self.Ts),
            "channels": channels,
            **{"notes": (*self.notes, *told), "breaks": breaks, "units": units, "roles": roles},
        }
        for n, v in values.items():
            object.__setattr__(self, n, v)

    @classmethod
    def from_arrays(
        cls,
        u: Any,
        y: Any,
        Ts: float | None = None,
        t: Any = None,
        channels: Mapping[str, Any] | None = None,
        name: str = "record",
        units: Mapping[str, str] | None = None,
        roles: Mapping[str, str] | None = None,
    ) -> Record:
        """Make a record from (N,) or (N, 1) arrays, lists or Series; `Ts` in s overrides the time stamps `t` in s.

        `units` such as {"u": "V", "y": "um"}, and `roles` such as {"command": "setpoint"}, go with the record.
        DataError says what is wrong with the arrays.
        """
        where = f"record '{name}': "
        if not isinstance(channels or {}, Mapping):
            raise DataError(f'{where}channels must be a mapping of names to arrays, such as {{"temp": temp}}')
        extra = {} if t is None or Ts is not None else {"t": t}
        signals = _vectors({"u": u, "y": y, **extra}, channels or {}, where)
        stamps = signals.pop("t", None)
        if Ts is None and stamps is None:
            raise DataError(f"{where}no sampling time; give Ts (seconds) or t (time stamps)")
        if stamps is None:
            grid = uniform_time(signals["u"].size, check_step(Ts))
        else:
            grid = regular_time(stamps, lambda i: f"t[{i}]", where)
        u, y, *rest = (grid.apply(a) for a in signals.values())
        notes = grid.notes if t is None or Ts is None else (f"time stamps not used, Ts = {grid.Ts:.10g} s was given",)
        named = dict(zip(channels or {}, rest, strict=True))
        return cls(
            u, y, grid.t, grid.Ts, named, name, notes, grid.breaks, _known(units, ("u", "y", *named), f"{where}units"),
            roles=_known(roles, named, f"{where}a role"),
        )  # fmt: skip

    @property
    def signals(self) -> dict[str, Vector]:
        """Every measured sequence by name: the channels, and u, y, t, whatever a channel is called."""
        own = {"u": self.u, "y": self.y, "t": self.t}
        return {**own, **self.channels, **own}

    def __len__(self) -> int:
        return int(self.u.size)

    def __getitem__(self, rows: slice) -> Record:
        if not isinstance(rows, slice):
            raise TypeError("a Record is cut with a slice, as in record[20:5000]; use record.u[k] for one sample")
        a, b, step = rows.indices(len(self))
        if step != 1:
            raise DataError(f"record '{self.name}': the step of a slice must be 1, not {step}")
        return replace(
            self, u=self.u[a:b], y=self.y[a:b], t=self.t[a:b], channels={n: c[a:b] for n, c in self.channels.items()},
            breaks=tuple(i - a for i in self.breaks if a < i < b),
        )  # fmt: skip

    def remarks(self, among: Sequence[Record] = ()) -> list[str]:
        """Return remarks on the data that matter for every conclusion from them."""
        found = []
        for word, name in {"input": "u", "output": "y"}.items():
            x = np.concatenate([getattr(r, name) for r in among or (self,)])
            low, high = float(x.min()), float(x.max())
            if low < high and np.all((x == low) | (x == high)):
                found.append(
                    f"the {word} takes only two values, {low:.6g} and {high:.6g}: what happens between them, such as "
                    "a curve or a dead zone, cannot be detected"
                )
        frequency = one_sine(self.u, self.Ts)
        if frequency:
            found.append(
                f"the input is one sine of {frequency:.3g} Hz: with one sine, effects of speed (a lag, creep, drag) "
                "and effects with memory (hysteresis, friction, slack) draw similar loops; record a second "
                "frequency or other amplitudes to distinguish them"
            )
        if self.Ts * len(self) > YEARS:
            found.append(
                f"the record seems to last {self.Ts * len(self) / 3.156e7:.3g} years: where the time is not in s, "
                "convert it or give --ts"
            )
        return found

    def segments(self) -> list[Record]:
        """Return the segments between the breaks as records; single samples are left out."""
        if not self.breaks:
            return [self]
        edges = (0, *self.breaks, len(self))
        return [self[a:b] for a, b in pairwise(edges) if b - a >= 2]

    def split(self, fraction: float) -> tuple[Record, Record]:
        """Return the first `fraction` (0 to 1) of the samples and the rest; DataError where one has fewer than 2."""
        n = round(len(self) * fraction)
        if not 2 <= n <= len(self) - 2:
            raise DataError(
                f"record '{self.name}': a split at {fraction:g} of {len(self)} samples leaves a part "
                "with fewer than 2; choose another fraction"
            )
        return self[:n], self[n:]

    def smoothed(self, seconds: float) -> Record:
        """Return the record with y smoothed by quadratic regression over a moving window (section 6 of the paper).

        An inverse model has y as its input: noise on it would be an error in the variables. Each segment is smoothed
        on its own, without delay (Savitzky & Golay 1964).

        Parameters
        ----------
        seconds : float
            Length of the window [s]; at least five samples, and no longer than the shortest segment, else DataError.
        """
        from scipy.signal import savgol_filter

        width = 2 * round(seconds / self.Ts / 2) + 1 if 0 < seconds < np.inf else 0
        parts = self.segments()
        if not 5 <= width <= min(map(len, parts)):
            raise DataError(
                f"record '{self.name}': a window of {seconds:g} s has {width} samples; between 5 and the "
                f"{min(map(len, parts))} samples of the shortest segment are needed"
            )
        edges = (0, *self.breaks, len(self))
        y = np.concatenate(
            [savgol_filter(self.y[a:b], width, 2) if b - a >= 2 else self.y[a:b] for a, b in pairwise(edges)]
        )
        notes = (*self.notes, f"y was smoothed by quadratic regression over {width} samples")
        return replace(self, y=y, notes=notes)

    def __repr__(self) -> str:
        ranges = ", ".join(
            f"{n} in [{a.min():.4g}, {a.max():.4g}] {self.units.get(n, '')}".rstrip()
            for n, a in {"u": self.u, "y": self.y, **self.channels}.items()
        )
        parts = f", {len(self.breaks) + 1} segments" if self.breaks else ""
        span = self.t[-1] - self.t[0]
        return f"Record '{self.name}': N = {len(self)}, Ts = {self.Ts:.6g} s, {span:.6g} s{parts}, {ranges}"


def check_excitation(*segments: Record) -> None:
    """Refuse a record whose input or output is constant, or which has one signal: nothing can be identified from it."""
    record = segments[0]
    u, y = (np.concatenate([getattr(s, name) for s in segments]) for name in "uy")
    for word, x in {"input": u, "output": y}.items():
        if np.ptp(x) <= 1e-12 * np.max(np.abs(x)):
            raise DataError(
                f"record '{record.name}': the {word} is constant ({x[0]:.6g} in all {x.size} "
                f"samples), nothing can be identified; check the column (--{word}) and the rows "
                "(--rows), or measure with motion"
            )
    if np.array_equal(u, y):
        raise DataError(
            f"record '{record.name}': output and input are the same signal, nothing can be identified; check the "
            "columns (--input, --output)"
        )


def _known(given: Mapping[str, str] | None, names: Collection[str], what: str) -> Mapping[str, str]:
    """Refuse units or roles of what is none of these names."""
    if stray := [n for n in given or {} if n not in names]:
        raise DataError(f"{what} of {stray[0]!r}, which is no signal; there are {', '.join(names) or 'none'}")
    return given or {}


def _vectors(signals: Mapping[str, Any], channels: Mapping[str, Any], where: str) -> dict[str, Vector]:
    """Read-only (N,) copies of equal length N >= 2; channel names get the prefix 'channel '."""
    named = {**signals, **{"channel " + n: a for n, a in channels.items()}}
    out = {n: _vector(a, where + n) for n, a in named.items()}
    first, size = next((n, a.size) for n, a in out.items())
    for n, a in out.items():
        if a.size != size:
            raise DataError(f"{where}{first} has {size} samples but {n} has {a.size}; give equal lengths")
    if size < 2:
        raise DataError(f"{where}{size} sample(s) are left; at least 2 are needed")
    return out


def _vector(x: Any, where: str) -> Vector:
    """`x` as a finite, read-only (N,) copy."""
    out = np.array(vector(x, where, DataError, "repair them or cut them away"), order="C")
    check_size(out, where)
    out.flags.writeable = False
    return out


def read(
    path: PathLike,
    u: str | Sequence[str] = "u",
    y: str | Sequence[str] = "y",
    t: str | None = "t",
    Ts: float | None = None,
    rows: slice | str | None = None,
    channels: str | Sequence[str] = (),
    missing: str = "refuse",
    units: Mapping[str, str] | None = None,
    roles: Mapping[str, str] | None = None,
) -> Record:
    r"""Read one experiment from .csv, .txt, .tsv, .dat, .npz, .mat, .parquet, .mf4, .mdf or .tdms.

    Logs (.mf4, .mdf, .tdms, .mat of version 7.3) need `pip install "narx-sym[logs]"`. Channels with different sampling
    rates are interpolated to the time stamps of the fastest chosen one (called `t`). Units in the file, from a log or
    in the name of a column ("u [V]", found as `u`), are kept. What was changed is listed in `notes` of the record.

    Parameters
    ----------
    path : str or Path
        The file.
    u, y, t : str
        Names of the columns of input, output and time (s). Of several inputs the first is `u`, the others are channels
        with the role "input"; of several outputs the first is `y`, and all are channels with the role "output".
    Ts : float
        Sampling time in s; if it is given, the time column is not used.
    rows : slice or "A:B"
        Data rows to keep, counted from 0 as in Python.
    channels : list of str, or "all"
        Further columns to keep. A name that cannot stand in an equation is changed: "temp [C]" becomes temp_C, and can
        be asked for by this name too.
    missing : "refuse" or "drop"
        What to do with missing or infinite values. "drop" fills up to ten samples of a column by linear interpolation;
        a longer gap is removed and splits the record.
    units : mapping such as {"u": "V", "y": "um"}
        Units of the signals, in place of those in the file.
    roles : mapping such as {"command": "setpoint", "temp": "disturbance", "index": "ignore"}
        Roles of further columns (`Record.roles`). These columns become channels, except for "ignore".

    Returns
    -------
    Record

    Raises
    ------
    DataError
        If the file cannot be read, a column is missing, or values are missing (see `missing`).

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import narx_sym as ns
    >>> path = pathlib.Path(tempfile.mkdtemp(), "stage.csv")
    >>> _ = path.write_text("t,volts [V],y [um]\n0,0,0\n0.1,1,0.5\n0.2,1,0.9\n")
    >>> ns.read(path, u="volts")
    Record 'stage': N = 3, Ts = 0.1 s, 0.2 s, u in [0, 1] V, y in [0, 0.9] um
    """
    if not (isinstance(u, str) and isinstance(y, str)):
        return _read_several(u, y, channels, roles, path, t=t, Ts=Ts, rows=rows, missing=missing, units=units)
    if missing not in ("refuse", "drop"):
        raise DataError(f"missing values are refused or dropped (--missing refuse or drop), not {missing!r}")
    said = check_roles(roles or {})
    table = load(path, None if wants_all(channels) else {u, y, *names_of(channels), *said, *([t] if t else [])})
    cut = table.cut(rows)
    u, y, t = table.named(u), table.named(y), None if t is None else table.named(t)
    names, given = table.channels(channels, (u, y, t), cut, said)
    asked = {**dict.fromkeys(names.values(), "--channels"), u: "--input", y: "--output"}
    stamps = [t] if Ts is None and t in table.columns else []
    keep = table.complete(list(asked), stamps, cut) if missing == "drop" else None
    data = {n: table.numbers(n, option, cut, keep) for n, option in asked.items()}
    grid = table.time(t, Ts, cut, keep)
    if grid is None:
        raise DataError(
            f"{table.path}: no time column '{t}' and no sampling time; there are {table.listing}; "
            "give --ts SECONDS or choose the time column with --time"
        )
    data = {n: grid.apply(a) for n, a in data.items()}
    written = {n: table.unit(column) for n, column in (*names.items(), ("u", u), ("y", y))}
    return Record(
        data[u], data[y], grid.t, grid.Ts, {name: data[n] for name, n in names.items()}, Path(path).stem,
        (*table.notes, *grid.notes), grid.breaks, said_first(written, _known(units, written, f"{table.path}: units")),
        table.aside({*asked, t, *given}, cut), given,
    )  # fmt: skip


def _read_several(u: Any, y: Any, channels: Any, roles: Mapping[str, str] | None, path: PathLike, **how: Any) -> Record:
    """Read a record with several inputs or outputs: see `read`."""
    named = [[n] if isinstance(n, str) else list(n) if isinstance(n, (list, tuple)) else [] for n in (u, y)]
    if not all(names and all(isinstance(n, str) for n in names) for names in named):
        raise DataError(f"{path}: inputs and outputs are the name of a column, or a list of them, not {u!r} and {y!r}")
    for option, names in zip(("--input", "--output"), named, strict=True):
        if wrong := [n for n in names if not n.strip() or names.count(n) > 1]:
            raise DataError(f"{path}: {option} has {wrong[0]!r}, which is empty or named twice: name each column once")
    (u, *inputs), (y, *outputs) = named
    said = {**dict.fromkeys(inputs, INPUT), **dict.fromkeys(outputs, OUTPUT), **(roles or {})}
    made = read(path, u, y, channels=[*names_of(channels), *inputs, *outputs], roles=said, **how)
    if not outputs:
        return made
    first = channel_name(y)
    units = {**made.units, **({first: made.units["y"]} if "y" in made.units else {})}
    return replace(made, channels={first: made.y, **made.channels}, roles={**made.roles, first: OUTPUT}, units=units)


def read_signal(
    path: PathLike,
    column: str | None,
    Ts: float | None = None,
    t: str | None = "t",
    rows: slice | str | None = None,
    option: str = "--input",
    prefer: str | None = None,
    unit: str = "",
    offers: Sequence[str] = ("--rows",),
) -> tuple[Vector, float | None, Vector]:
    """Read one column, such as a reference.

    Parameters
    ----------
    column : str or None
        Name of the column; None takes `prefer` where there is one, else the only one beside `t`.
    option : str
        The command-line option named where the column is unknown.
    unit : str
        What the values are wanted in; a column that says another unit, as "r [mm]", is converted, and that is warned.
    offers : those of "--rows" and "--ts" that the user has for this file: what he is told to do

    Returns
    -------
    values : (N,) array
    Ts : float in s, or None where neither `Ts` nor a time column says it
    t : (N,) array in s, or the sample numbers where `Ts` is None
    """
    table = load(path, None if column is None else {column, *([t] if t else [])})
    table.offers = tuple(offers)
    cut = table.cut(rows)
    t, prefer = (name and table.named(name) for name in (t, prefer))
    if column is None:
        others = [prefer] if prefer in table.columns else [n for n in table.columns if n != t]
        if len(others) != 1:
            raise DataError(
                f"{table.path}: which column is the signal? There are {table.listing}; choose with {option}"
            )
        column = others[0]
    column = table.named(column)
    values, own = table.numbers(column, option, cut), table.unit(column)
    if own and unit and own != unit:
        found = converted(values, own, unit)
        if found is None:
            raise DataError(
                f"{table.path}: column '{column}' is in {own}, which does not convert to {unit}, the model's"
            )
        warnings.warn(f"{table.path}: column '{column}' is converted from {own} to {unit}", stacklevel=2)
        values = found
    grid = table.time(t, Ts, cut)
    if grid is None:
        return values, None, np.arange(values.size, dtype=np.float64)
    if len(grid.pieces) > 1 or grid.pieces[0][1].size < values.size:
        raise DataError(
            f"{table.path}: the time stamps have a gap ({grid.notes[0].partition(';')[0]}); this signal must have none"
            + (f": {' or '.join(f'use {option}' for option in offers)}" if offers else "")
        )
    if grid.resampled:
        warnings.warn(f"{table.path}: {grid.notes[-1]}", stacklevel=2)
    return grid.apply(values), grid.Ts, grid.t
