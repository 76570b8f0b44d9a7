"""Model files: JSON in a versioned schema. Terms are text in the grammar of `parsing`; nothing is evaluated."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from sympy import Eq, Indexed

from .analysis import continuum_conditions
from .errors import ModelError, NarxError
from .files import write_text
from .model import NARX, Model
from .parsing import parse
from .printing import text
from .signals import u, y

SCHEMA, MAX_BYTES = 1, 2_000_000
FIELDS = {
    "schema", "kind", "terms", "F", "symbols", "theta", "std", "input", "output", "lead", "operating_point", "Ts",
    "constraints", "channels", "info",
}  # fmt: skip


def to_dict(model: Model) -> dict[str, Any]:
    """Return the model as plain data."""
    linear = isinstance(model, NARX)
    return {
        "schema": SCHEMA,
        "kind": "narx" if linear else "equation",
        "input": str(model.input.label),
        "output": str(model.output.label),
        "lead": model.lead,
        "Ts": model.Ts,
        "operating_point": {str(b.label): v for b, v in model.operating_point.items()},
        **({"terms": [text(t) for t in model.terms]} if isinstance(model, NARX) else {"F": text(model.F)}),
        "symbols": [str(s) for s in model.symbols],
        "theta": None if model.theta is None else model.theta.tolist(),
        "std": None if model.std is None else [s if math.isfinite(s) else None for s in model.std],
        "constraints": [c if isinstance(c, str) else text(c.lhs - c.rhs) for c in model.constraints],
        "channels": list(model.channels),
        "info": model.info,
    }


def save(model: Model, path: Any) -> None:
    """Write a model file; it appears whole or not at all."""
    write_text(path, json.dumps(to_dict(model), indent=1, sort_keys=True, allow_nan=False) + "\n")


def load(path: Any) -> Model:
    """Read a model file.

    Raises
    ------
    ModelError
        For a file that is missing, not JSON, of another schema, or with unknown, missing or wrong fields.
    """
    source = Path(path)
    try:
        if source.stat().st_size > MAX_BYTES:
            raise ModelError(f"{path}: the file is larger than {MAX_BYTES} bytes; this is not a model file.")
        data = json.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file.") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{path}: not a model file (no valid JSON: {str(error)[:80]}).") from None
    try:
        return from_dict(data)
    except NarxError as error:
        raise ModelError(f"{path}: {error}") from None


def from_dict(data: Any) -> Model:
    """Build a model from plain data; everything is checked before it is used."""
    if not isinstance(data, dict) or "schema" not in data:
        raise ModelError("not a model file: the field 'schema' is missing.")
    if type(data["schema"]) is not int or data["schema"] != SCHEMA:
        raise ModelError(f"schema {str(data['schema'])[:40]!r} is not known; this version reads schema {SCHEMA}.")
    unknown = sorted(set(data) - FIELDS)
    if unknown:
        raise ModelError(f"unknown field {unknown[0][:40]!r}; a newer version may have written this file.")
    channels = _texts(data, "channels")
    symbols = _texts(data, "symbols")
    bases = {"u": u, "y": y}
    if [data.get("input"), data.get("output")] not in (["u", "y"], ["y", "u"]):
        raise ModelError("'input' and 'output' must be 'u' and 'y', or 'y' and 'u'.")
    point = data.get("operating_point", {})
    if not isinstance(point, dict) or not set(point) <= {"u", "y"}:
        raise ModelError("'operating_point' must give numbers for 'u' and 'y'.")
    lead = data.get("lead", 0)
    if not isinstance(lead, int) or isinstance(lead, bool) or not 0 <= lead <= 1000:
        raise ModelError("'lead' must be a whole number from 0 to 1000.")
    if lead and data["input"] == "u":
        raise ModelError("'lead' belongs to an inverse model (input 'y').")
    theta = None if data.get("theta") is None else _numbers(data["theta"], "theta")
    options: dict[str, Any] = {
        "input": bases[data["input"]],
        "output": bases[data["output"]],
        "operating_point": {bases[n]: _numbers([v], "operating_point")[0] for n, v in point.items()},
        "lead": lead,
        "Ts": None if data.get("Ts") is None else _numbers([data["Ts"]], "Ts")[0],
    }
    model: Model
    if data.get("kind") == "narx":
        terms = [parse(t, signals=channels) for t in _texts(data, "terms")]
        model = NARX(terms, theta, **options)
        if symbols and symbols != [str(s) for s in model.symbols]:
            raise ModelError("'symbols' do not belong to 'terms': theta_1 ... theta_n, one per term.")
    elif data.get("kind") == "equation":
        if not isinstance(data.get("F"), str):
            raise ModelError("'F' must be a text.")
        expr = parse(data["F"], signals=channels, symbols=symbols)
        names = {s.name: s for s in expr.free_symbols if hasattr(s, "name")}
        missing = [n for n in symbols if n not in names]
        if missing:
            raise ModelError(f"the parameter {missing[0]!r} does not appear in 'F'.")
        model = Model(expr, [names[n] for n in symbols], theta, **options)
    else:
        raise ModelError(f"'kind' must be 'narx' or 'equation', not {str(data.get('kind'))[:40]!r}.")
    model.constraints = tuple(
        c if c == "continuum" else _equation(c, [str(s) for s in model.symbols]) for c in _texts(data, "constraints")
    )
    if model.Ts is not None and model.Ts <= 0:
        raise ModelError("'Ts' must be a positive number of seconds.")
    if any(abs(v) > 1e15 for v in model.operating_point.values()):
        raise ModelError("'operating_point' is beyond 1e15.")
    unused = set(channels) - set(model.channels)
    if unused:
        raise ModelError(f"the channel {sorted(unused)[0][:40]!r} appears in no term.")
    _check_constraints(model)
    std = data.get("std")
    if std is not None:
        values = [float("nan") if s is None else s for s in std] if isinstance(std, list) else std
        model.std = tuple(_numbers(values, "std", finite=False))
        if len(model.std) != len(model.symbols) or any(s < 0 for s in model.std):
            raise ModelError("'std' must have one number per parameter, none negative.")
    info = data.get("info", {})
    model.info = _checked_info(info)
    return model


def _check_constraints(model: Model) -> None:
    """Refuse values that break the constraints they are said to meet."""
    equations = [e for c in model.constraints for e in (continuum_conditions(model) if c == "continuum" else [c])]
    for equation in equations:
        gap = (equation.lhs - equation.rhs).xreplace(model.values)
        if gap.atoms(Indexed):
            raise ModelError("'constraints' speak of the parameters only.")
        if model.values and abs(float(gap)) > 1e-6 * (1 + max(abs(v) for v in model.values.values())):
            raise ModelError(f"theta does not meet the constraint {equation.lhs} = {equation.rhs}.")


def _equation(source: str, symbols: list[str]) -> Any:
    return Eq(parse(source, symbols=symbols), 0, evaluate=False)


def _texts(data: dict[str, Any], name: str) -> list[str]:
    value = data.get(name, [])
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise ModelError(f"{name!r} must be a list of texts.")
    if len(value) > 2000:
        raise ModelError(f"{name!r} has more than 2000 entries.")
    return value


def _numbers(values: Any, name: str, finite: bool = True) -> list[float]:
    good = isinstance(values, list) and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    if not good or (finite and not all(abs(v) < 1e308 for v in values)):
        raise ModelError(f"{name!r} must hold finite numbers.")
    return [float(v) for v in values]


def _checked_info(info: Any) -> dict[str, Any]:
    if not isinstance(info, dict):
        raise ModelError("'info' must be an object.")
    if "line" in info and len(_numbers(info["line"], "info.line")) != 2:
        raise ModelError("'info.line' must hold two numbers.")
    ranges = info.get("ranges", {})
    if not isinstance(ranges, dict) or not all(
        len(pair := _numbers(v, "info.ranges")) == 2 and pair[0] < pair[1] for v in ranges.values()
    ):
        raise ModelError("'info.ranges' must give two increasing numbers for each signal.")
    return info
