"""Section 4 of the paper: compensation laws by algebraic inversion, and from an identified inverse.

A law is a recursion for m[k] in past m and (future) r; putting it back into the model gives r[k + tau_d] identically.
Models beyond Assumption A1 are inverted in stages (`stages`), each of them by branches (`solve`); where m[k] stands
in powers it is a root of a polynomial (arXiv 2011.12246; `solution.Polynomial` says which).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy as sp

from ..errors import ModelError, NotInvertible
from ..models.model import Model
from ..models.rest_map import newest_input
from ..models.rewrite import own_names, set_apart
from ..symbolic import printing
from ..symbolic.functions import follows, within
from ..symbolic.identities import vanishes
from ..symbolic.recursion import Recursion
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import k, lag, m, r, samples, shift, swap, u, y
from ..symbolic.smoothing import smoothed, widths
from .doors import CompensatorDoors
from .grouping import offending, polynomials, q, why_not
from .solution import Branch, Polynomial
from .stability import InternalDynamics, InternalRecursion, internal_dynamics
from .stages import Staged, guarded, in_order, stages_of, wanted

BESIDE = ("wanted", "taken", "share", "kick")  # behind the name of what a law computes: what a run needs beside it


@dataclass(frozen=True)
class Compensator(CompensatorDoors):
    """A compensation law m[k] = ... : it computes the input with which the output of the model follows a reference r.

    Derive it with `model.compensator()`, and run it with `law.run(r)`.

    Attributes
    ----------
    model : Model
    law : expression
        The right-hand side of m[k], in the user's units.
    A, B : expressions in q, f : expression
        A(q) y[k] = B(q) u[k] + f(...), as grouped in the paper; None for an identified inverse, and if Assumption A1
        does not hold.
    staged : Staged, optional
        If A1 does not hold: the equations to solve, from the output back to the input.
    aside : pairs of names
        Channels and states of the model whose names the law needs for itself, and their new names.

    Examples
    --------
    >>> import narx_sym as ns
    >>> model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.5, 2.0])
    >>> law = model.compensator()
    >>> print(*law.lines())
    m[k] = -theta_1*r[k]/theta_2 + r[k+1]/theta_2
    >>> law.residual()
    0
    >>> law.run([0.0, 1.0, 2.0, 2.0], m0=0.0)
    array([0.5 , 0.75, 0.5 , 0.5 ])
    """

    model: Model
    law: Any
    A: Any = None
    B: Any = None
    f: Any = None
    staged: Staged | None = None
    aside: tuple[tuple[str, str], ...] = ()

    def named(self, channels: Mapping[str, Any] | None) -> dict[str, Any]:
        """Return channels under the names that they have in the law."""
        known = dict(self.aside)
        return {known.get(name, name): value for name, value in (channels or {}).items()}

    @property
    def equation(self) -> sp.Eq:
        """m[k] = law."""
        return sp.Eq(m[k], self.law, evaluate=False)

    @property
    def symbols(self) -> tuple[Any, ...]:
        """The parameter symbols of the model."""
        return self.model.symbols

    @property
    def theta(self) -> Any:
        """The values of the model's parameters, (n_theta,) float array that cannot be written to, or None."""
        return self.model.theta

    @property
    def updates(self) -> tuple[tuple[Any, Any], ...]:
        """The law's equations in the order of the stages, in true time: x[k+1] is computed together with m[k]."""
        return self.staged.updates if self.staged else ((m[k], self.law),)

    @cached_property
    def recursion(self) -> Recursion:
        """The law as update equations; its inputs are r and any further channels.

        What is computed ahead of k is shifted: the recursion's x[k] is the x[k+1] of `updates`.
        """
        return in_order(self.updates, self.symbols)

    def limited(
        self, limits: Sequence[float] | None = None, rate: float | None = None, share: float = 1.0
    ) -> Recursion:
        """Return the law with limits of the actuator and damping, together with the model.

        Where the actuator cannot follow, the law goes on from the model's own output instead of the reference's past.

        Parameters
        ----------
        limits : (lowest, highest) input [unit of u]
        rate : largest change of the input from sample to sample [unit of u]
        share : of the change that the law asks for, the part that the input goes in a sample

        Raises
        ------
        ModelError
            For limits that are not increasing, a rate that is not positive, and a share that is no part of one.
        """
        low, high = allowed(limits, rate)
        if not 0 < share <= 1 or (share < 1 and self.model.input == y):
            raise ModelError("share must be above 0 and at most 1; an identified inverse is not damped.")

        def clipped(asked: Any) -> Any:
            if share < 1:
                asked = m[k - 1] + sp.Float(share) * (asked - m[k - 1])
            if rate is not None:
                asked = follows(asked, m[k - 1], sp.Float(rate))
            return within(asked, sp.sympify(low), sp.sympify(high))

        if self.model.input == y:
            asked = wanted(m)[k]
            return in_order([(asked, self.law), (m[k], clipped(asked))], self.symbols)
        plain = limits is None and rate is None and share == 1
        return self._free if plain else in_order(self.beside(clipped), self.symbols)

    @cached_property
    def _free(self) -> Recursion:
        return in_order(self.beside(), self.symbols)

    def beside(self, clipped: Any = lambda asked: asked) -> Any:
        """Return the law together with the model; see `narx_sym.inversion.stages.guarded`."""
        return guarded(self.staged or stages_of(self.model), clipped)

    @property
    def starts(self) -> dict[Any, Any]:
        """What each state of the model beside the law is at rest, in samples of m and of the model's output."""
        return {base: swap(e, {self.model.input: m}) for base, e in self.model.starts.items()}

    @property
    def preview(self) -> int:
        """How many samples of the reference ahead of k the law needs (tau_d, or tau_s - 1)."""
        return max([0, *(-lag(s) for _, right in self.updates for s in samples(right, r))])

    @property
    def closed_form(self) -> bool:
        """Whether no root finder is needed."""
        return self.staged is None or all(s.closed_form for s in self.staged.stages)

    @property
    def branches(self) -> tuple[Branch, ...]:
        """The cases of every stage that has several, from the output to the input: conditions and solutions."""
        stages = self.staged.stages if self.staged else ()
        return tuple(b for s in stages if len(s.branches) > 1 for b in s.branches)

    @cached_property
    def checked(self) -> str:
        """Whether the solution is unique, in words: by proof or by a numerical check; see `check`."""
        return str(self.check())

    def expand(self) -> sp.Eq:
        """Return the law with numbers in the place of the parameters."""
        return sp.Eq(m[k], self.law.xreplace(self.model.values), evaluate=False)

    @property
    def polynomials(self) -> tuple[Polynomial, ...]:
        """Of each stage whose unknown is a root of a polynomial that polynomial, from the output to the input."""
        found = (s.polynomial for s in (self.staged.stages if self.staged else ()))
        return tuple(p for p in found if p is not None)

    def lines(self, numbers: bool = False) -> list[str]:
        """Return each equation of the law as text, then which roots are taken."""
        values = self.model.values if numbers else {}
        return [*self._equations(values), *(p.held(values).sentence for p in self.polynomials)]

    def _equations(self, values: Mapping[Any, Any]) -> list[str]:
        return [f"{printing.text(left)} = {printing.text(right.xreplace(values))}" for left, right in self.updates]

    def residual(self) -> Any:
        """Substitute the law into the model and subtract the reference: 0 if the inversion is exact.

        Beyond A1 each branch is put into the equation of its stage.
        """
        if self.staged:
            return next((gap for s in self.staged.stages if (gap := s.residual()) != 0), sp.S.Zero)
        if self.A is None:  # an identified inverse is its own law: nothing was inverted
            return sp.simplify(self.law - swap(self.model.right, {u: m, y: r}, {y: self.model.lead}))
        delay = newest_input(self.model)
        followed = shift(swap(self.model.right, {self.model.input: m, y: r}), delay)
        gap = sp.expand(followed.xreplace({m[k]: self.law}) - r[k + delay])
        return sp.S.Zero if gap == 0 or vanishes(gap) else gap

    @cached_property
    def internal(self) -> InternalDynamics | InternalRecursion:
        """The internal dynamics of the law: they show whether it can diverge."""
        return internal_dynamics(self)

    def smooth(self, eps: Any = None, form: Any = "tanh") -> Compensator:
        """Put a smooth function in the place of the sign of a step of m or r; see `narx_sym.models.model.Model.smooth`.

        `eps` speaks of u and y: m has the unit of u, r that of y. ModelError for a law with branches or states.
        """
        if self.staged:
            raise ModelError("A law with branches or further states is not smoothed: smooth the model first.")
        own = widths(eps, {m: "u", r: "y"}, self.model.info.steps)
        f = None if self.f is None else smoothed(self.f, widths(eps, {u: "u", y: "y"}, self.model.info.steps), form)
        return replace(self, model=self.model.smooth(eps, form), law=smoothed(self.law, own, form), f=f)

    def latex(self, numbers: bool = False) -> str:
        """LaTeX of the law, grouped as in the paper: one bracket over the coefficient of the newest input."""
        if self.staged:
            return printing.latex_law(self.grouped(numbers))
        gain, parts = self._bracket(numbers)
        body = printing.latex_sum(m[k], parts)
        if self.A is None:
            return body
        opening = rf"&= \frac{{1}}{{{printing.latex(gain)}}} \Big[ "
        return body.replace("&= ", opening, 1).replace("\n\\end{aligned}", " \\Big]\n\\end{aligned}")

    def grouped(self, numbers: bool = False) -> list[tuple[Any, Any]]:
        """Return the equations as `latex` shows them: the gain stands beside m[k], and nothing is multiplied out."""
        if self.staged:
            values = self.model.values if numbers else {}
            return [(left, right.xreplace(values)) for left, right in self.updates]
        gain, parts = self._bracket(numbers)
        terms = (sp.Mul(c, term, evaluate=False) for c, term in parts)
        return [(sp.Mul(gain, m[k], evaluate=False), sp.Add(*terms, evaluate=False))]

    def _bracket(self, numbers: bool) -> tuple[Any, list[tuple[Any, Any]]]:
        """Return the coefficient of the newest input, and the grouped terms that are divided by it."""
        values = self.model.values if numbers else {}
        numerator, gain = (self.law, sp.S.One) if self.A is None else self._fraction()
        return gain.xreplace(values), [(c.xreplace(values), term) for c, term in self._grouped(numerator)]

    def latex_stability(self) -> str:
        """LaTeX of the first line: whether the law is stable, and where it is known."""
        return printing.latex_text(str(self.stability()))

    def latex_polynomials(self, numbers: bool = False) -> list[str]:
        """LaTeX of the polynomials whose roots the law takes."""
        return [p.held(self.model.values if numbers else {}).latex() for p in self.polynomials]

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
        pairs = [part.as_independent(sp.Indexed, as_Add=False) for part in sp.Add.make_args(expr)]

        def place(pair: tuple[Any, Any]) -> tuple[Any, ...]:
            # References first, then past inputs, then the nonlinear terms: the order of the paper.
            read = samples(pair[1])
            return len(read) > 1, not pair[1].has(r), min(map(lag, read), default=9), len(str(pair[1]))

        return sorted(pairs, key=place)

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def __repr__(self) -> str:
        return f"Compensator({'; '.join([str(self.stability()).rstrip('.'), *self._equations(self.model.values)])})"

    def __str__(self) -> str:
        return "\n".join([str(self.stability()), *self.lines(numbers=True)])


def ends(limits: Any) -> tuple[float, float] | None:
    """Return limits as two numbers."""
    if limits is None:
        return None
    try:
        low, high = map(float, limits)
    except (TypeError, ValueError):
        raise ModelError(f"Limits are a lower and a higher number, not {limits!r}.") from None
    return low, high


def allowed(limits: Sequence[float] | None = None, rate: float | None = None) -> tuple[float, float]:
    """Return the lowest and the highest input; refuse limits that are not increasing, and a rate that is not positive.

    Raises
    ------
    ModelError
    """
    low, high = ends(limits) or (float("-inf"), float("inf"))
    if not low < high or (rate is not None and not 0 < float(rate) < float("inf")):
        raise ModelError("Limits are a lower and a higher number, and a rate is a positive number.")
    return low, high


def compensator(model: Model, force: bool = False) -> Compensator:
    """Derive the compensation law of a model, or of an identified inverse.

    Strategy 1 (Eq. Cms:InputCompensation): y becomes r, u becomes m, and m[k - tau_d + 1] is isolated one step ahead;
    written here for m[k], it needs the reference up to k + tau_d. Strategy 2 (Eq. Cci:InputCompensation): in an
    identified inverse y[k-j] becomes r[k-j+tau_s].

    Beyond Assumption A1 (nonlinear in the newest input, effects that remember) the law is derived in stages.

    Parameters
    ----------
    force : bool
        Also for a model whose fit said not to use it.

    Raises
    ------
    ModelError
        For a model whose free run is no better than a constant.
    NotInvertible
        Naming the terms or the effects that violate Assumption A1(i) where there is no law beyond it, or what else is
        missing.
    """
    if model.info.useless and not force:
        raise ModelError(
            "The free run of this model is no better than a constant, so no law is derived: fit another model, or "
            "use force=True (--force)."
        )
    taken = {r.name, m.name}
    while True:  # at most twice: what a law computes beside m is called after its stages
        apart, names = set_apart(model, taken)
        law = _derived(apart)
        stages = law.staged.stages if law.staged else ()
        unknowns = {m.name, *(s.unknown.base.name for s in stages)}
        made = {f"{name}_{word}" for name in unknowns for word in BESIDE} | {n for s in stages for n, _ in s.steps}
        if not made.intersection(own_names(apart)):
            return replace(law, aside=tuple(names.items())) if names else law
        taken |= made


def _derived(model: Model) -> Compensator:
    """Derive the law of a model whose channels leave the law's names to it."""
    if model.input == y:
        law = swap(model.right, {u: m, y: r}, {y: model.lead})
        return Compensator(model, law)
    right = model.right
    if not model.hidden and not samples(right, model.input):
        raise NotInvertible("The model has no input term: there is nothing to solve for (Assumption A1).")
    delay = newest_input(model)
    latest = model.input[k - delay]
    if model.hidden or offending(model):
        return _beyond(model)
    gain = derivative(right, latest)
    value = gain.xreplace(model.values)
    if value == 0 or (value.is_number and abs(float(value)) < 1e-300):
        if model.states:  # an added effect takes the newest input away: a pure delay
            return _beyond(model)
        raise NotInvertible(f"The coefficient of {printing.text(latest)} is zero: the input does not act (A1(i)).")
    # It is linear in the newest input: nothing else changes where that is set to zero.
    parts = [p.xreplace({latest: sp.S.Zero}) if p.has(latest) else p for p in sp.Add.make_args(right)]
    rest = shift(swap(sp.Add(*parts), {model.input: m, y: r}), delay)
    law = sp.Add(*(p / gain for p in (r[k + delay], *(-x for x in sp.Add.make_args(rest)))))
    return Compensator(model, law, *polynomials(model))


def _beyond(model: Model) -> Compensator:
    """Derive a law in stages."""
    try:
        staged = stages_of(model)
    except NotInvertible as error:
        raise NotInvertible(why_not(model, str(error))) from None
    return Compensator(model, dict(staged.updates)[m[k]], staged=staged)
