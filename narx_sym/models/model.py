"""y[k] = F(y[k-1], ..., u[k-tau_d], ..., phi1, phi2): models as expressions, and pools of candidate terms."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import FrozenInstanceError
from functools import cached_property
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.grammar import parse
from ..symbolic.recursion import Recursion, State
from ..symbolic.signals import differences, expand_phi, free, k, lags, pairs, renamed, samples, signal, t, u, x, y
from . import assumptions
from .added import AddedEffect, arrivals, flat, measured, own_states, starts
from .doors import ModelDoors
from .info import Info, around

EQUATIONS = ("F", "symbols", "output", "input", "operating_point", "lead", "states")
BESIDE = ("theta", "standard_errors", "Ts", "constraints", "info", "effects", "bounds")  # what changes no equation


def sampling_time(Ts: Any) -> float | None:
    """Return a sampling time [s] as a number; ModelError where it is none, or not positive."""
    try:
        known = None if Ts is None else float(Ts)
    except (TypeError, ValueError):
        known = 0.0
    if known is not None and not 0 < known < float("inf"):
        said = f"{known:g}" if isinstance(Ts, (int, float)) else repr(Ts)
        raise ModelError(f"The sampling time Ts must be a positive number [s], not {said}.")
    return known


class Model(ModelDoors, printing.InLatex):
    """A difference equation y[k] = F with named parameters, fitted or not.

    A model never changes: `fit`, `add` and `replace` return a new one. Models that are linear in their parameters are
    `NARX` models.

    Parameters
    ----------
    F : expression
        The right-hand side, in samples, phi1, phi2 and the parameter symbols.
    symbols : sequence of Symbol
        The parameters, in the order of `theta`.
    theta : (n_theta,) numbers, optional
    output, input : IndexedBase
        y and u; exchanged in an inverse model.
    operating_point : mapping from u and y, or their names, to numbers, optional
        F contains the deviations y[k] - y0 and u[k] - u0 from this point [units of y and u]. `expand` and every law are
        in the user's units.
    lead : int
        For an inverse model: y[k] in F means the measured y[k + lead] (the paper's tau_s).
    Ts : float, optional
        Sampling time [s].
    constraints : sequence of equations, optional
        Linear equations in the parameters that hold exactly, such as Sigma_y = 1.
    states : sequence of State, optional
        Equations that are computed before the output, in deviations from the operating point: internal states of
        effects, the input `v` after effects, the output `x` before effects.
    standard_errors : sequence of numbers, optional
        Of theta, for white noise.
    info : Info
        How the model was fitted, and the ranges and units of its records.
    effects : sequence of AddedEffect
        The added effects, in order.
    bounds : mapping from parameters to (low, high)
        Bounds in a free-run fit.

    Raises
    ------
    ModelError
        If F contains something that is neither a signal nor a parameter, or theta has the wrong length.

    Examples
    --------
    >>> import sympy as sp
    >>> import narx_sym as ns
    >>> from narx_sym import k, u, y
    >>> a, b = sp.symbols("a b", real=True)
    >>> model = ns.Model(a * y[k - 1] + sp.tanh(b * u[k - 1]), (a, b), [0.9, 0.2])
    >>> print(*model.lines(numbers=True))
    y[k] = tanh(0.2*u[k-1]) + 0.9*y[k-1]
    >>> model.delay, model.theta
    (1, array([0.9, 0.2]))
    """

    F: Any
    symbols: tuple[Any, ...]
    numbers: tuple[float, ...] | None  # theta
    standard_errors: tuple[float, ...] | None
    output: sp.IndexedBase
    input: sp.IndexedBase
    operating_point: dict[Any, float]
    lead: int
    Ts: float | None
    constraints: tuple[Any, ...]
    states: tuple[State, ...]
    info: Info
    effects: tuple[AddedEffect, ...]
    bounds: dict[Any, tuple[float, float]]

    def __init__(  # noqa: PLR0913
        self,
        F: Any,
        symbols: Sequence[Any],
        theta: Sequence[float] | None = None,
        *,
        output: sp.IndexedBase = y,
        input: sp.IndexedBase = u,
        operating_point: Mapping[Any, float] | None = None,
        lead: int = 0,
        Ts: float | None = None,
        constraints: Sequence[Any] = (),
        states: Sequence[State] = (),
        standard_errors: Sequence[float] | None = None,
        info: Info | None = None,
        effects: Sequence[AddedEffect] = (),
        bounds: Mapping[Any, tuple[float, float]] | None = None,
    ):
        point = around(operating_point)
        vars(self).update(
            F=sp.sympify(F), symbols=tuple(symbols), output=output, input=input, operating_point=point, lead=int(lead),
            states=tuple(states),
        )  # fmt: skip
        self._carry(theta, standard_errors, Ts, constraints, info or Info(), effects, bounds or {})
        if self.recursion.lead:
            raise ModelError(f"{output.name}[k] depends on samples after k; a model uses present and past inputs only.")

    def _carry(
        self, theta: Any, standard_errors: Any, Ts: Any, constraints: Any, info: Info, effects: Any, bounds: Any
    ) -> None:
        """Take what stands beside the equations; without parameters their values are known."""
        theta = () if theta is None and not self.symbols else theta
        try:
            theta, standard_errors = (n if n is None else [float(v) for v in n] for n in (theta, standard_errors))
            Ts = None if Ts is None else float(Ts)
        except (TypeError, ValueError):
            raise ModelError("theta and its errors must be lists of numbers, and Ts a number.") from None
        for what, numbers in (("values", theta), ("standard errors", standard_errors)):
            if numbers is not None and len(numbers) != len(self.symbols):
                raise ModelError(f"The model has {len(self.symbols)} parameters, but {len(numbers)} {what} were given.")
        if theta is not None and not all(abs(v) < float("inf") for v in theta):
            raise ModelError("A parameter value is not a finite number.")
        Ts = sampling_time(Ts)
        if any(c is sp.false for c in constraints):
            raise ModelError("A constraint is false for every value of the parameters.")
        vars(self).update(
            numbers=None if theta is None else tuple(theta),
            standard_errors=None if standard_errors is None else tuple(standard_errors),
            Ts=Ts, constraints=tuple(constraints), info=info, effects=tuple(effects),
            bounds={s: (float(low), float(high)) for s, (low, high) in bounds.items() if s in self.symbols},
        )  # fmt: skip

    def __setattr__(self, name: str, value: Any) -> None:
        raise FrozenInstanceError(f"A model does not change: model.replace({name}=...) returns another one.")

    def __delattr__(self, name: str) -> None:
        self.__setattr__(name, None)

    def replace(self, **changes: Any) -> Model:
        """Return the model with some of its fields changed, named like the arguments of `Model`.

        A new theta has no standard errors unless they are given too. A `NARX` has `terms` beside them; `F` or
        `symbols` make a `Model` of it.

        Raises
        ------
        ModelError
            For a field that a model does not have, and for what `Model` refuses.
        """
        if "theta" in changes:
            changes = {"standard_errors": None} | changes
        linear = isinstance(self, NARX)
        unknown = changes.keys() - {*EQUATIONS, *BESIDE, *(["terms"] if linear else [])}
        if unknown:
            raise ModelError(f"A model has no field {min(unknown)!r} to replace.")
        if changes.keys() <= set(BESIDE):  # what was derived from the equations stays
            made = copy.copy(self)
            made._carry(**{name: getattr(self, name) for name in BESIDE} | changes)
            return made
        own = ("terms",) if linear and not changes.keys() & {"F", "symbols"} else ("F", "symbols")
        kind = NARX if "terms" in own else Model
        return kind(**{name: getattr(self, name) for name in (*own, *EQUATIONS[2:], *BESIDE)} | changes)

    @property
    def values(self) -> dict[Any, Any]:
        """Symbol to value, or an empty mapping before a fit."""
        return {} if self.numbers is None else dict(zip(self.symbols, map(sp.Float, self.numbers), strict=True))

    @property
    def printed(self) -> dict[Any, Any]:
        """Symbol to value, rounded to the digits that its free run needs (`info.digits`), where these are known."""
        d = self.info.digits
        return {s: sp.Float(f"{float(v):.{d}g}", d) for s, v in self.values.items()} if d else self.values

    @property
    def equation(self) -> sp.Eq:
        """y[k] = F in the paper's notation; around an operating point the signals are the shifted ones."""
        return sp.Eq(self.output[k], self.F, evaluate=False)

    @cached_property
    def right(self) -> Any:
        """The output's equation in the user's units, phi1 and phi2 written out, states without memory put in."""
        return self.in_user_units(expand_phi(self.flat)) + self.operating_point.get(self.output, 0)

    @cached_property
    def flat(self) -> Any:
        """F in the model's shifted signals; `x` and states without memory are eliminated, where algebra can do it."""
        return flat(self)

    @property
    def core(self) -> Any:
        """The right-hand side that the base's terms stand in; see `driven`."""
        return next((s.right for s in self.states if s.left.base == self.driven), self.F)

    @property
    def driven(self) -> sp.IndexedBase:
        """The sequence that the base's terms add up to: `free` where effects act on the motion, else `inner`."""
        return free if any(s.left.base == free for s in self.states) else self.inner

    @property
    def inner(self) -> sp.IndexedBase:
        """The sequence that the core computes: `x` where effects act on the output, else the output."""
        return x if any(s.left.base == x for s in self.states) else self.output

    @property
    def memory(self) -> tuple[State, ...]:
        """The internal states of the model and its effects."""
        own, past = own_states(self), {s.base for s in self.recursion.past}
        kept = {s.left.base for s in self.recurrent} & past
        return tuple(s for s in self.states if (s.left.base in kept or s.left.base.name in own) and s.left.base != x)

    @cached_property
    def recurrent(self) -> tuple[State, ...]:
        """The states other than `x` that depend on their own past, through each other too."""
        own = self.recursion.graph.without(x, self.output).recurrent
        return tuple(s for s in self.states if s.left.base in own)

    @cached_property
    def hidden(self) -> tuple[State, ...]:
        """The states that `right` still contains: what effects remember, and `x` where effects act on it."""
        read = {s.base for s in samples(self.right)}
        return tuple(s for s in self.states if s.left.base in read)

    @property
    def beside(self) -> Any:
        """The terms that the output equation adds to `x`."""
        return self.F - x[k]

    def in_user_units(self, expr: Any) -> Any:
        """Put y - y0 and u - u0 in the place of the model's shifted signals."""
        point = self.operating_point
        return renamed(expr, {s: s - point[s.base] for s in samples(expr) if s.base in point}) if point else expr

    def expand(self, numbers: bool = False) -> sp.Eq:
        """Return the equation in the user's units, in samples of y, u and the states of effects."""
        return sp.Eq(self.output[k], self.right.xreplace(self.values if numbers else {}), evaluate=False)

    @cached_property
    def recursion(self) -> Recursion:
        """The model as an update equation in the user's units."""
        return Recursion((*self._updates(), (self.output[k], self._output)), self.symbols)

    @property
    def _output(self) -> Any:
        """F in the user's units."""
        return self.in_user_units(expand_phi(self.F)) + self.operating_point.get(self.output, 0)

    def _updates(self, change: Any = lambda right: right) -> list[tuple[Any, Any]]:
        return [(s.left, self.in_user_units(expand_phi(change(s.right)))) for s in self.states]

    @cached_property
    def starts(self) -> dict[Any, Any]:
        """Start values of the states, in samples of inputs and outputs in the user's units."""
        return {base: self.in_user_units(e) for base, e in starts(self).items()}

    @property
    def usual(self) -> dict[str, Any]:
        """Where the signals usually are, (low, high) by name: as identified, or around the operating point."""
        around = {b.name: (value - 1.0, value + 1.0) for b, value in self.operating_point.items()}
        return around | dict(self.info.ranges)

    @cached_property
    def predictor(self) -> Recursion:
        """The one-step-ahead prediction: the model fed with measured outputs."""
        ahead = signal("prediction")[k]
        updates = self._updates(lambda right: measured(self, right)) if self.inner == x else self._updates()
        return Recursion((*updates, (ahead, self._output)), self.symbols)

    @cached_property
    def n_y(self) -> int:
        """The largest lag of the output, in the linear part and in effects on the motion."""
        moving = next((s.right for s in self.states if s.left.base == self.inner), self.F)
        return max([0, *lags(self.core, self.inner), *lags(moving, self.inner)])

    @cached_property
    def n_u(self) -> int:
        """The largest lag of the input (phi1[k-2] and phi2[k-2] count as lag 2)."""
        return max([0, *arrivals(self, self.core, (self.input, *differences(self.input)))])

    @cached_property
    def delay(self) -> int:
        """The delay tau_d: the smallest lag of the input [samples]."""
        return min(arrivals(self, expand_phi(self.core), (self.input,)), default=0)

    @cached_property
    def structure(self) -> assumptions.Structure:
        """What the assumption rules need to know."""
        return assumptions.Structure(self.output, self.input, self.delay)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the further measured signals in the equations."""
        return tuple(b.name for b in self.recursion.inputs if b not in (self.input, self.output, t))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs: the input and the channels."""
        return (self.input.name, *self.channels)

    def latex(self, numbers: bool = False) -> str:
        """LaTeX of the equations, states first and the output last, with symbols or with numbers."""
        values = self.printed if numbers else {}
        system = [(left, [(c.xreplace(values), e.xreplace(values)) for c, e in pairs]) for left, pairs in self.system()]
        shown = printing.latex_system(system)
        if self.operating_point:
            where = ", ".join(rf"{b.name} \to {b.label} - ({v:.6g})" for b, v in self.operating_point.items())
            shown += rf" \quad \text{{(around the operating point: }} {where} \text{{)}}"
        return shown

    def parts(self) -> list[tuple[Any, Any]]:
        """(coefficient, term) pairs whose products add up to F."""
        return pairs(self.F)

    def system(self) -> list[tuple[Any, list[tuple[Any, Any]]]]:
        """Return each equation in order, the output's last: its left side and its (coefficient, term) pairs."""
        return [*((s.left, pairs(s.right)) for s in self.states), (self.output[k], self.parts())]

    def lines(self, numbers: bool = False) -> list[str]:
        """Return each equation as text; the equation of the output is the last."""
        values = self.printed if numbers else {}
        equations = [*((s.left, s.right) for s in self.states), (self.output[k], self.F)]
        return [f"{printing.text(left)} = {printing.text(right.xreplace(values))}" for left, right in equations]

    def table(self) -> list[dict[str, Any]]:
        """One row per parameter: symbol, term, value, standard error."""
        term_of = {c: e for _, listed in self.system() for c, e in listed if c in self.symbols}
        blank = [None] * len(self.symbols)
        said = {s: printing.text(term) for s, term in term_of.items()}
        return [
            {"symbol": str(s), "term": said.get(s, ""), "theta": v, "standard_error": e}
            for s, v, e in zip(self.symbols, self.numbers or blank, self.standard_errors or blank, strict=True)
        ]

    def __repr__(self) -> str:
        """Return the equations with six digits, and the operating point: a text to read."""
        system = [*((s.left, s.right) for s in self.states), (self.output[k], self.F)]
        lines = [f"{printing.shown(left)} = {printing.shown(right.xreplace(self.values))}" for left, right in system]
        point = ", ".join(f"{b.name} = {printing.shown(sp.Float(v))}" for b, v in self.operating_point.items())
        return f"{type(self).__name__}({'; '.join(lines)}{'; around ' * bool(point)}{point})"

    def __eq__(self, other: object) -> bool:
        """Whether two models have the same equations and values, and the same is known of both."""
        return self is other or (isinstance(other, Model) and _content(self) == _content(other))

    def __hash__(self) -> int:
        return hash((self.F, self.symbols, self.numbers))


def _content(model: Model) -> tuple[Any, ...]:
    """Return all that a model is, so that equal ones compare equal: constraints as what must vanish, NaN as None."""

    def plain(value: Any) -> Any:
        if isinstance(value, float) and value != value:
            return None
        if isinstance(value, sp.Eq):
            return sp.expand(value.lhs - value.rhs)
        if isinstance(value, Mapping):
            return {name: plain(one) for name, one in value.items()}
        return [plain(one) for one in value] if isinstance(value, (list, tuple)) else value

    own = (model.parts(), *(getattr(model, name) for name in (*EQUATIONS, "numbers", *BESIDE[1:])))
    return type(model), [plain(one) for one in own if one is not sp.true]


class NARX(Model):
    """A model that is linear in its parameters: y[k] = sum_i theta_i psi_i, Eq. (3) of the paper.

    `terms` are the regressors psi_i, in order; for the other parameters see `Model`. Terms as text: `NARX.from_terms`.

    Examples
    --------
    >>> import narx_sym as ns
    >>> model = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "u[k-1]*y[k-1]"], theta=[1.0, 0.7, -0.1])
    >>> model.sigma_y, model.theta
    (theta_1, array([ 1. ,  0.7, -0.1]))
    """

    terms: tuple[Any, ...]

    def __init__(self, terms: Iterable[Any], theta: Sequence[float] | None = None, **options: Any):
        listed = list(terms)
        if any(isinstance(t, str) for t in listed):
            raise ModelError("Terms given as text are read by NARX.from_terms.")
        terms = tuple(sp.sympify(t) for t in listed)
        if not terms:
            raise ModelError("A NARX model needs at least one term.")
        if len(set(terms)) < len(terms):
            raise ModelError("A term appears twice.")
        vars(self).update(terms=terms)
        symbols = sp.symbols(f"theta_1:{len(terms) + 1}", real=True)
        F = sp.Add(*(s * t for s, t in zip(symbols, terms, strict=True)))
        super().__init__(F, symbols, theta, **options)

    @classmethod
    def from_terms(
        cls,
        terms: Iterable[str],
        theta: Sequence[float] | None = None,
        input: str = "u",
        output: str = "y",
        channels: Iterable[str] = (),
        **options: Any,
    ) -> NARX:
        """Build a model from texts such as "phi2[k-2]*phi1[k-2]*u[k-2]".

        phi1 and phi2 are of the input; in an inverse model (`input="y", output="u"`) the paper's breve forms.

        Raises
        ------
        ParseError
            For a text that is not a term; ModelError for an unknown or repeated one.
        """
        if isinstance(terms, str):
            raise ModelError("Give a list of terms, one text each.")
        if (input == "y") != (output == "u") or output not in ("u", "y") or input in ("t", "k"):
            raise ModelError("A model goes from u, or another measured signal, to y; an inverse model from y to u.")
        source = signal(input)
        parsed = [parse(text, signals=[*channels, *([] if input in ("u", "y") else [input])]) for text in terms]
        if input == "y":
            breve = dict(zip(differences(u), differences(source), strict=True))
            written = [t.xreplace({s: breve.get(s.base, s.base)[s.indices[0]] for s in samples(t)}) for t in parsed]
        else:
            written = parsed if input == "u" else [expand_phi(t, source) for t in parsed]
        return cls(written, theta, input=source, output=signal(output), **options)

    def parts(self) -> list[tuple[Any, Any]]:
        """(theta_i, psi_i) in the model's order."""
        return list(zip(self.symbols, self.terms, strict=True))
