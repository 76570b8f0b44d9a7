"""Effects that a user writes as text in a file: read by the grammar of `parsing`, nothing is evaluated."""

from __future__ import annotations

import inspect
import math
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import sympy as sp

from ...errors import ModelError, NarxError
from ...symbolic.functions import NAMES
from ...symbolic.grammar import LARGEST, SIGNALS, parse, read_json
from ...symbolic.recursion import Recursion, State, written_out
from ...symbolic.signals import k, lag, samples, signal
from ._effect import COEFFICIENT, EFFECTS, PLACES, SCANS, SEQUENCES, Catalogue, Effect, Form, Scan, effect

MAX_BYTES, MAX_EFFECTS, MAX_PARTS, MAX_TEXT, MAX_WRITTEN = 200_000, 100, 20, 2000, 20_000
REQUIRED = ("id", "where", "z", "sentence")
FIELDS = {*REQUIRED, "driver", "scan", "states", "sign", "unit", "source", "form", "centred"}
STATE_FIELDS = {"state", "update", "initial"}
DRIVERS = ("u", "y", "uy", "t", "channel")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
RESERVED = {*SEQUENCES, *SIGNALS, *NAMES, "k", "pi", "prediction", "Ts"}


Texts = tuple[str, ...]


def _refuse(wrong: Any, said: str) -> None:
    """Refuse a file in which something is wrong."""
    if wrong:
        raise ModelError(said)


def _few(names: Iterable[Any]) -> str:
    return ", ".join(map(str, names))[:60]


class Written:
    """The equations of one effect as texts; called like the function of an effect.

    Attributes
    ----------
    z : tuple of texts
        One contribution per coefficient.
    states : tuple of (name, update, initial) texts
    shape : tuple of names
    steps : names of the shape parameters in whole samples, which may stand in a lag: `x[k-n]`
    """

    def __init__(self, z: Texts, states: tuple[tuple[str, str, str], ...], shape: Texts, steps: Texts):
        self.z, self.states, self.shape, self.steps = z, states, shape, steps
        self._read: dict[tuple[int, ...], Form] = {}
        form = self.read((1,) * len(steps))
        read = [*form.z, *(e for s in form.states for e in (s.right, s.initial))]
        bases = {s.base.name for e in read for s in samples(e)}
        names = {s.name for e in read for s in e.free_symbols if isinstance(s, sp.Symbol)}
        sequences = [n for n in SEQUENCES if n in bases]
        order = [*sequences, *(["Ts"] if "Ts" in names else []), *shape]
        kinds = inspect.Parameter.POSITIONAL_OR_KEYWORD
        self.__signature__ = inspect.Signature([inspect.Parameter(n, kinds) for n in order])
        self.__name__, self.__module__ = "written", "own"

    def read(self, values: tuple[int, ...]) -> Form:
        """Return the form in plain sequences and symbols, for given numbers of samples."""
        if values not in self._read:
            self._read[values] = self._form(values)
        return self._read[values]

    def _form(self, values: tuple[int, ...]) -> Form:
        names = [n for n, _, _ in self.states]

        def plain(text: str) -> Any:
            for name, value in zip(self.steps, values, strict=True):
                text = re.sub(rf"\[\s*k\s*([+-])\s*{name}\s*\]", rf"[k\g<1>{value}]", text)
            expr = parse(text, signals=[*SEQUENCES, *names], symbols=[*self.shape, "Ts"])
            foreign = [s for s in samples(expr) if s.base.name not in (*SEQUENCES, *names)]
            _refuse(foreign, f"{_few(foreign)} is not known here; write x[k] - x[k-1] for a difference.")
            return expr

        states = tuple(State(signal(n)[k], plain(update), plain(initial)) for n, update, initial in self.states)
        return Form(tuple(map(plain, self.z)), states)

    def __call__(self, **given: Any) -> Form:
        """Return the form over given sequences and shape parameters."""
        form = self.read(tuple(int(given[n]) for n in self.steps))
        known = {sp.Symbol(n, real=True): sp.sympify(given[n]) for n in (*self.shape, "Ts") if n in given}

        def written(expr: Any) -> Any:
            moved = {s: given[n][s.indices[0]] for s in samples(expr) if (n := s.base.name) in given}
            return expr.xreplace(known | moved)

        return Form(tuple(map(written, form.z)), tuple(s.map(written) for s in form.states))


def text_effect(data: Mapping[str, Any]) -> Effect:
    """Build an effect from plain data, as it stands in a file; see `load_effects`. It is not put into a catalogue.

    Raises
    ------
    ModelError
        For a missing, unknown or wrong field, and for an equation that cannot be computed.
    """
    _refuse(not isinstance(data, Mapping), "An effect is a table of fields.")
    name = data.get("id")
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ModelError(f"The 'id' of an effect is a plain name such as my_friction, not {str(name)[:40]!r}.")
    try:
        return _built(name, data)
    except NarxError as error:
        raise ModelError(f"Effect {name}: {error}") from None


def _built(name: str, data: Mapping[str, Any]) -> Effect:
    missing, unknown = next((f for f in REQUIRED if f not in data), ""), sorted(set(map(str, data)) - FIELDS)
    _refuse(missing, f"the field {missing!r} is missing.")
    _refuse(unknown, f"unknown field {_few(unknown)!r}; there are {', '.join(sorted(FIELDS))}.")
    places = _places(data)
    scan = {p: _scan(p, rule) for p, rule in _table(data, "scan").items()}
    states = _states(data, set(scan))
    z = tuple(_text(e, "z") for e in (data["z"] if isinstance(data["z"], list) else [data["z"]]))
    _refuse(not 1 <= len(z) <= MAX_PARTS, f"'z' is an equation or a list of 1 to {MAX_PARTS}.")
    for p in scan:
        taken = not NAME.fullmatch(p) or p in RESERVED or COEFFICIENT.fullmatch(p)
        _refuse(taken, f"the shape parameter {p[:40]!r} needs another name.")
        read = any(re.search(rf"\b{p}\b", e) for e in (*z, *(s[1] for s in states)))
        _refuse(not read, f"the shape parameter {p!r} has a scan rule, but no equation contains it.")
    try:
        function = Written(z, states, tuple(scan), tuple(p for p, s in scan.items() if s.of == "steps"))
    except NarxError as error:
        raise ModelError(f"{error} (A shape parameter needs a rule in 'scan'.)") from None
    for steps in _corners(scan):
        _computable(function.read(steps), places, tuple(scan))
    for p, unit in _table(data, "unit").items():
        _refuse(p not in scan, f"'unit' names {p[:40]!r}, which is not a shape parameter.")
        scan[p] = replace(scan[p], unit=_text(unit, "unit"))
    sign, centred = data.get("sign", 0), data.get("centred", False)
    said = "'sign' is 1 where only a positive coefficient means this effect, else 0."
    _refuse(type(sign) is not int or sign not in (0, 1), said)
    _refuse(not isinstance(centred, bool), "'centred' is true or false.")
    words: dict[str, Any] = {n: _text(data.get(n, ""), n) for n in ("sentence", "source", "form")}
    _refuse(not words["sentence"].strip(), "'sentence' says in plain words what the effect does.")
    share = (0.0 if sign else -math.inf, math.inf)
    made = effect(places, scan=scan, share=share, id=name, centred=centred, register=False, **words)(function)
    unread = "channel" not in made.arguments and any("channel" in d for d in places.values())
    _refuse(unread, "the driver is 'channel', and no equation uses channel[k].")
    return made


def load_effects(path: Any, catalogue: Catalogue = EFFECTS) -> list[Effect]:
    r"""Read effects from a TOML or JSON file and put them into a catalogue. If one is wrong, none is added.

    Equations are texts. They may contain samples of `x` (the driving signal), `u`, `y`, `t` (time in s), `channel` and
    the effect's own states, its shape parameters, the sampling time `Ts`, and numbers::

        [[effect]]
        id = "my_stick_slip"
        where = "output"            # a place (see PLACES), a list, or { output = ["u", "y"], inside = "y" }
        driver = "u"                # u, y, uy, t or channel
        z = "tanh((x[k] - x[k-1])/s)"
        scan = { s = { of = "speed", values = [0.1, 0.5, 1.5] } }
        unit = { s = "V per sample" }
        sentence = "My own friction."
        source = "Smith 2020"

        [[effect]]
        id = "my_play"
        where = "input"
        z = ["p[k] - x[k]"]         # one coefficient for each
        states = [{ state = "p", update = "Max(x[k] - w, Min(x[k] + w, p[k-1]))", initial = "x[k]" }]
        scan = { w = "amplitude" }  # the usual values
        sign = 1                    # only a positive coefficient means this effect
        sentence = "Slack before the input."

    A JSON file has the same fields in a list called "effect". A shape parameter with a scan of "steps" may be a lag:
    `x[k-n]`. If its unit is "samples", it is adapted to the sampling rate of the record.

    Parameters
    ----------
    path : str or Path
        The file.
    catalogue : Catalogue
        Where the effects are added.

    Returns
    -------
    list of Effect, in the order of the file

    Raises
    ------
    ModelError
        For a file that cannot be read, a wrong field or equation, or an effect that is in the catalogue already.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import narx_sym as ns
    >>> path = pathlib.Path(tempfile.mkdtemp(), "mine.toml")
    >>> lines = "[[effect]];id = 'my_bend';where = 'input';driver = 'u';z = 'x[k]**5';sentence = 'A bend.'"
    >>> _ = path.write_text(lines.replace(";", "\n"))
    >>> ns.load_effects(path, ns.effects.Catalogue())
    [Effect(my_bend)]
    """
    source = Path(path)
    try:
        with source.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
        if len(raw) > MAX_BYTES:
            raise ModelError(f"{path}: the file is larger than {MAX_BYTES} bytes; this is no file of effects.")
        text = raw.decode("utf-8").replace("\r\n", "\n")
        data = read_json(text) if source.suffix.lower() == ".json" else tomllib.loads(text)
    except FileNotFoundError:
        raise ModelError(f"{path}: no such file of effects.") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except NarxError:
        raise
    except (ValueError, RecursionError) as error:
        kind = "JSON" if source.suffix.lower() == ".json" else "TOML"
        raise ModelError(f"{path}: no valid {kind}: {str(error)[:80]}.") from None
    listed = data.get("effect") if isinstance(data, dict) and set(data) == {"effect"} else None
    if not isinstance(listed, list) or not 1 <= len(listed) <= MAX_EFFECTS:
        raise ModelError(f"{path}: write effects as [[effect]] tables, 1 to {MAX_EFFECTS}, and nothing else.")
    try:
        found = [text_effect(one) for one in listed]
    except NarxError as error:
        raise ModelError(f"{path}: {error}") from None
    keys = [(e.id, e.form) for e in found]
    for one, key in zip(found, keys, strict=True):
        # The same file may be read again.
        there = [f for f in catalogue.get(one.id, []) if f.form == one.form and not isinstance(f.function, Written)]
        if there or keys.count(key) > 1:
            raise ModelError(f"{path}: there is an effect {one.id!r} already; choose another id, or another 'form'.")
    for one in found:
        catalogue.add(one)
    return found


def _text(value: Any, field: str) -> str:
    too_long = f"'{field}' must be a text of at most {MAX_TEXT} characters."
    _refuse(not isinstance(value, str) or len(value) > MAX_TEXT, too_long)
    return str(value)


def _table(data: Mapping[str, Any], field: str) -> dict[str, Any]:
    value = data.get(field, {})
    wrong = not isinstance(value, Mapping) or len(value) > MAX_PARTS
    _refuse(wrong, f"'{field}' is a table with one entry per shape parameter.")
    return {str(n): v for n, v in value.items()}


def _listed(value: Any, field: str, known: Collection[str], what: str) -> Texts:
    found = tuple(value) if isinstance(value, list) else (value,)
    plain = found and all(isinstance(v, str) for v in found) and len(set(found)) == len(found)
    _refuse(not plain, f"'{field}' is a text or a list of different ones.")
    wrong = [v for v in found if v not in known]
    _refuse(wrong, f"a {what} is one of {', '.join(known)}, not {_few(wrong)!r}.")
    return found


def _places(data: Mapping[str, Any]) -> dict[str, Texts]:
    """Return the drivers of each place."""
    where = data["where"]
    if isinstance(where, Mapping):
        _refuse("driver" in data, "give 'driver', or drivers in 'where', not both.")
        places = _listed([*map(str, where)], "where", PLACES, "place")
        return {p: _listed(d, "where", DRIVERS, "driver") for p, d in zip(places, where.values(), strict=True)}
    places = _listed(where, "where", PLACES, "place")
    return dict.fromkeys(places, _listed(data.get("driver", "u"), "driver", DRIVERS, "driver"))


def _scan(name: str, rule: Any) -> Scan:
    """Read the scan rule of a shape parameter: its kind alone, or a table."""
    table: Any = {"of": rule} if isinstance(rule, str) else rule
    known = isinstance(table, Mapping) and {"of"} <= set(table) <= {"of", "values", "power"}
    _refuse(not known, f"the scan rule of {name[:40]!r} has the fields of, values and power.")
    of = table["of"]
    wrong = not isinstance(of, str) or of not in SCANS
    _refuse(wrong, f"a scan is of {', '.join(SCANS)}, not {str(of)[:40]!r}.")
    values, power = table.get("values", list(SCANS[of].values)), table.get("power", 1)
    good = isinstance(values, list) and 1 <= len(values) <= 50
    good = good and all(type(v) in (int, float) and 0 <= v < math.inf for v in map(_float, values))
    must = f"the scan values of {name!r} must be"
    _refuse(not good, f"{must} 1 to 50 numbers, none negative.")
    whole = all(float(v).is_integer() and v <= 1000 for v in values)
    _refuse(of == "steps" and not whole, f"{must} whole samples up to 1000.")
    _refuse(of == "time" and max(values) > 1, f"{must} between 0 (a few samples) and 1 (a part of the record).")
    _refuse(of in ("amplitude", "speed", "gain") and min(values) == 0, f"{must} above 0.")
    small = type(power) is int and abs(power) <= 3
    _refuse(not small, f"the scan power of {name!r} is a whole number from -3 to 3.")
    return Scan(of, tuple(values), power)


def _float(value: Any) -> Any:
    """Return a whole number as a float, infinite where it is too large for one."""
    return (float(value) if abs(value) < LARGEST else math.inf) if type(value) is int else value


def _states(data: Mapping[str, Any], shape: set[str]) -> tuple[tuple[str, str, str], ...]:
    listed, found = data.get("states", []), dict[str, tuple[str, str, str]]()
    many = not isinstance(listed, list) or len(listed) > MAX_PARTS
    _refuse(many, f"'states' is a list of at most {MAX_PARTS} tables.")
    for one in listed:
        known = isinstance(one, Mapping) and {"state", "update"} <= set(one) <= STATE_FIELDS
        _refuse(not known, "a state has the fields state, update and initial (0 unless given).")
        name, update, initial = (_text(one.get(n, "0"), n) for n in ("state", "update", "initial"))
        taken = not NAME.fullmatch(name) or name in {*RESERVED, *shape, *found}
        _refuse(taken, f"the state {name[:40]!r} needs another name.")
        found[name] = (name, update, initial)
    return tuple(found.values())


def _corners(scan: Mapping[str, Scan]) -> set[tuple[int, ...]]:
    """Return the smallest and the largest numbers of samples: equations are checked there."""
    stepped = [s.values for s in scan.values() if s.of == "steps"]
    return {tuple(int(end(v)) for v in stepped) for end in (min, max)}


def _computable(form: Form, places: Mapping[str, tuple[str, ...]], shape: tuple[str, ...]) -> None:
    """Refuse equations that need what is not known yet, at any of their places."""
    updates = [(s.left, s.right) for s in form.states]
    updates += [(signal(f"contribution_{i}")[k], e) for i, e in enumerate(form.z)]
    Recursion(tuple(updates), tuple(sp.Symbol(n, real=True) for n in (*shape, "Ts")))
    large = sum(written_out(e, form.states) for e in form.z) > MAX_WRITTEN
    _refuse(large, "the equations grow too large when the states are written out.")
    own, shapes = {s.left.base.name for s in form.states}, {sp.Symbol(n, real=True) for n in (*shape, "Ts")}
    for s in (s for _, right in updates for s in samples(right) if s.base.name not in own):
        late = s.base.name == "y" or (s.base.name == "x" and "y" in places.get("input", ()))
        _refuse(lag(s) < late, f"{s} is not known at time k there; use earlier samples.")
    for state in form.states:
        begins = f"the initial value of {state.left}"
        foreign = [s for s in samples(state.initial) if s.base.name not in ("x", "u", "y") or lag(s) < 0]
        _refuse(foreign, f"{begins} may contain samples of x, u and y, not {_few(foreign)}.")
        shaped = state.initial.free_symbols & shapes
        _refuse(shaped, f"{begins} contains a shape parameter; only signals and numbers.")
