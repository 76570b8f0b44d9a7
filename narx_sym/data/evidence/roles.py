"""What the further columns of a record are: said by the user, seen in the numbers, or guessed from name and unit."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from difflib import get_close_matches
from itertools import pairwise
from typing import Any

import numpy as np

from ...errors import DataError

Array = np.ndarray
SETPOINT, INPUT, OUTPUT, DISTURBANCE, IGNORE = "setpoint", "input", "output", "disturbance", "ignore"
DERIVATIVE, INTEGRAL, COPIES = "derivative-of-y", "integral-of-y", {"copy-of-y": "output", "copy-of-u": "input"}
ACTING = (INPUT, DISTURBANCE)  # what may act on the machine beside its input
ROLES = (SETPOINT, INPUT, OUTPUT, DERIVATIVE, INTEGRAL, DISTURBANCE, IGNORE, *COPIES)
SETPOINTS = {"setpoint", "sp", "sv", "ref", "reference", "command", "cmd", "target", "demand", "desired", "goal"}
RATES = {"velocity", "vel", "speed", "rate", "dot", "dy", "dydt"}
FURTHER = re.compile(r"(u|in|input|mv)_?[2-9]", re.IGNORECASE)
PART = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
ROUNDING = 1e-9  # of a number, after a few additions
SINGLE = 1.2e-7  # step of single precision
GUESS = "channel '{}'"  # begins what is said of one that is guessed
DIGITS = range(1, 10)  # that a file may have of each number
WHOLE = 1e-6  # of the last digit: rounding
FEWEST, LONG = 20, 20_000  # samples: fewer may be alike by chance; so many are looked at
UNLIKE = 0.1  # of a signal's standard deviation: what another one leaves is no more where both are the same


def is_setpoint(name: str) -> bool:
    """Whether a channel has the name of a setpoint: r, "Setpoint [m3/h]" as Setpoint_m3_h, GoalPosition, speed_ref."""
    name = name.removeprefix("channel_")
    parts = [part.lower() for part in PART.findall(name)]
    said = {*parts[:1], *parts[-1:], "".join(parts[:2])}  # "Set Point" is one word too
    return name.lower().partition("_")[0] == "r" or not SETPOINTS.isdisjoint(said)


def check_roles(roles: Mapping[str, str]) -> dict[str, str]:
    """Return roles by name; DataError for one that does not exist."""
    if not isinstance(roles, Mapping):
        raise DataError('roles must be a mapping of names to roles, such as {"command": "setpoint"}')
    for name, role in roles.items():
        if role not in ROLES:
            meant = get_close_matches(str(role), ROLES, n=1)
            raise DataError(
                f"'{name}' has the unknown role {role!r}{f', did you mean {meant[0]}?' if meant else ''}; roles are "
                f"{', '.join(ROLES)}"
            )
    return dict(roles)


def found_role(name: str, x: Array, u: Array, y: Array, units: Mapping[str, str]) -> tuple[str, str]:
    """Return the role of a channel of which nothing is said, and why; without a reason it is a disturbance.

    Parameters
    ----------
    name : of the channel
    x, u, y : (N,) arrays, contiguous: the channel, the input, and the output
    units : of the signals by name, where they are known
    """
    enough = x.size >= FEWEST and np.ptp(x) > 0
    if enough:
        for role, words, (a, b), (digits_a, digits_b) in _relations(x, u, y):
            if _same(a, b, digits_a, digits_b):
                return role, f"is the {words}, as its values show"
    if is_setpoint(name):
        return SETPOINT, "is assumed to be the setpoint of a controller, because of its name"
    if FURTHER.fullmatch(name):
        return INPUT, "is assumed to be a further input of the machine, because of its name"
    rate = not RATES.isdisjoint(map(str.lower, PART.findall(name))) or _rate_unit(units.get(name), units.get("y"))
    if enough and rate and _integrates(x, y):
        return DERIVATIVE, (
            "is assumed to be the derivative of the output, because of its name or unit, and its integral"
        )
    return DISTURBANCE, ""


def _relations(x: Array, u: Array, y: Array) -> Iterator[tuple[str, str, tuple[Array, Array], tuple[float, float]]]:
    """Yield role, words, two signals that are the same up to scale and offset in that role, and their resolutions."""
    of_x, of_y = _resolution(x), _resolution(y)
    for (role, word), of, digits in zip(COPIES.items(), (y, u), (of_y, _resolution(u)), strict=True):
        for pair in _shifted(x, of):
            yield role, f"{word} again", pair, (of_x, digits)
    for role, word, rate, level, own, step in (  # a difference is of two rounded numbers
        (DERIVATIVE, "derivative of the output", x, y, of_x, 2 * of_y),
        (INTEGRAL, "integral of the output", y, x, of_y, 2 * of_x),
    ):
        middle = 0.5 * (rate[1:] + rate[:-1])
        differences = [(middle, np.diff(level)), *_shifted(rate[1:], np.diff(level))]
        differences.append((rate[1:-1], level[2:] - level[:-2]))
        for pair in differences:
            yield role, word, pair, (own, step)
    twice = np.diff(y, 2)
    for a, b in ((x[1:-1], twice), (x[2:], twice), (x[2:-2], y[4:] - 2 * y[2:-2] + y[:-4])):
        yield DERIVATIVE, "second derivative of the output", (a, b), (of_x, 4 * of_y)


def _shifted(a: Array, b: Array) -> Iterator[tuple[Array, Array]]:
    """Yield two signals at the same sample, and one sample apart either way."""
    n = min(a.size, b.size)
    yield a[:n], b[:n]
    yield a[1:n], b[: n - 1]
    yield a[: n - 1], b[1:n]


def _same(a: Array, b: Array, digits_a: float, digits_b: float) -> bool:
    """Whether a is b times a factor and an offset, as far as their digits tell; too few digits do not count."""
    spread, size = np.std(a), np.max(np.abs(a), initial=0.0)
    if np.ptp(b) == 0 or np.ptp(a) <= ROUNDING * size:
        return False
    slope = np.dot(a - a.mean(), b - b.mean()) / np.dot(b - b.mean(), b - b.mean())
    allowed = max(min(digits_a + abs(slope) * digits_b, UNLIKE * spread), ROUNDING * size)
    return bool(np.max(np.abs(a - a.mean() - slope * (b - b.mean()))) <= allowed)


def _resolution(x: Array) -> float:
    """Return the last digit in which the largest number of a signal is written, 0 where all digits are used."""
    some = np.abs(x[x != 0])
    exponent = np.floor(np.log10(some))
    for digits in DIGITS:
        told = some * 10.0 ** (digits - 1 - exponent)
        if some.size and np.all(np.abs(told - np.rint(told)) <= WHOLE):
            return float(10.0 ** (exponent.max() - digits + 1))
    return SINGLE * float(np.max(some, initial=0.0)) if np.array_equal(x, x.astype(np.float32)) else 0.0


def _integrates(x: Array, y: Array) -> bool:
    """Whether y is the integral of x, with an offset of x, but for noise."""
    columns = np.column_stack([np.cumsum(x - x.mean()), np.arange(x.size), np.ones(x.size)])
    drift = columns[:, 1:]
    alone = y - drift @ np.linalg.lstsq(drift, y, rcond=None)[0]
    return bool(np.std(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) <= UNLIKE * np.std(alone) > 0)


def _rate_unit(own: str | None, of_y: str | None) -> bool:
    """Whether a unit is that of the output per time."""
    from ..units import converted

    return bool(own and of_y and any(converted(1.0, own, f"{of_y}/{time}") is not None for time in ("s", "s^2")))


def column_roles(
    said: Mapping[str, str], channels: Mapping[str, Array], u: Array, y: Array, units: Mapping[str, str],
    breaks: tuple[int, ...] = (),
) -> tuple[dict[str, str], list[str]]:  # fmt: skip
    """Return the roles of all channels, what is ignored too, and what to say about those that nobody said.

    Parameters
    ----------
    breaks : where segments begin after a gap; the longest is looked at, from where the channel moves
    """
    roles = {n: role for n, role in check_roles(said).items() if n in channels or role == IGNORE}
    begin, end = max(pairwise((0, *breaks, u.size)), key=lambda edges: edges[1] - edges[0])
    told = []
    for name, x in channels.items():
        if name not in roles:
            moves = begin + int(np.argmax(x[begin:end] != x[begin]))
            rows = slice(max(moves - 1, 0), min(moves + LONG, end))
            roles[name], why = found_role(name, x[rows], u[rows], y[rows], units)
            if why:
                then = (
                    "if there was no controller, use --open-loop, or"
                    if roles[name] == SETPOINT
                    else ("if this is wrong,")
                )
                part = (
                    "is an input of a narx, linear or static base model, with its own lags"
                    if roles[name] == INPUT
                    else "is not used as an input"
                )
                told.append(f"{GUESS.format(name)} {why}, and {part}; {then} use --role {name}={DISTURBANCE}")
    return roles, told


def with_roles(record: Any, roles: Mapping[str, str] | None) -> Any:
    """Return a record in which some channels have these roles, whatever was guessed; DataError for no channel."""
    if stray := [n for n in check_roles(roles or {}) if n not in record.roles]:
        there = ", ".join(record.channels) or "none"
        raise DataError(
            f"record '{record.name}': there is no channel {stray[0]!r} to give a role to; there are {there}"
        )
    guesses = tuple(f"{GUESS.format(name)} " for name in roles or {})
    notes = tuple(note for note in record.notes if not (guesses and note.startswith(guesses)))
    return replace(record, roles={**record.roles, **(roles or {})}, notes=notes)


def roles_of(text: str) -> dict[str, str]:
    """Turn "command=setpoint,temp=disturbance" into roles by name; DataError for what is none."""
    found = {}
    for part in filter(str.strip, text.split(",")):
        name, told, role = part.rpartition("=")
        if not told or not name.strip():
            raise DataError(f"--role {text}: give names with their roles, such as command=setpoint,temp=disturbance")
        found[name.strip()] = role.strip()
    return check_roles(found)


def acting(record: Any) -> list[str]:
    """Return the names of the channels of a record that may act on the machine."""
    return [name for name in record.channels if record.roles[name] in ACTING]
