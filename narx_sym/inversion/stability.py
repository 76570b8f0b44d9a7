"""The dynamics of a law itself: section 3 of the paper applied to m[k] = law(m[k-1], ..., r).

In the model the output follows exactly, whatever the law does inside. Whether m itself stays where it should is the
question of its own Jacobian, fixed points and attracting regions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import sympy as sp

from ..errors import ModelError
from ..models.model import Model
from ..models.rest.equilibria import SteadyState, characteristic, jury, steady_state, without_integrator, z
from ..models.rest_map import ubar, ybar
from ..symbolic import printing
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import Name, k, lag, m, r, samples, shift
from .doors import InternalDynamicsDoors

if TYPE_CHECKING:
    from .compensator import Compensator

mbar, rbar = (Name(n, real=True) for n in (r"\bar{m}", r"\bar{r}"))
# The directions of slow motion: of m, and of the reference. 1 rising, -1 falling.
direction, heading = (Name(n, real=True) for n in ("s", "s_r"))


@dataclass(frozen=True)
class InternalDynamics(InternalDynamicsDoors, printing.InLatex):
    """How a law reacts to its own past, around slow motion.

    Attributes
    ----------
    law : Compensator
    jacobian : list of expressions
        [dm[k]/dm[k-1], dm[k]/dm[k-2], ...] with time indices.
    polynomial : expression in z, mbar, rbar and the directions s (of m) and s_r (of the reference)
        Its roots are the eigenvalues along slow motion: all past m equal mbar, all r equal rbar. The root that is
        exactly 1 is taken out.
    integrates : bool
        Whether that root was there: every law of a Sigma_y = 1 model has it.
    condition : relational or true
        Where the law is attracting.
    turns : mapping from s and s_r to what they stand for in the law, such as sign(m[k-1] - m[k-2])
    """

    law: Compensator
    jacobian: list[Any]
    polynomial: Any
    integrates: bool
    condition: Any
    turns: dict[Any, Any]

    def latex(self) -> str:
        """LaTeX of the polynomial whose roots are the eigenvalues, and of where all of them are inside the circle."""
        return printing.latex([sp.Eq(self.polynomial, 0, evaluate=False), self.condition])

    @property
    def numbers(self) -> Any:
        """The polynomial with the values of the parameters in it."""
        # A law may integrate with numbers that does not in symbols (theta_1 = 1 by constraint): that root goes too.
        known = self.polynomial.xreplace(self.law.model.values)
        return known if self.integrates else without_integrator(known)[0]

    @property
    def eigenvalue(self) -> Any:
        """The root of the polynomial with numbers; None where it has no root left or several."""
        polynomial = sp.Poly(self.numbers, z)
        if polynomial.degree() != 1:
            return None
        lead, rest = polynomial.all_coeffs()
        return sp.expand(-rest / lead)

    @property
    def region(self) -> Any:
        """Where the law repels, with numbers: a relational in mbar, rbar and s, or false where it repels nowhere."""
        root = self.eigenvalue
        if root is not None:
            return sp.Ge(sp.Abs(root), 1)
        return sp.Not(sp.And(*(c.doit() for c in jury(self.numbers)))) if self.numbers.has(z) else sp.false

    @property
    def fixed_points(self) -> SteadyState:
        """The law at rest: mbar = G(mbar, rbar), the condition of a continuum, and the fixed points.

        Raises
        ------
        ModelError
            For a law that changes with time.
        """
        law, ahead = self.law, self.law.preview
        own = Model(shift(law.law, -ahead) if ahead else law.law, law.symbols, law.model.theta, output=m, input=r)
        found, names = steady_state(own), {ybar: mbar, ubar: rbar}
        listed = found.equilibria
        points = [p.xreplace(names) for p in listed] if isinstance(listed, list) else listed
        if isinstance(listed, sp.Set):  # its unknown is bound
            points = listed.func(mbar, listed.condition.xreplace(names), listed.base_set)
        conditions = [c.xreplace(names) for c in found.conditions]
        return SteadyState(found.equation.xreplace(names), conditions, points, excess=found.excess)


def internal_dynamics(law: Compensator) -> InternalDynamics:
    """Derive Jacobian, eigenvalues and attracting condition of a law along slow motion.

    Raises
    ------
    ModelError
        For a law with branches or further states.
    """
    if law.staged:
        raise ModelError(
            "The internal dynamics are not derived for a law with branches or further states; "
            "law.disturbance(reference) has what becomes of a disturbance along a run."
        )
    return InternalDynamics(law, *_derived(law.law))


@lru_cache(maxsize=256)  # sweeps derive the same law many times
def _derived(law: Any) -> tuple[list[Any], Any, bool, Any, dict[Any, Any]]:
    depth = max([0, *(lag(x) for x in samples(law, m))])
    jacobian = [derivative(law, m[k - i]) for i in range(1, depth + 1)]
    turns: dict[Any, Any] = {}
    slow = [sp.simplify(_slow(slope, turns)) for slope in jacobian]
    polynomial, integrates = without_integrator(characteristic(slow)) if slow else (sp.S.One, False)
    conditions = jury(polynomial) if polynomial.has(z) else []
    condition = sp.And(*conditions) if conditions else sp.true
    return jacobian, polynomial, integrates, condition, turns


def _slow(slope: Any, turns: dict[Any, Any]) -> Any:
    """Hold m and r still, but keep the direction in which they move where a sign asks for it."""

    def turned(node: Any) -> Any:
        argument = node.args[0] - node.args[1] if isinstance(node, sp.core.relational.Relational) else node.args[0]
        moving = _step(argument)
        if moving is None:
            return _still(node)
        symbol, sense = moving
        told = node if isinstance(node, sp.tanh) else sp.sign(argument)
        turns.setdefault(symbol, sense * told)
        if isinstance(node, (sp.sign, sp.tanh)):
            return sense * symbol
        if isinstance(node, sp.Heaviside):
            return (1 + sense * symbol) / 2
        return node.func(sense * symbol, 0)

    kinds = (sp.sign, sp.tanh, sp.Heaviside, sp.core.relational.Relational)
    return _still(slope.replace(lambda e: isinstance(e, kinds) and bool(samples(e)), turned))


def _still(expr: Any) -> Any:
    held = {m: mbar, r: rbar}
    return expr.xreplace({s: held.get(s.base, s) for s in samples(expr)})


def _step(argument: Any) -> tuple[Any, Any] | None:
    """Return (s or s_r, 1 or -1) for a difference in time of m or of r alone; None for anything else."""
    for base, symbol in ((m, direction), (r, heading)):
        read = samples(argument)
        if read and all(s.base == base for s in read) and sp.expand(_still(argument)) == 0:
            rising = sp.expand(argument.xreplace({s: -lag(s) for s in read}))  # one unit more in each sample
            if rising.is_number and rising != 0:
                return symbol, sp.sign(rising)
    return None
