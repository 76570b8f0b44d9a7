"""What a model carries beside its equations, as plain data and back; everything is checked before it is used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

from ..errors import ModelError
from ..models.added import AddedEffect
from ..models.effects import MACHINES
from ..models.info import Info, Nrmse, Selection

MAX_LISTED = 1000  # entries of a list
MAX_LABEL = 100  # characters of a unit, or a role
MAX_EFFECTS = 200
MAX_DIGITS = 17  # of a float
EFFECT = {f.name for f in fields(AddedEffect)}


def info_to_dict(info: Info) -> dict[str, Any]:
    """Return what is known of a fit and its records as plain data; what is not known is left out."""
    nrmse, chosen = info.nrmse, info.selection
    found: dict[str, Any] = {
        "method": info.method, "converged": info.converged, "samples": info.samples,
        "nrmse": nrmse and {"one_step": or_none(nrmse.one_step), "free_run": or_none(nrmse.free_run)},
        "ranges": {n: list(pair) for n, pair in info.ranges.items()}, "rates": dict(info.rates),
        "frequencies": dict(info.frequencies), "steps": dict(info.steps),
        "line": info.line and list(info.line), "band": info.band, "start": info.start and list(info.start),
        "selection": None if chosen == Selection() else asdict(chosen) | {"err": list(chosen.err)},
        "units": dict(info.units), "roles": dict(info.roles), "digits": info.digits or None,
        "machine": info.machine,
    }  # fmt: skip
    return {n: v for n, v in found.items() if v is not None and v != {} and v != ""} if info != Info() else {}


def effect_to_dict(one: AddedEffect) -> dict[str, Any]:
    """Return an added effect as plain data."""
    named = {n: {own: str(s) for own, s in getattr(one, n).items()} for n in ("coefficients", "shape")}
    return {n: getattr(one, n) for n in ("effect", "form", "where", "driver", "group")} | named | {
        "fixed": dict(one.fixed), "full": one.full,
    }  # fmt: skip


def or_none(number: float) -> float | None:
    """Put None in the place of what is not finite: JSON has no such numbers."""
    return number if math.isfinite(number) else None


def read_info(info: Any) -> Info:
    """Build what is known of a fit from plain data.

    Raises
    ------
    ModelError
        For a field that is not known, or of the wrong kind.
    """
    known = {f.name for f in fields(Info)}
    if not isinstance(info, dict) or set(info) - known:
        raise ModelError(f"'info' must be an object with some of the fields {', '.join(sorted(known))}.")
    line, band = info.get("line"), info.get("band")
    pairs = {n: info[n] for n in ("line", "start") if info.get(n) is not None}
    for name, pair in pairs.items():
        if len(numbers(pair, f"info.{name}")) != 2:
            raise ModelError(f"'info.{name}' must hold two numbers.")
    if band is not None and (line is None or numbers([band], "info.band")[0] < 0):
        raise ModelError("'info.band' must be a positive number beside 'info.line'.")
    ranges = info.get("ranges", {})
    if not isinstance(ranges, dict) or not all(
        len(pair := numbers(v, "info.ranges")) == 2 and pair[0] < pair[1] for v in ranges.values()
    ):
        raise ModelError("'info.ranges' must give two increasing numbers for each signal.")
    for name in ("rates", "frequencies", "steps"):
        most = info.get(name, {})
        good = isinstance(most, dict) and all(v >= 0 for v in numbers(list(most.values()), f"info.{name}"))
        if not good or (name == "steps" and 0 in most.values()):
            raise ModelError(f"'info.{name}' must give a positive number for each signal.")
    method, converged, samples = info.get("method", ""), info.get("converged"), info.get("samples", 0)
    if (
        not isinstance(method, str)
        or not (converged is None or isinstance(converged, bool))
        or type(samples) is not int
    ):
        raise ModelError("'info' must give the method as a text, converged as true or false, samples as a number.")
    rates, frequencies, steps = (
        {n: float(v) for n, v in info.get(name, {}).items()} for name in ("rates", "frequencies", "steps")
    )
    return Info(
        method=method, converged=converged, samples=samples, nrmse=_nrmse(info.get("nrmse")),
        ranges={n: (float(a), float(b)) for n, (a, b) in ranges.items()}, rates=rates, frequencies=frequencies,
        steps=steps, band=None if band is None else float(band), selection=_selection(info.get("selection")),
        units=_labels(info.get("units", {}), "units"), roles=_labels(info.get("roles", {}), "roles"),
        digits=_digits(info.get("digits", 0)), machine=_machine(info.get("machine", "")),
        **{name: (float(pair[0]), float(pair[1])) for name, pair in pairs.items()},
    )  # fmt: skip


def _labels(given: Any, name: str) -> dict[str, str]:
    good = isinstance(given, dict) and len(given) <= MAX_LISTED
    if not good or not all(isinstance(v, str) and 0 < len(v) <= MAX_LABEL and v.isprintable() for v in given.values()):
        raise ModelError(f"'info.{name}' must give a printable text of at most {MAX_LABEL} characters for each signal.")
    return dict(given)


def _machine(given: Any) -> str:
    if given not in ("", "none", *MACHINES):
        raise ModelError(f"'info.machine' must be one of {', '.join(MACHINES)}, or none.")
    return str(given)


def _digits(given: Any) -> int:
    if type(given) is not int or not 0 <= given <= MAX_DIGITS:
        raise ModelError(f"'info.digits' must be a whole number up to {MAX_DIGITS}.")
    return given


def _nrmse(given: Any) -> Nrmse | None:
    if given is None:
        return None
    if not isinstance(given, dict) or set(given) != {"one_step", "free_run"}:
        raise ModelError("'info.nrmse' must give one_step and free_run.")
    finite = {n: numbers([v], "info.nrmse")[0] for n, v in given.items() if v is not None}
    return Nrmse(**{n: finite.get(n, math.inf) for n in ("one_step", "free_run")})


def _selection(given: Any) -> Selection:
    if given is None:
        return Selection()
    known = {f.name for f in fields(Selection)}
    if not isinstance(given, dict) or set(given) - known:
        raise ModelError(f"'info.selection' must be an object with some of the fields {', '.join(sorted(known))}.")
    base, reason, stable = given.get("base", ""), given.get("reason", ""), given.get("stable_law")
    candidates, chosen = given.get("candidates", 0), given.get("chosen", 0)
    if not isinstance(base, str) or not isinstance(reason, str) or not isinstance(stable, (bool, type(None))):
        raise ModelError("'info.selection' must give base and reason as texts, stable_law as true or false.")
    if type(candidates) is not int or type(chosen) is not int:
        raise ModelError("'info.selection' must give candidates and chosen as whole numbers.")
    err = tuple(numbers(given.get("err", []), "info.selection.err"))
    return Selection(base, candidates, chosen, reason, err, stable)


def read_effects(listed: Any, symbols: Mapping[str, Any]) -> list[AddedEffect]:
    """Build the added effects from plain data; their symbols are the model's, given by name.

    Raises
    ------
    ModelError
        For a field that is missing or of the wrong kind, and for a symbol that is no parameter.
    """
    if not isinstance(listed, list) or len(listed) > MAX_EFFECTS:
        raise ModelError(f"'effects' must be a list of at most {MAX_EFFECTS} entries.")
    found = []
    for one in listed:
        if not isinstance(one, dict) or not {"effect", "coefficients"} <= set(one) <= EFFECT:
            raise ModelError(f"each of 'effects' is an object with the fields {', '.join(sorted(EFFECT))}.")
        if not all(isinstance(one.get(n, ""), str) for n in ("effect", "form", "where", "driver", "group")):
            raise ModelError("'effects' must name effect, form, where, driver and group by texts.")
        named = [one.get(n, {}) for n in ("coefficients", "shape")]
        if not all(isinstance(d, dict) and all(isinstance(v, str) for v in d.values()) for d in named):
            raise ModelError("'effects' must give coefficients and shape as parameters by the effect's own names.")
        unknown = [s for d in named for s in d.values() if s not in symbols]
        if unknown:
            raise ModelError(f"'effects' speaks of {unknown[0][:40]!r}, which is no parameter.")
        fixed = one.get("fixed", {})
        if not isinstance(fixed, dict) or any(v != int(v) for v in numbers(list(fixed.values()), "effects.fixed")):
            raise ModelError("'effects': 'fixed' must be an object of whole numbers.")
        made: dict[str, Any] = {n: one[n] for n in ("effect", "form", "where", "driver", "group") if n in one}
        made |= {n: {o: symbols[s] for o, s in one.get(n, {}).items()} for n in ("coefficients", "shape")}
        full = one.get("full", False)
        if not isinstance(full, bool):
            raise ModelError("'effects': 'full' must be true or false.")
        found.append(AddedEffect(**made, fixed={n: int(v) for n, v in fixed.items()}, full=full))
    return found


def texts(data: Mapping[str, Any], name: str) -> list[str]:
    """Return a list of texts from plain data."""
    value = data.get(name, [])
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise ModelError(f"{name!r} must be a list of texts.")
    if len(value) > MAX_LISTED:
        raise ModelError(f"{name!r} has more than {MAX_LISTED} entries.")
    return value


def numbers(values: Any, name: str, finite: bool = True) -> list[float]:
    """Return a list of numbers from plain data."""
    good = isinstance(values, list) and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    if not good or not all(abs(v) < 1e308 for v in values if finite or v == v):
        raise ModelError(f"{name!r} must hold finite numbers.")
    return [float(v) for v in values]


# -- schema 1 --------------------------------------------------------------------------------------------------


def newer_schema(data: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of schema 1 as schema 2 has it.

    There, standard errors were `std`, effects stood in `info`, and what an effect brought was told by the names of its
    symbols: `c_backlash`, `r_backlash`, `c2_hysteresis`.
    """
    made = {n: v for n, v in data.items() if n != "std"} | {"schema": 2}
    if "std" in data:
        made["standard_errors"] = data["std"]
    if "info" in data and not isinstance(data["info"], dict):
        raise ModelError("'info' must be an object.")
    info = dict(data.get("info", {}))
    effects = info.pop("effects", [])
    if isinstance(effects, list):  # what is wrong in it is said where it is read
        effects = [_newer_effect(one) if isinstance(one, dict) else one for one in effects]
    known = {f.name for f in fields(Info)}
    return made | {"info": {n: v for n, v in info.items() if n in known}, "effects": effects}


def _newer_effect(one: dict[str, Any]) -> dict[str, Any]:
    made = dict(one)
    for name in ("coefficients", "shape"):
        made[name] = {symbol.partition("_")[0]: symbol for symbol in texts(one, name)}
    groups = {symbol.partition("_")[2] for symbol in made["coefficients"].values()}
    return {"group": min(groups, default="")} | made
