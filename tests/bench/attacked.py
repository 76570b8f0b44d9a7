"""The law of an attacked model in C, in Structured Text, and in plain Python, beside the machine code."""

from __future__ import annotations

import importlib.util
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "codegen"))
from exported import Subject
from languages import arguments, in_st, stepped

from narx_sym.engines.compile import compile
from narx_sym.fit.laws.driven import driven
from narx_sym.fit.simulate import rest_states

WIDE = (-1e9, 1e9)  # limits that never act


class Given(Subject):
    """A law that reads what it is given."""

    def waves(self, n: int) -> Any:
        """What the law reads, by name, in the order in which the sources take it."""
        return {str(base.label): self.given[str(base.label)] for base in self.recursion.inputs}

    def rests(self, source: str) -> list[float]:
        """Where the law starts, in the order of its C source."""
        return [self.at_rest(re.sub(r"_sig\d*$", "", name)) for name in arguments(source, "law_init")]


def gaps(run: Any) -> dict[str, float]:
    """Return how far other languages are from the machine code, in sizes of the input.

    Raises
    ------
    NotInvertible
        Where the law has no closed form.
    """
    law, first = run.law, {name: float(c[0]) for name, c in run.law.named(run.channels).items()}
    rest = rest_states(law.model, run.u0, run.y0, first) | {"m": run.u0, "r": run.y0, "y": run.y0, **first}
    options = {"limits": WIDE, "share": None}
    source = law.export("c", **options)
    given = Given(law.limited(WIDE), run.model.values, law, rest, given={"r": run.y, **law.named(run.channels)})
    n = run.y.size - run.ahead
    expected = law.follow(run.y, run.u0, run.channels, **options).m[:n]
    size = max(1.0, float(np.abs(expected).max()))
    plain = compile(law.limited(WIDE), "python")
    found = {"Python": driven(law, plain, run.y, run.u0, law.named(run.channels), on_divergence="nan")["m"][:n]}
    if shutil.which("gcc"):
        steps = {name: x[:n] for name, x in given.steps(n).items()}
        with tempfile.TemporaryDirectory() as folder:
            found["C"] = stepped(Path(folder), source, "law", steps, given.rests(source))
    if importlib.util.find_spec("blark"):
        found["ST"] = in_st(given.export("st", "law", **options), given, n, None)
    return {language: float(np.abs(x[:n] - expected).max()) / size for language, x in found.items()}
