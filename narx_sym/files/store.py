"""Model files: JSON in a versioned schema. Equations are text in the grammar of `parsing`; nothing is evaluated.

The equations of added effects stand in the file, as states: it is read without the catalogue that they came from.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sympy import Eq, Indexed, Symbol, expand, true
from sympy.core.assumptions import _assume_defined as assumed_of
from sympy.core.facts import InconsistentAssumptions

from ..errors import ModelError, NarxError
from ..models.model import NARX, Model
from ..models.rest.equilibria import continuum_conditions
from ..models.rest_map import rest_map
from ..models.system import System
from ..symbolic.functions import NAMES
from ..symbolic.grammar import SIGNALS, expanded_terms, parse, read_json
from ..symbolic.printing import text
from ..symbolic.recursion import State, written_out
from ..symbolic.signals import k, lag, samples, sensed, signal, u, x, y
from .atomic import write_text
from .info import EffectData, effect_to_dict, info_to_dict, newer_schema, or_none, read_info, to_effects
from .plain import read

SCHEMA, MAX_BYTES, MAX_STATES, MAX_NAME, MAX_LEAD, MAX_OUTPUTS = 2, 2_000_000, 200, 100, 1000, 50
MAX_TEXT = 60_000  # characters of all equations
MAX_WRITTEN, MAX_TERMS = 20_000, 20_000  # nodes of the output's equation; terms of its rest map, multiplied out
# `x`, `v`, `free`, `sensed` and `acting` are names of states: see `narx_sym.symbolic.signals`.
RESERVED = {*SIGNALS, *NAMES, "k", "t", "r", "m", "pi", "prediction"}


@dataclass(frozen=True)
class StateData:
    """A state in a file."""

    state: str
    update: str
    initial: str
    group: str = ""


@dataclass(frozen=True)
class ModelData:
    """The content of a model file."""

    schema: int
    kind: str
    input: str
    output: str
    terms: tuple[str, ...] = ()
    F: str | None = None
    symbols: tuple[str, ...] = ()
    theta: tuple[float, ...] | None = None
    standard_errors: tuple[float | None, ...] | None = None
    lead: int = 0
    operating_point: Mapping[str, float] = field(default_factory=dict)
    Ts: float | None = None
    constraints: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    states: tuple[StateData, ...] = ()
    info: Any = field(default_factory=dict)
    effects: tuple[EffectData, ...] = ()
    assumptions: Mapping[str, Mapping[str, bool]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class SystemData:
    """The content of the file of a model with several outputs: a model each, in order."""

    schema: int
    kind: str
    outputs: tuple[str, ...]
    parts: tuple[Any, ...]


def to_dict(model: Model | System) -> dict[str, Any]:
    """Return the model as plain data."""
    if isinstance(model, System):
        _check_names(model.outputs, "output", set())
        parts = [to_dict(part) for part in model.parts.values()]
        return {"schema": SCHEMA, "kind": "system", "outputs": list(model.outputs), "parts": parts}
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


def to_text(model: Model | System) -> str:
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


def save(model: Model | System, path: Any) -> None:
    """Write a model to a file (JSON) that `load` reads.

    The file is written completely or not at all.

    Raises
    ------
    ModelError
        For a model that cannot be read again from its file.
    DataError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import narx_sym as ns
    >>> path = pathlib.Path(tempfile.mkdtemp(), "model.json")
    >>> ns.save(ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2]), path)
    >>> path.exists()
    True
    """
    write_text(path, to_text(model))


def load_model(path: Any) -> Model:
    """Read a model with one output, as `load` does; refuse a `System`."""
    made = load(path)
    if isinstance(made, System):
        raise ModelError(
            f"{path}: this is a model with the outputs {', '.join(made.outputs)}; this needs one output. In Python, "
            "ns.load(...).parts has the model of each output, which ns.save writes."
        )
    return made


def load(path: Any) -> Any:
    """Read a model, or a `System` of models, from a file that `save` or the command line has written.

    Raises
    ------
    ModelError
        For a file that is missing, is not JSON, has another schema, or has unknown, missing or wrong fields.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import narx_sym as ns
    >>> path = pathlib.Path(tempfile.mkdtemp(), "model.json")
    >>> ns.save(ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2]), path)
    >>> print(*ns.load(path).lines(numbers=True))
    y[k] = 0.2*u[k-1] + 0.9*y[k-1]
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


def from_dict(data: Any) -> Model | System:
    """Build a model from plain data; everything is checked before it is used."""
    if isinstance(data, dict) and data.get("kind") == "system":
        found: SystemData = read(SystemData, data)
        if found.schema != SCHEMA:
            raise ModelError(f"schema {str(data['schema'])[:40]!r} is not known; this version reads schema {SCHEMA}.")
        if len(found.parts) != len(found.outputs) or len(found.parts) > MAX_OUTPUTS:
            raise ModelError(f"'parts' must have one model for each of 'outputs', and at most {MAX_OUTPUTS}.")
        _check_names(found.outputs, "output", set())
        return System(dict(zip(found.outputs, map(_model_of, found.parts), strict=True)))
    return _model_of(data)


def _model_of(data: Any) -> Model:
    if not isinstance(data, dict) or "schema" not in data:
        raise ModelError("not a model file: the field 'schema' is missing.")
    if type(data["schema"]) is not int or data["schema"] not in (1, SCHEMA):
        raise ModelError(f"schema {str(data['schema'])[:40]!r} is not known; this version reads schema 1 and {SCHEMA}.")
    file: ModelData = read(ModelData, newer_schema(data) if data["schema"] == 1 else data)
    _check_data(file)
    std = file.standard_errors
    made = _narx(file) if file.kind == "narx" else _equation_model(file)
    if std is not None and (len(std) != len(made.symbols) or any(s is not None and s < 0 for s in std)):
        raise ModelError("'standard_errors' must have one number per parameter, none negative.")
    model = made.replace(
        constraints=[
            c if c == "continuum" else Eq(parse(c, symbols=made.symbols), 0, evaluate=False) for c in file.constraints
        ],
        standard_errors=std and [math.nan if s is None else s for s in std],
        info=read_info(file.info),
        effects=to_effects(file.effects, {str(s): s for s in made.symbols}),
        bounds=_bounds(file.bounds, {str(s): s for s in made.symbols}),
    )
    unused = set(file.channels) - set(model.channels)
    if unused:
        raise ModelError(f"the channel {sorted(unused)[0][:40]!r} appears in no term.")
    _check_states(model)
    _check_size(model)
    _check_constraints(model)
    return model


def _check_data(file: ModelData) -> None:
    """Refuse what no model can be made of."""
    _check_names(file.channels, "channel", set())
    _check_names(file.symbols, "parameter", set())
    states = [s.state for s in file.states]
    _check_names(states, "state", {*file.symbols, *file.channels})
    written = (*file.terms, *file.constraints, file.F or "", *(s.update + s.initial for s in file.states))
    length = sum(map(len, written))
    if length > MAX_TEXT:
        raise ModelError(f"the equations have {length} characters; at most {MAX_TEXT} are read.")
    if len(states) > MAX_STATES:
        raise ModelError(f"'states' must be a list of at most {MAX_STATES} entries.")
    if any(len(s.group) > MAX_NAME for s in file.states):
        raise ModelError(f"the group of a state has more than {MAX_NAME} characters.")
    if (file.input, file.output) not in (("u", "y"), ("y", "u")):
        raise ModelError("'input' and 'output' must be 'u' and 'y', or 'y' and 'u'.")
    if not set(file.operating_point) <= {"u", "y"} or any(abs(v) > 1e15 for v in file.operating_point.values()):
        raise ModelError("'operating_point' must give numbers up to 1e15 for 'u' and 'y'.")
    if not 0 <= file.lead <= MAX_LEAD or (file.lead and file.input == "u"):
        raise ModelError(f"'lead' must be a number from 0 to {MAX_LEAD}, and only an inverse model (input 'y') has it.")
    if file.Ts is not None and file.Ts <= 0:
        raise ModelError("'Ts' must be a positive number of seconds.")
    if file.kind not in ("narx", "equation"):
        raise ModelError(f"'kind' must be 'narx' or 'equation', not {file.kind[:40]!r}.")


def _narx(file: ModelData) -> Model:
    parameters = _parameters([f"theta_{i}" for i in range(1, len(file.terms) + 1)], file.assumptions)
    known = _signals(file)
    model = NARX([parse(term, signals=known) for term in file.terms], file.theta, **_options(file, parameters))
    if file.symbols and file.symbols != tuple(map(str, model.symbols)):
        raise ModelError("'symbols' do not match 'terms': theta_1 ... theta_n, one per term.")
    return model


def _equation_model(file: ModelData) -> Model:
    if file.F is None:
        raise ModelError("'F' must be a text.")
    parameters = _parameters(file.symbols, file.assumptions)
    expr, options = parse(file.F, signals=_signals(file), symbols=parameters), _options(file, parameters)
    free = expr.free_symbols.union(*(s.right.free_symbols for s in options["states"]))
    missing = [s.name for s in parameters if s not in free]
    if missing:
        raise ModelError(
            f"the parameter {missing[0][:40]!r} does not appear in 'F'{' or a state' * bool(file.states)}."
        )
    return Model(expr, parameters, file.theta, **options)


def _signals(file: ModelData) -> list[str]:
    """Return the names of the signals beside input and output."""
    return [*file.channels, "t", *(s.state for s in file.states)]


def _options(file: ModelData, parameters: Sequence[Symbol]) -> dict[str, Any]:
    """Return what both kinds of models are made with."""
    bases, known, outer = {"u": u, "y": y}, _signals(file), [*file.channels, "t"]
    states = tuple(
        State(
            signal(one.state)[k],
            parse(one.update, signals=known, symbols=parameters),
            parse(one.initial, signals=outer, symbols=parameters),
            one.group,
        )
        for one in file.states
    )
    point = {bases[n]: value for n, value in file.operating_point.items()}
    return {
        "input": bases[file.input], "output": bases[file.output], "operating_point": point, "lead": file.lead,
        "Ts": file.Ts, "states": states,
    }  # fmt: skip


def _assumptions(model: Model) -> dict[str, dict[str, bool]]:
    """Return what is assumed of each parameter, without those that are real and nothing else."""
    found = {str(s): {n: v for n, v in s._assumptions_orig.items() if v is not None} for s in model.symbols}
    return {name: of for name, of in found.items() if of != {"real": True}}


def _parameters(names: Sequence[str], assumed: Mapping[str, Mapping[str, bool]]) -> list[Symbol]:
    """Return the parameters with what is assumed of them; real where nothing is said."""
    if not set(assumed) <= set(names) or not set().union(*assumed.values()) <= assumed_of:
        raise ModelError("'assumptions' must refer to parameters, such as {'positive': true}.")
    try:
        return [Symbol(n, **assumed.get(n, {"real": True})) for n in names]
    except InconsistentAssumptions:
        raise ModelError("'assumptions' contradict each other.") from None


def _bounds(given: Mapping[str, tuple[float, float]], symbols: dict[str, Any]) -> dict[Any, tuple[float, float]]:
    if not set(given) <= set(symbols) or any(low >= high for low, high in given.values()):
        raise ModelError("'bounds' must refer to parameters, the lower number first.")
    return {symbols[name]: pair for name, pair in given.items()}


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
            raise ModelError("'constraints' must refer to parameters only.")
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


def _check_names(names: Sequence[str], what: str, taken: set[str]) -> None:
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
        raise ModelError(
            "there is a state 'x' (the output before the effects at the output), but the output does not contain it."
        )
