"""What a diagnosis begins with: what to know about the data, and a base from a file or identified."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..data.evidence.roles import INPUT
from ..data.evidence.several import told_once
from ..data.record import Record
from ..data.sensor import sensor_faults
from ..data.timegrid import same_pace
from ..diagnosis.bases import joined
from ..errors import DataError, ModelError, NarxError
from ..files.store import MAX_BYTES, load_model
from ..fit.identify import BASES, OPEN, SEVERAL, identify, prepare
from ..models.differential import from_equations
from ..models.model import Model
from ..models.system import System
from ..symbolic.signals import u


def what_to_know(records: Sequence[Record]) -> dict[str, list[str]]:
    """Say what was changed in records and what to know before anything is concluded; with the names of the records."""
    return told_once(records, lambda r: [*r.notes, *r.remarks(records), *(f.sentence for f in sensor_faults([r], 0.0))])


def what_to_print(records: Sequence[Record]) -> list[str]:
    """Return what to know of records as sentences, each with the names of those that it is said of."""
    return [f"{joined(names)}: {text}" for text, names in what_to_know(records).items()]


def read_base(path: str | Path, shown: str = "") -> Model:
    """Return the model in a file, fitted and from u to y.

    Parameters
    ----------
    shown : str
        What the file is called in errors; its path by default.

    Raises
    ------
    ModelError
        For an inverse model, one without parameter values, or a file that holds none.
    """
    shown = shown or str(path)
    try:
        model = load_model(path)
    except NarxError as error:
        raise ModelError(str(error).replace(str(path), shown)) from None
    if model.input != u:
        raise ModelError(f"{shown}: this is an inverse model; a base goes from u to y.")
    if model.theta is None:
        raise ModelError(f"{shown}: the model has no parameter values; fit it first.")
    return model


def equations_in(base: str | Path) -> str:
    """Return the text of a file with equations of one's own (`from_equations`); "" where it names no such file.

    Raises
    ------
    ModelError
        For a file that cannot be read, with its name.
    ParseError
        For equations that cannot be read.
    """
    path = Path(base)
    if str(base) in BASES or path.suffix.lower() == ".json" or not path.is_file():
        return ""
    try:
        text = path.read_text(encoding="utf-8") if path.stat().st_size <= MAX_BYTES else "{"  # no text of equations
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: cannot be read as text ({error}).") from None
    if text.lstrip().startswith("{"):
        return ""
    try:
        from_equations(text, 1.0)
    except NarxError as error:
        raise type(error)(f"{path}: {error}") from None
    return text


def fit_equations(text: str, records: Sequence[Record]) -> Model:
    """Return the model of a text of equations, fitted in free run to records."""
    listed = prepare(records)
    return from_equations(text, listed[0].Ts).fit(listed, method="free_run")


def check_kind(kind: str) -> str:
    """Return the name of a kind of base; refuse one that does not exist."""
    if kind not in BASES:
        raise ModelError(f"Unknown base {kind!r}: use {', '.join(BASES)}, a model file, or a file with equations.")
    return kind


def identify_base(kind: str, records: Sequence[Record], delay: int | None = None) -> Model:
    """Identify a base to diagnose; what is wrong with the data is said at once. A dead time is found if none is given.

    What `identify` warns of a linear or static base is not passed on: a diagnosis chooses its orders again.
    """
    check_kind(kind)
    prepare(records)
    inputs = {n for r in records for n, role in r.roles.items() if role == INPUT and kind in SEVERAL}
    # Another channel acts as an effect.
    bare = [replace(r, channels={n: c for n, c in r.channels.items() if n in inputs}) for r in records]
    with warnings.catch_warnings():
        if kind in OPEN:
            warnings.simplefilter("ignore", UserWarning)
        return identify(bare, base=kind, delay=delay)


def check_pace(model: Model | System, Ts: float | None, what: str) -> None:
    """Refuse data with another sampling time [s] than the model: at another rate it is another model, and another law.

    A model of the same sample alone, y[k] from u[k], is the same at every rate.

    Parameters
    ----------
    what : str
        What the data are, such as "The reference has".

    Raises
    ------
    DataError
    """
    if Ts is None or not model.Ts or same_pace(Ts, model.Ts) or not model.recursion.depth:
        return
    raise DataError(
        f"{what} Ts = {Ts:g} s, the model was identified at {model.Ts:g} s, and a model is only valid at its "
        f"sampling time: resample to {model.Ts:g} s, or fit a model to data at {Ts:g} s."
    )
