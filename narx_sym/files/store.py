"""Model files: JSON in a versioned schema. Equations are text in the grammar of `parsing`; nothing is evaluated.

The equations of added effects stand in the file, as states: it is read without the catalogue that they came from.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sympy import Eq, Indexed, Symbol, expand, true
from sympy.core.assumptions import _assume_defined as assumed_of
from sympy.core.facts import InconsistentAssumptions

from ..errors import ModelError, NarxError
from ..models.model import NARX, Model
from ..models.rest.equilibria import continuum_conditions
from ..models.rest_map import rest_map
from ..symbolic.functions import NAMES
from ..symbolic.grammar import SIGNALS, expanded_terms, parse, read_json
from ..symbolic.printing import text
from ..symbolic.recursion import State, written_out
from ..symbolic.signals import k, lag, samples, sensed, signal, u, x, y
from .atomic import write_text
from .info import effect_to_dict, info_to_dict, newer_schema, numbers, or_none, read_effects, read_info, texts

SCHEMA, MAX_BYTES, MAX_STATES, MAX_NAME = 2, 2_000_000, 200, 100
MAX_TEXT = 60_000  # characters of all equations
MAX_WRITTEN, MAX_TERMS = 20_000, 20_000  # nodes of the output's equation; terms of its rest map, multiplied out
FIELDS = {
    "schema", "kind", "terms", "F", "symbols", "theta", "standard_errors", "input", "output", "lead", "operating_point",
    "Ts", "constraints", "channels", "states", "info", "effects", "assumptions", "bounds",
}  # fmt: skip
STATE_FIELDS = {"state", "update", "initial", "group"}
# `x`, `v`, `free`, `sensed` and `acting` are names of states: see `narx_sym.symbolic.signals`.
RESERVED = {*SIGNALS, *NAMES, "k", "t", "r", "m", "pi", "prediction"}


def to_dict(model: Model) -> dict[str, Any]:
    """Return the model as plain data."""
    linear = isinstance(model, NARX)
    names = {"parameter": list(map(str, model.symbols)), "channel": list(model.channels)}
    for what, listed in (names | {"state": [s.left.base.name for s in model.states]}).items():
        _check_names(listed, what, set())
    return {
        "schema": SCHEMA,
        "kind": "narx" if linear else "equation",
        "input": model.input.name,
        "output": model.output.name,
        "lead": model.lead,
        "Ts": model.Ts,
        "operating_point": {b.name: v for b, v in model.operating_point.items()},
        **({"terms": [text(t) for t in model.terms]} if isinstance(model, NARX) else {"F": text(model.F)}),
        "symbols": [str(s) for s in model.symbols],
        **({"assumptions": assumed} if (assumed := _assumptions(model)) else {}),
        "theta": None if model.theta is None else model.theta.tolist(),
        "standard_errors": None if model.standard_errors is None else [or_none(s) for s in model.standard_errors],
        "constraints": [
            c if isinstance(c, str) else text(expand(c.lhs - c.rhs)) for c in model.constraints if c != true
        ],
        "channels": list(model.channels),
        **({"states": [_state_to_dict(s) for s in model.states]} if model.states else {}),
        "info": info_to_dict(model.info),
        **({"effects": [effect_to_dict(e) for e in model.effects]} if model.effects else {}),
        **({"bounds": {str(s): list(pair) for s, pair in model.bounds.items()}} if model.bounds else {}),
    }


def to_text(model: Model) -> str:
    """Return the content of a model file, which `load` surely reads.

    Raises
    ------
    ModelError
        For an equation that the grammar has no words for, such as a Piecewise.
    """
    written = json.dumps(to_dict(model), indent=1, sort_keys=True, allow_nan=False) + "\n"
    try:
        from_dict(read_json(written))
    except NarxError as error:
        raise ModelError(f"A model file could not be read again: {error}") from None
    return written


def save(model: Model, path: Any) -> None:
    """Write a model file; it appears whole or not at all, and only where it can be read again, else ModelError."""
    write_text(path, to_text(model))


def load(path: Any) -> Model:
    """Read a model file.

    Raises
    ------
    ModelError
        For a file that is missing, not JSON, of another schema, or with unknown, missing or wrong fields.
    """
    source = Path(path)
    try:
        with source.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
        if len(raw) > MAX_BYTES:
            raise ModelError(f"{path}: the file is larger than {MAX_BYTES} bytes; this is not a model file.")
        data = read_json(raw.decode("utf-8"))
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file.") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except NarxError:
        raise
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{path}: not a model file (no valid JSON: {str(error)[:80]}).") from None
    try:
        return from_dict(data)
    except NarxError as error:
        raise ModelError(f"{path}: {error}") from None


def from_dict(data: Any) -> Model:  # noqa: C901, PLR0912, PLR0915
    """Build a model from plain data; everything is checked before it is used."""
    if not isinstance(data, dict) or "schema" not in data:
        raise ModelError("not a model file: the field 'schema' is missing.")
    if type(data["schema"]) is not int or data["schema"] not in (1, SCHEMA):
        raise ModelError(f"schema {str(data['schema'])[:40]!r} is not known; this version reads schema 1 and {SCHEMA}.")
    if data["schema"] == 1:
        data = newer_schema(data)
    unknown = sorted(set(data) - FIELDS)
    if unknown:
        raise ModelError(f"unknown field {unknown[0][:40]!r}; a newer version may have written this file.")
    channels = texts(data, "channels")
    symbols = texts(data, "symbols")
    _check_names(channels, "channel", set())
    _check_names(symbols, "parameter", set())
    kind = data.get("kind")
    terms = texts(data, "terms") if kind == "narx" else []
    named = [f"theta_{i}" for i in range(1, len(terms) + 1)] if kind == "narx" else symbols
    parameters = _parameters(named, data.get("assumptions", {}))
    constraints = texts(data, "constraints")
    length = sum(map(len, (*terms, *constraints, str(data.get("F", "")), *map(str, _listed_states(data)))))
    if length > MAX_TEXT:
        raise ModelError(f"the equations have {length} characters; at most {MAX_TEXT} are read.")
    states = _states(data, channels, parameters)
    signals = [*channels, "t", *(s.left.base.name for s in states)]
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
    theta = None if data.get("theta") is None else numbers(data["theta"], "theta")
    options: dict[str, Any] = {
        "input": bases[data["input"]],
        "output": bases[data["output"]],
        "operating_point": {bases[n]: numbers([v], "operating_point")[0] for n, v in point.items()},
        "lead": lead,
        "Ts": None if data.get("Ts") is None else numbers([data["Ts"]], "Ts")[0],
        "states": states,
    }
    model: Model
    if kind == "narx":
        model = NARX([parse(term, signals=signals) for term in terms], theta, **options)
        if symbols and symbols != [str(s) for s in model.symbols]:
            raise ModelError("'symbols' do not belong to 'terms': theta_1 ... theta_n, one per term.")
    elif kind == "equation":
        if not isinstance(data.get("F"), str):
            raise ModelError("'F' must be a text.")
        expr = parse(data["F"], signals=signals, symbols=parameters)
        free = expr.free_symbols.union(*(s.right.free_symbols for s in states))
        missing = [s.name for s in parameters if s not in free]
        if missing:
            raise ModelError(f"the parameter {missing[0][:40]!r} does not appear in 'F'{' or a state' * bool(states)}.")
        model = Model(expr, parameters, theta, **options)
    else:
        raise ModelError(f"'kind' must be 'narx' or 'equation', not {str(data.get('kind'))[:40]!r}.")
    model = model.replace(
        constraints=[c if c == "continuum" else _equation(c, model.symbols) for c in constraints],
        standard_errors=_standard_errors(data.get("standard_errors"), len(model.symbols)),
        info=read_info(data.get("info", {})),
        effects=read_effects(data.get("effects", []), {str(s): s for s in model.symbols}),
        bounds=_bounds(data.get("bounds", {}), {str(s): s for s in model.symbols}),
    )
    if model.Ts is not None and model.Ts <= 0:
        raise ModelError("'Ts' must be a positive number of seconds.")
    if any(abs(v) > 1e15 for v in model.operating_point.values()):
        raise ModelError("'operating_point' is beyond 1e15.")
    unused = set(channels) - set(model.channels)
    if unused:
        raise ModelError(f"the channel {sorted(unused)[0][:40]!r} appears in no term.")
    _check_states(model)
    _check_size(model)
    _check_constraints(model)
    return model


def _assumptions(model: Model) -> dict[str, dict[str, bool]]:
    """Return what is assumed of each parameter, without those that are real and nothing else."""
    found = {str(s): {n: v for n, v in s._assumptions_orig.items() if v is not None} for s in model.symbols}
    return {name: of for name, of in found.items() if of != {"real": True}}


def _parameters(names: list[str], assumed: Any) -> list[Symbol]:
    """Return the parameters with what is assumed of them; real where nothing is said."""
    if not isinstance(assumed, dict) or not set(assumed) <= set(names):
        raise ModelError("'assumptions' must be an object that speaks of parameters.")
    for name, of in assumed.items():
        if not isinstance(of, dict) or not set(of) <= assumed_of or not all(isinstance(v, bool) for v in of.values()):
            raise ModelError(f"'assumptions' of {name[:40]!r} must be true or false, such as {{'positive': true}}.")
    try:
        return [Symbol(n, **assumed.get(n, {"real": True})) for n in names]
    except InconsistentAssumptions:
        raise ModelError("'assumptions' contradict each other.") from None


def _bounds(given: Any, symbols: dict[str, Any]) -> dict[Any, tuple[float, float]]:
    if not isinstance(given, dict) or not set(given) <= set(symbols):
        raise ModelError("'bounds' must be an object that speaks of parameters.")
    found = {symbols[name]: tuple(numbers(pair, "bounds")) for name, pair in given.items()}
    if any(len(pair) != 2 or pair[0] >= pair[1] for pair in found.values()):
        raise ModelError("'bounds' must be two numbers each, the lower one first.")
    return found  # type: ignore[return-value]


def _standard_errors(given: Any, count: int) -> list[float] | None:
    if given is None:
        return None
    given = [math.nan if s is None else s for s in given] if isinstance(given, list) else given
    found = numbers(given, "standard_errors", finite=False)
    if len(found) != count or any(s < 0 for s in found):
        raise ModelError("'standard_errors' must have one number per parameter, none negative.")
    return found


def _check_size(model: Model) -> None:
    """Refuse equations that grow without bound where algebra writes them out."""
    size = written_out(model.F, model.states)
    if model.inner == x:
        core, beside = (written_out(e, model.states) for e in (model.core, model.beside))
        size = core + (1 + len(samples(model.core, x))) * beside
    if size > MAX_WRITTEN or ("continuum" in model.constraints and expanded_terms(rest_map(model)) > MAX_TERMS):
        raise ModelError("the equations grow too large when they are written out; this is not a model of measurements.")


def _check_constraints(model: Model) -> None:
    """Refuse values that break the constraints they are said to meet."""
    equations = [e for c in model.constraints for e in (continuum_conditions(model) if c == "continuum" else [c])]
    for equation in equations:
        gap = (equation.lhs - equation.rhs).xreplace(model.values)
        if gap.atoms(Indexed):
            raise ModelError("'constraints' speak of the parameters only.")
        try:
            size = abs(float(gap)) if model.values else 0.0
        except (TypeError, ValueError, OverflowError):
            size = math.nan
        if not math.isfinite(size):
            raise ModelError(f"the constraint {str(equation.lhs)[:200]} = {equation.rhs} has no finite value.")
        if size > 1e-6 * (1 + max((abs(float(v)) for v in model.values.values()), default=0.0)):
            raise ModelError(f"theta does not meet the constraint {str(equation.lhs)[:200]} = {equation.rhs}.")


def _state_to_dict(state: State) -> dict[str, str]:
    return {
        "state": state.left.base.name, "update": text(state.right), "initial": text(state.initial),
        "group": state.group,
    }  # fmt: skip


def _states(data: dict[str, Any], channels: list[str], symbols: list[Symbol]) -> tuple[State, ...]:
    """Read the states in order; whether each has what it needs is checked by the recursion."""
    listed = _listed_states(data)
    for one in listed:
        if not isinstance(one, dict) or not all(isinstance(v, str) for v in one.values()):
            raise ModelError("each of 'states' must be an object of texts.")
        wrong = sorted(set(one) ^ STATE_FIELDS)
        if wrong and (wrong != ["group"] or "group" in one):
            raise ModelError(f"a state has the fields state, update, initial and group; look at {wrong[0][:40]!r}.")
        if len(one.get("group", "")) > MAX_NAME:
            raise ModelError(f"the group of a state has more than {MAX_NAME} characters.")
    names = [one["state"] for one in listed]
    if names:
        _check_names(names, "state", {*map(str, symbols), *channels})
    signals = [*channels, "t", *names]
    return tuple(
        State(
            signal(one["state"])[k], parse(one["update"], signals=signals, symbols=symbols),
            parse(one["initial"], signals=[*channels, "t"], symbols=symbols), one.get("group", ""),
        )
        for one in listed
    )  # fmt: skip


def _listed_states(data: dict[str, Any]) -> list[Any]:
    listed = data.get("states", [])
    if not isinstance(listed, list) or len(listed) > MAX_STATES:
        raise ModelError(f"'states' must be a list of at most {MAX_STATES} entries.")
    return listed


def _check_names(names: list[str], what: str, taken: set[str]) -> None:
    """Refuse names that the grammar cannot read back, or that mean something else."""
    for name in names:
        if not (name.isascii() and name.isidentifier()) or len(name) > MAX_NAME:
            raise ModelError(f"the {what} {name[:40]!r} needs a plain name: letters, digits and underscores.")
        if what == "state" and name in RESERVED:
            raise ModelError(f"the state {name!r} has a name that means something else.")
        if name in taken or names.count(name) > 1:
            raise ModelError(f"the name {name!r} of a {what} appears twice.")


def _check_states(model: Model) -> None:
    """Refuse states that cannot start, and an `x` that the output is not made of."""
    known = {model.input, model.output, *(b for b in model.recursion.inputs)}
    shown = [s.right for s in model.states if s.left.base == sensed]
    for state in model.states:
        for s in samples(state.initial):
            if s.base not in known or lag(s) < 0:
                raise ModelError(f"the initial value of {state.left} may contain measured signals up to now, not {s}.")
    if model.inner == x and not any(samples(e, x) for e in (model.F, *shown)):
        raise ModelError("there is a state 'x', what effects at the output add to, but the output does not contain it.")


def _equation(source: str, symbols: Sequence[Symbol]) -> Any:
    return Eq(parse(source, symbols=symbols), 0, evaluate=False)
