r"""Several outputs: one model each, which may read the other outputs; together they are one recursion.

y_i[k] = F_i(y_i[k-1], ..., u[k-tau], ..., y_j[k-1], ...): the equations of a machine with several outputs and inputs,
in the order in which they can be computed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic.printing import InLatex
from ..symbolic.recursion import Recursion
from ..symbolic.signals import RESERVED, k, lag, samples, signal, u, y
from .doors import SystemDoors
from .model import Model
from .rewrite import called


@dataclass(frozen=True, eq=False)
class System(SystemDoors, InLatex):
    """A model with several outputs: one model for each output, connected by the names of the outputs.

    Parameters
    ----------
    parts : mapping from the name of an output to its Model
        In each model `y` is its own output and `u` the first input; the other outputs and inputs are channels.

    Raises
    ------
    ModelError
        For no model, an inverse model, a reserved name, different sampling times, or an algebraic loop.

    Examples
    --------
    >>> import narx_sym as ns
    >>> upper = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.75, 0.5])
    >>> lower = ns.NARX.from_terms(["y[k-1]", "h1[k-1]"], theta=[0.5, 0.5], channels=["h1"])
    >>> tanks = ns.System({"h1": upper, "h2": lower})
    >>> tanks.inputs, tanks.outputs
    (('u',), ('h1', 'h2'))
    >>> tanks.equilibria()
    [{h1: 2.0*u, h2: 2.0*u}]
    >>> tanks.simulate({"u": [1.0, 1.0, 1.0]}, {"h1": 0.0, "h2": 0.0})["h2"]
    array([0.  , 0.  , 0.25])
    """

    parts: Mapping[str, Model]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", dict(self.parts))
        if not self.parts:
            raise ModelError("A system has at least one output.")
        for name, part in self.parts.items():
            if not isinstance(part, Model) or part.output != y or part.lead:
                raise ModelError(f"The part of {name!r} must be a model from inputs to y.")
            if not name.isidentifier() or name in RESERVED - {y.name} or (name == y.name and len(self.parts) > 1):
                raise ModelError(f"The output {name!r} needs a plain name of its own, such as y1.")
        if len({part.Ts for part in self.parts.values() if part.Ts}) > 1:
            raise ModelError("All parts of a system must have the same sampling time.")
        self.recursion  # noqa: B018  what cannot be computed in any order is said at once

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the outputs."""
        return tuple(self.parts)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of the inputs, `u` first."""
        read = [b.name for b in self.recursion.inputs]
        return tuple(sorted(read, key=lambda name: (name != u.name, name)))

    @property
    def Ts(self) -> float | None:
        """Sampling time [s]."""
        return next((part.Ts for part in self.parts.values() if part.Ts), None)

    @property
    def units(self) -> dict[str, str]:
        """Units of the inputs and outputs by name, where they are known."""
        return self._known("units")

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of the inputs and outputs in the records, by name."""
        return self._known("ranges")

    def _known(self, what: str) -> dict[str, Any]:
        parts = [(output, getattr(part.info, what)) for output, part in self.parts.items()]
        return {output if n == y.name else n: value for output, known in parts for n, value in known.items()}

    def names(self, output: str) -> dict[Any, Any]:
        """Return the names that the signals and parameters of a part have in the system."""
        part = self.parts[output]
        own: dict[Any, Any] = {s: sp.Symbol(f"{s}_{output}", **s._assumptions_orig) for s in part.symbols}
        own |= {s.left.base: signal(f"{s.left.base.name}_{output}") for s in part.states}
        return own | {part.output: signal(output)}

    @cached_property
    def recursion(self) -> Recursion:
        """All equations, sorted so that each only needs earlier ones of the same sample.

        ModelError for an algebraic loop.
        """
        listed: list[tuple[Any, Any]] = []
        for output, part in self.parts.items():
            names = self.names(output)
            listed += [(called(left, names), called(right, names)) for left, right in part.recursion.updates]
        left, ordered = {a.base: (a, b) for a, b in listed}, list[tuple[Any, Any]]()
        while left:
            ready = [base for base, (_, right) in left.items() if not _at_once(right) & left.keys()]
            if not ready:
                raise ModelError(
                    f"Algebraic loop: {', '.join(b.name for b in left)} depend on one another at the same sample; "
                    "one of them needs a delay."
                )
            ordered.append(left.pop(ready[0]))
        return Recursion(tuple(ordered), self.symbols)

    @property
    def symbols(self) -> tuple[Any, ...]:
        """The parameters of all parts."""
        return tuple(self.names(output)[s] for output, part in self.parts.items() for s in part.symbols)

    @property
    def numbers(self) -> tuple[float, ...] | None:
        """Values of the parameters, None if a part has none."""
        found = [part.numbers for part in self.parts.values()]
        return None if any(n is None for n in found) else tuple(v for n in found for v in n or ())

    @property
    def values(self) -> dict[Any, Any]:
        """Values by symbol; empty if a part has none."""
        return {} if self.numbers is None else dict(zip(self.symbols, map(sp.Float, self.numbers), strict=True))

    @property
    def equations(self) -> list[sp.Eq]:
        """Each equation, in order."""
        return [sp.Eq(left, right, evaluate=False) for left, right in self.recursion.updates]

    def at_rest(self) -> list[Any]:
        """Return what must vanish in equilibrium, in symbols that are called like the outputs, states and inputs."""
        found = []
        for left, right in self.recursion.updates:
            held = right.xreplace({s: sp.Symbol(s.base.name, real=True) for s in samples(right)})
            found.append(sp.expand(held - sp.Symbol(left.base.name, real=True)))
        return found

    def equilibria(self, numbers: bool = True) -> list[dict[Any, Any]]:
        """Return the steady states: outputs (and states) as functions of the constant inputs.

        Parameters
        ----------
        numbers : bool
            Whether the parameters have their values, where they are known.

        Raises
        ------
        ModelError
            Where SymPy finds no closed form.
        """
        unknown = [sp.Symbol(base.name, real=True) for base in self.recursion.states]
        equations = [e.xreplace(self.values if numbers else {}) for e in self.at_rest()]
        try:
            return list(sp.solve(equations, unknown, dict=True))
        except NotImplementedError:
            raise ModelError(
                "The equilibria of this system have no closed form: solve `at_rest()` in numbers."
            ) from None

    def latex(self, numbers: bool = False) -> str:
        """LaTeX of all equations, with symbols or with numbers."""
        return self.recursion.subs(self.values).latex() if numbers else self.recursion.latex()

    def __repr__(self) -> str:
        return f"System({self.recursion.subs(self.values)!r})"


def _at_once(expr: Any) -> set[Any]:
    """Return the sequences that an expression reads at time k."""
    return {s.base for s in samples(expr) if lag(s) == 0 and s.indices[0] == k}
