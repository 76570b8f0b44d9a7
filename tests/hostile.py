"""What a stranger may put into terms, files of effects and model files; and the one judge of how it is taken.

`pick` is a `random.Random`: the tests and `bench/fuzz.py` draw from the same source.
"""

from __future__ import annotations

import copy
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from narx_sym.errors import ModelError, NarxError, ParseError
from narx_sym.files.store import load
from narx_sym.models.effects import Catalogue, load_effects
from narx_sym.symbolic import functions
from narx_sym.symbolic.grammar import parse

# ---------------------------------------------------------------- text terms

NAMES = ("u", "y", "phi1", "phi2", "x", "t", "k", "z", "theta_1", "os", "__class__", "e", "nan", "inf", "pi", "é")
NUMBERS = (
    "0", "1", "2", "16", "17", "99999", "0.5", "1e-300", "1e300", "1e999", "-1", ".5", "5.", "007", "1" * 400, "9" * 5000,
    "1e-5000", "1E+16", "nan", "inf", "Infinity", "0x10", "1_000", "1j", "٣",
)  # fmt: skip
LAGS = (
    "",
    "-1",
    "-2",
    "+1",
    "-0",
    "-100000",
    "-100001",
    "-1000000000",
    "-10**9",
    "--1",
    "-1.5",
    "-" + "9" * 4000,
    "*2",
)
SPLICES = (
    "", "(", ")", "[", "]", "**", "*", "/", "+", "-", ",", ";", "\n", "\0", "'", '"', "#", "9**9**9", "((((", "k", "[k-1]", "u[k",
    "import os", "__import__('os').system('true')", "eval(", "lambda: 0", "(" * 50, "-" * 500, "2**" * 60, "u[k-10**9]",
    "../../etc/passwd", "file:///etc/passwd", "\u202e", "\ud800", "{", "}", "<script>", "%s", "\\", "1/0", "0**0", "exp(1e9)",
)  # fmt: skip
TERMS = (
    "y[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "u[k-1]**2*y[k-1]", "abs(u[k])*sign(y[k-2])", "Max(u[k]-0.5, Min(u[k]+0.5, y[k-1]))",
    "tanh(u[k-1]/0.3)", "1.5e-3*u[k]", "sqrt(u[k]**2 + 1)", "(u[k]-u[k-1])/(1 + abs(y[k-1]))", "exp(-(u[k]/2)**2)", "-y[k-1] + 3",
)  # fmt: skip


def grown(pick: Random, depth: int = 4) -> str:
    """A text of the grammar, with leaves that are mostly good."""
    kind = pick.random()
    if depth == 0 or kind < 0.25:
        name = pick.choice(NAMES[:4] if pick.random() < 0.9 else NAMES)
        lag = pick.choice(LAGS[:3] if pick.random() < 0.9 else LAGS)
        return f"{name}[k{lag}]" if pick.random() < 0.97 else name
    if kind < 0.35:
        return pick.choice(NUMBERS[:7] if pick.random() < 0.8 else NUMBERS)
    inner = [grown(pick, depth - 1) for _ in range(pick.randint(1, 3))]
    if kind < 0.6:
        return pick.choice(("+", "-", " + ")).join(inner)
    if kind < 0.8:
        return pick.choice(("*", "*", "/")).join(f"({e})" if pick.random() < 0.5 else e for e in inner)
    if kind < 0.9:
        return f"({inner[0]})**{pick.choice(NUMBERS[:5] if pick.random() < 0.8 else (*NUMBERS, *inner))}"
    return f"{pick.choice((*functions.NAMES, 'eval', 'open'))}({', '.join(inner[: 1 if pick.random() < 0.8 else 3])})"


def mutated(pick: Random, text: str) -> str:
    """Cut, double, swap or splice pieces of a text."""
    for _ in range(pick.randint(1, 4)):
        a, b = sorted(pick.randint(0, len(text)) for _ in range(2))
        way = pick.randrange(6)
        if way == 0:
            text = text[:a] + text[b:]
        elif way == 1:
            text = text[:b] + text[a:]
        elif way == 2:
            text = text[:a] + pick.choice(SPLICES) + text[a:]
        elif way == 3:
            text = text[:a] + pick.choice(NUMBERS) + text[b:]
        elif way == 4:
            text = text[:a] + chr(pick.choice((pick.randrange(128), pick.randrange(0xD800)))) + text[a:]
        else:
            text = text[:a] + text[a:b] * pick.choice((2, 3, 50)) + text[b:]
        text = text[:30_000]
    return text


def term(pick: Random) -> str:
    """One text term from a stranger."""
    way = pick.random()
    if way < 0.4:
        return grown(pick)
    if way < 0.8:
        return mutated(pick, pick.choice(TERMS) if way < 0.6 else grown(pick, 3))
    return "".join(pick.choice((*SPLICES, *NUMBERS[:9], *TERMS, *NAMES)) for _ in range(pick.randint(1, 6)))[:30_000]


# ---------------------------------------------------------------- files

PLAY = {"state": "p", "update": "Max(u[k] - r, Min(u[k] + r, p[k-1]))", "initial": "u[k]", "group": "backlash"}
MODELS: tuple[dict[str, Any], ...] = (
    {"schema": 1, "kind": "narx", "input": "u", "output": "y", "terms": ["y[k-1]", "phi1[k-1]"], "theta": [1.0, 0.7],
     "Ts": 0.01, "lead": 0, "operating_point": {"u": 0.3, "y": -2.0}, "constraints": ["continuum"], "std": [None, 0.1],
     "symbols": ["theta_1", "theta_2"], "channels": [], "info": {"ranges": {"u": [-1, 1]}, "line": [0, 1], "steps": {"u": 1}}},
    {"schema": 1, "kind": "equation", "input": "u", "output": "y", "F": "a*y[k-1] + p[k]", "symbols": ["a", "r"],
     "theta": [0.5, 0.1], "states": [PLAY],
     "info": {"effects": [{"effect": "backlash", "coefficients": ["a"], "shape": ["r"], "fixed": {}}]}},
    {"schema": 1, "kind": "narx", "input": "y", "output": "u", "terms": ["u[k-1]", "temp[k]*y[k]"], "theta": None, "lead": 2,
     "channels": ["temp"]},
)  # fmt: skip
EFFECTS: tuple[dict[str, Any], ...] = (
    {"id": "soft_start", "where": "input", "driver": "u", "z": "-x[k]*exp(-(x[k]/s)**2)", "sentence": "Less around zero.",
     "scan": {"s": {"of": "amplitude", "values": [0.2, 0.5, 1.0]}}, "unit": {"s": "V"}, "source": "a notebook"},
    {"id": "my_play", "where": ["input", "output"], "z": ["p[k] - x[k]"], "scan": {"w": "amplitude"}, "sign": 1,
     "states": [{"state": "p", "update": "Max(x[k] - w, Min(x[k] + w, p[k-1]))", "initial": "x[k]"}], "sentence": "Slack."},
    {"id": "late", "where": {"output": ["u", "y"]}, "z": "x[k-n] - x[k]", "scan": {"n": {"of": "steps", "values": [1, 5]}},
     "sentence": "A delay."},
)  # fmt: skip
ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 10**9, 10**400, 1e308, -0.0, 1e-320, float("nan"), float("inf"), "", "u", "y", "t", "x", "k",
    "../../../etc/passwd", "/dev/zero", "continuum", "theta_1 - 2", [], {}, [[]], [None], {"u": None}, "a" * 30_000, ["y[k-1]"] * 3,
    ["y[k-1]"] * 3000, [[[[[[[[]]]]]]]], {"u": {"u": {"u": 1}}}, "\ud800", "\0", "__class__", [1e400], [True, False], "9**9**9",
)  # fmt: skip


def spoiled(pick: Random, data: Any) -> Any:
    """Change a few places of a nested structure."""
    data = copy.deepcopy(data)
    for _ in range(pick.choice((1, 1, 1, 2, 3))):
        spots: list[tuple[Any, Any]] = []

        def walk(one: Any, spots: list[tuple[Any, Any]] = spots) -> None:
            for key in one if isinstance(one, dict) else range(len(one)):
                spots.append((one, key))
                if isinstance(one[key], (dict, list)):
                    walk(one[key])

        walk(data)
        if not spots:
            break
        where, key = pick.choice(spots)
        way, now = pick.random(), where[key]
        if way < 0.7 and isinstance(now, str):
            where[key] = (
                mutated(pick, now) if pick.random() < 0.3 else grown(pick) if pick.random() < 0.6 else term(pick)
            )
        elif way < 0.78:
            where[key] = copy.deepcopy(pick.choice(ODD))
        elif way < 0.84:
            del where[key]
        elif way < 0.9 and isinstance(where, list):
            where.extend(copy.deepcopy(where) * pick.choice((1, 2, 100)))
        elif way < 0.95 and isinstance(where, dict):
            where[pick.choice((*NAMES, "schema", "states", "info", "../x"))] = copy.deepcopy(pick.choice((now, *ODD)))
        else:
            where[key] = [now] if pick.random() < 0.5 else {"u": now}
    return data


def written(data: Any) -> str:
    """JSON that also has what JSON forbids: NaN, Infinity, lone surrogates."""
    return json.dumps(data)


def toml(data: Any) -> str:
    """The same in TOML; what TOML cannot say stays as JSON says it."""
    if isinstance(data, dict):
        return "{ " + ", ".join(f"{json.dumps(str(n))} = {toml(v)}" for n, v in data.items()) + " }"
    return "[" + ", ".join(map(toml, data)) + "]" if isinstance(data, list) else json.dumps(data)


def model_file(pick: Random) -> bytes:
    """A model file from a stranger."""
    text = written(spoiled(pick, pick.choice(MODELS)))
    return _bytes(pick, text)


def effect_file(pick: Random) -> tuple[str, bytes]:
    """Suffix and content of a file of effects from a stranger."""
    listed = [spoiled(pick, pick.choice(EFFECTS)) if pick.random() < 0.9 else pick.choice(EFFECTS)]
    if pick.random() < 0.1:
        listed *= pick.choice((2, 101))
    if pick.random() < 0.5:
        return ".json", _bytes(pick, written({"effect": listed}))
    tables = []
    for one in listed:
        lines = [f"{n} = {toml(v)}" for n, v in one.items()] if isinstance(one, dict) else []
        tables.append("\n".join(["[[effect]]", *lines]))
    return ".toml", _bytes(pick, "\n".join(tables))


def _bytes(pick: Random, text: str) -> bytes:
    if pick.random() < 0.15:
        text = mutated(pick, text)
    elif pick.random() < 0.05:
        text = text.replace("{", '{"schema": 1, "z": 1, ', 1) if pick.random() < 0.5 else text + text
    raw = text.encode("utf-8", "surrogatepass")
    if pick.random() < 0.05:
        at = pick.randint(0, len(raw))
        raw = raw[:at] + bytes(pick.randrange(256) for _ in range(pick.randint(0, 4))) + raw[at + pick.randint(0, 4) :]
    return raw


# ---------------------------------------------------------------- the judge


class Judge:
    """Give an input to the reader it is meant for; anything but a result or the documented error is a fault."""

    def __init__(self, folder: Path | None = None):
        self.folder = Path(folder or tempfile.mkdtemp(prefix="narx_fuzz_"))
        self.read = self.refused = 0

    def term(self, pick: Random) -> Any:
        """Read a term."""
        text = term(pick)
        return text, lambda: self._try(ParseError, lambda: parse(text))

    def model(self, pick: Random) -> Any:
        """Read a model file."""
        raw, path = model_file(pick), self.folder / "m.json"
        path.write_bytes(raw)
        return raw, lambda: self._try(ModelError, lambda: load(path))

    def effect(self, pick: Random) -> Any:
        """Read a file of effects."""
        suffix, raw = effect_file(pick)
        path = self.folder / f"e{suffix}"
        path.write_bytes(raw)
        return raw, lambda: self._try(ModelError, lambda: load_effects(path, Catalogue({})))

    def _try(self, documented: type[NarxError], read: Callable[[], Any]) -> Any:
        try:
            found = read()
        except documented as error:
            said = str(error)
            assert said and len(said) < 2000, f"a message of {len(said)} characters"
            self.refused += 1
            return None
        self.read += 1
        return found
