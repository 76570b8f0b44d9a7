"""A law that rings is damped: of the change that it asks for, the input goes a part in each sample.

The poles of a law are the zeros of the model. A zero near -1, as a fast resonance or half a sample of delay leave it,
makes the input alternate from sample to sample long after it was disturbed; one beyond -1 makes it run away. A law that
goes the share a of the way, m[k] = m[k-1] + a (asked - m[k-1]), has the zeros of a B + (1 - a) (1 - 1/z) b_0 A as its
poles instead of those of B: a root locus from the zeros of the model to its poles and 1. The rest of the way is made up
for later, because the model runs beside the law.

Both are measured on the law itself: it makes what the model makes of a slow ramp, and is disturbed once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np

from ...errors import ModelError, NarxError
from ...inversion.compensator import Compensator
from ...models.model import Model
from ...symbolic.signals import y
from ..simulate import rest_output
from .internal import DOUBLES
from .trial import Trial, own_output

Array = np.ndarray
Share = float | Literal["auto"] | None
SHARES = np.arange(1, 20) / 20
RESTS, RISE, LASTS = 600, 100, 200  # samples before the ramp, of the ramp before the disturbance, and after it
STEPS, SMALL = 400, 1e-3  # steps of the ramp through the recorded range; the disturbance in steps
ALTERNATES = 0.5  # of the steps that turn back: a signal that swings by itself
FORGOTTEN = 0.01  # of a disturbance: what is smaller counts for nothing
ROUNDS, RESTED = 20, 1e-12  # until a model rests
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
        ramp = _Ramp(law)
        free = ramp.after(1.0)
    except NarxError:  # what does not run on a ramp is said where it runs
        return Damping(0.0)
    ring = _ring(free, ramp.depth)
    if ring < DOUBLES:
        return Damping(ring)
    lasts = _forgets(free) if np.isfinite(ring) else LASTS
    tried = [(_forgets(found), -float(a)) for a in SHARES if np.isfinite(found := ramp.after(float(a))).all()]
    best, share = min(tried, default=(LASTS, -1.0))
    return Damping(ring, lasts, -share, best) if best < lasts else Damping(ring, lasts)


class _Ramp:
    """A slow ramp through the recorded inputs, what the model makes of it, and the law that makes the same."""

    def __init__(self, law: Compensator):
        model, ahead = law.model, law.preview
        low, high = model.info.ranges.get(model.input.name, (0.0, 1.0))
        self.step = (high - low) / STEPS
        begin = RISE // 2 + ahead
        n = begin + RISE + LASTS + ahead
        self.at = begin + RISE
        self.ramp = (low + high) / 2 + self.step * (np.maximum(np.arange(n) - begin, 0) - n / 2)
        first = rest_output(model, self.ramp[0]) if model.info.line else model.operating_point.get(y, 0.0)
        for _ in range(ROUNDS):  # an output that stays: what it remembers may start elsewhere each time
            before, first = first, float(own_output(model, np.full(RESTS, self.ramp[0]), first)[-1])
            if abs(first - before) <= RESTED * (1.0 + abs(first)):
                break
        self.trial = Trial.of_input(law, self.ramp, first)
        self.depth = self.trial.prepared.depth

    def after(self, share: float) -> Array:
        """Return what a disturbance of 1 becomes, sample by sample; NaN from where it is beyond all numbers."""
        kick, base = SMALL * self.step, self.trial.inputs(share=share)
        away = np.abs(base - self.ramp)[self.at - self.depth - 1 : self.at]
        if not (away < STEPS * self.step).all():  # rounding alone has grown beyond the ramp
            with np.errstate(over="ignore"):
                grown = (base - self.ramp) / kick
            return grown[np.flatnonzero(grown)[0] :]
        return ((self.trial.inputs(share=share, kick=kick, at=self.at) - base) / kick)[self.at : self.at + LASTS]


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
