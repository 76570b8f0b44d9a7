"""What is said first of a law: whether it forgets its own errors, and for which signals it was identified."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ...errors import ModelError, NarxError
from ...inversion.compensator import Compensator
from ...models.model import Model
from ...symbolic.signals import y
from ..simulate import rest_output
from .damping import damping
from .internal import DOUBLES, law_radius_at, operating_range
from .trial import TINY, Trial

LENGTH, PERIODS, INSIDE = 800, 2, 0.9  # samples of a trial, its periods, the part of the known range that it passes
OTHER = 1e-3  # of the input's range: what is as far away is another input
_known: WeakKeyDictionary[Model, Stability] = WeakKeyDictionary()


@dataclass(frozen=True)
class Stability:
    """Whether a law is stable, and where its model is known.

    Attributes
    ----------
    stable : bool or None
        Whether a disturbance of the input stops growing; None where that is not known.
    why : str
        What was looked at.
    ranges : (name, lowest, highest) of input and output in the records; empty for a model that has seen none
    apart : float
        How far the input of a trial is from that which made its output, in ranges of the input: of the law as it is,
        without damping, which is late. 0 where none was run.
    """

    stable: bool | None
    why: str
    ranges: tuple[tuple[str, float, float], ...] = ()
    apart: float = 0.0

    def __str__(self) -> str:
        head = {True: "Stable", False: "UNSTABLE", None: "Stability not known"}[self.stable]
        known = " and ".join(f"{name} from {low:.4g} to {high:.4g}" for name, low, high in self.ranges)
        return f"{head}: {self.why}. Known range: {known or 'none, the model was not fitted to records'}."


def stability(law: Compensator) -> Stability:
    """Return whether a law is stable with its default damping, and for which range this is known."""
    found = _known.get(law.model)  # once: an equal model that is the key may be collected between two looks
    if found is None:
        known = law.model.info.ranges.items()
        ranges = tuple((name, float(low), float(high)) for name, (low, high) in known if name in ("u", "y"))
        stable, why, *apart = _judged(law)
        _known[law.model] = found = Stability(stable, why, ranges, *apart)
    return found


def strays(law: Compensator) -> bool:
    """Whether on a slow sine through the known range a law takes other inputs than that which made the output.

    There are several then that stand apart, which algebra does not exclude: the model cannot tell them from each other,
    the machine can. On a flat piece all are alike.
    """
    return stability(law).apart > OTHER and not all(stage.alone for stage in (law.staged.stages if law.staged else ()))


def refuse_unstable(law: Compensator) -> None:
    """Raise ModelError for a law that is unstable."""
    found = stability(law)
    if found.stable is False:
        raise ModelError(f"The law is not exported. {found} To export it nevertheless, use force=True (--force).")


def _judged(law: Compensator) -> tuple[bool | None, str] | tuple[bool, str, float]:
    model = law.model
    if model.theta is None:
        return None, "the parameters have no values"
    damped = damping(law)
    if not law.staged and damped.share == 1:
        radius = law_radius_at(law)
        if radius is not None:  # the same wherever the law is
            return radius <= 1, f"its own dynamics have poles up to {radius:.4g}"
        passed = operating_range(law)
        if passed is not None and passed.largest <= 1:
            return True, f"its own dynamics have poles up to {passed.largest:.4g} over the known range"
        if passed is not None and min(passed.shares.values()) == 1:
            return False, f"its own dynamics repel in all of the known range, with poles up to {passed.largest:.4g}"
    if not {model.input.name, model.output.name} <= model.info.ranges.keys() or model.input == y:
        return None, "the model has no known signal ranges to test it on"
    return _tried(law, damped.share)


def _tried(law: Compensator, share: float) -> tuple[bool, str, float]:
    """Run a law over a slow sine through the known range, and disturb it once."""
    how = "on a slow sine through the known range" + (f", damped to {share:.3g} of each step," if share < 1 else "")
    try:
        late, most, apart = _grown(law, share)
    except NarxError:
        return False, f"{how} the law diverges", np.inf
    if not np.isfinite(most):
        return False, f"{how} the law diverges", np.inf
    if late >= DOUBLES:
        return False, f"{how} a disturbance of its input continues to grow, to {most:.3g} times its size", apart
    if most * TINY >= 1:  # larger than the range: it grows no more where it is as large as it can get
        return False, f"{how} a disturbance of its input grows to {most:.3g} times its size", apart
    if share == 1 and apart > OTHER and law.staged and all(stage.proved for stage in law.staged.stages):
        return False, f"{how} its input deviates from the only correct input by {apart:.3g} of its range", apart
    said = f"{how} a disturbance of its input grows to {max(1.0, most):.3g} times its size at most"
    return True, said, apart


def _grown(law: Compensator, share: float) -> tuple[float, float, float]:
    """Return by how much a disturbance grows from the middle of a trial to its end, and at most; and `apart`."""
    low, high = law.model.info.ranges[law.model.input.name]
    wave = np.sin(2 * np.pi * PERIODS * np.arange(LENGTH) / LENGTH)
    u, at = (low + high) / 2 + INSIDE * (high - low) / 2 * wave, LENGTH // 4
    trial, size = Trial.of_input(law, u, rest_output(law.model, u[0])), float(np.ptp(u))
    plain = trial.inputs(share=share)
    away = np.abs(trial.inputs(share=share, kick=TINY * size, at=at) - plain)[at:] / (TINY * size)
    away = np.nan_to_num(away, nan=np.inf, posinf=np.inf)
    middle, end = (float(part.max()) for part in np.array_split(away, 3)[1:])
    seen = LENGTH - law.preview  # later the reference is held
    gap = np.abs((plain if share == 1 else trial.inputs()) - u)[:seen]
    apart = float(np.nan_to_num(gap, nan=np.inf, posinf=np.inf).max()) / size
    return end / max(1.0, middle) if np.isfinite(end) else np.inf, float(away.max()), apart
