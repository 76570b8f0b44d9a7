"""A physical model of one's own: its equations as text become a model like the others.

    # a mass with viscous friction: m x'' + d x' = g u + o
    x'' = (g*u - d*x' + o)/m
    y = x
    g = 35.15                      # a known number
    m ~ 90 in 10 ... 500           # a parameter: its first value, and its bounds where there are some
    d ~ 200 in 1 ... 2000
    o ~ 0

Further lines may be `temp = channel` (a measured signal), `flow = a*sqrt(h)` (a name for an expression), `h(0) = y`
(where a state starts, in u and y; 0 by default, and estimated with the fit) and, instead of derivatives, `h[k] = ...`.
A level that may run dry needs a root of both signs: sign(h)*sqrt(Abs(h)).

Between two samples the input is held. Where the output is a combination of one or two states, and only it stands in
what is not linear, x' = A x + w becomes x[k] = exp(A Ts) x[k-1] + G w[k-1], with G the integral of exp(A t) from 0 to
Ts: exact for linear equations. The states are then eliminated (Cayley and Hamilton), so that effects can act on the
motion of the output; a force that depends on a position acts at the middle of the three samples, and adds no damping of
its own (the scheme of Stormer and Verlet, of second order). Other equations take one step of the midpoint rule (Runge
1895), of second order; effects can act on each of their states.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import sympy as sp

from ..errors import ModelError, ParseError
from ..symbolic.functions import NAMES
from ..symbolic.grammar import parse
from ..symbolic.recursion import State
from ..symbolic.signals import RESERVED, k, signal, t, u, y
from .added import own_group
from .model import Model, sampling_time

MAX_LINES, MAX_STATES = 200, 12
NEAR = 1e-8  # of a sampling time: less is the rounding of a clock
CLOSED = 2  # states up to which exp(A Ts) has a closed form
NAME, NUMBER = r"[A-Za-z_][A-Za-z_0-9]*", r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
PARAMETER = re.compile(rf"({NAME})\s*~\s*({NUMBER})(?:\s+in\s+({NUMBER})\s*\.\.\.\s*({NUMBER}))?")
LINE = re.compile(rf"({NAME})('*|\[k\]|\(0\))\s*=\s*(.+)")
MEANT = (u.name, t.name, k.name, "pi")
PRIMED = re.compile(rf"({NAME})('+)")


@dataclass
class Equations:
    """What the lines of a text say; expressions are still texts."""

    parameters: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    channels: list[str] = field(default_factory=list)
    named: dict[str, str] = field(default_factory=dict)  # numbers and names for expressions
    slopes: dict[str, str] = field(default_factory=dict)  # of states, by the name of the state
    steps: dict[str, str] = field(default_factory=dict)  # right-hand sides of difference equations
    starts: dict[str, str] = field(default_factory=dict)


def dotted(name: str, order: int) -> str:
    """Return the name of a derivative of a state: x, x_dot, x_dot2, ..."""
    return name + ("" if not order else "_dot" if order == 1 else f"_dot{order}")


def read_lines(text: str) -> Equations:
    """Sort the lines of a text by what they say.

    Raises
    ------
    ParseError
        For a line that is none of these, with its number.
    """
    found, lines = Equations(), text.splitlines()
    if len(lines) > MAX_LINES:
        raise ParseError(f"The model has {len(lines)} lines; at most {MAX_LINES} are read.")
    for number, line in enumerate(lines, 1):
        said = line.partition("#")[0].strip()
        if not said:
            continue
        if given := PARAMETER.fullmatch(said):
            name, value, low, high = given.groups()
            _parameter(name, value, low, high, number, found)
            continue
        equation = LINE.fullmatch(said)
        if equation is None:
            raise ParseError(
                f"Line {number}: cannot read {said[:60]!r}; write x' = ..., x[k] = ..., y = ..., m ~ 90 in 10 ... 500, "
                "g = 9.81 or temp = channel."
            )
        name, kind, right = equation.groups()
        right = PRIMED.sub(lambda one: dotted(one[1], len(one[2])), right)
        if kind == "(0)":
            found.starts[name] = right
        elif kind == "[k]":
            found.steps[_own(name, number, found, steps=True)] = right
        elif kind:
            _own(name, number, found)
            for order in range(len(kind)):
                found.slopes[dotted(name, order)] = right if order == len(kind) - 1 else dotted(name, order + 1)
        elif right == "channel":
            found.channels.append(_own(name, number, found))
        else:
            found.named[_own(name, number, found)] = right
    return found


def _parameter(name: str, value: str, low: str | None, high: str | None, number: int, found: Equations) -> None:
    """Keep the first value of a parameter, and its bounds if they are given."""
    taken = _own(name, number, found)
    found.parameters[taken] = float(value)
    if low is not None and high is not None:
        found.bounds[taken] = (float(low), float(high))
        if not float(low) < float(high) or not float(low) <= float(value) <= float(high):
            raise ParseError(f"Line {number}: {name} must start inside low ... high, with low below high.")


def _own(name: str, number: int, found: Equations, steps: bool = False) -> str:
    """Return a name that a line gives, once, and to nothing that has a meaning already."""
    taken = {*found.parameters, *found.channels, *found.named, *found.slopes, *found.steps}
    if name in {*taken, *NAMES, *MEANT} or (steps and name in RESERVED - {y.name}):
        why = "is given twice" if name in taken else "means something else"
        raise ParseError(f"Line {number}: the name {name!r} {why}; choose another one.")
    return name


def from_equations(text: str, Ts: float | None = None) -> Model:
    """Make a model from equations of your own, given as text: derivatives or difference equations.

    The model can then be fitted (`model.fit(record, method="free_run")`), diagnosed and completed like an identified
    one.

    Parameters
    ----------
    text : str
        One line for each equation (x'' = ..., x[k] = ..., y = ...), parameter (m ~ 90 in 10 ... 500: first value and
        bounds), constant (g = 9.81), channel (temp = channel) or start value (h(0) = y). # begins a comment.
    Ts : float, optional
        Sampling time [s]; derivatives need it.

    Returns
    -------
    Model, with the first values of the parameters

    Raises
    ------
    ParseError
        For a line that cannot be read, or that has an unknown name.
    ModelError
        If the output `y` or Ts is missing, or derivatives and difference equations are mixed.

    Examples
    --------
    >>> import narx_sym as ns
    >>> tank = ns.from_equations("h' = (q*u - a*sqrt(h))/8; y = h; q ~ 2; a ~ 1".replace("; ", chr(10)), Ts=0.5)
    >>> print(tank.symbols, tank.theta)
    (q, a) [2. 1.]
    """
    if not isinstance(text, str):
        raise ParseError(f"The equations are a text with one per line, not {type(text).__name__}.")
    return _made(text, sampling_time(Ts))


@lru_cache(maxsize=16)
def _made(text: str, Ts: float | None) -> Model:
    said = read_lines(text)
    parameters = {name: sp.Symbol(name, real=True) for name in said.parameters}
    if said.slopes and said.steps:
        raise ModelError("Write either derivatives, x' = ..., or difference equations, x[k] = ..., not both.")
    if not (said.slopes or said.steps) or not ({y.name} & {*said.slopes, *said.steps, *said.named}):
        raise ModelError("The equations need the output: y' = ..., y[k] = ..., or y = an expression of the states.")
    if len(said.slopes) + len(said.steps) > MAX_STATES:
        raise ModelError(f"At most {MAX_STATES} states are read.")
    model = _differences(said, parameters) if said.steps else _sampled(said, parameters, Ts)
    unused = parameters.keys() - {
        str(s) for right in (model.F, *(s.right for s in model.states)) for s in right.free_symbols
    }
    if unused:
        raise ModelError(f"The parameter {min(unused)!r} appears in no equation.")
    return model.replace(
        theta=list(said.parameters.values()), Ts=Ts, bounds={parameters[n]: b for n, b in said.bounds.items()}
    )


def _meant(
    said: Equations, known: Mapping[str, Any], listed: Mapping[str, str], sequences: Iterable[str] = ()
) -> dict[str, Any]:
    """Return expressions with what their names stand for put in.

    Raises
    ------
    ModelError
        For names that are defined by one another.
    """
    symbols = {**{n: sp.Symbol(n, real=True) for n in said.named if n != y.name}, **known}
    read = {
        n: parse(right, signals=sequences, symbols=symbols.values()) for n, right in {**said.named, **listed}.items()
    }
    inner = {symbols[n]: read[n] for n in said.named if n != y.name}
    found = {}
    for name, right in read.items():
        for _ in range(len(inner) + 1):
            right = right.subs(inner)
        if right.free_symbols & inner.keys():
            raise ModelError(f"The definitions of the names in {name!r} are circular.")
        found[name] = right
    return found


def _starts(said: Equations, states: Sequence[str]) -> dict[str, Any]:
    """Return where the states start, in samples of u and y."""
    unknown = said.starts.keys() - set(states)
    if unknown:
        raise ModelError(f"{min(unknown)}(0) is given, but {min(unknown)!r} is no state.")
    at = {b.name: sp.Symbol(b.name, real=True) for b in (u, y)}
    read = {n: parse(right, symbols=at.values()) for n, right in said.starts.items()}
    return {n: e.xreplace({at[b.name]: b[k] for b in (u, y)}) for n, e in read.items()}


def _differences(said: Equations, parameters: Mapping[str, Any]) -> Model:
    """Return the model of difference equations: the states in order, the output last."""
    sequences = [*said.channels, *said.steps, t.name]
    found = _meant(said, parameters, said.steps, sequences)
    begins = _starts(said, [n for n in said.steps if n != y.name])
    states = [State(signal(n)[k], found[n], begins.get(n, sp.S.Zero), own_group(n)) for n in said.steps if n != y.name]
    return Model(found[y.name], list(parameters.values()), states=states)


def _sampled(said: Equations, parameters: Mapping[str, Any], Ts: float | None) -> Model:
    """Return the model of differential equations at a sampling time."""
    if Ts is None:
        raise ModelError("Differential equations need a sampling time: from_equations(text, Ts=record.Ts).")
    inputs = {n: sp.Symbol(n, real=True) for n in (u.name, t.name, *said.channels)}
    x = {n: sp.Symbol(n, real=True) for n in said.slopes}
    found = _meant(said, {**parameters, **inputs, **x}, said.slopes)
    states, shown = list(x.values()), x.get(y.name, found[y.name])
    A, rest = _linear([found[n] for n in x], states, set(inputs.values()))
    h, first = exact(Ts), dict(zip(parameters.values(), said.parameters.values(), strict=True))
    measured, listed = {s: signal(n) for n, s in inputs.items()}, list(parameters.values())
    output = [s for s in states if s == shown]
    own = {s: y if s in output else hidden(s.name) for s in states}

    def at(expr: Any, back: int) -> Any:
        return expr.xreplace({s: base[k - back] for s, base in {**measured, **own}.items()})

    begins = _starts(said, [s.name for s in states])
    C = sp.Matrix([[sp.diff(shown, s) for s in states]])
    linear = not C.free_symbols & {*states, *measured} and sp.expand(shown - (C * sp.Matrix(states))[0]) == 0
    bent = {s for w in rest for s in w.free_symbols} & set(states)
    if linear and bent <= set(output) and len(states) <= CLOSED:
        centred = [len(states) == 2 and slope == 0 for slope in C]  # a force: two steps lie between it and the output
        return Model(_eliminated(C, held_input(A, h, first), [partial(at, w) for w in rest], centred), listed)
    middle = {s: signal(f"{s.name}_half") for s in states}
    slopes, old = [found[n] for n in x], {s: base[k - 1] for s, base in own.items()}
    between = [State(middle[s][k], old[s] + h / 2 * at(f, 1)) for s, f in zip(states, slopes, strict=True)]
    there = {s: base[k] for s, base in middle.items()}
    updates = {s: old[s] + h * at(f.xreplace(there), 1) for s, f in zip(states, slopes, strict=True)}
    kept = [
        State(own[s][k], e, begins.get(s.name, sp.S.Zero), own_group(own[s].name)) for s, e in updates.items()
        if s not in output
    ]  # fmt: skip
    return Model(updates[output[0]] if output else at(shown, 0), listed, states=[*between, *kept])


def _eliminated(C: Any, held: Held, forced: Sequence[Callable[[int], Any]], centred: Sequence[bool]) -> Any:
    """Return y[k] of x[k] = Ad x[k-1] + G w[k-1], y = C x, in older outputs and w (Cayley and Hamilton).

    `forced` gives each w so many samples back. What of a `centred` one the output makes acts at the middle sample.
    """
    weights: dict[Any, Any] = {y[k - i]: a for i, a in enumerate(held.older, 1)}
    for i, part_of in enumerate(held.inputs, 1):
        for b, w, middle in zip(C * part_of, forced, centred, strict=True):
            for part in sp.Add.make_args(w(i)):
                factor, signals = part.as_independent(sp.Indexed, as_Add=False)
                read = signals.xreplace({y[k - i]: y[k - 1]}) if middle else signals
                weights[read] = weights.get(read, 0) + b * factor
    return sp.Add(*(_with_numbers(held.written(weight)) * read for read, weight in weights.items()))


def _with_numbers(weight: Any) -> Any:
    """Return a coefficient in which functions and roots of numbers are numbers: model files hold no others."""
    known = (f for f in weight.atoms(sp.Function, sp.Pow) if f.is_number and not f.is_Rational)
    return weight.xreplace({f: sp.Float(float(f)) for f in known})


def exact(Ts: float) -> Any:
    """Return a sampling time as a fraction of few digits: sums of exponents then cancel exactly."""
    return next(h for d in (3, 6, 9, 17) if abs((h := sp.Rational(f"{Ts:.{d}g}")) - Ts) <= NEAR * Ts)


def hidden(name: str) -> Any:
    """Return the sequence of a state that is not the output: `x` and `v` mean something else in models."""
    return signal(name + "_" * (name in RESERVED))


def _linear(slopes: Sequence[Any], states: Sequence[Any], moving: Collection[Any]) -> tuple[Any, list[Any]]:
    """Return A of x' = A x + w, and w: all that is not a state times what never is `moving`."""
    A, rest = sp.zeros(len(slopes)), []
    for i, slope in enumerate(slopes):
        beside = sp.S.Zero
        for part in sp.Add.make_args(sp.expand(slope)):
            factor, signals = part.as_independent(*states, as_Add=False)
            if signals in states and not factor.free_symbols & moving:
                A[i, list(states).index(signals)] += factor
            else:
                beside += part
        rest.append(beside)
    return A, rest


@dataclass(frozen=True)
class Held:
    """x[k] = Ad x[k-1] + G w[k-1] as an equation of an output: y[k] = sum older_i y[k-i] + C sum inputs_i w[k-i].

    `meant` says what symbols in it stand for: exponentials of the poles, which stay as they are.
    """

    older: tuple[Any, ...]
    inputs: tuple[Any, ...]
    meant: Mapping[Any, Any]

    def written(self, weight: Any) -> Any:
        """Return a coefficient with what its symbols stand for, each once."""
        if not self.meant:
            return sp.simplify(weight)
        parts = sp.collect(sp.expand(weight), list(self.meant), evaluate=False)
        return sp.Add(*(sp.factor(c) * symbol for symbol, c in parts.items())).xreplace(dict(self.meant))


def held_input(A: Any, h: Any, first: Mapping[Any, Any]) -> Held:
    """Return what one sample with a held input does, exactly, for one or two states.

    Of two, those that swing at the `first` values of the parameters are written as such.
    """
    one = sp.eye(A.rows)
    trace, det = sp.simplify(A.trace()), sp.simplify(A.det())
    if A.rows == 1 or det == 0:  # A^2 = trace A
        e, area = (h, h**2 / 2) if trace == 0 else ((sp.exp(trace * h) - 1) / trace, None)
        Ad = one + A * e
        G = one * h + A * (area if area is not None else (e - h) / trace)
        older = (Ad[0],) if A.rows == 1 else (sp.simplify(Ad.trace()), sp.simplify(-Ad.det()))
        return Held(older, (G, (Ad - older[0] * one) * G)[: A.rows], {})
    mean = trace / 2
    swings = sp.expand(4 * det - trace**2)
    w = sp.sqrt(swings if swings.xreplace(dict(first)) > 0 else -swings) / 2
    E, C, S = (sp.Dummy(name, real=True) for name in ("E", "C", "S"))  # exp(A h) = E (C 1 + S (A - mean 1))
    cos, sin = (sp.cos, sp.sin) if swings.xreplace(dict(first)) > 0 else (_cosh, _sinh)
    Ad, inverse = E * (C * one + S * (A - mean * one)), A.inv()
    older = (2 * E * C, -(E**2))
    inputs = (inverse * (Ad - one), inverse * ((older[0] + older[1]) * one - Ad))
    return Held(older, inputs, {E: sp.exp(mean * h), C: cos(w * h), S: sin(w * h) / w})


def _cosh(x: Any) -> Any:
    return (sp.exp(x) + sp.exp(-x)) / 2


def _sinh(x: Any) -> Any:
    return (sp.exp(x) - sp.exp(-x)) / 2
