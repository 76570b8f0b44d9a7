"""A law that rings is damped: of the change that it asks for, the input goes a part in each sample.

The poles of a law are the zeros of the model. A zero near -1, as a fast resonance or half a sample of delay leave it,
makes the input alternate from sample to sample long after it was disturbed; one beyond -1 makes it run away. A law that
goes the share a of the way, m[k] = m[k-1] + a (asked - m[k-1]), has the zeros of a B + (1 - a) (1 - 1/z) b_0 A as its
poles instead of those of B: a root locus from the zeros of the model to its poles and 1. The rest of the way is made up
for later, because the model runs beside the law.

Both are measured on the law itself: it makes what the model makes of a slow ramp, and is disturbed once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal
from weakref import WeakKeyDictionary

import numpy as np

from ...engines.compile import Compiled, compile
from ...errors import ModelError, NarxError
from ...inversion.compensator import Compensator
from ...inversion.stages import in_order
from ...models.model import Model
from ...symbolic.recursion import Recursion
from ...symbolic.signals import k, m, signal, y
from ..simulate import fitted, named, rest_output, simulate, vector
from .driven import driven
from .excursions import DOUBLES

Array = np.ndarray
Share = float | Literal["auto"] | None
SHARES = np.arange(1, 20) / 20
RESTS, RISE, LASTS = 600, 100, 200  # samples before the ramp, of the ramp before the disturbance, and after it
STEPS, SMALL = 400, 1e-3  # steps of the ramp through the recorded range; the disturbance in steps
ALTERNATES = 0.5  # of the steps that turn back: a signal that swings by itself
FORGOTTEN = 0.01  # of a disturbance: what is smaller counts for nothing
ROUNDS, RESTED = 20, 1e-12  # until a model rests
TINY, PLACES = 1e-9, 4  # of the input's range: a disturbance; where along a run it is put
FREE, KICK = signal("m_share"), signal("m_kick")
_known: WeakKeyDictionary[Model, Damping] = WeakKeyDictionary()


@dataclass(frozen=True)
class Damping:
    """What a disturbance of the input does, and what is done about it.

    Attributes
    ----------
    ring : float
        H2 norm of the alternating part of the input after a disturbance of 1; infinite where it grows.
    lasts : int
        Samples until a disturbance is forgotten: 99 % of it.
    share : float
        Of the change that the law asks for, the input goes this part in a sample; 1 where the law is left as it is.
    damped : int
        `lasts` with that share.
    """

    ring: float
    lasts: int = 0
    share: float = 1.0
    damped: int = 0

    @property
    def rings(self) -> bool:
        """Whether a disturbance makes the input alternate with at least twice its size."""
        return self.ring >= DOUBLES

    @property
    def sentence(self) -> str:
        """Say that a law rings, and what is done; empty where it does not."""
        if not self.rings:
            return ""
        longer = "at least " if self.lasts >= LASTS - 1 else ""  # no more are looked at
        grows = "grows from sample to sample" if np.isinf(self.ring) else f"lasts for {longer}{self.lasts} samples"
        said = (
            "The law rings: after a disturbance its input alternates from sample to sample, which "
            f"{grows} (the model has a zero near -1)"
        )
        if self.share == 1:
            return f"{said}. Damping does not help: limit the rate of the input."
        return (
            f"{said}. So the law is damped: in each sample the fraction {self.share:.3g} of the computed change is "
            f"applied. On a slow ramp a disturbance then decays in {self.damped} samples. (No damping: --share none, "
            "share=None)"
        )


def share_of(law: Compensator, share: Share | str = "auto") -> float:
    """Return the damping factor of a law: the given number, that of `damping` for "auto", 1 for None."""
    if share is None:
        return 1.0
    if share == "auto":
        return damping(law).share
    try:
        part = float(share)
    except ValueError:
        part = float("nan")
    if not 0 < part <= 1:
        raise ModelError(f"share must be above 0 and at most 1, not {share!r}.")
    return part


def damping(law: Compensator) -> Damping:
    """Return whether a law rings, and the damping with which disturbances decay fastest."""
    if law.model.input == y or law.model.theta is None:
        return Damping(0.0)
    found = _known.get(law.model)  # once: an equal model that is the key may be collected between two looks
    if found is None:
        _known[law.model] = found = _measured(law)
    return found


def _measured(law: Compensator) -> Damping:
    try:
        trial = _Trial(law)
        free = trial.after(1.0)
    except NarxError:  # what does not run on a ramp is said where it runs
        return Damping(0.0)
    ring = _ring(free, trial.depth)
    if ring < DOUBLES:
        return Damping(ring)
    lasts = _forgets(free) if np.isfinite(ring) else LASTS
    tried = [(_forgets(found), -float(a)) for a in SHARES if np.isfinite(found := trial.after(float(a))).all()]
    best, share = min(tried, default=(LASTS, -1.0))
    return Damping(ring, lasts, -share, best) if best < lasts else Damping(ring, lasts)


def growth(
    law: Compensator, target: Array, start: float, channels: Mapping[str, Any], at: int,
    made: Callable[[Any], Recursion] | None = None,
) -> float:  # fmt: skip
    """Return by how much a small disturbance of the input grows along a run, at most, until a sample.

    Parameters as for `narx_sym.fit.laws.driven.driven`; `at` is the sample, and `made` the law with the model beside
    it, as a function of what becomes of the wanted input.
    """
    places = sorted({at * part // PLACES for part in range(PLACES)})
    return max(float(one.max(initial=0.0)) for one in _grown(law, target, start, channels, at, places, made))


def disturbance(
    law: Compensator, reference: Any, m0: Any = None, channels: Mapping[str, Any] | None = None, at: int = 0
) -> Array:
    """Return how a small disturbance of the input grows or decays along a run of a law, without damping.

    The law's own dynamics where there is no polynomial for them: of laws with branches and states. The law goes on from
    the model's output, as it does on a machine.

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
    return _grown(law, target, start, law.named(named(channels)), target.size - 1, [at])[0]


def _grown(
    law: Compensator, target: Array, start: float, channels: Mapping[str, Any], at: int, places: list[int],
    made: Callable[[Any], Recursion] | None = None,
) -> list[Array]:  # fmt: skip
    """Return what a disturbance at each of some samples becomes until `at`, in multiples of it; see `growth`."""
    own = made or (lambda clipped: in_order(law.beside(clipped), law.symbols))
    compiled = compile(own(lambda asked: asked + KICK[k]))
    stop = at + 1 + compiled.recursion.lead
    target, channels = target[:stop], {name: np.asarray(c)[:stop] for name, c in channels.items()}

    def run(kick: Array) -> Array:
        with np.errstate(all="ignore"):
            found = driven(law, compiled, target, start, {**channels, "m_kick": kick}, on_divergence="nan")
        return found["m"][: at + 1]

    base = run(np.zeros(target.size))
    kick = TINY * max(float(np.ptp(np.nan_to_num(base[: max(at, 1)]))), abs(start), TINY)
    grown = (np.abs(run(kick * (np.arange(target.size) == one)) - base)[one:] / kick for one in places)
    return [np.nan_to_num(g, nan=np.inf, posinf=np.inf) for g in grown]


def nudged(law: Compensator) -> Compiled:
    """Return a law beside its model that goes a share of each step, and whose input may be disturbed."""
    beside = law.beside(lambda asked: m[k - 1] + FREE[k] * (asked - m[k - 1]) + KICK[k])
    return compile(in_order(beside, law.symbols))


def run_nudged(
    law: Compensator, compiled: Compiled, target: Array, start: float, channels: Mapping[str, Any], share: float,
    kick: float, at: int,
) -> Array:  # fmt: skip
    """Return the input that `nudged` makes along a reference, (N,), with a disturbance at one sample; NaN beyond."""
    n = target.size
    more = {"m_share": np.full(n, share), "m_kick": kick * (np.arange(n) == at)}
    with np.errstate(all="ignore"):
        return np.asarray(driven(law, compiled, target, start, {**channels, **more}, on_divergence="nan")["m"][:n])


class _Trial:
    """A slow ramp through the recorded inputs, what the model makes of it, and the law that makes the same."""

    def __init__(self, law: Compensator):
        model, self.law = law.model, law
        low, high = model.info.ranges.get(model.input.name, (0.0, 1.0))
        self.step = (high - low) / STEPS
        begin = RISE // 2 + law.preview
        n = begin + RISE + LASTS + law.preview
        self.at = begin + RISE
        self.ramp = (low + high) / 2 + self.step * (np.maximum(np.arange(n) - begin, 0) - n / 2)
        self.channels: dict[str, Any] = {name: np.zeros(n) for name in model.channels}
        self.target = self._simulated(self.ramp, self._rest())
        self.compiled = nudged(law)
        self.depth = self.compiled.recursion.depth

    def _rest(self) -> float:
        """Return an output that stays under the first input."""
        model = self.law.model
        found = rest_output(model, self.ramp[0]) if model.info.line else model.operating_point.get(y, 0.0)
        for _ in range(ROUNDS):  # what it remembers may start elsewhere each time
            before, found = found, float(self._simulated(np.full(RESTS, self.ramp[0]), found)[-1])
            if abs(found - before) <= RESTED * (1.0 + abs(found)):
                break
        return found

    def _simulated(self, commands: Array, first: float) -> Array:
        held = {name: np.zeros(commands.size) for name in self.channels}
        return simulate(self.law.model, commands, first, held, u0=float(commands[0]), warn=False)

    def after(self, share: float) -> Array:
        """Return what a disturbance of 1 becomes, sample by sample; NaN from where it is beyond all numbers."""
        kick, base = SMALL * self.step, self._run(share, 0.0)
        away = np.abs(base - self.ramp)[self.at - self.depth - 1 : self.at]
        if not (away < STEPS * self.step).all():  # rounding alone has grown beyond the ramp
            with np.errstate(over="ignore"):
                grown = (base - self.ramp) / kick
            return grown[np.flatnonzero(grown)[0] :]
        return ((self._run(share, kick) - base) / kick)[self.at : self.at + LASTS]

    def _run(self, share: float, kick: float) -> Array:
        return run_nudged(self.law, self.compiled, self.target, self.ramp[0], self.channels, share, kick, self.at)


def _ring(d: Array, depth: int) -> float:
    """H2 norm of the alternating part, half the differences, of what is left once the output is back on its way.

    What grows or decays without turning back, as a zero near 1 makes it, does not alternate.
    """
    left, within = d[depth:], np.diff(d[np.abs(d) < 1 / SMALL])  # comparisons with NaN are False
    turns = within[1:] * within[:-1] < 0
    if not turns.sum() > ALTERNATES * turns.size:
        return 0.0
    if not (np.abs(left) < 1 / SMALL).all():
        return float("inf")
    size = abs(left[0])
    return float(np.sqrt(np.sum(np.diff(left, prepend=0.0) ** 2)) / (2 * size)) if size > FORGOTTEN else 0.0


def _forgets(d: Array) -> int:
    """Return after how many samples nothing is left but what stays."""
    away = np.abs(d - d[-1])
    return int(np.flatnonzero(away > FORGOTTEN * np.abs(d).max()).max(initial=-1)) + 1
