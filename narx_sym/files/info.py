"""What a model carries beside its equations, as plain data and back; everything is checked before it is used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from ..errors import ModelError
from ..models.added import AddedEffect
from ..models.effects import MACHINES
from ..models.info import Info, Nrmse, Selection
from .plain import read

MAX_LABEL = 100  # characters of a unit, or a role
MAX_DIGITS = 17  # of a float


@dataclass(frozen=True)
class EffectData:
    """An added effect in a file: as `AddedEffect`, its symbols by name."""

    effect: str
    form: str = ""
    where: str = ""
    driver: str = ""
    group: str = ""
    coefficients: Mapping[str, str] = field(default_factory=dict)
    shape: Mapping[str, str] = field(default_factory=dict)
    fixed: Mapping[str, int] = field(default_factory=dict)
    full: bool = False


def info_to_dict(info: Info) -> dict[str, Any]:
    """Return what is known of a fit and its records as plain data; what is not known is left out."""
    empty, found = Info(), {}
    for name in (f.name for f in fields(Info)):
        value = getattr(info, name)
        if value != getattr(empty, name):
            found[name] = asdict(value) if isinstance(value, Selection | Nrmse) else value
    if info.nrmse:
        found["nrmse"] = {n: or_none(v) for n, v in found["nrmse"].items()}
    return found


def effect_to_dict(one: AddedEffect) -> dict[str, Any]:
    """Return an added effect as plain data."""
    named = {n: {own: str(s) for own, s in getattr(one, n).items()} for n in ("coefficients", "shape")}
    return {f.name: getattr(one, f.name) for f in fields(EffectData)} | named


def or_none(number: float) -> float | None:
    """Put None in the place of what is not finite: JSON has no such numbers."""
    return number if math.isfinite(number) else None


def read_info(given: Any) -> Info:
    """Build what is known of a fit from plain data; ModelError for what cannot be."""
    plain = dict(read(Mapping[str, Any], given, "info"))
    errors = read(Mapping[str, float | None] | None, plain.pop("nrmse", None), "info.nrmse")
    if errors is not None and set(errors) != {f.name for f in fields(Nrmse)}:
        raise ModelError("'info.nrmse' must give one_step and free_run.")
    nrmse = None if errors is None else Nrmse(**{n: math.inf if v is None else v for n, v in errors.items()})
    info: Info = replace(read(Info, plain, "info"), nrmse=nrmse)
    labels = f"must be printable texts of 1 to {MAX_LABEL} characters"
    rules = [
        ("ranges", all(low < high for low, high in info.ranges.values()), "must increase"),
        ("rates", all(v >= 0 for v in info.rates.values()), "must not be negative"),
        ("frequencies", all(v >= 0 for v in info.frequencies.values()), "must not be negative"),
        ("steps", all(v > 0 for v in info.steps.values()), "must be positive"),
        ("band", info.band is None or (info.line and info.band >= 0), "must not be negative, and needs line"),
        ("units", all(map(_is_label, info.units.values())), labels),
        ("roles", all(map(_is_label, info.roles.values())), labels),
        ("digits", 0 <= info.digits <= MAX_DIGITS, f"must be from 0 to {MAX_DIGITS}"),
        ("machine", info.machine in ("", "none", *MACHINES), f"must be one of {', '.join(MACHINES)}, or none"),
    ]
    for name, holds, rule in rules:
        if not holds:
            raise ModelError(f"'info.{name}' {rule}.")
    return info


def _is_label(text: str) -> bool:
    return 0 < len(text) <= MAX_LABEL and text.isprintable()


def to_effects(listed: Sequence[EffectData], symbols: Mapping[str, Any]) -> list[AddedEffect]:
    """Return added effects from a file; ModelError for a symbol that is not among the model's, given by name."""
    found = []
    for one in listed:
        for name in (*one.coefficients.values(), *one.shape.values()):
            if name not in symbols:
                raise ModelError(f"'effects' names {name[:40]!r}, which is not a parameter.")
        named = {n: {own: symbols[s] for own, s in getattr(one, n).items()} for n in ("coefficients", "shape")}
        found.append(AddedEffect(**{f.name: getattr(one, f.name) for f in fields(EffectData)} | named))
    return found


# -- schema 1 --------------------------------------------------------------------------------------------------


def newer_schema(data: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of schema 1 as schema 2 has it.

    There, standard errors were `std`, effects stood in `info`, and what an effect brought was told by the names of its
    symbols: `c_backlash`, `r_backlash`, `c2_hysteresis`.
    """
    made = {n: v for n, v in data.items() if n != "std"} | {"schema": 2}
    if "std" in data:
        made["standard_errors"] = data["std"]
    info = dict(read(Mapping[str, Any], data.get("info", {}), "info"))
    effects = [
        _newer_effect(dict(one)) for one in read(tuple[Mapping[str, Any], ...], info.pop("effects", []), "effects")
    ]
    known = {f.name for f in fields(Info)}
    return made | {"info": {n: v for n, v in info.items() if n in known}, "effects": effects}


def _newer_effect(made: dict[str, Any]) -> dict[str, Any]:
    for name in ("coefficients", "shape"):
        listed = read(tuple[str, ...], made.get(name, []), f"effects.{name}")
        made[name] = {symbol.partition("_")[0]: symbol for symbol in listed}
    groups = {symbol.partition("_")[2] for symbol in made["coefficients"].values()}
    return {"group": min(groups, default="")} | made
