"""y[k] = F(y[k-1], ..., u[k-tau_d], ..., phi1, phi2): models as expressions, and pools of candidate terms."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb
from typing import Any

import sympy as sp

from ..errors import ModelError
from ..symbolic import printing
from ..symbolic.functions import TABLE
from ..symbolic.grammar import parse
from ..symbolic.identities import canonical, independent
from ..symbolic.recursion import Recursion, State
from ..symbolic.signals import differences, expand_phi, k, lag, lags, samples, shift, signal, t, u, v, x, y
from ..symbolic.smoothing import smoothed, widths
from . import assumptions
from .doors import ModelDoors

MAX_POOL = 20_000
FUNCTIONS = {row.name: row.cls for row in TABLE if row.everywhere and not row.extreme}


class Model(ModelDoors):
    """A difference equation with named parameters, optionally fitted.

    Parameters
    ----------
    F : expression
        The right-hand side of y[k] = F, in samples, phi1, phi2 and the parameter symbols.
    symbols : sequence of Symbol
        The parameters, in the order of `theta`.
    theta : (n_theta,) numbers, optional
    output, input : IndexedBase
        y and u; exchanged in an inverse model.
    operating_point : mapping from a sequence to a number, optional
        The model's signals are measured from here: F speaks of y[k] - y0 and u[k] - u0. `expand` and every law are in
        the user's own units. [units of y and u]
    lead : int
        For an inverse model: y[k] in F stands for the measured y[k + lead] (the paper's tau_s).
    Ts : float, optional
        Sampling time [s].
    states : sequence of State, optional
        Further update equations, evaluated before the output and in the model's shifted signals: what added effects
        remember, the input `v` that they act on, the output `x` that they add to.

    What follows from F, the symbols and the operating point is derived once; only theta and what belongs to a fit
    change afterwards.

    Raises
    ------
    ModelError
        Where F contains something that is neither a signal nor a parameter, or theta has the wrong length.
    """

    def __init__(
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
    ):
        self.states = tuple(states)
        self.F, self.symbols = sp.sympify(F), tuple(symbols)
        self.output, self.input, self.lead, self.Ts = output, input, int(lead), Ts
        self.operating_point = {b: float(v) for b, v in (operating_point or {}).items() if v}
        self.constraints = tuple(constraints)
        self.info: dict[str, Any] = {}
        self.std: tuple[float, ...] | None = None
        self.theta = theta
        if self.recursion.lead:
            raise ModelError(
                f"{output.label}[k] depends on samples after k; a model uses present and past inputs only."
            )

    # -- values ------------------------------------------------------------------------------------------------

    @property
    def theta(self) -> Any:
        """The parameter values, (n_theta,) float array, or None before a fit."""
        return self.array

    @theta.setter
    def theta(self, theta: Sequence[float] | None) -> None:
        if theta is not None and len(theta) != len(self.symbols):
            raise ModelError(f"The model has {len(self.symbols)} parameters; {len(theta)} values were given.")
        if theta is not None and not all(abs(float(v)) < float("inf") for v in theta):
            raise ModelError("A parameter value is not a finite number.")
        self._theta = None if theta is None else tuple(float(v) for v in theta)

    @property
    def values(self) -> dict[Any, Any]:
        """Symbol to value, or an empty mapping before a fit."""
        return {} if self._theta is None else dict(zip(self.symbols, map(sp.Float, self._theta), strict=True))

    # -- equations ---------------------------------------------------------------------------------------------

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
        states = {s.left.base: s for s in self.states}
        F = self.F
        if x in states and not any(samples(s.right, x) for b, s in states.items() if b != x):
            F = self._measured(states[x].right) + self.beside
        for base, state in reversed(states.items()):
            if state not in self.recurrent and not (base == x and state.remembers):
                F = F.xreplace({s: shift(state.right, -lag(s)) for s in samples(F, base)})
        return F

    @property
    def core(self) -> Any:
        """The right-hand side that the base's terms stand in: of `x` where effects act on the output, else F."""
        return next((s.right for s in self.states if s.left.base == x), self.F)

    @property
    def inner(self) -> sp.IndexedBase:
        """The sequence that the core computes: `x` where effects act on the output, else the output."""
        return x if any(s.left.base == x for s in self.states) else self.output

    @property
    def memory(self) -> tuple[State, ...]:
        """The states that effects remember."""
        return tuple(s for s in self.states if s.remembers and s.left.base != x)

    @cached_property
    def recurrent(self) -> tuple[State, ...]:
        """The states other than `x` that depend on their own past, through each other too."""
        reads = {s.left.base: {e.base for e in samples(s.right)} - {x} for s in self.states}
        found = []
        for state in self.states:
            base, more = state.left.base, reads[state.left.base]
            seen: set[Any] = set()
            while more - seen:
                seen |= more
                more = set().union(*(reads.get(b, set()) for b in more))
            if base in seen and base != x:
                found.append(state)
        return tuple(found)

    @cached_property
    def hidden(self) -> tuple[State, ...]:
        """The states that `right` still contains: what effects remember, and `x` where effects act on it."""
        read = {s.base for s in samples(self.right)}
        return tuple(s for s in self.states if s.left.base in read)

    @property
    def beside(self) -> Any:
        """What the output adds to `x`."""
        return self.F - x[k]

    def _measured(self, right: Any) -> Any:
        """Put y - (what the output adds) in the place of past `x`."""
        return right.xreplace(
            {s: self.output[k - lag(s)] - shift(self.beside, -lag(s)) for s in samples(right, x) if lag(s)}
        )

    def in_user_units(self, expr: Any) -> Any:
        """Put y - y0 and u - u0 in the place of the model's shifted signals."""
        return expr.xreplace(
            {s: s - self.operating_point[s.base] for s in samples(expr) if s.base in self.operating_point}
        )

    def expand(self, numbers: bool = False) -> sp.Eq:
        """Return the equation in the user's own units, in samples of y and u, and of what effects remember."""
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

    @property
    def starts(self) -> dict[Any, Any]:
        """What each further state starts from, in samples of the inputs and outputs in the user's units."""
        return {s.left.base: self.in_user_units(s.initial) for s in self.states}

    @property
    def usual(self) -> dict[str, Any]:
        """Where the signals usually are, (low, high) by name: the identified ranges, or around the operating point."""
        around = {str(b.label): (value - 1.0, value + 1.0) for b, value in self.operating_point.items()}
        return around | self.info.get("ranges", {})

    @cached_property
    def predictor(self) -> Recursion:
        """The one-step-ahead prediction: the model fed with measured outputs."""
        ahead = signal("prediction")[k]
        updates = self._updates(self._measured) if self.inner == x else self._updates()
        return Recursion((*updates, (ahead, self._output)), self.symbols)

    @cached_property
    def n_y(self) -> int:
        """The largest lag of the output."""
        return max([0, *lags(self.core, self.inner)])

    @cached_property
    def n_u(self) -> int:
        """The largest lag of the input (phi1[k-2] and phi2[k-2] count as lag 2)."""
        drivers = (self.input, v, *differences(self.input))
        return max([0, *(i for b in drivers for i in lags(self.core, b))])

    @cached_property
    def delay(self) -> int:
        """The pure delay tau_d: the smallest lag of the input."""
        core = expand_phi(self.core)
        return min((i for b in (self.input, v) for i in lags(core, b)), default=0)

    @cached_property
    def structure(self) -> assumptions.Structure:
        """What the assumption rules need to know."""
        return assumptions.Structure(self.output, self.input, self.delay)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the further measured sequences that enter."""
        return tuple(str(b.label) for b in self.recursion.inputs if b not in (self.input, self.output, t))

    def copy(self) -> Model:
        """Return the same model, to be fitted apart."""
        made = copy.copy(self)
        made.info = dict(self.info)
        return made

    def smooth(self, eps: Any = None, form: Any = "tanh") -> Any:
        """Put a smooth function in the place of sign(phi1), before or after identification.

        Parameters
        ----------
        eps : number or mapping from "u" and "y" to numbers, optional
            The width of the change from -1 to 1 [unit of u, of y]. By default 0.3 median steps of the
            record that the model was fitted on.
        form : "tanh", "root", "atan" or a function
            See `narx_sym.symbolic.smoothing.smoothed`.

        Returns
        -------
        A model of the same parameters and values; `.fit(record)` fits it anew.
        """
        eps = widths(eps, {b: str(b.label) for b in (self.output, self.input)}, self.info)

        def change(expr: Any) -> Any:
            return smoothed(expr, eps, form)

        options: dict[str, Any] = {
            "output": self.output, "input": self.input, "operating_point": self.operating_point, "lead": self.lead,
            "Ts": self.Ts, "constraints": self.constraints,
        }  # fmt: skip
        if isinstance(self, NARX):
            made: Model = NARX([change(term) for term in self.terms], self._theta, **options)
        else:
            states = [s.map(change) for s in self.states]
            made = Model(change(self.F), self.symbols, self._theta, states=states, **options)
        made.info |= {
            n: v
            for n, v in self.info.items()
            if n in ("ranges", "rates", "frequencies", "line", "band", "steps", "effects")
        }
        return made

    # -- printing ----------------------------------------------------------------------------------------------

    def latex(self, numbers: bool = False) -> str:
        """LaTeX of the equations, states first and the output last, with symbols or with numbers."""
        values = self.values if numbers else {}
        system = [(left, [(c.xreplace(values), e.xreplace(values)) for c, e in pairs]) for left, pairs in self.system()]
        shown = printing.latex_system(system)
        if self.operating_point:
            where = ", ".join(rf"{b.label} \to {b.label} - ({v:.6g})" for b, v in self.operating_point.items())
            shown += rf" \quad \text{{(around the operating point: }} {where} \text{{)}}"
        return shown

    def parts(self) -> list[tuple[Any, Any]]:
        """(coefficient, term) pairs whose products add up to F."""
        return pairs(self.F)

    def system(self) -> list[tuple[Any, list[tuple[Any, Any]]]]:
        """Return each equation in order, the output's last: its left side and its (coefficient, term) pairs."""
        return [*((s.left, pairs(s.right)) for s in self.states), (self.output[k], self.parts())]

    def lines(self, numbers: bool = False) -> list[str]:
        """Return each equation in order, the output's last, as a text."""
        values = self.values if numbers else {}
        equations = [*((s.left, s.right) for s in self.states), (self.output[k], self.F)]
        return [f"{printing.text(left)} = {printing.text(right.xreplace(values))}" for left, right in equations]

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def table(self) -> list[dict[str, Any]]:
        """One row per parameter: symbol, term, value, standard error."""
        term_of = {c: e for _, listed in self.system() for c, e in listed if c in self.symbols}
        blank = [None] * len(self.symbols)
        return [
            {
                "symbol": str(s),
                "term": printing.text(term_of[s]) if s in term_of else "",
                "theta": v,
                "std": e,
            }
            for s, v, e in zip(self.symbols, self._theta or blank, self.std or blank, strict=True)
        ]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(self.lines(numbers=True))})"


def pairs(expr: Any) -> list[tuple[Any, Any]]:
    """Return (coefficient, term) pairs whose products add up to an expression."""
    return [
        part.as_independent(sp.Indexed, as_Add=False) if part.has(sp.Indexed) else (part, sp.S.One)
        for part in sp.Add.make_args(expr)
    ]


class NARX(Model):
    """A model linear in its parameters: y[k] = sum_i theta_i psi_i, the paper's Eq. (3).

    Parameters
    ----------
    terms : sequence of expressions
        The regressors psi_i, in order; the rest as for `Model`.
    """

    def __init__(self, terms: Iterable[Any], theta: Sequence[float] | None = None, **options: Any):
        listed = list(terms)
        if any(isinstance(t, str) for t in listed):
            raise ModelError("Terms given as text are read by NARX.from_terms.")
        self.terms = [sp.sympify(t) for t in listed]
        if not self.terms:
            raise ModelError("A NARX model needs at least one term.")
        if len(set(self.terms)) < len(self.terms):
            raise ModelError("A term appears twice.")
        symbols = sp.symbols(f"theta_1:{len(self.terms) + 1}", real=True)
        F = sp.Add(*(s * t for s, t in zip(symbols, self.terms, strict=True)))
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

        In an inverse model (`input="y", output="u"`) phi1 and phi2 are the paper's breve forms.

        Raises
        ------
        ParseError
            For a text that is not a term; ModelError for an unknown or repeated one.
        """
        if isinstance(terms, str):
            raise ModelError("Give a list of terms, one text each.")
        bases = {"u": u, "y": y}
        if {input, output} != {"u", "y"}:
            raise ModelError("A model goes from u to y, an inverse model from y to u.")
        source = bases[input]
        breve = dict(zip(differences(u), differences(source), strict=True))
        written = [
            t.xreplace({s: breve.get(s.base, s.base)[s.indices[0]] for s in samples(t)})
            for t in (parse(text, signals=channels) for text in terms)
        ]
        return cls(written, theta, input=source, output=bases[output], **options)

    def parts(self) -> list[tuple[Any, Any]]:
        """(theta_i, psi_i) in the model's order."""
        return list(zip(self.symbols, self.terms, strict=True))


@dataclass(frozen=True)
class Pool:
    """Candidate terms, and what was left out with the reason."""

    terms: list[Any]
    excluded: list[assumptions.Violation]
    duplicates: dict[Any, str]
    structure: assumptions.Structure
    rules: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.terms)

    def __iter__(self) -> Any:
        return iter(self.terms)

    def __repr__(self) -> str:
        banned = len({v.term for v in self.excluded})
        return f"Pool({len(self.terms)} terms; {banned} excluded by rule, {len(self.duplicates)} duplicates)"


def pool(
    n_y: int = 1,
    n_u: int = 2,
    degree: int = 3,
    delay: int = 1,
    *,
    rules: Sequence[str] = (),
    lags: Mapping[str, Any] | None = None,
    functions: Iterable[str] = (),
    phi: bool = True,
    constant: bool = False,
    inverse: bool = False,
) -> Pool:
    """List the candidate terms: products up to `degree` of lagged outputs, inputs, phi1 and phi2.

    Parameters
    ----------
    n_y, n_u : int
        Largest lags of the output and of the input side.
    degree : int
        The paper's l.
    delay : int
        tau_d >= 0, the smallest lag of the input side.
    rules : names of `assumptions.RULES`
        Terms that violate one are excluded, with the reason kept.
    lags : mapping, optional
        Own lags for "y", "u", "phi1", "phi2" or a channel: an int (1 ... n), a range or a list.
    functions : names among abs, sin, cos, tanh, exp, sign
        Applied to each lagged sample (abs also to phi1) as further factors.
    phi : bool
        Whether phi1 and phi2 are candidates at all.
    constant : bool
        Whether the constant 1 is a candidate.
    inverse : bool
        Exchange y and u, as for the identified inverse.

    Returns
    -------
    Pool
        Free of terms that are identically equal to a combination of earlier ones.
    """
    output, source = (u, y) if inverse else (y, u)
    first, second = differences(source)
    if delay < 0 or n_u < delay or n_y < 0 or degree < 1:
        raise ModelError(f"A pool needs n_y >= 0, degree >= 1 and n_u >= delay >= 0; got n_u = {n_u}, delay = {delay}.")
    chosen: dict[str, Any] = {
        str(output.label): range(1, n_y + 1),
        "phi1": range(delay, n_u + 1) if phi else (),
        "phi2": range(delay, n_u + 1) if phi else (),
        str(source.label): range(delay, n_u + 1),
    }
    for name, wanted in (lags or {}).items():
        chosen[name] = range(0 if name not in ("y",) else 1, wanted + 1) if isinstance(wanted, int) else wanted
    named = {"phi1": first, "phi2": second}
    factors = [(named.get(name) or signal(name))[k - i] for name, steps in chosen.items() for i in steps]
    for name in functions:
        if name not in FUNCTIONS:
            raise ModelError(f"Unknown function {name!r}; there are {', '.join(FUNCTIONS)}.")
        plain = [s for s in factors if isinstance(s, sp.Indexed) and s.base != second]
        factors += [FUNCTIONS[name](s) for s in plain]
    wanted = comb(len(factors) + degree, degree)
    if wanted > MAX_POOL:
        raise ModelError(
            f"The pool would have {wanted} terms ({len(factors)} factors, degree {degree}); at most {MAX_POOL} are "
            "built. Lower n_y, n_u or the degree, or name the lags."
        )
    structure = assumptions.Structure(output, source, delay)
    terms: list[Any] = [sp.S.One] if constant else []
    seen = set(terms)
    for size in range(1, degree + 1):
        for product in combinations_with_replacement(factors, size):
            term = sp.Mul(*product)
            if term not in seen:
                seen.add(term)
                terms.append(term)
    # Shortened first: phi2^2 phi1 is phi1, and must not slip past a rule that excludes phi1.
    shortened = {t: short for t in terms if (short := canonical(t)) != t and short in seen}
    excluded = assumptions.violations([t for t in terms if t not in shortened], rules, structure)
    banned = {v.term for v in excluded}
    kept, duplicates = independent([t for t in terms if t not in banned and t not in shortened])
    duplicates |= {t: f"= {printing.text(short)}" for t, short in shortened.items()}
    return Pool(kept, excluded, duplicates, structure, tuple(rules))
