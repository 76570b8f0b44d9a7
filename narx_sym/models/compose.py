"""Models put together: one behind another, side by side, around a loop; and effects in front of or behind them.

The whole is a model like any other: its parts are states, in the user's units, and their names are kept apart.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic.identities import vanishes
from ..symbolic.recursion import State
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import (
    INNER_INPUTS,
    INNER_OUTPUTS,
    expand_phi,
    grip,
    k,
    lag,
    renamed,
    rub,
    samples,
    shift,
    signal,
    u,
    x,
    y,
)
from .effects import Effect
from .extend import written_constraints
from .info import Info
from .model import Model
from .rest_map import INTEGRATES
from .rewrite import called, own_names, relabelled

# Where effects act in a model: in another one they are plain states.
PLACES = {*INNER_INPUTS, *INNER_OUTPUTS, rub, grip}


def series(first: Any, second: Any) -> Model:
    """Connect two models in series (the output of the first is the input of the second): `first >> second`.

    Parameters
    ----------
    first, second : Model or Effect
        An effect x + c z(x) is put in front of or behind a model.

    Returns
    -------
    Model
        Its input is that of the first, its output that of the second. What stands between is a state, which starts
        where the first rests; where that may rest anywhere, on the line through its data, or at 0.
        Parameters that have one name get two; the same channel stays one. Without values where one of them has none.

    Raises
    ------
    ModelError
        For an inverse model, and for two sampling times.

    Examples
    --------
    >>> import narx_sym as ns
    >>> lag = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.5, 0.5])
    >>> gain = ns.NARX.from_terms(["u[k]"], theta=[3.0])
    >>> whole = lag >> gain
    >>> whole.lines()
    ['y_1[k] = theta_1*y_1[k-1] + theta_2*u[k-1]', 'y[k] = theta_3*y_1[k]']
    >>> whole.delay, whole.simulate([0.0, 1.0, 1.0, 1.0], 0.0).tolist()
    (1, [0.0, 0.0, 1.5, 2.25])
    """
    one, two = _pair(first, second)
    a, b = one.model, two.model
    between = signal(_fresh("y_1", {*own_names(a), *own_names(b)}))
    own = _Part.of(one, a.input, between, {between: one.rest})
    other = _Part.of(two, between, y, {between: own.rest})
    states = [*own.states, State(between[k], own.right, own.rest), *other.states]
    return _whole(a, b, other.right, states, _joined(a.info, b.info))


def parallel(first: Any, second: Any) -> Model:
    """Connect two models in parallel (same input, sum of the outputs): `first + second`.

    Returns
    -------
    Model
        The output of the first is a state, which starts where that rests. See `series` for names and values.

    Raises
    ------
    ModelError
        As for `series`, and for two different inputs.
    """
    one, two = _pair(first, second)
    a, b = one.model, two.model
    if a.input != b.input:
        raise ModelError(f"In parallel both models have the same input, not {a.input.label} and {b.input.label}.")
    beside = signal(_fresh("y_1", {*own_names(a), *own_names(b)}))
    own = _Part.of(one, a.input, beside, {beside: one.rest})
    other = _Part.of(two, b.input, y, {})

    def alone(expr: Any, at: Any) -> Any:
        """Take off what the first one adds to the output."""
        return renamed(expr, {s: s - at(s) for s in samples(expr, y)})

    def past(s: Any) -> Any:
        return beside[s.indices[0]]

    states = [*own.states, State(beside[k], own.right, own.rest)]
    for s in other.states:
        begin = s.initial if samples(s.right, x) else alone(s.initial, lambda y_: shift(own.rest, -lag(y_)))
        states.append(State(s.left, alone(s.right, past), begin, s.group))
    info = Info(ranges=_only(a.info.ranges, "y"), units=a.info.units)
    return _whole(a, b, beside[k] + alone(other.right, past), states, info)


def feedback(forward: Any, back: Any) -> Model:
    """Return the model of a feedback loop: the input of the first model is the input minus the output of the second.

    Raises
    ------
    ModelError
        As for `series`, and where the output would act on itself at once.
    """
    one, two = _pair(forward, back, main=0)
    a, b = one.model, two.model
    taken = {*own_names(a), *own_names(b)}
    error, returned = signal(_fresh("e", taken)), signal(_fresh("y_1", taken))
    held = called(two.rest, {b.input: y})
    other = _Part.of(two, y, returned, {returned: held})
    own = _Part.of(one, error, y, {error: a.input[k] - held})
    way = [
        *other.states,
        State(returned[k], other.right, held),
        State(error[k], a.input[k] - returned[k], a.input[k] - held),
    ]
    late = {s.left.base for s in way} if any(not lag(s) for state in way for s in samples(state.right, y)) else set()
    for state in own.states if late else ():
        if any(s.base in late and not lag(s) for s in samples(state.right)):
            late.add(state.left.base)
    if any(s.base in late and not lag(s) for s in samples(own.right)):
        raise ModelError("Algebraic loop: one of the two models must have a delay of at least one sample.")

    def computed(expr: Any, of: Any) -> Any:
        """Read what the output reaches at once as it is computed: one sample later than it is."""
        expr = shift(expr, -1) if of in late else expr
        return renamed(expr, {s: s.base[s.indices[0] + 1] for s in samples(expr) if s.base in late})

    states = [State(s.left, computed(s.right, s.left.base), s.initial, s.group) for s in (*way, *own.states)]
    info = Info(ranges=_only(a.info.ranges, "u"), units=a.info.units)
    return _whole(a, b, computed(own.right, y), states, info)


@dataclass(frozen=True)
class _Named:
    """A model with names of its own, what its states start from, and where its output rests, in the user's units."""

    model: Model
    starts: dict[Any, Any]
    rest: Any


@dataclass(frozen=True)
class _Part:
    """The equations of a model between two sequences, in the user's units."""

    states: list[State]
    right: Any
    rest: Any

    @classmethod
    def of(cls, one: _Named, source: Any, target: Any, rest: dict[Any, Any]) -> _Part:
        """Take a model whose input and output are called otherwise; `rest` says what they are before the start."""
        model = one.model
        names = {model.input: source, model.output: target}

        def meant(expr: Any) -> Any:
            return called(model.in_user_units(expr if source == model.input else expand_phi(expr)), names)

        def begun(expr: Any) -> Any:
            known = called(expr, names)
            return known.xreplace({s: shift(rest[s.base], -lag(s)) for s in samples(known) if s.base in rest})

        def initial(state: State) -> Any:
            if not samples(state.right, x):
                return begun(one.starts[state.left.base])
            point = model.operating_point.get(model.output, 0)  # of what x drives, y means x, which has no such point
            own = model.in_user_units(state.initial)
            return begun(own.xreplace({s: s + point for s in samples(own, model.output)}))

        states = [State(s.left, meant(s.right), initial(s), s.group) for s in model.states]
        right = meant(model.F) + model.operating_point.get(model.output, 0)
        return cls(states, right, rest.get(target, y[k]))


def _pair(*given: Any, main: int = 1) -> list[_Named]:
    """Return models with names of their own: what is not a channel of both has another name in the second.

    The core of the `main` one computes the output of the whole: its output places stay what they are.
    """
    a, b = (_block(one) if isinstance(one, Effect) else one for one in given)
    for one in (a, b):
        if not isinstance(one, Model) or one.output != y:
            raise ModelError("Only models from an input to y and effects of the catalogue can be combined.")
    if a.Ts and b.Ts and a.Ts != b.Ts:
        raise ModelError(f"The models have different sampling times, {a.Ts:g} s and {b.Ts:g} s.")
    taken = {u.name, y.name, *a.channels, *b.channels}
    made: list[_Named] = []
    symbols: set[str] = set()
    for place, one in enumerate((a, b)):
        names: dict[Any, Any] = {}
        for state in one.states:
            base = state.left.base
            special = base in PLACES and not (place == main and base in INNER_OUTPUTS)
            new = _fresh(f"{base.name}_1" if special else base.name, taken)
            taken.add(new)
            names[base] = signal(new)
        for symbol in one.symbols:
            new = _fresh(symbol.name, symbols | (set(map(str, one.symbols)) - {symbol.name}))
            symbols.add(new)
            names[symbol] = symbol if new == symbol.name else sp.Symbol(new, **symbol._assumptions_orig)
        changed = {old: new for old, new in names.items() if old != new}
        model = _regrouped(
            relabelled(one, changed) if changed else one, {s.group for m in made for s in m.model.states}
        )
        # Where effects act is known by names: what follows from these is derived before others stand in their place.
        starts = {names.get(base, base): called(e, changed) for base, e in one.starts.items()}
        made.append(_Named(model, starts, called(_output_at_rest(one), changed)))
    return made


def _fresh(name: str, taken: Collection[str]) -> str:
    """Return a name, with the next number behind it that leaves those that are taken."""
    while name in taken:
        stem, number = re.fullmatch(r"(.*?)(?:_(\d+))?", name).groups()  # type: ignore[union-attr]
        name = f"{stem}_{int(number or 1) + 1}"
    return name


def _regrouped(model: Model, taken: set[str]) -> Model:
    """Return a model whose effects have groups of their own."""
    names = {g: _fresh(g, taken) for g in {*(s.group for s in model.states), *(e.group for e in model.effects)} if g}
    if all(old == new for old, new in names.items()):
        return model
    states = [replace(s, group=names.get(s.group, "")) for s in model.states]
    return model.replace(states=states, effects=[replace(e, group=names.get(e.group, "")) for e in model.effects])


def _block(effect: Effect) -> Model:
    """Return an effect as a model y[k] = u[k] + c z[k] without values."""
    shape = {p: sp.Symbol(f"{p}_{effect.id}", real=True) for p in effect.shape}
    steps = {p: s.values[len(s.values) // 2] for p, s in effect.scan.items() if s.of == "steps"}
    form = effect.equations(**{**shape, **{p: int(n) for p, n in steps.items()}})
    many = len(form.z) > 1
    cs = [sp.Symbol(f"c{i + 1 if many else ''}_{effect.id}", real=True) for i in range(len(form.z))]

    def driven(expr: Any) -> Any:
        return renamed(expr, {s: u[s.indices[0]] for s in samples(expr, signal("x"))})

    F = u[k] + sp.Add(*(c * driven(z) for c, z in zip(cs, form.z, strict=True)))
    return Model(
        F, [*cs, *(s for p, s in shape.items() if p not in steps)], states=[s.map(driven) for s in form.states]
    )


def _output_at_rest(model: Model) -> Any:
    """Return where a model's output rests under a constant input, in its samples at time k.

    Where it may rest anywhere, or has no closed form, on the line through the data that it was fitted on, else at 0.
    """
    at, inner = sp.Dummy("rest", real=True), model.inner
    expr = dict(model.recursion.updates)[inner[k]] - inner[k]  # where effects add to the output, what the core computes
    while read := [s for s in samples(expr) if s.base in model.starts]:
        expr = expr.xreplace({s: shift(model.starts[s.base], -lag(s)) for s in read})
    held = renamed(expr, {s: at if s.base == model.output else s.base[k] for s in samples(expr)})
    slope = sp.expand(-derivative(held, at))
    line = model.info.line or (0.0, 0.0)
    value = slope.xreplace(model.values)
    # Where nothing is known of the parameters they could not be put in before a run.
    if model.values and value.is_number and abs(float(value)) > INTEGRATES and not vanishes(slope):
        return held.xreplace({at: sp.S.Zero}) / slope
    return line[0] + line[1] * model.input[k] if model.info.line else sp.S.Zero


def _joined(first: Info, second: Info) -> Info:
    """Return what is known of the ends of a chain, and the line through both."""
    line = None
    if first.line and second.line:
        line = (second.line[0] + second.line[1] * first.line[0], first.line[1] * second.line[1])
    known = {
        name: _only(getattr(first, name), "y") | _only(getattr(second, name), "u")
        for name in ("ranges", "rates", "frequencies", "steps", "units")
    }
    return Info(line=line, **known)  # type: ignore[arg-type]


def _only(known: Any, but: str) -> dict[str, Any]:
    return {name: value for name, value in known.items() if name != but}


def _whole(a: Model, b: Model, right: Any, states: Sequence[State], info: Info) -> Model:
    """Return the model of both."""
    theta, errors = _both(a.numbers, b.numbers), _both(a.standard_errors, b.standard_errors)
    return Model(
        right, (*a.symbols, *b.symbols), theta, input=a.input, Ts=a.Ts or b.Ts, states=states, standard_errors=errors,
        constraints=[*written_constraints(a), *written_constraints(b)], info=info, effects=(*a.effects, *b.effects),
    )  # fmt: skip


def _both(one: Iterable[float] | None, other: Iterable[float] | None) -> list[float] | None:
    return None if one is None or other is None else [*one, *other]
