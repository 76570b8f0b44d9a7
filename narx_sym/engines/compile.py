"""The bridge from symbols to numbers: recursions to functions over arrays, by one of several engines."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cache as once
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from ..errors import Diverged, ModelError
from ..files import cache
from ..inversion.solution import Root
from ..models.model import Model
from ..symbolic.recursion import Recursion
from .numbers import floats, lifted
from .plan import Plan

ENGINES = ("native", "casadi", "python")
Array = np.ndarray


@dataclass(frozen=True)
class Layout:
    """What a run must know of a recursion, in plain data.

    Attributes
    ----------
    states, inputs : sequence of str
    remembered : sequence of int
        Which states are used at a lag.
    parameters, depth, lead : int
    """

    states: Sequence[str]
    inputs: Sequence[str]
    remembered: Sequence[int]
    parameters: int
    depth: int
    lead: int

    @classmethod
    def of(cls, plan: Plan) -> Layout:
        """Read the layout off a plan: names once, SymPy's printer would take longer than a short run."""
        made = plan.recursion
        states, inputs = (tuple(base.name for base in bases) for bases in (made.states, made.inputs))
        remembered = tuple(sorted({s for s, i in plan.sample if i >= 1 and s < len(states)}))
        return cls(states, inputs, remembered, len(made.parameters), made.depth, made.lead)


class Compiled:
    """A recursion as a function over arrays; made by `compile`.

    Attributes
    ----------
    layout : Layout
    engine : str
    recursion : Recursion
        Its equations; None of a run with tangents.
    """

    def __init__(self, layout: Layout, run: Callable[..., int], engine: str, recursion: Any = None):
        self.layout, self.run, self.engine, self.recursion = layout, run, engine, recursion

    def __call__(
        self,
        inputs: Mapping[Any, Any],
        theta: Any = (),
        initial: Mapping[Any, Any] | None = None,
        length: int | None = None,
        start: int | None = None,
        on_divergence: str = "raise",
        out: Mapping[str, Array] | None = None,
        output: Any = None,
    ) -> dict[str, Array]:
        """Run over N samples.

        Parameters
        ----------
        inputs : mapping from a sequence or its name to (N,) arrays
            Where the recursion looks ahead, the last value is held.
        theta : (n_parameters,) array
        initial : mapping from a state or its name to a number or (>= start,) array
            The values before `start`; needed for each state that is used at a lag.
        length : int
            N, for a recursion without inputs.
        start : int
            The first k that is computed, at least `recursion.depth` (the default).
        on_divergence : "raise" or "nan"
            What happens at the first value that is not finite: an error, or NaN from there on.
        out : mapping from the states' names to contiguous (N,) float arrays, optional
            Where the results go: fits that run the same recursion many times save the allocation.
        output : a state or its name, optional
            The state that an error speaks of; by default the first one that is not finite.

        Returns
        -------
        dict from the states' names to (N,) arrays.

        Raises
        ------
        Diverged
            With the first bad sample.
        ModelError
            For missing or unequal inputs.
        """
        layout = self.layout
        given = _named(inputs)
        columns = []
        for name in layout.inputs:
            if name not in given:
                raise ModelError(f"The input sequence {name} is missing.")
            column = np.ascontiguousarray(floats(given[name]))
            if column.size != max(column.shape, default=1):
                raise ModelError(f"The input sequence {name} has shape {column.shape}; one of shape (N,) is needed.")
            columns.append(column.ravel())
        sizes = {c.size for c in columns} | ({length} if length is not None else set())
        if not sizes:  # nothing is read from the inputs: they only say how long the run is
            sizes = {np.size(x) for x in given.values()}
        if not sizes:
            raise ModelError("A recursion without inputs needs the length of the run.")
        if len(sizes) != 1:
            raise ModelError(f"The input sequences have different lengths: {sorted(map(str, sizes))}.")
        n = int(sizes.pop())
        first = max(layout.depth, start or 0)
        columns = self._ahead(columns)
        states = self._start(n, min(first, n), initial or {}, out or {})
        theta = np.ascontiguousarray(theta, dtype=float)
        if theta.shape != (layout.parameters,):
            raise ModelError(f"{layout.parameters} parameter values are needed, {theta.size} were given.")
        if n > first:
            reached = self.run([*states, *columns], theta, first, n)
            if reached < n:
                if on_divergence == "raise":
                    raise self._diverged(states, reached, output)
                for state in states:
                    state[reached:] = np.nan
        return dict(zip(layout.states, states, strict=True))

    def over(
        self,
        inputs: Mapping[str, Array],
        initial: Mapping[str, Any],
        out: Mapping[str, Array],
        beside: tuple[Array, ...] = (),
    ) -> Callable[[Array], None]:
        """Return run(theta) into arrays that stay where they are, for fits that run the same samples many times.

        Each call starts from what stands in the first `depth` samples of `out`, at first from `initial`; it leaves NaN
        from where the run diverges. `beside` is what else the machine code writes to, the first of them sample by
        sample.
        """
        columns = self._ahead([np.ascontiguousarray(inputs[name], dtype=float) for name in self.layout.inputs])
        n, first = len(next(iter(out.values()))), self.layout.depth
        states = self._start(n, min(first, n), initial, out)
        arrays = [*states, *columns, *beside]
        over = getattr(self.run, "over", None)
        move = over(arrays, first, n) if over else lambda theta: self.run(arrays, theta, first, n)

        def run(theta: Array) -> None:
            reached = move(theta) if n > first else n
            if reached < n:
                for state in (*states, *beside[:1]):
                    state[reached:] = np.nan

        return run

    def _ahead(self, columns: list[Array]) -> list[Array]:
        """Hold the last value of each input where the recursion looks ahead."""
        lead = self.layout.lead
        return [np.concatenate([c, np.repeat(c[-1:], lead)]) for c in columns] if lead else columns

    def _start(self, n: int, first: int, initial: Mapping[Any, Any], out: Mapping[str, Array]) -> list[Array]:
        given = _named(initial)
        states = []
        for position, name in enumerate(self.layout.states):
            state = out[name] if out else np.empty(n)
            if state.shape != (n,) or state.dtype != float or not state.flags.c_contiguous:
                raise ModelError(f"The result array of {name} must be a contiguous float array of shape ({n},).")
            value = given.get(name, None if position in self.layout.remembered else np.nan)
            if value is None:
                raise ModelError(f"The recursion needs {first} initial samples of {name}.")
            value = np.asarray(value, dtype=float).ravel()
            if value.size != 1 and value.size < first:
                raise ModelError(f"{name} needs {first} initial samples, {value.size} were given.")
            state[:first] = value if value.size == 1 else value[:first]
            states.append(state)
        return states

    def _diverged(self, states: list[Array], at: int, output: Any) -> Diverged:
        """Say where a run leaves the finite numbers: of the output, or else of the state that does so first."""
        bad = (i for i, x in enumerate(states) if not np.isfinite(x[at]))
        shown = next(bad, -1) if output is None else self.layout.states.index(str(getattr(output, "label", output)))
        before = ", ".join(f"{v:.3g}" for v in states[shown][max(0, at - 3) : at])
        return Diverged(
            f"The simulation of {self.layout.states[shown]} diverges: sample {at} is not finite (before it: {before}). "
            "Likely causes: an unstable model, an input far outside the identified range, or wrong initial values.",
            at,
            states[shown],
        )


def _named(mapping: Mapping[Any, Any]) -> dict[str, Any]:
    """Key by name: a sequence may stand for its name."""
    return {base if isinstance(base, str) else str(getattr(base, "label", base)): x for base, x in mapping.items()}


@lru_cache(maxsize=512)
def _compiled(recursion: Recursion, engine: str) -> Compiled:
    if engine != "native":
        plan = Plan.of(recursion)
        return Compiled(Layout.of(plan), import_module(f".{engine}", __package__).build(plan), engine, recursion)
    from .machine.native import bound, coded

    plain, numbers = lifted(recursion)

    def make() -> tuple[Any, bytes]:
        plan = Plan.of(plain)
        return astuple(Layout.of(plan)), coded(plan)

    told, code = kept(written(plain), make)
    layout = replace(Layout(*told), parameters=len(recursion.parameters))
    run = bound(code, len(layout.states) + len(layout.inputs), numbers)
    return Compiled(layout, run, engine, recursion)


def kept(recipe: str, make: Callable[[], tuple[Any, bytes]]) -> tuple[Any, Any]:
    """Return plain data and loaded machine code; from an earlier process if it was kept.

    `make` returns both; `recipe` tells all that they are made from.
    """
    from .machine.emitter import loaded, processor

    def together() -> bytes:
        told, code = make()
        return json.dumps(told).encode() + b"\n" + code

    content = cache.made("\n".join((processor(), _rules(), sp.__version__, recipe)), together)
    header, _, code = content.partition(b"\n")
    return json.loads(header), loaded(code, "run")


def written(recursion: Recursion) -> str:
    """Return all that a recursion is, as text: a line per node, which names the lines of its arguments."""
    lines: dict[Any, int] = {}  # in order: a dictionary keeps it
    told: list[str] = []

    def number(node: Any) -> int:
        if node not in lines:
            own = sp.srepr(node) if not node.args else type(node).__name__
            told.append(" ".join([own, *(str(number(a)) for a in node.args)]))
            lines[node] = len(lines)
        return lines[node]

    updates = [(number(left), number(right)) for left, right in recursion.updates]
    return "\n".join([*told, f"{updates} {recursion.parameters}"])


@once
def _rules() -> str:
    """Return a digest of the code that derives and emits: what other code has made is made again."""
    here = Path(__file__).parent
    files = [*here.rglob("*.py"), *(here.parent / "symbolic").glob("*.py")]
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted(files))).hexdigest()


def compile(recursion: Recursion, engine: str = "native") -> Compiled:
    """Turn a recursion into a function over arrays, once per recursion and engine.

    Parameters
    ----------
    recursion : Recursion
    engine : "native", "casadi" or "python"
        Machine code by LLVM, CasADi's virtual machine, or a generated Python loop. They agree to rounding. For laws
        that need a root finder "native" falls back to "python".
    """
    if engine not in ENGINES:
        raise ModelError(f"Unknown engine {engine!r}; there are {', '.join(ENGINES)}.")
    if engine == "native" and any(right.has(Root) for _, right in recursion.updates):
        engine = "python"  # only there is a root finder
    return _compiled(recursion, engine)


def theta(model: Model) -> Array | None:
    """Return the parameter values, (n_theta,) float array that cannot be written to, or None before a fit."""
    if model.numbers is None:
        return None
    found = np.array(model.numbers, dtype=float)
    found.setflags(write=False)
    return found
