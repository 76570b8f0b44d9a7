"""Experiments with a law beside its model: one recursion whose input can be given, damped, and disturbed once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sympy as sp

from ...engines.compile import Compiled, compile
from ...errors import Diverged, ModelError
from ...inversion.compensator import Compensator
from ...inversion.stability import internal_recursion
from ...inversion.stages import in_order
from ...models.model import Model
from ...symbolic.signals import k, m, signal, y
from ..simulate import fitted, named, simulate, vector
from .driven import FREE, Prepared

Array = np.ndarray
TINY, PLACES = 1e-9, 4  # of the input's range: a disturbance; where along a run it is put
TAKEN, SHARE, KICK = (signal(f"m_{what}") for what in ("taken", "share", "kick"))


def testable(law: Compensator) -> Compiled:
    """Return a law beside its model whose input is `m_taken` where that is given.

    Else it goes the part `m_share` of each change that the law asks for; `m_kick` is added to both.
    """

    def moved(asked: Any) -> Any:
        damped = asked - (1 - SHARE[k]) * (asked - m[k - 1])  # with a share of 1 not a digit changes
        return sp.Piecewise((TAKEN[k], TAKEN[k] < FREE), (damped, True)) + KICK[k]

    return compile(in_order(law.beside(moved), law.symbols))


def own_output(model: Model, u: Array, first: float) -> Array:
    """Return what a model makes of an input that rested before, its channels at zero, (N,)."""
    return simulate(model, u, first, {name: np.zeros(u.size) for name in model.channels}, u0=float(u[0]), warn=False)


def alone(model: Model, u: Array, first: float, start: float, channels: Mapping[str, Any]) -> Array:
    """Return what a model gives by itself under an input, (N,): no law takes it back to its reference.

    Before, input and output were `start` and `first`, at rest or not; infinite from where it runs away.
    """
    try:
        return simulate(model, u, first, channels, u0=start, warn=False)
    except Diverged as error:
        found, known = np.full(u.size, np.inf), np.asarray(error.trajectory)[-u.size :][: max(0, error.at)]
        found[: known.size] = known
        return found


class Trial:
    """The runs of such a law over one reference: parameters as for `narx_sym.fit.laws.driven.driven`."""

    def __init__(self, law: Compensator, target: Array, start: float, channels: Mapping[str, Any]):
        self.start, self.n = start, target.size
        free = {"m_share": np.ones(self.n), "m_taken": np.full(self.n, FREE), "m_kick": np.zeros(self.n)}
        self.prepared = Prepared.of(law, testable(law), target, start, {**channels, **free})

    @classmethod
    def of_input(cls, law: Compensator, u: Array, first: float) -> Trial:
        """Return the runs that should make an input again: along what the model makes of it, from a first output."""
        channels = {name: np.zeros(u.size) for name in law.model.channels}
        return cls(law, own_output(law.model, u, first), float(u[0]), channels)

    def inputs(
        self, share: float = 1.0, taken: Array | None = None, kick: float = 0.0, at: int = 0, end: int | None = None
    ) -> Array:
        """Return the input along the reference, until a sample; NaN from where it diverges.

        Parameters
        ----------
        share : of each change that is asked for, the input goes this part
        taken : (N,) array, inputs that are given; FREE where none is
        kick, at : a disturbance, and the sample at which it is added
        """
        n = self.n if end is None else end + 1
        more = {"m_share": np.full(self.n, share), "m_kick": kick * (np.arange(self.n) == at)}
        more |= {} if taken is None else {"m_taken": taken}
        with np.errstate(all="ignore"):
            found = self.prepared.run({name: (c, float(c[0])) for name, c in more.items()}, {}, 0, n)
        return np.asarray(found["m"][self.prepared.depth :][:n])

    def error_growth(self, places: Sequence[int], end: int, **options: Any) -> list[Array]:
        """Return what a small disturbance at each of some samples becomes until another one, as multiples of it."""
        base = self.inputs(**options, end=end)
        kick = TINY * max(float(np.ptp(np.nan_to_num(base[: max(end, 1)]))), abs(self.start), TINY)
        found = (np.abs(self.inputs(kick=kick, at=one, end=end, **options) - base)[one:] / kick for one in places)
        return [np.nan_to_num(x, nan=np.inf, posinf=np.inf) for x in found]


def growth(
    law: Compensator, target: Array, start: float, channels: Mapping[str, Any], end: int, **options: Any
) -> float:
    """Return by how much a small disturbance of the input grows along a run, at most, until a sample.

    Options as for `Trial.inputs`.
    """
    places = sorted({end * part // PLACES for part in range(PLACES)})
    found = Trial(law, target, start, channels).error_growth(places, end, **options)
    return max(float(one.max(initial=0.0)) for one in found)


def disturbance(
    law: Compensator, reference: Any, m0: Any = None, channels: Mapping[str, Any] | None = None, at: int = 0
) -> Array:
    """Return how a small disturbance of the input grows or decays along a run of a law, without damping.

    By the derivatives of `narx_sym.inversion.stability.InternalRecursion`, so that laws with branches and states have
    it too. The law goes on from the model's output, as it does on a machine.

    Parameters
    ----------
    reference : (N,) array [unit of y]
    m0 : number, optional
        The input before the start [unit of u]; by default as for `Compensator.run`.
    channels : mapping of names to (N,) arrays
    at : the sample that is disturbed

    Returns
    -------
    (N - at,) array
        Its size from there on, as a multiple of what it was; infinite where it is beyond all numbers.

    Raises
    ------
    ModelError
        For a law without values, an identified inverse, and a sample outside of the reference.
    """
    target = vector(reference, "reference", least=2)
    fitted(law.model)
    if law.model.input == y or not 0 <= at < target.size:
        raise ModelError(
            f"A disturbance is one of a law that is derived from a model, at one of {target.size} samples."
        )
    start = law.rest_input(float(target[0]), None) if m0 is None else float(m0)
    found = internal_recursion(law)
    given = {**law.named(named(channels)), "m_kick": 1.0 * (np.arange(target.size) == at)}
    prepared = Prepared.of(law, compile(found.recursion), target, start, given)
    initial = {**prepared.initial, **{moved.name: 0.0 for moved in found.moved.values()}}
    with np.errstate(all="ignore"):
        run = replace(prepared, initial=initial).run({}, {}, 0, target.size)
    size = np.abs(run[found.moved[m].name][prepared.depth :][at : target.size])
    return np.asarray(np.nan_to_num(size, nan=np.inf, posinf=np.inf))
