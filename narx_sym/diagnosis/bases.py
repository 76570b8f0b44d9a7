"""The base in words: the user's own terms, in a confusion set."""

BASE = "base"


def words(name: str) -> str:
    """Return the name of an effect, a run or a panel as words."""
    return "the base" if name == BASE else name.replace("_", " ")
