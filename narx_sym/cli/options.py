"""What the commands share: options, reading, and checks before any work is done."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from inspect import Parameter, Signature, signature
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperOption

from ..errors import DataError, FitError
from .printing import note

# Heavy modules are imported inside the functions: `narx-sym --help` answers at once.
if TYPE_CHECKING:
    from ..data.record import Record
    from ..models.effects import Catalogue
    from ..tasks.black_box import BlackBox

DataFiles = Annotated[
    list[Path],
    typer.Argument(metavar="DATA...", help="Data file: CSV with a header, .npz, .mat, .parquet, .mf4 or .tdms."),
]
ModelFile = Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model file written by narx-sym.")]
Input = Annotated[str, typer.Option("--input", help="Column of the input; of several, names separated by commas.")]
Output = Annotated[str, typer.Option("--output", help="Column of the output; of several, names separated by commas.")]
Time = Annotated[str, typer.Option("--time", help="Column of the time, in s.")]
Ts = Annotated[float | None, typer.Option("--ts", help="Sampling time in s; overrides the time column.")]
Channels = Annotated[str, typer.Option("--channels", help="Further columns to use: names separated by commas, or all.")]
Rows = Annotated[str | None, typer.Option("--rows", help="Use only the data rows A:B, counted from 0.")]
Validate = Annotated[
    list[Path] | None,
    typer.Option("--validate", help="A validation record: no model is fitted to it. May be repeated."),
]
SteadyState = Annotated[
    Path | None,
    typer.Option(
        "--steady-state",
        help="CSV with steady-state pairs of input and output, in columns named as in the data, to fit together with "
        "them. Needs --base narx, linear or static.",
    ),
]
Missing = Annotated[
    str,
    typer.Option(
        "--missing",
        help="Missing values: refuse (stop with an error), or drop (remove these rows, "
        "fill short gaps, and print what was done).",
    ),
]
Units = Annotated[
    str,
    typer.Option(
        "--units", help="Units of input, output and channels, such as V,um,temp=degC (default: those in the file)."
    ),
]
Scale = Annotated[
    str | None,
    typer.Option(
        "--scale", help="Force per unit of the input, such as u=35.15N/V; forces are then printed in this unit."
    ),
]
Roles = Annotated[
    str,
    typer.Option(
        "--role",
        help="Roles of columns, such as command=setpoint,temp=disturbance. A role is setpoint, input, disturbance, "
        "derivative-of-y, integral-of-y or ignore (default: detected from the values, else guessed from the "
        "name; the guess is printed).",
    ),
]
Machine = Annotated[
    str,
    typer.Option(
        "--machine",
        help="Kind of machine: thermal, tank, drive, motion-force, smart-material, soft, propeller, valve, "
        "structure, circuit, battery, process or pendulum; none: unknown (default: guessed from the units; the guess "
        "is printed).",
    ),
]
MaxEffects = Annotated[int, typer.Option("--max-effects", min=1, max=20, help="Largest number of effects to add.")]
OpenLoop = Annotated[
    bool, typer.Option("--open-loop", help="The record was taken in open loop: do not check for feedback.")
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")]
Column = Annotated[str | None, typer.Option("--column", help="Column of the reference (default: the only one).")]
Limits = Annotated[
    tuple[float, float] | None,
    typer.Option("--limits", metavar="LO HI", help="Smallest and largest input of the actuator."),
]
Rate = Annotated[float | None, typer.Option("--rate", help="Largest change of the input per sample.")]
Share = Annotated[
    str,
    typer.Option(
        "--share",
        help="Damping: fraction of each computed input change to apply. auto (damp only a "
        "law that rings), none, or a number.",
    ),
]
Resume = Annotated[
    Path | None, typer.Option("--resume", help="File for intermediate results; an interrupted run continues from them.")
]
EffectFiles = Annotated[
    list[Path] | None, typer.Option("--effects", help="File with your own effects (TOML or JSON); may be repeated.")
]


@dataclass(frozen=True)
class Reading:
    """How data files are read: the options that many commands have, in the place of their argument `how`."""

    u: Input = "u"
    y: Output = "y"
    t: Time = "t"
    ts: Ts = None
    channels: Channels = ""
    role: Roles = ""
    rows: Rows = None
    missing: Missing = "refuse"
    units: Units = ""

    @property
    def several(self) -> bool:
        """Whether several outputs are asked for: the model is then a `System`."""
        return "," in self.y

    def records(self, files: list[Path], model: Any = None, more: Iterable[str] = ()) -> list[Record]:
        """Read data files in the units of a model, or of the first; say what was changed and what to know.

        What a channel is says the user, else the model, else what is found in the file. `more` are the names of
        further columns.
        """
        from ..data.evidence.roles import roles_of, with_roles
        from ..data.record import read
        from ..data.units import in_units
        from ..symbolic.signals import channel_name
        from ..tasks.base import check_pace, what_to_print

        said, own = unit_names(self.units), roles_of(self.role)
        columns = ",".join(dict.fromkeys(filter(None, [*self.channels.split(","), *more])))
        u, y = (names.split(",") if "," in names else names for names in (self.u, self.y))
        read_in = [read(file, u, y, self.t, self.ts, self.rows, columns, self.missing, said, own) for file in files]
        if model:
            known = {n: role for n, role in model.info.roles.items() if n not in map(channel_name, own)}
            read_in = [with_roles(r, {n: known[n] for n in r.channels if n in known}) for r in read_in]
        listed = in_units(read_in, model.info.units if model else None)
        for file, record in zip(files, listed, strict=True):
            if model:
                check_pace(model, record.Ts, f"{file}: the record has")
        for text in what_to_print(listed):
            note(text)
        return listed

    def black_box(self, file: Path | str) -> BlackBox | None:
        """Return what an FMU is, by its ending, with the variables named like the columns; None for another file."""
        from ..tasks.black_box import ENDING, from_fmu

        return from_fmu(file, self.u, self.y) if str(file).lower().endswith(ENDING) else None

    def validating(self, files: list[Path] | None, measured: list[Record], more: Iterable[str] = ()) -> list[Record]:
        """Read the validation records, all their rows, in the units of the data; they have the pace of the data."""
        from ..data.timegrid import same_pace
        from ..data.units import in_units

        if not files:
            return []
        listed = in_units(replace(self, rows=None).records(files, more=more), measured[0].units)
        for record in listed:
            if not same_pace(record.Ts, measured[0].Ts):
                raise DataError(
                    f"{record.name}: the validation record has Ts = {record.Ts:g} s, the data {measured[0].Ts:g} s: "
                    "resample one of them."
                )
        return listed


def reads(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of `Reading` in the place of its argument `how`, without some of them."""

    def command(run: Callable[..., None]) -> Callable[..., None]:
        own = [p for p in signature(run, eval_str=True).parameters.values() if p.name != "how"]
        shared = [p for p in signature(Reading, eval_str=True).parameters.values() if p.name not in without]

        @wraps(run)
        def given(**options: Any) -> None:
            how = Reading(**{p.name: options.pop(p.name) for p in shared})
            run(**options, how=how)

        listed = [p.replace(kind=Parameter.KEYWORD_ONLY) for p in (*own, *shared)]
        given.__signature__ = Signature(listed)  # type: ignore[attr-defined]
        given.__annotations__ = {p.name: p.annotation for p in listed}
        return given

    return command


def check_rest(file: Path | None, weight: float | None, method: str, base: str) -> str:
    """Return the method of a fit; refuse what steady-state data cannot enter, before any work is done."""
    if file is None:
        if weight is not None:
            raise DataError("--weight needs --steady-state: give its file too.")
        return method
    if method not in ("auto", "one_step"):
        raise FitError(f"Steady-state data can only be used in the one-step fit: use --method one_step, not {method}.")
    if base not in ("narx", "linear", "static"):
        raise FitError(
            "Steady-state data need a model that is linear in its parameters: --base narx, linear or static, not "
            f"{base}."
        )
    return "one_step"


def rest_points(file: Path, how: Reading, units: Mapping[str, str]) -> Any:
    """Read the (ubar, ybar) pairs of a file, (n, 2), in the units of the data."""
    import numpy as np

    from ..data.record import read_signal

    asked = (("u", how.u, "--input"), ("y", how.y, "--output"))
    found = [
        read_signal(file, column, t=None, option=option, unit=units.get(name, ""), offers=())[0]
        for name, column, option in asked
    ]
    return np.column_stack(found)


def again(context: typer.Context, left_out: Sequence[str] = ()) -> dict[str, list[str]]:
    """Return the options that were typed, as they would be typed again, by name; without some parameters."""
    typed: dict[str, list[str]] = {}
    for one in context.command.params:
        name, source = one.name or "", context.get_parameter_source(one.name or "")
        if not isinstance(one, TyperOption) or name in left_out or source is None or source.name != "COMMANDLINE":
            continue
        values = context.params[name] if one.multiple else [context.params[name]]
        words = [[] if one.is_flag else map(str, value if one.nargs > 1 else [value]) for value in values]
        typed[one.opts[0]] = [word for own in words for word in (one.opts[0], *own)]
    return typed


def unit_names(units: str) -> dict[str, str]:
    """Turn "V,um,temp=degC" into units of u, y and channels by name; what is empty is not said."""
    found: dict[str, str] = {}
    for part, own in zip_longest(units.split(","), ("u", "y"), fillvalue=""):
        name, told, label = part.rpartition("=")
        if label.strip() and not (name.strip() if told else own):
            raise DataError(
                f"--units {units}: give the units of input and output, then those of channels as temp=degC."
            )
        if label.strip():
            found[name.strip() or own] = label.strip()
    return found


def check_format(path: Path | None, columns: Path | None = None) -> None:
    """Refuse a picture, and a name for columns of text, that cannot be written, before any work is done."""
    from ..files.atomic import check_columns

    check_columns(columns)
    if path is None:
        return
    from matplotlib.backend_bases import FigureCanvasBase

    supported = FigureCanvasBase.get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in supported:
        raise DataError(
            f"{path}: unknown kind of picture; end the name in one of {', '.join(sorted('.' + s for s in supported))}."
        )


def save_figure(figure: Any, path: Path) -> None:
    """Write a picture; the format follows the suffix. It appears whole or not at all."""
    from ..files.atomic import write_figure

    check_format(path)
    write_figure(figure, path, dpi=130)


def check_targets(targets: Sequence[Path | None], *read: Path | None) -> None:
    """Refuse output paths that cannot be written, that are read, or that are the same, before any work is done."""
    from ..files.atomic import check_path

    sources = {p.resolve() for p in read if p is not None}
    given: set[Path] = set()
    for path in targets:
        if path is None:
            continue
        where = check_path(path)
        if where in sources:
            raise DataError(f"{path}: this command reads this file; write to another one.")
        if where in given and where.is_file() == where.exists():
            raise DataError(f"{path}: two results would go to the same file; choose different names.")
        given.add(where)


def with_own(files: list[Path]) -> Catalogue:
    """Return the catalogue with the user's own effects."""
    from ..models.effects import EFFECTS, load_effects

    catalogue = EFFECTS.without()  # a copy
    for file in files:
        load_effects(file, catalogue)
    return catalogue


def where_beside(plot: Path) -> Path:
    """Return the name of the picture of where it fails."""
    return plot.with_stem(f"{plot.stem}_where")
