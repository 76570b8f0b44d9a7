"""A model at rest: what keeps it from resting, its rest map G with ybar = G(ybar, ubar), and Sigma_y."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.recursion import State
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import INNER_OUTPUTS, Name, differences, expand_phi, held, lag, lags, samples, t, x
from .model import Model

INTEGRATES = 1e-9  # of 1: a slope at rest as near to 1 is that of an integrator
ybar, ubar = (Name(n, real=True) for n in (r"\bar{y}", r"\bar{u}"))


def at_rest(expr: Any, model: Model) -> Any:
    """Hold every signal constant: y[k-i] is ybar, u[k-j] is ubar, a channel its own symbol."""
    known = {model.output: ybar, model.input: ubar}
    return held(expr, lambda base: known.get(base, rest_of(base)))


def rest_of(base: Any) -> Any:
    """Return the symbol of a sequence at rest."""
    return Name(rf"\bar{{{base.label}}}", real=True)


def effects_of(model: Model, expr: Any = None, states: Sequence[State] = ()) -> str:
    """Name the effects whose coefficients an expression contains or that brought some states, or the states."""
    symbols = sp.sympify(expr or 0).free_symbols
    groups = {s.group for s in states if s.group}
    named = [e.effect for e in model.effects if e.group in groups or symbols & set(e.coefficients.values())]
    if named:
        return f"the {'effect' if len(named) == 1 else 'effects'} {' and '.join(dict.fromkeys(named))}"
    return f"the {'state' if len(states) == 1 else 'states'} {', '.join(printing.text(s.left) for s in states)}"


@dataclass(frozen=True)
class Play:
    """A state p[k] = Max(low, Min(high, p[k-1])) of the input: it rests anywhere from low to high."""

    state: State
    low: Any
    high: Any

    @property
    def base(self) -> sp.IndexedBase:
        """Its sequence."""
        return self.state.left.base

    @property
    def rest(self) -> Any:
        """Its symbol at rest."""
        return rest_of(self.base)

    def between(self, value: Any) -> tuple[Any, Any]:
        """Return from where to where it may be at some value of the input."""
        return held(self.low, lambda base: value), held(self.high, lambda base: value)


def plays(model: Model) -> list[Play]:
    """Return the plays of the input that a model's output reads (Krasnosel'skii & Pokrovskii 1989)."""
    found = []
    for state in model.hidden:
        right, before = model.in_user_units(state.right), state.left.base[state.left.indices[0] - 1]
        taken = [a for a in right.args if a.has(before)] if isinstance(right, sp.Max) else []
        if len(taken) != 1 or not isinstance(taken[0], sp.Min) or before not in taken[0].args:
            continue
        low = sp.Max(*(a for a in right.args if a != taken[0]))
        high = sp.Min(*(a for a in taken[0].args if a != before))
        if {s.base for s in samples(low) + samples(high)} == {model.input}:
            found.append(Play(state, low, high))
    return found


def settled(model: Model) -> dict[Any, Any]:
    """Return where states that no effect brought settle under a constant input and output, by their symbols at rest.

    Each is solved for where it stands linearly and alone decides; a state that may rest anywhere is not among them.
    """
    groups = {e.group for e in model.effects if e.group}
    found: dict[Any, Any] = {}
    for state in model.hidden:
        if state.left.base in INNER_OUTPUTS or state.group in groups:
            continue
        own = rest_of(state.left.base)
        right = model.in_user_units(expand_phi(state.right))
        if samples(right, t):
            continue
        gap = (own - at_rest(right, model)).xreplace(found)
        slope = sp.expand(derivative(gap, own))
        value = slope.xreplace(model.values)
        if slope.free_symbols - set(model.symbols) or (value.is_number and abs(float(value)) <= INTEGRATES):
            continue
        known = {own: -gap.xreplace({own: sp.S.Zero}) / slope}
        found = {s: e.xreplace(known) for s, e in found.items()} | known
    return found


def resting_states(model: Model) -> list[Any]:
    """Return the sequences of `settled`."""
    known = settled(model)
    return [s.left for s in model.hidden if rest_of(s.left.base) in known]


def remembered(model: Model, but: Sequence[Any] = ()) -> str:
    """Say what keeps a model from being one equation in y and u, `but` some plays; an empty text where it is one."""
    known = {one.base for one in but}
    hidden = {s.left.base for s in model.hidden} - known
    if not hidden:
        return ""
    read = (hidden | model.recursion.graph.reached(*hidden)) - known
    held = [s for s in model.recurrent if s.left.base in read]
    if held:
        shown = ", ".join(printing.text(s.left) for s in held)
        return f"it has further memory in {effects_of(model, states=held)} ({shown})"
    return f"{effects_of(model, model.beside, model.hidden)} acts on the inner output x[k], which is not measured"


def closed(model: Model, what: str, timeless: bool = True, but: Sequence[Any] = ()) -> None:
    """Refuse what is not derived for models that remember more than some plays, or that change with time.

    Raises
    ------
    ModelError
    """
    why = remembered(model, but)
    if not why and timeless and samples(model.right, t):
        why = f"{_moving(model)} changes with time, so there is no steady state"
    if why:
        raise ModelError(f"{what} not derived for this model: {why}.")


def _moving(model: Model) -> str:
    """Name the effects that depend on time."""
    for one in model.effects:
        if any(samples(sp.diff(model.right, c), t) for c in one.coefficients.values()):
            return f"the effect {one.effect}"
    return "the equation"


def newest_input(model: Model) -> int:
    """Return the smallest lag of the input: that of the core, or of an effect that acts faster."""
    return min(lags(model.right, model.input), default=model.delay)


def folded(model: Model) -> Any:
    """Return the model's flat equation with differences of consecutive inputs written as phi1, their signs as phi2."""
    first, second = differences(model.input)
    expr = model.flat
    found: dict[Any, Any] = {}
    for node in expr.atoms(sp.Add):
        read = samples(node, model.input)
        if len(node.args) == len(read) == 2 and lag(read[1]) - lag(read[0]) == 1:
            for sign in (1, -1):
                if node == sign * (read[0] - read[1]):
                    found[node] = sign * first[read[0].indices[0]]
    expr = expr.xreplace(found)
    return expr.xreplace({sp.sign(s): second[s.indices[0]] for s in samples(expr, first)})


def rest_map(model: Model) -> Any:
    """Return G with ybar = G(ybar, ubar): all signals held constant, in the user's units.

    phi1 and phi2 vanish because u[k] - u[k-1] does; they are not declared. A play is held where it is.

    Raises
    ------
    ModelError
        For a model that remembers more than its outputs, inputs and plays of them, or changes with time.
    """
    closed(model, "The steady state is", but=[*plays(model), *resting_states(model)])
    return at_rest(model.right, model).xreplace(settled(model))


def sigma_y(model: Model) -> Any:
    """Return the sum of the parameters of the linear output regressors.

    Where effects act on the output it is that of the inner output `x`.

    Raises
    ------
    ModelError
        Where the output also returns through what an effect remembers.
    """
    besides = (s.left.base for s in model.states if s.left.base != x)
    returning = model.recursion.graph.reached(*besides) & {x, model.output}
    if model.hidden and (returning or (model.inner == x and samples(model.beside, x))):
        closed(model, "Sigma_y is", timeless=False)
    # Only a sum that is multiplied out shows its linear terms: 2*y[k-1], a*(y[k-1] + y[k-2]).
    terms = [part.as_independent(sp.Indexed, as_Add=False) for part in sp.Add.make_args(sp.expand(model.core))]
    return sp.Add(*(c for c, term in terms if isinstance(term, sp.Indexed) and term.base == model.inner))
