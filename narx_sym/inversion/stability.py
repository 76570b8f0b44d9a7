"""The dynamics of a law itself: section 3 of the paper applied to m[k] = law(m[k-1], ..., r).

In the model the output follows exactly, whatever the law does inside. Whether m itself stays where it should is the
question of its own Jacobian, fixed points and attracting regions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import sympy as sp

from ..models.model import Model
from ..models.rest.equilibria import SteadyState, characteristic, jury, steady_state, without_integrator, z
from ..models.rest_map import ubar, ybar
from ..symbolic import printing
from ..symbolic.recursion import Recursion
from ..symbolic.sensitivity import derivative, sensitivities
from ..symbolic.signals import Name, k, lag, m, r, samples, shift, signal
from .doors import InternalDynamicsDoors
from .stages import in_order

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


@dataclass(frozen=True)
class InternalRecursion(printing.InLatex):
    """How a law with branches or further states reacts to an error of its input: one derivative beside each state.

    No polynomial holds for all branches, so it is the law beside its model, with the derivative of every state by an
    error `m_kick[k]` that is added to m[k] (`narx_sym.symbolic.sensitivity.sensitivities`). Roots that have no closed
    form are differentiated implicitly, and a kink has the derivative of the side on which the run is.

    Attributes
    ----------
    law : Compensator
    recursion : Recursion
    moved : mapping from states to their derivatives, dm_0 of m

    Examples
    --------
    >>> import narx_sym as ns
    >>> model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "abs(u[k-1])", "u[k-2]"], [0.5, 1.5, -0.5, -0.8])
    >>> model.compensator().internal.along([5.0, 6.0, 7.0], m0=12.5)
    array([1.  , 0.3 , 0.24])
    """

    law: Compensator
    recursion: Recursion
    moved: dict[Any, Any]

    @property
    def updates(self) -> list[tuple[Any, Any]]:
        """The equations of the derivatives."""
        return [(left, right) for left, right in self.recursion.updates if left.base in self.moved.values()]

    def latex(self) -> str:
        """LaTeX of the equations of the derivatives."""
        return printing.latex_law(self.updates)

    def along(self, reference: Any, m0: Any = None, channels: Any = None, at: int = 0) -> Any:
        """Return what becomes of an error of 1 at a sample of a run: see `Compensator.disturbance`."""
        return self.law.disturbance(reference, m0, channels, at)


def internal_dynamics(law: Compensator) -> InternalDynamics | InternalRecursion:
    """Derive Jacobian, eigenvalues and attracting condition of a law along slow motion.

    Of a law with branches or further states: the recursion of an error.
    """
    return internal_recursion(law) if law.staged else InternalDynamics(law, *_derived(law.law))


def internal_recursion(law: Compensator) -> InternalRecursion:
    """Derive what becomes of an error of m, for the law beside its model."""
    size, kick = sp.Dummy("size", real=True), signal("m_kick")
    disturbed = in_order(law.beside(lambda asked: asked + size * kick[k]), (*law.symbols, size))
    full, (moved,) = sensitivities(disturbed, [size])
    at_zero = full.subs({size: sp.S.Zero})
    # A derivative speaks of the root, not of its equation again.
    named = {right: left for left, right in at_zero.updates[: len(disturbed.updates)] if not right.is_Atom}
    shown = ((left, right.xreplace(named) if left.base in moved.values() else right) for left, right in at_zero.updates)
    return InternalRecursion(law, Recursion(tuple(shown), at_zero.parameters), moved)


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
