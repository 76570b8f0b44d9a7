"""The time index and the sequences: `y[k]`, `u[k-1]`, `phi1[k-2]`, ... as SymPy expressions.

`expr.xreplace({k: k + 1})` is the shift operator q of the paper; `phi1` and `phi2` are the first difference
of the input and its sign, `breve_phi1` and `breve_phi2` those of the output (the paper's inverse model).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import sympy as sp


class Name(sp.Symbol):
    """A symbol of the package's own: it equals no symbol of a user, whatever that is called."""


k = Name("k", integer=True)


class Sequence(sp.IndexedBase):
    """A sequence whose samples are made once: equal ones are the same object, which SymPy sees at once.

    Its label is no symbol of a user: a parameter called `y` is not the `y` of `y[k]`.
    """

    def __new__(cls, label: Any) -> Any:
        """Make the real sequence of a name: without real, sign(x)*x would turn into a Piecewise."""
        return super().__new__(cls, label if isinstance(label, Name) else Name(label, real=True))

    def __getitem__(self, index: Any, **assumptions: Any) -> sp.Indexed:
        return _sample(self, index)

    def __reduce__(self) -> Any:
        return signal, (self.name,)


@lru_cache(maxsize=100_000)
def _sample(base: Sequence, index: Any) -> sp.Indexed:
    return sp.Indexed(base, index)


@lru_cache(maxsize=10_000)
def signal(name: str) -> Sequence:
    """Return the real sequence called `name`; `signal("p")[k]` is its value at time k."""
    return Sequence(name)


y, u, r, m = (signal(name) for name in "yurm")
# Time [s]; the input and the output that the core of a model sees where effects act on them.
t, v, x = (signal(name) for name in "tvx")
# Where the core would go if nothing held it; what the sensor sees; the input once it has arrived, with other forces;
# what a first effect at the input lets through to a second one; the share of a friction that is reached, and what of it
# is passed on.
free, sensed, acting, passed = signal("free"), signal("sensed"), signal("acting"), signal("passed")
rub, grip = signal("rub"), signal("grip")
INNER_INPUTS, INNER_OUTPUTS = (v, acting, passed), (x, free, sensed)  # what effects make of the input, and the output
phi1, phi2 = signal("phi1"), signal("phi2")
breve_phi1, breve_phi2 = signal("breve_phi1"), signal("breve_phi2")
# Names that no channel and no state of an effect may have.
SIGNALS = (u, y, t, *INNER_INPUTS, *INNER_OUTPUTS, grip, r, m, phi1, phi2, breve_phi1, breve_phi2)
RESERVED = {base.name for base in SIGNALS} | {"k", "prediction"}


def differences(driver: sp.IndexedBase) -> tuple[sp.IndexedBase, sp.IndexedBase]:
    """Return (phi1, phi2) of a driving sequence: those of u, or the breve pair of any other."""
    return (phi1, phi2) if driver == u else (breve_phi1, breve_phi2)


def lag(sample: sp.Indexed) -> int:
    """Return i of `x[k-i]`; a lead is negative."""
    return int(k - sample.indices[0])


def samples(expr: Any, base: sp.IndexedBase | None = None) -> list[sp.Indexed]:
    """Return the samples in an expression, of one sequence or of all, ordered by name and lag."""
    return [s for s in _samples(sp.sympify(expr)) if base is None or s.base == base]


@lru_cache(maxsize=20_000)
def _samples(expr: Any) -> tuple[sp.Indexed, ...]:
    return tuple(sorted(expr.atoms(sp.Indexed), key=lambda s: (str(s.base), lag(s))))


def lags(expr: Any, base: sp.IndexedBase) -> list[int]:
    """Return the sorted lags at which a sequence enters an expression."""
    return sorted({lag(s) for s in samples(expr, base)})


def pairs(expr: Any) -> list[tuple[Any, Any]]:
    """Return (coefficient, term) pairs whose products add up to an expression."""
    return [
        part.as_independent(sp.Indexed, as_Add=False) if part.has(sp.Indexed) else (part, sp.S.One)
        for part in sp.Add.make_args(expr)
    ]


def shift(expr: Any, steps: int) -> Any:
    """Apply q**steps: every `x[k]` becomes `x[k+steps]`."""
    return expr.xreplace({k: k + steps})


def renamed(expr: Any, names: Mapping[Any, Any]) -> Any:
    """Put other samples or symbols for some; like `xreplace`, but extremes are not searched for what they could lose.

    Another name makes no argument of Max or Min redundant, and SymPy's search takes longer than a derivation.
    """
    return rewritten(expr, names.get)


def rewritten(expr: Any, change: Callable[[Any], Any]) -> Any:
    """Put `change(part)` in the place of each part for which it is not None; extremes keep all of their arguments."""
    found = change(expr)
    if found is not None:
        return found
    if not expr.args or isinstance(expr, sp.Indexed):
        return expr
    arguments = [rewritten(a, change) for a in expr.args]
    if all(new is old for new, old in zip(arguments, expr.args, strict=True)):
        return expr
    if isinstance(expr, (sp.Max, sp.Min)):
        return expr.func(*arguments, evaluate=False)
    return expr.func(*arguments)


def held(expr: Any, values: Callable[[sp.IndexedBase], Any]) -> Any:
    """Hold sequences still: every sample of one becomes what `values` gives for it, at whatever time."""
    return expr.xreplace({s: values(s.base) for s in samples(expr)})


def expand_phi(expr: Any, driver: sp.IndexedBase = u, breve_driver: sp.IndexedBase = y) -> Any:
    """Write phi1 and phi2 out as differences and signs of `driver` (the breve pair: of `breve_driver`)."""
    source = {phi1: driver, phi2: driver, breve_phi1: breve_driver, breve_phi2: breve_driver}
    written: dict[Any, Any] = {}
    for s in samples(expr):
        if s.base in source:
            of, i = source[s.base], s.indices[0]
            change = of[i] - of[i - 1]
            written[s] = change if s.base in (phi1, breve_phi1) else sp.sign(change)
    return expr.xreplace(written) if written else expr


def definitions(expr: Any) -> list[tuple[Any, Any]]:
    """Return (left, right) of what phi1, phi2 and the breve pair are at time k, of those in an expression."""
    used = {s.base for s in samples(expr)}
    return [(b[k], expand_phi(b[k])) for b in (phi1, phi2, breve_phi1, breve_phi2) if b in used]


def swap(expr: Any, bases: dict[sp.IndexedBase, sp.IndexedBase], shifts: dict[Any, int] | None = None) -> Any:
    """Rename sequences, each with its own shift in time: {u: m}, {y: 1} turns `u[k-1]` into `m[k]`."""
    shifts = shifts or {}
    return expr.xreplace({s: bases.get(s.base, s.base)[s.indices[0] + shifts.get(s.base, 0)] for s in samples(expr)})


def plain_name(text: str) -> str:
    """Return a text as a name that may stand in equations: letters, digits and underscores."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
    return name if name.isidentifier() else f"channel_{name}"


def channel_name(text: str) -> str:
    """Return the name of a column as a channel may have it in equations: `plain_name`, and none that is taken."""
    name = plain_name(text)
    return f"channel_{name}" if name in RESERVED or re.fullmatch(r"theta_\d+", name) else name
