"""Section 4 of the paper: compensation laws by algebraic inversion, and from an identified inverse.

A law is a recursion for m[k] in past m and (future) r; putting it back into the model gives r[k + tau_d] identically.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy as sp

from . import printing
from .analysis import effects_of, newest_input, remembered
from .errors import NotInvertible
from .internal import InternalDynamics, internal_dynamics
from .model import Model
from .recursion import Recursion
from .sensitivity import derivative
from .signals import expand_phi, k, lag, m, r, samples, shift, swap, u, y
from .smoothing import smoothed, widths

q = sp.Symbol("q")


@dataclass(frozen=True)
class Compensator:
    """A compensation law m[k] = ... that makes the model's output follow the reference r.

    Attributes
    ----------
    model : Model
    law : expression
        The right-hand side of m[k], in the user's units.
    A, B : expressions in q, f : expression
        A(q) y[k] = B(q) u[k] + f(...), the grouping of the paper; None for an identified inverse.
    """

    model: Model
    law: Any
    A: Any = None
    B: Any = None
    f: Any = None

    @property
    def equation(self) -> sp.Eq:
        """m[k] = law."""
        return sp.Eq(m[k], self.law, evaluate=False)

    @property
    def symbols(self) -> tuple[Any, ...]:
        """The parameter symbols of the model."""
        return self.model.symbols

    @property
    def recursion(self) -> Recursion:
        """The law as an update equation; its inputs are r and any further channels."""
        return Recursion(((m[k], self.law),), self.symbols)

    @property
    def preview(self) -> int:
        """How many samples of the reference ahead of k the law needs (tau_d, or tau_s - 1)."""
        return self.recursion.lead

    def expand(self) -> sp.Eq:
        """Return the law with numbers in the place of the parameters."""
        return sp.Eq(m[k], self.law.xreplace(self.model.values), evaluate=False)

    def residual(self) -> Any:
        """Put the law into the model and subtract the reference: 0 where the inversion is exact."""
        if self.A is None:  # an identified inverse is its own law: nothing was inverted
            return sp.simplify(self.law - swap(self.model.right, {u: m, y: r}, {y: self.model.lead}))
        delay = newest_input(self.model)
        followed = shift(swap(self.model.right, {u: m, y: r}), delay)
        return sp.simplify(sp.expand(followed.xreplace({m[k]: self.law}) - r[k + delay]))

    @cached_property
    def internal(self) -> InternalDynamics:
        """The law's own dynamics: whether it can run away although the model follows."""
        return internal_dynamics(self)

    def smooth(self, eps: Any = None, form: Any = "tanh") -> Compensator:
        """Put a smooth function in the place of the sign of a step of m or r; see `narx_sym.model.Model.smooth`.

        `eps` speaks of u and y: m has the unit of u, r that of y.
        """
        own = widths(eps, {m: "u", r: "y"}, self.model.info)
        f = None if self.f is None else smoothed(self.f, widths(eps, {u: "u", y: "y"}, self.model.info), form)
        return replace(self, model=self.model.smooth(eps, form), law=smoothed(self.law, own, form), f=f)

    def run(self, reference: Any, m0: Any = None, channels: Mapping[str, Any] | None = None) -> Any:
        """Compute m over a reference; see `narx_sym.simulation.run_law`."""
        from .simulation import run_law

        return run_law(self, reference, m0, channels)

    def rest_input(self, output: float) -> float:
        """Return the input to start from; see `narx_sym.simulation.rest_input`."""
        from .simulation import rest_input

        return rest_input(self.model, float(output))

    def to_c(self, name: str = "law", single: bool = False) -> str:
        """Return the law as C99 source; see `narx_sym.export.to_c`."""
        from .export import to_c

        usual = {own: self.model.usual[of] for own, of in (("m", "u"), ("r", "y")) if of in self.model.usual}
        return to_c(
            self.recursion, self.model.values, name, single, m, ranges={**self.model.usual, **usual}, Ts=self.model.Ts
        )

    def to_st(self, name: str = "law", single: bool = False) -> str:
        """Return the law as an IEC 61131-3 function block; see `narx_sym.export.to_st`."""
        from .export import to_st

        return to_st(self.recursion, self.model.values, name, single, m, Ts=self.model.Ts)

    def to_casadi(self, name: str = "law") -> Any:
        """Return one step as a CasADi `Function` (state, inputs) -> (next, output).

        state : `recursion.past`, such as m[k-1], r[k]; `rest_state` gives its values at rest
        inputs : `recursion.given`, the reference at the end of the preview, such as r[k+1]; output is m[k]
        """
        from .export import transition

        return transition(self.recursion, self.model.values, name, m)

    def rest_state(self, **rest: float) -> Any:
        """Return the state of `to_casadi` at rest: `law.rest_state(m=1.0, r=2.0)`."""
        from .interop import rest_state

        return rest_state(self.recursion, {}, rest)

    def latex(self, numbers: bool = False) -> str:
        """LaTeX of the law, grouped as in the paper: one bracket over the coefficient of the newest input."""
        values = self.model.values if numbers else {}
        if self.A is None:
            parts = [(c.xreplace(values), t) for c, t in self._grouped(self.law)]
            return printing.latex_sum(m[k], parts)
        numerator, gain = self._fraction()
        parts = [(c.xreplace(values), t) for c, t in self._grouped(numerator)]
        body = printing.latex_sum(m[k], parts)
        opening = rf"&= \frac{{1}}{{{printing.latex(gain.xreplace(values))}}} \Big[ "
        return body.replace("&= ", opening, 1).replace("\n\\end{aligned}", " \\Big]\n\\end{aligned}")

    def latex_grouping(self) -> list[str]:
        """LaTeX of A(q), B(q) and f, the linear regressors and the rest; empty for an identified inverse."""
        if self.A is None:
            return []
        back = sp.Symbol("back")  # q^{-1}
        lines = []
        for name, expr in (("A(q)", self.A), ("B(q)", self.B)):
            powers = sp.Poly(expr.subs(q, 1 / back), back).terms()
            terms = [(c, q ** (-n)) for (n,), c in reversed(powers) if c != 0]
            lines.append(printing.latex_sum(sp.Symbol(name), terms, per_line=6))
        return [*lines, printing.latex_sum(sp.Symbol(r"f(\cdot)"), self._grouped(self.f), per_line=2)]

    def _fraction(self) -> tuple[Any, Any]:
        gain = derivative(self.model.right, self.model.input[k - newest_input(self.model)])
        return sp.Add(*(p * gain for p in sp.Add.make_args(self.law))), gain

    def _grouped(self, expr: Any) -> list[tuple[Any, Any]]:
        """(coefficient, term) pairs; differences stay in brackets as the model's own terms have them."""
        pairs = []
        for part in sp.Add.make_args(expr):
            held = [f for f in sp.Mul.make_args(part) if not f.has(sp.Indexed)]
            coefficient = sp.Mul(*held)
            pairs.append((coefficient, sp.Mul(*(f for f in sp.Mul.make_args(part) if f.has(sp.Indexed)))))
        # References first, then past inputs, then the nonlinear terms: the order of the paper.
        return sorted(
            pairs,
            key=lambda p: (
                len(samples(p[1])) > 1,
                not p[1].has(r),
                lag(min(samples(p[1]), key=lag)) if samples(p[1]) else 9,
                len(str(p[1])),
            ),
        )

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def __repr__(self) -> str:
        return f"Compensator(m[k] = {printing.text(self.expand().rhs)})"


def _addends(model: Model) -> list[tuple[Any, Any]]:
    """Return what the output adds up: each term, and the same with its coefficient in the user's units."""
    if model.states:
        return [(part, part) for part in sp.Add.make_args(sp.expand(model.right))]
    return [(term, c * expand_phi(model.in_user_units(term))) for c, term in model.parts()]


def _offending(model: Model) -> list[tuple[Any, Any]]:
    latest = model.input[k - newest_input(model)]
    return [
        (term, written)
        for term, written in _addends(model)
        if (written.has(latest) and samples(derivative(written, latest))) or _hidden(written, latest)
    ]


def offending_terms(model: Model) -> list[Any]:
    """Return the terms that contain u[k - tau_d] other than linearly with a constant coefficient (Assumption A1(i))."""
    return [term for term, _ in _offending(model)]


def _hidden(expr: Any, sample: Any) -> bool:
    return any(f.has(sample) for f in expr.atoms(sp.Function, sp.Piecewise))


def polynomials(model: Model) -> tuple[Any, Any, Any]:
    """Group a model as A(q) y[k] = B(q) u[k] + f: the linear regressors, and all the rest in f."""
    offset = sp.S.Zero if model.states else model.operating_point.get(model.output, sp.S.Zero)
    A, B, f = sp.S.One, sp.S.Zero, offset
    for _, written in _addends(model):
        pieces = sp.Add.make_args(sp.expand(written))
        if all(len(_samples_with_powers(p)) <= 1 for p in pieces):
            for piece in pieces:
                found = _samples_with_powers(piece)
                if not found or found[0].base not in (model.input, model.output):
                    f += piece
                elif found[0].base == model.output:
                    A -= piece / found[0] * q ** (-lag(found[0]))
                else:
                    B += piece / found[0] * q ** (-lag(found[0]))
        else:
            f += written
    return A, B, f


def _samples_with_powers(piece: Any) -> list[Any]:
    """Return the samples of a product with repetition; a sample inside a function counts twice."""
    found: list[Any] = []
    for factor in sp.Mul.make_args(piece):
        base, exponent = factor.as_base_exp()
        if isinstance(base, sp.Indexed) and exponent == 1:
            found.append(base)
        else:
            found += samples(factor) * 2
    return found


def compensator(model: Model) -> Compensator:
    """Derive the compensation law of a model, or of an identified inverse.

    Strategy 1 (Eq. Cms:InputCompensation): y becomes r, u becomes m, and m[k - tau_d + 1] is isolated one step ahead;
    written here for m[k], it needs the reference up to k + tau_d. Strategy 2 (Eq. Cci:InputCompensation): in an
    identified inverse y[k-j] becomes r[k-j+tau_s].

    Raises
    ------
    NotInvertible
        Naming the terms or the effects that violate Assumption A1(i), the effects that remember, or what else is
        missing.
    """
    if model.input == y:
        law = swap(model.right, {u: m, y: r}, {y: model.lead})
        return Compensator(model, law)
    if model.hidden:
        raise NotInvertible(_memory(model))
    right = model.right
    if not samples(right, model.input):
        raise NotInvertible("The model has no input term: there is nothing to solve for (Assumption A1).")
    delay = newest_input(model)
    latest = model.input[k - delay]
    found = _offending(model)
    added = {str(s) for s in model.symbols} & {c for e in model.info.get("effects", []) for c in e["coefficients"]}
    own = [one for one in found if added & {str(s) for s in one[1].free_symbols}]
    if own:
        names = effects_of(model, sp.Add(*(written for _, written in own)))
        raise NotInvertible(
            f"{printing.text(latest)} cannot be isolated: {names} uses it other than linearly, as in "
            f"{printing.text(own[0][0])} (Assumption A1(i))."
        )
    bad = [term for term, _ in found]
    if bad:
        named = ", ".join(printing.text(t) for t in bad)
        raise NotInvertible(
            f"{printing.text(latest)} cannot be isolated: {named} {'violates' if len(bad) == 1 else 'violate'} "
            "Assumption A1(i) (the only regressor involving u[k-tau_d] must be linear). "
            "Identify with for_compensation=True (--for-compensation), which keeps such terms out of the pool."
        )
    gain = derivative(right, latest)
    value = gain.xreplace(model.values)
    if value == 0 or (value.is_number and abs(float(value)) < 1e-300):
        raise NotInvertible(f"The coefficient of {printing.text(latest)} is zero: the input does not act (A1(i)).")
    rest = _drop(right, latest)
    law = sp.Add(*(p / gain for p in (r[k + delay], *(-x for x in sp.Add.make_args(_renamed(rest, delay))))))
    A, B, f = polynomials(model)
    return Compensator(model, law, A, B, f)


def _memory(model: Model) -> str:
    """Say why a model with hidden states has no law: what remembers, and what drives it."""
    arriving = list(_arrivals(model, model.F))
    delay = min((i for i, _ in arriving), default=0)
    passed = {base for i, through in arriving if i == delay for base in through}
    holding = [s for s in model.recurrent if s.left.base in passed]
    if holding:
        shown = ", ".join(printing.text(s.left) for s in holding)
        return (
            f"{printing.text(model.input[k - delay])} cannot be isolated: {effects_of(model, states=holding)} "
            f"remembers it ({shown}); there is no closed form yet."
        )
    return f"The law is not derived yet: {remembered(model)}, and the law would need it."


def _arrivals(model: Model, expr: Any, through: frozenset[Any] = frozenset()) -> Iterator[tuple[int, frozenset[Any]]]:
    """Yield the lags at which the input reaches an expression, each with the states that it passes."""
    states = {s.left.base: s.right for s in model.states}
    for s in samples(expand_phi(expr)):
        if s.base == model.input:
            yield lag(s), through
        elif s.base in states and s.base not in through:
            for i, passed in _arrivals(model, states[s.base], through | {s.base}):
                yield lag(s) + i, passed


def _drop(right: Any, latest: Any) -> Any:
    """Set the newest input to zero where it stands (it is linear, so nothing else changes)."""
    return sp.Add(*(p.xreplace({latest: sp.S.Zero}) if p.has(latest) else p for p in sp.Add.make_args(right)))


def _renamed(rest: Any, delay: int) -> Any:
    return shift(swap(rest, {u: m, y: r}), delay)
