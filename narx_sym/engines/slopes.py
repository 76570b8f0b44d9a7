"""A recursion with its derivatives, compiled: derived once, and kept between processes with its machine code."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from ..symbolic.recursion import Recursion
from ..symbolic.sensitivity import sensitivities
from .compile import Compiled, compile, has_llvm, written

Names = list[dict[str, str]]


@lru_cache(maxsize=512)
def with_slopes(
    recursion: Recursion, groups: tuple[tuple[Any, ...], ...], fixed: tuple[Any, ...] = ()
) -> tuple[Compiled, Names]:
    """Return a compiled recursion with its derivatives.

    Parameters
    ----------
    groups : tuples of states
        The starts of each move together, in one more direction.
    fixed : parameters that have no direction

    Returns
    -------
    compiled : Compiled
    directions : list of dict from a state's name to that of its derivative, one per parameter and group
    """

    def derived() -> tuple[Recursion, Names]:
        made, directions = sensitivities(recursion, [p for p in recursion.parameters if p not in fixed], groups)
        return made, [{str(s.label): str(d.label) for s, d in moved.items()} for moved in directions]

    def make() -> tuple[Compiled, Names]:
        made, names = derived()
        return Compiled.made(made, "native"), names

    if not has_llvm():
        made, names = derived()
        return compile(made), names
    initial = [[str(base.label) for base in group] for group in groups]
    return Compiled.kept(f"with slopes {initial} {fixed} {written(recursion)}", make)
