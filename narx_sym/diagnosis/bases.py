"""The base in words: the user's own terms, in a confusion set."""

import re
from collections.abc import Iterable

BASE = "base"


def spaced(name: str) -> str:
    """Return the id of an effect as words; a channel is called as the user calls it."""
    effect, colon, channel = name.partition(":")
    return re.sub(r"\b(coulomb|stribeck)\b", lambda found: found[0].title(), effect.replace("_", " ")) + colon + channel


def words(name: str) -> str:
    """Return the name of an effect, a run or a panel as words."""
    return "the base" if name == BASE else spaced(name)


def joined(names: Iterable[str]) -> str:
    """Return names as one text: a, b and c."""
    listed = list(names)
    return " and ".join([", ".join(listed[:-1]), listed[-1]] if len(listed) > 1 else listed)


def percent_of(probability: float) -> str:
    """Return a probability in percent; never all or nothing."""
    most = 1 - probability < 0.005
    return "more than 99 %" if most else "less than 1 %" if probability < 0.01 else f"{100 * probability:.0f} %"
