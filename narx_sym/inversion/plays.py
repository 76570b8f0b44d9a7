"""The inverse of a sum of plays is a sum of plays (Krejci & Kuhnen 2001): radii and weights by a recursion.

With P_j = play(w; r_j), r_0 = 0 < r_1 < ... and v = sum p_j P_j, whose slopes S_j = p_0 + ... + p_j are positive,

    w = v / S_0 - sum p_j / (S_j S_(j-1)) play(v; rho_j),   rho_j = sum_(i<j) p_i (r_j - r_i).

A play of radius rho_j takes every narrower play of the sum to P_j: play(v; rho_j) = S_j P_j + sum_(i>j) p_i P_i. So the
model's own plays say where those of the inverse were; the law has no memory beside them and goes on from where the
machine is when its input is held back. It needs plays that lie no further apart than their radii do; those that start
from the same input stay so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import sympy as sp

from ..symbolic.functions import KINKED
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import signal
from .breakpoints import FLAT
from .solution import Branch, Solution, number

FEWEST = 2  # one play alone has few kinks: its branches say more
SAME = 1e-9  # where plays are centred, relative


@dataclass(frozen=True)
class Play:
    """weight * Max(w - centre - radius, Min(w - centre + radius, held)) in a sum."""

    weight: Any
    radius: Any
    centre: Any
    held: Any
    size: float


def inverse_of(p: list[Any], r: list[Any]) -> tuple[list[Any], list[Any]]:
    """Return weights and radii of the inverse, the first radius 0.

    Parameters
    ----------
    p, r : weights p_0 ... p_n and radii r_0 = 0 ... r_n, in the order of the radii
    """
    slopes = list(accumulate(p))
    weights = [1 / slopes[0], *(-p[j] / (slopes[j] * slopes[j - 1]) for j in range(1, len(p)))]
    radii = [sp.Add(*(p[i] * (r[j] - r[i]) for i in range(j))) for j in range(len(p))]
    return weights, radii


def solve_plays(
    G: Any, w: Any, target: Any, values: Mapping[Any, Any], made: dict[str, Any], together: Mapping[Any, Any]
) -> Solution | None:
    """Solve a sum of the unknown and its plays; None where it is something else, or does not rise.

    Parameters
    ----------
    together : mapping from states to what they start from
    """
    found = _plays(G, w, values)
    if found is None:
        return None
    first, beside, plays = found
    starts = {together.get(getattr(one.held, "base", None)) for one in plays}
    if len(starts) > 1 or None in starts:
        return None
    slopes = [number(s, values) for s in accumulate([first, *(one.weight for one in plays)])]
    known = [s for s in slopes if s is not None]
    if len(known) < len(slopes) or min(known) <= FLAT * max(known):  # shares of a whole leave a slope of rounding
        return None
    p, r = [first, *(one.weight for one in plays)], [sp.S.Zero, *(one.radius for one in plays)]
    weights, radii = inverse_of(p, r)
    index, name = made["unknown"].indices[0], made["unknown"].base.name
    steps: list[tuple[str, Any]] = []

    def step(what: str, expr: Any) -> Any:
        steps.append((f"{name}_{what}", expr))
        return signal(f"{name}_{what}")[index]

    centre = plays[0].centre
    wanted = step("plays", target - beside - first * centre)
    total = wanted * weights[0]
    for j, one in enumerate(plays, 1):
        wider = sp.Add(*(other.weight * other.held for other in plays[j:]))
        held = step(f"held{j}", sp.Add(*p[: j + 1]) * one.held + wider)
        total += weights[j] * step(f"play{j}", sp.Max(wanted - radii[j], sp.Min(wanted + radii[j], held)))
    branches = (Branch(sp.true, total + centre),)
    return Solution(how="plays", branches=branches, steps=tuple(steps), steep=min(known), **made)


def _plays(G: Any, w: Any, values: Mapping[Any, Any]) -> tuple[Any, Any, list[Play]] | None:
    """Return the weight of w, what stands beside, and the plays by their radii; None for any other expression."""
    nodes = [n for n in G.atoms(sp.Max) if n.has(w)]
    if len(nodes) < FEWEST:
        return None
    names = {n: sp.Dummy(real=True) for n in nodes}
    outer = G.xreplace(names)
    plays = []
    for node, place in names.items():
        one = _play(node, w, derivative(outer, place), values)
        if one is None or one.weight.has(w, *names.values()):
            return None
        plays.append(one)
    first = derivative(outer, w)
    if first.has(w, *names.values()) or any(n.has(w) for n in outer.atoms(*KINKED)):  # the slope of a sign is zero
        return None
    apart = [number(one.centre - plays[0].centre, values) for one in plays]
    if any(a is None or abs(a) > SAME * max(one.size for one in plays) for a in apart):
        return None
    beside = outer.xreplace({w: sp.S.Zero, **dict.fromkeys(names.values(), sp.S.Zero)})
    return first, beside, sorted(plays, key=lambda one: one.size)


def _play(node: Any, w: Any, weight: Any, values: Mapping[Any, Any]) -> Play | None:
    """Read Max(w - a, Min(w + b, held)) as a play of radius (a + b)/2 around (a - b)/2."""
    inner = next((e for e in node.args if isinstance(e, sp.Min)), None)
    if inner is None or len(node.args) != 2 or len(inner.args) != 2:
        return None
    low = next(e for e in node.args if e is not inner)
    held = next((e for e in inner.args if not e.has(w)), None)
    high = next((e for e in inner.args if e.has(w)), None)
    if held is None or high is None or derivative(low, w) != 1 or derivative(high, w) != 1:
        return None
    a, b = -low.xreplace({w: sp.S.Zero}), high.xreplace({w: sp.S.Zero})
    size = number((a + b) / 2, values)
    return None if size is None or size <= 0 else Play(weight, (a + b) / 2, (a - b) / 2, held, size)
